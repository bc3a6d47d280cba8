//! Squared differences between the speeds of arm and stream at a latency.

use super::correlation::SpeedSeries;
use ground::stats::mean;

/// After compensation, as a fraction of the speeds' variation.
pub(crate) const MAX_SPEED_RESIDUAL_SHARE: f64 = 0.15;

/// Speeds of an arm and of a stream.
#[derive(Clone, Copy)]
pub(crate) struct SpeedPair<'a> {
    pub arm: &'a SpeedSeries,
    pub stream: &'a SpeedSeries,
}

impl SpeedPair<'_> {
    /// Squared deviation of the stream's speed from its mean.
    pub fn variation(self) -> f64 {
        let values = &self.stream.value;
        let mean = mean(values.iter().copied());
        values.iter().map(|value| (value - mean).powi(2)).sum()
    }

    /// Squared differences of the two speeds at a lag. Where the arm's speed is unknown, the most that a lag that explains
    /// the speeds may leave.
    pub fn differences(self, lag_s: &dyn Fn(f64) -> f64) -> Vec<f64> {
        let count = self.stream.t_s.len().max(1) as f64;
        let unknown = MAX_SPEED_RESIDUAL_SHARE * self.variation() / count;
        let compared = ComparedSpeeds::new(self, lag_s);
        compared.squares().map(|square| square.unwrap_or(unknown)).collect()
    }

    /// Their sum.
    pub fn residual(self, lag_s: &dyn Fn(f64) -> f64) -> f64 {
        self.differences(lag_s).iter().sum()
    }
}

/// Speeds of arm and stream at common times.
pub(crate) struct ComparedSpeeds<'a> {
    speeds: SpeedPair<'a>,
    /// `None` if the arm's speed is unknown.
    pairs: Vec<Option<(f64, f64)>>,
}

impl<'a> ComparedSpeeds<'a> {
    pub fn new(speeds: SpeedPair<'a>, lag_s: &dyn Fn(f64) -> f64) -> Self {
        let mut compared = Self { speeds, pairs: vec![None; speeds.stream.t_s.len()] };
        compared.update((f64::NEG_INFINITY, f64::INFINITY), lag_s);
        compared
    }

    /// Replaces the lag of stamps from the first to the second.
    pub fn update(&mut self, (from_s, to_s): (f64, f64), lag_s: &dyn Fn(f64) -> f64) {
        const MAX_GAP_S: f64 = 0.5;
        let SpeedPair { arm, stream } = self.speeds;
        let first = stream.t_s.partition_point(|t_s| *t_s < from_s);
        let end = stream.t_s.partition_point(|t_s| *t_s <= to_s);
        let samples = stream.t_s[first..end].iter().zip(&stream.value[first..end]);
        let mut left = 0;
        for (pair, (t_s, value)) in self.pairs[first..end].iter_mut().zip(samples) {
            let speed = arm.at(t_s - lag_s(*t_s), MAX_GAP_S, &mut left);
            *pair = speed.map(|speed| (speed, *value));
        }
    }

    fn squares(&self) -> impl Iterator<Item = Option<f64>> {
        let square = |of: fn(&(f64, f64)) -> f64| self.pairs.iter().flatten().map(of).sum::<f64>();
        // The stream may use another length unit.
        let scale = (square(|pair| pair.0 * pair.0) / square(|pair| pair.1 * pair.1)).sqrt();
        let scale = if (0.5..2.0).contains(&scale) || !scale.is_finite() { 1.0 } else { scale };
        self.pairs.iter().map(move |pair| pair.map(|(arm, stream)| (stream - arm / scale).powi(2)))
    }

    /// Where the arm's speed is known.
    pub fn squared_residual(&self) -> f64 {
        self.squares().flatten().sum()
    }
}
