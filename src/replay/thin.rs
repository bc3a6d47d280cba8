//! Which rows of a long stream are kept.

/// No more rows than this of one stream are written.
const MOST_ROWS: usize = 4_000;

/// Rows for what moves: every k-th with the least k that keeps [`MOST_ROWS`], and the last.
pub(super) fn evenly(rows: usize) -> Vec<usize> {
    let step = rows.div_ceil(MOST_ROWS).max(1);
    let last = rows.checked_sub(1).filter(|last| last % step != 0);
    (0..rows).step_by(step).chain(last).collect()
}

/// Rows for what is plotted: of each of [`MOST_ROWS`]/2 equal stretches the lowest value and the
/// highest, in the order of time, so that no peak is lost.
pub(super) fn extremes(values: &[f64]) -> Vec<usize> {
    if values.len() <= MOST_ROWS {
        return (0..values.len()).collect();
    }
    let stretch = values.len().div_ceil(MOST_ROWS / 2);
    let mut kept = Vec::with_capacity(MOST_ROWS);
    for start in (0..values.len()).step_by(stretch) {
        let rows = start..(start + stretch).min(values.len());
        let by_value = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]);
        let (lowest, highest) = (rows.clone().min_by(by_value), rows.max_by(by_value));
        let (first, second) = (lowest.min(highest), lowest.max(highest));
        kept.extend(first);
        kept.extend(second.filter(|_| first != second));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_streams_are_kept_whole() {
        assert_eq!(evenly(5), [0, 1, 2, 3, 4]);
        assert_eq!(extremes(&[3.0, 1.0, 2.0]), [0, 1, 2]);
        assert!(evenly(0).is_empty() && extremes(&[]).is_empty());
    }

    #[test]
    fn a_long_stream_keeps_its_ends_and_its_bound() {
        for rows in [MOST_ROWS + 1, 10_001, 123_457] {
            let kept = evenly(rows);
            assert!(kept.len() <= MOST_ROWS + 1 && kept.is_sorted());
            assert_eq!((kept.first(), kept.last()), (Some(&0), Some(&(rows - 1))));
        }
    }

    #[test]
    fn a_single_peak_survives() {
        let mut values: Vec<f64> = (0..100_000).map(|row| f64::from(row % 7)).collect();
        (values[51_234], values[70_001]) = (99.0, -99.0);
        let kept = extremes(&values);
        assert!(kept.len() <= MOST_ROWS && kept.is_sorted());
        assert!(kept.contains(&51_234) && kept.contains(&70_001));
    }
}
