//! Assembles a run from a decoded log.

mod arms;
mod assembly;
mod groups;
mod hands;
mod ranking;
mod references;
mod tool_poses;
mod trajectories;
mod transforms;

use std::borrow::Cow;
use std::sync::Arc;

use crate::geometry::Units;
use crate::log::{DeclaredPose, Log};
use crate::robot::{Robot, RobotError};
use crate::stream::Columns;
use crate::time::Stamp;

use super::arm::Arm;
use super::cadence::measure_rhythms;
use super::declaration::Declaration;
use super::error::RunError;
use super::joint_order;
use super::namespace::Namespace;
use super::norm_defects::{measure_norm_defects, release_values};
use super::resolve::resolve;
use super::role::Role;
use super::streams::{Stream, mark_shared_topics, split, tf_topics};
use super::tf_problems::detect_tf_problems;
use super::timing::Timing;
use super::topics;
use super::unwrap::{self, unwrap_joints};
use super::{Run, RunOptions};
use super::{given_calibrations, models};

use arms::{RobotInfo, joint_topics};
use assembly::Assembly;
use transforms::tf_tree;

pub(crate) use ranking::{MAX_TOOL_M, MIN_RESIDUAL_RATIO};
pub use references::{ReferenceContent, ReferenceSource};

impl Run {
    /// Assembles the run, lets `correct` change it, and resolves open roles by motion.
    ///
    /// # Errors
    /// As [`Run::assemble`], and the errors of `correct`.
    pub fn complete<E: From<RunError>>(
        log: Log,
        options: &RunOptions,
        correct: impl FnOnce(&mut Run) -> Result<(), E>,
    ) -> Result<Run, E> {
        let mut run = Run::assemble(log, options)?;
        correct(&mut run)?;
        resolve(&mut run, options.max_latency_s);
        Ok(run)
    }

    /// Assembles the run from names, types and frames.
    ///
    /// # Errors
    /// If the caller's options are invalid. Faults of the log itself are in [`Run::no_arm`].
    pub fn assemble(log: Log, options: &RunOptions) -> Result<Run, RunError> {
        let by_layouts = log.declared_poses();
        let options = &match by_layouts.as_slice() {
            [] => Cow::Borrowed(options),
            poses => Cow::Owned(options.clone().with_declared(poses.to_vec())),
        };
        let given = models::read_given_or_shared(options)?;
        let calibrations = given_calibrations::given(&options.calibrations)?;
        let has_clock_topic = log.has_clock();
        let mut topics_of_log = log.topics;
        let robots = models::robots_for_numbered_joints(&given, log.robot_type.as_deref());
        joint_order::name_numbered_joints(&mut topics_of_log, &robots);
        let mut streams = split(topics_of_log);
        for DeclaredPose { topic, units, .. } in &by_layouts {
            for stream in streams.iter_mut().filter(|stream| stream.topic == *topic) {
                let Units { length, angle } = stream.named_units;
                stream.named_units = Units {
                    length: length.filter(|_| units.length.is_none()),
                    angle: angle.filter(|_| units.angle.is_none()),
                };
            }
        }
        for declared in &options.declared {
            // A topic that only the config expects is a finding, not an error.
            let by_config = options.topics.iter().any(|info| info.is_of(&declared.topic));
            let has_columns =
                |stream: &Stream| declared.is_of(&stream.topic) && stream.columns.is_some();
            if !by_config || streams.iter().any(has_columns) {
                check_topic(declared, &streams)?;
            }
        }
        topics::apply(&options.topics, &mut streams)?;
        let wrapped = unwrap_joints(&mut streams);
        let timing = Timing::new(&mut streams, options.stamp, options.max_latency_s);
        let origin = origin(&streams);
        let tf = Arc::new(tf_tree(&streams, &timing, &Namespace::default()));
        let (attached, logged_calibrations): (Vec<_>, Vec<_>) =
            log.descriptions.into_iter().partition(|found| found.text.starts_with('<'));
        let descriptions = descriptions(&streams, attached);
        let unreadable = match options.robots.is_empty() {
            true => unreadable(&descriptions),
            false => Vec::new(),
        };
        let logged_calibrations: Vec<_> =
            logged_calibrations.into_iter().map(|found| (found.name, found.text)).collect();
        let mut assembly = Assembly {
            options,
            tf_topics: tf_topics(&streams),
            streams,
            timing,
            origin,
            tf,
            arms: Vec::new(),
            unmatched_joint_topics: Vec::new(),
            not_audited: Vec::new(),
            shared_streams: Vec::new(),
            frozen: Vec::new(),
            searched_for_frozen: Vec::new(),
        };
        let info = RobotInfo {
            given,
            calibrations,
            descriptions: &descriptions,
            logged_calibrations: &logged_calibrations,
            robot_type: log.robot_type.as_deref(),
            question: log.question,
        };
        let no_arm = match assembly.find_arms(&info) {
            Ok(()) => None,
            Err(error) if error.is_of_the_call() => return Err(error),
            Err(error) => Some(error),
        };
        let Assembly { streams, arms, tf, .. } = &assembly;
        topics::check_frames(&options.topics, streams, arms, tf)?;
        assembly.measured_transforms();
        if let Some(error) = &no_arm {
            assembly.compare_trajectories(error)?;
        }
        let is_replaced = |error: &RunError| {
            matches!(error, RunError::NoJointStates { .. }) && !assembly.arms.is_empty()
        };
        let no_arm = no_arm.filter(|error| !is_replaced(error));
        mark_shared_topics(&mut assembly.streams);
        for stream in 0..assembly.streams.len() {
            assembly.assign(stream)?;
        }
        assembly.assign_joint_topics();
        unwrap::add_remarks(&mut assembly.streams, &wrapped);
        append_column_reasons(&mut assembly.streams);
        let (targets, references) = (assembly.targets(), assembly.references());
        assembly.clear_unused_targets(&targets);
        let Assembly {
            mut streams,
            timing,
            tf,
            arms,
            not_audited,
            shared_streams,
            frozen,
            searched_for_frozen,
            ..
        } = assembly;
        let span = span(streams.iter().filter(|stream| stream.rate_hz.is_some()));
        let tf_problems = detect_tf_problems(&streams, &timing.sample_filter.publishers);
        let norm_defects = measure_norm_defects(&streams, &timing.clocks);
        release_values(&mut streams, &norm_defects);
        let rhythms = measure_rhythms(&streams, &timing, &joint_topics(&streams, &timing), &arms);
        let Timing { clocks, excerpts, sample_filter } = timing;
        Ok(Run {
            declared: options.declared.clone(),
            origin,
            span,
            streams,
            arms,
            targets,
            references,
            tf,
            clocks: clocks.all,
            rounded: clocks.rounded,
            rhythms,
            tf_problems,
            wrapped,
            norm_defects,
            shared_streams,
            not_audited,
            leaders: Vec::new(),
            undecided: Vec::new(),
            frozen: sample_filter
                .stale
                .iter()
                .map(|found| found.frozen.clone())
                .chain(frozen)
                .collect(),
            tool_switching: Vec::new(),
            sample_filter,
            searched_for_frozen,
            excerpts,
            has_clock_topic,
            no_arm,
            unreadable,
        })
    }
}

