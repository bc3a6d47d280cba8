//! What of a long run the estimators see.
//!
//! An estimate from an hour of motion is hardly better than one from five minutes that are spread
//! over the hour, and costs twelve times as much. So of a run longer than [`WHOLE_S`] the estimators
//! see excerpts: it is cut into [`PARTS`] parts with as many joint states each, and of each part they
//! see the stretch in which the joints move most. Clocks, rates, gaps, repeats and counts are always
//! of all rows.

use crate::stream::{Columns, JointColumns};
use crate::time::{NANOS_PER_SECOND, Stamp, nanos};

use super::role::Role;
use super::strays;
use super::streams::{Stream, Timing};

/// A run that is no longer is seen whole, s.
const WHOLE_S: i64 = 300;
/// Parts that a longer one is cut into.
const PARTS: usize = 24;
/// What is seen of each part, s.
const EXCERPT_S: i64 = 12;
/// Most steps of a run in which motion is summed; in a run of a day each is a second.
const STEPS: i64 = 100_000;

/// The excerpts of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Excerpts {
    /// First and last nanosecond of each on the audit's clock, in the order of time.
    spans: Vec<(i64, i64)>,
}

impl Excerpts {
    /// The excerpts of a run with these streams; `None` where it is seen whole, or has no joint states.
    pub(super) fn of(streams: &[Stream], timing: &Timing) -> Option<Self> {
        let topics = joints(streams, timing);
        let (start, end) = bulk(&topics.iter().max_by_key(|(_, stamps)| stamps.len())?.1)?;
        let span = end.saturating_sub(start);
        // Some 2 % of it are margin.
        if span <= WHOLE_S * NANOS_PER_SECOND * 102 / 100 {
            return None;
        }
        let step = NANOS_PER_SECOND.max(span / STEPS);
        let mut activity = Activity::none(start, step, (span / step) as usize + 1);
        for (columns, stamps) in &topics {
            activity.add(columns, stamps);
        }
        let length = (EXCERPT_S * NANOS_PER_SECOND / step).max(1) as usize;
        let spans = activity.parts().into_iter().map(|(from, to)| {
            let at = from + busiest(&activity.motion[from..to], length);
            let first = start + at as i64 * step;
            (first, first + length as i64 * step)
        });
        Some(Self { spans: spans.collect() })
    }

    /// Takes out the times that are in none of them, nor less than `around_s` off.
    pub(super) fn hide_others(&self, stamps: &mut [Option<Stamp>], around_s: f64) {
        let around = nanos(around_s);
        let widened =
            |&(start, end): &(i64, i64)| (start.saturating_sub(around), end.saturating_add(around));
        // Stamps mostly follow each other, so that the span of one is that of the next.
        let mut span = (i64::MAX, i64::MIN);
        for stamp in stamps {
            let Some(at) = stamp.map(Stamp::nanos) else { continue };
            if !(span.0..=span.1).contains(&at) {
                let next = self.spans.partition_point(|span| widened(span).1 < at);
                span = self.spans.get(next).map_or((i64::MAX, i64::MIN), widened);
            }
            if !(span.0..=span.1).contains(&at) {
                *stamp = None;
            }
        }
    }

    /// How many there are, and how long they are together, s.
    pub fn extent(&self) -> (usize, f64) {
        let nanos: i64 = self.spans.iter().map(|(start, end)| end - start).sum();
        (self.spans.len(), crate::time::seconds(nanos))
    }
}

/// The topics of joint states, each with the stamps of its rows.
fn joints<'a>(
    streams: &'a [Stream],
    timing: &Timing,
) -> Vec<(&'a JointColumns, Vec<Option<Stamp>>)> {
    let is_joints = |(_, stream): &(usize, &Stream)| stream.role == Role::Joints;
    let joints = streams.iter().enumerate().filter(is_joints);
    let with_stamps = joints.filter_map(|(index, stream)| match &stream.columns {
        Some(Columns::Joints(joints)) => {
            let mut stamps = timing.stamps(streams, index, 0);
            strays::hide(&timing.strays, index, 0, &mut stamps);
            Some((joints, stamps))
        }
        _ => None,
    });
    with_stamps.collect()
}

/// Between which times the rows are but for stray ones, ns.
fn bulk(stamps: &[Option<Stamp>]) -> Option<(i64, i64)> {
    let mut stamps: Vec<i64> = stamps.iter().flatten().map(|stamp| stamp.nanos()).collect();
    // So many at either end may be stray; as many are there even so, a little further out.
    let stray = stamps.len() / 200;
    let last = stamps.len().checked_sub(1 + stray)?;
    let (_, &mut start, _) = stamps.select_nth_unstable(stray);
    let (_, &mut end, _) = stamps.select_nth_unstable(last);
    let margin = end.saturating_sub(start) / 100;
    Some((start.saturating_sub(margin), end.saturating_add(margin)))
}

/// What the joints do in each step of a run.
struct Activity {
    /// Where the run begins and how long a step is, ns.
    start: i64,
    step: i64,
    /// Rows in each step.
    rows: Vec<usize>,
    /// By how much the joints move in each step, summed over all, rad and m together.
    motion: Vec<f64>,
}

