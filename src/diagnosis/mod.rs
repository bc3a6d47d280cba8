//! Estimators: joint states and streams in, estimates with intervals out.
//!
//! This module reads no files, knows no topics and holds no thresholds of rules. `checks` turns its
//! estimates into findings.
//!
//! # Input
//! A `JointTrack` with joint positions `q` and velocities, and for each pose stream a [`PoseStream`]: the
//! logged poses, the kinematic chain from its reference link to its tip, and whether its reference frame
//! is known. Times are in seconds from the run's origin.
//!
//! # Measurement model (`model`)
//! ```text
//! logged(s) = C(reference · scaled(FK(q(s − τ) + δ) · tool)) + noise,   τ = latency + skew·(s − middle)
//! ```
//! - `s` is the stamp of a sample.
//! - `C` is the encoding: unit and axes of positions, rotation convention, inversion of whole poses. It is
//!   discrete.
//! - `reference` and `tool` are constant poses, the identity if the frames are correct.
//! - `scaled` multiplies positions by `1 + radial_scale` about the base origin (radial scale).
//! - `δ` contains the joint zeros, and unknown scales and couplings of joints if their encoding has any.
//! - The noise is white plus first-order autoregressive (`noise`), with Huber weights for outliers
//!   (`robust`).
//!
//! # Steps for an arm (`diagnose_with_latency_compensation` in `latency_compensation`)
//! 1. `coarse_latency` estimates large latency steps and ramps from speeds. `latency_compensation` removes
//!    them from the stamps.
//! 2. `latency` cross-correlates speeds to find candidate lags.
//! 3. `position_encoding` and `axis_convention` determine the position encoding, `joints` the joint names
//!    and units. Both use positions, before any rotation is decoded. `decoded_stream`,
//!    `orientation_samples` and `rotation_encoding` then determine the rotation encoding.
//! 4. `arm::fit` fits all streams together. `frames` provides starting points, `model_selection` selects
//!    causes and iterates Gauss–Newton, and `prefer_tool` replaces a moved reference by a tool if both
//!    fit.
//! 5. `nominal_model` and `link_deviations` add link deviations as random effects. Causes that these
//!    explain as well are dropped.
//! 6. `arm::stream` and `arm::zeros` compute values, intervals and confounders; `residual` computes the
//!    excess residual and `latency_profile` the latency profile. `latency_compensation` compensates a
//!    variable latency and repeats steps 2 to 6.
//! 7. `compliance` (backlash, sag, eccentricity) and `changes` (change points) are competing models for a
//!    remaining residual. Each corrects the run and repeats steps 2 to 6. It is accepted only if the
//!    residual becomes much smaller.
//!
//! Streams computed from the joint states, such as /tf, are compared with these alone
//! (`diagnose_derived`). IMUs are compared with FK of the corrected joint states (`imu`).
//!
//! # Selection of causes (`model_selection`)
//! The latency of a moving stream and an unknown reference frame are always free. Candidate causes are the
//! joint zeros, and per stream the skew, radial scale, reference and tool. The model is linearised once
//! with all of them. Each set of causes then has the score `rᵀWr` after its least-squares step plus
//! `ln n + 8` per parameter, with `n` the number of independent residuals. Sets of up to four causes
//! (three if there are more than 16) are compared exhaustively, larger ones by greedy addition and
//! pruning. Sets with a cause nearly equal to a combination of the others are rejected. Selection and
//! steps alternate until both converge. This is repeated from every starting point, and the least
//! `Σ n·ln σ²` plus price wins.
//!
//! # Checks
//! `residual_check` compares each stream with FK without the estimators, as logged and corrected.
//! `residual` cross-validates whether the residual repeats with the configuration. `observability` lists
//! the parameters that the motion does not determine.
//!
//! # Output
//! An [`ArmDiagnosis`]. Each estimate is a [`Measured`] (value, standard error, degrees of freedom) or the
//! [`NotObservable`] reason why it does not exist, and states whether its cause was selected.
//!
//! The remaining modules are separate estimators: `columns` identifies table columns, `model_fit` the arm
//! model, and `handeye`, `calibration`, `plan`, `reference`, `velocity`, `vibration`, `workspace` and
//! `trend` do as their names say.
#![warn(missing_docs, clippy::unwrap_used)]

#[cfg(test)]
mod test_motion;
#[cfg(test)]
#[path = "../ground/geometry/test_random.rs"]
mod test_random;

