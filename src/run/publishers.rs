//! Two publishers of one topic or of one transform, told apart by their rhythms.
//!
//! Rows that no single rhythm explains are two publishers' where each of two does nearly all of its
//! own. That needs no value: two that say the same are told as well as two that disagree. Whether
//! they disagree is then seen by holding the rows of the one against what lies between those of the
//! other.

use std::collections::HashSet;

use rayon::prelude::*;

use crate::time::seconds;

use super::apart::Apart;
use super::grid::Grid;
use super::rows::Rows;
use super::series::{Series, Values};
use super::trains::{FEWEST, NEARLY, SMOOTH, Split, are_two, is_one, roughness, split, split_by};

/// Two publishers of one piece of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Publishers {
    /// Index of the stream.
    pub stream: usize,
    /// Parent and child of the transform; `None` of poses and joint states.
    pub frames: Option<(String, String)>,
    /// Rows of each, those of the one that is used first.
    pub rows: [usize; 2],
    /// Rows a second of each.
    pub rates_hz: [f64; 2],
    /// How far what they say is apart: of poses m and rad, of joints the farthest in its unit, as
    /// `angle_rad`; nothing where they say the same.
    pub apart: Option<Apart>,
    /// Which of the stream's pieces.
    pub(super) piece: usize,
    /// The rows of the second.
    pub(super) second: HashSet<usize>,
}

/// Takes the rows of the second publisher out.
pub(super) fn hide(found: &[Publishers], stream: usize, piece: usize, rows: &mut Rows) {
    let of_it = |found: &&Publishers| (found.stream, found.piece) == (stream, piece);
    if let Some(found) = found.iter().find(of_it) {
        rows.retain(|(_, row)| !found.second.contains(row));
    }
}

