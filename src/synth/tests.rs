//! Compares generated logs with the true motion.

mod changes;
mod motion;
mod structure;

use std::f64::consts::{FRAC_PI_2, PI};
use std::io::Cursor;

use super::*;
use crate::geometry::{
    QuaternionOrderError, Rotation, angle_between, pose, rotation_from_rpy, rotation_from_xyzw,
    rotvec_from_rotation,
};
use crate::time::seconds;

struct CdrReader<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> CdrReader<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        assert_eq!(bytes[..4], [0, 1, 0, 0]);
        Self { body: &bytes[4..], at: 0 }
    }

    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let from = self.at.next_multiple_of(N);
        self.at = from + N;
        self.body[from..self.at].try_into().unwrap()
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    fn floats<const N: usize>(&mut self) -> [f64; N] {
        [(); N].map(|()| f64::from_le_bytes(self.bytes()))
    }

    fn sequence(&mut self) -> Vec<f64> {
        (0..self.u32()).map(|_| f64::from_le_bytes(self.bytes())).collect()
    }

    fn string(&mut self) -> String {
        let length = self.u32() as usize;
        let text = &self.body[self.at..self.at + length - 1];
        self.at += length;
        String::from_utf8(text.to_vec()).unwrap()
    }

    /// Stamp, s after the start, and frame.
    fn header(&mut self) -> (f64, String) {
        let nanos = i64::from(self.u32()) * 1_000_000_000 + i64::from(self.u32());
        (seconds(nanos - START.nanos()), self.string())
    }

    fn pose(&mut self) -> Pose {
        pose(self.floats(), rotation_from_xyzw(self.floats()).unwrap())
    }
}

struct LoggedJoints {
    stamp_s: f64,
    names: Vec<String>,
    positions: Vec<f64>,
    velocities: Vec<f64>,
}

struct LoggedTf {
    stamp_s: f64,
    parent: String,
    child: String,
    parent_from_child: Pose,
}

struct LoggedImuSample {
    stamp_s: f64,
    world_from_imu: Rotation,
    orientation_is_absent: bool,
    gyro: Vec3,
    specific_force: Vec3,
}

struct Log(Vec<u8>);

impl Log {
    fn write(run: &Scenario) -> Self {
        let mut bytes = Vec::new();
        run.write_mcap(Cursor::new(&mut bytes), None).unwrap();
        Self(bytes)
    }

    fn read<T>(&self, topic: &str, decode: impl Fn(&mut CdrReader) -> T) -> Vec<T> {
        mcap::MessageStream::new(&self.0)
            .unwrap()
            .map(|message| message.unwrap())
            .filter(|message| message.channel.topic == topic)
            .map(|message| decode(&mut CdrReader::new(&message.data)))
            .collect()
    }

    fn joints(&self) -> Vec<LoggedJoints> {
        self.read(JOINT_STATES, |cdr| LoggedJoints {
            stamp_s: cdr.header().0,
            names: (0..cdr.u32()).map(|_| cdr.string()).collect(),
            positions: cdr.sequence(),
            velocities: cdr.sequence(),
        })
    }

    /// Stamps, s after the start.
    fn poses(&self) -> Vec<(f64, Pose)> {
        self.read(POSE, |cdr| (cdr.header().0, cdr.pose()))
    }

    fn transforms(&self, topic: &str) -> Vec<LoggedTf> {
        let messages = self.read(topic, |cdr| {
            let count = cdr.u32();
            let transform = |_| {
                let (stamp_s, parent) = cdr.header();
                let child = cdr.string();
                LoggedTf { stamp_s, parent, child, parent_from_child: cdr.pose() }
            };
            (0..count).map(transform).collect::<Vec<_>>()
        });
        messages.into_iter().flatten().collect()
    }

    fn imu(&self) -> Vec<LoggedImuSample> {
        self.read(IMU, |cdr| {
            let stamp_s = cdr.header().0;
            let world_from_imu = rotation_from_xyzw(cdr.floats()).unwrap();
            let orientation_is_absent = cdr.floats::<9>()[0] == -1.0;
            let gyro = cdr.floats().into();
            cdr.floats::<9>();
            let specific_force = cdr.floats().into();
            LoggedImuSample { stamp_s, world_from_imu, orientation_is_absent, gyro, specific_force }
        })
    }
}

fn quiet_run() -> Scenario {
    let mut run = Scenario { duration_s: 4.0, noise: Noise::NONE, ..Scenario::ur5e() };
    run.joints.timing.rate_hz = 25.0;
    run.pose.timing.rate_hz = 25.0;
    run.tf.timing.rate_hz = 25.0;
    run.imu.timing.rate_hz = 50.0;
    run
}

