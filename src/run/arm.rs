//! One arm of a run: its joint states, and the streams that measure its pose.

use std::sync::Arc;

use crate::geometry::Pose;
use crate::robot::{Chain, Joint, JointKind, LinkId, Robot, catalogue};
use crate::stream::JointTrack;
use crate::time::Stamp;

use super::error::RunError;
use super::joints::{JointSamples, JointSource, JointTopics};
use super::model::{CompetingModel, FrameNames, LogModel};
use super::namespace::{Namespace, NamespaceMatch};
use super::role::{FrameKind, split_words};
use super::skeleton::{self, ArmPath, driving_joint};
use super::sources::{ImuSource, PoseSource};
use super::tf_error::TfError;
use super::tf_tree::{TfTree, strip_slash};
use super::trajectory::Trajectory;

/// One arm of a run.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Name in reports.
    pub name: String,
    /// The robot, with the log's joint names.
    pub robot: Robot,
    /// How the robot was identified.
    pub identified_by: String,
    /// Arm that fits far better than the named `robot`.
    pub competing: Option<CompetingModel>,
    /// Other catalogue arms that fit about as well as the guessed `robot`.
    pub indistinguishable: Vec<String>,
    /// Chain from base to tip.
    pub chain: Chain,
    /// Column in `joints` of each joint of `chain`.
    pub columns: Vec<usize>,
    /// Whether the caller named the tip.
    pub tip_named: bool,
    /// Names of the columns of `joints`.
    pub joint_names: Vec<String>,
    /// Joint states.
    pub joints: Arc<JointTrack>,
    /// Origin of each column.
    pub joint_sources: Vec<JointSource>,
    /// Joint states as recorded, if `joints` are corrected.
    pub recorded_joints: Option<Arc<JointTrack>>,
    /// Correction of the values in `joints`.
    pub joint_correction: Option<JointStateCorrection>,
    /// Measured and candidate tool poses.
    pub poses: Vec<PoseSource>,
    /// Tip poses from the log's transforms, or why they are unavailable.
    pub tf: Result<PoseSource, TfUnavailable>,
    /// Transforms (parent, child) that `tf` takes from the model.
    pub from_model: Vec<(String, String)>,
    /// IMUs on the arm.
    pub imus: Vec<ImuSource>,
    /// The pose stream in the place of joint states, if these are missing.
    pub trajectory: Option<Trajectory>,
    pub(super) base: LinkId,
    pub(super) tip: LinkId,
    /// Reference link of poses without a frame.
    pub(super) unnamed_base: LinkId,
    pub(super) frames: FrameNames,
    pub(super) joint_stamps: Arc<[Stamp]>,
    pub(super) namespace: Namespace,
    pub(super) tree: Arc<TfTree>,
}

impl Arm {
    /// Whether each joint column is prismatic.
    pub fn are_prismatic(&self) -> Vec<bool> {
        let slides = |name: &String| {
            self.robot.joint(name).is_some_and(|joint| joint.kind == JointKind::Prismatic)
        };
        self.joint_names.iter().map(slides).collect()
    }
}

/// Correction of the joint states, for each column.
#[derive(Clone, Debug, PartialEq)]
pub struct JointStateCorrection {
    /// Column with this joint's positions.
    pub from: Vec<usize>,
    /// Factor for positions and velocities.
    pub factor: Vec<f64>,
    /// Offset added to the scaled positions, rad or m.
    pub offset: Vec<f64>,
    /// Joints that others move too.
    pub couplings: Vec<CoupledColumn>,
}

/// Column to which `factor` times the scaled values of the column `by` are added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledColumn {
    /// Driven joint.
    pub column: usize,
    /// Driving joint.
    pub by: usize,
    /// Per radian of the driving joint.
    pub factor: f64,
}

impl JointStateCorrection {
    /// No correction.
    pub fn identity(joints: usize) -> Self {
        let from = (0..joints).collect();
        Self { from, factor: vec![1.0; joints], offset: vec![0.0; joints], couplings: Vec::new() }
    }

    /// Whether there is no correction.
    pub fn is_identity(&self) -> bool {
        *self == Self::identity(self.from.len())
    }

