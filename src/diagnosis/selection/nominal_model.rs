//! Tests whether the difference between the nominal model and a calibrated arm explains a residual.
//!
//! Lengths of real arms deviate by tenths of a millimetre, axes by hundredths of a degree, so nominal FK
//! differs from the calibrated pose by millimetres. Small changes of all link frames explain this, one or
//! two joint zeros do not (Mooring, Roth and Driels, *Fundamentals of Manipulator Calibration*, 1991, ch.
//! 3).
//!
//! Forty parameters fit better than seven on any log, so the models are compared by evidence (MacKay 1992,
//! *Bayesian Interpolation*). The calibration pays for each direction constrained beyond the prior, and for
//! large changes. The selected causes are kept unless it has the higher evidence, which it cannot if a few
//! causes reduce the residual to noise.

use crate::latency::profile::explains_excess;
use crate::model::jacobian::link_derivatives;
use crate::model::measurement::{FLOOR_M, FLOOR_RAD, Prediction, StreamAt, StreamState};
use crate::priors::{FREE_PRIOR, LINK_PRIOR_M, LINK_PRIOR_RAD, RAD_PER_M, price};
use crate::solver::linear::{Linear, ReweightedFit, Weight};
use crate::solver::noise::{Noise, rms};
use crate::solver::robust::robust_sigma;
use crate::{LatencyProfile, Measured, PiecewiseLatency};
use ground::geometry::{Pose, Vec3};
use nalgebra::{DMatrix, DVector};

/// Rms tip change by a calibration.
pub(crate) const MAX_TIP_CHANGE_M: f64 = 10e-3;
pub(crate) const MAX_TIP_CHANGE_RAD: f64 = RAD_PER_M * MAX_TIP_CHANGE_M;

/// Whether a calibration may change the tip by this much, m and rad.
pub(crate) fn is_calibratable([m, rad]: [f64; 2]) -> bool {
    m <= MAX_TIP_CHANGE_M && rad <= MAX_TIP_CHANGE_RAD
}

/// Whether a calibration may change the tip as much as this error of a frame does.
pub(crate) fn is_calibratable_frame(frame: &Pose) -> bool {
    is_calibratable([frame.translation.vector.norm(), frame.rotation.angle()])
}

/// Over the noise, of positions, or the equivalent of rotations.
const MIN_EXCESS_M: f64 = 0.3e-3;
/// Same with joint zeros, whose intervals it widens.
const MIN_EXCESS_WITH_ZEROS_M: f64 = 0.05e-3;
const MAX_SAMPLES: usize = 1000;
const FIT_ROUNDS: usize = 4;

/// Whether small changes of the link frames explain a stream better than the causes of its model. Without these causes, it
/// has only latency and large frames, and the joint zeros too large for link deviations. `dropped` is the number of
/// parameters of the causes.
pub(crate) fn is_nominal(without_causes: StreamAt, with_causes: StreamAt, dropped: usize) -> bool {
    let as_recorded = without_causes.linearize(MAX_SAMPLES);
    let [rms_m, rms_rad] = rms_of_kinds(&as_recorded.residual);
    if !is_calibratable([rms_m, rms_rad]) {
        return false;
    }
    let calibration = LinkFrameChanges::fit(without_causes);
    let square_over_noise = |kind: usize, rms: f64| {
        rms.powi(2) - 3.0 * calibration.fit.weights[kind].noise.sigma.powi(2)
    };
    let excess = square_over_noise(0, rms_m).max(square_over_noise(1, rms_rad) / RAD_PER_M.powi(2));
    let is_named = without_causes.offsets.iter().any(|offset| *offset != 0.0);
    let min_excess_m = if is_named { MIN_EXCESS_WITH_ZEROS_M } else { MIN_EXCESS_M };
    if excess < min_excess_m.powi(2) {
        return false;
    }
    let explained = with_causes.linearize(MAX_SAMPLES);
    let saved = price(calibration.frames.len() as f64) * dropped as f64;
    calibration.gain_over(&explained.weights()) + saved > calibration.price()
}

