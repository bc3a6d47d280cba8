//! Joint velocities: logged, or derived from positions.

use nalgebra::{Matrix3, Vector3};

use crate::diagnosis::encoder_step;
use crate::stream::sample_noise;

/// Source of a joint's velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VelocitySource {
    /// Logged and consistent with positions.
    Logged,
    /// Derivatives. Logged ones are close, as with irregularly read rows, and detect motion better.
    DerivedLoggedClose,
    /// Derivatives: logged ones are missing or inconsistent.
    Derived,
}

pub(super) struct SmoothedJoint {
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    /// Noise standard deviations of both, including encoder steps.
    pub noise: [f64; 2],
}

/// Differentiates positions. If noise matters, smooths by local parabolas over up to 0.15 s.
///
/// The criterion is noise divided by typical speed, a timing error: an encoder's 20 µrad at 1 rad/s is 20
/// µs and stays; a hobby servo's 0.5 mrad at 0.05 rad/s is 10 ms and would dominate latencies (Savitzky and
/// Golay 1964).
pub(super) fn smooth(t_s: &[f64], q: &[f64]) -> SmoothedJoint {
    const MAX_TIMING_ERROR_S: f64 = 5e-4;
    const MAX_WINDOW_S: f64 = 0.15;
    let derived = derivative(t_s, q);
    let rows = t_s.len();
    let speed = root_mean_square(&derived);
    let noise = sample_noise(q);
    // Rounding has the variance of a uniform distribution.
    let rounded = noise.max(encoder_step(q) / 12f64.sqrt());
    let span_s = t_s.last().zip(t_s.first()).map_or(0.0, |(last, first)| last - first);
    let period_s = (span_s / rows.saturating_sub(1).max(1) as f64).max(f64::MIN_POSITIVE);
    let as_they_are = |qd: Vec<f64>| SmoothedJoint {
        q: q.to_vec(),
        qd,
        noise: [rounded, rounded / (2f64.sqrt() * period_s)],
    };
    if rows < 9 || noise <= MAX_TIMING_ERROR_S * speed {
        return as_they_are(derived);
    }
    let needed = (noise / (MAX_TIMING_ERROR_S * speed.max(f64::MIN_POSITIVE))).powi(2).ceil();
    let longest = (0.5 * MAX_WINDOW_S / period_s).floor();
    let half = (0.5 * needed.min(1e6)).min(longest) as usize;
    if half < 2 {
        return as_they_are(derived);
    }
    let fitted = |row: usize| {
        let (from, to) = (row.saturating_sub(half), (row + half + 1).min(rows));
        parabola(&t_s[from..to], &q[from..to], t_s[row]).unwrap_or((q[row], derived[row]))
    };
    let (q, qd) = (0..rows).map(fitted).unzip();
    // Variances of a parabola's value and slope at the middle of many even samples.
    let samples = (2 * half + 1) as f64;
    let noise =
        [rounded * (2.25 / samples).sqrt(), rounded * (12.0 / samples.powi(3)).sqrt() / period_s];
    SmoothedJoint { q, qd, noise }
}

/// Value and slope at `at` of the least-squares parabola.
fn parabola(t_s: &[f64], q: &[f64], at: f64) -> Option<(f64, f64)> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (t, q) in t_s.iter().zip(q) {
        let row = Vector3::new(1.0, t - at, (t - at) * (t - at));
        normal += row * row.transpose();
        right += row * *q;
    }
    let fit = normal.lu().solve(&right)?;
    Some((fit[0], fit[1]))
}

