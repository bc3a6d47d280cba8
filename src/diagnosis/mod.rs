//! Estimators: joint states and streams in, estimates with intervals out.
//!
//! This module reads no files, knows no topics and holds no thresholds of rules. `checks` turns its
//! estimates into findings.
//!
//! # Input
//! A `JointTrack` with joint positions `q` and velocities, and for each pose stream a [`PoseStream`]: the
//! logged poses, the kinematic chain from its reference link to its tip, and whether its reference frame is
//! known. Times are in seconds from the run's origin.
//!
//! # Measurement model (`model`)
//! ```text
//! logged(s) = C(reference · scaled(FK(q(s − τ) + δ) · tool)) + noise,   τ = latency + skew·(s − middle)
//! ```
//! - `s` is the stamp of a sample.
//! - `C` is the encoding: unit and axes of positions, rotation convention, inversion of whole poses. It is
//!   discrete.
//! - `reference` and `tool` are constant poses, the identity if the frames are correct.
//! - `scaled` multiplies positions by `1 + growth` about the base origin (radial scale).
//! - `δ` contains the joint zeros, and unknown scales and couplings of joints if their encoding has any.
//! - The noise is white plus first-order autoregressive (`noise`), with Huber weights for outliers
//!   (`robust`).
//!
//! # Steps for an arm (`diagnose_steadied` in `steady`)
//! 1. `large` estimates large latency steps and ramps from speeds. `steady` removes them from the stamps.
//! 2. `latency` cross-correlates speeds to find candidate lags.
//! 3. `placement` and `layout` determine the position encoding, `joints` the joint names and units. Both
//!    use positions, before any rotation is decoded. `prepare`, `turning` and `reading` then determine the
//!    rotation encoding.
//! 4. `arm::fit` fits all streams together. `frames` provides starting points, `explain` selects causes and
//!    iterates Gauss–Newton, and `harmless` replaces a moved reference by a tool if both fit.
//! 5. `nominal` and `drawing` add link deviations as random effects. Causes that these explain as well are
//!    dropped.
//! 6. `arm::stream` and `arm::zeros` compute values, intervals and confounders; `residual` computes the
//!    excess residual and `course` the latency profile. `steady` compensates a variable latency and repeats
//!    steps 2 to 6.
//! 7. `bends` (backlash, sag, eccentricity) and `changes` (change points) are competing models for a
//!    remaining residual. Each corrects the run and repeats steps 2 to 6. It is accepted only if the
//!    residual becomes much smaller.
//!
//! Streams computed from the joint states, such as /tf, are compared with these alone (`diagnose_derived`).
//! IMUs are compared with FK of the corrected joint states (`imu`).
//!
//! # Selection of causes (`explain`)
//! The latency of a moving stream and an unknown reference frame are always free. Candidate causes are the
//! joint zeros, and per stream the skew, radial scale, reference and tool. The model is linearised once
//! with all of them. Each set of causes then has the score `rᵀWr` after its least-squares step plus `ln n +
//! 8` per parameter, with `n` the number of independent residuals. Sets of up to four causes (three if
//! there are more than 16) are compared exhaustively, larger ones by greedy addition and pruning. Sets with
//! a cause nearly equal to a combination of the others are rejected. Selection and steps alternate until
//! both converge. This is repeated from every starting point, and the least `Σ n·ln σ²` plus price wins.
//!
//! # Checks
//! `proof` compares each stream with FK without the estimators, as logged and corrected. `residual`
//! cross-validates whether the residual repeats with the configuration. `observability` lists the
//! parameters that the motion does not determine.
//!
//! # Output
//! An [`ArmDiagnosis`]. Each estimate is a [`Measured`] (value, standard error, degrees of freedom) or the
//! [`Unseen`] reason why it does not exist, and states whether its cause was selected.
//!
//! The remaining modules are separate estimators: `columns` identifies table columns, `model_fit` the arm
//! model, and `handeye`, `calibration`, `plan`, `reference`, `velocity`, `shake`, `workspace` and `trend`
//! do as their names say.
#![warn(missing_docs, clippy::unwrap_used)]

#[cfg(test)]
mod test_motion;
#[cfg(test)]
#[path = "../ground/geometry/test_random.rs"]
mod test_random;

