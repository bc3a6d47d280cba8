use rayon::prelude::*;

use super::commanded_poses::commanded_poses;
use super::joint_clock::{are_others_steady, with_corrected_joint_stamps};
use super::joint_topics::{JointTopicLatency, with_corrected_topic};
use crate::diagnosis::{
    ArmDiagnosis, DhComparison, DhConventionResult, DhResidual, DhStreamResiduals, ImuDiagnosis,
    ImuStream, LastTurn, LatencyProfile, MeasuredLength, NotObservable, PoseDiagnosis,
    PoseEncoding, PoseStream, StreamResidual, best_lag_peak, compensate_latency, diagnose_derived,
    diagnose_imu_with_latency_compensation, diagnose_run, fault_count, position_misfit_m,
};
use crate::geometry::AngleUnit;
use crate::robot::DhConvention;
use crate::run::{Arm, ImuSource, PoseSource, Run, common_diagnosis_count, realign_moving_bases};
use crate::stream::{JointTrack, Orientations};

/// DH table of a robot.
#[derive(Clone, Debug)]
pub struct DhEvidence {
    /// Declared convention.
    pub declared: DhConvention,
    /// Residuals of the streams under either convention.
    pub estimate: DhComparison,
}

pub(super) struct ArmStreamsDiagnosis {
    pub arm: ArmDiagnosis,
    pub tf: Option<PoseDiagnosis>,
    pub imus: Vec<ImuDiagnosis>,
    pub dh: Option<DhEvidence>,
    /// Steps of the joint states' clock, if their stamps were corrected.
    pub joint_clock: Option<LatencyProfile>,
    /// Latency between topics of the joint states, if their stamps were corrected.
    pub joint_topic: Option<JointTopicLatency>,
}

/// Another interpretation of an arm with its diagnosis, if it is better than the one found.
type Alternative = fn(&Run, &Arm, &ArmStreamsDiagnosis, f64) -> Option<(Arm, ArmStreamsDiagnosis)>;

const ALTERNATIVES: [Alternative; 4] = [
    with_documented_conventions, with_turn_by_imu, with_simultaneous_topics,
    with_steady_joint_clock,
];

/// Diagnoses every arm. Replaces an arm whose DH table uses the undeclared convention.
pub(super) fn diagnose(run: &mut Run, max_lag_s: f64) -> Vec<ArmStreamsDiagnosis> {
    let arms = 0..run.arms.len();
    arms.map(|index| {
        let mut found = diagnose_one(run, &run.arms[index], max_lag_s);
        let commanded = commanded_poses(run, index, &found.arm, max_lag_s);
        if !commanded.is_empty() {
            run.exclude_commanded_poses(commanded);
            found = diagnose_one(run, &run.arms[index], max_lag_s);
        }
        if realign_moving_bases(run, index, &found.arm) {
            found = diagnose_one(run, &run.arms[index], max_lag_s);
        }
        if let Some((arm, other)) = with_other_reference(run, &run.arms[index], &found, max_lag_s) {
            run.exchange_reference(index, arm);
            found = other;
        }
        for alternative in ALTERNATIVES {
            if let Some((arm, other)) = alternative(run, &run.arms[index], &found, max_lag_s) {
                run.replace_arm(index, arm);
                found = other;
            }
        }
        let Some(dh) = &run.arms[index].robot.dh else { return found };
        let declared = dh.convention;
        let (estimate, other) =
            diagnose_other_convention(run, &run.arms[index], &found.arm, max_lag_s);
        let is_other = estimate.convention() == DhConventionResult::Other;
        let dh = Some(DhEvidence { declared, estimate });
        match other.filter(|_| is_other) {
            Some((mut arm, other)) => {
                let convention = declared.other().name();
                arm.identified_by += &format!(", DH table interpreted as {convention}");
                run.replace_arm(index, arm);
                ArmStreamsDiagnosis { dh, ..other }
            }
            None => ArmStreamsDiagnosis { dh, ..found },
        }
    })
    .collect()
}

