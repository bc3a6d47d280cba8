//! Generates the logs of the demo and the tests: an arm in motion, its streams, and injected faults.
//!
//! A [`Scenario`] defines the motion, the recorded streams and the faults; [`Scenario::write_mcap`] writes
//! the log as a ROS 2 recorder would. Faults use the signs and names of the audit's reports, so a finding
//! can be compared with the field that injected it. This module contains no estimators.
//!
//! The output is deterministic. Motion and streams have separate random sequences, so a fault in one stream
//! does not change the rest of the log.

mod cdr;
mod gives;
mod messages;
mod motion;
mod noise;
mod path;
mod recorded;
mod reference;
mod streams;
mod structure;
mod target;
mod task;
mod truth;
mod urdf;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use nalgebra::Matrix3;

use crate::geometry::{Convention, Misinterpretation, Pose, Vec3, pose, rotation_from_rotvec};
use crate::robot::{ChainError, Robot, catalogue};
use crate::time::Stamp;

pub use gives::{Gives, Giving};
use messages::Topic;
pub use motion::Motion;
pub use noise::Noise;
pub use path::Lines;
pub use recorded::{Coding, ImuStream, JointStream, OtherTransform, PoseStream, TfStream, Timing};
pub use reference::{Commands, ReferenceStream};
pub use structure::{Drive, Fold, LeaderStream, SecondPublisher, ToolSlip, write_cell};
pub use target::{Camera, Swapped, TargetStream};
pub use task::Task;
use truth::Truth;
pub use urdf::urdf_text;

/// Default start of a run, on the recorder's clock.
pub const START: Stamp = Stamp::from_nanos(1_780_000_000_000_000_000);

/// Topic of the joint states.
pub const JOINT_STATES: &str = "/joint_states";
/// Topic of the pose stream.
pub const POSE: &str = "/tcp_pose_broadcaster/pose";
/// Topic of the moving transforms.
pub const TF: &str = "/tf";
/// Topic of tool poses as bare numbers.
pub const NUMBERS: &str = "/tool_pose";
/// Topic of the static transforms.
pub const TF_STATIC: &str = "/tf_static";
/// Topic of the IMU.
pub const IMU: &str = "/imu/data";
/// Topic of the target seen by a camera.
pub const TARGET: &str = "/camera/tag_pose";
/// Topic of commanded poses.
pub const COMMANDED_POSE: &str = "/cartesian_controller/commanded_pose";
/// Topic of commanded joints.
pub const COMMANDED_JOINTS: &str = "/joint_commands";
/// Topic of goals.
pub const GOAL: &str = "/goal_pose";
/// Topic of the arm's URDF.
pub const ROBOT_DESCRIPTION: &str = "/robot_description";

/// Frame of the IMU.
const IMU_FRAME: &str = "imu_link";

/// One recorded run: arm, motion, logged streams, and faults.
///
/// A new scenario has noise but no faults. Each fault is a field of the stream that shows it.
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
    /// Reference link of the poses; its z axis points up.
    pub base: String,
    /// Link whose pose is logged; it carries the IMU.
    pub tip: String,
    /// Start time on the recorder's clock.
    pub start: Stamp,
    /// Length of the run, s.
    pub duration_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Motion of the arm.
    pub motion: Motion,
    /// Centre of the motion, rad or m, one value per joint from base to tip. Joints beyond the end of the
    /// list use the middle of their range.
    pub home: Vec<f64>,
    /// Maximum distance of a joint from home, rad; a quarter in m for a prismatic joint.
    pub amplitude: f64,
    /// Maximum speed of a joint, rad/s; a quarter in m/s for a prismatic joint.
    pub speed: f64,
    /// Additional rest at every fourth configuration, s.
    pub pause_s: f64,
    /// Final stop during a motion, if any.
    pub stop: Option<Stop>,
    /// Oscillation of a joint, if any.
    pub shake: Option<Shake>,
    /// Joints with compliance.
    pub gives: Vec<Gives>,
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
    /// Target seen by a camera; disabled unless [`Scenario::watch`] is called.
    pub target: TargetStream,
    /// Commands; disabled unless the rate is set.
    pub reference: ReferenceStream,
    /// Hand that leads the arm; disabled unless the rate is set.
    pub leader: LeaderStream,
    /// Prefix of all topics except transforms, such as `/left`.
    pub namespace: String,
    /// First link of the joint states and transforms, if it is above `base`: a rail, a lift or a waist then
    /// moves the base. `home`, offsets and orders count joints from it. Not included in the IMU's motion.
    pub root: Option<String>,
    /// Motion of the robot's root. Not included in the IMU's motion.
    pub drive: Option<Drive>,
    /// Whether the log contains the arm's URDF.
    pub description: bool,
    /// Actual arm, if it differs from the nominal model `robot`; with the same links and joints. The pose
    /// stream, the target and the IMU use it; /tf and the description use the nominal model.
    pub built: Option<Robot>,
    /// Changes within the run: times, s after the start, in order, and the scenario of the stream contents
    /// from then on. Motion, noise and stamps do not change.
    pub later: Vec<(f64, Scenario)>,
}

/// Stop during the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// The stop occurs when a joint is fastest within 3 s after this time, s after the start.
    pub after_s: f64,
    /// Deceleration of that joint, rad/s², or m/s² for a prismatic joint.
    pub deceleration: f64,
}

/// Oscillation of a joint in addition to its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shake {
    /// Index of the joint, from the base.
    pub joint: usize,
    /// Amplitude, rad or m.
    pub amplitude: f64,
    /// Frequency, Hz.
    pub frequency_hz: f64,
}

/// Error in the generation of a log.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// There is no chain from base to tip.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The log cannot be written.
    #[error("cannot write the log")]
    Write(#[from] McapError),
}

