//! Encodings of a pose stream: units and axes of positions, conventions of rotations.

pub(crate) mod axis_convention;
pub(crate) mod decoded_stream;
pub(crate) mod orientation_samples;
pub(crate) mod position;
pub(crate) mod reinterpret;
pub(crate) mod rotation;
