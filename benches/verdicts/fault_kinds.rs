//! Kinds of faults: their effect on a run, and the findings that name them.

use std::f64::consts::PI;
use std::fmt;

use nalgebra::Matrix3;
use poseaudit::checks::{self, Grade};
use poseaudit::finding::Unit;
use poseaudit::geometry::{
    Misinterpretation, Pose, QuaternionOrderError, Vec3, misinterpretation_classes, pose,
    rotation_from_rotvec,
};
use poseaudit::robot::{Chain, JointKind};
use poseaudit::synth::{
    self, Camera, Commands, LoggedEncoding, Scenario, SecondPublisher, SynthCompliance,
    SynthComplianceKind,
};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::backgrounds::gravity_loaded_joints;

/// Chain of the joint states.
pub fn chain(run: &Scenario) -> Chain {
    let link = |name: &str| run.robot.link(name).expect("a link of the arm");
    let first = run.root.as_deref().unwrap_or(&run.base);
    run.robot.chain(link(first), link(&run.tip)).expect("a chain from base to tip")
}

pub const DEGREE: f64 = PI / 180.0;

/// Planted magnitudes, in units of the rule's first threshold.
pub const MAGNITUDES: [f64; 8] = [0.1, 0.3, 0.6, 0.9, 1.25, 2.0, 5.0, 20.0];
/// Minimum magnitude of a fault that must be found.
pub const MIN_MAGNITUDE_TO_FIND: f64 = 2.0;

/// A fault in a log.
pub struct PlantedFault {
    pub kind: FaultKind,
    /// Codes of which one must name it; the first is the usual one.
    pub codes: &'static [&'static str],
    /// Prefixes of codes of further correct findings.
    pub related_codes: &'static [&'static str],
    /// Topic or joint; `None` if any is correct.
    pub subject: Option<String>,
    /// Magnitude in first thresholds; infinite if the fault has none.
    pub magnitude: f64,
    pub truth: TrueValue,
}

#[derive(Clone, Copy)]
pub enum TrueValue {
    Amount(f64),
    Frame { length_m: f64, angle_rad: f64 },
    Convention(Misinterpretation),
    NoValue,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum FaultKind {
    PoseLate,
    ImuLate,
    TfLate,
    JointsLate,
    Skew,
    Zero,
    Growth,
    Reference,
    BaseTurned,
    Tool,
    YawDrift,
    YawJump,
    Mount,
    GyroBias,
    Misread,
    ImuMisread,
    Wxyz,
    ImuWxyz,
    Transposed,
    Inverted,
    ImuTransposed,
    JointDegrees,
    JointOrder,
    Millimetres,
    LengthUnit,
    Axes,
    Constant,
    Unset,
    OwnFrame,
    Homed,
    Reversed,
    Geared,
    HeldPose,
    HeldJoints,
    StuckPose,
    StuckJoints,
    ClockStep,
    SecondTfDiffers,
    WrongArm,
    ToolChanges,
    BaseChanges,
    ZeroChanges,
    ScaleChanges,
    GrowthChanges,
    OrderChanges,
    UnitChanges,
    Alternates,
    LatencyStep,
    LatencyRamp,
    HeldAge,
    Play,
    Sag,
    Shake,
    VelocityScale,
    VelocityLate,
    CommandLate,
    TagSize,
    GyroDegrees,
    AccelInG,
    BiasSteps,
    BiasWarmsUp,
    ImuSlips,
    YawWarmsUp,
    YawByHeading,
}

impl FaultKind {
    /// Whether it changes only a part of a continuous run.
    pub fn is_within_run(self) -> bool {
        use FaultKind::*;
        matches!(
            self,
            LatencyStep | LatencyRamp | ClockStep | StuckPose | StuckJoints | BiasWarmsUp
        )
    }

    /// Whether it replaces the run from some time on, so that it must be planted after faults of the whole
    /// run.
    pub fn starts_mid_run(self) -> bool {
        use FaultKind::*;
        matches!(
            self,
            ToolChanges
                | BaseChanges
                | Alternates
                | ZeroChanges
                | ScaleChanges
                | GrowthChanges
                | OrderChanges
                | UnitChanges
                | BiasSteps
                | ImuSlips
        )
    }
}

/// A kind of fault.
pub struct FaultSpec {
    pub kind: FaultKind,
    /// Codes of which one must name it.
    pub codes: &'static [&'static str],
    /// Prefixes of codes of further correct findings.
    pub related_codes: &'static [&'static str],
    /// Resources it uses exclusively: two faults that share a slot are indistinguishable or cannot be
    /// combined.
    pub slots: &'static [&'static str],
}