fn assert_same_pose(a: &Pose, b: &Pose) {
    assert!((a.translation.vector - b.translation.vector).norm() < 1e-9, "{a} is not {b}");
    assert!(angle_between(&a.rotation, &b.rotation) < 1e-8, "{a} is not {b}");
}

#[test]
fn without_faults_every_stream_is_true_at_its_stamp() {
    let run = quiet_run();
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);

    for joints in log.joints() {
        let (q, q_dot) = truth.joints(joints.stamp_s);
        assert_eq!(joints.names, truth.chain.joint_names());
        assert!(joints.positions.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-8));
        assert!(joints.velocities.iter().zip(q_dot).all(|(a, b)| (a - b).abs() < 1e-8));
    }
    for (stamp_s, logged) in log.poses() {
        assert_same_pose(&logged, &truth.base_from_tip(stamp_s));
    }
    for imu in log.imu() {
        let base_from_tip = truth.base_from_tip(imu.stamp_s).rotation;
        let world_from_base = rotation_from_rpy([0.0, 0.0, run.imu.world_yaw_rad]);
        let expected = world_from_base * base_from_tip * run.imu.tip_from_imu.rotation;
        assert!(angle_between(&imu.world_from_imu, &expected) < 1e-8);
        assert!(!imu.orientation_is_absent);
    }
}

#[test]
fn the_tf_tree_leads_from_the_root_to_the_tool() {
    let run = quiet_run();
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);
    let (moving, fixed) = (log.transforms(TF), log.transforms(TF_STATIC));
    let first: Vec<&LoggedTf> =
        moving.iter().filter(|tf| tf.stamp_s == moving[0].stamp_s).chain(&fixed).collect();
    let root_from = |link: &str| {
        let mut root_from_link = Pose::identity();
        let mut at = link;
        while let Some(tf) = first.iter().find(|tf| tf.child == at) {
            root_from_link = tf.parent_from_child * root_from_link;
            at = &tf.parent;
        }
        assert_eq!(at, "base_link");
        root_from_link
    };
    let base_from_tool = root_from("base").inverse() * root_from("tool0");
    assert_same_pose(&base_from_tool, &truth.base_from_tip(moving[0].stamp_s));
    assert_same_pose(&root_from("imu_link"), &(root_from("tool0") * run.imu.tip_from_imu));
}

#[test]
fn gyro_rates_integrate_to_the_orientations() {
    let mut run = quiet_run();
    run.imu.timing.rate_hz = 1000.0;
    run.imu.mount_error = pose([0.0; 3], rotation_from_rpy([0.0, 0.1, 0.0]));
    let log = Log::write(&run).imu();
    for pair in log.windows(3) {
        let turned = pair[0].world_from_imu.inverse() * pair[2].world_from_imu;
        let rate = rotvec_from_rotation(&turned) / (pair[2].stamp_s - pair[0].stamp_s);
        assert!((rate - pair[1].gyro).norm() < 1e-4, "{rate} is not {}", pair[1].gyro);
    }
}

#[test]
fn an_imu_at_rest_measures_gravity_upwards() {
    let run = Scenario { motion: Motion::AtRest, ..quiet_run() };
    for imu in Log::write(&run).imu() {
        let up = imu.world_from_imu * imu.specific_force;
        assert!((up - Vec3::z() * truth::GRAVITY_M_S2).norm() < 1e-6);
        assert_eq!(imu.gyro, Vec3::zeros());
    }
}

#[test]
fn an_imu_on_a_rotating_base_measures_centripetal_acceleration() {
    let mut run = quiet_run();
    run.motion = Motion::OneJoint(0);
    run.imu.tip_from_imu = Pose::identity();
    let truth = Truth::new(&run).unwrap();
    let fastest =
        Log::write(&run).imu().into_iter().max_by(|a, b| a.gyro.norm().total_cmp(&b.gyro.norm()));
    let imu = fastest.unwrap();
    let base_from_tip = truth.base_from_tip(imu.stamp_s);
    let felt = base_from_tip.rotation * imu.specific_force;
    let mut outwards = base_from_tip.translation.vector;
    outwards.z = 0.0;
    let expected = -outwards.norm() * imu.gyro.norm_squared();
    assert!(imu.gyro.norm() > 0.5);
    assert!((felt.dot(&outwards.normalize()) - expected).abs() < 1e-3);
}

#[test]
fn a_late_stream_has_earlier_content() {
    for latency_s in [0.022, -0.015] {
        let mut run = quiet_run();
        run.pose.timing.latency_s = latency_s;
        run.joints.timing.latency_s = latency_s;
        let truth = Truth::new(&run).unwrap();
        let log = Log::write(&run);
        for (stamp_s, logged) in log.poses() {
            assert_same_pose(&logged, &truth.base_from_tip(stamp_s - latency_s));
        }
        for joints in log.joints() {
            let (q, _) = truth.joints(joints.stamp_s - latency_s);
            assert!(joints.positions.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-8));
        }
    }
}