mod aligned;
mod arm;
mod axis_convention;
mod calibration;
mod changes;
mod coarse_latency;
mod columns;
mod competing_model;
mod compliance;
mod constant;
mod decoded_stream;
mod delay_jitter;
mod dh;
mod frames;
mod handeye;
mod imu;
mod joints;
mod latency;
mod latency_compensation;
mod latency_profile;
mod latency_ramp;
mod latency_residual;
mod latency_steps;
mod linear;
mod link_deviations;
mod model;
mod model_fit;
mod model_selection;
mod motion;
mod moving_base;
mod noise;
mod nominal_model;
mod observability;
mod orientation_samples;
pub mod plan;
mod position_encoding;
mod position_fit;
mod prefer_tool;
mod reference;
mod reinterpret;
mod residual;
mod residual_check;
mod response;
mod robust;
mod rotation_encoding;
mod sampling;
mod tool_switching;
mod trend;
mod velocity;
mod vibration;
mod workspace;

use ground::geometry::{
    Axes, Convention, LengthScale, Misinterpretation, MisinterpretationClass, Pose,
    QuaternionOrderError, Vec3,
};
use ground::robot::Chain;
use ground::stream::PoseTrack;

pub use aligned::{AlignedSamples, PoseDistances};
pub use arm::{best_lag_peak, candidate_lags, diagnose_arm, diagnose_derived};
pub use calibration::{
    ArmCalibration, CalibrationFailure, CalibrationResidual, CalibrationStream, FkUncertainty,
    LinkParameter, StreamCalibration, UndeterminedDirection, calibrate_arm,
};
pub use changes::{ChangePoint, EncodingSpans, FrameChange, JointChange, JointPatch, ScalarChange};
use coarse_latency::{
    CoarseLatencyChange, detect_imu_latency_changes, detect_pose_latency_changes,
};
pub use columns::{
    ColumnContent, ColumnMapping, GroupShift, JointColumns, JointValueUnit, MappingConstraints,
    NumericTable,
};
pub use competing_model::{is_seen_from_tool, position_misfit_m};
pub use compliance::{BacklashCrossing, ComplianceShape, JointCompliance, JointSag};
pub use delay_jitter::DelayJitter;
pub use dh::{DhComparison, DhConventionResult, DhResidual, DhStreamResiduals, fault_count};
pub use ground::stats::{Measured, MeasuredLength};
pub use handeye::{
    CameraMount, CameraPose, ClosureError, HandEyeDiagnosis, HandEyeSolution, HandEyeStreams,
    PoseSeries, RotationDiversity, TargetEncoding, TargetScale, TargetScaleError,
    diagnose_hand_eye, rotation_lag_peaks,
};
pub use imu::{
    AccelUnit, AccelUnitError, GyroAxesRotation, GyroBias, GyroBiasChange, GyroBiasProfile,
    GyroResidual, GyroSaturation, GyroScaleError, HeadingError, HeadingPair, ImuConventions,
    ImuDiagnosis, ImuMountChange, ImuResidualCheck, ImuStream, UpDirections, YawJump, YawProfile,
    YawWarmUp, check_imu_residual, diagnose_imu, reread_imu, turning_by_latency,
};
pub use joints::{
    Confounder, JointCoupling, JointEncoding, JointOffset, JointScale, JointUnit, JointUnitError,
};
pub use latency::LagPeak;
pub use latency_compensation::{
    compensate_latency, diagnose_imu_with_latency_compensation, diagnose_with_latency_compensation,
};
pub use latency_profile::{LatencyProfile, LatencyShape, LatencyStep};
pub use latency_ramp::LatencyRamp;
pub use latency_residual::{LatencyResidual, residual_by_latency};
pub use model_fit::{FitAssumption, FitHypotheses, HypothesisFit, ModelFit, ScoredFit, fit_model};
pub use motion::{
    JointSampleKind, LimitViolation, PeakAcceleration, peak_acceleration, position_violation,
    rates, speed_violation, speed_violation_from_positions,
};
pub use moving_base::{BaseMotion, MovingBaseLag, detect_base_motion, estimate_moving_base_lag};
pub use observability::{Observability, StreamParameter, WeakDirection};
pub use reference::{
    CommandDelay, CommandTracking, CommandedArm, CommandedLine, Commands, DelayFailure,
    LineDeviation, ReferenceDiagnosis, RestError, RestErrorSpread, diagnose_reference,
    estimate_joint_delays, estimate_pose_delay, infer_joint_order,
};
pub use reinterpret::{IntendedEncoding, reinterpret_poses};
pub use residual_check::{
    ErrorMagnitude, ErrorSize, FkError, PartError, ResidualCheck, SampleNoise, check_residual,
};
pub use response::Response;
pub use sampling::row_blocks;
pub use tool_switching::{SwitchedTool, ToolSwitching, detect_tool_switching};
pub use trend::{MIN_RUNS, RunEstimate, Trend, TrendStep, estimate_trend};
pub use velocity::{
    VelocityDiagnosis, VelocitySamples, VelocityShape, diagnose_velocity, encoder_step,
};
pub use vibration::{
    Vibration, VibrationFailure, VibrationPath, estimate_vibration, vibration_path,
};
pub use workspace::{
    CELL_SIZE_M, JointSpan, MIN_CONFIGURATION_DIFFERENCE, MIN_ORIENTATION_DIFFERENCE_RAD,
    ReachCell, ReachedPose, Workspace, cell_centre_m, reach_m,
};

