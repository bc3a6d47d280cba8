//! Shared by the rules on commands.

use serde_json::{Value, json};

use crate::checks::decision::not_observable;
use crate::checks::motion::mot003_limits_exceeded;
use crate::diagnosis::{CommandDiagnosis, CommandTracking, JointOffset};
use crate::evidence::ReferenceEvidence;
use crate::evidence::{ArmEvidence, StreamEvidence, TipPoseKind};
use crate::finding::Outcome;

/// Diagnosis of a command stream, or the rule's outcome.
pub fn reference_diagnosis<'a>(
    arm: &ArmEvidence,
    reference: &'a StreamEvidence<ReferenceEvidence>,
    settle: &str,
) -> Result<&'a CommandDiagnosis, Outcome> {
    let found = match &reference.diagnosis {
        Err(why) => return Err(Outcome::Skipped(why.clone())),
        Ok(found) => found.as_ref().map_err(|why| not_observable(why, settle))?,
    };
    match mot003_limits_exceeded::doubt(arm) {
        Some(why) => Err(Outcome::Inconclusive(why)),
        None => Ok(found),
    }
}

/// Whether a finding makes pose streams and FK differ.
pub fn is_fk_different(arm: &ArmEvidence) -> bool {
    let is_chosen = |offset: &JointOffset| offset.is_chosen;
    let differs = arm
        .poses
        .iter()
        .any(|stream| stream.diagnosis.is_nominal || stream.diagnosis.is_radial_scale_chosen);
    differs || arm.diagnosis.offsets.iter().any(is_chosen)
}

pub fn source_name(reference: &StreamEvidence<ReferenceEvidence>, index: usize) -> String {
    match reference.tip_poses.get(index) {
        Some(source) if source.kind == TipPoseKind::Corrected => {
            format!("{} as corrected", source.name)
        }
        Some(source) => source.name.clone(),
        None => String::new(),
    }
}

/// How the arm follows a streamed command; null for goals.
pub fn following_json(following: Option<&CommandTracking>) -> Value {
    let Some(following) = following else { return Value::Null };
    json!({
        "delay_s": following.delay_s,
        "correlation": following.correlation,
        "rms_m": following.rms.0,
        "rms_rad": following.rms.1,
        "left_m": following.compensated.0,
        "left_rad": following.compensated.1,
    })
}
