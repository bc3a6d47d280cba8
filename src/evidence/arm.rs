use std::borrow::Cow;
use std::cmp::Reverse;

use rayon::prelude::*;

use super::commands::{ReferenceEvidence, references};
use super::estimate::{ArmStreamsDiagnosis, DhEvidence};
use super::joint_axes::JointAxes;
use super::joint_clock::samples_with_true_stamps;
use super::joint_stamps::{JointStamps, stamps_and_velocities};
use super::joints::{JointEvidence, change_points, joint_evidence, mending};
use super::poses::{
    DeclaredUnits, EulerEvidence, ImuEvidence, LateTransforms, PoseEvidence, euler,
    unidentified_columns,
};
use super::vibration::{VibrationEvidence, vibration_of_joints, vibration_of_poses};
use super::{StreamEvidence, arm_stream_evidence, span_or_run};
use crate::diagnosis::{
    ArmDiagnosis, EncodingSpans, EstimateResult, ImuDiagnosis, JointDiagnosis, JointScale,
    LatencyProfile, Measured, NotObservable, PoseDiagnosis, ResidualCheck, UnitResiduals,
    check_imu_residual, check_residual,
};
use crate::finding::{Span, Subject, Unit};
use crate::geometry::{Vec3, mean_vector};
use crate::run::{
    Arm, CompetingModel, ImuSource, JointSamples, PoseSource, PoseSourceKind, Run, RunOptions,
    are_of_one_body,
};
use crate::stream::{Columns, JointTrack, Orientations};

/// Robot with its streams.
#[derive(Clone, Debug)]
pub struct ArmEvidence {
    /// Robot name; empty without a model.
    pub name: String,
    /// Topic of its joint states, or of the poses in their place.
    pub joints_topic: String,
    /// Whether poses are in the place of joint states.
    pub is_trajectory: bool,
    /// Steps of the joint states' clock, which their stamps are corrected for.
    pub joint_clock: Option<LatencyProfile>,
    /// Latency of one topic of joint states against another, whose name follows.
    pub joint_topic: Option<(StreamEvidence<Measured>, String)>,
    /// Properties of the joint states' stamps, found by positions and velocities.
    pub stamps: JointStamps,
    /// The unit of its positions is unknown: columns of a table, without a model.
    pub has_unknown_units: bool,
    /// First and last stamp of the joint states.
    pub span: Span,
    /// Joints of the chain, as in `diagnosis`.
    pub joints: Vec<JointEvidence>,
    /// From base to tip at full stretch, or of a trajectory from its middle, m.
    pub reach_m: f64,
    /// Other model that fits the poses far better.
    pub better_model: Option<CompetingModel>,
    /// Other catalogue arms that fit about as well as this guess.
    pub indistinguishable_models: Vec<String>,
    /// Evidence for the DH convention, for DH tables.
    pub dh: Option<DhEvidence>,
    /// Diagnosis of its joint states.
    pub diagnosis: JointDiagnosis,
    /// Pose streams, as in the confounders of a joint offset.
    pub poses: Vec<StreamEvidence<PoseEvidence>>,
    /// Tip pose from /tf, against FK.
    pub tf: Option<StreamEvidence<PoseEvidence>>,
    /// From the joint states and each pose stream.
    pub vibrations: Vec<StreamEvidence<VibrationEvidence>>,
    /// IMUs on the arm.
    pub imus: Vec<StreamEvidence<ImuEvidence>>,
    /// Joint positions were identified as degrees by magnitude.
    pub is_in_degrees_by_magnitude: bool,
    /// Joint positions were converted from degrees, by magnitude or as declared.
    pub is_converted_from_degrees: bool,
    /// Command streams.
    pub references: Vec<StreamEvidence<ReferenceEvidence>>,
}

impl ArmEvidence {
    pub(super) fn subjects(&self) -> usize {
        let poses = self.poses_and_tf().count();
        let streams = poses + self.imus.len() + self.references.len();
        self.joints.len() + streams
    }

