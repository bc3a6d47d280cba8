//! Clocks that are set back within a stream.

use std::ops::Range;

use super::rows::Rows;
use crate::stats::{STD_DEV_PER_MEDIAN, median};
use crate::time::Stamp;

/// Removes rows after a clock was set back until it has caught up.
pub(super) fn leave_out_overlaps(rows: &mut Rows, received: &[i64]) {
    let overlaps = set_backs(rows, received);
    let mut row = 0..;
    rows.retain(|_| {
        let row = row.next().unwrap_or_default();
        !overlaps.iter().any(|overlap| overlap.contains(&row))
    });
}

/// Shifts rows after a clock was set back by as much, so that the interval there is a typical one.
pub(super) fn continue_stamps(rows: &mut Rows, received: &[i64]) {
    let overlaps = set_backs(rows, received);
    let mut intervals: Vec<f64> =
        rows.windows(2).map(|pair| (pair[1].0.nanos() - pair[0].0.nanos()) as f64).collect();
    let period_ns = median(&mut intervals).unwrap_or(0.0) as i64;
    for Range { start, .. } in overlaps.into_iter().filter(|overlap| overlap.start > 0) {
        let next_ns = rows[start - 1].0.nanos() + period_ns;
        let shift_ns = next_ns - rows[start].0.nanos();
        for (stamp, _) in &mut rows[start..] {
            *stamp = Stamp::from_nanos(stamp.nanos() + shift_ns);
        }
    }
}

/// Sorts rows by receive time, and returns those with earlier stamps than a row before them because the clock was set
/// back. After messages out of order, the stamps are as far behind the receive times as before.
fn set_backs(rows: &mut Rows, received: &[i64]) -> Vec<Range<usize>> {
    /// Compared on each side.
    const SIDE_ROWS: usize = 50;
    /// Standard errors of a significant change of the delay.
    const MIN_STD_ERRORS: f64 = 6.0;
    if rows.is_sorted_by_key(|(stamp, _)| *stamp) {
        return Vec::new();
    }
    rows.sort_by_key(|(_, row)| received[*row]);
    let mut latest_ns = i64::MIN;
    let behind_ns: Vec<i64> = rows
        .iter()
        .map(|(stamp, _)| {
            latest_ns = latest_ns.max(stamp.nanos());
            latest_ns - stamp.nanos()
        })
        .collect();
    let delay_ns = |row: usize| (received[rows[row].1] - rows[row].0.nanos()) as f64;
    // Median, and its standard error.
    let usual = |rows: Range<usize>| {
        let count = rows.len() as f64;
        let delays: Vec<f64> = rows.map(delay_ns).collect();
        let median_ns = median(&mut delays.clone())?;
        let mut deviations: Vec<f64> = delays.iter().map(|one| (one - median_ns).abs()).collect();
        let std_dev = STD_DEV_PER_MEDIAN * median(&mut deviations)?;
        Some((median_ns, std_dev / count.sqrt()))
    };
    let (mut found, mut start) = (Vec::new(), 0);
    for block in behind_ns.chunk_by(|a, b| (*a > 0) == (*b > 0)) {
        let overlap = start..start + block.len();
        start = overlap.end;
        let set_back_ns = block[0] as f64;
        if set_back_ns == 0.0 {
            continue;
        }
        let before = usual(overlap.start.saturating_sub(SIDE_ROWS)..overlap.start);
        let after = usual(overlap.end..(overlap.end + SIDE_ROWS).min(rows.len()));
        let is_lasting = |(before, after): ((f64, f64), (f64, f64))| {
            let std_error = before.1.hypot(after.1);
            after.0 - before.0 > (0.5 * set_back_ns).max(MIN_STD_ERRORS * std_error)
        };
        if before.zip(after).is_some_and(is_lasting) {
            found.push(overlap);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: i64 = 10_000_000;

    /// Rows at 100 Hz with these stamps in periods, received on time.
    fn rows(stamp: impl Fn(i64) -> i64) -> (Rows, Vec<i64>) {
        let received = (0..200).map(|row| row * PERIOD_NS).collect();
        let rows = (0..200).map(|row| (Stamp::from_nanos(stamp(row) * PERIOD_NS), row as usize));
        (rows.collect(), received)
    }

    #[test]
    fn a_clock_set_back_loses_the_overlap_or_continues() {
        let (stepped, received) = rows(|row| if row < 100 { row } else { row - 4 });
        let mut without = stepped.clone();
        leave_out_overlaps(&mut without, &received);
        let rows_left: Vec<usize> = without.iter().map(|(_, row)| *row).collect();
        assert_eq!(rows_left, (0..100).chain(103..200).collect::<Vec<_>>());
        let mut continued = stepped;
        continue_stamps(&mut continued, &received);
        assert_eq!(continued, rows(|row| row).0);
    }

    #[test]
    fn messages_out_of_order_are_kept() {
        let (swapped, received) = rows(|row| match row {
            50 => 51,
            51 => 50,
            other => other,
        });
        let mut all = swapped.clone();
        leave_out_overlaps(&mut all, &received);
        assert_eq!(all, swapped);
    }
}
