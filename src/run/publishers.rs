//! Separates two publishers of one topic or transform by their periods.
//!
//! Two periods then explain nearly all rows, and one does not. This also detects publishers that agree.
//! Interpolating between the rows of the first measures their disagreement.

use std::collections::HashSet;

use rayon::prelude::*;

use crate::time::seconds;

use super::part_series::{Series, Values};
use super::periodic::{FEWEST, NEARLY, SMOOTH, Split, are_two, is_one, roughness, split, split_by};
use super::pose_distance::PoseDistance;
use super::rows::Rows;
use super::tick_grid::Grid;

/// Two publishers of one part of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Publishers {
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
    pub apart: Option<PoseDistance>,
    /// Index of the stream's part.
    pub(super) piece: usize,
    /// Rows of the second publisher.
    pub(super) second: HashSet<usize>,
}

pub(super) fn hide(found: &[Publishers], stream: usize, piece: usize, rows: &mut Rows) {
    let of_it = |found: &&Publishers| (found.stream, found.piece) == (stream, piece);
    if let Some(found) = found.iter().find(of_it) {
        rows.retain(|(_, row)| !found.second.contains(row));
    }
}

pub(super) fn publishers(series: &[Series<'_>]) -> Vec<Publishers> {
    let mut found: Vec<Option<Publishers>> = series.par_iter().map(of).collect();
    // If publishers of one part disagree, other parts of the same messages have the same publishers.
    for leader in 0..series.len() {
        let Some(led) = found[leader].clone().filter(|one| one.apart.is_some()) else { continue };
        let sent: HashSet<[i64; 2]> =
            led.second.iter().map(|&row| sent(&series[leader], row)).collect();
        let others = series.iter().zip(&mut found).filter(|(other, of_it)| {
            other.stream == led.stream && of_it.as_ref().is_none_or(|one| one.apart.is_none())
        });
        for (other, of_it) in others {
            let (second, first): (Vec<usize>, Vec<usize>) = (0..other.rows.len())
                .partition(|&at| sent.contains(&self::sent(other, other.rows[at].1)));
            if second.len() == led.second.len() {
                *of_it = told(other, &other.seconds(), [first, second], false);
            }
        }
    }
    found.into_iter().flatten().collect()
}

fn sent(series: &Series<'_>, row: usize) -> [i64; 2] {
    [series.times.header[row], series.times.log[row]]
}

const ENOUGH: usize = 60;

const MOST: usize = 4000;
/// Rows checked first if one period explains all.
const PART: usize = 500;
/// Minimum ratio of the roughness of both together to that of each, if they share one period.
const SMOOTHER: f64 = 4.0;

fn of(series: &Series<'_>) -> Option<Publishers> {
    if series.rows.len() < ENOUGH || matches!(series.values, Values::Imu(_) | Values::Array(_)) {
        return None;
    }
    // One regular publisher, possibly with losses.
    let looked_at = &series.rows[..series.rows.len().min(MOST)];
    let begin = looked_at[0].0;
    let stamped_s: Vec<f64> =
        looked_at.iter().map(|(stamp, _)| stamp.seconds_since(begin)).collect();
    let mut received: Vec<i64> = looked_at.iter().map(|(_, row)| series.times.log[*row]).collect();
    received.sort_unstable();
    let since = |nanos: &i64| seconds(nanos.saturating_sub(received[0]));
    let received_s: Vec<f64> = received.iter().map(since).collect();
    let t_s = series.seconds();
    let off = |before: usize, from: usize, to: usize| {
        let [before_s, from_s, to_s] = [before, from, to].map(|at| t_s[at]);
        let part = if from_s > before_s { (to_s - before_s) / (from_s - before_s) } else { 1.0 };
        gap(&series.values, [before, to, from].map(|at| series.rows[at].1), part).size_m()
    };
    let rough = roughness(&(0..looked_at.len()).collect::<Vec<_>>(), &off);
    let again =
        looked_at.windows(2).filter(|two| series.values.is_same(two[0].1, two[1].1)).count();
    let is_ticking = || Grid::of(&stamped_s).is_some_and(|grid| grid.is_of_one_even_sender());
    // Disagreeing poses have two publishers even if their stamps, copied from joint states, are irregular.
    let values_disagree = matches!(series.values, Values::Poses(_)) && rough > SMOOTH;
    let stamps_show_two = || {
        let two = split(&stamped_s, &off);
        two.is_some_and(|two| values_disagree || are_two(&stamped_s, &two))
    };
    let is_one = is_one(&stamped_s)
        || is_one(&received_s)
        || is_ticking()
        || is_read_evenly(series, looked_at.len())
        || !stamps_show_two();
    // Repeats are as rough as disagreeing publishers.
    if is_one && (rough <= SMOOTH || again as f64 > NEARLY * looked_at.len() as f64) {
        return None;
    }
    // A part of the rows shows two publishers with one period.
    let is_smoother = |parts: &Split| SMOOTHER * parts.roughness(&off) <= rough;
    let part = &stamped_s[..stamped_s.len().min(PART)];
    if is_one && !split(part, &off).is_some_and(|parts| is_smoother(&parts)) {
        return None;
    }
    let parts = split(&stamped_s, &off).filter(|parts| !is_one || is_smoother(parts))?;
    // Applies the periods of a part to the whole run.
    let rows = match looked_at.len() == t_s.len() {
        true => parts.rows,
        false => split_by(&t_s, parts.periods_s, &off)?.rows,
    };
    told(series, &t_s, rows, is_one)
}

/// Whether values are interpolated far better by row number than by stamp: one sender reads regularly, but
/// stamps or sends in bursts.
fn is_read_evenly(series: &Series<'_>, rows: usize) -> bool {
    const BETTER: f64 = 0.5;
    let mut off = [0.0; 2];
    for three in series.rows[..rows].windows(3) {
        let span_s = three[2].0.seconds_since(three[0].0);
        let part = three[1].0.seconds_since(three[0].0) / span_s.max(f64::MIN_POSITIVE);
        let at = [0, 1, 2].map(|row| three[row].1);
        for (off, part) in off.iter_mut().zip([0.5, part]) {
            *off += gap(&series.values, at, part).size_m();
        }
    }
    off[0] < BETTER * off[1]
}

/// `None` if publishers with one period do not differ steadily: vibration or irregular stamps are then the
/// cause.
fn told(
    series: &Series<'_>,
    t_s: &[f64],
    [first, second]: [Vec<usize>; 2],
    is_one: bool,
) -> Option<Publishers> {
    let apart = apart(series, t_s, [&first, &second])?;
    if (is_one && !(apart.is_there && apart.is_steady)) || (series.is_table && !apart.is_there) {
        return None;
    }
    // Messages resent with the same stamp are no second publisher.
    let sent: HashSet<i64> = first.iter().map(|&at| series.rows[at].0.nanos()).collect();
    let is_again = |at: &&usize| sent.contains(&series.rows[**at].0.nanos());
    if !apart.is_there && second.iter().filter(is_again).count() * 10 > second.len() * 9 {
        return None;
    }
    let rate = |rows: &[usize]| {
        let span_s = t_s[rows[rows.len() - 1]] - t_s[rows[0]];
        (rows.len() - 1) as f64 / span_s
    };
    let frames = match series.values {
        Values::Poses(poses) if series.frame.is_some() => {
            Some((poses.frame_id.clone(), poses.child_frame_id.clone()))
        }
        _ => None,
    };
    Some(Publishers {
        stream: series.stream,
        frames,
        rows: [first.len(), second.len()],
        rates_hz: [rate(&first), rate(&second)],
        apart: apart.is_there.then_some(apart.by),
        piece: series.piece,
        second: second.iter().map(|&at| series.rows[at].1).collect(),
    })
}

struct Gap {
    by: PoseDistance,
    is_there: bool,
    /// Whether it is nearly constant.
    is_steady: bool,
}

/// Compares rows of the second with interpolated rows of the first, and rows of the first with their
/// neighbours for the interpolation error.
fn apart(series: &Series<'_>, t_s: &[f64], [first, second]: [&[usize]; 2]) -> Option<Gap> {
    /// Minimum distance, m or rad: above rounding and encoder noise.
    const LEAST: f64 = 3e-4;
    /// Minimum ratio to the interpolation error.
    const TIMES: f64 = 2.0;
    /// Minimum ratio of least to largest constant offset.
    const STEADY: f64 = 0.7;
    /// Ratio of largest to usual distance that motion causes.
    const VARIES: f64 = 2.0;
    let row = |at: usize| series.rows[at].1;
    let gap = |left: usize, at: usize, right: usize| {
        let span_s = t_s[right] - t_s[left];
        let part = if span_s > 0.0 { (t_s[at] - t_s[left]) / span_s } else { 0.0 };
        gap(&series.values, [row(left), row(at), row(right)], part)
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
    if gaps.len() < FEWEST || own.is_empty() {
        return None;
    }
    let told = |of: fn(&PoseDistance) -> f64| {
        let [usual, far] = [0.5, 0.9].map(|part| quantile(gaps.iter().map(of), part));
        // Coinciding rows may be attributed wrongly.
        let uncertain = quantile(own.iter().map(of), 0.8);
        let by = if far > VARIES * usual { far } else { usual };
        (by, far > LEAST + TIMES * uncertain)
    };
    let (length, angle) = (told(|gap| gap.length_m), told(|gap| gap.angle_rad));
    let part = |(by, is_there): (f64, bool)| if is_there { by } else { 0.0 };
    let by = PoseDistance { length_m: part(length), angle_rad: part(angle) };
    let [least, most] = [0.1, 0.9].map(|part| quantile(gaps.iter().map(|gap| gap.size_m()), part));
    Some(Gap { by, is_there: length.1 || angle.1, is_steady: least > STEADY * most })
}

fn quantile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * part) as usize).copied().unwrap_or(0.0)
}