/// Whether the unsteady latency `profile` is likelier than a constant one and explains most of the residual, both beside link
/// deviations. Slow motion hides large latency changes, and link deviations resemble one there. `None` if the residual is
/// too large for link deviations.
///
/// `state` excludes causes that calibrations explain. It refers to stamps without `removed`.
pub(crate) fn is_unsteady_beside_links(
    StreamAt { observations, state, offsets }: StreamAt,
    profile: &LatencyProfile,
    removed: Option<&PiecewiseLatency>,
) -> Option<bool> {
    let logged_s = |t_s: f64| removed.map_or(t_s, |ramp| ramp.logged_s(t_s));
    let logged = observations.with_stamps(logged_s);
    let steady = observations.with_stamps(|t_s| logged_s(t_s) - profile.levels.at(logged_s(t_s)));
    let as_logged = logged.at(state, offsets).linearize(MAX_SAMPLES);
    if !is_calibratable(rms_of_kinds(&as_logged.residual)) {
        return None;
    }
    // The constant latency absorbs the pivot of the skew.
    let mut steady_state = StreamState { skew: profile.skew, ..state.clone() };
    for _ in 0..2 {
        steady_state.latency_s +=
            steady.at(&steady_state, offsets).residual_at_latency(MAX_SAMPLES).1;
    }
    let constant = LinkFrameChanges::fit(logged.at(state, offsets));
    let unsteady = LinkFrameChanges::fit(steady.at(&steady_state, offsets));
    let price = price(unsteady.frames.len() as f64) * profile.parameters as f64;
    let excess = |changes: &LinkFrameChanges| {
        [(0, FLOOR_M), (1, FLOOR_RAD)].map(|(kind, floor): (usize, f64)| {
            let Noise { sigma, share, .. } = unsteady.fit.weights[kind].noise;
            let white = (sigma.powi(2) * (1.0 - share)).max(floor * floor);
            (changes.fit.weights[kind].noise.sigma.powi(2) / white - 1.0).max(0.0)
        })
    };
    let is_likelier = unsteady.gain_over(&constant.fit.weights) > price;
    Some(is_likelier && explains_excess(excess(&constant), excess(&unsteady)))
}

/// Noise of positions and rotations beside the likeliest link deviations, m and rad, and the sum of the squares of these,
/// relative to their prior.
pub(crate) fn noise_beside_links(stream: StreamAt) -> (Vec<f64>, f64) {
    let LinkFrameChanges { fit, usual, .. } = LinkFrameChanges::fit(stream);
    let constrained = fit.step.iter().zip(&usual).filter(|(_, usual)| **usual != FREE_PRIOR);
    let squares = constrained.map(|(step, usual)| (step / usual).powi(2)).sum();
    (fit.weights.iter().map(|weight| weight.noise.sigma).collect(), squares)
}

/// Latency and clock skew of a stream beside link deviations.
#[derive(Clone, Copy)]
pub(crate) struct Timing {
    pub latency_s: Measured,
    /// `None` if it is not free.
    pub skew: Option<Measured>,
    /// Whether the skew is likelier than none.
    pub is_skewed: bool,
}

pub(crate) fn timing_beside_link_deviations(stream: StreamAt, has_skew: bool) -> Option<Timing> {
    let StreamAt { observations, state, .. } = stream;
    let free = if has_skew { FreeAlongside::Skew } else { FreeAlongside::Nothing };
    let changes = LinkFrameChanges::fit_with(stream, free, LINK_PRIOR_M);
    let covariance = changes.covariance()?;
    let fit = changes.fit;
    let dof = (fit.normal.independent - fit.step.len() as f64).max(1.0);
    let measured = |column: usize, before: f64| Measured {
        value: before + fit.step[column],
        std_error: covariance[(column, column)].sqrt(),
        dof,
    };
    let latency = 6 * (observations.columns.len() + 1);
    let skew = latency + 1;
    let is_likelier =
        || fit.step[skew].powi(2) / covariance[(skew, skew)] > price(fit.normal.independent);
    Some(Timing {
        latency_s: measured(latency, state.latency_s),
        skew: has_skew.then(|| measured(skew, state.skew)),
        is_skewed: has_skew && is_likelier(),
    })
}

/// Rms of positions, m, and rotations, rad.
pub(crate) fn rms_of_kinds(residuals: &[Vec<Vec3>]) -> [f64; 2] {
    [0, 1].map(|kind| rms(&residuals[kind]))
}

