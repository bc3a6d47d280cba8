//! Results of the comparison of commands with motion.

use super::line::CommandedLine;
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::{Measured, MeasuredLength};

/// Difference between a command and the pose in which the arm came to rest.
#[derive(Clone, Debug)]
pub struct RestError {
    /// Start of the interval in which both are constant, s from the run's origin.
    pub from_s: f64,
    /// End of the interval, s.
    pub to_s: f64,
    /// Commanded `base_from_tip`.
    pub commanded: Pose,
    /// Mean of the measured `base_from_tip`.
    pub measured: Pose,
    /// Distance between the two, m.
    pub distance_m: MeasuredLength,
    /// Angle between the two, rad.
    pub angle_rad: MeasuredLength,
    /// For each commanded joint, its column and its error `q_measured − q_commanded`, rad or m.
    pub joints: Vec<(usize, Measured)>,
}

impl RestError {
    /// `tip_from_commanded`: commanded pose in the measured tip frame.
    pub fn tip_from_commanded(&self) -> Pose {
        self.measured.inverse() * self.commanded
    }
}

/// Spread of the pose error over several rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestErrorSpread {
    /// Maximum deviation of `tip_from_commanded` from its mean, m and rad. Zero if the commands refer to
    /// another point on the tool.
    pub in_tool: (f64, f64),
    /// Maximum deviation of `base_from_commanded_base`, m and rad. Zero if the commands refer to another
    /// base.
    pub in_base: (f64, f64),
}

impl RestErrorSpread {
    /// `None` for fewer than two rests.
    pub fn from_rests(gaps: &[RestError]) -> Option<Self> {
        if gaps.len() < 2 {
            return None;
        }
        let spread = |of: &dyn Fn(&RestError) -> Pose| {
            let parts: Vec<(Vec3, Vec3)> = gaps
                .iter()
                .map(of)
                .map(|pose| (pose.translation.vector, rotvec_from_rotation(&pose.rotation)))
                .collect();
            let count = parts.len() as f64;
            let (mean_m, mean_rad) = (
                parts.iter().map(|part| part.0).sum::<Vec3>() / count,
                parts.iter().map(|part| part.1).sum::<Vec3>() / count,
            );
            let far = |part: &(Vec3, Vec3)| ((part.0 - mean_m).norm(), (part.1 - mean_rad).norm());
            parts.iter().map(far).fold((0.0, 0.0), |a: (f64, f64), b| (a.0.max(b.0), a.1.max(b.1)))
        };
        Some(Self {
            in_tool: spread(&RestError::tip_from_commanded),
            in_base: spread(&|gap| gap.commanded * gap.measured.inverse()),
        })
    }
}

/// How the arm follows a stream of commands, by FK of its joint states during motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandTracking {
    /// Delay of the arm, s.
    pub delay_s: f64,
    /// Correlation of the two speeds at that delay.
    pub correlation: f64,
    /// Following error at equal stamps, rms m and rad.
    pub rms: (f64, f64),
    /// Following error after compensating the delay, rms m and rad.
    pub compensated: (f64, f64),
}

/// Comparison of one command stream with the motion of the arm.
#[derive(Clone, Debug)]
pub struct ReferenceDiagnosis {
    /// Whether the commands are a stream that the arm follows, and not single goals.
    pub is_streamed: bool,
    /// How the arm follows. `None` if there are too few commands or it does not follow.
    pub tracking: Option<CommandTracking>,
    /// Number of constant commands.
    pub goals: usize,
    /// Goals near which the arm never came to rest afterwards. Zero for a stream that the arm follows.
    pub not_reached: usize,
    /// Smallest distance (m) and angle (rad) between such a goal and a rest.
    pub nearest_miss: Option<(f64, f64)>,
    /// For each observation, the pose error at each rest near its command, in time order.
    pub rest_errors: Vec<Vec<RestError>>,
    /// Straight lines commanded by a stream of poses.
    pub lines: Vec<CommandedLine>,
}
