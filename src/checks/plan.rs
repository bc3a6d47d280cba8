//! Which motion would settle what a rule left open.

use super::poses::mdl001::MDL001;
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Status};

/// Whether a row is open for what MDL001 has left and nothing explains: no motion settles that.
pub(crate) fn is_behind_residual(row: &CheckRow) -> bool {
    let is_said = |reason: &String| reason.contains(&format!("({})", MDL001.code));
    row.status == Status::Inconclusive && row.reason.as_ref().is_some_and(is_said)
}

/// What a motion that shows this is made of.
pub(crate) const fn recipe(purpose: Purpose) -> &'static str {
    match purpose {
        Purpose::Zeros => {
            "each joint by 30° or more, one after another, the wrist by 60° about two axes, the arm \
             stretched out and folded"
        }
        Purpose::Calibration => "every joint moving, in postures over the whole workspace",
        Purpose::Latency => "starts and stops that do not repeat, faster than 0.2 rad/s",
        Purpose::HandEye => "the hand tilted by 30° or more about two axes, the target in view",
        Purpose::Yaw => "the IMU turned by 60° about two axes, and rests of 2 s",
    }
}

/// What the motion must show that would settle a row, where a motion of the arm would. `is_drawing`: the
/// arm's model is a drawing, of which single causes are told only once all links are calibrated.
pub(crate) fn settled_by(row: &CheckRow, is_drawing: bool) -> Option<Purpose> {
    if row.status != Status::Inconclusive || row.indistinguishable || is_behind_residual(row) {
        return None;
    }
    match row.code {
        "ZER001" | "ZER002" | "FRM002" | "FRM003" if is_drawing => Some(Purpose::Calibration),
        "MDL001" => Some(Purpose::Calibration),
        "ZER001" | "ZER002" | "ZER003" | "FRM001" | "FRM002" | "FRM003" => Some(Purpose::Zeros),
        "ORD001" | "ORD002" | "ORD003" | "ORD004" | "ORD005" | "ORD007" | "ORD008" => {
            Some(Purpose::Zeros)
        }
        "ORD009" | "ORD010" | "ORD011" | "MOT006" => Some(Purpose::Zeros),
        "LAT001" | "LAT002" | "LAT003" | "LAT004" | "VEL001" => Some(Purpose::Latency),
        "HEC001" | "HEC002" | "HEC003" => Some(Purpose::HandEye),
        "YAW001" | "YAW002" | "YAW003" | "YAW004" => Some(Purpose::Yaw),
        _ => None,
    }
}
