//! Camera targets, and hands that may carry camera or target.

use crate::stream::{Columns, Orientations, PoseTrack};

use super::super::poses;
use super::super::role::{Role, is_of_camera, may_have_role};
use super::super::streams::Stream;
use super::super::targets::{self, HandKind, HandSource, TargetSource};
use super::assembly::Assembly;

impl Assembly<'_> {
    /// Camera targets with their candidate hands. A target by name alone may also be on the tool.
    pub(super) fn targets(&self) -> Vec<TargetSource> {
        let is_target = |&index: &usize| may_have_role(&self.streams[index], Role::Target);
        (0..self.streams.len()).filter(is_target).filter_map(|index| self.target(index)).collect()
    }

    /// Clears the role of detections outside of `targets`, so that the report lists them.
    pub(super) fn clear_unused_targets(&mut self, targets: &[TargetSource]) {
        let streams = self.streams.iter_mut().enumerate();
        let is_unused = |(index, stream): &(usize, &mut Stream)| {
            stream.role == Role::Target && targets.iter().all(|target| target.stream != *index)
        };
        for (_, stream) in streams.filter(is_unused) {
            stream.role = Role::Unassigned;
            stream.reason += "; not compared: that needs orientations that change, and an arm";
        }
    }

    fn target(&self, index: usize) -> Option<TargetSource> {
        let stream = &self.streams[index];
        let camera = &stream.frame_id;
        let is_array = matches!(stream.columns, Some(Columns::Array(_)));
        // A marker may be on any body.
        if is_array && !is_of_camera(&stream.topic) && self.fitting_declaration(stream).is_none() {
            return None;
        }
        if self.is_transform(stream) && !targets::is_detection(camera, &stream.child_frame_id) {
            return None;
        }
        let hands = match self.likeliest_arm(stream) {
            Some(owner) => {
                let arm = &self.arms[owner];
                let (kind, [hand_from_camera, base_from_camera]) =
                    HandKind::from_arm(owner, arm, camera)?;
                let stamp_error_s = self.stamp_error_s(arm, index, 0, false);
                vec![HandSource { kind, hand_from_camera, base_from_camera, stamp_error_s }]
            }
            None => self.hands_without_arm(index),
        };
        // A detector's poses change; a frame published repeatedly does not.
        let has_rotations =
            |track: &PoseTrack| matches!(track.orientation, Orientations::Rotations(_));
        let track = self.plain_track(index).filter(has_rotations).filter(PoseTrack::changes)?;
        Some(TargetSource {
            stream: index,
            track,
            axes: targets::camera_axes(&self.tf, camera),
            hands,
        })
    }

    /// Of a stream with one pose per row, whose encoding is known.
    fn plain_track(&self, index: usize) -> Option<PoseTrack> {
        let stream = &self.streams[index];
        let known = self.known_encoding(stream);
        let is_array = matches!(stream.columns, Some(Columns::Array(_)));
        if is_array && known.is_none() {
            return None;
        }
        let mut rows = self.timing.clocks.rows(&self.streams, index, 0);
        self.timing.sample_filter.apply(index, 0, &mut rows);
        let columns = stream.columns.as_ref();
        let track = poses::from_columns(columns, &rows, known.as_deref(), self.origin).ok()?.track;
        (track.t_s.len() > 1).then_some(track)
    }

    /// Candidate hands without an arm: pose streams, and frames that transforms move.
    fn hands_without_arm(&self, target: usize) -> Vec<HandSource> {
        let camera = &self.streams[target].frame_id;
        let tied = |frame: &str| {
            let found = self.tf.nearest_fixed(camera, |other| !frame.is_empty() && other == frame);
            found.map(|(_, frame_from_camera)| frame_from_camera)
        };
        let may_be = |&index: &usize| {
            let stream = &self.streams[index];
            matches!(stream.role, Role::Unassigned | Role::Pose) && !self.is_transform(stream)
        };
        let streams = (0..self.streams.len()).filter(may_be).filter_map(|index| {
            let stream = &self.streams[index];
            Some(HandSource {
                kind: HandKind::Stream { stream: index, track: self.plain_track(index)? },
                hand_from_camera: tied(&stream.child_frame_id),
                base_from_camera: tied(&stream.frame_id),
                stamp_error_s: self.timing.clocks.alignment_error_s((index, 0), (target, 0)),
            })
        });
        let by_transforms = targets::hand_frame(&self.tf, camera).and_then(|(base, hand)| {
            let path = self.tf.find_path(&base, &hand, |_| true)?;
            let track = poses::from_samples(path.poses_at(&path.stamps()), self.origin).track;
            let (hand_from_camera, base_from_camera) = (tied(&hand), tied(&base));
            let kind = HandKind::Transforms { base, frame: hand, track };
            Some(HandSource { kind, hand_from_camera, base_from_camera, stamp_error_s: 0.0 })
        });
        streams.chain(by_transforms).collect()
    }
}
