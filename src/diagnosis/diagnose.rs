//! Diagnosis of an arm's whole run.
//!
//! Constant causes are estimated after compensating a variable latency. Joint compliance, change points and a drift of
//! a frame compete to explain a remaining residual. The likeliest diagnosis wins.

use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::changes::{
    constant_frames_suffice, diagnose_with_changes, diagnose_with_drift,
    diagnose_with_recorded_changes,
};
use crate::compliance::{diagnose_scale_as_compliance, diagnose_with_compliance};
use crate::latency::compensation::{CompensatedRun, with_tracks};
use crate::residuals::comparison::has_slow_residual;
use crate::selection::evidence::{likeliest, log_bayes_factor};
use crate::{ArmDiagnosis, JointCompliance, PoseDiagnosis, PoseStream};
use ground::stream::JointTrack;

/// Diagnoses an arm's joint states and independent pose streams. `max_lag_s` is the largest latency to search.
pub fn diagnose_run(
    joints: &JointTrack,
    streams: &[PoseStream],
    is_prismatic: &[bool],
    max_lag_s: f64,
) -> ArmDiagnosis {
    let run = ArmRun { joints, streams, is_prismatic, max_lag_s };
    if let Some(by_changes) = diagnose_with_recorded_changes(&run) {
        // Between poses in one frame, a drift leaves some segments as logged.
        let constant = are_floating(streams).then(|| run.diagnose());
        return match constant.and_then(|constant| diagnose_with_drift(&run, &constant)) {
            Some(by_drift) if log_bayes_factor(&by_drift, &by_changes) > 0.0 => by_drift,
            _ => by_changes,
        };
    }
    let CompensatedRun { tracks, profiles, diagnosis } = CompensatedRun::new(&run);
    let streams = with_tracks(streams, &tracks);
    let run = ArmRun { streams: &streams, ..run };
    let (mut diagnosis, has_changes) =
        diagnose_with_varying_causes(&run, &diagnosis).unwrap_or((diagnosis, false));
    for (stream, compensated) in diagnosis.streams.iter_mut().zip(profiles) {
        match (&mut stream.latency_profile, compensated) {
            // Change points include further steps of the latency.
            (Ok(further), Ok(compensated)) if has_changes && !further.steps.is_empty() => {
                if let Some(all) = compensated.with_further_steps(further) {
                    *further = all;
                }
            }
            (profile, compensated) => *profile = compensated,
        }
    }
    diagnosis
}

/// Diagnosis with joint compliance, change points or a drift of a frame, and whether it has change points. `None` if
/// `constant` is likelier.
fn diagnose_with_varying_causes(
    run: &ArmRun,
    constant: &ArmDiagnosis,
) -> Option<(ArmDiagnosis, bool)> {
    let is_floating = are_floating(run.streams);
    let is_within_links = !is_floating && constant_frames_suffice(constant);
    // Link deviations look like sag, eccentricity, steps and drifts, but not like backlash.
    let is_distinct = |it: &ArmDiagnosis| {
        !is_within_links || it.joints.compliance.iter().all(JointCompliance::is_backlash)
    };
    let by_compliance = diagnose_scale_as_compliance(run, constant)
        .or_else(|| diagnose_with_compliance(run, constant).filter(is_distinct));
    if is_within_links {
        return by_compliance.map(|diagnosis| (diagnosis, false));
    }
    let is_sufficient = |it: &ArmDiagnosis| {
        !it.joints.compliance.is_empty() && !it.streams.iter().any(has_slow_residual)
    };
    // Backlash with few reversals resembles a changing zero or frame.
    let max_changes =
        if by_compliance.as_ref().is_some_and(is_sufficient) { 1 } else { usize::MAX };
    let by_changes = diagnose_with_changes(run, constant, max_changes);
    let (best, has_changes) = match (by_changes, by_compliance) {
        (Some(changes), Some(compliance)) if log_bayes_factor(&compliance, &changes) > 0.0 => {
            (Some(compliance), false)
        }
        (Some(changes), _) => (Some(changes), true),
        (None, compliance) => (compliance, false),
    };
    // Steps can imitate a drift.
    let are_steps = |stream: &PoseDiagnosis| is_floating && stream.has_changes();
    let is_open = best.as_ref().is_none_or(|best| {
        best.streams.iter().any(|stream| are_steps(stream) || has_slow_residual(stream))
    });
    let by_drift = if is_open { diagnose_with_drift(run, constant) } else { None };
    Some((likeliest(by_drift.into_iter().chain(best))?, has_changes))
}