/// Positions and velocities of all joints at one time, rad and rad/s (m and m/s for prismatic joints).
pub type JointRow = (Vec<f64>, Vec<f64>);

impl Scenario {
    /// Run of `robot` without faults: 20 s of pick and place with all streams.
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
            stop: None,
            shake: None,
            gives: Vec::new(),
            noise: Noise::default(),
            joints: JointStream {
                timing: Timing::every(125.0, 0.0),
                with_velocity: true,
                velocity_late_s: 0.0,
                velocity_scales: Vec::new(),
                zero_offsets: Vec::new(),
                scales: Vec::new(),
                in_degrees: false,
                number_order: None,
                fold: None,
                quantum: 0.0,
                apart: None,
                stuck_s: None,
            },
            pose: PoseStream {
                timing: Timing::every(125.0, 0.0037),
                frame_id: base.to_owned(),
                reference_from_stream: Pose::identity(),
                tip_from_stream: Pose::identity(),
                slip: None,
                growth: 0.0,
                coding: Coding::Faithful,
                inverted: false,
                in_millimetres: false,
                times: 1.0,
                axes: None,
                constant: None,
                unset: None,
                quaternion_norm: 1.0,
                as_numbers: None,
                numbers_in_degrees: false,
                strays: Vec::new(),
                stuck_s: None,
            },
            tf: TfStream {
                timing: Timing::every(50.0, 0.0083),
                coding: Coding::Faithful,
                with_static: true,
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
                with_orientation: true,
                world_yaw_rad: 0.6,
                yaw_drift_rad_s: 0.0,
                yaw_jumps: Vec::new(),
                yaw_walk_rad_rt_s: 0.0,
                gyro_bias_rad_s: Vec3::zeros(),
                gyro_from_rate: Matrix3::identity(),
                gyro_warms_up: None,
                yaw_warms_up: None,
                yaw_by_heading: [(0.0, 0.0); 2],
                gyro_times: 1.0,
                force_times: 1.0,
                coding: Coding::Faithful,
            },
            target: TargetStream::none(),
            reference: ReferenceStream::none(base),
            leader: LeaderStream::none(),
            namespace: String::new(),
            root: None,
            drive: None,
            description: true,
            built: None,
            later: Vec::new(),
        }
    }

    /// Run of the catalogue's UR5e without faults, about a typical configuration.
    pub fn ur5e() -> Self {
        use std::f64::consts::FRAC_PI_2;
        let robot = catalogue::find("ur5e").expect("the catalogue has the ur5e").clone();
        let home = vec![0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
        Self { home, ..Self::new(robot, "base", "tool0") }
    }

    /// Writes the run as an MCAP file with optional chunk compression, and flushes `out`.
    ///
    /// # Errors
    /// If there is no chain between `base` and `tip`, or `out` cannot be written.
    ///
    /// # Panics
    /// If `motion` or `shake` refers to a joint that is not in the chain, or `number_order` is not a
    /// permutation of its joints.
    pub fn write_mcap(
        &self,
        out: impl Write + Seek,
        compression: Option<Compression>,
    ) -> Result<(), SynthError> {
        write(std::slice::from_ref(self), out, compression)
    }

    /// True positions and velocities of the joints at times after the start, s.
    ///
    /// # Errors
    /// If there is no chain from `base` to `tip`.
    pub fn joints_at(&self, times_s: &[f64]) -> Result<Vec<JointRow>, SynthError> {
        let truth = Truth::new(self)?;
        Ok(times_s.iter().map(|&time_s| truth.joints(time_s)).collect())
    }

    /// Scenario in effect `time_s` after the start.
    fn at(&self, time_s: f64) -> &Scenario {
        let begun = self.later.partition_point(|(from_s, _)| *from_s <= time_s);
        begun.checked_sub(1).map_or(self, |last| &self.later[last].1)
    }

    /// Name of a topic in the log.
    fn name_of(&self, topic: Topic) -> String {
        let own = match (topic, &self.joints.apart) {
            (Topic::Leader, _) => &self.leader.topic,
            (Topic::JointsApart, Some((_, name))) => name,
            _ => topic.name(),
        };
        match topic {
            Topic::Tf | Topic::TfStatic => own.to_owned(),
            _ => format!("{}{own}", self.namespace),
        }
    }
}

/// Writes the runs of several arms as one file.
fn write(
    arms: &[Scenario],
    out: impl Write + Seek,
    compression: Option<Compression>,
) -> Result<(), SynthError> {
    let mut messages = Vec::new();
    for arm in arms {
        let truth = Truth::new(arm)?;
        let said = [
            streams::messages(arm, &truth),
            target::sightings(arm, &truth),
            reference::commands(arm, &truth),
            structure::driving(arm),
            structure::hand(arm, &truth),
        ];
        let said = said.into_iter().flatten();
        messages.extend(said.map(|message| (arm.name_of(message.topic), message)));
    }
    // The sort is stable: for simultaneous messages, the first arm comes first.
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

/// Run of the demo: 20 s of a UR5e with four faults.
///
/// The tool pose's rotation vector was interpreted as roll, pitch and yaw; the tool pose is 22 ms late; the
/// zero of shoulder_lift_joint is off by 0.5°; the IMU's yaw drifts by 3 °/min.
pub fn demo() -> Scenario {
    let mut run = Scenario::ur5e();
    run.pose.coding =
        Coding::Misread(Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY });
    run.pose.timing.latency_s = 0.022;
    run.joints.zero_offsets = vec![0.0, 0.5_f64.to_radians()];
    run.imu.yaw_drift_rad_s = 3.0_f64.to_radians() / 60.0;
    run
}

#[cfg(test)]
mod tests;
