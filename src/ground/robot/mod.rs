//! The arm as a tree of joints, where it comes from, and its forward kinematics.
//!
//! A [`Robot`] is read from a URDF, from TOML (joints or a Denavit-Hartenberg table) or taken from
//! the [`catalogue`]; a UR's [`Calibration`] can be laid over it. [`Robot::chain`] cuts the path between two links out of it; a [`Chain`]
//! turns joint positions into `base_from_tip`.

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

pub use calibration::{CALIBRATION_SCHEMA, Calibration};
pub use chain::Chain;
pub use chain::turn_z_to;
pub use deviate::LinkPath;
pub use dh::{DhConvention, DhModel};
pub use error::{ChainError, Problem, RobotError};
pub use joint::{JointKind, Limits, Mimic};
pub use model::{Joint, LinkId, Provenance, Robot};
pub use names::NameMatch;
pub use nearest::nearest;
pub use patch::NoPatch;
pub use visuals::{Shape, Visual};
pub use xml::document as xml_document;

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use xml::MAX_TEXT_BYTES;

impl Robot {
    /// Reads the URDF or TOML file at `path`; the content tells which, not the extension.
    ///
    /// # Errors
    /// As [`Robot::from_text`], or where the file cannot be read as text.
    pub fn from_file(path: &Path) -> Result<Robot, RobotError> {
        let file = path.display().to_string();
        let text =
            text_of(path).map_err(|e| RobotError::new(&file, None, Problem::Unreadable(e)))?;
        Robot::from_text(&text, &file)
    }

    /// Reads `text` as a URDF where it begins with `<`, else as TOML; `source` names it in errors.
    ///
    /// # Errors
    /// What is wrong with the model, with its line.
    pub fn from_text(text: &str, source: &str) -> Result<Robot, RobotError> {
        if without_bom(text).trim_start().starts_with('<') {
            Robot::from_urdf(text, source)
        } else {
            Robot::from_toml(text, source)
        }
    }
}

/// The text at `path`, unless it is larger than any model.
fn text_of(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_TEXT_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > MAX_TEXT_BYTES {
        let what = format!("it has more than the {MAX_TEXT_BYTES} bytes that are read");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, what));
    }
    String::from_utf8(bytes).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// `text` without the byte order mark that some editors put first.
fn without_bom(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}