    /// Pose streams followed by /tf.
    pub fn poses_and_tf(&self) -> impl Iterator<Item = &StreamEvidence<PoseEvidence>> {
        self.poses.iter().chain(&self.tf)
    }

    /// Whether a pose stream is computed from the joint states, as /tf is.
    pub fn is_derived(&self, stream: &StreamEvidence<PoseEvidence>) -> bool {
        self.tf.iter().any(|tf| tf.topic() == stream.topic())
    }

    /// External if any pose stream is, controller if all are.
    pub fn pose_source_kind(&self) -> PoseSourceKind {
        let of = |witness: PoseSourceKind| {
            self.poses.iter().filter(move |s| s.source_kind == witness).count()
        };
        match (of(PoseSourceKind::External), of(PoseSourceKind::Controller)) {
            (1.., _) => PoseSourceKind::External,
            (0, controllers) if controllers == self.poses.len() => PoseSourceKind::Controller,
            _ => PoseSourceKind::Unknown,
        }
    }

    /// Maximum tip speed by FK, m/s; 0 without streams.
    pub fn top_speed_m_s(&self) -> f64 {
        self.poses_and_tf().map(|stream| stream.diagnosis.top_speed_m_s).fold(0.0, f64::max)
    }

    /// The robot.
    pub fn subject(&self) -> Subject {
        let (robot, reference) = match self.is_trajectory {
            true => (None, Some(self.joints_topic.clone())),
            false => ((!self.name.is_empty()).then(|| self.name.clone()), None),
        };
        Subject { robot, reference, ..Subject::default() }
    }

    /// The first text for an arm, the second for a body whose poses are in the place of joint states.
    pub fn arm_or_body<T>(&self, arm: T, body: T) -> T {
        if self.is_trajectory { body } else { arm }
    }

    /// A topic of this robot.
    pub fn topic(&self, topic: &str) -> Subject {
        Subject { topic: Some(topic.to_owned()), ..self.subject() }
    }

    /// A frame in a topic of this robot.
    pub fn frame(&self, topic: &str, frame: &str) -> Subject {
        Subject { frame: Some(frame.to_owned()), ..self.topic(topic) }
    }

    /// A joint of this robot.
    pub fn joint(&self, index: usize) -> Subject {
        let joint = self.joints.get(index).map(|joint| joint.name.clone());
        Subject { joint, ..self.subject() }
    }

    /// A joint in the joint states topic.
    pub fn joint_states(&self, index: usize) -> Subject {
        Subject { topic: Some(self.joints_topic.clone()), ..self.joint(index) }
    }

    /// Scale error of a joint, if any.
    pub fn scale(&self, index: usize) -> Option<&JointScale> {
        self.diagnosis.scales.iter().find(|scale| scale.column == index)
    }

    /// Position residuals, m, if joint positions that were converted from degrees are in rad. Each joint then seems to
    /// have the same scale.
    pub fn radians_as_degrees(&self) -> Option<UnitResiduals> {
        /// Relative: a nominal model against a calibrated arm.
        const SCALE_PRECISION: f64 = 0.01;
        let is_it = |scale: &JointScale| {
            (scale.factor.value * 1f64.to_radians() - 1.0).abs() < SCALE_PRECISION
        };
        let scales = &self.diagnosis.scales;
        let are_all =
            self.is_converted_from_degrees && scales.len() > 1 && scales.iter().all(is_it);
        self.diagnosis.encoding.as_ref().ok()?.residual.filter(|_| are_all)
    }

    /// Joint positions were identified as degrees, but no pose confirms it.
    pub fn is_unit_undetermined(&self) -> bool {
        self.is_in_degrees_by_magnitude && self.diagnosis.encoding.is_err()
    }

    /// Unit of a joint's positions.
    pub fn joint_unit(&self, index: usize) -> Unit {
        match self.joints.get(index) {
            Some(joint) if joint.is_prismatic => Unit::Metre,
            _ => Unit::Radian,
        }
    }
}

