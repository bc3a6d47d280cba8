//! Generates the logs of the demo and the tests: an arm in motion, its streams, and injected faults.
//!
//! [`Scenario::write_mcap`] writes a [`Scenario`] as a ROS 2 recorder would. Faults use the signs and names
//! of the audit's reports. The output is deterministic; each stream has its own random sequence, so a fault
//! in one does not change the others.

mod cdr;
mod compliance;
mod messages;
mod motion;
mod noise;
mod path;
mod reference;
mod stream_settings;
mod streams;
mod structure;
mod target;
mod task;
mod tracker;
mod truth;
mod urdf;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use nalgebra::Matrix3;

use crate::geometry::{
    Convention, Misinterpretation, Pose, Rotation, Vec3, pose, rotation_from_rotvec,
};
use crate::robot::{ChainError, Robot, catalogue};
use crate::time::Stamp;

pub use compliance::{SynthCompliance, SynthComplianceKind};
use messages::Topic;
pub use motion::Motion;
pub use noise::Noise;
pub use path::LineMotion;
pub use reference::{Commands, ReferenceStream};
pub use stream_settings::{
    ImuStream, JointStream, LoggedEncoding, OtherTransform, PoseStream, TfStream, Timing,
};
pub use structure::{JointWrapping, LeaderStream, MovingBase, SecondPublisher, ToolSlip};
pub use target::{BodyAxesPart, Camera, TargetStream};
pub use task::Task;
pub use tracker::TrackerStream;
use truth::Truth;
pub use urdf::urdf_text;

/// Default start, on the recorder's clock.
pub const START: Stamp = Stamp::from_nanos(1_780_000_000_000_000_000);

/// Joint states.
pub const JOINT_STATES: &str = "/joint_states";
/// Pose stream.
pub const POSE: &str = "/tcp_pose_broadcaster/pose";
/// Moving transforms.
pub const TF: &str = "/tf";
/// Tool poses as bare numbers.
pub const NUMBERS: &str = "/tool_pose";
/// Static transforms.
pub const TF_STATIC: &str = "/tf_static";
/// IMU.
pub const IMU: &str = "/imu/data";
/// Target seen by a camera.
pub const TARGET: &str = "/camera/tag_pose";
/// Commanded poses.
pub const COMMANDED_POSE: &str = "/cartesian_controller/commanded_pose";
/// Commanded joints.
pub const COMMANDED_JOINTS: &str = "/joint_commands";
/// Goals.
pub const GOAL: &str = "/goal_pose";
/// The arm's URDF.
pub const ROBOT_DESCRIPTION: &str = "/robot_description";

const IMU_FRAME: &str = "imu_link";

/// One recorded run: arm, motion, streams, and faults; a new one has noise but no faults.
///
/// ```
/// # use poseaudit::synth::Scenario;
/// let mut run = Scenario::ur5e();
/// run.pose.timing.latency_s = 0.015;
/// run.joints.zero_offsets = vec![0.0, 0.0, 0.6_f64.to_radians()];
/// run.write_mcap(std::io::Cursor::new(Vec::new()), None)?;
/// # Ok::<(), poseaudit::synth::SynthError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Scenario {
    /// The arm.
    pub robot: Robot,
    /// Reference of the poses; z up.
    pub base: String,
    /// Logged link; carries the IMU.
    pub tip: String,
    /// Start, on the recorder's clock.
    pub start: Stamp,
    /// In s.
    pub duration_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Motion of the arm.
    pub motion: Motion,
    /// Centre of the motion, rad or m, from base to tip; beyond the list, mid-range.
    pub home: Vec<f64>,
    /// Maximum distance from home, rad; a quarter in m if prismatic.
    pub amplitude: f64,
    /// Maximum joint speed, rad/s; a quarter in m/s if prismatic.
    pub speed: f64,
    /// Extra rest at every fourth configuration, s.
    pub pause_s: f64,
    /// Final stop during a motion.
    pub final_stop: Option<FinalStop>,
    /// Oscillation of a joint.
    pub oscillation: Option<JointOscillation>,
    /// Joints with compliance.
    pub compliance: Vec<SynthCompliance>,
    /// Noise of the streams.
    pub noise: Noise,
    /// Joint states.
    pub joints: JointStream,
    /// Stream of tool poses.
    pub pose: PoseStream,
    /// Moving transforms.
    pub tf: TfStream,
    /// IMU at the tip.
    pub imu: ImuStream,
    /// Target seen by a camera.
    pub target: TargetStream,
    /// Commands; off at rate 0.
    pub reference: ReferenceStream,
    /// Leading hand; off at rate 0.
    pub leader: LeaderStream,
    /// Tracker of a marker on the tip; off at rate 0.
    pub tracker: TrackerStream,
    /// Namespace of all topics except transforms, such as `/left`.
    pub namespace: String,
    /// First link of joint states and transforms, if above `base`: a rail, lift or waist then moves the
    /// base. `home`, offsets and orders count from it. Not in the IMU's motion.
    pub root: Option<String>,
    /// Motion of the root; not in the IMU's motion.
    pub moving_base: Option<MovingBase>,
    /// Whether to log the URDF.
    pub has_description: bool,
    /// Actual arm, if not the nominal `robot`; same links and joints. Pose stream, target and IMU use it;
    /// /tf and description do not.
    pub actual_robot: Option<Robot>,
    /// Changes of the stream contents: times, s after the start, in order, and the scenario from then on.
    /// Motion, noise and stamps stay.
    pub changes: Vec<(f64, Scenario)>,
}

