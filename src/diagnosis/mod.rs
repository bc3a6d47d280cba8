//! Estimators: joint states and streams in, estimates with intervals out. They read no files and hold no
//! thresholds of rules; `checks` turns estimates into findings. Times are in s from the run's origin.
//!
//! # Measurement model (`model::measurement`)
//! ```text
//! logged(s) = C(reference · scaled(FK(q(s − τ) + δ) · tool)) + noise,   τ = latency + skew·(s − middle)
//! ```
//! `s` is the stamp and `C` the encoding (unit, axes, rotation convention, inversion). `reference` and `tool` are
//! constant errors of the frames, `δ` joint zeros, and `scaled` multiplies positions by `1 + radial_scale` about
//! the base. Noise is white plus first-order autoregressive (`solver::noise`), with Huber weights. Poses in a frame in
//! which the base moves are first transformed to the base (`model::moving_frame`).
//!
//! # Algorithm (`diagnose`)
//! 1. Clocks: large steps and ramps of the latency by speeds (`latency::coarse`), then candidate lags by
//!    cross-correlation of speeds (`latency::correlation`).
//! 2. Encodings: of positions and joints from positions alone (`encodings::position`, `encodings::axis_convention`,
//!    `joints`), then of rotations (`encodings::rotation`).
//! 3. Constant causes: each stream is fitted alone from several starts, then all together from the best (`arm::fit`).
//!    Gauss–Newton steps alternate with the selection of causes (`selection::model_selection`): the set with the
//!    lowest weighted cost `rᵀWr` plus `ln n + 8` per parameter, for `n` independent residuals. Latencies and unknown
//!    references are always free.
//! 4. Link deviations: no arm is its drawing. Causes that usual deviations explain, or that do not predict held-out
//!    samples, are dropped (`selection::nominal_model`, `causes_beside_links`, `held_out`).
//! 5. Estimates: values, intervals and confounders (`arm::stream`, `arm::zeros`), the excess residual
//!    (`residuals::excess`) and the latency over the run (`latency::profile`).
//! 6. Varying causes: a variable latency is compensated; scales, couplings and compliance of joints (`compliance`),
//!    steps and drifts of frames, zeros and radial scales (`changes`) are removed. Each time, steps 2 to 5 are repeated,
//!    and the likeliest diagnosis wins (`selection::evidence`).
//! 7. If a residual remains: parts of the run with another encoding, or after a large turn of a frame or a joint
//!    (`changes`), joints that only a stream from outside shows, and orientations that were never set (`diagnose`).
//!
//! Without joint states, the path of a pose stream takes their place: the chain is one floating joint
//! (`Chain::is_floating`). Streams computed from joint states, such as /tf, are diagnosed one by one
//! (`diagnose_derived`), IMUs against FK (`imu`). `residuals::residual_check` compares streams with FK without the
//! estimators.
#![warn(missing_docs, clippy::unwrap_used)]

#[cfg(test)]
mod test_motion;
#[cfg(test)]
#[path = "../ground/geometry/test_random.rs"]
mod test_random;

// What every estimator uses.
mod distinct;
mod model;
mod priors;
mod samples;
mod solver;

// One arm and its pose streams.
mod arm;
mod arm_run;
mod changes;
mod compliance;
mod diagnose;
mod encodings;
mod frames;
mod joints;
mod latency;
mod residuals;
mod selection;

mod joint_diagnosis;

// Other streams and questions.
mod calibration;
mod columns;
mod commands;
mod hand_eye;
mod imu;
pub mod plan;
mod robot_models;
mod signals;

use ground::geometry::{
    Axes, Convention, LengthScale, Misinterpretation, MisinterpretationClass, Pose,
    QuaternionOrderError,
};
use ground::robot::Chain;
use ground::stream::PoseTrack;