/// Largest distance from the mean position.
fn extent_m(xyz: &[Vec3]) -> f64 {
    let mean = mean_vector(xyz);
    xyz.iter().map(|xyz| (xyz - mean).norm()).fold(0.0, f64::max)
}

/// Infinite without a comparison.
fn as_logged_m(check: &EstimateResult<ResidualCheck>) -> f64 {
    check.as_ref().map_or(f64::INFINITY, |check| check.as_logged.length.whole.rms)
}

/// Samples of the joints in one encoding throughout the run.
fn in_one_encoding<'a>(
    mut samples: Vec<JointSamples<'a>>,
    found: &JointDiagnosis,
) -> Vec<JointSamples<'a>> {
    if found.partial_encoding.is_some() {
        for patch in &found.patches {
            if let Some(other) = patch.exchanged_with
                && let Ok([a, b]) = samples.get_disjoint_mut([patch.column, other])
                && a.has_same_times(b)
            {
                let rows = patch.rows(&a.t_s);
                for (a, b) in
                    [(&mut a.position, &mut b.position), (&mut a.velocity, &mut b.velocity)]
                {
                    a.to_mut()[rows.clone()].swap_with_slice(&mut b.to_mut()[rows.clone()]);
                }
            }
            let JointSamples { t_s, position, velocity } = &mut samples[patch.column];
            patch.apply_to_samples(t_s, position.to_mut(), velocity.to_mut());
        }
    }
    samples
}

pub(super) fn arm_evidence(
    run: &Run,
    index: usize,
    diagnosis: ArmStreamsDiagnosis,
    options: &RunOptions,
) -> ArmEvidence {
    let arm = &run.arms[index];
    let ArmDiagnosis { joints: found, streams } = diagnosis.arm;
    let joints_stream = joints_stream(arm);
    let corrected =
        found.without_eccentricity().corrected_joints(&arm.joints, &arm.are_prismatic());
    let poses = PoseEvidenceOfArm { run, arm, corrected: &corrected };
    let of_joints = || joint_evidences(run, arm, joints_stream, &diagnosis.joint_clock, &found);
    let of_stream = |(source, mut found): (&PoseSource, PoseDiagnosis)| {
        if run.streams[source.stream].lacks_rotation() {
            found.encoding = Err(NotObservable::NoOrientation);
        }
        let in_other_units = matches!(found.length_unit, Ok(Some(_)));
        let vibration = vibration_of_poses(&source.track, &found, &arm.joints);
        let vibration = VibrationEvidence { in_other_units, vibration };
        let vibration = arm_stream_evidence(run, arm, source.stream, vibration);
        let euler = euler(run, source, &found);
        let pose = poses.evidence(source, found, euler);
        (arm_stream_evidence(run, arm, source.stream, pose), vibration)
    };
    let of_streams =
        || -> (Vec<_>, Vec<_>) { arm.poses.par_iter().zip(streams).map(of_stream).unzip() };
    let of_tf = || {
        let (source, found) = arm.tf.as_ref().ok().zip(diagnosis.tf)?;
        let tf = poses.tf_evidence(source, found);
        Some(arm_stream_evidence(run, arm, source.stream, tf))
    };
    let is_read = !matches!(found.encoding, Err(NotObservable::NotExcited));
    let of_imu = |(source, diagnosis): (&ImuSource, ImuDiagnosis)| {
        let proof = is_read
            .then(|| {
                let stream = source.as_stream();
                check_imu_residual(&corrected, &stream, &diagnosis, options.max_latency_s)
            })
            .flatten();
        let imu = ImuEvidence {
            has_independent_stamps: !source.stamps_copied,
            link: source.chain.tip_name().to_owned(),
            link_from_imu: source.link_from_imu.map(|pose| pose.rotation),
            proof,
            diagnosis,
        };
        arm_stream_evidence(run, arm, source.stream, imu)
    };
    let of_imus = || arm.imus.iter().zip(diagnosis.imus).map(of_imu).collect::<Vec<_>>();
    let ((stamps, joints, vibration), ((poses, vibrations), (tf, imus))) =
        rayon::join(of_joints, || rayon::join(of_streams, || rayon::join(of_tf, of_imus)));
    let (is_in_degrees_by_magnitude, is_declared_in_degrees) = degrees(run, joints_stream);
    ArmEvidence {
        name: arm.name.clone(),
        joints_topic: run.streams[joints_stream].topic.clone(),
        is_trajectory: arm.trajectory.is_some(),
        joint_clock: diagnosis.joint_clock,
        joint_topic: diagnosis.joint_topic.map(|late| {
            let other = run.streams[late.other].topic.clone();
            (arm_stream_evidence(run, arm, late.stream, late.latency_s), other)
        }),
        stamps,
        has_unknown_units: false,
        span: span_or_run(run, joints_stream),
        joints,
        reach_m: match &arm.trajectory {
            Some(trajectory) => extent_m(&trajectory.track.xyz),
            None => arm.chain.max_reach_m(),
        },
        better_model: arm.competing.clone(),
        indistinguishable_models: arm.indistinguishable.clone(),
        dh: diagnosis.dh,
        is_in_degrees_by_magnitude,
        is_converted_from_degrees: is_in_degrees_by_magnitude || is_declared_in_degrees,
        diagnosis: found,
        references: references(run, index, &poses, options.max_latency_s),
        poses,
        tf,
        vibrations: [vec![vibration], vibrations].concat(),
        imus,
    }
}

