//! Available byte ranges of a file. A partially fetched object has zeros between the fetched parts, so
//! readers check availability first.
#![cfg_attr(not(feature = "cloud"), allow(dead_code, reason = "without it nothing is fetched"))]

use std::ops::Range;

/// Disjoint, non-adjacent byte ranges in ascending order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Ranges(Vec<Range<usize>>);

impl Ranges {
    /// Merges ranges separated by at most `gap` bytes.
    pub(super) fn new(mut ranges: Vec<Range<usize>>, gap: usize) -> Self {
        ranges.retain(|range| !range.is_empty());
        ranges.sort_by_key(|range| range.start);
        ranges.dedup_by(|next, kept| {
            let joins = next.start <= kept.end.saturating_add(gap);
            if joins {
                kept.end = kept.end.max(next.end);
            }
            joins
        });
        Self(ranges)
    }

    pub(super) fn up_to(end: usize) -> Self {
        let whole = 0..end;
        Self::new(vec![whole], 0)
    }

    pub(super) fn contains(&self, range: &Range<usize>) -> bool {
        let behind = self.0.partition_point(|kept| kept.start <= range.start);
        let last = behind.checked_sub(1).map(|index| &self.0[index]);
        range.is_empty() || last.is_some_and(|kept| range.end <= kept.end)
    }

    pub(super) fn extend(&mut self, further: Self) {
        let mut all = std::mem::take(&mut self.0);
        all.extend(further.0);
        *self = Self::new(all, 0);
    }

    pub(super) fn missing(&self, wanted: &Self) -> Self {
        let mut missing = Vec::new();
        for want in &wanted.0 {
            let mut at = want.start;
            let first = self.0.partition_point(|kept| kept.end <= want.start);
            for kept in self.0[first..].iter().take_while(|kept| kept.start < want.end) {
                missing.push(at..kept.start);
                at = kept.end;
            }
            missing.push(at..want.end);
        }
        Self::new(missing, 0)
    }

    pub(super) fn bytes(&self) -> usize {
        self.0.iter().map(Range::len).sum()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = Range<usize>> {
        self.0.iter().cloned()
    }

    pub(super) fn pieces(&self, size: usize) -> impl Iterator<Item = Range<usize>> {
        self.iter().flat_map(move |range| {
            let end = range.end;
            range.step_by(size).map(move |start| start..end.min(start.saturating_add(size)))
        })
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) enum Present {
    #[default]
    Whole,
    Parts(Ranges),
}

impl Present {
    pub(super) fn from_ranges(ranges: Ranges, size: usize) -> Self {
        if ranges.contains(&(0..size)) { Present::Whole } else { Present::Parts(ranges) }
    }

    pub(super) fn contains(&self, range: &Range<usize>) -> bool {
        match self {
            Present::Whole => true,
            Present::Parts(ranges) => ranges.contains(range),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(ranges: &Ranges) -> Vec<usize> {
        ranges.0.iter().cloned().flatten().collect()
    }

    #[test]
    fn ranges_contain_their_inputs() {
        let ranges = Ranges::new(vec![20..30, 5..8, 8..10, 25..40, 50..50], 0);
        assert_eq!(ranges.0, [5..10, 20..40]);
        let held = |range: Range<usize>| ranges.contains(&range);
        assert!(held(5..10) && held(21..39) && held(12..12));
        assert!(!held(4..6) && !held(9..11) && !held(8..22) && !held(39..41) && !held(50..51));
        assert_eq!(Ranges::new(vec![0..4, 9..10, 16..17], 5).0, [0..10, 16..17]);
    }

    #[test]
    fn missing_ranges_are_wanted_and_absent() {
        let mut there = Ranges::new(vec![10..20, 30..40, 60..70], 0);
        let wanted = Ranges::new(vec![0..12, 15..18, 19..61, 80..90], 0);
        let missing = there.missing(&wanted);
        let both = |byte: &usize| !bytes(&there).contains(byte);
        assert_eq!(bytes(&missing), bytes(&wanted).into_iter().filter(both).collect::<Vec<_>>());
        there.extend(missing);
        assert!(there.missing(&wanted).0.is_empty());
        let pieces: Vec<_> = wanted.pieces(10).collect();
        assert_eq!(pieces.iter().map(Range::len).sum::<usize>(), wanted.bytes());
        assert!(pieces.iter().all(|piece| piece.len() <= 10));
    }
}
