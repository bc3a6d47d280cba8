pub(super) mod lat001_latency;
pub(super) mod lat002_clock_skew;
pub(super) mod lat003_unsteady_latency;

use self::lat001_latency::LAT001;
use super::decision::PASS_CONFIDENCE;
use super::{Case, Family, SubjectResult};
use crate::diagnosis::Measured;
use crate::evidence::{ArmEvidence, StampEvidence};
use crate::finding::Outcome;

pub(super) static FAMILY: Family = Family {
    examines: "Latency of each stream relative to the joint states, and how it varies",
    rules: &[&LAT001, &lat002_clock_skew::LAT002, &lat003_unsteady_latency::LAT003],
};

/// If the stamps are known less precisely than LAT001's threshold, no motion determines the latency: replaces the advice
/// `motion` of an inconclusive result by the correction of the stamps.
fn with_stamp_remedy(
    case: &Case,
    arm: &ArmEvidence,
    mut judged: SubjectResult,
    motion: &str,
) -> SubjectResult {
    let limit_s = case.thresholds.threshold(&LAT001, lat001_latency::THRESHOLD).warning;
    let Outcome::Inconclusive(why) = &mut judged.outcome else { return judged };
    let topics = [judged.subject.topic.as_deref(), Some(arm.joints_topic.as_str())];
    let mut stamps =
        case.evidence.stamps.iter().filter(|stream| topics.contains(&Some(stream.topic())));
    let remedy = stamps.find_map(|stream| stamp_remedy(stream, stream.topic(), limit_s));
    if let Some((reason, remedy)) = why.strip_suffix(motion).zip(remedy) {
        *why = format!("{reason}{remedy}");
    }
    judged
}

/// Correction of stamps that are uncertain by more than `limit_s`.
fn stamp_remedy(stamps: &StampEvidence, topic: &str, limit_s: f64) -> Option<String> {
    if let Some(aligned) = stamps.clock.alignment {
        let offset = Measured { value: 0.0, std_error: aligned.spread_s, dof: f64::INFINITY };
        if aligned.is_by_motion || offset.half_width(PASS_CONFIDENCE) > limit_s {
            return Some(format!(
                "{topic} is on another clock (TIM003); synchronise the clocks (chrony, PTP)"
            ));
        }
    }
    let rounded = stamps.rounded.as_ref()?;
    (rounded.resolution_s + 0.5 * rounded.tick_s > limit_s).then(|| {
        format!("the stamps of {topic} are rounded (TIM005); record them with full resolution")
    })
}
