//! What each stream says of the truth, and when.

use rand::RngExt;

use super::messages::{self, LoggedImu, LoggedPose, LoggedTransform, Topic};
use super::noise::{Purpose, UnitNoise, random};
use super::reference::commands;
use super::target::sightings;
use super::truth::{GRAVITY, Truth};
use super::{Coding, IMU_FRAME, ImuStream, JointStream, Scenario, Timing, urdf_text};
use crate::geometry::{
    Pose, QuaternionSlip, Rotation, Vec3, pose, rotation_from_rotvec, xyz_of, xyzw_from_rotation,
};
use crate::robot::{Joint, JointKind, Robot};
use crate::time::Stamp;

/// One message of the log.
pub(super) struct Message {
    pub(super) topic: Topic,
    /// When the recorder has it.
    pub(super) received: Stamp,
    pub(super) cdr: Vec<u8>,
}

/// All messages of the log, in the order in which they are received.
pub(super) fn messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let mut messages = latched(scenario);
    messages.extend(joint_states(scenario, truth));
    messages.extend(poses(scenario, truth));
    messages.extend(transforms(scenario, truth));
    messages.extend(imu_samples(scenario, truth));
    messages.extend(sightings(scenario, truth));
    messages.extend(commands(scenario, truth));
    messages.sort_by_key(|message| (message.received, message.topic));
    messages
}

/// What is said once: the fixed transforms and the arm's description.
fn latched(scenario: &Scenario) -> Vec<Message> {
    let robot = &scenario.robot;
    let fixed = robot.joints().iter().filter(|joint| joint.kind == JointKind::Fixed);
    let mut transforms: Vec<LoggedTransform> = fixed
        .map(|joint| {
            logged_transform(robot, joint, Coding::Faithful.logged(&joint.parent_from_joint))
        })
        .collect();
    if scenario.imu.timing.rate_hz > 0.0 {
        transforms.push(LoggedTransform {
            parent: &scenario.tip,
            child: IMU_FRAME,
            parent_from_child: Coding::Faithful.logged(&scenario.imu.tip_from_imu),
        });
    }
    transforms.extend(scenario.target.frame(scenario));
    transforms.extend(scenario.tf.others.iter().map(|other| LoggedTransform {
        parent: &other.parent,
        child: &other.child,
        parent_from_child: Coding::Faithful.logged(&other.parent_from_child),
    }));
    let statics = scenario.tf.with_static.then(|| {
        let cdr = messages::tf_message(scenario.start, &transforms);
        Message { topic: Topic::TfStatic, received: scenario.start, cdr }
    });
    let description = scenario.description.then(|| {
        let cdr = messages::string(&urdf_text(robot));
        Message { topic: Topic::RobotDescription, received: scenario.start, cdr }
    });
    statics.into_iter().chain(description).collect()
}

fn joint_states(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.joints;
    let mut noise = scenario.unit_noise(Purpose::JointNoise, truth.chain.dof());
    let ticks = scenario.ticks(&stream.timing, Purpose::JointTransport);
    ticks
        .map(|tick| {
            let (mut positions, mut velocities) = truth.joints(tick.time_s);
            add_noise(&mut positions, noise.next(), scenario.noise.joints);
            let positions = stream.reported_positions(&positions);
            if !stream.with_velocity {
                velocities.clear();
            }
            let velocities = stream.reported(&velocities);
            let names = truth.chain.joint_names();
            let cdr = messages::joint_state(tick.stamp, names, &positions, &velocities);
            tick.message(Topic::JointStates, cdr)
        })
        .collect()
}

fn poses(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.pose;
    let stream_from_reference = stream.reference_from_stream.inverse();
    let mut noise = scenario.unit_noise(Purpose::PoseNoise, 6);
    let ticks = scenario.ticks(&stream.timing, Purpose::PoseTransport);
    let mut stuck: Option<Pose> = None;
    ticks
        .enumerate()
        .map(|(sample, tick)| {
            let base_from_tip = truth.base_from_tip(tick.time_s);
            let mut pose = stream_from_reference * base_from_tip * stream.tip_from_stream;
            let noise = noise.next();
            pose.translation.vector *= 1.0 + stream.growth;
            pose.translation.vector += scenario.noise.pose_m * Vec3::from_column_slice(&noise[..3]);
            pose.rotation *= small_rotation(&noise[3..], scenario.noise.pose_rad);
            for (_, by) in stream.strays.iter().filter(|(stray, _)| *stray == sample) {
                pose.translation.vector += by;
            }
            if stream.stuck_s.is_some_and(|(from, to)| (from..to).contains(&tick.time_s)) {
                pose = *stuck.get_or_insert(pose);
            }
            if stream.inverted {
                pose = pose.inverse();
            }
            let mut logged = stream.coding.logged(&pose);
            if stream.in_millimetres {
                logged.xyz = logged.xyz.map(|metres| 1000.0 * metres);
            }
            if let Some(convention) = stream.as_numbers {
                let [a, b, c] = convention.numbers(&pose.rotation);
                let [x, y, z] = logged.xyz;
                return tick.message(Topic::Numbers, messages::numbers(&[x, y, z, a, b, c]));
            }
            logged.xyzw = logged.xyzw.map(|component| stream.quaternion_norm * component);
            let cdr = messages::pose_stamped(tick.stamp, &stream.frame_id, logged);
            tick.message(Topic::Pose, cdr)
        })
        .collect()
}

