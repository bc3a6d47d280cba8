//! Recognises poses of objects: they rest while the joints move the tool, also if the tool carries them later.

use std::collections::{BTreeMap, HashSet};
use std::f64::consts::TAU;

use crate::diagnosis::{LagPeak, PoseStream, candidate_lags, value_range};
use crate::geometry::{Vec3, angle_between, rotation_from_rpy};
use crate::stream::{JointTrack, Orientations, PoseTrack, sample_noise};

use super::arm::Arm;
use super::frozen::{is_same, jumps_after, retain_samples, spans_like_first};
use super::not_audited::{NotAudited, NotAuditedReason};
use super::role::Role;
use super::sources::PoseSource;
use super::streams::Stream;
use super::{MIN_FOLLOWER_CORRELATION, Run};

/// Minimum motion of the tool that a pose of it must show, m.
pub(super) const MIN_MOTION_M: f64 = 0.05;
/// Minimum duration of a rest, s.
const MIN_DURATION_S: f64 = 1.0;

impl Run {
    /// Largest motion of the tool by the joints while the pose of `source` rests, m. Applies the latencies at which the moving
    /// pose follows the tool. `None` if the pose may be of the tool.
    pub(super) fn motion_during_rests_m(
        &self,
        arm: &Arm,
        source: &PoseSource,
        max_lag_s: f64,
    ) -> Option<f64> {
        const MIN_MOVING_SAMPLES: usize = 10;
        /// Latencies on either side of 0, for a pose that never moves.
        const LAGS: i32 = 8;
        /// Ratio of the tool's motion to the radius of a rest. With sparse samples, the noise estimate contains motion.
        const MIN_MOTION_RATIO: f64 = 5.0;
        let track = &source.track;
        let radius = rest_radius(track);
        let rests = rests(track, radius);
        let mut is_moving = vec![true; track.t_s.len()];
        rests.iter().for_each(|&(first, last)| is_moving[first..=last].fill(false));
        let mut moving = track.clone();
        retain_samples(&mut moving, &is_moving);
        let lags_s: Vec<f64> = if moving.t_s.len() < MIN_MOVING_SAMPLES {
            (-LAGS..=LAGS).map(|lag| max_lag_s * f64::from(lag) / f64::from(LAGS)).collect()
        } else {
            let stream = PoseStream { track: &moving, ..self.pose_stream(source) };
            let peaks = candidate_lags(&arm.joints, &stream, max_lag_s).into_iter();
            let follows = |peak: &LagPeak| peak.correlation >= MIN_FOLLOWER_CORRELATION;
            peaks.filter(follows).map(|peak| peak.lag_s).collect()
        };
        let moved = rests
            .into_iter()
            .filter(|rest| !may_be_frozen(track, *rest))
            .filter_map(|rest| source.motion_during(&arm.joints, rest, &lags_s))
            .filter(|moved_m| *moved_m > MIN_MOTION_RATIO * radius);
        moved.reduce(f64::max)
    }

    /// Excludes streams of objects; each has the motion of the tool during its rest. Reports streams in a frame of the robot,
    /// once per topic: a simulator's topic has all bodies of its world.
    pub(super) fn exclude_objects(&mut self, objects: &[(usize, f64)]) {
        let mut topics: BTreeMap<String, (usize, Vec<String>, f64)> = BTreeMap::new();
        for &(stream, moved_m) in objects {
            let Stream { topic, child_frame_id, role, .. } = &self.streams[stream];
            if *role == (Role::Candidate { presumed: true }) {
                let (_, bodies, largest_m) =
                    topics.entry(topic.clone()).or_insert((stream, Vec::new(), 0.0));
                bodies.push(child_frame_id.clone());
                *largest_m = largest_m.max(moved_m);
            }
            let moved_mm = 1e3 * moved_m;
            let reason =
                format!("an object: it rests while the joints move the tool by {moved_mm:.0} mm");
            self.clear_role(stream, reason);
        }
        let streams: HashSet<usize> = objects.iter().map(|(stream, _)| *stream).collect();
        self.remove_sources(&streams);
        self.targets.retain(|target| !streams.contains(&target.stream));
        self.frozen.retain(|span| !streams.contains(&span.stream));
        let reports = topics.into_values().map(|(stream, bodies, moved_m)| NotAudited {
            stream,
            reason: NotAuditedReason::SceneObjects { bodies, moved_m },
        });
        self.not_audited.extend(reports);
    }
}

