//! Messages of each stream, from the true motion.

use rand::RngExt;

use super::messages::{self, LoggedImu, LoggedPose, LoggedTransform, Topic};
use super::noise::{Noise, Purpose, UnitNoise, add_noise, add_pose_noise, random, small_rotation};
use super::truth::{GRAVITY_M_S2, Truth};
use super::{
    IMU_FRAME, ImuStream, JointStream, LoggedEncoding, PoseStream, Scenario, Timing, urdf_text,
};
use crate::geometry::{
    Pose, QuaternionOrderError, Rotation, Vec3, pose, rotation_from_matrix_rows,
    rotation_from_rotvec, xyz_of, xyzw_from_rotation,
};
use crate::robot::{Joint, JointKind, Robot};
use crate::time::Stamp;

pub(super) struct Message {
    pub(super) topic: Topic,
    /// Receive time.
    pub(super) received: Stamp,
    pub(super) cdr: Vec<u8>,
}

pub(super) fn messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let mut messages = static_messages(scenario);
    messages.extend(joint_state_messages(scenario, truth));
    messages.extend(pose_messages(scenario, truth));
    messages.extend(transform_messages(scenario, truth));
    messages.extend(imu_messages(scenario, truth));
    messages
}

fn static_messages(scenario: &Scenario) -> Vec<Message> {
    let robot = &scenario.robot;
    let fixed = robot.joints().iter().filter(|joint| joint.kind == JointKind::Fixed);
    let mut transforms: Vec<LoggedTransform> = fixed
        .map(|joint| {
            logged_transform(robot, joint, LoggedEncoding::Correct.encode(&joint.parent_from_joint))
        })
        .collect();
    if scenario.imu.timing.rate_hz > 0.0 {
        transforms.push(LoggedTransform {
            parent: &scenario.tip,
            child: IMU_FRAME,
            parent_from_child: LoggedEncoding::Correct.encode(&scenario.imu.tip_from_imu),
        });
    }
    transforms.extend(scenario.target.frame(scenario));
    transforms.extend(scenario.tf.others.iter().map(|other| LoggedTransform {
        parent: &other.parent,
        child: &other.child,
        parent_from_child: LoggedEncoding::Correct.encode(&other.parent_from_child),
    }));
    let statics = scenario.tf.has_static.then(|| {
        let cdr = messages::tf_message(scenario.start, &transforms);
        Message { topic: Topic::TfStatic, received: scenario.start, cdr }
    });
    let description = scenario.has_description.then(|| {
        let cdr = messages::string(&urdf_text(robot));
        Message { topic: Topic::RobotDescription, received: scenario.start, cdr }
    });
    statics.into_iter().chain(description).collect()
}

fn joint_state_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.joints;
    let mut noise = scenario.unit_noise(Purpose::JointNoise, truth.chain.dof());
    let kinds = truth.chain.joint_kinds();
    let ticks = scenario.ticks(&stream.timing, Purpose::JointTransport);
    let (mut last, mut frozen) = (None, None);
    let mut messages = Vec::new();
    for tick in ticks {
        let stream = &scenario.scenario_at(tick.time_s).joints;
        let fresh = {
            let (mut positions, _) = truth.encoder_joints(tick.time_s);
            let (_, velocities) = truth.encoder_joints(tick.time_s - stream.velocity_latency_s);
            add_noise(&mut positions, noise.next(), scenario.noise.joints);
            (stream.reported_positions(&positions, kinds), stream.reported_velocities(&velocities))
        };
        let mut said = if tick.is_new { fresh } else { last.unwrap_or(fresh) };
        if stream.frozen_s.is_some_and(|(from, to)| (from..to).contains(&tick.time_s)) {
            said = frozen.get_or_insert(said).clone();
        }
        last = Some(said.clone());
        let names = truth.chain.joint_names();
        let of = |wanted: &dyn Fn(&usize) -> bool, topic: Topic| {
            let some: Vec<usize> = (0..names.len()).filter(wanted).collect();
            let pick = |all: &[f64]| -> Vec<f64> {
                some.iter().filter_map(|&at| all.get(at).copied()).collect()
            };
            let names: Vec<String> = some.iter().map(|&at| names[at].clone()).collect();
            let cdr = messages::joint_state(tick.stamp, &names, &pick(&said.0), &pick(&said.1));
            tick.message(topic, cdr)
        };
        match &stream.separate_topic {
            Some((apart, _)) => {
                messages.push(of(&|at| !apart.contains(at), Topic::JointStates));
                messages.push(of(&|at| apart.contains(at), Topic::SeparateJoints));
            }
            None => messages.push(of(&|_| true, Topic::JointStates)),
        }
    }
    messages
}

