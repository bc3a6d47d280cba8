//! Samples as sums over windows of about a second, and over short bins within.

use super::{LatencySample, typical_std_error_s};
use ground::stats::{Measured, mean};
use nalgebra::{DMatrix, DVector, Vector6};

/// The residual has a free constant in each window.
const WINDOW_S: f64 = 1.0;
/// The latency is constant in a bin, so this is also the resolution of its times.
pub(super) const BIN_S: f64 = 0.05;

/// Levels that contribute to a latency, with their factors. Those of factor 0 do not.
pub(super) type Terms = [(usize, f64); 4];

/// Sums over the samples of a bin.
pub(super) struct Bin {
    /// Mean stamp.
    pub t_s: f64,
    /// Of its first sample.
    pub loads: [f64; 2],
    pub velocity: Vector6<f64>,
    pub squared_velocity: f64,
    /// Of velocity and residual.
    pub product: f64,
}

/// Sums over the samples of a window. Residuals are those before any compensation of the latency.
pub(super) struct Window {
    pub t_s: f64,
    pub latency_s: Measured,
    /// Variances of the samples' noise per variance of independent noise.
    scale: f64,
    samples: f64,
    residual: Vector6<f64>,
    squared_residual: f64,
    /// With the best constant latency beyond the compensated one.
    constant_square: f64,
    pub bins: Vec<Bin>,
}

impl Window {
    /// Squared residual with these latencies of its bins beyond that with a constant one, in units of the noise.
    pub fn excess(&self, latencies_s: impl Iterator<Item = f64>) -> f64 {
        let (mut square, mut sum) = (self.squared_residual, self.residual);
        for (bin, latency_s) in self.bins.iter().zip(latencies_s) {
            square += latency_s * (2.0 * bin.product + latency_s * bin.squared_velocity);
            sum += latency_s * bin.velocity;
        }
        self.scale * (square - sum.norm_squared() / self.samples - self.constant_square)
    }

    /// Adds the normal equations of the levels of a latency. `terms` are a bin's levels with their factors.
    pub fn accumulate(
        &self,
        terms: impl Fn(usize, f64) -> Terms,
        matrix: &mut DMatrix<f64>,
        right: &mut DVector<f64>,
        velocities: &mut [Vector6<f64>],
    ) {
        let (mut first, mut last) = (usize::MAX, 0);
        for (at, bin) in self.bins.iter().enumerate() {
            let terms = terms(at, bin.t_s);
            let terms = || terms.into_iter().filter(|term| term.1 != 0.0);
            for (row, a) in terms() {
                (first, last) = (first.min(row), last.max(row));
                right[row] -= self.scale * a * bin.product;
                velocities[row] += a * bin.velocity;
                for (column, b) in terms() {
                    matrix[(row, column)] += self.scale * a * b * bin.squared_velocity;
                }
            }
        }
        let share = self.scale / self.samples;
        for row in first..=last {
            right[row] += share * velocities[row].dot(&self.residual);
            for column in first..=last {
                matrix[(row, column)] -= share * velocities[row].dot(&velocities[column]);
            }
        }
        velocities[first..=last].fill(Vector6::zeros());
    }

    /// The same with a constant latency.
    pub fn as_one_bin(&self) -> Self {
        let Self { t_s, latency_s, .. } = *self;
        let (squared_velocity, value) = (latency_s.std_error.powi(-2), latency_s.value);
        let product = -value * squared_velocity;
        let (loads, velocity) = ([0.0; 2], Vector6::zeros());
        Self {
            t_s,
            latency_s,
            scale: 1.0,
            samples: 1.0,
            residual: Vector6::zeros(),
            squared_residual: value * value * squared_velocity,
            constant_square: 0.0,
            bins: vec![Bin { t_s, loads, velocity, squared_velocity, product }],
        }
    }

