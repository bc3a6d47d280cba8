//! Diagnosis of an arm's whole run.
//!
//! Constant causes are estimated after compensating a variable latency. Joint compliance and changes of causes compete to
//! explain a remaining residual. The likeliest diagnosis wins, also against changes of encodings.
//!
//! Streams are diagnosed together, unless some are FK of the joint states and others show joint zeros or compliance.

use crate::arm::{are_floating, diagnose_derived};
use crate::arm_run::ArmRun;
use crate::changes::{
    self, constant_frames_suffice, diagnose_with_cause_changes, diagnose_with_encoding_changes,
    diagnose_with_recorded_encoding_changes,
};
use crate::compliance::{
    diagnose_gain_as_compliance, diagnose_with_compliance, diagnose_with_gain,
    has_unusual_compliance,
};
use crate::encodings::decoded_stream::{MIN_TURN_RAD, max_angle};
use crate::encodings::orientation_samples::MAX_ENCODING_RESIDUAL_RAD;
use crate::latency::compensation::{CompensatedRun, tracks_with_stamps, with_tracks};
use crate::residuals::comparison::{has_large_residual, has_slow_residual, residual_m};
use crate::samples::sampling::slow_samples;
use crate::selection::evidence::{fits_as_well, likeliest, log_bayes_factor};
use crate::selection::nominal_model::{MAX_TIP_CHANGE_M, MAX_TIP_CHANGE_RAD};
use crate::{
    ArmDiagnosis, EstimateResult, JointCompliance, JointDiagnosis, LatencyProfile, PoseDiagnosis,
    PoseStream,
};
use ground::geometry::Rotation;
use ground::stream::{JointTrack, Orientations, PoseTrack};
use std::borrow::Cow;

/// Diagnoses an arm's joint states and pose streams. `max_lag_s` is the largest latency to search.
pub fn diagnose_run(
    joints: &JointTrack,
    streams: &[PoseStream],
    is_prismatic: &[bool],
    max_lag_s: f64,
) -> ArmDiagnosis {
    let run = ArmRun { joints, streams, is_prismatic, max_lag_s };
    let found = diagnose_all(&run);
    let both = streams.iter().zip(&found.streams);
    let tracks: Vec<Option<PoseTrack>> =
        both.map(|both| without_constant_orientation(joints, both)).collect();
    if tracks.iter().all(Option::is_none) {
        return found;
    }
    diagnose_all(&ArmRun { streams: &with_tracks(streams, &tracks), ..run })
}

fn diagnose_all(run: &ArmRun) -> ArmDiagnosis {
    let together = diagnose_together(run);
    diagnose_without_derived(run, &together).unwrap_or(together)
}

/// Positions alone, if the logged orientations are constant, the joints turn the tool, and neither the arm nor a fault of its
/// joints explains that: they were never set.
fn without_constant_orientation(
    joints: &JointTrack,
    (stream, found): (&PoseStream, &PoseDiagnosis),
) -> Option<PoseTrack> {
    const MAX_CHANGE_RAD: f64 = 1e-3;
    let is_explained = found.encoding.is_ok()
        && found.residual.as_ref().is_ok_and(|it| it.rms_rad < MAX_ENCODING_RESIDUAL_RAD);
    if is_explained {
        return None;
    }
    let logged = match stream.moving_frame {
        Some(frame) => Cow::Owned(frame.in_frame(stream.track)),
        None => Cow::Borrowed(stream.track),
    };
    let Orientations::Rotations(rotations) = &logged.orientation else { return None };
    if max_angle(rotations) >= MAX_CHANGE_RAD {
        return None;
    }
    let (_, fk) = slow_samples(joints, stream, 0.0);
    let by_fk: Vec<Rotation> = fk.iter().map(|pose| pose.rotation).collect();
    let orientation = Orientations::Unset(rotations.len());
    (max_angle(&by_fk) > MIN_TURN_RAD).then(|| PoseTrack { orientation, ..stream.track.clone() })
}