const fn fault_spec(
    kind: FaultKind,
    codes: &'static [&'static str],
    related_codes: &'static [&'static str],
    slots: &'static [&'static str],
) -> FaultSpec {
    FaultSpec { kind, codes, related_codes, slots }
}

/// Slots of the tool pose stream.
const POSE_SLOTS: &[&str] = &[
    "pose time", "skew", "growth", "reference", "tool", "pose coding", "pose units", "pose rows",
    "changes",
];
/// Slots that depend on the joint states.
const ALL_SLOTS: &[&str] = &[
    "pose time", "skew", "growth", "reference", "tool", "pose coding", "pose units", "pose rows",
    "imu time", "tf time", "tf", "joint numbers", "drift", "mount", "gyro", "imu coding",
    "changes", "gives", "velocities", "commands", "target",
];

/// Every kind of fault.
pub const FAULT_SPECS: [FaultSpec; 63] = [
    fault_spec(FaultKind::PoseLate, &["LAT001"], &[], &["pose time"]),
    fault_spec(FaultKind::ImuLate, &["LAT001"], &[], &["imu time"]),
    fault_spec(FaultKind::TfLate, &["LAT001"], &[], &["tf time"]),
    fault_spec(FaultKind::JointsLate, &["LAT001"], &[], &["pose time", "imu time", "tf time"]),
    fault_spec(FaultKind::Skew, &["LAT002"], &[], &["skew"]),
    fault_spec(FaultKind::Zero, &["ZER001"], &[], &[]),
    fault_spec(FaultKind::Growth, &["ZER002"], &[], &["growth"]),
    fault_spec(FaultKind::Reference, &["FRM002"], &[], &["reference"]),
    fault_spec(FaultKind::BaseTurned, &["FRM002"], &[], &["reference"]),
    fault_spec(FaultKind::Tool, &["FRM003"], &[], &["tool"]),
    fault_spec(FaultKind::YawDrift, &["YAW001"], &[], &["drift"]),
    fault_spec(FaultKind::YawJump, &["YAW001"], &[], &["drift"]),
    fault_spec(FaultKind::Mount, &["YAW003"], &[], &["mount"]),
    fault_spec(FaultKind::GyroBias, &["YAW004"], &[], &["gyro"]),
    fault_spec(FaultKind::Misread, &["ORD001"], &[], &["pose coding"]),
    fault_spec(FaultKind::ImuMisread, &["ORD001"], &[], &["imu coding", "mount"]),
    fault_spec(FaultKind::Wxyz, &["ORD002"], &[], &["pose coding"]),
    fault_spec(FaultKind::ImuWxyz, &["ORD002"], &[], &["imu coding", "mount"]),
    fault_spec(FaultKind::Transposed, &["ORD003"], &[], &["pose coding"]),
    fault_spec(FaultKind::Inverted, &["ORD003"], &[], &["pose coding"]),
    fault_spec(FaultKind::ImuTransposed, &["ORD003"], &[], &["imu coding", "mount"]),
    fault_spec(FaultKind::JointDegrees, &["ORD004"], &[], &["joint numbers"]),
    fault_spec(FaultKind::JointOrder, &["ORD005"], &[], &["joint numbers"]),
    fault_spec(FaultKind::Millimetres, &["ORD008"], &[], &["pose units"]),
    fault_spec(FaultKind::LengthUnit, &["ORD008"], &[], &["pose units", "growth"]),
    fault_spec(FaultKind::Axes, &["ORD010"], &["FRM002", "ORD"], &["pose coding", "reference"]),
    fault_spec(FaultKind::Constant, &["ORD011"], &["MDL001", "FRM"], POSE_SLOTS),
    fault_spec(FaultKind::Unset, &["FRM007", "FRM005", "ORD"], &["FRM"], &["pose coding", "tool"]),
    fault_spec(FaultKind::OwnFrame, &["FRM007", "FRM002"], &["FRM", "ORD003"], POSE_SLOTS),
    fault_spec(
        FaultKind::Homed,
        // Quarter and half turns are ORD009.
        &["ZER001", "ORD009"],
        &["FRM002", "FRM003", "MOT003"],
        &["joint numbers", "reference", "tool"],
    ),
    fault_spec(FaultKind::Reversed, &["ORD009"], &["VEL", "MOT003"], ALL_SLOTS),
    fault_spec(FaultKind::Geared, &["ORD009"], &["VEL", "MOT003"], ALL_SLOTS),
    fault_spec(FaultKind::HeldPose, &["TIM008"], &["LAT001"], POSE_SLOTS),
    fault_spec(FaultKind::HeldJoints, &["TIM008"], &["LAT001", "VEL"], ALL_SLOTS),
    fault_spec(FaultKind::StuckPose, &["TIM007"], &["TIM"], POSE_SLOTS),
    fault_spec(
        FaultKind::StuckJoints,
        &["TIM007"],
        &["TIM", "LAT", "MDL", "MOT", "VEL"],
        ALL_SLOTS,
    ),
    fault_spec(FaultKind::ClockStep, &["LAT003"], &["LAT001", "TIM"], POSE_SLOTS),
    fault_spec(FaultKind::SecondTfDiffers, &["FRM004"], &["FRM001", "TIM"], &["tf time", "tf"]),
    fault_spec(FaultKind::WrongArm, &["MDL001"], &["FRM001"], ALL_SLOTS),
    fault_spec(FaultKind::ToolChanges, &["FRM003"], &[], &["tool", "changes"]),
    fault_spec(FaultKind::BaseChanges, &["FRM002"], &[], &["reference", "changes"]),
    fault_spec(FaultKind::ZeroChanges, &["ZER001"], &[], &["changes"]),
    // The positions jump there.
    fault_spec(FaultKind::ScaleChanges, &["ORD009"], &["VEL", "MOT002", "MOT003"], ALL_SLOTS),
    fault_spec(FaultKind::GrowthChanges, &["ZER002"], &[], &["growth", "changes"]),
    fault_spec(FaultKind::OrderChanges, &["ORD002"], &[], &["pose coding", "changes"]),
    fault_spec(FaultKind::UnitChanges, &["ORD008"], &[], &["pose units", "growth", "changes"]),
    fault_spec(FaultKind::Alternates, &["FRM003"], &[], &["tool", "changes", "pose rows"]),
    fault_spec(FaultKind::LatencyStep, &["LAT003"], &["LAT001"], &["pose time", "skew", "changes"]),
    fault_spec(FaultKind::LatencyRamp, &["LAT003"], &["LAT001"], &["pose time", "skew", "changes"]),
    fault_spec(FaultKind::Play, &["MOT006"], &[], &["gives"]),
    fault_spec(FaultKind::Sag, &["ZER003"], &[], &["gives"]),
    fault_spec(FaultKind::Shake, &["MOT001"], &[], &["gives", "pose units"]),
    fault_spec(FaultKind::VelocityScale, &["VEL001"], &[], &["velocities", "joint numbers"]),
    fault_spec(FaultKind::VelocityLate, &["VEL001"], &[], &["velocities", "joint numbers"]),
    fault_spec(FaultKind::CommandLate, &["LAT004"], &[], &["commands", "tf time", "joint numbers"]),
    fault_spec(FaultKind::TagSize, &["HEC001"], &[], &["target", "joint numbers", "tf time"]),
    fault_spec(FaultKind::GyroDegrees, &["ORD004"], &[], &["gyro", "imu units"]),
    fault_spec(FaultKind::AccelInG, &["ORD008"], &[], &["imu units"]),
    fault_spec(FaultKind::BiasSteps, &["YAW004"], &[], &["gyro", "mount", "changes"]),
    fault_spec(FaultKind::BiasWarmsUp, &["YAW004"], &[], &["gyro", "mount"]),
    fault_spec(FaultKind::ImuSlips, &["YAW003"], &[], &["mount", "drift", "gyro", "changes"]),
    fault_spec(FaultKind::YawWarmsUp, &["YAW001"], &[], &["drift"]),
    fault_spec(FaultKind::YawByHeading, &["YAW001"], &[], &["drift"]),
];

