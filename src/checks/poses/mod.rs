//! Rules on tool poses and /tf against FK: frames, encodings, units and residuals.

pub(super) mod frm001_tf_against_kinematics;
pub(super) mod frm002_reference_frame;
pub(super) mod frm003_tool_frame;
pub(super) mod mdl001_unexplained_residual;
pub(super) mod ord001_rotation_convention;
pub(super) mod ord002_quaternion_order;
pub(super) mod ord003_inverted_pose;
pub(super) mod ord004_degrees_for_radians;
pub(super) mod ord006_gimbal_lock;
pub(super) mod ord008_millimetres_for_metres;
pub(super) mod ord010_axes_exchanged;
pub(super) mod ord011_constant_coordinate;
pub(super) mod zer002_growth_with_reach;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Tool poses and /tf against FK: frames, encodings, units and residuals",
    rules: &[
        &frm001_tf_against_kinematics::FRM001,
        &frm002_reference_frame::FRM002,
        &frm003_tool_frame::FRM003,
        &mdl001_unexplained_residual::MDL001,
        &ord001_rotation_convention::ORD001,
        &ord002_quaternion_order::ORD002,
        &ord003_inverted_pose::ORD003,
        &ord004_degrees_for_radians::ORD004,
        &ord006_gimbal_lock::ORD006,
        &ord008_millimetres_for_metres::ORD008,
        &ord010_axes_exchanged::ORD010,
        &ord011_constant_coordinate::ORD011,
        &zer002_growth_with_reach::ZER002,
    ],
};