fn transforms(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let robot = &scenario.robot;
    let names = truth.chain.joint_names().iter();
    let joints: Vec<&Joint> =
        names.map(|name| robot.joint(name).expect("a chain's joints are its robot's")).collect();
    let mut noise = scenario.unit_noise(Purpose::TfNoise, joints.len());
    let ticks = scenario.ticks(&scenario.tf.timing, Purpose::TfTransport);
    ticks
        .map(|tick| {
            let (mut positions, _) = truth.joints(tick.time_s);
            add_noise(&mut positions, noise.next(), scenario.noise.joints);
            let believed = scenario.joints.reported_positions(&positions);
            let transforms: Vec<LoggedTransform> = joints
                .iter()
                .zip(believed)
                .map(|(joint, position)| {
                    let parent_from_child = joint.parent_from_joint * motion(joint, position);
                    logged_transform(robot, joint, scenario.tf.coding.logged(&parent_from_child))
                })
                .collect();
            tick.message(Topic::Tf, messages::tf_message(tick.stamp, &transforms))
        })
        .collect()
}

fn imu_samples(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.imu;
    let tip_from_imu = stream.tip_from_imu * stream.mount_error;
    let mut noise = scenario.unit_noise(Purpose::ImuNoise, 9);
    let mut walk = UnitNoise::new(random(scenario.seed, Purpose::ImuWalk), 1, 0.0);
    let step_rad = stream.yaw_walk_rad_rt_s / stream.timing.rate_hz.sqrt();
    let mut wandered_rad = 0.0;
    let ticks = scenario.ticks(&stream.timing, Purpose::ImuTransport);
    ticks
        .map(|tick| {
            let noise = noise.next();
            wandered_rad += step_rad * walk.next()[0];
            let scaled =
                |at: usize, sigma: f64| sigma * Vec3::from_column_slice(&noise[at..at + 3]);
            let base_from_imu = (truth.base_from_tip(tick.time_s) * tip_from_imu).rotation;
            let imu_from_base = base_from_imu.inverse();
            let acceleration = truth.acceleration(tick.time_s, &tip_from_imu);
            let yaw_rad = stream.yaw_rad(tick.time_s) + wandered_rad;
            let world_from_base = rotation_from_rotvec(Vec3::z() * yaw_rad);
            let world_from_imu = world_from_base
                * base_from_imu
                * small_rotation(&noise[..3], scenario.noise.imu_rad);
            let orientation = stream.coding.logged(&pose([0.0; 3], world_from_imu));
            let sample = LoggedImu {
                orientation_xyzw: stream.with_orientation.then_some(orientation.xyzw),
                gyro: stream.gyro_from_rate * (imu_from_base * truth.angular_velocity(tick.time_s))
                    + stream.gyro_bias_rad_s
                    + scaled(3, scenario.noise.gyro_rad_s),
                specific_force: imu_from_base * (acceleration + GRAVITY * Vec3::z())
                    + scaled(6, scenario.noise.accel_m_s2),
            };
            tick.message(Topic::Imu, messages::imu(tick.stamp, IMU_FRAME, &sample))
        })
        .collect()
}

/// One moment of a stream.
pub(super) struct Tick {
    /// When its content is true, s after the start.
    pub(super) time_s: f64,
    /// What its header says.
    pub(super) stamp: Stamp,
    received: Stamp,
}

impl Tick {
    pub(super) fn message(&self, topic: Topic, cdr: Vec<u8>) -> Message {
        Message { topic, received: self.received, cdr }
    }
}

impl Scenario {
    /// The moments of a stream; messages are received 0.1 to 2 ms after their content was true, and
    /// none before the one sent ahead of it.
    pub(super) fn ticks(&self, timing: &Timing, transport: Purpose) -> impl Iterator<Item = Tick> {
        const TRANSPORT_S: std::ops::Range<f64> = 0.1e-3..2e-3;
        let mut random = random(self.seed, transport);
        let Timing { rate_hz, phase_s, .. } = *timing;
        let count = ((self.duration_s - phase_s) * rate_hz).ceil().max(0.0) as usize;
        let start = self.start;
        let mut received = start;
        (0..count).map(move |index| {
            let time_s = phase_s + index as f64 / rate_hz;
            received = received.max(start.shifted(time_s + random.random_range(TRANSPORT_S)));
            Tick { time_s, stamp: timing.stamp(start, time_s, self.duration_s / 2.0), received }
        })
    }

