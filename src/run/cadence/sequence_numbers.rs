//! Counts missing rows by sequence number.
//!
//! ROS 1 numbers each publisher's messages; MCAP numbers messages as recorded, perhaps all topics together.
//! So gaps count only if topics are numbered separately, and complete numbers prove nothing.

const MIN_NUMBERS: usize = 20;
/// Minimum share of steps of one, if the numbers count messages.
const MIN_STEP_OF_ONE_SHARE: f64 = 0.6;

/// Rows missing from each stream, given its numbers in receive order; `None` if they are unusable.
pub(super) fn count_skipped(numbers: &[Vec<u32>]) -> Vec<Option<usize>> {
    let is_counted = |index: &usize| is_counted(&numbers[*index]);
    let counted: Vec<usize> = (0..numbers.len()).filter(is_counted).collect();
    let mut skipped = vec![None; numbers.len()];
    for &index in &counted {
        let others = counted.iter().filter(|other| **other != index).map(|&other| &*numbers[other]);
        skipped[index] = count_skipped_beside(&numbers[index], others);
    }
    skipped
}

fn count_skipped_beside<'a>(own: &[u32], others: impl Iterator<Item = &'a [u32]>) -> Option<usize> {
    let mut others = others.peekable();
    // A counter shared by two topics is useless for both.
    others.peek()?;
    others.all(|other| have_separate_counters(own, other)).then_some(())?;
    let steps = || own.windows(2).map(|pair| (pair[1] - pair[0]) as usize);
    let by_one = steps().filter(|step| *step == 1).count();
    let skipped: usize = steps().map(|step| step - 1).sum();
    // With more skipped than received, the sender restarted its counter.
    (by_one as f64 > MIN_STEP_OF_ONE_SHARE * own.len() as f64 && skipped < own.len())
        .then_some(skipped)
}

fn is_counted(numbers: &[u32]) -> bool {
    numbers.len() >= MIN_NUMBERS && numbers.windows(2).all(|pair| pair[0] < pair[1])
}

/// Whether two streams have separate counters. A shared one gives neither equal numbers nor disjoint
/// ranges.
fn have_separate_counters(a: &[u32], b: &[u32]) -> bool {
    let (Some((a_first, a_last)), Some((b_first, b_last))) =
        (a.first().zip(a.last()), b.first().zip(b.last()))
    else {
        return false;
    };
    let is_in_a = |number: &u32| a.binary_search(number).is_ok();
    a_last < b_first || b_last < a_first || b.iter().any(is_in_a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn without(numbers: impl Iterator<Item = u32>, gone: &[u32]) -> Vec<u32> {
        numbers.filter(|number| !gone.contains(number)).collect()
    }

    #[test]
    fn skipped_sequence_numbers_are_missing_rows() {
        let lossy = without(1..101, &[7, 8, 50]);
        let counted = [lossy, (1..201).collect(), (5000..5100).collect()];
        assert_eq!(count_skipped(&counted), [Some(3), Some(0), Some(0)]);
    }

    #[test]
    fn regular_decimation_gives_no_missing_rows() {
        let counted = [without((0..300).step_by(3), &[30]), (1..201).collect()];
        assert_eq!(count_skipped(&counted)[0], None);
    }

    #[test]
    fn a_counter_shared_by_two_topics_is_ignored_for_both() {
        let (a, b) = (1..400).partition(|number| number % 5 != 0);
        let counted = [a, b, (1..201).collect()];
        assert_eq!(count_skipped(&counted), [None, None, Some(0)]);
    }

    #[test]
    fn a_counter_shared_by_all_topics_is_ignored() {
        let (a, b) = (1..400).partition(|number| number % 5 != 0);
        assert_eq!(count_skipped(&[a, b])[0], None);
        assert_eq!(count_skipped(&[without(1..101, &[7])]), [None]);
    }

    #[test]
    fn numbers_that_do_not_count_are_ignored() {
        let other = || (1..201).collect::<Vec<u32>>();
        let (none, back) = (vec![0; 100], (1..50).chain(1..50).collect());
        let (square, anew) =
            ((1..100).map(|n| n * n).collect(), (1..60).chain(90_000..90_050).collect());
        for numbers in [none, back, square, anew] {
            assert_eq!(count_skipped(&[numbers, other()])[0], None);
        }
    }
}
