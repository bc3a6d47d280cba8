//! Piecewise linear latency of a stream, which may also step.

/// Piecewise linear latency of a stream, constant before the first knot and after the last one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PiecewiseLatency {
    /// Stamp, s from the run's origin, and latency, s. Two at the time of a step.
    pub knots: Vec<(f64, f64)>,
}

impl PiecewiseLatency {
    /// Constant from each time on, up to the next. The first of at least two levels also applies before its time.
    pub fn with_steps(levels: &[(f64, f64)]) -> Self {
        let steps = levels.windows(2);
        Self { knots: steps.flat_map(|two| [(two[1].0, two[0].1), two[1]]).collect() }
    }

    /// Latency at a stamp, s. 0 without knots.
    pub(crate) fn at(&self, t_s: f64) -> f64 {
        let after = self.knots.partition_point(|knot| knot.0 <= t_s);
        let knot = |index: usize| self.knots.get(index).copied();
        match (after.checked_sub(1).and_then(knot), knot(after)) {
            (Some((a_s, a)), Some((b_s, b))) => a + (b - a) * ((t_s - a_s) / (b_s - a_s)),
            (Some((_, nearest)), None) | (None, Some((_, nearest))) => nearest,
            (None, None) => 0.0,
        }
    }

    /// Logged stamp of a compensated one, s.
    pub(crate) fn logged_s(&self, t_s: f64) -> f64 {
        // Fixed-point iteration; converges because the latency changes slowly.
        (0..3).fold(t_s, |logged_s, _| t_s + self.at(logged_s))
    }
}
