//! Fits the orientation to FK: `world_from_imu(s) = Rz(yaw(s)) · world_from_base · FK(q(s − τ)) ·
//! link_from_imu`, with `yaw(s) = drift·(s − middle) + jumps before s + walk(s)`, the [`yaw_terms`], and at
//! most one change of the mount.

mod yaw_terms;

use super::estimates::ImuMountChange;
use super::solve::{DesignNoise, Model, Solved, lengths, solve};
use super::yaw::{self, YawDecomposition};
use super::{
    Clock, Delay, Link, MIN_FIT_SAMPLES, MIN_ROTATION_RAD, MOUNT_SIGNIFICANCE, SKEW_SIGNIFICANCE,
    add_block, check_explained, mount_of, rms, rotated_noise,
};
use crate::encodings::rotation::{
    EncodingFit, LoggedRotations, RotationCorrections, RotationSamples, decode_nearest,
    estimate_encoding_with_gravity,
};
use crate::frames::rotation_frames::mean_rotation;
use crate::latency::profile::{LatencySample, fit_profile};
use crate::model::measurement::FLOOR_RAD;
use crate::model::measurement::MAX_EXPLAINED_RAD;
use crate::solver::linear::Linear;
use crate::{
    EncodingEstimate, EstimateResult, HeadingPair, LatencyProfile, Measured, NotObservable,
    YawProfile,
};
use ground::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::MeasuredLength;
use nalgebra::{DMatrix, DVector, Matrix3};
use std::f64::consts::TAU;
use std::ops::Range;
use yaw_terms::YawTerm;

const WHOLE_RUN_S: Range<f64> = f64::NEG_INFINITY..f64::INFINITY;
/// To test encodings.
const ENCODING_SAMPLES: usize = 72;
/// Refits with an updated yaw model.
const MAX_PASSES: usize = 4;
/// Until the mount is corrected, an unmodelled jump looks like a walk.
const PASSES_WITHOUT_WALK: usize = 2;

pub(super) struct OrientationFit {
    pub encoding: EncodingEstimate,
    pub clock: Clock,
    pub drift_rad_s: EstimateResult<Measured>,
    pub yaw_profile: YawProfile,
    pub latency_profile: EstimateResult<LatencyProfile>,
    pub mount_rad: EstimateResult<MeasuredLength>,
    pub link_from_imu: Rotation,
    pub mount_change: Option<ImuMountChange>,
    pub yaw_error: Vec<(f64, f64)>,
    pub headings: Vec<HeadingPair>,
}

