//! Point of the last link that stays at one place in the base, although the configuration changes.

use crate::solver::noise::rms;
use crate::solver::robust::huber;
use ground::geometry::{Vec3, mean_vector};
use ground::robot::Chain;
use nalgebra::Matrix3;

const ROUNDS: usize = 10;
/// Minimum error scale for robust weights, m.
const FLOOR_M: f64 = 1e-6;
/// The point stays at the link's origin along directions with less rotation.
const MIN_ROTATION_SHARE: f64 = 1e-6;
/// Minimum share of the squared errors that a jump explains.
const MIN_JUMP_SHARE: f64 = 0.8;

/// Fit of a fixed point with the links of a chain.
#[derive(Clone, Debug)]
pub struct FixedPoint {
    /// In the base, m.
    pub base_xyz: Vec3,
    /// Position of the tip's point minus the fixed point, per configuration, m.
    pub errors: Vec<Vec3>,
}

impl FixedPoint {
    /// Robust least squares over `configurations`. `None` for an empty iterator.
    ///
    /// # Panics
    /// If a configuration has not one value per joint.
    pub fn fit<'a>(chain: &Chain, configurations: impl Iterator<Item = &'a [f64]>) -> Option<Self> {
        let poses = configurations.map(|q| {
            let pose = chain.forward(q);
            (pose.rotation.to_rotation_matrix().into_inner(), pose.translation.vector)
        });
        let poses: Vec<(Matrix3<f64>, Vec3)> = poses.collect();
        let mut weights = vec![1.0; poses.len()];
        let mut found = None;
        for _ in 0..ROUNDS {
            let total: f64 = weights.iter().sum();
            if total <= 0.0 {
                return None;
            }
            let weighted = || poses.iter().zip(&weights).map(|((r, p), weight)| (r, p, *weight));
            let mean_rotation: Matrix3<f64> = weighted().map(|(r, _, w)| w / total * r).sum();
            let mean: Vec3 = weighted().map(|(_, p, w)| w / total * p).sum();
            let (mut matrix, mut right) = (Matrix3::zeros(), Vec3::zeros());
            for (r, p, w) in weighted() {
                let turn = r - mean_rotation;
                matrix += w * turn.transpose() * turn;
                right -= w * turn.transpose() * (p - mean);
            }
            let tip_xyz = matrix.pseudo_inverse(MIN_ROTATION_SHARE * total).ok()? * right;
            let base_xyz = mean_rotation * tip_xyz + mean;
            let errors: Vec<Vec3> = poses.iter().map(|(r, p)| r * tip_xyz + p - base_xyz).collect();
            weights = huber(&errors, FLOOR_M);
            found = Some(Self { base_xyz, errors });
        }
        found
    }

    /// Root mean square of the errors, m.
    pub fn rms_m(&self) -> f64 {
        rms(&self.errors)
    }

    /// First configuration after a jump of the point, and its size, m. `None` unless one jump explains the errors.
    pub fn jump(&self) -> Option<(usize, f64)> {
        let count = self.errors.len();
        let squares = |errors: &[Vec3]| {
            let mean = mean_vector(errors);
            errors.iter().map(|error| (error - mean).norm_squared()).sum::<f64>()
        };
        let best = (2..count.saturating_sub(1))
            .map(|at| (at, squares(&self.errors[..at]) + squares(&self.errors[at..])))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        let is_jump = best.1 < (1.0 - MIN_JUMP_SHARE) * squares(&self.errors);
        let (before, after) = self.errors.split_at(best.0);
        is_jump.then(|| (best.0, (mean_vector(after) - mean_vector(before)).norm()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixed(errors: Vec<Vec3>) -> FixedPoint {
        FixedPoint { base_xyz: Vec3::zeros(), errors }
    }

    #[test]
    fn only_one_jump_is_reported_as_one() {
        let noise = |at: usize| 0.3e-3 * Vec3::new((at as f64).sin(), (3.0 * at as f64).cos(), 0.0);
        let jump = |at: usize| if at < 12 { Vec3::zeros() } else { Vec3::new(0.0, 0.02, 0.0) };
        let moved = fixed((0..30).map(|at| noise(at) + jump(at)).collect());
        let (row, by_m) = moved.jump().expect("a jump");
        assert!(row == 12 && (by_m - 0.02).abs() < 1e-3, "{row} {by_m}");
        assert!(fixed((0..30).map(noise).collect()).jump().is_none());
        assert!(fixed(Vec::new()).jump().is_none() && fixed(vec![Vec3::x()]).jump().is_none());
    }
}
