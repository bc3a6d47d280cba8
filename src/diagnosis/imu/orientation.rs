//! Fits the orientation to FK: `world_from_imu(s) = Rz(yaw(s)) · world_from_base · FK(q(s − τ)) ·
//! link_from_imu`, with `yaw(s) = drift·(s − middle)` and the [`effects`](super::effects) on yaw and mount.
//! The links deviate from the model by random rotations with the prior of a calibrated arm; otherwise their
//! error, which depends on the posture, looks like a jump, a walk or a drift of the yaw.

use super::effects::{Block, Profile, Shape, add_likeliest_effects};
use super::estimates::{HeadingError, ImuDiagnosis, YawWarmUp};
use super::gyro::GyroFit;
use super::model::{Column, Linearization, Model, Moment, Parameters, Sample};
use super::solve::Solved;
use super::{Delay, Link, LinkState, MIN_FIT_SAMPLES, MOUNT_SIGNIFICANCE, mount_of};
use crate::encodings::rotation::{
    EncodingFit, LoggedRotations, RotationSamples, estimate_imu_encoding,
};
use crate::frames::position_fit::spread;
use crate::frames::rotation_frames::mean_rotation;
use crate::latency::profile::{LatencySample, stacked};
use crate::model::measurement::{FLOOR_RAD, MAX_EXPLAINED_RAD};
use crate::priors::{LINK_PRIOR_RAD, MODEL_ERROR_RAD};
use crate::samples::sampling::{check_sample_count, rows_within};
use crate::{EncodingEstimate, EstimateResult, HeadingPair, NotObservable, YawJump, YawProfile};
use ground::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::MeasuredLength;
use ground::stats::thin::thinned;
use nalgebra::{DVector, Matrix3};
use std::f64::consts::TAU;
use std::ops::Range;

const WHOLE_RUN_S: Range<f64> = f64::NEG_INFINITY..f64::INFINITY;
/// To test encodings.
const ENCODING_SAMPLES: usize = 72;
/// Effects over the run to test.
const EFFECTS: [(Block, Shape); 6] = [
    (Block::Yaw, Shape::Step),
    (Block::Yaw, Shape::Heading),
    (Block::Yaw, Shape::Decay),
    (Block::Yaw, Shape::Walk),
    (Block::World, Shape::Step),
    (Block::Mount, Shape::Step),
];

