//! Chooses the motion that would resolve an inconclusive rule.

use super::poses::mdl001_unexplained_residual::MDL001;
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Status};

/// No motion resolves an unexplained residual (MDL001).
pub(crate) fn is_blocked_by_residual(row: &CheckRow) -> bool {
    let names_rule = |reason: &String| reason.contains(&format!("({})", MDL001.code));
    row.status == Status::Inconclusive && row.reason.as_ref().is_some_and(names_rule)
}

pub(crate) const fn motion_description(purpose: Purpose) -> &'static str {
    match purpose {
        Purpose::Zeros => {
            "each joint by 30° or more in turn, the wrist by 60° about two axes, the arm both stretched out \
             and folded"
        }
        Purpose::Calibration => "all joints moving, in configurations across the whole workspace",
        Purpose::Latency => "non-periodic starts and stops, faster than 0.2 rad/s",
        Purpose::HandEye => "the hand tilted by 30° or more about two axes, the target in view",
        Purpose::Yaw => "the IMU turned by 60° about two axes, with rests of 2 s",
    }
}

/// `None` if no arm motion would resolve the row. With a nominal model, single causes are observable only
/// after calibrating all links.
pub(crate) fn resolving_motion(row: &CheckRow, is_nominal: bool) -> Option<Purpose> {
    if row.status != Status::Inconclusive || row.is_indistinguishable || is_blocked_by_residual(row)
    {
        return None;
    }
    match row.code {
        "ZER001" | "ZER002" | "FRM002" | "FRM003" if is_nominal => Some(Purpose::Calibration),
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
