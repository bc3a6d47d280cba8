//! Latency profile of a stream over the run: steady, in steps, or wandering.
//!
//! An additional latency of δ shifts the corrected stream against FK by −δ times its velocity. In each
//! window, position and rotation residuals are fitted jointly by `c − δ·v`. The constant `c` absorbs model
//! error, which changes slowly with the configuration.

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

use crate::samples::sampling::monotonic_rows;
use crate::{AlignedSamples, EstimateResult, LatencyRamp, Measured, NotObservable};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use shapes::{
    THREE_SEGMENT_PARAMETERS, fit_load_dependence, fit_piecewise_linear, levels_at, piecewise_chi2,
    residual_after,
};
use windows::{LatencyWindow, NormalizedSample, chi2_of_line, levels, samples, splits, windows};

const WINDOW_S: f64 = 1.0;
const MIN_WINDOW_SAMPLES: usize = 10;
const MIN_WINDOWS: usize = 4;
/// Windows with larger standard errors, relative to the typical one, are ignored. The second value applies
/// after compensating a gradual latency estimated from speeds alone.
const MAX_STD_ERROR_RATIO: [f64; 2] = [5.0, 100.0];
const MAX_STEPS: usize = 4;
/// Per latency step, in units of the remaining χ² per window.
const MIN_CHI2_GAIN: f64 = 40.0;
/// For a significant swing.
const MIN_STD_ERRORS: f64 = 6.0;
/// A simpler profile is preferred if it explains all but this fraction of what the best one does. The
/// second value applies after compensating a gradual latency.
const MAX_EXTRA_RESIDUAL: [f64; 2] = [0.03, 0.002];
/// χ² per window of an unsteady latency.
const MIN_UNSTEADY_CHI2: f64 = 9.0;

/// Kind of latency profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LatencyShape {
    /// Constant.
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
#[derive(Clone, Debug, PartialEq)]
pub struct LatencyProfile {
    /// Size of the variation, s: signed for steps (largest) and ramps; range if it wanders or depends on
    /// load; scatter beyond chance if steady.
    pub swing_s: Measured,
    /// Whether the variation is significant.
    pub is_unsteady: bool,
    /// Kind of profile.
    pub shape: LatencyShape,
    /// In time order. Empty for other kinds.
    pub steps: Vec<LatencyStep>,
    /// Time and latency. Constant from each time on if there are steps, else linear in between. If
    /// unsteady, relative to the latency estimated after compensation.
    pub levels: Vec<(f64, f64)>,
    /// Time and latency of each window.
    pub windows: Vec<(f64, Measured)>,
}

/// Sudden, lasting change of latency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyStep {
    /// Time, s from the run's origin.
    pub at_s: f64,
    /// Size, s. Positive if the latency increases.
    pub size_s: Measured,
}

impl LatencyProfile {
    /// Profile with steps between `levels`. `None` without a step.
    pub(crate) fn from_steps(
        jumps: Vec<LatencyStep>,
        levels: Vec<(f64, f64)>,
        windows: Vec<(f64, Measured)>,
    ) -> Option<Self> {
        let size = |jump: &LatencyStep| jump.size_s.value.abs();
        let swing_s = jumps.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?.size_s;
        Some(Self {
            swing_s,
            is_unsteady: true,
            shape: LatencyShape::Steps,
            steps: jumps,
            levels,
            windows,
        })
    }

    /// Adds steps that were estimated after compensating those of this profile. They refine steps at the same time.
    /// `None` if this profile has no steps.
    pub(crate) fn with_further_steps(self, further: &Self) -> Option<Self> {
        /// In addition to the compensation, which shifts the stamps.
        const MAX_TIME_DIFFERENCE_S: f64 = 0.5;
        let mut steps = Some(self.steps).filter(|steps| !steps.is_empty())?;
        for step in &further.steps {
            let is_same = |own: &&mut LatencyStep| {
                let shift_s = own.size_s.value.abs() + MAX_TIME_DIFFERENCE_S;
                (own.at_s - step.at_s).abs() < shift_s
            };
            match steps.iter_mut().find(is_same) {
                Some(own) => {
                    let value = own.size_s.value + step.size_s.value;
                    own.size_s = Measured { value, ..step.size_s };
                }
                None => steps.push(*step),
            }
        }
        steps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let (start_s, first_s) = *self.levels.first()?;
        let mut level_s = first_s + further.levels.first()?.1;
        let mut levels = vec![(start_s, level_s)];
        levels.extend(steps.iter().map(|step| {
            level_s += step.size_s.value;
            (step.at_s, level_s)
        }));
        Self::from_steps(steps, levels, self.windows)
    }

