//! Joins a run, what was estimated on it and the report to what the recording shows.

use polars::prelude::PolarsResult;

use crate::checks::{ArmFacts, Facts, Of, PoseFacts};
use crate::geometry::Pose;
use crate::replay::{
    self, Receipts, Recording, Replay, ReplayArm, ReplayImu, ReplayStream, StreamKind,
};
use crate::report::{NoteRow, Report, Trouble};
use crate::run::{Arm, PoseSource, Run};
use crate::tables::aligned_frame;
use crate::time::Stamp;

/// Writes the recording of an audited run; what the report is to say of it.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn record(
    recording: &Recording,
    run: &Run,
    facts: &Facts,
    report: &Report,
) -> Result<Vec<NoteRow>, Trouble> {
    let remedy = "name a file that can be written with --rrd";
    let trouble = |what| Trouble::unwritable(&recording.path, what, remedy);
    let arms = run.arms.iter().zip(&facts.robots).map(|(arm, facts)| replay_arm(run, arm, facts));
    let replay = Replay {
        origin: run.origin,
        span: run.span.unwrap_or((run.origin, run.origin)),
        arms: arms.collect::<Result<_, _>>().map_err(|error| trouble(error.to_string()))?,
        report,
    };
    let notes = replay::write(recording, &replay).map_err(|it| trouble(it.cause.to_string()))?;
    let path = &recording.path;
    Ok(notes.into_iter().map(|note| NoteRow { path: path.clone(), note }).collect())
}

fn replay_arm<'a>(run: &Run, arm: &'a Arm, facts: &'a ArmFacts) -> PolarsResult<ReplayArm<'a>> {
    let stream = |kind, source: &PoseSource, facts: &'a Of<PoseFacts>| {
        let found = &facts.diagnosis;
        let base_from_reference = base_from_link(arm, source.chain.base_name());
        Ok(ReplayStream {
            topic: facts.topic(),
            kind,
            frame: aligned_frame(&found.aligned, run.origin)?,
            received: receipts(run, source.stream),
            base_from_reference: base_from_reference.unwrap_or_default(),
            reference_known: facts.reference_known && base_from_reference.is_some(),
            latency_s: found.latency_s.as_ref().map_or(0.0, |latency| latency.value),
        })
    };
    let poses = arm.poses.iter().zip(&facts.poses);
    let poses = poses.map(|(source, facts)| stream(StreamKind::Pose, source, facts));
    let tf = arm.tf.iter().zip(&facts.tf);
    let tf = tf.map(|(source, facts)| stream(StreamKind::Tf, source, facts));
    let imus = arm.imus.iter().zip(&facts.imus);
    Ok(ReplayArm {
        name: &arm.name,
        robot: &arm.robot,
        chain: &arm.chain,
        columns: &arm.columns,
        received: arm
            .joint_facts
            .first()
            .map_or_else(Receipts::default, |joint| receipts(run, joint.stream)),
        recorded: arm.recorded.as_ref().map_or(&arm.joints, |(recorded, _)| recorded),
        corrected: facts.diagnosis.corrected_joints(&arm.joints, &arm.slides()),
        streams: poses.chain(tf).collect::<PolarsResult<_>>()?,
        imus: imus
            .map(|(source, facts)| ReplayImu {
                topic: facts.topic(),
                received: receipts(run, source.stream),
                yaw_error: &facts.diagnosis.yaw_error,
            })
            .collect(),
    })
}

/// When the recorder received the rows of a stream.
fn receipts(run: &Run, stream: usize) -> Receipts {
    let clock = run.clocks.iter().find(|clock| clock.stream == stream);
    let Some((clock, stream)) = clock.zip(run.streams.get(stream)) else {
        return Receipts::default();
    };
    let rows = stream.times().into_iter().flat_map(|times| {
        clock.rows_of(times).map(|(stamp, row)| (stamp, Stamp::from_nanos(times.log[row])))
    });
    Receipts::of(rows.collect())
}

/// The pose of a still link in the base of an arm's chain; `None` where it is not still there.
fn base_from_link(arm: &Arm, link: &str) -> Option<Pose> {
    let base = arm.robot.link(arm.chain.base_name())?;
    arm.robot.fixed_transform(base, arm.robot.link(link)?)
}
