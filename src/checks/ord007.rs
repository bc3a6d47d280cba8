use crate::checks::{ArmFacts, DhFacts, Facts, Grade, Judged};
use crate::diagnosis::{DhEstimate, DhTold, Left};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// The DH table fits only under the other DH convention.
    ///
    /// ## What it means
    /// The rows a, d, α, θ of the robot's table are of the other convention than the table says:
    /// standard (Denavit and Hartenberg, Spong; a row turns about z first) or modified (Craig; about x
    /// first, with a and α of the row before). The same numbers are another arm under each.
    ///
    /// ## Why it matters
    /// Forward kinematics of such a table is wrong everywhere by decimetres, and looks plausible in
    /// the posture where all joints are at zero. Every other finding would be about the wrong arm. The
    /// audit therefore goes on with the convention that fits.
    ///
    /// ## Evidence
    /// `declared_m` and `declared_rad` are what the streams leave beyond their noise under the
    /// convention that the table says, with all that explains them taken off (null where they cannot be
    /// read at all); `other_m` and `other_rad` the same under the other one, `declared_faults` and
    /// `other_faults` how many faults that takes. The rule fires only where the other one leaves no more
    /// than a drawing leaves of a calibrated arm, and a tenth of what the declared one does at most.
    ///
    /// ## How to fix
    /// Correct `convention` in the table's `[dh]`; `audit --fix DIR` writes it so.
    ///
    /// ## When it misleads
    /// Where all axes are parallel and all links of one length the conventions differ by constant
    /// frames, and the rule says that either may be meant. A table of another arm fits under neither.
    ORD007 {
        name: "dh-convention",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "the model is no DH table",
        check: check,
    }
}

/// What would tell where neither convention does.
const SETTLE: &str = "move every joint, and check the table's rows";

fn check(facts: &Facts) -> Vec<Judged> {
    facts.robots.iter().filter_map(|arm| Some(judge(arm, arm.dh.as_ref()?))).collect()
}

fn judge(arm: &ArmFacts, facts: &DhFacts) -> Judged {
    let DhFacts { declared: convention, estimate } = facts;
    let DhEstimate { declared, other } = estimate;
    let (is, read_as) = (convention.other().name(), convention.name());
    let outcome = match (estimate.told(), other) {
        _ if arm.poses.is_empty() => {
            Outcome::Skipped("no pose stream to hold the DH table against".to_owned())
        }
        (DhTold::AsDeclared, _) => Outcome::sound(),
        (DhTold::Other, Some(other)) => Outcome::faulty(fault([is, read_as], declared, other)),
        (DhTold::Either, Some(other)) => Outcome::Inconclusive(format!(
            "the rows explain the streams as {read_as}, which leaves {}, and as {is}, which leaves {}; \
             see where the table comes from",
            left(declared),
            left(other)
        )),
        _ => Outcome::Inconclusive(format!(
            "the rows explain the streams under neither convention; {SETTLE}"
        )),
    };
    let is_found = other.is_some() && estimate.told() == DhTold::Other;
    let slip = is_found.then_some(Estimate::Slip { name: "DH convention", is, read_as });
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    let judged = Judged::new(arm.subject(), outcome)
        .within(arm.span)
        .estimated(slip)
        .with_evidence("declared_m", finite(declared.m))
        .with_evidence("declared_rad", finite(declared.rad))
        .with_evidence("declared_faults", declared.faults);
    match other {
        Some(other) => judged
            .with_evidence("other_m", finite(other.m))
            .with_evidence("other_rad", finite(other.rad))
            .with_evidence("other_faults", other.faults),
        None => judged,
    }
}

/// What is left and what it takes, in words.
fn left(left: &Left) -> String {
    let faults = match left.faults {
        0 => "no fault".to_owned(),
        1 => "1 fault".to_owned(),
        many => format!("{many} faults"),
    };
    format!("{} with {faults}", Unit::Metre.show(left.m))
}

fn fault([is, read_as]: [&'static str; 2], declared: &Left, other: &Left) -> Fault {
    let after = Unit::Metre.show(other.m);
    let message = match declared.m.is_finite() {
        true => format!(
            "the rows are of the {is} convention, not {read_as}: {} off as declared",
            Unit::Metre.show(declared.m)
        ),
        false => format!(
            "the rows are of the {is} convention, not {read_as}: they leave {after}, and as declared \
             nothing follows the arm"
        ),
    };
    Fault {
        severity: Severity::Error,
        title: "DH table of the other convention",
        message,
        evidence: Evidence {
            effect: Some(format!("{after} once read as {is}; the audit goes on with that")),
            effect_m: Some(declared.m).filter(|left_m| left_m.is_finite()),
            ..Evidence::default()
        },
        fix: format!("set convention = \"{is}\" in the table's [dh]"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run};
    use crate::finding::Status;

    fn judged(declared_m: f64, other_m: Option<f64>) -> (Status, String) {
        let mut facts = clean_run();
        let left = |m: f64| Left { m, rad: 0.0, faults: 2 };
        let other = other_m.map(|m| Left { faults: 0, ..left(m) });
        let dh = facts.robots[0].dh.as_mut().unwrap();
        dh.estimate = DhEstimate { declared: left(declared_m), other };
        let (rows, findings) = ask(&ORD007, &facts);
        let said = findings.first().map(|finding| finding.message.clone());
        (rows[0].status, said.or(rows[0].reason.clone()).unwrap_or_default())
    }

    #[test]
    fn a_table_is_blamed_only_where_the_other_convention_alone_explains() {
        let (status, said) = judged(0.3, Some(1e-5));
        assert_eq!(status, Status::Fail);
        assert!(said.contains("modified convention, not standard: 300 mm off"), "{said}");
        let (status, said) = judged(f64::INFINITY, Some(1e-3));
        assert_eq!(status, Status::Fail);
        assert!(said.contains("1 mm") && said.contains("nothing follows"), "{said}");
        assert_eq!(judged(1e-5, None).0, Status::Pass);
        let (status, said) = judged(1e-5, Some(1e-5));
        assert_eq!(status, Status::Inconclusive);
        assert!(said.contains("with 2 faults") && said.contains("with no fault"), "{said}");
        assert_eq!(judged(0.3, Some(0.3)).0, Status::Inconclusive);
    }
}