    /// Stamps compensated for the deviation from the median level, each with its row. Drops rows that would
    /// be out of order.
    pub fn compensated(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        let usual = self.typical_s(t_s);
        let straight = |t_s: &f64| t_s - (self.relative_s(*t_s) - usual);
        monotonic_rows(t_s.iter().map(straight).enumerate())
    }

    /// Median level at the stamps, s.
    pub fn typical_s(&self, t_s: &[f64]) -> f64 {
        let mut latencies: Vec<f64> = t_s.iter().map(|&t_s| self.relative_s(t_s)).collect();
        latencies.sort_by(f64::total_cmp);
        latencies.get(latencies.len() / 2).copied().unwrap_or(0.0)
    }

    /// Makes the levels relative to the median at the stamps.
    pub(crate) fn relative_to_typical(mut self, t_s: &[f64]) -> Self {
        let usual_s = self.typical_s(t_s);
        self.levels.iter_mut().for_each(|(_, level_s)| *level_s -= usual_s);
        self
    }

    /// Adds the profile that remains after compensating this one. Not for steps.
    pub(crate) fn combined_with(mut self, rest: &Self) -> Self {
        let added: Option<Vec<f64>> = match self.shape {
            LatencyShape::WithLoad if rest.shape == self.shape && rest.is_unsteady => {
                Some(self.levels.iter().map(|(t_s, _)| rest.relative_s(*t_s)).collect())
            }
            LatencyShape::Ramp { .. } | LatencyShape::Wander => {
                let knots: Vec<f64> = self.levels.iter().map(|(t_s, _)| *t_s).collect();
                levels_at(&knots, &rest.windows)
            }
            _ => None,
        };
        let Some(added) = added else { return self };
        let sign = self.swing_s.value.signum();
        self.levels.iter_mut().zip(added).for_each(|((_, level_s), added_s)| *level_s += added_s);
        let levels = || self.levels.iter().map(|level| level.1);
        let (min_s, max_s) = (levels().fold(f64::MAX, f64::min), levels().fold(f64::MIN, f64::max));
        let std_error = match self.shape {
            LatencyShape::WithLoad => rest.swing_s.std_error,
            _ => self.swing_s.std_error,
        };
        let range = Measured { value: sign * (max_s - min_s), std_error, ..self.swing_s };
        self.swing_s = self.between_levels(rest).unwrap_or(range);
        self
    }

    /// Size of a ramp from the levels before and after it, which are more accurate than its ends.
    fn between_levels(&self, rest: &Self) -> Option<Measured> {
        let LatencyShape::Ramp { from_s, to_s } = self.shape else { return None };
        let level = |is_on_side: &dyn Fn(f64) -> bool| {
            let windows = rest.windows.iter().filter(|(t_s, _)| is_on_side(*t_s));
            let levels: Vec<(f64, Measured)> = windows
                .map(|(t_s, rest)| {
                    (*t_s, Measured { value: rest.value + self.relative_s(*t_s), ..*rest })
                })
                .collect();
            mean(levels.iter())
        };
        let before = level(&|t_s| t_s < from_s - 0.5 * WINDOW_S)?;
        let after = level(&|t_s| t_s > to_s + 0.5 * WINDOW_S)?;
        Some(Measured {
            value: after.value - before.value,
            std_error: before.std_error.hypot(after.std_error),
            dof: before.dof + after.dof,
        })
    }

    /// Number of parameters without the constant.
    pub(crate) fn parameters(&self) -> usize {
        match self.shape {
            LatencyShape::Steady => 0,
            // Time and size of each step.
            LatencyShape::Steps => 2 * self.steps.len(),
            // Start, end and size.
            LatencyShape::Ramp { .. } => 3,
            LatencyShape::Wander => self.levels.len(),
            // Latency per unit of speed.
            LatencyShape::WithLoad => 1,
        }
    }

    /// Latency at a stamp, s.
    pub(crate) fn relative_s(&self, t_s: f64) -> f64 {
        let after = self.levels.partition_point(|(from_s, _)| *from_s <= t_s);
        let level = |index: usize| self.levels.get(index).copied();
        match (after.checked_sub(1).and_then(level), level(after)) {
            (Some((a_s, a)), Some((b_s, b))) if self.steps.is_empty() => {
                a + (b - a) * (t_s - a_s) / (b_s - a_s)
            }
            (Some((_, before)), _) => before,
            (None, Some((_, first))) => first,
            (None, None) => 0.0,
        }
    }
}

