//! Corrections file, in TOML.

use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::diagnosis::PoseEncoding;
use crate::geometry::{
    AngleUnit, Axes, Convention, LengthScale, Misread, Pose, RotationError,
    misinterpretation_classes, pose, rotation_from_xyzw, xyz_of, xyzw_from_rotation,
};
use crate::report::Trouble;

/// Corrections of a log's joints and topics. Names are as in the log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Corrections {
    schema: Schema,
    /// With a zero offset or a scale error.
    #[serde(default, rename = "joint", skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointCorrection>,
    /// Topics.
    #[serde(default, rename = "topic", skip_serializing_if = "Vec::is_empty")]
    pub topics: Vec<TopicCorrection>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Schema {
    #[default]
    #[serde(rename = "poseaudit.corrections/1")]
    One,
}

/// Rounds to 1e-9, without −0.
pub(super) fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9 + 0.0
}

/// Zero, scale and coupling of a joint: `q_true = factor · q_reported + offset + coupling.factor · q_driver`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointCorrection {
    /// Joint.
    pub name: String,
    /// If several robots have a joint of this name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// For positions and velocities.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "finite")]
    pub factor: Option<f64>,
    /// 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor_ci95: Option<[f64; 2]>,
    /// Revolute joint, rad; at most one turn.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "angle")]
    pub offset_rad: Option<f64>,
    /// Prismatic joint, m; at most 10.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "length")]
    pub offset_m: Option<f64>,
    /// 95 % interval, in the offset's unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// Other joint that moves it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coupling: Option<CouplingCorrection>,
}

/// Joint to which another one is coupled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CouplingCorrection {
    /// Driving joint.
    pub joint: String,
    /// For its scaled positions and velocities, without its offset.
    #[serde(deserialize_with = "finite_number")]
    pub factor: f64,
    /// 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

impl JointCorrection {
    /// Offset in rad, or in m if it slides.
    pub(super) fn set_offset(&mut self, offset: f64, is_prismatic: bool) {
        (self.offset_rad, self.offset_m) =
            if is_prismatic { (None, Some(offset)) } else { (Some(offset), None) };
    }
}

/// Corrections of a topic, applied in the order units, rotations, frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicCorrection {
    /// Topic.
    pub name: String,
    /// s; at most one hour. A sample stamped *t* was taken at *t − latency*.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "latency")]
    pub latency_s: Option<f64>,
    /// 95 % interval, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_ci95: Option<[f64; 2]>,
    /// Growth of the latency per second of stamp, s/s; at most 0.1.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "skew")]
    pub skew: Option<f64>,
    /// 95 % interval, s/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skew_ci95: Option<[f64; 2]>,
    /// When the latency is `latency_s`, s after the topic's first stamp.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "finite")]
    pub skew_about_s: Option<f64>,
    /// Convention of bare rotation numbers, needed to apply frames to them.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "convention_name")]
    pub convention: Option<Convention>,
    /// `link_from_imu`, x, y, z, w.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "quaternion")]
    pub link_from_imu_xyzw: Option<[f64; 4]>,
    /// Actual length unit, and the assumed one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_unit: Option<Misread<LengthScale>>,
    /// Same for angles, or positions of revolute joints.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_unit: Option<Misread<AngleUnit>>,
    /// Positions under other joints' names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint_order: Option<JointOrder>,
    /// Actual rotation encoding, and the assumed one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<RotationError>,
    /// Whole poses are inverted after decoding.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inverse: Option<bool>,
    /// Axes of the numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes: Option<AxesCorrection>,
    /// `reference_from_stream`, multiplied from the left.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_from_stream: Option<FrameCorrection>,
    /// `tip_from_stream`, whose inverse is multiplied from the right.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_from_stream: Option<FrameCorrection>,
    /// Camera in the hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hand_from_camera: Option<FrameCorrection>,
    /// Camera in the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_from_camera: Option<FrameCorrection>,
}

/// Permuted joint positions: the position named `read_as[i]` belongs to `is[i]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointOrder {
    /// In the order of the numbers.
    pub is: Vec<String>,
    /// In the order of the names.
    pub read_as: Vec<String>,
}

/// Axes of positions and rotations, for example `x right, y up, z forward (left-handed)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxesCorrection {
    /// Axes of positions.
    #[serde(with = "axes_name")]
    pub positions: Axes,
    /// Axes of rotations.
    #[serde(with = "axes_name")]
    pub rotations: Axes,
}

/// A constant frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameCorrection {
    /// Unit: m.
    xyz: [f64; 3],
    /// x, y, z, w.
    #[serde(deserialize_with = "unit_quaternion")]
    quaternion_xyzw: [f64; 4],
}

