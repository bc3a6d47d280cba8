//! The caller's declarations of robots and streams, as on the command line and in the config.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::geometry::{
    AngleUnit, ConventionError, LengthScale, RotationEncoding, UnitError, Units, vendors,
};
use crate::log::DeclaredPose;
use crate::robot::Robot;
use crate::stream::Columns;

use super::RunOptions;
use super::error::RunError;
use super::models::load_robot;
use super::topics::{RoleSetting, TopicSettings};

/// Source of a robot: `FILE`, a catalogue `NAME`, or either after `PREFIX=`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotSource {
    /// Prefix of its joint names in a log with several arms.
    pub prefix: Option<String>,
    /// URDF or TOML file, or catalogue arm.
    pub model: String,
    /// Its content, if given; the file is then not read.
    pub text: Option<String>,
}

impl RobotSource {
    /// Path of its file; `None` if from the catalogue.
    pub fn file(&self) -> Option<&Path> {
        Some(Path::new(&self.model)).filter(|path| self.text.is_none() && path.is_file())
    }

    /// Loads the robot.
    ///
    /// # Errors
    /// If its text or file is invalid, or the catalogue lacks the name.
    pub fn robot(&self) -> Result<Robot, RunError> {
        match &self.text {
            Some(text) => Ok(Robot::from_text(text, &self.model)?),
            None => load_robot(&self.model),
        }
    }
}

impl From<&str> for RobotSource {
    fn from(text: &str) -> Self {
        let (prefix, model) = after_prefix(text);
        Self { prefix, model: model.to_owned(), text: None }
    }
}

/// Calibration of an arm: `FILE`, or `PREFIX=FILE`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationSource {
    /// Prefix of the arm's joint names in a log with several arms.
    pub prefix: Option<String>,
    /// JSON file from `calibrate`, or YAML from `ur_calibration`.
    pub file: PathBuf,
}

impl From<&str> for CalibrationSource {
    fn from(text: &str) -> Self {
        let (prefix, file) = after_prefix(text);
        Self { prefix, file: file.into() }
    }
}

/// A joint named differently in log and model: `LOG=MODEL`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JointName {
    /// Name in the log.
    pub logged: String,
    /// Name in the model.
    pub modelled: String,
}

impl FromStr for JointName {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once('=') {
            Some((logged, modelled)) if !logged.is_empty() && !modelled.is_empty() => {
                Ok(Self { logged: logged.to_owned(), modelled: modelled.to_owned() })
            }
            _ => Err("expected LOG=MODEL, as in iiwa_joint_1=lbr_A1"),
        }
    }
}

fn after_prefix(text: &str) -> (Option<String>, &str) {
    match text.split_once('=') {
        Some((prefix, rest)) if !prefix.contains(['/', '.']) => (Some(prefix.to_owned()), rest),
        _ => (None, text),
    }
}

/// Declared topic: `TOPIC=CONVENTION[,deg][,mm]`, or `TOPIC=VENDOR`, as in `kuka`.
#[derive(Clone, Debug, PartialEq)]
pub struct Declaration {
    /// The topic.
    pub topic: String,
    /// Source of the declaration, for error messages.
    pub place: String,
    /// Encoding of rotations.
    pub coding: RotationEncoding,
    /// Unit of positions.
    pub length: LengthScale,
    /// Unit of angles.
    pub angle: AngleUnit,
    /// Whether only a vendor was named; then applies only to topics with its number of values.
    pub is_of_vendor: bool,
}

impl Declaration {
    /// Whether it applies to this topic.
    pub fn is_of(&self, topic: &str) -> bool {
        self.topic.trim_start_matches('/') == topic.trim_start_matches('/')
    }

    pub(super) fn fits(&self, columns: Option<&Columns>) -> bool {
        match columns {
            _ if !self.is_of_vendor => true,
            Some(Columns::Array(array)) => {
                array.width == if self.coding.has_angles() { 6 } else { 7 }
            }
            _ => false,
        }
    }
}

/// Why a text is not a [`Declaration`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeclarationError {
    /// It contains no `=`.
    #[error(
        "`{0}` declares nothing: write TOPIC=CONVENTION, as in /tcp=rotvec or /tcp=euler:ZYX,deg,mm"
    )]
    NoConvention(String),
    /// Unknown convention after the `=`.
    #[error("{0}; for a quaternion write `quat:xyzw` or `quat:wxyz`")]
    Convention(#[from] ConventionError),
    /// A vendor that logs matrices.
    #[error("`{0}` gives matrices, which need no declaration")]
    Matrix(String),
    /// Unknown word after the convention.
    #[error("unknown unit `{0}`: after the convention, use `deg` or `rad`, `mm` or `m`")]
    Unit(String),
    /// Two units that exclude each other.
    #[error("`{0}` contradicts another unit")]
    Contradiction(String),
}

