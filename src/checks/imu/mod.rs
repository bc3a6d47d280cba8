//! IMUs on the arm: yaw drift, tilt, mount and gyro bias.

pub(super) mod yaw001_yaw_drift;
pub(super) mod yaw002_imu_tilt;
pub(super) mod yaw003_imu_mount;
pub(super) mod yaw004_gyro_bias;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "IMUs on the arm",
    rules: &[
        &yaw001_yaw_drift::YAW001,
        &yaw002_imu_tilt::YAW002,
        &yaw003_imu_mount::YAW003,
        &yaw004_gyro_bias::YAW004,
    ],
};
