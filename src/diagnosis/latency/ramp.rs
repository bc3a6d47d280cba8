//! Fits a piecewise linear latency to the speeds of a stream.

use super::coarse::MIN_VARIATION_S;
use super::lag_windows::LagWindow;
use super::piecewise::PiecewiseLatency;
use super::speed_residual::{ComparedSpeeds, SpeedPair};
use crate::samples::sampling::value_range;

/// Fitted latency with its squared speed residual, and the residual of a linear latency.
pub(crate) struct RampFit {
    pub ramp: PiecewiseLatency,
    pub residual: f64,
    pub line_residual: f64,
}

impl PiecewiseLatency {
    /// Fits the lags of `windows` to samples of the stream's speed. Also returns the speed residuals of this fit and of the best line.
    /// `None` if the lags vary little.
    pub(crate) fn fit_windows(speeds: SpeedPair, windows: &[&LagWindow]) -> Option<RampFit> {
        /// Smaller deviations are skew.
        const MIN_LINE_DEVIATION_S: f64 = 0.005;
        const MIN_KNOTS: usize = 6;
        let (first, last) = (windows.first()?, windows.last()?);
        let (begin_s, end_s) = speeds.arm.span_s()?;
        let inner = windows.iter().map(|window| (window.middle_s, window.lag_s));
        let inner = inner.filter(|(middle_s, _)| (begin_s..end_s).contains(middle_s));
        let lags = std::iter::once((begin_s, first.lag_s)).chain(inner);
        let lags = lags.chain([(end_s, last.lag_s)]);
        let knots: Vec<(f64, f64)> = lags.map(|(t_s, lag_s)| (t_s + lag_s, lag_s)).collect();
        let range_s = value_range(knots.iter().map(|knot| knot.1));
        let is_in_order = knots.windows(2).all(|two| two[1].0 > two[0].0);
        if knots.len() < MIN_KNOTS || range_s < MIN_VARIATION_S || !is_in_order {
            return None;
        }
        let mut line = Self { knots: vec![knots[0], knots[knots.len() - 1]] };
        let line_residual = line.refine(speeds);
        let mut initial = Self { knots };
        initial.refine(speeds);
        // Windows overlap, so add a knot between every two.
        let mut piecewise = Self { knots: initial.with_midpoints() };
        let residual = piecewise.refine(speeds);
        let deviates = |knot: &(f64, f64)| (knot.1 - line.at(knot.0)).abs() > MIN_LINE_DEVIATION_S;
        let is_nonlinear = piecewise.knots.iter().any(deviates);
        Some(RampFit {
            ramp: piecewise,
            residual: if is_nonlinear { residual } else { line_residual },
            line_residual,
        })
    }

    /// Minimises the speed residual over the lag at each knot, where the arm's speed is known. Returns the residual of all
    /// samples.
    fn refine(&mut self, speeds: SpeedPair) -> f64 {
        const STEPS_S: [f64; 5] = [0.02, 0.008, 0.003, 0.001, 0.0003];
        let mut pairs = ComparedSpeeds::new(speeds, &|t_s| self.at(t_s));
        let mut min_residual = pairs.squared_residual();
        for step_s in STEPS_S.into_iter().flat_map(|step_s| [step_s, step_s]) {
            for knot in 0..self.knots.len() {
                let span_s = self.span_of_knot(knot);
                for by_s in [step_s, -step_s] {
                    self.knots[knot].1 += by_s;
                    pairs.update(span_s, &|t_s| self.at(t_s));
                    match pairs.squared_residual() {
                        lower if lower < min_residual => min_residual = lower,
                        _ => {
                            self.knots[knot].1 -= by_s;
                            pairs.update(span_s, &|t_s| self.at(t_s));
                        }
                    }
                }
            }
        }
        speeds.residual(&|t_s| self.at(t_s))
    }

    /// Stamps whose latency depends on the lag at a knot, s.
    fn span_of_knot(&self, knot: usize) -> (f64, f64) {
        let before = knot.checked_sub(1).filter(|before| *before > 0);
        let after = Some(knot + 1).filter(|after| after + 1 < self.knots.len());
        let at = |knot: Option<usize>| knot.map(|knot| self.knots[knot].0);
        (at(before).unwrap_or(f64::NEG_INFINITY), at(after).unwrap_or(f64::INFINITY))
    }

    fn with_midpoints(&self) -> Vec<(f64, f64)> {
        let midpoints = self.knots.windows(2).flat_map(|two| {
            let ((a_s, a), (b_s, b)) = (two[0], two[1]);
            [(a_s, a), (0.5 * (a_s + b_s), 0.5 * (a + b))]
        });
        midpoints.chain(self.knots.last().copied()).collect()
    }
}
