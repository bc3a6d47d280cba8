//! Estimates how a response follows a reference: delay, low-pass time constant and gain.
//!
//! Compares changes over windows rather than derivatives, so noise enters once per window and offsets
//! cancel. The response's change is the gain times the reference's over the same window, `delay` earlier
//! (Ljung, *System Identification*, 2nd ed., §4.2, with at most two poles).

use crate::NotObservable;
use ground::stats::{Measured, lowest, median_of};
use ground::stream::{bracket, hermite_basis};
use nalgebra::{DMatrix, Matrix6, Vector6};

/// One column or groups of three. Times are in s from the run's origin, strictly increasing.
#[derive(Clone, Debug, Default)]
pub(crate) struct TimeSeries {
    pub t_s: Vec<f64>,
    pub columns: Vec<Vec<f64>>,
    /// Time derivatives.
    slopes: Vec<Vec<f64>>,
    /// Longest interpolated interval, s.
    longest_s: f64,
}

/// Changes over time windows, of up to six columns.
#[derive(Clone, Debug, Default)]
pub(crate) struct ResponseChanges {
    /// Start and end, s.
    pub windows: Vec<(f64, f64)>,
    /// One per window; zero beyond the columns.
    pub changes: Vec<Vector6<f64>>,
    /// Number of columns.
    pub width: usize,
}

/// Response to a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Pure delay plus low-pass time constant, s.
    pub delay_s: Measured,
    /// Low-pass time constant, s. 0 if a pure delay fits as well.
    pub low_pass_s: f64,
    /// Response per reference change, column mean.
    pub gain: f64,
    /// Explained share of energy, at most 1.
    pub explained: f64,
}

impl Response {
    /// Cut-off frequency, Hz. `None` without low-pass.
    pub fn corner_hz(&self) -> Option<f64> {
        (self.low_pass_s > 0.0).then(|| 1.0 / (std::f64::consts::TAU * self.low_pass_s))
    }

    /// Delay without the low-pass, s.
    pub fn pure_delay_s(&self) -> f64 {
        self.delay_s.value - self.low_pass_s
    }

    /// First column of the reference that causes the response at `t_s`, which increases. `None` outside the reference and
    /// in its gaps.
    pub(crate) fn reference_at(&self, reference: &TimeSeries, t_s: &[f64]) -> Vec<Option<f64>> {
        let filtered = (self.low_pass_s > 0.0).then(|| reference.filtered(self.low_pass_s));
        let reference = filtered.as_ref().unwrap_or(reference);
        let mut cursor = 0;
        let at = |t_s: &f64| Some(reference.at(t_s - self.pure_delay_s(), &mut cursor)?[0]);
        t_s.iter().map(at).collect()
    }
}

impl TimeSeries {
    /// From columns with common times. Gaps are longer than 0.2 s and five median intervals.
    pub fn new(t_s: Vec<f64>, columns: Vec<Vec<f64>>) -> Self {
        const MIN_GAP_S_PERIODS: (f64, f64) = (0.2, 5.0);
        let period_s = median_of(t_s.windows(2).map(|pair| pair[1] - pair[0])).unwrap_or(0.0);
        let slopes = columns.iter().map(|column| slopes(&t_s, column)).collect();
        let longest_s = MIN_GAP_S_PERIODS.0.max(MIN_GAP_S_PERIODS.1 * period_s);
        Self { t_s, columns, slopes, longest_s }
    }

    /// The same motion with the opposite sign.
    pub fn negated(&self) -> Self {
        let negate = |columns: &[Vec<f64>]| -> Vec<Vec<f64>> {
            columns.iter().map(|column| column.iter().map(|value| -value).collect()).collect()
        };
        Self {
            columns: negate(&self.columns),
            slopes: negate(&self.slopes),
            t_s: self.t_s.clone(),
            ..*self
        }
    }