fn append_column_reasons(streams: &mut [Stream]) {
    for stream in streams {
        if let Some(read_as) = &stream.read_as {
            stream.reason += &format!("; {read_as}");
        }
    }
}

fn check_topic(declared: &Declaration, streams: &[Stream]) -> Result<(), RunError> {
    let is_pose =
        |stream: &&Stream| matches!(stream.columns, Some(Columns::Poses(_) | Columns::Array(_)));
    let of_topic = || streams.iter().filter(|stream| declared.is_of(&stream.topic));
    let what = match (of_topic().count(), of_topic().any(|stream| is_pose(&stream))) {
        (0, _) => "the log has no such topic",
        (_, false) => "the topic has no poses",
        (_, true) => return Ok(()),
    };
    Err(declaration_error(declared, what.to_owned()))
}

fn declaration_error(declared: &Declaration, what: String) -> RunError {
    let remedy = "check the topic's name and type with `poseaudit info`";
    RunError::Declared { place: declared.place.clone(), what, remedy }
}

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

fn descriptions(
    streams: &[Stream],
    attached: Vec<crate::log::Description>,
) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for stream in streams.iter().filter(|stream| stream.role == Role::Description) {
        if let Some(Columns::Text(texts)) = &stream.columns {
            let mut own: Vec<&String> = texts.text.iter().collect();
            own.dedup();
            found.extend(own.into_iter().map(|text| (stream.topic.clone(), text.clone())));
        }
    }
    found.extend(attached.into_iter().map(|description| (description.name, description.text)));
    found
}

fn unreadable(descriptions: &[(String, String)]) -> Vec<(String, RobotError)> {
    let refused = |(place, text): &(String, String)| {
        Some((place.clone(), Robot::from_text(text, place).err()?))
    };
    let mut refused: Vec<_> = descriptions.iter().filter_map(refused).collect();
    refused.dedup_by(|later, first| later.0 == first.0);
    refused
}

impl Assembly<'_> {
    /// Standard error of a part's stamps against the joint states, s. Copied stamps are of one clock and have none, unless it
    /// is coarse and made them equal.
    fn stamp_error_s(&self, arm: &Arm, stream: usize, piece: usize, are_copied: bool) -> f64 {
        if are_copied && self.timing.clocks.rounded_stamps(stream, piece).is_none() {
            return 0.0;
        }
        let joints = arm.joint_sources.first().map(|joint| joint.stream);
        let trajectory = || arm.trajectory.as_ref().map(|trajectory| trajectory.stream);
        let joints = joints.or_else(trajectory).unwrap_or(stream);
        let (clocks, parts) = (&self.timing.clocks, [(joints, 0), (stream, piece)]);
        match are_copied {
            true => clocks.rounding_error_s(parts[0], parts[1]),
            false => clocks.alignment_error_s(parts[0], parts[1]),
        }
    }

    fn assign(&mut self, stream: usize) -> Result<(), RunError> {
        let is_it = |arm: &Arm| arm.trajectory.as_ref().is_some_and(|one| one.stream == stream);
        if self.arms.iter().any(is_it) {
            return Ok(());
        }
        match &self.streams[stream].columns {
            Some(Columns::Poses(_) | Columns::Array(_)) => self.assign_pose(stream)?,
            Some(Columns::Imu(_)) => self.assign_imu(stream),
            Some(Columns::Transforms(_)) if self.streams[stream].role == Role::Tf => {
                self.assign_tf(stream);
            }
            _ => {}
        }
        Ok(())
    }
}
