//! Separates two publishers of one topic or transform by their periods.
//!
//! Two periods then explain nearly all rows, and one does not. This also detects publishers that agree.
//! Interpolating between the rows of the first measures their disagreement.

use std::collections::HashSet;

use rayon::prelude::*;

use crate::stream::{Times, encoder_tick};
use crate::time::seconds;

use super::part_series::{Part, PartSeries, PartValues, RowsOfPart};
use super::periodic::{
    MAX_EXTRAPOLATION_ERROR, MAX_UNEXPLAINED_SHARE, MIN_PUBLISHER_ROWS, has_one_sender,
    has_two_senders, roughness, split_by_periods, split_senders,
};
use super::pose_distance::PoseDistance;
use super::rows::Rows;
use super::streams::with_key;
use super::tick_grid::TickGrid;

/// Two publishers of one part of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoPublishers {
    /// Index of the stream.
    pub stream: usize,
    /// Parent and child of the transform; `None` for poses and joint states.
    pub frames: Option<(String, String)>,
    /// Rows of each; the used publisher first.
    pub rows: [usize; 2],
    /// Rate of each, Hz.
    pub rates_hz: [f64; 2],
    /// Distance of their values; `None` if they agree. For joints, the largest difference, in their unit,
    /// as `angle_rad`.
    pub distance: Option<PoseDistance>,
    /// Index of the stream's part.
    pub(super) piece: usize,
    /// Rows of the second publisher.
    pub(super) second_rows: HashSet<usize>,
}

impl TwoPublishers {
    /// Publishers of one part, if it has two; `sorted` by stream and part.
    pub(super) fn of_part(sorted: &[Self], stream: usize, piece: usize) -> Option<&Self> {
        with_key(sorted, (stream, piece), |two| (two.stream, two.piece)).first()
    }
}

pub(super) fn remove_second_publisher(
    found: &[TwoPublishers],
    stream: usize,
    piece: usize,
    rows: &mut Rows,
) {
    if let Some(found) = TwoPublishers::of_part(found, stream, piece) {
        rows.retain(|(_, row)| !found.second_rows.contains(row));
    }
}