pub use arm::{
    best_lag_peak, candidate_lags, diagnose_arm, diagnose_derived, follows_with_other_encoding,
    full_fit_count,
};
pub use calibration::{
    ArmCalibration, CalibrationFailure, CalibrationResidual, CalibrationStream, FixedPoint,
    FkUncertainty, FrameFreedom, LinkParameter, PointDistance, StreamCalibration,
    UndeterminedDirection, calibrate_arm,
};
pub use changes::{
    ChangePoint, Course, EncodingSpans, FrameChange, JointChange, JointParameter, JointPatch,
    ScalarChange,
};
pub use columns::{
    ColumnContent, ColumnMapping, GroupShift, JointColumns, JointValueUnit, MappingConstraints,
    NumericTable,
};
pub use commands::{
    CommandDelay, CommandDiagnosis, CommandTracking, CommandedArm, CommandedLine, Commands,
    DelayFailure, JointMap, LineDeviation, RestError, RestErrorSpread, diagnose_commands,
    estimate_joint_delays, estimate_pose_delay, infer_joint_order,
};
pub use compliance::{BacklashCrossing, ComplianceShape, JointCompliance, JointSag};
pub use diagnose::diagnose_run;
pub use encodings::reinterpret::{IntendedEncoding, reinterpret_poses};
pub use frames::moving_base::{
    BaseMotion, MovingBaseLag, detect_base_motion, estimate_moving_base_lag,
};
pub use frames::tool_switching::{SwitchedTool, ToolSwitching, detect_tool_switching};
pub use ground::stats::{Measured, MeasuredLength};
pub use hand_eye::{
    CameraMount, CameraPose, ClosureError, HandEyeDiagnosis, HandEyeSolution, HandEyeStreams,
    PoseSeries, RotationDiversity, TargetEncoding, TargetScale, TargetScaleError,
    diagnose_hand_eye, rotation_lag_peaks,
};
pub use imu::{
    AccelUnit, AccelUnitError, GyroAxesRotation, GyroBias, GyroBiasChange, GyroBiasProfile,
    GyroResidual, GyroSaturation, GyroScaleError, HeadingError, HeadingPair, ImuConventions,
    ImuDiagnosis, ImuMountChange, ImuResidualCheck, ImuStream, UpDirections, YawJump, YawProfile,
    YawWarmUp, angular_speed_correlation, check_imu_residual, diagnose_imu, reinterpret_imu,
};
pub use joints::{
    Confounder, JointCoupling, JointEncoding, JointOffset, JointScale, JointUnit, JointUnitError,
    follows_as_logged,
};
use latency::coarse::{
    CoarseLatencyChange, detect_imu_latency_changes, detect_pose_latency_changes,
};
pub use latency::compensation::{compensate_latency, diagnose_imu_with_latency_compensation};
pub use latency::correlation::LagPeak;
pub use latency::delay_jitter::DelayJitter;
pub use latency::late_joints::{LateJoints, with_earlier_joints};
pub use latency::piecewise::PiecewiseLatency;
pub use latency::profile::{LatencyProfile, LatencyShape, LatencyStep};
pub use latency::residual_by_latency::{LatencyResidual, residual_by_latency};
pub use model::moving_frame::MovingFrame;
pub use model::observability::{Observability, StreamParameter, WeakDirection};
pub use residuals::residual_check::{
    ErrorMagnitude, ErrorSize, FkError, PartError, ResidualCheck, SampleNoise, check_residual,
};
pub use residuals::trajectory_error::{
    MAX_STAMP_DIFFERENCE_S, TrajectoryError, absolute_trajectory_error, aligned_trajectory_error,
    associate_stamps, relative_pose_error, rigid_alignment,
};
pub use robot_models::dh_convention::{
    DhComparison, DhConventionResult, DhResidual, DhStreamResiduals, fault_count,
};
pub use robot_models::position_misfit::{is_seen_from_tool, position_misfit_m};
pub use robot_models::ranking::{
    FitCause, FitHypotheses, HypothesisFit, ModelFit, ScoredFit, fit_model,
};
pub use samples::aligned::{AlignedSamples, PoseDistances};
pub use samples::sampling::{monotonic_rows, range_of, row_blocks, value_range};
pub use selection::held_out::{HeldOutResidual, StreamHeldOut};
pub use selection::link_deviations::LinkDisplacement;
pub use signals::joint_motion::{
    JointSampleKind, LimitViolation, PeakAcceleration, peak_acceleration, position_violation,
    rates, speed_violation, speed_violation_from_positions,
};
pub use signals::response::Response;
pub use signals::trend::{MIN_RUNS, RunEstimate, Trend, TrendStep, estimate_trend};
pub use signals::velocity::{
    VelocityDiagnosis, VelocitySamples, VelocityShape, diagnose_velocity, encoder_step,
};
pub use signals::vibration::{
    Vibration, VibrationFailure, VibrationPath, estimate_vibration, vibration_path,
};
pub use signals::workspace::{
    CELL_SIZE_M, JointSpan, MIN_CONFIGURATION_DIFFERENCE, MIN_ORIENTATION_DIFFERENCE_RAD,
    ReachCell, ReachedPose, Workspace, cell_centre_m, reach_m,
};

