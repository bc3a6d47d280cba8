//! Merges all joint states on one time grid.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use crate::stream::{
    Columns, JointColumn, JointColumns, JointSequence, JointTrack, bracket, sample_noise,
};
use crate::time::Stamp;

use super::Run;
use super::rows::Rows;
use super::set_back::continue_stamps;
use super::velocities::{SmoothedJoint, VelocitySource, compare_velocities, smooth};

/// Origin of one joint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JointSource {
    /// Joint name in the log.
    pub name: String,
    /// Index of its stream.
    pub stream: usize,
    /// Number of samples in that stream.
    pub samples: usize,
    /// Source of its velocities.
    pub velocities: VelocitySource,
}

#[derive(Clone)]
pub(super) struct JointTopic<'a> {
    /// Index of its stream.
    pub stream: usize,
    pub columns: &'a JointColumns,
    pub rows: Rows,
}

impl JointTopic<'_> {
    /// Whether all rows are selected and strictly increase in time, in the order of the columns.
    pub fn is_in_order(&self) -> bool {
        self.rows.len() == self.columns.times.len()
            && self.rows.is_sorted_by(|earlier, later| earlier.0 < later.0 && earlier.1 < later.1)
    }

    /// Whether it has samples of the joint.
    pub fn has_joint(&self, name: &str) -> bool {
        let joint = self.columns.joints.iter().find(|joint| joint.name == name);
        joint.is_some_and(|joint| self.has_samples(joint))
    }

    /// Whether `joint`, one of its joints, has samples.
    pub fn has_samples(&self, joint: &JointColumn) -> bool {
        self.rows.iter().any(|(_, row)| joint.position[*row].is_finite())
    }
}

/// Joint state topics of one robot. Caches merged tracks, as ranked models request the same joints.
pub(super) struct JointTopics<'a> {
    pub topics: Vec<JointTopic<'a>>,
    origin: Stamp,
    merged: Mutex<Vec<(Vec<String>, Option<MergedJoints>)>>,
}

impl<'a> JointTopics<'a> {
    /// Merged times are relative to `origin`.
    pub fn new(topics: Vec<JointTopic<'a>>, origin: Stamp) -> Self {
        Self { topics, origin, merged: Mutex::default() }
    }

    /// The named joints, merged by [`merge`].
    pub fn merged(&self, names: &[String]) -> Option<MergedJoints> {
        let known = || self.merged.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known().iter().find(|(of, _)| of == names).map(|(_, merged)| merged.clone());
        found.unwrap_or_else(|| {
            let merged = merge(&self.topics, names, self.origin);
            known().push((names.to_vec(), merged.clone()));
            merged
        })
    }
}

#[derive(Clone)]
pub(super) struct MergedJoints {
    pub track: Arc<JointTrack>,
    /// Stamps of the track's samples.
    pub stamps: Arc<[Stamp]>,
    pub sources: Vec<JointSource>,
}

/// Finite samples, strictly increasing in time.
#[derive(Default)]
pub(super) struct SortedSamples {
    pub stamps: Vec<Stamp>,
    pub position: Vec<f64>,
    velocity: Vec<f64>,
}

/// Merges the named joints on the time grid of the one with the most samples.
///
/// Each joint comes from the topic with the most requested joints, then the most rows. Gaps are
/// interpolated; times are skipped before a joint's start, after its end, and in gaps with motion. Times
/// are relative to `origin`. `None` if a joint has no sample, or fewer than two times remain.
fn merge(topics: &[JointTopic<'_>], names: &[String], origin: Stamp) -> Option<MergedJoints> {
    let mut ranked: Vec<&JointTopic<'_>> = topics.iter().collect();
    let holds = |topic: &JointTopic<'_>| {
        topic.columns.joints.iter().filter(|joint| names.contains(&joint.name)).count()
    };
    ranked.sort_by_key(|topic| std::cmp::Reverse((holds(topic), topic.columns.times.len())));

    let mut sources = Vec::with_capacity(names.len());
    let mut joints = Vec::with_capacity(names.len());
    let found = names.par_iter().map(|name| {
        let samples = ranked.iter().map(|topic| (topic, SortedSamples::from_topic(topic, name)));
        let (topic, samples) = samples.into_iter().find(|(_, found)| !found.stamps.is_empty())?;
        let (track, velocities) = samples.track(origin);
        Some((topic, samples, track, velocities))
    });
    for (name, found) in names.iter().zip(found.collect::<Vec<_>>()) {
        let (topic, samples, track, velocities) = found?;
        let count = samples.stamps.len();
        sources.push(JointSource {
            name: name.clone(),
            stream: topic.stream,
            samples: count,
            velocities,
        });
        joints.push((samples.stamps, track));
    }
    let (grid, _) = joints.iter().rev().max_by_key(|(stamps, _)| stamps.len())?;

    let noise = joints.iter().flat_map(|(_, track)| track.noise.iter().copied()).collect();
    let mut track = JointTrack { dof: names.len(), noise, ..Default::default() };
    let mut stamps = Vec::new();
    let mut cursors: Vec<SampleCursor<'_>> =
        joints.iter().map(|(stamps, track)| SampleCursor::new(stamps, track)).collect();
    let mut row: Vec<(f64, f64)> = Vec::with_capacity(names.len());
    for &stamp in grid {
        let t_s = stamp.seconds_since(origin);
        row.clear();
        row.extend(cursors.iter_mut().map_while(|cursor| cursor.sample(stamp, t_s)));
        if row.len() < names.len() {
            continue;
        }
        stamps.push(stamp);
        track.t_s.push(t_s);
        track.q.extend(row.iter().map(|(position, _)| position));
        track.qd.extend(row.iter().map(|(_, velocity)| velocity));
    }
    let is_track = track.len() > 1;
    is_track.then(|| MergedJoints { track: Arc::new(track), stamps: stamps.into(), sources })
}

