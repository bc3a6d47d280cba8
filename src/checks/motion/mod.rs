//! Motion of the arm: vibration, abrupt stops, joint limits.

pub(super) mod mot001;
pub(super) mod mot002;
pub(super) mod mot003;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Motion of the arm: vibration, abrupt stops, joint limits",
    rules: &[&mot001::MOT001, &mot002::MOT002, &mot003::MOT003],
};