/// Corrected residual at one stamp, and the true velocity. Up to two kinds of vectors, such as position and
/// rotation; a missing kind is zero.
pub(crate) struct LatencySample {
    /// s from the run's origin.
    pub t_s: f64,
    pub residual: [Vec3; 2],
    pub velocity: [Vec3; 2],
    /// Joint speed, rad/s, and tool speed, m/s, on which the latency may depend. 0 disables the test.
    pub loads: [f64; 2],
    /// Standard deviation of a component of the last kind caused by joint noise. 0 if unknown.
    pub joint_noise: f64,
}

/// Latency profile of `aligned` samples, which are compensated for `skew` and the gradual latency `removed_ramp`.
/// `speed` returns the joint speed at the time of measurement, rad/s.
pub(crate) fn latency_profile(
    aligned: &AlignedSamples,
    skew: f64,
    removed_ramp: Option<&LatencyRamp>,
    speed: impl Fn(f64) -> f64,
) -> EstimateResult<LatencyProfile> {
    fit_profile(&latency_samples(aligned, speed), 2, skew, removed_ramp)
}

/// Same from residuals of this many kinds.
pub(crate) fn fit_profile(
    latency_samples: &[LatencySample],
    kinds: usize,
    skew: f64,
    removed_ramp: Option<&LatencyRamp>,
) -> EstimateResult<LatencyProfile> {
    let mut samples = samples(latency_samples);
    if let Some(ramp) = removed_ramp {
        samples.iter_mut().for_each(|sample| sample.t_s = ramp.logged_s(sample.t_s));
    }
    let mut windows = windows(&samples, 3 * kinds);
    let mut errors: Vec<f64> = windows.iter().map(|window| window.std_error_s).collect();
    errors.sort_by(f64::total_cmp);
    let Some(&typical_s) = errors.get(errors.len() / 2) else { return Err(NotObservable::AtRest) };
    let max_std_error_s = MAX_STD_ERROR_RATIO[usize::from(removed_ramp.is_some())] * typical_s;
    windows.retain(|window| window.std_error_s < max_std_error_s);
    if windows.len() < MIN_WINDOWS {
        return Err(NotObservable::NotExcited);
    }
    let middle_s = 0.5 * (windows[0].t_s + windows[windows.len() - 1].t_s);
    let removed_s =
        |t_s: f64| skew * (t_s - middle_s) + removed_ramp.map_or(0.0, |ramp| ramp.lag_s(t_s));
    for window in &mut windows {
        window.delta_s += removed_s(window.t_s);
    }
    // Linear growth is skew, reported separately.
    let line_chi2 = chi2_of_line(&windows);
    let free = (windows.len() - 2) as f64;
    let measured_windows: Vec<(f64, Measured)> =
        windows.iter().map(|w| (w.t_s, w.measured())).collect();
    let load_dependence = if removed_ramp.is_none() { fit_load_dependence(&samples) } else { None };
    // A ramp resembles a line, and its deviation is small relative to window errors, so test for it
    // explicitly.
    let is_piecewise = piecewise_chi2(&windows).is_some_and(|piecewise| {
        let dof = (windows.len() as f64 - THREE_SEGMENT_PARAMETERS).max(1.0);
        line_chi2 - piecewise > MIN_CHI2_GAIN * (piecewise / dof).max(1.0)
    });
    if line_chi2 <= MIN_UNSTEADY_CHI2 * free && !is_piecewise && load_dependence.is_none() {
        return Ok(LatencyProfile {
            windows: measured_windows,
            ..constant_profile(&windows, typical_s)
        });
    }
    let splits = splits(&windows);
    let jumps = || stepped_profile(&samples, &windows, &splits, &removed_s);
    let without_removed: Vec<NormalizedSample> = samples
        .iter()
        .map(|sample| {
            let removed_s = removed_s(sample.t_s);
            let residual =
                std::array::from_fn(|i| sample.residual[i] - removed_s * sample.velocity[i]);
            NormalizedSample { residual, ..*sample }
        })
        .collect();
    // A rise within one window is a step.
    let is_ramp = |profile: &LatencyProfile| match profile.shape {
        LatencyShape::Ramp { from_s, to_s } => to_s - from_s >= WINDOW_S,
        _ => false,
    };
    // A piecewise linear fit exaggerates small variations.
    let piecewise_linear = fit_piecewise_linear(&windows, &without_removed)
        .filter(|profile| removed_ramp.is_some() || is_ramp(profile));
    // Latency that remains in `samples`. The load-dependent profile was fitted to them; the others include
    // the compensated part.
    let remaining_s = |profile: &LatencyProfile, t_s: f64| match profile.shape {
        LatencyShape::WithLoad => profile.relative_s(t_s),
        _ => profile.relative_s(t_s) - removed_s(t_s),
    };
    // In order of complexity.
    let fits = [
        load_dependence,
        (splits.len() == 1).then(jumps),
        piecewise_linear,
        (splits.len() > 1).then(jumps),
        Some(wandering_profile(&windows)),
    ];
    let fits: Vec<(f64, LatencyProfile)> = fits
        .into_iter()
        .flatten()
        .map(|profile| {
            (residual_after(&samples, |row| remaining_s(&profile, samples[row].t_s)), profile)
        })
        .collect();
    let noise = 3.0 * samples.len() as f64;
    let min_residual = fits.iter().map(|(dof, _)| *dof).fold(f64::INFINITY, f64::min);
    let level_s = levels(&windows, &[]).0[0].value;
    let constant = residual_after(&samples, |row| level_s - removed_s(samples[row].t_s));
    // Linearisation leaves a second-order residual that no simple profile explains.
    let extra_share = MAX_EXTRA_RESIDUAL[usize::from(removed_ramp.is_some())];
    let max_residual =
        min_residual + extra_share * (constant - min_residual).max(0.0) + 0.02 * noise;
    let Some((_, profile)) = fits.into_iter().find(|(dof, _)| *dof <= max_residual) else {
        return Err(NotObservable::NotExcited);
    };
    // With many windows, noise alone has a range.
    let is_significant = profile.swing_s.value.abs() > MIN_STD_ERRORS * profile.swing_s.std_error;
    let without_s = |t_s: f64| if removed_ramp.is_some() { level_s - removed_s(t_s) } else { 0.0 };
    let is_unsteady =
        is_significant && explains_residual(&samples, without_s, |t_s| remaining_s(&profile, t_s));
    Ok(LatencyProfile { is_unsteady, windows: measured_windows, ..profile })
}

