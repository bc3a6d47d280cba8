//! Latency profile of a stream over the run: steady, in steps, a ramp, with load, or wandering.
//!
//! An additional latency L shifts the corrected stream against FK by −L times its velocity. In each window, position
//! and rotation residuals are fitted jointly by `c − L·v`. The constant `c` absorbs model error, which changes slowly
//! with the configuration. The likeliest shape of L wins ([`shapes`]). Its effect is nonlinear, so FK is evaluated again at
//! the compensated times, and the shape is fitted to the remaining residuals.

mod shapes;

/// Weighted mean, with a standard error scaled by the scatter.
pub(crate) fn mean<'a>(windows: impl Iterator<Item = &'a (f64, Measured)>) -> Option<Measured> {
    const MIN_STD_ERROR_S: f64 = 2e-5;
    let windows: Vec<&Measured> = windows.map(|(_, measured)| measured).collect();
    let weight: f64 = windows.iter().map(|one| one.std_error.powi(-2)).sum();
    if windows.len() < 2 || !weight.is_finite() {
        return None;
    }
    let value = windows.iter().map(|one| one.value * one.std_error.powi(-2)).sum::<f64>() / weight;
    let chi2: f64 = windows.iter().map(|one| ((one.value - value) / one.std_error).powi(2)).sum();
    let birge = (chi2 / (windows.len() as f64 - 1.0)).max(1.0).sqrt();
    let std_error = (birge / weight.sqrt()).max(MIN_STD_ERROR_S);
    Some(Measured { value, std_error, dof: windows.len() as f64 })
}

#[cfg(test)]
mod tests;
mod windows;

use crate::samples::sampling::{monotonic_rows, value_range};
use crate::{AlignedSamples, EstimateResult, Measured, NotObservable, PiecewiseLatency};
use ground::geometry::{Pose, Vec3};
use ground::stats::{highest, lowest, median_of};
use nalgebra::Vector6;
use shapes::{Basis, Fit, likeliest_shape, middle_s};
use windows::{Window, noise, normalized, windows};

/// Kind of latency profile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum LatencyShape {
    /// Constant.
    #[default]
    Steady,
    /// Steps between constant levels.
    Steps,
    /// Ramp between two levels. Times are in s from the run's origin.
    Ramp {
        /// Start of the ramp.
        from_s: f64,
        /// End of the ramp.
        to_s: f64,
    },
    /// Rises and falls.
    Wander,
    /// Grows with the speed of the arm.
    WithLoad,
}

/// Latency profile of a stream. Latencies are relative to the stream's estimated latency, in s; times are
/// in s from the run's origin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatencyProfile {
    /// Size of the variation, s: signed for steps (largest) and ramps; range if it wanders or depends on
    /// load; scatter beyond chance if steady.
    pub swing_s: Measured,
    /// Whether the variation is significant.
    pub is_unsteady: bool,
    /// Kind of profile.
    pub shape: LatencyShape,
    /// Clock skew in addition to a latency that grows with the speed. Other kinds include it in their levels.
    pub skew: f64,
    /// In time order. Empty for other kinds.
    pub steps: Vec<LatencyStep>,
    /// Over time. If unsteady, relative to the latency estimated after compensation.
    pub levels: PiecewiseLatency,
    /// Time and latency of each window.
    pub windows: Vec<(f64, Measured)>,
    /// Number of parameters beyond a constant latency and a skew.
    pub parameters: usize,
}

/// Sudden, lasting change of latency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyStep {
    /// Time, s from the run's origin.
    pub at_s: f64,
    /// Size, s. Positive if the latency increases.
    pub size_s: Measured,
}

/// Size of the largest step.
pub(crate) fn largest(steps: &[LatencyStep]) -> Option<Measured> {
    Some(highest(steps, |step| step.size_s.value.abs())?.size_s)
}