/// Reason why an estimate does not exist.
#[derive(Clone, Debug, PartialEq)]
pub enum NotObservable {
    /// Too few overlapping samples.
    TooFewSamples {
        /// Samples at common times.
        have: usize,
        /// Samples needed.
        need: usize,
    },
    /// The streams do not overlap in time.
    NoOverlap,
    /// The arm moves too little.
    AtRest,
    /// The arm never rests.
    NeverRests,
    /// Several lags fit a periodic motion; the candidates, s.
    Periodic(Vec<f64>),
    /// The stream follows the arm at no lag; highest correlation, 0 to 1.
    DoesNotFollow(f64),
    /// The orientation changes too little; its range, rad.
    LittleRotation(f64),
    /// The parameter has no visible effect, or one that other unknowns can imitate.
    NotExcited,
    /// The stream has no orientation.
    NoOrientation,
    /// The angular velocity is zero while the arm rotates.
    NoGyro,
    /// The accelerations have no constant part, so gravity was removed from them.
    NoGravity,
    /// The orientation is constant while the arm rotates.
    OrientationNotSet,
    /// The log does not contain the frame's mounting.
    NoFrame,
    /// Single causes cannot be separated from link deviations of the arm.
    NominalKinematics,
    /// A required estimate does not exist.
    RestsOn(&'static str),
}

/// Estimate, or the reason why it does not exist.
pub type EstimateResult<T> = Result<T, NotObservable>;

/// Pose stream as input.
#[derive(Clone, Copy, Debug)]
pub struct PoseStream<'a> {
    /// Poses as logged.
    pub track: &'a PoseTrack,
    /// From the reference link to the logged link.
    pub chain: &'a Chain,
    /// Joint-track column of each joint in `chain`.
    pub columns: &'a [usize],
    /// Whether the reference is fixed to the base; else its pose is estimated.
    pub reference_known: bool,
    /// Standard error from aligning another clock, s. 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether stamps are copies of the joints'.
    pub stamps_copied: bool,
    /// Latency ramp already subtracted from the stamps, to be reported with the remaining profile.
    pub removed_ramp: Option<&'a PiecewiseLatency>,
    /// Frame of the logged poses, if it moves in the base. `track` is transformed to the base.
    pub moving_frame: Option<&'a MovingFrame>,
    /// Cause of a turn about the last joint's axis.
    pub last_turn: LastTurn,
}

impl<'a> PoseStream<'a> {
    /// Stream in a frame fixed to the base, on the clock of the joint states.
    pub fn new(track: &'a PoseTrack, chain: &'a Chain, columns: &'a [usize]) -> Self {
        Self {
            track,
            chain,
            columns,
            reference_known: true,
            stamp_error_s: 0.0,
            stamps_copied: false,
            removed_ramp: None,
            moving_frame: None,
            last_turn: LastTurn::Unknown,
        }
    }
}

/// Cause of a turn about the axis of a chain's last joint. Poses do not show it; an IMU beyond the joint may.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LastTurn {
    /// Joint or tool.
    #[default]
    Unknown,
    /// The joint's zero.
    OfJoint,
    /// The tool frame.
    OfTool,
}

