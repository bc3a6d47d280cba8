//! IMUs on the arm: yaw drift, tilt, mount and gyro bias.

pub(super) mod yaw001;
pub(super) mod yaw002;
pub(super) mod yaw003;
pub(super) mod yaw004;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "IMUs on the arm",
    rules: &[&yaw001::YAW001, &yaw002::YAW002, &yaw003::YAW003, &yaw004::YAW004],
};
