//! The models of an IMU's orientation and gyro: what they share, and their fit.

use super::effects::{Block, Effect};
use super::estimates::{ImuDiagnosis, ImuMountChange};
use super::solve::{Solved, solve};
use super::{Delay, MOUNT_SIGNIFICANCE, SKEW_SIGNIFICANCE};
use crate::latency::profile::{LatencySample, fit_profile};
use crate::solver::linear::Linear;
use crate::{EstimateResult, LatencyProfile, Measured, NotObservable, PiecewiseLatency};
use ground::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::MeasuredLength;
use nalgebra::{DMatrix, DVector, Matrix3};
use std::ops::Range;

/// Parametric model of one signal of an IMU.
pub(super) trait Model: Clone {
    /// Residuals below it distinguish no effects.
    const MODEL_ERROR: f64;

    fn parameters(&mut self) -> &mut Parameters;

    /// Linearises at the current parameters, with all random effects at zero.
    fn linearize(&self) -> Linearization;

    /// Turns the rotations of the model besides the mount by a step, with one entry per column of the design.
    fn turn(&mut self, _: &[f64]) {}

    /// Columns of equal unit that are tested together for excitation before the common ones.
    fn own_group(&self) -> Range<usize> {
        0..0
    }

    /// Columns of the block's constant parameters.
    fn columns_of(block: Block) -> Range<usize>;

    /// Sets the mount to the logged one if the fitted one does not differ significantly. Returns whether it did.
    fn restores_logged_mount(&mut self, _: &Solved) -> bool {
        false
    }

    /// Fits all free parameters. Refits without skew and with the logged mount if the free values do not differ
    /// significantly.
    fn fit(&mut self) -> Solved {
        let columns = self.parameters().columns.iter().enumerate();
        let mut free = Vec::from_iter(columns.filter(|(_, it)| it.is_free).map(|(at, _)| at));
        let all = free.len();
        let mut solved = solve(self, &free);
        let Parameters { columns, skew, .. } = self.parameters();
        *skew = solved.measure(Parameters::SKEW);
        let value = &mut columns[Parameters::SKEW].value;
        let length = solved.length([Parameters::SKEW].into_iter(), &[*value]);
        if !length.is_ok_and(|length| length.p_value < SKEW_SIGNIFICANCE) {
            *value = 0.0;
            free.retain(|&column| column != Parameters::SKEW);
        }
        if self.restores_logged_mount(&solved) {
            free.retain(|column| !Parameters::MOUNT.contains(column));
        }
        if free.len() < all {
            solved = solve(self, &free);
        }
        solved
    }
}

/// Column of the design, with its parameter.
#[derive(Clone, Copy, Default)]
pub(super) struct Column {
    /// 0 for random effects, which are not part of the state. Unused for rotations.
    pub value: f64,
    /// Whether it is fitted as part of the state.
    pub is_free: bool,
    /// Of a normal prior about zero, with which it is always fitted; 0 without a prior.
    pub precision: f64,
    /// Without a prior, the precision with which it is fitted while effects are tested. `None` if it is then fixed.
    pub tested: Option<f64>,
}

/// Parameters of a model. Those of both signals are in the first columns of the design, effects in the last.
#[derive(Clone)]
pub(super) struct Parameters {
    pub columns: Vec<Column>,
    /// Time without effect of the skew.
    pub middle_s: f64,
    /// Mount before a slip.
    pub link_from_imu: Rotation,
    pub effects: Vec<Effect>,
    /// Whether the IMU follows the arm, so that its delay is observable.
    pub moves: bool,
    /// Before it is omitted.
    pub skew: EstimateResult<Measured>,
}

impl Parameters {
    pub const LATENCY: usize = 0;
    pub const SKEW: usize = 1;
    pub const MOUNT: Range<usize> = 2..5;
    /// Of both signals.
    pub const WIDTH: usize = 5;

    /// Without effects. The delay is free if the IMU moves.
    pub fn new(delay: Delay, link_from_imu: Rotation, moves: bool, columns: Vec<Column>) -> Self {
        let Delay { latency_s, skew, middle_s } = delay;
        let (effects, no_skew) = (Vec::new(), Err(NotObservable::AtRest));
        let mut new = Self { columns, middle_s, link_from_imu, effects, moves, skew: no_skew };
        for (column, value) in [(Self::LATENCY, latency_s), (Self::SKEW, skew)] {
            new.columns[column] = Column { value, is_free: moves, ..new.columns[column] };
        }
        new
    }

    pub fn delay(&self) -> Delay {
        let [latency_s, skew] = [Self::LATENCY, Self::SKEW].map(|at| self.columns[at].value);
        Delay { latency_s, skew, middle_s: self.middle_s }
    }