impl fmt::Display for PlantedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let subject = self.subject.as_deref().unwrap_or("");
        write!(f, "{} {subject} {:?}", self.codes[0], self.kind)?;
        match self.truth {
            TrueValue::Amount(value) => write!(f, " {value:.6} (×{})", self.magnitude),
            TrueValue::Frame { length_m, angle_rad } => {
                write!(
                    f,
                    " {:.3} mm {:.3}° (×{})",
                    length_m * 1e3,
                    angle_rad / DEGREE,
                    self.magnitude
                )
            }
            TrueValue::Convention(Misinterpretation { is, read_as }) => {
                write!(f, " {is} as {read_as}")
            }
            TrueValue::NoValue => Ok(()),
        }
    }
}

/// Plants one fault of `position_factor` the first threshold, with a random sign.
pub fn plant(
    run: &mut Scenario,
    r: &mut Pcg64,
    spec: &FaultSpec,
    joint: usize,
    times: f64,
) -> PlantedFault {
    let kind = spec.kind;
    let sign = if r.random_bool(0.5) { 1.0 } else { -1.0 };
    let thresholds = first_thresholds(spec.codes[0]);
    let amount = sign * times * thresholds.first().map_or(0.0, |threshold| threshold.1);
    let direction = unit_vector(r);
    let topic = |name: &str| Some(format!("{}{name}", run.namespace));
    let (pose_topic, imu_topic) = (topic(synth::POSE), topic(synth::IMU));
    let joints_topic = topic(synth::JOINT_STATES);
    let mut subject = pose_topic;
    let mut truth = TrueValue::Amount(amount);
    let mut times = times;
    // Faults without a magnitude, or with a different one than the rule's thresholds.
    let mut has_no_value = thresholds.is_empty();
    match kind {
        FaultKind::PoseLate => run.pose.timing.latency_s += amount,
        FaultKind::ImuLate => {
            run.imu.timing.latency_s += amount;
            subject = imu_topic;
        }
        FaultKind::TfLate => {
            run.tf.timing.latency_s += amount;
            subject = Some(synth::TF.to_owned());
        }
        FaultKind::JointsLate => {
            // If the joints are early, everything else is late, which has the opposite sign.
            run.joints.timing.latency_s += amount.abs();
            truth = TrueValue::Amount(amount.abs());
            subject = joints_topic;
        }
        FaultKind::Skew => run.pose.timing.skew = amount,
        FaultKind::Zero => {
            let chain = chain(run);
            let amount = match chain.joint_kinds()[joint] {
                JointKind::Prismatic => sign * times * 0.2e-3,
                _ => sign * times * 0.1 * DEGREE,
            };
            run.joints.zero_offsets.resize(chain.dof(), 0.0);
            run.joints.zero_offsets[joint] = amount;
            truth = TrueValue::Amount(amount);
            subject = Some(chain.joint_names()[joint].clone());
        }
        FaultKind::Homed => {
            let chain = chain(run);
            let amount = sign * *choose(r, &[5.0, 10.0, 30.0, 45.0, 90.0, 120.0, 180.0]) * DEGREE;
            run.joints.zero_offsets.resize(chain.dof(), 0.0);
            run.joints.zero_offsets[joint] = amount;
            // The value is in the benchmark's own table of homed joints, modulo a turn.
            has_no_value = true;
            subject = Some(chain.joint_names()[joint].clone());
        }
        FaultKind::Reversed | FaultKind::Geared => {
            let chain = chain(run);
            run.joints.scales.resize(chain.dof(), 1.0);
            run.joints.scales[joint] = match kind {
                FaultKind::Reversed => -1.0,
                _ => *choose(r, &[2.0, 0.5, 1.1, 3.0, -2.0, 100.0 / PI, 4096.0 / (2.0 * PI)]),
            };
            subject = Some(chain.joint_names()[joint].clone());
        }
        FaultKind::Growth => run.pose.radial_scale_error = amount,
        FaultKind::Reference | FaultKind::Tool => {
            let (length_m, angle_rad) = match r.random_range(0..3) {
                0 => (times * 1e-3, 0.0),
                1 => (0.0, times * 0.1 * DEGREE),
                _ => (times * 1e-3, times * 0.1 * DEGREE),
            };
            let offset = pose(
                (length_m * unit_vector(r)).into(),
                rotation_from_rotvec(angle_rad * direction),
            );
            match kind {
                FaultKind::Tool => run.pose.tip_from_stream = offset,
                _ => run.pose.reference_from_stream = offset,
            }
            truth = TrueValue::Frame { length_m, angle_rad };
        }
        FaultKind::BaseTurned => {
            let turned: Pose = pose([0.0; 3], rotation_from_rotvec(PI * Vec3::z()));
            run.pose.reference_from_stream = turned;
            truth = TrueValue::Frame { length_m: 0.0, angle_rad: PI };
            times = f64::INFINITY;
        }
        FaultKind::YawDrift => {
            run.imu.yaw_drift_rad_s = amount;
            subject = imu_topic;
        }
        FaultKind::YawJump => {
            let amount = sign * times * thresholds.last().map_or(0.0, |threshold| threshold.1);
            let at_s = run.duration_s * r.random_range(0.2..0.8);
            run.imu.yaw_jumps = vec![(at_s, amount)];
            truth = TrueValue::Amount(amount);
            subject = imu_topic;
        }
        FaultKind::Mount => {
            run.imu.mount_error = pose([0.0; 3], rotation_from_rotvec(amount.abs() * direction));
            truth = TrueValue::Amount(amount.abs());
            subject = imu_topic;
        }
        FaultKind::GyroBias => {
            run.imu.gyro_bias_rad_s = amount.abs() * direction;
            truth = TrueValue::Amount(amount.abs());
            subject = imu_topic;
        }
        FaultKind::Misread | FaultKind::ImuMisread => {
            let classes = misinterpretation_classes();
            // The usual ones are more frequent.
            let class = match r.random_bool(0.3) {
                true => &classes[r.random_range(0..classes.len().min(12))],
                false => choose(r, classes),
            };
            let misinterpretation = *choose(r, &class.members);
            truth = TrueValue::Convention(misinterpretation);
            if kind == FaultKind::Misread {
                run.pose.encoding = LoggedEncoding::Misinterpreted(misinterpretation);
            } else {
                run.imu.encoding = LoggedEncoding::Misinterpreted(misinterpretation);
                subject = imu_topic;
            }
        }
        FaultKind::Wxyz => {
            run.pose.encoding = LoggedEncoding::WrongQuaternionOrder(quaternion_order_error(r))
        }
        FaultKind::ImuWxyz => {
            run.imu.encoding = LoggedEncoding::WrongQuaternionOrder(quaternion_order_error(r));
            subject = imu_topic;
        }
        FaultKind::Transposed => run.pose.encoding = LoggedEncoding::Transposed,
        FaultKind::Inverted => run.pose.encoding = LoggedEncoding::Inverted,
        FaultKind::ImuTransposed => {
            run.imu.encoding = LoggedEncoding::Transposed;
            subject = imu_topic;
        }
        FaultKind::JointDegrees => {
            run.joints.is_in_degrees = true;
            subject = joints_topic;
        }
        FaultKind::JointOrder => {
            run.joints.number_order = Some(wrong_joint_order(r, chain(run).dof()));
            subject = joints_topic;
        }
        FaultKind::Millimetres => run.pose.is_in_millimetres = true,
        FaultKind::LengthUnit => {
            run.pose.position_factor = *choose(r, &[100.0, 1.0 / 0.0254, 1e4, 10.0])
        }
        FaultKind::Axes => run.pose.axes = Some(wrong_axes(r)),
        FaultKind::Constant => run.pose.constant_coordinate = Some((r.random_range(0..3), 0.0)),
        FaultKind::Unset => {
            run.pose.unset_quaternion = Some(*choose(r, &[[0.0; 4], [0.0, 0.0, 0.0, 1.0]]));
        }
        FaultKind::OwnFrame => run.pose.frame_id = run.tip.clone(),
        FaultKind::HeldPose => {
            let hz = run.pose.timing.rate_hz;
            let rows = *choose(r, &[2.0, 3.0, 5.0, 6.25]);
            run.pose.timing.update_hz = hz / rows;
            (truth, times) = repeated_share(rows, &thresholds);
        }
        FaultKind::HeldJoints => {
            let hz = run.joints.timing.rate_hz;
            let rows = *choose(r, &[2.0, 4.0, 5.0]);
            run.joints.timing.update_hz = hz / rows;
            (truth, times) = repeated_share(rows, &thresholds);
            subject = joints_topic;
        }
        FaultKind::StuckPose => run.pose.frozen_s = Some(span_mid_run(run, r)),
        FaultKind::StuckJoints => {
            run.joints.frozen_s = Some(span_mid_run(run, r));
            subject = joints_topic;
        }
        FaultKind::ClockStep => {
            let by_s = sign * *choose(r, &[0.03, 0.08, 0.2, 0.5]);
            run.pose.timing.clock_step = Some((run.duration_s * r.random_range(0.3..0.7), by_s));
            has_no_value = true;
        }
        FaultKind::SecondTfDiffers => {
            let by = pose((*choose(r, &[3e-3, 5e-3, 0.02]) * direction).into(), Default::default());
            let mut timing = run.tf.timing.clone();
            timing.rate_hz = *choose(r, &[timing.rate_hz, 30.0, 100.0]);
            timing.phase_s += 0.0041;
            run.tf.second = Some(SecondPublisher { timing, offset_joint: Some((joint, by)) });
            subject = None;
        }
        FaultKind::WrongArm => {
            has_no_value = true;
        }
        _ => {
            return plant_change_or_other_stream(run, r, spec, joint, times);
        }
    }
    if has_no_value {
        times = f64::INFINITY;
        truth = match truth {
            TrueValue::Convention(_) => truth,
            _ => TrueValue::NoValue,
        };
    }
    PlantedFault {
        kind,
        codes: spec.codes,
        related_codes: spec.related_codes,
        subject,
        magnitude: times,
        truth,
    }
}