/// Finite samples of an arm's joint, strictly increasing in time.
#[derive(Clone, Debug, Default)]
pub struct JointSamples<'a> {
    /// Times, s from the run's origin; shared by joints of the same messages.
    pub t_s: Arc<[f64]>,
    /// Positions, rad or m.
    pub position: Cow<'a, [f64]>,
    /// Logged velocities, rad/s or m/s; NaN if none.
    pub velocity: Cow<'a, [f64]>,
}

impl JointSamples<'_> {
    /// Whether two joints have the same times.
    pub fn has_same_times(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.t_s, &other.t_s) || self.t_s == other.t_s
    }

    /// Positions and velocities at the times of another joint: linear between samples, constant beyond them. Empty without
    /// samples.
    pub(super) fn at_times_of(&self, other: &Self) -> [Vec<f64>; 2] {
        let own = [&self.position, &self.velocity];
        let (Some(first), Some(last)) = (self.t_s.first(), self.t_s.last()) else {
            return Default::default();
        };
        if self.has_same_times(other) {
            return own.map(|values| values.to_vec());
        }
        own.map(|values| {
            let mut left = 0;
            let value_at = |t_s: &f64| {
                let t_s = t_s.clamp(*first, *last);
                let Some(at) = bracket(&self.t_s, t_s, &mut left) else { return values[0] };
                let interval_s = (self.t_s[at + 1] - self.t_s[at]).max(f64::MIN_POSITIVE);
                let share = (t_s - self.t_s[at]) / interval_s;
                values[at] + share * (values[at + 1] - values[at])
            };
            other.t_s.iter().map(value_at).collect()
        })
    }

    /// Times of all joints. `None` if they differ, or without joints.
    pub fn common_times(joints: &[Self]) -> Option<&Arc<[f64]>> {
        let (first, others) = joints.split_first()?;
        others.iter().all(|other| other.has_same_times(first)).then_some(&first.t_s)
    }
}

impl Run {
    /// Samples of each joint, also outside the excerpts.
    pub fn joint_samples(&self, joints: &[JointSource]) -> Vec<JointSamples<'_>> {
        let mut topics: Vec<(JointTopic<'_>, Option<Arc<[f64]>>)> = Vec::new();
        let mut samples = Vec::with_capacity(joints.len());
        for joint in joints {
            let known = topics.iter().position(|(topic, _)| topic.stream == joint.stream);
            let at = known.or_else(|| {
                topics.push(self.joint_topic(joint.stream)?);
                Some(topics.len() - 1)
            });
            samples.push(match at.map(|at| &topics[at]) {
                Some((topic, t_s)) => topic.samples(&joint.name, t_s.as_ref(), self.origin),
                None => JointSamples::default(),
            });
        }
        samples
    }

    fn joint_topic(&self, stream: usize) -> Option<(JointTopic<'_>, Option<Arc<[f64]>>)> {
        let Columns::Joints(columns) = self.streams.get(stream)?.columns.as_ref()? else {
            return None;
        };
        let clock = self.clocks_of(stream).first()?;
        let mut rows: Rows = clock.rows_of(&columns.times).collect();
        continue_stamps(&mut rows, &columns.times.log);
        self.sample_filter.apply(stream, 0, &mut rows);
        let topic = JointTopic { stream, columns, rows };
        let seconds = |(stamp, _): &(Stamp, usize)| stamp.seconds_since(self.origin);
        let t_s = topic.is_in_order().then(|| topic.rows.iter().map(seconds).collect());
        Some((topic, t_s))
    }
}