/// The stream with most of the arm's joints, or that of the poses in their place.
fn joints_stream(arm: &Arm) -> usize {
    if let Some(trajectory) = &arm.trajectory {
        return trajectory.stream;
    }
    // A rail may have a topic of its own.
    let joints_in =
        |stream: usize| arm.joint_sources.iter().filter(|source| source.stream == stream).count();
    let streams = arm.joint_sources.iter().map(|source| source.stream);
    streams.max_by_key(|&stream| (joints_in(stream), Reverse(stream))).unwrap_or(0)
}

/// Whether the joint states were converted from degrees by magnitude, and whether as declared.
fn degrees(run: &Run, joints_stream: usize) -> (bool, bool) {
    let columns = run.streams.get(joints_stream).and_then(|stream| stream.columns.as_ref());
    let Some(Columns::Joints(joints)) = columns else { return (false, false) };
    let is_degree = |line: &[f64; 2]| *line == [1f64.to_radians(), 0.0];
    let are_degrees = joints.conversions.iter().all(is_degree);
    (joints.converted_from_degrees, !joints.conversions.is_empty() && are_degrees)
}

/// Stamps, joints and vibration of the joint states.
fn joint_evidences(
    run: &Run,
    arm: &Arm,
    joints_stream: usize,
    joint_clock: &Option<LatencyProfile>,
    found: &JointDiagnosis,
) -> (JointStamps, Vec<JointEvidence>, StreamEvidence<VibrationEvidence>) {
    let mut samples = run.joint_samples(&arm.joint_sources);
    if let Some(profile) = joint_clock {
        samples.iter_mut().for_each(|joint| *joint = samples_with_true_stamps(joint, profile));
    }
    let change_points = change_points(found, arm.joint_sources.len());
    let (stamps, mut velocities) = stamps_and_velocities(&samples, &change_points);
    if found.partial_encoding.is_some() {
        let why = NotObservable::RestsOn("one unit of the joint positions throughout the run");
        velocities.iter_mut().flatten().for_each(|velocity| *velocity = Err(why.clone()));
    }
    let correction = mending(arm, found);
    let actual = arm.joint_correction.as_ref().or(correction.as_ref()).cloned();
    let samples = match &arm.joint_correction {
        Some(mending) => mending.apply_to_samples(&samples),
        None => samples,
    };
    let samples = in_one_encoding(samples, found);
    let track = found.in_one_encoding(&arm.joints);
    let (samples, track) = match correction {
        Some(mending) => (mending.apply_to_samples(&samples), Cow::Owned(mending.apply(&track))),
        None => (samples, track),
    };
    let joints = || {
        let joint = |joint| joint_evidence(run, arm, joint, &samples[joint]);
        (0..arm.joint_sources.len()).into_par_iter().map(joint).collect::<Vec<JointEvidence>>()
    };
    let vibration = || {
        let vibration = vibration_of_joints(arm, &samples, &track);
        let vibration = VibrationEvidence { in_other_units: false, vibration };
        arm_stream_evidence(run, arm, joints_stream, vibration)
    };
    let (mut joints, vibration) = rayon::join(joints, vibration);
    for (index, (joint, velocity)) in joints.iter_mut().zip(velocities).enumerate() {
        joint.velocity = velocity;
        joint.actual = actual.as_ref().map(|actual| (actual.from[index], actual.factor[index]));
    }
    (stamps, joints, vibration)
}