impl LatencyProfile {
    fn from_fit(fit: &Fit, windows: &[Window]) -> Self {
        let (levels_s, covariance) = (&fit.levels_s, fit.covariance());
        let measured = |value, variance: f64| Measured {
            value,
            std_error: variance.max(0.0).sqrt(),
            dof: windows.len() as f64,
        };
        // Sizes are differences of levels.
        let size_s = |from: usize, to: usize| {
            let variances = covariance[(from, from)] + covariance[(to, to)];
            measured(levels_s[to] - levels_s[from], variances - 2.0 * covariance[(from, to)])
        };
        let bins_s = windows.iter().flat_map(|window| &window.bins).map(|bin| bin.t_s);
        let steady = steady_profile(windows);
        let (mut steps, mut skew) = (Vec::new(), 0.0);
        let (shape, swing_s, levels) = match &fit.basis {
            Basis::Line(_) => return steady,
            Basis::Steps(times_s) => {
                let sizes_s = (1..levels_s.len()).map(|level| size_s(level - 1, level));
                let both = times_s.iter().zip(sizes_s);
                steps = both.map(|(&at_s, size_s)| LatencyStep { at_s, size_s }).collect();
                let starts_s = std::iter::once(f64::NEG_INFINITY).chain(times_s.iter().copied());
                let levels: Vec<(f64, f64)> = starts_s.zip(levels_s.iter().copied()).collect();
                let swing_s = largest(&steps).unwrap_or(size_s(0, 0));
                (LatencyShape::Steps, swing_s, PiecewiseLatency::with_steps(&levels))
            }
            Basis::Ramp(times_s) => {
                let knots = times_s.iter().copied().zip(levels_s.iter().copied()).collect();
                let shape = LatencyShape::Ramp { from_s: times_s[0], to_s: times_s[1] };
                (shape, size_s(0, 1), PiecewiseLatency { knots })
            }
            Basis::Spline(_) => {
                let level = |(at, t_s): (usize, f64)| (t_s, fit.basis.latency_s(levels_s, at, t_s));
                let knots: Vec<(f64, f64)> = bins_s.enumerate().map(level).collect();
                let value = value_range(knots.iter().map(|knot| knot.1));
                let swing_s = Measured { value, ..size_s(levels_s.imin(), levels_s.imax()) };
                (LatencyShape::Wander, swing_s, PiecewiseLatency { knots })
            }
            Basis::Load(load, _) => {
                skew = levels_s[2];
                let level = |load: &f64| levels_s[0] + levels_s[1] * load;
                let knots = bins_s.zip(load.iter().map(level)).collect();
                let slope = measured(levels_s[1], covariance[(1, 1)]);
                let swing_s = slope.scaled(value_range(load.iter().copied()));
                (LatencyShape::WithLoad, swing_s, PiecewiseLatency { knots })
            }
        };
        let parameters = fit.basis.parameters();
        Self { swing_s, is_unsteady: true, shape, skew, steps, levels, parameters, ..steady }
    }

    /// With the steps that remain at compensated stamps. `None` if one of them has another shape.
    pub(crate) fn with_further_steps(&self, further: &Self) -> Option<Self> {
        /// Closer ones are one step.
        const MIN_SEPARATION_S: f64 = 1.0;
        let (start, start_of_further) = (self.levels.knots.first()?, further.levels.knots.first()?);
        if self.steps.is_empty() || further.steps.is_empty() {
            return None;
        }
        let mut steps = self.steps.clone();
        for step in &further.steps {
            let apart_s = |it: &LatencyStep| (it.at_s - step.at_s).abs();
            let near = lowest(&mut steps, |it| apart_s(it));
            match near.filter(|near| apart_s(near) < MIN_SEPARATION_S) {
                Some(near) => {
                    let value = near.size_s.value + step.size_s.value;
                    near.size_s = Measured { value, ..step.size_s };
                }
                None => steps.push(*step),
            }
        }
        steps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let mut level_s = start.1 + start_of_further.1;
        let mut levels = vec![(f64::NEG_INFINITY, level_s)];
        for step in &steps {
            level_s += step.size_s.value;
            levels.push((step.at_s, level_s));
        }
        let swing_s = largest(&steps)?;
        let levels = PiecewiseLatency::with_steps(&levels);
        Some(Self { swing_s, steps, levels, ..self.clone() })
    }

    /// Stamps compensated for the deviation from the median level, each with its row. Drops rows that would
    /// be out of order.
    pub fn compensated(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        let usual = self.typical_s(t_s);
        let straight = |t_s: &f64| t_s - (self.levels.at(*t_s) - usual);
        monotonic_rows(t_s.iter().map(straight).enumerate())
    }

    /// Median level at the stamps, s.
    pub fn typical_s(&self, t_s: &[f64]) -> f64 {
        median_of(t_s.iter().map(|&t_s| self.levels.at(t_s))).unwrap_or(0.0)
    }

    /// Makes the levels relative to the median at the stamps.
    pub(crate) fn relative_to_typical(mut self, t_s: &[f64]) -> Self {
        let usual_s = self.typical_s(t_s);
        self.levels.knots.iter_mut().for_each(|(_, level_s)| *level_s -= usual_s);
        self
    }
}

