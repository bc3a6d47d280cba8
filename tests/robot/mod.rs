//! Robot models: readers, catalogue, forward kinematics.

mod catalogue;
mod chains;
mod files;

use poseaudit::geometry::{Pose, angle_between};
use poseaudit::robot::{Chain, Robot};

pub fn chain(robot: &Robot, base: &str, tip: &str) -> Chain {
    robot
        .chain(robot.link_or_nearest(base).unwrap(), robot.link_or_nearest(tip).unwrap())
        .unwrap_or_else(|error| panic!("{}: {error}", robot.name))
}

pub fn default_chain(robot: &Robot) -> Chain {
    chain(robot, robot.default_base.as_deref().unwrap(), robot.default_tip.as_deref().unwrap())
}

pub fn urdf(body: &str) -> Robot {
    Robot::from_urdf(&format!("<robot name=\"test\">\n{body}\n</robot>"), "test.urdf").unwrap()
}

/// Positions in ±2 from a linear congruential generator, to avoid a dependency.
pub fn positions(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 4.0 - 2.0
    };
    (0..count).map(|_| next()).collect()
}

#[track_caller]
pub fn assert_near(found: &Pose, expected: &Pose, tolerance: f64, what: &str) {
    let distance_m = (found.translation.vector - expected.translation.vector).norm();
    let angle_rad = angle_between(&found.rotation, &expected.rotation);
    assert!(
        distance_m <= tolerance && angle_rad <= tolerance,
        "{what}: {distance_m:e} m and {angle_rad:e} rad off"
    );
}