/// Whether replacing latency `without_s` by `with_s` explains most of the excess residual without
/// increasing the position or rotation residual. A model error may imitate latency in one of them, not in
/// both.
fn explains_residual(
    samples: &[NormalizedSample],
    without_s: impl Fn(f64) -> f64,
    with_s: impl Fn(f64) -> f64,
) -> bool {
    /// Share of the excess residual.
    const MAX_RESIDUAL_RATIO: f64 = 0.5;
    /// Minimum excess relative to the noise.
    const MIN_EXCESS_SHARE: f64 = 0.1;
    // Residuals are scaled to unit noise.
    let noise = 3.0 * samples.len() as f64;
    let square = |kind: usize, with_profile: bool| {
        let squares = samples.iter().map(|sample| {
            let delta_s = if with_profile { with_s(sample.t_s) } else { without_s(sample.t_s) };
            let components = sample.residual.iter().zip(&sample.velocity).skip(3 * kind).take(3);
            components
                .map(|(residual, velocity)| (residual + delta_s * velocity).powi(2))
                .sum::<f64>()
        });
        (squares.sum::<f64>() - noise).max(0.0)
    };
    let [before, after] =
        [false, true].map(|with_profile| [0, 1].map(|kind| square(kind, with_profile)));
    let is_no_worse = (0..2).all(|kind| after[kind] <= before[kind] + 0.1 * noise);
    let has_excess = before[0] + before[1] > MIN_EXCESS_SHARE * noise;
    is_no_worse && has_excess && after[0] + after[1] < MAX_RESIDUAL_RATIO * (before[0] + before[1])
}

