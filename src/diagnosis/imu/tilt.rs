//! Tilt of an IMU's orientation against gravity.

use super::estimates::UpDirections;
use super::{BLOCKS, Link};
use crate::{EstimateResult, NotObservable};
use ground::geometry::{Rotation, Vec3};
use ground::stats::MeasuredLength;
use nalgebra::DMatrix;

/// Around a sample at rest.
const REST_MARGIN_S: f64 = 0.05;
const MIN_SAMPLES: usize = 4 * BLOCKS;

impl Link<'_> {
    /// Constancy of the specific force's direction in the base, 0 to 1.
    pub(super) fn steadiness(&self, lag_s: f64, link_from_accel: &Rotation) -> f64 {
        let track = self.stream.track;
        let (mut sum, mut sizes) = (Vec3::zeros(), f64::MIN_POSITIVE);
        for (row, state) in self.states(self.rows(), self.delay(lag_s)) {
            sum += state.rotation * (link_from_accel * track.accel[row]);
            sizes += track.accel[row].norm();
        }
        sum.norm() / sizes
    }

    /// Specific forces while the arm rests, in the orientation's world and in the base.
    fn forces_at_rest(&self, lag_s: f64, link_from_imu: &Rotation) -> [Vec<Vec3>; 2] {
        let track = self.stream.track;
        let mut buffers = self.buffers();
        let mut at_rest = |t_s: f64| self.at(t_s, &mut buffers).filter(|state| !state.moving);
        let (mut in_world, mut in_base) = (Vec::new(), Vec::new());
        for k in self.rows().filter(|_| !track.orientation.is_empty()) {
            let t_s = track.t_s[k] - lag_s;
            let around = [-REST_MARGIN_S, REST_MARGIN_S].map(|by_s| at_rest(t_s + by_s));
            if let ([Some(_), Some(_)], Some(link_state)) = (around, at_rest(t_s)) {
                in_world.push(track.orientation[k] * track.accel[k]);
                in_base.push(link_state.rotation * (link_from_imu * track.accel[k]));
            }
        }
        [in_world, in_base]
    }

    /// Direction opposite to gravity.
    pub(super) fn up(&self, lag_s: f64, link_from_imu: &Rotation) -> Option<UpDirections> {
        let [in_world, in_base] = self.forces_at_rest(lag_s, link_from_imu);
        let mean = |forces: &[Vec3]| forces.iter().sum::<Vec3>().try_normalize(f64::MIN_POSITIVE);
        (in_world.len() >= MIN_SAMPLES).then_some(())?;
        let base_tilt_rad = tilt(&in_base).ok()?;
        Some(UpDirections { in_world: mean(&in_world)?, in_base: mean(&in_base)?, base_tilt_rad })
    }

    pub(super) fn tilt(&self, lag_s: f64) -> EstimateResult<MeasuredLength> {
        if self.stream.track.orientation.is_empty() {
            return Err(NotObservable::NoOrientation);
        }
        tilt(&self.forces_at_rest(lag_s, &Rotation::identity())[0])
    }
}

/// Angle between the z axis and the mean force at rest. The standard error comes from the spread over blocks.
fn tilt(forces: &[Vec3]) -> EstimateResult<MeasuredLength> {
    let n = forces.len();
    if n < MIN_SAMPLES {
        return Err(NotObservable::NeverRests);
    }
    let mean = forces.iter().sum::<Vec3>() / n as f64;
    let gravity = mean.norm();
    if gravity < 1.0 {
        return Err(NotObservable::RestsOn("the direction of gravity"));
    }
    let blocks = forces.chunks_exact(n / BLOCKS).take(BLOCKS);
    let blocks = blocks.map(|block| block.iter().sum::<Vec3>());
    let off = |sum: Vec3| (sum / (n / BLOCKS) as f64 - mean).xy().norm_squared();
    let degrees = 2.0 * (BLOCKS as f64 - 1.0);
    let variance = blocks.map(off).sum::<f64>() / degrees / BLOCKS as f64 / gravity.powi(2);
    let sideways = mean.xy().norm();
    let per_sine = if sideways > 0.0 { sideways.atan2(mean.z) / sideways } else { 0.0 };
    let lean = [mean.x * per_sine, mean.y * per_sine];
    let covariance = DMatrix::from_diagonal_element(2, 2, variance);
    Ok(MeasuredLength::estimate(&lean, &covariance, degrees))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upside_down_world_has_a_tilt_of_half_a_turn() {
        let forces: Vec<Vec3> = (0..400)
            .map(|k| Vec3::new(0.02 * f64::from(k).sin(), 0.02 * f64::from(k).cos(), -9.81))
            .collect();
        let tilt = tilt(&forces).unwrap();
        assert!((tilt.norm.value - std::f64::consts::PI).abs() < 1e-3, "{tilt:?}");
    }

    #[test]
    fn without_gravity_there_is_no_tilt() {
        assert!(matches!(tilt(&[Vec3::zeros(); 100]), Err(NotObservable::RestsOn(_))));
        assert!(matches!(tilt(&[Vec3::z() * 9.81; 10]), Err(NotObservable::NeverRests)));
    }
}
