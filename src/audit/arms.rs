//! What the rules judge of one arm.

use std::borrow::Cow;

use rayon::prelude::*;

use super::Options;
use super::estimate::Diagnosis;
use crate::checks::{
    ArmFacts, Declared, EulerFacts, ImuFacts, JointFacts, JointMotion, Of, PoseFacts, ShakeFacts,
};
use crate::diagnosis::{
    ArmDiagnosis, JointDiagnosis, JointOffset, NoShake, PoseDiagnosis, Reading, Series, Shake,
    Unseen, abruptness, beyond_positions, beyond_speed, proof, proof_of_imu, shake,
};
use crate::finding::{Span, Subject};
use crate::geometry::{AngleUnit, Coding};
use crate::robot::JointKind;
use crate::run::{
    Arm, Declaration, JointMending, JointSamples, PoseSource, Run, Velocities, Witness,
};
use crate::stream::{Columns, JointTrack, Orientations, PoseTrack};

pub(super) fn arm_facts(run: &Run, arm: &Arm, diagnosis: Diagnosis, options: &Options) -> ArmFacts {
    let joints_stream = arm.joint_facts.first().map_or(0, |facts| facts.stream);
    let ArmDiagnosis { joints: found, streams } = diagnosis.arm;
    let mended = found.corrected_joints(&arm.joints, &arm.slides());
    let is_read = !matches!(found.reading, Err(Unseen::NotExcited));
    let most_lag_s = options.run.max_latency_s;
    let pose_facts = |source: &PoseSource, found: PoseDiagnosis, euler| PoseFacts {
        proof: proof(&arm.joints, &mended, &run.pose_stream(source), &found),
        reference: if source.reference_known {
            source.chain.base_name().to_owned()
        } else {
            run.streams[source.stream].frame_id.clone()
        },
        reference_known: source.reference_known,
        tip: source.chain.tip_name().to_owned(),
        tip_named: source.tip_named,
        witness: run.streams[source.stream].witness.unwrap_or(Witness::Unknown),
        euler,
        independent: !source.stamps_copied,
        bare_numbers: matches!(source.track.orientation, Orientations::Numbers(_)),
        bare: source.track.declared.is_none()
            && matches!(run.streams[source.stream].columns, Some(Columns::Array(_))),
        declared: source.track.declared.as_ref().map(|units| Declared {
            angles: units.in_other_angles.is_some().then_some(units.angle),
            lengths: units.length,
        }),
        diagnosis: found,
    };
    let imus = arm.imus.iter().zip(diagnosis.imus).map(|(source, diagnosis)| {
        let found = ImuFacts {
            independent: !source.stamps_copied,
            link: source.chain.tip_name().to_owned(),
            link_from_imu: source.link_from_imu.map(|pose| pose.rotation),
            proof: is_read
                .then(|| proof_of_imu(&mended, &source.as_stream(), &diagnosis, most_lag_s))
                .flatten(),
            diagnosis,
        };
        of(run, arm, source.stream, found)
    });
    let samples = run.joint_samples(&arm.joint_facts);
    let samples = match &arm.recorded {
        Some((_, mending)) => mending.mended_samples(&samples),
        None => samples,
    };
    let (samples, track) = match mending(arm, &found) {
        Some(mending) => {
            (mending.mended_samples(&samples), Cow::Owned(mending.mended(&arm.joints)))
        }
        None => (samples, Cow::Borrowed(&arm.joints)),
    };
    let joints: Vec<usize> = (0..arm.joint_names.len()).collect();
    let joint = |&joint: &usize| joint_facts(run, arm, joint, &samples[joint], &track);
    let joints = joints.par_iter().map(joint).collect();
    let of_joints =
        ShakeFacts { in_other_units: false, shake: shake_of_joints(arm, &samples, &track) };
    let mut shakes = vec![of(run, arm, joints_stream, of_joints)];
    let mut poses = Vec::new();
    for (source, found) in arm.poses.iter().zip(streams) {
        let in_other_units = matches!(found.length, Ok(Some(_)));
        let shake = shake_of_poses(&source.track, &found);
        shakes.push(of(run, arm, source.stream, ShakeFacts { in_other_units, shake }));
        let euler = euler(run, source, &found, &options.run.declared);
        poses.push(of(run, arm, source.stream, pose_facts(source, found, euler)));
    }
    let tf = arm.tf.as_ref().ok().zip(diagnosis.tf);
    let tf = tf.map(|(source, found)| of(run, arm, source.stream, pose_facts(source, found, None)));
    ArmFacts {
        name: arm.name.clone(),
        joints_topic: run.streams[joints_stream].topic.clone(),
        span: span_in(run, joints_stream),
        joints,
        reach_m: arm.chain.max_reach_m(),
        wrong_model: arm.instead_of.clone(),
        dh: diagnosis.dh,
        diagnosis: found,
        poses,
        tf,
        shakes,
        imus: imus.collect(),
        references: Vec::new(),
    }
}