impl Link<'_> {
    /// Delay, encoding, yaw and mount.
    pub(super) fn fit_orientation(
        &self,
        start: Delay,
        moves: bool,
        gyro: Option<&GyroFit>,
    ) -> EstimateResult<ImuDiagnosis> {
        let (mut encoding, mut model) = self.orientation_model(start, moves, gyro)?;
        let solved = model.fit();
        let (model, solved) = add_likeliest_effects((model, solved), &EFFECTS);
        if let Some(side_s) = model.longer_side_s() {
            // A slip makes every encoding fit badly: determine it again on one side.
            let estimated = self.estimate_encoding_near(&model.parameters.delay(), gyro, side_s);
            encoding = estimated.map_or(encoding, |estimated| estimated.0);
        }
        let parameters = &model.parameters;
        self.check_rotation_explained(&parameters.delay(), &solved.residuals)?;
        let latency_profile = parameters.latency_profile(self.stream.removed_ramp, |late_s| {
            model.latency_samples(&solved, late_s)
        });
        let (yaw_error, headings) = model.yaw_error();
        Ok(ImuDiagnosis {
            encoding: Ok(encoding),
            yaw_drift_rad_s: solved.measure(OrientationModel::DRIFT),
            yaw_profile: model.yaw_profile(&solved),
            yaw_error,
            headings,
            mount_rad: model.mount_rad,
            latency_profile,
            ..parameters.diagnosis(&solved)
        })
    }

    /// Initial model, with the branch chosen for every sample.
    fn orientation_model(
        &self,
        start: Delay,
        moves: bool,
        gyro: Option<&GyroFit>,
    ) -> EstimateResult<(EncodingEstimate, OrientationModel<'_>)> {
        let track = self.stream.track;
        let known_mount = self.known_mount();
        let (estimate, fit) = match self.estimate_encoding_near(&start, gyro, WHOLE_RUN_S) {
            // A large slip makes two mounts: try each half.
            Err(why) => [f64::NEG_INFINITY..self.middle_s, self.middle_s..f64::INFINITY]
                .into_iter()
                .filter_map(|half| self.estimate_encoding_near(&start, gyro, half).ok())
                .min_by(|a, b| a.0.best_rad.total_cmp(&b.0.best_rad))
                .ok_or(why)?,
            Ok(estimated) => estimated,
        };
        let logged = LoggedRotations::new(&track.orientation);
        let mount = known_mount.unwrap_or_default() * fit.tool;
        let own = Column { is_free: true, tested: Some(0.0), ..Column::default() };
        let mut columns = vec![own; OrientationModel::LINKS_START];
        columns.extend(self.link_columns());
        let mut model = OrientationModel {
            link: self,
            parameters: Parameters::new(start, mount, moves, columns),
            samples: Vec::new(),
            mount_rad: Err(NotObservable::NoFrame),
            world_from_base: fit.reference,
        };
        for (k, state) in self.states(self.rows(), start) {
            let expected = model.world_from_base * state.rotation * mount;
            let truth = logged.nearest(fit.encoding, k, &expected);
            model.samples.extend(truth.map(|truth| (track.t_s[k], truth)));
        }
        check_sample_count(model.samples.len(), MIN_FIT_SAMPLES)?;
        model.init_mount(known_mount.unwrap_or_default());
        Ok((estimate, model))
    }

    /// Number of links between the first and the last joint.
    fn inner_links(&self) -> usize {
        match self.stream.chain.is_floating() {
            true => 0,
            false => self.stream.columns.len().saturating_sub(1),
        }
    }

    /// Rotations of the links between the first and the last joint.
    fn link_columns(&self) -> Vec<Column> {
        let count = 3 * self.inner_links();
        // The constant rotations absorb about half of the deviations.
        let by_fk_error = self.stream.fk_error_rad.powi(2) / (0.5 * count as f64);
        let precision = LINK_PRIOR_RAD.powi(2).max(by_fk_error).recip();
        vec![Column { precision, ..Column::default() }; count]
    }

    fn estimate_encoding_near(
        &self,
        start: &Delay,
        gyro: Option<&GyroFit>,
        when_s: Range<f64>,
    ) -> EstimateResult<(EncodingEstimate, EncodingFit)> {
        let track = self.stream.track;
        let known_mount = self.known_mount().unwrap_or_default();
        let rows = rows_within(&track.t_s, when_s.start, when_s.end);
        let (mut fk, mut logged, mut forces) = (Vec::new(), Vec::new(), Vec::new());
        for (k, state) in self.states(thinned(rows, ENCODING_SAMPLES), *start) {
            fk.push(state.rotation * known_mount);
            logged.push(track.orientation[k]);
            forces.push(track.accel[k]);
        }
        let samples = RotationSamples::new(LoggedRotations::new(&logged), &fk, false);
        let contradicts_gyro = |tool: &Rotation| {
            let rotation = gyro.and_then(|gyro| gyro.rotation_against(&(known_mount * tool)));
            rotation.is_some_and(|rotation| {
                let MeasuredLength { norm, p_value, .. } = rotation.size_rad;
                p_value < MOUNT_SIGNIFICANCE && norm.value > MAX_EXPLAINED_RAD
            })
        };
        estimate_imu_encoding(&samples, &forces, &contradicts_gyro)
    }
}

/// Rotation axis times the sine of the angle: continuous at half a turn.
fn axis_by_sine(rotation: &Rotation) -> Vec3 {
    2.0 * rotation.w * rotation.vector()
}

#[derive(Clone)]
struct OrientationModel<'a> {
    link: &'a Link<'a>,
    parameters: Parameters,
    /// Stamps and decoded orientations.
    samples: Vec<(f64, Rotation)>,
    world_from_base: Rotation,
    /// Error of the logged mount before it is fixed.
    mount_rad: EstimateResult<MeasuredLength>,
}

