//! The pose desk: one pose as a person has it, in every convention; and what makes two poses agree.
//!
//! [`paste()`] takes a text apart, [`sheet()`] says one pose in every convention with those who use each,
//! and [`reconcile()`] ranks what makes pairs of poses one.

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
