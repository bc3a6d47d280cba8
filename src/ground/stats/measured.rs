use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// Estimate, in the unit of the containing field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Estimate.
    pub value: f64,
    /// Corrected for autocorrelated residuals.
    pub std_error: f64,
    /// Effective degrees of freedom.
    pub dof: f64,
}

impl Measured {
    /// Half-width of the interval with this coverage (Student's t).
    pub fn half_width(&self, confidence: f64) -> f64 {
        if !self.std_error.is_finite() {
            return f64::INFINITY;
        }
        quantile(0.5 + 0.5 * confidence, self.dof) * self.std_error
    }

    /// Interval with this coverage.
    pub fn interval(&self, confidence: f64) -> [f64; 2] {
        let half = self.half_width(confidence);
        [self.value - half, self.value + half]
    }

    /// The same with its magnitude.
    pub fn abs(&self) -> Self {
        Self { value: self.value.abs(), ..*self }
    }

    /// Multiplied by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { value: self.value * factor, std_error: self.std_error * factor.abs(), ..*self }
    }

    /// With another, independent error.
    pub fn with_error(&self, std_error: f64) -> Self {
        Self { std_error: self.std_error.hypot(std_error), ..*self }
    }
}

/// Length of a measured vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLength {
    /// Its interval includes zero unless zero is rejected.
    pub norm: Measured,
    /// Probability of such values if all components are zero.
    pub p_value: f64,
}

impl MeasuredLength {
    /// Estimates the length of `vector` from the `covariance` of its errors, with `dof` degrees of freedom.
    ///
    /// Noise lengthens a vector: `E|v̂|² = |v|² + tr C`. `|v|²` is therefore estimated by `|v̂|² − tr C`,
    /// with variance `4 vᵀCv + 2 tr C²` for normal errors (Mathai and Provost, *Quadratic Forms in Random
    /// Variables*, 1992, §3.2). `4 v̂ᵀCv̂` exceeds that by `2 tr C²` on average, which compensates for
    /// shortening by noise. The bounds are computed from the squared length.
    pub fn estimate(vector: &[f64], covariance: &DMatrix<f64>, dof: f64) -> Self {
        /// Standard deviations in half of a 95 % interval, rounded down to keep a bound at zero.
        const HALF_WIDTH_SIGMAS: f64 = 1.9599;
        /// p-value above which the interval includes zero.
        const MAX_SIGNIFICANT_P_VALUE: f64 = 1e-3;
        /// Standard deviations by which noise may have shortened a vector.
        const SHORTENING_SIGMAS: f64 = 1.4;
        let v = DVector::from_column_slice(vector);
        let (spread, square_spread) = (covariance.trace(), covariance.norm_squared());
        let along = (v.transpose() * covariance * &v)[(0, 0)];
        let square = (v.norm_squared() - spread).max(0.0);
        let variance = (4.0 * along).max(2.0 * square_spread);
        let reach = HALF_WIDTH_SIGMAS * variance.sqrt();
        let value = square.sqrt();
        let p_value = joint_p_value(&v, covariance, dof);
        let (mut above, mut below) =
            ((square + reach).sqrt() - value, value - (square - reach).max(0.0).sqrt());
        if square <= reach || p_value > MAX_SIGNIFICANT_P_VALUE {
            // Near zero, the distribution of the square is skewed and noise may have shortened the vector.
            above = above.max(v.norm() + SHORTENING_SIGMAS * largest_std_error(covariance) - value);
            below = value;
        }
        let std_error = above.max(below) / HALF_WIDTH_SIGMAS;
        Self { norm: Measured { value, std_error, dof }, p_value }
    }
}

