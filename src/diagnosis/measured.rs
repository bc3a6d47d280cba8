use statrs::distribution::{ContinuousCDF, StudentsT};

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
        let tail = 0.5 + 0.5 * confidence;
        let quantile = StudentsT::new(0.0, 1.0, self.dof.max(2.0))
            .map_or(f64::INFINITY, |t| t.inverse_cdf(tail));
        quantile * self.std_error
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