/// Diagnosis of the joint states by the streams that FK of the joint states does not explain, if these show joint zeros or
/// compliance. The poses of a controller are FK of the same encoders, so they would hide them.
fn diagnose_without_derived(run: &ArmRun, together: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    if run.streams.len() < 2 || are_floating(run.streams) {
        return None;
    }
    let is_open = !together.is_explained(run.streams);
    // A stream in an unknown frame comes from an external sensor; one in the robot's frame may be the controller's.
    if !is_open && run.streams.iter().all(|stream| stream.reference_known) {
        return None;
    }
    let derived = run.streams.iter().map(|stream| {
        let may_be_derived = is_open || stream.reference_known;
        let found =
            may_be_derived.then(|| diagnose_derived(run.joints, None, stream, run.max_lag_s))?;
        let is_nominal = has_slow_residual(&found);
        // A frame that explains the rest would not be reported.
        let is_near = found.residual.as_ref().is_ok_and(|residual| {
            residual.rms_m < MAX_TIP_CHANGE_M && residual.rms_rad < MAX_TIP_CHANGE_RAD
        });
        (is_near && changes::is_explained(&found, stream)).then_some(PoseDiagnosis {
            is_nominal,
            is_derived: true,
            ..found
        })
    });
    let derived: Vec<Option<PoseDiagnosis>> = derived.collect();
    let is_derived = |s: &usize| derived[*s].is_some();
    let independent: Vec<usize> = (0..derived.len()).filter(|s| !is_derived(s)).collect();
    if independent.is_empty() || independent.len() == derived.len() {
        return None;
    }
    let streams: Vec<PoseStream> = independent.iter().map(|&s| run.streams[s]).collect();
    let apart = diagnose_together(&ArmRun { streams: &streams, ..*run });
    let common = ArmDiagnosis {
        joints: together.joints.clone(),
        streams: independent.iter().map(|&s| together.streams[s].clone()).collect(),
    };
    let JointDiagnosis { changes, offsets, compliance, .. } = &apart.joints;
    let is_faulty = !changes.is_empty()
        || !compliance.is_empty()
        || offsets.iter().any(|offset| offset.is_chosen);
    if !is_faulty || !fits_as_well(&apart, &common) {
        return None;
    }
    let mut others = apart.streams.into_iter();
    let streams = derived.into_iter().filter_map(|derived| derived.or_else(|| others.next()));
    Some(ArmDiagnosis { streams: streams.collect(), joints: apart.joints })
}

fn diagnose_together(run: &ArmRun) -> ArmDiagnosis {
    if let Some(by_encodings) = diagnose_with_recorded_encoding_changes(run, diagnose_uniform) {
        // Between poses in one frame, some segments of a drift follow as logged.
        let constant = are_floating(run.streams).then(|| run.diagnose());
        let by_steps = constant.and_then(|constant| diagnose_with_cause_changes(run, &constant));
        let likelier = by_steps.filter(|it| log_bayes_factor(it, &by_encodings) > 0.0);
        return likelier.unwrap_or(by_encodings);
    }
    let uniform = diagnose_uniform(run);
    diagnose_with_encoding_changes(run, &uniform, diagnose_uniform).unwrap_or(uniform)
}

/// Diagnosis with one encoding throughout the run.
fn diagnose_uniform(run: &ArmRun) -> ArmDiagnosis {
    let CompensatedRun { tracks, mut profiles, diagnosis } = CompensatedRun::new(run);
    let streams = with_tracks(run.streams, &tracks);
    let run = ArmRun { streams: &streams, ..*run };
    let mut diagnosis = diagnose_with_varying_causes(&run, &diagnosis).unwrap_or(diagnosis);
    if let Some((compensated, found)) = diagnose_with_hidden_latency(&run, &diagnosis, &profiles) {
        (diagnosis, profiles) = (compensated, found);
    }
    run.restore_eccentricity(&mut diagnosis);
    for (stream, profile) in diagnosis.streams.iter_mut().zip(profiles) {
        stream.latency_profile = profile;
    }
    diagnosis
}

