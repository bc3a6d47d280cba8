//! Joint zero offsets and constant frames that have the same effect on a log.

use crate::diagnosis::{Confounder, Measured};
use crate::evidence::ArmEvidence;
use crate::finding::{Alternative, Estimate, Unit};

pub fn joint_zero_estimate(unit: Unit, offset: &Measured) -> Estimate {
    Estimate::scalar("joint zero offset", unit, offset)
}

/// `offset` is the one that would explain the log.
pub fn joint_zero_alternative(arm: &ArmEvidence, joint: usize, offset: f64) -> Alternative {
    let unit = arm.joint_unit(joint);
    let estimate = Estimate::exact("joint zero offset", unit.symbol(), offset);
    Alternative { code: "ZER001", subject: arm.joint(joint), estimate: Some(estimate) }
}

pub fn confounder_alternative(
    arm: &ArmEvidence,
    confounder: &Confounder,
    unit: Unit,
) -> Alternative {
    let topic = |stream: usize| arm.poses.get(stream).map_or("", |stream| stream.topic());
    let (code, subject, name, value, unit) = match *confounder {
        Confounder::JointZero(joint, value) => {
            ("ZER001", arm.joint(joint), "joint zero offset", value, arm.joint_unit(joint))
        }
        Confounder::Reference(stream, value) => {
            ("FRM002", arm.topic(topic(stream)), "reference frame", value, unit)
        }
        Confounder::Tool(stream, value) => {
            ("FRM003", arm.topic(topic(stream)), "tool frame", value, unit)
        }
        Confounder::Sag(joint, value) => ("ZER003", arm.joint(joint), "sag", value, unit),
    };
    let estimate = Estimate::exact(name, unit.symbol(), value);
    Alternative { code, subject, estimate: Some(estimate) }
}