impl<'a> JointTopic<'a> {
    /// `t_s` are the times of all rows, if in order.
    fn samples(&self, name: &str, t_s: Option<&Arc<[f64]>>, origin: Stamp) -> JointSamples<'a> {
        let columns: &'a JointColumns = self.columns;
        let joint = columns.joints.iter().find(|joint| joint.name == name);
        if let (Some(joint), Some(t_s)) = (joint, t_s)
            && joint.position.iter().all(|position| position.is_finite())
        {
            let (position, velocity) = (joint.position.as_slice(), joint.velocity.to_slice());
            return JointSamples { t_s: Arc::clone(t_s), position: position.into(), velocity };
        }
        let SortedSamples { stamps, position, velocity } = SortedSamples::from_topic(self, name);
        JointSamples {
            t_s: stamps.iter().map(|stamp| stamp.seconds_since(origin)).collect(),
            position: position.into(),
            velocity: velocity.into(),
        }
    }
}

/// Samples of one joint, read at ascending stamps.
struct SampleCursor<'a> {
    stamps: &'a [Stamp],
    track: &'a JointTrack,
    next: usize,
    between: JointSequence<'a>,
}

impl<'a> SampleCursor<'a> {
    fn new(stamps: &'a [Stamp], track: &'a JointTrack) -> Self {
        Self { stamps, track, next: 0, between: track.sequence() }
    }

    /// Position and velocity at `stamp`, interpolated between samples.
    fn sample(&mut self, stamp: Stamp, t_s: f64) -> Option<(f64, f64)> {
        while self.stamps.get(self.next).is_some_and(|&own| own < stamp) {
            self.next += 1;
        }
        if self.stamps.get(self.next) == Some(&stamp) {
            return Some((self.track.q[self.next], self.track.qd[self.next]));
        }
        self.between.at(t_s).map(|(q, qd)| (q[0], qd[0]))
    }
}

impl SortedSamples {
    /// Finite samples in time order; the first of equal stamps.
    pub fn from_topic(topic: &JointTopic<'_>, name: &str) -> Self {
        let Some(joint) = topic.columns.joints.iter().find(|joint| joint.name == name) else {
            return Self::default();
        };
        let is_known = |(_, row): &(Stamp, usize)| joint.position[*row].is_finite();
        let mut rows: Rows = topic.rows.iter().copied().filter(is_known).collect();
        rows.sort_by_key(|(stamp, _)| *stamp);
        rows.dedup_by_key(|(stamp, _)| *stamp);
        Self {
            stamps: rows.iter().map(|(stamp, _)| *stamp).collect(),
            position: rows.iter().map(|(_, row)| joint.position[*row]).collect(),
            velocity: rows.iter().map(|(_, row)| joint.velocity[*row]).collect(),
        }
    }

    fn track(&self, origin: Stamp) -> (JointTrack, VelocitySource) {
        let t_s: Vec<f64> = self.stamps.iter().map(|stamp| stamp.seconds_since(origin)).collect();
        let SmoothedJoint { q, qd: derived, mut noise } = smooth(&t_s, &self.position);
        let velocities = compare_velocities(&t_s, &q, &self.velocity, &derived);
        let is_logged = velocities == VelocitySource::Logged;
        let qd = if is_logged { self.velocity.clone() } else { derived };
        if is_logged {
            noise[1] = sample_noise(&qd);
        }
        (JointTrack { t_s, dof: 1, q, qd, noise: vec![noise] }, velocities)
    }
}

#[cfg(test)]
mod tests {
    use super::super::velocities::derivative;
    use super::*;
    use crate::stream::JointColumn;

    /// Two joints at 100 Hz for 3 s; `velocity` maps time and true to logged velocity.
    fn columns(velocity: impl Fn(f64, f64) -> f64) -> JointColumns {
        let mut columns = JointColumns::default();
        for name in ["a", "b"] {
            columns.joints.push(JointColumn { name: name.into(), ..Default::default() });
        }
        for row in 0..300 {
            let t = row as f64 * 0.01;
            columns.times.push(1 + row * 10_000_000, 0, 0);
            for (joint, rate) in columns.joints.iter_mut().zip([2.0_f64, 3.0]) {
                joint.position.push((rate * t).sin());
                joint.velocity.push(velocity(t, rate * (rate * t).cos()));
            }
        }
        columns
    }

