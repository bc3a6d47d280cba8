use super::poses::PoseEvidence;
use super::{StreamEvidence, arm_stream_evidence, stream_span};
use crate::diagnosis::{
    AlignedSamples, CommandDelay, CommandDiagnosis, CommandedArm, Commands, EstimateResult,
    PoseDiagnosis, PoseSeries, diagnose_commands, estimate_joint_delays, estimate_pose_delay,
    infer_joint_order,
};
use crate::finding::Subject;
use crate::geometry::Pose;
use crate::run::{Arm, PoseSource, ReferenceContent, ReferenceSource, Role, Run};
use crate::stream::{Columns, JointColumn, JointColumns, JointTrack};

/// One command stream.
#[derive(Clone, Debug)]
pub struct ReferenceEvidence {
    /// Commands joints rather than poses.
    pub is_of_joints: bool,
    /// The commanded link is declared; otherwise it may be an active TCP.
    pub is_tip_declared: bool,
    /// The frame of the commanded poses is declared.
    pub is_frame_declared: bool,
    /// Actual tip poses, one per entry of the gaps and of a line's observations.
    pub tip_poses: Vec<TipPoseSource>,
    /// Diagnosis, or why the commands cannot be compared with the arm.
    pub diagnosis: Result<EstimateResult<CommandDiagnosis>, String>,
    /// From command to state, per commanded joint or for the tip. Empty if the commands cannot be compared.
    pub delays: Vec<CommandDelay>,
}

/// Source of the actual tip pose.
#[derive(Clone, Debug)]
pub struct TipPoseSource {
    /// Topic, or another display name.
    pub name: String,
    /// Kind of its poses.
    pub kind: TipPoseKind,
}

/// Kind of a source's poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TipPoseKind {
    /// FK of the joint states.
    Kinematics,
    /// Pose stream after correction.
    Corrected,
    /// Pose stream as logged.
    AsLogged,
}

/// Joint commands without an arm model, compared with joint states of the same names.
#[derive(Clone, Debug)]
pub struct UnmodelledCommands {
    /// Joint names.
    pub joints: Vec<String>,
    /// Delay from command to state, per joint.
    pub delays: Vec<CommandDelay>,
    /// The joint states were read as degrees by their size only.
    pub is_in_degrees_by_magnitude: bool,
}

pub(super) fn unmodelled_commands(
    run: &Run,
    max_lag_s: f64,
) -> Vec<StreamEvidence<UnmodelledCommands>> {
    if run.no_arm.is_none() {
        return Vec::new();
    }
    let of_role = |role: Role| {
        let streams = run.streams.iter().enumerate().filter(move |(_, own)| own.role == role);
        streams.filter_map(|(index, own)| match &own.columns {
            Some(Columns::Joints(joints)) => Some((index, joints)),
            _ => None,
        })
    };
    let of = |(index, commands): (usize, &JointColumns)| {
        let shared = |states: &JointColumns| -> Vec<(usize, usize)> {
            let place = |joint: &JointColumn| {
                states.joints.iter().position(|other| other.name == joint.name)
            };
            let own = commands.joints.iter().enumerate();
            own.filter_map(|(at, joint)| Some((at, place(joint)?))).collect()
        };
        let states = of_role(Role::Joints).map(|(state, joints)| (state, joints, shared(joints)));
        let (state, states, pairs) = states.max_by_key(|(_, _, pairs)| pairs.len())?;
        let (command_places, state_places): (Vec<usize>, Vec<usize>) = pairs.into_iter().unzip();
        let (t_s, q) = rows_of(run, index, commands, &command_places)?;
        let (state_t_s, state_q) = rows_of(run, state, states, &state_places)?;
        let dof = state_places.len();
        let qd = vec![0.0; state_q.len()];
        let joints = JointTrack { t_s: state_t_s, dof, q: state_q, qd, noise: Vec::new() };
        let order: Vec<usize> = (0..dof).collect();
        let names = state_places.iter().map(|&at| states.joints[at].name.clone());
        let value = UnmodelledCommands {
            joints: names.collect(),
            delays: estimate_joint_delays(&t_s, &order, &q, &joints, max_lag_s),
            is_in_degrees_by_magnitude: states.converted_from_degrees,
        };
        let topic = Some(run.streams[index].topic.clone());
        let subject = Subject { topic, ..Subject::default() };
        Some(StreamEvidence { subject, span: stream_span(run, index), value })
    };
    of_role(Role::Reference).filter_map(of).collect()
}

