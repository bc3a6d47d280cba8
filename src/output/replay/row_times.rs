use crate::time::Stamp;

/// Receive times of stamps.
#[derive(Clone, Debug, Default)]
pub struct ReceiveTimes {
    /// Stamp and log time, by distinct stamps.
    rows: Vec<(Stamp, Stamp)>,
}

impl ReceiveTimes {
    /// Times in between are interpolated.
    const MAX_ROWS: usize = 100_000;

    /// From stamps and log times in any order. The first received of equal stamps counts.
    pub fn new(mut rows: Vec<(Stamp, Stamp)>) -> Self {
        rows.sort_unstable();
        rows.dedup_by_key(|(stamp, _)| *stamp);
        let kept = crate::stats::thin::even_rows(rows.len(), Self::MAX_ROWS);
        Self { rows: kept.into_iter().map(|row| rows[row]).collect() }
    }

    /// Interpolated between known stamps; with the delay of the first or last one outside their range;
    /// `stamp` itself if there are none.
    pub fn log_time(&self, stamp: Stamp) -> Stamp {
        let after = self.rows.partition_point(|(known, _)| *known < stamp);
        let (before, after) = (after.checked_sub(1), self.rows.get(after));
        match (before.map(|row| self.rows[row]), after) {
            (_, Some(&(known, log))) if known == stamp => log,
            (Some((left, left_log)), Some(&(right, right_log))) => {
                let part = stamp.seconds_since(left) / right.seconds_since(left);
                left_log.shifted(part * right_log.seconds_since(left_log))
            }
            (Some((known, log)), None) | (None, Some(&(known, log))) => {
                let late_ns = log.nanos().saturating_sub(known.nanos());
                Stamp::from_nanos(stamp.nanos().saturating_add(late_ns))
            }
            (None, None) => stamp,
        }
    }
}

/// One entry per row in each column.
#[derive(Clone, Debug, Default)]
pub(super) struct RowTimes {
    pub stamps_ns: Vec<i64>,
    pub logs_ns: Vec<i64>,
    /// Last joint state at that stamp.
    pub samples: Vec<i64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp_at(nanos: i64) -> Stamp {
        Stamp::from_nanos(nanos)
    }

    #[test]
    fn receive_times_are_interpolated_between_rows() {
        let pairs = [(2_000, 2_900), (1_000, 1_100), (1_000, 1_500), (4_000, 4_100)];
        let receipts =
            ReceiveTimes::new(pairs.map(|(stamp, log)| (stamp_at(stamp), stamp_at(log))).to_vec());
        for (stamp, log) in [
            (1_000, 1_100),
            (2_000, 2_900),
            (1_500, 2_000),
            (3_000, 3_500),
            (500, 600),
            (5_000, 5_100),
        ] {
            assert_eq!(receipts.log_time(stamp_at(stamp)), stamp_at(log), "{stamp}");
        }
    }

    #[test]
    fn without_receive_times_the_stamps_are_used() {
        assert_eq!(ReceiveTimes::default().log_time(stamp_at(7)), stamp_at(7));
    }

    #[test]
    fn decimation_keeps_the_first_and_last_row() {
        let rows: Vec<_> =
            (0..250_000).map(|row| (stamp_at(10 * row), stamp_at(10 * row + 3))).collect();
        let receipts = ReceiveTimes::new(rows);
        assert!(receipts.rows.len() <= ReceiveTimes::MAX_ROWS + 1);
        assert_eq!(receipts.log_time(stamp_at(2_499_990)), stamp_at(2_499_993));
        assert_eq!(receipts.log_time(stamp_at(1_234_560)), stamp_at(1_234_563));
    }
}
