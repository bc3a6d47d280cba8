//! Audits robot-arm pose logs.
#![warn(missing_docs)]

pub mod geometry;
pub mod stream;
pub mod time;