#[test]
fn skew_changes_the_latency_about_mid_run() {
    let mut run = quiet_run();
    (run.pose.timing.latency_s, run.pose.timing.skew) = (0.010, 0.002);
    let truth = Truth::new(&run).unwrap();
    for (stamp_s, logged) in Log::write(&run).poses() {
        let latency_s = 0.010 + 0.002 * (stamp_s - 2.0);
        assert_same_pose(&logged, &truth.base_from_tip(stamp_s - latency_s));
    }
}

#[test]
fn other_clocks_and_missing_stamps_keep_receive_times() {
    let mut run = quiet_run();
    run.imu.timing.clock_offset_s = -1000.0;
    run.pose.timing.has_stamps = false;
    let log = Log::write(&run);
    assert!((log.imu()[0].stamp_s + 1000.0 - run.imu.timing.phase_s).abs() < 1e-8);
    assert_eq!(log.poses()[0].0, seconds(-START.nanos()));
    for message in mcap::MessageStream::new(&log.0).unwrap() {
        let received_s = seconds(message.unwrap().log_time.cast_signed() - START.nanos());
        assert!((0.0..4.003).contains(&received_s));
    }
}

#[test]
fn reported_positions_plus_zero_offset_are_true() {
    let offset_rad = 0.6_f64.to_radians();
    let mut run = quiet_run();
    run.joints.zero_offsets = vec![0.0, 0.0, offset_rad];
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);
    for joints in log.joints() {
        let (q_true, _) = truth.joints(joints.stamp_s);
        assert!((joints.positions[2] + offset_rad - q_true[2]).abs() < 1e-8);
        assert!((joints.positions[1] - q_true[1]).abs() < 1e-8);
    }
    for (stamp_s, logged) in log.poses() {
        assert_same_pose(&logged, &truth.base_from_tip(stamp_s));
    }
    for tf in log.transforms(TF).iter().filter(|tf| tf.child == "forearm_link") {
        let angle = rotvec_from_rotation(&tf.parent_from_child.rotation).z;
        let (q_true, _) = truth.joints(tf.stamp_s);
        let gap = (angle + offset_rad - q_true[2]).rem_euclid(2.0 * PI);
        assert!(gap.min(2.0 * PI - gap) < 1e-8);
    }
}

#[test]
fn tf_uses_degrees_and_permuted_positions() {
    let mut run = quiet_run();
    run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    run.joints.is_in_degrees = true;
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);
    for joints in log.joints() {
        let (q, _) = truth.joints(joints.stamp_s);
        assert!((joints.positions[0] - q[2].to_degrees()).abs() < 1e-6);
        assert!((joints.positions[5] - q[5].to_degrees()).abs() < 1e-6);
    }
    for tf in log.transforms(TF).iter().filter(|tf| tf.child == "shoulder_link") {
        let (q, _) = truth.joints(tf.stamp_s);
        let believed = rotation_from_rpy([0.0, 0.0, q[2].to_degrees()]);
        assert!(angle_between(&tf.parent_from_child.rotation, &believed) < 1e-6);
    }
}

#[test]
fn yaw_drift_is_positive_about_up() {
    let drift_rad_s = 3_f64.to_radians() / 60.0;
    let clean = quiet_run();
    let mut drifting = clean.clone();
    drifting.imu.yaw_drift_rad_s = drift_rad_s;
    for (clean, drifting) in Log::write(&clean).imu().iter().zip(Log::write(&drifting).imu()) {
        let ahead = drifting.world_from_imu * clean.world_from_imu.inverse();
        let expected = Vec3::z() * drift_rad_s * clean.stamp_s;
        assert!((rotvec_from_rotation(&ahead) - expected).norm() < 1e-8);
    }
}

#[test]
fn frames_and_radial_scale_are_as_planted() {
    let mut run = quiet_run();
    run.pose.reference_from_stream = pose([0.1, 0.2, 0.0], rotation_from_rpy([0.0, 0.0, PI]));
    run.pose.tip_from_stream = pose([0.0, 0.0, 0.14], rotation_from_rpy([0.0, 0.0, FRAC_PI_2]));
    let truth = Truth::new(&run).unwrap();
    for (stamp_s, logged) in Log::write(&run).poses() {
        let expected = truth.base_from_tip(stamp_s) * run.pose.tip_from_stream;
        assert_same_pose(&(run.pose.reference_from_stream * logged), &expected);
    }

    let mut run = quiet_run();
    run.pose.radial_scale_error = 0.01;
    run.pose.is_in_millimetres = true;
    for (stamp_s, logged) in Log::write(&run).poses() {
        let expected = truth.base_from_tip(stamp_s).translation.vector * 1010.0;
        assert!((logged.translation.vector - expected).norm() < 1e-5);
    }
}