/// Plants changes within the run, compliance, and faults of streams other than poses.
fn plant_change_or_other_stream(
    run: &mut Scenario,
    r: &mut Pcg64,
    spec: &FaultSpec,
    joint: usize,
    times: f64,
) -> PlantedFault {
    let kind = spec.kind;
    let sign = if r.random_bool(0.5) { 1.0 } else { -1.0 };
    let thresholds = first_thresholds(spec.codes[0]);
    let amount = sign * times * thresholds.first().map_or(0.0, |threshold| threshold.1);
    let direction = unit_vector(r);
    let topic = |name: &str| Some(format!("{}{name}", run.namespace));
    let [pose_topic, imu_topic, joints_topic] =
        [synth::POSE, synth::IMU, synth::JOINT_STATES].map(topic);
    let target_topic = topic(synth::TARGET);
    let chain = chain(run);
    let joint_name = |joint: usize| Some(chain.joint_names()[joint].clone());
    let at_s = run.duration_s * r.random_range(0.3..0.7);
    let (mut subject, mut times) = (pose_topic, times);
    let truth = match kind {
        FaultKind::ToolChanges | FaultKind::BaseChanges | FaultKind::Alternates => {
            // Bodies on one tool are some distance apart.
            times = if kind == FaultKind::Alternates { times.max(20.0) } else { times };
            let (length_m, angle_rad) = match r.random_range(0..3) {
                0 => (times * 1e-3, 0.0),
                1 if kind != FaultKind::Alternates => (0.0, times * 0.1 * DEGREE),
                _ => (times * 1e-3, times * 0.1 * DEGREE),
            };
            let turn = rotation_from_rotvec(angle_rad * unit_vector(r));
            let by: Pose = pose((length_m * direction).into(), turn);
            let mut moved = run.clone();
            match kind {
                FaultKind::BaseChanges => moved.pose.reference_from_stream *= by,
                _ => moved.pose.tip_from_stream *= by,
            }
            if kind == FaultKind::Alternates {
                let usual = run.clone();
                let mut at_s = run.duration_s * r.random_range(0.1..0.2);
                while at_s < 0.9 * run.duration_s {
                    let to_s = at_s + r.random_range(0.5..2.0);
                    run.changes.extend([(at_s, moved.clone()), (to_s, usual.clone())]);
                    at_s = to_s + r.random_range(1.5..4.0);
                }
            } else {
                run.changes = vec![(at_s, moved)];
            }
            TrueValue::Frame { length_m, angle_rad }
        }
        FaultKind::ZeroChanges => {
            let amount = match chain.joint_kinds()[joint] {
                JointKind::Prismatic => sign * times * 0.2e-3,
                _ => sign * times * 0.1 * DEGREE,
            };
            change_from(run, at_s, |run| {
                run.joints.zero_offsets.resize(chain.dof(), 0.0);
                run.joints.zero_offsets[joint] += amount;
            });
            subject = joint_name(joint);
            TrueValue::Amount(amount)
        }
        FaultKind::ScaleChanges => {
            let factor = *choose(r, &[-1.0, 2.0, 0.5, 1.1, 0.9]);
            change_from(run, at_s, |run| {
                run.joints.scales.resize(chain.dof(), 1.0);
                run.joints.scales[joint] = factor;
            });
            subject = joint_name(joint);
            times = f64::INFINITY;
            // `q_true = factor · q_reported`, and 1 before.
            TrueValue::Amount(1.0 / factor - 1.0)
        }
        FaultKind::GrowthChanges => {
            change_from(run, at_s, |run| run.pose.radial_scale_error += amount);
            TrueValue::Amount(amount)
        }
        FaultKind::OrderChanges => {
            let coding = LoggedEncoding::WrongQuaternionOrder(quaternion_order_error(r));
            change_from(run, at_s, |run| run.pose.encoding = coding);
            times = f64::INFINITY;
            TrueValue::NoValue
        }
        FaultKind::UnitChanges => {
            change_from(run, at_s, |run| run.pose.is_in_millimetres = true);
            times = f64::INFINITY;
            TrueValue::NoValue
        }
        FaultKind::LatencyStep => {
            run.pose.timing.latency_ramp = Some((at_s, at_s, amount));
            TrueValue::Amount(amount)
        }
        FaultKind::LatencyRamp => {
            let to_s = at_s + run.duration_s * r.random_range(0.1..0.25);
            run.pose.timing.latency_ramp = Some((at_s, to_s, amount));
            TrueValue::Amount(amount.abs())
        }
        FaultKind::Play | FaultKind::Sag => {
            let (joint, how) = match kind {
                FaultKind::Play => (joint, SynthComplianceKind::Backlash),
                _ => (*choose(r, &gravity_loaded_joints(run)), SynthComplianceKind::Sag),
            };
            run.compliance.retain(|gives| gives.joint != joint);
            run.compliance.push(SynthCompliance { joint, kind: how, amplitude_rad: amount.abs() });
            subject = joint_name(joint);
            TrueValue::Amount(amount.abs())
        }
        FaultKind::Shake => {
            let hz = r.random_range(5.0..0.4 * run.pose.timing.rate_hz.clamp(15.0, 50.0));
            let [joint, _] = gravity_loaded_joints(run);
            // Rms of a sine at the lever arm of the home configuration.
            let mut home = run.home.clone();
            home.resize(chain.dof(), 0.0);
            let tip_at = |by_rad: f64| {
                let mut q = home.clone();
                q[joint] += by_rad;
                chain.forward(&q).translation.vector
            };
            let lever_m = (tip_at(1e-4) - tip_at(-1e-4)).norm() / 2e-4;
            let by_rad = 2_f64.sqrt() * amount.abs() / lever_m.max(0.05);
            run.compliance.retain(|gives| gives.joint != joint);
            run.compliance.push(SynthCompliance {
                joint,
                kind: SynthComplianceKind::Vibration(hz),
                amplitude_rad: by_rad,
            });
            TrueValue::NoValue
        }
        FaultKind::VelocityScale => {
            run.joints.has_velocity = true;
            let factor = match r.random_bool(0.5) {
                true => 1.0 + amount,
                false => {
                    times = f64::INFINITY;
                    *choose(r, &[1_f64.to_degrees(), -1.0, 0.0, 60.0 / (2.0 * PI)])
                }
            };
            if r.random_bool(0.5) {
                run.joints.velocity_scales = vec![factor; chain.dof()];
                subject = joints_topic;
            } else {
                run.joints.velocity_scales = vec![1.0; chain.dof()];
                run.joints.velocity_scales[joint] = factor;
                subject = joint_name(joint);
            }
            TrueValue::Amount((factor - 1.0).abs())
        }
        FaultKind::VelocityLate => {
            run.joints.has_velocity = true;
            run.joints.velocity_latency_s = *choose(r, &[0.08, 0.12, 0.2]);
            (subject, times) = (None, f64::INFINITY);
            TrueValue::NoValue
        }
        FaultKind::CommandLate => {
            let timing = &mut run.reference.timing;
            (timing.rate_hz, timing.latency_s) = (50.0, -amount.abs());
            run.reference.commands = *choose(r, &[Commands::Joints, Commands::Poses]);
            // Joints with equal delay are one finding on their topic, otherwise each is a finding.
            subject = None;
            TrueValue::Amount(amount.abs())
        }
        FaultKind::TagSize => {
            if run.target.timing.rate_hz == 0.0 {
                let camera = *choose(r, &[Camera::InHand, Camera::InBase]);
                run.add_camera(camera).expect("a chain");
            }
            run.target.scale = *choose(r, &[0.5, 0.8, 0.9, 1.1, 1.25, 2.0]);
            (subject, times) = (target_topic, f64::INFINITY);
            TrueValue::NoValue
        }
        FaultKind::GyroDegrees => {
            run.imu.gyro_factor = 1_f64.to_degrees();
            (subject, times) = (imu_topic, f64::INFINITY);
            TrueValue::NoValue
        }
        FaultKind::AccelInG => {
            run.imu.force_factor = *choose(r, &[1.0, 1e3]) / 9.80665;
            (subject, times) = (imu_topic, f64::INFINITY);
            TrueValue::NoValue
        }
        FaultKind::BiasSteps => {
            change_from(run, at_s, |run| run.imu.gyro_bias_rad_s += amount.abs() * direction);
            subject = imu_topic;
            TrueValue::Amount(amount.abs())
        }
        FaultKind::BiasWarmsUp => {
            times = times.max(5.0);
            let by_rad_s = amount.abs().max(times * thresholds[0].1);
            let tau_s = run.duration_s * r.random_range(0.1..0.25);
            run.imu.gyro_warm_up = Some((by_rad_s * direction, tau_s));
            subject = imu_topic;
            TrueValue::NoValue
        }
        FaultKind::ImuSlips => {
            let turn = pose([0.0; 3], rotation_from_rotvec(amount.abs() * direction));
            change_from(run, at_s, |run| run.imu.mount_error *= turn);
            subject = imu_topic;
            TrueValue::Amount(amount.abs())
        }
        FaultKind::YawWarmsUp => {
            let by_rad = sign * times.max(2.0) * DEGREE;
            let tau_s = run.duration_s * r.random_range(0.1..0.25);
            run.imu.yaw_warm_up = Some((by_rad, tau_s));
            (subject, times) = (imu_topic, f64::INFINITY);
            TrueValue::NoValue
        }
        _ => {
            let by_rad = r.random_range(3.0..12.0) * DEGREE;
            let mut phase = || r.random_range(0.0..2.0 * PI);
            let phases = [phase(), phase()];
            run.imu.yaw_by_heading = [(by_rad, phases[0]), (0.3 * by_rad, phases[1])];
            (subject, times) = (imu_topic, f64::INFINITY);
            TrueValue::NoValue
        }
    };
    PlantedFault {
        kind,
        codes: spec.codes,
        related_codes: spec.related_codes,
        subject,
        magnitude: times,
        truth,
    }
}