/// Maximum a posteriori changes of link frames.
struct LinkFrameChanges {
    /// The samples, with the residuals after the changes.
    frames: Linear,
    /// Changes in the order of [`link_frames`], with their priors in the normal equations.
    fit: ReweightedFit,
    /// Standard deviations of the prior.
    usual: Vec<f64>,
}

/// Residuals after the likeliest link frame changes, m and rad, for up to `most` covered samples. The links deviate by about
/// `link_m`.
pub(crate) fn calibrated_residuals(
    stream: StreamAt,
    link_m: Option<f64>,
    most: usize,
) -> Vec<Vec<Vec3>> {
    let link_m = link_m.map_or(LINK_PRIOR_M, |link_m| link_m.max(LINK_PRIOR_M));
    let fit = LinkFrameChanges::fit_with(stream, FreeAlongside::Nothing, link_m).fit;
    let frames = link_frames(stream, stream.observations.rows(most), FreeAlongside::Nothing);
    frames.residuals_after(fit.step.as_slice())
}

impl LinkFrameChanges {
    fn fit(stream: StreamAt) -> Self {
        Self::fit_with(stream, FreeAlongside::Nothing, LINK_PRIOR_M)
    }

    /// With further parameters, and link deviations of about `link_m`.
    fn fit_with(stream: StreamAt, with: FreeAlongside, link_m: f64) -> Self {
        let mut frames = link_frames(stream, stream.observations.rows(MAX_SAMPLES), with);
        // Wide for those free without a calibration, such as an undeclared tool.
        let usual = |i: usize| match i % 6 {
            _ if is_free_parameter(i, stream) => FREE_PRIOR,
            0..3 => link_m,
            _ => LINK_PRIOR_RAD * link_m / LINK_PRIOR_M,
        };
        let usual: Vec<f64> = (0..frames.width).map(usual).collect();
        let fit = frames.reweighted_fit(FIT_ROUNDS, |normal| {
            for (i, usual) in usual.iter().enumerate() {
                normal.matrix[(i, i)] += usual.powi(-2);
            }
            normal.full_step()
        });
        frames.residual.clone_from(&fit.residuals);
        Self { frames, fit, usual }
    }

    /// Sandwich covariance with the prior: noise may depend on the motion, as that of delays that scatter does.
    fn covariance(&self) -> Option<DMatrix<f64>> {
        let [information, scores] = self.frames.covariance_parts(&self.fit.weights);
        let precisions = self.usual.iter().map(|usual| usual.powi(-2));
        let prior = DMatrix::from_diagonal(&DVector::from_iterator(self.usual.len(), precisions));
        let inverse = (information + &prior).cholesky()?.inverse();
        Some(&inverse * (scores + prior) * &inverse)
    }

    /// Complexity penalty with deviations of the likeliest size (MacKay 1992).
    fn price(&self) -> f64 {
        /// Of the usual deviations.
        const SIZES: [f64; 5] = [1.0, 0.5, 0.25, 0.125, 0.0625];
        SIZES.map(|size| self.price_at(size)).into_iter().fold(f64::INFINITY, f64::min)
    }

    /// For deviations of `size` times the usual ones, the sum of: the squared changes in prior standard deviations; the log
    /// determinant of posterior over prior precision, except for free parameters; the increase of the residual's cost.
    fn price_at(&self, size: f64) -> f64 {
        let Self { fit: ReweightedFit { step, normal: fitted, .. }, usual, .. } = self;
        let all: Vec<usize> = (0..usual.len()).collect();
        let (free, constrained): (Vec<usize>, Vec<usize>) =
            all.iter().partition(|&&i| usual[i] == FREE_PRIOR);
        let mut normal = fitted.clone();
        let mut sizes = usual.clone();
        for &i in &constrained {
            sizes[i] *= size;
            normal.matrix[(i, i)] += sizes[i].powi(-2) - usual[i].powi(-2);
        }
        let narrowing = |chosen: &[usize]| -> f64 {
            let at = |i: usize, j: usize| normal.matrix[(i, j)] * sizes[i] * sizes[j];
            let n = chosen.len();
            let precision = DMatrix::from_fn(n, n, |i, j| at(chosen[i], chosen[j]));
            // 1 is the prior; smaller values are rounding.
            precision.symmetric_eigenvalues().iter().map(|value| value.max(1.0).ln()).sum()
        };
        let squares: f64 = constrained.iter().map(|&i| (step[i] / usual[i]).powi(2)).sum();
        let least_cost = fitted.cost_after(step) - squares;
        let cost = normal.cost_after(&normal.full_step());
        cost - least_cost + narrowing(&all) - narrowing(&free)
    }

