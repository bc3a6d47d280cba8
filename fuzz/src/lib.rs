//! The modules of poseaudit that read logs, for the fuzz targets.

pub use ground::{boundary, geometry, stats, stream, time};
pub use poseaudit_log as log;
