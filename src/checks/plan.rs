//! Which motion would settle what a rule left open.

use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Status};

/// What the motion must show that would settle a row, where a motion of the arm would. `is_drawing`: the
/// arm's model is a drawing, of which single causes are told only once all links are calibrated.
pub(crate) fn settled_by(row: &CheckRow, is_drawing: bool) -> Option<Purpose> {
    if row.status != Status::Inconclusive || row.indistinguishable {
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