/// Stop during the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinalStop {
    /// When a joint is fastest within 3 s after this time, s after the start.
    pub after_s: f64,
    /// Deceleration of that joint, rad/s² or m/s².
    pub deceleration: f64,
}

/// Oscillation of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointOscillation {
    /// Joint, from the base.
    pub joint: usize,
    /// In rad or m.
    pub amplitude: f64,
    /// In Hz.
    pub frequency_hz: f64,
}

/// Why a log cannot be generated.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// There is no chain from base to tip.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The log cannot be written.
    #[error("cannot write the log")]
    Write(#[from] McapError),
}

/// Positions and velocities of all joints, rad and rad/s (m and m/s).
pub type JointRow = (Vec<f64>, Vec<f64>);

impl Scenario {
    /// 20 s of pick and place with all streams, without faults.
    pub fn new(robot: Robot, base: &str, tip: &str) -> Self {
        Self {
            robot,
            base: base.to_owned(),
            tip: tip.to_owned(),
            start: START,
            duration_s: 20.0,
            seed: 1,
            motion: Motion::PickAndPlace,
            home: Vec::new(),
            amplitude: 1.2,
            speed: 1.2,
            pause_s: 0.0,
            final_stop: None,
            oscillation: None,
            compliance: Vec::new(),
            noise: Noise::default(),
            joints: JointStream {
                timing: Timing::every(125.0, 0.0),
                has_velocity: true,
                velocity_latency_s: 0.0,
                velocity_scales: Vec::new(),
                zero_offsets: Vec::new(),
                scales: Vec::new(),
                is_in_degrees: false,
                number_order: None,
                wrapping: None,
                resolution: 0.0,
                separate_topic: None,
                frozen_s: None,
            },
            pose: PoseStream {
                timing: Timing::every(125.0, 0.0037),
                frame_id: base.to_owned(),
                reference_from_stream: Pose::identity(),
                tip_from_stream: Pose::identity(),
                tool_slip: None,
                radial_scale_error: 0.0,
                encoding: LoggedEncoding::Correct,
                is_inverted: false,
                is_in_millimetres: false,
                position_factor: 1.0,
                axes: None,
                constant_coordinate: None,
                unset_quaternion: None,
                quaternion_norm: 1.0,
                number_convention: None,
                has_numbers_in_degrees: false,
                outliers: Vec::new(),
                frozen_s: None,
            },
            tf: TfStream {
                timing: Timing::every(50.0, 0.0083),
                encoding: LoggedEncoding::Correct,
                has_static: true,
                second: None,
                others: Vec::new(),
            },
            imu: ImuStream {
                timing: Timing::every(200.0, 0.0011),
                tip_from_imu: pose(
                    [0.02, -0.01, 0.03],
                    rotation_from_rotvec(Vec3::new(0.1, -0.2, 0.4)),
                ),
                mount_error: Pose::identity(),
                has_orientation: true,
                world_yaw_rad: 0.6,
                yaw_drift_rad_s: 0.0,
                yaw_jumps: Vec::new(),
                yaw_walk_rad_per_sqrt_s: 0.0,
                gyro_bias_rad_s: Vec3::zeros(),
                gyro_from_rate: Matrix3::identity(),
                gyro_warm_up: None,
                yaw_warm_up: None,
                yaw_by_heading: [(0.0, 0.0); 2],
                gyro_factor: 1.0,
                force_factor: 1.0,
                encoding: LoggedEncoding::Correct,
            },
            target: TargetStream::disabled(),
            reference: ReferenceStream::disabled(base),
            leader: LeaderStream::disabled(),
            tracker: TrackerStream::disabled(),
            namespace: String::new(),
            root: None,
            moving_base: None,
            has_description: true,
            actual_robot: None,
            changes: Vec::new(),
        }
    }

