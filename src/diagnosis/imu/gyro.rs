//! Fits the gyro to the rate of the link: `gyro = (1 + scale_error) · link_from_imu⁻¹ · ω(s − τ) + bias`.
//!
//! Differentiated joint positions amplify noise, so the gyro is integrated over windows and compared with
//! FK between their ends (preintegration: Forster et al., "On-manifold preintegration", IEEE T-RO 2017,
//! with its first-order derivatives). Short windows determine latency and mount better; the joints' noise
//! limits them.

use super::effects::{Block, Profile, Shape, add_likeliest_effects};
use super::estimates::{GyroAxesRotation, GyroBiasChange, GyroBiasProfile, ImuDiagnosis};
use super::extension_tests::ExtensionTests;
use super::model::{Column, Linearization, Model, Moment, Parameters, Sample};
use super::solve::Solved;
use super::{
    Delay, Link, LinkState, MIN_FIT_SAMPLES, MIN_ROTATION_RAD, check_explained, mount_of,
    noise_of_axes, rms,
};
use crate::latency::correlation::median_period_s;
use crate::latency::profile::{LatencySample, stacked};
use crate::priors::GYRO_SCALE_PRIOR;
use crate::samples::sampling::check_sample_count;
use crate::{EstimateResult, GyroBias, GyroScaleError, Measured, NotObservable};
use ground::geometry::{Rotation, Vec3, angle_between, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::mean;
use ground::stats::thin::thinned;
use nalgebra::Matrix3;
use std::ops::{Range, RangeInclusive};

const FLOOR_RAD_S: f64 = 1e-6;
const MIN_WINDOW_S: f64 = 0.1;
const MIN_WINDOW_PERIODS: f64 = 4.0;
const MAX_WINDOWS: usize = 2500;
/// Neighbouring windows share the FK error at their common end with opposite signs. It dominates below this
/// correlation of their residuals.
const MAX_SHARED_END_CORRELATION: f64 = -0.2;

pub(super) struct GyroFit {
    /// Its mount is that of the gyro's axes.
    pub diagnosis: ImuDiagnosis,
    pub parameters: Parameters,
    solved: Solved,
    /// Error of the rotation by FK, relative to the rotation.
    relative_fk_error: f64,
}

impl GyroFit {
    /// Rotation of the gyro's axes against an orientation with mount `link_from_imu`.
    pub fn rotation_against(&self, link_from_imu: &Rotation) -> Option<GyroAxesRotation> {
        let imu_from_gyro = link_from_imu.inverse() * self.parameters.link_from_imu;
        let rotation = rotvec_from_rotation(&imu_from_gyro);
        let mut size_rad =
            self.solved.observable_length(Parameters::MOUNT, rotation.as_slice()).ok()?;
        size_rad.norm = size_rad.norm.with_error(self.relative_fk_error);
        Some(GyroAxesRotation { imu_from_gyro, size_rad, with_accel: false })
    }
}

impl Link<'_> {
    pub(super) fn fit_gyro(&self, lag_s: f64, moves: bool) -> EstimateResult<GyroFit> {
        let is_zero = self.stream.track.gyro.iter().all(|gyro| *gyro == Vec3::zeros());
        if is_zero && self.rotation_rms_rad(&self.delay(lag_s)) > MIN_ROTATION_RAD {
            return Err(NotObservable::NoGyro);
        }
        let period_s = median_period_s(&self.stream.track.t_s);
        let mut window_s = MIN_WINDOW_S.max(MIN_WINDOW_PERIODS * period_s);
        let (delay, mount) = (self.delay(lag_s), self.initial_mount(lag_s, moves));
        let mut model = GyroModel {
            link: self,
            parameters: Parameters::new(delay, mount, moves, GyroModel::columns(moves)),
            windows: self.windows(window_s, &delay),
            scale_columns: 0..0,
            rate_without_noise: Matrix3::identity(),
            noise: noise_of_axes(&self.stream.track.gyro).norm_squared() / 3.0,
        };
        check_sample_count(model.windows.len(), MIN_FIT_SAMPLES)?;
        let mut solved = model.fit();
        while model.is_dominated_by_shared_ends() {
            window_s *= 2.0;
            let windows = self.windows(window_s, &model.parameters.delay());
            if windows.len() < MIN_FIT_SAMPLES {
                break;
            }
            model.windows = windows;
            solved = model.fit();
        }
        let effects =
            [(Block::Bias, Shape::Step), (Block::Bias, Shape::Decay), (Block::Mount, Shape::Step)];
        let effects = if moves { &effects[..] } else { &effects[..2] };
        let (mut model, mut solved) = add_likeliest_effects((model, solved), effects);
        if moves {
            model.rate_without_noise = model.estimate_rate_without_noise(&solved.residuals);
            for scale_columns in model.likely_scale_errors() {
                let mut scaled =
                    GyroModel { scale_columns: scale_columns.clone(), ..model.clone() };
                for column in &mut scaled.parameters.columns[scale_columns] {
                    (column.is_free, column.precision) = (true, GYRO_SCALE_PRIOR.powi(-2));
                }
                let fit = scaled.fit();
                if scaled.scale_error(&fit).is_some() {
                    (model, solved) = (scaled, fit);
                    break;
                }
            }
        }
        let parameters = &model.parameters;
        let rotation_rad = self.rotation_rms_rad(&parameters.delay());
        let relative_fk_error = self.stream.fk_error_rad / rotation_rad.max(f64::MIN_POSITIVE);
        let residual = rms(solved.residuals.iter().map(Vec3::norm));
        check_explained(rotation_rad, model.mean_rate_rad_s(), residual)?;
        let mut found = parameters.diagnosis(&solved);
        if self.stream.track.orientation.is_empty() {
            // Otherwise, the orientation's profile is reported.
            found.latency_profile = parameters
                .latency_profile(self.stream.removed_ramp, |late_s| model.latency_samples(late_s));
        }
        let diagnosis = ImuDiagnosis {
            link_from_imu: found.link_from_imu.filter(|_| moves),
            mount_rad: parameters.mount_rad(self.known_mount(), &solved),
            gyro_bias: model.bias(&solved, relative_fk_error),
            ..found
        };
        Ok(GyroFit { diagnosis, parameters: model.parameters, solved, relative_fk_error })
    }

    /// Mount that maps the link's rates to the gyro's, as close to the logged one as the data allow.
    fn initial_mount(&self, lag_s: f64, moves: bool) -> Rotation {
        let logged = self.known_mount().unwrap_or_default();
        if !moves {
            return logged;
        }
        let track = self.stream.track;
        let rows = self.rows().filter(|&row| !self.numbers.saturates(&track.gyro[row]));
        let states = self.states(rows, self.delay(lag_s));
        let products = states.map(|(row, state)| state.body_rate() * track.gyro[row].transpose());
        mount_of(&products.sum(), &logged)
    }

    /// Windows of at least `window_s`, without gaps, with FK at both ends.
    fn windows(&self, window_s: f64, delay: &Delay) -> Vec<RangeInclusive<usize>> {
        const MIN_GAP_PERIODS: f64 = 5.0;
        let t_s = &self.stream.track.t_s;
        let gap_s = MIN_GAP_PERIODS * median_period_s(t_s);
        let (mut windows, mut start) = (Vec::new(), 0);
        for k in 1..t_s.len() {
            if t_s[k] - t_s[k - 1] > gap_s || self.numbers.saturates(&self.stream.track.gyro[k]) {
                start = k;
            } else if t_s[k] - t_s[start] >= window_s {
                windows.push(start..=k);
                start = k;
            }
        }
        let mut joints = self.joints.sequence();
        let mut is_covered = |k: usize| self.at(delay.truth_s(t_s[k]), &mut joints).is_some();
        windows.retain(|window| is_covered(*window.start()) && is_covered(*window.end()));
        thinned(windows, MAX_WINDOWS).collect()
    }
}