mod aligned;
mod alternation;
mod arm;
mod bends;
mod calibration;
mod carried;
mod changes;
mod columns;
mod constant;
mod course;
mod dh;
mod drawing;
mod explain;
mod frames;
mod gradual;
mod handeye;
mod harmless;
mod imu;
mod joints;
mod lag;
mod large;
mod latency;
mod layout;
mod linear;
mod model;
mod model_fit;
mod motion;
mod noise;
mod nominal;
mod observability;
mod placement;
mod placing;
pub mod plan;
mod prepare;
mod proof;
mod reading;
mod reference;
mod reread;
mod residual;
mod response;
mod rival;
mod robust;
mod sampling;
mod shake;
mod skewed;
mod steady;
mod steps;
mod trend;
mod turning;
mod velocity;
mod workspace;

use ground::geometry::{
    Axes, Convention, LengthScale, Misreading, MisreadingClass, Pose, QuaternionSlip, Vec3,
};
use ground::robot::Chain;
use ground::stream::PoseTrack;

pub use aligned::{Aligned, Residuals};
pub use alternation::{Alternation, Other, alternation};
pub use arm::{diagnose_arm, diagnose_derived, follows, likely_lags};
pub use bends::{BendShape, Crossing, JointBend, Sag};
pub use calibration::{
    ArmCalibration, CalibrationStream, LeftOver, LinkParameter, NoCalibration, StreamCalibration,
    Uncertainty, Untold, calibrate_arm,
};
pub use carried::{BaseTravel, CarrierLag, base_travel, carrier_lag};
pub use changes::{AmountChange, Change, CodedParts, FrameChange, JointChange, JointPatch};
pub use columns::{Block, Conduct, JointNumbers, Mapping, Sheet, Shift, Wanted};
pub use course::{LatencyCourse, LatencyJump, LatencyShape};
pub use dh::{DhEstimate, DhStream, DhTold, Left, faults};
pub use gradual::GradualLatency;
pub use ground::stats::{Length, Measured};
pub use handeye::{
    CameraPose, Closure, Diversity, HandEyeDiagnosis, HandEyeStreams, Mount, PoseSeries, Solution,
    Stretch, TargetReading, TargetScale, diagnose_hand_eye, turning_peaks,
};
pub use imu::{
    AccelSlip, AccelUnit, AxesTurn, BiasChange, BiasCourse, Clipped, GyroBias, GyroShape, Heading,
    HeadingError, ImuDiagnosis, ImuNumbers, ImuProof, ImuStream, MountChange, Rates, Up, YawCourse,
    YawJump, YawWarmUp, diagnose_imu, proof_of_imu, reread_imu, turning_by_latency,
};
pub use joints::{
    JointCoupling, JointOffset, JointReading, JointScale, JointSlip, JointUnit, Twin,
};
pub use lag::{LatencyResidual, residual_by_latency};
use large::{LargeChange, imu_changes, pose_changes};
pub use latency::Peak;
pub use model_fit::{ModelFit, Needs, Priced, Tried, Way, model_fit};
pub use motion::{
    Abruptness, Excess, Series, abruptness, beyond_positions, beyond_speed,
    beyond_speed_of_positions, rates,
};
pub use observability::{BlindDirection, Observability, Parameter};
pub use proof::{Amount, Error, Part, Proof, Short, Size, proof};
pub use reference::{
    CommandDelay, CommandedArm, Commands, Constancy, Following, Line, LineWitness, NoDelay,
    ReferenceDiagnosis, RestGap, diagnose_reference, joint_delays, pose_delay, unnamed_order,
};
pub use reread::{Meant, reread_poses};
pub use response::Response;
pub use rival::{is_seen_from_tool, position_misfit_m};
pub use sampling::stretches;
pub use shake::{NoShake, Shake, ShakeSeen, shake, shake_seen};
pub use skewed::SkewedDelays;
pub use steady::{diagnose_imu_steadied, diagnose_steadied, steadied};
pub use trend::{LEAST_RUNS, Step, Told, Trend, trend};
pub use velocity::{
    VelocityDiagnosis, VelocitySamples, VelocityShape, diagnose_velocity, encoder_step,
};
pub use workspace::{
    APART_RAD, CELL_M, JOINT_APART, JointSpan, Place, ReachedPose, Workspace, centre_m, reach_m,
};

/// Reason why an estimate does not exist, with the values that a message needs.
#[derive(Clone, Debug, PartialEq)]
pub enum Unseen {
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
pub type Seen<T> = Result<T, Unseen>;

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
    pub taken_off: Option<&'a GradualLatency>,
}

