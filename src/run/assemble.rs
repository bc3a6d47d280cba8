//! From a decoded log to a run.

mod contest;
mod references;

use std::collections::BTreeSet;

use crate::geometry::{Pose, Vec3, pose, rotation_from_xyzw};
use crate::log::Log;
use crate::robot::{Chain, JointKind, LinkId, Robot};
use crate::stream::{Columns, PoseColumns, PoseTrack};
use crate::time::Stamp;

use super::arm::{Anchor, Arm, Ends, ImuSource, NoTf, PoseSource};
use super::cadence::rhythms;
use super::catalogued::Judges;
use super::declaration::Declaration;
use super::error::RunError;
use super::excerpts::Excerpts;
use super::flaws::flaws;
use super::frozen::{Frozen, take_frozen};
use super::joints::JointTopic;
use super::models::{self, Clues, FrameNames, Given, GivenCalibration};
use super::norms::norms;
use super::poses::{self, Stamped};
use super::role::{Place, PoseTopic, Role, Verdict, array_role, pose_role};
use super::skeleton;
use super::strays::{hide, strays};
use super::streams::{Stream, Timing, split};
use super::targets::{self, HandKind, HandSource, TargetSource};
use super::tf_tree::{Edge, EdgeKind, TfTree, without_slash};
use super::topics::{self, SaidRole, TopicSettings};
use super::witness::{PoseNames, Witness, witness_of};
use super::{Run, RunOptions};

pub use references::{ReferenceContent, ReferenceSource};

impl Run {
    /// Assembles the run that `log` recorded.
    ///
    /// # Errors
    /// Where the caller's options cannot be followed: a robot that cannot be read, a base or tip that
    /// is no link, a declared topic that is not there. What the log itself lacks is
    /// [`Run::no_arm`].
    pub fn assemble(log: Log, options: &RunOptions) -> Result<Run, RunError> {
        let given = models::given(&options.robots)?;
        let calibrations = models::given_calibrations(&options.calibrations)?;
        let has_clock_topic = log.has_clock();
        let mut streams = split(log.topics);
        for declared in &options.declared {
            // What a config expects and the log does not have is a finding.
            let by_config = options.topics.iter().any(|said| said.is_of(&declared.topic));
            let has_columns =
                |stream: &Stream| is_topic(stream, &declared.topic) && stream.columns.is_some();
            if !by_config || streams.iter().any(has_columns) {
                check_topic(declared, &streams)?;
            }
        }
        topics::apply(&options.topics, &mut streams)?;
        let mut timing = Timing::settle(&streams, options.stamp, options.max_latency_s);
        timing.measure(&mut streams);
        timing.strays = strays(&streams, &timing);
        timing.excerpts = Excerpts::of(&streams, &timing);
        let origin = origin(&streams);
        let tf = tf_tree(&streams, &timing);
        let (attached, logged_calibrations): (Vec<_>, Vec<_>) =
            log.descriptions.into_iter().partition(|found| found.text.starts_with('<'));
        let descriptions = descriptions(&streams, attached);
        let logged_calibrations: Vec<_> =
            logged_calibrations.into_iter().map(|found| (found.name, found.text)).collect();
        let mut assembly = Assembly {
            options,
            streams,
            timing,
            origin,
            tf,
            arms: Vec::new(),
            frozen: Vec::new(),
            watched: Vec::new(),
        };
        let said = Said {
            given,
            calibrations,
            descriptions: &descriptions,
            logged_calibrations: &logged_calibrations,
        };
        let no_arm = match assembly.find_arms(said) {
            Ok(()) => None,
            Err(error) if error.is_of_the_call() => return Err(error),
            Err(error) => Some(error),
        };
        let Assembly { streams, arms, tf, .. } = &assembly;
        topics::check_frames(&options.topics, streams, arms, tf)?;
        assembly.measured_transforms();
        for stream in 0..assembly.streams.len() {
            assembly.assign(stream)?;
        }
        assembly.name_joints();
        let (targets, references) = (assembly.targets(), assembly.references());
        let Assembly { streams, timing, tf, arms, frozen, watched, .. } = assembly;
        let span = span(streams.iter().filter(|stream| stream.rate_hz.is_some()));
        let rhythms = rhythms(&streams, &timing, &joint_topics(&streams, &timing), &arms);
        let (flaws, norms) = (flaws(&streams), norms(&streams, &timing));
        let Timing { clocks, excerpts, strays, .. } = timing;
        Ok(Run {
            origin,
            span,
            streams,
            arms,
            targets,
            references,
            tf,
            clocks,
            rhythms,
            flaws,
            norms,
            strays,
            frozen,
            watched,
            excerpts,
            has_clock_topic,
            no_arm,
        })
    }
}