    fn topic(columns: &JointColumns) -> JointTopic<'_> {
        let rows = columns.times.header.iter().map(|&t| Stamp::from_nanos(t)).zip(0..).collect();
        JointTopic { stream: 0, columns, rows }
    }

    fn merged(topics: &[JointTopic<'_>]) -> MergedJoints {
        merge(topics, &["b".to_owned(), "a".to_owned()], Stamp::from_nanos(1)).unwrap()
    }

    #[test]
    fn joints_are_in_the_requested_order() {
        let columns = columns(|_, v| v);
        let MergedJoints { track, sources, .. } = merged(&[topic(&columns)]);
        assert_eq!((track.len(), track.dof), (300, 2));
        assert_eq!(track.row(50), [1.5_f64.sin(), 1.0_f64.sin()]);
        assert!(sources.iter().all(|joint| joint.velocities == VelocitySource::Logged));
    }

    #[test]
    fn velocities_inconsistent_with_positions_are_not_used() {
        for wrong in
            [|_: f64, _: f64| 0.0, |_, v: f64| v.to_degrees(), |_, v: f64| -v, |_, _| f64::NAN]
        {
            let columns = columns(wrong);
            let MergedJoints { track, sources, .. } = merged(&[topic(&columns)]);
            assert!(sources.iter().all(|joint| joint.velocities == VelocitySource::Derived));
            for row in 0..track.len() {
                let truth = 3.0 * (3.0 * track.t_s[row]).cos();
                assert!((track.qd[2 * row] - truth).abs() < 2e-3, "row {row}");
            }
        }
    }

    #[test]
    fn a_joint_at_rest_keeps_its_zero_velocities() {
        let t_s: Vec<f64> = (0..100).map(|row| row as f64 * 0.01).collect();
        let noise: Vec<f64> = (0..100).map(|row| 1e-5 * f64::from(row % 3)).collect();
        let derived = derivative(&t_s, &noise);
        assert_eq!(compare_velocities(&t_s, &noise, &[0.0; 100], &derived), VelocitySource::Logged);
        assert_eq!(
            compare_velocities(&t_s, &noise, &[0.3; 100], &derived),
            VelocitySource::Derived
        );
    }

    #[test]
    fn samples_that_are_not_finite_are_interpolated_and_not_used() {
        let mut columns = columns(|_, v| v);
        columns.joints[0].position[77] = f64::NAN;
        let MergedJoints { track, sources, .. } = merged(&[topic(&columns)]);
        assert_eq!(sources.iter().map(|joint| joint.samples).collect::<Vec<_>>(), [300, 299]);
        assert_eq!(track.len(), 300);
        assert!((track.row(77)[1] - 1.54_f64.sin()).abs() < 1e-7);
    }

    #[test]
    fn a_gap_in_one_moving_joint_is_a_gap_in_the_track() {
        let mut columns = columns(|_, v| v);
        columns.joints[0].position[100..150].fill(f64::NAN);
        assert_eq!(merged(&[topic(&columns)]).track.len(), 250);
    }

    #[test]
    fn joints_of_several_topics_are_merged_on_the_finer_grid() {
        let (mut arm, mut rail) = (columns(|_, v| v), columns(|_, v| v));
        arm.joints.remove(0);
        rail.joints.remove(1);
        for time in &mut rail.times.header {
            *time += 3_000_000;
        }
        let rail_rows = 0..150;
        rail.times.header.truncate(150);
        rail.joints[0].position.truncate(150);
        rail.joints[0].velocity.select(&(0..150).collect::<Vec<_>>());
        let mut topics = [topic(&arm), topic(&rail)];
        topics[1].stream = 7;
        let MergedJoints { track, sources, .. } = merged(&topics);
        assert_eq!((sources[0].stream, sources[1].stream), (0, 7));
        assert_eq!(track.len(), rail_rows.len() - 1);
        let truth = (2.0 * (track.t_s[40] - 0.003)).sin();
        assert!((track.row(40)[1] - truth).abs() < 1e-7);
    }

    #[test]
    fn repeated_and_unordered_stamps_leave_a_strictly_increasing_track() {
        let mut columns = columns(|_, v| v);
        columns.times.header[10] = columns.times.header[9];
        columns.times.header.swap(20, 21);
        let MergedJoints { track, .. } = merged(&[topic(&columns)]);
        assert_eq!(track.len(), 299);
        assert!(track.t_s.is_sorted_by(|a, b| a < b));
    }
}
