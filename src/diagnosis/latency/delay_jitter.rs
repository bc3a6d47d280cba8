//! Delay jitter with a skewed distribution, caused by transport or CPU load. Mean and median delay then
//! differ, and a robust fit estimates neither. The delay of a sample is its error along the motion divided
//! by the speed, if the motion is fast.

use crate::priors::LEVER_M;
use crate::residuals::excess::mean_of;
use crate::{AlignedSamples, Measured};
use ground::geometry::Vec3;
use ground::stats::{mean, median_of};

/// Skewed delays of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelayJitter {
    /// Median, s.
    pub median_s: Measured,
    /// Mean, s.
    pub mean_s: Measured,
    /// Rms deviation from the median, s.
    pub scatter_s: f64,
    /// Rms error along the motion that it produces, with angles at 0.3 m.
    pub scatter_m: f64,
}

/// For standard errors.
const BLOCKS: usize = 20;

/// Delays of `aligned` samples with fitted latency `latency_s`. `None` if they do not scatter or are not
/// skewed.
pub(crate) fn estimate_delay_jitter(
    aligned: &AlignedSamples,
    latency_s: f64,
) -> Option<DelayJitter> {
    /// Error along the motion divided by the error across it.
    const MIN_ALONG_RATIO: f64 = 3.0;
    /// Between mean and median, in standard errors and in s.
    const MIN_STD_ERRORS: f64 = 4.0;
    const MIN_DIFFERENCE_S: f64 = 1e-4;
    let all = sample_delays(aligned);
    if all.len() < 10 * BLOCKS {
        return None;
    }
    let middle = |part: &[SampleDelay]| {
        median_of(part.iter().map(|delay| delay.delay_s)).unwrap_or_default()
    };
    let mean = |part: &[SampleDelay]| mean(part.iter().map(|delay| delay.delay_s));
    let middle_s = middle(&all);
    let along: f64 =
        all.iter().map(|delay| ((delay.delay_s - middle_s) * delay.speed).powi(2)).sum();
    let across: f64 = all.iter().map(|delay| delay.across.powi(2)).sum();
    let steps = all.windows(2).map(|pair| (pair[1].delay_s - pair[0].delay_s).powi(2));
    let spread: f64 = all.iter().map(|delay| (delay.delay_s - middle_s).powi(2)).sum();
    // Slow changes have small successive differences (von Neumann 1941).
    let is_scatter = steps.sum::<f64>() > spread;
    if along < MIN_ALONG_RATIO * MIN_ALONG_RATIO * across / 5.0 || !is_scatter {
        return None;
    }
    let std_error = |of: &dyn Fn(&[SampleDelay]) -> f64| {
        let blocks = all.chunks(all.len().div_ceil(BLOCKS));
        mean_of(&blocks.map(of).collect::<Vec<f64>>()).std_error
    };
    let difference_s = mean(&all) - middle_s;
    let is_skewed = difference_s.abs()
        > MIN_DIFFERENCE_S.max(MIN_STD_ERRORS * std_error(&|part| mean(part) - middle(part)));
    let measured = |additional_s: f64, std_error: f64| Measured {
        value: latency_s + additional_s,
        std_error,
        dof: BLOCKS as f64 - 1.0,
    };
    is_skewed.then(|| DelayJitter {
        median_s: measured(middle_s, std_error(&middle)),
        mean_s: measured(mean(&all), std_error(&mean)),
        scatter_s: (spread / all.len() as f64).sqrt(),
        scatter_m: (along / all.len() as f64).sqrt(),
    })
}

struct SampleDelay {
    delay_s: f64,
    /// m/s.
    speed: f64,
    /// Error across the motion, m.
    across: f64,
}

fn sample_delays(aligned: &AlignedSamples) -> Vec<SampleDelay> {
    let t = &aligned.t_s;
    let in_m = |[linear, angular]: [Vec3; 2]| [linear, angular * LEVER_M];
    let dot = |a: &[Vec3; 2], b: &[Vec3; 2]| a[0].dot(&b[0]) + a[1].dot(&b[1]);
    let of = |k: usize| {
        let residual = in_m(aligned.residual(k, &aligned.fk_at_truth[k]));
        let velocity = in_m(aligned.velocity(k));
        let square = dot(&velocity, &velocity);
        let by_s = -dot(&residual, &velocity) / square.max(f64::MIN_POSITIVE);
        let across = [0, 1].map(|kind| residual[kind] + by_s * velocity[kind]);
        SampleDelay { delay_s: by_s, speed: square.sqrt(), across: dot(&across, &across).sqrt() }
    };
    let mut all: Vec<SampleDelay> = (1..t.len().saturating_sub(1)).map(of).collect();
    let square: f64 = all.iter().map(|delay| delay.speed.powi(2)).sum();
    let usual = (square / all.len().max(1) as f64).sqrt();
    all.retain(|delay| delay.speed > 0.5 * usual && delay.delay_s.is_finite());
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{Pose, pose};
    use rand::SeedableRng;
    use rand_distr::{Distribution, Exp, Normal};

    fn truth(t_s: f64) -> Pose {
        let swing = |rate: f64, phase: f64| (rate * t_s + phase).sin();
        pose([0.4 * swing(1.7, 0.0), 0.3 * swing(2.3, 1.0), 0.0], Default::default())
    }

    fn aligned(delay_s: impl Fn(&mut rand_pcg::Pcg64) -> f64) -> AlignedSamples {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
        let noise = Normal::new(0.0, 2e-5).expect("a spread");
        let mut aligned = AlignedSamples::default();
        for row in 0..4000 {
            let t_s = f64::from(row) * 0.01;
            let mut logged = truth(t_s - delay_s(&mut rng));
            logged.translation.vector += Vec3::from_fn(|_, _| noise.sample(&mut rng));
            aligned.t_s.push(t_s);
            aligned.corrected.push(logged);
            aligned.fk_at_truth.push(truth(t_s));
        }
        aligned
    }

    #[test]
    fn skewed_delays_are_reported_with_median_and_mean() {
        let delays = Exp::new(1.0 / 5e-3).expect("a rate");
        let found = aligned(|rng| delays.sample(rng) - 3e-3);
        let found = estimate_delay_jitter(&found, 0.013).expect("skewed");
        let (median_s, mean_s) = (0.010 + 5e-3 * 2.0_f64.ln(), 0.015);
        let covers = |one: Measured, truth: f64| (one.value - truth).abs() < 3.0 * one.std_error;
        assert!(covers(found.median_s, median_s) && covers(found.mean_s, mean_s), "{found:?}");
        assert!(found.median_s.std_error < 4e-4, "{found:?}");
    }

    #[test]
    fn symmetric_or_constant_delays_have_no_jitter() {
        let even = Normal::new(0.0, 4e-3).expect("a spread");
        assert_eq!(estimate_delay_jitter(&aligned(|rng| even.sample(rng)), 0.0), None);
        assert_eq!(estimate_delay_jitter(&aligned(|_| 0.002), 0.0), None);
    }
}