/// Corrected residual at one stamp, and the true velocity. Up to two kinds of vectors, such as position and
/// rotation; a missing kind is zero. Normalised ones are in units of the noise of each kind.
#[derive(Clone, Copy)]
pub(crate) struct LatencySample {
    /// s from the run's origin.
    pub t_s: f64,
    pub residual: Vector6<f64>,
    pub velocity: Vector6<f64>,
    /// Joint speed, rad/s, and tool speed, m/s, on which the latency may depend. 0 disables the test.
    pub loads: [f64; 2],
    /// Standard deviation of a component of the last kind caused by joint noise. 0 if unknown.
    pub joint_noise: f64,
}

/// One vector of both kinds.
pub(crate) fn stacked([first, last]: [Vec3; 2]) -> Vector6<f64> {
    Vector6::new(first.x, first.y, first.z, last.x, last.y, last.z)
}

/// Latency profile of `aligned` samples, which are compensated for `skew` and the gradual latency `removed_ramp`.
/// `speed` returns the joint speed at the time of measurement, rad/s, and `fk_at` FK at the times of measurement if the
/// stamps of the samples are later by this latency.
pub(crate) fn latency_profile(
    aligned: &AlignedSamples,
    skew: f64,
    removed_ramp: Option<&PiecewiseLatency>,
    speed: impl Fn(f64) -> f64,
    fk_at: impl Fn(&dyn Fn(f64) -> f64) -> Option<Vec<Option<Pose>>>,
) -> EstimateResult<LatencyProfile> {
    let samples = latency_samples(aligned, speed);
    let samples_at = |late_s: &dyn Fn(f64) -> f64| {
        let fk = fk_at(late_s)?;
        let shifted = samples.iter().zip(1..).filter_map(|(sample, row): (_, usize)| {
            let measured_s = sample.t_s - late_s(sample.t_s);
            let then = samples.partition_point(|it| it.t_s < measured_s).min(samples.len() - 1);
            let LatencySample { velocity, loads, .. } = samples[then];
            let residual = stacked(aligned.residual(row, fk[row].as_ref()?));
            Some(LatencySample { residual, velocity, loads, ..*sample })
        });
        Some(shifted.collect())
    };
    fit_profile(&samples, 2, skew, removed_ramp, samples_at)
}

/// The same for residuals of this many kinds. `samples_at` compensates an additional latency.
pub(crate) fn fit_profile(
    latency_samples: &[LatencySample],
    kinds: usize,
    skew: f64,
    removed_ramp: Option<&PiecewiseLatency>,
    samples_at: impl Fn(&dyn Fn(f64) -> f64) -> Option<Vec<LatencySample>>,
) -> EstimateResult<LatencyProfile> {
    /// Of precise windows.
    const MIN_WINDOWS: usize = 4;
    /// Usual delays of drivers are 1 to 2 ms.
    const MAX_STD_ERROR_S: f64 = 2e-3;
    const GAUSS_NEWTON_STEPS: usize = 2;
    let logged_s = |t_s: f64| removed_ramp.map_or(t_s, |ramp| ramp.logged_s(t_s));
    let (Some(first), Some(last)) = (latency_samples.first(), latency_samples.last()) else {
        return Err(NotObservable::AtRest);
    };
    let removed = SkewedLatency {
        levels: removed_ramp.cloned().unwrap_or_default(),
        skew,
        middle_s: 0.5 * (logged_s(first.t_s) + logged_s(last.t_s)),
    };
    let normalized = |samples: &[LatencySample], noise| normalized(samples, noise, logged_s);
    let windows_of = |samples: &[LatencySample], compensated: &SkewedLatency| {
        windows(&normalized(samples, noise(samples)), 3 * kinds, |t_s| compensated.at(t_s))
    };
    let windows = windows_of(latency_samples, &removed);
    if windows.is_empty() {
        return Err(NotObservable::AtRest);
    }
    let is_precise = |window: &&Window| window.latency_s.std_error < MAX_STD_ERROR_S;
    if windows.iter().filter(is_precise).count() < MIN_WINDOWS {
        return Err(NotObservable::NotExcited);
    }
    let (mut profile, mut latency) = likeliest_profile(&windows)?;
    let (mut samples, mut compensated) = (latency_samples.to_vec(), removed.clone());
    for _ in 0..GAUSS_NEWTON_STEPS {
        let beyond_s = |t_s: f64| latency.at(logged_s(t_s)) - removed.at(logged_s(t_s));
        let shifted = if profile.is_unsteady { samples_at(&beyond_s) } else { None };
        let Some(shifted) = shifted else { break };
        (samples, compensated) = (shifted, latency);
        (profile, latency) = likeliest_profile(&windows_of(&samples, &compensated))?;
    }
    if !profile.is_unsteady {
        return Ok(profile);
    }
    // Latency that remains in the samples, without and with the profile.
    let mean_s = mean(profile.windows.iter()).map_or(0.0, |mean| mean.value);
    let without_s = |t_s: f64| match removed_ramp {
        Some(_) => mean_s - removed.at(t_s),
        None => 0.0,
    };
    let with_s = |t_s: f64| latency.at(t_s) - compensated.at(t_s);
    let noise = noise(&samples);
    let [before, after] = [latency_samples, &samples].map(|samples| normalized(samples, noise));
    profile.is_unsteady = explains_excess(excess(&before, without_s), excess(&after, with_s));
    Ok(profile)
}