impl Activity {
    fn none(start: i64, step: i64, steps: usize) -> Self {
        Self { start, step, rows: vec![0; steps], motion: vec![0.0; steps] }
    }

    /// Adds a topic of joint states.
    fn add(&mut self, joints: &JointColumns, stamps: &[Option<Stamp>]) {
        let step_of = |stamp: &Option<Stamp>| {
            let since = stamp.as_ref()?.nanos().checked_sub(self.start)?;
            usize::try_from(since / self.step).ok().filter(|step| *step < self.rows.len())
        };
        let steps: Vec<Option<usize>> = stamps.iter().map(step_of).collect();
        steps.iter().flatten().for_each(|&step| self.rows[step] += 1);
        for joint in &joints.joints {
            let mut last = f64::NAN;
            for (&position, step) in joint.position.iter().zip(&steps) {
                let moved = (position - last).abs();
                if let (Some(step), true) = (*step, moved.is_finite()) {
                    self.motion[step] += moved;
                }
                // Without a stamp it is no sample, or a stray one.
                if position.is_finite() && step.is_some() {
                    last = position;
                }
            }
        }
    }

    /// First step of each part, and the one behind its last.
    fn parts(&self) -> Vec<(usize, usize)> {
        let mut behind = Vec::with_capacity(PARTS);
        let (all, mut seen) = (self.rows.iter().sum::<usize>(), 0);
        for (step, rows) in self.rows.iter().enumerate() {
            seen += rows;
            while behind.len() < PARTS && seen * PARTS >= all * (behind.len() + 1) {
                behind.push(step + 1);
            }
        }
        let starts = std::iter::once(0).chain(behind.iter().copied());
        starts.zip(behind.iter().copied()).filter(|(from, to)| from < to).collect()
    }
}

/// Where the `length` steps begin in which there is most motion.
fn busiest(motion: &[f64], length: usize) -> usize {
    let sums = motion.windows(length).map(|window| window.iter().sum::<f64>());
    // Of equals the first: `max_by` would give the last.
    let best = sums.enumerate().reduce(|best, next| if next.1 > best.1 { next } else { best });
    best.map_or(0, |(at, _)| at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::Topic;
    use crate::run::streams::split;
    use crate::stream::JointColumn;

    /// Joint states every half second for `seconds`, which move in the last tenth of every part.
    fn excerpts(seconds: i64, stray: Option<i64>) -> Option<Excerpts> {
        let mut columns = JointColumns::default();
        columns.joints.push(JointColumn { name: "a".into(), ..Default::default() });
        let rows = 2 * seconds;
        let part = rows / PARTS as i64;
        for row in 0..rows {
            let at = (1000 + row / 2) * NANOS_PER_SECOND + (row % 2) * NANOS_PER_SECOND / 2;
            columns.times.push(at, at, at);
            let moves = row % part > part - part / 10;
            columns.joints[0].position.push(if moves { (row % 2) as f64 } else { 0.0 });
            columns.joints[0].velocity.push(f64::NAN);
        }
        if let Some(stray) = stray {
            columns.times.header[17] = stray;
        }
        let streams = split(vec![Topic {
            name: "/joint_states".into(),
            type_name: "sensor_msgs/msg/JointState".into(),
            encoding: "cdr".into(),
            messages: rows as u64,
            columns: Some(Columns::Joints(columns)),
            undecodable: None,
            useless: None,
            span: None,
        }]);
        let timing = Timing::settle(&streams, crate::time::Clock::Header, 5.0);
        Excerpts::of(&streams, &timing)
    }

    #[test]
    fn a_short_run_is_seen_whole() {
        assert_eq!(excerpts(WHOLE_S, None), None);
        // A stamp from another age makes it no longer.
        assert_eq!(excerpts(WHOLE_S, Some(i64::MAX)), None);
    }

    #[test]
    fn of_each_part_the_stretch_with_most_motion_is_seen() {
        let part_s = 200;
        let seconds = part_s * PARTS as i64;
        for stray in [None, Some(1), Some(i64::MAX)] {
            let excerpts = excerpts(seconds, stray).unwrap();
            assert_eq!(excerpts.extent(), (PARTS, (PARTS as i64 * EXCERPT_S) as f64));
            let holds = |stamp: Stamp, around_s: f64| {
                let mut stamps = [Some(stamp)];
                excerpts.hide_others(&mut stamps, around_s);
                stamps == [Some(stamp)]
            };
            for part in 0..PARTS as i64 {
                let moving = Stamp::from_nanos((1000 + part * part_s + 190) * NANOS_PER_SECOND);
                let still = Stamp::from_nanos((1000 + part * part_s + 90) * NANOS_PER_SECOND);
                assert!(holds(moving, 0.0), "part {part}");
                assert!(!holds(still, 5.0), "part {part}");
                assert!(holds(still, 120.0), "part {part}");
            }
        }
    }
}
