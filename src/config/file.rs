//! Layout of the config file. Editors show the doc comments of the keys.

use std::collections::BTreeMap;

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;

use super::quantity::Quantity;
use super::rules::Rules;
use crate::checks::Selector;
use crate::finding::{Severity, Unit};
use crate::geometry::{RotationEncoding, Units, vendors};
use crate::log::{ColumnSelector, ColumnSettings, FileLayout, RowLayout};
use crate::robot::nearest;
use crate::run::{PoseSourceKind, RoleSetting};
use crate::time::Clock;

/// Settings of an audit. Command-line options override them; paths are relative to this file.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "poseaudit.toml")]
pub(super) struct ConfigFile {
    /// The robot: a URDF or DH table, or a catalogue name; for several arms, a table by the prefix of their
    /// joint names. Default: the description in the log, else the best-matching catalogue arm.
    #[schemars(with = "Option<ByPrefix>")]
    pub robot: Option<Spanned<ByPrefix>>,
    /// A calibration: the JSON written by `calibrate`, or for a UR the YAML extracted by `ur_calibration`;
    /// for several arms, a table by prefix. Default: the calibration in the log.
    pub calibration: Option<ByPrefix>,
    /// Maps log joint names to model joint names. Default: joints are matched by name, or by order if the
    /// names differ.
    #[serde(default)]
    pub joint_map: BTreeMap<String, String>,
    /// First link of the chain. Default: the controller's base, else the root.
    pub base: Option<String>,
    /// End link; the pose streams are assumed to be this link's pose. If it is named here, an offset from
    /// it is a fault (FRM003) and not the active TCP.
    pub tip: Option<String>,
    /// Pose topic that the others are compared with, if the log has no joint states.
    pub reference: Option<String>,
    /// Clock that gives the time of a sample. Default: `header`.
    pub stamp: Option<ClockName>,
    /// Largest latency to search; larger offsets are reported as clock errors. With a unit, or in seconds.
    /// Default: `5 s`.
    pub max_latency: Option<Duration>,
    /// Lowest severity that fails the run. Default: `warning`.
    pub fail_on: Option<FailOn>,
    /// Rules whose outcome must not be inconclusive: codes, or the leading letters of a family. Default:
    /// none.
    #[serde(default)]
    pub require: Vec<Code>,
    /// Rules to evaluate. Default: all.
    #[serde(default)]
    pub select: Vec<Code>,
    /// Known findings that do not count. The report lists them as ignored, with the reason.
    #[serde(default)]
    #[schemars(with = "Vec<Ignore>")]
    pub ignore: Vec<Spanned<Ignore>>,
    /// Contents of a table's columns, if their names do not identify them.
    #[serde(default)]
    pub columns: Columns,
    /// Settings of topics, by name.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Stream>")]
    pub stream: BTreeMap<Spanned<String>, Stream>,
    /// Thresholds, limits and severities of rules, by code.
    #[serde(default)]
    pub rules: Rules,
}

/// One value, or one for each prefix of joint names.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a text, or a table of texts by prefix")]
pub(super) enum ByPrefix {
    /// A single value.
    One(String),
    /// One value per prefix.
    Each(BTreeMap<String, String>),
}

impl ByPrefix {
    /// All values with their prefixes.
    pub fn all(&self) -> Vec<(Option<&str>, &str)> {
        match self {
            Self::One(one) => vec![(None, one)],
            Self::Each(each) => {
                each.iter().map(|(prefix, one)| (Some(prefix.as_str()), one.as_str())).collect()
            }
        }
    }
}

/// Contents of a table's columns. Columns are named as listed by `poseaudit info`; `NAME[FIRST:END]`
/// selects a part of one.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Columns {
    /// Meaning of every column in order, as for `--columns`: `t,q[6],qd[6],_[6],x,y,z,rotvec`; for several
    /// files, a table by their names. Replaces the other keys for its files.
    pub layout: Option<ByFile>,
    /// Time column.
    pub time: Option<String>,
    /// Rows per second, if there is no time column.
    pub rate_hz: Option<Rate>,
    /// Joint positions, in the order of the model's joints.
    #[serde(default)]
    pub joints: Selection,
    /// Commanded joint positions, in the same order.
    #[serde(default)]
    pub joint_commands: Selection,
    /// For each joint, rad per unit of its numbers, if they are not in rad: rad = factor * number + offset.
    #[serde(default)]
    pub joint_factors: Vec<f64>,
    /// For each joint, the angle in rad at number 0. Default: 0.
    #[serde(default)]
    pub joint_offsets: Vec<f64>,
    /// The measured pose of the tool: position, then rotation. 3, 6, 7, 12 or 16 numbers.
    #[serde(default)]
    pub pose: Selection,
    /// The commanded pose of the tool.
    #[serde(default)]
    pub pose_commands: Selection,
    /// The same keys for each arm, by name, if there are several.
    #[serde(default)]
    pub arm: BTreeMap<String, ArmColumns>,
}

