//! The columns of one topic: what decoders append to and everything above reads.
//!
//! A decoder appends rows as it meets them; [`Times::sort_permutation`] and the `sort_by` methods
//! then put a stream in the order of the clock that the audit uses. Nothing here knows what a topic
//! means or which file it came from. Rotations stay in the numbers that the log holds
//! (`_xyzw`, raw arrays); only `geometry` turns numbers into rotations.

mod columns;
mod tracks;

pub use columns::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns, Times,
    usable,
};
pub use tracks::{DeclaredUnits, ImuTrack, JointTrack, Orientations, PoseTrack, sample_noise};
