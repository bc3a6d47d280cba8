//! What joins a run's candidates to the estimator that says whether they follow the arm, or lead it.

use crate::audit::{imu_stream, pose_stream};
use crate::diagnosis::{Peak, diagnose_imu, follows};
use crate::run::{Arm, PoseSource, Role, Run};

/// Settles which candidates are tool poses, by whether they follow the arm.
pub(crate) fn settle_candidates(run: &mut Run, most_lag_s: f64) {
    let candidates: Vec<usize> = run.candidates().collect();
    for candidate in candidates {
        let source = run
            .arms
            .iter()
            .flat_map(|arm| arm.poses.iter().map(move |source| (arm, source)))
            .find(|(_, source)| source.stream == candidate);
        let peak = source
            .and_then(|(arm, source)| follows(&arm.joints, &pose_stream(run, source), most_lag_s));
        let lead_s = source
            .zip(peak)
            .and_then(|((arm, source), peak)| lead_s(run, arm, source, peak, most_lag_s));
        match lead_s {
            Some(lead_s) => run.settle_leader(candidate, lead_s),
            None => run.settle(candidate, peak.map(|peak| peak.correlation)),
        }
    }
}

/// By how much a stream leads its arm, s, where it does.
///
/// What is measured on an arm cannot be received before the arm did it. Stamps that run ahead of their
/// clock make a stream early, and its messages come with the others all the same; joint states that are
/// late make all other streams early.
fn lead_s(run: &Run, arm: &Arm, source: &PoseSource, peak: Peak, most_lag_s: f64) -> Option<f64> {
    /// Shorter leads are stamps, transport and filters, s.
    const LEAST_S: f64 = 0.04;
    /// Speeds of a stream that leads correlate as well as those of one that follows.
    const LEADS: f64 = 0.7;
    let joints = arm.joint_facts.first()?.stream;
    let delay_s = |stream: usize| {
        let clock = run.clocks.iter().find(|clock| clock.stream == stream);
        clock.and_then(|clock| clock.log_minus_header_s).unwrap_or(0.0)
    };
    let received_s = peak.lag_s + delay_s(source.stream) - delay_s(joints);
    if peak.correlation < LEADS || peak.lag_s > -LEAST_S || received_s > -LEAST_S {
        return None;
    }
    let is_as_early = |lag_s: f64| lag_s < 0.5 * peak.lag_s;
    let poses_agree = arm
        .poses
        .iter()
        .filter(|other| run.streams[other.stream].role == Role::Pose)
        .filter_map(|other| follows(&arm.joints, &pose_stream(run, other), most_lag_s))
        .any(|other| other.correlation >= LEADS && is_as_early(other.lag_s));
    let imus_agree = || {
        arm.imus.iter().any(|imu| {
            let found = diagnose_imu(&arm.joints, &imu_stream(imu), most_lag_s);
            found.latency_s.is_ok_and(|latency| is_as_early(latency.value))
        })
    };
    (!poses_agree && !imus_agree()).then_some(-received_s)
}
