//! Data series of a report's plots, in SI units and seconds from the start of the run.
//!
//! Computed only if a format draws them; see [`Audited::with_figures`](crate::Audited::with_figures).

use crate::time::Stamp;

/// Data of all plots of a report.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Duration of the run, s.
    pub duration_s: f64,
    /// Whether the data cover only the longest segment, because the clock was reset during the run.
    pub of_longest_segment: bool,
    /// Pose streams and /tf.
    pub poses: Vec<PoseFigure>,
    /// IMUs.
    pub imus: Vec<ImuFigure>,
    /// Plots specific to single findings, with the index of the finding in the report.
    pub own: Vec<(usize, Own)>,
    /// First stamp of the run, the origin of all times.
    pub start: Option<Stamp>,
    /// Time spans of all streams.
    pub timeline: Vec<TimelineRow>,
    /// Transforms of the log and fixed joints of the models.
    pub frames: Vec<FrameEdge>,
}

/// Plot specific to one finding.
#[derive(Clone, Debug)]
pub enum Own {
    /// Vibration: spectrum in Hz and rms m, and path in s and m.
    Shake {
        /// Frequency and rms.
        spectrum: Vec<[f64; 2]>,
        /// Time and position along the axis with most motion.
        trace: Vec<[f64; 2]>,
    },
    /// Hand-eye closure.
    HandEye {
        /// Time, distance in m and angle in rad of the closure error of each view.
        each: Vec<[f64; 3]>,
        /// Viewing directions of the target, rad about two axes normal to the mean direction.
        views: Vec<[f64; 2]>,
        /// Positions of the target in the camera frame, m.
        seen: Vec<[f64; 3]>,
    },
    /// Commanded line: position along it in m, deviation in m and in rad.
    Line {
        /// Tip by FK, relative to the line between its end points.
        tip: Vec<[f64; 3]>,
        /// The command.
        command: Vec<[f64; 3]>,
    },
    /// Rest positions of the arm and their goals, m in the base frame.
    Rests(Vec<[[f64; 3]; 2]>),
    /// Time and deviation from a valid rotation.
    Norms(Vec<[f64; 2]>),
    /// Axes of an IMU in its link, as columns of rotation matrices.
    ImuAxes {
        /// The link.
        link: String,
        /// Estimated from the motion.
        found: [[f64; 3]; 3],
        /// From the log's frames.
        logged: Option<[[f64; 3]; 3]>,
    },
    /// Time and three rates of a gyro, rad/s.
    Gyro {
        /// The rates.
        rates: Vec<[f64; 4]>,
        /// Whether only samples at rest are included.
        at_rest: bool,
        /// Estimated bias.
        bias: Option<[f64; 3]>,
    },
    /// Up direction from the accelerometer in the orientation's world frame: x and y as angles, rad.
    Tilt(Vec<[f64; 2]>),
    /// A joint.
    Joint(JointFigure),
}

/// One joint, in rad or m.
#[derive(Clone, Debug, Default)]
pub struct JointFigure {
    /// The joint.
    pub joint: String,
    /// Whether it is prismatic.
    pub slides: bool,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Positions.
    pub position: Vec<f64>,
    /// Recorded velocities. Empty if there are none.
    pub velocity: Vec<f64>,
    /// Rates computed from the positions.
    pub rate: Vec<f64>,
    /// Position limits.
    pub limits: [Option<f64>; 2],
    /// Velocity limit.
    pub top_speed: Option<f64>,
}

/// Errors of one pose stream, with one entry per sample in each column. The columns `before_…` are empty if
/// the stream's frame is not connected to the arm in the log.
#[derive(Clone, Debug, Default)]
pub struct PoseFigure {
    /// The arm.
    pub robot: String,
    /// The stream's topic.
    pub topic: String,
    /// Whether it is derived from the joint states, such as /tf.
    pub is_derived: bool,
    /// Stamps, s.
    pub t_s: Vec<f64>,
    /// Position error against recorded FK, m.
    pub before_m: Vec<f64>,
    /// Rotation error against recorded FK, rad.
    pub before_rad: Vec<f64>,
    /// Position error after correcting all findings, m.
    pub after_m: Vec<f64>,
    /// Rotation error after correcting all findings, rad.
    pub after_rad: Vec<f64>,
    /// Distance of FK from the origin of the reference frame, m.
    pub reach_m: Vec<f64>,
    /// Tip position by FK in the reference frame, m.
    pub at_m: Vec<[f64; 3]>,
    /// Residual at latencies around the estimate: latency in s, rms m, rms rad.
    pub left_by_latency: Vec<[f64; 3]>,
    /// Latency profile over the run.
    pub latency_course: Vec<CoursePoint>,
    /// Residual of each rotation encoding.
    pub readings: Vec<ReadingScore>,
}

/// One IMU.
#[derive(Clone, Debug, Default)]
pub struct ImuFigure {
    /// The arm.
    pub robot: String,
    /// The IMU's topic.
    pub topic: String,
    /// Stamp in s, and yaw error of the IMU against FK in rad.
    pub yaw_error: Vec<[f64; 2]>,
    /// Stamp in s, and heading by the IMU and by FK in rad. Empty if no axis has a heading throughout.
    pub headings: Vec<[f64; 3]>,
    /// Correlation of its angular speed with FK's: latency in s, correlation.
    pub correlation_by_latency: Vec<[f64; 2]>,
    /// Latency profile over the run.
    pub latency_course: Vec<CoursePoint>,
    /// Residual of each rotation encoding.
    pub readings: Vec<ReadingScore>,
}

/// Latency of a stream in a window of about a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoursePoint {
    /// Middle of the window, s.
    pub t_s: f64,
    /// Latency relative to the whole run's, s.
    pub beyond_s: f64,
    /// Half width of its 95 % interval, s.
    pub half_width_s: f64,
}

/// Residual of one rotation encoding of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingScore {
    /// Actual encoding of the numbers in this hypothesis.
    pub is: String,
    /// Assumed encoding.
    pub read_as: String,
    /// Whether it is the stream as logged.
    pub is_as_logged: bool,
    /// Whether the audit selects this encoding.
    pub is_best: bool,
    /// Residual angle, rms rad.
    pub rms_rad: f64,
}

/// Time span of one stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimelineRow {
    /// Its topic.
    pub topic: String,
    /// Child frame, if the topic has several streams.
    pub frame: Option<String>,
    /// First and last stamp, s.
    pub span_s: [f64; 2],
    /// Samples per second.
    pub rate_hz: Option<f64>,
    /// Number of messages or samples.
    pub count: u64,
    /// Number of samples that could not be used.
    pub dropped: u64,
    /// Longest intervals with missing samples, in time order.
    pub silences: Vec<Silence>,
    /// Number of further such intervals.
    pub silences_left_out: usize,
}

/// Interval with missing samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Silence {
    /// Start and end, s.
    pub span_s: [f64; 2],
    /// Number of missing samples at the stream's period.
    pub missing: usize,
}

/// A transform between two frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEdge {
    /// The parent frame.
    pub parent: String,
    /// The child frame.
    pub child: String,
    /// Origin of the transform.
    pub kind: FrameEdgeKind,
}

/// Origin of a transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameEdgeKind {
    /// Published repeatedly.
    Moving,
    /// Published as static.
    Still,
    /// Fixed joint of the model that the log does not publish.
    Model,
}
