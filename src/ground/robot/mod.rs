//! Robot models: trees of joints, their sources and forward kinematics.
//!
//! A [`Robot`] comes from a URDF, from TOML (joints or a Denavit-Hartenberg table) or from the
//! [`catalogue`]; a [`Calibration`] replaces its joint origins. [`Robot::chain`] is the path between two
//! links.

mod calibration;
pub mod catalogue;
mod chain;
mod deviate;
mod dh;
mod dh_write;
mod error;
mod joint;
mod lanes;
mod model;
mod names;
mod nearest;
mod patch;
mod table;
mod urdf;
mod visuals;
mod write;
mod xml;

pub use calibration::{CALIBRATION_SCHEMA, Calibration, UR_JOINTS};
pub use chain::{Chain, FLOATING_COORDINATES, turn_z_to};
pub use deviate::LinkPath;
pub use dh::{DhConvention, DhModel};
pub use error::{ChainError, Problem, RobotError};
pub use joint::{JointKind, Limits, Mimic};
pub use model::{Joint, LinkId, Provenance, Robot};
pub use names::NameMatch;
pub use nearest::nearest;
pub use patch::PatchError;
pub use visuals::{Shape, Visual};
pub use xml::document as xml_document;

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use xml::MAX_TEXT_BYTES;

impl Robot {
    /// Reads a URDF or TOML file.
    ///
    /// # Errors
    /// As [`Robot::from_text`], or if it is not text.
    pub fn from_file(path: &Path) -> Result<Robot, RobotError> {
        let file = path.display().to_string();
        let text =
            text_of(path).map_err(|e| RobotError::new(&file, None, Problem::Unreadable(e)))?;
        Robot::from_text(&text, &file)
    }

    /// Parses a URDF if `text` starts with `<`, otherwise TOML; `source` is its name in errors.
    ///
    /// # Errors
    /// If the model is invalid, with the line.
    pub fn from_text(text: &str, source: &str) -> Result<Robot, RobotError> {
        if without_bom(text).trim_start().starts_with('<') {
            Robot::from_urdf(text, source)
        } else {
            Robot::from_toml(text, source)
        }
    }
}

fn text_of(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_TEXT_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > MAX_TEXT_BYTES {
        let what = format!("larger than the limit of {MAX_TEXT_BYTES} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, what));
    }
    String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

fn without_bom(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}