impl Link<'_> {
    pub(super) fn fit_orientation(
        &self,
        start: Delay,
        moves: bool,
    ) -> EstimateResult<OrientationFit> {
        let (mut encoding, mut model) = self.orientation_model(start)?;
        let mut solution = model.fit(moves);
        if let Some(with_slip) = solution.model.with_mount_slip(moves) {
            let (from_s, to_s) = with_slip.longer_side();
            // A slip makes every encoding fit badly: determine it again on one side.
            encoding = self
                .estimate_encoding_near(&with_slip.delay, self.known_mount(), from_s..to_s)
                .map_or(encoding, |estimated| estimated.0);
            model = with_slip;
            solution = model.fit(moves);
        }
        if let Some((with_term, its_solution)) = solution.model.with_yaw_term(moves) {
            (model, solution) = (with_term, its_solution);
        }
        let mut yaw = YawDecomposition::default();
        for pass in 0..MAX_PASSES {
            let previous = std::mem::replace(
                &mut yaw,
                yaw::decompose_yaw(&solution.model.yaw_without_terms()),
            );
            if yaw.is_steady() && previous.is_steady() {
                break;
            }
            if pass < PASSES_WITHOUT_WALK && !yaw.parts.jumps.is_empty() {
                yaw = yaw.without_walk();
            }
            model.add_profile(&yaw);
            solution = model.fit(moves);
        }
        let OrientationSolution { model, solved, mount_rad, skew } = solution;
        let rotation_rms_rad = self.rotation_rms_rad(&model.delay);
        if rotation_rms_rad > MIN_ROTATION_RAD {
            check_explained(rotation_rms_rad, rms(lengths(&model.linearize())))?;
        }
        let clock = match moves {
            true => {
                let latency_s = solved.measure(OrientationModel::LATENCY, model.delay.latency_s);
                Clock { latency_s, skew }
            }
            false => Clock::not_observable(&NotObservable::AtRest),
        };
        // Only the bins account for the random drift of a walk.
        let has_walk = yaw.parts.walk_rad_per_sqrt_s.is_some();
        let drift_rad_s = match yaw.drift_rad_s.filter(|_| has_walk) {
            Some(drift_rad_s) => Ok(drift_rad_s),
            None => solved.measure(OrientationModel::DRIFT, model.drift_rad_s),
        };
        if !has_walk {
            for (jump, (column, fitted)) in yaw.parts.jumps.iter_mut().zip(model.jumps()) {
                jump.size_rad = solved.measure(column, fitted.size_rad).unwrap_or(jump.size_rad);
            }
        }
        (yaw.parts.heading, yaw.parts.warm_up) = model.term_estimates(&solved);
        Ok(OrientationFit {
            encoding,
            clock,
            drift_rad_s,
            yaw_profile: yaw.parts,
            latency_profile: match moves {
                true => fit_profile(
                    &model.latency_samples(),
                    1,
                    model.delay.skew,
                    self.stream.removed_ramp,
                ),
                false => Err(NotObservable::AtRest),
            },
            mount_rad,
            link_from_imu: model.link_from_imu,
            mount_change: model.mount_change(&solved),
            yaw_error: model.yaw_error(),
            headings: model.headings(),
        })
    }

    /// Initial model, with the branch chosen for every sample.
    fn orientation_model(
        &self,
        start: Delay,
    ) -> EstimateResult<(EncodingEstimate, OrientationModel<'_>)> {
        let track = self.stream.track;
        let known_mount = self.known_mount();
        let (estimate, fit) = match self.estimate_encoding_near(&start, known_mount, WHOLE_RUN_S) {
            // A large slip makes two mounts: try each half.
            Err(why) => [f64::NEG_INFINITY..self.middle_s, self.middle_s..f64::INFINITY]
                .into_iter()
                .filter_map(|half| self.estimate_encoding_near(&start, known_mount, half).ok())
                .min_by(|a, b| a.0.best_rad.total_cmp(&b.0.best_rad))
                .ok_or(why)?,
            Ok(estimated) => estimated,
        };
        let mut buffers = self.buffers();
        let mut buffer = Vec::new();
        let logged = LoggedRotations::Rotations(&track.orientation);
        let mut model = OrientationModel {
            link: self,
            rows: Vec::new(),
            truth: Vec::new(),
            jumps: Vec::new(),
            path_rad: Vec::new(),
            terms: Vec::new(),
            slip: None,
            delay: start,
            drift_rad_s: 0.0,
            world_from_base: fit.reference,
            link_from_imu: known_mount.unwrap_or_default() * fit.tool,
        };
        for k in (0..track.t_s.len()).step_by(self.stride()) {
            let truth_s = start.truth_s(track.t_s[k]);
            let Some(link_state) = self.at(truth_s, &mut buffers) else { continue };
            let expected = model.world_from_base * link_state.rotation * model.link_from_imu;
            if let Some(truth) = decode_nearest(
                &fit.encoding,
                &RotationCorrections::default(),
                &logged,
                k,
                &expected,
                &mut buffer,
            ) {
                model.rows.push(k);
                model.truth.push(truth);
            }
        }
        if model.rows.len() < MIN_FIT_SAMPLES {
            return Err(NotObservable::TooFewSamples {
                have: model.rows.len(),
                need: MIN_FIT_SAMPLES,
            });
        }
        model.init_mount(known_mount.unwrap_or_default());
        Ok((estimate, model))
    }

    fn known_mount(&self) -> Option<Rotation> {
        self.stream.link_from_imu.map(|pose| pose.rotation)
    }

    fn estimate_encoding_near(
        &self,
        start: &Delay,
        known_mount: Option<Rotation>,
        when_s: Range<f64>,
    ) -> EstimateResult<(EncodingEstimate, EncodingFit)> {
        let track = self.stream.track;
        let from = track.t_s.partition_point(|t_s| *t_s < when_s.start);
        let to = track.t_s.partition_point(|t_s| *t_s < when_s.end).max(from);
        let step = (to - from).div_ceil(ENCODING_SAMPLES).max(1);
        let mut buffers = self.buffers();
        let (mut fk, mut logged, mut forces) = (Vec::new(), Vec::new(), Vec::new());
        for k in (from..to).step_by(step) {
            if let Some(link_state) = self.at(start.truth_s(track.t_s[k]), &mut buffers) {
                fk.push(link_state.rotation * known_mount.unwrap_or_default());
                logged.push(track.orientation[k]);
                forces.push(track.accel[k]);
            }
        }
        let samples = RotationSamples {
            logged: LoggedRotations::Rotations(&logged),
            fk: &fk,
            reference_free: true,
            reference_known: false,
            are_quaternions: true,
            after: RotationCorrections::default(),
        };
        estimate_encoding_with_gravity(&samples, &forces)
    }
}