    /// Cubic Hermite. `None` outside the series and in gaps.
    fn at(&self, t_s: f64, cursor: &mut usize) -> Option<Vector6<f64>> {
        let before = bracket(&self.t_s, t_s, cursor)?;
        let from_s = self.t_s[before];
        let length_s = self.t_s[before + 1] - from_s;
        let [start, start_slope, end, end_slope] = hermite_basis((t_s - from_s) / length_s);
        let columns = self.columns.iter().zip(&self.slopes);
        let mut values = Vector6::zeros();
        for (value, (column, slopes)) in values.iter_mut().zip(columns) {
            let by_slopes = start_slope * slopes[before] + end_slope * slopes[before + 1];
            *value = start * column[before] + end * column[before + 1] + length_s * by_slopes;
        }
        (length_s <= self.longest_s).then_some(values)
    }

    /// First-order low-pass, exact for linear interpolation. Restarts after a gap.
    fn filtered(&self, constant_s: f64) -> Self {
        let filter = |column: &Vec<f64>| {
            let mut filtered = Vec::with_capacity(column.len());
            let mut last = column.first().copied().unwrap_or(0.0);
            filtered.extend(column.first());
            for (times, ends) in self.t_s.windows(2).zip(column.windows(2)) {
                let length_s = times[1] - times[0];
                let behind = (ends[1] - ends[0]) / length_s * constant_s;
                let decay = (-length_s / constant_s).exp();
                last = match length_s > self.longest_s {
                    true => ends[1],
                    false => ends[1] - behind + (last - ends[0] + behind) * decay,
                };
                filtered.push(last);
            }
            filtered
        };
        Self::new(self.t_s.clone(), self.columns.iter().map(filter).collect())
    }
}

/// Slopes of parabolas through each sample and its neighbours.
pub(crate) fn slopes(t_s: &[f64], values: &[f64]) -> Vec<f64> {
    let slope = |left: usize| (values[left + 1] - values[left]) / (t_s[left + 1] - t_s[left]);
    let last = values.len().saturating_sub(1);
    let at = |row: usize| match row {
        _ if last == 0 => 0.0,
        0 => slope(0),
        row if row == last => slope(last - 1),
        row => {
            let (before_s, after_s) = (t_s[row] - t_s[row - 1], t_s[row + 1] - t_s[row]);
            (slope(row - 1) * after_s + slope(row) * before_s) / (before_s + after_s)
        }
    };
    (0..values.len()).map(at).collect()
}

struct DelayFit {
    /// Response = gains · reference, within each group of columns.
    gains: Matrix6<f64>,
    /// Mean of the columns' own gains.
    mean_gain: f64,
    /// Over the windows used.
    unexplained_share: f64,
    /// Windows covered by the reference.
    used: usize,
}

impl ResponseChanges {
    /// Windows of `window_s` within `span`, s, without gaps, overlapping by half or thinned in very long
    /// series.
    pub fn from_windows(
        t_s: &[f64],
        columns: &[Vec<f64>],
        span: (f64, f64),
        window_s: f64,
    ) -> Self {
        /// More do not improve the estimate.
        const MAX_WINDOWS: f64 = 1500.0;
        let stride_s = (0.5 * window_s).max((span.1 - span.0) / MAX_WINDOWS);
        let mut changes = Self { width: columns.len(), ..Self::default() };
        let mut first = t_s.partition_point(|&t| t < span.0);
        while first < t_s.len() && t_s[first] <= span.1 {
            let after = |length_s: f64| {
                first + t_s[first..].partition_point(|&t| t < t_s[first] + length_s)
            };
            let (last, next) = (after(window_s), after(stride_s).max(first + 1));
            let is_whole = t_s.get(last).is_some_and(|&to_s| to_s - t_s[first] < 1.5 * window_s);
            if is_whole {
                let mut by = Vector6::zeros();
                by.iter_mut().zip(columns).for_each(|(by, of)| *by = of[last] - of[first]);
                changes.windows.push((t_s[first], t_s[last]));
                changes.changes.push(by);
            }
            first = next;
        }
        changes
    }

    /// Reference changes over windows `delay_s` earlier.
    pub fn references(&self, reference: &TimeSeries, delay_s: f64) -> Vec<Option<Vector6<f64>>> {
        let mut cursors = [0; 2];
        let change = |&(from_s, to_s): &(f64, f64)| {
            let [before, after] = &mut cursors;
            let before = reference.at(from_s - delay_s, before)?;
            Some(reference.at(to_s - delay_s, after)? - before)
        };
        self.windows.iter().map(change).collect()
    }

