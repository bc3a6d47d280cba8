//! Commands compared with motion.

use super::joint_map::JointMap;
use super::line::CommandedLine;
use ground::geometry::{Pose, Vec3, mean_vector, rotvec_from_rotation};
use ground::stats::{Measured, MeasuredLength};

/// Difference between a command and the pose at rest.
#[derive(Clone, Debug)]
pub struct RestError {
    /// Start of the constant interval, from the run's origin.
    pub from_s: f64,
    /// Its end.
    pub to_s: f64,
    /// Commanded `base_from_tip`.
    pub commanded: Pose,
    /// Mean measured `base_from_tip`.
    pub measured: Pose,
    /// Distance between them.
    pub distance_m: MeasuredLength,
    /// Angle between them.
    pub angle_rad: MeasuredLength,
    /// Column and `q_measured − q_commanded`, rad or m, per commanded joint.
    pub joints: Vec<(usize, Measured)>,
}

impl RestError {
    /// Commanded pose in the measured tip frame.
    pub fn tip_from_commanded(&self) -> Pose {
        self.measured.inverse() * self.commanded
    }
}

/// Spread of the pose error over rests, m and rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestErrorSpread {
    /// Maximum deviation of `tip_from_commanded` from its mean. Zero if the commands refer to another tool
    /// point.
    pub in_tool: (f64, f64),
    /// Likewise of `base_from_commanded_base`. Zero if they refer to another base.
    pub in_base: (f64, f64),
}

impl RestErrorSpread {
    /// `None` for fewer than two rests.
    pub fn from_rests(errors: &[RestError]) -> Option<Self> {
        if errors.len() < 2 {
            return None;
        }
        let max_deviation = |vectors: Vec<Vec3>| {
            let mean = mean_vector(&vectors);
            vectors.iter().map(|vector| (vector - mean).norm()).fold(0.0, f64::max)
        };
        let spread = |of: &dyn Fn(&RestError) -> Pose| {
            let poses: Vec<Pose> = errors.iter().map(of).collect();
            let translations = poses.iter().map(|pose| pose.translation.vector);
            let rotations = poses.iter().map(|pose| rotvec_from_rotation(&pose.rotation));
            (max_deviation(translations.collect()), max_deviation(rotations.collect()))
        };
        Some(Self {
            in_tool: spread(&RestError::tip_from_commanded),
            in_base: spread(&|error| error.commanded * error.measured.inverse()),
        })
    }
}

/// Following of a command stream by FK during motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandTracking {
    /// Delay of the arm.
    pub delay_s: f64,
    /// Speed correlation at that delay.
    pub correlation: f64,
    /// Following error at equal stamps, rms m and rad.
    pub rms: (f64, f64),
    /// Error after compensating the delay.
    pub compensated: (f64, f64),
}

/// One command stream against the arm's motion.
#[derive(Clone, Debug)]
pub struct CommandDiagnosis {
    /// Whether the arm follows a stream, not single goals.
    pub is_streamed: bool,
    /// `None` if there are too few commands or the arm does not follow.
    pub tracking: Option<CommandTracking>,
    /// Constant commands.
    pub goals: usize,
    /// Goals without a rest nearby. Zero for a followed stream.
    pub not_reached: usize,
    /// Smallest distance (m) and angle (rad) of these goals to a rest.
    pub nearest_miss: Option<(f64, f64)>,
    /// Per observation, each rest near its command, in time order.
    pub rest_errors: Vec<Vec<RestError>>,
    /// Column, and map from the joint's goals to its states at the rests that they caused.
    pub goal_maps: Vec<(usize, JointMap)>,
    /// Straight lines in the stream.
    pub lines: Vec<CommandedLine>,
}
