//! Columns of one topic, filled by decoders and read by all later stages.
//!
//! Decoders append rows as they arrive. Rotations stay as logged (`_xyzw`, raw arrays).

mod column;
mod columns;
mod encoder_tick;
mod times;
mod tracks;

pub use column::Column;
pub use columns::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns,
    is_usable, usable_or_nan,
};
pub use encoder_tick::{encoder_tick, is_whole};
pub use times::{SharedTimes, Times};
pub use tracks::{
    DeclaredUnits, ImuTrack, JointSequence, JointTrack, Orientations, PoseTrack, bracket,
    hermite_basis, sample_noise,
};