/// What was found on a stream of an arm: with its topic for a subject, whatever frame it is of.
pub(super) fn of<T>(run: &Run, arm: &Arm, stream: usize, found: T) -> Of<T> {
    let (robot, topic) = (Some(arm.name.clone()), Some(run.streams[stream].topic.clone()));
    let subject = Subject { robot, topic, ..Subject::default() };
    Of { subject, span: Some(span_in(run, stream)), found }
}

/// First and last stamp of a stream.
pub(super) fn span_of(run: &Run, stream: usize) -> Option<Span> {
    let stream = run.streams.get(stream)?;
    Some(Span { start: stream.start?, end: stream.end? })
}

/// First and last stamp of a stream, else of the run.
fn span_in(run: &Run, stream: usize) -> Span {
    span_of(run, stream).unwrap_or_else(|| {
        let (start, end) = run.span.unwrap_or((run.origin, run.origin));
        Span { start, end }
    })
}

/// What makes the joint states those that the arm has, where they are far from that: how the arm moves
/// is not told by numbers that are no positions.
fn mending(arm: &Arm, found: &JointDiagnosis) -> Option<JointMending> {
    /// A smaller zero changes neither speeds nor what a limit says of them, rad or m.
    const FAR: f64 = 0.1;
    let reading = found.reading.as_ref().ok()?;
    let zero = |(joint, offset): (usize, &JointOffset)| {
        let coded = found.scales.iter().find(|scale| scale.column == joint && scale.is_coded());
        let own = offset.offset.as_ref().ok().filter(|_| offset.chosen).map_or(0.0, |it| it.value);
        coded.map_or(own, |scale| scale.offset)
    };
    let offset: Vec<f64> = found.offsets.iter().enumerate().map(zero).collect();
    if reading.is_as_logged() && offset.iter().all(|offset| offset.abs() < FAR) {
        return None;
    }
    let mut mending = JointMending { offset, ..JointMending::none(arm.joint_names.len()) };
    if let Some((really, _)) = &reading.permutation {
        really.iter().enumerate().for_each(|(named, &really)| mending.from[really] = named);
    }
    for (factor, slides) in mending.factor.iter_mut().zip(arm.slides()) {
        *factor = if reading.degrees.is_some() && !slides { 1f64.to_radians() } else { 1.0 };
    }
    reading.slips.iter().for_each(|slip| mending.factor[slip.column] *= slip.factor);
    Some(mending)
}

/// The shake of the tip by a stream of poses, but for where its clock steps: the path does, too.
fn shake_of_poses(track: &PoseTrack, found: &PoseDiagnosis) -> Result<Shake, NoShake> {
    /// Rows so near to a step are left out, s.
    const BESIDE_S: f64 = 0.1;
    let jumps = found.course.as_ref().map_or(&[][..], |course| course.jumps.as_slice());
    let is_clear = |t_s: f64| jumps.iter().all(|jump| (jump.at_s - t_s).abs() > BESIDE_S);
    let rows: Vec<usize> = (0..track.t_s.len()).filter(|&row| is_clear(track.t_s[row])).collect();
    let t_s: Vec<f64> = rows.iter().map(|&row| track.t_s[row]).collect();
    shake(&t_s, |row| track.xyz[rows[row]])
}

