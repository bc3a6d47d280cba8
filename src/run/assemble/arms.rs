//! Finds the arms of a log: its robot models, and the joint states of each arm.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;

use crate::diagnosis::value_range;
use crate::robot::{LinkId, nearest};
use crate::stream::{Columns, JointColumn, JointColumns};

use super::super::arm::{Arm, ChainEnds};
use super::super::catalogue_selection::RankingCriteria;
use super::super::declaration::JointName;
use super::super::error::RunError;
use super::super::given_calibrations::{self, GivenCalibration};
use super::super::joints::JointTopic;
use super::super::model::{LogModel, ModelClues};
use super::super::models::{self, GivenRobot};
use super::super::namespace::{Namespace, NamespaceMatch};
use super::super::not_audited::{NotAudited, NotAuditedReason};
use super::super::role::{Role, is_outside_arm};
use super::super::skeleton::{self, ArmPath};
use super::super::streams::Stream;
use super::super::tf_tree::TfTree;
use super::super::timing::Timing;
use super::assembly::Assembly;
use super::groups::{JointStateGroup, group_joint_topics};
use super::ranking::PoseRanking;
use super::transforms::{add_fixed_joints, add_odometry, misfit_m, tf_tree};

pub(super) struct RobotInfo<'a> {
    pub given: Vec<GivenRobot>,
    pub calibrations: Vec<GivenCalibration>,
    pub descriptions: &'a [(String, String)],
    pub logged_calibrations: &'a [(String, String)],
    pub robot_type: Option<&'a str>,
    pub question: Option<String>,
}

