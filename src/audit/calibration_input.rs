//! A stream as calibration input.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use crate::diagnosis::{PoseDiagnosis, PoseEncoding};
use crate::geometry::Pose;
use crate::report::Trouble;
use crate::robot::{Chain, Robot};
use crate::run::PoseSourceKind;
use crate::stream::JointTrack;

/// The arm of a file, its streams, and data left out with the reasons.
pub(super) type LogInputs = (Robot, Vec<CalibrationInput>, Vec<String>);

/// Meaning of a stream's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measurement {
    /// Measured poses.
    Pose,
    /// One of the points on the tool that an external sensor measures.
    Point,
    /// A point of the tool at one place, without a sensor.
    FixedPoint,
}

/// Stream as calibration input.
#[derive(Clone, Debug)]
pub struct CalibrationInput {
    /// File.
    pub log: PathBuf,
    /// Topic, or its substitute for a table.
    pub topic: String,
    /// Source of the poses.
    pub source_kind: PoseSourceKind,
    /// Meaning of its samples.
    pub measurement: Measurement,
    /// Encoding of the rotations if not the log's.
    pub encoding: Option<String>,
    /// Base link.
    pub base: String,
    /// Tip link.
    pub tip: String,
    pub(super) joints: JointTrack,
    pub(super) columns: Vec<usize>,
    pub(super) t_s: Vec<f64>,
    pub(super) poses: Vec<Pose>,
    pub(super) is_rotation_excluded: bool,
    pub(super) latency_s: Option<f64>,
    pub(super) skew: f64,
    pub(super) reference: Pose,
    pub(super) is_reference_free: bool,
    pub(super) tool: Pose,
    pub(super) is_tool_free: bool,
    pub(super) zeros: Vec<String>,
}

impl CalibrationInput {
    /// Measured poses with their diagnosed encoding, in free frames and without latency.
    pub(super) fn new(
        log: &Path,
        topic: String,
        chain: &Chain,
        (joints, columns): (JointTrack, Vec<usize>),
        found: &PoseDiagnosis,
    ) -> Self {
        let frames = &found.frame_correction;
        Self {
            log: log.to_path_buf(),
            topic,
            source_kind: PoseSourceKind::External,
            measurement: Measurement::Pose,
            encoding: encoding_name(found),
            base: chain.base_name().to_owned(),
            tip: chain.tip_name().to_owned(),
            joints,
            columns,
            t_s: found.aligned.t_s.clone(),
            poses: found.aligned.corrected.iter().map(|pose| frames.invert(pose)).collect(),
            is_rotation_excluded: found.encoding.is_err(),
            latency_s: None,
            skew: 0.0,
            reference: frames.reference,
            is_reference_free: true,
            tool: frames.tool,
            is_tool_free: true,
            zeros: Vec::new(),
        }
    }

    /// The rotations carry no information.
    pub fn is_rotation_excluded(&self) -> bool {
        self.is_rotation_excluded
    }
}

pub(super) fn trouble(path: &Path, what: impl Display, remedy: &str) -> Trouble {
    Trouble::log(path.display(), what, remedy)
}

fn encoding_name(found: &PoseDiagnosis) -> Option<String> {
    let reading = match found.encoding.as_ref().ok()?.best {
        PoseEncoding::AsLogged => return None,
        PoseEncoding::Misinterpreted(class) => {
            let misreading = class.members.first()?;
            format!("{} read as {}", misreading.is, misreading.read_as)
        }
        PoseEncoding::QuaternionOrder(_) => "quaternion components in the other order".to_owned(),
        PoseEncoding::Transposed => "transposed".to_owned(),
        PoseEncoding::Inverted => "inverted".to_owned(),
        PoseEncoding::Numbers(convention) => convention.to_string(),
    };
    let unit = if found.degrees.is_some() { ", in degrees" } else { "" };
    Some(format!("{reading}{unit}"))
}
