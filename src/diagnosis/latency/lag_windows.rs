//! Lag of the highest correlation in each window of several seconds.

use super::correlation::{lag_peaks, max_gap_s, median_period_s, unbroken_spans};
use super::speed_residual::SpeedPair;
use crate::samples::sampling::rows_within;
use std::collections::BTreeSet;

/// Window with the lag of the highest correlation.
pub(crate) struct LagWindow {
    /// In the arm's time, s.
    pub middle_s: f64,
    pub lag_s: f64,
    /// −1 to 1.
    pub correlation: f64,
}

pub(crate) fn lag_windows(SpeedPair { arm, stream }: SpeedPair, max_lag_s: f64) -> Vec<LagWindow> {
    const MIN_COMMON_SHARE: f64 = 0.5;
    const MIN_LENGTH_S: f64 = 5.0;
    const MAX_LENGTH_S: f64 = 10.0;
    let Some((begin_s, end_s)) = arm.span_s() else { return Vec::new() };
    let stream_spans_s = unbroken_spans(&stream.t_s, max_gap_s(median_period_s(&stream.t_s)));
    let length_s = (0.25 * (end_s - begin_s)).clamp(MIN_LENGTH_S, MAX_LENGTH_S);
    let count = (2.0 * (end_s - begin_s) / length_s) as usize;
    let window = |index: usize| {
        let from_s = begin_s + 0.5 * length_s * index as f64;
        let own = arm.at_rows(rows_within(&arm.t_s, from_s, from_s + length_s));
        // A lag can match a short common span by chance, as at the ends of the run and of excerpts.
        let (first_s, last_s) = own.span_s()?;
        let covers = |lag_s: f64| {
            let common_s = stream_spans_s.iter().map(|(start_s, end_s)| {
                ((last_s + lag_s).min(*end_s) - (first_s + lag_s).max(*start_s)).max(0.0)
            });
            common_s.sum::<f64>() > MIN_COMMON_SHARE * (last_s - first_s)
        };
        if !covers(0.0) {
            return None;
        }
        let best = lag_peaks(&own, stream, max_lag_s).into_iter().find(|it| covers(it.lag_s))?;
        let middle_s = from_s + 0.5 * length_s;
        Some(LagWindow { middle_s, lag_s: best.lag_s, correlation: best.correlation })
    };
    // Those with samples: gaps may be long.
    let cells = arm.t_s.iter().map(|t_s| ((t_s - begin_s) / (0.5 * length_s)) as usize);
    let indices = cells.flat_map(|cell| [cell.saturating_sub(1), cell]);
    let indices: BTreeSet<usize> = indices.filter(|index| *index < count).collect();
    indices.into_iter().filter_map(window).collect()
}
