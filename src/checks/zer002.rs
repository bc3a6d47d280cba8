use crate::checks::decision::{Decision, Figure, decide, unseen};
use crate::checks::{ArmFacts, Facts, Grade, Judged, PoseFacts};
use crate::diagnosis::{Measured, PoseDiagnosis};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// The position error grows with reach, and no joint offset explains it.
    ///
    /// ## What it means
    /// The logged positions are too far from the base's origin, or too near, by a share of their
    /// distance: positive where they are logged too far out.
    ///
    /// ## Why it matters
    /// At 1 % an arm of 0.85 m misses by 8.5 mm when it is stretched out and by nothing near its
    /// base, which looks like a bent joint and is a scale.
    ///
    /// ## Evidence
    /// The radial scale of the logged over the recomputed position, from the base's origin,
    /// minus 1, estimated together with everything else; it is named only where the joints' zeros
    /// and the frames do not explain the log without it.
    ///
    /// ## How to fix
    /// Look for a unit or scale factor in the driver, and for a description of another size or
    /// variant of the arm.
    ///
    /// ## When it misleads
    /// Links that are all 1 % too long in the description do the same. A tracker with a wrong scale
    /// does it too: then the arm is right.
    ZER002 {
        name: "growth-with-reach",
        grade: Grade::From(&[FIGURE]),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

const FIGURE: Figure = Figure { unit: Unit::MetrePerMetre, warning: 1e-3, error: 5e-3 };

/// What would tell where the growth could not be had.
const SETTLE: &str = "reach far out and close in, with every joint moving";

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    facts
        .poses()
        .map(|(arm, stream, diagnosis)| judge(arm, stream, diagnosis, subjects))
        .collect()
}

fn judge(arm: &ArmFacts, stream: &PoseFacts, diagnosis: &PoseDiagnosis, subjects: usize) -> Judged {
    let subject = arm.topic(&stream.topic);
    let growth = match &diagnosis.growth {
        Ok(growth) => growth,
        Err(why) => return Judged::new(subject, unseen(why, SETTLE)).within(stream.span),
    };
    let outcome = match decide(growth, &FIGURE, subjects) {
        Decision::Pass => Outcome::sound(),
        Decision::Fail(_) if diagnosis.repeats() => {
            Outcome::Inconclusive(format!("it rests on a latency that fits at several lags; {SETTLE}"))
        }
        Decision::Fail(severity) if diagnosis.growth_chosen => {
            Outcome::faulty(fault(arm, growth, severity))
        }
        Decision::Fail(_) => {
            let shown = FIGURE.unit.show_signed(growth);
            let why = format!("{shown} would fit, but what is found explains the log without it");
            Outcome::Inconclusive(format!("{why}; {SETTLE}"))
        }
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
    };
    let estimate = Estimate::amount("growth with reach", FIGURE.unit, growth);
    Judged::new(subject, outcome).within(stream.span).estimated(estimate)
}

fn fault(arm: &ArmFacts, growth: &Measured, severity: Severity) -> Fault {
    let (reach, moved_m) = (arm.reach_m, growth.value.abs() * arm.reach_m);
    let moved = Unit::Metre.show(moved_m);
    Fault {
        severity,
        title: "error grows with reach",
        message: format!("positions are off by {} of reach", FIGURE.unit.show_signed(growth)),
        evidence: Evidence {
            effect: Some(format!("{moved} at full reach ({reach:.2} m)")),
            effect_m: Some(moved_m),
            ..Evidence::default()
        },
        fix: format!(
            "look for a scale of {:.4} in the driver, or for a description of another size",
            1.0 + growth.value
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, sure};

    #[test]
    fn a_growth_that_is_chosen_is_a_finding_with_its_effect_at_reach() {
        let mut facts = clean_run();
        let stream = &mut facts.robots[0].diagnosis.streams[0];
        (stream.growth, stream.growth_chosen) = (Ok(sure(0.01)), true);
        let (_, findings) = ask(&ZER002, &facts);
        assert_eq!(findings[0].evidence.effect.as_deref(), Some("8.5 mm at full reach (0.85 m)"));
        assert_eq!(findings[0].severity, Severity::Error);
    }
}