fn largest_std_error(covariance: &DMatrix<f64>) -> f64 {
    covariance.clone().symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// For all components being zero: Hotelling's T² test, or Wald's if `dof` is large.
pub fn joint_p_value(vector: &DVector<f64>, covariance: &DMatrix<f64>, dof: f64) -> f64 {
    let Some(cholesky) = covariance.clone().cholesky() else {
        return 1.0;
    };
    let count = vector.len() as f64;
    let statistic = vector.dot(&cholesky.solve(vector));
    if !statistic.is_finite() {
        return 1.0;
    }
    if dof >= MIN_NORMAL_DOF {
        return ChiSquared::new(count).map_or(1.0, |chi| chi.sf(statistic));
    }
    FisherSnedecor::new(count, dof.max(2.0)).map_or(1.0, |f| f.sf(statistic / count))
}

/// Degrees of freedom from which the normal quantile replaces Student's t. The difference is below 0.3 %
/// even at p = 1 − 1e-6.
const MIN_NORMAL_DOF: f64 = 2000.0;

fn quantile(p: f64, dof: f64) -> f64 {
    if dof >= MIN_NORMAL_DOF {
        return Normal::standard().inverse_cdf(p);
    }
    StudentsT::new(0.0, 1.0, dof.max(2.0)).map_or(f64::INFINITY, |t| t.inverse_cdf(p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// SciPy 1.17: `scipy.stats.t.ppf(p, dof)`.
    #[test]
    fn t_quantiles_match_tables() {
        for (p, dof, expected) in [
            (0.975, 5.0, 2.570_581_835_6),
            (0.975, 30.0, 2.042_272_456_3),
            (0.9995, 19.0, 3.883_405_852_6),
            (0.975, f64::INFINITY, 1.959_963_984_5),
        ] {
            assert!((quantile(p, dof) - expected).abs() < 1e-6, "{p} {dof}: {}", quantile(p, dof));
        }
        let just_below = quantile(1.0 - 1e-6, 1999.0);
        assert!((just_below / quantile(1.0 - 1e-6, 2000.0) - 1.0).abs() < 0.004);
    }

    fn lengths(true_vector: [f64; 3], sigma: [f64; 3]) -> Vec<MeasuredLength> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
        let covariance = DMatrix::from_diagonal(&DVector::from_iterator(3, sigma.map(|s| s * s)));
        (0..4000)
            .map(|_| {
                let noisy: [f64; 3] = std::array::from_fn(|i| {
                    let error: f64 = StandardNormal.sample(&mut rng);
                    true_vector[i] + sigma[i] * error
                });
                MeasuredLength::estimate(&noisy, &covariance, f64::INFINITY)
            })
            .collect()
    }

    #[test]
    fn the_interval_of_a_length_covers_the_truth_for_any_length_and_covariance() {
        for sigma in [[1.0, 1.0, 1.0], [1.0, 1.0, 0.1], [1.0, 0.1, 0.1]] {
            for direction in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]] {
                for size in [0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 30.0] {
                    let all = lengths(direction.map(|part| size * part), sigma);
                    let covers = |length: &&MeasuredLength| {
                        let [low, high] = length.norm.interval(0.95);
                        (low..=high).contains(&size)
                    };
                    let share = all.iter().filter(covers).count() as f64 / all.len() as f64;
                    assert!(share > 0.9, "{share} of {size} along {direction:?} in {sigma:?}");
                }
            }
        }
    }

    #[test]
    fn an_uncertain_direction_does_not_lengthen_a_vector() {
        let all = lengths([3.0, 0.0, 0.0], [0.01, 0.01, 1.0]);
        let mean = all.iter().map(|length| length.norm.value).sum::<f64>() / all.len() as f64;
        assert!((mean - 3.0).abs() < 0.06, "{mean}");
    }

    #[test]
    fn a_vector_of_noise_is_rarely_significant() {
        let all = lengths([0.0; 3], [1.0, 0.3, 2.0]);
        let significant = |bound: f64| all.iter().filter(|length| length.p_value < bound).count();
        assert!(
            (150..250).contains(&significant(0.05)) && significant(0.001) < 14,
            "{}",
            significant(0.05)
        );
        assert!(all.iter().filter(|length| length.norm.interval(0.95)[0] > 0.0).count() < 40);
    }

    #[test]
    fn an_infinite_standard_error_gives_an_unbounded_interval() {
        let blind = Measured { value: 1.0, std_error: f64::INFINITY, dof: 10.0 };
        assert_eq!(blind.interval(0.95), [f64::NEG_INFINITY, f64::INFINITY]);
    }
}
