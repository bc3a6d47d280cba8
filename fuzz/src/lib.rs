//! The rooms of poseaudit that read logs, as the fuzz targets need them.

#[path = "../../src/boundary.rs"]
pub mod boundary;
#[path = "../../src/geometry/mod.rs"]
pub mod geometry;
#[path = "../../src/log/mod.rs"]
pub mod log;
#[path = "../../src/stats/mod.rs"]
pub mod stats;
#[path = "../../src/stream/mod.rs"]
pub mod stream;
#[path = "../../src/time.rs"]
pub mod time;