    /// Corrected joint states.
    pub fn apply(&self, track: &JointTrack) -> JointTrack {
        let mut corrected = track.clone();
        for start in (0..track.q.len()).step_by(track.dof.max(1)) {
            for (joint, &from) in self.from.iter().enumerate() {
                let factor = self.factor[joint];
                corrected.q[start + joint] = factor * track.q[start + from] + self.offset[joint];
                corrected.qd[start + joint] = factor * track.qd[start + from];
            }
            for coupling in &self.couplings {
                let (from, gain) = self.driver(coupling);
                corrected.q[start + coupling.column] += gain * track.q[start + from];
                corrected.qd[start + coupling.column] += gain * track.qd[start + from];
            }
        }
        corrected
    }

    /// Corrected samples of each joint.
    pub fn apply_to_samples<'a>(&self, samples: &[JointSamples<'a>]) -> Vec<JointSamples<'a>> {
        let corrected = self.from.iter().enumerate().map(|(joint, &from)| {
            let mut own = samples[from].clone();
            let (factor, offset) = (self.factor[joint], self.offset[joint]);
            own.position.to_mut().iter_mut().for_each(|q| *q = factor * *q + offset);
            own.velocity.to_mut().iter_mut().for_each(|qd| *qd *= factor);
            for coupling in self.couplings.iter().filter(|coupling| coupling.column == joint) {
                let (from, gain) = self.driver(coupling);
                let [positions, velocities] = samples[from].at_times_of(&own);
                own.position.to_mut().iter_mut().zip(positions).for_each(|(q, by)| *q += gain * by);
                own.velocity
                    .to_mut()
                    .iter_mut()
                    .zip(velocities)
                    .for_each(|(qd, by)| *qd += gain * by);
            }
            own
        });
        corrected.collect()
    }

    /// Column with the driving joint's positions, and their factor in the coupled joint's.
    fn driver(&self, coupling: &CoupledColumn) -> (usize, f64) {
        (self.from[coupling.by], coupling.factor * self.factor[coupling.by])
    }
}

/// Why the log's transforms do not connect base and tip.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TfUnavailable {
    /// There are none.
    #[error("the log has no transforms over time")]
    NoTransforms,
    /// No path connects base and tip.
    #[error(transparent)]
    NoPath(#[from] TfError),
    /// No dynamic transform covers these joints.
    #[error("no transform over time covers {}", joints.join(", "))]
    NotCovered {
        /// The joints.
        joints: Vec<String>,
    },
    /// Some come from a model with the wrong DH convention.
    #[error("some of them come from the model, whose DH table uses the other convention")]
    OtherModel,
    /// They belong to another arm with the same frames.
    #[error("they belong to {arm}, by its motion")]
    OfAnotherArm {
        /// That arm.
        arm: String,
    },
    /// They are never all available at once.
    #[error("fewer than two times have all transforms from base to tip")]
    NoSamples,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct FrameAnchor {
    pub link: LinkId,
    pub link_from_frame: Pose,
}

#[derive(Clone, Copy)]
pub(super) struct ChainEnds<'a> {
    pub base: Option<&'a str>,
    pub tip: Option<&'a str>,
}

/// Link that the catalogue calls `name`, if the links of its arm have the prefix of the log.
fn link_named_in_catalogue(robot: &Robot, name: &str) -> Option<LinkId> {
    robot.provenance.as_ref()?;
    let own =
        catalogue::find(&robot.name).filter(|own| own.links().count() == robot.links().count())?;
    own.link(name)
}

