//! Evidence from joint states without kinematics, for arms without a model, such as humanoids and hands.

use super::arm::ArmEvidence;
use super::commands::UnmodelledCommands;
use super::joint_stamps::stamps_and_velocities;
use super::joints::{JointEvidence, JointMotion, position_step};
use super::{StreamEvidence, span_or_run};
use crate::diagnosis::{
    EstimateResult, JointDiagnosis, JointEncoding, JointSampleKind, VelocityDiagnosis,
    peak_acceleration,
};
use crate::run::{JointSamples, JointSource, Role, Run, RunError, VelocitySource};
use crate::stream::{Columns, JointColumn, JointColumns};

/// Velocities with a larger relative error do not show accelerations.
const MAX_VELOCITY_ERROR: f64 = 0.2;

/// Joint states of a log whose arm has no model. Empty if neither commands nor velocities can be judged, or if poses
/// without commands would stay unchecked.
pub(super) fn unmodelled_arms(
    run: &Run,
    commands: &[StreamEvidence<UnmodelledCommands>],
) -> Vec<ArmEvidence> {
    match &run.no_arm {
        Some(RunError::NoModel { .. }) => {}
        Some(RunError::Numbered { arms, best: None, .. }) if arms.is_empty() => {}
        _ => return Vec::new(),
    }
    let has_delay = commands.iter().any(|of| of.delays.iter().any(|delay| delay.response.is_ok()));
    let has_poses = run.streams.iter().any(|stream| {
        matches!(
            stream.columns,
            Some(Columns::Poses(_) | Columns::Transforms(_) | Columns::Array(_) | Columns::Imu(_))
        )
    });
    let streams = run.streams.iter().enumerate().filter(|(_, own)| own.role == Role::Joints);
    let arms: Vec<ArmEvidence> = streams
        .filter_map(|(index, own)| match &own.columns {
            Some(Columns::Joints(joints)) => Some(unmodelled_arm(run, index, joints)),
            _ => None,
        })
        .collect();
    let has_velocities =
        || arms.iter().flat_map(|arm| &arm.joints).any(|joint| joint.velocity.is_some());
    if has_delay || (!has_poses && has_velocities()) { arms } else { Vec::new() }
}

fn unmodelled_arm(run: &Run, stream: usize, columns: &JointColumns) -> ArmEvidence {
    let source = |joint: &JointColumn| JointSource {
        name: joint.name.clone(),
        stream,
        samples: columns.times.len(),
        velocities: VelocitySource::Derived,
    };
    let sources: Vec<JointSource> = columns.joints.iter().map(source).collect();
    let samples = run.joint_samples(&sources);
    let change_points = vec![Vec::new(); samples.len()];
    let (stamps, velocities) = stamps_and_velocities(&samples, &change_points);
    let joint = |((source, samples), velocity): (
        (&JointSource, &JointSamples<'_>),
        Option<EstimateResult<VelocityDiagnosis>>,
    )| {
        let JointSamples { t_s, position, velocity: logged } = samples;
        let is_consistent = velocity
            .as_ref()
            .and_then(|found| found.as_ref().ok())
            .is_some_and(|found| found.error.value < MAX_VELOCITY_ERROR);
        let abruptness = match is_consistent {
            true => peak_acceleration(t_s, logged, JointSampleKind::Velocities, 0.0),
            false => {
                let step = position_step(run, stream, samples);
                peak_acceleration(t_s, position, JointSampleKind::Positions, step)
            }
        };
        JointEvidence {
            name: source.name.clone(),
            is_prismatic: false,
            limits: Default::default(),
            motion: JointMotion { abruptness, ..JointMotion::default() },
            velocity,
            actual: None,
        }
    };
    let joints: Vec<JointEvidence> =
        sources.iter().zip(&samples).zip(velocities).map(joint).collect();
    ArmEvidence {
        name: String::new(),
        joints_topic: run.streams[stream].topic.clone(),
        is_trajectory: false,
        joint_clock: None,
        joint_topic: None,
        stamps,
        has_unknown_units: !run.streams[stream].cells.is_empty(),
        span: span_or_run(run, stream),
        joints,
        reach_m: 0.0,
        better_model: None,
        indistinguishable_models: Vec::new(),
        dh: None,
        diagnosis: JointDiagnosis::without_changes(
            Ok(JointEncoding::default()),
            Vec::new(),
            Vec::new(),
        ),
        poses: Vec::new(),
        tf: None,
        vibrations: Vec::new(),
        imus: Vec::new(),
        is_in_degrees_by_magnitude: columns.converted_from_degrees,
        is_converted_from_degrees: columns.converted_from_degrees,
        references: Vec::new(),
    }
}