impl From<&Pose> for FrameCorrection {
    fn from(pose: &Pose) -> Self {
        let quaternion_xyzw = xyzw_from_rotation(&pose.rotation).map(rounded);
        Self { xyz: xyz_of(pose).map(rounded), quaternion_xyzw }
    }
}

impl FrameCorrection {
    /// The frame as a pose.
    pub fn pose(&self) -> Pose {
        pose(self.xyz, rotation_from_xyzw(self.quaternion_xyzw).unwrap_or_default())
    }
}

pub(super) fn encoding_of_error(slip: RotationError) -> Option<PoseEncoding> {
    Some(match slip {
        RotationError::Transposed => PoseEncoding::Transposed,
        RotationError::Inverted => PoseEncoding::Inverted,
        RotationError::Quaternion(slip) => PoseEncoding::QuaternionOrder(slip),
        RotationError::Misread(misreading) => {
            let classes = misinterpretation_classes().iter();
            let mut classes = classes.filter(|class| class.members.contains(&misreading));
            PoseEncoding::Misinterpreted(classes.next()?)
        }
    })
}

mod axes_name {
    use super::{Axes, Deserialize, Deserializer};
    use serde::Serializer;
    use serde::de::Error as _;

    pub fn serialize<S: Serializer>(axes: &Axes, out: S) -> Result<S::Ok, S::Error> {
        out.collect_str(axes)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Axes, D::Error> {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

mod convention_name {
    use super::{Convention, Deserialize, Deserializer};
    use serde::Serializer;
    use serde::de::Error as _;

    pub fn serialize<S: Serializer>(of: &Option<Convention>, out: S) -> Result<S::Ok, S::Error> {
        match of {
            Some(convention) => out.collect_str(convention),
            None => out.serialize_none(),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Convention>, D::Error> {
        let name = String::deserialize(from)?;
        name.parse().map(Some).map_err(D::Error::custom)
    }
}

fn finite_number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(from)?;
    match value.is_finite() {
        true => Ok(value),
        false => Err(D::Error::custom(format!("{value} is not a finite number"))),
    }
}

fn finite<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    finite_number(from).map(Some)
}

/// Absolute value at most `most`.
fn deserialize_within<'de, D: Deserializer<'de>>(
    from: D,
    most: f64,
    unit: &str,
) -> Result<Option<f64>, D::Error> {
    let value = finite(from)?;
    match value {
        Some(amount) if amount.abs() > most => Err(D::Error::custom(format!(
            "{amount} {unit} is out of range: the maximum is {most} {unit}"
        ))),
        value => Ok(value),
    }
}

fn angle<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    deserialize_within(from, TAU, "rad")
}

fn length<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    deserialize_within(from, 10.0, "m")
}

fn latency<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    deserialize_within(from, 3600.0, "s")
}

fn skew<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    deserialize_within(from, 0.1, "s/s")
}

fn quaternion<'de, D: Deserializer<'de>>(from: D) -> Result<Option<[f64; 4]>, D::Error> {
    unit_quaternion(from).map(Some)
}

fn unit_quaternion<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 4], D::Error> {
    let q_xyzw = <[f64; 4]>::deserialize(from)?;
    match rotation_from_xyzw(q_xyzw) {
        Some(_) => Ok(q_xyzw),
        None => Err(D::Error::custom("a quaternion of length zero is not a rotation")),
    }
}

const HEADER: &str = "\
# Corrections, to be applied with `poseaudit audit LOG --corrections FILE`.
# Joint: q_true = factor * q_reported + offset; coupling.factor times the position of coupling.joint is added.
# Latency: a sample stamped t was taken at t - latency.
# Frames: `a_from_b` maps coordinates in b to coordinates in a; lengths in m, angles in rad.

";