    /// A single column has at least `min_gain`.
    fn fit(&self, references: &[Option<Vector6<f64>>], min_gain: f64) -> DelayFit {
        // Vectors have three columns.
        let size = if self.width.is_multiple_of(3) { 3 } else { 1 };
        let (mut normal, mut right) = (Matrix6::zeros(), Matrix6::zeros());
        let (mut total, mut used) = (Vector6::zeros(), 0);
        for (by, reference) in self.changes.iter().zip(references) {
            let Some(reference) = reference else { continue };
            normal.ger(1.0, reference, reference, 1.0);
            right.ger(1.0, reference, by, 1.0);
            total += by.component_mul(by);
            used += 1;
        }
        let mut gains = Matrix6::zeros();
        let mut residual = 0.0;
        for first in (0..self.width).step_by(size) {
            let group = ((first, first), (size, size));
            let [normal, right] =
                [&normal, &right].map(|all| all.view(group.0, group.1).into_owned());
            // Columns without motion have no gain.
            let ridge = 1e-9 * normal.trace() + f64::MIN_POSITIVE;
            let inverse = (normal + DMatrix::identity(size, size) * ridge).try_inverse();
            let mut own = inverse.map_or(DMatrix::zeros(size, size), |inverse| inverse * &right);
            if size == 1 {
                own[(0, 0)] = own[(0, 0)].max(min_gain);
            }
            let total = total.rows(first, size).sum();
            residual += (total - own.component_mul(&right).sum()).max(0.0);
            gains.view_mut(group.0, group.1).copy_from(&own.transpose());
        }
        let total = total.sum();
        let unexplained_share = if total > 0.0 { residual / total } else { 1.0 };
        let mean_gain = gains.trace() / self.width.max(1) as f64;
        DelayFit { gains, mean_gain, unexplained_share, used }
    }

    fn fit_at(&self, reference: &TimeSeries, delay_s: f64) -> DelayFit {
        // No negative gain: it fits a periodic signal half a period late.
        self.fit(&self.references(reference, delay_s), 0.0)
    }

    /// 1 if the reference covers too few windows.
    fn unexplained_at(&self, reference: &TimeSeries, delay_s: f64) -> f64 {
        let fit = self.fit_at(reference, delay_s);
        if 2 * fit.used < self.windows.len() { 1.0 } else { fit.unexplained_share }
    }