    /// A single moment of a stream, received 1 ms later.
    pub(super) fn moment(&self, timing: &Timing, time_s: f64) -> Tick {
        const TRANSPORT_S: f64 = 1e-3;
        let stamp = timing.stamp(self.start, time_s, self.duration_s / 2.0);
        Tick { time_s, stamp, received: self.start.shifted(time_s + TRANSPORT_S) }
    }

    pub(super) fn unit_noise(&self, purpose: Purpose, components: usize) -> UnitNoise {
        UnitNoise::new(random(self.seed, purpose), components, self.noise.correlation)
    }
}

impl Timing {
    /// The stamp of what is true `time_s` after `start`: the solution of
    /// `time = stamp − latency − skew · (stamp − middle)`.
    fn stamp(&self, start: Stamp, time_s: f64, middle_s: f64) -> Stamp {
        if !self.stamped {
            return Stamp::default();
        }
        let stamp_s = (time_s + self.latency_s - self.skew * middle_s) / (1.0 - self.skew);
        start.shifted(self.clock_offset_s).shifted(stamp_s)
    }
}

impl JointStream {
    /// The numbers that are logged for true `positions`.
    fn reported_positions(&self, positions: &[f64]) -> Vec<f64> {
        let offsets = self.zero_offsets.iter().copied().chain(std::iter::repeat(0.0));
        let zeroed: Vec<f64> =
            positions.iter().zip(offsets).map(|(q, offset)| q - offset).collect();
        self.reported(&zeroed)
    }

    /// The same numbers in the order and unit of the log.
    fn reported(&self, numbers: &[f64]) -> Vec<f64> {
        let unit = if self.in_degrees { 1_f64.to_degrees() } else { 1.0 };
        let in_unit = |at: usize| unit * self.scales.get(at).unwrap_or(&1.0) * numbers[at];
        match &self.number_order {
            Some(order) if !numbers.is_empty() => {
                assert_eq!(order.len(), numbers.len(), "an order of all joints");
                order.iter().map(|&at| in_unit(at)).collect()
            }
            _ => (0..numbers.len()).map(in_unit).collect(),
        }
    }
}

impl ImuStream {
    /// Yaw of the base in the IMU's world as logged, without its random walk.
    fn yaw_rad(&self, time_s: f64) -> f64 {
        let jumped = self.yaw_jumps.iter().filter(|(at_s, _)| time_s > *at_s);
        self.world_yaw_rad
            + self.yaw_drift_rad_s * time_s
            + jumped.map(|(_, size_rad)| size_rad).sum::<f64>()
    }
}

impl Coding {
    /// The numbers that are logged for `pose`.
    pub(super) fn logged(self, pose: &Pose) -> LoggedPose {
        let (pose, xyzw) = match self {
            Self::Faithful => (*pose, xyzw_from_rotation(&pose.rotation)),
            Self::Misread(reading) => {
                let misread = reading.read_as.rotation(reading.is.numbers(&pose.rotation));
                (*pose, xyzw_from_rotation(&misread))
            }
            Self::Slipped(slip) => {
                // What undoes one slip is what makes the other.
                let other = match slip {
                    QuaternionSlip::WxyzReadAsXyzw => QuaternionSlip::XyzwReadAsWxyz,
                    QuaternionSlip::XyzwReadAsWxyz => QuaternionSlip::WxyzReadAsXyzw,
                };
                (*pose, other.truth(xyzw_from_rotation(&pose.rotation)))
            }
            Self::Transposed => (*pose, xyzw_from_rotation(&pose.rotation.inverse())),
            Self::Inverted => {
                let inverse = pose.inverse();
                (inverse, xyzw_from_rotation(&inverse.rotation))
            }
        };
        LoggedPose { xyz: xyz_of(&pose), xyzw }
    }
}

fn logged_transform<'a>(
    robot: &'a Robot,
    joint: &Joint,
    parent_from_child: LoggedPose,
) -> LoggedTransform<'a> {
    LoggedTransform {
        parent: robot.link_name(joint.parent),
        child: robot.link_name(joint.child),
        parent_from_child,
    }
}

/// What a joint does at `position`, rad or m.
fn motion(joint: &Joint, position: f64) -> Pose {
    let along = joint.axis * position;
    match joint.kind {
        JointKind::Prismatic => pose(along.into(), Rotation::identity()),
        _ => pose([0.0; 3], rotation_from_rotvec(along)),
    }
}

fn add_noise(values: &mut [f64], unit_noise: &[f64], sigma: f64) {
    for (value, noise) in values.iter_mut().zip(unit_noise) {
        *value += sigma * noise;
    }
}

pub(super) fn small_rotation(unit_noise: &[f64], sigma_rad: f64) -> Rotation {
    rotation_from_rotvec(sigma_rad * Vec3::from_column_slice(unit_noise))
}
