use super::*;
use crate::test_motion;
use ground::geometry::{Pose, rotation_from_rotvec};
use ground::robot::Chain;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

const JOINT_NOISE_RAD: f64 = 2e-5;
const GYRO_NOISE_RAD_S: f64 = 2e-3;
const ORIENTATION_NOISE_RAD: f64 = 7e-4;

/// 20 s at 100 Hz with noise on each joint. Only one joint moves.
fn one_joint(moving: usize, rng: &mut Pcg64) -> (JointTrack, Chain) {
    let (_, chain) = test_motion::arm();
    let mut joints = JointTrack { dof: 6, ..Default::default() };
    let q = |row: i32, joint: usize| {
        let t_s = f64::from(row) * 0.01;
        if joint == moving { 0.4 * (1.3 * t_s).sin() } else { 0.3 * joint as f64 - 0.8 }
    };
    for row in 0..2000 {
        joints.t_s.push(f64::from(row) * 0.01);
        for joint in 0..6 {
            joints.q.push(q(row, joint) + JOINT_NOISE_RAD * rng.sample::<f64, _>(StandardNormal));
        }
    }
    joints.qd = vec![0.0; joints.q.len()];
    for at in 6..joints.q.len() - 6 {
        joints.qd[at] = (joints.q[at + 6] - joints.q[at - 6]) / 0.02;
    }
    (joints, chain)
}

/// IMU with rotation `mount` on the link, during [`one_joint`].
fn imu(moving: usize, mount: Rotation, rng: &mut Pcg64) -> ImuTrack {
    let (_, chain) = test_motion::arm();
    let rotation = |t_s: f64| {
        let mut q: Vec<f64> = (0..6).map(|joint| 0.3 * f64::from(joint) - 0.8).collect();
        q[moving] = 0.4 * (1.3 * t_s).sin();
        chain.forward(&q).rotation * mount
    };
    let mut noise = |sigma: f64| sigma * Vec3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
    let mut track = ImuTrack::default();
    for row in 5..3980 {
        let t_s = f64::from(row) * 0.005;
        let turn = rotation(t_s - 1e-4).inverse() * rotation(t_s + 1e-4);
        track.t_s.push(t_s);
        track.gyro.push(turn.scaled_axis() / 2e-4 + noise(GYRO_NOISE_RAD_S));
        track.accel.push(rotation(t_s).inverse() * Vec3::new(0.0, 0.0, 9.81));
        track.orientation.push(rotation(t_s) * rotation_from_rotvec(noise(ORIENTATION_NOISE_RAD)));
    }
    track
}

/// True rotation `mount`, logged rotation `logged`.
fn diagnosed(
    moving: usize,
    mount: Rotation,
    logged: Rotation,
    with_orientation: bool,
) -> ImuDiagnosis {
    let mut rng = Pcg64::seed_from_u64(7);
    let (joints, chain) = one_joint(moving, &mut rng);
    let mut track = imu(moving, mount, &mut rng);
    if !with_orientation {
        track.orientation.clear();
    }
    diagnosed_track(&joints, &chain, &track, logged)
}

fn diagnosed_track(
    joints: &JointTrack,
    chain: &Chain,
    track: &ImuTrack,
    logged: Rotation,
) -> ImuDiagnosis {
    diagnosed_beside_fk_error(joints, chain, track, logged, 0.0)
}

fn diagnosed_beside_fk_error(
    joints: &JointTrack,
    chain: &Chain,
    track: &ImuTrack,
    logged: Rotation,
    fk_error_rad: f64,
) -> ImuDiagnosis {
    let stream = ImuStream {
        track,
        chain,
        columns: &[0, 1, 2, 3, 4, 5],
        stamp_error_s: 0.0,
        link_from_imu: Some(Pose::from_parts(Vec3::zeros().into(), logged)),
        removed_ramp: None,
        fk_error_rad,
    };
    diagnose_imu(joints, &stream, 1.0)
}

/// Filtered gyros and vibrations have such noise. About the axes that do not turn, it is all that the gyro measures.
#[test]
fn noise_that_is_correlated_in_time_is_no_scale_error() {
    /// Per sample.
    const CORRELATION: f64 = 0.95;
    for moving in [0, 3, 5] {
        let mut rng = Pcg64::seed_from_u64(7);
        let (joints, chain) = one_joint(moving, &mut rng);
        let mount = rotation_from_rotvec(Vec3::new(0.3, -0.4, 1.2));
        let mut track = imu(moving, mount, &mut rng);
        let mut noise = Vec3::zeros();
        for gyro in &mut track.gyro {
            let innovation = Vec3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
            noise = CORRELATION * noise
                + GYRO_NOISE_RAD_S * (1.0 - CORRELATION.powi(2)).sqrt() * innovation;
            *gyro += noise;
        }
        let found = diagnosed_track(&joints, &chain, &track, mount);
        let bias = found.gyro_bias.expect("a bias");
        assert!(bias.scale_error.is_none(), "joint {moving}: {:?}", bias.scale_error);
    }
}

#[test]
fn a_gain_is_estimated_also_if_the_imu_turns_about_one_axis() {
    for moving in [0, 3, 5] {
        let mut rng = Pcg64::seed_from_u64(7);
        let (joints, chain) = one_joint(moving, &mut rng);
        let mount = rotation_from_rotvec(Vec3::new(0.3, -0.4, 1.2));
        let mut track = imu(moving, mount, &mut rng);
        track.gyro.iter_mut().for_each(|gyro| *gyro *= 1.15);
        let found = diagnosed_track(&joints, &chain, &track, mount);
        let scale = found.gyro_bias.expect("a bias").scale_error.expect("a scale").scale;
        assert!(
            scale.iter().all(|scale| (scale.value - 0.15).abs() < scale.half_width(0.999)),
            "joint {moving}: {scale:?}"
        );
        let found = diagnosed_beside_fk_error(&joints, &chain, &track, mount, 0.1);
        let scale = found.gyro_bias.expect("a bias").scale_error.expect("a scale").scale;
        assert!(scale[0].half_width(0.95) > 0.15, "joint {moving}: {scale:?}");
    }
}

#[test]
fn a_mount_is_not_observable_about_the_only_axis_of_motion() {
    for moving in [0, 3, 5] {
        let mount = rotation_from_rotvec(Vec3::new(0.3, -0.4, 1.2));
        for with_orientation in [false, true] {
            let found = diagnosed(moving, mount, mount, with_orientation);
            assert!(found.mount_rad.is_err(), "joint {moving}: {:?}", found.mount_rad);
            assert!(found.axes_rotation.is_none(), "joint {moving}: {:?}", found.axes_rotation);
            let latency = found.latency_s.expect("a latency");
            assert!(latency.value.abs() < 1e-3, "joint {moving}: {latency:?}");
        }
    }
}

#[test]
fn a_mount_error_that_tilts_the_only_axis_of_motion_is_found() {
    // The tool's z axis is the axis of the last joint.
    let off = rotation_from_rotvec(Vec3::x() * 90f64.to_radians());
    for with_orientation in [false, true] {
        let found = diagnosed(5, off, Rotation::identity(), with_orientation);
        let mount = found.mount_rad.expect("a mount");
        assert!((mount.norm.value - 90f64.to_radians()).abs() < 0.02, "{mount:?}");
    }
}
