//! Pure estimators on streams and a robot: each returns an estimate with its interval, or why it
//! cannot tell.
//!
//! Nothing here reads files, knows topics, holds a rule's threshold or writes prose; `checks` turns
//! these numbers into verdicts and words.
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

/// Why an estimate does not exist. Each case carries what the words need.
#[derive(Clone, Debug, PartialEq)]
pub enum Unseen {
    /// Fewer samples overlap than the estimate needs.
    TooFewSamples {
        /// Samples of both streams at common times.
        have: usize,
        /// Samples needed.
        need: usize,
    },
    /// The streams share no time span.
    NoOverlap,
    /// The arm does not move enough.
    AtRest,
    /// The arm never rests.
    NeverRests,
    /// The motion repeats itself, so several lags fit; the candidates in seconds.
    Periodic(Vec<f64>),
    /// No lag makes the stream follow the arm: the best correlation found, from 0 to 1.
    DoesNotFollow(f64),
    /// The orientation changes too little; the span of orientations in rad.
    LittleRotation(f64),
    /// The parameter moves nothing that the log shows, or the same as other unknowns do.
    NotExcited,
    /// The stream carries no orientation.
    NoOrientation,
    /// The stream carries no angular velocity: it is zero while the arm turns.
    NoGyro,
    /// The stream's orientation was never set: it stays as it is while the arm turns.
    OrientationNotSet,
    /// The log does not say how the stream's frame is mounted.
    NoFrame,
    /// The model differs from the arm in many small ways, as a drawing differs from a calibrated
    /// arm; single causes of that size cannot be told from them.
    NominalKinematics,
    /// Another estimate that this one rests on could not be had.
    RestsOn(&'static str),
}

/// An estimate, or why there is none.
pub type Seen<T> = Result<T, Unseen>;

/// One pose stream, as the estimators see it.
#[derive(Clone, Copy, Debug)]
pub struct PoseStream<'a> {
    /// The poses as logged.
    pub track: &'a PoseTrack,
    /// The chain from the stream's reference link to the link whose pose it is.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint track.
    pub columns: &'a [usize],
    /// Whether the reference frame is tied to the robot's base; if not its pose is estimated.
    pub reference_known: bool,
    /// Standard error that aligning a foreign clock left in the stamps, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Whether the stream's stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
    /// What was taken off the stamps already, to be told of with what is found beyond it.
    pub taken_off: Option<&'a GradualLatency>,
}

/// How the numbers of a stream must be read so that they follow the arm.
#[derive(Clone, Copy, Debug)]
pub enum Reading {
    /// As the log says.
    AsLogged,
    /// Three numbers of one convention were read as another; any member says the same.
    Misread(&'static MisreadingClass),
    /// The quaternion's components are in another order.
    QuaternionOrder(QuaternionSlip),
    /// The rotation is transposed, the position is not.
    Transposed,
    /// The pose is inverted as a whole (parent and child exchanged).
    Inverted,
    /// Bare numbers that are of this convention (no fault).
    Numbers(Convention),
}

impl Reading {
    /// Whether the stream means what it says.
    pub fn is_as_logged(&self) -> bool {
        matches!(self, Reading::AsLogged | Reading::Numbers(_))
    }

    /// The misreading that names this reading, where it is one.
    pub fn misreading(&self) -> Option<Misreading> {
        match self {
            Reading::Misread(class) => class.members.first().copied(),
            _ => None,
        }
    }
}

/// Which reading of a stream's orientation follows the arm, and by how much.
#[derive(Clone, Debug)]
pub struct ReadingEstimate {
    /// The reading with the least residual; `AsLogged` wherever that explains the stream.
    pub best: Reading,
    /// Whether the pose as a whole is inverted, once its numbers are read so.
    pub inverted: bool,
    /// Residual angle as logged, rms rad; `None` for bare numbers.
    pub as_logged_rad: Option<f64>,
    /// Residual angle of the best reading, rms rad.
    pub best_rad: f64,
    /// The next best reading that is another map on this motion, with its residual, rms rad.
    pub runner_up: Option<(Reading, f64)>,
    /// Readings that this motion cannot tell from the best.
    pub equivalent: Vec<Reading>,
    /// The readings that fit best, with the frames that the best one needs: the least residual first,
    /// rms rad, the best and the stream as logged among them.
    pub ranked: Vec<(Reading, f64)>,
    /// Whether most readings fit worse; at rest a constant frame makes nearly all of them fit.
    pub is_told: bool,
}

/// The axes that a stream's numbers are in, where they are not those of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxesSlip {
    /// Those of its positions.
    pub positions: Axes,
    /// Those of its rotations.
    pub rotations: Axes,
}

