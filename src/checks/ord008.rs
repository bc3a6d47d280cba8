use crate::checks::decision::unseen;
use crate::checks::{Facts, Grade, Judged};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// Millimetres stand where metres belong.
    ///
    /// ## What it means
    /// The positions of a pose stream are millimetres, as pendants show them, in a message that
    /// wants metres (REP 103).
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
                let before = Unit::Metre.show(slip.as_logged);
                let fault = Fault {
                    severity: Severity::Error,
                    title: "millimetres where metres belong",
                    message: format!(
                        "positions are millimetres where metres belong, {before} off as logged"
                    ),
                    evidence: Evidence {
                        effect: Some(format!(
                            "{} once read as millimetres",
                            Unit::Metre.show(slip.corrected)
                        )),
                        effect_m: Some(slip.as_logged),
                        ..Evidence::default()
                    },
                    fix: format!("divide the positions of {} by 1000", stream.topic),
                };
                Judged::new(subject, Outcome::faulty(fault))
                    .estimated(Estimate::Slip { name: "length unit", is: "mm", read_as: "m" })
                    .with_evidence("as_logged_m", slip.as_logged)
                    .with_evidence("corrected_m", slip.corrected)
            }
        }
        .within(stream.span)
    });
    judged.collect()
}
