//! Foundation of `poseaudit`: poses and encodings, robots and kinematics, columns and interpolation,
//! intervals, stamps, and process termination.
//!
//! A separate crate with its own optimisation level, so it is compiled once. Its modules are re-exported by
//! `poseaudit`.
#![warn(missing_docs, clippy::unwrap_used)]

pub mod boundary;
pub mod geometry;
pub mod robot;
pub mod stats;
pub mod stream;
pub mod time;