impl Arm {
    /// Builds the arm of `model` along `path`.
    ///
    /// # Errors
    /// If base or tip are not links, a joint between them is missing, or no time has samples of all joints.
    pub(super) fn new(
        model: &LogModel,
        path: &ArmPath,
        ends: ChainEnds<'_>,
        joints: &JointTopics<'_>,
    ) -> Result<Self, RunError> {
        let robot = &model.robot;
        let link = |option: &'static str, name: &str| {
            let name = strip_slash(name);
            let found = robot.link(name).or_else(|| model.frames.link_of(robot, name));
            let found = found.or_else(|| link_named_in_catalogue(robot, name));
            found.ok_or_else(|| RunError::UnknownLink {
                option,
                link: name.to_owned(),
                source: robot.source.clone(),
                nearest: robot.nearest_link_names(name).into_iter().map(str::to_owned).collect(),
            })
        };
        let tip = match ends.tip {
            Some(name) => link("--tip", name)?,
            None => {
                let preferred = model.controller_tip.map(|link| robot.link_name(link));
                skeleton::select_tip(robot, path.end, preferred)
            }
        };
        let base = match ends.base {
            Some(name) => link("--base", name)?,
            None => default_base(model, path),
        };
        let chain = robot.chain(base, tip)?;
        let mut joint_names = path.joints.clone();
        joint_names
            .extend(chain.joint_names().iter().filter(|name| !path.joints.contains(name)).cloned());
        let is_logged = |name: &&String| joints.topics.iter().any(|topic| topic.has_joint(name));
        let missing: Vec<String> =
            joint_names.iter().filter(|name| !is_logged(name)).cloned().collect();
        if !missing.is_empty() {
            return Err(RunError::MissingJoints {
                base: chain.base_name().to_owned(),
                tip: chain.tip_name().to_owned(),
                joints: missing,
            });
        }
        let merged = joints.merged(&joint_names).ok_or_else(|| RunError::NoSamples {
            robot: robot.name.clone(),
            joints: joint_names.clone(),
        })?;
        let columns = joint_columns(&joint_names, &chain).unwrap_or_default();
        Ok(Self {
            name: robot.name.clone(),
            robot: robot.clone(),
            identified_by: model.identified_by.clone(),
            competing: model.competing.clone(),
            indistinguishable: model.indistinguishable.clone(),
            chain,
            columns,
            tip_named: ends.tip.is_some(),
            joint_names,
            joints: merged.track,
            joint_sources: merged.sources,
            recorded_joints: None,
            joint_correction: None,
            poses: Vec::new(),
            tf: Err(TfUnavailable::NoTransforms),
            from_model: Vec::new(),
            imus: Vec::new(),
            trajectory: None,
            base,
            tip,
            unnamed_base: model.controller_base.unwrap_or(base),
            frames: model.frames.clone(),
            joint_stamps: merged.stamps,
            namespace: Namespace::default(),
            tree: Arc::default(),
        })
    }

    /// The same arm on `robot`, which has the same links with other lengths. `None` if a chain fails.
    pub(crate) fn with_robot(&self, robot: Robot) -> Option<Self> {
        let pose_source = |source: &PoseSource| {
            Some(PoseSource { chain: same_chain(&robot, &source.chain)?, ..source.clone() })
        };
        let imu_source = |source: &ImuSource| {
            Some(ImuSource { chain: same_chain(&robot, &source.chain)?, ..source.clone() })
        };
        let tf = match &self.tf {
            // Transforms from the old model have the wrong lengths.
            Ok(_) if !self.from_model.is_empty() => Err(TfUnavailable::OtherModel),
            Ok(source) => Ok(pose_source(source)?),
            Err(why) => Err(why.clone()),
        };
        Some(Self {
            chain: same_chain(&robot, &self.chain)?,
            poses: self.poses.iter().map(pose_source).collect::<Option<_>>()?,
            imus: self.imus.iter().map(imu_source).collect::<Option<_>>()?,
            tf,
            robot,
            ..self.clone()
        })
    }

    pub(crate) fn correct_joints(&mut self, correction: JointStateCorrection) {
        self.replace_joints(correction.apply(&self.joints));
        self.joint_correction = Some(correction);
    }

    /// Replaces the joint states, and keeps those that were recorded.
    pub(crate) fn replace_joints(&mut self, corrected: JointTrack) {
        let replaced = std::mem::replace(&mut self.joints, Arc::new(corrected));
        self.recorded_joints.get_or_insert(replaced);
    }

    /// Whether this arm includes a joint of `path`.
    pub(super) fn has_joint_of(&self, path: &ArmPath) -> bool {
        self.chain.joint_names().iter().any(|joint| path.joints.contains(joint))
    }

    /// The robot's root if logged joints move the arm's base, such as a rail's, otherwise that base. `tip` is the end of
    /// the chain.
    pub(super) fn outermost_base(&self, tip: LinkId) -> LinkId {
        let root = self.robot.root();
        let rides = self.robot.fixed_transform(root, self.base).is_none();
        if rides && self.chain_between(root, tip).is_some() { root } else { self.base }
    }

    /// The chain between two links with its columns, if all its joints are logged.
    pub(super) fn chain_between(&self, base: LinkId, tip: LinkId) -> Option<(Chain, Vec<usize>)> {
        let chain = self.robot.chain(base, tip).ok()?;
        let columns = joint_columns(&self.joint_names, &chain)?;
        Some((chain, columns))
    }

    /// Classifies a frame, and returns the link that it is or is tied to.
    pub(super) fn classify_frame(&self, frame: &str) -> (FrameKind, Option<FrameAnchor>) {
        if frame.is_empty() {
            return (FrameKind::Unnamed, None);
        }
        let link_of = |frame: &str| self.frames.link_of(&self.robot, frame);
        let (anchor, is_link) = match link_of(frame) {
            Some(link) => (FrameAnchor { link, link_from_frame: Pose::identity() }, true),
            None => {
                let tied = self.tree.nearest_fixed(frame, |other| link_of(other).is_some());
                let anchor = tied.and_then(|(name, link_from_frame)| {
                    Some(FrameAnchor { link: link_of(name)?, link_from_frame })
                });
                match anchor {
                    Some(anchor) => (anchor, false),
                    None => return (FrameKind::Unknown, None),
                }
            }
        };
        let place = match (self.can_move(anchor.link), is_link) {
            (true, _) => FrameKind::MovingLink,
            (false, true) => FrameKind::StillLink,
            (false, false) => FrameKind::StaticallyTied,
        };
        (place, Some(anchor))
    }

    pub(super) fn joints_between(&self, a: &str, b: &str) -> Option<Vec<String>> {
        let link = |frame| self.frames.link_of(&self.robot, frame);
        let chain = self.robot.chain(link(a)?, link(b)?);
        Some(chain.map(|chain| chain.joint_names().to_vec()).unwrap_or_default())
    }

    pub(super) fn can_move(&self, link: LinkId) -> bool {
        self.count_joints_above(link) > 0
    }

    /// A joint that moves `link` but has no joint states.
    pub(super) fn unlogged_joint_above(&self, link: LinkId) -> Option<&str> {
        skeleton::moving_joints_above(&self.robot, link)
            .map(|joint| driving_joint(&self.robot, joint).name.as_str())
            .find(|name| !self.has_joint_states_of(name))
    }

    fn has_joint_states_of(&self, name: &str) -> bool {
        // The only joint of a trajectory is floating.
        self.trajectory.is_some() || self.joint_names.iter().any(|known| known == name)
    }

    pub(super) fn has_logged_joint_between(&self, a: &str, b: &str) -> bool {
        let joints = self.joints_between(a, b);
        joints.is_some_and(|joints| joints.iter().any(|joint| self.has_joint_states_of(joint)))
    }

    pub(super) fn match_names<'n>(
        &self,
        names: impl IntoIterator<Item = &'n str>,
    ) -> NamespaceMatch {
        self.namespace.match_names(names)
    }

    fn count_joints_above(&self, link: LinkId) -> usize {
        let above = skeleton::moving_joints_above(&self.robot, link);
        above
            .filter(|joint| self.has_joint_states_of(&driving_joint(&self.robot, joint).name))
            .count()
    }

    pub(super) fn has_most_joints_between(&self, base: LinkId, tip: LinkId) -> bool {
        const MIN_JOINTS: usize = 4;
        let own = self.chain.joint_names();
        self.chain_between(base, tip).is_some_and(|(chain, _)| {
            let shared = chain.joint_names().iter().filter(|name| own.contains(name)).count();
            shared >= MIN_JOINTS && 2 * shared > own.len()
        })
    }

    /// Whether most of the arm's joints move this frame.
    pub(super) fn is_moved_by_most_joints(&self, name: &str) -> bool {
        let link = self.frames.link_of(&self.robot, name);
        link.is_some_and(|link| 2 * self.count_joints_above(link) > self.joint_names.len())
    }

    /// Words of most joint names, and of the tip's name unless they name a kind of frame.
    pub(super) fn name_words(&self) -> Vec<String> {
        const FRAME_WORDS: [&str; 9] =
            ["ee", "eef", "end", "effector", "flange", "link", "tcp", "tip", "tool"];
        let of_joints: Vec<Vec<String>> =
            self.joint_names.iter().map(|name| split_words(name)).collect();
        let is_of_most = |word: &String| {
            2 * of_joints.iter().filter(|words| words.contains(word)).count() > of_joints.len()
        };
        let mut own: Vec<String> = of_joints.iter().flatten().cloned().collect();
        own.retain(is_of_most);
        let of_tip = split_words(&self.frame_of(self.tip)).into_iter();
        own.extend(of_tip.filter(|word| !FRAME_WORDS.contains(&word.as_str())));
        own.sort_unstable();
        own.dedup();
        own
    }

    pub(crate) fn end_frames(&self) -> [String; 2] {
        [self.base, self.tip].map(|link| self.frame_of(link))
    }

    pub(super) fn frame_of(&self, link: LinkId) -> String {
        self.frames.frame_of(self.robot.link_name(link))
    }
}