fn pose_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let timing = &scenario.pose.timing;
    let drive =
        scenario.moving_base.as_ref().filter(|drive| drive.frame_id == scenario.pose.frame_id);
    let mut noise = scenario.unit_noise(Purpose::PoseNoise, 6);
    let mut walk = UnitNoise::new(random(scenario.seed, Purpose::PoseWalk), 6, 0.0);
    let mut drifted = [0.0; 6];
    let ticks = scenario.ticks(timing, Purpose::PoseTransport);
    let (mut frozen, mut last): (Option<Pose>, Option<Pose>) = (None, None);
    ticks
        .enumerate()
        .map(|(sample, tick)| {
            let reference_from_tip = match drive {
                Some(drive) => drive.pose_at(tick.time_s) * truth.first_from_tip(tick.time_s),
                None => truth.base_from_tip(tick.time_s),
            };
            let stream = &scenario.scenario_at(tick.time_s).pose;
            let stream_from_reference = stream.reference_from_stream.inverse();
            let mut pose = stream_from_reference * reference_from_tip * stream.tip_from_stream;
            let slip = stream.tool_slip.as_ref();
            if let Some(slip) = slip.filter(|slip| slip.is_active(tick.time_s)) {
                pose *= slip.tool_from_slipped;
            }
            let far = scenario.noise.factor_at_distance(pose.translation.vector.norm());
            for (drifted, step) in drifted.iter_mut().zip(walk.next()) {
                *drifted += step / timing.rate_hz.sqrt();
            }
            let Noise { pose_m, pose_rad, pose_walk: (walk_m, walk_rad), .. } = scenario.noise;
            pose.translation.vector *= 1.0 + stream.radial_scale_error;
            add_pose_noise(&mut pose, noise.next(), far * pose_m, far * pose_rad);
            add_pose_noise(&mut pose, &drifted, walk_m, walk_rad);
            if !tick.is_new {
                pose = last.unwrap_or(pose);
            }
            last = Some(pose);
            for (_, by) in stream.outliers.iter().filter(|(stray, _)| *stray == sample) {
                pose.translation.vector += by;
            }
            if stream.frozen_s.is_some_and(|(from, to)| (from..to).contains(&tick.time_s)) {
                pose = *frozen.get_or_insert(pose);
            }
            if stream.is_inverted {
                pose = pose.inverse();
            }
            let pose = stream.in_axes(&pose);
            let mut logged = stream.encoding.encode(&pose);
            if stream.is_in_millimetres {
                logged.xyz = logged.xyz.map(|metres| 1000.0 * metres);
            }
            logged.xyz = logged.xyz.map(|length| stream.position_factor * length);
            if let Some((axis, value)) = stream.constant_coordinate {
                logged.xyz[axis] = value;
            }
            if let Some(convention) = stream.number_convention {
                let unit = if stream.has_numbers_in_degrees { 1_f64.to_degrees() } else { 1.0 };
                let [a, b, c] = convention.numbers(&pose.rotation).map(|angle| unit * angle);
                let [x, y, z] = logged.xyz;
                return tick.message(Topic::Numbers, messages::numbers(&[x, y, z, a, b, c]));
            }
            logged.xyzw = logged.xyzw.map(|component| stream.quaternion_norm * component);
            logged.xyzw = stream.unset_quaternion.unwrap_or(logged.xyzw);
            let cdr = messages::pose_stamped(tick.stamp, &stream.frame_id, logged);
            tick.message(Topic::Pose, cdr)
        })
        .collect()
}

fn transform_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.tf;
    let of =
        |timing: &Timing, transport, moved| tf_messages(scenario, truth, timing, transport, moved);
    let mut messages = of(&stream.timing, Purpose::TfTransport, &None);
    if let Some(second) = &stream.second {
        messages.extend(of(&second.timing, Purpose::SecondTfTransport, &second.offset_joint));
    }
    messages
}