/// Increasing times from the run's origin, and row-major positions of the joints at `places`.
fn rows_of(
    run: &Run,
    stream: usize,
    joints: &JointColumns,
    places: &[usize],
) -> Option<(Vec<f64>, Vec<f64>)> {
    let clock = run.clocks_of(stream).first()?;
    let (mut t_s, mut q): (Vec<f64>, Vec<f64>) = Default::default();
    for row in 0..joints.times.len() {
        let Some(stamp) = clock.stamp_of(&joints.times, row) else { continue };
        let at_s = stamp.seconds_since(run.origin);
        let own = places.iter().map(|&at| joints.joints[at].position[row]);
        if t_s.last().is_none_or(|last| at_s > *last) && own.clone().all(f64::is_finite) {
            t_s.push(at_s);
            q.extend(own);
        }
    }
    (!q.is_empty()).then_some((t_s, q))
}

pub(super) fn references(
    run: &Run,
    index: usize,
    poses: &[StreamEvidence<PoseEvidence>],
    max_lag_s: f64,
) -> Vec<StreamEvidence<ReferenceEvidence>> {
    let Some(arm) = run.arms.get(index) else { return Vec::new() };
    let sources: Vec<&ReferenceSource> =
        run.references.iter().filter(|source| source.arm == index).collect();
    if sources.is_empty() {
        return Vec::new();
    }
    let by_kinematics = PoseSeries::from_joints(&arm.joints, &arm.chain, &arm.columns);
    let kinematics =
        TipPoseSource { name: "FK of the joint states".to_owned(), kind: TipPoseKind::Kinematics };
    let of_joints = [(kinematics, by_kinematics)];
    let streams = arm.poses.iter().zip(poses);
    let of_streams: Vec<(TipPoseSource, PoseSeries)> = streams
        .flat_map(|(source, of)| tip_poses_of_stream(run, arm, source, &of.diagnosis))
        .collect();
    let found = sources.into_iter().map(|source| {
        let (is_of_joints, tip_named, frame_named) = match &source.content {
            Ok(ReferenceContent::Poses { tip_named, frame_named, .. }) => {
                (false, *tip_named, *frame_named)
            }
            Ok(ReferenceContent::Joints { .. }) => (true, true, true),
            Err(_) => (false, false, false),
        };
        // Joint commands are compared with joint states only: both have the same zeros.
        let others = if is_of_joints { [].as_slice() } else { of_streams.as_slice() };
        let (witnesses, series): (Vec<TipPoseSource>, Vec<PoseSeries>) =
            of_joints.iter().chain(others).cloned().unzip();
        let (diagnosis, delays) = match &source.content {
            Ok(content) => diagnose(arm, content, &series, max_lag_s)
                .map_or_else(|why| (Err(why), Vec::new()), |(found, delays)| (Ok(found), delays)),
            Err(why) => (Err(why.clone()), Vec::new()),
        };
        let found = ReferenceEvidence {
            is_of_joints,
            is_tip_declared: tip_named,
            is_frame_declared: frame_named,
            tip_poses: witnesses,
            diagnosis,
            delays,
        };
        StreamEvidence {
            span: stream_span(run, source.stream),
            ..arm_stream_evidence(run, arm, source.stream, found)
        }
    });
    found.collect()
}