impl Corrections {
    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.joints.is_empty() && self.topics.is_empty()
    }

    /// Reads the file at `path`.
    ///
    /// # Errors
    /// With the line, if it cannot be read or has a different layout.
    pub fn from_file(path: &Path) -> Result<Self, Trouble> {
        let place = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| {
            let remedy = "pass the corrections.toml written by `audit --fix DIR`";
            Trouble::call(&place, format_args!("cannot be read: {error}"), remedy)
        })?;
        Self::from_text(&text, &place)
    }

    /// Parses a text; `source` names it in errors.
    ///
    /// # Errors
    /// With the line, if it has a different layout.
    pub fn from_text(text: &str, source: &str) -> Result<Self, Trouble> {
        let remedy = "compare it with a file written by `audit --fix DIR`";
        let refuse = |place: String, what: String| Trouble::call(place, what, remedy);
        let corrections: Self = toml::from_str(text).map_err(|error| {
            let before = &text.as_bytes()[..error.span().map_or(0, |span| span.start)];
            let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
            let what = error.message().lines().collect::<Vec<_>>().join(", ");
            refuse(format!("{source}:{line}"), format!("invalid corrections: {what}"))
        })?;
        match corrections.inconsistency() {
            Some(what) => Err(refuse(source.to_owned(), what)),
            None => Ok(corrections),
        }
    }

    /// Contradiction that the file layout permits.
    fn inconsistency(&self) -> Option<String> {
        for (index, joint) in self.joints.iter().enumerate() {
            let name = &joint.name;
            let offsets = [joint.offset_rad, joint.offset_m].iter().flatten().count();
            if offsets > 1 {
                return Some(format!("joint '{name}' has both offset_rad and offset_m"));
            }
            if offsets == 0 && joint.factor.is_none() && joint.coupling.is_none() {
                return Some(format!(
                    "joint '{name}' has no correction: it needs offset_rad, offset_m, factor or coupling"
                ));
            }
            if joint.coupling.as_ref().is_some_and(|coupling| coupling.joint == *name) {
                return Some(format!("joint '{name}' is coupled to itself: use factor instead"));
            }
            if joint.factor == Some(0.0) {
                return Some(format!("joint '{name}': factor must not be 0"));
            }
            let same = |other: &JointCorrection| other.name == *name && other.robot == joint.robot;
            if self.joints[..index].iter().any(same) {
                return Some(format!("joint '{name}' is listed twice"));
            }
        }
        for (index, topic) in self.topics.iter().enumerate() {
            let name = &topic.name;
            let same = |other: &TopicCorrection| is_same_topic(&other.name, name);
            if self.topics[..index].iter().any(same) {
                return Some(format!("topic '{name}' is listed twice"));
            }
            if topic.skew.is_some() && topic.skew_about_s.is_none() {
                return Some(format!("topic '{name}' has a skew but no skew_about_s"));
            }
            let frames = [
                &topic.reference_from_stream, &topic.tip_from_stream, &topic.hand_from_camera,
                &topic.base_from_camera,
            ];
            let numbers = frames.into_iter().flatten().flat_map(|frame| frame.xyz);
            if let Some(number) = numbers.into_iter().find(|number| !number.is_finite()) {
                return Some(format!("topic '{name}': {number} is not a valid length"));
            }
            if let Some(JointOrder { is, read_as }) = &topic.joint_order {
                let sorted = |names: &[String]| {
                    let mut names = names.to_vec();
                    names.sort_unstable();
                    names
                };
                let (is, read_as) = (sorted(is), sorted(read_as));
                if is != read_as || is.windows(2).any(|pair| pair[0] == pair[1]) {
                    return Some(format!(
                        "joint_order of '{name}': `is` and `read_as` must list the same \
                        joints once"
                    ));
                }
            }
        }
        None
    }

    /// Text of the file.
    pub fn to_text(&self) -> String {
        let body = toml::to_string(self).expect("names and numbers are TOML");
        format!("{HEADER}{body}")
    }

    /// Created if missing.
    pub(super) fn joint(&mut self, name: &str, robot: Option<String>) -> &mut JointCorrection {
        let at = self.joints.iter().position(|joint| joint.name == name && joint.robot == robot);
        let at = at.unwrap_or_else(|| {
            let name = name.to_owned();
            self.joints.push(JointCorrection { name, robot, ..Default::default() });
            self.joints.len() - 1
        });
        &mut self.joints[at]
    }

    /// Created if missing.
    pub(super) fn topic(&mut self, name: &str) -> &mut TopicCorrection {
        let at = self.topics.iter().position(|topic| topic.name == name);
        let at = at.unwrap_or_else(|| {
            self.topics.push(TopicCorrection { name: name.to_owned(), ..Default::default() });
            self.topics.len() - 1
        });
        &mut self.topics[at]
    }
}