impl FromStr for Declaration {
    type Err = DeclarationError;

    fn from_str(text: &str) -> Result<Self, DeclarationError> {
        let (topic, encoding_text) = text
            .split_once('=')
            .filter(|(topic, encoding_text)| !topic.is_empty() && !encoding_text.is_empty())
            .ok_or_else(|| DeclarationError::NoConvention(text.to_owned()))?;
        let mut words = encoding_text.split(',');
        let name = words.next().unwrap_or_default();
        let vendor = vendors::find(name);
        let coding = match vendor {
            Some(vendor) if vendor.coding.is_matrix() => {
                return Err(DeclarationError::Matrix(name.to_owned()));
            }
            Some(vendor) => vendor.coding,
            None => RotationEncoding::from_declared_name(name)?,
        };
        let mut units = Units::default();
        for word in words {
            units.set_symbol(word).map_err(|error| match error {
                UnitError::Unknown => DeclarationError::Unit(word.to_owned()),
                UnitError::Contradiction => DeclarationError::Contradiction(word.to_owned()),
            })?;
        }
        let units = units.or(vendor.map_or_else(Units::default, |vendor| vendor.units));
        Ok(Self {
            topic: topic.to_owned(),
            place: format!("--declare {topic}"),
            coding,
            length: units.length.unwrap_or_default(),
            angle: units.angle.unwrap_or_default(),
            is_of_vendor: vendor.is_some(),
        })
    }
}

impl RunOptions {
    /// With the poses of table layouts declared, unless they are declared otherwise.
    pub(super) fn with_declared(mut self, poses: Vec<DeclaredPose>) -> Self {
        let place = "--columns or [columns]";
        for pose in poses {
            let settings = TopicSettings {
                topic: pose.topic.clone(),
                place: place.to_owned(),
                role: (!pose.is_command).then_some(RoleSetting::Pose),
                of_columns: true,
                ..TopicSettings::default()
            };
            match self.topics.iter_mut().find(|known| known.is_of(&pose.topic)) {
                Some(known) => known.role = known.role.or(settings.role),
                None => self.topics.push(settings),
            }
            let is_declared = self.declared.iter().any(|known| known.is_of(&pose.topic));
            if let (Some(coding), false) = (pose.coding, is_declared) {
                self.declared.push(Declaration {
                    topic: pose.topic,
                    place: place.to_owned(),
                    coding,
                    length: pose.units.length.unwrap_or_default(),
                    angle: pose.units.angle.unwrap_or_default(),
                    is_of_vendor: false,
                });
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_declaration_names_topic_convention_and_units() {
        let declared: Declaration = "/tcp=euler:ZYX,deg,mm".parse().unwrap();
        assert_eq!(declared.topic, "/tcp");
        assert_eq!(declared.coding, RotationEncoding::Three("euler:ZYX".parse().unwrap()));
        let (mm, degrees) = (LengthScale::MILLIMETRE, AngleUnit::Degree);
        assert_eq!((declared.length, declared.angle), (mm, degrees));
        let kuka: Declaration = "/tcp=kuka".parse().unwrap();
        assert_eq!((kuka.coding, kuka.length, kuka.angle), (declared.coding, mm, degrees));
        let in_metres: Declaration = "/tcp=kuka,m".parse().unwrap();
        assert_eq!((in_metres.length, in_metres.angle), (LengthScale::METRE, degrees));
        let quaternion: Declaration = "/tcp=quat:wxyz".parse().unwrap();
        assert_eq!(quaternion.coding, RotationEncoding::Wxyz);
    }

    #[test]
    fn an_invalid_declaration_gives_the_syntax() {
        for (text, part) in [
            ("/tcp", "write TOPIC=CONVENTION"),
            ("=rotvec", "write TOPIC=CONVENTION"),
            ("/tcp=", "write TOPIC=CONVENTION"),
            ("/tcp=euler:xxz", "twice in a row"),
            ("/tcp=rotvec,grad", "unit `grad`"),
            ("/tcp=rotvec,deg,rad", "`rad` contradicts"),
            ("/tcp=franka", "gives matrices"),
        ] {
            let error = text.parse::<Declaration>().unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn a_robot_may_carry_a_prefix() {
        let source = RobotSource::from("left=arms/ur5e.urdf");
        assert_eq!(
            (source.prefix.as_deref(), source.model.as_str()),
            (Some("left"), "arms/ur5e.urdf")
        );
        assert_eq!(RobotSource::from("./a=b.urdf").prefix, None);
        assert_eq!(RobotSource::from("ur5e").model, "ur5e");
    }
}