/// Encoding under which a stream follows the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseEncoding {
    /// As logged.
    AsLogged,
    /// Three numbers of one convention read as another. Members of a class have the same effect.
    Misinterpreted(&'static MisinterpretationClass),
    /// Permuted quaternion components.
    QuaternionOrder(QuaternionOrderError),
    /// Rotation transposed, position not.
    Transposed,
    /// Whole pose inverted (parent and child exchanged).
    Inverted,
    /// Rotation logged as bare numbers, in this convention (not a fault).
    Numbers(Convention),
}

impl PoseEncoding {
    /// Whether this is no fault.
    pub fn is_as_logged(&self) -> bool {
        matches!(self, PoseEncoding::AsLogged | PoseEncoding::Numbers(_))
    }

    /// Misinterpretation, if any.
    pub fn misinterpretation(&self) -> Option<Misinterpretation> {
        match self {
            PoseEncoding::Misinterpreted(class) => class.members.first().copied(),
            _ => None,
        }
    }
}

/// Rotation encoding with its competitors. Residuals are angles, rms rad.
#[derive(Clone, Debug)]
pub struct EncodingEstimate {
    /// Selected encoding; `AsLogged` if that fits.
    pub best: PoseEncoding,
    /// Whether whole poses are also inverted.
    pub is_inverted: bool,
    /// Residual as logged. `None` for bare numbers.
    pub as_logged_rad: Option<f64>,
    /// Residual of `best`.
    pub best_rad: f64,
    /// Next best encoding that differs, and residual.
    pub runner_up: Option<(PoseEncoding, f64)>,
    /// Encodings equivalent to `best` here.
    pub equivalent: Vec<PoseEncoding>,
    /// Best encodings, with the same frame errors free as for `best`, by increasing residual. Includes `best`
    /// and as logged.
    pub ranked: Vec<(PoseEncoding, f64)>,
    /// Whether most encodings fit worse. At rest, nearly all fit with a constant frame.
    pub is_determined: bool,
}

/// Axes that differ from those of the stream's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxesError {
    /// Position axes.
    pub positions: Axes,
    /// Rotation axes.
    pub rotations: Axes,
}

impl AxesError {
    /// Standard axes.
    pub const NONE: Self = Self { positions: Axes::STANDARD, rotations: Axes::STANDARD };
}

/// Wrong length unit of positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthUnitError {
    /// Actual unit.
    pub is: LengthScale,
    /// Unit read.
    pub read_as: LengthScale,
    /// Residuals in both units.
    pub residual: UnitResiduals,
}

impl LengthUnitError {
    /// From positions as read to m.
    pub fn factor(&self) -> f64 {
        self.is.in_m() / self.read_as.in_m()
    }
}

/// Coordinate that is constant while the arm moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantCoordinate {
    /// x, y or z.
    pub coordinate: char,
    /// In the stream's unit.
    pub value: f64,
    /// Range by FK, m.
    pub moved_m: f64,
}

/// Residuals before and after correcting a unit, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitResiduals {
    /// As logged.
    pub as_logged: f64,
    /// In the other unit.
    pub corrected: f64,
}

/// Constant frame error.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEstimate {
    /// `reference_from_stream` or `tip_from_stream` (tool).
    pub pose: Pose,
    /// Translation, m.
    pub translation_m: Measured,
    /// Rotation angle, rad.
    pub rotation_rad: Measured,
    /// Probability of an error this large if the frame were correct (joint test of six parameters).
    pub p_value: f64,
    /// Whether the selected model contains it.
    pub is_chosen: bool,
}

/// Residual of a stream after correcting every finding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamResidual {
    /// Excess position residual over the noise, rms m. Its interval excludes zero only if the residual depends
    /// on the configuration, unlike noise.
    pub excess_m: Measured,
    /// Excess rotation residual, rms rad.
    pub excess_rad: Measured,
    /// Position residual, rms m.
    pub rms_m: f64,
    /// Rotation residual, rms rad.
    pub rms_rad: f64,
    /// Position error as logged, against recorded FK, rms m.
    pub before_m: f64,
    /// Rotation error as logged, against recorded FK, rms rad.
    pub before_rad: f64,
}