impl Assembly<'_> {
    pub(super) fn find_arms(&mut self, info: &RobotInfo<'_>) -> Result<(), RunError> {
        let topics = filtered_joint_topics(&self.streams, &self.timing, self.options.max_latency_s);
        if joints_in(&topics).is_empty() {
            let is_command = |stream: &&Stream| {
                stream.role == Role::Reference && matches!(stream.columns, Some(Columns::Joints(_)))
            };
            let commands = self.streams.iter().filter(is_command);
            return Err(RunError::NoJointStates {
                commands: commands.map(|stream| stream.topic.clone()).collect(),
                question: info.question.clone(),
                is_of_tables: self.streams.iter().any(|stream| stream.is_from_table),
                is_robot_named: !info.given.is_empty(),
            });
        }
        let joints = joints_in(&topics);
        let is_missing = |mapped: &&JointName| !joints.contains(&mapped.logged);
        if let Some(mapped) = self.options.joint_map.iter().find(is_missing) {
            let near = nearest(&mapped.logged, joints.iter().map(String::as_str));
            let near =
                near.first().map_or(String::new(), |near| format!("; did you mean '{near}'?"));
            let what = format!("the log has no joint '{}'{near}", mapped.logged);
            return Err(RunError::JointMap { what });
        }
        let groups = group_joint_topics(&self.streams, topics, self.origin);
        let is_alone = groups.len() == 1;
        let (mut arms, mut strangers, mut refusal) = (Vec::new(), Vec::new(), None);
        for group in &groups {
            let mut tree = match is_alone {
                true => std::mem::take(&mut self.tf),
                false => Arc::new(tf_tree(&self.streams, &self.timing, &group.namespace)),
            };
            match self.build_arms(group, &mut tree, info) {
                Ok(found) => arms.extend(found),
                Err(error) => {
                    strangers.extend(group.joints.topics.iter().map(|topic| topic.stream));
                    refusal = refusal.or(Some(error));
                }
            }
            let is_of_group = |arm: &&mut Arm| arm.tree.frames().next().is_none();
            arms.iter_mut().filter(is_of_group).for_each(|arm| arm.tree = Arc::clone(&tree));
            if is_alone {
                self.tf = tree;
            }
        }
        drop(groups);
        if arms.is_empty() {
            return Err(refusal.unwrap_or(RunError::NoModel { logged: Vec::new() }));
        }
        make_names_unique(&mut arms);
        if !is_alone {
            let all = Arc::make_mut(&mut self.tf);
            arms.iter().for_each(|arm| add_fixed_joints(all, arm));
        }
        for arm in &mut arms {
            match self.follow_transforms(arm) {
                Ok((source, from_model)) => (arm.tf, arm.from_model) = (Ok(source), from_model),
                Err(reason) => arm.tf = Err(reason),
            }
        }
        (self.arms, self.unmatched_joint_topics) = (arms, strangers);
        Ok(())
    }

    /// Arms of a group of joint states. Adds the model's fixed joints and odometry to `tree`.
    fn build_arms(
        &self,
        group: &JointStateGroup<'_>,
        tree: &mut Arc<TfTree>,
        info: &RobotInfo<'_>,
    ) -> Result<Vec<Arm>, RunError> {
        let JointStateGroup { joints: states, namespace } = group;
        let is_own = |names: &[&str]| {
            namespace.match_names(names.iter().copied()) != NamespaceMatch::Foreign
        };
        let joints = joints_in(&states.topics);
        let streams = self.streams.iter().filter(|stream| is_own(&[&stream.topic]));
        let named = streams.flat_map(|stream| [&stream.frame_id, &stream.child_frame_id]);
        let frames: BTreeSet<String> =
            tree.frames().chain(named.map(String::as_str)).map(str::to_owned).collect();
        let of_group = |wanted: NamespaceMatch| {
            let descriptions = info.descriptions.iter();
            descriptions
                .filter(move |(place, _)| namespace.match_names([place.as_str()]) == wanted)
                .cloned()
        };
        let mut descriptions: Vec<(String, String)> = of_group(NamespaceMatch::Own).collect();
        if descriptions.is_empty() {
            descriptions = of_group(NamespaceMatch::Neutral).collect();
        }
        let clues = ModelClues {
            joints: &joints,
            frames: &frames,
            descriptions: &descriptions,
            calibrations: info.logged_calibrations,
            joint_map: &self.options.joint_map,
            namespace,
            robot_type: info.robot_type,
        };
        let poses = PoseRanking { assembly: self, group, tree };
        let criteria = RankingCriteria {
            by_transforms: &|model| misfit_m(tree, &model.robot, &model.frames),
            by_poses: &|models| poses.rank(models),
        };
        let mut models = models::select_models(&info.given, &clues, &criteria)?;
        given_calibrations::overlay_all(&mut models, &info.calibrations, &clues)?;
        for model in &mut models {
            model.competing = poses.find_competing_model(model, &clues);
        }
        let ends =
            ChainEnds { base: self.options.base.as_deref(), tip: self.options.tip.as_deref() };
        let (mut arms, mut refusal) = (Vec::new(), None);
        let is_logged = |name: &str| joints.iter().any(|joint| joint == name);
        for model in &models {
            let paths = skeleton::find_arm_paths(&model.robot, is_logged);
            for path in &paths {
                let on_positioner = self.with_positioner(model, path, &paths, group);
                let on_positioner =
                    on_positioner.and_then(|path| Arm::new(model, &path, ends, states).ok());
                match on_positioner.map_or_else(|| Arm::new(model, path, ends, states), Ok) {
                    Ok(arm) if arm.has_joint_of(path) => {
                        arms.push(Arm { namespace: namespace.clone(), ..arm });
                    }
                    Ok(_) => {}
                    Err(error) => refusal = refusal.or(Some(error)),
                }
            }
        }
        if arms.is_empty() {
            return Err(refusal.unwrap_or(RunError::NoModel { logged: joints }));
        }
        let tree = Arc::make_mut(tree);
        for arm in &arms {
            add_fixed_joints(tree, arm);
        }
        add_odometry(tree, &self.streams, &self.timing, &arms);
        Ok(arms)
    }

    /// `path` with the joints that move the frames of pose streams, if any, and if its topic has them.
    fn with_positioner(
        &self,
        model: &LogModel,
        path: &ArmPath,
        arms: &[ArmPath],
        JointStateGroup { joints, namespace }: &JointStateGroup<'_>,
    ) -> Option<ArmPath> {
        let own = path.joints.first()?;
        let topic = joints.topics.iter().find(|topic| topic.has_joint(own))?;
        let is_of_group = |stream: &&Stream| {
            matches!(stream.columns, Some(Columns::Poses(_)))
                && namespace.match_names([stream.topic.as_str()]) != NamespaceMatch::Foreign
        };
        let frames = self.streams.iter().filter(is_of_group).map(|stream| &stream.frame_id);
        let links: BTreeSet<LinkId> =
            frames.filter_map(|frame| model.frames.link_of(&model.robot, frame)).collect();
        let mut extended = path.clone();
        for link in links {
            let joints = skeleton::joints_of_positioner(&model.robot, link, arms, |name| {
                topic.has_joint(name)
            });
            let new = joints.into_iter().filter(|joint| !extended.joints.contains(joint));
            let new: Vec<String> = new.collect();
            extended.joints.extend(new);
        }
        (extended.joints.len() > path.joints.len()).then_some(extended)
    }

    /// Topics without joint names whose positions are those of an arm's topic.
    fn copied_joint_topics(&self) -> HashSet<usize> {
        let columns = |index: usize| match &self.streams[index].columns {
            Some(Columns::Joints(columns)) => Some(columns),
            _ => None,
        };
        let sources: HashSet<usize> =
            self.arms.iter().flat_map(|arm| &arm.joint_sources).map(|joint| joint.stream).collect();
        let is_copy = |own: &JointColumns, source: usize| {
            columns(source).is_some_and(|of| {
                let pairs = own.joints.iter().zip(&of.joints);
                own.joints.len() == of.joints.len()
                    && pairs.into_iter().all(|(own, of)| own.position == of.position)
            })
        };
        let unnamed = (0..self.streams.len()).filter(|index| !sources.contains(index));
        let unnamed = unnamed.filter_map(|index| Some((index, columns(index)?)));
        let copies = unnamed
            .filter(|(_, own)| own.unnamed && sources.iter().any(|&source| is_copy(own, source)));
        copies.map(|(index, _)| index).collect()
    }

    pub(super) fn assign_joint_topics(&mut self) {
        let arms = &self.arms;
        if arms.iter().all(|arm| arm.trajectory.is_some()) {
            return;
        }
        let copies = self.copied_joint_topics();
        for (index, stream) in self.streams.iter_mut().enumerate() {
            let (Role::Joints, Some(Columns::Joints(columns))) = (stream.role, &stream.columns)
            else {
                continue;
            };
            let reads = |arm: &Arm, name: &str| {
                arm.joint_sources.iter().any(|joint| joint.stream == index && joint.name == name)
            };
            let (used, ignored): (Vec<&str>, Vec<&str>) = columns
                .joints
                .iter()
                .map(|joint| joint.name.as_str())
                .partition(|name| arms.iter().any(|arm| reads(arm, name)));
            stream.arm = arms.iter().position(|arm| used.iter().any(|name| reads(arm, name)));
            let is_stranger = self.unmatched_joint_topics.contains(&index);
            let is_known =
                |joint: &JointColumn| arms.iter().any(|arm| arm.robot.joint(&joint.name).is_some());
            let unknown: Vec<&JointColumn> =
                columns.joints.iter().filter(|joint| is_stranger || !is_known(joint)).collect();
            if are_arm_joints(&unknown) && !copies.contains(&index) {
                let joints = unknown.iter().map(|joint| joint.name.clone()).collect();
                let why = NotAuditedReason::NoModel { joints };
                self.not_audited.push(NotAudited { stream: index, reason: why });
            }
            if used.is_empty() {
                stream.role = Role::Ignored;
                stream.reason =
                    "none of its joints moves an arm's tip, or another topic already provides them"
                        .to_owned();
            } else if !ignored.is_empty() {
                let ignored = ignored.join(", ");
                stream.reason = format!(
                    "joint states; ignored because they do not move an arm's tip: {ignored}"
                );
            }
        }
    }
}

