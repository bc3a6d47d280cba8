//! Constant frame errors, tool switching and moving bases.

pub(crate) mod constant_frames;
pub(crate) mod moving_base;
pub(crate) mod position_fit;
pub(crate) mod rotation_frames;
pub(crate) mod tool_switching;
pub(crate) mod with_links;
