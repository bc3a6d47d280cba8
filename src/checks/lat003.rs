use serde_json::{Value, json};

use crate::checks::decision::{Decision, Figure, decide, unseen};
use crate::checks::{ArmFacts, Facts, Grade, Judged, PoseFacts};
use crate::diagnosis::{LatencyCourse, PoseDiagnosis};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// The latency of a stream jumps or wanders within the run.
    ///
    /// ## What it means
    /// The stream is not late by one amount: from some moment on it is later or earlier than before,
    /// or its latency goes up and down. A clock that is set, a queue that fills, a network that is
    /// busy, stamps that are made on receipt do that.
    ///
    /// ## Why it matters
    /// No single number takes such a latency off: what was calibrated in the morning is wrong after
    /// the jump, and poses scatter by speed times jump.
    ///
    /// ## Evidence
    /// The latency in windows of a second, from how the stream lies behind forward kinematics along
    /// the motion. The estimate is the largest jump (positive where the stream is later from then
    /// on), or from least to most where it wanders; `jumps` says when each was. The other rules judge
    /// the stream with this taken off, at the latency that it has longest.
    ///
    /// ## How to fix
    /// Stamp a sample when it is taken. Slew clocks instead of setting them, and look at what began
    /// on the machine or the network at the moment of a jump.
    ///
    /// ## When it misleads
    /// A latency that grows steadily is LAT002. Where all streams of an arm jump at one moment, it is
    /// the joint states that did. At rest a latency does nothing, so a jump is dated to the next
    /// motion.
    LAT003 {
        name: "unsteady-latency",
        grade: Grade::From(&[FIGURE]),
        headline: false,
        needs_model: true,
        missing: "no pose or /tf stream beside the joint states",
        check: check,
    }
}

const FIGURE: Figure = Figure { unit: Unit::Second, warning: 5e-3, error: 20e-3 };

/// What would tell where it could not be told.
const SETTLE: &str = "record 10 s or more of motion that starts and stops";

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    let arms = facts.robots.iter();
    arms.flat_map(|arm| {
        arm.poses_and_tf().map(move |(stream, found)| judge(facts, arm, stream, found, subjects))
    })
    .collect()
}

fn judge(
    facts: &Facts,
    arm: &ArmFacts,
    stream: &PoseFacts,
    found: &PoseDiagnosis,
    subjects: usize,
) -> Judged {
    let subject = arm.topic(&stream.topic);
    let course = match &found.course {
        Ok(course) => course,
        Err(why) => return Judged::new(subject, unseen(why, SETTLE)).within(stream.span),
    };
    let outcome = match decide(&course.swing_s, &FIGURE, subjects) {
        Decision::Pass => Outcome::sound(),
        Decision::Fail(severity) if course.is_unsteady => {
            Outcome::faulty(fault(facts, arm, course, severity))
        }
        Decision::Fail(_) => {
            let shown = FIGURE.unit.show(course.swing_s.value);
            Outcome::Inconclusive(format!("it scatters by {shown}, as noise would; {SETTLE}"))
        }
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
    };
    let name = if course.jumps.is_empty() { "latency swing" } else { "latency jump" };
    Judged::new(subject, outcome)
        .within(stream.span)
        .estimated(Estimate::amount(name, FIGURE.unit, &course.swing_s))
}

fn fault(facts: &Facts, arm: &ArmFacts, course: &LatencyCourse, severity: Severity) -> Fault {
    let swing = &course.swing_s;
    let at = |at_s: f64| facts.moment(facts.origin.shifted(at_s));
    let (title, message) = match course.jumps.as_slice() {
        [] => (
            "latency wanders",
            format!("latency wanders by {} within the run", FIGURE.unit.show_measured(swing)),
        ),
        [jump] => (
            "latency jumps",
            format!("latency jumps by {} at {}", FIGURE.unit.show_signed(swing), at(jump.at_s)),
        ),
        jumps => (
            "latency jumps",
            format!(
                "latency jumps {} times, by {} at most",
                jumps.len(),
                FIGURE.unit.show_signed(swing)
            ),
        ),
    };
    let listed: Vec<Value> = course
        .jumps
        .iter()
        .map(|jump| {
            let at_ns = facts.origin.shifted(jump.at_s).to_string();
            json!({ "at_ns": at_ns, "by_s": jump.size_s.value })
        })
        .collect();
    let effect_m = swing.value.abs() * arm.top_speed_m_s();
    let mut evidence = Evidence {
        effect: Some(format!("{} at this run's top speed", Unit::Metre.show(effect_m))),
        effect_m: Some(effect_m),
        ..Evidence::default()
    };
    evidence.more.insert("jumps".to_owned(), listed.into());
    Fault {
        severity,
        title,
        message,
        evidence,
        fix: "stamp a sample when it is taken, and slew clocks instead of setting them".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, sure};
    use crate::diagnosis::LatencyJump;
    use crate::finding::Status;

    #[test]
    fn scatter_that_noise_may_be_is_no_finding() {
        let mut facts = clean_run();
        let course = |swing_s, is_unsteady, jumps| {
            Ok(LatencyCourse { swing_s, is_unsteady, jumps, levels: Vec::new() })
        };
        facts.robots[0].diagnosis.streams[0].course = course(sure(0.012), false, vec![]);
        let (rows, findings) = ask(&LAT003, &facts);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
        let jump = LatencyJump { at_s: 4.0, size_s: sure(0.012) };
        facts.robots[0].diagnosis.streams[0].course = course(sure(0.012), true, vec![jump]);
        let (_, findings) = ask(&LAT003, &facts);
        assert!(findings[0].message.starts_with("latency jumps by +12.000"), "{findings:?}");
    }
}
