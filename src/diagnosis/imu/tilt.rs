//! Tilt of an IMU's orientation against gravity.

use super::estimates::UpDirections;
use super::{BLOCKS, Link, LinkState};
use crate::samples::sampling::check_sample_count;
use crate::{EstimateResult, NotObservable};
use ground::geometry::{Rotation, Vec3, mean_vector};
use ground::stats::MeasuredLength;
use nalgebra::DMatrix;

/// From a sample to the states of the link before and after it: for rest, and for second differences of FK's positions.
/// Noise of a joint of 1e-4 rad is 0.06 m/s² at 1 m, and averages out.
const STEP_S: f64 = 0.05;
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

    /// Specific forces without acceleration, in the orientation's world and in the base: while the arm rests, otherwise
    /// all less the acceleration by FK.
    pub(super) fn static_forces(
        &self,
        lag_s: f64,
        link_from_imu: &Rotation,
        imu_from_accel: &Rotation,
    ) -> [Vec<Vec3>; 2] {
        let track = self.stream.track;
        let imu_in_link =
            self.stream.link_from_imu.map_or(Vec3::zeros(), |pose| pose.translation.vector);
        let mut joints = self.joints.sequence();
        let mut at = |row: usize, by_s: f64| self.at(track.t_s[row] - lag_s + by_s, &mut joints);
        let rows = self.rows().filter(|_| !track.orientation.is_empty());
        let samples: Vec<(usize, [LinkState; 3])> = rows
            .filter_map(|row| Some((row, [at(row, -STEP_S)?, at(row, 0.0)?, at(row, STEP_S)?])))
            .collect();
        let rests = |states: &[LinkState; 3]| states.iter().all(|state| !state.moving);
        let at_rest = samples.iter().filter(|(_, states)| rests(states)).count() >= MIN_SAMPLES;
        let forces =
            samples.iter().filter(|(_, states)| rests(states) || !at_rest).map(|(row, states)| {
                let [before, now, after] =
                    states.each_ref().map(|state| state.position + state.rotation * imu_in_link);
                let acceleration = match at_rest {
                    true => Vec3::zeros(),
                    false => (before - 2.0 * now + after) / STEP_S.powi(2),
                };
                let base_from_imu = states[1].rotation * link_from_imu;
                let force =
                    imu_from_accel * track.accel[*row] - base_from_imu.inverse() * acceleration;
                (track.orientation[*row] * force, base_from_imu * force)
            });
        let (in_world, in_base) = forces.unzip();
        [in_world, in_base]
    }
}

/// Direction opposite to gravity, by forces in the orientation's world and in the base.
pub(super) fn up([in_world, in_base]: &[Vec<Vec3>; 2]) -> Option<UpDirections> {
    let mean = |forces: &[Vec3]| forces.iter().sum::<Vec3>().try_normalize(f64::MIN_POSITIVE);
    let base_tilt_rad = tilt(in_base).ok()?;
    Some(UpDirections { in_world: mean(in_world)?, in_base: mean(in_base)?, base_tilt_rad })
}

/// Angle between the z axis and the mean force. The standard error comes from the spread over blocks.
pub(super) fn tilt(forces: &[Vec3]) -> EstimateResult<MeasuredLength> {
    let n = forces.len();
    check_sample_count(n, MIN_SAMPLES)?;
    let mean = mean_vector(forces);
    let gravity = mean.norm();
    if gravity < 1.0 {
        return Err(NotObservable::NoGravity);
    }
    let blocks = forces.chunks_exact(n / BLOCKS).take(BLOCKS);
    let off = |block: &[Vec3]| (mean_vector(block) - mean).xy().norm_squared();
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
        assert!(matches!(tilt(&[Vec3::zeros(); 100]), Err(NotObservable::NoGravity)));
        assert!(matches!(tilt(&[Vec3::z() * 9.81; 10]), Err(NotObservable::TooFewSamples { .. })));
    }
}
