//! Poses, rotations and conversions.
//!
//! `a_from_b` maps coordinates in b to coordinates in a; it is ROS TF with parent a and child b. Only this
//! module constructs rotations from numbers.

#![allow(
    clippy::disallowed_methods,
    reason = "the only module that constructs rotations from numbers"
)]

mod axes;
mod code;
mod convention;
mod euler;
mod misinterpretation;
mod rotation;
mod rotation_encoding;
mod units;
pub mod vendors;

use std::borrow::Borrow;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

pub use axes::Axes;
pub use code::{CodeLine, code_of_numbers, code_of_quaternion};
pub use convention::{Convention, ConventionError};
pub use euler::EulerOrder;
pub use misinterpretation::{
    Misinterpretation, MisinterpretationClass, QuaternionOrderError, RotationError,
    misinterpretation_classes,
};
pub use rotation::{
    angle_between, rotation_by_wahba, rotation_from_matrix_rows, rotation_from_rotvec,
    rotation_from_rpy, rotation_from_xyzw, rotvec_from_rotation, xyzw_from_rotation,
};
pub use rotation_encoding::RotationEncoding;
pub use units::{AngleUnit, LengthScale, Misread, UnitError, Units};

/// Rigid transform `a_from_b`, m.
pub type Pose = Isometry3<f64>;

/// Rotation `a_from_b`.
pub type Rotation = UnitQuaternion<f64>;

/// Three components; the variable's name states unit and frame.
pub type Vec3 = Vector3<f64>;

/// From a translation (m) and a rotation.
pub fn pose(xyz: [f64; 3], rotation: Rotation) -> Pose {
    Pose::from_parts(Translation3::new(xyz[0], xyz[1], xyz[2]), rotation)
}

/// Translation, m.
pub fn xyz_of(pose: &Pose) -> [f64; 3] {
    pose.translation.vector.into()
}

/// 0 without vectors.
pub fn mean_vector(vectors: impl IntoIterator<Item = impl Borrow<Vec3>>) -> Vec3 {
    let (mut sum, mut count) = (Vec3::zeros(), 0_usize);
    for vector in vectors {
        let vector: &Vec3 = vector.borrow();
        sum += vector;
        count += 1;
    }
    sum / count.max(1) as f64
}

/// Between two poses, linear in position and rotation angle; `part` is 0 to 1.
pub fn interpolate(from: &Pose, to: &Pose, part: f64) -> Pose {
    let turn = rotvec_from_rotation(&(from.rotation.inverse() * to.rotation));
    Pose::from_parts(
        from.translation.vector.lerp(&to.translation.vector, part).into(),
        from.rotation * rotation_from_rotvec(turn * part),
    )
}

#[cfg(test)]
pub(crate) mod test_random;