/// Largest distance between positions at rest.
fn rest_radius(track: &PoseTrack) -> f64 {
    /// Ratio to the standard deviation of the noise.
    const MAX_NOISE_RATIO: f64 = 8.0;
    /// Share of the extent of the positions.
    const MAX_EXTENT_SHARE: f64 = 0.005;
    let axis = |axis: usize| track.xyz.iter().map(move |xyz| xyz[axis]);
    let noise = Vec3::from_fn(|i, _| sample_noise(&axis(i).collect::<Vec<f64>>())).norm();
    let extent = Vec3::from_fn(|i, _| value_range(axis(i))).norm();
    (MAX_NOISE_RATIO * noise).max(MAX_EXTENT_SHARE * extent)
}

/// First and last sample of each rest: positions and orientations stay within the noise.
fn rests(track: &PoseTrack, radius: f64) -> Vec<(usize, usize)> {
    const MAX_TURN_RAD: f64 = 0.1;
    let angle_rad = |a: usize, b: usize| match &track.orientation {
        Orientations::Rotations(all) => angle_between(&all[a], &all[b]),
        // A turn changes the numbers of every convention, by other amounts.
        Orientations::Numbers(all) => {
            let is_in_degrees = all.iter().flatten().any(|angle| angle.abs() > TAU);
            let unit = if is_in_degrees { 1f64.to_radians() } else { 1.0 };
            let [a, b] = [a, b].map(|row| rotation_from_rpy(all[row].map(|angle| angle * unit)));
            angle_between(&a, &b)
        }
        Orientations::Unset(_) => 0.0,
    };
    let is_turned = |a: usize, b: usize| angle_rad(a, b) > MAX_TURN_RAD;
    spans_like_first(&track.t_s, MIN_DURATION_S, |first, row| {
        (track.xyz[row] - track.xyz[first]).norm() <= radius && !is_turned(first, row)
    })
}

/// Whether a publisher may have repeated its last value: afterwards it jumps, or the run ends.
fn may_be_frozen(track: &PoseTrack, (first, last): (usize, usize)) -> bool {
    let is_constant = (first + 1..=last).all(|row| is_same(track, first, row));
    let is_end = last + 1 == track.t_s.len();
    is_constant && if is_end { first > 0 } else { jumps_after(track, last) }
}

impl PoseSource {
    /// Motion of the link by FK during the rest, m: the smallest over all lags. `None` if a rigid tool could rest then.
    fn motion_during(
        &self,
        joints: &JointTrack,
        (first, last): (usize, usize),
        lags_s: &[f64],
    ) -> Option<f64> {
        const MIN_OVERLAP: f64 = 0.5;
        let (&begin_s, &end_s) = (joints.t_s.first()?, joints.t_s.last()?);
        let rest_s = [first, last].map(|row| self.track.t_s[row]);
        let spans =
            lags_s.iter().map(|lag_s| rest_s.map(|at_s| (at_s - lag_s).clamp(begin_s, end_s)));
        let known =
            spans.filter(|[from_s, to_s]| to_s - from_s >= MIN_OVERLAP * (rest_s[1] - rest_s[0]));
        let moved = known.map(|span_s| self.fk_motion_without_rest(joints, span_s));
        moved.reduce(|a, b| Some(a?.min(b?)))?
    }

    /// `None` if some rigid tool rests, or the joints move too little.
    fn fk_motion_without_rest(&self, joints: &JointTrack, span_s: [f64; 2]) -> Option<f64> {
        const MIN_TURN_RAD: f64 = 0.35;
        /// Longest tool considered.
        const MAX_LENGTH_M: f64 = 0.5;
        /// Minimum motion of a joint, as a share of its range: in a wrong unit, noise moves FK.
        const MIN_RANGE_SHARE: f64 = 0.1;
        let [from, to] = span_s.map(|at_s| joints.t_s.partition_point(|t_s| *t_s < at_s));
        let all = 0..joints.len();
        let moves = self.columns.iter().any(|&column| {
            let [own, all] = [from..to, all.clone()]
                .map(|rows| value_range(rows.map(|row| joints.row(row)[column])));
            own > MIN_RANGE_SHARE * all
        });
        if from >= to || !moves {
            return None;
        }
        let poses = self.fk_poses(joints, from..to);
        let start = poses.first()?;
        let has_rotations = matches!(self.track.orientation, Orientations::Rotations(_));
        let moved = poses.iter().filter_map(|pose| {
            let m = (pose.translation.vector - start.translation.vector).norm();
            let rad = angle_between(&start.rotation, &pose.rotation);
            let must_move = m > MIN_MOTION_M + MAX_LENGTH_M * rad;
            (must_move || (has_rotations && rad > MIN_TURN_RAD)).then_some(m)
        });
        moved.reduce(f64::max)
    }
}
