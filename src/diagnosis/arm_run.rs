//! Input of a diagnosis of an arm's run.

use crate::{ArmDiagnosis, JointEncoding, PoseStream};
use ground::stream::JointTrack;

/// Joint states and pose streams of an arm.
#[derive(Clone, Copy)]
pub(crate) struct ArmRun<'a> {
    pub joints: &'a JointTrack,
    pub streams: &'a [PoseStream<'a>],
    /// Per joint.
    pub is_prismatic: &'a [bool],
    /// The largest latency to search, s.
    pub max_lag_s: f64,
}

impl ArmRun<'_> {
    /// Whether the joint in this column turns, and a stream depends on it.
    pub fn is_rotary(&self, column: usize) -> bool {
        !self.is_prismatic[column]
            && self.streams.iter().any(|stream| stream.columns.contains(&column))
    }

    /// With constant causes, after changes that do not affect whether the joint states are as logged.
    pub fn diagnose_again(&self, before: &ArmDiagnosis) -> ArmDiagnosis {
        match before.joints.encoding.as_ref().is_ok_and(JointEncoding::is_as_logged) {
            true => self.diagnose_as_logged(),
            false => self.diagnose(),
        }
    }

    /// The same, without another encoding of the joint states.
    pub fn diagnose_as_logged(&self) -> ArmDiagnosis {
        self.diagnose_encoded(JointEncoding::default())
    }
}