/// Diagnosis with another pose stream as the reference, if the errors of this one explain what those of the others do
/// not, or explain it in a more usual way, or by fewer of at least three streams.
fn with_other_reference(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    max_lag_s: f64,
) -> Option<(Arm, ArmStreamsDiagnosis)> {
    let is_unusual = found.arm.has_unusual_misinterpretation();
    let deviating = found.arm.deviating_streams();
    let is_shared = deviating >= 2 && deviating == found.arm.streams.len();
    let is_open = is_unusual || is_shared || found.arm.is_unexplained();
    arm.trajectory.as_ref().filter(|_| is_open)?;
    let others = (0..arm.poses.len()).filter_map(|source| run.with_other_reference(arm, source));
    let diagnosed = others.map(|other| {
        let found = diagnose_one(run, &other, max_lag_s);
        (other, found)
    });
    let mut better = diagnosed.filter(|(_, ArmStreamsDiagnosis { arm: other, .. })| {
        let is_usual = || is_unusual && !other.has_unusual_misinterpretation();
        let is_simpler = || is_shared && other.deviating_streams() < deviating;
        other.is_far_better_than(&found.arm)
            || ((is_usual() || is_simpler()) && other.is_as_good_as(&found.arm))
    });
    better.next()
}

/// Diagnosis with rotation numbers in the convention that their driver documents or their column names state, if the
/// motion does not determine it, or another one explains the poses far worse. Wrong joint states can hide it.
fn with_documented_conventions(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    max_lag_s: f64,
) -> Option<(Arm, ArmStreamsDiagnosis)> {
    let mut arm = arm.clone();
    let mut undetermined: Vec<bool> = Vec::new();
    for (source, found) in arm.poses.iter_mut().zip(&found.arm.streams) {
        let documented = run.streams[source.stream].documented_convention(&arm.robot.name);
        let (Orientations::Numbers(numbers), Some(convention)) =
            (&source.track.orientation, documented)
        else {
            continue;
        };
        let read = found.encoding.as_ref().map(|encoding| encoding.best);
        if !matches!(read, Ok(PoseEncoding::Numbers(read)) if read == convention) {
            let unit = angle_unit_by_size(numbers);
            let rotation =
                |numbers: &[f64; 3]| convention.rotation(numbers.map(|it| it * unit.in_rad()));
            source.track.orientation =
                Orientations::Rotations(numbers.iter().map(rotation).collect());
            undetermined.push(read.is_err());
        }
    }
    if undetermined.is_empty() {
        return None;
    }
    let documented = diagnose_one(run, &arm, max_lag_s);
    let is_better = documented.arm.is_far_better_than(&found.arm)
        || (undetermined.contains(&true) && documented.arm.is_as_good_as(&found.arm));
    is_better.then_some((arm, documented))
}

/// Degrees if any number exceeds a turn in radians.
fn angle_unit_by_size(numbers: &[[f64; 3]]) -> AngleUnit {
    let is_turn = |number: &f64| number.abs() > std::f64::consts::TAU;
    if numbers.iter().flatten().any(is_turn) { AngleUnit::Degree } else { AngleUnit::Radian }
}

/// Diagnosis with a turn of the last joint instead of the tool, or of the tool instead of the joint, if an IMU beyond them
/// then has the mount in the log. Poses fit either.
fn with_turn_by_imu(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    max_lag_s: f64,
) -> Option<(Arm, ArmStreamsDiagnosis)> {
    const MAX_P_VALUE: f64 = 1e-4;
    /// Of the mount's error.
    const MAX_REMAINING_SHARE: f64 = 0.2;
    let last = arm.columns.last();
    let imus: Vec<(usize, MeasuredLength)> = (0..arm.imus.len())
        .filter(|&imu| arm.imus[imu].columns.last() == last)
        .filter_map(|imu| Some((imu, *found.imus[imu].mount_rad.as_ref().ok()?)))
        .filter(|(_, error)| error.p_value < MAX_P_VALUE)
        .collect();
    let is_wrong_tool = |(found, source): (&PoseDiagnosis, &PoseSource)| {
        source.tip_named && found.tool.as_ref().is_ok_and(|tool| tool.is_chosen)
    };
    let zero = found.arm.joints.offsets.get(*last?);
    let last_turn = match zero.is_some_and(|offset| offset.is_chosen) {
        _ if imus.is_empty() => return None,
        true => LastTurn::OfTool,
        // Without a named tip, another tool is a normal setting.
        false if found.arm.streams.iter().zip(&arm.poses).any(is_wrong_tool) => LastTurn::OfJoint,
        false => return None,
    };
    let mut arm = arm.clone();
    for source in arm.poses.iter_mut().filter(|source| source.columns.last() == last) {
        source.last_turn = last_turn;
    }
    let other = diagnose_one(run, &arm, max_lag_s);
    // A rotation about one axis shows some wrong mounts, but confirms none.
    let is_mounted_as_logged =
        |(imu, before): &(usize, MeasuredLength)| match &other.imus[*imu].mount_rad {
            Ok(error) => error.norm.value < MAX_REMAINING_SHARE * before.norm.value,
            Err(why) => *why == NotObservable::NotExcited,
        };
    let fits = || {
        let streams: Vec<PoseStream> = arm.poses.iter().map(|it| run.pose_stream(it)).collect();
        other.arm.is_as_good_as(&found.arm) || other.arm.is_explained(&streams)
    };
    (imus.iter().all(is_mounted_as_logged) && fits()).then_some((arm, other))
}