/// Rotation axis times the sine of the angle: continuous at half a turn.
fn axis_by_sine(rotation: &Rotation) -> Vec3 {
    2.0 * rotation.w * rotation.vector()
}

#[derive(Clone)]
struct OrientationModel<'a> {
    link: &'a Link<'a>,
    rows: Vec<usize>,
    truth: Vec<Rotation>,
    jumps: Vec<Jump>,
    /// Yaw per row; empty if there is no walk.
    path_rad: Vec<f64>,
    terms: Vec<YawTerm>,
    /// Time, 95 % interval, and rotation: `link_from_imu after = link_from_imu · slip`.
    slip: Option<(f64, [f64; 2], Rotation)>,
    delay: Delay,
    drift_rad_s: f64,
    world_from_base: Rotation,
    link_from_imu: Rotation,
}

#[derive(Clone, Copy)]
struct Jump {
    at_s: f64,
    size_rad: f64,
}

struct OrientationSolution<'a> {
    model: OrientationModel<'a>,
    solved: Solved,
    mount_rad: EstimateResult<MeasuredLength>,
    skew: EstimateResult<Measured>,
}

impl<'a> OrientationModel<'a> {
    const LATENCY: usize = 0;
    const DRIFT: usize = 1;
    const WORLD: Range<usize> = 2..5;
    const MOUNT: Range<usize> = 5..8;
    const SKEW: usize = 8;
    const SLIP: Range<usize> = 9..12;
    /// Columns of the terms, then of the jumps.
    const TERM_COLUMNS_START: usize = 12;

