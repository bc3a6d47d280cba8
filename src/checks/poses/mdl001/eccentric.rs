//! What is left and goes with the angle of a joint.

use crate::evidence::ArmEvidence;
use crate::finding::Unit;

/// The joints with whose angle goes what is left of an arm's streams, in a clause; empty where none is known.
pub(super) fn eccentricity(arm: &ArmEvidence) -> String {
    let eccentric = arm.diagnosis.bends.iter().filter(|bend| bend.is_eccentric());
    let clauses = eccentric.filter_map(|bend| {
        let joint = &arm.joints.get(bend.column)?.name;
        let amount = Unit::Radian.show(bend.amount.value);
        Some(format!("; it goes with the angle of {joint}: eccentric gear or encoder, ±{amount}"))
    });
    clauses.collect()
}