impl OrientationModel<'_> {
    const WORLD: Range<usize> = Parameters::WIDTH..Parameters::WIDTH + 3;
    const DRIFT: usize = Self::WORLD.end;
    const LINKS_START: usize = Self::DRIFT + 1;

    /// A wrong mount must turn the orientations by more than usual errors of filters and arms.
    fn mount(&self, solved: &Solved) -> EstimateResult<MeasuredLength> {
        let known = self.link.known_mount().ok_or(NotObservable::NoFrame)?;
        let length = self.parameters.mount_rad(Some(known), solved)?;
        let error_in_link = known * self.parameters.mount_error_rad(&known);
        let turned: Vec<Vec3> =
            self.states().map(|(.., state)| state.rotation * error_in_link).collect();
        let is_hidden =
            length.norm.value > MAX_EXPLAINED_RAD && spread(&turned) < MAX_EXPLAINED_RAD;
        match length.p_value < MOUNT_SIGNIFICANCE && is_hidden {
            true => Err(NotObservable::NotExcited),
            false => Ok(length),
        }
    }

    /// Stamps, decoded orientations and states of the link.
    fn states(&self) -> impl Iterator<Item = (f64, &Rotation, LinkState)> {
        let (mut joints, delay) = (self.link.joints.sequence(), self.parameters.delay());
        self.samples.iter().filter_map(move |(stamp_s, truth)| {
            let state = self.link.at(delay.truth_s(*stamp_s), &mut joints)?;
            Some((*stamp_s, truth, state))
        })
    }

    /// Side of a slip with more samples.
    fn longer_side_s(&self) -> Option<Range<f64>> {
        let (at_s, _) = self.parameters.effects_on(Block::Mount).next()?.profile.change_s()?;
        let Range { start, end } = WHOLE_RUN_S;
        Some(if at_s > self.link.middle_s { start..at_s } else { at_s..end })
    }

    fn yaw_profile(&self, solved: &Solved) -> YawProfile {
        let mut profile = YawProfile::default();
        for effect in self.parameters.effects_on(Block::Yaw) {
            let size = || solved.measure(effect.columns.start).ok();
            match effect.profile {
                Profile::Step { at_s, .. } => {
                    profile.jumps.extend(size().map(|size_rad| YawJump { at_s, size_rad }));
                }
                Profile::Decay { time_constant_s, .. } => {
                    profile.warm_up = size().map(|size| YawWarmUp {
                        time_constant_s,
                        turned_rad: size.scaled(-1.0),
                        at_first_rad_s: size.scaled(-1.0 / time_constant_s),
                    });
                }
                Profile::Heading { axis } => {
                    let weights = |Moment { t_s, world_from_imu }: &Moment| {
                        DVector::from_vec(effect.profile.weights(*t_s, world_from_imu))
                    };
                    let mut all: Vec<DVector<f64>> =
                        self.linearize().moments.iter().map(weights).collect();
                    let values = self.parameters.values(effect.columns.clone());
                    all.sort_by(|a, b| a.dot(&values).total_cmp(&b.dot(&values)));
                    if let [min, .., max] = all.as_slice() {
                        let along = 0.5 * (max - min);
                        let amplitude = solved.measure_combination(effect.columns.clone(), &along);
                        profile.heading = amplitude
                            .ok()
                            .map(|amplitude_rad| HeadingError { amplitude_rad, axis });
                    }
                }
                Profile::Walk { density, .. } => profile.walk_rad_per_sqrt_s = Some(density),
                Profile::Constant => {}
            }
        }
        profile.jumps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        profile
    }

    /// Yaw error relative to the middle of the run.
    fn yaw_at(&self, t_s: f64, world_from_imu: &Rotation) -> f64 {
        self.parameters.columns[Self::DRIFT].value * (t_s - self.link.middle_s)
            + self.parameters.sum_of_effects(Block::Yaw, t_s, world_from_imu).x
    }

    /// Maps rotation axes of the link to the IMU's, as close to `expected` as the data allow.
    fn init_mount(&mut self, expected: Rotation) {
        let mut middle: Option<(Rotation, Rotation)> = None;
        let mut correlation = Matrix3::zeros();
        for (_, truth, link_state) in self.states() {
            let (link, imu) = *middle.get_or_insert((link_state.rotation, *truth));
            let by_link = axis_by_sine(&(link.inverse() * link_state.rotation));
            let by_imu = axis_by_sine(&(imu.inverse() * truth));
            correlation += by_link * by_imu.transpose();
        }
        self.parameters.link_from_imu = mount_of(&correlation, &expected);
        self.init_world();
    }

    /// Average world rotation for the current mount.
    fn init_world(&mut self) {
        let world = |(stamp_s, truth, state): (f64, &Rotation, LinkState)| {
            let base_from_imu = state.rotation * self.parameters.mount_at(stamp_s);
            let yaw_rad = self.yaw_at(stamp_s, &(self.world_from_base * base_from_imu));
            let truth = rotation_from_rotvec(Vec3::z() * -yaw_rad) * truth;
            truth * base_from_imu.inverse()
        };
        let worlds: Vec<Rotation> = self.states().map(world).collect();
        self.world_from_base = mean_rotation(&worlds);
    }

    /// Residual rotations and angular velocity by FK, with this latency compensated in addition to the model's.
    fn latency_samples(&self, solved: &Solved, late_s: &dyn Fn(f64) -> f64) -> Vec<LatencySample> {
        let (mut joints, delay) = (self.link.joints.sequence(), self.parameters.delay());
        let samples =
            self.states().zip(&solved.residuals).filter_map(|((t_s, _, state), residual)| {
                let then = self.link.at(delay.truth_s(t_s - late_s(t_s)), &mut joints)?;
                let turned = then.rotation * state.rotation.inverse();
                let in_world = |by_link: Vec3| self.world_from_base * by_link;
                let residual = residual - in_world(rotvec_from_rotation(&turned));
                Some(LatencySample {
                    t_s,
                    residual: stacked([Vec3::zeros(), residual]),
                    velocity: stacked([Vec3::zeros(), in_world(then.rate)]),
                    loads: [0.0; 2],
                    joint_noise: (state.rotation_noise.trace() / 3.0).sqrt(),
                })
            });
        samples.collect()
    }

    /// Stamp and total yaw error relative to FK, and the headings that it separates: of the IMU axis furthest
    /// from the vertical, or none if every axis comes too close.
    fn yaw_error(&self) -> (Vec<(f64, f64)>, Vec<HeadingPair>) {
        const MAX_VERTICAL_COSINE: f64 = 0.97;
        let Linearization { linear, moments, .. } = self.linearize();
        let error = |(Moment { t_s, world_from_imu }, residual): (&Moment, &Vec3)| {
            (*t_s, self.yaw_at(*t_s, world_from_imu) + residual[2])
        };
        let errors: Vec<(f64, f64)> = moments.iter().zip(&linear.residual[0]).map(error).collect();
        let points = |axis: usize| {
            moments.iter().map(move |moment| moment.world_from_imu * Vec3::ith(axis, 1.0))
        };
        let max_vertical =
            |axis: usize| points(axis).map(|point| point.z.abs()).fold(0.0, f64::max);
        let axes = (0..3).map(|axis| (max_vertical(axis), axis));
        let best = axes.min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, axis)) = best.filter(|best| best.0 <= MAX_VERTICAL_COSINE) else {
            return (errors, Vec::new());
        };
        let (mut turns, mut last) = (0.0, None);
        let pair = |(point, &(t_s, error)): (Vec3, &(f64, f64))| {
            let heading = point.y.atan2(point.x);
            let change: f64 = heading - last.replace(heading).unwrap_or(heading);
            turns -= (change / TAU).round();
            let fk_rad = heading + turns * TAU;
            HeadingPair { t_s, imu_rad: fk_rad + error, fk_rad }
        };
        let pairs = points(axis).zip(&errors).map(pair).collect();
        (errors, pairs)
    }
}

