//! Colours that mean the same in the scene, in the plots and in the text.

use re_sdk_types::components::Color;

/// The arm where it was.
pub const ARM: Color = rgb(0xD7, 0xDD, 0xE4);
/// The arm by the joint states as recorded.
pub const AS_RECORDED: Color = rgb(0x7A, 0x82, 0x8E);
/// A stream that is computed from the joint states.
pub const DERIVED: Color = rgb(0xA7, 0x7B, 0xF3);
/// The links of the arm between their joints.
pub const ERROR: Color = rgb(0xF2, 0x55, 0x4E);
/// A finding of severity warning.
pub const WARNING: Color = rgb(0xF2, 0xB1, 0x34);
/// A finding of severity info.
pub const INFO: Color = rgb(0x5A, 0xB4, 0xE6);

/// Streams as logged and as corrected; the first is by far the most frequent.
const STREAMS: [(Color, Color); 3] = [
    (rgb(0xF2, 0x55, 0x4E), rgb(0x3D, 0xD6, 0x8C)),
    (rgb(0xF2, 0xB1, 0x34), rgb(0x2F, 0xC4, 0xC4)),
    (rgb(0xF0, 0x76, 0xC0), rgb(0xA8, 0xD9, 0x3A)),
];
/// IMUs.
const IMUS: [Color; 3] = [rgb(0xF2, 0xB1, 0x34), rgb(0x5A, 0xB4, 0xE6), rgb(0xF0, 0x76, 0xC0)];

/// Colours of the `index`-th stream of an arm: as logged, and as corrected.
pub fn stream(index: usize) -> (Color, Color) {
    STREAMS[index % STREAMS.len()]
}

/// Colour of the `index`-th IMU of an arm.
pub fn imu(index: usize) -> Color {
    IMUS[index % IMUS.len()]
}

const fn rgb(red: u8, green: u8, blue: u8) -> Color {
    let rgba = u32::from_be_bytes([red, green, blue, 0xFF]);
    Color(re_sdk_types::datatypes::Rgba32(rgba))
}
