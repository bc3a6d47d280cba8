//! Rules on joints and the kinematic model: order, scale, zeros, backlash, sag, velocities, DH convention.

mod bends;
mod coupling;
pub(super) mod mot006;
pub(super) mod ord005;
pub(super) mod ord007;
pub(super) mod ord009;
mod turns;
pub(super) mod vel001;
pub(super) mod zer001;
pub(super) mod zer003;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Joints and kinematic model: order, scale, zeros, backlash, sag, velocities, DH convention",
    rules: &[
        &ord005::ORD005,
        &ord007::ORD007,
        &ord009::ORD009,
        &vel001::VEL001,
        &zer001::ZER001,
        &zer003::ZER003,
        &mot006::MOT006,
    ],
};