/// Whether joints look like an arm's rather than a gripper's, wheels' or legs'.
fn are_arm_joints(joints: &[&JointColumn]) -> bool {
    const MIN_JOINTS: usize = 4;
    const MIN_MOTION: f64 = 0.02;
    let moves = |joint: &JointColumn| {
        value_range(joint.position.iter().copied().filter(|q| q.is_finite())) > MIN_MOTION
    };
    joints.iter().filter(|joint| moves(joint) && !is_outside_arm(&joint.name)).count() >= MIN_JOINTS
}

fn joints_in(topics: &[JointTopic<'_>]) -> Vec<String> {
    let mut known: HashSet<&str> = HashSet::new();
    let all = topics
        .iter()
        .flat_map(|topic| topic.columns.joints.iter().filter(|joint| topic.has_samples(joint)));
    let names = all.map(|joint| &joint.name).filter(|name| known.insert(name));
    names.cloned().collect()
}

/// Distinguishes arms of equal names by words of their topics, the tip or the first joint.
fn make_names_unique(arms: &mut [Arm]) {
    let is_double =
        |arms: &[Arm], arm: &Arm| arms.iter().filter(|other| other.name == arm.name).count() > 1;
    let labels: [fn(&Arm) -> Option<String>; 3] = [
        |arm| arm.namespace.label(),
        |arm| Some(arm.chain.tip_name().to_owned()),
        |arm| arm.joint_names.first().cloned(),
    ];
    for label in labels {
        let doubles: Vec<bool> = arms.iter().map(|arm| is_double(arms, arm)).collect();
        // A label that all share distinguishes nothing.
        let of_doubles = || arms.iter().zip(&doubles).filter(|(_, is_double)| **is_double);
        let first = of_doubles().next().and_then(|(arm, _)| label(arm));
        let shared =
            first.filter(|first| of_doubles().all(|(arm, _)| label(arm).as_ref() == Some(first)));
        for (arm, _) in arms.iter_mut().zip(doubles).filter(|(_, is_double)| *is_double) {
            if let Some(label) = label(arm).filter(|label| Some(label) != shared.as_ref()) {
                arm.name = format!("{} ({label})", arm.name);
            }
        }
    }
    let words: Vec<Vec<String>> =
        arms.iter().map(|arm| [arm.namespace.own.as_slice(), &arm.name_words()].concat()).collect();
    for (arm, namespace) in arms.iter_mut().zip(Namespace::from_words(&words)) {
        arm.namespace = namespace;
    }
}

pub(super) fn joint_topics<'a>(streams: &'a [Stream], timing: &Timing) -> Vec<JointTopic<'a>> {
    let with_columns = streams.iter().enumerate().filter_map(|(index, stream)| {
        let Some(Columns::Joints(columns)) = &stream.columns else { return None };
        (stream.role == Role::Joints).then_some((index, columns))
    });
    with_columns
        .map(|(stream, columns)| JointTopic {
            stream,
            columns,
            rows: timing.clocks.rows(streams, stream, 0),
        })
        .collect()
}

/// Joint state topics with the rows used for estimation. They extend beyond other streams by the maximum
/// latency.
fn filtered_joint_topics<'a>(
    streams: &'a [Stream],
    timing: &Timing,
    max_lag_s: f64,
) -> Vec<JointTopic<'a>> {
    let mut topics = joint_topics(streams, timing);
    for topic in &mut topics {
        topic.rows = timing.filtered_rows(streams, topic.stream, 0, max_lag_s);
    }
    topics
}