/// The controller's base, or the root if joints move that base, as of an arm on a rail. The arm's first link if an
/// unlogged joint moves it.
fn default_base(model: &LogModel, path: &ArmPath) -> LinkId {
    let robot = &model.robot;
    let known = |joint: &Joint| path.joints.contains(&driving_joint(robot, joint).name);
    let is_fixed = |base: &LinkId| skeleton::moving_joints_above(robot, *base).next().is_none();
    let wanted = model.controller_base.filter(is_fixed).unwrap_or(robot.root());
    let is_reachable = skeleton::moving_joints_above(robot, path.base).all(known)
        && skeleton::moving_joints_above(robot, wanted).all(known);
    if is_reachable { wanted } else { path.base }
}

/// The chain between the same links of another robot.
pub(super) fn same_chain(robot: &Robot, old: &Chain) -> Option<Chain> {
    robot.chain(robot.link(old.base_name())?, robot.link(old.tip_name())?).ok()
}

fn joint_columns(joint_names: &[String], chain: &Chain) -> Option<Vec<usize>> {
    let column = |name: &String| joint_names.iter().position(|known| known == name);
    chain.joint_names().iter().map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::borrow::Cow;

    #[test]
    fn a_coupled_joint_moves_with_the_scaled_positions_of_its_driver() {
        let correction = JointStateCorrection {
            factor: vec![1.0, 2.0],
            offset: vec![0.0, 0.5],
            couplings: vec![CoupledColumn { column: 0, by: 1, factor: -1.0 }],
            ..JointStateCorrection::identity(2)
        };
        let [q, qd] = [vec![1.0, 0.25], vec![0.5, 0.125]];
        let track = JointTrack { t_s: vec![0.0], dof: 2, q, qd, noise: Vec::new() };
        let corrected = correction.apply(&track);
        assert_eq!((corrected.q, corrected.qd), (vec![0.5, 1.0], vec![0.25, 0.25]));

        // The driver is sampled at other times.
        let samples = |t_s: &[f64], position: &[f64]| JointSamples {
            t_s: t_s.into(),
            position: Cow::Owned(position.to_vec()),
            velocity: Cow::Owned(vec![0.0; t_s.len()]),
        };
        let driven = samples(&[0.0, 0.5, 1.0, 1.5], &[1.0; 4]);
        let corrected = correction.apply_to_samples(&[driven, samples(&[0.0, 1.0], &[0.0, 0.25])]);
        assert_eq!(*corrected[0].position, [1.0, 0.75, 0.5, 0.5]);
        assert_eq!(*corrected[1].position, [0.5, 1.0]);
    }
}
