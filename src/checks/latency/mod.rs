pub(super) mod lat001_latency;
pub(super) mod lat002_clock_skew;
pub(super) mod lat003_unsteady_latency;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Latency of each stream relative to the joint states, and how it varies",
    rules: &[&lat001_latency::LAT001, &lat002_clock_skew::LAT002, &lat003_unsteady_latency::LAT003],
};