/// Continues the run from `at_s` on with the modification `other`.
fn change_from(run: &mut Scenario, at_s: f64, other: impl Fn(&mut Scenario)) {
    let mut later = run.clone();
    other(&mut later);
    run.changes = vec![(at_s, later)];
}

/// Share of repeated rows if each value is sent `rows` times, and its ratio to the threshold.
fn repeated_share(rows: f64, thresholds: &[(Unit, f64)]) -> (TrueValue, f64) {
    let share = 1.0 - 1.0 / rows;
    (
        TrueValue::Amount(share),
        thresholds.first().map_or(f64::INFINITY, |threshold| share / threshold.1),
    )
}

/// A wrong order of `dof` joints.
fn wrong_joint_order(r: &mut Pcg64, dof: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..dof).collect();
    match r.random_range(0..3) {
        0 => {
            let at = r.random_range(0..dof - 1);
            order.swap(at, at + 1);
        }
        1 => order.reverse(),
        _ => {
            let (a, b) = (r.random_range(0..dof), r.random_range(1..dof));
            order.swap(a, (a + b) % dof);
        }
    }
    order
}

/// Axes of game engines and cameras: y up, left-handed, mirrored.
fn wrong_axes(r: &mut Pcg64) -> Matrix3<f64> {
    let [x, y, z] = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| axis.transpose());
    let rows = *choose(r, &[[x, z, -y], [-y, z, x], [x, z, y], [x, -y, z], [y, x, z], [-y, -z, x]]);
    Matrix3::from_rows(&rows)
}

