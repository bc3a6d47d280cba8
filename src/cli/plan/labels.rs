//! Labels of the quantities that a motion shows.

use poseaudit::diagnosis::plan::{Bound, Showable};
use poseaudit::finding::Unit;

use super::arm::Planning;
use super::setup::Asked;

/// Label of a quantity.
pub struct Label {
    /// Key in JSON.
    pub name: &'static str,
    /// Text for people, without the joint or axis.
    pub said: String,
    /// The joint or the axis.
    pub of: Option<String>,
    pub unit: Unit,
}

impl Label {
    pub fn of(planning: &Planning, asked: &Asked, shown: Showable) -> Self {
        let joint = |joint: usize| Some(planning.chain.joint_names()[joint].clone());
        let axis = |axis: usize| Some(["x", "y", "z"][axis % 3].to_owned());
        let by_joint = |at: usize| if planning.slides(at) { Unit::Metre } else { Unit::Radian };
        let links = Unit::Metre.show(asked.sensing.link_m);
        let (name, said, of, unit) = match shown {
            Showable::Zero(at) => {
                ("zero", "zero, exact nominal model".to_owned(), joint(at), by_joint(at))
            }
            Showable::ZeroBesideLinks(at) => {
                let said = format!("zero, links deviate by {links}");
                ("zero_beside_links", said, joint(at), by_joint(at))
            }
            Showable::FkPosition { everywhere: false } => (
                "fk_position_here",
                "tip position where it moves, rms".to_owned(),
                None,
                Unit::Metre,
            ),
            Showable::FkPosition { everywhere: true } => (
                "fk_position_everywhere",
                "tip position everywhere, rms".to_owned(),
                None,
                Unit::Metre,
            ),
            Showable::FkRotation { everywhere: false } => (
                "fk_rotation_here",
                "tip rotation where it moves, rms".to_owned(),
                None,
                Unit::Radian,
            ),
            Showable::FkRotation { everywhere: true } => (
                "fk_rotation_everywhere",
                "tip rotation everywhere, rms".to_owned(),
                None,
                Unit::Radian,
            ),
            Showable::Latency => ("latency", "latency".to_owned(), None, Unit::Second),
            Showable::CameraShift(at) => {
                ("camera_position", "camera's position along".to_owned(), axis(at), Unit::Metre)
            }
            Showable::CameraTurn(at) => {
                ("camera_rotation", "camera's rotation about".to_owned(), axis(at), Unit::Radian)
            }
            Showable::YawDrift => {
                ("yaw_drift", "yaw drift".to_owned(), None, Unit::RadianPerSecond)
            }
            Showable::Tilt(at) => ("tilt", "tilt about".to_owned(), axis(at), Unit::Radian),
        };
        Self { name, said, of, unit }
    }

    /// The whole label as one text.
    pub fn whole(&self) -> String {
        match &self.of {
            None => self.said.clone(),
            Some(of) if self.name.starts_with("zero") => format!("{of}: {}", self.said),
            Some(of) => format!("{} {of}", self.said),
        }
    }
}

/// The limited quantity, in text and JSON.
pub fn bound(bound: Bound) -> &'static str {
    match bound {
        Bound::Lower | Bound::Upper => "position",
        Bound::Speed => "speed",
        Bound::Acceleration => "acceleration",
    }
}