/// Diagnosis after compensating latencies that another cause hides, and the latencies over the run. Such a latency varies
/// only after the changes in `found` are removed, or explains too little of the residual alone. `None` without one, or if
/// the diagnosis is not likelier.
fn diagnose_with_hidden_latency(
    run: &ArmRun,
    found: &ArmDiagnosis,
    profiles: &[EstimateResult<LatencyProfile>],
) -> Option<(ArmDiagnosis, Vec<EstimateResult<LatencyProfile>>)> {
    /// The first profile contains errors of the other causes.
    const ITERATIONS: usize = 2;
    let is_open = !found.is_explained(run.streams);
    let varying = |found: &PoseDiagnosis| {
        let confirmed = found.latency_profile.as_ref().ok().filter(|profile| profile.is_unsteady);
        let profile = confirmed.or(found.unconfirmed_latency.as_ref().filter(|_| is_open))?;
        Some(LatencyProfile { is_unsteady: true, ..profile.clone() })
    };
    // Only steps can be added to a variation that is already compensated.
    let known = profiles.iter().map(|it| it.as_ref().ok().filter(|before| before.is_unsteady));
    let known: Vec<Option<&LatencyProfile>> = known.collect();
    let total = |s: usize, own: &LatencyProfile| match known[s] {
        Some(known) => known.with_further_steps(own),
        None => Some(own.clone()),
    };
    let hidden = found.streams.iter().enumerate().map(|(s, found)| {
        let own = varying(found)?;
        total(s, &own).map(|_| own)
    });
    let mut hidden: Vec<Option<LatencyProfile>> = hidden.collect();
    let mut best: Option<(ArmDiagnosis, Vec<EstimateResult<LatencyProfile>>)> = None;
    for _ in 0..ITERATIONS {
        if hidden.iter().all(Option::is_none) {
            break;
        }
        let tracks =
            tracks_with_stamps(run.streams, |s, t_s| Some(hidden[s].as_ref()?.compensated(t_s)));
        let compensated = ArmRun { streams: &with_tracks(run.streams, &tracks), ..*run };
        let constant = compensated.diagnose();
        let diagnosis = diagnose_with_varying_causes(&compensated, &constant).unwrap_or(constant);
        let (before, is_first) = best.as_ref().map_or((found, true), |best| (&best.0, false));
        let is_likelier = match is_open && is_first {
            true => is_enough(&diagnosis, before, run.streams),
            false => residual_m(&diagnosis) < residual_m(before),
        };
        if !is_likelier {
            break;
        }
        let profile = |(s, own): (usize, &Option<LatencyProfile>)| {
            let own = own.as_ref().and_then(|own| total(s, own));
            let relative = own.map(|own| own.relative_to_typical(&run.streams[s].track.t_s));
            relative.map_or_else(|| profiles[s].clone(), Ok)
        };
        let profiles = hidden.iter().enumerate().map(profile).collect();
        let further = hidden.iter().zip(&diagnosis.streams);
        hidden = further
            .map(|(own, found)| own.as_ref()?.with_further_steps(&varying(found)?))
            .collect();
        best = Some((diagnosis, profiles));
    }
    best
}

/// Whether a diagnosis explains the residual of another, or most of it.
fn is_enough(diagnosis: &ArmDiagnosis, other: &ArmDiagnosis, streams: &[PoseStream]) -> bool {
    /// Largest share of the residual that may remain, as between two interpretations of the joint states.
    const MAX_RESIDUAL_SHARE: f64 = 0.5;
    diagnosis.is_explained(streams)
        || residual_m(diagnosis) < MAX_RESIDUAL_SHARE * residual_m(other)
}

