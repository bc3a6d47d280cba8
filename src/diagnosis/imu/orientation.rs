//! The orientation against FK:
//! `world_from_imu(s) = Rz(drift·(s − middle) + path(s)) · world_from_base · FK(q(s − τ)) · link_from_imu`.

use super::super::linear::Linear;
use super::super::measured::Length;
use super::super::model::FLOOR_RAD;
use super::super::reading::{Fit, Logged, Samples, mean_rotation, nearest_truth, read_in_gravity};
use super::super::{Measured, ReadingEstimate, Seen, Unseen, YawCourse};
use super::solve::{Model, Solved, solve};
use super::yaw::{self, Course};
use super::{Link, MOUNT_CHANCE, NEED};
use crate::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use nalgebra::DVector;
use std::ops::Range;

/// Samples that readings are tried on.
const READING_SAMPLES: usize = 72;
/// Times that a yaw's course is taken off and the rest fitted anew.
const PASSES: usize = 4;

/// What a fit of orientations gives.
pub(super) struct OrientationFit {
    pub reading: ReadingEstimate,
    pub latency_s: Seen<Measured>,
    pub drift_rad_s: Seen<Measured>,
    pub course: YawCourse,
    pub mount_rad: Seen<Length>,
    pub link_from_imu: Rotation,
    pub yaw_error: Vec<(f64, f64)>,
}

impl Link<'_> {
    pub(super) fn fit_orientation(&self, lag_s: f64, moves: bool) -> Seen<OrientationFit> {
        let (reading, mut model) = self.orientation_model(lag_s)?;
        let mut settled = model.settle(moves);
        let mut course = yaw::explain(&settled.model.yaw_error());
        for _ in 1..PASSES {
            if course.is_steady() {
                break;
            }
            model.take_off(&course);
            settled = model.settle(moves);
            course = yaw::explain(&settled.model.yaw_error());
        }
        let Settled { model, solved, mount_rad } = settled;
        let latency_s = match moves {
            true => solved.one(OrientationModel::LATENCY, model.latency_s),
            false => Err(Unseen::AtRest),
        };
        let drift_rad_s = match course.drift_rad_s {
            Some(drift_rad_s) => Ok(drift_rad_s),
            None => solved.one(OrientationModel::DRIFT, model.drift_rad_s),
        };
        Ok(OrientationFit {
            reading,
            latency_s,
            drift_rad_s,
            course: course.parts,
            mount_rad,
            link_from_imu: model.link_from_imu,
            yaw_error: model.yaw_error(),
        })
    }

    /// The model from which the fit starts, with the branch of every sample chosen.
    fn orientation_model(&self, lag_s: f64) -> Seen<(ReadingEstimate, OrientationModel<'_>)> {
        let track = self.stream.track;
        let known_mount = self.stream.link_from_imu.map(|pose| pose.rotation);
        let (estimate, fit) = self.read(lag_s, known_mount)?;
        let mut sweep = self.sweep();
        let mut buffer = Vec::new();
        let logged = Logged::Rotations(&track.orientation);
        let mut model = OrientationModel {
            link: self,
            rows: Vec::new(),
            truth: Vec::new(),
            path_rad: Vec::new(),
            latency_s: lag_s,
            drift_rad_s: 0.0,
            world_from_base: fit.reference,
            link_from_imu: known_mount.unwrap_or_default() * fit.tool,
        };
        for k in (0..track.t_s.len()).step_by(self.stride()) {
            let Some(moment) = self.at(track.t_s[k] - lag_s, &mut sweep) else { continue };
            let expected = model.world_from_base * moment.rotation * model.link_from_imu;
            if let Some(truth) = nearest_truth(&fit.reading, &logged, k, &expected, &mut buffer) {
                model.rows.push(k);
                model.truth.push(truth);
            }
        }
        if model.rows.len() < NEED {
            return Err(Unseen::TooFewSamples { have: model.rows.len(), need: NEED });
        }
        model.path_rad = vec![0.0; model.rows.len()];
        if known_mount.is_some() {
            model.start_world();
        }
        Ok((estimate, model))
    }

    /// Which convention the orientation is written in; the mount by the log's frames is taken off.
    fn read(&self, lag_s: f64, known_mount: Option<Rotation>) -> Seen<(ReadingEstimate, Fit)> {
        let track = self.stream.track;
        let step = track.t_s.len().div_ceil(READING_SAMPLES).max(1);
        let mut sweep = self.sweep();
        let (mut fk, mut logged, mut forces) = (Vec::new(), Vec::new(), Vec::new());
        for k in (0..track.t_s.len()).step_by(step) {
            if let Some(moment) = self.at(track.t_s[k] - lag_s, &mut sweep) {
                fk.push(moment.rotation * known_mount.unwrap_or_default());
                logged.push(track.orientation[k]);
                forces.push(track.accel[k]);
            }
        }
        let samples = Samples {
            logged: Logged::Rotations(&logged),
            fk: &fk,
            reference_free: true,
            reference_known: false,
        };
        read_in_gravity(&samples, &forces)
    }
}

/// The model of the orientations.
#[derive(Clone)]
struct OrientationModel<'a> {
    link: &'a Link<'a>,
    rows: Vec<usize>,
    truth: Vec<Rotation>,
    /// What the yaw does beside its drift, a row each.
    path_rad: Vec<f64>,
    latency_s: f64,
    drift_rad_s: f64,
    world_from_base: Rotation,
    link_from_imu: Rotation,
}

