//! Pose desk: [`convert()`] shows a pose in every convention; [`reconcile()`] explains the difference of two
//! poses.

mod conversions;
mod encoding;
mod error;
mod fit_offsets;
mod fixed_frames;
mod json;
mod labelled_numbers;
mod pairs;
mod parse;
mod reconcile;
mod reconciliation;
mod search;
mod text;

#[cfg(test)]
mod tests;

pub use conversions::{
    ConventionRow, ConversionCandidate, ConversionResult, PoseConversions, convert,
};
pub use encoding::{KnownEncoding, NumberEncoding};
pub use error::DeskError;
pub use fixed_frames::{FixedFrame, FrameCandidates, FrameNames, World};
pub use json::{conversions_as_json, reconciliation_as_json};
pub use pairs::{Pair, pairs_from_csv};
pub use parse::{PoseText, parse_pose};
pub use reconcile::{ReconcileInput, reconcile};
pub use reconciliation::{
    EndTransform, Hypothesis, Inversion, ReconcileVerdict, Reconciliation, Residual,
    SinglePairOffsets,
};
pub use text::{write_candidates, write_conversions, write_reconciliation};