    /// Slope of residual over velocity. Autocorrelation ρ inflates the variance by (1 + ρ)/(1 − ρ). `None` without
    /// enough variation of velocity. `compensated_s` is the latency that the residuals do not contain.
    fn new(
        samples: &[LatencySample],
        components: usize,
        compensated_s: impl Fn(f64) -> f64,
    ) -> Option<Self> {
        const MIN_SAMPLES: usize = 10;
        const MAX_AUTOCORRELATION: f64 = 0.98;
        let n = samples.len() as f64;
        if samples.len() < MIN_SAMPLES {
            return None;
        }
        let mean_of = |of: fn(&LatencySample) -> Vector6<f64>| {
            samples.iter().map(of).sum::<Vector6<f64>>() / n
        };
        let means = [mean_of(|sample| sample.residual), mean_of(|sample| sample.velocity)];
        let centred = samples.iter().map(|it| (it.residual - means[0], it.velocity - means[1]));
        let centred: Vec<(Vector6<f64>, Vector6<f64>)> = centred.collect();
        let information: f64 = centred.iter().map(|(_, velocity)| velocity.norm_squared()).sum();
        let product: f64 = centred.iter().map(|(residual, velocity)| velocity.dot(residual)).sum();
        if information <= 0.0 {
            return None;
        }
        let delta_s = -product / information;
        let rest = centred.iter().map(|(residual, velocity)| residual + delta_s * velocity);
        let rest: Vec<Vector6<f64>> = rest.collect();
        let constant_square: f64 = rest.iter().map(Vector6::norm_squared).sum();
        let lagged: f64 = rest.windows(2).map(|pair| pair[0].dot(&pair[1])).sum();
        let rho = (lagged / constant_square.max(f64::MIN_POSITIVE)).clamp(0.0, MAX_AUTOCORRELATION);
        // The slope and each component's mean use them up.
        let free = components * (samples.len() - 1) - 1;
        let variance = constant_square / free as f64 * (1.0 + rho) / (1.0 - rho);
        // Stamps rounded to nanoseconds, and positions.
        let std_error_s = (variance.max(1e-3) / information).sqrt().max(1e-6);
        // Encoder rounding can be biased over a whole window.
        let rows = components as f64 * n;
        let joint_noise = mean(samples.iter().map(|sample| sample.joint_noise));
        let std_error = std_error_s.hypot(joint_noise / (information / rows).sqrt());
        // Acceleration adds a residual of the second order in the latency.
        let accelerations = samples.windows(2).map(|pair| {
            let change = pair[1].velocity - pair[0].velocity;
            change.norm_squared() / (pair[1].t_s - pair[0].t_s).powi(2)
        });
        let squared_velocity: f64 =
            samples.iter().map(|sample| sample.velocity.norm_squared()).sum();
        let rate = (accelerations.sum::<f64>() / squared_velocity).sqrt();
        let std_error = std_error.hypot(0.5 * rate * delta_s * delta_s);
        let t_s = mean(samples.iter().map(|sample| sample.t_s));
        let value = delta_s + compensated_s(t_s);
        let as_logged = samples.iter().map(|sample| LatencySample {
            residual: sample.residual - compensated_s(sample.t_s) * sample.velocity,
            ..*sample
        });
        let as_logged: Vec<LatencySample> = as_logged.collect();
        let bin_of = |sample: &LatencySample| ((sample.t_s - samples[0].t_s) / BIN_S) as usize;
        let bin = |own: &[LatencySample]| Bin {
            t_s: mean(own.iter().map(|sample| sample.t_s)),
            loads: own[0].loads,
            velocity: own.iter().map(|sample| sample.velocity).sum(),
            squared_velocity: own.iter().map(|sample| sample.velocity.norm_squared()).sum(),
            product: own.iter().map(|sample| sample.velocity.dot(&sample.residual)).sum(),
        };
        std_error.is_finite().then_some(Self {
            t_s,
            latency_s: Measured { value, std_error, dof: f64::INFINITY },
            scale: (std_error.powi(2) * information).recip(),
            samples: n,
            residual: as_logged.iter().map(|sample| sample.residual).sum(),
            squared_residual: as_logged.iter().map(|sample| sample.residual.norm_squared()).sum(),
            constant_square,
            bins: as_logged.chunk_by(|a, b| bin_of(a) == bin_of(b)).map(bin).collect(),
        })
    }
}

/// Noise of each kind, from differences between samples, m and rad.
pub(super) fn noise(samples: &[LatencySample]) -> [f64; 2] {
    /// In m and rad.
    const FLOOR: f64 = 1e-6;
    [0, 1].map(|kind| {
        let steps = samples.windows(2).map(|pair| pair[1].residual - pair[0].residual);
        let square: f64 = steps.map(|step| step.fixed_rows::<3>(3 * kind).norm_squared()).sum();
        (square / (6 * samples.len().max(1)) as f64).sqrt().max(FLOOR)
    })
}

/// Samples in units of this noise, at their logged stamps.
pub(super) fn normalized(
    samples: &[LatencySample],
    noise: [f64; 2],
    logged_s: impl Fn(f64) -> f64,
) -> Vec<LatencySample> {
    let scaled = |parts: &Vector6<f64>| Vector6::from_fn(|at, _| parts[at] / noise[at / 3]);
    let sample = |of: &LatencySample| LatencySample {
        t_s: logged_s(of.t_s),
        residual: scaled(&of.residual),
        velocity: scaled(&of.velocity),
        loads: of.loads,
        joint_noise: of.joint_noise / noise[1],
    };
    samples.iter().map(sample).collect()
}

/// Number of windows, less those with larger standard errors than usual.
pub(super) fn effective_count(windows: &[Window]) -> f64 {
    let usual_s = typical_std_error_s(windows);
    let certainty = |window: &Window| window.latency_s.std_error.max(usual_s).recip();
    let sum: f64 = windows.iter().map(certainty).sum();
    let squares: f64 = windows.iter().map(|window| certainty(window).powi(2)).sum();
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

pub(super) fn windows(
    samples: &[LatencySample],
    components: usize,
    compensated_s: impl Fn(f64) -> f64,
) -> Vec<Window> {
    let mut windows = Vec::new();
    let mut rest = samples;
    while let Some(first) = rest.first() {
        let length = rest.partition_point(|sample| sample.t_s < first.t_s + WINDOW_S);
        let (own, after) = rest.split_at(length.max(1));
        windows.extend(Window::new(own, components, &compensated_s));
        rest = after;
    }
    windows
}
