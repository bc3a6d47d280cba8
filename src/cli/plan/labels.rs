//! Labels of the quantities that a motion shows.

use poseaudit::diagnosis::plan::{LimitKind, PlannedQuantity};
use poseaudit::finding::Unit;

use super::arm::PlannedArm;
use super::setup::PlanTask;

pub struct QuantityLabel {
    /// JSON key.
    pub key: &'static str,
    /// Label without the joint or axis.
    pub text: String,
    /// Joint or axis.
    pub axis_or_joint: Option<String>,
    pub unit: Unit,
}

impl QuantityLabel {
    pub fn new(arm: &PlannedArm, task: &PlanTask, quantity: PlannedQuantity) -> Self {
        let joint = |joint: usize| Some(arm.chain.joint_names()[joint].clone());
        let axis = |axis: usize| Some(["x", "y", "z"][axis % 3].to_owned());
        let by_joint = |at: usize| if arm.is_prismatic(at) { Unit::Metre } else { Unit::Radian };
        let links = match task.sensing.link_m {
            0.0 => "exact nominal model".to_owned(),
            link_m => format!("links deviate by {}", Unit::Metre.show(link_m)),
        };
        let (key, text, axis_or_joint, unit) = match quantity {
            PlannedQuantity::Zero(at) => {
                ("zero", format!("zero, {links}"), joint(at), by_joint(at))
            }
            PlannedQuantity::ZeroAlone(at) => {
                let text = format!("zero, {links}, the others are right");
                ("zero_alone", text, joint(at), by_joint(at))
            }
            PlannedQuantity::FkPosition { everywhere: false } => (
                "fk_position_here",
                "tip position where it moves, rms".to_owned(),
                None,
                Unit::Metre,
            ),
            PlannedQuantity::FkPosition { everywhere: true } => (
                "fk_position_everywhere",
                "tip position everywhere, rms".to_owned(),
                None,
                Unit::Metre,
            ),
            PlannedQuantity::FkRotation { everywhere: false } => (
                "fk_rotation_here",
                "tip rotation where it moves, rms".to_owned(),
                None,
                Unit::Radian,
            ),
            PlannedQuantity::FkRotation { everywhere: true } => (
                "fk_rotation_everywhere",
                "tip rotation everywhere, rms".to_owned(),
                None,
                Unit::Radian,
            ),
            PlannedQuantity::Latency => ("latency", "latency".to_owned(), None, Unit::Second),
            PlannedQuantity::CameraShift(at) => {
                ("camera_position", "camera's position along".to_owned(), axis(at), Unit::Metre)
            }
            PlannedQuantity::CameraTurn(at) => {
                ("camera_rotation", "camera's rotation about".to_owned(), axis(at), Unit::Radian)
            }
            PlannedQuantity::YawDrift => {
                ("yaw_drift", "yaw drift".to_owned(), None, Unit::RadianPerSecond)
            }
            PlannedQuantity::Tilt(at) => ("tilt", "tilt about".to_owned(), axis(at), Unit::Radian),
        };
        Self { key, text, axis_or_joint, unit }
    }

    pub fn full_text(&self) -> String {
        match &self.axis_or_joint {
            None => self.text.clone(),
            Some(axis_or_joint) if self.key.starts_with("zero") => {
                format!("{axis_or_joint}: {}", self.text)
            }
            Some(axis_or_joint) => format!("{} {axis_or_joint}", self.text),
        }
    }
}

pub fn limit_name(bound: LimitKind) -> &'static str {
    match bound {
        LimitKind::Lower | LimitKind::Upper => "position",
        LimitKind::Speed => "speed",
        LimitKind::Acceleration => "acceleration",
    }
}
