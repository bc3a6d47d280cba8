//! Residual that varies with a joint's angle.

use crate::evidence::ArmEvidence;
use crate::finding::Unit;

/// May be empty.
pub(super) fn eccentricity(arm: &ArmEvidence) -> String {
    let eccentric = arm.diagnosis.compliance.iter().filter(|compliance| compliance.is_eccentric());
    let clauses = eccentric.filter_map(|compliance| {
        let joint = &arm.joints.get(compliance.column)?.name;
        let amount = Unit::Radian.show(compliance.value().value);
        Some(format!("; it varies with the angle of {joint}: eccentric gear or encoder, ±{amount}"))
    });
    clauses.collect()
}
