use crate::diagnosis::{
    AlignedSamples, PoseDiagnosis, Vibration, VibrationFailure, encoder_step, estimate_vibration,
};
use crate::geometry::Pose;
use crate::run::{Arm, JointSamples};
use crate::stats::mean;
use crate::stream::{JointTrack, PoseTrack};

/// Vibration of the tip according to one stream.
#[derive(Clone, Debug)]
pub struct VibrationEvidence {
    /// Positions are in a wrong unit.
    pub in_other_units: bool,
    /// Vibration, or why it cannot be estimated.
    pub vibration: Result<Vibration, VibrationFailure>,
}

/// Vibration according to a pose stream, excluding the surroundings of latency steps, which also step the
/// path. `joints` are the arm's joint states.
pub(super) fn vibration_of_poses(
    track: &PoseTrack,
    found: &PoseDiagnosis,
    joints: &JointTrack,
) -> Result<Vibration, VibrationFailure> {
    /// Longest interval of joint states that resolves the commanded motion, s.
    const MAX_INTERVAL_S: f64 = 0.04;
    /// Rows closer to a latency step are excluded, s.
    const MIN_STEP_DISTANCE_S: f64 = 0.1;
    let AlignedSamples { t_s: known_s, corrected, fk_at_truth, .. } = &found.aligned;
    if found.is_inverted {
        // In inverted poses, tool rotations move the position.
        let at = |poses: &[Pose], row: usize| {
            found.frame_correction.invert(&poses[row]).translation.vector
        };
        let going = |row: usize| at(fk_at_truth, row);
        return estimate_vibration(known_s, |row| at(corrected, row), Some(&going));
    }
    let jumps = found.latency_profile.as_ref().map_or(&[][..], |course| course.steps.as_slice());
    let is_clear =
        |t_s: f64| jumps.iter().all(|jump| (jump.at_s - t_s).abs() > MIN_STEP_DISTANCE_S);
    let rows: Vec<usize> = (0..track.t_s.len()).filter(|&row| is_clear(track.t_s[row])).collect();
    let t_s: Vec<f64> = rows.iter().map(|&row| track.t_s[row]).collect();
    // FK at the nearest aligned sample.
    let going = |row: usize| {
        let after = known_s.partition_point(|known_s| *known_s < t_s[row]);
        let nearest = after.min(known_s.len() - 1);
        found.frame_correction.invert(&fk_at_truth[nearest]).translation.vector
    };
    // Too few aligned samples do not determine the commanded motion.
    let span_s = joints.span().map_or(f64::INFINITY, |(first, last)| last - first);
    let is_known = 2 * known_s.len() > t_s.len()
        && !found.is_far_from_fk()
        && span_s < MAX_INTERVAL_S * joints.len() as f64;
    estimate_vibration(&t_s, |row| track.xyz[rows[row]], if is_known { Some(&going) } else { None })
}

/// Uses the resampled track if joints have different stamps.
pub(super) fn vibration_of_joints(
    arm: &Arm,
    samples: &[JointSamples<'_>],
    track: &JointTrack,
) -> Result<Vibration, VibrationFailure> {
    /// Maximum ratio of local to overall rms of quantisation noise.
    const MAX_LOCAL_RMS_RATIO: f64 = 1.5;
    let mut q = vec![0.0; arm.columns.len()];
    let mut tip = |position: &dyn Fn(usize) -> f64| {
        q.iter_mut().zip(&arm.columns).for_each(|(q, &column)| *q = position(column));
        arm.chain.forward(&q).translation.vector
    };
    let found = match JointSamples::common_times(samples) {
        Some(t_s) => {
            estimate_vibration(t_s, |row| tip(&|column| samples[column].position[row]), None)
        }
        None => estimate_vibration(&track.t_s, |row| tip(&|column| track.row(row)[column]), None),
    }?;
    // Encoder quantisation is not white: uniform motion turns it into tones.
    let hidden_m = MAX_LOCAL_RMS_RATIO * encoder_noise_m(arm, samples, track);
    let rms_m = if found.rms_m < hidden_m { 0.0 } else { found.rms_m };
    Ok(Vibration { rms_m, resolved_m: found.resolved_m.max(hidden_m), ..found })
}

/// Rms effect of encoder quantisation on the tip, m.
fn encoder_noise_m(arm: &Arm, samples: &[JointSamples<'_>], track: &JointTrack) -> f64 {
    const MAX_CONFIGURATIONS: usize = 50;
    let step = |column: &usize| samples.get(*column).map_or(0.0, |of| encoder_step(&of.position));
    let steps: Vec<f64> = arm.columns.iter().map(step).collect();
    if steps.iter().all(|step| *step == 0.0) {
        return 0.0;
    }
    let mut jacobian = vec![[0.0; 6]; arm.columns.len()];
    let rows = (0..track.len()).step_by((track.len() / MAX_CONFIGURATIONS).max(1));
    let squares = rows.map(|row| {
        arm.chain.forward_with_jacobian(&track.positions_at(row, &arm.columns), &mut jacobian);
        let of_joint = |(column, step): (&[f64; 6], &f64)| {
            // Uniform error of ± half a step.
            (column[0].powi(2) + column[1].powi(2) + column[2].powi(2)) * step * step / 12.0
        };
        jacobian.iter().zip(&steps).map(of_joint).sum::<f64>()
    });
    mean(squares).sqrt()
}
