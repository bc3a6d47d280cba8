//! Latency of each stream relative to the joint states, and how it varies.

pub(super) mod lat001;
pub(super) mod lat002;
pub(super) mod lat003;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Latency of each stream relative to the joint states, and how it varies",
    rules: &[&lat001::LAT001, &lat002::LAT002, &lat003::LAT003],
};
