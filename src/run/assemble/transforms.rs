//! TF tree of a log, the arm's transforms, and transforms that are measured poses.

use crate::diagnosis::LastTurn;
use crate::geometry::{Pose, Vec3, pose, rotation_from_xyzw};
use crate::robot::{JointKind, Robot};
use crate::stream::{Columns, PoseColumns};
use crate::time::Stamp;

use super::super::arm::{Arm, TfUnavailable};
use super::super::model::FrameNames;
use super::super::namespace::{Namespace, NamespaceMatch};
use super::super::poses::{self, StampedTrack};
use super::super::role::{FrameKind, Role};
use super::super::source_kind::PoseSourceKind;
use super::super::sources::PoseSource;
use super::super::streams::Stream;
use super::super::targets;
use super::super::tf_tree::{Edge, EdgeKind, TfTree, strip_slash};
use super::super::timing::Timing;
use super::assembly::Assembly;

/// Builds the tree of the TF topics, without those of arms outside `namespace`.
pub(super) fn tf_tree(streams: &[Stream], timing: &Timing, namespace: &Namespace) -> TfTree {
    let mut tree = TfTree::default();
    for (index, stream) in streams.iter().enumerate() {
        let Some(Columns::Transforms(transforms)) = &stream.columns else { continue };
        if namespace.match_names([stream.topic.as_str()]) == NamespaceMatch::Foreign {
            continue;
        }
        for (piece, transform) in transforms.iter().enumerate() {
            let (parent, child) = (&transform.frame_id, &transform.child_frame_id);
            if stream.role == Role::TfStatic {
                let last = (0..transform.times.len()).rev().find_map(|row| pose_at(transform, row));
                if let (Some(last), None) = (last, tree.edge(parent, child)) {
                    tree.insert_fixed(parent, child, EdgeKind::Static, last);
                }
                continue;
            }
            let (stamps, poses) = samples_of(streams, timing, (index, piece), transform);
            tree.insert(parent, child, EdgeKind::Dynamic, stamps, poses);
        }
    }
    tree
}

/// Valid poses of one transform, strictly increasing in time.
fn samples_of(
    streams: &[Stream],
    timing: &Timing,
    (index, piece): (usize, usize),
    poses: &PoseColumns,
) -> (Vec<Stamp>, Vec<Pose>) {
    let rows = timing.filtered_rows(streams, index, piece, 0.0).into_iter();
    let mut samples: Vec<(Stamp, Pose)> =
        rows.filter_map(|(stamp, row)| Some((stamp, pose_at(poses, row)?))).collect();
    samples.sort_by_key(|(stamp, _)| *stamp);
    samples.dedup_by_key(|(stamp, _)| *stamp);
    samples.into_iter().unzip()
}

/// Adds odometry base poses that no transform provides.
pub(super) fn add_odometry(tree: &mut TfTree, streams: &[Stream], timing: &Timing, arms: &[Arm]) {
    for (index, stream) in streams.iter().enumerate() {
        let Some(Columns::Poses(poses)) = &stream.columns else { continue };
        let (frame, child) = (&stream.frame_id, &stream.child_frame_id);
        let is_odometry = stream.type_name.ends_with("Odometry") && !frame.is_empty();
        let ([poses], true) = (poses.as_slice(), is_odometry) else { continue };
        let is_base = |arm: &Arm| {
            let link = arm.frames.link_of(&arm.robot, child);
            link.is_some_and(|link| !arm.can_move(link))
                && arm.frames.link_of(&arm.robot, frame).is_none()
        };
        if arms.iter().any(is_base) && tree.find_path(frame, child, |_| true).is_none() {
            let (stamps, poses) = samples_of(streams, timing, (index, 0), poses);
            if stamps.len() > 1 {
                tree.insert(frame, child, EdgeKind::Dynamic, stamps, poses);
            }
        }
    }
}

fn pose_at(poses: &PoseColumns, row: usize) -> Option<Pose> {
    Some(pose(poses.xyz[row], rotation_from_xyzw(poses.q_xyzw[row])?))
}