#[derive(Clone)]
struct GyroModel<'a> {
    link: &'a Link<'a>,
    parameters: Parameters,
    windows: Vec<RangeInclusive<usize>>,
    /// Columns of the scale error. Empty without one.
    scale_columns: Range<usize>,
    /// Maps a measured rate to its best linear estimate (Wiener filter), for the columns of the scale error.
    rate_without_noise: Matrix3<f64>,
    /// Variance of one axis of the gyro from sample to sample.
    noise: f64,
}

#[derive(Default)]
struct IntegratedRotation {
    first_from_last: Rotation,
    /// Derivative, about axes at the last sample, by a constant rate change.
    by_rate: Matrix3<f64>,
    /// Derivative by each column of the scale error, with the sign of the rate's error.
    by_scale_error: [Vec3; 7],
    /// At the first and last sample, rad/s.
    rates: [Vec3; 2],
}

impl GyroModel<'_> {
    const BIAS: Range<usize> = Parameters::WIDTH..Parameters::WIDTH + 3;
    /// Of single entries, and of all axes alike.
    const SCALE_ENTRIES: Range<usize> = Self::BIAS.end..Self::BIAS.end + 6;
    const COMMON_SCALE: Range<usize> = Self::SCALE_ENTRIES.end..Self::SCALE_ENTRIES.end + 1;

    /// Effects are tested with the scale error, which they may imitate.
    fn columns(moves: bool) -> Vec<Column> {
        let of_motion =
            Column { is_free: moves, tested: moves.then_some(0.0), ..Column::default() };
        let bias = Column { is_free: true, tested: Some(0.0), ..Column::default() };
        let tested = moves.then_some(GYRO_SCALE_PRIOR.powi(-2));
        let mut columns = vec![of_motion; Self::BIAS.start];
        columns[Parameters::SKEW].tested = None;
        columns.resize(Self::BIAS.end, bias);
        columns.resize(Self::SCALE_ENTRIES.end, Column { tested, ..Column::default() });
        columns.resize(Self::COMMON_SCALE.end, Column::default());
        columns
    }

    /// Scale error by each of its columns: symmetric, because an antisymmetric part would be a rotation and belongs to
    /// the mount.
    fn scale_units() -> impl Iterator<Item = Matrix3<f64>> {
        let entry = |(row, column)| {
            let mut unit = Matrix3::zeros();
            unit[(row, column)] = 1.0;
            unit[(column, row)] = 1.0;
            unit
        };
        let entries = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)];
        entries.into_iter().map(entry).chain([Matrix3::identity()])
    }

    /// Maps a measured rate without bias to the true one.
    fn unscale(&self) -> Matrix3<f64> {
        let columns = &self.parameters.columns[Self::SCALE_ENTRIES.start..];
        let parts = Self::scale_units().zip(columns).map(|(unit, column)| unit * column.value);
        (Matrix3::identity() + parts.sum::<Matrix3<f64>>()).try_inverse().unwrap_or_default()
    }

    fn bias_at(&self, t_s: f64) -> Vec3 {
        let change = self.parameters.sum_of_effects(Block::Bias, t_s, &Rotation::identity());
        self.parameters.vector(Self::BIAS) + change
    }

    /// Residual rates in the link frame and angular acceleration by FK, with this latency compensated in addition.
    fn latency_samples(&self, late_s: &dyn Fn(f64) -> f64) -> Vec<LatencySample> {
        /// Long enough to average joint velocity noise, short relative to the motion.
        const DIFFERENCE_HALF_WIDTH_S: f64 = 0.025;
        let track = self.link.stream.track;
        let unscale = self.unscale();
        let mut joints = self.link.joints.sequence();
        let rows = self.link.rows().filter(|&k| !self.link.numbers.saturates(&track.gyro[k]));
        rows.filter_map(|k| {
            let truth_s = self.parameters.delay().truth_s(track.t_s[k] - late_s(track.t_s[k]));
            let [before, state, after] = [-DIFFERENCE_HALF_WIDTH_S, 0.0, DIFFERENCE_HALF_WIDTH_S]
                .map(|around_s| self.link.at(truth_s + around_s, &mut joints));
            let (before, state, after) = (before?, state?, after?);
            let change = (after.body_rate() - before.body_rate()) / (2.0 * DIFFERENCE_HALF_WIDTH_S);
            let at_s = track.t_s[k];
            let measured =
                self.parameters.mount_at(at_s) * (unscale * (track.gyro[k] - self.bias_at(at_s)));
            Some(LatencySample {
                t_s: track.t_s[k],
                residual: stacked([Vec3::zeros(), measured - state.body_rate()]),
                velocity: stacked([Vec3::zeros(), change]),
                loads: [0.0; 2],
                joint_noise: (state.rate_noise / 3.0).sqrt(),
            })
        })
        .collect()
    }

    /// Midpoint rule.
    fn integrate(&self, window: &RangeInclusive<usize>) -> IntegratedRotation {
        let track = self.link.stream.track;
        let unscale = self.unscale();
        let rate = |k: usize| unscale * (track.gyro[k] - self.bias_at(track.t_s[k]));
        let (first, last) = (*window.start(), *window.end());
        let rates = [rate(first), rate(last)];
        let mut integrated = IntegratedRotation { rates, ..IntegratedRotation::default() };
        for k in first..last {
            let dt = track.t_s[k + 1] - track.t_s[k];
            let omega = 0.5 * (rate(k) + rate(k + 1));
            let true_rate = self.rate_without_noise * omega;
            let step = rotation_from_rotvec(omega * dt);
            let to_end = step.inverse().to_rotation_matrix();
            // From the middle of the step to its end.
            let middle_to_end = rotation_from_rotvec(-0.5 * dt * omega).to_rotation_matrix();
            integrated.first_from_last *= step;
            integrated.by_rate =
                to_end * integrated.by_rate + middle_to_end.matrix() * unscale * dt;
            let sums = integrated.by_scale_error.iter_mut();
            for (sum, unit) in sums.zip(Self::scale_units()) {
                *sum = to_end * *sum + middle_to_end * (unscale * (unit * true_rate)) * dt;
            }
        }
        integrated
    }

    /// Windows, with the stamps and the states of the link at both ends.
    fn ends(&self) -> impl Iterator<Item = (&RangeInclusive<usize>, [(f64, LinkState); 2])> {
        let mut joints = self.link.joints.sequence();
        let (t_s, delay) = (&self.link.stream.track.t_s, self.parameters.delay());
        self.windows.iter().filter_map(move |window| {
            let mut end =
                |k: usize| Some((t_s[k], self.link.at(delay.truth_s(t_s[k]), &mut joints)?));
            Some((window, [end(*window.start())?, end(*window.end())?]))
        })
    }

    /// Rms over the windows, by FK.
    fn mean_rate_rad_s(&self) -> f64 {
        rms(self.ends().map(|(_, [(from_s, first), (to_s, last)])| {
            angle_between(&first.rotation, &last.rotation) / (to_s - from_s)
        }))
    }

    fn is_dominated_by_shared_ends(&self) -> bool {
        let linear = self.linearize().linear;
        let residual = &linear.residual[0];
        let square: f64 = residual.iter().map(Vec3::norm_squared).sum();
        let neighbour_product: f64 = residual.windows(2).map(|pair| pair[0].dot(&pair[1])).sum();
        neighbour_product < MAX_SHARED_END_CORRELATION * square
    }

    /// The noise of a rate is at most the residual. Without the filter, a scale error of −100 % explains the noise of a
    /// gyro about axes that do not turn: the noise is in the column and in the residual.
    fn estimate_rate_without_noise(&self, residuals: &[Vec3]) -> Matrix3<f64> {
        let square = |rates: &[Vec3]| -> Matrix3<f64> {
            rates.iter().map(|rate| rate * rate.transpose()).sum()
        };
        let t_s = &self.link.stream.track.t_s;
        let mean_rate = |window: &RangeInclusive<usize>| {
            let rotation = rotvec_from_rotation(&self.integrate(window).first_from_last);
            rotation / (t_s[*window.end()] - t_s[*window.start()])
        };
        let measured = square(&self.windows.iter().map(mean_rate).collect::<Vec<Vec3>>());
        let mut eigen = (measured - square(residuals)).symmetric_eigen();
        eigen.eigenvalues.apply(|value| *value = value.max(0.0));
        measured.try_inverse().map_or_else(Matrix3::identity, |inverse| eigen.recompose() * inverse)
    }

    /// Columns of scale errors that are likelier than none, the likeliest first: of each axis, or of all alike.
    fn likely_scale_errors(&self) -> Vec<Range<usize>> {
        let linearization = self.linearize();
        let effects = Self::COMMON_SCALE.end..self.parameters.columns.len();
        let base: Vec<(usize, f64)> =
            (0..Self::BIAS.end).chain(effects).map(|column| (column, 0.0)).collect();
        let tests = ExtensionTests::new(&linearization, &base, Self::MODEL_ERROR);
        let scored = [Self::COMMON_SCALE, Self::SCALE_ENTRIES].into_iter().filter_map(|columns| {
            let tests = tests.as_ref()?;
            let factor = tests.compare(columns.clone(), Profile::Constant, GYRO_SCALE_PRIOR)?.0;
            Some((columns, factor))
        });
        let mut likely: Vec<_> = scored.filter(|(_, factor)| *factor > 0.0).collect();
        likely.sort_by(|a, b| b.1.total_cmp(&a.1));
        likely.into_iter().map(|(columns, _)| columns).collect()
    }

    /// `None` without a scale error, or if part of it is not observable in this motion.
    fn scale_error(&self, solved: &Solved) -> Option<GyroScaleError> {
        let measured = self.scale_columns.clone().map(|column| solved.measure(column).ok());
        match *measured.collect::<Option<Vec<Measured>>>()? {
            [common] => Some(GyroScaleError { scale: [common; 3], misalignment_rad: None }),
            [x, y, z, yz, xz, xy] => {
                Some(GyroScaleError { scale: [x, y, z], misalignment_rad: Some([yz, xz, xy]) })
            }
            _ => None,
        }
    }

    fn bias(&self, solved: &Solved, relative_fk_error: f64) -> EstimateResult<GyroBias> {
        let constant_rad_s = self.parameters.vector(Self::BIAS);
        let mut vector_rad_s = constant_rad_s;
        let mut columns: Vec<usize> = Self::BIAS.collect();
        let mut change = None;
        if let Some(effect) = self.parameters.effects_on(Block::Bias).next() {
            let by_effect = self.parameters.vector(effect.columns.clone());
            let changed_rad_s = constant_rad_s + by_effect;
            let (profile, [before_rad_s, after_rad_s]) = match effect.profile {
                Profile::Decay { time_constant_s, .. } => {
                    (GyroBiasProfile::WarmUp { time_constant_s }, [changed_rad_s, constant_rad_s])
                }
                other => {
                    let (at_s, interval_s) = other.change_s().unwrap_or_default();
                    let both = [constant_rad_s, changed_rad_s];
                    (GyroBiasProfile::Step { at_s, interval_s }, both)
                }
            };
            let size_rad_s = solved.length(effect.columns.clone(), by_effect.as_slice())?;
            change = Some(GyroBiasChange { profile, before_rad_s, after_rad_s, size_rad_s });
            // The larger of the two biases.
            if changed_rad_s.norm() > constant_rad_s.norm() {
                vector_rad_s = changed_rad_s;
                columns.extend(effect.columns.clone());
            }
        }
        let scale_error = self.scale_error(solved).map(|it| {
            let scale = it.scale.map(|one| one.with_error(relative_fk_error));
            GyroScaleError { scale, ..it }
        });
        Ok(GyroBias {
            vector_rad_s,
            length_rad_s: solved.length(columns.into_iter(), vector_rad_s.as_slice())?,
            yaw_rate_rad_s: self.yaw_rate(&vector_rad_s),
            scale_error,
            change,
        })
    }

    /// Mean rate about the base's z that the bias simulates.
    fn yaw_rate(&self, bias_rad_s: &Vec3) -> f64 {
        let starts = self.windows.iter().map(|window| *window.start());
        let in_link = self.parameters.link_from_imu * bias_rad_s;
        let states = self.link.states(starts, self.parameters.delay());
        mean(states.map(|(_, state)| (state.rotation * in_link).z))
    }
}