impl AxesSlip {
    /// The axes as they should be.
    pub const NONE: Self = Self { positions: Axes::STANDARD, rotations: Axes::STANDARD };
}

/// Positions that are in another unit than they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthSlip {
    /// The unit that they are in.
    pub is: LengthScale,
    /// The one that they were taken for.
    pub read_as: LengthScale,
    /// Residual in the one and in the other.
    pub residual: UnitSlip,
}

impl LengthSlip {
    /// What takes positions as they were read to m.
    pub fn factor(&self) -> f64 {
        self.is.in_m() / self.read_as.in_m()
    }
}

/// A part of a stream's poses that stays as it is while the arm moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantPart {
    /// Which coordinate: x, y or z.
    pub coordinate: char,
    /// Its value, in the stream's unit.
    pub value: f64,
    /// By how much FK moves it, m.
    pub moved_m: f64,
}

/// Units of a stream's positions or angles that are not what they should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitSlip {
    /// Residual as logged, in the quantity's SI unit.
    pub as_logged: f64,
    /// Residual with the other unit, in the quantity's SI unit.
    pub corrected: f64,
}

/// A constant frame error, and how it was weighed.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEstimate {
    /// The pose: for the reference frame `reference_from_stream`, for the tool `tip_from_stream`.
    pub pose: Pose,
    /// Norm of its translation, m.
    pub translation_m: Measured,
    /// Its rotation angle, rad.
    pub rotation_rad: Measured,
    /// Chance of an estimate this large if the frame were right (joint test on the six numbers).
    pub p_value: f64,
    /// Whether the smallest explanation of the log contains this frame error.
    pub chosen: bool,
}

/// What is left of a stream when everything found is taken off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Position, rms m, beyond the sample-to-sample noise. Its interval excludes zero only where it
    /// comes again with the posture.
    pub excess_m: Measured,
    /// Rotation, rms rad, likewise.
    pub excess_rad: Measured,
    /// Position, rms m.
    pub rms_m: f64,
    /// Rotation, rms rad.
    pub rms_rad: f64,
    /// Position against FK as recorded, at equal stamps, rms m.
    pub before_m: f64,
    /// Rotation against FK as recorded, at equal stamps, rms rad.
    pub before_rad: f64,
}

impl Residual {
    /// Position and rotation together, an angle counting at an arm's length of 0.3 m, rms m.
    pub fn together_m(&self) -> f64 {
        self.rms_m.hypot(0.3 * self.rms_rad)
    }
}

/// All that was estimated on one pose stream.
#[derive(Clone, Debug)]
pub struct PoseDiagnosis {
    /// Convention and direction of the rotations.
    pub reading: Seen<ReadingEstimate>,
    /// Positions in another unit.
    pub length: Seen<Option<LengthSlip>>,
    /// Whether the poses as a whole are inverted, by their positions.
    pub inverted: bool,
    /// Axes that are exchanged or mirrored.
    pub axes: Seen<Option<AxesSlip>>,
    /// Coordinates that never change.
    pub constant: Vec<ConstantPart>,
    /// Rotation numbers in degrees (bare number streams).
    pub degrees: Option<UnitSlip>,
    /// Latency against the joint states, s; the median where its delays are skewed.
    pub latency_s: Seen<Measured>,
    /// Its delays, where they scatter to one side.
    pub delays: Option<SkewedDelays>,
    /// Clock skew, s/s.
    pub skew: Seen<Measured>,
    /// Whether the smallest explanation of the log contains the skew.
    pub skew_chosen: bool,
    /// What the latency does within the run.
    pub course: Seen<LatencyCourse>,
    /// Signed radial growth of positions, m/m.
    pub growth: Seen<Measured>,
    /// Whether the smallest explanation of the log contains the growth.
    pub growth_chosen: bool,
    /// Error of the reference frame, `reference_from_stream`; the estimated pose of the reference
    /// where that was not known.
    pub reference: Seen<FrameEstimate>,
    /// Error of the tool frame, `tip_from_stream`.
    pub tool: Seen<FrameEstimate>,
    /// When its reference frame changes, and by how much.
    pub reference_changes: Vec<FrameChange>,
    /// When its tool frame changes, and by how much.
    pub tool_changes: Vec<FrameChange>,
    /// When the growth of its positions changes, and by how much, m/m.
    pub growth_changes: Vec<AmountChange>,
    /// The parts of the run in which its numbers are coded as `reading`, `length`, `axes`, `inverted` and
    /// `degrees` say.
    pub coded: CodedParts,
    /// What is left.
    pub residual: Seen<Residual>,
    /// Whether what is left is that of nominal kinematics against a calibrated arm: at most 10 mm
    /// and 0.5°, and explained by small changes of many kinematic parameters.
    pub nominal: bool,
    /// By how much each link of such an arm differs from the drawing, as a standard deviation, m; its
    /// angles by 0.1° where that is 1 mm.
    pub link_m: Option<f64>,
    /// What this log tells of each parameter of the model; `None` where nothing was fitted.
    pub observability: Option<Observability>,
    /// Largest speed of the tip by FK, m/s.
    pub top_speed_m_s: f64,
    /// The aligned samples.
    pub aligned: Aligned,
    /// What was taken off them.
    pub taken: Taken,
}