fn latency_samples(aligned: &AlignedSamples, speed: impl Fn(f64) -> f64) -> Vec<LatencySample> {
    let t = &aligned.t_s;
    let rotation = |a: &Pose, b: &Pose| rotvec_from_rotation(&(a.rotation * b.rotation.inverse()));
    let position = |a: &Pose, b: &Pose| a.translation.vector - b.translation.vector;
    let rows = 1..t.len().saturating_sub(1);
    rows.map(|k| {
        let (corrected, expected) = (&aligned.corrected[k], &aligned.fk_at_truth[k]);
        let (before, after) = (&aligned.fk_at_truth[k - 1], &aligned.fk_at_truth[k + 1]);
        let span_s = t[k + 1] - t[k - 1];
        let velocity = [position(after, before) / span_s, rotation(after, before) / span_s];
        LatencySample {
            t_s: t[k],
            residual: [position(corrected, expected), rotation(corrected, expected)],
            velocity,
            loads: [speed(t[k]), velocity[0].norm()],
            joint_noise: 0.0,
        }
    })
    .collect()
}

fn constant_profile(windows: &[LatencyWindow], typical_s: f64) -> LatencyProfile {
    let weight: f64 = windows.iter().map(LatencyWindow::weight).sum();
    let mean = windows.iter().map(|w| w.weight() * w.delta_s).sum::<f64>() / weight;
    let scatter = windows.iter().map(|w| (w.delta_s - mean).powi(2) - w.std_error_s.powi(2));
    let scatter = (scatter.sum::<f64>() / windows.len() as f64).max(0.0).sqrt();
    // Inflate the error by excess scatter (Birge 1932).
    let std_error = typical_s.hypot(scatter);
    LatencyProfile {
        swing_s: Measured { value: scatter, std_error, dof: windows.len() as f64 },
        is_unsteady: false,
        shape: LatencyShape::Steady,
        steps: Vec::new(),
        levels: Vec::new(),
        windows: Vec::new(),
    }
}

fn wandering_profile(windows: &[LatencyWindow]) -> LatencyProfile {
    let by = |a: &&LatencyWindow, b: &&LatencyWindow| a.delta_s.total_cmp(&b.delta_s);
    let (low, high) = (windows.iter().min_by(by), windows.iter().max_by(by));
    let swing = low.zip(high).map_or((0.0, 0.0), |(low, high)| {
        (high.delta_s - low.delta_s, high.std_error_s.hypot(low.std_error_s))
    });
    LatencyProfile {
        swing_s: Measured { value: swing.0, std_error: swing.1, dof: windows.len() as f64 },
        is_unsteady: true,
        shape: LatencyShape::Wander,
        steps: Vec::new(),
        levels: windows.iter().map(|window| (window.t_s, window.delta_s)).collect(),
        windows: Vec::new(),
    }
}

fn stepped_profile(
    samples: &[NormalizedSample],
    windows: &[LatencyWindow],
    splits: &[usize],
    removed_s: &impl Fn(f64) -> f64,
) -> LatencyProfile {
    let (measured, _) = levels(windows, splits);
    let mut levels = vec![(f64::NEG_INFINITY, measured[0].value)];
    let mut jumps = Vec::new();
    for (&split, pair) in splits.iter().zip(measured.windows(2)) {
        let [before, after] = [pair[0], pair[1]];
        let around = (windows[split - 1].t_s - WINDOW_S, windows[split].t_s + WINDOW_S);
        let inside: Vec<&NormalizedSample> =
            samples.iter().filter(|sample| (around.0..around.1).contains(&sample.t_s)).collect();
        let residual_at = |sample: &NormalizedSample, level: f64| {
            let delta_s = level - removed_s(sample.t_s);
            let components = sample.residual.iter().zip(&sample.velocity);
            components
                .map(|(residual_at, velocity)| (residual_at + delta_s * velocity).powi(2))
                .sum::<f64>()
        };
        // Change of the squared residual as the step moves past each sample.
        let mut sum = 0.0;
        let (mut min_sum, mut at_s) = (0.0, around.0);
        for sample in inside {
            sum += residual_at(sample, before.value) - residual_at(sample, after.value);
            if sum < min_sum {
                (min_sum, at_s) = (sum, sample.t_s);
            }
        }
        levels.push((at_s, after.value));
        let size_s = Measured {
            value: after.value - before.value,
            std_error: before.std_error.hypot(after.std_error),
            dof: before.dof,
        };
        jumps.push(LatencyStep { at_s, size_s });
    }
    levels.sort_by(|a, b| a.0.total_cmp(&b.0));
    let largest = jumps.iter().max_by(|a, b| a.size_s.value.abs().total_cmp(&b.size_s.value.abs()));
    let swing_s = largest.map_or(measured[0], |jump| jump.size_s);
    LatencyProfile {
        swing_s,
        is_unsteady: true,
        shape: LatencyShape::Steps,
        steps: jumps,
        levels,
        windows: Vec::new(),
    }
}
