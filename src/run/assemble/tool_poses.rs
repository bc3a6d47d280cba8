//! Assigns pose and IMU streams to arms and determines their links.

use std::borrow::Cow;

use crate::diagnosis::{FitHypotheses, LastTurn, MovingFrame, fit_model, follows_as_logged};
use crate::geometry::{Pose, Units};
use crate::robot::LinkId;
use crate::stream::Columns;
use crate::time::Stamp;

use super::super::arm::{Arm, FrameAnchor};
use super::super::declaration::Declaration;
use super::super::error::RunError;
use super::super::frozen::{FrozenSpan, remove_frozen};
use super::super::namespace::NamespaceMatch;
use super::super::not_audited::{NotAudited, NotAuditedReason};
use super::super::poses::{self, StampedTrack};
use super::super::role::{
    FrameKind, PoseTopic, Role, RoleDecision, array_role, is_detection_of_columns, is_driver_frame,
    may_be_poses, pose_role, role_outside_arm,
};
use super::super::shared_stream::{CandidateArm, SharedStream};
use super::super::source_kind::{PoseNames, PoseSourceKind, classify_source};
use super::super::sources::{ImuSource, MovingBase, PoseSource};
use super::super::streams::Stream;
use super::super::tf_tree::{Edge, EdgeKind};
use super::super::topics::{RoleSetting, TopicSettings};
use super::assembly::Assembly;
use super::declaration_error;

pub(super) struct StreamFrames {
    pub frame: FrameKind,
    pub child: FrameKind,
    pub base: FrameAnchor,
    pub tip: FrameAnchor,
    pub tip_named: bool,
    pub moving_frame: Option<Vec<(Stamp, Pose)>>,
    pub remarks: String,
}

struct ArmPoseSource {
    candidate: CandidateArm,
    source: PoseSource,
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    const ROUNDING: f64 = 1e-6;
    let distance_m = (a.translation.vector - b.translation.vector).norm();
    distance_m < ROUNDING && a.rotation.angle_to(&b.rotation) < ROUNDING
}

#[derive(Debug, thiserror::Error)]
pub(super) enum SourceError {
    /// No known chain predicts it.
    #[error("{0}")]
    Kinematics(String),
    /// It has no usable samples.
    #[error("{0}")]
    Samples(String),
}

impl From<String> for SourceError {
    fn from(what: String) -> Self {
        Self::Samples(what)
    }
}

/// Reference of a tracker that names no frame.
const UNNAMED_FRAME: &str = "unnamed frame";

