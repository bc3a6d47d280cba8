//! The layout of the file. The words on its keys are what editors show and `docs/config.md` says.

use std::collections::BTreeMap;

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;

use super::quantity::Quantity;
use super::rules::Rules;
use crate::checks::Selector;
use crate::finding::{Severity, Unit};
use crate::geometry::{Coding, Units, vendors};
use crate::log::{ColumnSelector, ColumnSettings};
use crate::robot::nearest;
use crate::run::{SaidRole, Witness};
use crate::time::Clock;

/// The settings of an audit. Options of the command line stand before them; paths are relative to
/// this file.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "poseaudit.toml")]
pub(super) struct File {
    /// The robot: a URDF or DH table, or a name of the catalogue; with several arms a table of them by
    /// the prefix of their joints' names. Default: the description in the log, else the catalogue's arm
    /// that fits.
    #[schemars(with = "Option<ByPrefix>")]
    pub robot: Option<Spanned<ByPrefix>>,
    /// A calibration: the JSON that `calibrate` wrote, or of a UR the YAML that `ur_calibration` extracts;
    /// with several arms a table by prefix. Default: what the log holds.
    pub calibration: Option<ByPrefix>,
    /// Joints that the log and the model name otherwise: the model's name by the log's. Default: names are
    /// matched, and where they differ, the order of the joints.
    #[serde(default)]
    pub joint_map: BTreeMap<String, String>,
    /// Link that the chain begins at. Default: the controller's base, else the root.
    pub base: Option<String>,
    /// End link; the pose streams are assumed to be this link's pose. A tip that is named here is held
    /// against them: an offset from it is a fault (FRM003), and not the active TCP.
    pub tip: Option<String>,
    /// The time that places a sample. Default: `header`.
    pub stamp: Option<ClockName>,
    /// Largest latency; what is off by more is on another clock. With a unit, or in seconds.
    /// Default: `5 s`.
    pub max_latency: Option<Duration>,
    /// The severity from which on a finding fails the run. Default: `warning`.
    pub fail_on: Option<FailOn>,
    /// Rules that must conclude: codes, or the letters that a family begins with. Default: none.
    #[serde(default)]
    pub require: Vec<Code>,
    /// Ask only these rules. Default: all.
    #[serde(default)]
    pub select: Vec<Code>,
    /// What is known and shall not count. It stays in the report, as ignored and why.
    #[serde(default)]
    #[schemars(with = "Vec<Ignore>")]
    pub ignore: Vec<Spanned<Ignore>>,
    /// What the columns of a table hold, where their names do not say it.
    #[serde(default)]
    pub columns: Columns,
    /// What is known of topics, by their names.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Stream>")]
    pub stream: BTreeMap<Spanned<String>, Stream>,
    /// Thresholds, limits and severities of rules, by their codes.
    #[serde(default)]
    pub rules: Rules,
}

/// One, or one for each prefix of joints' names.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a text, or a table of texts by prefix")]
pub(super) enum ByPrefix {
    /// The only one.
    One(String),
    /// One for each prefix.
    Each(BTreeMap<String, String>),
}

impl ByPrefix {
    /// Each with its prefix.
    pub fn all(&self) -> Vec<(Option<&str>, &str)> {
        match self {
            Self::One(one) => vec![(None, one)],
            Self::Each(each) => {
                each.iter().map(|(prefix, one)| (Some(prefix.as_str()), one.as_str())).collect()
            }
        }
    }
}

/// What the columns of a table hold. A column is named as `poseaudit info` lists it; `NAME[FIRST:END]` is a
/// part of one.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Columns {
    /// The column of the time.
    pub time: Option<String>,
    /// Rows a second, where no column holds times.
    pub rate_hz: Option<Rate>,
    /// Joint positions, in the order of the model's joints.
    #[serde(default)]
    pub joints: Selection,
    /// Commanded joint positions, likewise.
    #[serde(default)]
    pub joint_commands: Selection,
    /// For each joint the rad of one unit of its numbers, where these are no rad: rad = factor * number + offset.
    #[serde(default)]
    pub joint_factors: Vec<f64>,
    /// For each joint the rad where its number is 0. Default: 0.
    #[serde(default)]
    pub joint_offsets: Vec<f64>,
    /// The measured pose of the tool: position, then rotation. 3, 6, 7, 12 or 16 numbers.
    #[serde(default)]
    pub pose: Selection,
    /// The commanded pose of the tool.
    #[serde(default)]
    pub pose_commands: Selection,
    /// The same of each arm by its name, where there are several.
    #[serde(default)]
    pub arm: BTreeMap<String, ArmColumns>,
}

/// What the columns hold of one of several arms.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmColumns {
    /// Joint positions, in the order of the model's joints.
    #[serde(default)]
    pub joints: Selection,
    /// Commanded joint positions, likewise.
    #[serde(default)]
    pub joint_commands: Selection,
    /// For each joint the rad of one unit of its numbers, where these are no rad: rad = factor * number + offset.
    #[serde(default)]
    pub joint_factors: Vec<f64>,
    /// For each joint the rad where its number is 0. Default: 0.
    #[serde(default)]
    pub joint_offsets: Vec<f64>,
    /// The measured pose of the tool: position, then rotation. 3, 6, 7, 12 or 16 numbers.
    #[serde(default)]
    pub pose: Selection,
    /// The commanded pose of the tool.
    #[serde(default)]
    pub pose_commands: Selection,
}

