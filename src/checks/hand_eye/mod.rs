//! Hand-eye chains: camera, target and the hand that moves one.

mod chain;
pub(super) mod hec001_hand_eye_closure;
pub(super) mod hec002_hand_eye_rotation;
pub(super) mod hec003_camera_axes;

use super::Family;

pub(super) static FAMILY: Family = Family {
    examines: "Hand-eye chains: a camera, its target and the arm",
    rules: &[
        &hec001_hand_eye_closure::HEC001,
        &hec002_hand_eye_rotation::HEC002,
        &hec003_camera_axes::HEC003,
    ],
};
