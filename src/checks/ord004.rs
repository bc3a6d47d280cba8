use crate::checks::decision::unseen;
use crate::checks::{ArmFacts, Facts, Grade, Judged};
use crate::diagnosis::UnitSlip;
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// Degrees stand where radians belong.
    ///
    /// ## What it means
    /// The joint positions, or the rotation numbers of a bare array, are degrees, and everything
    /// that reads them takes them for radians (REP 103).
    ///
    /// ## Why it matters
    /// Forward kinematics of degrees read as radians is noise within the arm's reach: nothing built
    /// on it can be right, and every other finding would be about the wrong motion. The audit
    /// therefore reads the numbers as degrees before it judges anything else.
    ///
    /// ## Evidence
    /// What the stream leaves against forward kinematics as logged (`as_logged`) and as degrees
    /// (`corrected`): metres for joint positions, radians for rotation numbers.
    ///
    /// ## How to fix
    /// Convert at the source, `np.deg2rad(q)`. For a stream that shall stay in degrees declare it:
    /// `--declare TOPIC=CONVENTION,deg`.
    ///
    /// ## When it misleads
    /// A prismatic joint is in metres and is left alone. An arm that stays within a degree of zero
    /// looks alike in both units; then there is no finding.
    ORD004 {
        name: "degrees-for-radians",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states with a stream to hold them against",
        check: check,
    }
}

fn check(facts: &Facts) -> Vec<Judged> {
    facts.robots.iter().flat_map(judge_arm).collect()
}

fn judge_arm(arm: &ArmFacts) -> Vec<Judged> {
    let joints = match &arm.diagnosis.joints {
        Err(why) => Judged::new(arm.topic(&arm.joints_topic), unseen(why, "log a pose or /tf too")),
        Ok(reading) => judge(arm, &arm.joints_topic, reading.degrees, Unit::Metre),
    };
    let numbers = arm.poses().filter(|(stream, _)| stream.bare_numbers);
    let numbers = numbers.map(|(stream, diagnosis)| {
        judge(arm, &stream.topic, diagnosis.degrees, Unit::Radian).within(stream.span)
    });
    std::iter::once(joints.within(arm.span)).chain(numbers).collect()
}

fn judge(arm: &ArmFacts, topic: &str, slip: Option<UnitSlip>, residual: Unit) -> Judged {
    let subject = arm.topic(topic);
    let Some(slip) = slip else {
        return Judged::new(subject, Outcome::sound());
    };
    let (before, after) = (residual.show(slip.as_logged), residual.show(slip.corrected));
    let fault = Fault {
        severity: Severity::Error,
        title: "degrees where radians belong",
        message: format!("the numbers are degrees where radians belong, {before} off as logged"),
        evidence: Evidence {
            effect: Some(format!("{after} once read as degrees")),
            effect_m: Some(match residual {
                Unit::Metre => slip.as_logged,
                _ => slip.as_logged * arm.reach_m,
            }),
            ..Evidence::default()
        },
        fix: format!("publish {topic} in radians: np.deg2rad(q)"),
    };
    Judged::new(subject, Outcome::faulty(fault))
        .estimated(Estimate::Slip { name: "angle unit", is: "deg", read_as: "rad" })
        .with_evidence("as_logged", slip.as_logged)
        .with_evidence("corrected", slip.corrected)
}