    pub fn values(&self, columns: Range<usize>) -> DVector<f64> {
        DVector::from_iterator(columns.len(), self.columns[columns].iter().map(|it| it.value))
    }

    /// Three parameters.
    pub fn vector(&self, columns: Range<usize>) -> Vec3 {
        Vec3::from_fn(|axis, _| self.columns[columns.start + axis].value)
    }

    /// Columns that are fitted while effects are tested, with the precisions of their priors.
    pub fn tested(&self) -> Vec<(usize, f64)> {
        let precision = |column: &Column| match column.precision {
            0.0 => column.tested,
            precision => Some(precision),
        };
        let columns = self.columns.iter().enumerate();
        columns.filter_map(|(at, column)| Some((at, precision(column)?))).collect()
    }

    pub fn mount_at(&self, t_s: f64) -> Rotation {
        let slip = self.sum_of_effects(Block::Mount, t_s, &Rotation::identity());
        self.link_from_imu * rotation_from_rotvec(slip)
    }

    fn mount_change(&self, solved: &Solved) -> Option<ImuMountChange> {
        let effect = self.effects_on(Block::Mount).next()?;
        let (at_s, interval_s) = effect.profile.change_s()?;
        let slip = self.vector(effect.columns.clone());
        let size_rad = solved.length(effect.columns.clone(), slip.as_slice()).ok()?;
        let link_from_imu = self.link_from_imu * rotation_from_rotvec(slip);
        Some(ImuMountChange { at_s, interval_s, link_from_imu, size_rad })
    }

    /// Rotation from the logged mount, in the axes of the IMU.
    pub fn mount_error_rad(&self, known_mount: &Rotation) -> Vec3 {
        rotvec_from_rotation(&(known_mount.inverse() * self.link_from_imu))
    }

    /// Error of the logged mount, or its observable part if that is significant; a pass requires the whole error.
    pub fn mount_rad(
        &self,
        known_mount: Option<Rotation>,
        solved: &Solved,
    ) -> EstimateResult<MeasuredLength> {
        let error = self.mount_error_rad(&known_mount.ok_or(NotObservable::NoFrame)?);
        let observable = || solved.observable_length(Self::MOUNT, error.as_slice()).ok();
        solved.length(Self::MOUNT, error.as_slice()).or_else(|why| {
            observable().filter(|length| length.p_value < MOUNT_SIGNIFICANCE).ok_or(why)
        })
    }

    /// Estimates of these parameters by the fit. No latency at rest.
    pub fn diagnosis(&self, solved: &Solved) -> ImuDiagnosis {
        let mut found = ImuDiagnosis {
            link_from_imu: Some(self.link_from_imu),
            mount_change: self.mount_change(solved),
            ..ImuDiagnosis::not_observable(&NotObservable::NoOrientation)
        };
        if self.moves {
            found.latency_s = solved.measure(Self::LATENCY);
            found.skew = self.skew.clone();
        } else {
            found.drop_latency(&NotObservable::AtRest);
        }
        found
    }

    /// By the samples with an additional latency compensated.
    pub fn latency_profile(
        &self,
        removed_ramp: Option<&PiecewiseLatency>,
        samples: impl Fn(&dyn Fn(f64) -> f64) -> Vec<LatencySample>,
    ) -> EstimateResult<LatencyProfile> {
        if !self.moves {
            return Err(NotObservable::AtRest);
        }
        let compensated = |late_s: &dyn Fn(f64) -> f64| Some(samples(late_s));
        fit_profile(
            &samples(&|_| 0.0),
            1,
            self.columns[Self::SKEW].value,
            removed_ramp,
            compensated,
        )
    }

    /// Adds a step of the `free` parameters.
    pub fn apply(&mut self, step: &[f64], free: &[usize]) {
        let turn = |columns| rotation_from_rotvec(Vec3::from_column_slice(&step[columns]));
        self.link_from_imu *= turn(Self::MOUNT);
        let slipped = self.effects_on(Block::Mount).next().map(|effect| {
            let slip = rotation_from_rotvec(self.vector(effect.columns.clone()));
            (effect.columns.clone(), rotvec_from_rotation(&(slip * turn(effect.columns.clone()))))
        });
        free.iter().for_each(|&column| self.columns[column].value += step[column]);
        if let Some((columns, slip)) = slipped {
            let columns = self.columns[columns].iter_mut();
            columns.zip(&slip).for_each(|(column, value)| column.value = *value);
        }
    }