/// Reason why an estimate does not exist, with the values that a message needs.
#[derive(Clone, Debug, PartialEq)]
pub enum NotObservable {
    /// Too few overlapping samples.
    TooFewSamples {
        /// Number of samples of both streams at common times.
        have: usize,
        /// Number of samples needed.
        need: usize,
    },
    /// The streams do not overlap in time.
    NoOverlap,
    /// The arm moves too little.
    AtRest,
    /// The arm never rests.
    NeverRests,
    /// Several lags fit because the motion is periodic; the candidates, s.
    Periodic(Vec<f64>),
    /// The stream follows the arm at no lag; the highest correlation found, 0 to 1.
    DoesNotFollow(f64),
    /// The orientation changes too little; the range of orientations, rad.
    LittleRotation(f64),
    /// The parameter has no visible effect in the log, or the same effect as other unknowns.
    NotExcited,
    /// The stream has no orientation.
    NoOrientation,
    /// The stream has no angular velocity: it is zero while the arm rotates.
    NoGyro,
    /// The stream's orientation is not set: it is constant while the arm rotates.
    OrientationNotSet,
    /// The log does not contain the mounting of the stream's frame.
    NoFrame,
    /// The arm deviates from the nominal model in many small ways. Single causes of that size cannot be
    /// separated from link deviations.
    NominalKinematics,
    /// An estimate that this one requires does not exist.
    RestsOn(&'static str),
}

/// Estimate, or the reason why it does not exist.
pub type EstimateResult<T> = Result<T, NotObservable>;

/// Pose stream as input of the estimators.
#[derive(Clone, Copy, Debug)]
pub struct PoseStream<'a> {
    /// Poses as logged.
    pub track: &'a PoseTrack,
    /// Chain from the stream's reference link to the link whose pose it contains.
    pub chain: &'a Chain,
    /// Column in the joint track of each joint of `chain`.
    pub columns: &'a [usize],
    /// Whether the reference frame is fixed to the robot's base; if not, its pose is estimated.
    pub reference_known: bool,
    /// Standard error of the stamps from aligning a different clock, s. 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether the stream's stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// Latency ramp already subtracted from the stamps; reported together with the remaining latency
    /// profile.
    pub removed_ramp: Option<&'a LatencyRamp>,
}

/// Encoding of a stream's numbers under which it follows the arm.
#[derive(Clone, Copy, Debug)]
pub enum PoseEncoding {
    /// As logged.
    AsLogged,
    /// Misinterpretation: three numbers of one convention were read as another. All members are equivalent.
    Misinterpreted(&'static MisinterpretationClass),
    /// Permuted quaternion components.
    QuaternionOrder(QuaternionOrderError),
    /// The rotation is transposed, the position is not.
    Transposed,
    /// The whole pose is inverted (parent and child exchanged).
    Inverted,
    /// Bare numbers in this convention (not a fault).
    Numbers(Convention),
}

impl PoseEncoding {
    /// Whether the encoding is as logged, not a fault.
    pub fn is_as_logged(&self) -> bool {
        matches!(self, PoseEncoding::AsLogged | PoseEncoding::Numbers(_))
    }