/// A span in the middle of a run, s after the start.
fn span_mid_run(run: &Scenario, r: &mut Pcg64) -> (f64, f64) {
    let from_s = run.duration_s * r.random_range(0.25..0.6);
    (from_s, from_s + *choose(r, &[1.0, 2.0, 3.0]))
}

/// Unit and first threshold of each value that the rule checks.
fn first_thresholds(code: &str) -> Vec<(Unit, f64)> {
    match checks::find(code).map(|rule| rule.grade) {
        Ok(Grade::From(thresholds)) => {
            thresholds.iter().map(|threshold| (threshold.unit, threshold.warning)).collect()
        }
        _ => Vec::new(),
    }
}

fn quaternion_order_error(r: &mut Pcg64) -> QuaternionOrderError {
    *choose(r, &[QuaternionOrderError::WxyzReadAsXyzw, QuaternionOrderError::XyzwReadAsWxyz])
}

pub fn choose<'a, T>(r: &mut Pcg64, from: &'a [T]) -> &'a T {
    &from[r.random_range(0..from.len())]
}

pub fn unit_vector(r: &mut Pcg64) -> Vec3 {
    loop {
        let v = Vec3::from_fn(|_, _| r.random_range(-1.0..1.0));
        if (0.01..1.0).contains(&v.norm()) {
            return v.normalize();
        }
    }
}
