//! Residual that varies with a joint's angle.

use crate::evidence::ArmEvidence;
use crate::finding::Unit;

/// May be empty.
pub(super) fn eccentricity(arm: &ArmEvidence) -> String {
    let eccentric = arm.diagnosis.compliance.iter().filter(|bend| bend.is_eccentric());
    let clauses = eccentric.filter_map(|bend| {
        let joint = &arm.joints.get(bend.column)?.name;
        let amount = Unit::Radian.show(bend.value.value);
        Some(format!("; it varies with the angle of {joint}: eccentric gear or encoder, ±{amount}"))
    });
    clauses.collect()
}