    /// Refits with the logged mount and without skew if the free values do not differ significantly.
    fn fit(&self, moves: bool) -> OrientationSolution<'a> {
        let mut free: Vec<usize> = Self::WORLD.chain([Self::DRIFT]).chain(Self::MOUNT).collect();
        if moves {
            free.push(Self::LATENCY);
        }
        // A walk simulates a skew: use the gyro's skew, and let the bins estimate the jumps.
        let has_walk = !self.path_rad.is_empty();
        if moves && !has_walk {
            free.push(Self::SKEW);
        }
        if !has_walk {
            free.extend(self.jumps().map(|(column, _)| column));
        }
        free.extend(Self::TERM_COLUMNS_START..self.first_jump());
        if self.slip.is_some() {
            free.extend(Self::SLIP);
        }
        let all = free.len();
        let mut model = self.clone();
        let mut solved = solve(&mut model, &free);
        let mount_rad = model.mount(&solved);
        let skew = solved.measure(Self::SKEW, model.delay.skew);
        if !has_walk
            && !solved.is_significant(&[Self::SKEW], &[model.delay.skew], SKEW_SIGNIFICANCE)
        {
            model.delay.skew = 0.0;
            free.retain(|&parameter| parameter != Self::SKEW);
        }
        let is_mount_wrong =
            mount_rad.as_ref().is_ok_and(|length| length.p_value < MOUNT_SIGNIFICANCE)
                && model.residual_with_known_mount() > MAX_EXPLAINED_RAD;
        if let Some(known) = self.link.stream.link_from_imu
            && !is_mount_wrong
        {
            model.link_from_imu = known.rotation;
            model.init_world();
            free.retain(|parameter| !Self::MOUNT.contains(parameter));
        }
        if free.len() < all {
            solved = solve(&mut model, &free);
        }
        OrientationSolution { model, solved, mount_rad, skew }
    }

    /// Residual with the logged mount and the average world, rms rad. If link deviations explain it, weak
    /// motion does not determine the mount.
    fn residual_with_known_mount(&self) -> f64 {
        let Some(known) = self.link.stream.link_from_imu else { return f64::INFINITY };
        let mut model = Self { link_from_imu: known.rotation, ..self.clone() };
        model.init_world();
        rms(lengths(&model.linearize()))
    }

    fn mount(&self, solved: &Solved) -> EstimateResult<MeasuredLength> {
        let known = self.link.stream.link_from_imu.ok_or(NotObservable::NoFrame)?;
        let error = rotvec_from_rotation(&(known.rotation.inverse() * self.link_from_imu));
        let mount: Vec<usize> = Self::MOUNT.collect();
        solved.mount_error(&mount, error.as_slice())
    }

    fn add_profile(&mut self, yaw: &YawDecomposition) {
        let t_s = &self.link.stream.track.t_s;
        let jumps = yaw.parts.jumps.iter();
        self.jumps =
            jumps.map(|jump| Jump { at_s: jump.at_s, size_rad: jump.size_rad.value }).collect();
        self.path_rad = match yaw.parts.walk_rad_per_sqrt_s {
            Some(_) => self.rows.iter().map(|&k| yaw.walk_rad(t_s[k])).collect(),
            None => Vec::new(),
        };
    }

    fn jumps(&self) -> impl Iterator<Item = (usize, &Jump)> {
        (self.first_jump()..).zip(&self.jumps)
    }

    fn error_without_drift(&self, row: usize) -> f64 {
        let stamp = self.link.stream.track.t_s[self.rows[row]];
        let by_terms: f64 = self.terms.iter().map(|term| term.at(row)).sum();
        let by_jumps = self.jumps.iter().filter(|jump| stamp > jump.at_s);
        let by_walk = self.path_rad.get(row).copied().unwrap_or(0.0);
        by_terms + by_walk + by_jumps.map(|jump| jump.size_rad).sum::<f64>()
    }

    /// Maps rotation axes of the link to the IMU's, as close to `expected` as the data allow.
    fn init_mount(&mut self, expected: Rotation) {
        let mut buffers = self.link.buffers();
        let t_s = &self.link.stream.track.t_s;
        let mut middle: Option<(Rotation, Rotation)> = None;
        let mut correlation = Matrix3::zeros();
        for (&k, truth) in self.rows.iter().zip(&self.truth) {
            let Some(link_state) = self.link.at(self.delay.truth_s(t_s[k]), &mut buffers) else {
                continue;
            };
            let (link, imu) = *middle.get_or_insert((link_state.rotation, *truth));
            let by_link = axis_by_sine(&(link.inverse() * link_state.rotation));
            let by_imu = axis_by_sine(&(imu.inverse() * truth));
            correlation += by_link * by_imu.transpose();
        }
        self.link_from_imu = mount_of(&correlation, &expected);
        self.init_world();
    }

    /// Average world rotation for the current mount.
    fn init_world(&mut self) {
        let mut buffers = self.link.buffers();
        let t_s = &self.link.stream.track.t_s;
        let worlds: Vec<Rotation> = self
            .rows
            .iter()
            .zip(&self.truth)
            .enumerate()
            .filter_map(|(row, (&k, truth))| {
                let link_state = self.link.at(self.delay.truth_s(t_s[k]), &mut buffers)?;
                let truth =
                    rotation_from_rotvec(Vec3::z() * -self.error_without_drift(row)) * truth;
                Some(truth * (link_state.rotation * self.mount_at(t_s[k])).inverse())
            })
            .collect();
        self.world_from_base = mean_rotation(&worlds);
    }

    /// Residual rotations and angular velocity by FK.
    fn latency_samples(&self) -> Vec<LatencySample> {
        let linear = self.linearize();
        let mut buffers = self.link.buffers();
        let t_s = self.rows.iter().map(|&k| self.link.stream.track.t_s[k]);
        let link_states = t_s.filter_map(|t_s| {
            let link_state = self.link.at(self.delay.truth_s(t_s), &mut buffers)?;
            let joint_noise = (link_state.rotation_noise.trace() / 3.0).sqrt();
            Some((t_s, self.world_from_base * link_state.rate, joint_noise))
        });
        let residuals = linear.residual[0].iter().map(|&residual| Vec3::from(residual));
        let to_sample = |((t_s, rate, joint_noise), residuals)| LatencySample {
            t_s,
            residual: [Vec3::zeros(), residuals],
            velocity: [Vec3::zeros(), rate],
            loads: [0.0; 2],
            joint_noise,
        };
        link_states.zip(residuals).map(to_sample).collect()
    }

    /// Stamp and total yaw error relative to FK.
    fn yaw_error(&self) -> Vec<(f64, f64)> {
        Self { terms: Vec::new(), ..self.clone() }.yaw_without_terms()
    }

    /// Yaw error without the heading-dependent and decaying parts.
    fn yaw_without_terms(&self) -> Vec<(f64, f64)> {
        let driftless =
            Self { drift_rad_s: 0.0, jumps: Vec::new(), path_rad: Vec::new(), ..self.clone() };
        let mut buffers = self.link.buffers();
        let t_s = &self.link.stream.track.t_s;
        let stamps = self
            .rows
            .iter()
            .filter(|&&k| self.link.at(self.delay.truth_s(t_s[k]), &mut buffers).is_some());
        let stamps: Vec<f64> = stamps.map(|&k| t_s[k]).collect();
        let linear = driftless.linearize();
        stamps.into_iter().zip(linear.residual[0].iter().map(|residual| residual[2])).collect()
    }

    /// Heading of the IMU axis furthest from the vertical, by the IMU and by FK. Empty if every axis comes
    /// too close.
    fn headings(&self) -> Vec<HeadingPair> {
        const MAX_VERTICAL_COSINE: f64 = 0.97;
        let mut buffers = self.link.buffers();
        let t_s = &self.link.stream.track.t_s;
        let rows: Vec<(f64, Rotation, Rotation)> = self
            .rows
            .iter()
            .zip(&self.truth)
            .filter_map(|(&k, truth)| {
                let link_state = self.link.at(self.delay.truth_s(t_s[k]), &mut buffers)?;
                let by_fk = self.world_from_base * link_state.rotation * self.mount_at(t_s[k]);
                Some((t_s[k], *truth, by_fk))
            })
            .collect();
        let max_vertical = |axis: &Vec3| {
            rows.iter().map(|(_, _, by_fk)| (by_fk * axis).z.abs()).fold(0.0, f64::max)
        };
        let axes = [0, 1, 2].map(|axis| Vec3::ith(axis, 1.0));
        let axes = axes.iter().map(|axis| (max_vertical(axis), axis));
        let Some((max_vertical, axis)) = axes.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Vec::new();
        };
        if max_vertical > MAX_VERTICAL_COSINE {
            return Vec::new();
        }
        let heading = |rotation: &Rotation| {
            let points = rotation * axis;
            points.y.atan2(points.x)
        };
        let unwrapped = |of: &dyn Fn(&(f64, Rotation, Rotation)) -> f64| {
            yaw::unwrapped(&rows.iter().map(|row| (row.0, of(row))).collect::<Vec<_>>())
        };
        let by_fk = unwrapped(&|(_, _, by_fk)| heading(by_fk));
        let yaw_error = unwrapped(&|(_, truth, by_fk)| {
            let yaw_error = heading(truth) - heading(by_fk);
            yaw_error - (yaw_error / TAU).round() * TAU
        });
        let pairs = by_fk.into_iter().zip(yaw_error);
        pairs
            .map(|((t_s, fk_rad), (_, yaw_error))| HeadingPair {
                t_s,
                imu_rad: fk_rad + yaw_error,
                fk_rad,
            })
            .collect()
    }
}

