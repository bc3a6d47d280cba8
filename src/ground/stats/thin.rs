//! Some rows of long streams.

use std::iter::StepBy;

/// Every k-th item, with the smallest k for at most `max` items.
pub fn thinned<I: IntoIterator<IntoIter: ExactSizeIterator>>(
    items: I,
    max: usize,
) -> StepBy<I::IntoIter> {
    let items = items.into_iter();
    let step = items.len().div_ceil(max).max(1);
    items.step_by(step)
}

/// Every k-th row and the last, with the smallest k for at most `max_rows` rows.
pub fn even_rows(rows: usize, max_rows: usize) -> Vec<usize> {
    let step = rows.div_ceil(max_rows.max(1)).max(1);
    let last = rows.checked_sub(1).filter(|last| last % step != 0);
    (0..rows).step_by(step).chain(last).collect()
}

/// Minima and maxima of each series in equal intervals, in order: about `max_rows` rows, or all if not more.
pub fn extreme_rows(series: &[&[f64]], max_rows: usize) -> Vec<usize> {
    let rows = series.first().map_or(0, |values| values.len());
    if rows <= max_rows {
        return (0..rows).collect();
    }
    let stretch = rows.div_ceil((max_rows / (2 * series.len())).max(1));
    let mut selected = Vec::with_capacity(max_rows);
    for start in (0..rows).step_by(stretch) {
        let range = start..(start + stretch).min(rows);
        let of_stretch = selected.len();
        for values in series {
            let by_value = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]);
            selected.extend(range.clone().min_by(by_value));
            selected.extend(range.clone().max_by(by_value));
        }
        selected[of_stretch..].sort_unstable();
    }
    selected.dedup();
    selected
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX_ROWS: usize = 4_000;

    #[test]
    fn short_streams_are_not_thinned() {
        assert_eq!(even_rows(5, MAX_ROWS), [0, 1, 2, 3, 4]);
        assert_eq!(extreme_rows(&[&[3.0, 1.0, 2.0]], MAX_ROWS), [0, 1, 2]);
        assert!(even_rows(0, MAX_ROWS).is_empty() && extreme_rows(&[&[]], MAX_ROWS).is_empty());
        assert!(extreme_rows(&[], MAX_ROWS).is_empty());
    }

    #[test]
    fn a_thinned_stream_keeps_its_ends_and_the_row_limit() {
        for rows in [MAX_ROWS + 1, 10_001, 123_457] {
            let kept = even_rows(rows, MAX_ROWS);
            assert!(kept.len() <= MAX_ROWS + 1 && kept.is_sorted());
            assert_eq!((kept.first(), kept.last()), (Some(&0), Some(&(rows - 1))));
        }
    }

    #[test]
    fn a_single_peak_of_each_series_survives_thinning() {
        let mut up: Vec<f64> = (0..100_000).map(|row| f64::from(row % 7)).collect();
        let mut down: Vec<f64> = (0..100_000).map(|row| f64::from(row % 11)).collect();
        (up[51_234], down[70_001]) = (99.0, -99.0);
        let kept = extreme_rows(&[&up, &down], MAX_ROWS);
        assert!(kept.len() <= MAX_ROWS && kept.is_sorted());
        assert!(kept.contains(&51_234) && kept.contains(&70_001));
    }
}