/// Distance of the middle row from the interpolation at `part`.
fn gap(values: &Values<'_>, [left, at, right]: [usize; 3], part: f64) -> PoseDistance {
    match values {
        Values::Poses(poses) => {
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
            let off = |number: usize| {
                let [a, q, b] = [left, at, right].map(|row| values.at(row, number));
                (q - a - part * (b - a)).abs()
            };
            let angle_rad = (0..values.width()).map(off).fold(0.0, f64::max);
            PoseDistance { length_m: 0.0, angle_rad }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{PoseColumns, Times};
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

    fn found(poses: &PoseColumns) -> Option<Publishers> {
        let times: &Times = &poses.times;
        let rows = times.header.iter().map(|nanos| Stamp::from_nanos(*nanos)).zip(0..).collect();
        let (frame, values) = (Some("b"), Values::Poses(poses));
        of(&Series { stream: 0, piece: 0, frame, is_table: false, rows, times, values })
    }

    #[test]
    fn two_are_told_apart_at_any_pair_of_rates() {
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
                let found = found(&two);
                let case = format!(
                    "{a_ms} {b_ms} {phase_ms} {off_m}: {:?}",
                    found.as_ref().map(|f| (f.rows, f.apart))
                );
                let found = found.expect(&case);
                let mut rates = found.rates_hz.map(|rate_hz| 1000.0 / rate_hz);
                rates.sort_by(f64::total_cmp);
                assert!((rates[0] - f64::min(a_ms, b_ms)).abs() < 0.1, "{case}");
                assert!((rates[1] - f64::max(a_ms, b_ms)).abs() < 0.1, "{case}");
                let apart_m = found.apart.map_or(0.0, |apart| apart.length_m);
                assert!((apart_m - off_m).abs() < 1e-4, "{case}");
            }
        }
    }

    #[test]
    fn stamps_that_are_copied_from_joint_states_are_told_apart() {
        let copied = |by: &[(f64, f64, f64)]| {
            let mut poses = sent(by);
            for (row, nanos) in poses.times.header.iter_mut().enumerate() {
                *nanos = 1 + (*nanos + 8 * MS - 2).div_euclid(8 * MS) * 8 * MS;
                poses.times.log[row] = *nanos + MS;
            }
            poses
        };
        let found = |by: &[(f64, f64, f64)]| found(&copied(by));
        assert_eq!(found(&[(20.0, 0.0, 0.0)]), None);
        let two = found(&[(20.0, 0.0, 0.0), (33.333, 0.0, 0.005)]).expect("two publishers");
        assert!(two.apart.is_some_and(|apart| (apart.length_m - 0.005).abs() < 1e-3), "{two:?}");
    }

    #[test]
    fn one_that_loses_rows_or_has_no_rhythm_is_one() {
        let mut lossy = sent(&[(20.0, 0.0, 0.0)]);
        let kept: Vec<usize> = (0..lossy.times.len()).filter(|row| (row * 7919) % 9 != 4).collect();
        lossy.xyz = kept.iter().map(|&row| lossy.xyz[row]).collect();
        lossy.q_xyzw.truncate(kept.len());
        let header = kept.iter().map(|&row| lossy.times.header[row]).collect::<Vec<_>>();
        lossy.times = Times::default();
        header.iter().for_each(|nanos| lossy.times.push(*nanos, *nanos, 0));
        assert_eq!(found(&lossy), None);
        let mut ragged = sent(&[(20.0, 0.0, 0.0)]);
        for (row, nanos) in ragged.times.header.iter_mut().enumerate() {
            *nanos += ((row * 7919) % 17) as i64 * MS;
        }
        ragged.times.log.clone_from(&ragged.times.header);
        assert_eq!(found(&ragged), None);
    }
}
