//! Changes within a run, arms off the nominal model, and warm-up.

use super::*;

const CHANGE_S: f64 = 2.0;

#[test]
fn changes_apply_from_their_time_on() {
    let mut run = quiet_run();
    let mut later = run.clone();
    later.pose.tip_from_stream = pose([0.0, 0.02, 0.01], Rotation::identity());
    later.joints.zero_offsets = vec![0.0, 0.0, 0.03];
    later.imu.gyro_bias_rad_s = Vec3::new(0.01, 0.0, 0.02);
    let moved = later.pose.tip_from_stream;
    run.changes = vec![(CHANGE_S, later)];
    let truth = Truth::new(&run).unwrap();
    let (log, before) = (Log::write(&run), Log::write(&quiet_run()));
    for (stamp_s, logged) in log.poses() {
        let is_later = stamp_s >= CHANGE_S;
        let by = if is_later { moved } else { Pose::identity() };
        assert_same_pose(&logged, &(truth.base_from_tip(stamp_s) * by));
    }
    for joints in log.joints() {
        let is_later = joints.stamp_s >= CHANGE_S;
        let off = truth.joints(joints.stamp_s).0[2] - joints.positions[2];
        assert!((off - if is_later { 0.03 } else { 0.0 }).abs() < 1e-9, "{off}");
    }
    for (imu, was) in log.imu().iter().zip(before.imu()) {
        let off = (imu.gyro - was.gyro).norm();
        let expected = if imu.stamp_s >= CHANGE_S { 0.01_f64.hypot(0.02) } else { 0.0 };
        assert!((off - expected).abs() < 1e-12, "{off}");
    }
}

#[test]
fn latency_may_step_or_ramp() {
    for (to_s, by_s) in [(CHANGE_S, 0.04), (3.0, 0.04), (3.0, -0.02)] {
        let mut run = quiet_run();
        run.pose.timing.latency_ramp = Some((CHANGE_S, to_s, by_s));
        let truth = Truth::new(&run).unwrap();
        for (stamp_s, logged) in Log::write(&run).poses() {
            let part = if to_s > CHANGE_S { (stamp_s - CHANGE_S) / (to_s - CHANGE_S) } else { 1.0 };
            let part = if stamp_s < CHANGE_S { 0.0 } else { part.clamp(0.0, 1.0) };
            assert_same_pose(&logged, &truth.base_from_tip(stamp_s - by_s * part));
        }
    }
}

#[test]
fn a_gap_removes_only_its_messages() {
    let mut run = quiet_run();
    run.pose.timing.gap_s = Some((1.0, 1.5));
    let kept: Vec<f64> = Log::write(&run).poses().into_iter().map(|(stamp_s, _)| stamp_s).collect();
    let all = Log::write(&quiet_run()).poses().into_iter().map(|(stamp_s, _)| stamp_s);
    let expected: Vec<f64> = all.filter(|stamp_s| !(1.0..1.5).contains(stamp_s)).collect();
    assert_eq!(kept, expected);
    assert!(kept.windows(2).any(|pair| pair[1] - pair[0] > 0.49));
}

#[test]
fn poses_use_the_actual_arm_and_transforms_the_nominal_one() {
    let mut run = quiet_run();
    let text = urdf_text(&run.robot);
    let drawn = "<origin xyz=\"-0.425 0 0\"";
    assert!(text.contains(drawn));
    let built = text.replace(drawn, "<origin xyz=\"-0.427 0 0\"");
    run.actual_robot = Some(Robot::from_urdf(&built, "as built").unwrap());
    let drawing = Truth::new(&quiet_run()).unwrap();
    let log = Log::write(&run);
    for (stamp_s, logged) in log.poses() {
        let by = logged.translation.vector - drawing.base_from_tip(stamp_s).translation.vector;
        assert!((by.norm() - 2e-3).abs() < 1e-9, "{by}");
    }
    let of = |log: &Log| -> Vec<Pose> {
        log.transforms(TF).into_iter().map(|one| one.parent_from_child).collect()
    };
    let both = of(&log).into_iter().zip(of(&Log::write(&quiet_run())));
    both.for_each(|(a, b)| assert_same_pose(&a, &b));
}

