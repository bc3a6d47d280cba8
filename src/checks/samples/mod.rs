pub(super) mod frm005_not_a_rotation;
pub(super) mod ing003_unusable_samples;
pub(super) mod mot005_stray_samples;
pub(super) mod tim007_frozen_stream;
pub(super) mod tim008_repeated_rows;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Samples: NaNs, outliers, repeats, invalid rotations",
    rules: &[
        &ing003_unusable_samples::ING003,
        &frm005_not_a_rotation::FRM005,
        &mot005_stray_samples::MOT005,
        &tim007_frozen_stream::TIM007,
        &tim008_repeated_rows::TIM008,
    ],
};
