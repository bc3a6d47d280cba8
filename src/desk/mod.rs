//! The pose desk: one pose as a person has it, in every convention; and what makes two poses agree.
//!
//! [`paste()`] takes a text apart, [`sheet()`] says one pose in every convention with those who use each,
//! and [`reconcile()`] ranks what makes pairs of poses one. Facts about makers and libraries are in
//! `conventions.toml`.

mod error;
mod form;
mod frames;
mod pairs;
mod paste;
mod reconcile;
mod sheet;
mod usage;

#[cfg(test)]
mod tests;

pub use crate::geometry::{AngleUnit, LengthUnit};
pub use error::DeskError;
pub use form::{Form, Reading, Style};
pub use frames::{Corrections, FixedFrame, FrameNames};
pub use pairs::{Pair, pairs_from_csv};
pub use paste::{Pasted, paste};
pub use reconcile::{
    Answer, Hypothesis, Inversion, Question, Residual, Tool, Verdict, WouldDo, reconcile,
};
pub use sheet::{Candidate, Row, Sheet, Sheets, sheet};
pub use usage::{LibraryName, Use, library_names, maker, maker_names, uses, uses_of};