/// Encoding of a stream's numbers under which it follows the arm.
#[derive(Clone, Copy, Debug)]
pub enum Reading {
    /// As logged.
    AsLogged,
    /// Misinterpretation: three numbers of one convention were read as another. All members are equivalent.
    Misread(&'static MisreadingClass),
    /// Permuted quaternion components.
    QuaternionOrder(QuaternionSlip),
    /// The rotation is transposed, the position is not.
    Transposed,
    /// The whole pose is inverted (parent and child exchanged).
    Inverted,
    /// Bare numbers in this convention (not a fault).
    Numbers(Convention),
}

impl Reading {
    /// Whether the encoding is as logged, not a fault.
    pub fn is_as_logged(&self) -> bool {
        matches!(self, Reading::AsLogged | Reading::Numbers(_))
    }

    /// Misinterpretation behind this encoding, if any.
    pub fn misreading(&self) -> Option<Misreading> {
        match self {
            Reading::Misread(class) => class.members.first().copied(),
            _ => None,
        }
    }
}

/// Rotation encoding that follows the arm, with its competitors.
#[derive(Clone, Debug)]
pub struct ReadingEstimate {
    /// Selected encoding; `AsLogged` if that explains the stream.
    pub best: Reading,
    /// Whether the whole pose is also inverted.
    pub inverted: bool,
    /// Residual angle as logged, rms rad. `None` for bare numbers.
    pub as_logged_rad: Option<f64>,
    /// Residual angle of the selected encoding, rms rad.
    pub best_rad: f64,
    /// Next best encoding that differs on this motion, with its residual, rms rad.
    pub runner_up: Option<(Reading, f64)>,
    /// Encodings that are equivalent to the selected one on this motion.
    pub equivalent: Vec<Reading>,
    /// Best encodings with the frames of the selected one, by increasing residual, rms rad. Includes the
    /// selected encoding and the stream as logged.
    pub ranked: Vec<(Reading, f64)>,
    /// Whether most encodings fit worse. At rest nearly all of them fit with a constant frame.
    pub is_told: bool,
}

/// Axes of a stream's numbers that differ from the axes of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxesSlip {
    /// Axes of the positions.
    pub positions: Axes,
    /// Axes of the rotations.
    pub rotations: Axes,
}

impl AxesSlip {
    /// Standard axes.
    pub const NONE: Self = Self { positions: Axes::STANDARD, rotations: Axes::STANDARD };
}

/// Wrong length unit of positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthSlip {
    /// Actual unit.
    pub is: LengthScale,
    /// Unit in which they were read.
    pub read_as: LengthScale,
    /// Residuals in both units.
    pub residual: UnitSlip,
}

impl LengthSlip {
    /// Factor from positions as read to m.
    pub fn factor(&self) -> f64 {
        self.is.in_m() / self.read_as.in_m()
    }
}

/// Coordinate of a stream that is constant while the arm moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantPart {
    /// Coordinate: x, y or z.
    pub coordinate: char,
    /// Its value, in the stream's unit.
    pub value: f64,
    /// Range of the coordinate by FK, m.
    pub moved_m: f64,
}

/// Residuals before and after correcting a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitSlip {
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
    pub chosen: bool,
}

/// Residual of a stream after correcting every finding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
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

impl Residual {
    /// Position and rotation residual combined with a lever of 0.3 m, rms m.
    pub fn together_m(&self) -> f64 {
        self.rms_m.hypot(0.3 * self.rms_rad)
    }
}

