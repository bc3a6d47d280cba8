//! Chooses the motion that would resolve an inconclusive rule.

use super::decision::BLOCKED;
use super::poses::mdl001_unexplained_residual::{self, MDL001};
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Status};

/// No motion resolves an unexplained residual (MDL001).
pub(crate) fn is_blocked_by_residual(row: &CheckRow) -> bool {
    let names_rule = |reason: &String| reason.contains(&format!("({})", MDL001.code));
    row.status == Status::Inconclusive && row.reason.as_ref().is_some_and(names_rule)
}

/// Whether another check, or a fault of the stamps, must be resolved first, whatever the motion.
fn is_blocked(row: &CheckRow) -> bool {
    let reason = row.reason.as_deref().unwrap_or_default();
    is_blocked_by_residual(row) || reason.starts_with(BLOCKED) || reason.contains("(TIM")
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
    if row.status != Status::Inconclusive || row.is_indistinguishable || is_blocked(row) {
        return None;
    }
    match row.code {
        "ZER001" | "ZER002" | "FRM002" | "FRM003" if is_nominal => Some(Purpose::Calibration),
        "MDL001" => mdl001_unexplained_residual::resolving_motion(row.reason.as_deref()?),
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

#[cfg(test)]
mod tests {
    use serde_json::Map;

    use super::*;
    use crate::finding::Subject;

    #[test]
    fn no_motion_is_proposed_if_another_check_a_pose_or_a_clock_resolves_the_row() {
        let motion_of = |code: &'static str, reason: &str| {
            let reason = Some(reason.to_owned());
            let row = CheckRow {
                code,
                name: "",
                subject: Subject::default(),
                status: Status::Inconclusive,
                reason,
                estimate: None,
                evidence: Map::default(),
                is_indistinguishable: false,
                is_exempt: false,
            };
            resolving_motion(&row, false)
        };
        let reasons = [
            ("ORD009", "blocked: a pose of the tool must be known first; also log a pose"),
            ("YAW002", "blocked: its accelerations contain no gravity; publish the specific force"),
            (
                "LAT001",
                "uncertainty ±9 ms; /pose is on another clock (TIM003); synchronise the clocks",
            ),
            ("MDL001", "nothing in this log can be compared; record the tool's pose"),
            ("MDL001", "its possible causes are undetermined: LAT001; resolve these first"),
        ];
        for (code, reason) in reasons {
            assert_eq!(motion_of(code, reason), None, "{code}: {reason}");
        }
        let open = "uncertainty ±0.2° exceeds the limit of ±0.1°; move each joint by 30° or more";
        assert_eq!(motion_of("ZER001", open), Some(Purpose::Zeros));
        let at_rest = "off by 3 mm at rest; record 10 s in which every joint moves";
        assert_eq!(motion_of("MDL001", at_rest), Some(Purpose::Calibration));
    }
}
