//! Encoding of the joint states: order, units, signs, scales, couplings and large zeros. Compares them with poses, up to
//! a constant tool offset or a rotated reference frame.

mod comparison;
mod corrected_joints;
mod encoding;
mod estimate;
mod interpretation;
mod interpreted_poses;
mod map;
mod refinement;
mod search;
mod single_joint;
mod single_zeros;
mod slow_samples;

pub use comparison::follows_as_logged;
pub use encoding::{
    Confounder, JointCoupling, JointEncoding, JointOffset, JointScale, JointUnit, JointUnitError,
};

pub(super) use comparison::{JointComparison, MAX_FOLLOWING_RESIDUAL_SHARE};
pub(super) use corrected_joints::{CorrectedJoints, add_zeros, correct_joints};
pub(super) use estimate::LikelyEncoding;
pub(super) use interpreted_poses::ResidualSize;
pub(super) use map::{half_turns, is_quarter_turn};
pub(super) use search::MIN_MOTION_RAD;
pub(super) use single_zeros::single_zeros;

#[cfg(test)]
mod tests;
