//! The series behind a report's pictures, in SI units and seconds from the start of the run.
//!
//! Filled where a format draws them, from what plots, tables and the recording read too; see
//! [`Audited::with_figures`](crate::Audited::with_figures).

use crate::time::Stamp;

/// What the pictures of a report show.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Length of the run, s.
    pub duration_s: f64,
    /// Whether they are of the longest segment only of a run whose clock began anew.
    pub of_longest_segment: bool,
    /// The pose streams, and /tf.
    pub poses: Vec<PoseFigure>,
    /// The IMUs.
    pub imus: Vec<ImuFigure>,
    /// The pictures of single findings, with the place of the finding in the report.
    pub own: Vec<(usize, Own)>,
    /// First stamp of the run, from which times count.
    pub start: Option<Stamp>,
    /// When each stream was there.
    pub timeline: Vec<TimelineRow>,
    /// The transforms of the log and the still ones of its models.
    pub frames: Vec<FrameEdge>,
}

/// The picture of one finding's own.
#[derive(Clone, Debug)]
pub enum Own {
    /// A path that shakes: its spectrum in Hz and rms m, and the path in s and m.
    Shake {
        /// Frequency and rms.
        spectrum: Vec<[f64; 2]>,
        /// Time and place along the axis that moves most.
        trace: Vec<[f64; 2]>,
    },
    /// What a camera sees against a hand.
    HandEye {
        /// Time, distance in m and angle in rad that the chain is open by, of each view.
        each: Vec<[f64; 3]>,
        /// From where the target is seen, rad about two axes across the mean view.
        views: Vec<[f64; 2]>,
        /// Where the target is in the camera's frame, m.
        seen: Vec<[f64; 3]>,
    },
    /// A commanded line: way along it in m, distance in m and angle in rad from it.
    Line {
        /// The tip by FK, from the line through its own ends.
        tip: Vec<[f64; 3]>,
        /// The command.
        command: Vec<[f64; 3]>,
    },
    /// Where the arm came to rest, against each goal: both m in the base.
    Rests(Vec<[[f64; 3]; 2]>),
    /// Time and by how much a rotation is none.
    Norms(Vec<[f64; 2]>),
    /// The columns of the rotations from an IMU to its link.
    ImuAxes {
        /// The link.
        link: String,
        /// As the motion has it.
        found: [[f64; 3]; 3],
        /// As the log's frames have it.
        logged: Option<[[f64; 3]; 3]>,
    },
    /// Time and the three rates of a gyro, rad/s.
    Gyro {
        /// The rates.
        rates: Vec<[f64; 4]>,
        /// Whether they are of rests alone.
        at_rest: bool,
        /// The bias found.
        bias: Option<[f64; 3]>,
    },
    /// Where up is by the accelerometer in the world of the orientation: its x and y as angles, rad.
    Tilt(Vec<[f64; 2]>),
    /// A joint.
    Joint(JointFigure),
}

/// One joint, in rad or m.
#[derive(Clone, Debug, Default)]
pub struct JointFigure {
    /// The joint.
    pub joint: String,
    /// Whether it slides.
    pub slides: bool,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Positions.
    pub position: Vec<f64>,
    /// Velocities as recorded; empty where there are none.
    pub velocity: Vec<f64>,
    /// The rates of the positions.
    pub rate: Vec<f64>,
    /// Limits of the position.
    pub limits: [Option<f64>; 2],
    /// Limit of the speed.
    pub top_speed: Option<f64>,
}

/// Errors of one pose stream. The columns have an entry a sample; those `before` are empty where the
/// log does not tie the stream's frame to the arm.
#[derive(Clone, Debug, Default)]
pub struct PoseFigure {
    /// The arm.
    pub robot: String,
    /// The stream's topic.
    pub topic: String,
    /// Whether it is computed from the joint states, as /tf is.
    pub is_derived: bool,
    /// Stamps, s.
    pub t_s: Vec<f64>,
    /// Distance from FK as recorded, m.
    pub before_m: Vec<f64>,
    /// Angle to FK as recorded, rad.
    pub before_rad: Vec<f64>,
    /// The same once everything found is taken off, m.
    pub after_m: Vec<f64>,
    /// Likewise, rad.
    pub after_rad: Vec<f64>,
    /// Distance of FK from the origin of the reference frame, m.
    pub reach_m: Vec<f64>,
    /// The tip by FK in the reference frame, m.
    pub at_m: Vec<[f64; 3]>,
    /// What is left at latencies around the one found: latency in s, rms m, rms rad.
    pub left_by_latency: Vec<[f64; 3]>,
    /// Its latency over the run.
    pub latency_course: Vec<CoursePoint>,
    /// What each reading of its rotations leaves.
    pub readings: Vec<ReadingScore>,
}

/// One IMU.
#[derive(Clone, Debug, Default)]
pub struct ImuFigure {
    /// The arm.
    pub robot: String,
    /// The IMU's topic.
    pub topic: String,
    /// Stamp in s, and yaw of the IMU over that of FK in rad.
    pub yaw_error: Vec<[f64; 2]>,
    /// Stamp in s, and heading by the IMU and by FK in rad; empty where no axis has one throughout.
    pub headings: Vec<[f64; 3]>,
    /// How its speed of turning correlates with FK's: latency in s, correlation.
    pub correlation_by_latency: Vec<[f64; 2]>,
    /// Its latency over the run.
    pub latency_course: Vec<CoursePoint>,
    /// What each reading of its rotations leaves.
    pub readings: Vec<ReadingScore>,
}

/// The latency of a stream in a window of about a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoursePoint {
    /// Middle of the window, s.
    pub t_s: f64,
    /// Latency beyond that of the whole run, s.
    pub beyond_s: f64,
    /// Half the width of its 95 % interval, s.
    pub half_width_s: f64,
}

/// What one reading of a stream's rotations leaves.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingScore {
    /// What the numbers are under it, by the names of the estimates.
    pub is: String,
    /// What they were read as.
    pub read_as: String,
    /// Whether it is the stream as logged.
    pub is_as_logged: bool,
    /// Whether it is the reading that the audit names.
    pub is_best: bool,
    /// Residual angle, rms rad.
    pub rms_rad: f64,
}

/// When one stream was there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimelineRow {
    /// Its topic.
    pub topic: String,
    /// Its child frame, where the topic has several streams.
    pub frame: Option<String>,
    /// First and last stamp, s.
    pub span_s: [f64; 2],
    /// Samples a second.
    pub rate_hz: Option<f64>,
    /// Messages or samples, and how many could not be used.
    pub count: u64,
    /// Samples that could not be used.
    pub dropped: u64,
    /// The longest intervals in which samples are missing, in the order of time.
    pub silences: Vec<Silence>,
    /// Silences beside those.
    pub silences_left_out: usize,
}

/// An interval in which samples of a stream are missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Silence {
    /// From and to, s.
    pub span_s: [f64; 2],
    /// Samples missing, at the stream's period.
    pub missing: usize,
}

/// A transform between two frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEdge {
    /// The parent frame.
    pub parent: String,
    /// The child frame.
    pub child: String,
    /// Where it comes from.
    pub kind: FrameEdgeKind,
}

/// Where a transform comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameEdgeKind {
    /// Sent over and over.
    Moving,
    /// Sent as static.
    Still,
    /// A fixed joint of the model that the log does not publish.
    Model,
}
