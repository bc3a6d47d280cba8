//! Joints and kinematic model.

mod compliance;
mod coupling;
pub(super) mod mot006_backlash;
pub(super) mod ord005_joint_order;
pub(super) mod ord007_dh_convention;
pub(super) mod ord009_joint_scale;
mod turns;
pub(super) mod vel001_velocity_mismatch;
pub(super) mod zer001_joint_zero;
pub(super) mod zer003_sag;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Joints and kinematic model: order, scale, zeros, backlash, sag, velocities, DH convention",
    rules: &[
        &ord005_joint_order::ORD005,
        &ord007_dh_convention::ORD007,
        &ord009_joint_scale::ORD009,
        &vel001_velocity_mismatch::VEL001,
        &zer001_joint_zero::ZER001,
        &zer003_sag::ZER003,
        &mot006_backlash::MOT006,
    ],
};
