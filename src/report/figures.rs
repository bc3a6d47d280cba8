//! Data series of a report's plots, in SI units and seconds from the start of the run.
//!
//! Computed only if a format draws them; see [`Audited::with_figures`](crate::Audited::with_figures).

use crate::time::Stamp;

/// All plots of a report.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Run duration, s.
    pub duration_s: f64,
    /// Only the longest segment: the clock was reset.
    pub is_longest_segment: bool,
    /// Pose streams and /tf.
    pub poses: Vec<PoseFigure>,
    /// IMUs.
    pub imus: Vec<ImuFigure>,
    /// With the finding's index in the report.
    pub of_findings: Vec<(usize, FindingFigure)>,
    /// Origin of all times.
    pub start: Option<Stamp>,
    /// One row per stream.
    pub timeline: Vec<TimelineRow>,
    /// Frames of the log, and fixed joints of the models.
    pub frames: Vec<FrameEdge>,
}

/// Plot for one finding.
#[derive(Clone, Debug)]
pub enum FindingFigure {
    /// Vibration.
    Vibration {
        /// Hz and rms in m.
        spectrum: Vec<[f64; 2]>,
        /// Time and position along the axis with most motion, m.
        trace: Vec<[f64; 2]>,
    },
    /// Hand-eye closure.
    HandEye {
        /// Time and closure error of each view, m and rad.
        closures: Vec<[f64; 3]>,
        /// Directions of the target, rad about two axes normal to the mean direction.
        directions: Vec<[f64; 2]>,
        /// Target in the camera frame, m.
        positions: Vec<[f64; 3]>,
    },
    /// Commanded line: position along it in m, deviation in m and rad.
    Line {
        /// FK relative to the line between its end points.
        tip: Vec<[f64; 3]>,
        /// Command.
        command: Vec<[f64; 3]>,
    },
    /// Rest positions and goals, m in the base frame.
    RestErrors(Vec<[[f64; 3]; 2]>),
    /// Time and deviation from a valid rotation.
    RotationNorms(Vec<[f64; 2]>),
    /// Axes of an IMU in its link, as matrix columns.
    ImuAxes {
        /// Link.
        link: String,
        /// Estimated from the motion.
        estimated: [[f64; 3]; 3],
        /// From the log's frames.
        logged: Option<[[f64; 3]; 3]>,
    },
    /// Gyro.
    Gyro {
        /// Time and rates, rad/s.
        rates: Vec<[f64; 4]>,
        /// Only samples at rest.
        is_at_rest: bool,
        /// Estimated bias, rad/s.
        bias: Option<[f64; 3]>,
    },
    /// Accelerometer's up in the orientation's world frame: x and y as angles, rad.
    Tilt(Vec<[f64; 2]>),
    /// A joint.
    Joint(JointFigure),
}

/// One joint, in rad or m.
#[derive(Clone, Debug, Default)]
pub struct JointFigure {
    /// Name.
    pub joint: String,
    /// Prismatic.
    pub is_prismatic: bool,
    /// s.
    pub t_s: Vec<f64>,
    /// Positions.
    pub position: Vec<f64>,
    /// Recorded velocity; may be empty.
    pub velocity: Vec<f64>,
    /// Velocity from positions.
    pub differentiated: Vec<f64>,
    /// Lower and upper.
    pub limits: [Option<f64>; 2],
    /// Speed limit.
    pub max_speed: Option<f64>,
}

/// One entry per sample. `before_…` is empty if the log does not connect the stream's frame to the arm.
#[derive(Clone, Debug, Default)]
pub struct PoseFigure {
    /// Arm.
    pub robot: String,
    /// Topic.
    pub topic: String,
    /// From the joint states, such as /tf.
    pub is_derived: bool,
    /// Stamps, s.
    pub t_s: Vec<f64>,
    /// Error against recorded FK, m.
    pub before_m: Vec<f64>,
    /// Error against recorded FK, rad. Empty without orientations.
    pub before_rad: Vec<f64>,
    /// Error after all corrections, m.
    pub after_m: Vec<f64>,
    /// Error after all corrections, rad. Empty without orientations.
    pub after_rad: Vec<f64>,
    /// FK from the origin of the reference frame, m.
    pub reach_m: Vec<f64>,
    /// FK in the reference frame, m.
    pub at_m: Vec<[f64; 3]>,
    /// Residual around the estimate: latency in s, rms m, rms rad.
    pub residual_by_latency: Vec<[f64; 3]>,
    /// Latency profile.
    pub latency_profile: Vec<LatencyProfilePoint>,
    /// One score per rotation encoding.
    pub encodings: Vec<EncodingScore>,
}

/// One IMU.
#[derive(Clone, Debug, Default)]
pub struct ImuFigure {
    /// Arm.
    pub robot: String,
    /// Topic.
    pub topic: String,
    /// Stamp in s, and yaw error against FK in rad.
    pub yaw_error: Vec<[f64; 2]>,
    /// Stamp in s, heading by IMU and FK in rad. Empty if no axis always has one.
    pub headings: Vec<[f64; 3]>,
    /// Angular speed against FK's: latency in s, correlation.
    pub correlation_by_latency: Vec<[f64; 2]>,
    /// Latency profile.
    pub latency_profile: Vec<LatencyProfilePoint>,
    /// One score per rotation encoding.
    pub encodings: Vec<EncodingScore>,
}

/// Latency in a window of about a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyProfilePoint {
    /// Window middle, s.
    pub t_s: f64,
    /// Latency relative to the whole run's, s.
    pub deviation_s: f64,
    /// Half-width of the 95 % interval, s.
    pub half_width_s: f64,
}

/// Residual of one rotation encoding.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodingScore {
    /// Hypothetical actual encoding.
    pub actual: String,
    /// Assumed encoding.
    pub assumed: String,
    /// The stream as logged.
    pub is_as_logged: bool,
    /// Selected by the audit.
    pub is_best: bool,
    /// rad.
    pub rms_rad: f64,
}

/// Time span of one stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimelineRow {
    /// Topic.
    pub topic: String,
    /// Frame, if the topic has several streams.
    pub frame: Option<String>,
    /// First and last stamp, s.
    pub span_s: [f64; 2],
    /// Samples per second.
    pub rate_hz: Option<f64>,
    /// Messages or samples.
    pub count: u64,
    /// Unusable samples.
    pub dropped: u64,
    /// Longest gaps, in time order.
    pub gaps: Vec<StreamGap>,
    /// Number of other gaps.
    pub omitted_gaps: usize,
}

/// Gap in a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamGap {
    /// Start and end, s.
    pub span_s: [f64; 2],
    /// Samples, at the stream's period.
    pub missing: usize,
}

/// Transform between two frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEdge {
    /// Parent frame.
    pub parent: String,
    /// Child frame.
    pub child: String,
    /// Origin.
    pub kind: FrameEdgeKind,
}

/// Origin of a transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameEdgeKind {
    /// Published repeatedly.
    Moving,
    /// Published as static.
    Static,
    /// Fixed joint of the model, not published.
    Model,
}