/// Diagnosis with corrected stamps of one topic of joint states, if it then fits as well.
fn with_simultaneous_topics(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    max_lag_s: f64,
) -> Option<(Arm, ArmStreamsDiagnosis)> {
    let (arm, late) = with_corrected_topic(run, arm, found)?;
    let simultaneous = diagnose_one(run, &arm, max_lag_s);
    simultaneous
        .arm
        .is_as_good_as(&found.arm)
        .then_some((arm, ArmStreamsDiagnosis { joint_topic: Some(late), ..simultaneous }))
}

/// Diagnosis with corrected stamps of the joint states, if all other streams are then steady.
fn with_steady_joint_clock(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    max_lag_s: f64,
) -> Option<(Arm, ArmStreamsDiagnosis)> {
    let (arm, profile) = with_corrected_joint_stamps(arm, found)?;
    let steady = diagnose_one(run, &arm, max_lag_s);
    are_others_steady(&arm, &steady, &profile).then_some((
        arm,
        ArmStreamsDiagnosis {
            joint_clock: Some(profile),
            joint_topic: found.joint_topic,
            ..steady
        },
    ))
}

/// Diagnosis under the undeclared DH convention. Skipped if `found`, under the declared one, explains the
/// streams, or if positions alone rule out the other.
fn diagnose_other_convention(
    run: &Run,
    arm: &Arm,
    found: &ArmDiagnosis,
    max_lag_s: f64,
) -> (DhComparison, Option<(Arm, ArmStreamsDiagnosis)>) {
    /// Maximum position misfit of a possible convention, m.
    const MAX_POSITION_MISFIT_M: f64 = 0.02;
    /// The same, relative to the declared convention.
    const MAX_MISFIT_RATIO: f64 = 0.5;
    let declared = DhResidual::from_diagnosis(found);
    let residuals =
        |&declared| DhStreamResiduals { declared, declared_positions_m: None, other: None };
    let streams = declared.iter().map(residuals).collect();
    let mut estimate =
        DhComparison { streams, declared_faults: fault_count(found), other_faults: 0 };
    if estimate.declared_faults == 0 && declared.iter().any(DhResidual::is_explained) {
        return (estimate, None);
    }
    let misfits_m = |arm: &Arm| -> Vec<Option<f64>> {
        let streams = arm.poses.iter().zip(&found.streams).map(|(source, found)| {
            let stream = run.pose_stream(source);
            let lag_s =
                best_lag_peak(&arm.joints, &stream, max_lag_s).map_or(0.0, |peak| peak.lag_s);
            position_misfit_m(&arm.joints, &stream, position_factor(found), lag_s)
        });
        streams.collect()
    };
    let declared_m = misfits_m(arm);
    for (stream, declared_m) in estimate.streams.iter_mut().zip(&declared_m) {
        stream.declared_positions_m = *declared_m;
    }
    let Some(other) = arm.robot.under_other_convention().and_then(|robot| arm.with_robot(robot))
    else {
        return (estimate, None);
    };
    let ruled_out = declared_m.iter().zip(misfits_m(&other)).map(|(declared_m, other_m)| {
        let both = declared_m.zip(other_m);
        both.is_some_and(|(declared_m, other_m)| {
            other_m > MAX_POSITION_MISFIT_M && other_m > MAX_MISFIT_RATIO * declared_m
        })
    });
    let ruled_out: Vec<bool> = ruled_out.collect();
    let contradicts = |(left, ruled_out): (&DhResidual, &bool)| left.is_explained() && *ruled_out;
    if declared.iter().zip(&ruled_out).any(contradicts) || ruled_out.iter().all(|is| *is) {
        return (estimate, None);
    }
    let diagnosis = diagnose_one(run, &other, max_lag_s);
    for (stream, left) in
        estimate.streams.iter_mut().zip(DhResidual::from_diagnosis(&diagnosis.arm))
    {
        stream.other = Some(left);
    }
    estimate.other_faults = fault_count(&diagnosis.arm);
    (estimate, Some((other, diagnosis)))
}

