//! Random numbers, one sequence per use.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::geometry::{Pose, Rotation, Vec3, rotation_from_rotvec};

/// Standard deviations of the streams' noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Joint positions and /tf, rad or m.
    pub joints: f64,
    /// Tool position per axis, m.
    pub pose_m: f64,
    /// Tool rotation per axis, rad.
    pub pose_rad: f64,
    /// IMU orientation per axis, rad.
    pub imu_rad: f64,
    /// Gyro, rad/s.
    pub gyro_rad_s: f64,
    /// Accelerometer, m/s².
    pub accel_m_s2: f64,
    /// Target position in the camera per axis, m.
    pub target_m: f64,
    /// Target rotation per axis, rad.
    pub target_rad: f64,
    /// Correlation of consecutive samples, from 0 (white) to below 1.
    pub correlation: f64,
    /// Random walk of the tool's position, m/√s, and rotation, rad/√s, per axis.
    pub pose_walk: (f64, f64),
    /// Noise of target and tool pose grows with the squared distance beyond this, m, as for a camera; 0 for
    /// constant noise.
    pub far_m: f64,
}

impl Noise {
    /// No noise.
    pub const NONE: Self = Self {
        joints: 0.0,
        pose_m: 0.0,
        pose_rad: 0.0,
        imu_rad: 0.0,
        gyro_rad_s: 0.0,
        accel_m_s2: 0.0,
        target_m: 0.0,
        target_rad: 0.0,
        correlation: 0.0,
        pose_walk: (0.0, 0.0),
        far_m: 0.0,
    };

    pub(super) fn factor_at_distance(&self, distance_m: f64) -> f64 {
        if self.far_m > 0.0 { (distance_m / self.far_m).powi(2).max(1.0) } else { 1.0 }
    }
}

impl Default for Noise {
    /// Typical encoders and a good IMU; white.
    fn default() -> Self {
        Self {
            joints: 2e-5,
            pose_m: 2e-5,
            pose_rad: 2e-5,
            imu_rad: 3e-4,
            gyro_rad_s: 2e-3,
            accel_m_s2: 0.02,
            target_m: 4e-4,
            target_rad: 1.5e-3,
            correlation: 0.0,
            pose_walk: (0.0, 0.0),
            far_m: 0.0,
        }
    }
}

/// Each with its own sequence.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Motion,
    JointNoise,
    JointTransport,
    PoseNoise,
    PoseTransport,
    TfNoise,
    TfTransport,
    ImuNoise,
    ImuTransport,
    ImuWalk,
    TargetNoise,
    TargetTransport,
    ReferenceTransport,
    LeaderNoise,
    LeaderTransport,
    DriveTransport,
    SecondTfTransport,
    PoseWalk,
    TrackerNoise,
    TrackerTransport,
}

pub(super) fn random(seed: u64, purpose: Purpose) -> Pcg64 {
    Pcg64::seed_from_u64(seed.rotate_left(8) ^ purpose as u64)
}

/// Unit variance, white or AR(1).
pub(super) struct UnitNoise {
    random: Pcg64,
    correlation: f64,
    last: Vec<f64>,
}

impl UnitNoise {
    pub(super) fn new(mut random: Pcg64, components: usize, correlation: f64) -> Self {
        let last = (0..components).map(|_| StandardNormal.sample(&mut random)).collect();
        Self { random, correlation, last }
    }

    /// One value per component.
    pub(super) fn next(&mut self) -> &[f64] {
        let fresh = (1.0 - self.correlation * self.correlation).sqrt();
        for value in &mut self.last {
            let innovation: f64 = StandardNormal.sample(&mut self.random);
            *value = self.correlation * *value + fresh * innovation;
        }
        &self.last
    }
}

pub(super) fn add_noise(values: &mut [f64], unit_noise: &[f64], sigma: f64) {
    for (value, noise) in values.iter_mut().zip(unit_noise) {
        *value += sigma * noise;
    }
}

/// Position and rotation per axis, by six numbers of `unit_noise`.
pub(super) fn add_pose_noise(pose: &mut Pose, unit_noise: &[f64], sigma_m: f64, sigma_rad: f64) {
    pose.translation.vector += sigma_m * Vec3::from_column_slice(&unit_noise[..3]);
    pose.rotation *= small_rotation(&unit_noise[3..], sigma_rad);
}

/// `sigma_rad` about each axis, rad.
pub(super) fn small_rotation(unit_noise: &[f64], sigma_rad: f64) -> Rotation {
    rotation_from_rotvec(sigma_rad * Vec3::from_column_slice(unit_noise))
}