    /// Twice the log likelihood ratio to a fit with weights `without_change`, both with this fit's noise
    /// correlation, which is closer to the truth.
    fn gain_over(&self, without_change: &[Weight]) -> f64 {
        let gains = self.fit.weights.iter().zip(without_change).map(|(weight, other)| {
            let independent = weight.noise.independent(self.frames.len());
            2.0 * independent * (other.noise.sigma / weight.noise.sigma).ln()
        });
        gains.sum()
    }
}

/// Whether parameter `i` of [`link_frames`] is free regardless of the nominal model.
pub(crate) fn is_free_parameter(i: usize, StreamAt { observations, state, .. }: StreamAt) -> bool {
    let joints = observations.columns.len();
    match i / 6 {
        0 => !observations.reference_known || state.reference != Pose::identity(),
        link if link == joints => state.tool != Pose::identity(),
        link => link > joints,
    }
}

/// Parameters besides link frames and latency.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum FreeAlongside {
    Nothing,
    Skew,
    /// Every joint zero of the chain.
    Zeros,
    ZerosAndRadialScale,
}

/// Linearises samples. Columns: six changes each for the reference and every
/// joint's child link frame, the latency, then the parameters in `with`. The noise includes the error of the linearisation
/// if the changes explain the residual.
pub(crate) fn link_frames(
    stream: StreamAt,
    rows: impl Iterator<Item = usize>,
    with: FreeAlongside,
) -> Linear {
    let StreamAt { observations, state, .. } = stream;
    let joints = observations.columns.len();
    let width = 6 * (joints + 1)
        + match with {
            FreeAlongside::Nothing => 1,
            FreeAlongside::Skew => 2,
            FreeAlongside::Zeros => joints + 1,
            FreeAlongside::ZerosAndRadialScale => joints + 2,
        };
    let mut linear = Linear::new(width, &[FLOOR_M, FLOOR_RAD]);
    let mut predictor = stream.predictor();
    let (mut links, mut derivatives) = (Vec::new(), Vec::with_capacity(width));
    for k in rows {
        let Some(Prediction { jacobian, q, qd, .. }) = predictor.at(k) else { continue };
        observations.chain.joint_frames(q, &mut links);
        let tip = jacobian.pose.translation.vector;
        let frames = links.iter().map(|link| state.reference * link);
        derivatives.clear();
        for frame in [state.reference].into_iter().chain(frames) {
            derivatives.extend(link_derivatives(&frame, &tip));
        }
        let late = jacobian.velocity(qd).map(|part| -part);
        derivatives.push(late);
        match with {
            FreeAlongside::Nothing => {}
            FreeAlongside::Skew => {
                let from_middle_s = observations.t_s[k] - observations.middle_s;
                derivatives.push(late.map(|part| from_middle_s * part));
            }
            FreeAlongside::Zeros | FreeAlongside::ZerosAndRadialScale => {
                derivatives.extend((0..joints).map(|joint| jacobian.joint(joint)));
            }
        }
        if with == FreeAlongside::ZerosAndRadialScale {
            let from_base = tip - state.reference.translation.vector;
            derivatives.push([from_base, Vec3::zeros()]);
        }
        let mut rows = linear.push(&observations.residual(k, &jacobian.pose));
        for (column, derivative) in derivatives.iter().enumerate() {
            rows.set_all(column, observations.excluded.mask(*derivative));
        }
    }
    // Its terms are products of a rotation and a displacement, or of two rotations.
    let [shift_m, turn_rad] = [0, 1].map(|kind| robust_sigma(&linear.residual[kind]));
    let turn_rad = turn_rad.max(shift_m / observations.chain.max_reach_m().max(shift_m));
    linear.raise_floors(&[turn_rad * shift_m, turn_rad.powi(2)]);
    linear
}
