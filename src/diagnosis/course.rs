//! The course of a stream's latency over the run: steady, in jumps, or wandering.
//!
//! With everything found taken off, a stream that is late by δ more than was found lies behind FK by
//! δ times its velocity. So in each window of about a second the residual is fitted by `c − δ·v`,
//! position and rotation together. The constant `c` keeps an error of the model, which belongs to
//! the posture and changes slowly, from being taken for a latency.

mod shapes;
#[cfg(test)]
mod tests;
mod windows;

use super::large::in_order;
use super::steps::mean;
use super::{Aligned, GradualLatency, Measured, Seen, Unseen};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use shapes::{BENT_PARAMETERS, bent_chi2, left_beside, levels_at, path, with_load};
use windows::{Sample, Window, chi2_beside_line, levels, samples, splits, windows};

/// Length of a window, s.
const WINDOW_S: f64 = 1.0;
/// Samples in a window, at least.
const SAMPLES: usize = 10;
/// Windows without which nothing can be said.
const WINDOWS: usize = 4;
/// A window this much less certain than the typical one says nothing, or where speeds alone told what was taken off,
/// within a window by less than it changes there.
const VAGUE: [f64; 2] = [5.0, 100.0];
/// Jumps that are sought.
const JUMPS: usize = 4;
/// By how much a jump must lower χ², in units of what χ² a window has left after it.
const SURE: f64 = 40.0;
/// A swing is told from none by so many standard errors.
const TOLD: f64 = 6.0;
/// Of what the course that leaves least takes off one that is simpler takes off all but this share: the first
/// order of a latency, or what is left of it where most was taken off.
const HARDLY_MORE: [f64; 2] = [0.03, 0.002];
/// χ² a window from which on a latency is not steady.
const UNSTEADY: f64 = 9.0;

/// What the course of a latency is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LatencyShape {
    /// It stays as it is.
    Steady,
    /// It jumps from level to level.
    Steps,
    /// It goes from one level to another within a time, s from the run's origin.
    Ramp {
        /// When it begins.
        from_s: f64,
        /// When it ends.
        to_s: f64,
    },
    /// It goes up and down.
    Wander,
    /// It is the larger the faster the arm moves.
    WithLoad,
}

/// How a stream's latency went over the run.
#[derive(Clone, Debug, PartialEq)]
pub struct LatencyCourse {
    /// Its largest jump or its ramp with the sign, or from the least to the most where it wanders or goes with
    /// the load; where it is steady, the scatter beyond chance, s.
    pub swing_s: Measured,
    /// Whether it is surely not steady.
    pub is_unsteady: bool,
    /// What it is like.
    pub shape: LatencyShape,
    /// Its jumps, in the order of time; only of steps.
    pub jumps: Vec<LatencyJump>,
    /// Latency beyond what was found for the whole run or, where it is unsteady, with it taken off: from these
    /// times on (s from the run's origin) where it jumps, else at these times, s.
    pub levels: Vec<(f64, f64)>,
    /// Latency beyond what was found for the whole run in each window: its time, s from the run's
    /// origin, and the latency, s.
    pub windows: Vec<(f64, Measured)>,
}

/// A sudden change of latency that stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyJump {
    /// When, s from the run's origin.
    pub at_s: f64,
    /// By how much, s; positive where the stream is later from then on.
    pub size_s: Measured,
}

impl LatencyCourse {
    /// That of a latency that jumps between `levels`; `None` without a jump.
    pub(super) fn of_jumps(
        jumps: Vec<LatencyJump>,
        levels: Vec<(f64, f64)>,
        windows: Vec<(f64, Measured)>,
    ) -> Option<Self> {
        let size = |jump: &LatencyJump| jump.size_s.value.abs();
        let swing_s = jumps.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?.size_s;
        Some(Self {
            swing_s,
            is_unsteady: true,
            shape: LatencyShape::Steps,
            jumps,
            levels,
            windows,
        })
    }

