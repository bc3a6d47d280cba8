use ground::time::{NANOS_PER_SECOND, Stamp};

pub(super) type Span = (Stamp, Stamp);

/// Pairs of files (earlier start first) that overlap by more than a second, or more than half of the
/// shorter one, with the overlap in s. Splits of one recording overlap less.
pub(super) fn overlaps(spans: &[(usize, Span)]) -> Vec<(usize, usize, f64)> {
    const SPLIT_S: f64 = 1.0;
    let length_s = |(first, last): Span| last.seconds_since(first);
    let shared_s = |a: Span, b: Span| length_s((a.0.max(b.0), a.1.min(b.1)));
    neighbours(spans)
        .map(|(a, b)| (a.0, b.0, shared_s(a.1, b.1), length_s(a.1).min(length_s(b.1))))
        .filter(|&(_, _, shared, shorter)| shared > 0.0 && shared > SPLIT_S.min(0.5 * shorter))
        .map(|(a, b, shared, _)| (a, b, shared))
        .collect()
}

/// Pairs of files with a gap of more than a day, in s.
pub(super) fn gaps(spans: &[(usize, Span)]) -> Vec<(usize, usize, f64)> {
    const DAY_S: f64 = 86_400.0;
    neighbours(spans)
        .map(|(a, b)| (a.0, b.0, b.1.0.seconds_since(a.1.1)))
        .filter(|&(_, _, apart)| apart > DAY_S)
        .collect()
}

/// Each file except the first, by start, paired with the latest-ending one before it.
pub(super) fn neighbours(
    spans: &[(usize, Span)],
) -> impl Iterator<Item = ((usize, Span), (usize, Span))> {
    let mut spans = spans.to_vec();
    spans.sort_by_key(|&(number, span)| (span.0, number));
    let mut spans = spans.into_iter();
    let mut last_ending = spans.next();
    spans.filter_map(move |next| {
        let before = last_ending?;
        if next.1.1 > before.1.1 {
            last_ending = Some(next);
        }
        Some((before, next))
    })
}

/// A time of 0 is unset if the other times come from a clock that counts from 1970.
pub(super) fn join(a: Span, b: Span) -> Span {
    /// 2001. A clock that starts with the robot does not reach it.
    const EPOCH: Stamp = Stamp::from_nanos(1_000_000_000 * NANOS_PER_SECOND);
    let is_unset = |a: Span, b: Span| a.1 == Stamp::from_nanos(0) && b.0 >= EPOCH;
    if is_unset(a, b) {
        return b;
    }
    if is_unset(b, a) {
        return a;
    }
    (a.0.min(b.0), a.1.max(b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_are_not_set_do_not_extend_a_span() {
        let [zero, early, first, last] =
            [0, 5, 1_748_331_284, 1_748_331_286].map(|s| Stamp::from_nanos(s * NANOS_PER_SECOND));
        assert_eq!(join((zero, zero), (first, last)), (first, last));
        assert_eq!(join((first, last), (zero, zero)), (first, last));
        // A simulation starts at 0.
        assert_eq!(join((zero, zero), (early, early)), (zero, early));
    }
}
