//! Compares pose streams with each other if no joint states predict them.
//!
//! One stream becomes the reference: a body that moves freely in the stream's frame, in the place of an arm. The
//! others are compared with it as with forward kinematics.

use std::sync::Arc;

use crate::diagnosis::best_lag_peak;
use crate::finding::Unit;
use crate::geometry::{Rotation, angle_between};
use crate::run::arm::Arm;
use crate::run::error::RunError;
use crate::run::poses::{self, StampedTrack};
use crate::run::role::{Role, array_role, is_detection_of_columns, may_be_poses, target_of_camera};
use crate::run::streams::Stream;
use crate::run::trajectory::{Trajectory, are_of_one_body, continuous_quaternions};
use crate::stats::{STD_DEV_PER_MEDIAN, median};
use crate::stream::{Columns, Orientations, PoseTrack, sample_noise};

use super::assembly::Assembly;

/// Converts rotations to lengths.
const LEVER_M: f64 = 0.3;

/// A body that moves less may be at rest: an arm's links tremble by tenths of a millimetre.
const MIN_MOTION_M: f64 = 1e-3;

/// A stream that may be the reference.
struct Candidate {
    stream: usize,
    logged: StampedTrack<PoseTrack>,
    errors: SampleErrors,
}

/// Standard deviations of a stream's samples.
#[derive(Clone, Copy)]
struct SampleErrors {
    m: f64,
    rad: f64,
    stamp_s: f64,
    /// Typical speed, m/s and rad/s.
    speed: [f64; 2],
}

impl SampleErrors {
    fn of(track: &PoseTrack, rotations: &[Rotation]) -> Self {
        let axis = |axis: usize| track.xyz.iter().map(|xyz| xyz[axis]).collect::<Vec<f64>>();
        let norm = |noise: &[f64]| noise.iter().map(|one| one * one).sum::<f64>().sqrt();
        let quaternions = continuous_quaternions(rotations);
        let component = |at: usize| quaternions.iter().map(|q| q[at]).collect::<Vec<f64>>();
        let mut periods: Vec<f64> = track.t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let period_s = median(&mut periods).unwrap_or(0.0);
        let mut jitters: Vec<f64> =
            periods.iter().map(|period| (period - period_s).abs()).collect();
        let jitter_s = median(&mut jitters).unwrap_or(0.0);
        let rms = |steps: Vec<f64>| norm(&steps) / (steps.len().max(1) as f64).sqrt();
        let per_s = |steps: Vec<f64>| rms(steps) / period_s.max(f64::MIN_POSITIVE);
        let steps = track.xyz.windows(2).map(|pair| (pair[1] - pair[0]).norm());
        let turns = rotations.windows(2).map(|pair| angle_between(&pair[0], &pair[1]));
        Self {
            m: norm(&[0, 1, 2].map(|at| sample_noise(&axis(at)))),
            // A rotation by a small angle changes the quaternion by half of it.
            rad: 2.0 * norm(&[0, 1, 2, 3].map(|at| sample_noise(&component(at)))),
            stamp_s: STD_DEV_PER_MEDIAN * jitter_s / 2f64.sqrt(),
            speed: [per_s(steps.collect()), per_s(turns.collect())],
        }
    }

    /// Position error of a sample, rotations and times included, m.
    fn total_m(&self) -> f64 {
        let by_clock = |speed: f64| speed * self.stamp_s;
        let turn_m = LEVER_M * self.rad.hypot(by_clock(self.speed[1]));
        self.m.hypot(by_clock(self.speed[0])).hypot(turn_m)
    }
}

impl Candidate {
    /// Whether a pose differs from the first by more than an arm at rest trembles.
    fn moves(&self) -> bool {
        let PoseTrack { xyz, orientation, .. } = &self.logged.track;
        let moved = xyz.iter().any(|own| (own - xyz[0]).norm() > MIN_MOTION_M);
        let Orientations::Rotations(all) = orientation else { return moved };
        moved || all.iter().any(|own| LEVER_M * angle_between(&all[0], own) > MIN_MOTION_M)
    }
}