pub(super) fn is_same_topic(topic: &str, name: &str) -> bool {
    topic.trim_start_matches('/') == name.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Misinterpretation;

    #[test]
    fn corrections_round_trip() {
        let mut corrections = Corrections::default();
        corrections.joints.push(JointCorrection {
            name: "elbow".to_owned(),
            robot: Some("left arm".to_owned()),
            offset_rad: Some(-0.010_471_975_5),
            offset_m: None,
            ci95: Some([-0.0105, -0.0104]),
            factor: Some(-1.0),
            factor_ci95: Some([-1.001, -0.999]),
            coupling: Some(CouplingCorrection {
                joint: "shoulder".to_owned(),
                factor: 1.0,
                ci95: Some([0.999, 1.001]),
            }),
        });
        let topic = corrections.topic("/tcp \"odd\"");
        (topic.latency_s, topic.skew) = (Some(0.022), Some(2e-4));
        topic.skew_about_s = Some(10.25);
        topic.convention = Some(Convention::RPY);
        topic.length_unit =
            Some(Misread { is: LengthScale::MILLIMETRE, read_as: LengthScale::METRE });
        topic.rotation = Some(RotationError::Misread(Misinterpretation {
            is: Convention::RotVec,
            read_as: Convention::RPY,
        }));
        let turned = pose([0.1, 0.0, -0.2], crate::geometry::rotation_from_rpy([0.1, 0.2, 0.3]));
        topic.reference_from_stream = Some(FrameCorrection::from(&turned));
        let names = |order: [&str; 2]| order.map(str::to_owned).to_vec();
        corrections.topic("/joint_states").joint_order =
            Some(JointOrder { is: names(["b", "a"]), read_as: names(["a", "b"]) });
        let text = corrections.to_text();
        assert_eq!(Corrections::from_text(&text, "c.toml"), Ok(corrections), "{text}");
    }

    #[test]
    fn errors_name_the_invalid_entry() {
        let head = "schema = \"poseaudit.corrections/1\"\n";
        for (text, place, part) in [
            ("schema = \"poseaudit.corrections/9\"", "c.toml:1", "unknown variant"),
            ("[[joint]]\nname = \"a\"\nofset_rad = 1\n", "c.toml:4", "ofset_rad"),
            (
                "[[joint]]\nname = \"a\"\noffset_rad = nan\n",
                "c.toml:4",
                "NaN is not a finite number",
            ),
            ("[[joint]]\nname = \"a\"\noffset_rad = 30\n", "c.toml:4", "out of range"),
            (
                "[[joint]]\nname = \"a\"\ncoupling = {joint = \"b\", factor = inf}\n",
                "c.toml:4",
                "inf is not a finite number",
            ),
            ("[[topic]]\nname = \"/t\"\nlatency_s = 1e9\n", "c.toml:4", "the maximum is 3600 s"),
            ("[[topic]]\nname = \"/t\"\n[[topic]]\nname = \"t\"\n", "c.toml", "twice"),
            (
                "[[joint]]\nname = \"a\"\n",
                "c.toml",
                "needs offset_rad, offset_m, factor or coupling",
            ),
            (
                "[[joint]]\nname = \"a\"\noffset_rad = 0.1\noffset_m = 0.1\n",
                "c.toml",
                "both offset_rad and offset_m",
            ),
            (
                "[[joint]]\nname = \"a\"\ncoupling = {joint = \"a\", factor = 0.1}\n",
                "c.toml",
                "coupled to itself",
            ),
            (
                "[[topic]]\nname = \"/t\"\nrotation = {is = \"rotvec\", read_as = \"rpy\"}\n",
                "c.toml:4",
                "`rpy`",
            ),
            ("[[topic]]\nname = \"/t\"\nconvention = \"euler:xxy\"\n", "c.toml:4", "twice"),
            (
                "[[topic]]\nname = \"/t\"\nlink_from_imu_xyzw = [0.0, 0.0, 0.0, 0.0]\n",
                "c.toml:4",
                "not a rotation",
            ),
            ("[[topic]]\nname = \"/t\"\nskew = 1e-4\n", "c.toml", "skew_about_s"),
            ("[[topic]]\nname = \"/t\"\n[[topic]]\nname = \"/t\"\n", "c.toml", "twice"),
        ] {
            let text =
                if text.starts_with("schema") { text.to_owned() } else { format!("{head}{text}") };
            let trouble = Corrections::from_text(&text, "c.toml").expect_err("no corrections");
            assert_eq!(trouble.place, place, "{trouble}");
            assert!(trouble.what.contains(part), "{trouble}");
            assert!(!trouble.to_string().contains('\n'), "{trouble}");
        }
    }

    #[test]
    fn units_have_factors() {
        use AngleUnit::{Degree, Radian};
        let (m, mm) = (LengthScale::METRE, LengthScale::MILLIMETRE);
        assert_eq!(Misread { is: mm, read_as: m }.factor(), 1e-3);
        assert_eq!(Misread { is: m, read_as: mm }.factor(), 1e3);
        let half_turn = 180.0 * Misread { is: Degree, read_as: Radian }.factor();
        assert!((half_turn - std::f64::consts::PI).abs() < 1e-15);
    }
}