/// Contents of the columns of one of several arms.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmColumns {
    /// Joint positions, in the order of the model's joints.
    #[serde(default)]
    pub joints: Selection,
    /// Commanded joint positions, in the same order.
    #[serde(default)]
    pub joint_commands: Selection,
    /// For each joint, rad per unit of its numbers, if they are not in rad: rad = factor * number + offset.
    #[serde(default)]
    pub joint_factors: Vec<f64>,
    /// For each joint, the angle in rad at number 0. Default: 0.
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
    /// Topics of the columns declared as poses, with the key that declares each.
    pub fn poses(&self) -> Vec<(String, String)> {
        let own = (!self.pose.0.is_empty()).then(|| ("pose".to_owned(), "columns.pose".to_owned()));
        let arms = self.arm.iter().filter(|(_, arm)| !arm.pose.0.is_empty());
        let of_arm = |(name, _)| (format!("{name}/pose"), format!("columns.arm.{name}.pose"));
        own.into_iter().chain(arms.map(of_arm)).collect()
    }

    /// Layouts, by file if there are several.
    pub fn layouts(&self) -> Vec<FileLayout> {
        match &self.layout {
            None => Vec::new(),
            Some(ByFile::One(Layout(layout))) => {
                vec![FileLayout { file: None, layout: layout.clone() }]
            }
            Some(ByFile::Each(each)) => {
                let own = |(file, Layout(layout)): (&String, &Layout)| FileLayout {
                    file: Some(file.clone()),
                    layout: layout.clone(),
                };
                each.iter().map(own).collect()
            }
        }
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
            layouts: self.layouts(),
            ..ColumnSettings::default()
        }
    }
}

/// Meaning of the columns of one table, or of several by file.
#[derive(Clone, Debug, JsonSchema)]
#[schemars(untagged)]
pub(super) enum ByFile {
    /// All tables.
    One(Layout),
    /// By file name.
    Each(BTreeMap<String, Layout>),
}

impl<'de> Deserialize<'de> for ByFile {
    /// Keeps the error of a layout, which an untagged enum replaces.
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let layout = |text: String| Layout::try_from(text).map_err(serde::de::Error::custom);
        match ByPrefix::deserialize(from)? {
            ByPrefix::One(text) => layout(text).map(Self::One),
            ByPrefix::Each(each) => {
                let own = |(file, text)| Ok((file, layout(text)?));
                each.into_iter().map(own).collect::<Result<_, _>>().map(Self::Each)
            }
        }
    }
}

/// Meaning of every column of a table, in order.
#[derive(Clone, Debug, JsonSchema)]
#[schemars(with = "String")]
pub(super) struct Layout(pub RowLayout);

impl TryFrom<String> for Layout {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse().map(Self).map_err(|error: crate::log::LayoutError| error.to_string())
    }
}

/// One or several column selectors.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(try_from = "OneOrMore")]
#[schemars(with = "OneOrMore")]
pub(super) struct Selection(pub Vec<ColumnSelector>);

/// One or several texts.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected the name of a column, or a list of names")]
pub(super) enum OneOrMore {
    /// One.
    One(String),
    /// Several.
    More(Vec<String>),
}

impl TryFrom<OneOrMore> for Selection {
    type Error = String;

    fn try_from(value: OneOrMore) -> Result<Self, String> {
        let texts = match value {
            OneOrMore::One(text) => vec![text],
            OneOrMore::More(texts) => texts,
        };
        texts.iter().map(|text| text.parse()).collect::<Result<_, _>>().map(Self)
    }
}