pub(super) fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Derivative from parabolas through each sample and its neighbours; at the ends, the outermost three.
/// Exact to second order for uneven samples (Fornberg, "Generation of finite difference formulas on
/// arbitrarily spaced grids", 1988).
pub(super) fn derivative(t_s: &[f64], q: &[f64]) -> Vec<f64> {
    let slope = |left: usize| (q[left + 1] - q[left]) / (t_s[left + 1] - t_s[left]);
    let rows = t_s.len();
    if rows < 3 {
        return vec![if rows == 2 { slope(0) } else { 0.0 }; rows];
    }
    let at = |row: usize| {
        let middle = row.clamp(1, rows - 2);
        let (before, after) = (slope(middle - 1), slope(middle));
        let curvature = (after - before) / (t_s[middle + 1] - t_s[middle - 1]);
        before + curvature * (2.0 * t_s[row] - t_s[middle - 1] - t_s[middle])
    };
    (0..rows).map(at).collect()
}

/// Compares logged velocities with the positions.
///
/// Over 0.1 s, the trapezoidal integral must match the position change within 2 % of its rms plus noise. At
/// rest, velocities must not exceed the derivative. They are near if integrals and changes correlate and
/// their ratio is within a fifth of one.
pub(super) fn compare_velocities(
    t_s: &[f64],
    q: &[f64],
    velocity: &[f64],
    derived: &[f64],
) -> VelocitySource {
    const MAX_RATIO_DEVIATION: f64 = 0.2;
    const WINDOW_S: f64 = 0.1;
    const MIN_MOTION: f64 = 1e-3;
    const MAX_DISAGREEMENT: f64 = 0.02;
    if velocity.len() < 2 || velocity.iter().any(|v| !v.is_finite()) {
        return VelocitySource::Derived;
    }
    let or_else =
        |agrees: bool, other: VelocitySource| if agrees { VelocitySource::Logged } else { other };
    let (mut moved, mut differed, mut windows) = (0.0, 0.0, 0.0);
    let (mut along, mut summed) = (0.0, 0.0);
    let (mut start, mut integral, mut largest) = (0, 0.0, 0.0_f64);
    for row in 1..t_s.len() {
        if t_s[row] - t_s[row - 1] > 2.0 * WINDOW_S {
            (start, integral) = (row, 0.0);
            continue;
        }
        integral += 0.5 * (velocity[row] + velocity[row - 1]) * (t_s[row] - t_s[row - 1]);
        if t_s[row] - t_s[start] < WINDOW_S {
            continue;
        }
        let change = q[row] - q[start];
        largest = largest.max(change.abs());
        moved += change * change;
        along += change * integral;
        summed += integral * integral;
        differed += (integral - change).powi(2);
        windows += 1.0;
        (start, integral) = (row, 0.0);
    }
    if largest < MIN_MOTION {
        let peak = |values: &[f64]| values.iter().fold(0.0_f64, |peak, v| peak.max(v.abs()));
        return or_else(peak(velocity) <= peak(derived), VelocitySource::Derived);
    }
    // Both ends contribute noise; three times its variance exceeds chance.
    let by_noise = 3.0 * windows * 2.0 * sample_noise(q).powi(2);
    let slope = along / moved;
    let is_near = (slope - 1.0).abs() < MAX_RATIO_DEVIATION
        && along * along > (1.0 - MAX_RATIO_DEVIATION) * moved * summed;
    let near = if is_near { VelocitySource::DerivedLoggedClose } else { VelocitySource::Derived };
    or_else(
        differed <= MAX_DISAGREEMENT * MAX_DISAGREEMENT * moved + by_noise.min(0.1 * moved),
        near,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_of_a_parabola_is_exact_on_any_grid() {
        let t_s = [0.0, 0.1, 0.15, 0.4, 0.41, 0.9];
        let q: Vec<f64> = t_s.iter().map(|t| 1.0 - 2.0 * t + 3.0 * t * t).collect();
        for (t, slope) in t_s.iter().zip(derivative(&t_s, &q)) {
            assert!((slope - (6.0 * t - 2.0)).abs() < 1e-12, "{t}");
        }
        assert_eq!(derivative(&[0.0, 2.0], &[1.0, 2.0]), [0.5, 0.5]);
        assert_eq!(derivative(&[0.0], &[1.0]), [0.0]);
    }
}