/// The error is the reason why they cannot be compared.
fn diagnose(
    arm: &Arm,
    content: &ReferenceContent,
    witnesses: &[PoseSeries],
    max_lag_s: f64,
) -> Result<(EstimateResult<CommandDiagnosis>, Vec<CommandDelay>), String> {
    let (commands, mut delays) = match content {
        ReferenceContent::Poses { track, .. } => {
            let series = PoseSeries::from_track(track).ok_or("its rotations are bare numbers")?;
            let by_kinematics = witnesses.first();
            let delay = by_kinematics.map(|done| estimate_pose_delay(&series, done, max_lag_s));
            (Commands { series, joints: Vec::new() }, delay.into_iter().collect())
        }
        ReferenceContent::Joints { t_s, columns, q } => {
            let order = match columns {
                Some(columns) => columns.clone(),
                None => infer_joint_order(t_s, q, &arm.joints, &arm.joint_names, &arm.columns).ok_or(
                    "its values have no joint names and match the joints in none of the usual orders",
                )?,
            };
            let delays = estimate_joint_delays(t_s, &order, q, &arm.joints, max_lag_s);
            let chain = (&arm.chain, arm.columns.as_slice());
            (Commands::from_joints(t_s, &order, q, &arm.joints, chain), delays)
        }
    };
    let arm = CommandedArm { joints: &arm.joints, chain: &arm.chain, columns: &arm.columns };
    let found = diagnose_commands(&commands, &arm, witnesses, max_lag_s);
    for (column, map) in found.iter().flat_map(|found| &found.goal_maps) {
        let is_of_joint = |delay: &&mut CommandDelay| delay.joint == Some(*column);
        let goals = delays.iter_mut().filter(is_of_joint).filter(|delay| delay.is_of_goals());
        goals.for_each(|delay| delay.map = Some(*map));
    }
    let leads = |found: &CommandDiagnosis| !found.is_streamed || found.tracking.is_some();
    let is_unnamed = matches!(content, ReferenceContent::Joints { columns: None, .. });
    match &found {
        Ok(found) if is_unnamed && !leads(found) => {
            Err("its values have no joint names and do not lead the joint states".to_owned())
        }
        _ => Ok((found, delays)),
    }
}

/// Tip poses in the base, corrected and as logged. Both are corrected for latency.
fn tip_poses_of_stream(
    run: &Run,
    arm: &Arm,
    source: &PoseSource,
    found: &PoseDiagnosis,
) -> Vec<(TipPoseSource, PoseSeries)> {
    let link = |name: &str| arm.robot.link(name);
    let fixed = |a: &str, b: &str| arm.robot.fixed_transform(link(a)?, link(b)?);
    let base = fixed(arm.chain.base_name(), source.chain.base_name());
    let tip = fixed(source.chain.tip_name(), arm.chain.tip_name());
    let (Some(base_from_reference), Some(link_from_tip)) = (base, tip) else { return Vec::new() };
    if found.unusable_reason().is_some() || found.is_far_from_fk() {
        return Vec::new();
    }
    let latency_s = found.latency_s.as_ref().map_or(0.0, |latency| latency.value);
    let series = |poses: fn(&AlignedSamples) -> &Vec<Pose>| PoseSeries {
        t_s: found.aligned.t_s.iter().map(|t_s| t_s - latency_s).collect(),
        poses: poses(&found.aligned)
            .iter()
            .map(|pose| base_from_reference * pose * link_from_tip)
            .collect(),
    };
    let witness = |kind| TipPoseSource { name: run.streams[source.stream].topic.clone(), kind };
    let corrected = (witness(TipPoseKind::Corrected), series(|aligned| &aligned.corrected));
    let as_logged = (witness(TipPoseKind::AsLogged), series(|aligned| &aligned.logged));
    if source.reference_known { vec![corrected, as_logged] } else { vec![corrected] }
}
