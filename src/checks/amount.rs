//! What LAT002 and ZER002 share: an amount that is estimated on every stream, and that is a fault
//! only where the smallest explanation needs it.

use crate::checks::decision::{Decision, Threshold, decide, unseen};
use crate::checks::{Case, Judged, Rule};
use crate::diagnosis::{Measured, Seen};
use crate::evidence::{ArmEvidence, Of};
use crate::finding::{Estimate, Fault, Outcome, Severity};

/// An amount, and how its rule words it.
pub struct Amount {
    /// Name of the estimate.
    pub name: &'static str,
    /// From where it matters.
    pub threshold: Threshold,
    /// What would tell where it could not be had.
    pub settle: &'static str,
    /// The fault.
    pub fault: fn(&ArmEvidence, &Of<Estimated<'_>>, &Measured, Severity) -> Fault,
}

/// What is known of an amount on one stream.
pub struct Estimated<'a> {
    /// The amount.
    pub estimate: &'a Seen<Measured>,
    /// Whether the smallest explanation contains it.
    pub is_chosen: bool,
    /// Why it cannot be believed here, where it cannot.
    pub doubt: Option<String>,
}

impl Amount {
    /// Judges the amount on one stream of `arm` for `rule`.
    pub fn judge(
        &self,
        rule: &Rule,
        case: &Case,
        arm: &ArmEvidence,
        on: &Of<Estimated<'_>>,
    ) -> Judged {
        let (threshold, subjects) =
            (case.thresholds.of(rule, self.threshold), case.evidence.subjects());
        let settle = self.settle;
        let found = match on.estimate {
            Ok(found) => found,
            Err(why) => return on.judged(unseen(why, settle)),
        };
        let open = |why: String| Outcome::Inconclusive(format!("{why}; {settle}"));
        let outcome = match (decide(found, &threshold, subjects), &on.doubt) {
            (Decision::Pass, _) => Outcome::sound(),
            (Decision::Undecided(why), _) => open(why),
            (Decision::Fail(_), Some(why)) => Outcome::Inconclusive(why.clone()),
            (Decision::Fail(severity), None) if on.is_chosen => {
                Outcome::faulty((self.fault)(arm, on, found, severity))
            }
            (Decision::Fail(_), None) => {
                let shown = self.threshold.unit.show_signed(found);
                open(format!("{shown} would fit, but what is found explains the log without it"))
            }
        };
        let estimate = Estimate::amount(self.name, self.threshold.unit, found);
        on.judged(outcome).estimated(estimate)
    }
}
