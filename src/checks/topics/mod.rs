//! Files, topics and frames: damaged, missing or unaudited data.

pub(super) mod frm004;
pub(super) mod frm007;
pub(super) mod ing001;
pub(super) mod ing002;
pub(super) mod meta001;
pub(super) mod meta002;
pub(super) mod tim006;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Files, topics and frames: damaged, missing or unaudited data",
    rules: &[
        &ing001::ING001,
        &ing002::ING002,
        &frm004::FRM004,
        &frm007::FRM007,
        &tim006::TIM006,
        &meta001::META001,
        &meta002::META002,
    ],
};
