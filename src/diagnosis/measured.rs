use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// A number with its standard error.
///
/// The unit is that of the field that holds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The estimate.
    pub value: f64,
    /// Its standard error, corrected for the autocorrelation of the residuals.
    pub std_error: f64,
    /// Effective degrees of freedom behind `std_error`.
    pub dof: f64,
}

impl Measured {
    /// Half the width of the interval that covers the truth with probability `confidence`
    /// (Student's t with `dof` degrees of freedom).
    pub fn half_width(&self, confidence: f64) -> f64 {
        if !self.std_error.is_finite() {
            return f64::INFINITY;
        }
        quantile(0.5 + 0.5 * confidence, self.dof) * self.std_error
    }

    /// The interval that covers the truth with probability `confidence`.
    pub fn interval(&self, confidence: f64) -> [f64; 2] {
        let half = self.half_width(confidence);
        [self.value - half, self.value + half]
    }

    /// This number times `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { value: self.value * factor, std_error: self.std_error * factor.abs(), ..*self }
    }
}

/// Quantile `p` of Student's t with `dof` degrees of freedom.
fn quantile(p: f64, dof: f64) -> f64 {
    /// From here on the normal quantile is within 0.3 % even at p = 1 − 1e-6, and the inverse of t
    /// no longer needed (nor, for infinite `dof`, finite).
    const MANY: f64 = 2000.0;
    if dof >= MANY {
        return Normal::standard().inverse_cdf(p);
    }
    StudentsT::new(0.0, 1.0, dof.max(2.0)).map_or(f64::INFINITY, |t| t.inverse_cdf(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of SciPy 1.17: `scipy.stats.t.ppf(p, dof)`.
    #[test]
    fn quantiles_are_those_of_tables() {
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

    #[test]
    fn no_standard_error_means_no_end_of_the_interval() {
        let blind = Measured { value: 1.0, std_error: f64::INFINITY, dof: 10.0 };
        assert_eq!(blind.interval(0.95), [f64::NEG_INFINITY, f64::INFINITY]);
    }
}