/// Makes the evidence of an arm's pose streams.
struct PoseEvidenceOfArm<'a> {
    run: &'a Run,
    arm: &'a Arm,
    /// Joint states with the faults found corrected.
    corrected: &'a JointTrack,
}

impl PoseEvidenceOfArm<'_> {
    fn evidence(
        &self,
        source: &PoseSource,
        found: PoseDiagnosis,
        euler: Option<EulerEvidence>,
    ) -> PoseEvidence {
        let Self { run, arm, corrected } = *self;
        let stream = &run.streams[source.stream];
        // Numbers whose encoding changes contradict themselves, declared or not.
        let is_undeclared =
            source.track.declared.is_none() && found.encoding_spans == EncodingSpans::default();
        let alternation = run.tool_switching.iter().find(|(stream, _)| *stream == source.stream);
        PoseEvidence {
            proof: check_residual(&arm.joints, corrected, &run.pose_stream(source), &found),
            reference: match source.reference_known {
                true => source.chain.base_name().to_owned(),
                false => stream.reference.as_ref().unwrap_or(&stream.frame_id).clone(),
            },
            reference_known: source.reference_known,
            tip: source.chain.tip_name().to_owned(),
            is_tip_declared: source.tip_named,
            is_tip_of_child_frame: stream
                .logged_child_frame()
                .is_some_and(|child| child.ends_with(source.chain.tip_name())),
            is_of_reference_body: arm.trajectory.as_ref().is_some_and(|trajectory| {
                are_of_one_body(&run.streams, [trajectory.stream, source.stream])
            }),
            source_kind: stream.source_kind.unwrap_or(PoseSourceKind::Unknown),
            euler,
            labels: stream.labels.filter(|_| is_undeclared),
            named_units: stream.named_units,
            names_no_frame: stream.frame_id.is_empty() && !stream.cells.is_empty(),
            unidentified_columns: unidentified_columns(run, source),
            is_uncorrected: false,
            joint_axes: JointAxes::in_the_middle(&source.chain, &source.columns, &arm.joints),
            has_independent_stamps: !source.stamps_copied,
            has_bare_numbers: matches!(source.track.orientation, Orientations::Numbers(_)),
            is_undeclared: is_undeclared && stream.lacks_encoding(),
            declared: source.track.declared.as_ref().map(|units| DeclaredUnits {
                angles: units.in_other_angles.is_some().then_some(units.angle),
                lengths: units.length,
            }),
            late_transforms: LateTransforms::of(run, source),
            alternation: alternation.map(|(_, alternation)| alternation.converted_to_m(&found)),
            diagnosis: found,
        }
    }

    /// Its residual is that against the joint states as recorded, if that is smaller.
    fn tf_evidence(&self, source: &PoseSource, found: PoseDiagnosis) -> PoseEvidence {
        let tf = self.evidence(source, found, None);
        let Some(recorded) = &self.arm.recorded_joints else { return tf };
        let stream = self.run.pose_stream(source);
        let as_recorded = check_residual(recorded, recorded, &stream, &tf.diagnosis);
        match as_logged_m(&as_recorded) < as_logged_m(&tf.proof) {
            true => PoseEvidence { proof: as_recorded, is_uncorrected: true, ..tf },
            false => tf,
        }
    }
}
