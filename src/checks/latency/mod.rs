//! How late each stream is against the joint states, and whether that stays.

pub(super) mod lat001;
pub(super) mod lat002;
pub(super) mod lat003;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "How late each stream is against the joint states, and whether that stays",
    rules: &[&lat001::LAT001, &lat002::LAT002, &lat003::LAT003],
};
