//! Causes that step or drift: a slipped tool, a moved base, a tracker's or SLAM's world, a marker that creeps, a joint zero
//! that is lost or warms up, a radial scale.
//!
//! All changes are fitted to the residuals of all streams, together with constant causes and link deviations. Their
//! effect is removed from joint states and poses, and the run is diagnosed again.

use super::change::Change;
use super::change_search::likeliest_changes;
use super::removal::{Removal, remove};
use crate::ArmDiagnosis;
use crate::arm_run::ArmRun;
use crate::compliance::{apply_compliance, diagnose_with_compliance, has_unusual_compliance};
use crate::latency::compensation::with_tracks;
use crate::residuals::comparison::restore_recorded;
use crate::selection::evidence::likeliest;

/// Diagnoses the run with the changes of its causes removed, and reports them, with joint compliance if that is likelier.
/// `diagnosis` is of the uncorrected run. `None` if nothing changes.
pub(crate) fn diagnose_with_cause_changes(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let changes = likeliest_changes(run, diagnosis)?;
    let alone = remove(run, diagnosis, &changes).and_then(|it| it.reported(run, diagnosis));
    likeliest(alone.into_iter().chain(diagnose_beside_compliance(run, diagnosis, changes)))
}

/// With joint compliance, which resembles changes of joint zeros. Removes the changes of frames and radial scales to
/// estimate compliance, then removes compliance to estimate all changes. `None` without compliance or without such changes.
fn diagnose_beside_compliance(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
    mut changes: Vec<Change>,
) -> Option<ArmDiagnosis> {
    const ROUNDS: usize = 2;
    for round in 1.. {
        let (of_streams, of_joints): (Vec<Change>, Vec<Change>) =
            changes.into_iter().partition(|change| change.subject.stream().is_some());
        if of_streams.is_empty() {
            break;
        }
        let Removal { tracks, after, .. } = remove(run, diagnosis, &of_streams)?;
        let streams = with_tracks(run.streams, &tracks);
        let steady = ArmRun { streams: &streams, ..*run };
        let with = diagnose_with_compliance(&steady, &after, has_unusual_compliance)?;
        let compliance = with.joints.compliance;
        let mut joints = run.joints.clone();
        apply_compliance(&mut joints, &compliance);
        let rigid = ArmRun { joints: &joints, ..*run };
        let constant = rigid.diagnose_again(diagnosis);
        changes = likeliest_changes(&rigid, &constant)?;
        if of_joints.is_empty() || round == ROUNDS {
            let mut found = remove(&rigid, &constant, &changes)?.reported(&rigid, &constant)?;
            found.joints.compliance = compliance;
            let streams = run.streams.iter().zip(&mut found.streams);
            streams.for_each(|(stream, found)| restore_recorded(run.joints, stream, found));
            return Some(found);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use crate::test_motion;
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, Confounder, Course, PoseStream, diagnose_run};
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};

    /// Diagnosis of poses of the deviating arm in a world and a marker frame that are unknown, with 0.1 mm of noise.
    fn diagnosed(link_m: f64, changes: impl Fn(f64) -> [Vec3; 2]) -> ArmDiagnosis {
        let (joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(link_m);
        let world = pose([0.4, -1.1, 0.7], rotation_from_rotvec(Vec3::new(0.1, 0.2, 1.3)));
        let marker = pose([0.02, 0.01, 0.06], rotation_from_rotvec(Vec3::new(0.3, -0.2, 0.5)));
        let shift = |by: Vec3| Pose::from_parts(by.into(), Rotation::identity());
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
            let [of_base, of_tool] = changes(t_s).map(shift);
            let mut logged = world * of_base * deviating.forward(q) * marker * of_tool;
            logged.translation.vector += Vec3::from(random.triple(1e-4));
            (logged.translation.vector, logged.rotation)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        let stream =
            PoseStream { reference_known: false, ..test_motion::tip_stream(&track, &chain) };
        diagnose_run(&joints, &[stream], &[false; 6], 1.0)
    }

    /// Diagnosis of the deviating arm's poses, whose joints report less by this many degrees.
    fn diagnosed_zeros(link_m: f64, missing: impl Fn(f64, usize) -> f64) -> ArmDiagnosis {
        let (mut joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(link_m);
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| deviating.forward(q));
        let poses = poses.map(|pose| {
            let [shift, turn] = [2e-5, 2e-5].map(|size| random.triple(size));
            let turn = rotation_from_rotvec(turn.into());
            (pose.translation.vector + Vec3::from(shift), turn * pose.rotation)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        for (row, q) in joints.q.chunks_mut(6).enumerate() {
            let t_s = joints.t_s[row];
            q.iter_mut().enumerate().for_each(|(joint, q)| *q -= missing(t_s, joint).to_radians());
        }
        diagnose_run(&joints, &[test_motion::tip_stream(&track, &chain)], &[false; 6], 1.0)
    }

    #[test]
    fn a_long_tool_in_mid_run_is_no_scale() {
        let (joints, chain) = test_motion::arm();
        for at_s in [6.0, 9.0, 14.0] {
            let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
                let tool = Vec3::new(0.0, 0.0, if t_s > at_s { 0.12 } else { 0.0 });
                let pose = chain.forward(q) * Pose::from_parts(tool.into(), Rotation::identity());
                (pose.translation.vector, pose.rotation)
            });
            let track = test_motion::pose_track(&joints.t_s, poses);
            let stream = test_motion::tip_stream(&track, &chain);
            let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
            let [change] = found.streams[0].tool_changes.as_slice() else {
                panic!("{at_s}: {:?}", found.streams[0])
            };
            let size = &change.size.translation_m;
            assert!((size.value - 0.12).abs() < 1e-4, "{at_s}: {size:?}");
        }
    }

    #[test]
    fn a_small_step_of_a_joint_zero_is_measured() {
        for link_m in LINK_M {
            let step = |t_s: f64, joint| if joint == 2 && t_s > 11.0 { 0.15 } else { 0.0 };
            let found = diagnosed_zeros(link_m, step).joints;
            let [change] = found.changes.as_slice() else {
                panic!("{link_m}: {:?}", found.changes)
            };
            let zero = &change.change;
            let is_right = (zero.size.value.to_degrees() - 0.15).abs() < 0.01
                && change.column == 2
                && (zero.at_s - 11.0).abs() < 0.1;
            assert!(is_right, "{link_m}: {change:?}");
        }
    }

    #[test]
    fn a_step_of_the_last_zero_that_joint_states_show_is_no_turn_of_the_tool() {
        for link_m in LINK_M {
            let found = diagnosed_zeros(
                link_m,
                |t_s, joint| if joint == 5 && t_s > 11.0 { 0.7 } else { 0.0 },
            );
            let [change] = found.joints.changes.as_slice() else {
                panic!("{link_m}: {:?} {:?}", found.joints.changes, found.streams[0].tool_changes)
            };
            let zero = &change.change;
            let is_right = change.column == 5
                && (zero.size.value.to_degrees() - 0.7).abs() < 0.01
                && (zero.from, zero.to) == (0.0, zero.size.value);
            assert!(is_right, "{link_m}: {change:?}");
            assert!(found.streams[0].tool_changes.is_empty(), "{link_m}");
            let twins = &found.joints.offsets[5].confounders;
            assert!(matches!(twins.as_slice(), [Confounder::Tool(0, _)]), "{link_m}: {twins:?}");
        }
    }

    #[test]
    fn a_joint_zero_that_warms_up_is_measured() {
        let settling = |t_s: f64, tau_s: f64| 1.0 - (-t_s / tau_s).exp();
        for link_m in LINK_M {
            for tau_s in [4.0, 9.0] {
                let drift = |t_s, joint| if joint == 3 { 0.4 * settling(t_s, tau_s) } else { 0.0 };
                let found = diagnosed_zeros(link_m, drift).joints;
                let [change] = found.changes.as_slice() else {
                    panic!("{link_m} {tau_s}: {:?}", found.changes)
                };
                let zero = &change.change;
                let span_s = zero.at_s + zero.within_s;
                let is_right = change.column == 3
                    && (zero.size.value.to_degrees() - 0.4 * settling(span_s, tau_s)).abs() < 0.02
                    && matches!(zero.course, Course::Settling(found_s) if (found_s / tau_s - 1.0).abs() < 0.15);
                assert!(is_right, "{link_m} {tau_s}: {change:?}");
            }
        }
    }

    #[test]
    fn a_tool_that_slips_gradually_is_measured() {
        for link_m in LINK_M {
            let slip = |t_s: f64| Vec3::new(0.0, 4e-3, 3e-3) * ((t_s - 6.0) / 5.0).clamp(0.0, 1.0);
            let found = diagnosed(link_m, |t_s| [Vec3::zeros(), slip(t_s)]);
            let [change] = found.streams[0].tool_changes.as_slice() else {
                panic!("{link_m}: {:?}", found.streams[0].tool_changes)
            };
            let is_right = change.course == Course::Ramp
                && (change.size.translation_m.value - 5e-3).abs() < 2e-4
                && (change.at_s - 8.5).abs() < 0.2
                && (change.within_s - 2.5).abs() < 0.2;
            assert!(is_right, "{link_m}: {change:?}");
        }
    }

    #[test]
    fn three_zeros_lost_at_once_are_measured() {
        let lost = [0.0, 1.2, 1.4, 0.0, -1.1, 0.0];
        let step = |t_s: f64, joint: usize| if t_s > 8.0 { lost[joint] } else { 0.0 };
        for link_m in [0.0, 1e-4] {
            let found = diagnosed_zeros(link_m, step);
            let mut changes: Vec<(usize, f64)> = Vec::new();
            for change in &found.joints.changes {
                let zero = &change.change;
                changes.push((change.column, zero.size.value.to_degrees()));
            }
            changes.sort_by_key(|change| change.0);
            let is_near = changes.len() == 3
                && changes.iter().all(|(column, size)| (size - lost[*column]).abs() < 0.02);
            assert!(is_near, "{link_m}: {changes:?}");
            let stream = &found.streams[0];
            let frames = (&stream.reference_changes, &stream.tool_changes);
            assert!(!stream.has_changes(), "{link_m}: {frames:?} {:?}", stream.encoding_spans);
        }
    }

    const LINK_M: [f64; 3] = [0.0, 1e-4, 3e-4];

    #[test]
    fn constant_frames_of_a_deviating_arm_do_not_change() {
        for link_m in LINK_M {
            let found = diagnosed(link_m, |_| [Vec3::zeros(); 2]);
            assert!(!found.streams[0].has_changes(), "{link_m}: {:?}", found.streams[0]);
        }
    }

    #[test]
    fn a_slip_of_a_deviating_arms_tool_is_measured() {
        let slip = Vec3::new(1.2e-3, 0.0, -1.6e-3);
        for link_m in LINK_M {
            let found = diagnosed(link_m, |t_s| {
                [Vec3::zeros(), if t_s < 9.0 { Vec3::zeros() } else { slip }]
            });
            let found = &found.streams[0];
            let [change] = found.tool_changes.as_slice() else {
                panic!("{link_m}: {:?} {:?}", found.tool_changes, found.reference_changes)
            };
            assert!((change.at_s - 9.0).abs() < 0.1, "{link_m}: {change:?}");
            let size = &change.size.translation_m;
            assert!((size.value - 2e-3).abs() < 1e-4, "{link_m}: {size:?}");
            assert!((size.value - 2e-3).abs() < 2.0 * size.half_width(0.95), "{link_m}: {size:?}");
            assert!(found.reference_changes.is_empty(), "{link_m}");
        }
    }

    #[test]
    fn a_base_that_moves_and_returns_has_two_steps() {
        for link_m in LINK_M {
            let found = diagnosed(link_m, |t_s| {
                let is_away = (6.0..13.0).contains(&t_s);
                [if is_away { Vec3::new(0.0, 4e-3, 0.0) } else { Vec3::zeros() }, Vec3::zeros()]
            });
            let changes = &found.streams[0].reference_changes;
            let at_s: Vec<f64> = changes.iter().map(|change| change.at_s).collect();
            let is_dated =
                at_s.len() == 2 && (at_s[0] - 6.0).abs() < 0.1 && (at_s[1] - 13.0).abs() < 0.1;
            assert!(is_dated, "{link_m}: {changes:?}");
            for change in changes {
                let size_m = change.size.translation_m.value;
                assert!((size_m - 4e-3).abs() < 2e-4, "{link_m}: {change:?}");
            }
        }
    }
}
