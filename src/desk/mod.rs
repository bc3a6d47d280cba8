//! Pose desk: [`sheet()`] shows a pose in every convention; [`reconcile()`] explains the difference of two
//! poses.

mod answer;
mod error;
mod fit;
mod form;
mod frames;
mod json;
mod labelled;
mod pairs;
mod paste;
mod reconcile;
mod search;
mod sheet;
mod text;

#[cfg(test)]
mod tests;

pub use answer::{Answer, End, Hypothesis, Inversion, Residual, Verdict, WouldDo};
pub use error::DeskError;
pub use form::{Reading, Style};
pub use frames::{Corrections, FixedFrame, FrameNames, World};
pub use json::{answer_as_json, sheets_as_json};
pub use pairs::{Pair, pairs_from_csv};
pub use paste::{Pasted, paste};
pub use reconcile::{Question, reconcile};
pub use sheet::{Candidate, Row, Sheet, Sheets, sheet};
pub use text::{write_answer, write_sheets};
