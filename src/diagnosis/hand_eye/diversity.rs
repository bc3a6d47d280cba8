//! Diversity of the hand's rotation axes.

use super::RotationDiversity;
use super::series::HandEyeSetting;
use ground::geometry::{Rotation, Vec3, rotvec_from_rotation};
use ground::stats::quantile;
use nalgebra::Matrix3;

/// Compared in pairs.
const MAX_POSES: usize = 120;
/// For a rotation's axis to count.
const MIN_ROTATION_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// Expects a `setting` with the camera in the hand.
pub(super) fn rotation_diversity(setting: &HandEyeSetting, lag_s: f64) -> RotationDiversity {
    let pairs = setting.pairs_at(lag_s, MAX_POSES);
    let hands: Vec<Rotation> = pairs.iter().map(|pair| pair.carrier_pose.rotation).collect();
    let turns = hands.iter().enumerate();
    let turns = turns.flat_map(|(i, a)| hands[..i].iter().map(move |b| a.inverse() * b));
    let turns: Vec<Vec3> = turns.map(|turn| rotvec_from_rotation(&turn)).collect();
    let span_rad = turns.iter().map(Vec3::norm).fold(0.0, f64::max);
    // Weighted by angle, so noise between similar orientations has little effect.
    let scatter: Matrix3<f64> = turns.iter().map(|turn| turn * turn.transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let axis: Vec3 = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into();
    let min_rad = MIN_ROTATION_RAD.min(0.3 * span_rad);
    let axes = turns.iter().filter(|turn| turn.norm() > min_rad);
    let axes = axes.filter_map(|turn| turn.try_normalize(1e-12));
    let mut leans: Vec<f64> = axes.map(|own| own.dot(&axis).abs().min(1.0).acos()).collect();
    let spread_rad = quantile(&mut leans, 0.95).unwrap_or_default();
    // The mean squared difference of two orientations is twice their variance.
    let squares: f64 = turns.iter().map(Vec3::norm_squared).sum();
    let turning_rad = (0.5 * squares / turns.len().max(1) as f64).sqrt();
    RotationDiversity { span_rad, turning_rad, spread_rad, axis_in_hand: axis.into() }
}
