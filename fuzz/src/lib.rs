//! The rooms of poseaudit that read logs, as the fuzz targets need them.

pub use ground::{boundary, geometry, stats, stream, time};
pub use poseaudit_log as log;