impl Model for OrientationModel<'_> {
    const MODEL_ERROR: f64 = MODEL_ERROR_RAD;

    fn parameters(&mut self) -> &mut Parameters {
        &mut self.parameters
    }

    /// FK noise is in the columns of mount and delay.
    fn linearize(&self) -> Linearization {
        let parameters = &self.parameters;
        let mut linearization = Linearization::new(parameters, self.samples.len(), FLOOR_RAD);
        let mut frames = Vec::new();
        for (t_s, truth, state) in self.states() {
            let since_middle_s = t_s - parameters.middle_s;
            let base_from_imu = state.rotation * parameters.mount_at(t_s);
            linearization.add_mount_noise(parameters, t_s, &base_from_imu, &state.rotation_noise);
            if state.moving {
                linearization.add_delay_noise(since_middle_s, state.rate_noise);
            }
            let world_from_imu = self.world_from_base * base_from_imu;
            let yaw = rotation_from_rotvec(Vec3::z() * self.yaw_at(t_s, &world_from_imu));
            let world = yaw * self.world_from_base;
            let predicted = yaw * world_from_imu;
            let units = [0, 1, 2].map(|axis| Vec3::ith(axis, 1.0));
            let mut by_own = units.map(|unit| yaw * unit).to_vec();
            by_own.push(Vec3::z() * since_middle_s);
            self.link.stream.chain.joint_frames(&state.q, &mut frames);
            for frame in frames.iter().take(self.link.inner_links()) {
                by_own.extend(units.map(|unit| world * (frame.rotation * unit)));
            }
            let sample = Sample {
                moment: Moment { t_s, world_from_imu },
                residual: rotvec_from_rotation(&(truth * predicted.inverse())),
                by_latency: if state.moving { -(world * state.rate) } else { Vec3::zeros() },
                since_middle_s,
                by_mount: units.map(|unit| predicted * unit),
                by_own: &by_own,
            };
            linearization.push::<Self>(parameters, sample);
        }
        linearization
    }

    fn turn(&mut self, step: &[f64]) {
        let turn = rotation_from_rotvec(Vec3::from_column_slice(&step[Self::WORLD]));
        self.world_from_base = turn * self.world_from_base;
    }

    fn restores_logged_mount(&mut self, solved: &Solved) -> bool {
        self.mount_rad = self.mount(solved);
        let is_wrong =
            self.mount_rad.as_ref().is_ok_and(|length| length.p_value < MOUNT_SIGNIFICANCE);
        let Some(known) = self.link.known_mount().filter(|_| !is_wrong) else { return false };
        self.parameters.link_from_imu = known;
        self.init_world();
        true
    }

    fn columns_of(block: Block) -> Range<usize> {
        match block {
            Block::Mount => Parameters::MOUNT,
            Block::World => Self::WORLD,
            // About the vertical.
            _ => Self::WORLD.end - 1..Self::WORLD.end,
        }
    }
}