pub(super) fn detect_publishers(parts: &[Part<'_>], rows: RowsOfPart<'_>) -> Vec<TwoPublishers> {
    let detect = |part| detect_in_series(&PartSeries::new(part, rows));
    let mut found: Vec<Option<TwoPublishers>> = parts.par_iter().map(detect).collect();
    // If publishers of one part disagree, other parts of the same messages have the same publishers.
    for leader in 0..parts.len() {
        let Some(led) = found[leader].clone().filter(|one| one.distance.is_some()) else {
            continue;
        };
        let sent: HashSet<[i64; 2]> =
            led.second_rows.iter().map(|&row| message_stamps(parts[leader].times, row)).collect();
        let others = parts.iter().zip(&mut found).filter(|(other, of_it)| {
            other.stream == led.stream && of_it.as_ref().is_none_or(|one| one.distance.is_none())
        });
        for (other, of_it) in others {
            let other = PartSeries::new(other, rows);
            let (second, first): (Vec<usize>, Vec<usize>) = (0..other.rows.len())
                .partition(|&at| sent.contains(&message_stamps(other.times, other.rows[at].1)));
            if second.len() == led.second_rows.len() {
                *of_it = build_publishers(&other, &other.seconds(), [first, second], false);
            }
        }
    }
    found.into_iter().flatten().collect()
}

fn message_stamps(times: &Times, row: usize) -> [i64; 2] {
    [times.header[row], times.log[row]]
}

const MIN_ROWS: usize = 60;

const MAX_ROWS: usize = 4000;
/// Rows checked first if one period explains all.
const CHECKED_PART_ROWS: usize = 500;
/// Minimum ratio of the roughness of both together to that of each, if they share one period.
const MIN_ROUGHNESS_RATIO: f64 = 4.0;

fn detect_in_series(series: &PartSeries<'_>) -> Option<TwoPublishers> {
    if series.rows.len() < MIN_ROWS
        || matches!(series.values, PartValues::Imu(_) | PartValues::Array(_))
    {
        return None;
    }
    // One regular publisher, possibly with losses.
    let checked_rows = &series.rows[..series.rows.len().min(MAX_ROWS)];
    let begin = checked_rows[0].0;
    let stamped_s: Vec<f64> =
        checked_rows.iter().map(|(stamp, _)| stamp.seconds_since(begin)).collect();
    let mut received: Vec<i64> =
        checked_rows.iter().map(|(_, row)| series.times.log[*row]).collect();
    received.sort_unstable();
    let since = |nanos: &i64| seconds(nanos.saturating_sub(received[0]));
    let received_s: Vec<f64> = received.iter().map(since).collect();
    let extrapolation_error = |before: usize, from: usize, to: usize| {
        let [before_s, from_s, to_s] =
            [before, from, to].map(|at| series.rows[at].0.seconds_since(begin));
        let part = if from_s > before_s { (to_s - before_s) / (from_s - before_s) } else { 1.0 };
        interpolation_error(&series.values, [before, to, from].map(|at| series.rows[at].1), part)
            .size_m()
    };
    let rough = roughness(&(0..checked_rows.len()).collect::<Vec<_>>(), &extrapolation_error);
    let repeats =
        checked_rows.windows(2).filter(|two| series.values.is_same(two[0].1, two[1].1)).count();
    let is_ticking =
        || TickGrid::detect(&stamped_s).is_some_and(|grid| grid.is_of_one_even_sender());
    // Disagreeing poses have two publishers even if their stamps, copied from joint states, are irregular.
    let values_disagree =
        matches!(series.values, PartValues::Poses(_)) && rough > MAX_EXTRAPOLATION_ERROR;
    let stamps_show_one = has_one_sender(&stamped_s)
        || has_one_sender(&received_s)
        || is_ticking()
        || is_read_evenly(series, checked_rows.len());
    let split = match stamps_show_one {
        true => None,
        false => split_senders(&stamped_s, &extrapolation_error, f64::INFINITY),
    };
    let stamps_show_two = split.as_ref().is_some_and(|two| has_two_senders(&stamped_s, two));
    let shows_two = stamps_show_two || (values_disagree && split.is_some());
    // Repeats are as rough as disagreeing publishers.
    if !shows_two
        && (rough <= MAX_EXTRAPOLATION_ERROR
            || repeats as f64 > MAX_UNEXPLAINED_SHARE * checked_rows.len() as f64)
    {
        return None;
    }
    // A part of the rows shows two publishers with one period.
    let max_roughness = rough / MIN_ROUGHNESS_RATIO;
    let smoother = |stamped_s: &[f64]| {
        split_senders(stamped_s, &extrapolation_error, max_roughness)
            .filter(|parts| parts.roughness(&extrapolation_error) <= max_roughness)
    };
    let part = &stamped_s[..stamped_s.len().min(CHECKED_PART_ROWS)];
    if !shows_two && smoother(part).is_none() {
        return None;
    }
    let parts = if shows_two { split } else { smoother(&stamped_s) }?;
    let t_s = series.seconds();
    // Applies the periods of a part to the whole run.
    let rows = match checked_rows.len() == t_s.len() {
        true => parts.rows,
        false => split_by_periods(&t_s, parts.periods_s, &extrapolation_error)?.rows,
    };
    // Jitter of one publisher's stamps makes its values rough, but its halves then agree.
    build_publishers(series, &t_s, rows, !shows_two)
        .filter(|two| !shows_two || stamps_show_two || two.distance.is_some())
}

/// Whether values are interpolated far better by row number than by stamp: one sender reads regularly, but
/// stamps or sends in bursts.
fn is_read_evenly(series: &PartSeries<'_>, rows: usize) -> bool {
    const MAX_ERROR_RATIO: f64 = 0.5;
    let mut extrapolation_error = [0.0; 2];
    for three in series.rows[..rows].windows(3) {
        let span_s = three[2].0.seconds_since(three[0].0);
        let part = three[1].0.seconds_since(three[0].0) / span_s.max(f64::MIN_POSITIVE);
        let at = [0, 1, 2].map(|row| three[row].1);
        for (extrapolation_error, part) in extrapolation_error.iter_mut().zip([0.5, part]) {
            *extrapolation_error += interpolation_error(&series.values, at, part).size_m();
        }
    }
    extrapolation_error[0] < MAX_ERROR_RATIO * extrapolation_error[1]
}

/// `None` if publishers with one period do not differ steadily: vibration or irregular stamps are then the
/// cause.
fn build_publishers(
    series: &PartSeries<'_>,
    t_s: &[f64],
    [first, second]: [Vec<usize>; 2],
    is_one: bool,
) -> Option<TwoPublishers> {
    let difference = compare_publishers(series, t_s, [&first, &second])?;
    if (is_one && !(difference.is_significant && difference.is_steady))
        || (series.is_table && !difference.is_significant)
    {
        return None;
    }
    // Messages resent with the same stamp are no second publisher.
    let sent: HashSet<i64> = first.iter().map(|&at| series.rows[at].0.nanos()).collect();
    let is_again = |at: &&usize| sent.contains(&series.rows[**at].0.nanos());
    if !difference.is_significant && second.iter().filter(is_again).count() * 10 > second.len() * 9
    {
        return None;
    }
    let rate = |rows: &[usize]| {
        let span_s = t_s[rows[rows.len() - 1]] - t_s[rows[0]];
        (rows.len() - 1) as f64 / span_s
    };
    let frames = match series.values {
        PartValues::Poses(poses) if series.frame.is_some() => {
            Some((poses.frame_id.clone(), poses.child_frame_id.clone()))
        }
        _ => None,
    };
    Some(TwoPublishers {
        stream: series.stream,
        frames,
        rows: [first.len(), second.len()],
        rates_hz: [rate(&first), rate(&second)],
        distance: difference.is_significant.then_some(difference.distance),
        piece: series.piece,
        second_rows: second.iter().map(|&at| series.rows[at].1).collect(),
    })
}

struct PublisherDistance {
    distance: PoseDistance,
    is_significant: bool,
    /// Whether it is nearly constant.
    is_steady: bool,
}

/// Compares rows of the second with interpolated rows of the first, and rows of the first with their
/// neighbours for the interpolation error.
fn compare_publishers(
    series: &PartSeries<'_>,
    t_s: &[f64],
    [first, second]: [&[usize]; 2],
) -> Option<PublisherDistance> {
    /// Minimum distance, m or rad: above rounding and encoder noise.
    const MIN_DISTANCE: f64 = 3e-4;
    /// Two rounded values differ by up to a tick; noise adds some.
    const MAX_ROUNDING_TICKS: f64 = 1.5;
    /// Minimum ratio to the interpolation error.
    const MIN_RATIO_TO_INTERPOLATION_ERROR: f64 = 2.0;
    /// Minimum ratio of least to largest constant offset.
    const MIN_STEADY_RATIO: f64 = 0.7;
    /// Ratio of largest to usual distance that motion causes.
    const MIN_VARIATION_RATIO: f64 = 2.0;
    /// Share of the second's rows that repeat a neighbour: a relay sends copies.
    const MIN_COPIED_SHARE: f64 = 0.9;
    let row = |at: usize| series.rows[at].1;
    let is_copy = |at: &&usize| {
        let after = first.partition_point(|&other| t_s[other] < t_s[**at]);
        let neighbours = first[after.saturating_sub(1)..first.len().min(after + 1)].iter();
        neighbours.into_iter().any(|&other| series.values.is_same(row(other), row(**at)))
    };
    let copies = second.iter().filter(is_copy).count();
    let is_relay = copies as f64 > MIN_COPIED_SHARE * second.len() as f64;
    let gap = |left: usize, at: usize, right: usize| {
        let span_s = t_s[right] - t_s[left];
        let part = if span_s > 0.0 { (t_s[at] - t_s[left]) / span_s } else { 0.0 };
        interpolation_error(&series.values, [row(left), row(at), row(right)], part)
    };
    let period_s = (t_s[first[first.len() - 1]] - t_s[first[0]]) / (first.len() - 1) as f64;
    let gaps: Vec<PoseDistance> = second
        .iter()
        .filter_map(|&at| {
            let after = first.partition_point(|&other| t_s[other] < t_s[at]);
            let (left, right) = (*first.get(after.checked_sub(1)?)?, *first.get(after)?);
            (t_s[right] - t_s[left] < 2.5 * period_s).then(|| gap(left, at, right))
        })
        .collect();
    let own: Vec<PoseDistance> =
        first.windows(3).map(|window| gap(window[0], window[1], window[2])).collect();
    if gaps.len() < MIN_PUBLISHER_ROWS || own.is_empty() {
        return None;
    }
    let significant_distance = |of: fn(&PoseDistance) -> f64| {
        let [usual, far] = [0.5, 0.9].map(|part| quantile(gaps.iter().map(of), part));
        // Coinciding rows may be attributed wrongly.
        let uncertain = quantile(own.iter().map(of), 0.8);
        let by = if far > MIN_VARIATION_RATIO * usual { far } else { usual };
        let distance = |a: usize, b: usize| of(&gap(first[a], first[b], first[a]));
        let tick = encoder_tick(first.len(), distance, MIN_DISTANCE).unwrap_or(0.0);
        let least = MIN_DISTANCE.max(MAX_ROUNDING_TICKS * tick);
        (by, far > least + MIN_RATIO_TO_INTERPOLATION_ERROR * uncertain)
    };
    let (length, angle) =
        (significant_distance(|gap| gap.length_m), significant_distance(|gap| gap.angle_rad));
    let part = |(by, is_there): (f64, bool)| if is_there { by } else { 0.0 };
    let by = PoseDistance { length_m: part(length), angle_rad: part(angle) };
    let [least, most] = [0.1, 0.9].map(|part| quantile(gaps.iter().map(|gap| gap.size_m()), part));
    Some(PublisherDistance {
        distance: by,
        is_significant: !is_relay && (length.1 || angle.1),
        is_steady: least > MIN_STEADY_RATIO * most,
    })
}

fn quantile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * part) as usize).copied().unwrap_or(0.0)
}