    /// Misinterpretation behind this encoding, if any.
    pub fn misinterpretation(&self) -> Option<Misinterpretation> {
        match self {
            PoseEncoding::Misinterpreted(class) => class.members.first().copied(),
            _ => None,
        }
    }
}

/// Rotation encoding that follows the arm, with its competitors.
#[derive(Clone, Debug)]
pub struct EncodingEstimate {
    /// Selected encoding; `AsLogged` if that explains the stream.
    pub best: PoseEncoding,
    /// Whether the whole pose is also inverted.
    pub is_inverted: bool,
    /// Residual angle as logged, rms rad. `None` for bare numbers.
    pub as_logged_rad: Option<f64>,
    /// Residual angle of the selected encoding, rms rad.
    pub best_rad: f64,
    /// Next best encoding that differs on this motion, with its residual, rms rad.
    pub runner_up: Option<(PoseEncoding, f64)>,
    /// Encodings that are equivalent to the selected one on this motion.
    pub equivalent: Vec<PoseEncoding>,
    /// Best encodings with the frames of the selected one, by increasing residual, rms rad. Includes the
    /// selected encoding and the stream as logged.
    pub ranked: Vec<(PoseEncoding, f64)>,
    /// Whether most encodings fit worse. At rest nearly all of them fit with a constant frame.
    pub is_determined: bool,
}

/// Axes of a stream's numbers that differ from the axes of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxesError {
    /// Axes of the positions.
    pub positions: Axes,
    /// Axes of the rotations.
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
    /// Unit in which they were read.
    pub read_as: LengthScale,
    /// Residuals in both units.
    pub residual: UnitResiduals,
}

impl LengthUnitError {
    /// Factor from positions as read to m.
    pub fn factor(&self) -> f64 {
        self.is.in_m() / self.read_as.in_m()
    }
}

/// Coordinate of a stream that is constant while the arm moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantCoordinate {
    /// Coordinate: x, y or z.
    pub coordinate: char,
    /// Its value, in the stream's unit.
    pub value: f64,
    /// Range of the coordinate by FK, m.
    pub moved_m: f64,
}

/// Residuals before and after correcting a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitResiduals {
    /// Residual as logged, in SI units.
    pub as_logged: f64,
    /// Residual in the other unit, in SI units.
    pub corrected: f64,
}

/// Constant frame error and its significance.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEstimate {
    /// Pose: `reference_from_stream` for the reference frame, `tip_from_stream` for the tool.
    pub pose: Pose,
    /// Length of its translation, m.
    pub translation_m: Measured,
    /// Its rotation angle, rad.
    pub rotation_rad: Measured,
    /// Probability of an estimate this large if the frame were correct (joint test of the six parameters).
    pub p_value: f64,
    /// Whether the selected model contains this frame error.
    pub is_chosen: bool,
}

/// Residual of a stream after correcting every finding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamResidual {
    /// Excess position residual over the noise between samples, rms m. Its interval excludes zero only if
    /// the residual repeats with the configuration.
    pub excess_m: Measured,
    /// Excess rotation residual, rms rad.
    pub excess_rad: Measured,
    /// Position residual, rms m.
    pub rms_m: f64,
    /// Rotation residual, rms rad.
    pub rms_rad: f64,
    /// Position error against FK at equal stamps as recorded, rms m.
    pub before_m: f64,
    /// Rotation error against FK at equal stamps as recorded, rms rad.
    pub before_rad: f64,
}

impl StreamResidual {
    /// Position and rotation residual combined with a lever of 0.3 m, rms m.
    pub fn combined_m(&self) -> f64 {
        self.rms_m.hypot(0.3 * self.rms_rad)
    }
}