impl Columns {
    /// The topics that columns are said to be a pose of, with the key that says it.
    pub fn poses(&self) -> Vec<(String, String)> {
        let own = (!self.pose.0.is_empty()).then(|| ("pose".to_owned(), "columns.pose".to_owned()));
        let arms = self.arm.iter().filter(|(_, arm)| !arm.pose.0.is_empty());
        let of_arm = |(name, _)| (format!("{name}/pose"), format!("columns.arm.{name}.pose"));
        own.into_iter().chain(arms.map(of_arm)).collect()
    }

    pub fn settings(&self) -> ColumnSettings {
        let of_arm = |(name, arm): (&String, &ArmColumns)| {
            let settings = ColumnSettings {
                joints: arm.joints.0.clone(),
                joint_commands: arm.joint_commands.0.clone(),
                joint_factors: arm.joint_factors.clone(),
                joint_offsets: arm.joint_offsets.clone(),
                pose: arm.pose.0.clone(),
                pose_commands: arm.pose_commands.0.clone(),
                ..ColumnSettings::default()
            };
            (name.clone(), settings)
        };
        ColumnSettings {
            time: self.time.clone(),
            rate_hz: self.rate_hz.map(|rate| rate.0),
            joints: self.joints.0.clone(),
            joint_commands: self.joint_commands.0.clone(),
            joint_factors: self.joint_factors.clone(),
            joint_offsets: self.joint_offsets.clone(),
            pose: self.pose.0.clone(),
            pose_commands: self.pose_commands.0.clone(),
            arms: self.arm.iter().map(of_arm).collect(),
        }
    }
}

/// One selector of columns, or several.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(try_from = "OneOrMore")]
#[schemars(with = "OneOrMore")]
pub(super) struct Selection(pub Vec<ColumnSelector>);

/// One text, or several.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected the name of a column, or a list of such")]
pub(super) enum OneOrMore {
    /// One.
    One(String),
    /// Several.
    More(Vec<String>),
}

impl TryFrom<OneOrMore> for Selection {
    type Error = String;

    fn try_from(said: OneOrMore) -> Result<Self, String> {
        let texts = match said {
            OneOrMore::One(text) => vec![text],
            OneOrMore::More(texts) => texts,
        };
        texts.iter().map(|text| text.parse()).collect::<Result<_, _>>().map(Self)
    }
}

/// What is known of a topic.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, try_from = "StreamTable")]
#[schemars(with = "StreamTable")]
pub(super) struct Stream {
    pub said: StreamTable,
    /// How its numbers are coded.
    pub coding: Option<(Coding, Units)>,
}

/// What is known of a topic.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Stream")]
pub(super) struct StreamTable {
    /// The part that it plays. Default: as its name, its type, its frames and its motion say.
    pub role: Option<SaidRole>,
    /// How its rotations are coded: `rotvec`, `euler:SEQ`, `euler:SEQ@axes`, `quat:xyzw` or
    /// `quat:wxyz`. What the log says against it is a finding (ORD001, ORD002).
    pub convention: Option<CodingName>,
    /// The units of its numbers: one of `m` and `mm`, one of `rad` and `deg`. Default: those of the
    /// vendor, else `m` and `rad`. What the log says against them is a finding (ORD004, ORD008).
    #[serde(default)]
    pub units: UnitNames,
    /// Whose numbers they are, as in `kuka`: sets convention and units as its controller gives them.
    pub vendor: Option<Vendor>,
    /// Whose word its poses are. Default: as names and frames say.
    pub witness: Option<Witness>,
    /// How often it should come, Hz: it is expected, and slow below 0.9 of that (TIM006).
    pub rate_hz: Option<Rate>,
    /// The frame that its poses are in, instead of that in its messages; of an IMU its own frame.
    pub frame: Option<String>,
    /// The link whose poses they are, instead of the child frame in its messages; an offset from it is
    /// then a fault (FRM003).
    pub link: Option<String>,
}

impl TryFrom<StreamTable> for Stream {
    type Error = String;

    fn try_from(said: StreamTable) -> Result<Self, String> {
        let UnitNames(units) = said.units;
        let vendor = said.vendor.as_ref().map(|vendor| vendor.0);
        let by_vendor = vendor.map(|vendor| vendor.coding).filter(|coding| !coding.is_matrix());
        let coding = said.convention.as_ref().map(|name| name.0).or(by_vendor);
        if coding.is_none() && units != Units::default() {
            return Err("`units` need a `convention` or a `vendor`".to_owned());
        }
        let units = units.or(vendor.map_or_else(Units::default, |vendor| vendor.units));
        Ok(Self { coding: coding.map(|coding| (coding, units)), said })
    }
}

