//! A fault-free run for tests.

use std::sync::LazyLock;

use crate::checks::{Case, Rule, Thresholds, evaluate};
use crate::diagnosis::{
    AlignedSamples, CommandDelay, CommandDiagnosis, CommandedLine, DhComparison, DhResidual,
    DhStreamResiduals, EncodingEstimate, EncodingSpans, ErrorMagnitude, ErrorSize, FkError,
    FrameCorrection, FrameEstimate, GyroBias, ImuConventions, ImuDiagnosis, ImuResidualCheck,
    JointDiagnosis, JointEncoding, JointOffset, LatencyProfile, LineDeviation, Measured,
    MeasuredLength, PartError, PeakAcceleration, PoseDiagnosis, PoseEncoding, ResidualCheck,
    Response, RestError, SampleNoise, StreamHeldOut, StreamResidual, VelocityDiagnosis,
    VelocityShape, Vibration, YawProfile,
};
use crate::evidence::{
    ArmEvidence, DhEvidence, EulerEvidence, ImuEvidence, JointAxes, JointEvidence, JointMotion,
    JointStamps, PoseEvidence, ReferenceEvidence, RunEvidence, StreamEvidence, TipPoseKind,
    TipPoseSource, VibrationEvidence,
};
use crate::finding::{CheckRow, Finding, Span, Subject};
use crate::geometry::{Convention, Pose, Vec3, pose, rotation_from_rotvec};
use crate::robot::{DhConvention, Limits};
use crate::run::PoseSourceKind;
use crate::time::Stamp;

const ARM: &str = "arm";
pub const POSE: &str = "/pose";
pub const TF: &str = "/tf";
pub const IMU: &str = "/imu";
pub const JOINTS: &str = "/joint_states";
pub const COMMANDS: &str = "/commanded_pose";

const SPAN: Span = Span { start: Stamp::from_nanos(0), end: Stamp::from_nanos(40_000_000_000) };

pub fn precise(value: f64) -> Measured {
    Measured { value, std_error: 1e-6, dof: 1e3 }
}

/// Significant, unless zero.
pub fn length(value: f64) -> MeasuredLength {
    MeasuredLength { norm: precise(value), p_value: if value > 0.0 { 0.0 } else { 0.5 } }
}

pub fn as_case(evidence: &RunEvidence) -> Case<'_> {
    static OWN: LazyLock<Thresholds> = LazyLock::new(Thresholds::default);
    Case { evidence, thresholds: &OWN, required: &[] }
}

pub fn evaluate_rule(rule: &Rule, run: &RunEvidence) -> (Vec<CheckRow>, Vec<Finding>) {
    let evaluation = evaluate(run, &Default::default());
    let (mut rows, mut findings) = (evaluation.checks, evaluation.findings);
    rows.retain(|row| row.code == rule.code);
    findings.retain(|finding| finding.code == rule.code);
    (rows, findings)
}

/// Error over the whole run, before and after correction, far above the noise.
pub fn residual_check_of(quantile_m: f64, quantile_rad: f64) -> ResidualCheck {
    let size = |quantile: f64| {
        let noise = Some(SampleNoise { rms: 1e-8, quantile_95: 2e-8, lag_samples: 1 });
        let whole =
            ErrorMagnitude { samples: 1000, rms: 0.8 * quantile, quantile_95: quantile, noise };
        let part =
            PartError { from_s: 0.0, to_s: 40.0, at: Vec3::new(0.4, 0.1, 0.3), magnitude: whole };
        ErrorSize { whole, parts: vec![part] }
    };
    let error = FkError { length: size(quantile_m), angle: Some(size(quantile_rad)) };
    ResidualCheck {
        is_at_rest: false,
        corrected: Some(error.clone()),
        poses_corrected: Some(error.clone()),
        joints_corrected: Some(error.clone()),
        calibrated: None,
        as_logged: error,
    }
}