impl StreamResidual {
    /// Combined with a lever of 0.3 m, rms m.
    pub fn combined_m(&self) -> f64 {
        self.rms_m.hypot(priors::LEVER_M * self.rms_rad)
    }
}

/// Diagnosis of one pose stream.
#[derive(Clone, Debug)]
pub struct PoseDiagnosis {
    /// Rotation encoding.
    pub encoding: EstimateResult<EncodingEstimate>,
    /// Wrong position unit.
    pub length_unit: EstimateResult<Option<LengthUnitError>>,
    /// Whether positions show inverted poses.
    pub is_inverted: bool,
    /// Exchanged or mirrored axes.
    pub axes: EstimateResult<Option<AxesError>>,
    /// Constant coordinates.
    pub constant_coordinates: Vec<ConstantCoordinate>,
    /// Rotation numbers in degrees.
    pub degrees: Option<UnitResiduals>,
    /// Latency relative to joint states, s; the median if delays are skewed.
    pub latency_s: EstimateResult<Measured>,
    /// Delay distribution, if skewed.
    pub delay_jitter: Option<DelayJitter>,
    /// Clock skew, s/s.
    pub skew: EstimateResult<Measured>,
    /// Whether the model contains the skew.
    pub is_skew_chosen: bool,
    /// Latency over the run.
    pub latency_profile: EstimateResult<LatencyProfile>,
    /// Likeliest variation of the latency, if the residual does not confirm that it varies.
    pub unconfirmed_latency: Option<LatencyProfile>,
    /// Radial scale error, m/m.
    pub radial_scale: EstimateResult<Measured>,
    /// Whether the model contains radial scale.
    pub is_radial_scale_chosen: bool,
    /// Reference error, `reference_from_stream`. Its pose if it was unknown.
    pub reference: EstimateResult<FrameEstimate>,
    /// Tool error, `tip_from_stream`.
    pub tool: EstimateResult<FrameEstimate>,
    /// Change points of the reference frame.
    pub reference_changes: Vec<FrameChange>,
    /// Change points of the tool frame.
    pub tool_changes: Vec<FrameChange>,
    /// Change points of the radial scale, m/m.
    pub radial_scale_changes: Vec<ScalarChange>,
    /// Predictions of held-out samples.
    pub held_out: StreamHeldOut,
    /// Spans in which `encoding`, `length_unit`, `axes`, `is_inverted` and `degrees` apply.
    pub encoding_spans: EncodingSpans,
    /// Residual after correcting every finding.
    pub residual: EstimateResult<StreamResidual>,
    /// Whether the model is nominal: link deviations explain the error against it, at most 10 mm and 0.5° rms.
    pub is_nominal: bool,
    /// Standard deviation of these deviations, m (0.1° per mm).
    pub link_m: Option<f64>,
    /// Largest displacement of a link by these deviations.
    pub largest_displacement: Option<LinkDisplacement>,
    /// Whether the poses are FK of the joint states as recorded, whose zeros another stream contradicts.
    pub is_derived: bool,
    /// Observability. `None` without a fit.
    pub observability: Option<Observability>,
    /// Maximum tip speed by FK, m/s.
    pub top_speed_m_s: f64,
    /// Aligned samples.
    pub aligned: AlignedSamples,
    /// Corrections applied to them.
    pub frame_correction: FrameCorrection,
}

/// Frames and radial scale that align a stream with FK.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameCorrection {
    /// `stream_from_reference`.
    pub reference: Pose,
    /// `tip_from_stream`.
    pub tool: Pose,
    /// Radial scale error, m/m.
    pub radial_scale: f64,
}

impl FrameCorrection {
    /// `reference_from_tip` for a decoded pose.
    pub fn apply(&self, decoded: &Pose) -> Pose {
        let mut in_base = self.reference.inv_mul(decoded);
        in_base.translation.vector /= 1.0 + self.radial_scale;
        in_base * self.tool.inverse()
    }

