//! Assembles a recording from a run, its estimates and the report.

use super::{
    ReceiveTimes, Recording, Replay, ReplayArm, ReplayImu, ReplayStream, StreamKind, write,
};
use crate::audit::Audited;
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::geometry::Pose;
use crate::places::PathRegistry;
use crate::report::{NoteRow, Plots, Trouble};
use crate::run::{Arm, PoseSource, Run};
use crate::time::Stamp;

impl Recording {
    /// Registers the output file and its inputs.
    pub fn register_outputs(&self, places: &mut PathRegistry) {
        self.mesh_roots.iter().for_each(|root| places.add_mesh_folder(root));
        self.base.iter().for_each(|base| places.add_input("--rrd-layer", base));
        places.add_output("--rrd", &self.path);
    }
}

impl Audited {
    /// Writes the recording. The report then notes the meshes that were not found.
    ///
    /// # Errors
    /// If it cannot be written or would replace an input file.
    pub fn record(&mut self, recording: &Recording) -> Result<(), Trouble> {
        self.read.check_with(|places| recording.register_outputs(places))?;
        let is_pictured = self.report.figures.is_some();
        if !is_pictured {
            self.report.figures = Some(self.figures(Plots::All));
        }
        let Self { report, run, evidence, .. } = self;
        let arms = run.arms.iter().zip(&evidence.robots);
        let replay = Replay {
            origin: run.origin,
            span: run.span.unwrap_or((run.origin, run.origin)),
            arms: arms.map(|(arm, facts)| replay_arm(run, arm, facts)).collect(),
            report,
        };
        let path = &recording.path;
        let written = write(recording, &replay);
        if !is_pictured {
            report.figures = None;
        }
        let notes = written.map_err(|error| {
            let remedy = "set --rrd to a writable file";
            Trouble::call(path.display(), error.cause, remedy)
        })?;
        let notes = notes.into_iter().map(|note| NoteRow { path: path.clone(), note });
        report.log.notes.extend(notes);
        Ok(())
    }
}

fn replay_arm<'a>(run: &Run, arm: &'a Arm, facts: &'a ArmEvidence) -> ReplayArm<'a> {
    let stream = |kind, source: &PoseSource, facts: &'a StreamEvidence<PoseEvidence>| {
        let found = &facts.diagnosis;
        let base_from_reference = base_from_link(arm, source.chain.base_name());
        ReplayStream {
            topic: facts.topic(),
            kind,
            aligned: &found.aligned,
            received: receive_times(run, source.stream),
            base_from_reference: base_from_reference.unwrap_or_default(),
            reference_known: facts.reference_known && base_from_reference.is_some(),
            latency_s: found.latency_s.as_ref().map_or(0.0, |latency| latency.value),
        }
    };
    let poses = arm.poses.iter().zip(&facts.poses);
    let poses = poses.map(|(source, facts)| stream(StreamKind::Pose, source, facts));
    let tf = arm.tf.iter().zip(&facts.tf);
    let tf = tf.map(|(source, facts)| stream(StreamKind::Tf, source, facts));
    let imus = arm.imus.iter().zip(&facts.imus);
    ReplayArm {
        name: &arm.name,
        robot: &arm.robot,
        chain: &arm.chain,
        columns: &arm.columns,
        received: arm
            .joint_sources
            .first()
            .map_or_else(ReceiveTimes::default, |joint| receive_times(run, joint.stream)),
        recorded: arm.recorded_joints.as_ref().unwrap_or(&arm.joints),
        corrected: facts.diagnosis.corrected_joints(&arm.joints, &arm.are_prismatic()),
        streams: poses.chain(tf).collect(),
        imus: imus
            .map(|(source, facts)| ReplayImu {
                topic: facts.topic(),
                received: receive_times(run, source.stream),
                yaw_error: &facts.diagnosis.yaw_error,
            })
            .collect(),
    }
}

fn receive_times(run: &Run, stream: usize) -> ReceiveTimes {
    let clock = run.clocks_of(stream).first();
    let Some((clock, stream)) = clock.zip(run.streams.get(stream)) else {
        return ReceiveTimes::default();
    };
    let rows = stream.times().into_iter().flat_map(|times| {
        clock.rows_of(times).map(|(stamp, row)| (stamp, Stamp::from_nanos(times.log[row])))
    });
    ReceiveTimes::new(rows.collect())
}

/// In the base of an arm's chain. `None` if the link moves.
fn base_from_link(arm: &Arm, link: &str) -> Option<Pose> {
    let base = arm.robot.link(arm.chain.base_name())?;
    arm.robot.fixed_transform(base, arm.robot.link(link)?)
}
