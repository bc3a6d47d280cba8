//! Excerpts of a long run for estimation.
//!
//! Five minutes spread over an hour estimate nearly as well as the hour. A run longer than [`MAX_WHOLE_RUN_S`] is
//! divided into [`EXCERPT_COUNT`] parts with equally many joint states, and estimators use the span of each with
//! the most motion. Clocks, rates, gaps, repeats and counts use all rows.

use rayon::prelude::*;

use crate::stream::{Columns, JointColumns};
use crate::time::{NANOS_PER_SECOND, Stamp, nanos};

use super::role::Role;
use super::rows::Rows;
use super::sample_filter::SampleFilter;
use super::streams::{Stream, StreamClocks};

/// Maximum duration that is used completely, s.
const MAX_WHOLE_RUN_S: i64 = 300;
const EXCERPT_COUNT: usize = 24;
/// Duration of each excerpt, s.
const EXCERPT_S: i64 = 12;
/// Maximum number of motion sums; about a second each for a day.
const MAX_STEPS: i64 = 100_000;

/// The excerpts of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Excerpts {
    /// First and last ns of each excerpt on the audit's clock, in time order.
    spans: Vec<(i64, i64)>,
}

impl Excerpts {
    /// `None` if the run is used completely, or has no joint states.
    pub(super) fn select(
        streams: &[Stream],
        clocks: &StreamClocks,
        sample_filter: &SampleFilter,
    ) -> Option<Self> {
        let topics = filtered_joint_states(streams, clocks, sample_filter);
        let (start, end) = typical_range(&topics.iter().max_by_key(|(_, rows)| rows.len())?.1)?;
        let span = end.saturating_sub(start);
        // 2 % margin.
        if span <= MAX_WHOLE_RUN_S * NANOS_PER_SECOND * 102 / 100 {
            return None;
        }
        let step = NANOS_PER_SECOND.max(span / MAX_STEPS);
        let mut activity = MotionHistogram::new(start, step, (span / step) as usize + 1);
        for (columns, rows) in &topics {
            activity.add(columns, rows);
        }
        let length = (EXCERPT_S * NANOS_PER_SECOND / step).max(1) as usize;
        let spans = activity.parts().into_iter().map(|(from, to)| {
            let at = from + busiest_window(&activity.motion[from..to], length);
            let first = start + at as i64 * step;
            (first, first + length as i64 * step)
        });
        Some(Self { spans: spans.collect() })
    }

    /// Tests whether a time is within `around_s` of an excerpt. Fast for increasing times.
    pub(super) fn time_filter(&self, around_s: f64) -> impl FnMut(Stamp) -> bool {
        let around = nanos(around_s);
        let widened =
            |(start, end): &(i64, i64)| (start.saturating_sub(around), end.saturating_add(around));
        let spans: Vec<(i64, i64)> = self.spans.iter().map(widened).collect();
        // Times with the same next span as the last query.
        let mut until = (i64::MAX, i64::MIN);
        let mut start = i64::MAX;
        move |stamp| {
            let at = stamp.nanos();
            if !(until.0..=until.1).contains(&at) {
                let next = spans.partition_point(|(_, end)| *end < at);
                let before = next
                    .checked_sub(1)
                    .map_or(i64::MIN, |before| spans[before].1.saturating_add(1));
                let (from, end) = spans.get(next).copied().unwrap_or((i64::MAX, i64::MAX));
                (start, until) = (from, (before, end));
            }
            (start..i64::MAX).contains(&at)
        }
    }

    /// Number of excerpts, and their total duration, s.
    pub fn extent(&self) -> (usize, f64) {
        let nanos: i64 = self.spans.iter().map(|(start, end)| end - start).sum();
        (self.spans.len(), crate::time::seconds(nanos))
    }
}

fn filtered_joint_states<'a>(
    streams: &'a [Stream],
    clocks: &StreamClocks,
    sample_filter: &SampleFilter,
) -> Vec<(&'a JointColumns, Rows)> {
    let is_joints = |(_, stream): &(usize, &Stream)| stream.role == Role::Joints;
    let joints = streams.iter().enumerate().filter(is_joints);
    let with_rows = joints.filter_map(|(index, stream)| match &stream.columns {
        Some(Columns::Joints(joints)) => {
            let mut rows = clocks.rows(streams, index, 0);
            sample_filter.apply(index, 0, &mut rows);
            Some((joints, rows))
        }
        _ => None,
    });
    with_rows.collect()
}

/// Range without outlier stamps, with a margin, ns.
fn typical_range(rows: &Rows) -> Option<(i64, i64)> {
    // The margin includes these rows again if they are regular.
    let stray = rows.len() / 200;
    let last = rows.len().checked_sub(1 + stray)?;
    let (start, end) = match rows.is_sorted_by_key(|(stamp, _)| *stamp) {
        true => (rows[stray].0.nanos(), rows[last].0.nanos()),
        false => {
            let mut stamps: Vec<i64> = rows.iter().map(|(stamp, _)| stamp.nanos()).collect();
            stamps.sort_unstable();
            (stamps[stray], stamps[last])
        }
    };
    let margin = end.saturating_sub(start) / 100;
    Some((start.saturating_sub(margin), end.saturating_add(margin)))
}

