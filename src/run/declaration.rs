//! What the caller says of robots and streams, as the command line and the config spell it.

use std::path::PathBuf;
use std::str::FromStr;

use crate::geometry::{Convention, ConventionError};

/// Where a robot comes from: `FILE`, `NAME` of the catalogue, or `PREFIX=` and one of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotSource {
    /// What the names of this robot's joints start with in the log, where several arms are in it.
    pub prefix: Option<String>,
    /// Path of a URDF or TOML file, or the name of a catalogue arm.
    pub model: String,
}

impl From<&str> for RobotSource {
    fn from(text: &str) -> Self {
        let (prefix, model) = after_prefix(text);
        Self { prefix, model: model.to_owned() }
    }
}

/// The calibration of a UR: `FILE`, or `PREFIX=FILE`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationSource {
    /// What the names of that arm's joints start with in the log, where several arms are in it.
    pub prefix: Option<String>,
    /// Path of the YAML file that `ur_calibration` wrote.
    pub file: PathBuf,
}

impl From<&str> for CalibrationSource {
    fn from(text: &str) -> Self {
        let (prefix, file) = after_prefix(text);
        Self { prefix, file: file.into() }
    }
}

/// What stands before and after the `=`, where a prefix does.
fn after_prefix(text: &str) -> (Option<String>, &str) {
    match text.split_once('=') {
        Some((prefix, rest)) if !prefix.contains(['/', '.']) => (Some(prefix.to_owned()), rest),
        _ => (None, text),
    }
}

/// How the numbers of a stream code its rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Three numbers of this convention.
    Three(Convention),
    /// A quaternion with its scalar part last.
    QuaternionXyzw,
    /// A quaternion with its scalar part first.
    QuaternionWxyz,
}

/// What the caller says of one topic: `TOPIC=CONVENTION[,deg][,mm]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Declaration {
    /// The topic.
    pub topic: String,
    /// How its rotations are coded.
    pub coding: Coding,
    /// Whether its angles are degrees.
    pub degrees: bool,
    /// Whether its positions are millimetres.
    pub millimetres: bool,
}

impl Declaration {
    /// Whether it is about this topic.
    pub fn is_of(&self, topic: &str) -> bool {
        self.topic.trim_start_matches('/') == topic.trim_start_matches('/')
    }
}

/// Why a text is no [`Declaration`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeclarationError {
    /// No `=` in it.
    #[error(
        "`{0}` declares nothing: write TOPIC=CONVENTION, as in /tcp=rotvec or /tcp=euler:ZYX,deg,mm"
    )]
    NoConvention(String),
    /// The name after the `=`.
    #[error("{0}; for a quaternion write `quat:xyzw` or `quat:wxyz`")]
    Convention(#[from] ConventionError),
    /// A word after the convention.
    #[error("unit `{0}` is unknown: after the convention only `deg` and `mm` can stand")]
    Unit(String),
}

impl FromStr for Declaration {
    type Err = DeclarationError;

    fn from_str(text: &str) -> Result<Self, DeclarationError> {
        let (topic, said) = text
            .split_once('=')
            .filter(|(topic, said)| !topic.is_empty() && !said.is_empty())
            .ok_or_else(|| DeclarationError::NoConvention(text.to_owned()))?;
        let mut words = said.split(',');
        let coding = match words.next().unwrap_or_default() {
            "quat:xyzw" => Coding::QuaternionXyzw,
            "quat:wxyz" => Coding::QuaternionWxyz,
            convention => Coding::Three(convention.parse()?),
        };
        let mut declaration =
            Self { topic: topic.to_owned(), coding, degrees: false, millimetres: false };
        for word in words {
            match word {
                "deg" => declaration.degrees = true,
                "mm" => declaration.millimetres = true,
                _ => return Err(DeclarationError::Unit(word.to_owned())),
            }
        }
        Ok(declaration)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_declaration_names_topic_convention_and_units() {
        let declared: Declaration = "/tcp=euler:ZYX,deg,mm".parse().unwrap();
        assert_eq!(declared.topic, "/tcp");
        assert_eq!(declared.coding, Coding::Three("euler:ZYX".parse().unwrap()));
        assert!(declared.degrees && declared.millimetres);
        let quaternion: Declaration = "/tcp=quat:wxyz".parse().unwrap();
        assert_eq!(quaternion.coding, Coding::QuaternionWxyz);
    }

    #[test]
    fn what_is_no_declaration_says_what_to_write() {
        for (text, part) in [
            ("/tcp", "write TOPIC=CONVENTION"),
            ("=rotvec", "write TOPIC=CONVENTION"),
            ("/tcp=", "write TOPIC=CONVENTION"),
            ("/tcp=euler:xxz", "twice in a row"),
            ("/tcp=rotvec,grad", "unit `grad`"),
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