    /// Best delay between `low` and `high`, s (golden section search).
    fn refined(
        &self,
        reference: &TimeSeries,
        (mut low, mut high): (f64, f64),
        fine_s: f64,
    ) -> (f64, f64) {
        const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;
        let residual_at = |delay_s: f64| self.unexplained_at(reference, delay_s);
        let mut inner = [high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low)];
        let mut samples = inner.map(residual_at);
        while high - low > fine_s {
            if samples[0] <= samples[1] {
                high = inner[1];
                inner = [high - GOLDEN_RATIO * (high - low), inner[0]];
                samples = [residual_at(inner[0]), samples[0]];
            } else {
                low = inner[0];
                inner = [inner[1], low + GOLDEN_RATIO * (high - low)];
                samples = [samples[1], residual_at(inner[1])];
            }
        }
        let best = usize::from(samples[1] < samples[0]);
        (inner[best], samples[best])
    }

    /// Standard error of the delay and its degrees of freedom, for any correlation within time blocks
    /// (Liang and Zeger 1986).
    fn uncertainty(&self, reference: &TimeSeries, delay_s: f64) -> (f64, f64) {
        const MAX_BLOCKS: f64 = 40.0;
        const MIN_BLOCK_S: f64 = 0.5;
        const STEP_S: f64 = 1e-3;
        let references = self.references(reference, delay_s);
        let fit = self.fit(&references, 0.0);
        let [before, after] =
            [-STEP_S, STEP_S].map(|step_s| self.references(reference, delay_s + step_s));
        let slopes = before.iter().zip(&after);
        let slopes = slopes.map(|(before, after)| Some(((*after)? - (*before)?) / (2.0 * STEP_S)));
        let slopes: Vec<Option<Vector6<f64>>> = slopes.collect();
        // Onto the complement of the gains.
        let predicted_slope = |slope: &Option<Vector6<f64>>| {
            slope.map_or(Vector6::zeros(), |slope| fit.gains * slope)
        };
        let changes = slopes.iter().map(predicted_slope).collect();
        let sloped = ResponseChanges { changes, ..self.clone() };
        let sloped_fit = sloped.fit(&references, 0.0);
        let (Some(first), Some(last)) = (self.windows.first(), self.windows.last()) else {
            return (f64::INFINITY, 1.0);
        };
        let block_s = ((last.1 - first.0) / MAX_BLOCKS).max(MIN_BLOCK_S);
        let (mut information, mut blocks) = (0.0, std::collections::BTreeMap::new());
        for (row, reference) in references.iter().enumerate() {
            let (Some(reference), Some(_)) = (reference, slopes[row]) else { continue };
            let change = sloped.changes[row] - sloped_fit.gains * reference;
            let residual = self.changes[row] - fit.gains * reference;
            let block = ((self.windows[row].0 - first.0) / block_s) as u64;
            information += change.norm_squared();
            *blocks.entry(block).or_insert(0.0) += change.dot(&residual);
        }
        let count = blocks.len() as f64;
        if count < 4.0 || information <= 0.0 {
            return (f64::INFINITY, 1.0);
        }
        let square: f64 = blocks.values().map(|sum: &f64| sum * sum).sum::<f64>();
        ((square * count / (count - 1.0)).sqrt() / information, count - 1.0)
    }

    /// Gain of either sign at zero delay, and unexplained share.
    pub fn gain(&self, reference: &TimeSeries) -> (f64, f64) {
        let fit = self.fit(&self.references(reference, 0.0), f64::NEG_INFINITY);
        (fit.mean_gain, fit.unexplained_share)
    }

    /// Response to `reference`, for delays within ±`max_delay_s`.
    ///
    /// # Errors
    /// If too little is explained, or several delays explain it equally.
    pub fn estimate_response(
        &self,
        reference: &TimeSeries,
        max_delay_s: f64,
    ) -> Result<Response, NotObservable> {
        const MIN_EXPLAINED_SHARE: f64 = 0.8;
        const DELAY_RESOLUTION_S: f64 = 2e-5;
        /// Factor and offset to the best unexplained share for a competing delay.
        const COMPETITOR_TOLERANCE: (f64, f64) = (2.0, 0.02);
        let lengths_s = self.windows.iter().map(|(from_s, to_s)| to_s - from_s);
        let step_s = (median_of(lengths_s).unwrap_or(0.1) / 4.0).max(5e-3);
        let steps = (max_delay_s / step_s).ceil() as i64;
        let tested =
            (-steps..=steps).map(|step| self.unexplained_at(reference, step as f64 * step_s));
        let tested: Vec<f64> = std::iter::once(1.0).chain(tested).chain([1.0]).collect();
        let is_low = |around: &[f64]| around[1] <= around[0] && around[1] < around[2];
        let lows = tested.windows(3).zip(-steps..).filter(|(around, _)| is_low(around));
        let refined = |(_, step): (&[f64], i64)| {
            let middle_s = step as f64 * step_s;
            self.refined(reference, (middle_s - step_s, middle_s + step_s), DELAY_RESOLUTION_S)
        };
        let lows: Vec<(f64, f64)> = lows.map(refined).collect();
        let Some(&(delay_s, min_residual)) = lowest(&lows, |low| low.1) else {
            return Err(NotObservable::DoesNotFollow(0.0));
        };
        let (low_pass_s, delay_s, unexplained) =
            self.fit_low_pass(reference, (delay_s, min_residual), max_delay_s);
        let explained = 1.0 - unexplained;
        if explained < MIN_EXPLAINED_SHARE {
            return Err(NotObservable::DoesNotFollow(explained.max(0.0).sqrt()));
        }
        let is_competitor = |low: &&(f64, f64)| {
            low.1 < COMPETITOR_TOLERANCE.0 * min_residual + COMPETITOR_TOLERANCE.1
        };
        let competitors: Vec<f64> = lows.iter().filter(is_competitor).map(|low| low.0).collect();
        if competitors.len() > 1 {
            return Err(NotObservable::Periodic(competitors));
        }
        let filtered = (low_pass_s > 0.0).then(|| reference.filtered(low_pass_s));
        let reference = filtered.as_ref().unwrap_or(reference);
        let (std_error, dof) = self.uncertainty(reference, delay_s);
        Ok(Response {
            delay_s: Measured { value: delay_s + low_pass_s, std_error, dof },
            low_pass_s,
            gain: self.fit_at(reference, delay_s).mean_gain,
            explained,
        })
    }

    /// Time constant, s, remaining delay, s, and unexplained share. The constant is 0 unless it clearly
    /// improves on `pure`, the best pure delay.
    fn fit_low_pass(
        &self,
        reference: &TimeSeries,
        pure: (f64, f64),
        max_delay_s: f64,
    ) -> (f64, f64, f64) {
        /// Unexplained share relative to a pure delay.
        const MAX_LOW_PASS_RATIO: f64 = 0.75;
        /// Gain in the unexplained share.
        const MIN_GAIN: f64 = 1e-6;
        /// Share of the whole delay.
        const MIN_LOW_PASS_SHARE: f64 = 0.2;
        const MIN_TIME_CONSTANT_S: f64 = 2e-3;
        const TIME_CONSTANT_STEPS: usize = 24;
        /// Unexplained share relative to a pure delay, at the best of every second constant. It changes little over the
        /// steps between, so above it no constant reaches `MAX_LOW_PASS_RATIO`.
        const MAX_COARSE_RATIO: f64 = 0.9;
        /// In s, and relative to the time constant.
        const REMAINING_DELAY_RESOLUTION: (f64, f64) = (1e-4, 0.02);
        let with = |constant_s: f64| {
            let filtered = reference.filtered(constant_s);
            let middle_s = pure.0 - constant_s;
            let around_s = (0.5 * constant_s).max(5e-3);
            let fine_s =
                REMAINING_DELAY_RESOLUTION.0.max(REMAINING_DELAY_RESOLUTION.1 * constant_s);
            let (delay_s, residual) =
                self.refined(&filtered, (middle_s - around_s, middle_s + around_s), fine_s);
            (constant_s, delay_s, residual)
        };
        if pure.1 < MIN_GAIN {
            return (0.0, pure.0, pure.1);
        }
        let ratio = (max_delay_s / MIN_TIME_CONSTANT_S).powf(1.0 / TIME_CONSTANT_STEPS as f64);
        let step = |at: usize| with(MIN_TIME_CONSTANT_S * ratio.powi(at as i32));
        let residual = |fit: &(f64, f64, f64)| fit.2;
        let every_second = lowest((0..=TIME_CONSTANT_STEPS).step_by(2).map(step), residual);
        let Some(coarse) = every_second.filter(|best| best.2 < MAX_COARSE_RATIO * pure.1) else {
            return (0.0, pure.0, pure.1);
        };
        let between = (1..TIME_CONSTANT_STEPS).step_by(2).map(step);
        let coarse = lowest(std::iter::once(coarse).chain(between), residual).unwrap_or(coarse);
        let finer = (-6..=6).map(|at| with(coarse.0 * ratio.powf(f64::from(at) / 6.0)));
        let best = lowest(finer, residual).unwrap_or(coarse);
        let is_worth = best.2 < MAX_LOW_PASS_RATIO * pure.1
            && pure.1 - best.2 > MIN_GAIN
            && best.0 > MIN_LOW_PASS_SHARE * (best.0 + best.1);
        // A causal response precedes its reference by stamp errors only.
        let is_causal = best.1 > -0.25 * best.0 - 2e-3;
        if is_worth && is_causal { best } else { (0.0, pure.0, pure.1) }
    }
}

#[cfg(test)]
mod tests;