/// An arm with a pose stream, /tf, an IMU and three joints.
pub fn clean_run() -> RunEvidence {
    let still = PeakAcceleration {
        acceleration: 0.5,
        noise: 0.1,
        window_s: 0.1,
        at_s: 1.0,
        jerk: 1.0,
        resolved: 0.1,
    };
    let joint = |name: &str| JointEvidence {
        name: name.to_owned(),
        is_prismatic: false,
        limits: Limits { lower: Some(-3.0), upper: Some(3.0), velocity: Some(2.0) },
        motion: JointMotion { abruptness: Some(still), ..JointMotion::default() },
        velocity: Some(Ok(VelocityDiagnosis {
            error: precise(0.0),
            noise: 1e-3,
            rate: 0.5,
            window_s: 0.1,
            shape: VelocityShape::Rates,
        })),
        actual: None,
    };
    let offset = || JointOffset {
        offset: Ok(precise(0.0)),
        is_chosen: false,
        effect_m: 0.0,
        lever_m: 1.0,
        confounders: vec![],
        held_out: None,
    };
    let imu = ImuDiagnosis {
        encoding: Ok(as_logged()),
        latency_s: Ok(precise(0.0)),
        latency_profile: Ok(steady()),
        skew: Ok(precise(0.0)),
        yaw_drift_rad_s: Ok(precise(0.0)),
        yaw_profile: YawProfile::default(),
        mount_rad: Ok(length(0.0)),
        link_from_imu: None,
        axes_rotation: None,
        mount_change: None,
        conventions: ImuConventions::default(),
        tilt_rad: Ok(length(0.0)),
        up: None,
        gyro_bias: Ok(GyroBias {
            vector_rad_s: Vec3::zeros(),
            length_rad_s: length(0.0),
            yaw_rate_rad_s: 0.0,
            scale_error: None,
            change: None,
        }),
        yaw_error: Vec::new(),
        headings: Vec::new(),
    };
    let arm = ArmEvidence {
        name: ARM.to_owned(),
        joints_topic: JOINTS.to_owned(),
        is_trajectory: false,
        joint_clock: None,
        joint_topic: None,
        stamps: JointStamps::default(),
        has_unknown_units: false,
        span: SPAN,
        joints: ["pan", "lift", "elbow"].map(joint).to_vec(),
        reach_m: 0.85,
        better_model: None,
        indistinguishable_models: Vec::new(),
        dh: Some(DhEvidence {
            declared: DhConvention::Standard,
            estimate: DhComparison {
                streams: vec![DhStreamResiduals {
                    declared: DhResidual { m: 0.0, rad: 0.0 },
                    declared_positions_m: None,
                    other: None,
                }],
                declared_faults: 0,
                other_faults: 0,
            },
        }),
        diagnosis: JointDiagnosis::without_changes(
            Ok(JointEncoding::default()),
            vec![offset(), offset(), offset()],
            Vec::new(),
        ),
        poses: vec![stream_evidence(POSE, stream(true))],
        tf: Some(stream_evidence(TF, stream(false))),
        vibrations: vec![stream_evidence(
            JOINTS,
            VibrationEvidence { in_other_units: false, vibration: Ok(Vibration::default()) },
        )],
        imus: vec![stream_evidence(
            IMU,
            ImuEvidence {
                has_independent_stamps: true,
                link: "tool0".to_owned(),
                link_from_imu: None,
                proof: Some(ImuResidualCheck::default()),
                diagnosis: imu,
            },
        )],
        is_in_degrees_by_magnitude: false,
        is_converted_from_degrees: false,
        references: vec![stream_evidence(COMMANDS, commands())],
    };
    let frozen = stream_evidence(POSE, Vec::new());
    let audited = stream_evidence(POSE, Vec::new());
    RunEvidence {
        robots: vec![arm],
        frozen_intervals: vec![frozen],
        not_audited: vec![audited],
        ..RunEvidence::default()
    }
}

fn stream_evidence<T>(topic: &str, value: T) -> StreamEvidence<T> {
    let (robot, topic) = (Some(ARM.to_owned()), Some(topic.to_owned()));
    StreamEvidence {
        subject: Subject { robot, topic, ..Subject::default() },
        span: Some(SPAN),
        value,
    }
}

/// The arm follows the commands, among them a straight line.
fn commands() -> ReferenceEvidence {
    let tip_pose_source = |name: &str, kind| TipPoseSource { name: name.to_owned(), kind };
    let deviation = LineDeviation { distance_m: length(0.0), angle_rad: length(0.0) };
    let line = CommandedLine {
        from_s: 1.0,
        to_s: 2.0,
        length_m: 0.2,
        turn_rad: 0.5,
        command_rad: 0.0,
        command_off_axis_rad: 0.0,
        interpolated: None,
        deviations: vec![Some(deviation); 2],
    };
    ReferenceEvidence {
        is_of_joints: false,
        is_tip_declared: true,
        is_frame_declared: true,
        tip_poses: vec![
            tip_pose_source("FK of the joint states", TipPoseKind::Kinematics),
            tip_pose_source(POSE, TipPoseKind::Corrected),
        ],
        diagnosis: Ok(Ok(CommandDiagnosis {
            is_streamed: true,
            tracking: None,
            goals: 2,
            not_reached: 0,
            nearest_miss: None,
            rest_errors: vec![vec![rest_error_of(0.0, 0.0)]; 2],
            goal_maps: Vec::new(),
            lines: vec![line],
        })),
        delays: vec![CommandDelay {
            joint: None,
            period_s: 0.02,
            response: Ok(Response {
                delay_s: precise(0.02),
                low_pass_s: 0.0,
                gain: 1.0,
                explained: 0.999,
            }),
            map: None,
        }],
    }
}

