//! Poses and rotations, and every change of rotation convention.
//!
//! `a_from_b` maps coordinates in frame b to coordinates in frame a; ROS TF with parent a and child
//! b is `a_from_b`. Outside this room nobody builds a quaternion from numbers.

#![allow(clippy::disallowed_methods, reason = "the one room where numbers become rotations")]

mod axes;
mod code;
mod coding;
mod convention;
mod euler;
mod reading;
mod rotation;
mod units;
pub mod vendors;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

pub use axes::Axes;
pub use code::{CodeLine, code_of_numbers, code_of_quaternion};
pub use coding::Coding;
pub use convention::{Convention, ConventionError};
pub use euler::EulerOrder;
pub use reading::{Misreading, MisreadingClass, QuaternionSlip, RotationSlip, misreading_classes};
pub use rotation::{
    angle_between, rotation_from_matrix_rows, rotation_from_rotvec, rotation_from_rpy,
    rotation_from_xyzw, rotvec_from_rotation, xyzw_from_rotation,
};
pub use units::{AngleUnit, LengthScale, Slip, UnitError, Units};

/// A rigid transform `a_from_b`; translation in metres.
pub type Pose = Isometry3<f64>;

/// A rotation `a_from_b`.
pub type Rotation = UnitQuaternion<f64>;

/// A vector of three components; its unit and frame are in the name of the variable.
pub type Vec3 = Vector3<f64>;

/// The pose with translation `xyz` (m) and `rotation`.
pub fn pose(xyz: [f64; 3], rotation: Rotation) -> Pose {
    Pose::from_parts(Translation3::new(xyz[0], xyz[1], xyz[2]), rotation)
}

/// The translation of `pose` as an array, m.
pub fn xyz_of(pose: &Pose) -> [f64; 3] {
    pose.translation.vector.into()
}

#[cfg(test)]
pub(crate) mod test_random;