/// A fitted model, with the mount's error against the log's frames.
struct Settled<'a> {
    model: OrientationModel<'a>,
    solved: Solved,
    mount_rad: Seen<Length>,
}

impl<'a> OrientationModel<'a> {
    const LATENCY: usize = 0;
    const DRIFT: usize = 1;
    const WORLD: Range<usize> = 2..5;
    const MOUNT: Range<usize> = 5..8;
    const WIDTH: usize = 8;

    /// Fits the model with the mount free, and with the log's mount where the free one is no other.
    fn settle(&self, moves: bool) -> Settled<'a> {
        let mut free: Vec<usize> = Self::WORLD.chain([Self::DRIFT]).collect();
        if moves {
            free.push(Self::LATENCY);
        }
        let with_mount: Vec<usize> = free.iter().copied().chain(Self::MOUNT).collect();
        let mut model = self.clone();
        let solved = solve(&mut model, &with_mount);
        let Some(known) = self.link.stream.link_from_imu.map(|pose| pose.rotation) else {
            let mount_rad = Err(Unseen::RestsOn("the IMU's frame in the log"));
            return Settled { model, solved, mount_rad };
        };
        let error = rotvec_from_rotation(&(known.inverse() * model.link_from_imu));
        let mount: Vec<usize> = Self::MOUNT.collect();
        let mount_rad = solved.length(&mount, error.as_slice());
        if mount_rad.as_ref().is_ok_and(|length| length.p_value < MOUNT_CHANCE) {
            return Settled { model, solved, mount_rad };
        }
        let mut model = Self { link_from_imu: known, ..self.clone() };
        model.start_world();
        let solved = solve(&mut model, &free);
        Settled { model, solved, mount_rad }
    }

    /// Takes what `course` says beside the drift off the yaw.
    fn take_off(&mut self, course: &Course) {
        let t_s = &self.link.stream.track.t_s;
        self.path_rad = self.rows.iter().map(|&k| course.beside_drift(t_s[k])).collect();
    }

    /// Makes the world's rotation fit the mount by averaging.
    fn start_world(&mut self) {
        let mut sweep = self.link.sweep();
        let t_s = &self.link.stream.track.t_s;
        let worlds: Vec<Rotation> = self
            .rows
            .iter()
            .zip(&self.truth)
            .zip(&self.path_rad)
            .filter_map(|((&k, truth), &path_rad)| {
                let moment = self.link.at(t_s[k] - self.latency_s, &mut sweep)?;
                let truth = rotation_from_rotvec(Vec3::z() * -path_rad) * truth;
                Some(truth * (moment.rotation * self.link_from_imu).inverse())
            })
            .collect();
        self.world_from_base = mean_rotation(&worlds);
    }

    /// Stamp, and yaw of the IMU over that of the arm with the drift and all else left in.
    fn yaw_error(&self) -> Vec<(f64, f64)> {
        let still = Self { drift_rad_s: 0.0, path_rad: vec![0.0; self.rows.len()], ..self.clone() };
        let mut sweep = self.link.sweep();
        let t_s = &self.link.stream.track.t_s;
        let stamps = self
            .rows
            .iter()
            .filter(|&&k| self.link.at(t_s[k] - self.latency_s, &mut sweep).is_some());
        let stamps: Vec<f64> = stamps.map(|&k| t_s[k]).collect();
        let linear = still.linearize();
        stamps.into_iter().zip(linear.residual[0].iter().map(|residual| residual[2])).collect()
    }
}

impl Model for OrientationModel<'_> {
    fn linearize(&self) -> Linear {
        let mut linear = Linear::new(Self::WIDTH, &[FLOOR_RAD]);
        let mut sweep = self.link.sweep();
        for ((&k, truth), path_rad) in self.rows.iter().zip(&self.truth).zip(&self.path_rad) {
            let stamp = self.link.stream.track.t_s[k];
            let Some(moment) = self.link.at(stamp - self.latency_s, &mut sweep) else { continue };
            let since = stamp - self.link.middle_s;
            let yaw_rad = self.drift_rad_s * since + path_rad;
            let drifted = rotation_from_rotvec(Vec3::z() * yaw_rad);
            let world = drifted * self.world_from_base;
            let predicted = world * moment.rotation * self.link_from_imu;
            let residual = rotvec_from_rotation(&(truth * predicted.inverse()));
            let mut rows = linear.push(&[residual.into()]);
            if moment.moving {
                rows.set(0, Self::LATENCY, (-(world * moment.rate)).into());
            }
            rows.set(0, Self::DRIFT, (Vec3::z() * since).into());
            for axis in 0..3 {
                let unit = Vec3::ith(axis, 1.0);
                rows.set(0, Self::WORLD.start + axis, (drifted * unit).into());
                rows.set(0, Self::MOUNT.start + axis, (predicted * unit).into());
            }
        }
        linear
    }

    fn apply(&mut self, delta: &DVector<f64>) {
        let part = |first: usize| Vec3::new(delta[first], delta[first + 1], delta[first + 2]);
        self.latency_s += delta[Self::LATENCY];
        self.drift_rad_s += delta[Self::DRIFT];
        self.world_from_base = rotation_from_rotvec(part(Self::WORLD.start)) * self.world_from_base;
        self.link_from_imu *= rotation_from_rotvec(part(Self::MOUNT.start));
    }
}
