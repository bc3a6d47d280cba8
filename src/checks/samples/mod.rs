//! Samples: NaNs, outliers, repeats, invalid rotations.

pub(super) mod frm005;
pub(super) mod ing003;
pub(super) mod mot005;
pub(super) mod tim007;
pub(super) mod tim008;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Samples: NaNs, outliers, repeats, invalid rotations",
    rules: &[&ing003::ING003, &frm005::FRM005, &mot005::MOT005, &tim007::TIM007, &tim008::TIM008],
};
