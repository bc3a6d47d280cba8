//! Makes the logs of the demo and the tests: an arm in motion, its streams, and planted faults.
//!
//! A [`Scenario`] says what moves, what is recorded and what is wrong; [`Scenario::write_mcap`]
//! writes the log as a ROS 2 recorder would. Faults are planted in the signs and names in which the
//! audit reports them, so a finding can be compared with the field that planted it. Nothing here
//! estimates anything.
//!
//! The same scenario gives the same bytes. Motion and streams draw from random numbers of their
//! own: a fault planted in one stream leaves the rest of the log as it was.

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

use crate::geometry::{Convention, Misreading, Pose, Vec3, pose, rotation_from_rotvec};
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

/// When a run starts unless its scenario says otherwise, on the recorder's clock.
pub const START: Stamp = Stamp::from_nanos(1_780_000_000_000_000_000);

/// The topic of the joint states.
pub const JOINT_STATES: &str = "/joint_states";
/// The topic of the pose stream.
pub const POSE: &str = "/tcp_pose_broadcaster/pose";
/// The topic of the transforms that move.
pub const TF: &str = "/tf";
/// The topic of tool poses as bare numbers.
pub const NUMBERS: &str = "/tool_pose";
/// The topic of the transforms that do not.
pub const TF_STATIC: &str = "/tf_static";
/// The topic of the IMU.
pub const IMU: &str = "/imu/data";
/// The topic of the target that a camera sees.
pub const TARGET: &str = "/camera/tag_pose";
/// The topic of commanded poses that the arm follows.
pub const COMMANDED_POSE: &str = "/cartesian_controller/commanded_pose";
/// The topic of commanded joints that the arm follows.
pub const COMMANDED_JOINTS: &str = "/joint_commands";
/// The topic of goals.
pub const GOAL: &str = "/goal_pose";
/// The topic of the arm's URDF.
pub const ROBOT_DESCRIPTION: &str = "/robot_description";

/// The frame of the IMU.
const IMU_FRAME: &str = "imu_link";

/// One recorded run: an arm, how it moves, what is logged, and what is wrong with it.
///
/// A new scenario has noise and no fault; each fault is a field of the stream that shows it.
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
    /// The link that poses are in; its z axis points up.
    pub base: String,
    /// The link whose pose is logged, and which carries the IMU.
    pub tip: String,
    /// When it starts, on the recorder's clock.
    pub start: Stamp,
    /// Length of the run, s.
    pub duration_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// How the arm moves.
    pub motion: Motion,
    /// Where the motion stays near, rad or m, one a joint from base to tip; joints beyond its end
    /// are in the middle of their range.
    pub home: Vec<f64>,
    /// The largest distance of a joint from home, rad; a quarter of it in m where the joint slides.
    pub amplitude: f64,
    /// The largest speed of a joint, rad/s; a quarter of it in m/s where the joint slides.
    pub speed: f64,
    /// How much longer than usual the arm rests at every fourth of its postures, s.
    pub pause_s: f64,
    /// When the arm is stopped on its way, not to move again, and how hard.
    pub stop: Option<Stop>,
    /// What shakes, and how.
    pub shake: Option<Shake>,
    /// The joints whose links are not where their encoders say.
    pub gives: Vec<Gives>,
    /// The noise of the streams.
    pub noise: Noise,
    /// The joint states.
    pub joints: JointStream,
    /// The stream of tool poses.
    pub pose: PoseStream,
    /// The transforms that move.
    pub tf: TfStream,
    /// The IMU at the tip.
    pub imu: ImuStream,
    /// The target that a camera sees; there is none unless [`Scenario::watch`] is called.
    pub target: TargetStream,
    /// What the arm is told; nothing unless its rate is set.
    pub reference: ReferenceStream,
    /// The hand that the arm follows; none unless its rate is set.
    pub leader: LeaderStream,
    /// What the names of all topics but those of transforms begin with, such as `/left`.
    pub namespace: String,
    /// The link that the joint states and the transforms begin at, where that is above `base`: a rail, a
    /// lift or a waist moves the base. `home`, offsets and orders count joints from it. The IMU knows
    /// nothing of it.
    pub root: Option<String>,
    /// How the robot's root drives about. The IMU knows nothing of it.
    pub drive: Option<Drive>,
    /// Whether the arm's URDF is in the log.
    pub description: bool,
    /// The arm as it was built, where that is not `robot`, its drawing: the same links and joints. The pose
    /// stream, the target and the IMU know it; /tf and the description are of the drawing.
    pub built: Option<Robot>,
    /// What is other from some moments on, s after the start, in their order: what streams say is then as of
    /// this run. Motion, noise and stamps stay those of the first.
    pub later: Vec<(f64, Scenario)>,
}