/// What the caller and the log say of the robots.
struct Said<'a> {
    given: Vec<Given>,
    calibrations: Vec<GivenCalibration>,
    /// Text of each description and calibration in the log, after the name of where it was.
    descriptions: &'a [(String, String)],
    logged_calibrations: &'a [(String, String)],
}

/// A run in the making.
struct Assembly<'a> {
    options: &'a RunOptions,
    streams: Vec<Stream>,
    timing: Timing,
    origin: Stamp,
    tf: TfTree,
    arms: Vec<Arm>,
    frozen: Vec<Frozen>,
    /// The streams that were looked at for that.
    watched: Vec<usize>,
}

fn check_topic(declared: &Declaration, streams: &[Stream]) -> Result<(), RunError> {
    let is_pose =
        |stream: &&Stream| matches!(stream.columns, Some(Columns::Poses(_) | Columns::Array(_)));
    let of_topic = || streams.iter().filter(|stream| is_topic(stream, &declared.topic));
    let what = match (of_topic().count(), of_topic().any(|stream| is_pose(&stream))) {
        (0, _) => "the log has no such topic",
        (_, false) => "the topic holds no poses",
        (_, true) => return Ok(()),
    };
    Err(not_so(declared, what.to_owned()))
}

/// The error where a topic is not what is declared of it.
fn not_so(declared: &Declaration, what: String) -> RunError {
    let remedy = "check the topic's name and type with `poseaudit info`";
    RunError::Declared { place: declared.place.clone(), what, remedy }
}

fn is_topic(stream: &Stream, topic: &str) -> bool {
    stream.topic.trim_start_matches('/') == topic.trim_start_matches('/')
}

/// First and last time of some streams.
fn span<'a>(streams: impl Iterator<Item = &'a Stream>) -> Option<(Stamp, Stamp)> {
    let bounds = streams.filter_map(|stream| stream.start.zip(stream.end));
    bounds.reduce(|(start, end), (other_start, other_end)| {
        (start.min(other_start), end.max(other_end))
    })
}

fn origin(streams: &[Stream]) -> Stamp {
    let of_joints = span(streams.iter().filter(|stream| stream.role == Role::Joints));
    let of_any = || span(streams.iter().filter(|stream| stream.rate_hz.is_some()));
    of_joints.or_else(of_any).map_or(Stamp::default(), |(start, _)| start)
}

/// The descriptions on topics and beside the messages, each with where it was.
fn descriptions(
    streams: &[Stream],
    attached: Vec<crate::log::Description>,
) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for stream in streams.iter().filter(|stream| stream.role == Role::Description) {
        if let Some(Columns::Text(texts)) = &stream.columns {
            found.extend(texts.text.iter().map(|text| (stream.topic.clone(), text.clone())));
        }
    }
    found.extend(attached.into_iter().map(|description| (description.name, description.text)));
    found
}

/// The tree of all transforms of the log's TF topics.
fn tf_tree(streams: &[Stream], timing: &Timing) -> TfTree {
    let mut tree = TfTree::default();
    for (index, stream) in streams.iter().enumerate() {
        let Some(Columns::Transforms(transforms)) = &stream.columns else { continue };
        for (piece, transform) in transforms.iter().enumerate() {
            let (parent, child) = (&transform.frame_id, &transform.child_frame_id);
            if stream.role == Role::TfStatic {
                let last = (0..transform.times.len()).rev().find_map(|row| pose_at(transform, row));
                if let (Some(last), None) = (last, tree.edge(parent, child)) {
                    tree.insert_fixed(parent, child, EdgeKind::Static, last);
                }
                continue;
            }
            let rows = timing.seen_rows(streams, index, piece, 0.0).into_iter();
            let mut samples: Vec<(Stamp, Pose)> =
                rows.filter_map(|(stamp, row)| Some((stamp, pose_at(transform, row)?))).collect();
            samples.sort_by_key(|(stamp, _)| *stamp);
            samples.dedup_by_key(|(stamp, _)| *stamp);
            let (stamps, poses) = samples.into_iter().unzip();
            tree.insert_samples(parent, child, stamps, poses);
        }
    }
    tree
}

fn pose_at(poses: &PoseColumns, row: usize) -> Option<Pose> {
    Some(pose(poses.xyz[row], rotation_from_xyzw(poses.q_xyzw[row])?))
}

