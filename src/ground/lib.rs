//! The ground floor of `poseaudit`: poses and how they are coded, robots and their kinematics, columns and
//! their interpolation, intervals, stamps, and where the process ends.
//!
//! A crate of its own, so that it is compiled once and at a level of its own; the rooms are those of
//! `poseaudit` itself.
#![warn(missing_docs, clippy::unwrap_used)]

pub mod boundary;
pub mod geometry;
pub mod robot;
pub mod stats;
pub mod stream;
pub mod time;