struct MotionHistogram {
    /// Start of the run, and duration of a step, ns.
    start: i64,
    step: i64,
    /// Rows in each step.
    rows: Vec<usize>,
    /// Motion in each step over all joints, rad and m combined.
    motion: Vec<f64>,
}

impl MotionHistogram {
    fn new(start: i64, step: i64, steps: usize) -> Self {
        Self { start, step, rows: vec![0; steps], motion: vec![0.0; steps] }
    }

    fn add(&mut self, joints: &JointColumns, rows: &Rows) {
        let step_of = |stamp: Stamp| {
            let since = stamp.nanos().checked_sub(self.start)?;
            usize::try_from(since / self.step).ok().filter(|step| *step < self.rows.len())
        };
        // Only outlier stamps are outside.
        let steps: Vec<(usize, usize)> =
            rows.iter().filter_map(|&(stamp, row)| Some((step_of(stamp)?, row))).collect();
        steps.iter().for_each(|&(step, _)| self.rows[step] += 1);
        let motion = joints.joints.par_iter().map(|joint| {
            let mut motion = vec![0.0; self.motion.len()];
            let mut last = f64::NAN;
            for &(step, row) in &steps {
                let position = joint.position[row];
                let moved = (position - last).abs();
                if moved.is_finite() {
                    motion[step] += moved;
                }
                if position.is_finite() {
                    last = position;
                }
            }
            motion
        });
        // A fixed order makes the sums reproducible.
        for motion in motion.collect::<Vec<_>>() {
            self.motion.iter_mut().zip(motion).for_each(|(sum, moved)| *sum += moved);
        }
    }

    /// First and end step (exclusive) of each part.
    fn parts(&self) -> Vec<(usize, usize)> {
        let mut behind = Vec::with_capacity(EXCERPT_COUNT);
        let (all, mut seen) = (self.rows.iter().sum::<usize>(), 0);
        for (step, rows) in self.rows.iter().enumerate() {
            seen += rows;
            while behind.len() < EXCERPT_COUNT && seen * EXCERPT_COUNT >= all * (behind.len() + 1) {
                behind.push(step + 1);
            }
        }
        let starts = std::iter::once(0).chain(behind.iter().copied());
        starts.zip(behind.iter().copied()).filter(|(from, to)| from < to).collect()
    }
}

fn busiest_window(motion: &[f64], length: usize) -> usize {
    let sums = motion.windows(length).map(|window| window.iter().sum::<f64>());
    // The first of equals; `max_by` would return the last.
    let best = sums.enumerate().reduce(|best, next| if next.1 > best.1 { next } else { best });
    best.map_or(0, |(at, _)| at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::Topic;
    use crate::run::streams::split;
    use crate::stream::JointColumn;

    /// Joint states every 0.5 s, with motion in the last tenth of every part.
    fn excerpts(seconds: i64, stray: Option<i64>) -> Option<Excerpts> {
        let mut columns = JointColumns::default();
        columns.joints.push(JointColumn { name: "a".into(), ..Default::default() });
        let rows = 2 * seconds;
        let part = rows / EXCERPT_COUNT as i64;
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
            unusable: None,
            read_as: None,
            cells: Vec::new(),
            velocity_cells: Vec::new(),
            is_aligned_by_motion: false,
            span: None,
            file: None,
        }]);
        let clocks = StreamClocks::select(&streams, crate::time::Clock::Header, 5.0);
        Excerpts::select(&streams, &clocks, &SampleFilter::default())
    }

    #[test]
    fn a_short_run_is_used_completely() {
        assert_eq!(excerpts(MAX_WHOLE_RUN_S, None), None);
        assert_eq!(excerpts(MAX_WHOLE_RUN_S, Some(i64::MAX)), None);
    }

    #[test]
    fn excerpts_are_the_spans_with_most_motion() {
        let part_s = 200;
        let seconds = part_s * EXCERPT_COUNT as i64;
        for stray in [None, Some(1), Some(i64::MAX)] {
            let excerpts = excerpts(seconds, stray).unwrap();
            assert_eq!(
                excerpts.extent(),
                (EXCERPT_COUNT, (EXCERPT_COUNT as i64 * EXCERPT_S) as f64)
            );
            let holds = |stamp: Stamp, around_s: f64| {
                let mut of_many = excerpts.time_filter(around_s);
                let alone = excerpts.time_filter(around_s)(stamp);
                for seconds in 0..seconds {
                    of_many(Stamp::from_nanos((1000 + seconds) * NANOS_PER_SECOND));
                    assert_eq!(of_many(stamp), alone);
                }
                alone
            };
            for part in 0..EXCERPT_COUNT as i64 {
                let moving = Stamp::from_nanos((1000 + part * part_s + 190) * NANOS_PER_SECOND);
                let still = Stamp::from_nanos((1000 + part * part_s + 90) * NANOS_PER_SECOND);
                assert!(holds(moving, 0.0), "part {part}");
                assert!(!holds(still, 5.0), "part {part}");
                assert!(holds(still, 120.0), "part {part}");
            }
        }
    }
}