/// Settings of a topic.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, try_from = "StreamTable")]
#[schemars(with = "StreamTable")]
pub(super) struct Stream {
    pub table: StreamTable,
    /// Encoding of its numbers.
    pub coding: Option<(RotationEncoding, Units)>,
}

/// Settings of a topic.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Stream")]
pub(super) struct StreamTable {
    /// Its role. Default: from its name, type, frames and motion.
    pub role: Option<RoleSetting>,
    /// Encoding of its rotations: `rotvec`, `euler:SEQ`, `euler:SEQ@axes`, `quat:xyzw` or `quat:wxyz`. If
    /// the log contradicts it, that is a finding (ORD001, ORD002).
    pub convention: Option<CodingName>,
    /// Units of its numbers: one of `m` and `mm`, one of `rad` and `deg`. Default: those of the vendor,
    /// else `m` and `rad`. If the log contradicts them, that is a finding (ORD004, ORD008).
    #[serde(default)]
    pub units: UnitNames,
    /// Vendor of the controller, as in `kuka`: sets its convention and units.
    pub vendor: Option<Vendor>,
    /// Source of its poses. Default: from names and frames.
    pub witness: Option<PoseSourceKind>,
    /// Expected rate, Hz: the topic is expected, and slow below 0.9 of the rate (TIM006).
    pub rate_hz: Option<Rate>,
    /// Reference frame of its poses, instead of the one in its messages; for an IMU its own frame.
    pub frame: Option<String>,
    /// Link of its poses, instead of the child frame in its messages; an offset from it is then a fault
    /// (FRM003).
    pub link: Option<String>,
}

impl TryFrom<StreamTable> for Stream {
    type Error = String;

    fn try_from(table: StreamTable) -> Result<Self, String> {
        let UnitNames(units) = table.units;
        let vendor = table.vendor.as_ref().map(|vendor| vendor.0);
        let by_vendor = vendor.map(|vendor| vendor.coding).filter(|coding| !coding.is_matrix());
        let coding = table.convention.as_ref().map(|name| name.0).or(by_vendor);
        if coding.is_none() && units != Units::default() {
            return Err("`units` requires a `convention` or a `vendor`".to_owned());
        }
        let units = units.or(vendor.map_or_else(Units::default, |vendor| vendor.units));
        Ok(Self { coding: coding.map(|coding| (coding, units)), table })
    }
}

/// A known finding that does not count.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Ignore {
    /// The rule's code, or the leading letters of a family.
    pub code: Code,
    /// Reason, shown in the report.
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

/// A non-empty reason.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String", extend("minLength" = 1))]
pub(super) struct Reason(pub String);

impl TryFrom<String> for Reason {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        let text = text.trim();
        match text.is_empty() {
            true => Err("the `reason` is empty: say why this does not count"),
            false => Ok(Self(text.to_owned())),
        }
    }
}

/// A rule's code, or the leading letters of a family.
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

/// Clock that gives the time of a sample.
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

/// Lowest severity that fails the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum FailOn {
    /// Errors.
    Error,
    /// Warnings and errors.
    Warning,
    /// Warnings, errors, and an inconclusive verdict.
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

/// A value with its unit, as in `2 ms`, or a number.
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

/// Name of an encoding.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String")]
pub(super) struct CodingName(pub RotationEncoding);

impl TryFrom<String> for CodingName {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        RotationEncoding::from_declared_name(&name).map(Self).map_err(|error| error.to_string())
    }
}

/// Name of a vendor with a known encoding.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
#[schemars(with = "String")]
pub(super) struct Vendor(pub &'static vendors::VendorUse);

impl TryFrom<String> for Vendor {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let known: Vec<&str> = vendors::names().collect();
        let near = nearest(&name.trim().to_lowercase(), known.iter().copied());
        vendors::find(&name).map(Self).ok_or_else(|| match near.first() {
            Some(near) => format!("unknown vendor `{name}`: did you mean `{near}`?"),
            None => format!("unknown vendor `{name}`: known are {}", known.join(", ")),
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
        match names.iter().try_for_each(|name| units.set_symbol(name.symbol())) {
            Ok(()) => Ok(Self(units)),
            Err(_) => Err("the units contradict each other: one of m and mm, one of rad and deg"),
        }
    }
}