/// Diagnosis of one pose stream.
#[derive(Clone, Debug)]
pub struct PoseDiagnosis {
    /// Encoding of the rotations.
    pub reading: Seen<ReadingEstimate>,
    /// Wrong position unit.
    pub length: Seen<Option<LengthSlip>>,
    /// Whether whole poses are inverted, according to their positions.
    pub inverted: bool,
    /// Exchanged or mirrored axes.
    pub axes: Seen<Option<AxesSlip>>,
    /// Constant coordinates.
    pub constant: Vec<ConstantPart>,
    /// Rotation numbers in degrees (streams of bare numbers).
    pub degrees: Option<UnitSlip>,
    /// Latency relative to the joint states, s; the median if its delays are skewed.
    pub latency_s: Seen<Measured>,
    /// Delay distribution, if it is skewed.
    pub delays: Option<SkewedDelays>,
    /// Clock skew, s/s.
    pub skew: Seen<Measured>,
    /// Whether the selected model contains the skew.
    pub skew_chosen: bool,
    /// Latency profile over the run.
    pub course: Seen<LatencyCourse>,
    /// Radial scale error of positions, m/m.
    pub growth: Seen<Measured>,
    /// Whether the selected model contains the radial scale.
    pub growth_chosen: bool,
    /// Error of the reference frame, `reference_from_stream`. If the reference was unknown, its estimated
    /// pose.
    pub reference: Seen<FrameEstimate>,
    /// Error of the tool frame, `tip_from_stream`.
    pub tool: Seen<FrameEstimate>,
    /// Change points of the reference frame.
    pub reference_changes: Vec<FrameChange>,
    /// Change points of the tool frame.
    pub tool_changes: Vec<FrameChange>,
    /// Change points of the radial scale, m/m.
    pub growth_changes: Vec<AmountChange>,
    /// Parts of the run to which `reading`, `length`, `axes`, `inverted` and `degrees` apply.
    pub coded: CodedParts,
    /// Residual after correcting every finding.
    pub residual: Seen<Residual>,
    /// Whether link deviations explain the residual: nominal kinematics of a calibrated arm, at most 10 mm
    /// and 0.5°.
    pub nominal: bool,
    /// Standard deviation of the links from the nominal model, m. Angles deviate by 0.1° per mm.
    pub link_m: Option<f64>,
    /// Observability of each parameter. `None` if nothing was fitted.
    pub observability: Option<Observability>,
    /// Maximum tip speed by FK, m/s.
    pub top_speed_m_s: f64,
    /// Aligned samples.
    pub aligned: Aligned,
    /// Corrections applied to them.
    pub taken: Taken,
}

/// Frame and radial scale corrections that align a stream's poses with FK.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taken {
    /// `stream_from_reference`.
    pub reference: Pose,
    /// `tip_from_stream`.
    pub tool: Pose,
    /// Radial scale error of positions, m/m.
    pub growth: f64,
}

impl Taken {
    /// Corrects a decoded pose. Returns the pose of the tip in the reference frame.
    pub fn off(&self, read: &Pose) -> Pose {
        let mut in_base = self.reference.inv_mul(read);
        in_base.translation.vector /= 1.0 + self.growth;
        in_base * self.tool.inverse()
    }

    /// Inverse of [`Taken::off`]: the decoded pose for a corrected one.
    pub fn back(&self, tip: &Pose) -> Pose {
        let mut in_base = tip * self.tool;
        in_base.translation.vector *= 1.0 + self.growth;
        self.reference * in_base
    }
}

impl PoseDiagnosis {
    /// Whether the stream has a change point.
    pub fn changes(&self) -> bool {
        let Self { reference_changes, tool_changes, growth_changes, coded, .. } = self;
        let are_frames = !reference_changes.is_empty() || !tool_changes.is_empty();
        are_frames || !growth_changes.is_empty() || *coded != CodedParts::default()
    }

    /// Reason why the stream could not be used. Positions may be usable if orientations are not.
    pub fn unread(&self) -> Option<&Unseen> {
        self.reading.as_ref().err().filter(|_| self.residual.is_err())
    }

    /// Whether the position residual is a large share of the motion, so that no finding on the stream is
    /// credible.
    pub fn strays(&self) -> bool {
        /// Residuals below this are noise or a calibration, rms m.
        const MUCH_M: f64 = 5e-3;
        let fk: Vec<Vec3> =
            self.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).collect();
        let left_m = self.residual.as_ref().map_or(0.0, |residual| residual.excess_m.value);
        left_m > MUCH_M && left_m > joints::ON_ARM * placing::spread(&fk)
    }

    /// Whether the motion is periodic, so that all other findings may belong to a wrong lag.
    pub fn repeats(&self) -> bool {
        matches!(self.latency_s, Err(Unseen::Periodic(_)))
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
    pub reading: Seen<JointReading>,
    /// Zero offset of each joint of the chain, from all pose streams.
    pub offsets: Vec<JointOffset>,
    /// Joints with a wrong scale or direction.
    pub scales: Vec<JointScale>,
    /// Joints with a change point of zero or scale.
    pub changes: Vec<JointChange>,
    /// Corrections that undo these changes.
    pub patches: Vec<JointPatch>,
    /// Joints with compliance (backlash, sag or eccentricity).
    pub bends: Vec<JointBend>,
}