impl Assembly<'_> {
    /// Declaration of the stream, if its numbers match.
    pub(super) fn fitting_declaration(&self, stream: &Stream) -> Option<&Declaration> {
        let declared = self.options.declared.iter().find(|one| one.is_of(&stream.topic));
        declared.filter(|declared| declared.fits(stream.columns.as_ref()))
    }

    /// Its declaration, else the encoding and the units that its matrices, its driver or the names of its columns state.
    pub(super) fn known_encoding(&self, stream: &Stream) -> Option<Cow<'_, Declaration>> {
        if let Some(declared) = self.fitting_declaration(stream) {
            return Some(Cow::Borrowed(declared));
        }
        let Units { length, angle } = stream.named_units;
        Some(Cow::Owned(Declaration {
            topic: stream.topic.clone(),
            place: "names of columns".to_owned(),
            coding: stream.stated_encoding()?,
            length: length.unwrap_or_default(),
            angle: angle.unwrap_or_default(),
            is_of_vendor: false,
        }))
    }

    pub(super) fn assign_pose(&mut self, index: usize) -> Result<(), RunError> {
        let stream = &self.streams[index];
        let declared = self.options.declared.iter().find(|one| one.is_of(&stream.topic));
        let unfit = declared.filter(|declared| !declared.fits(stream.columns.as_ref()));
        let declared = declared.filter(|_| unfit.is_none());
        let candidate_arms = self.candidate_arms(stream);
        let owner = candidate_arms.first().copied();
        let stream_frames = owner.map(|arm| self.locate_frames(&self.arms[arm], stream));
        let settings = self.topic_settings(stream);
        let (mut role, mut reason) =
            self.role_of(stream, stream_frames.as_ref(), declared.is_some());
        let trajectory = owner.and_then(|arm| self.arms[arm].trajectory.as_ref());
        if trajectory.is_some_and(|trajectory| trajectory.others.contains(&index))
            && settings.is_none_or(|settings| settings.role.is_none())
        {
            role = Role::Candidate { presumed: true };
            reason = format!("compared with '{}'", self.arms[owner.unwrap_or(0)].name);
        }
        if let Some(vendor) = settings.and_then(|settings| settings.vendor.as_ref()) {
            reason += &format!("; {vendor}");
        }
        if unfit.is_some() {
            reason += ", but its numbers do not match the declaration, which is ignored";
        }
        let is_wanted = matches!(role, Role::Pose | Role::Candidate { .. });
        let mut source = None;
        let mut unaudited = None;
        if let (true, Some(arm), Some(stream_frames)) = (is_wanted, owner, &stream_frames) {
            let mut frozen = Vec::new();
            let known = role == Role::Pose;
            match self.pose_source(
                index,
                &self.arms[arm],
                stream_frames,
                declared,
                (known, &mut frozen),
            ) {
                Ok(found) => {
                    reason += &stream_frames.remarks;
                    let frame = match stream.frame_id.as_str() {
                        "" => FrameKind::Unnamed,
                        _ => stream_frames.frame,
                    };
                    let is_of_joints = found.stamps_copied && trajectory.is_none();
                    let source_kind = self.source_kind(stream, frame, is_of_joints);
                    source = Some((self.arm_pose_source(arm, stream_frames, found), source_kind));
                }
                Err(what)
                    if let Some(declared) = declared
                        && frozen.is_empty() =>
                {
                    return Err(declaration_error(declared, what.to_string()));
                }
                Err(why) => {
                    // Poses between links without relative motion cannot be audited.
                    let is_asked = known && stream_frames.frame != FrameKind::MovingLink;
                    if let (true, SourceError::Kinematics(what)) = (is_asked, &why) {
                        unaudited = Some(NotAuditedReason::NoKinematics { what: what.clone() });
                    }
                    (role, reason) = (role_outside_arm(&stream.topic), why.to_string());
                }
            }
            self.searched_for_frozen.push(index);
            self.frozen.extend(frozen);
        } else if matches!(role, Role::Candidate { .. }) {
            role = role_outside_arm(&stream.topic);
            reason += ", and there is no arm for it to follow";
        }
        let is_named = candidate_arms.len() == 1;
        let other_sources: Vec<ArmPoseSource> = match &source {
            Some((own, _)) if is_named => self.sources_besides(own),
            Some(_) => candidate_arms[1..]
                .iter()
                .filter_map(|&arm| self.pose_source_of_other_arm(index, arm, None))
                .collect(),
            None => Vec::new(),
        };
        let is_own_frame = stream_frames
            .as_ref()
            .is_some_and(|stream_frames| stream_frames.frame == FrameKind::Tool);
        if source.is_some() && is_own_frame {
            unaudited = Some(NotAuditedReason::OwnFrame { frame: stream.frame_id.clone() });
        }
        let why = |why| NotAudited { stream: index, reason: why };
        self.not_audited.extend(unaudited.map(why));
        let stream = &mut self.streams[index];
        (stream.role, stream.reason) = (role, reason);
        if let Some((own, (source_kind, why))) = source {
            stream.reason += &format!("; source: {}, by {why}", source_kind.name());
            stream.source_kind = Some(source_kind);
            own.candidate.assign(stream);
            let sources: Vec<ArmPoseSource> = std::iter::once(own).chain(other_sources).collect();
            if sources.len() > 1 {
                let candidates = sources.iter().map(|own| own.candidate.clone()).collect();
                self.shared_streams.push(SharedStream { stream: index, candidates, is_named });
            }
            for ArmPoseSource { candidate, source } in sources {
                self.arms[candidate.arm].poses.push(source);
            }
        }
        Ok(())
    }

    /// Sources of the other arms, if the poses do not follow the arm that names and frames identify. If the
    /// frame has the wrong arm's name, too, the poses are in the other arm's frame that is nearest to FK.
    fn sources_besides(&self, own: &ArmPoseSource) -> Vec<ArmPoseSource> {
        let (index, named) = (own.source.stream, &self.arms[own.candidate.arm]);
        let follows = || follows_as_logged(&named.joints, &own.source.as_stream()) == Some(true);
        if self.arms.len() < 2 || follows() {
            return Vec::new();
        }
        let is_frame_of = |arm: &Arm, frame: &str| arm.match_names([frame]) == NamespaceMatch::Own;
        let is_of_named = is_frame_of(named, &self.streams[index].frame_id);
        let source_of = |arm: usize| {
            let of = &self.arms[arm];
            let distance_m = |one: &ArmPoseSource| {
                let stream = one.source.as_stream();
                let max_lag_s = self.options.max_latency_s;
                let fit = fit_model(&of.joints, &stream, max_lag_s, FitHypotheses::Faultless);
                fit.map_or(f64::INFINITY, |fit| fit.as_is_m)
            };
            let links = of.robot.links().filter(|&link| {
                is_of_named && !of.can_move(link) && is_frame_of(of, &of.frame_of(link))
            });
            let as_logged = self.pose_source_of_other_arm(index, arm, None);
            let renamed =
                links.filter_map(|base| self.pose_source_of_other_arm(index, arm, Some(base)));
            let all = as_logged.into_iter().chain(renamed);
            all.min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))
        };
        let others = (0..self.arms.len()).filter(|&arm| arm != own.candidate.arm);
        others.filter_map(source_of).collect()
    }

    /// `base` replaces the stream's frame.
    fn pose_source_of_other_arm(
        &self,
        index: usize,
        arm: usize,
        base: Option<LinkId>,
    ) -> Option<ArmPoseSource> {
        let stream = &self.streams[index];
        let mut stream_frames = self.locate_frames(&self.arms[arm], stream);
        if let Some(link) = base {
            stream_frames.base = FrameAnchor { link, link_from_frame: Pose::identity() };
            stream_frames.frame = FrameKind::StillLink;
        }
        let is_wanted = matches!(
            self.role_of(stream, Some(&stream_frames), false).0,
            Role::Pose | Role::Candidate { .. }
        );
        let found =
            self.pose_source(index, &self.arms[arm], &stream_frames, None, (true, &mut Vec::new()));
        found
            .ok()
            .filter(|_| is_wanted)
            .map(|source| self.arm_pose_source(arm, &stream_frames, source))
    }

    fn arm_pose_source(
        &self,
        arm: usize,
        stream_frames: &StreamFrames,
        source: PoseSource,
    ) -> ArmPoseSource {
        let of = &self.arms[arm];
        let reference = match source.reference_known {
            true => of.frame_of(stream_frames.base.link),
            false => match self.streams[source.stream].frame_id.as_str() {
                "" => UNNAMED_FRAME.to_owned(),
                frame_id => frame_id.to_owned(),
            },
        };
        ArmPoseSource {
            candidate: CandidateArm { arm, reference, link: of.frame_of(stream_frames.tip.link) },
            source,
        }
    }

    /// Source as configured, else by the stream's names, with the reason.
    fn source_kind(
        &self,
        stream: &Stream,
        frame: FrameKind,
        stamps_copied: bool,
    ) -> (PoseSourceKind, String) {
        let settings = self.topic_settings(stream);
        let set =
            settings.and_then(|settings| Some((settings.source_kind?, settings.place.clone())));
        set.unwrap_or_else(|| {
            classify_source(&PoseNames {
                topic: &stream.topic,
                type_name: &stream.type_name,
                frame_id: &stream.frame_id,
                child_frame_id: &stream.child_frame_id,
                frame,
                stamps_copied,
            })
        })
    }

    fn topic_settings(&self, stream: &Stream) -> Option<&TopicSettings> {
        self.options.topics.iter().find(|settings| settings.is_of(&stream.topic))
    }

    pub(super) fn role_of(
        &self,
        stream: &Stream,
        stream_frames: Option<&StreamFrames>,
        is_declared: bool,
    ) -> RoleDecision {
        let setting = self
            .topic_settings(stream)
            .filter(|settings| !(settings.of_columns && is_detection_of_columns(stream)))
            .and_then(|settings| Some((settings.role?, &settings.place)));
        if let Some((role, place)) = setting
            && !self.is_transform(stream)
        {
            let set_reason = format!("its role is set ({place})");
            match (&stream.columns, role) {
                (Some(Columns::Array(array)), RoleSetting::Pose) => {
                    let (role, reason) = array_role(&stream.topic, array.width, true);
                    let is_pose = role == Role::Pose;
                    return if is_pose { (role, set_reason) } else { (role, reason) };
                }
                (_, role) => return (role.role(), set_reason),
            }
        }
        if let Some(Columns::Array(array)) = &stream.columns {
            let is_declared = is_declared && !is_detection_of_columns(stream);
            let role = array_role(&stream.topic, array.width, is_declared);
            return match role {
                (Role::Candidate { presumed: false }, _) if !may_be_poses(array) => (
                    Role::Ignored,
                    "7 numbers per row are not a pose: the last four are not a quaternion"
                        .to_owned(),
                ),
                role => role,
            };
        }
        let place =
            |frame: &str| if frame.is_empty() { FrameKind::Unnamed } else { FrameKind::Unknown };
        let verdict = pose_role(&PoseTopic {
            topic: &stream.topic,
            frame_id: &stream.frame_id,
            child_frame_id: &stream.child_frame_id,
            frame: stream_frames
                .map_or(place(&stream.frame_id), |stream_frames| stream_frames.frame),
            child: stream_frames
                .map_or(place(&stream.child_frame_id), |stream_frames| stream_frames.child),
            is_declared,
        });
        match verdict {
            (Role::Candidate { .. }, _)
                if self.is_transform(stream) && is_driver_frame(&stream.child_frame_id) =>
            {
                let reason = "the frame that UR drivers use for the tool pose".to_owned();
                (Role::Candidate { presumed: true }, reason)
            }
            // Many transforms start at the base, so this frame alone does not make a tool pose.
            (Role::Candidate { .. }, _) if self.is_transform(stream) => (
                Role::Candidate { presumed: false },
                format!("'{}' is not a link of the robot", stream.child_frame_id),
            ),
            // Points in the base are usually seen or clicked.
            (Role::Candidate { .. }, _) if stream.is_of_points() => {
                let reason = "a point, which may be on the tool".to_owned();
                (Role::Candidate { presumed: false }, reason)
            }
            verdict => verdict,
        }
    }

    pub(super) fn is_transform(&self, stream: &Stream) -> bool {
        self.tf_topics.contains(&stream.topic)
    }

    /// Candidate arms. Applies each criterion if a candidate remains: the arm moves the child frame, the
    /// topic name matches, the arm has the frame, the frame names match. Motion decides between several.
    fn candidate_arms(&self, stream: &Stream) -> Vec<usize> {
        let place = |arm: &Arm, frame: &str| arm.classify_frame(frame).0;
        let frames = [stream.frame_id.as_str(), stream.child_frame_id.as_str()];
        let of_topic = |arm: &Arm| arm.match_names([stream.topic.as_str()]);
        let of_frames = |arm: &Arm| arm.match_names(frames);
        let is_known =
            |arm: &Arm| !matches!(place(arm, frames[0]), FrameKind::Unknown | FrameKind::Unnamed);
        let tests: [&dyn Fn(&Arm) -> bool; 6] = [
            &|arm| place(arm, frames[1]) == FrameKind::MovingLink,
            &|arm| of_topic(arm) == NamespaceMatch::Own,
            &|arm| of_topic(arm) != NamespaceMatch::Foreign,
            &is_known,
            &|arm| of_frames(arm) == NamespaceMatch::Own,
            &|arm| of_frames(arm) != NamespaceMatch::Foreign,
        ];
        tests.iter().fold((0..self.arms.len()).collect(), |remaining: Vec<usize>, fits| {
            let fitting: Vec<usize> =
                remaining.iter().copied().filter(|&arm| fits(&self.arms[arm])).collect();
            if fitting.is_empty() { remaining } else { fitting }
        })
    }

    pub(super) fn likeliest_arm(&self, stream: &Stream) -> Option<usize> {
        self.candidate_arms(stream).first().copied()
    }

    pub(super) fn locate_frames(&self, arm: &Arm, stream: &Stream) -> StreamFrames {
        let (mut frame, mut frame_anchor) = arm.classify_frame(&stream.frame_id);
        let (child, child_anchor) = arm.classify_frame(&stream.child_frame_id);
        let link_anchor = |link: LinkId| FrameAnchor { link, link_from_frame: Pose::identity() };
        // The caller's tip overrides a child frame, except in a transform, or if the log ties the child frame to this tip.
        let is_on_tip = child_anchor.is_some_and(|anchor| anchor.link == arm.tip);
        let names_tip = child == FrameKind::MovingLink
            && (!arm.tip_named || is_on_tip || self.is_transform(stream));
        let child_tip = child_anchor.filter(|_| names_tip);
        let tip = child_tip.unwrap_or(link_anchor(arm.tip));
        let is_reached = |base: FrameAnchor| arm.chain_between(base.link, tip.link).is_some();
        let mut moving_base = None;
        if frame == FrameKind::Unknown || frame_anchor.is_some_and(|base| !is_reached(base)) {
            moving_base = self.moving_frame(arm, &stream.frame_id);
        }
        let first_pose =
            moving_base.as_ref().and_then(|samples| samples.first()).map(|(_, first)| *first);
        let constant_pose = first_pose
            .filter(|first| moving_base.iter().flatten().all(|(_, pose)| is_same(first, pose)));
        if let Some(base_from_frame) = constant_pose {
            // Dynamic transforms that never change act as static ones.
            let anchor = FrameAnchor { link: arm.base, link_from_frame: base_from_frame };
            (frame, frame_anchor, moving_base) = (FrameKind::StaticallyTied, Some(anchor), None);
        } else if moving_base.is_some() {
            (frame, frame_anchor) = (FrameKind::DynamicallyTied, None);
        } else if frame == FrameKind::MovingLink
            && child != FrameKind::MovingLink
            && frame_anchor
                .is_some_and(|base| arm.robot.fixed_transform(base.link, tip.link).is_some())
        {
            (frame, frame_anchor) = (FrameKind::Tool, None);
        } else if frame == FrameKind::MovingLink
            && frame_anchor.is_some_and(|base| arm.has_most_joints_between(base.link, tip.link))
        {
            frame = FrameKind::Upstream;
        }
        // A tracker without a named frame has its own world frame.
        if frame == FrameKind::Unnamed
            && (arm.trajectory.is_some()
                || self.source_kind(stream, frame, false).0 == PoseSourceKind::External)
        {
            frame = FrameKind::Unknown;
        }
        let base = match frame {
            FrameKind::Unnamed => link_anchor(arm.unnamed_base),
            _ => frame_anchor.unwrap_or(link_anchor(arm.base)),
        };
        let mut remarks = String::new();
        let sides = [(&stream.frame_id, frame_anchor), (&stream.child_frame_id, child_tip)];
        for (frame, anchor) in sides {
            let Some(anchor) = anchor else { continue };
            let link = arm.frame_of(anchor.link);
            if link != *frame {
                let how = if constant_pose.is_some() {
                    "transforms that never change"
                } else {
                    "static transforms"
                };
                remarks += &format!("; '{frame}' is tied to '{link}' by {how}");
            }
        }
        if child == FrameKind::MovingLink
            && child_anchor.is_some_and(|anchor| anchor.link != tip.link)
        {
            remarks += &format!("; audited as '{}', as set by the caller", arm.chain.tip_name());
        }
        let tip_named = arm.tip_named || child == FrameKind::MovingLink;
        StreamFrames { frame, child, base, tip, tip_named, moving_frame: moving_base, remarks }
    }

    pub(super) fn pose_source(
        &self,
        index: usize,
        arm: &Arm,
        stream_frames: &StreamFrames,
        declared: Option<&Declaration>,
        (known, frozen): (bool, &mut Vec<FrozenSpan>),
    ) -> Result<PoseSource, SourceError> {
        let (chain, columns) = arm
            .chain_between(stream_frames.base.link, stream_frames.tip.link)
            .ok_or_else(|| {
            let [base, tip] =
                [stream_frames.base.link, stream_frames.tip.link].map(|link| arm.frame_of(link));
            SourceError::Kinematics(format!(
                "no joint in the joint states moves '{tip}' relative to '{base}'"
            ))
        })?;
        let mut rows = self.timing.filtered_rows(&self.streams, index, 0, 0.0);
        poses::thin(&mut rows);
        let columns_of_stream = self.streams[index].columns.as_ref();
        let mut logged = poses::from_columns(columns_of_stream, &rows, declared, self.origin)?;
        if stream_frames.frame == FrameKind::Tool && !logged.track.changes() {
            return Err("it never changes, like a tool offset in its own frame".to_owned().into());
        }
        let how = (known, self.options.max_latency_s);
        *frozen = remove_frozen(index, &mut logged, &arm.joints, &columns, how);
        if frozen.iter().any(|frozen| frozen.is_whole_stream) {
            return Err("it repeats one value while the arm moves".to_owned().into());
        }
        let StampedTrack { mut track, stamps } = logged;
        if track.t_s.len() < 2 {
            return Err("it has fewer than two usable samples".to_owned().into());
        }
        let (before, after) =
            (stream_frames.base.link_from_frame, stream_frames.tip.link_from_frame.inverse());
        track.transform(&before, &after);
        let seconds = |stamp: &Stamp| stamp.seconds_since(self.origin);
        let moving_base = stream_frames.moving_frame.as_ref().map(|samples| MovingBase {
            frame: self.streams[index].frame_id.clone(),
            motion: MovingFrame {
                t_s: samples.iter().map(|(stamp, _)| seconds(stamp)).collect(),
                base_from_frame: samples.iter().map(|(_, pose)| *pose).collect(),
                lag_s: 0.0,
            },
            latency_s: None,
            logged: track.clone(),
        });
        let track = moving_base.as_ref().map_or(track, |base| base.motion.in_base(&base.logged));
        if track.t_s.len() < 2 {
            let what = "the transforms of its frame do not cover its time range".to_owned();
            return Err(SourceError::Kinematics(what));
        }
        let stamps_copied = poses::are_copied_stamps(&stamps, &arm.joint_stamps);
        Ok(PoseSource {
            stream: index,
            chain,
            columns,
            track,
            moving_base,
            reference_known: !matches!(stream_frames.frame, FrameKind::Unknown | FrameKind::Tool),
            stamps_copied,
            stamp_error_s: self.stamp_error_s(arm, index, 0, stamps_copied),
            tip_named: stream_frames.tip_named,
            last_turn: LastTurn::Unknown,
        })
    }

    /// Poses of a moving frame in the base, from transforms without known joints, at least one dynamic.
    fn moving_frame(&self, arm: &Arm, frame: &str) -> Option<Vec<(Stamp, Pose)>> {
        let is_free = |edge: &Edge| {
            let (parent, child) = arm.tree.names(edge);
            edge.kind != EdgeKind::Dynamic || !arm.has_logged_joint_between(parent, child)
        };
        let path = arm.tree.find_path(&arm.frame_of(arm.base), frame, is_free)?;
        let mut stamps = path.stamps();
        poses::thin(&mut stamps);
        let samples = path.poses_at(&stamps);
        (samples.len() > 1).then_some(samples)
    }

    /// Root frame in which the base rotates, by transforms without known joints.
    fn rotating_root<'t>(&self, arm: &'t Arm) -> Option<&'t str> {
        const MAX_REST_RAD: f64 = 0.02;
        let root = arm.tree.root_of(&arm.frame_of(arm.base));
        let samples = self.moving_frame(arm, root)?;
        let first = samples.first()?.1.rotation;
        let turns = samples.iter().any(|(_, pose)| pose.rotation.angle_to(&first) > MAX_REST_RAD);
        turns.then_some(root)
    }

    pub(super) fn assign_imu(&mut self, index: usize) {
        let stream = &self.streams[index];
        let Some(Columns::Imu(imu)) = &stream.columns else { return };
        let Some(owner) = self.likeliest_arm(stream) else { return };
        let arm = &self.arms[owner];
        let (place, anchor) = arm.classify_frame(&stream.frame_id);
        let (moving_base, link_from_imu, why) = match (place, anchor) {
            (FrameKind::MovingLink, Some(anchor)) => {
                (anchor.link, Some(anchor.link_from_frame), "the arm moves its frame")
            }
            _ => (arm.tip, None, "its frame does not show where it is mounted; assumed at the tip"),
        };
        let carried = || {
            let root = self.rotating_root(arm)?;
            Some(format!("the arm's base rotates in '{root}' and carries it"))
        };
        let refusal = match (place, arm.unlogged_joint_above(moving_base)) {
            (FrameKind::StillLink | FrameKind::StaticallyTied, _) => {
                Some(format!("the arm does not move its frame '{}'", stream.frame_id))
            }
            (_, Some(joint)) => {
                Some(format!("'{joint}', which moves it, is not in the joint states"))
            }
            (_, None) => carried(),
        };
        if let Some(reason) = refusal {
            self.streams[index].reason = format!("inertial measurements; {reason}");
            return;
        }
        // A waist does not move gravity and the world frame.
        let base = arm.outermost_base(moving_base);
        let Some((chain, columns)) = arm.chain_between(base, moving_base) else { return };
        let rows = self.timing.filtered_rows(&self.streams, index, 0, 0.0);
        let StampedTrack { track, stamps } = poses::from_imu(imu, &rows, self.origin);
        let stamps_copied = poses::are_copied_stamps(&stamps, &arm.joint_stamps);
        let source = ImuSource {
            stream: index,
            chain,
            columns,
            track,
            link_from_imu,
            stamps_copied,
            stamp_error_s: self.stamp_error_s(arm, index, 0, stamps_copied),
        };
        let reason = format!("inertial measurements; {why}");
        let [reference, link] = [base, moving_base].map(|link| arm.frame_of(link));
        let stream = &mut self.streams[index];
        (stream.arm, stream.reason) = (Some(owner), reason);
        stream.source_kind = Some(PoseSourceKind::External);
        (stream.reference, stream.link) = (Some(reference), Some(link));
        if source.track.t_s.len() > 1 {
            self.arms[owner].imus.push(source);
        }
    }
}