/// The frames and the growth that are taken off a stream's poses to lay them on FK.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taken {
    /// `stream_from_reference`.
    pub reference: Pose,
    /// `tip_from_stream`.
    pub tool: Pose,
    /// Radial growth of positions, m/m.
    pub growth: f64,
}

impl Taken {
    /// A pose as it is read with these taken off: that of the tip in the reference.
    pub fn off(&self, read: &Pose) -> Pose {
        let mut in_base = self.reference.inv_mul(read);
        in_base.translation.vector /= 1.0 + self.growth;
        in_base * self.tool.inverse()
    }

    /// The pose as it was read of one with these taken off.
    pub fn back(&self, tip: &Pose) -> Pose {
        let mut in_base = tip * self.tool;
        in_base.translation.vector *= 1.0 + self.growth;
        self.reference * in_base
    }
}

impl PoseDiagnosis {
    /// Whether something of it changes in mid-run.
    pub fn changes(&self) -> bool {
        let Self { reference_changes, tool_changes, growth_changes, coded, .. } = self;
        let are_frames = !reference_changes.is_empty() || !tool_changes.is_empty();
        are_frames || !growth_changes.is_empty() || *coded != CodedParts::default()
    }

    /// Why the stream was not read. Where its orientations say nothing its positions still may.
    pub fn unread(&self) -> Option<&Unseen> {
        self.reading.as_ref().err().filter(|_| self.residual.is_err())
    }

    /// Whether what is left of the positions is a good part of their motion, so that nothing found on
    /// the stream can be believed.
    pub fn strays(&self) -> bool {
        /// Less than this is noise or a calibration, rms m.
        const MUCH_M: f64 = 5e-3;
        let fk: Vec<Vec3> =
            self.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).collect();
        let left_m = self.residual.as_ref().map_or(0.0, |residual| residual.excess_m.value);
        left_m > MUCH_M && left_m > joints::ON_ARM * placing::spread(&fk)
    }

    /// Whether the motion repeats itself, so that everything found beside the latency may be that
    /// of a wrong lag.
    pub fn repeats(&self) -> bool {
        matches!(self.latency_s, Err(Unseen::Periodic(_)))
    }
}

/// All that was estimated from the joint states and the pose streams together.
#[derive(Clone, Debug)]
pub struct ArmDiagnosis {
    /// What is said of the joint states.
    pub joints: JointDiagnosis,
    /// One entry for each pose stream given.
    pub streams: Vec<PoseDiagnosis>,
}

/// What was estimated on the joint states of an arm.
#[derive(Clone, Debug)]
pub struct JointDiagnosis {
    /// Their names and units.
    pub reading: Seen<JointReading>,
    /// Zero offset of each joint of the chain, from all pose streams.
    pub offsets: Vec<JointOffset>,
    /// The joints whose scale or direction is wrong.
    pub scales: Vec<JointScale>,
    /// The joints whose zero or scale changes in mid-run.
    pub changes: Vec<JointChange>,
    /// What makes their positions those that they would be had nothing changed.
    pub patches: Vec<JointPatch>,
    /// The joints that give, as none of the others do.
    pub bends: Vec<JointBend>,
}