impl Model for OrientationModel<'_> {
    fn linearize(&self) -> Linear {
        self.linearized().0
    }

    /// FK noise in the columns of mount and delay.
    fn design_noise(&self) -> DesignNoise {
        let width = self.first_jump() + self.jumps.len();
        let mut squares = DMatrix::zeros(width, width);
        let mut buffers = self.link.buffers();
        let stamps = self.rows.iter().map(|&k| self.link.stream.track.t_s[k]);
        for stamp in stamps {
            let Some(link_state) = self.link.at(self.delay.truth_s(stamp), &mut buffers) else {
                continue;
            };
            let base_from_imu = (link_state.rotation * self.mount_at(stamp)).to_rotation_matrix();
            let in_imu = link_state.rotation_noise * base_from_imu.matrix();
            let rotation_noise = rotated_noise(&base_from_imu.matrix().tr_mul(&in_imu));
            add_block(&mut squares, Self::MOUNT.start, &rotation_noise);
            if self.slip.is_some_and(|(at_s, ..)| stamp > at_s) {
                add_block(&mut squares, Self::SLIP.start, &rotation_noise);
            }
            if link_state.moving {
                squares[(Self::LATENCY, Self::LATENCY)] += link_state.rate_noise;
                let since_s = stamp - self.link.middle_s;
                squares[(Self::SKEW, Self::SKEW)] += link_state.rate_noise * since_s.powi(2);
            }
        }
        let groups = vec![
            vec![Self::SKEW],
            vec![Self::LATENCY],
            Self::SLIP.collect(),
            Self::MOUNT.collect(),
        ];
        DesignNoise { squares, groups }
    }

    fn apply(&mut self, delta: &DVector<f64>) {
        let part = |first: usize| Vec3::new(delta[first], delta[first + 1], delta[first + 2]);
        self.delay.latency_s += delta[Self::LATENCY];
        self.delay.skew += delta[Self::SKEW];
        self.drift_rad_s += delta[Self::DRIFT];
        let first_jump = self.first_jump();
        for (jump, step) in self.jumps.iter_mut().zip(delta.iter().skip(first_jump)) {
            jump.size_rad += step;
        }
        let sizes = self.terms.iter_mut().flat_map(|term| &mut term.sizes_rad);
        sizes
            .zip(delta.iter().skip(Self::TERM_COLUMNS_START))
            .for_each(|(size, step)| *size += step);
        if let Some((.., slip)) = &mut self.slip {
            *slip *= rotation_from_rotvec(part(Self::SLIP.start));
        }
        self.world_from_base = rotation_from_rotvec(part(Self::WORLD.start)) * self.world_from_base;
        self.link_from_imu *= rotation_from_rotvec(part(Self::MOUNT.start));
    }
}