/// A latency with a skew about the middle of the run.
#[derive(Clone)]
struct SkewedLatency {
    levels: PiecewiseLatency,
    skew: f64,
    middle_s: f64,
}

impl SkewedLatency {
    fn at(&self, t_s: f64) -> f64 {
        self.levels.at(t_s) + self.skew * (t_s - self.middle_s)
    }
}

fn likeliest_profile(windows: &[Window]) -> EstimateResult<(LatencyProfile, SkewedLatency)> {
    let fit = likeliest_shape(windows).ok_or(NotObservable::NotExcited)?;
    let profile = LatencyProfile::from_fit(&fit, windows);
    let (levels, skew) = (profile.levels.clone(), profile.skew);
    Ok((profile, SkewedLatency { levels, skew, middle_s: middle_s(windows) }))
}

/// Squared residual of each kind beyond the noise, which is 1, if this latency remains at a stamp of samples.
fn excess(samples: &[LatencySample], remaining_s: impl Fn(f64) -> f64) -> [f64; 2] {
    [0, 1].map(|kind| {
        let squares = samples.iter().map(|sample| {
            let residual = sample.residual + remaining_s(sample.t_s) * sample.velocity;
            residual.fixed_rows::<3>(3 * kind).norm_squared()
        });
        (squares.sum::<f64>() / (3.0 * samples.len() as f64) - 1.0).max(0.0)
    })
}

/// Whether the excess residual falls to less than half, and increases neither for positions nor for rotations. A model error
/// may imitate latency in one kind, not in both. The excess is a squared residual relative to the squared noise.
pub(crate) fn explains_excess(before: [f64; 2], after: [f64; 2]) -> bool {
    const MAX_RATIO: f64 = 0.5;
    /// Relative to the noise.
    const TOLERANCE: f64 = 0.1;
    let sum = |excess: [f64; 2]| excess[0] + excess[1];
    let is_no_worse = (0..2).all(|kind| after[kind] <= before[kind] + TOLERANCE);
    is_no_worse && sum(before) > TOLERANCE && sum(after) < MAX_RATIO * sum(before)
}

fn latency_samples(aligned: &AlignedSamples, speed: impl Fn(f64) -> f64) -> Vec<LatencySample> {
    let t = &aligned.t_s;
    let rows = 1..t.len().saturating_sub(1);
    rows.map(|k| {
        let speed = speed(t[k]);
        // The noise of joints at rest is no velocity.
        let velocity = match speed > 0.0 || !aligned.frame_from_base.is_empty() {
            true => aligned.velocity(k),
            false => [Vec3::zeros(); 2],
        };
        LatencySample {
            t_s: t[k],
            residual: stacked(aligned.residual(k, &aligned.fk_at_truth[k])),
            velocity: stacked(velocity),
            loads: [speed, velocity[0].norm()],
            joint_noise: 0.0,
        }
    })
    .collect()
}

fn steady_profile(windows: &[Window]) -> LatencyProfile {
    let measured = measured(windows);
    let count = measured.len().max(1) as f64;
    let mean_s = mean(measured.iter()).map_or(0.0, |mean| mean.value);
    let excess = measured.iter().map(|(_, w)| (w.value - mean_s).powi(2) - w.std_error.powi(2));
    // Inflate the error by excess scatter (Birge 1932).
    let scatter = (excess.sum::<f64>() / count).max(0.0).sqrt();
    let std_error = typical_std_error_s(windows).hypot(scatter);
    let swing_s = Measured { value: scatter, std_error, dof: count };
    LatencyProfile { swing_s, windows: measured, ..LatencyProfile::default() }
}

/// Windows in which the latency is about as certain as usual.
fn measured(windows: &[Window]) -> Vec<(f64, Measured)> {
    /// Relative to the typical standard error.
    const MAX_STD_ERROR_RATIO: f64 = 5.0;
    let max_s = MAX_STD_ERROR_RATIO * typical_std_error_s(windows);
    let certain = windows.iter().filter(|window| window.latency_s.std_error < max_s);
    certain.map(|window| (window.t_s, window.latency_s)).collect()
}

fn typical_std_error_s(windows: &[Window]) -> f64 {
    median_of(windows.iter().map(|window| window.latency_s.std_error)).unwrap_or(0.0)
}
