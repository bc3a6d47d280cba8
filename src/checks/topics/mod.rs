//! Files, topics and frames: damaged, missing or unaudited data.

pub(super) mod frm004_broken_frame_tree;
pub(super) mod frm007_not_audited;
pub(super) mod ing001_damaged_log;
pub(super) mod ing002_undecodable_topic;
pub(super) mod meta001_contradicted_metadata;
pub(super) mod meta002_repeated_columns;
pub(super) mod tim006_incomplete_stream;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Files, topics and frames: damaged, missing or unaudited data",
    rules: &[
        &ing001_damaged_log::ING001,
        &ing002_undecodable_topic::ING002,
        &frm004_broken_frame_tree::FRM004,
        &frm007_not_audited::FRM007,
        &tim006_incomplete_stream::TIM006,
        &meta001_contradicted_metadata::META001,
        &meta002_repeated_columns::META002,
    ],
};