#[test]
fn gyro_and_yaw_warm_up_and_have_the_requested_units() {
    let mut run = quiet_run();
    run.imu.gyro_warm_up = Some((Vec3::new(0.0, 0.03, 0.0), 1.5));
    run.imu.yaw_warm_up = Some((0.05, 1.5));
    run.imu.gyro_factor = 180.0 / PI;
    run.imu.force_factor = 1.0 / truth::GRAVITY_M_S2;
    let (log, ideal) = (Log::write(&run).imu(), Log::write(&quiet_run()).imu());
    for (imu, was) in log.iter().zip(ideal) {
        let left = (-imu.stamp_s / 1.5).exp();
        let bias = imu.gyro * (PI / 180.0) - was.gyro;
        assert!((bias - Vec3::new(0.0, 0.03 * left, 0.0)).norm() < 1e-9, "{bias}");
        let turned = imu.world_from_imu * was.world_from_imu.inverse();
        assert!((rotvec_from_rotation(&turned).z - 0.05 * (1.0 - left)).abs() < 1e-8);
        assert!((imu.specific_force * truth::GRAVITY_M_S2 - was.specific_force).norm() < 1e-9);
    }
}

#[test]
fn magnetic_errors_are_harmonics_of_the_heading() {
    let mut run = quiet_run();
    run.imu.yaw_by_heading = [(0.08, 0.3), (0.02, 1.1)];
    let (log, ideal) = (Log::write(&run).imu(), Log::write(&quiet_run()).imu());
    for (imu, was) in log.iter().zip(ideal) {
        let ahead = was.world_from_imu * Vec3::x();
        let heading = ahead.y.atan2(ahead.x);
        let expected = 0.08 * (heading + 0.3).sin() + 0.02 * (2.0 * heading + 1.1).sin();
        let turned = imu.world_from_imu * was.world_from_imu.inverse();
        assert!((rotvec_from_rotation(&turned).z - expected).abs() < 1e-8);
    }
}

#[test]
fn a_vibrating_link_moves_without_its_encoder() {
    let mut run = quiet_run();
    run.motion = Motion::AtRest;
    run.pose.timing.rate_hz = 200.0;
    run.compliance = vec![SynthCompliance {
        joint: 1,
        kind: SynthComplianceKind::Vibration(8.0),
        amplitude_rad: 1e-3,
    }];
    let log = Log::write(&run);
    let first = log.joints()[0].positions.clone();
    assert!(log.joints().iter().all(|joints| joints.positions == first));
    let xyz: Vec<Vec3> = log.poses().iter().map(|(_, pose)| pose.translation.vector).collect();
    let mean = xyz.iter().sum::<Vec3>() / xyz.len() as f64;
    let square = xyz.iter().map(|xyz| (xyz - mean).norm_squared()).sum::<f64>() / xyz.len() as f64;
    let lever = Truth::new(&run).unwrap().base_from_tip(0.0).translation.vector
        - Vec3::new(0.0, 0.0, 0.1625);
    let turns_about_y = Vec3::new(lever.x, 0.0, lever.z).norm();
    assert!((square.sqrt() / (turns_about_y * 1e-3 / 2_f64.sqrt()) - 1.0).abs() < 0.05);
}

#[test]
fn random_walks_grow_with_time_and_camera_noise_with_distance() {
    let mut run = quiet_run();
    (run.motion, run.duration_s, run.pose.timing.rate_hz) = (Motion::AtRest, 400.0, 25.0);
    run.noise.pose_walk = (1e-4, 0.0);
    let walked = |run: &Scenario| -> f64 {
        let xyz: Vec<Vec3> =
            Log::write(run).poses().iter().map(|(_, pose)| pose.translation.vector).collect();
        let steps = xyz.iter().zip(xyz.iter().skip(100)).step_by(100);
        let squares: Vec<f64> = steps.map(|(a, b)| (b - a).norm_squared()).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    // 4 s, three directions.
    let expected = 1e-4 * (3.0 * 4.0_f64).sqrt();
    assert!((walked(&run) / expected - 1.0).abs() < 0.2, "{}", walked(&run));
    let far = Noise { far_m: 0.5, ..Noise::NONE };
    assert_eq!(
        [0.2, 0.5, 1.0].map(|distance_m| far.factor_at_distance(distance_m)),
        [1.0, 1.0, 4.0]
    );
}

#[test]
fn pauses_lengthen_rests() {
    let mut run = quiet_run();
    (run.duration_s, run.pause_s) = (30.0, 2.0);
    let rests = Truth::new(&run).unwrap().rests();
    let long = rests.iter().filter(|(from, to)| to - from > 2.0).count();
    assert_eq!(long, rests.len() / 4);
    assert!(long > 0);
}