/// The shake of the tip by the joint states as they are, or where the joints do not share their stamps
/// by the track that they were brought to.
fn shake_of_joints(
    arm: &Arm,
    samples: &[JointSamples<'_>],
    track: &JointTrack,
) -> Result<Shake, NoShake> {
    let mut q = vec![0.0; arm.columns.len()];
    let mut tip = |position: &dyn Fn(usize) -> f64| {
        q.iter_mut().zip(&arm.columns).for_each(|(q, &column)| *q = position(column));
        arm.chain.forward(&q).translation.vector
    };
    match samples.first() {
        Some(first) if samples.iter().all(|other| other.is_beside(first)) => {
            shake(&first.t_s, |row| tip(&|column| samples[column].position[row]))
        }
        _ => shake(&track.t_s, |row| tip(&|column| track.row(row)[column])),
    }
}

/// A joint, and what it does by all of its samples.
fn joint_facts(
    run: &Run,
    arm: &Arm,
    joint: usize,
    samples: &JointSamples<'_>,
    track: &JointTrack,
) -> JointFacts {
    let name = arm.joint_names[joint].clone();
    let model = arm.robot.joint(&name);
    let limits = model.map(|joint| joint.limits).unwrap_or_default();
    let mut motion = JointMotion::default();
    if let Some(source) = arm.joint_facts.get(joint) {
        let JointSamples { t_s, position, velocity } = samples;
        let is_folded = run
            .folded
            .iter()
            .any(|folded| folded.stream == source.stream && folded.joint == source.name);
        motion.is_endless =
            is_folded || model.is_some_and(|joint| joint.kind == JointKind::Continuous);
        // What is logged within one turn has no place on a longer way.
        motion.positions = if is_folded { None } else { beyond_positions(t_s, position, &limits) };
        (motion.speeds, motion.abruptness) = match source.velocities {
            Velocities::Logged | Velocities::Near => (
                beyond_speed(t_s, velocity, &limits),
                abruptness(t_s, velocity, Series::Velocities),
            ),
            Velocities::Derived => {
                let JointTrack { t_s: times_s, dof, qd, .. } = track;
                let qd: Vec<f64> = qd.iter().skip(joint).step_by(*dof).copied().collect();
                (beyond_speed(times_s, &qd, &limits), abruptness(t_s, position, Series::Positions))
            }
        };
    }
    let prismatic = model.is_some_and(|joint| joint.kind == JointKind::Prismatic);
    JointFacts { name, prismatic, limits, motion }
}

/// How the rotations of a stream of six bare numbers are coded, and how near gimbal lock all its rows
/// are; `None` of other streams.
fn euler(
    run: &Run,
    source: &PoseSource,
    found: &PoseDiagnosis,
    declared: &[Declaration],
) -> Option<EulerFacts> {
    let stream = run.streams.get(source.stream)?;
    let Some(Columns::Array(array)) = &stream.columns else { return None };
    let clock = run.clocks.iter().find(|clock| clock.stream == source.stream)?;
    if array.width != 6 {
        return None;
    }
    let names = |declared: &&Declaration| declared.is_of(&stream.topic);
    let declared = declared.iter().find(names);
    let reading = found.reading.as_ref().ok().filter(|reading| reading.is_told);
    let told = reading.and_then(|reading| match reading.best {
        Reading::Numbers(convention) => Some(convention),
        _ => Some(reading.best.misreading()?.is),
    });
    let said = declared.and_then(|declared| match declared.coding {
        Coding::Three(convention) => Some(convention),
        _ => None,
    });
    let convention = told.or(said);
    let in_degrees = declared.is_some_and(|declared| declared.angle == AngleUnit::Degree)
        != found.degrees.is_some();
    let to_radians = if in_degrees { 1_f64.to_radians() } else { 1.0 };
    let margin = |row: usize| {
        let numbers = array.row(row);
        let numbers = [3, 4, 5].map(|at| numbers[at] * to_radians);
        Some((clock.stamp_of(&array.times, row)?, convention?.gimbal_margin(numbers)?))
    };
    Some(EulerFacts {
        convention,
        margins_rad: (0..array.times.len()).filter_map(margin).collect(),
    })
}