    /// Columns of equal unit whose combinations are tested together for excitation, in the order of fixing.
    pub fn groups(&self) -> impl Iterator<Item = Range<usize>> {
        let delay = [Self::SKEW..Self::SKEW + 1, Self::LATENCY..Self::LATENCY + 1];
        let slips = self.effects_on(Block::Mount).map(|slip| slip.columns.clone());
        delay.into_iter().chain(slips).chain([Self::MOUNT])
    }
}

pub(super) struct Linearization {
    pub linear: Linear,
    /// Per sample.
    pub moments: Vec<Moment>,
    /// Expected contribution to `AᵀA` of noise in the columns of the design (errors in variables: Fuller, *Measurement
    /// Error Models*, 1987, §2.2). It inflates `AᵀA` and simulates information about parameters that a weak motion
    /// does not excite.
    pub design_noise: DMatrix<f64>,
}

pub(super) struct Moment {
    pub t_s: f64,
    /// Without yaw error; the identity if there is no world.
    pub world_from_imu: Rotation,
}

/// Residual of a sample and its derivatives.
pub(super) struct Sample<'a> {
    pub moment: Moment,
    pub residual: Vec3,
    /// By a later measurement. Zero at rest.
    pub by_latency: Vec3,
    /// Time for the skew, from the middle of the run.
    pub since_middle_s: f64,
    /// By rotations about the axes of the IMU.
    pub by_mount: [Vec3; 3],
    /// By the model's own parameters, in the order of their columns.
    pub by_own: &'a [Vec3],
}

impl Linearization {
    pub fn new(parameters: &Parameters, samples: usize, floor: f64) -> Self {
        let width = parameters.columns.len();
        let mut linear = Linear::new(width, &[floor]);
        linear.reserve(samples);
        let moments = Vec::with_capacity(samples);
        Self { linear, moments, design_noise: DMatrix::zeros(width, width) }
    }

    pub fn push<M: Model>(&mut self, parameters: &Parameters, sample: Sample) {
        let mut rows = self.linear.push(&[sample.residual]);
        let Moment { t_s, world_from_imu } = &sample.moment;
        // The mount is applied before the slip.
        let before_slip = parameters.mount_at(*t_s).inverse() * parameters.link_from_imu;
        let before_slip = before_slip.to_rotation_matrix();
        let by_mount = Matrix3::from_columns(&sample.by_mount) * before_slip.matrix();
        let by_mount = by_mount.column_iter().map(|column| column.into_owned());
        let by_delay = [sample.by_latency, sample.by_latency * sample.since_middle_s];
        let by_own = sample.by_own.iter().copied();
        rows.set_from(0, by_delay.into_iter().chain(by_mount).chain(by_own));
        for effect in &parameters.effects {
            let derivatives = match effect.block {
                Block::Mount => &sample.by_mount,
                block => {
                    let Range { start, end } = M::columns_of(block);
                    &sample.by_own[start - Parameters::WIDTH..end - Parameters::WIDTH]
                }
            };
            let weights = effect.profile.weights(*t_s, world_from_imu).into_iter();
            let products = weights.flat_map(|weight| derivatives.iter().map(move |d| d * weight));
            rows.set_from(effect.columns.start, products);
        }
        self.moments.push(sample.moment);
    }

    /// Adds noise of the link's rotation (its covariance in base) to the columns of the mount and of its slip. Noise δ
    /// contributes `Σ (δ×u)ᵀ(δ×v)` over axes u, v.
    pub fn add_mount_noise(
        &mut self,
        parameters: &Parameters,
        t_s: f64,
        base_from_imu: &Rotation,
        covariance: &Matrix3<f64>,
    ) {
        let base_from_imu = base_from_imu.to_rotation_matrix();
        let in_imu = base_from_imu.matrix().tr_mul(&(covariance * base_from_imu.matrix()));
        let noise = Matrix3::from_diagonal_element(in_imu.trace()) - in_imu;
        let slips = parameters.effects_on(Block::Mount);
        let slips = slips
            .map(|slip| (slip.columns.start, slip.profile.weights(t_s, &Rotation::identity())[0]));
        for (start, weight) in slips.chain([(Parameters::MOUNT.start, 1.0)]) {
            let mut block = self.design_noise.fixed_view_mut::<3, 3>(start, start);
            block += noise * weight;
        }
    }

    /// Adds noise of this variance to the columns of the delay.
    pub fn add_delay_noise(&mut self, since_middle_s: f64, variance: f64) {
        const LATENCY: usize = Parameters::LATENCY;
        const SKEW: usize = Parameters::SKEW;
        self.design_noise[(LATENCY, LATENCY)] += variance;
        self.design_noise[(SKEW, SKEW)] += variance * since_middle_s.powi(2);
    }
}