/// `offset_joint` offsets one joint's transform.
fn tf_messages(
    scenario: &Scenario,
    truth: &Truth,
    timing: &Timing,
    transport: Purpose,
    moved: &Option<(usize, Pose)>,
) -> Vec<Message> {
    let robot = &scenario.robot;
    let names = truth.chain.joint_names().iter();
    let joints: Vec<&Joint> =
        names.map(|name| robot.joint(name).expect("a chain's joints are its robot's")).collect();
    let mut noise = scenario.unit_noise(Purpose::TfNoise, joints.len());
    let mut last: Option<Vec<f64>> = None;
    let ticks = scenario.ticks(timing, transport);
    ticks
        .map(|tick| {
            let (mut positions, _) = truth.encoder_joints(tick.time_s);
            add_noise(&mut positions, noise.next(), scenario.noise.joints);
            let now = scenario.scenario_at(tick.time_s);
            let mut believed = now.joints.reported_positions(&positions, truth.chain.joint_kinds());
            if let Some(last) = last.as_ref().filter(|_| !tick.is_new) {
                believed.clone_from(last);
            }
            last = Some(believed.clone());
            let transforms: Vec<LoggedTransform> = joints
                .iter()
                .zip(believed)
                .enumerate()
                .map(|(at, (joint, position))| {
                    let mut origin = joint.parent_from_joint;
                    if let Some((_, by)) = moved.filter(|(joint, _)| *joint == at) {
                        origin *= by;
                    }
                    let parent_from_child = origin * joint_transform(joint, position);
                    logged_transform(robot, joint, now.tf.encoding.encode(&parent_from_child))
                })
                .collect();
            tick.message(Topic::Tf, messages::tf_message(tick.stamp, &transforms))
        })
        .collect()
}

fn imu_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.imu;
    let mut noise = scenario.unit_noise(Purpose::ImuNoise, 9);
    let mut walk = UnitNoise::new(random(scenario.seed, Purpose::ImuWalk), 1, 0.0);
    let step_rad = stream.yaw_walk_rad_per_sqrt_s / stream.timing.rate_hz.sqrt();
    let mut wandered_rad = 0.0;
    let mut last: Option<LoggedImu> = None;
    let ticks = scenario.ticks(&stream.timing, Purpose::ImuTransport);
    ticks
        .map(|tick| {
            let noise = noise.next();
            wandered_rad += step_rad * walk.next()[0];
            let stream = &scenario.scenario_at(tick.time_s).imu;
            let tip_from_imu = stream.tip_from_imu * stream.mount_error;
            let scaled =
                |at: usize, sigma: f64| sigma * Vec3::from_column_slice(&noise[at..at + 3]);
            let base_from_imu = (truth.base_from_tip(tick.time_s) * tip_from_imu).rotation;
            let imu_from_base = base_from_imu.inverse();
            let acceleration = truth.acceleration(tick.time_s, &tip_from_imu);
            let ahead = base_from_imu * Vec3::x();
            let heading_rad = ahead.y.atan2(ahead.x) + stream.world_yaw_rad;
            let yaw_rad =
                stream.yaw_rad(tick.time_s) + stream.heading_error_rad(heading_rad) + wandered_rad;
            let world_from_base = rotation_from_rotvec(Vec3::z() * yaw_rad);
            let world_from_imu = world_from_base
                * base_from_imu
                * small_rotation(&noise[..3], scenario.noise.imu_rad);
            let orientation = stream.encoding.encode(&pose([0.0; 3], world_from_imu));
            let sample = LoggedImu {
                orientation_xyzw: stream.has_orientation.then_some(orientation.xyzw),
                gyro: stream.gyro_factor
                    * (stream.gyro_from_rate
                        * (imu_from_base * truth.angular_velocity(tick.time_s))
                        + stream.bias_rad_s(tick.time_s)
                        + scaled(3, scenario.noise.gyro_rad_s)),
                specific_force: stream.force_factor
                    * (imu_from_base * (acceleration + GRAVITY_M_S2 * Vec3::z())
                        + scaled(6, scenario.noise.accel_m_s2)),
            };
            let sample = last.filter(|_| !tick.is_new).unwrap_or(sample);
            last = Some(sample);
            tick.message(Topic::Imu, messages::imu(tick.stamp, IMU_FRAME, &sample))
        })
        .collect()
}

