//! The arms of a log: which robots it is about, and which joint states are whose.

use std::collections::BTreeSet;

use crate::stream::Columns;

use super::super::arm::{Arm, Ends};
use super::super::catalogued::Judges;
use super::super::error::RunError;
use super::super::joints::JointTopic;
use super::super::models::{self, Clues, Given, GivenCalibration};
use super::super::role::Role;
use super::super::skeleton;
use super::super::streams::{Stream, Timing};
use super::Assembly;
use super::transforms::{add_fixed_joints, misfit_m};

/// What the caller and the log say of the robots.
pub(super) struct Said<'a> {
    pub given: Vec<Given>,
    pub calibrations: Vec<GivenCalibration>,
    /// Text of each description and calibration in the log, after the name of where it was.
    pub descriptions: &'a [(String, String)],
    pub logged_calibrations: &'a [(String, String)],
}

impl Assembly<'_> {
    /// Finds the robots, cuts the arms out of them and follows the transforms along each.
    pub(super) fn find_arms(&mut self, said: Said<'_>) -> Result<(), RunError> {
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

    /// Says of every stream of joint states which joints the arms use, and which they do not.
    pub(super) fn name_joints(&mut self) {
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

/// The topics of joint states.
pub(super) fn joint_topics<'a>(streams: &'a [Stream], timing: &Timing) -> Vec<JointTopic<'a>> {
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
