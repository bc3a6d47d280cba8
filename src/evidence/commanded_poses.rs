//! Poses that are FK of the joint commands, not of the joint states.

use crate::diagnosis::{
    ArmDiagnosis, PoseDiagnosis, StreamResidual, diagnose_derived, infer_joint_order,
};
use crate::run::{Arm, PoseSource, PoseSourceKind, ReferenceContent, Run};
use crate::stream::JointTrack;

/// Streams of poses of an arm that its joint states leave unexplained, and FK of joint commands explains, with the topic of
/// the commands.
pub(super) fn commanded_poses(
    run: &Run,
    index: usize,
    found: &ArmDiagnosis,
    max_lag_s: f64,
) -> Vec<(usize, String)> {
    /// Residual against the joint states over that against the commands. The search for encodings of joints uses the same.
    const MIN_RESIDUAL_RATIO: f64 = 5.0;
    /// The measured motion may be the commanded one, later. Poses of the commands are computed in the same cycle.
    const MAX_LATENCY_S: f64 = 0.01;
    /// Calibrations of arms differ by about as much from their models.
    const MAX_RESIDUAL_M: f64 = 1e-3;
    if !found.is_unexplained() {
        return Vec::new();
    }
    let arm = &run.arms[index];
    let commands = run.references.iter().filter(|commands| commands.arm == index);
    let commands = commands.filter_map(|commands| {
        let track = command_track(arm, commands.content.as_ref().ok()?)?;
        Some((&run.streams[commands.stream].topic, track))
    });
    let commands: Vec<(&String, JointTrack)> = commands.collect();
    let residual_m = |residual: &StreamResidual| residual.combined_m();
    let is_commanded = |(source, found): (&PoseSource, &PoseDiagnosis)| {
        let stream = run.pose_stream(source);
        let measured_m = found.residual.as_ref().ok().map(residual_m)?;
        // A tracker measures the arm.
        if run.streams[source.stream].source_kind == Some(PoseSourceKind::External) {
            return None;
        }
        let explains = |(_, track): &&(&String, JointTrack)| {
            let commanded = diagnose_derived(track, None, &stream, max_lag_s);
            let commanded_m = commanded.residual.as_ref().map_or(f64::INFINITY, residual_m);
            let is_decoded = commanded.encoding.is_ok() || found.encoding.is_err();
            let is_simultaneous =
                commanded.latency_s.as_ref().is_ok_and(|it| it.value.abs() < MAX_LATENCY_S);
            is_decoded
                && is_simultaneous
                && commanded_m < MAX_RESIDUAL_M.min(measured_m / MIN_RESIDUAL_RATIO)
        };
        let (topic, _) = commands.iter().find(explains)?;
        Some((source.stream, (*topic).clone()))
    };
    arm.poses.iter().zip(&found.streams).filter_map(is_commanded).collect()
}

/// The commands as joint states of the arm. `None` if they do not contain all joints of its chain.
fn command_track(arm: &Arm, content: &ReferenceContent) -> Option<JointTrack> {
    let ReferenceContent::Joints { t_s, columns, q } = content else { return None };
    let order = match columns {
        Some(columns) => columns.clone(),
        None => infer_joint_order(t_s, q, &arm.joints, &arm.joint_names, &arm.columns)?,
    };
    let dof = arm.joints.dof;
    let is_complete = arm.columns.iter().all(|column| order.contains(column));
    let rows = t_s.iter().zip(q.chunks_exact(order.len().max(1)));
    let rows = rows.filter(|(_, row)| row.iter().all(|position| position.is_finite()));
    let (t_s, rows): (Vec<f64>, Vec<&[f64]>) = rows.map(|(t_s, row)| (*t_s, row)).unzip();
    if !is_complete || t_s.len() < 2 {
        return None;
    }
    let mut track = JointTrack { q: vec![0.0; t_s.len() * dof], dof, t_s, ..JointTrack::default() };
    track.qd.clone_from(&track.q);
    for (at, column) in order.into_iter().enumerate() {
        for row in 0..rows.len() {
            let (before, after) = (row.saturating_sub(1), (row + 1).min(rows.len() - 1));
            track.q[row * dof + column] = rows[row][at];
            track.qd[row * dof + column] =
                (rows[after][at] - rows[before][at]) / (track.t_s[after] - track.t_s[before]);
        }
    }
    Some(track)
}
