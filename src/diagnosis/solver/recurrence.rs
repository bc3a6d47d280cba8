//! Errors that recur with the configuration. Deviating links, gears, coarse encoders and rounded positions have the same
//! error whenever the arm returns to a place, however much later. Repeating a motion then adds little information. The
//! autocorrelation in [`super::noise`] does not show this.

use super::noise::Noise;
use ground::geometry::Vec3;
use std::collections::HashMap;

/// Width of a cell of configurations, which is one place, rad or m. Such errors change little within a degree; not calibrated.
const CELL: f64 = 0.02;

/// Place of each sample.
#[derive(Clone, Default)]
pub(crate) struct Places {
    indices: HashMap<Vec<i32>, usize>,
    /// Number of places.
    count: usize,
    of_sample: Vec<usize>,
}

/// Samples of a place. A visit is a series of samples that autocorrelation connects.
#[derive(Clone, Copy, Default)]
struct Visits {
    last: usize,
    /// Weighted sum of the residuals, and of the weights.
    current: (Vec3, f64),
    all: (Vec3, f64),
    /// Sums over the finished visits: the squared sum of residuals, and the squared weight.
    squares: (f64, f64),
}

impl Visits {
    fn end_visit(&mut self) {
        let (sum, weight) = std::mem::take(&mut self.current);
        self.squares.0 += sum.norm_squared();
        self.squares.1 += weight * weight;
        self.all.0 += sum;
        self.all.1 += weight;
    }
}

impl Places {
    /// Appends a sample with these joint positions.
    pub fn push(&mut self, q: &[f64]) {
        let cell: Vec<i32> = q.iter().map(|q| (q / CELL).floor() as i32).collect();
        let next = self.indices.len();
        self.of_sample.push(*self.indices.entry(cell).or_insert(next));
        self.count = self.indices.len();
    }

    pub fn subset(&self, samples: &[usize]) -> Self {
        let of_sample = samples.iter().filter_map(|&at| self.of_sample.get(at).copied()).collect();
        Self { of_sample, count: self.count, indices: HashMap::new() }
    }

    /// Inflation of the variance of a mean by recurring errors, in addition to that of `noise`: the covariances of a
    /// residual with all residuals of other visits to its place, relative to the variance. 0 if not significant.
    pub fn inflation(&self, residual: &[Vec3], weights: &[f64], noise: &Noise) -> f64 {
        /// In standard errors, as for autocorrelation.
        const MAX_CHANCE: f64 = 3.0;
        /// In time constants of the autocorrelation, which then falls to 5 %.
        const MIN_ABSENCE: f64 = 3.0;
        let lasts = if noise.share > 0.0 { MIN_ABSENCE / (1.0 - noise.rho) } else { 1.0 };
        let mut places = vec![Visits::default(); self.count];
        for (sample, (&place, (r, w))) in
            self.of_sample.iter().zip(residual.iter().zip(weights)).enumerate()
        {
            let visits = &mut places[place];
            if (sample - visits.last) as f64 > lasts {
                visits.end_visit();
            }
            visits.last = sample;
            visits.current.0 += *w * r;
            visits.current.1 += w;
        }
        let (mut covariance, mut pairs, mut total) = (0.0, 0.0, 0.0);
        for visits in &mut places {
            visits.end_visit();
            covariance += visits.all.0.norm_squared() - visits.squares.0;
            pairs += visits.all.1.powi(2) - visits.squares.1;
            total += visits.all.1;
        }
        let scale = 3.0 * total * noise.sigma.powi(2);
        // Of independent residuals with three components each.
        let chance = (6.0 * pairs).sqrt() * noise.sigma.powi(2) * noise.inflation();
        if covariance > MAX_CHANCE * chance { covariance / scale } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::noise::rms;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const CYCLES: usize = 40;
    const SAMPLES: usize = 50;

    /// Inflation for a motion of many cycles, with an error of `recurring` in each place and white noise of 1.
    fn inflation(recurring: f64) -> f64 {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
        let mut normal = || Vec3::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let errors: Vec<Vec3> = (0..SAMPLES).map(|_| recurring * normal()).collect();
        let mut places = Places::default();
        let residual: Vec<Vec3> = (0..CYCLES * SAMPLES)
            .map(|k| {
                places.push(&[0.1 * (k % SAMPLES) as f64, 0.0]);
                errors[k % SAMPLES] + normal()
            })
            .collect();
        let noise = Noise::white(rms(&residual) / 3f64.sqrt());
        places.inflation(&residual, &vec![1.0; residual.len()], &noise)
    }

    #[test]
    fn white_noise_does_not_recur() {
        assert_eq!(inflation(0.0), 0.0);
    }

    /// Each cycle repeats the errors, so all cycles together determine a mean as one does.
    #[test]
    fn errors_of_every_cycle_count_once() {
        for recurring in [0.3, 1.0] {
            let share = recurring * recurring / (1.0 + recurring * recurring);
            let expected = share * (CYCLES - 1) as f64;
            let found = inflation(recurring);
            assert!((found / expected - 1.0).abs() < 0.3, "{found} against {expected}");
        }
    }
}