/// Diagnosis with joint compliance, scales and couplings of joints, or changes of causes. `None` if `constant` is likelier.
fn diagnose_with_varying_causes(run: &ArmRun, constant: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    let is_within_links = !are_floating(run.streams) && constant_frames_suffice(constant);
    // Link deviations look like sag and eccentricity, which depend on positions alone.
    let is_of_motion = |it: &JointCompliance| it.is_backlash() || it.delay_s().is_some();
    let is_distinct =
        |it: &ArmDiagnosis| !is_within_links || it.joints.compliance.iter().all(is_of_motion);
    let is_explained = |it: &ArmDiagnosis| it.is_explained(run.streams);
    let is_open = |(found, stream): (&PoseDiagnosis, &PoseStream)| {
        has_large_residual(found) && !changes::is_explained(found, stream)
    };
    let is_any_open = constant.streams.iter().zip(run.streams).any(is_open);
    let by_gain = is_any_open.then(|| diagnose_with_gain(run, constant)).flatten();
    let by_gain = by_gain.filter(|it| is_enough(it, constant, run.streams));
    let gain_as_compliance = diagnose_gain_as_compliance(run, by_gain.as_ref().unwrap_or(constant));
    let is_gain_explained = by_gain.as_ref().is_some_and(is_explained);
    let by_gain = by_gain.filter(|_| !is_gain_explained || gain_as_compliance.is_none());
    // Steps may be larger than a small motion, but steps also make the residual of another encoding smaller.
    let is_far = constant.streams.iter().any(PoseDiagnosis::is_far_from_fk);
    let by_steps =
        diagnose_with_cause_changes(run, constant).filter(|it| !is_far || is_explained(it));
    let by_compliance = gain_as_compliance.or_else(|| match is_gain_explained {
        true => None,
        false => diagnose_with_compliance(run, constant, is_distinct),
    });
    let all: Vec<ArmDiagnosis> = by_compliance.into_iter().chain(by_steps).chain(by_gain).collect();
    // Link deviations hide the difference between those they do not explain.
    let is_any_explained = all.iter().any(is_explained);
    let likeliest = likeliest(all.into_iter().filter(|it| !is_any_explained || is_explained(it)));
    // Usual compliance is no fault, but looks like a step if a joint seldom reverses.
    likeliest.filter(|it| it.joints.compliance.is_empty() || has_unusual_compliance(it))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_random::Lcg;
    use crate::{MovingFrame, NotObservable, test_motion};
    use ground::geometry::{Convention, Pose, Vec3, pose, rotation_from_rotvec};
    use std::f64::consts::FRAC_PI_2;

    /// Poses with noise. A controller computes its poses from the encoders, with its own calibration; a tracker in an
    /// unknown world measures the links.
    fn controller_and_tracker(
        joints: &JointTrack,
        link_m: f64,
        link_positions: impl Fn(usize, &mut [f64]),
    ) -> [PoseTrack; 2] {
        let deviating = test_motion::deviating_chain(link_m);
        let world = pose([0.4, -1.1, 0.7], rotation_from_rotvec(Vec3::new(0.1, 0.2, 1.3)));
        let marker = pose([0.02, 0.01, 0.06], rotation_from_rotvec(Vec3::new(0.3, -0.2, 0.5)));
        let mut random = Lcg::new();
        let mut track = |pose_of: &dyn Fn(usize, &[f64]) -> Pose| {
            let noisy = |(row, q): (usize, &[f64])| {
                let [shift, turn] = [1e-4, 1e-4].map(|size| random.triple(size));
                let pose = pose_of(row, q);
                let turn = rotation_from_rotvec(turn.into());
                (pose.translation.vector + Vec3::from(shift), turn * pose.rotation)
            };
            test_motion::pose_track(&joints.t_s, joints.q.chunks(6).enumerate().map(noisy))
        };
        let controller = track(&|_, q| deviating.forward(q));
        let tracker = track(&|row, q| {
            let mut q = q.to_vec();
            link_positions(row, &mut q);
            world * deviating.forward(&q) * marker
        });
        [controller, tracker]
    }

    /// Positions of a joint's link.
    fn with_backlash(joints: &JointTrack, joint: usize, backlash_rad: f64) -> Vec<f64> {
        let half_rad = 0.5 * backlash_rad;
        let mut link = joints.q[joint];
        let follow = |q: &[f64]| {
            link = link.clamp(q[joint] - half_rad, q[joint] + half_rad);
            link
        };
        joints.q.chunks(6).map(follow).collect()
    }

    /// Asserts backlash of this joint alone, within a tenth.
    fn assert_backlash(found: &ArmDiagnosis, joint: usize, backlash_rad: f64) {
        let [backlash] = found.joints.compliance.as_slice() else {
            panic!("{:?}", found.joints.compliance)
        };
        assert!(backlash.is_backlash() && backlash.column == joint, "{backlash:?}");
        let off_rad = (backlash.value().value - backlash_rad).abs();
        assert!(off_rad < 0.1 * backlash_rad, "{backlash:?}");
    }

    fn diagnose_both(joints: &JointTrack, [controller, tracker]: &[PoseTrack; 2]) -> ArmDiagnosis {
        let (_, chain) = test_motion::arm();
        let streams = [
            test_motion::tip_stream(controller, &chain),
            PoseStream { reference_known: false, ..test_motion::tip_stream(tracker, &chain) },
        ];
        let found = diagnose_run(joints, &streams, &[false; 6], 1.0);
        let are_derived = [0, 1].map(|s: usize| found.streams[s].is_derived);
        assert_eq!(are_derived, [true, false]);
        found
    }

    #[test]
    fn late_positions_of_one_joint_are_no_backlash() {
        let (mut joints, chain) = test_motion::arm();
        let poses = controller_and_tracker(&joints, 1e-4, |_, _| {});
        let late = joints.clone();
        let mut sequence = late.sequence();
        for (row, t_s) in late.t_s.iter().enumerate() {
            sequence.at(t_s - 0.02);
            joints.q[6 * row + 3] = sequence.last().0[3];
        }
        let stream = test_motion::tip_stream(&poses[0], &chain);
        let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
        let [late] = found.joints.compliance.as_slice() else {
            panic!("{:?}", found.joints.compliance)
        };
        let delay = late.delay_s().expect("a delay");
        assert!(late.column == 3 && (delay.value - 0.02).abs() < 1e-3, "{delay:?}");
        let latency = found.streams[0].latency_s.as_ref().expect("a latency");
        assert!(latency.value.abs() < 1e-3, "{latency:?}");
    }

    #[test]
    fn a_tracker_shows_a_zero_that_the_controller_cannot_see() {
        const ZERO_RAD: f64 = 0.012;
        let (joints, _) = test_motion::arm();
        for link_m in [0.0, 2e-4] {
            let tracks = controller_and_tracker(&joints, link_m, |_, q| q[2] += ZERO_RAD);
            let found = diagnose_both(&joints, &tracks);
            let chosen: Vec<usize> =
                (0..6).filter(|joint| found.joints.offsets[*joint].is_chosen).collect();
            assert_eq!(chosen, [2], "{link_m}");
            let zero = found.joints.offsets[2].offset.as_ref().expect("an offset");
            assert!((zero.value - ZERO_RAD).abs() < zero.half_width(0.99), "{link_m}: {zero:?}");
        }
    }

    #[test]
    fn a_tracker_shows_backlash_that_the_controller_cannot_see() {
        const BACKLASH_RAD: f64 = 6e-3;
        const JOINT: usize = 3;
        let (joints, _) = test_motion::arm();
        let links = with_backlash(&joints, JOINT, BACKLASH_RAD);
        let tracks = controller_and_tracker(&joints, 2e-4, |row, q| q[JOINT] = links[row]);
        let found = diagnose_both(&joints, &tracks);
        assert_backlash(&found, JOINT, BACKLASH_RAD);
    }

    /// Steps of the joint's zero imitate backlash, but not with the slip of the tool alone.
    #[test]
    fn backlash_is_found_beside_a_tool_that_slips() {
        const BACKLASH_RAD: f64 = 0.01;
        const SLIP_M: f64 = 0.008;
        const SLIP_S: f64 = 9.0;
        const JOINT: usize = 2;
        let (joints, _) = test_motion::arm();
        let links = with_backlash(&joints, JOINT, BACKLASH_RAD);
        let [_, mut tracker] =
            controller_and_tracker(&joints, 1e-4, |row, q| q[JOINT] = links[row]);
        let Orientations::Rotations(rotations) = &tracker.orientation else {
            panic!("{:?}", tracker.orientation)
        };
        let rows = tracker.xyz.iter_mut().zip(rotations).zip(&tracker.t_s);
        for ((xyz, rotation), _) in rows.filter(|(_, t_s)| **t_s > SLIP_S) {
            *xyz += rotation * Vec3::new(0.0, SLIP_M, 0.0);
        }
        let (_, chain) = test_motion::arm();
        let stream =
            PoseStream { reference_known: false, ..test_motion::tip_stream(&tracker, &chain) };
        let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
        assert_backlash(&found, JOINT, BACKLASH_RAD);
        let [slip] = found.streams[0].tool_changes.as_slice() else {
            panic!("{:?}", found.streams[0].tool_changes)
        };
        assert!((slip.at_s - SLIP_S).abs() < 0.05, "{slip:?}");
        assert!((slip.size.translation_m.value - SLIP_M).abs() < 5e-4, "{slip:?}");
        assert!(found.joints.changes.is_empty(), "{:?}", found.joints.changes);
    }

    /// Neither explains most of the residual alone, and a skew fits the step roughly.
    #[test]
    fn a_step_of_the_latency_is_found_beside_a_tool_that_slips() {
        const STEP_S: f64 = 0.03;
        const SLIP_M: f64 = 7.5e-3;
        const CHANGE_S: f64 = 9.0;
        let (joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(1e-4);
        let mut random = Lcg::new();
        let mut sequence = joints.sequence();
        let mut pose_at = |t_s: f64| {
            let is_changed = t_s > CHANGE_S;
            let late_s = if is_changed { STEP_S } else { 0.0 };
            let pose = deviating.forward(sequence.at(t_s - late_s)?.0);
            let slip_m = if is_changed { SLIP_M } else { 0.0 };
            let slipped = pose.translation.vector + pose.rotation * Vec3::new(0.0, slip_m, 0.0);
            let turn = rotation_from_rotvec(random.triple(1e-4).into());
            Some((t_s, (slipped + Vec3::from(random.triple(1e-4)), turn * pose.rotation)))
        };
        let rows = joints.t_s.iter().filter_map(|t_s| pose_at(*t_s));
        let (t_s, poses): (Vec<f64>, Vec<_>) = rows.unzip();
        let track = test_motion::pose_track(&t_s, poses);
        let stream =
            PoseStream { reference_known: false, ..test_motion::tip_stream(&track, &chain) };
        let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
        let found = &found.streams[0];
        let profile = found.latency_profile.as_ref().expect("a profile");
        assert!(profile.is_unsteady, "{profile:?}");
        assert!((profile.swing_s.value - STEP_S).abs() < 3e-4, "{:?}", profile.swing_s);
        assert!(found.skew.as_ref().is_ok_and(|skew| skew.value.abs() < 5e-5), "{:?}", found.skew);
        let [slip] = found.tool_changes.as_slice() else { panic!("{:?}", found.tool_changes) };
        assert!((slip.size.translation_m.value - SLIP_M).abs() < 5e-4, "{slip:?}");
    }

    /// In a small motion, a misread rotation vector is within a calibration's deviations from FK. No joint zero explains it.
    #[test]
    fn a_small_misreading_is_no_deviation_of_the_arm() {
        /// The tool is parallel to the base.
        const MIDDLE: [f64; 6] = [0.3, -1.2, 1.5, -1.8708, FRAC_PI_2, 1.2708];
        let (mut joints, chain) = test_motion::arm();
        for values in [&mut joints.q, &mut joints.qd] {
            values.iter_mut().for_each(|value| *value *= 0.2);
        }
        for q in joints.q.chunks_mut(6) {
            q.iter_mut().zip(MIDDLE).for_each(|(q, middle)| *q += middle + 0.12);
        }
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| {
            let pose = chain.forward(q);
            let misread = Convention::RPY.rotation(Convention::RotVec.numbers(&pose.rotation));
            (pose.translation.vector + Vec3::from(random.triple(2e-5)), misread)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        let streams = [test_motion::tip_stream(&track, &chain)];
        let found = diagnose_run(&joints, &streams, &[false; 6], 1.0);
        let encoding = found.streams[0].encoding.as_ref().expect("an encoding");
        assert!(encoding.as_logged_rad.is_some_and(|rad| rad < 8e-3), "{encoding:?}");
        assert!(!encoding.best.is_as_logged(), "{encoding:?}");
    }

    /// A position sensor that fills in one orientation, with noise.
    #[test]
    fn a_constant_orientation_that_nothing_explains_is_not_set() {
        let (joints, chain) = test_motion::arm();
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| {
            let noise = rotation_from_rotvec(random.triple(2e-5).into());
            (chain.forward(q).translation.vector + Vec3::from(random.triple(2e-5)), noise)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        let streams = [test_motion::tip_stream(&track, &chain)];
        let found = diagnose_run(&joints, &streams, &[false; 6], 1.0);
        let stream = &found.streams[0];
        assert!(matches!(stream.encoding, Err(NotObservable::OrientationNotSet)));
        assert!(stream.residual.as_ref().expect("a residual").rms_m < 1e-4);
    }

    /// Positions in a world in which the base moves and turns.
    #[test]
    fn a_constant_orientation_on_a_moving_base_is_not_set() {
        let (joints, chain) = test_motion::arm();
        let world_from_base = |t_s: f64| {
            pose(
                [0.3 * t_s, 0.5 * (0.4 * t_s).sin(), 0.0],
                rotation_from_rotvec(Vec3::new(0.0, 0.0, 0.1 * t_s)),
            )
        };
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
            let is = world_from_base(t_s) * chain.forward(q);
            (is.translation.vector + Vec3::from(random.triple(2e-5)), Rotation::identity())
        });
        let logged = test_motion::pose_track(&joints.t_s, poses);
        let frame = MovingFrame {
            base_from_frame: joints.t_s.iter().map(|&t_s| world_from_base(t_s).inverse()).collect(),
            t_s: joints.t_s.clone(),
            lag_s: 0.0,
        };
        let track = frame.in_base(&logged);
        let stream =
            PoseStream { moving_frame: Some(&frame), ..test_motion::tip_stream(&track, &chain) };
        let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
        let found = &found.streams[0];
        assert!(matches!(found.encoding, Err(NotObservable::OrientationNotSet)), "{found:?}");
        assert!(found.residual.as_ref().expect("a residual").rms_m < 1e-4);
    }

    #[test]
    fn the_orientation_of_an_arm_at_rest_may_be_set() {
        let (mut joints, chain) = test_motion::arm();
        let first = joints.row(0).to_vec();
        joints.q.chunks_mut(6).for_each(|row| row.copy_from_slice(&first));
        joints.qd.fill(0.0);
        let mut random = Lcg::new();
        let tip = chain.forward(&first);
        let poses = joints.t_s.iter().map(|_| {
            let noise = rotation_from_rotvec(random.triple(2e-5).into());
            (tip.translation.vector, tip.rotation * noise)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        let streams = [test_motion::tip_stream(&track, &chain)];
        let found = diagnose_run(&joints, &streams, &[false; 6], 1.0);
        assert!(!matches!(found.streams[0].encoding, Err(NotObservable::OrientationNotSet)));
    }
}