pub(super) struct Tick {
    /// Time of the content, s after the start.
    pub(super) time_s: f64,
    pub(super) is_new: bool,
    pub(super) stamp: Stamp,
    received: Stamp,
}

impl Tick {
    pub(super) fn message(&self, topic: Topic, cdr: Vec<u8>) -> Message {
        Message { topic, received: self.received, cdr }
    }
}

impl Scenario {
    /// Received in order, 0.1 to 2 ms after the content's time.
    pub(super) fn ticks(&self, timing: &Timing, transport: Purpose) -> impl Iterator<Item = Tick> {
        const TRANSPORT_S: std::ops::Range<f64> = 0.1e-3..2e-3;
        let mut random = random(self.seed, transport);
        let Timing { rate_hz, phase_s, update_hz: new_hz, .. } = *timing;
        let count = ((self.duration_s - phase_s) * rate_hz).ceil().max(0.0) as usize;
        let start = self.start;
        let mut received = start;
        let mut held = None;
        let ticks = (0..count).map(move |index| {
            let sent_s = phase_s + index as f64 / rate_hz;
            received = received.max(start.shifted(sent_s + random.random_range(TRANSPORT_S)));
            let stamp = timing.stamp(start, sent_s, self.duration_s / 2.0);
            let age_s = timing.content_age_s(sent_s);
            if new_hz <= 0.0 {
                return (sent_s, Tick { time_s: sent_s - age_s, is_new: true, stamp, received });
            }
            // Exceeds rounding errors, so multiples of the period stay exact.
            let number = ((sent_s - phase_s) * new_hz + 1e-9).floor();
            let is_new = held.replace(number) != Some(number);
            (sent_s, Tick { time_s: phase_s + number / new_hz - age_s, is_new, stamp, received })
        });
        let is_kept =
            |sent_s: &f64| timing.gap_s.is_none_or(|(from, to)| !(from..to).contains(sent_s));
        ticks.filter(move |(sent_s, _)| is_kept(sent_s)).map(|(_, tick)| tick)
    }

    /// Message received 1 ms later.
    pub(super) fn tick_at(&self, timing: &Timing, time_s: f64) -> Tick {
        const TRANSPORT_S: f64 = 1e-3;
        let stamp = timing.stamp(self.start, time_s, self.duration_s / 2.0);
        let received = self.start.shifted(time_s + TRANSPORT_S);
        Tick { time_s, is_new: true, stamp, received }
    }

    pub(super) fn unit_noise(&self, purpose: Purpose, components: usize) -> UnitNoise {
        UnitNoise::new(random(self.seed, purpose), components, self.noise.correlation)
    }
}

impl Timing {
    /// Age of the content, s.
    fn content_age_s(&self, sent_s: f64) -> f64 {
        let Some((from_s, to_s, by_s)) = self.latency_ramp else { return 0.0 };
        match sent_s {
            sent_s if sent_s >= to_s => by_s,
            sent_s if sent_s <= from_s => 0.0,
            _ => by_s * (sent_s - from_s) / (to_s - from_s),
        }
    }

    /// Solves `time = stamp − latency − skew · (stamp − middle)`.
    fn stamp(&self, start: Stamp, time_s: f64, middle_s: f64) -> Stamp {
        if !self.has_stamps {
            return Stamp::default();
        }
        let stamp_s = (time_s + self.latency_s - self.skew * middle_s) / (1.0 - self.skew);
        let stepped = self.clock_step.filter(|(at_s, _)| time_s >= *at_s);
        let stamp_s = stamp_s + stepped.map_or(0.0, |(_, by_s)| by_s);
        start.shifted(self.clock_offset_s).shifted(stamp_s)
    }
}

impl JointStream {
    fn reported_positions(&self, positions: &[f64], kinds: &[JointKind]) -> Vec<f64> {
        let offsets = self.zero_offsets.iter().copied().chain(std::iter::repeat(0.0));
        let said = positions.iter().zip(offsets).zip(kinds).enumerate();
        let said: Vec<f64> = said
            .map(|(joint, ((q, offset), kind))| {
                let scaled = self.scale(joint) * (q - offset);
                let wrapped = self.wrapping.map_or(scaled, |fold| fold.wrap(scaled, *kind));
                match self.resolution > 0.0 {
                    true => (wrapped / self.resolution).round() * self.resolution,
                    false => wrapped,
                }
            })
            .collect();
        self.order_and_convert(&said)
    }

