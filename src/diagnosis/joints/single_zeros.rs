//! Joints whose zero alone is far off.

use super::interpreted_poses::{ConstantFrames, InterpretedPoses};
use super::map::JointMap;
use super::single_joint::SingleJoint;
use super::slow_samples::JOINT_ENCODING_SAMPLES;
use crate::distinct::by_score;
use crate::model::measurement::PoseObservations;

/// Best two joints whose zero alone would greatly reduce the residual, with their offsets. `offsets` is the
/// reference.
pub(crate) fn single_zeros(
    observations: &PoseObservations,
    lag_s: f64,
    offsets: &[f64],
) -> Vec<(usize, f64)> {
    /// Gauss–Newton finds smaller ones.
    const MIN_ZERO_CHANGE_RAD: f64 = 0.1;
    const MAX_ZERO_RESIDUAL_RATIO: f64 = 0.3;
    let chain = observations.chain;
    let PoseObservations { joints, columns, .. } = *observations;
    let mut sequence = joints.sequence();
    let (mut xyz, mut rotation, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for k in observations.rows(JOINT_ENCODING_SAMPLES) {
        if let Some((q, _)) = sequence.at(observations.t_s[k] - lag_s) {
            xyz.push(observations.xyz[k]);
            rotation.push(observations.rotation[k]);
            rows.extend(columns.iter().map(|&column| q[column]));
        }
    }
    let spans = vec![[0.0; 2]; columns.len()];
    let view = InterpretedPoses::new(chain, xyz, Some(rotation), rows, spans);
    let mut nearest_zeros = JointMap::as_logged(columns.len());
    nearest_zeros.zero = columns.iter().map(|&column| offsets[column]).collect();
    let named = ConstantFrames::default();
    let residual_of =
        |map: &JointMap| view.residual_against(&view.fk(map), &named).combined_m(view.lever_m);
    let max_residual = MAX_ZERO_RESIDUAL_RATIO * residual_of(&nearest_zeros);
    let zeros = chain.turning_joints().filter_map(|joint| {
        let zero = SingleJoint::new(&view, &nearest_zeros, &named, joint).best_zero(1.0, true).0;
        let residual = residual_of(&nearest_zeros.with(joint, 1.0, zero));
        let is_off = (zero - nearest_zeros.zero[joint]).abs() > MIN_ZERO_CHANGE_RAD;
        (is_off && residual < max_residual).then_some((residual, (columns[joint], zero)))
    });
    by_score(zeros).take(2).collect()
}
