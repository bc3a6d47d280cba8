//! Foundation of `poseaudit`, which re-exports these modules. A separate crate, so it is optimised and
//! compiled once.
#![warn(missing_docs, clippy::unwrap_used)]

pub mod boundary;
pub mod geometry;
pub mod robot;
pub mod stats;
pub mod stream;
pub mod time;