/// Distance of the middle row from the interpolation at `part`.
fn interpolation_error(
    values: &PartValues<'_>,
    [left, at, right]: [usize; 3],
    part: f64,
) -> PoseDistance {
    match values {
        PartValues::Poses(poses) => {
            let mix = |a: f64, b: f64| a + part * (b - a);
            let (a, b) = (poses.q_xyzw[left], poses.q_xyzw[right]);
            let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            let sign = if dot < 0.0 { -1.0 } else { 1.0 };
            let q_xyzw = std::array::from_fn(|i| mix(a[i], sign * b[i]));
            let (a, b) = (poses.xyz[left], poses.xyz[right]);
            let xyz = std::array::from_fn(|i| mix(a[i], b[i]));
            PoseDistance::new((xyz, q_xyzw), (poses.xyz[at], poses.q_xyzw[at]))
        }
        _ => {
            let extrapolation_error = |number: usize| {
                let [a, q, b] = [left, at, right].map(|row| values.number(row, number));
                (q - a - part * (b - a)).abs()
            };
            let angle_rad = (0..values.width()).map(extrapolation_error).fold(0.0, f64::max);
            PoseDistance { length_m: 0.0, angle_rad }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::PoseColumns;
    use crate::time::Stamp;

    const MS: i64 = 1_000_000;

    /// 20 s of a transform; publishers are period (ms), phase (ms) and offset (m) of a common oscillation.
    fn sent(by: &[(f64, f64, f64)]) -> PoseColumns {
        let mut rows: Vec<(i64, f64)> = Vec::new();
        for (period_ms, phase_ms, off_m) in by {
            let mut t_ms = *phase_ms;
            while t_ms < 20_000.0 {
                let x = 0.3 * (t_ms * 1.1e-3).sin() + off_m;
                rows.push(((t_ms * MS as f64) as i64, x));
                t_ms += period_ms;
            }
        }
        rows.sort_by_key(|row| row.0);
        let mut poses = PoseColumns { child_frame_id: "b".to_owned(), ..PoseColumns::default() };
        for (nanos, x) in rows {
            poses.times.push(1 + nanos, 1 + nanos + MS, 0);
            poses.xyz.push([x, 0.0, 0.0]);
            poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
        }
        poses
    }

    fn detect(poses: &PoseColumns) -> Option<TwoPublishers> {
        let times: &Times = &poses.times;
        let rows = times.header.iter().map(|nanos| Stamp::from_nanos(*nanos)).zip(0..).collect();
        let (frame, values) = (Some("b"), PartValues::Poses(poses));
        let part = Part { stream: 0, piece: 0, frame, is_table: false, times, values };
        detect_in_series(&PartSeries { part, rows })
    }

    #[test]
    fn two_publishers_are_separated_at_any_pair_of_rates() {
        for (a_ms, b_ms, phase_ms) in [
            (20.0, 33.333, 3.0),
            (33.333, 20.0, 0.0),
            (20.0, 20.0, 3.0),
            (40.0, 25.0, 7.0),
            (10.0, 50.0, 2.0),
            (20.0, 20.0, 0.0),
        ] {
            for off_m in [0.0, 0.005] {
                if (a_ms, phase_ms, off_m) == (b_ms, 0.0, 0.0) {
                    // Copies with the same stamps come from one publisher.
                    continue;
                }
                let two = sent(&[(a_ms, 0.0, 0.0), (b_ms, phase_ms, off_m)]);
                let found = detect(&two);
                let case = format!(
                    "{a_ms} {b_ms} {phase_ms} {off_m}: {:?}",
                    found.as_ref().map(|f| (f.rows, f.distance))
                );
                let found = found.expect(&case);
                let mut rates = found.rates_hz.map(|rate_hz| 1000.0 / rate_hz);
                rates.sort_by(f64::total_cmp);
                assert!((rates[0] - f64::min(a_ms, b_ms)).abs() < 0.1, "{case}");
                assert!((rates[1] - f64::max(a_ms, b_ms)).abs() < 0.1, "{case}");
                let apart_m = found.distance.map_or(0.0, |difference| difference.length_m);
                assert!((apart_m - off_m).abs() < 1e-4, "{case}");
            }
        }
    }

    #[test]
    fn a_relay_does_not_disagree() {
        let mut both = sent(&[(20.0, 0.0, 0.0), (20.0, 3.0, 0.0)]);
        both.xyz = (0..both.xyz.len()).map(|row| both.xyz[row - row % 2]).collect();
        assert_eq!(detect(&both).expect("two publishers").distance, None);
    }

    #[test]
    fn publishers_with_copied_stamps_are_separated() {
        let copied = |by: &[(f64, f64, f64)]| {
            let mut poses = sent(by);
            let times: &mut Times = &mut poses.times;
            for (nanos, received) in times.header.iter_mut().zip(&mut times.log) {
                *nanos = 1 + (*nanos + 8 * MS - 2).div_euclid(8 * MS) * 8 * MS;
                *received = *nanos + MS;
            }
            poses
        };
        let found = |by: &[(f64, f64, f64)]| detect(&copied(by));
        assert_eq!(found(&[(20.0, 0.0, 0.0)]), None);
        let two = found(&[(20.0, 0.0, 0.0), (33.333, 0.0, 0.005)]).expect("two publishers");
        assert!(
            two.distance.is_some_and(|difference| (difference.length_m - 0.005).abs() < 1e-3),
            "{two:?}"
        );
    }

    #[test]
    fn one_lossy_or_irregular_publisher_is_not_split() {
        let mut lossy = sent(&[(20.0, 0.0, 0.0)]);
        let kept: Vec<usize> = (0..lossy.times.len()).filter(|row| (row * 7919) % 9 != 4).collect();
        lossy.xyz = kept.iter().map(|&row| lossy.xyz[row]).collect();
        lossy.q_xyzw.select(&kept);
        let header = kept.iter().map(|&row| lossy.times.header[row]).collect::<Vec<_>>();
        lossy.times = Times::default().into();
        header.iter().for_each(|nanos| lossy.times.push(*nanos, *nanos, 0));
        assert_eq!(detect(&lossy), None);
        let mut jittery = sent(&[(20.0, 0.0, 0.0)]);
        for (row, nanos) in jittery.times.header.iter_mut().enumerate() {
            *nanos += ((row * 7919) % 17) as i64 * MS / 4;
        }
        jittery.times.log = jittery.times.header.clone();
        assert_eq!(detect(&jittery), None);
        let mut ragged = sent(&[(20.0, 0.0, 0.0)]);
        for (row, nanos) in ragged.times.header.iter_mut().enumerate() {
            *nanos += ((row * 7919) % 17) as i64 * MS;
        }
        ragged.times.log = ragged.times.header.clone();
        assert_eq!(detect(&ragged), None);
    }
}
