//! Labels of the quantities that a motion shows.

use poseaudit::diagnosis::plan::{LimitKind, PlannedQuantity};
use poseaudit::finding::Unit;

use super::arm::Planning;
use super::setup::Asked;

pub struct Label {
    /// JSON key.
    pub name: &'static str,
    /// Without the joint or axis.
    pub said: String,
    /// Joint or axis.
    pub of: Option<String>,
    pub unit: Unit,
}

impl Label {
    pub fn of(planning: &Planning, asked: &Asked, shown: PlannedQuantity) -> Self {
        let joint = |joint: usize| Some(planning.chain.joint_names()[joint].clone());
        let axis = |axis: usize| Some(["x", "y", "z"][axis % 3].to_owned());
        let by_joint = |at: usize| if planning.slides(at) { Unit::Metre } else { Unit::Radian };
        let links = Unit::Metre.show(asked.sensing.link_m);
        let (name, said, of, unit) = match shown {
            PlannedQuantity::Zero(at) => {
                ("zero", "zero, exact nominal model".to_owned(), joint(at), by_joint(at))
            }
            PlannedQuantity::ZeroBesideLinks(at) => {
                let said = format!("zero, links deviate by {links}");
                ("zero_beside_links", said, joint(at), by_joint(at))
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
        Self { name, said, of, unit }
    }

    pub fn whole(&self) -> String {
        match &self.of {
            None => self.said.clone(),
            Some(of) if self.name.starts_with("zero") => format!("{of}: {}", self.said),
            Some(of) => format!("{} {of}", self.said),
        }
    }
}

pub fn bound(bound: LimitKind) -> &'static str {
    match bound {
        LimitKind::Lower | LimitKind::Upper => "position",
        LimitKind::Speed => "speed",
        LimitKind::Acceleration => "acceleration",
    }
}