#[test]
fn encodings_can_be_inverted() {
    let truth = Truth::new(&quiet_run()).unwrap();
    let base_from_tip = truth.base_from_tip(1.7);
    let truth_xyzw = |encoding: LoggedEncoding| encoding.encode(&base_from_tip).xyzw;
    let rotation_of = |xyzw| rotation_from_xyzw(xyzw).unwrap();

    let reading = Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY };
    let numbers =
        Convention::RPY.numbers(&rotation_of(truth_xyzw(LoggedEncoding::Misinterpreted(reading))));
    let mut shown = Vec::new();
    reading.true_rotations(&Convention::RPY.rotation(numbers), &mut shown);
    assert!(shown.iter().any(|found| angle_between(found, &base_from_tip.rotation) < 1e-9));

    for slip in [QuaternionOrderError::WxyzReadAsXyzw, QuaternionOrderError::XyzwReadAsWxyz] {
        let undone =
            rotation_of(slip.true_xyzw(truth_xyzw(LoggedEncoding::WrongQuaternionOrder(slip))));
        assert!(angle_between(&undone, &base_from_tip.rotation) < 1e-12);
    }

    let inverted = LoggedEncoding::Inverted.encode(&base_from_tip);
    let inverse = pose(inverted.xyz, rotation_of(inverted.xyzw));
    assert_same_pose(&(inverse * base_from_tip), &Pose::identity());

    let transposed = LoggedEncoding::Transposed.encode(&base_from_tip);
    assert_eq!(transposed.xyz, crate::geometry::xyz_of(&base_from_tip));
    let product = rotation_of(transposed.xyzw) * base_from_tip.rotation;
    assert!(angle_between(&product, &Rotation::identity()) < 1e-12);
}

#[test]
fn bytes_depend_only_on_scenario_and_seed() {
    let bytes = |run: &Scenario| {
        let mut bytes = Vec::new();
        run.write_mcap(Cursor::new(&mut bytes), Some(Compression::Zstd)).unwrap();
        bytes
    };
    for run in [demo(), pair()] {
        let run = Scenario { duration_s: 2.0, ..run };
        assert_eq!(bytes(&run), bytes(&run));
        assert_ne!(bytes(&run), bytes(&Scenario { seed: 2, ..run.clone() }));
    }
}

#[test]
fn a_fault_in_one_stream_does_not_change_others() {
    let clean = Scenario { duration_s: 2.0, ..Scenario::ur5e() };
    let mut faulty = clean.clone();
    faulty.pose.timing.latency_s = 0.022;
    faulty.imu.timing.rate_hz = 0.0;
    let (clean, faulty) = (Log::write(&clean), Log::write(&faulty));
    let positions = |log: &Log| log.joints().into_iter().map(|j| j.positions).collect::<Vec<_>>();
    assert_eq!(positions(&clean), positions(&faulty));
    assert!(faulty.imu().is_empty());
}

#[test]
fn an_imu_without_orientation_is_marked() {
    let mut run = quiet_run();
    run.imu.has_orientation = false;
    run.imu.gyro_bias_rad_s = Vec3::new(0.01, 0.0, -0.02);
    run.motion = Motion::AtRest;
    for imu in Log::write(&run).imu() {
        assert!(imu.orientation_is_absent);
        assert_eq!(imu.gyro, run.imu.gyro_bias_rad_s);
    }
}

#[test]
fn noise_has_the_requested_size_and_correlation() {
    let mut noise = noise::UnitNoise::new(noise::random(1, noise::Purpose::PoseNoise), 1, 0.9);
    let samples: Vec<f64> = (0..200_000).map(|_| noise.next()[0]).collect();
    let mean_of =
        |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / samples.len() as f64;
    let variance = mean_of(&mut samples.iter().map(|x| x * x));
    let covariance = mean_of(&mut samples.windows(2).map(|pair| pair[0] * pair[1]));
    assert!((variance - 1.0).abs() < 0.05);
    assert!((covariance / variance - 0.9).abs() < 0.01);
}

#[test]
fn an_unknown_tip_is_named() {
    let error = Scenario { tip: "tool".into(), ..Scenario::ur5e() }
        .write_mcap(Cursor::new(Vec::new()), None)
        .unwrap_err();
    assert!(error.to_string().contains("no link 'tool'"), "{error}");
}