/// How far the transforms of the log are from the lengths of a robot's links, rms m; `None` where
/// fewer than three of them stand for a turning joint.
fn misfit_m(tf: &TfTree, robot: &Robot, frames: &FrameNames) -> Option<f64> {
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
    /// Finds the robots, cuts the arms out of them and follows the transforms along each.
    fn find_arms(&mut self, said: Said<'_>) -> Result<(), RunError> {
        let topics = seen_joint_topics(&self.streams, &self.timing, self.options.max_latency_s);
        let mut joints: Vec<String> = Vec::new();
        for topic in &topics {
            let names = topic.columns.joints.iter().map(|joint| &joint.name);
            let new: Vec<String> =
                names.filter(|name| !joints.contains(name) && topic.holds(name)).cloned().collect();
            joints.extend(new);
        }
        if joints.is_empty() {
            let is_command = |stream: &&Stream| {
                stream.role == Role::Reference && matches!(stream.columns, Some(Columns::Joints(_)))
            };
            let commands = self.streams.iter().filter(is_command);
            return Err(RunError::NoJointStates {
                commands: commands.map(|stream| stream.topic.clone()).collect(),
            });
        }
        let named =
            self.streams.iter().flat_map(|stream| [&stream.frame_id, &stream.child_frame_id]);
        let frames: BTreeSet<String> =
            self.tf.frames().chain(named.map(String::as_str)).map(str::to_owned).collect();
        let clues = Clues {
            joints: &joints,
            frames: &frames,
            descriptions: said.descriptions,
            calibrations: said.logged_calibrations,
        };
        let judges = Judges {
            by_transforms: &|model| misfit_m(&self.tf, &model.robot, &model.frames),
            by_poses: &|models| self.contest(models, &topics),
        };
        let mut models = models::models(said.given, &clues, &judges)?;
        models::calibrate(&mut models, &said.calibrations, &clues)?;
        for model in &mut models {
            if let Some(rival) = self.rival(model, &clues, &topics) {
                *model = rival;
            }
        }
        let ends = Ends { base: self.options.base.as_deref(), tip: self.options.tip.as_deref() };
        let mut refusal = None;
        for model in &models {
            for path in
                skeleton::arms(&model.robot, |name| joints.iter().any(|joint| joint == name))
            {
                match Arm::new(model, &path, ends, &topics, self.origin) {
                    Ok(arm) if arm.is_along(&path) => self.arms.push(arm),
                    Ok(_) => {}
                    Err(error) => refusal = refusal.or(Some(error)),
                }
            }
        }
        if self.arms.is_empty() {
            return Err(refusal.unwrap_or(RunError::NoModel { logged: joints }));
        }
        drop(topics);
        self.tell_arms_apart();
        for arm in &self.arms {
            add_fixed_joints(&mut self.tf, arm);
        }
        let tf_stream = self.streams.iter().position(|stream| stream.role == Role::Tf);
        for index in 0..self.arms.len() {
            let followed = self.follow_transforms(&self.arms[index], tf_stream);
            let arm = &mut self.arms[index];
            match followed {
                Ok((source, from_model)) => (arm.tf, arm.from_model) = (Ok(source), from_model),
                Err(reason) => arm.tf = Err(reason),
            }
        }
        Ok(())
    }

    /// Gives arms of equal names their tip's name too.
    fn tell_arms_apart(&mut self) {
        let names: Vec<String> = self.arms.iter().map(|arm| arm.name.clone()).collect();
        for arm in &mut self.arms {
            if names.iter().filter(|name| **name == arm.name).count() > 1 {
                arm.name = format!("{} ({})", arm.name, arm.chain.tip_name());
            }
        }
    }

    /// The poses of `arm`'s tip by the log's transforms, and which of these the model had to give.
    fn follow_transforms(
        &self,
        arm: &Arm,
        tf_stream: Option<usize>,
    ) -> Result<(PoseSource, Vec<(String, String)>), NoTf> {
        let stream = tf_stream.ok_or(NoTf::NoTransforms)?;
        let [base, tip] = [arm.base, arm.tip].map(|link| arm.frame_of(link));
        let crosses = |edge: &Edge| {
            let (parent, child) = self.tf.names(edge);
            arm.joints_between(parent, child)
        };
        // A transform across several joints, or of a frame that is no link, is a measured pose.
        let is_of_the_model = |edge: &Edge| {
            edge.kind != EdgeKind::Dynamic || crosses(edge).is_some_and(|joints| joints.len() < 2)
        };
        let path = self.tf.path(&base, &tip, is_of_the_model)?;
        let crossed: Vec<String> = path
            .edges()
            .filter(|edge| edge.kind == EdgeKind::Dynamic)
            .flat_map(|edge| crosses(edge).unwrap_or_default())
            .collect();
        let uncrossed: Vec<String> = arm
            .chain
            .joint_names()
            .iter()
            .filter(|joint| !crossed.contains(joint))
            .cloned()
            .collect();
        if !uncrossed.is_empty() {
            return Err(NoTf::NotCovered { joints: uncrossed });
        }
        let mut stamps = path.stamps();
        poses::thinned(&mut stamps);
        let stamps = stamps.into_iter();
        let samples: Vec<(Stamp, Pose)> =
            stamps.filter_map(|stamp| Some((stamp, path.at(stamp).ok()?))).collect();
        if samples.len() < 2 {
            return Err(NoTf::NoSamples);
        }
        let from_model = path.edges().filter(|edge| edge.kind == EdgeKind::Model).map(|edge| {
            let (parent, child) = self.tf.names(edge);
            (parent.to_owned(), child.to_owned())
        });
        let piece = self.piece_of(stream, path.edges().find(|edge| edge.kind == EdgeKind::Dynamic));
        let Stamped { track, stamps } = poses::from_samples(samples, self.origin);
        let (chain, columns) = self.publishers_chain(arm);
        let source = PoseSource {
            stream,
            chain,
            columns,
            track,
            reference_known: true,
            stamps_copied: poses::are_copies(&stamps, &arm.joint_stamps),
            stamp_error_s: self.stamp_error_s(arm, stream, piece),
            tip_named: arm.tip_named,
        };
        Ok((source, from_model.collect()))
    }

    /// The chain that the transforms are of: where another model was named, and their lengths are that
    /// one's, its publisher has it, too.
    fn publishers_chain(&self, arm: &Arm) -> (Chain, Vec<usize>) {
        let own = || (arm.chain.clone(), arm.columns.clone());
        let Some(wrong) = &arm.instead_of else { return own() };
        let misfit_m = |robot: &Robot| misfit_m(&self.tf, robot, &arm.frames);
        if misfit_m(&wrong.named) >= misfit_m(&arm.robot) {
            return own();
        }
        let named = arm.with_robot(wrong.named.clone());
        named.map_or_else(own, |named| (named.chain, named.columns))
    }

    /// Which transform of a TF stream an edge is.
    fn piece_of(&self, stream: usize, edge: Option<&Edge>) -> usize {
        let Some(Columns::Transforms(transforms)) = &self.streams[stream].columns else { return 0 };
        let Some(names) = edge.map(|edge| self.tf.names(edge)) else { return 0 };
        let is_it = |poses: &PoseColumns| {
            (without_slash(&poses.frame_id), without_slash(&poses.child_frame_id)) == names
        };
        transforms.iter().position(is_it).unwrap_or(0)
    }

    fn stamp_error_s(&self, arm: &Arm, stream: usize, piece: usize) -> f64 {
        let joints = arm.joint_facts.first().map_or(stream, |joint| joint.stream);
        self.timing.alignment_error_s((joints, 0), (stream, piece))
    }

    /// Lists as streams of their own the transforms over time that are measured poses: those across
    /// several joints, and those of a child that is no link of an arm and carries none.
    fn measured_transforms(&mut self) {
        for index in 0..self.streams.len() {
            let stream = &self.streams[index];
            let (Role::Tf, Some(Columns::Transforms(transforms))) = (stream.role, &stream.columns)
            else {
                continue;
            };
            let measured: Vec<usize> = (0..transforms.len())
                .filter(|&piece| self.is_measured(&transforms[piece]))
                .collect();
            let new: Vec<Stream> = measured
                .iter()
                .map(|&piece| {
                    let mut new = self.streams[index].of_pose(transforms[piece].clone());
                    new.role = Role::Unassigned;
                    new
                })
                .collect();
            for (piece, stream) in measured.into_iter().zip(new) {
                self.timing.share(index, piece);
                self.streams.push(stream);
            }
        }
    }

    fn is_measured(&self, transform: &PoseColumns) -> bool {
        let frame = without_slash(&transform.frame_id);
        let child = without_slash(&transform.child_frame_id);
        let carries_none = || {
            let roots = self.arms.iter().map(|arm| arm.frame_of(arm.robot.root()));
            roots.into_iter().all(|root| child != root && !self.tf.is_above(child, &root))
        };
        let is_link = |arm: &Arm| arm.place(&self.tf, child).0 != Place::Unknown;
        if targets::is_sighting(frame, child) && !self.arms.iter().any(is_link) {
            return true;
        }
        for arm in &self.arms {
            let places = (arm.place(&self.tf, frame).0, arm.place(&self.tf, child).0);
            return match (arm.joints_between(frame, child), places) {
                (Some(joints), _) => joints.len() > 1,
                (None, (Place::Unknown, Place::Unknown)) => continue,
                (None, (Place::MovingLink, _)) => false,
                (None, (_, Place::MovingLink)) => arm.is_far_out(child),
                (None, (_, place)) => {
                    let carries_more =
                        self.tf.edges().iter().any(|edge| self.tf.names(edge).0 == child);
                    place == Place::Unknown && carries_none() && !carries_more
                }
            };
        }
        !self.arms.is_empty() && carries_none()
    }

    /// What cameras see, each with the hands that it may be held against.
    fn targets(&self) -> Vec<TargetSource> {
        let is_target = |&index: &usize| self.streams[index].role == Role::Target;
        (0..self.streams.len()).filter(is_target).filter_map(|index| self.target(index)).collect()
    }

    fn target(&self, index: usize) -> Option<TargetSource> {
        let stream = &self.streams[index];
        let camera = &stream.frame_id;
        if self.is_transform(stream) && !targets::is_sighting(camera, &stream.child_frame_id) {
            return None;
        }
        let hands = match self.owner(stream) {
            Some(owner) => {
                let arm = &self.arms[owner];
                let (kind, [hand_from_camera, base_from_camera]) =
                    HandKind::of_arm(owner, arm, &self.tf, camera)?;
                let stamp_error_s = self.stamp_error_s(arm, index, 0);
                vec![HandSource { kind, hand_from_camera, base_from_camera, stamp_error_s }]
            }
            None => self.hands_without_arm(index),
        };
        // A detector's poses are never all the same; a frame that is published over and over is.
        let track = self.plain_track(index).filter(|track| track.changes())?;
        Some(TargetSource { stream: index, track, axes: targets::axes_of(&self.tf, camera), hands })
    }

    /// The poses of a stream that holds one pose, as logged.
    fn plain_track(&self, index: usize) -> Option<PoseTrack> {
        let Some(Columns::Poses(poses)) = &self.streams[index].columns else { return None };
        let [poses] = poses.as_slice() else { return None };
        let mut rows = self.timing.rows(&self.streams, index, 0);
        hide(&self.timing.strays, index, 0, &mut rows);
        let track = poses::from_poses(poses, &rows, None, self.origin).ok()?.track;
        (track.t_s.len() > 1).then_some(track)
    }

    /// The streams of poses that may be a hand's in a log without an arm, and what its transforms
    /// move.
    fn hands_without_arm(&self, target: usize) -> Vec<HandSource> {
        let camera = &self.streams[target].frame_id;
        let tied = |frame: &str| {
            let found = self.tf.tied(camera, |other| !frame.is_empty() && other == frame);
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
                stamp_error_s: self.timing.alignment_error_s((index, 0), (target, 0)),
            })
        });
        let by_transforms = targets::hand_frame(&self.tf, camera).and_then(|(base, hand)| {
            let path = self.tf.path(&base, &hand, |_| true).ok()?;
            let stamps = path.stamps().into_iter();
            let samples: Vec<(Stamp, Pose)> =
                stamps.filter_map(|stamp| Some((stamp, path.at(stamp).ok()?))).collect();
            let track = poses::from_samples(samples, self.origin).track;
            let (hand_from_camera, base_from_camera) = (tied(&hand), tied(&base));
            let kind = HandKind::Transforms { base, frame: hand, track };
            Some(HandSource { kind, hand_from_camera, base_from_camera, stamp_error_s: 0.0 })
        });
        streams.chain(by_transforms).collect()
    }

    /// Gives `stream` its role and, where it belongs to an arm, hands it over.
    fn assign(&mut self, stream: usize) -> Result<(), RunError> {
        match &self.streams[stream].columns {
            Some(Columns::Poses(_) | Columns::Array(_)) => self.assign_pose(stream),
            Some(Columns::Imu(_)) => {
                self.assign_imu(stream);
                Ok(())
            }
            Some(Columns::Transforms(_)) if self.streams[stream].role == Role::Tf => {
                self.assign_tf(stream);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn assign_tf(&mut self, index: usize) {
        let follows = |arm: &Arm| arm.tf.as_ref().is_ok_and(|source| source.stream == index);
        let stream = &mut self.streams[index];
        stream.arm = self.arms.iter().position(follows);
        if let Some(arm) = stream.arm.map(|arm| &self.arms[arm]) {
            stream.reference = Some(arm.frame_of(arm.base));
            stream.link = Some(arm.frame_of(arm.tip));
            // Transforms of the model's joints: what is measured became a stream of its own.
            stream.witness = Some(Witness::Controller);
        } else if let Some(Err(reason)) = self.arms.first().map(|arm| &arm.tf) {
            stream.reason = format!("{}; {reason}", stream.reason);
        }
    }

    fn assign_pose(&mut self, index: usize) -> Result<(), RunError> {
        let stream = &self.streams[index];
        let declared =
            self.options.declared.iter().find(|declared| is_topic(stream, &declared.topic));
        let unfit = declared.filter(|declared| !declared.fits(stream.columns.as_ref()));
        let declared = declared.filter(|_| unfit.is_none());
        let owner = self.owner(stream);
        let site = owner.map(|arm| self.site(&self.arms[arm], stream));
        let said = self.said_of(stream);
        let (mut role, mut reason) = self.role_of(stream, site.as_ref(), declared.is_some());
        if let Some(vendor) = said.and_then(|said| said.vendor.as_ref()) {
            reason += &format!("; {vendor}");
        }
        if unfit.is_some() {
            reason += ", but it holds other numbers, which are read as they are";
        }
        let is_wanted = matches!(role, Role::Pose | Role::Candidate { .. });
        let mut source = None;
        if let (true, Some(arm), Some(site)) = (is_wanted, owner, &site) {
            let mut frozen = Vec::new();
            let known = role == Role::Pose;
            match self.pose_source(index, &self.arms[arm], site, declared, (known, &mut frozen)) {
                Ok(found) => {
                    reason += &site.said;
                    let reference = match found.reference_known {
                        true => self.arms[arm].frame_of(site.base.link),
                        false => stream.frame_id.clone(),
                    };
                    let link = self.arms[arm].frame_of(site.tip.link);
                    let by_names = || {
                        witness_of(&PoseNames {
                            topic: &stream.topic,
                            type_name: &stream.type_name,
                            frame_id: &stream.frame_id,
                            child_frame_id: &stream.child_frame_id,
                            frame: site.frame,
                            stamps_copied: found.stamps_copied,
                        })
                    };
                    let set = said.and_then(|said| Some((said.witness?, said.place.clone())));
                    let witness = set.unwrap_or_else(by_names);
                    source = Some((arm, found, reference, link, witness));
                }
                Err(what)
                    if let Some(declared) = declared
                        && frozen.is_empty() =>
                {
                    return Err(not_so(declared, what));
                }
                Err(why) => (role, reason) = (Role::Unassigned, why),
            }
            self.watched.push(index);
            self.frozen.extend(frozen);
        } else if matches!(role, Role::Candidate { .. }) {
            role = Role::Unassigned;
            reason += ", and there is no arm that it could follow";
        }
        let stream = &mut self.streams[index];
        (stream.role, stream.reason) = (role, reason);
        if let Some((arm, source, reference, link, (witness, why))) = source {
            stream.reason += &format!("; witness: {}, by {why}", witness.name());
            (stream.arm, stream.witness) = (Some(arm), Some(witness));
            (stream.reference, stream.link) = (Some(reference), Some(link));
            self.arms[arm].poses.push(source);
        }
        Ok(())
    }

    /// What the caller says of the topic of a stream.
    fn said_of(&self, stream: &Stream) -> Option<&TopicSettings> {
        self.options.topics.iter().find(|said| said.is_of(&stream.topic))
    }

    fn role_of(&self, stream: &Stream, site: Option<&Site>, is_declared: bool) -> Verdict {
        let said = self.said_of(stream).and_then(|said| Some((said.role?, &said.place)));
        if let Some((role, place)) = said
            && !self.is_transform(stream)
        {
            let said = format!("its role is set ({place})");
            match (&stream.columns, role) {
                (Some(Columns::Array(array)), SaidRole::Pose) => {
                    let (role, reason) = array_role(&stream.topic, array.width, true);
                    let is_pose = role == Role::Pose;
                    return if is_pose { (role, said) } else { (role, reason) };
                }
                (_, role) => return (role.role(), said),
            }
        }
        if let Some(Columns::Array(array)) = &stream.columns {
            return array_role(&stream.topic, array.width, is_declared);
        }
        let place = |frame: &str| if frame.is_empty() { Place::Unnamed } else { Place::Unknown };
        let verdict = pose_role(&PoseTopic {
            topic: &stream.topic,
            frame_id: &stream.frame_id,
            child_frame_id: &stream.child_frame_id,
            frame: site.map_or(place(&stream.frame_id), |site| site.frame),
            child: site.map_or(place(&stream.child_frame_id), |site| site.child),
            is_declared,
        });
        match verdict {
            // Many transforms start at the base: that alone says nothing.
            (Role::Candidate { .. }, _) if self.is_transform(stream) => (
                Role::Candidate { presumed: false },
                format!("'{}' is no link of the robot", stream.child_frame_id),
            ),
            verdict => verdict,
        }
    }

    /// Whether a stream of poses is a transform of a TF topic.
    fn is_transform(&self, stream: &Stream) -> bool {
        self.streams.iter().any(|other| other.role == Role::Tf && other.topic == stream.topic)
    }

    /// The arm that a stream may belong to: the one that moves its child frame, else the one that
    /// has its frame, else the one whose robot's name is in the topic, else the first.
    fn owner(&self, stream: &Stream) -> Option<usize> {
        let place = |arm: &Arm, frame: &str| arm.place(&self.tf, frame).0;
        let is_known =
            |arm: &&Arm| !matches!(place(arm, &stream.frame_id), Place::Unknown | Place::Unnamed);
        let moves = |arm: &Arm| place(arm, &stream.child_frame_id) == Place::MovingLink;
        let has_frame =
            |arm: &Arm| is_known(&arm) && self.arms.iter().filter(is_known).count() == 1;
        let is_named = |arm: &Arm| arm.namespace().is_some_and(|name| stream.topic.contains(name));
        let first = |fits: &dyn Fn(&Arm) -> bool| self.arms.iter().position(fits);
        first(&moves)
            .or_else(|| first(&has_frame))
            .or_else(|| first(&is_named))
            .or_else(|| first(&|_| true))
    }

    /// Between which links of `arm` a stream's poses are.
    fn site(&self, arm: &Arm, stream: &Stream) -> Site {
        let (frame, frame_anchor) = arm.place(&self.tf, &stream.frame_id);
        let (child, child_anchor) = arm.place(&self.tf, &stream.child_frame_id);
        let still = |link: LinkId| Anchor { link, link_from_frame: Pose::identity() };
        let base = match frame {
            Place::Unnamed => still(arm.unnamed_base),
            _ => frame_anchor.unwrap_or(still(arm.base)),
        };
        // The caller's tip stands before a stream's own child frame, but a transform is of its child.
        let names_tip = child == Place::MovingLink && (!arm.tip_named || self.is_transform(stream));
        let child_tip = child_anchor.filter(|_| names_tip);
        let tip = child_tip.unwrap_or(still(arm.tip));
        let mut said = String::new();
        let sides = [(&stream.frame_id, frame_anchor), (&stream.child_frame_id, child_tip)];
        for (frame, anchor) in sides {
            let Some(anchor) = anchor else { continue };
            let link = arm.frame_of(anchor.link);
            if link != *frame {
                said += &format!("; '{frame}' is tied to '{link}' by static transforms");
            }
        }
        if child == Place::MovingLink && child_anchor.is_some_and(|anchor| anchor.link != tip.link)
        {
            said += &format!("; audited as '{}', which the caller named", arm.chain.tip_name());
        }
        let tip_named = arm.tip_named || child == Place::MovingLink;
        Site { frame, child, base, tip, tip_named, said }
    }

    /// The poses of a stream with the chain that predicts them, or why there are none.
    fn pose_source(
        &self,
        index: usize,
        arm: &Arm,
        site: &Site,
        declared: Option<&Declaration>,
        (known, frozen): (bool, &mut Vec<Frozen>),
    ) -> Result<PoseSource, String> {
        let (chain, columns) =
            arm.chain_between(site.base.link, site.tip.link).ok_or_else(|| {
                let [base, tip] = [site.base.link, site.tip.link].map(|link| arm.frame_of(link));
                format!("no joint in the joint states moves '{tip}' against '{base}'")
            })?;
        let mut rows = self.timing.seen_rows(&self.streams, index, 0, 0.0);
        poses::thinned(&mut rows);
        let mut logged = match &self.streams[index].columns {
            Some(Columns::Poses(poses)) => {
                let [poses] = poses.as_slice() else {
                    return Err("it holds several poses".to_owned());
                };
                poses::from_poses(poses, &rows, declared, self.origin)?
            }
            Some(Columns::Array(array)) => poses::from_array(array, &rows, declared, self.origin)?,
            _ => return Err("it holds no poses".to_owned()),
        };
        let how = (known, self.options.max_latency_s);
        *frozen = take_frozen(index, &mut logged, &arm.joints, &columns, how);
        if frozen.iter().any(|frozen| frozen.whole) {
            return Err("it repeats one value while the arm moves".to_owned());
        }
        let Stamped { track, stamps } = logged;
        if track.t_s.len() < 2 {
            return Err("it has fewer than two usable samples".to_owned());
        }
        let (before, after) = (site.base.link_from_frame, site.tip.link_from_frame.inverse());
        Ok(PoseSource {
            stream: index,
            chain,
            columns,
            track: poses::reframed(track, &before, &after),
            reference_known: site.frame != Place::Unknown,
            stamps_copied: poses::are_copies(&stamps, &arm.joint_stamps),
            stamp_error_s: self.stamp_error_s(arm, index, 0),
            tip_named: site.tip_named,
        })
    }

    fn assign_imu(&mut self, index: usize) {
        let stream = &self.streams[index];
        let Some(Columns::Imu(imu)) = &stream.columns else { return };
        let Some(owner) = self.owner(stream) else { return };
        let arm = &self.arms[owner];
        let (place, anchor) = arm.place(&self.tf, &stream.frame_id);
        let (carrier, link_from_imu, why) = match (place, anchor) {
            (Place::MovingLink, Some(anchor)) => {
                (anchor.link, Some(anchor.link_from_frame), "the arm moves its frame".to_owned())
            }
            (Place::StillLink | Place::Tied, _) => {
                let reason = format!("the arm does not move its frame '{}'", stream.frame_id);
                self.streams[index].reason = format!("inertial measurements; {reason}");
                return;
            }
            _ => {
                (arm.tip, None, "no frame says what carries it: taken to be at the tip".to_owned())
            }
        };
        if let Some(joint) = arm.unlogged_above(carrier) {
            let reason = format!("'{joint}', which moves it, is not in the joint states");
            self.streams[index].reason = format!("inertial measurements; {reason}");
            return;
        }
        let Some((chain, columns)) = arm.chain_between(arm.base, carrier) else { return };
        let rows = self.timing.seen_rows(&self.streams, index, 0, 0.0);
        let Stamped { track, stamps } = poses::from_imu(imu, &rows, self.origin);
        let source = ImuSource {
            stream: index,
            chain,
            columns,
            track,
            link_from_imu,
            stamps_copied: poses::are_copies(&stamps, &arm.joint_stamps),
            stamp_error_s: self.stamp_error_s(arm, index, 0),
        };
        let reason = format!("inertial measurements; {why}");
        let [reference, link] = [arm.base, carrier].map(|link| arm.frame_of(link));
        let stream = &mut self.streams[index];
        (stream.arm, stream.reason) = (Some(owner), reason);
        stream.witness = Some(Witness::External);
        (stream.reference, stream.link) = (Some(reference), Some(link));
        if source.track.t_s.len() > 1 {
            self.arms[owner].imus.push(source);
        }
    }

    /// Says of every stream of joint states which joints the arms use, and which they do not.
    fn name_joints(&mut self) {
        let arms = &self.arms;
        if arms.is_empty() {
            return;
        }
        for (index, stream) in self.streams.iter_mut().enumerate() {
            let (Role::Joints, Some(Columns::Joints(columns))) = (stream.role, &stream.columns)
            else {
                continue;
            };
            let reads = |arm: &Arm, name: &str| {
                arm.joint_facts.iter().any(|joint| joint.stream == index && joint.name == name)
            };
            let (used, ignored): (Vec<&str>, Vec<&str>) = columns
                .joints
                .iter()
                .map(|joint| joint.name.as_str())
                .partition(|name| arms.iter().any(|arm| reads(arm, name)));
            stream.arm = arms.iter().position(|arm| used.iter().any(|name| reads(arm, name)));
            if used.is_empty() {
                stream.role = Role::Ignored;
                stream.reason =
                    "none of its joints moves an arm's tip, or another topic has them".to_owned();
            } else if !ignored.is_empty() {
                let ignored = ignored.join(", ");
                stream.reason =
                    format!("joint states; ignored, as they do not move an arm's tip: {ignored}");
            }
        }
    }
}

/// Between which links of an arm the poses of a stream are.
struct Site {
    frame: Place,
    child: Place,
    base: Anchor,
    tip: Anchor,
    tip_named: bool,
    /// What of it needs saying.
    said: String,
}

/// The topics of joint states.
fn joint_topics<'a>(streams: &'a [Stream], timing: &Timing) -> Vec<JointTopic<'a>> {
    let with_columns = streams.iter().enumerate().filter_map(|(index, stream)| {
        let Some(Columns::Joints(columns)) = &stream.columns else { return None };
        (stream.role == Role::Joints).then_some((index, columns))
    });
    with_columns
        .map(|(stream, columns)| JointTopic {
            stream,
            columns,
            rows: timing.rows(streams, stream, 0),
        })
        .collect()
}

/// The same, with the rows that the estimators see. Of joints they see more than of other
/// streams, by the latency that is sought.
fn seen_joint_topics<'a>(
    streams: &'a [Stream],
    timing: &Timing,
    most_lag_s: f64,
) -> Vec<JointTopic<'a>> {
    let mut topics = joint_topics(streams, timing);
    for topic in &mut topics {
        topic.rows = timing.seen_rows(streams, topic.stream, 0, most_lag_s);
    }
    topics
}

/// Adds those fixed joints of the arm's robot to the tree whose child has no parent there.
fn add_fixed_joints(tf: &mut TfTree, arm: &Arm) {
    for joint in arm.robot.joints().iter().filter(|joint| joint.kind == JointKind::Fixed) {
        let [parent, child] = [joint.parent, joint.child].map(|link| arm.frame_of(link));
        if !tf.has_parent(&child) {
            tf.insert_fixed(&parent, &child, EdgeKind::Model, joint.parent_from_joint);
        }
    }
}
