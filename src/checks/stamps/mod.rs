//! Stamps and rates: clocks, gaps and lost samples.

pub(super) mod tim001_backward_stamps;
pub(super) mod tim002_gaps;
pub(super) mod tim003_foreign_clock;
pub(super) mod tim004_duplicate_stamps;
pub(super) mod tim005_unusable_stamps;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Stamps and rates: clocks, gaps and lost samples",
    rules: &[
        &tim001_backward_stamps::TIM001,
        &tim002_gaps::TIM002,
        &tim003_foreign_clock::TIM003,
        &tim004_duplicate_stamps::TIM004,
        &tim005_unusable_stamps::TIM005,
    ],
};