/// Factor to m.
pub(super) fn position_factor(found: &PoseDiagnosis) -> f64 {
    found.length_unit.as_ref().ok().copied().flatten().map_or(1.0, |slip| slip.factor())
}

fn diagnose_one(run: &Run, arm: &Arm, max_lag_s: f64) -> ArmStreamsDiagnosis {
    let streams: Vec<PoseStream> = arm.poses.iter().map(|source| run.pose_stream(source)).collect();
    let together = common_diagnosis_count(arm);
    let mut diagnosis =
        diagnose_run(&arm.joints, &streams[..together], &arm.are_prismatic(), max_lag_s);
    let corrected = diagnosis.joints.corrected_joints(&arm.joints, &arm.are_prismatic());
    let derived_streams = (together..streams.len()).into_par_iter().map(|index| {
        let same = (0..together).find(|&of| arm.poses[index].is_copy_of(&arm.poses[of]));
        match same {
            Some(of) => diagnosis.streams[of].clone(),
            None => diagnose_derived(&corrected, None, &streams[index], max_lag_s),
        }
    });
    let derived_streams: Vec<PoseDiagnosis> = derived_streams.collect();
    diagnosis.streams.extend(derived_streams);
    let reading = diagnosis.joints.encoding.as_ref().ok();
    let derived = |stream: &PoseStream| {
        let left = |found: &PoseDiagnosis| {
            found.residual.as_ref().map_or(f64::INFINITY, StreamResidual::combined_m)
        };
        let found = diagnose_derived(&arm.joints, reading, stream, max_lag_s);
        // Transforms in the log were published without corrections.
        let as_recorded = arm
            .recorded_joints
            .as_ref()
            .map(|recorded| diagnose_derived(recorded, None, stream, max_lag_s));
        match as_recorded {
            Some(as_recorded) if left(&as_recorded) < left(&found) => as_recorded,
            _ => found,
        }
    };
    let tf = || {
        let source = arm.tf.as_ref().ok()?;
        let stream = run.pose_stream(source);
        let found = derived(&stream);
        Some(match compensate_latency(&stream, &found.latency_profile) {
            None => found,
            Some(track) => {
                let stream = PoseStream { track: &track, ..stream };
                PoseDiagnosis { latency_profile: found.latency_profile, ..derived(&stream) }
            }
        })
    };
    let residuals = diagnosis.streams.iter().filter_map(|stream| stream.residual.as_ref().ok());
    let fk_error_rad = residuals.map(|residual| residual.excess_rad.value).fold(0.0, f64::max);
    let imu = |source: &ImuSource| match &diagnosis.joints.encoding {
        // Without an interpretation of the joint states, FK is meaningless.
        Err(NotObservable::NotExcited) => ImuDiagnosis::not_observable(&NotObservable::RestsOn(
            "the order and the unit of the joint positions",
        )),
        _ => {
            let stream = ImuStream { fk_error_rad, ..source.as_stream() };
            diagnose_imu_with_latency_compensation(&corrected, stream, max_lag_s)
        }
    };
    let (tf, imus) = rayon::join(tf, || arm.imus.iter().map(imu).collect());
    ArmStreamsDiagnosis { arm: diagnosis, tf, imus, dh: None, joint_clock: None, joint_topic: None }
}

/// Corrected joint states. `None` if no encoding of the joints fits the poses.
pub(super) fn readable_joints(arm: &Arm, found: &ArmDiagnosis) -> Option<JointTrack> {
    let is_unread = matches!(found.joints.encoding, Err(NotObservable::NotExcited));
    (!is_unread).then(|| found.joints.corrected_joints(&arm.joints, &arm.are_prismatic()))
}