    /// The stamps `t_s` as they would be had the latency kept the level that it has longest, each
    /// with its row; rows that would then come before an earlier one are left out.
    pub fn straightened(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        let usual = self.usual_s(t_s);
        let straight = |t_s: &f64| t_s - (self.beyond_s(*t_s) - usual);
        in_order(t_s.iter().map(straight).enumerate())
    }

    /// The level that it has longest at the stamps `t_s`, s.
    pub fn usual_s(&self, t_s: &[f64]) -> f64 {
        let mut beyond: Vec<f64> = t_s.iter().map(|&t_s| self.beyond_s(t_s)).collect();
        beyond.sort_by(f64::total_cmp);
        beyond.get(beyond.len() / 2).copied().unwrap_or(0.0)
    }

    /// The same with its levels told from the one that it has longest at the stamps `t_s`.
    pub(super) fn beside_usual(mut self, t_s: &[f64]) -> Self {
        let usual_s = self.usual_s(t_s);
        self.levels.iter_mut().for_each(|(_, level_s)| *level_s -= usual_s);
        self
    }

    /// The same with what was found beyond it once it was taken off, where it is a ramp or goes with the load.
    pub(super) fn with(mut self, rest: &Self) -> Self {
        let added: Option<Vec<f64>> = match self.shape {
            LatencyShape::WithLoad if rest.shape == self.shape && rest.is_unsteady => {
                Some(self.levels.iter().map(|(t_s, _)| rest.beyond_s(*t_s)).collect())
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
        let (least, most) = (levels().fold(f64::MAX, f64::min), levels().fold(f64::MIN, f64::max));
        let std_error = match self.shape {
            LatencyShape::WithLoad => rest.swing_s.std_error,
            _ => self.swing_s.std_error,
        };
        let ends = Measured { value: sign * (most - least), std_error, ..self.swing_s };
        self.swing_s = self.between_levels(rest).unwrap_or(ends);
        self
    }

    /// How much a ramp makes by the levels before and after it, which are better known than its ends.
    fn between_levels(&self, rest: &Self) -> Option<Measured> {
        let LatencyShape::Ramp { from_s, to_s } = self.shape else { return None };
        let level = |is_part: &dyn Fn(f64) -> bool| {
            let windows = rest.windows.iter().filter(|(t_s, _)| is_part(*t_s));
            let whole: Vec<(f64, Measured)> = windows
                .map(|(t_s, rest)| {
                    (*t_s, Measured { value: rest.value + self.beyond_s(*t_s), ..*rest })
                })
                .collect();
            mean(whole.iter())
        };
        let before = level(&|t_s| t_s < from_s - 0.5 * WINDOW_S)?;
        let after = level(&|t_s| t_s > to_s + 0.5 * WINDOW_S)?;
        Some(Measured {
            value: after.value - before.value,
            std_error: before.std_error.hypot(after.std_error),
            dof: before.dof + after.dof,
        })
    }

    /// Number of parameters that describe it beside a constant.
    pub(super) fn parameters(&self) -> usize {
        match self.shape {
            LatencyShape::Steady => 0,
            // When, and by how much.
            LatencyShape::Steps => 2 * self.jumps.len(),
            // Its two ends, and by how much.
            LatencyShape::Ramp { .. } => 3,
            LatencyShape::Wander => self.levels.len(),
            // The latency for each unit of speed.
            LatencyShape::WithLoad => 1,
        }
    }

    /// Latency beyond what was found for the whole run at the stamp `t_s`, s.
    pub(super) fn beyond_s(&self, t_s: f64) -> f64 {
        let after = self.levels.partition_point(|(from_s, _)| *from_s <= t_s);
        let level = |index: usize| self.levels.get(index).copied();
        match (after.checked_sub(1).and_then(level), level(after)) {
            (Some((a_s, a)), Some((b_s, b))) if self.jumps.is_empty() => {
                a + (b - a) * (t_s - a_s) / (b_s - a_s)
            }
            (Some((_, before)), _) => before,
            (None, Some((_, first))) => first,
            (None, None) => 0.0,
        }
    }
}

/// What a late stream leaves at one stamp: what is left of it with everything found taken off, and
/// how fast the truth changes. Two kinds of vectors; one that a stream has not is zero throughout.
pub(super) struct Lagging {
    /// s from the run's origin.
    pub t_s: f64,
    pub left: [Vec3; 2],
    pub velocity: [Vec3; 2],
    /// What may go with the latency: the speed of the joints, rad/s, and of the tool, m/s; 0 where it is not
    /// to be asked.
    pub loads: [f64; 2],
    /// Standard deviation of a component of `left` of the last kind that the noise of the joints makes; 0 if
    /// unknown.
    pub joint_noise: f64,
}

/// The course of the latency of a stream that is `aligned`, whose latency was taken to grow by
/// `skew` a second beside what was `taken` off its stamps. `speed` is that of the joints when a stamp's
/// content was true, rad/s.
pub(super) fn latency_course(
    aligned: &Aligned,
    skew: f64,
    taken: Option<&GradualLatency>,
    speed: impl Fn(f64) -> f64,
) -> Seen<LatencyCourse> {
    course_of(&lagging(aligned, speed), 2, skew, taken)
}

/// The course of the latency of a stream that leaves `lagging`, of so many kinds, with what was `taken` off.
pub(super) fn course_of(
    lagging: &[Lagging],
    kinds: usize,
    skew: f64,
    taken: Option<&GradualLatency>,
) -> Seen<LatencyCourse> {
    let mut samples = samples(lagging);
    if let Some(gradual) = taken {
        samples.iter_mut().for_each(|sample| sample.t_s = gradual.logged_s(sample.t_s));
    }
    let mut windows = windows(&samples, 3 * kinds);
    let mut errors: Vec<f64> = windows.iter().map(|window| window.std_error_s).collect();
    errors.sort_by(f64::total_cmp);
    let Some(&typical_s) = errors.get(errors.len() / 2) else { return Err(Unseen::AtRest) };
    let vague_s = VAGUE[usize::from(taken.is_some())] * typical_s;
    windows.retain(|window| window.std_error_s < vague_s);
    if windows.len() < WINDOWS {
        return Err(Unseen::NotExcited);
    }
    let middle_s = 0.5 * (windows[0].t_s + windows[windows.len() - 1].t_s);
    let taken_s =
        |t_s: f64| skew * (t_s - middle_s) + taken.map_or(0.0, |gradual| gradual.lag_s(t_s));
    for window in &mut windows {
        window.delta_s += taken_s(window.t_s);
    }
    // A latency that grows steadily is a skew, which is not this course's to tell.
    let steady = chi2_beside_line(&windows);
    let free = (windows.len() - 2) as f64;
    let seen: Vec<(f64, Measured)> = windows.iter().map(|w| (w.t_s, w.measured())).collect();
    let loaded = if taken.is_none() { with_load(&samples) } else { None };
    // A ramp in mid-run is much like a steady growth, whose rest is small beside what the windows know.
    let is_bent = bent_chi2(&windows).is_some_and(|bent| {
        let left = (windows.len() as f64 - BENT_PARAMETERS).max(1.0);
        steady - bent > SURE * (bent / left).max(1.0)
    });
    if steady <= UNSTEADY * free && !is_bent && loaded.is_none() {
        return Ok(LatencyCourse { windows: seen, ..steady_course(&windows, typical_s) });
    }
    let splits = splits(&windows);
    let jumps = || jumping_course(&samples, &windows, &splits, &taken_s);
    // As they would be had nothing been taken off.
    let ungrown: Vec<Sample> = samples
        .iter()
        .map(|sample| {
            let taken_s = taken_s(sample.t_s);
            let residual =
                std::array::from_fn(|i| sample.residual[i] - taken_s * sample.velocity[i]);
            Sample { residual, ..*sample }
        })
        .collect();
    // What rises within a window is a jump.
    let is_ramp = |course: &LatencyCourse| match course.shape {
        LatencyShape::Ramp { from_s, to_s } => to_s - from_s >= WINDOW_S,
        _ => false,
    };
    // Where it goes up and down by little single pieces swing more than it does.
    let pieces = path(&windows, &ungrown).filter(|course| taken.is_some() || is_ramp(course));
    // What goes with the load was fitted with nothing taken off.
    let untold_s = |course: &LatencyCourse, t_s: f64| match course.shape {
        LatencyShape::WithLoad => course.beyond_s(t_s),
        _ => course.beyond_s(t_s) - taken_s(t_s),
    };
    // From the simplest on.
    let tried = [
        loaded,
        (splits.len() == 1).then(jumps),
        pieces,
        (splits.len() > 1).then(jumps),
        Some(wandering_course(&windows)),
    ];
    let tried: Vec<(f64, LatencyCourse)> = tried
        .into_iter()
        .flatten()
        .map(|course| (left_beside(&samples, |row| untold_s(&course, samples[row].t_s)), course))
        .collect();
    let noise = 3.0 * samples.len() as f64;
    let least = tried.iter().map(|(left, _)| *left).fold(f64::INFINITY, f64::min);
    let level_s = levels(&windows, &[]).0[0].value;
    let constant = left_beside(&samples, |row| level_s - taken_s(samples[row].t_s));
    // The first order of a latency leaves something that no simple course is made of.
    let hardly_more = HARDLY_MORE[usize::from(taken.is_some())];
    let enough = least + hardly_more * (constant - least).max(0.0) + 0.02 * noise;
    let Some((_, course)) = tried.into_iter().find(|(left, _)| *left <= enough) else {
        return Err(Unseen::NotExcited);
    };
    // From least to most of many windows noise swings, too.
    let is_told = course.swing_s.value.abs() > TOLD * course.swing_s.std_error;
    let without_s = |t_s: f64| if taken.is_some() { level_s - taken_s(t_s) } else { 0.0 };
    let is_unsteady = is_told && explains(&samples, without_s, |t_s| untold_s(&course, t_s));
    Ok(LatencyCourse { is_unsteady, windows: seen, ..course })
}

/// Whether a latency of `with_s` at each time, not of `without_s`, makes most of the residual beyond its noise,
/// and neither of position nor of rotation leaves more than there was. An error of the model may look
/// like a latency here and there, but not in both.
fn explains(
    samples: &[Sample],
    without_s: impl Fn(f64) -> f64,
    with_s: impl Fn(f64) -> f64,
) -> bool {
    /// The share of the residual that may be left.
    const LEFT: f64 = 0.5;
    /// There is so much of it beyond the noise.
    const BEYOND: f64 = 0.1;
    // Scaled by its noise, noise alone leaves 1 a component.
    let noise = 3.0 * samples.len() as f64;
    let square = |kind: usize, late: bool| {
        let squares = samples.iter().map(|sample| {
            let delta_s = if late { with_s(sample.t_s) } else { without_s(sample.t_s) };
            let parts = sample.residual.iter().zip(&sample.velocity).skip(3 * kind).take(3);
            parts.map(|(left, velocity)| (left + delta_s * velocity).powi(2)).sum::<f64>()
        });
        (squares.sum::<f64>() - noise).max(0.0)
    };
    let [before, after] = [false, true].map(|late| [0, 1].map(|kind| square(kind, late)));
    let is_no_worse = (0..2).all(|kind| after[kind] <= before[kind] + 0.1 * noise);
    let is_more_than_scatter = before[0] + before[1] > BEYOND * noise;
    is_no_worse && is_more_than_scatter && after[0] + after[1] < LEFT * (before[0] + before[1])
}

/// Positions and rotations against FK.
fn lagging(aligned: &Aligned, speed: impl Fn(f64) -> f64) -> Vec<Lagging> {
    let t = &aligned.t_s;
    let rotation = |a: &Pose, b: &Pose| rotvec_from_rotation(&(a.rotation * b.rotation.inverse()));
    let position = |a: &Pose, b: &Pose| a.translation.vector - b.translation.vector;
    let rows = 1..t.len().saturating_sub(1);
    rows.map(|k| {
        let (is, should) = (&aligned.corrected[k], &aligned.fk_at_truth[k]);
        let (before, after) = (&aligned.fk_at_truth[k - 1], &aligned.fk_at_truth[k + 1]);
        let span_s = t[k + 1] - t[k - 1];
        let velocity = [position(after, before) / span_s, rotation(after, before) / span_s];
        Lagging {
            t_s: t[k],
            left: [position(is, should), rotation(is, should)],
            velocity,
            loads: [speed(t[k]), velocity[0].norm()],
            joint_noise: 0.0,
        }
    })
    .collect()
}

fn steady_course(windows: &[Window], typical_s: f64) -> LatencyCourse {
    let weight: f64 = windows.iter().map(Window::weight).sum();
    let mean = windows.iter().map(|w| w.weight() * w.delta_s).sum::<f64>() / weight;
    let scatter = windows.iter().map(|w| (w.delta_s - mean).powi(2) - w.std_error_s.powi(2));
    let scatter = (scatter.sum::<f64>() / windows.len() as f64).max(0.0).sqrt();
    // Windows that scatter by more than they say know less than they say (Birge 1932).
    let std_error = typical_s.hypot(scatter);
    LatencyCourse {
        swing_s: Measured { value: scatter, std_error, dof: windows.len() as f64 },
        is_unsteady: false,
        shape: LatencyShape::Steady,
        jumps: Vec::new(),
        levels: Vec::new(),
        windows: Vec::new(),
    }
}

fn wandering_course(windows: &[Window]) -> LatencyCourse {
    let by = |a: &&Window, b: &&Window| a.delta_s.total_cmp(&b.delta_s);
    let (low, high) = (windows.iter().min_by(by), windows.iter().max_by(by));
    let swing = low.zip(high).map_or((0.0, 0.0), |(low, high)| {
        (high.delta_s - low.delta_s, high.std_error_s.hypot(low.std_error_s))
    });
    LatencyCourse {
        swing_s: Measured { value: swing.0, std_error: swing.1, dof: windows.len() as f64 },
        is_unsteady: true,
        shape: LatencyShape::Wander,
        jumps: Vec::new(),
        levels: windows.iter().map(|window| (window.t_s, window.delta_s)).collect(),
        windows: Vec::new(),
    }
}

fn jumping_course(
    samples: &[Sample],
    windows: &[Window],
    splits: &[usize],
    taken_s: &impl Fn(f64) -> f64,
) -> LatencyCourse {
    let (measured, _) = levels(windows, splits);
    let mut levels = vec![(f64::NEG_INFINITY, measured[0].value)];
    let mut jumps = Vec::new();
    for (&split, pair) in splits.iter().zip(measured.windows(2)) {
        let [before, after] = [pair[0], pair[1]];
        let around = (windows[split - 1].t_s - WINDOW_S, windows[split].t_s + WINDOW_S);
        let inside: Vec<&Sample> =
            samples.iter().filter(|sample| (around.0..around.1).contains(&sample.t_s)).collect();
        let left = |sample: &Sample, level: f64| {
            let delta_s = level - taken_s(sample.t_s);
            let parts = sample.residual.iter().zip(&sample.velocity);
            parts.map(|(left, velocity)| (left + delta_s * velocity).powi(2)).sum::<f64>()
        };
        // What moving the jump from before all samples past each of them makes of the residual.
        let mut sum = 0.0;
        let (mut least, mut at_s) = (0.0, around.0);
        for sample in inside {
            sum += left(sample, before.value) - left(sample, after.value);
            if sum < least {
                (least, at_s) = (sum, sample.t_s);
            }
        }
        levels.push((at_s, after.value));
        let size_s = Measured {
            value: after.value - before.value,
            std_error: before.std_error.hypot(after.std_error),
            dof: before.dof,
        };
        jumps.push(LatencyJump { at_s, size_s });
    }
    levels.sort_by(|a, b| a.0.total_cmp(&b.0));
    let largest = jumps.iter().max_by(|a, b| a.size_s.value.abs().total_cmp(&b.size_s.value.abs()));
    let swing_s = largest.map_or(measured[0], |jump| jump.size_s);
    LatencyCourse {
        swing_s,
        is_unsteady: true,
        shape: LatencyShape::Steps,
        jumps,
        levels,
        windows: Vec::new(),
    }
}