/// Rms difference of logged transforms and link lengths, m. `None` with fewer than three rotary joints.
pub(super) fn misfit_m(tf: &TfTree, robot: &Robot, frames: &FrameNames) -> Option<f64> {
    const ENOUGH: usize = 3;
    let turning = robot
        .joints()
        .iter()
        .filter(|joint| matches!(joint.kind, JointKind::Revolute | JointKind::Continuous));
    let gaps: Vec<f64> = turning
        .filter_map(|joint| {
            let [parent, child] =
                [joint.parent, joint.child].map(|link| frames.frame_of(robot.link_name(link)));
            let logged: Vec3 = tf.edge(&parent, &child)?.first()?.translation.vector;
            Some((logged - joint.parent_from_joint.translation.vector).norm_squared())
        })
        .collect();
    (gaps.len() >= ENOUGH).then(|| (gaps.iter().sum::<f64>() / gaps.len() as f64).sqrt())
}

impl Assembly<'_> {
    pub(super) fn follow_transforms(
        &self,
        arm: &Arm,
    ) -> Result<(PoseSource, Vec<(String, String)>), TfUnavailable> {
        let first = self.streams.iter().position(|stream| {
            stream.role == Role::Tf
                && arm.match_names([stream.topic.as_str()]) != NamespaceMatch::Foreign
        });
        let first = first.ok_or(TfUnavailable::NoTransforms)?;
        let [base, tip] = [arm.base, arm.tip].map(|link| arm.frame_of(link));
        let crosses = |edge: &Edge| {
            let (parent, child) = arm.tree.names(edge);
            arm.joints_between(parent, child)
        };
        // A transform across several joints, or to a frame that is not a link, is a measured pose.
        let is_of_the_model = |edge: &Edge| {
            edge.kind != EdgeKind::Dynamic || crosses(edge).is_some_and(|joints| joints.len() < 2)
        };
        let path = arm.tree.path(&base, &tip, is_of_the_model)?;
        let crossed: Vec<String> =
            path.dynamic_edges().flat_map(|edge| crosses(edge).unwrap_or_default()).collect();
        let uncrossed: Vec<String> = arm
            .chain
            .joint_names()
            .iter()
            .filter(|joint| !crossed.contains(joint))
            .cloned()
            .collect();
        if !uncrossed.is_empty() {
            return Err(TfUnavailable::NotCovered { joints: uncrossed });
        }
        let mut stamps = path.stamps();
        poses::thin(&mut stamps);
        let samples = path.poses_at(&stamps);
        if samples.len() < 2 {
            return Err(TfUnavailable::NoSamples);
        }
        let from_model = path.edges().filter(|edge| edge.kind == EdgeKind::Model).map(|edge| {
            let (parent, child) = arm.tree.names(edge);
            (parent.to_owned(), child.to_owned())
        });
        let moving = path.dynamic_edges().next();
        let (stream, piece) =
            moving.and_then(|edge| self.piece_of(arm, edge)).unwrap_or((first, 0));
        let StampedTrack { track, stamps } = poses::from_samples(samples, self.origin);
        let (chain, columns) = (arm.chain.clone(), arm.columns.clone());
        let stamps_copied = poses::are_copied_stamps(&stamps, &arm.joint_stamps);
        let source = PoseSource {
            stream,
            chain,
            columns,
            track,
            reference_known: true,
            stamps_copied,
            stamp_error_s: self.stamp_error_s(arm, stream, piece, stamps_copied),
            tip_named: arm.tip_named,
            moving_base: None,
            last_turn: LastTurn::Unknown,
        };
        Ok((source, from_model.collect()))
    }

    /// The TF stream with an edge of the arm's tree, and its transform's index.
    fn piece_of(&self, arm: &Arm, edge: &Edge) -> Option<(usize, usize)> {
        let names = arm.tree.names(edge);
        let is_it = |poses: &PoseColumns| {
            (strip_slash(&poses.frame_id), strip_slash(&poses.child_frame_id)) == names
        };
        self.streams.iter().enumerate().find_map(|(index, stream)| {
            let Some(Columns::Transforms(transforms)) = &stream.columns else { return None };
            let is_own = stream.role == Role::Tf
                && arm.match_names([stream.topic.as_str()]) != NamespaceMatch::Foreign;
            Some((index, transforms.iter().filter(|_| is_own).position(is_it)?))
        })
    }

    /// Adds measured poses as separate streams: transforms across several joints, or to a child that
    /// neither is nor carries a link.
    pub(super) fn measured_transforms(&mut self) {
        for index in 0..self.streams.len() {
            // The new streams are copies without the columns.
            let columns = self.streams[index].columns.take();
            let stream = &self.streams[index];
            if let (Role::Tf, Some(Columns::Transforms(transforms))) = (stream.role, &columns) {
                let measured: Vec<usize> = (0..transforms.len())
                    .filter(|&piece| self.is_measured(&stream.topic, &transforms[piece]))
                    .collect();
                let alone = |&piece: &usize| Stream {
                    role: Role::Unassigned,
                    ..stream.with_single_pose(transforms[piece].clone())
                };
                let new: Vec<Stream> = measured.iter().map(alone).collect();
                for (piece, stream) in measured.into_iter().zip(new) {
                    self.timing.share(index, piece);
                    self.streams.push(stream);
                }
            }
            self.streams[index].columns = columns;
        }
    }

    fn is_measured(&self, topic: &str, transform: &PoseColumns) -> bool {
        let frame = strip_slash(&transform.frame_id);
        let child = strip_slash(&transform.child_frame_id);
        let is_own = |arm: &&Arm| arm.match_names([topic]) != NamespaceMatch::Foreign;
        let arms: Vec<&Arm> = self.arms.iter().filter(is_own).collect();
        let carries_none = || {
            let mut roots = arms.iter().map(|arm| (arm, arm.frame_of(arm.robot.root())));
            roots.all(|(arm, root)| child != root && !arm.tree.is_above(child, &root))
        };
        let is_link = |arm: &&Arm| arm.classify_frame(child).0 != FrameKind::Unknown;
        // Links of an arm that the log names otherwise. A frame that moves along a chain of frames may be a tracked
        // body, but only a joint turns it about a fixed point.
        let is_link_elsewhere = |arm: &&Arm| {
            let is_next = |edge: &Edge| {
                let (above, below) = arm.tree.names(edge);
                edge.kind == EdgeKind::Dynamic && (above == child || below == frame)
            };
            arm.tree.edges().iter().any(is_next) && turns_about_its_origin(transform)
        };
        if targets::is_detection(frame, child) && !arms.iter().any(is_link) {
            return true;
        }
        for arm in &arms {
            let places = (arm.classify_frame(frame).0, arm.classify_frame(child).0);
            return match (arm.joints_between(frame, child), places) {
                (Some(joints), _) => joints.len() > 1,
                (None, (FrameKind::Unknown, FrameKind::Unknown)) => continue,
                (None, (FrameKind::MovingLink, _)) => false,
                (None, (_, FrameKind::MovingLink)) => arm.is_moved_by_most_joints(child),
                (None, (_, place)) => {
                    place == FrameKind::Unknown && carries_none() && !arm.tree.has_child(child)
                }
            };
        }
        !arms.is_empty() && carries_none() && !arms.iter().any(is_link_elsewhere)
    }

    pub(super) fn assign_tf(&mut self, index: usize) {
        let follows = |arm: &Arm| arm.tf.as_ref().is_ok_and(|source| source.stream == index);
        let stream = &mut self.streams[index];
        stream.arm = self.arms.iter().position(follows);
        if let Some(arm) = stream.arm.map(|arm| &self.arms[arm]) {
            stream.reference = Some(arm.frame_of(arm.base));
            stream.link = Some(arm.frame_of(arm.tip));
            // Transforms of the model's joints come from the controller.
            stream.source_kind = Some(PoseSourceKind::Controller);
        } else if let Some(Err(reason)) = self.arms.first().map(|arm| &arm.tf) {
            stream.reason = format!("{}; {reason}", stream.reason);
        }
    }
}

/// Whether only the rotation changes, as across a revolute joint.
fn turns_about_its_origin(transform: &PoseColumns) -> bool {
    /// Of published numbers.
    const ROUNDING_M: f64 = 1e-6;
    let is_first = |xyz: &[f64; 3]| {
        let first = transform.xyz.first().unwrap_or(xyz);
        xyz.iter().zip(first).all(|(one, first)| (one - first).abs() < ROUNDING_M)
    };
    transform.xyz.iter().all(is_first)
}

pub(super) fn add_fixed_joints(tf: &mut TfTree, arm: &Arm) {
    for joint in arm.robot.joints().iter().filter(|joint| joint.kind == JointKind::Fixed) {
        let [parent, child] = [joint.parent, joint.child].map(|link| arm.frame_of(link));
        if !tf.has_parent(&child) {
            tf.insert_fixed(&parent, &child, EdgeKind::Model, joint.parent_from_joint);
        }
    }
}