    /// Inverse of [`FrameCorrection::apply`].
    pub fn invert(&self, tip: &Pose) -> Pose {
        let mut in_base = tip * self.tool;
        in_base.translation.vector *= 1.0 + self.radial_scale;
        self.reference * in_base
    }
}

impl PoseDiagnosis {
    /// Whether the stream has a change point.
    pub fn has_changes(&self) -> bool {
        !self.reference_changes.is_empty()
            || !self.tool_changes.is_empty()
            || !self.radial_scale_changes.is_empty()
            || self.encoding_spans != EncodingSpans::default()
    }

    /// Number of frame errors in the model.
    fn chosen_frames(&self) -> usize {
        [&self.reference, &self.tool].into_iter().flatten().filter(|it| it.is_chosen).count()
    }

    /// Clock skew of the model, s/s. 0 if it contains none.
    pub fn chosen_skew(&self) -> f64 {
        match &self.skew {
            Ok(skew) if self.is_skew_chosen => skew.value,
            _ => 0.0,
        }
    }

    /// Residual of a stream that follows the arm.
    fn followed_residual(&self) -> Option<&StreamResidual> {
        let follows = !matches!(self.encoding, Err(NotObservable::DoesNotFollow(_)));
        self.residual.as_ref().ok().filter(|_| follows)
    }

    /// Why the stream is unusable. Positions may be usable without orientations.
    pub fn unusable_reason(&self) -> Option<&NotObservable> {
        self.encoding.as_ref().err().filter(|_| self.residual.is_err())
    }

    /// Whether the position residual is a large share of the motion, and too large for a calibration; then no finding is
    /// credible.
    pub fn is_far_from_fk(&self) -> bool {
        let excess_m = self.residual.as_ref().map_or(0.0, |residual| residual.excess_m.value);
        excess_m > selection::nominal_model::MAX_TIP_CHANGE_M
            && excess_m > joints::MAX_FOLLOWING_RESIDUAL_SHARE * self.extent_m()
    }

    /// Whether the position residual is a large share of the motion, also if it looks like noise: the errors of a few separate
    /// configurations do.
    pub fn is_unrelated_to_fk(&self) -> bool {
        self.residual.as_ref().is_ok_and(|residual| {
            residual.rms_m > selection::nominal_model::MAX_TIP_CHANGE_M
                && residual.rms_m > joints::MAX_FOLLOWING_RESIDUAL_SHARE * self.extent_m()
        })
    }

    /// Extent of FK's positions, m.
    fn extent_m(&self) -> f64 {
        let fk = self.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector);
        frames::position_fit::spread(fk)
    }

    /// Whether the motion is periodic, so other findings may belong to a wrong lag.
    pub fn is_periodic(&self) -> bool {
        matches!(self.latency_s, Err(NotObservable::Periodic(_)))
    }
}

/// Joint diagnosis of joint states and pose streams.
#[derive(Clone, Debug)]
pub struct ArmDiagnosis {
    /// Diagnosis of the joint states.
    pub joints: JointDiagnosis,
    /// One entry per pose stream, in input order.
    pub streams: Vec<PoseDiagnosis>,
}

/// Diagnosis of an arm's joint states.
#[derive(Clone, Debug)]
pub struct JointDiagnosis {
    /// Joint names and units.
    pub encoding: EstimateResult<JointEncoding>,
    /// Encoding to report if it holds in one part of the run only, with that part's start and end, s from
    /// the run's origin. `patches` correct the other parts.
    pub partial_encoding: Option<(JointEncoding, (f64, f64))>,
    /// Per joint of the chain, from all streams.
    pub offsets: Vec<JointOffset>,
    /// Joints with a wrong scale or direction.
    pub scales: Vec<JointScale>,
    /// Joints with a change point.
    pub changes: Vec<JointChange>,
    /// Corrections that undo these changes.
    pub patches: Vec<JointPatch>,
    /// Joints with backlash, sag or eccentricity.
    pub compliance: Vec<JointCompliance>,
}