/// Diagnosis of one pose stream.
#[derive(Clone, Debug)]
pub struct PoseDiagnosis {
    /// Encoding of the rotations.
    pub encoding: EstimateResult<EncodingEstimate>,
    /// Wrong position unit.
    pub length_unit: EstimateResult<Option<LengthUnitError>>,
    /// Whether whole poses are inverted, according to their positions.
    pub is_inverted: bool,
    /// Exchanged or mirrored axes.
    pub axes: EstimateResult<Option<AxesError>>,
    /// Constant coordinates.
    pub constant_coordinates: Vec<ConstantCoordinate>,
    /// Rotation numbers in degrees (streams of bare numbers).
    pub degrees: Option<UnitResiduals>,
    /// Latency relative to the joint states, s; the median if its delays are skewed.
    pub latency_s: EstimateResult<Measured>,
    /// Delay distribution, if it is skewed.
    pub delay_jitter: Option<DelayJitter>,
    /// Clock skew, s/s.
    pub skew: EstimateResult<Measured>,
    /// Whether the selected model contains the skew.
    pub is_skew_chosen: bool,
    /// Latency profile over the run.
    pub latency_profile: EstimateResult<LatencyProfile>,
    /// Radial scale error of positions, m/m.
    pub radial_scale: EstimateResult<Measured>,
    /// Whether the selected model contains the radial scale.
    pub is_radial_scale_chosen: bool,
    /// Error of the reference frame, `reference_from_stream`. If the reference was unknown, its estimated
    /// pose.
    pub reference: EstimateResult<FrameEstimate>,
    /// Error of the tool frame, `tip_from_stream`.
    pub tool: EstimateResult<FrameEstimate>,
    /// Change points of the reference frame.
    pub reference_changes: Vec<FrameChange>,
    /// Change points of the tool frame.
    pub tool_changes: Vec<FrameChange>,
    /// Change points of the radial scale, m/m.
    pub radial_scale_changes: Vec<ScalarChange>,
    /// Parts of the run to which `encoding`, `length_unit`, `axes`, `is_inverted` and `degrees` apply.
    pub encoding_spans: EncodingSpans,
    /// Residual after correcting every finding.
    pub residual: EstimateResult<StreamResidual>,
    /// Whether link deviations explain the residual: nominal kinematics of a calibrated arm, at most 10 mm
    /// and 0.5°.
    pub is_nominal: bool,
    /// Standard deviation of the links from the nominal model, m. Angles deviate by 0.1° per mm.
    pub link_m: Option<f64>,
    /// Observability of each parameter. `None` if nothing was fitted.
    pub observability: Option<Observability>,
    /// Maximum tip speed by FK, m/s.
    pub top_speed_m_s: f64,
    /// Aligned samples.
    pub aligned: AlignedSamples,
    /// Corrections applied to them.
    pub frame_correction: FrameCorrection,
}

/// Frame and radial scale corrections that align a stream's poses with FK.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameCorrection {
    /// `stream_from_reference`.
    pub reference: Pose,
    /// `tip_from_stream`.
    pub tool: Pose,
    /// Radial scale error of positions, m/m.
    pub radial_scale: f64,
}

impl FrameCorrection {
    /// Corrects a decoded pose. Returns the pose of the tip in the reference frame.
    pub fn apply(&self, read: &Pose) -> Pose {
        let mut in_base = self.reference.inv_mul(read);
        in_base.translation.vector /= 1.0 + self.radial_scale;
        in_base * self.tool.inverse()
    }

    /// Inverse of [`FrameCorrection::apply`]: the decoded pose for a corrected one.
    pub fn invert(&self, tip: &Pose) -> Pose {
        let mut in_base = tip * self.tool;
        in_base.translation.vector *= 1.0 + self.radial_scale;
        self.reference * in_base
    }
}

impl PoseDiagnosis {
    /// Whether the stream has a change point.
    pub fn has_changes(&self) -> bool {
        let Self {
            reference_changes,
            tool_changes,
            radial_scale_changes: growth_changes,
            encoding_spans: coded,
            ..
        } = self;
        let are_frames = !reference_changes.is_empty() || !tool_changes.is_empty();
        are_frames || !growth_changes.is_empty() || *coded != EncodingSpans::default()
    }

    /// Reason why the stream could not be used. Positions may be usable if orientations are not.
    pub fn unusable_reason(&self) -> Option<&NotObservable> {
        self.encoding.as_ref().err().filter(|_| self.residual.is_err())
    }

    /// Whether the position residual is a large share of the motion, so that no finding on the stream is
    /// credible.
    pub fn is_far_from_fk(&self) -> bool {
        /// Residuals below this are noise or a calibration, rms m.
        const MIN_LARGE_RESIDUAL_M: f64 = 5e-3;
        let fk: Vec<Vec3> =
            self.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).collect();
        let left_m = self.residual.as_ref().map_or(0.0, |residual| residual.excess_m.value);
        left_m > MIN_LARGE_RESIDUAL_M
            && left_m > joints::MAX_FOLLOWING_RESIDUAL_SHARE * position_fit::spread(&fk)
    }

    /// Whether the motion is periodic, so that all other findings may belong to a wrong lag.
    pub fn is_periodic(&self) -> bool {
        matches!(self.latency_s, Err(NotObservable::Periodic(_)))
    }
}

/// Joint diagnosis of the joint states and the pose streams.
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
    /// Zero offset of each joint of the chain, from all pose streams.
    pub offsets: Vec<JointOffset>,
    /// Joints with a wrong scale or direction.
    pub scales: Vec<JointScale>,
    /// Joints with a change point of zero or scale.
    pub changes: Vec<JointChange>,
    /// Corrections that undo these changes.
    pub patches: Vec<JointPatch>,
    /// Joints with compliance (backlash, sag or eccentricity).
    pub compliance: Vec<JointCompliance>,
}
