use serde_json::json;

use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{DhComparison, DhConventionResult, DhStreamResiduals};
use crate::evidence::{ArmEvidence, DhEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::robot::DhConvention;

rule! {
    /// The DH table fits only under the other DH convention.
    ///
    /// ## What it means
    /// The table's rows a, d, α, θ are not in the declared convention but in the other: standard (Denavit
    /// and Hartenberg, Spong; a row rotates about z first) or modified (Craig; about x first, with a and α
    /// of the previous row).
    ///
    /// ## Why it matters
    /// FK is wrong by decimetres, but plausible with all joints at zero. All other rules use the convention
    /// that fits.
    ///
    /// ## Evidence
    /// `streams` has each stream's residuals beyond the noise, after correcting all causes; null if it
    /// cannot be interpreted:
    ///
    /// - `declared_m`, `declared_rad`: under the declared convention; `other_m`, `other_rad`: under the
    ///   other.
    /// - `declared_positions_m`: distance of its positions from the arm as declared.
    ///
    /// `declared_faults` and `other_faults` count the causes needed. The rule requires that a stream's
    /// residual under the other convention is typical of a nominal model of a calibrated arm. It must also be
    /// at most a tenth of the declared one's, and no stream may contradict this.
    ///
    /// ## How to fix
    /// Correct `convention` in the table's `[dh]`; `audit --fix DIR` writes the corrected table.
    ///
    /// ## When it misleads
    /// If all axes are parallel and all links equally long, the conventions differ by constant frames:
    /// inconclusive. The table of a different arm fits neither.
    ORD007 {
        name: "dh-convention",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "DH convention: the model is a URDF",
        check: check,
    }
}

const SETTLE: &str = "move every joint, and check the table's rows";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.robots.iter().filter_map(|arm| Some(judge(arm, arm.dh.as_ref()?))).collect()
}

fn judge(arm: &ArmEvidence, facts: &DhEvidence) -> SubjectResult {
    let DhEvidence { declared: convention, estimate } = facts;
    let (is, read_as) = (convention.other().name(), convention.name());
    let result = estimate.convention();
    let outcome = match result {
        _ if arm.poses.is_empty() => {
            Outcome::Skipped("no pose stream to compare with the DH table".to_owned())
        }
        DhConventionResult::AsDeclared => Outcome::pass(),
        DhConventionResult::Other => Outcome::fail(fault(convention.other(), estimate)),
        DhConventionResult::Either => Outcome::Inconclusive(format!(
            "the table fits the streams both as {read_as} (with {}) and as {is} (with {}); check the source \
             of the table",
            faults(estimate.declared_faults),
            faults(estimate.other_faults),
        )),
        DhConventionResult::Neither => Outcome::Inconclusive(format!(
            "the table fits the streams under neither convention; {SETTLE}"
        )),
    };
    let error = (result == DhConventionResult::Other)
        .then_some(Estimate::misinterpretation("DH convention", is, read_as));
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    let streams = arm.poses.iter().zip(&estimate.streams).map(|(facts, stream)| {
        json!({
            "topic": facts.topic(),
            "declared_m": finite(stream.declared.m),
            "declared_rad": finite(stream.declared.rad),
            "declared_positions_m": stream.declared_positions_m,
            "other_m": stream.other.and_then(|other| finite(other.m)),
            "other_rad": stream.other.and_then(|other| finite(other.rad)),
        })
    });
    let judged = SubjectResult::new(arm.subject(), outcome)
        .within(arm.span)
        .estimated(error)
        .with_evidence("streams", streams.collect::<Vec<_>>())
        .with_evidence("declared_faults", estimate.declared_faults);
    match estimate.streams.iter().any(|stream| stream.other.is_some()) {
        true => judged.with_evidence("other_faults", estimate.other_faults),
        false => judged,
    }
}

fn faults(count: usize) -> String {
    match count {
        0 => "no fault".to_owned(),
        1 => "1 fault".to_owned(),
        many => format!("{many} faults"),
    }
}

fn fault(convention: DhConvention, estimate: &DhComparison) -> Fault {
    let (is, read_as) = (convention.name(), convention.other().name());
    let speaking = || estimate.streams.iter().filter(|stream| stream.supports_other());
    let error = |stream: &DhStreamResiduals| match stream.declared.m.is_finite() {
        true => Some(stream.declared.m),
        false => stream.declared_positions_m,
    };
    let error_m = speaking().filter_map(error).reduce(f64::max);
    let after_m = speaking().filter_map(|stream| Some(stream.other?.m)).fold(0.0, f64::max);
    let after = Unit::Metre.show(after_m);
    let message = match error_m {
        Some(error_m) => format!(
            "the table is in the {is} convention, not {read_as}: {} off as declared",
            Unit::Metre.show(error_m)
        ),
        None => format!(
            "the table is in the {is} convention, not {read_as}: residual {after} once corrected"
        ),
    };
    Fault {
        severity: Severity::Error,
        cause: Cause::DhConvention(convention),
        title: "DH table in the other convention",
        message,
        evidence: Evidence {
            effect: Some(format!("{after} once read as {is}; all other rules use this")),
            effect_m: error_m,
            ..Evidence::default()
        },
        fix: format!("set convention = \"{is}\" in the table's [dh]"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::diagnosis::DhResidual;
    use crate::finding::Status;

    fn judged(declared_m: f64, other_m: Option<f64>) -> (Status, String) {
        let mut run = clean_run();
        let left = |m: f64| DhResidual { m, rad: 0.0 };
        let dh = run.robots[0].dh.as_mut().unwrap();
        dh.estimate.streams[0] = DhStreamResiduals {
            declared: left(declared_m),
            declared_positions_m: Some(0.25),
            other: other_m.map(left),
        };
        dh.estimate.declared_faults = 2;
        let (rows, findings) = evaluate_rule(&ORD007, &run);
        let said = findings.first().map(|finding| finding.message.clone());
        (rows[0].status, said.or(rows[0].reason.clone()).unwrap_or_default())
    }

    #[test]
    fn a_dh_table_is_blamed_only_if_only_the_other_convention_fits() {
        let (status, said) = judged(0.3, Some(1e-5));
        assert_eq!(status, Status::Fail);
        assert!(said.contains("modified convention, not standard: 300 mm off"), "{said}");
        let (status, said) = judged(f64::INFINITY, Some(1e-3));
        assert_eq!(status, Status::Fail);
        assert!(said.contains("250 mm off as declared"), "{said}");
        assert_eq!(judged(1e-5, None).0, Status::Pass);
        let (status, said) = judged(1e-5, Some(1e-5));
        assert_eq!(status, Status::Inconclusive);
        assert!(said.contains("with 2 faults") && said.contains("with no fault"), "{said}");
        assert_eq!(judged(0.3, Some(0.3)).0, Status::Inconclusive);
    }
}