/// The pieces that two publish.
pub(super) fn publishers(series: &[Series<'_>]) -> Vec<Publishers> {
    let mut found: Vec<Option<Publishers>> = series.par_iter().map(of).collect();
    // What two say differently tells them apart; what comes in the same messages is theirs, too.
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

/// When a row was stamped and received.
fn sent(series: &Series<'_>, row: usize) -> [i64; 2] {
    [series.times.header[row], series.times.log[row]]
}

/// Rows without which nothing is told.
const ENOUGH: usize = 60;

/// Rows that are looked at, …
const MOST: usize = 4000;
/// … and first, where one rhythm explains them.
const PART: usize = 500;
/// Two publishers in one rhythm are told where each is smoother by this factor than both together.
const SMOOTHER: f64 = 4.0;

fn of(series: &Series<'_>) -> Option<Publishers> {
    if series.rows.len() < ENOUGH || matches!(series.values, Values::Imu(_) | Values::Array(_)) {
        return None;
    }
    // One publisher that stamps or sends evenly, whatever it loses.
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
        gap(&series.values, [before, to, from].map(|at| series.rows[at].1), part).size()
    };
    let rough = roughness(&(0..looked_at.len()).collect::<Vec<_>>(), &off);
    let again =
        looked_at.windows(2).filter(|two| series.values.is_same(two[0].1, two[1].1)).count();
    let is_ticking = || Grid::of(&stamped_s).is_some_and(|grid| grid.is_of_one_even_sender());
    // Poses that disagree are two publishers' even if their stamps, copied from joint states, are uneven.
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
    // What repeats values is as rough as two that disagree.
    if is_one && (rough <= SMOOTH || again as f64 > NEARLY * looked_at.len() as f64) {
        return None;
    }
    // Two of one rhythm are seen in a part of the rows, where they are at all.
    let is_smoother = |parts: &Split| SMOOTHER * parts.roughness(&off) <= rough;
    let part = &stamped_s[..stamped_s.len().min(PART)];
    if is_one && !split(part, &off).is_some_and(|parts| is_smoother(&parts)) {
        return None;
    }
    let parts = split(&stamped_s, &off).filter(|parts| !is_one || is_smoother(parts))?;
    // The whole run by the rhythms that a part of it has.
    let rows = match looked_at.len() == t_s.len() {
        true => parts.rows,
        false => split_by(&t_s, parts.periods_s, &off)?.rows,
    };
    told(series, &t_s, rows, is_one)
}

/// Whether the values lie between their neighbours by the number of the row far better than by its stamp: one
/// sender reads them evenly, and stamps or sends them in bursts.
fn is_read_evenly(series: &Series<'_>, rows: usize) -> bool {
    const BETTER: f64 = 0.5;
    let mut off = [0.0; 2];
    for three in series.rows[..rows].windows(3) {
        let span_s = three[2].0.seconds_since(three[0].0);
        let part = three[1].0.seconds_since(three[0].0) / span_s.max(f64::MIN_POSITIVE);
        let at = [0, 1, 2].map(|row| three[row].1);
        for (off, part) in off.iter_mut().zip([0.5, part]) {
            *off += gap(&series.values, at, part).size();
        }
    }
    off[0] < BETTER * off[1]
}

/// What is told of two publishers by the rows of each. What shares one rhythm is two publishers' only where
/// they are as far apart throughout: what shakes as fast as it is sampled is not, nor what is stamped unevenly.
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
    // What is sent again with its stamp is no second publisher.
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

/// How far what two publishers say is apart.
struct Gap {
    by: Apart,
    is_there: bool,
    /// Whether it is nearly the same throughout.
    is_steady: bool,
}

/// The rows of the second held against what lies between those of the first, and these against what
/// lies between their neighbours, which is what that tells at best. `None` where nothing lies between.
fn apart(series: &Series<'_>, t_s: &[f64], [first, second]: [&[usize]; 2]) -> Option<Gap> {
    /// What is apart by less is not, m or rad: rounding, and noise of encoders.
    const LEAST: f64 = 3e-4;
    /// It is more than what lies between rows is uncertain by.
    const TIMES: f64 = 2.0;
    /// It is steady where it is hardly ever less than this share of what it is at most.
    const STEADY: f64 = 0.7;
    /// What is apart by more at times than usually is apart by motion.
    const VARIES: f64 = 2.0;
    let row = |at: usize| series.rows[at].1;
    let gap = |left: usize, at: usize, right: usize| {
        let span_s = t_s[right] - t_s[left];
        let part = if span_s > 0.0 { (t_s[at] - t_s[left]) / span_s } else { 0.0 };
        gap(&series.values, [row(left), row(at), row(right)], part)
    };
    let period_s = (t_s[first[first.len() - 1]] - t_s[first[0]]) / (first.len() - 1) as f64;
    let gaps: Vec<Apart> = second
        .iter()
        .filter_map(|&at| {
            let after = first.partition_point(|&other| t_s[other] < t_s[at]);
            let (left, right) = (*first.get(after.checked_sub(1)?)?, *first.get(after)?);
            (t_s[right] - t_s[left] < 2.5 * period_s).then(|| gap(left, at, right))
        })
        .collect();
    let own: Vec<Apart> =
        first.windows(3).map(|window| gap(window[0], window[1], window[2])).collect();
    if gaps.len() < FEWEST || own.is_empty() {
        return None;
    }
    let told = |of: fn(&Apart) -> f64| {
        let [usual, far] = [0.5, 0.9].map(|part| quantile(gaps.iter().map(of), part));
        // Some rows of the one may be the other's where they come together.
        let uncertain = quantile(own.iter().map(of), 0.8);
        let by = if far > VARIES * usual { far } else { usual };
        (by, far > LEAST + TIMES * uncertain)
    };
    let (length, angle) = (told(|gap| gap.length_m), told(|gap| gap.angle_rad));
    let part = |(by, is_there): (f64, bool)| if is_there { by } else { 0.0 };
    let by = Apart { length_m: part(length), angle_rad: part(angle) };
    let [least, most] = [0.1, 0.9].map(|part| quantile(gaps.iter().map(|gap| gap.size()), part));
    Some(Gap { by, is_there: length.1 || angle.1, is_steady: least > STEADY * most })
}

fn quantile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * part) as usize).copied().unwrap_or(0.0)
}

/// How far the middle one of three rows is from `part` of the way between the others.
fn gap(values: &Values<'_>, [left, at, right]: [usize; 3], part: f64) -> Apart {
    match values {
        Values::Poses(poses) => {
            let mix = |a: f64, b: f64| a + part * (b - a);
            let (a, b) = (poses.q_xyzw[left], poses.q_xyzw[right]);
            let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            let sign = if dot < 0.0 { -1.0 } else { 1.0 };
            let q_xyzw = std::array::from_fn(|i| mix(a[i], sign * b[i]));
            let (a, b) = (poses.xyz[left], poses.xyz[right]);
            let xyz = std::array::from_fn(|i| mix(a[i], b[i]));
            Apart::of((xyz, q_xyzw), (poses.xyz[at], poses.q_xyzw[at]))
        }
        _ => {
            let off = |number: usize| {
                let [a, q, b] = [left, at, right].map(|row| values.at(row, number));
                (q - a - part * (b - a)).abs()
            };
            let angle_rad = (0..values.width()).map(off).fold(0.0, f64::max);
            Apart { length_m: 0.0, angle_rad }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{PoseColumns, Times};
    use crate::time::Stamp;

    const MS: i64 = 1_000_000;

    /// 20 s of a transform that publishers send every so many ms from so many ms on; each says a swing
    /// of its own plus what it is off by, m.
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
                    // Copies under the same stamps are one publisher's, sent twice.
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
