//! Shared by LAT002 and ZER002: a scalar per stream, a fault only if the selected model contains it.

use crate::checks::decision::{Decision, Threshold, decide, not_observable};
use crate::checks::{Case, Rule, SubjectResult};
use crate::diagnosis::{EstimateResult, Measured};
use crate::evidence::{ArmEvidence, StreamEvidence};
use crate::finding::{Estimate, Fault, Outcome, Severity};

pub struct ScalarRule {
    /// Name of the estimate.
    pub name: &'static str,
    pub threshold: Threshold,
    /// Motion or topic that would make it observable.
    pub settle: &'static str,
    pub fault: fn(&ArmEvidence, &StreamEvidence<StreamEstimate<'_>>, &Measured, Severity) -> Fault,
}

pub struct StreamEstimate<'a> {
    pub estimate: &'a EstimateResult<Measured>,
    /// Whether the selected model contains it.
    pub is_chosen: bool,
    /// Why the estimate is unreliable.
    pub doubt: Option<String>,
}

impl ScalarRule {
    pub fn judge(
        &self,
        rule: &Rule,
        case: &Case,
        arm: &ArmEvidence,
        on: &StreamEvidence<StreamEstimate<'_>>,
    ) -> SubjectResult {
        let (threshold, subjects) =
            (case.thresholds.threshold(rule, self.threshold), case.evidence.subjects());
        let settle = self.settle;
        let found = match on.estimate {
            Ok(found) => found,
            Err(why) => return on.judged(not_observable(why, settle)),
        };
        let open = |why: String| Outcome::Inconclusive(format!("{why}; {settle}"));
        let outcome = match (decide(found, &threshold, subjects), &on.doubt) {
            (Decision::Pass, _) => Outcome::pass(),
            (Decision::Undecided(why), _) => open(why),
            (Decision::Fail(_), Some(why)) => Outcome::Inconclusive(why.clone()),
            (Decision::Fail(severity), None) if on.is_chosen => {
                Outcome::fail((self.fault)(arm, on, found, severity))
            }
            (Decision::Fail(_), None) => {
                let shown = self.threshold.unit.show_signed(found);
                open(format!("{shown} would fit, but the reported causes already explain the log"))
            }
        };
        let estimate = Estimate::scalar(self.name, self.threshold.unit, found);
        on.judged(outcome).estimated(estimate)
    }
}
