//! Motion shared by tests.

use crate::PoseStream;
use crate::test_random::Lcg;
use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};
use ground::robot::{Chain, catalogue};
use ground::stream::{JointTrack, Orientations, PoseTrack};

/// 20 s of a UR5e with swinging joints, and its chain `base` to `tool0`.
pub fn arm() -> (JointTrack, Chain) {
    let robot = catalogue::find("ur5e").expect("it is in the catalogue");
    let link = |name| robot.link(name).expect("a link");
    let chain = robot.chain(link("base"), link("tool0")).expect("a chain");
    let mut joints = JointTrack { dof: 6, ..Default::default() };
    for row in 0..2500 {
        let t_s = f64::from(row) * 0.008;
        joints.t_s.push(t_s);
        for joint in 0..6 {
            let (rate, phase) = (0.7 + 0.23 * f64::from(joint), f64::from(joint));
            joints.q.push(0.5 * (rate * t_s + phase).sin() - 0.6);
            joints.qd.push(0.5 * rate * (rate * t_s + phase).cos());
        }
    }
    (joints, chain)
}

/// In ±1, with a standard deviation of 1/√3.
pub fn noise(row: usize) -> f64 {
    let hash = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let hash = (hash ^ (hash >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (hash >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// Positions, m, and rotations at these stamps.
pub fn pose_track(t_s: &[f64], poses: impl IntoIterator<Item = (Vec3, Rotation)>) -> PoseTrack {
    let (xyz, rotations) = poses.into_iter().unzip();
    let orientation = Orientations::Rotations(rotations);
    PoseTrack { t_s: t_s.to_vec(), xyz, orientation, declared: None }
}

/// Stream of the tip of [`arm`].
pub fn tip_stream<'a>(track: &'a PoseTrack, chain: &'a Chain) -> PoseStream<'a> {
    PoseStream::new(track, chain, &[0, 1, 2, 3, 4, 5])
}

/// The test arm, with links that deviate by this much, m, and 0.1° per mm.
pub fn deviating_chain(link_m: f64) -> Chain {
    let mut random = Lcg::new();
    let deviations = std::array::from_fn(|_| {
        let [shift, turn] = [link_m, 1.745 * link_m].map(|size| random.triple(size));
        pose(shift, rotation_from_rotvec(turn.into()))
    });
    chain_with(&deviations)
}

/// The test arm with these changes of its links, from the base on.
pub fn chain_with(deviations: &[Pose; 7]) -> Chain {
    let robot = catalogue::find("ur5e").expect("it is in the catalogue");
    let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
    let path = robot.link_path(base, tip).expect("a serial arm");
    let robot = robot.with_deviations(&path, deviations, &[]);
    let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
    robot.chain(base, tip).expect("a chain")
}
