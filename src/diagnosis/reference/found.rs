//! What was found on commands.

use super::line::Line;
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::{Length, Measured};

/// The difference between a command and where the arm came to rest.
#[derive(Clone, Debug)]
pub struct RestGap {
    /// When both stood still, s from the run's origin.
    pub from_s: f64,
    /// Until when.
    pub to_s: f64,
    /// `base_from_tip` as commanded.
    pub commanded: Pose,
    /// `base_from_tip` as measured, the mean.
    pub measured: Pose,
    /// Distance of the two, m.
    pub distance_m: Length,
    /// Angle between the two, rad.
    pub angle_rad: Length,
    /// Of commanded joints, the joint's column and by how much it is off what it was told:
    /// `q_measured − q_commanded`, rad or m.
    pub joints: Vec<(usize, Measured)>,
}

impl RestGap {
    /// `tip_from_commanded`: where the command is, seen from the tip.
    pub fn tip_from_commanded(&self) -> Pose {
        self.measured.inverse() * self.commanded
    }
}

/// Whether what differs at several rests is one and the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constancy {
    /// The farthest of `tip_from_commanded` from their mean: m, rad. Nothing where it is another point
    /// of the tool that is commanded.
    pub in_tool: (f64, f64),
    /// The same of `base_from_commanded_base`. Nothing where it is another base.
    pub in_base: (f64, f64),
}

impl Constancy {
    /// Of two rests or more.
    pub fn of(gaps: &[RestGap]) -> Option<Self> {
        if gaps.len() < 2 {
            return None;
        }
        let spread = |of: &dyn Fn(&RestGap) -> Pose| {
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
            in_tool: spread(&RestGap::tip_from_commanded),
            in_base: spread(&|gap| gap.commanded * gap.measured.inverse()),
        })
    }
}

/// How an arm follows a streamed command, by FK of its joint states while it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Following {
    /// How late the arm is, s.
    pub delay_s: f64,
    /// Correlation of the two speeds there.
    pub correlation: f64,
    /// Following error at equal stamps, rms m and rad.
    pub rms: (f64, f64),
    /// What is left of it when the delay is taken off.
    pub left: (f64, f64),
}

/// What was found of one stream of commands.
#[derive(Clone, Debug)]
pub struct ReferenceDiagnosis {
    /// Whether the commands come so often that the arm is led by them.
    pub is_streamed: bool,
    /// How the arm follows; `None` where commands are too few, or it does not.
    pub following: Option<Following>,
    /// Commands that stood still.
    pub goals: usize,
    /// Of these the ones near which the arm never came to rest after they were given; none of a stream
    /// that leads it.
    pub not_reached: usize,
    /// Distance (m) and angle (rad) at the nearest rest of the one of these that was missed by least.
    pub nearest_miss: Option<(f64, f64)>,
    /// By each witness what differs at each rest near its command, in the order of time.
    pub gaps: Vec<Vec<RestGap>>,
    /// The commanded straight lines, of poses that are streamed.
    pub lines: Vec<Line>,
}
