//! Stamps and rates: clocks, gaps and lost samples.

pub(super) mod tim001;
pub(super) mod tim002;
pub(super) mod tim003;
pub(super) mod tim004;
pub(super) mod tim005;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Stamps and rates: clocks, gaps and lost samples",
    rules: &[&tim001::TIM001, &tim002::TIM002, &tim003::TIM003, &tim004::TIM004, &tim005::TIM005],
};