impl Model for GyroModel<'_> {
    const MODEL_ERROR: f64 = FLOOR_RAD_S;

    fn parameters(&mut self) -> &mut Parameters {
        &mut self.parameters
    }

    /// Mean rates over the windows, in the sensor's frame at their ends. FK noise is in the columns of the mount, gyro
    /// noise in all others.
    fn linearize(&self) -> Linearization {
        let parameters = &self.parameters;
        let mut linearization = Linearization::new(parameters, self.windows.len(), FLOOR_RAD_S);
        let slip_s =
            parameters.effects_on(Block::Mount).next().and_then(|slip| slip.profile.change_s());
        for (window, [(from_s, first), (to_s, last)]) in self.ends() {
            let integrated = self.integrate(window);
            let (mount, per_s) = (parameters.mount_at(to_s), 1.0 / (to_s - from_s));
            let (moving, since_middle_s) =
                (first.moving || last.moving, to_s - parameters.middle_s);
            let base_from_imu = last.rotation * mount;
            let in_base = (first.rotation_noise + last.rotation_noise) * per_s.powi(2);
            linearization.add_mount_noise(parameters, from_s, &base_from_imu, &in_base);
            if moving {
                let by_ends = 3.0 * 2.0 * self.noise * per_s.powi(2);
                linearization.add_delay_noise(since_middle_s, by_ends);
            }
            let of_mean = self.noise / (window.end() - window.start()).max(1) as f64;
            for (column, unit) in (Self::SCALE_ENTRIES.start..).zip(Self::scale_units()) {
                linearization.design_noise[(column, column)] += of_mean * unit.norm_squared();
            }
            if slip_s.is_some_and(|(at_s, _)| from_s <= at_s && at_s < to_s) {
                continue;
            }
            let last_from_first = base_from_imu.inverse() * (first.rotation * mount);
            let residual = rotvec_from_rotation(&(last_from_first * integrated.first_from_last));
            let units = [0, 1, 2].map(|axis| Vec3::ith(axis, 1.0));
            let by_bias = units.map(|unit| integrated.by_rate * unit * per_s);
            let by_scale_error = integrated.by_scale_error.map(|by_entry| by_entry * per_s);
            // FK rates share the joints' noise with the residual.
            let rate_difference = integrated.rates[1] - last_from_first * integrated.rates[0];
            let sample = Sample {
                moment: Moment { t_s: 0.5 * (from_s + to_s), world_from_imu: Rotation::identity() },
                residual: residual * per_s,
                by_latency: if moving { -rate_difference * per_s } else { Vec3::zeros() },
                since_middle_s,
                by_mount: units.map(|unit| (unit - last_from_first * unit) * per_s),
                by_own: &[&by_bias[..], &by_scale_error].concat(),
            };
            linearization.push::<Self>(parameters, sample);
        }
        linearization
    }

    fn own_group(&self) -> Range<usize> {
        self.scale_columns.clone()
    }

    fn columns_of(block: Block) -> Range<usize> {
        match block {
            Block::Mount => Parameters::MOUNT,
            _ => Self::BIAS,
        }
    }
}
