//! Latency in windows of about a second.

use super::{LatencySample, MAX_STEPS, MIN_CHI2_GAIN, MIN_WINDOW_SAMPLES, WINDOW_S};
use ground::geometry::Vec3;
use ground::stats::Measured;

#[derive(Clone, Copy)]
pub(super) struct LatencyWindow {
    pub(super) t_s: f64,
    pub(super) delta_s: f64,
    pub(super) std_error_s: f64,
}

impl LatencyWindow {
    pub(super) fn weight(&self) -> f64 {
        self.std_error_s.powi(-2)
    }

    pub(super) fn measured(&self) -> Measured {
        Measured { value: self.delta_s, std_error: self.std_error_s, dof: f64::INFINITY }
    }
}

/// Sample in units of the noise of each kind.
#[derive(Clone, Copy)]
pub(super) struct NormalizedSample {
    pub(super) t_s: f64,
    pub(super) residual: [f64; 6],
    pub(super) velocity: [f64; 6],
    pub(super) loads: [f64; 2],
    pub(super) joint_noise: f64,
}

pub(super) fn samples(latency_samples: &[LatencySample]) -> Vec<NormalizedSample> {
    let noise = [0, 1].map(|kind| {
        let steps =
            latency_samples.windows(2).map(|pair| pair[1].residual[kind] - pair[0].residual[kind]);
        let square: f64 = steps.map(|step| step.norm_squared()).sum();
        // Floor, m and rad.
        (square / (6 * latency_samples.len().max(1)) as f64).sqrt().max(1e-6)
    });
    let scaled =
        |parts: &[Vec3; 2]| std::array::from_fn(|at| parts[at / 3][at % 3] / noise[at / 3]);
    let sample = |of: &LatencySample| NormalizedSample {
        t_s: of.t_s,
        residual: scaled(&of.residual),
        velocity: scaled(&of.velocity),
        loads: of.loads,
        joint_noise: of.joint_noise / noise[1],
    };
    latency_samples.iter().map(sample).collect()
}

/// Uses windows with enough variation of velocity.
pub(super) fn windows(samples: &[NormalizedSample], components: usize) -> Vec<LatencyWindow> {
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

/// Slope of residual over velocity. Autocorrelation ρ inflates the variance by (1 + ρ)/(1 − ρ).
pub(super) fn window(samples: &[NormalizedSample], components: usize) -> Option<LatencyWindow> {
    const MAX_AUTOCORRELATION: f64 = 0.98;
    let n = samples.len();
    if n < MIN_WINDOW_SAMPLES {
        return None;
    }
    let mean = |of: &dyn Fn(&NormalizedSample) -> [f64; 6]| {
        let mut sum = [0.0; 6];
        for sample in samples {
            sum.iter_mut().zip(of(sample)).for_each(|(sum, value)| *sum += value / n as f64);
        }
        sum
    };
    let (mean_left, mean_v) = (mean(&|sample| sample.residual), mean(&|sample| sample.velocity));
    let centred = |sample: &NormalizedSample| {
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
    let rho = (lagged / square.max(f64::MIN_POSITIVE)).clamp(0.0, MAX_AUTOCORRELATION);
    // The slope and each component's mean use them up.
    let free = components * (n - 1) - 1;
    let variance = square / free as f64 * (1.0 + rho) / (1.0 - rho);
    // Stamps rounded to nanoseconds, and positions.
    let std_error_s = (variance.max(1e-3) / information).sqrt().max(1e-6);
    // Encoder rounding can be biased over a whole window.
    let rows = (components * n) as f64;
    let joint_noise = samples.iter().map(|sample| sample.joint_noise).sum::<f64>() / n as f64;
    let std_error_s = std_error_s.hypot(joint_noise / (information / rows).sqrt());
    let t_s = samples.iter().map(|sample| sample.t_s).sum::<f64>() / n as f64;
    std_error_s.is_finite().then_some(LatencyWindow { t_s, delta_s, std_error_s })
}

/// χ² relative to the best line.
pub(super) fn chi2_of_line(windows: &[LatencyWindow]) -> f64 {
    let weight: f64 = windows.iter().map(LatencyWindow::weight).sum();
    let mean = |of: &dyn Fn(&LatencyWindow) -> f64| {
        windows.iter().map(|window| window.weight() * of(window)).sum::<f64>() / weight
    };
    let (t, delta) = (mean(&|window| window.t_s), mean(&|window| window.delta_s));
    let spread = mean(&|window| (window.t_s - t).powi(2));
    let slope =
        mean(&|window| (window.t_s - t) * (window.delta_s - delta)) / spread.max(f64::MIN_POSITIVE);
    let deviation = |window: &LatencyWindow| window.delta_s - delta - slope * (window.t_s - t);
    windows.iter().map(|window| window.weight() * deviation(window).powi(2)).sum()
}

/// Levels between `splits`, and the total χ².
pub(super) fn levels(windows: &[LatencyWindow], splits: &[usize]) -> (Vec<Measured>, f64) {
    let ends = splits.iter().copied().chain([windows.len()]);
    let starts = std::iter::once(0).chain(splits.iter().copied());
    let mut chi2 = 0.0;
    let levels = starts.zip(ends).map(|(start, end)| {
        let part = &windows[start..end];
        let weight: f64 = part.iter().map(LatencyWindow::weight).sum();
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

/// Positions of latency steps. The window with the step fits neither level and increases the χ² of both.
pub(super) fn splits(windows: &[LatencyWindow]) -> Vec<usize> {
    let mut splits: Vec<usize> = Vec::new();
    while splits.len() < MAX_STEPS {
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
        if before - after < MIN_CHI2_GAIN * (after / left).max(1.0) {
            break;
        }
        splits = best;
    }
    splits
}