    /// Empty if not logged.
    fn reported_velocities(&self, velocities: &[f64]) -> Vec<f64> {
        if !self.has_velocity {
            return Vec::new();
        }
        let own = |joint: usize| self.velocity_scales.get(joint).copied().unwrap_or(1.0);
        let said = velocities.iter().enumerate();
        let said = said.map(|(joint, rate)| own(joint) * self.scale(joint) * rate);
        self.order_and_convert(&said.collect::<Vec<f64>>())
    }

    fn scale(&self, joint: usize) -> f64 {
        self.scales.get(joint).copied().unwrap_or(1.0)
    }

    /// In the order and unit of the log.
    fn order_and_convert(&self, numbers: &[f64]) -> Vec<f64> {
        let unit = if self.is_in_degrees { 1_f64.to_degrees() } else { 1.0 };
        let in_unit = |at: usize| unit * numbers[at];
        match &self.number_order {
            Some(order) if !numbers.is_empty() => {
                assert_eq!(order.len(), numbers.len(), "must be an order of all joints");
                order.iter().map(|&at| in_unit(at)).collect()
            }
            _ => (0..numbers.len()).map(in_unit).collect(),
        }
    }
}

impl PoseStream {
    fn in_axes(&self, pose: &Pose) -> Pose {
        let Some(axes) = self.axes else { return *pose };
        let xyz = axes * pose.translation.vector;
        // Mirroring on both sides preserves rotations.
        let turned = axes * pose.rotation.to_rotation_matrix().matrix() * axes.transpose();
        let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| turned[(row, column)]));
        let rotation = rotation_from_matrix_rows(rows).map_or(pose.rotation, |(turn, _)| turn);
        Pose::from_parts(xyz.into(), rotation)
    }
}

impl ImuStream {
    /// Yaw of the base in the IMU's world, without the random walk.
    fn yaw_rad(&self, time_s: f64) -> f64 {
        let jumped = self.yaw_jumps.iter().filter(|(at_s, _)| time_s > *at_s);
        self.world_yaw_rad
            + self.yaw_drift_rad_s * time_s
            + self.yaw_warm_up.map_or(0.0, |(by, tau_s)| by * (1.0 - (-time_s / tau_s).exp()))
            + jumped.map(|(_, size_rad)| size_rad).sum::<f64>()
    }

    fn heading_error_rad(&self, heading_rad: f64) -> f64 {
        let [once, twice] = self.yaw_by_heading;
        once.0 * (heading_rad + once.1).sin() + twice.0 * (2.0 * heading_rad + twice.1).sin()
    }

    fn bias_rad_s(&self, time_s: f64) -> Vec3 {
        let settling = self.gyro_warm_up.map(|(by, tau_s)| by * (-time_s / tau_s).exp());
        self.gyro_bias_rad_s + settling.unwrap_or_default()
    }
}

impl LoggedEncoding {
    pub(super) fn encode(self, pose: &Pose) -> LoggedPose {
        let (pose, xyzw) = match self {
            Self::Correct => (*pose, xyzw_from_rotation(&pose.rotation)),
            Self::Misinterpreted(reading) => {
                let misread = reading.read_as.rotation(reading.is.numbers(&pose.rotation));
                (*pose, xyzw_from_rotation(&misread))
            }
            Self::WrongQuaternionOrder(slip) => {
                // The inverse of one slip is the other.
                let other = match slip {
                    QuaternionOrderError::WxyzReadAsXyzw => QuaternionOrderError::XyzwReadAsWxyz,
                    QuaternionOrderError::XyzwReadAsWxyz => QuaternionOrderError::WxyzReadAsXyzw,
                };
                (*pose, other.true_xyzw(xyzw_from_rotation(&pose.rotation)))
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

/// Joint transform at `position`, rad or m.
fn joint_transform(joint: &Joint, position: f64) -> Pose {
    let along = joint.axis * position;
    match joint.kind {
        JointKind::Prismatic => pose(along.into(), Rotation::identity()),
        _ => pose([0.0; 3], rotation_from_rotvec(along)),
    }
}