/// A stop amid the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// It comes when a joint is fastest within 3 s after this time, s after the start.
    pub after_s: f64,
    /// How fast that joint comes to rest, rad/s², or m/s² where it slides.
    pub deceleration: f64,
}

/// A joint that shakes beside its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shake {
    /// The joint, counted from the base.
    pub joint: usize,
    /// The amplitude, rad or m.
    pub amplitude: f64,
    /// The frequency, Hz.
    pub frequency_hz: f64,
}

/// Why a log could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// There is no chain from the scenario's base to its tip.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The log could not be written.
    #[error("cannot write the log")]
    Write(#[from] McapError),
}

/// Positions and velocities of all joints at one time, rad and rad/s (m and m/s if a joint slides).
pub type JointRow = (Vec<f64>, Vec<f64>);

impl Scenario {
    /// A run of `robot` without faults: 20 s of pick and place, all streams on.
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

    /// A run of the catalogue's UR5e without faults, about the posture that it is parked in.
    pub fn ur5e() -> Self {
        use std::f64::consts::FRAC_PI_2;
        let robot = catalogue::find("ur5e").expect("the catalogue has the ur5e").clone();
        let home = vec![0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0];
        Self { home, ..Self::new(robot, "base", "tool0") }
    }

    /// Writes the run as an MCAP file, its chunks compressed or not; `out` is flushed.
    ///
    /// # Errors
    /// Where `base` and `tip` are no two links with a chain between them, or `out` cannot be
    /// written.
    ///
    /// # Panics
    /// Where `motion` or `shake` names a joint that the chain does not have, or `number_order` is no order of
    /// its joints.
    pub fn write_mcap(
        &self,
        out: impl Write + Seek,
        compression: Option<Compression>,
    ) -> Result<(), SynthError> {
        write(std::slice::from_ref(self), out, compression)
    }

    /// Positions and velocities of the joints, where their links are, at times after the start, s.
    ///
    /// # Errors
    /// If there is no chain from `base` to `tip`.
    pub fn joints_at(&self, times_s: &[f64]) -> Result<Vec<JointRow>, SynthError> {
        let truth = Truth::new(self)?;
        Ok(times_s.iter().map(|&time_s| truth.joints(time_s)).collect())
    }

    /// The run that says what streams are `time_s` after the start.
    fn at(&self, time_s: f64) -> &Scenario {
        let begun = self.later.partition_point(|(from_s, _)| *from_s <= time_s);
        begun.checked_sub(1).map_or(self, |last| &self.later[last].1)
    }

    /// The name of a topic in the log.
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

/// Writes the runs of some arms as one file.
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
    // Of several arms at one moment, the first one's come first.
    messages.sort_by_key(|(_, message)| (message.received, message.topic));
    // Compressing on other threads would cut the data elsewhere on other machines.
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

/// The demo's run: 20 s of a UR5e with four faults at once.
///
/// The tool pose's rotation vector was read as roll, pitch and yaw; the tool pose is 22 ms late; the
/// zero of shoulder_lift_joint is off by 0.5°; the IMU's yaw drifts by 3 °/min.
pub fn demo() -> Scenario {
    let mut run = Scenario::ur5e();
    run.pose.coding =
        Coding::Misread(Misreading { is: Convention::RotVec, read_as: Convention::RPY });
    run.pose.timing.latency_s = 0.022;
    run.joints.zero_offsets = vec![0.0, 0.5_f64.to_radians()];
    run.imu.yaw_drift_rad_s = 3.0_f64.to_radians() / 60.0;
    run
}

#[cfg(test)]
mod tests;
