//! Which samples of a long run are shown.

/// Every k-th of `len` samples, with the least k that gives no more than `most`, and the last one.
pub fn every_kth(len: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    let step = len.div_ceil(most).max(1);
    let last = len.checked_sub(1).filter(|last| last % step != 0);
    (0..len).step_by(step).chain(last)
}

/// The least and the greatest of `values` in every stretch of equally many, in order, so that no
/// peak is lost; all where there are no more than `most`.
pub fn extremes(values: &[f64], most: usize) -> Vec<usize> {
    if values.len() <= most {
        return (0..values.len()).collect();
    }
    let stretch = values.len().div_ceil(most / 2);
    let mut kept = Vec::with_capacity(most);
    for start in (0..values.len()).step_by(stretch) {
        let within = start..values.len().min(start + stretch);
        let by_value = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]);
        let least = within.clone().min_by(by_value);
        let greatest = within.max_by(by_value);
        let (first, second) = (least.min(greatest), least.max(greatest));
        kept.extend(first);
        kept.extend(second.filter(|_| first != second));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kth_keeps_the_ends_and_the_bound() {
        let kept = |len, most| every_kth(len, most).collect::<Vec<_>>();
        assert_eq!(kept(0, 4), [0; 0]);
        assert_eq!(kept(4, 4), [0, 1, 2, 3]);
        assert_eq!(kept(10, 4), [0, 3, 6, 9]);
        assert_eq!(kept(9, 4), [0, 3, 6, 8]);
        assert!(kept(100_001, 5_000).len() <= 5_001);
    }

    #[test]
    fn extremes_lose_no_peak() {
        let mut values: Vec<f64> = (0..10_000).map(|i| f64::from(i % 7)).collect();
        values[4_321] = 50.0;
        values[4_322] = -50.0;
        let kept = extremes(&values, 100);
        assert!(kept.len() <= 100 && kept.is_sorted());
        assert!(kept.contains(&4_321) && kept.contains(&4_322));
        assert_eq!(extremes(&values[..100], 100).len(), 100);
        assert_eq!(extremes(&[1.0; 1_000], 10).len(), 10);
    }
}
