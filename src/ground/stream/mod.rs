//! Columns of one topic, filled by decoders and read by all later stages.
//!
//! A decoder appends rows as they arrive. [`Times::sort_permutation`] and the `sort_by` methods then sort a
//! stream by the clock that the audit uses. Nothing here knows the meaning of a topic or its file.
//! Rotations stay as logged (`_xyzw`, raw arrays); only `geometry` converts numbers to rotations.

mod columns;
mod tracks;

pub use columns::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns, Times,
    is_usable,
};
pub use tracks::{DeclaredUnits, ImuTrack, JointTrack, Orientations, PoseTrack, sample_noise};