impl OrientationModel<'_> {
    fn linearized(&self) -> (Linear, Vec<usize>) {
        let mut linear = Linear::new(self.first_jump() + self.jumps.len(), &[FLOOR_RAD]);
        let mut used_rows = Vec::new();
        let mut buffers = self.link.buffers();
        for (row, (&k, truth)) in self.rows.iter().zip(&self.truth).enumerate() {
            let stamp = self.link.stream.track.t_s[k];
            let truth_s = self.delay.truth_s(stamp);
            let Some(link_state) = self.link.at(truth_s, &mut buffers) else { continue };
            used_rows.push(row);
            let since = stamp - self.link.middle_s;
            let yaw_rad = self.drift_rad_s * since + self.error_without_drift(row);
            let yaw_rotation = rotation_from_rotvec(Vec3::z() * yaw_rad);
            let world = yaw_rotation * self.world_from_base;
            let predicted = world * link_state.rotation * self.mount_at(stamp);
            let slip = self.slip.filter(|(at_s, ..)| stamp > *at_s).map(|slip| slip.2);
            let residual = rotvec_from_rotation(&(truth * predicted.inverse()));
            let mut rows = linear.push(&[residual.into()]);
            if link_state.moving {
                let later = -(world * link_state.rate);
                rows.set(0, Self::LATENCY, later.into());
                rows.set(0, Self::SKEW, (later * since).into());
            }
            rows.set(0, Self::DRIFT, (Vec3::z() * since).into());
            for (column, _) in self.jumps().filter(|(_, jump)| stamp > jump.at_s) {
                rows.set(0, column, Vec3::z().into());
            }
            for axis in 0..3 {
                let unit = Vec3::ith(axis, 1.0);
                rows.set(0, Self::WORLD.start + axis, (yaw_rotation * unit).into());
                let before_slip = slip.map_or(unit, |slip| slip.inverse() * unit);
                rows.set(0, Self::MOUNT.start + axis, (predicted * before_slip).into());
                if slip.is_some() {
                    rows.set(0, Self::SLIP.start + axis, (predicted * unit).into());
                }
            }
            let weights = self.terms.iter().flat_map(|form| &form.weights);
            for (column, weight) in (Self::TERM_COLUMNS_START..).zip(weights) {
                rows.set(0, column, (Vec3::z() * weight[row]).into());
            }
        }
        (linear, used_rows)
    }
}
