//! Joint estimation of the arm and its pose streams.

mod agreement;
mod align;
mod beside_links;
mod choice_of_reference;
mod confounders;
mod encoded_run;
mod encoding_result;
mod encoding_search;
mod fit;
mod stream;
mod zeros;

use crate::arm_run::ArmRun;
use crate::encodings::position::{PositionEncodingEstimate, metres_by_reach, metres_by_size};
use crate::joints::JointComparison;
use crate::latency::correlation::{ArmSpeeds, LagPeak, stream_peaks};
use crate::samples::sampling::as_rotations;
use crate::{ArmDiagnosis, JointEncoding, PoseDiagnosis, PoseStream, StreamResidual};
use encoded_run::EncodedRun;
use encoding_search::EncodingSearch;
use ground::stream::JointTrack;

pub(super) use crate::selection::model_selection::FIT_SAMPLES;
pub use fit::full_fit_count;

/// Ratio of residuals, for another encoding of the joints or another reference.
const MIN_IMPROVEMENT: f64 = 5.0;

/// Whether the streams are compared with poses instead of joint states.
pub(super) fn are_floating(streams: &[PoseStream]) -> bool {
    streams.iter().any(|stream| stream.chain.is_floating())
}

/// Diagnoses joint states and independent pose streams; `max_lag_s` is the largest latency to search.
pub fn diagnose_arm(joints: &JointTrack, streams: &[PoseStream], max_lag_s: f64) -> ArmDiagnosis {
    let is_prismatic = &are_prismatic(joints, streams);
    ArmRun { joints, streams, is_prismatic, max_lag_s }.diagnose()
}

/// Whether each joint that a stream depends on is prismatic.
fn are_prismatic(joints: &JointTrack, streams: &[PoseStream]) -> Vec<bool> {
    let mut are_prismatic = vec![false; joints.dof];
    for PoseStream { chain, columns, .. } in streams {
        for (joint, &column) in columns.iter().enumerate() {
            are_prismatic[column] = chain.slides(joint);
        }
    }
    are_prismatic
}

impl ArmRun<'_> {
    /// With constant causes.
    pub fn diagnose(&self) -> ArmDiagnosis {
        match are_floating(self.streams) {
            true => self.diagnose_as_logged(),
            false => EncodingSearch::new(*self).diagnose(),
        }
    }

    /// The same with the joint states in this encoding. Its scales and couplings are refined.
    pub fn diagnose_encoded(&self, encoding: JointEncoding) -> ArmDiagnosis {
        let run = EncodedRun::new(*self, encoding, false);
        run.or_standard(run.diagnose()).without_negligible_gains()
    }
}

/// Diagnoses a stream computed from the joint states, such as /tf, which is not an independent reference
/// for joint zeros. Compares it with the joint states as recorded and as corrected by `encoding`; the better
/// match counts.
pub fn diagnose_derived(
    joints: &JointTrack,
    encoding: Option<&JointEncoding>,
    stream: &PoseStream,
    max_lag_s: f64,
) -> PoseDiagnosis {
    let streams = std::slice::from_ref(stream);
    let is_prismatic = &are_prismatic(joints, streams);
    let run = ArmRun { joints, streams, is_prismatic, max_lag_s };
    let diagnose_as = |encoding: &JointEncoding| {
        EncodedRun::new(run, encoding.clone(), true).diagnose().streams.remove(0)
    };
    let residual_m = |diagnosis: &PoseDiagnosis| {
        diagnosis.residual.as_ref().map_or(f64::INFINITY, StreamResidual::combined_m)
    };
    let as_recorded = diagnose_as(&JointEncoding::default());
    let as_corrected = encoding.filter(|encoding| !encoding.is_as_logged()).map(diagnose_as);
    let better = as_corrected.filter(|it| residual_m(it) < residual_m(&as_recorded));
    better.unwrap_or(as_recorded)
}

/// Best correlation of a pose stream's speeds with FK's. Bare numbers must also be positioned where the arm
/// is, because an array of joint angles correlates too.
pub fn best_lag_peak(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Option<LagPeak> {
    let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
    let peaks = stream_peaks(&arm, stream, max_lag_s);
    let peak = peaks.first().copied()?;
    let is_positioned = as_rotations(&stream.track.orientation).is_some() || {
        let position_encoding = PositionEncodingEstimate::from_speeds(joints, stream, &arm, peaks);
        position_encoding.needs_correction()
            || JointComparison { joints, stream, metres: position_encoding.metres(), max_lag_s }
                .follows_arm(peak.lag_s)
    };
    Some(if is_positioned { peak } else { LagPeak { correlation: 0.0, ..peak } })
}

/// Whether the stream fits the arm closely if the joint states have another sign, unit, order or zero.
pub fn follows_with_other_encoding(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> bool {
    let mut metres = vec![metres_by_size(joints, stream), metres_by_reach(stream)];
    metres.dedup();
    metres.into_iter().any(|metres| {
        let comparison = JointComparison { joints, stream, metres, max_lag_s };
        comparison.encoding().is_ok_and(|encoding| !encoding.is_as_logged())
    })
}

/// Candidate lags from speeds, best first.
pub fn candidate_lags(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Vec<LagPeak> {
    stream_peaks(&ArmSpeeds::from_joints(joints, stream.chain, stream.columns), stream, max_lag_s)
}
