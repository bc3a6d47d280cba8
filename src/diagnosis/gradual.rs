//! A stream's latency that goes along straight pieces by much.

use super::LatencyCourse;
use super::large::{Followed, in_order, left};
use super::latency::Speed;

/// A latency along straight pieces between knots, as it was taken off a stream's stamps.
#[derive(Clone, Debug, PartialEq)]
pub struct GradualLatency {
    /// Stamps, s from the run's origin, and how late the stream is there, s. Two at least.
    knots: Vec<(f64, f64)>,
}

/// One, what it leaves of the squares of the speeds, and what a latency that grows steadily leaves.
pub(super) struct Fitted {
    pub gradual: GradualLatency,
    pub left: f64,
    pub of_line: f64,
}

impl GradualLatency {
    /// That of a stream whose speed follows the arm's in windows at lags that change along them, with what it leaves
    /// of the speeds and what the best straight line leaves. `None` where the windows hardly differ.
    pub(super) fn of(arm: &Speed, stream: &Speed, windows: &[&Followed]) -> Option<Fitted> {
        /// Less than this is small beside a second of motion, s.
        const LEAST_S: f64 = 0.035;
        /// A latency that strays less from a straight line grows steadily, s.
        const BENT_S: f64 = 0.005;
        /// Knots without which a course is a line.
        const KNOTS: usize = 6;
        let (first, last) = (windows.first()?, windows.last()?);
        let (begin_s, end_s) = (*arm.t_s.first()?, *arm.t_s.last()?);
        let inner = windows.iter().map(|window| (window.middle_s, window.lag_s));
        let inner = inner.filter(|(middle_s, _)| (begin_s..end_s).contains(middle_s));
        let whole = [(begin_s, first.lag_s)].into_iter().chain(inner);
        let whole = whole.chain([(end_s, last.lag_s)]);
        let knots: Vec<(f64, f64)> = whole.map(|(t_s, lag_s)| (t_s + lag_s, lag_s)).collect();
        let lags = || knots.iter().map(|knot| knot.1);
        let swing_s = lags().fold(f64::MIN, f64::max) - lags().fold(f64::MAX, f64::min);
        let is_in_order = knots.windows(2).all(|two| two[1].0 > two[0].0);
        if knots.len() < KNOTS || swing_s < LEAST_S || !is_in_order {
            return None;
        }
        let mut line = Self { knots: vec![knots[0], knots[knots.len() - 1]] };
        let of_line = line.fit(arm, stream);
        let mut rough = Self { knots };
        rough.fit(arm, stream);
        // Windows overlap: between two of them stands another knot.
        let mut gradual = Self { knots: rough.halved() };
        let left = gradual.fit(arm, stream);
        let bends = gradual.knots.iter().any(|knot| (knot.1 - line.lag_s(knot.0)).abs() > BENT_S);
        Some(Fitted { gradual, left: if bends { left } else { of_line }, of_line })
    }

    /// That of a course that was found, if it goes along straight pieces.
    pub(super) fn along(course: &LatencyCourse) -> Option<Self> {
        let knots = &course.levels;
        (course.jumps.is_empty() && knots.len() > 1).then(|| Self { knots: knots.clone() })
    }

    /// How late the stream is at a stamp, s.
    pub(super) fn lag_s(&self, t_s: f64) -> f64 {
        let after = self.knots.partition_point(|knot| knot.0 <= t_s).clamp(1, self.knots.len() - 1);
        let ((a_s, a), (b_s, b)) = (self.knots[after - 1], self.knots[after]);
        a + (b - a) * ((t_s - a_s) / (b_s - a_s)).clamp(0.0, 1.0)
    }

    /// The stamps `t_s` as they would be without it, each with its row; rows that would then come before an
    /// earlier one are left out.
    pub fn straightened(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        in_order(t_s.iter().map(|t_s| t_s - self.lag_s(*t_s)).enumerate())
    }

    /// The stamp that was logged where `t_s` stands without it, s.
    pub(super) fn logged_s(&self, t_s: f64) -> f64 {
        // It changes by much less than a second a second.
        (0..3).fold(t_s, |logged_s, _| t_s + self.lag_s(logged_s))
    }

    /// Moves each knot's lag to where least is left of the speeds, by ever smaller steps; what that is.
    fn fit(&mut self, arm: &Speed, stream: &Speed) -> f64 {
        const STEPS_S: [f64; 5] = [0.02, 0.008, 0.003, 0.001, 0.0003];
        let mut least = left(arm, stream, &|t_s| self.lag_s(t_s));
        for step_s in STEPS_S.into_iter().flat_map(|step_s| [step_s, step_s]) {
            for knot in 0..self.knots.len() {
                for by_s in [step_s, -step_s] {
                    self.knots[knot].1 += by_s;
                    match left(arm, stream, &|t_s| self.lag_s(t_s)) {
                        better if better < least => least = better,
                        _ => self.knots[knot].1 -= by_s,
                    }
                }
            }
        }
        least
    }

    /// The same with a knot amid each piece.
    fn halved(&self) -> Vec<(f64, f64)> {
        let amid = self.knots.windows(2).flat_map(|two| {
            let ((a_s, a), (b_s, b)) = (two[0], two[1]);
            [(a_s, a), (0.5 * (a_s + b_s), 0.5 * (a + b))]
        });
        amid.chain(self.knots.last().copied()).collect()
    }
}
