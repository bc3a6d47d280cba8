use crate::checks::decision::unseen;
use crate::checks::{ArmFacts, Declared, Facts, Grade, Judged, PoseFacts};
use crate::diagnosis::{JointUnit, UnitSlip};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// Millimetres stand where metres belong, or the other way round.
    ///
    /// ## What it means
    /// The positions of a pose stream are millimetres, as pendants show them, in a message that
    /// wants metres (REP 103). Or the positions of a sliding joint are millimetres or centimetres. Of a
    /// stream that was declared it is the declaration that names the wrong unit, either way.
    ///
    /// ## Why it matters
    /// The tip appears a thousand times too far out. What does not crash on that will scale it
    /// silently somewhere else.
    ///
    /// ## Evidence
    /// What the positions leave against forward kinematics as metres (`as_logged_m`) and as
    /// millimetres (`corrected_m`).
    ///
    /// ## How to fix
    /// Divide by 1000 where the message is filled. For a bare array that shall stay in millimetres
    /// declare it: `--declare TOPIC=CONVENTION,mm`.
    ///
    /// ## When it misleads
    /// A factor of a thousand and a scale error of a thousand are the same thing; nothing else
    /// comes near it.
    ORD008 {
        name: "millimetres-for-metres",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

fn check(facts: &Facts) -> Vec<Judged> {
    let streams = facts.robots.iter().flat_map(|arm| {
        arm.poses_and_tf().map(move |(stream, diagnosis)| (arm, stream, diagnosis))
    });
    let judged = streams.map(|(arm, stream, diagnosis)| {
        let subject = arm.topic(&stream.topic);
        match &diagnosis.millimetres {
            Err(why) => Judged::new(subject, unseen(why, "move the tip by 10 cm or more")),
            Ok(None) => Judged::new(subject, Outcome::sound()),
            Ok(Some(slip)) => {
                let (is, read_as) = match stream.declared {
                    Some(Declared { lengths: "mm", .. }) => ("m", "mm"),
                    _ => ("mm", "m"),
                };
                Judged::new(subject, Outcome::faulty(fault(stream, slip, is)))
                    .estimated(Estimate::Slip { name: "length unit", is, read_as })
                    .with_evidence("as_logged_m", slip.as_logged)
                    .with_evidence("corrected_m", slip.corrected)
            }
        }
        .within(stream.span)
    });
    judged.chain(facts.robots.iter().flat_map(judge_joints)).collect()
}

/// The sliding joints whose positions are not metres.
fn judge_joints(arm: &ArmFacts) -> Vec<Judged> {
    let Ok(reading) = &arm.diagnosis.joints else { return Vec::new() };
    let units = [(JointUnit::Millimetres, "mm", 1000), (JointUnit::Centimetres, "cm", 100)];
    let slips = units.into_iter().flat_map(|(unit, is, number)| {
        reading.slips_of(unit).map(move |(slip, left)| (slip, left, is, number))
    });
    let judged = slips.map(|(slip, left, is, number)| {
        let subject = arm.joint_states(slip.column);
        let joint = subject.joint.as_deref().unwrap_or_default();
        let what = if is == "mm" { "millimetres" } else { "centimetres" };
        let (before, after) = (Unit::Metre.show(left.as_logged), Unit::Metre.show(left.corrected));
        let fault = Fault {
            severity: Severity::Error,
            title: "sliding joint not in metres",
            message: format!("the positions of {joint} are {what}, {before} off as logged"),
            evidence: Evidence {
                effect: Some(format!("{after} once read as {what}")),
                effect_m: Some(left.as_logged),
                ..Evidence::default()
            },
            fix: format!("divide the positions of {joint} by {number}"),
        };
        Judged::new(subject, Outcome::faulty(fault))
            .within(arm.span)
            .estimated(Estimate::Slip { name: "length unit", is, read_as: "m" })
            .with_evidence("as_logged_m", left.as_logged)
            .with_evidence("corrected_m", left.corrected)
    });
    judged.collect()
}

/// The fault of positions that are in the unit `is`.
fn fault(stream: &PoseFacts, slip: &UnitSlip, is: &str) -> Fault {
    let topic = &stream.topic;
    let (title, what, once, fix) = match (is, stream.declared) {
        ("m", _) => (
            "metres declared as millimetres",
            "positions are metres and were declared as millimetres",
            "metres",
            format!("declare {topic} without `,mm`"),
        ),
        (_, Some(_)) => (
            "millimetres declared as metres",
            "positions are millimetres and were declared as metres",
            "millimetres",
            format!("declare {topic} with `,mm`"),
        ),
        (_, None) => (
            "millimetres where metres belong",
            "positions are millimetres where metres belong",
            "millimetres",
            format!("divide the positions of {topic} by 1000"),
        ),
    };
    let (before, after) = (Unit::Metre.show(slip.as_logged), Unit::Metre.show(slip.corrected));
    Fault {
        severity: Severity::Error,
        title,
        message: format!("{what}, {before} off as logged"),
        evidence: Evidence {
            effect: Some(format!("{after} once read as {once}")),
            effect_m: Some(slip.as_logged),
            ..Evidence::default()
        },
        fix,
    }
}
