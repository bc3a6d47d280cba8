pub(super) mod mot001_shake;
pub(super) mod mot002_abrupt_stops;
pub(super) mod mot003_limits_exceeded;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Motion of the arm: vibration, abrupt stops, joint limits",
    rules: &[&mot001_shake::MOT001, &mot002_abrupt_stops::MOT002, &mot003_limits_exceeded::MOT003],
};