impl Assembly<'_> {
    /// Makes a pose stream the reference of the others: the caller's, else the one with the smallest errors that
    /// another follows. Without a choice of the caller, of more than two streams those that do not follow are of other bodies,
    /// except if they are stated to be of the same body; see [`are_of_one_body`].
    ///
    /// # Errors
    /// If the caller's reference is not a stream of poses with rotations that change.
    pub(super) fn compare_trajectories(&mut self, no_arm: &RunError) -> Result<(), RunError> {
        let wanted = self.options.reference.as_deref();
        let compared = self.compared_streams();
        let mut candidates = self.reference_candidates(&compared);
        if let Some(topic) = wanted {
            candidates.retain(|candidate| is_topic(&self.streams[candidate.stream], topic));
            if candidates.is_empty() {
                return Err(self.unusable_reference(topic));
            }
        }
        let is_choice = wanted.is_none() && compared.len() > 2;
        candidates.retain(|candidate| !is_choice || candidate.moves());
        candidates.sort_by(|a, b| a.errors.total_m().total_cmp(&b.errors.total_m()));
        let arms = candidates.iter().map(|one| self.trajectory(one, &compared));
        let arms: Vec<Arm> = arms.filter(|arm| self.has_other_input(arm)).collect();
        // In a log of an arm, a pose stream may have nothing to do with the others.
        let is_without_joints = matches!(no_arm, RunError::NoJointStates { question: None, .. });
        let first = arms.first().filter(|_| is_without_joints && !is_choice).cloned();
        let followed = |mut arm: Arm| {
            let followers = self.followers(&arm);
            if followers.is_empty() {
                return None;
            }
            if is_choice {
                let Trajectory { stream, others, .. } = arm.trajectory.as_mut()?;
                others.retain(|other| {
                    followers.contains(other) || are_of_one_body(&self.streams, [*stream, *other])
                });
            }
            Some(arm)
        };
        if let Some(arm) = arms.into_iter().find_map(followed).or(first)
            && let Some(Trajectory { stream, why, .. }) = &arm.trajectory
        {
            let reference = &mut self.streams[*stream];
            (reference.role, reference.arm) = (Role::Pose, Some(self.arms.len()));
            reference.reason = why.clone();
            self.arms.push(arm);
        }
        Ok(())
    }

    /// Pose streams. Topics of commands and camera detections take part only if the caller names the reference.
    fn compared_streams(&self) -> Vec<usize> {
        let has_poses = |index: &usize| {
            let stream = &self.streams[*index];
            match &stream.columns {
                Some(Columns::Poses(_)) => true,
                Some(Columns::Array(array)) => {
                    array_role(&stream.topic, array.width, false).0 != Role::Ignored
                        && may_be_poses(array)
                }
                _ => false,
            }
        };
        // A tracked marker is not a camera's, unless its frame is a camera.
        let is_measured = |index: &usize| {
            let (role, _) = self.role_of(&self.streams[*index], None, false);
            !matches!(role, Role::Reference | Role::Target)
        };
        // Files have names for other reasons than topics.
        let is_other_topic = |index: &usize| {
            let stream = &self.streams[*index];
            let is_of_topic =
                || stream.topic.starts_with('/') || target_of_camera(&stream.topic).is_some();
            self.options.reference.is_none()
                && (is_detection_of_columns(stream) || (!is_measured(index) && is_of_topic()))
        };
        let all =
            (0..self.streams.len()).filter(|index| has_poses(index) && !is_other_topic(index));
        let all: Vec<usize> = all.collect();
        let measured: Vec<usize> = all.iter().copied().filter(is_measured).collect();
        if measured.len() > 1 { measured } else { all }
    }

    /// Streams of changing poses with rotations.
    fn reference_candidates(&self, compared: &[usize]) -> Vec<Candidate> {
        let candidate = |&stream: &usize| {
            let logged = self.logged_poses(stream)?;
            let Orientations::Rotations(rotations) = &logged.track.orientation else { return None };
            if logged.track.t_s.len() < 3 || !logged.track.changes() {
                return None;
            }
            let errors = SampleErrors::of(&logged.track, rotations);
            Some(Candidate { stream, logged, errors })
        };
        compared.iter().filter_map(candidate).collect()
    }

    fn logged_poses(&self, index: usize) -> Option<StampedTrack<PoseTrack>> {
        let stream = &self.streams[index];
        let rows = self.timing.filtered_rows(&self.streams, index, 0, self.options.max_latency_s);
        let known = self.known_encoding(stream);
        poses::from_columns(stream.columns.as_ref(), &rows, known.as_deref(), self.origin).ok()
    }

    fn unusable_reference(&self, topic: &str) -> RunError {
        let is_known = self.streams.iter().any(|stream| is_topic(stream, topic));
        let what = match is_known {
            true => format!("'{topic}' has no poses with rotations that change"),
            false => format!("the log has no topic '{topic}'"),
        };
        RunError::Declared {
            place: "--reference".to_owned(),
            what,
            remedy: "name a pose topic that `poseaudit info` lists",
        }
    }

    /// Body that moves like the stream.
    fn trajectory(&self, candidate: &Candidate, compared: &[usize]) -> Arm {
        let StampedTrack { track, stamps } = &candidate.logged;
        let own = &self.streams[candidate.stream];
        // The poses that one message lists are of several bodies.
        let is_listed_with = |other: &Stream| own.lists_poses() && own.topic == other.topic;
        let others = compared
            .iter()
            .copied()
            .filter(|&stream| stream != candidate.stream && !is_listed_with(&self.streams[stream]));
        let SampleErrors { m, rad, stamp_s, .. } = candidate.errors;
        let why = format!(
            "the reference of the other poses, as the log has no joint states for them; noise {} and {}, stamps {}",
            Unit::Metre.show(m),
            Unit::Radian.show(rad),
            Unit::Second.show(stamp_s)
        );
        let trajectory = Trajectory {
            stream: candidate.stream,
            track: track.clone(),
            others: others.collect(),
            why,
        };
        let arm = Arm::from_trajectory(own, trajectory);
        Arm { joint_stamps: stamps.clone().into(), tree: Arc::clone(&self.tf), ..arm }
    }

    /// Streams that move like the arm's body.
    fn followers(&self, arm: &Arm) -> Vec<usize> {
        let follows = |stream: &usize| {
            let frames = self.locate_frames(arm, &self.streams[*stream]);
            let source = self.pose_source(*stream, arm, &frames, None, (true, &mut Vec::new()));
            let peak = source.ok().and_then(|source| {
                best_lag_peak(&arm.joints, &source.as_stream(), self.options.max_latency_s)
            });
            peak.is_some_and(|peak| peak.correlation >= crate::run::MIN_PRESUMED_CORRELATION)
        };
        other_streams(arm).filter(follows).collect()
    }

    fn has_other_input(&self, arm: &Arm) -> bool {
        let is_imu = |stream: &Stream| matches!(stream.columns, Some(Columns::Imu(_)));
        other_streams(arm).next().is_some() || self.streams.iter().any(is_imu)
    }
}

fn is_topic(stream: &Stream, topic: &str) -> bool {
    stream.topic.trim_start_matches('/') == topic.trim_start_matches('/')
}

fn other_streams(arm: &Arm) -> impl Iterator<Item = usize> {
    arm.trajectory.iter().flat_map(|trajectory| trajectory.others.iter().copied())
}