/// The command is off by `length_m` along the tool's x axis; the tool is turned by `turn_rad`.
pub fn rest_error_of(length_m: f64, turn_rad: f64) -> RestError {
    let measured = pose([0.4, 0.1, 0.3], rotation_from_rotvec(Vec3::z() * turn_rad));
    RestError {
        from_s: 1.0,
        to_s: 2.0,
        commanded: measured * Pose::translation(length_m, 0.0, 0.0),
        measured,
        distance_m: length(length_m),
        angle_rad: length(0.0),
        joints: Vec::new(),
    }
}

/// Along x, not in the selected model.
pub fn frame(length_m: f64) -> FrameEstimate {
    FrameEstimate {
        pose: Pose::translation(length_m, 0.0, 0.0),
        translation_m: precise(length_m),
        rotation_rad: precise(0.0),
        p_value: if length_m > 0.0 { 0.0 } else { 0.5 },
        is_chosen: false,
    }
}

fn as_logged() -> EncodingEstimate {
    EncodingEstimate {
        best: PoseEncoding::AsLogged,
        is_inverted: false,
        as_logged_rad: Some(1e-4),
        best_rad: 1e-4,
        runner_up: None,
        equivalent: Vec::new(),
        ranked: Vec::new(),
        is_determined: true,
    }
}

fn clean_stream() -> PoseDiagnosis {
    PoseDiagnosis {
        encoding: Ok(as_logged()),
        length_unit: Ok(None),
        axes: Ok(None),
        is_inverted: false,
        constant_coordinates: Vec::new(),
        degrees: None,
        latency_s: Ok(precise(0.0)),
        skew: Ok(precise(0.0)),
        is_skew_chosen: false,
        latency_profile: Ok(steady()),
        unconfirmed_latency: None,
        radial_scale: Ok(precise(0.0)),
        is_radial_scale_chosen: false,
        reference: Ok(frame(0.0)),
        tool: Ok(frame(0.0)),
        residual: Ok(StreamResidual {
            excess_m: precise(0.0),
            excess_rad: precise(0.0),
            rms_m: 1e-5,
            rms_rad: 1e-5,
            before_m: 1e-5,
            before_rad: 1e-5,
        }),
        is_nominal: false,
        is_derived: false,
        link_m: None,
        largest_displacement: None,
        observability: None,
        top_speed_m_s: 0.8,
        aligned: AlignedSamples::default(),
        reference_changes: Vec::new(),
        tool_changes: Vec::new(),
        radial_scale_changes: Vec::new(),
        held_out: StreamHeldOut::default(),
        delay_jitter: None,
        encoding_spans: EncodingSpans::default(),
        frame_correction: FrameCorrection::default(),
    }
}

fn stream(has_independent_stamps: bool) -> PoseEvidence {
    PoseEvidence {
        diagnosis: clean_stream(),
        reference: "base".to_owned(),
        reference_known: true,
        tip: "tool0".to_owned(),
        is_tip_declared: true,
        is_tip_of_child_frame: false,
        is_of_reference_body: false,
        source_kind: PoseSourceKind::Unknown,
        proof: Ok(residual_check_of(1e-5, 1e-5)),
        has_independent_stamps,
        late_transforms: None,
        has_bare_numbers: false,
        alternation: None,
        is_undeclared: false,
        declared: None,
        labels: None,
        named_units: crate::geometry::Units::default(),
        names_no_frame: false,
        unidentified_columns: Vec::new(),
        is_uncorrected: false,
        joint_axes: JointAxes::default(),
        euler: Some(EulerEvidence {
            convention: Some(Convention::RPY),
            margins_rad: vec![(SPAN.start, 0.5), (SPAN.end, 0.6)],
        }),
    }
}

pub fn steady() -> LatencyProfile {
    LatencyProfile { swing_s: precise(0.0), ..LatencyProfile::default() }
}
