//! The course of a stream's latency over the run: steady, in jumps, or wandering.
//!
//! With everything found taken off, a stream that is late by δ more than was found lies behind FK by
//! δ times its velocity. So in each window of about a second the residual is fitted by `c − δ·v`,
//! position and rotation together. The constant `c` keeps an error of the model, which belongs to
//! the posture and changes slowly, from being taken for a latency.

use super::{Aligned, Measured, Seen, Unseen};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};

/// Length of a window, s.
const WINDOW_S: f64 = 1.0;
/// Samples in a window, at least.
const SAMPLES: usize = 10;
/// Windows without which nothing can be said.
const WINDOWS: usize = 4;
/// A window this much less certain than the typical one says nothing.
const VAGUE: f64 = 5.0;
/// Jumps that are sought.
const JUMPS: usize = 4;
/// By how much a jump must lower χ², in units of what χ² a window has left after it.
const SURE: f64 = 40.0;
/// χ² a window from which on a latency is not steady.
const UNSTEADY: f64 = 9.0;

/// How a stream's latency went over the run.
#[derive(Clone, Debug, PartialEq)]
pub struct LatencyCourse {
    /// Its largest jump with the sign, or from the least to the most where it wanders; where it is
    /// steady, the scatter beyond chance, s.
    pub swing_s: Measured,
    /// Whether it is surely not steady.
    pub is_unsteady: bool,
    /// Its jumps, in the order of time; none where it wanders.
    pub jumps: Vec<LatencyJump>,
    /// Latency beyond what was found for the whole run: from these times on (s from the run's
    /// origin) where it jumps, else at these times, s.
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
        Some(Self { swing_s, is_unsteady: true, jumps, levels, windows })
    }

    /// The stamps `t_s` as they would be had the latency kept the level that it has longest, each
    /// with its row; rows that would then come before an earlier one are left out.
    pub fn straightened(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        let beyond: Vec<f64> = t_s.iter().map(|&t_s| self.beyond_s(t_s)).collect();
        let mut sorted = beyond.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let mut kept: Vec<(usize, f64)> = Vec::with_capacity(t_s.len());
        for (row, (t_s, beyond_s)) in t_s.iter().zip(beyond).enumerate() {
            let straight_s = t_s - (beyond_s - usual);
            if kept.last().is_none_or(|(_, before_s)| straight_s > *before_s) {
                kept.push((row, straight_s));
            }
        }
        kept
    }

    fn beyond_s(&self, t_s: f64) -> f64 {
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

/// One window.
#[derive(Clone, Copy)]
struct Window {
    t_s: f64,
    delta_s: f64,
    std_error_s: f64,
}

impl Window {
    fn weight(&self) -> f64 {
        self.std_error_s.powi(-2)
    }

    fn measured(&self) -> Measured {
        Measured { value: self.delta_s, std_error: self.std_error_s, dof: f64::INFINITY }
    }
}

/// What a late stream leaves at one stamp: what is left of it with everything found taken off, and
/// how fast the truth changes. Two kinds of vectors; one that a stream has not is zero throughout.
pub(super) struct Lagging {
    /// s from the run's origin.
    pub t_s: f64,
    pub left: [Vec3; 2],
    pub velocity: [Vec3; 2],
}

/// The same, in units of the noise of each kind.
struct Sample {
    t_s: f64,
    residual: [f64; 6],
    velocity: [f64; 6],
}

/// The course of the latency of a stream that is `aligned`, whose latency was taken to grow by
/// `skew` a second.
pub(super) fn latency_course(aligned: &Aligned, skew: f64) -> Seen<LatencyCourse> {
    course_of(&lagging(aligned), 2, skew)
}

/// The course of the latency of a stream that leaves `lagging`, of so many kinds.
pub(super) fn course_of(lagging: &[Lagging], kinds: usize, skew: f64) -> Seen<LatencyCourse> {
    let samples = samples(lagging);
    let mut windows = windows(&samples, 3 * kinds);
    let mut errors: Vec<f64> = windows.iter().map(|window| window.std_error_s).collect();
    errors.sort_by(f64::total_cmp);
    let Some(&typical_s) = errors.get(errors.len() / 2) else { return Err(Unseen::AtRest) };
    windows.retain(|window| window.std_error_s < VAGUE * typical_s);
    if windows.len() < WINDOWS {
        return Err(Unseen::NotExcited);
    }
    let middle_s = 0.5 * (windows[0].t_s + windows[windows.len() - 1].t_s);
    // A latency that grows steadily is a skew, which is not this course's to tell.
    let steady = chi2_beside_line(&windows);
    for window in &mut windows {
        window.delta_s += skew * (window.t_s - middle_s);
    }
    let free = (windows.len() - 2) as f64;
    let seen: Vec<(f64, Measured)> = windows.iter().map(|w| (w.t_s, w.measured())).collect();
    if steady <= UNSTEADY * free {
        return Ok(LatencyCourse { windows: seen, ..steady_course(&windows, typical_s) });
    }
    let splits = splits(&windows);
    let left = levels(&windows, &splits).1;
    let course = if !splits.is_empty() && left < 0.5 * steady {
        jumping_course(&samples, &windows, &splits, skew, middle_s)
    } else {
        wandering_course(&windows)
    };
    let beyond_s = |t_s: f64| course.beyond_s(t_s) - skew * (t_s - middle_s);
    let is_unsteady = explains(&samples, beyond_s);
    Ok(LatencyCourse { is_unsteady, windows: seen, ..course })
}

/// Whether a latency of `beyond_s` at each time makes most of the residual beyond its noise, and
/// neither of position nor of rotation leaves more than there was. An error of the model may look
/// like a latency here and there, but not in both.
fn explains(samples: &[Sample], beyond_s: impl Fn(f64) -> f64) -> bool {
    /// The share of the residual that may be left.
    const LEFT: f64 = 0.5;
    // Scaled by its noise, noise alone leaves 1 a component.
    let noise = 3.0 * samples.len() as f64;
    let square = |kind: usize, late: bool| {
        let squares = samples.iter().map(|sample| {
            let delta_s = if late { beyond_s(sample.t_s) } else { 0.0 };
            let parts = sample.residual.iter().zip(&sample.velocity).skip(3 * kind).take(3);
            parts.map(|(left, velocity)| (left + delta_s * velocity).powi(2)).sum::<f64>()
        });
        (squares.sum::<f64>() - noise).max(0.0)
    };
    let [before, after] = [false, true].map(|late| [0, 1].map(|kind| square(kind, late)));
    let is_no_worse = (0..2).all(|kind| after[kind] <= before[kind] + 0.1 * noise);
    is_no_worse && after[0] + after[1] < LEFT * (before[0] + before[1])
}

/// Positions and rotations against FK.
fn lagging(aligned: &Aligned) -> Vec<Lagging> {
    let t = &aligned.t_s;
    let rotation = |a: &Pose, b: &Pose| rotvec_from_rotation(&(a.rotation * b.rotation.inverse()));
    let position = |a: &Pose, b: &Pose| a.translation.vector - b.translation.vector;
    let rows = 1..t.len().saturating_sub(1);
    rows.map(|k| {
        let (is, should) = (&aligned.corrected[k], &aligned.fk_at_truth[k]);
        let (before, after) = (&aligned.fk_at_truth[k - 1], &aligned.fk_at_truth[k + 1]);
        let span_s = t[k + 1] - t[k - 1];
        Lagging {
            t_s: t[k],
            left: [position(is, should), rotation(is, should)],
            velocity: [position(after, before) / span_s, rotation(after, before) / span_s],
        }
    })
    .collect()
}

fn samples(lagging: &[Lagging]) -> Vec<Sample> {
    let noise = [0, 1].map(|kind| {
        let steps = lagging.windows(2).map(|pair| pair[1].left[kind] - pair[0].left[kind]);
        let square: f64 = steps.map(|step| step.norm_squared()).sum();
        // Below this a residual is arithmetic, m and rad.
        (square / (6 * lagging.len().max(1)) as f64).sqrt().max(1e-6)
    });
    let scaled =
        |parts: &[Vec3; 2]| std::array::from_fn(|at| parts[at / 3][at % 3] / noise[at / 3]);
    let sample = |of: &Lagging| Sample {
        t_s: of.t_s,
        residual: scaled(&of.left),
        velocity: scaled(&of.velocity),
    };
    lagging.iter().map(sample).collect()
}

/// The windows in which the arm's velocity changes enough to tell.
fn windows(samples: &[Sample], components: usize) -> Vec<Window> {
    let mut windows = Vec::new();
    let mut rest = samples;
    while let Some(first) = rest.first() {
        let length = rest.partition_point(|sample| sample.t_s < first.t_s + WINDOW_S);
        let (own, after) = rest.split_at(length.max(1));
        windows.extend(window(own, components));
        rest = after;
    }
    windows
}

/// The slope of residual over velocity by least squares, its error widened by what the residuals
/// remember from sample to sample: `(1 + ρ)/(1 − ρ)`, and by how many windows' samples that leaves.
fn window(samples: &[Sample], components: usize) -> Option<Window> {
    const REMEMBERED: f64 = 0.98;
    let n = samples.len();
    if n < SAMPLES {
        return None;
    }
    let mean = |of: &dyn Fn(&Sample) -> [f64; 6]| {
        let mut sum = [0.0; 6];
        for sample in samples {
            sum.iter_mut().zip(of(sample)).for_each(|(sum, value)| *sum += value / n as f64);
        }
        sum
    };
    let (mean_left, mean_v) = (mean(&|sample| sample.residual), mean(&|sample| sample.velocity));
    let centred = |sample: &Sample| {
        let left: [f64; 6] = std::array::from_fn(|i| sample.residual[i] - mean_left[i]);
        let velocity: [f64; 6] = std::array::from_fn(|i| sample.velocity[i] - mean_v[i]);
        (left, velocity)
    };
    let dot = |a: &[f64; 6], b: &[f64; 6]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (mut information, mut product) = (0.0, 0.0);
    for sample in samples {
        let (left, velocity) = centred(sample);
        information += dot(&velocity, &velocity);
        product += dot(&velocity, &left);
    }
    if information <= 0.0 {
        return None;
    }
    let delta_s = -product / information;
    let left: Vec<[f64; 6]> = samples
        .iter()
        .map(|sample| {
            let (left, velocity) = centred(sample);
            std::array::from_fn(|i| left[i] + delta_s * velocity[i])
        })
        .collect();
    let square: f64 = left.iter().map(|left| dot(left, left)).sum();
    let lagged: f64 = left.windows(2).map(|pair| dot(&pair[0], &pair[1])).sum();
    let rho = (lagged / square.max(f64::MIN_POSITIVE)).clamp(0.0, REMEMBERED);
    // A slope, and the mean of each component, are taken from the samples.
    let free = components * (n - 1) - 1;
    let variance = square / free as f64 * (1.0 + rho) / (1.0 - rho);
    // The rounding of stamps to nanoseconds and of positions is never beaten.
    let std_error_s = (variance.max(1e-3) / information).sqrt().max(1e-6);
    let t_s = samples.iter().map(|sample| sample.t_s).sum::<f64>() / n as f64;
    std_error_s.is_finite().then_some(Window { t_s, delta_s, std_error_s })
}

/// χ² of the windows beside their best line.
fn chi2_beside_line(windows: &[Window]) -> f64 {
    let weight: f64 = windows.iter().map(Window::weight).sum();
    let mean = |of: &dyn Fn(&Window) -> f64| {
        windows.iter().map(|window| window.weight() * of(window)).sum::<f64>() / weight
    };
    let (t, delta) = (mean(&|window| window.t_s), mean(&|window| window.delta_s));
    let spread = mean(&|window| (window.t_s - t).powi(2));
    let slope =
        mean(&|window| (window.t_s - t) * (window.delta_s - delta)) / spread.max(f64::MIN_POSITIVE);
    let beside = |window: &Window| window.delta_s - delta - slope * (window.t_s - t);
    windows.iter().map(|window| window.weight() * beside(window).powi(2)).sum()
}

/// The level and its error of each part that `splits` cut the windows into, and χ² beside them.
fn levels(windows: &[Window], splits: &[usize]) -> (Vec<Measured>, f64) {
    let ends = splits.iter().copied().chain([windows.len()]);
    let starts = std::iter::once(0).chain(splits.iter().copied());
    let mut chi2 = 0.0;
    let levels = starts.zip(ends).map(|(start, end)| {
        let part = &windows[start..end];
        let weight: f64 = part.iter().map(Window::weight).sum();
        let level = part.iter().map(|w| w.weight() * w.delta_s).sum::<f64>() / weight;
        let own: f64 = part.iter().map(|w| w.weight() * (w.delta_s - level).powi(2)).sum();
        chi2 += own;
        let scatter = (own / (part.len().max(2) - 1) as f64).max(1.0);
        let dof = windows.len() as f64;
        Measured { value: level, std_error: (scatter / weight).sqrt(), dof }
    });
    let levels = levels.collect();
    (levels, chi2)
}

/// Where the latency surely jumps: before these windows. The window in which it does so lies on
/// neither level and is charged to both.
fn splits(windows: &[Window]) -> Vec<usize> {
    let mut splits: Vec<usize> = Vec::new();
    while splits.len() < JUMPS {
        let before = levels(windows, &splits).1;
        let with = |split: usize| {
            let mut with = splits.clone();
            with.push(split);
            with.sort_unstable();
            (levels(windows, &with).1, with)
        };
        let free = (1..windows.len()).filter(|split| !splits.contains(split));
        let Some((after, best)) = free.map(with).min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        let left = (windows.len() as f64 - best.len() as f64 - 1.0).max(1.0);
        if before - after < SURE * (after / left).max(1.0) {
            break;
        }
        splits = best;
    }
    splits
}

fn steady_course(windows: &[Window], typical_s: f64) -> LatencyCourse {
    let weight: f64 = windows.iter().map(Window::weight).sum();
    let mean = windows.iter().map(|w| w.weight() * w.delta_s).sum::<f64>() / weight;
    let scatter = windows.iter().map(|w| (w.delta_s - mean).powi(2) - w.std_error_s.powi(2));
    let scatter = (scatter.sum::<f64>() / windows.len() as f64).max(0.0).sqrt();
    LatencyCourse {
        swing_s: Measured { value: scatter, std_error: typical_s, dof: windows.len() as f64 },
        is_unsteady: false,
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
        jumps: Vec::new(),
        levels: windows.iter().map(|window| (window.t_s, window.delta_s)).collect(),
        windows: Vec::new(),
    }
}

fn jumping_course(
    samples: &[Sample],
    windows: &[Window],
    splits: &[usize],
    skew: f64,
    middle_s: f64,
) -> LatencyCourse {
    let (measured, _) = levels(windows, splits);
    let mut levels = vec![(f64::NEG_INFINITY, measured[0].value)];
    let mut jumps = Vec::new();
    for (&split, pair) in splits.iter().zip(measured.windows(2)) {
        let [before, after] = [pair[0], pair[1]];
        let around = (windows[split - 1].t_s - WINDOW_S, windows[split].t_s + WINDOW_S);
        let inside: Vec<&Sample> =
            samples.iter().filter(|sample| (around.0..around.1).contains(&sample.t_s)).collect();
        let grown = |sample: &Sample| skew * (sample.t_s - middle_s);
        let left = |sample: &Sample, level: f64| {
            let delta_s = level - grown(sample);
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
    LatencyCourse { swing_s, is_unsteady: true, jumps, levels, windows: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{pose, rotation_from_rotvec};

    fn truth(t_s: f64) -> Pose {
        let swing = |rate: f64, phase: f64| (rate * t_s + phase).sin();
        pose(
            [0.3 * swing(1.7, 0.0), 0.25 * swing(2.3, 1.0), 0.2 * swing(1.1, 2.0)],
            rotation_from_rotvec(Vec3::new(0.4 * swing(1.9, 0.3), 0.3 * swing(1.3, 0.7), 0.0)),
        )
    }

    /// 20 s at 50 Hz, late by `beyond_s` more than was found, with noise and `bent` by a model error.
    fn aligned(beyond_s: impl Fn(f64) -> f64, noise_m: f64, bent_m: f64) -> Aligned {
        let mut random = crate::test_random::Lcg::new();
        let mut aligned = Aligned::default();
        for row in 0..1000 {
            let t_s = f64::from(row) * 0.02;
            let mut logged = truth(t_s - beyond_s(t_s));
            logged.translation.vector += Vec3::from(random.triple(noise_m));
            logged.translation.vector += bent_m * truth(t_s).translation.vector.map(f64::sin);
            aligned.t_s.push(t_s);
            aligned.corrected.push(logged);
            aligned.fk_at_truth.push(truth(t_s));
        }
        aligned
    }

    #[test]
    fn a_jump_is_found_with_its_moment_and_size() {
        for (at_s, size_s) in [(7.3, 0.012), (12.41, -0.03)] {
            let course = latency_course(
                &aligned(|t_s| if t_s < at_s { 0.001 } else { 0.001 + size_s }, 1e-4, 0.0),
                0.0,
            );
            let course = course.expect("a course");
            let [jump] = course.jumps.as_slice() else { panic!("{course:?}") };
            assert!((jump.size_s.value - size_s).abs() < 1e-3, "{jump:?}");
            assert!((jump.at_s - at_s).abs() < 0.2, "{jump:?}");
            let t_s = [1.0, 2.0, 18.0, 19.0];
            let straight = course.straightened(&t_s);
            let apart = (straight[2].1 - straight[1].1) - (18.0 - 2.0);
            assert!((apart + size_s).abs() < 1e-3, "{straight:?}");
        }
    }

    #[test]
    fn a_latency_that_wanders_is_measured_from_least_to_most() {
        let course = latency_course(&aligned(|t_s| 0.01 * (0.6 * t_s).sin(), 1e-4, 0.0), 0.0);
        let course = course.expect("a course");
        assert!(course.is_unsteady, "{course:?}");
        assert!((0.016..0.024).contains(&course.swing_s.value.abs()), "{course:?}");
    }

    #[test]
    fn noise_a_skew_and_a_bent_model_are_steady() {
        for noise_m in [1e-6, 1e-4, 2e-3] {
            let steady = latency_course(&aligned(|_| 0.0, noise_m, 0.0), 0.0).expect("a course");
            assert!(!steady.is_unsteady, "{steady:?}");
        }
        let skewed = latency_course(&aligned(|t_s| 3e-4 * t_s, 1e-4, 0.0), 0.0).expect("a course");
        assert!(!skewed.is_unsteady, "{skewed:?}");
        let bent = latency_course(&aligned(|_| 0.0, 1e-5, 0.01), 0.0).expect("a course");
        assert!(!bent.is_unsteady, "{bent:?}");
    }

    #[test]
    fn an_arm_at_rest_tells_nothing() {
        let mut still = aligned(|_| 0.0, 0.0, 0.0);
        still.fk_at_truth.fill(truth(0.0));
        assert!(latency_course(&still, 0.0).is_err());
        assert!(latency_course(&Aligned::default(), 0.0).is_err());
    }
}