/// Something that is known and shall not count.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Ignore {
    /// The rule's code, or the letters that a family begins with.
    pub code: Code,
    /// Why it shall not count; the report says so.
    pub reason: Reason,
    /// Only on this topic.
    pub topic: Option<String>,
    /// Only on this joint.
    pub joint: Option<String>,
    /// Only on this frame.
    pub frame: Option<String>,
    /// Only on this robot.
    pub robot: Option<String>,
}

/// A reason in words.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String", extend("minLength" = 1))]
pub(super) struct Reason(pub String);

impl TryFrom<String> for Reason {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        let text = text.trim();
        match text.is_empty() {
            true => Err("the `reason` is empty: say why this shall not count"),
            false => Ok(Self(text.to_owned())),
        }
    }
}

/// A rule's code, or the letters that a family begins with.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String", extend("pattern" = "^[A-Za-z]{1,4}[0-9]{0,3}$"))]
pub(super) struct Code(pub Selector);

impl TryFrom<String> for Code {
    type Error = crate::checks::UnknownRule;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse().map(Self)
    }
}

/// The clock that places a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum ClockName {
    /// The stamp in the message's header.
    Header,
    /// When the recorder received the message.
    Log,
    /// When the sender published it.
    #[value(help = "When the sender published the message")]
    Publish,
}

impl From<ClockName> for Clock {
    fn from(name: ClockName) -> Self {
        match name {
            ClockName::Header => Clock::Header,
            ClockName::Log => Clock::Log,
            ClockName::Publish => Clock::Publish,
        }
    }
}

/// The severity from which on a finding fails the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum FailOn {
    /// Errors.
    Error,
    /// Warnings and errors.
    Warning,
    /// Warnings, errors, and a verdict that is inconclusive.
    Inconclusive,
    /// Nothing.
    Never,
}

impl From<FailOn> for Option<Severity> {
    fn from(fail_on: FailOn) -> Self {
        match fail_on {
            FailOn::Error => Some(Severity::Error),
            FailOn::Warning | FailOn::Inconclusive => Some(Severity::Warning),
            FailOn::Never => None,
        }
    }
}

/// A time with its unit, or in seconds; s.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "Quantity")]
#[schemars(with = "NumberOrText")]
pub(super) struct Duration(pub f64);

impl TryFrom<Quantity> for Duration {
    type Error = String;

    fn try_from(quantity: Quantity) -> Result<Self, String> {
        let quantity = match quantity {
            Quantity::Number(seconds) => Quantity::Text(format!("{seconds} s")),
            text => text,
        };
        quantity.amount(Unit::Second).map(Self)
    }
}

/// An amount with its unit, as in `2 ms`, or a number.
#[derive(JsonSchema)]
#[schemars(untagged, inline)]
#[expect(dead_code, reason = "it only describes")]
pub(super) enum NumberOrText {
    /// A number.
    Number(f64),
    /// A number with its unit.
    Text(String),
}

/// A rate, Hz.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "f64")]
#[schemars(with = "f64", extend("exclusiveMinimum" = 0))]
pub(super) struct Rate(pub f64);

impl TryFrom<f64> for Rate {
    type Error = String;

    fn try_from(rate_hz: f64) -> Result<Self, String> {
        match rate_hz > 0.0 && rate_hz <= 1e6 {
            true => Ok(Self(rate_hz)),
            false => Err(format!("{rate_hz} Hz is out of range: it must be above 0")),
        }
    }
}

/// The name of a coding.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String")]
pub(super) struct CodingName(pub Coding);

impl TryFrom<String> for CodingName {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Coding::declared(&name).map(Self).map_err(|error| error.to_string())
    }
}

/// The name of somebody whose numbers are known.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String")]
pub(super) struct Vendor(pub &'static vendors::Use);

impl TryFrom<String> for Vendor {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let known: Vec<&str> = vendors::names().collect();
        let near = nearest(&name.trim().to_lowercase(), known.iter().copied());
        vendors::find(&name).map(Self).ok_or_else(|| match near.first() {
            Some(near) => format!("no maker `{name}` is known: did you mean `{near}`?"),
            None => format!("no maker `{name}` is known: there are {}", known.join(", ")),
        })
    }
}

/// A unit of a topic's numbers.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(super) enum UnitName {
    /// Metres.
    M,
    /// Millimetres.
    Mm,
    /// Radians.
    Rad,
    /// Degrees.
    Deg,
}

impl UnitName {
    fn symbol(self) -> &'static str {
        match self {
            Self::M => "m",
            Self::Mm => "mm",
            Self::Rad => "rad",
            Self::Deg => "deg",
        }
    }
}

/// The units of a topic's numbers.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema)]
#[serde(try_from = "Vec<UnitName>")]
#[schemars(with = "Vec<UnitName>", rename = "Units")]
pub(super) struct UnitNames(pub Units);

impl TryFrom<Vec<UnitName>> for UnitNames {
    type Error = &'static str;

    fn try_from(names: Vec<UnitName>) -> Result<Self, Self::Error> {
        let mut units = Units::default();
        match names.iter().try_for_each(|name| units.take(name.symbol())) {
            Ok(()) => Ok(Self(units)),
            Err(_) => Err("the units contradict each other: one of m and mm, one of rad and deg"),
        }
    }
}