    /// The catalogue's UR5e without faults, about a typical configuration.
    pub fn ur5e() -> Self {
        use std::f64::consts::FRAC_PI_2;
        let robot = catalogue::find("ur5e").expect("the catalogue has the ur5e").clone();
        let home = vec![0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
        Self { home, ..Self::new(robot, "base", "tool0") }
    }

    /// Writes an MCAP file with optional chunk compression, and flushes `out`.
    ///
    /// # Errors
    /// If there is no chain between `base` and `tip`, or `out` cannot be written.
    ///
    /// # Panics
    /// If `motion` or `oscillation` names a joint outside the chain, or `number_order` is no permutation.
    pub fn write_mcap(
        &self,
        out: impl Write + Seek,
        compression: Option<Compression>,
    ) -> Result<(), SynthError> {
        write_cell(std::slice::from_ref(self), out, compression)
    }

    /// True positions and velocities at times after the start, s.
    ///
    /// # Errors
    /// If there is no chain from `base` to `tip`.
    pub fn joints_at(&self, times_s: &[f64]) -> Result<Vec<JointRow>, SynthError> {
        let truth = Truth::new(self)?;
        Ok(times_s.iter().map(|&time_s| truth.joints(time_s)).collect())
    }

    fn scenario_at(&self, time_s: f64) -> &Scenario {
        let begun = self.changes.partition_point(|(from_s, _)| *from_s <= time_s);
        begun.checked_sub(1).map_or(self, |last| &self.changes[last].1)
    }

    fn name_of(&self, topic: Topic) -> String {
        let own = match (topic, &self.joints.separate_topic) {
            (Topic::Leader, _) => &self.leader.topic,
            (Topic::Tracker, _) => &self.tracker.topic,
            (Topic::SeparateJoints, Some((_, name))) => name,
            _ => topic.name(),
        };
        match topic {
            Topic::Tf | Topic::TfStatic => own.to_owned(),
            _ => format!("{}{own}", self.namespace),
        }
    }
}

/// Writes several arms as one MCAP file; topics and frames must be distinct.
///
/// # Errors
/// As [`Scenario::write_mcap`].
///
/// # Panics
/// As [`Scenario::write_mcap`].
pub fn write_cell(
    arms: &[Scenario],
    out: impl Write + Seek,
    compression: Option<Compression>,
) -> Result<(), SynthError> {
    let mut messages = Vec::new();
    for arm in arms {
        let truth = Truth::new(arm)?;
        let said = [
            streams::messages(arm, &truth),
            target::target_messages(arm, &truth),
            reference::command_messages(arm, &truth),
            structure::moving_base_messages(arm),
            structure::leader_messages(arm, &truth),
            tracker::tracker_messages(arm, &truth),
        ];
        let said = said.into_iter().flatten();
        messages.extend(said.map(|message| (arm.name_of(message.topic), message)));
    }
    // Stable: of simultaneous messages, the first arm's come first.
    messages.sort_by_key(|(_, message)| (message.received, message.topic));
    // Multithreaded compression would split the data differently on other machines.
    let options = WriteOptions::new()
        .profile("ros2")
        .library("poseaudit")
        .compression(compression)
        .compression_threads(0);
    let mut writer = options.create(out)?;
    let mut channels = BTreeMap::new();
    for (name, message) in messages {
        let header = match channels.entry(name) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let channel_id = add_channel(&mut writer, message.topic, new.key())?;
                new.insert(MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 })
            }
        };
        header.sequence += 1;
        header.log_time = message.received.nanos().cast_unsigned();
        header.publish_time = header.log_time;
        writer.write_to_known_channel(header, &message.cdr)?;
    }
    writer.finish()?;
    Ok(writer.into_inner().flush().map_err(McapError::from)?)
}

fn add_channel<W: Write + Seek>(
    writer: &mut mcap::Writer<W>,
    topic: Topic,
    name: &str,
) -> Result<u16, McapError> {
    let schema = writer.add_schema(topic.type_name(), "ros2msg", topic.definition().as_bytes())?;
    writer.add_channel(schema, name, "cdr", &BTreeMap::new())
}

/// The demo: 20 s of a UR5e. The tool pose's rotation vector is read as roll, pitch, yaw and 22 ms late;
/// the zero of shoulder_lift_joint is off by 0.5°; the IMU's yaw drifts by 3 °/min.
pub fn demo() -> Scenario {
    let mut run = Scenario::ur5e();
    run.pose.encoding = LoggedEncoding::Misinterpreted(Misinterpretation {
        is: Convention::RotVec,
        read_as: Convention::RPY,
    });
    run.pose.timing.latency_s = 0.022;
    run.joints.zero_offsets = vec![0.0, 0.5_f64.to_radians()];
    run.imu.yaw_drift_rad_s = 3.0_f64.to_radians() / 60.0;
    run
}

/// The pair of the demo: 30 s of a UR5e's pose and of a tracker's, without joint states, transforms and
/// description. The tracker is 24 ms late, and its marker slips by 5 mm after 18 s.
pub fn pair() -> Scenario {
    let mut run = Scenario { duration_s: 30.0, has_description: false, ..Scenario::ur5e() };
    run.joints.timing.rate_hz = 0.0;
    run.tf.timing.rate_hz = 0.0;
    run.tf.has_static = false;
    run.imu.timing.rate_hz = 0.0;
    run.tracker.timing.rate_hz = 100.0;
    run.tracker.timing.latency_s = 0.024;
    run.tracker.slip = Some(ToolSlip {
        from_s: 18.0,
        to_s: f64::INFINITY,
        tool_from_slipped: pose([0.003, 0.004, 0.0], Rotation::identity()),
    });
    run
}

#[cfg(test)]
mod tests;
