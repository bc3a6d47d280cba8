use crate::checks::decision::{Decision, Figure, decide, unseen};
use crate::checks::{ArmFacts, Facts, Grade, Judged};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::WrongModel;

rule! {
    /// A residual is left that no modelled cause explains.
    ///
    /// ## What it means
    /// When convention, latency, joint zeros and frames have been taken off, the stream still
    /// disagrees with the model by more than its noise. Something is wrong that this audit has no
    /// name for: kinematic parameters, a bent link, gear error, a flexible mount.
    ///
    /// ## Why it matters
    /// It bounds what any correction of the named causes can reach. It is also the warning that the
    /// description may be of another arm.
    ///
    /// ## Evidence
    /// `value` is the rms of position beyond the sample-to-sample noise, `rotation` that of
    /// orientation; `rms_m` and `rms_rad` are with the noise, `before_m` and `before_rad` before
    /// anything was taken off. `fits` names an arm of the catalogue with the same joints that fits
    /// without a cause where the model that was named does not, and to how much (`misfit_m`; `tool_m`
    /// where it needs an active TCP); `value` is then what the named model leaves of the positions as
    /// logged, and everything else is judged with the arm that fits.
    ///
    /// ## How to fix
    /// Use the arm's own calibrated description (for a UR, `calibration.yaml` extracted from the
    /// controller). If it is a few millimetres everywhere, that is it; if it is centimetres, look
    /// for the wrong model.
    ///
    /// ## When it misleads
    /// A nominal description against a calibrated arm leaves 1–10 mm; that is no fault of the log.
    /// Slowly wandering noise of a tracker counts as residual.
    MDL001 {
        name: "unexplained-residual",
        grade: Grade::From(&[FIGURE]),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

const FIGURE: Figure = Figure { unit: Unit::Metre, warning: 1e-3, error: 5e-3 };

/// What would tell where the residual could not be had.
const SETTLE: &str = "record 10 s in which every joint moves";

/// From where this audit speaks up.
fn figure(facts: &Facts) -> Figure {
    facts.figures.of(&MDL001, FIGURE)
}

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    let streams = facts
        .robots
        .iter()
        .flat_map(|arm| arm.poses().map(move |(stream, diagnosis)| (arm, stream, diagnosis)));
    let judged = streams.map(|(arm, stream, diagnosis)| {
        let subject = arm.topic(&stream.topic);
        if let Some(wrong) = arm.wrong_model.as_ref().filter(|wrong| wrong.topic == stream.topic) {
            return Judged::new(subject, wrong_model(facts, arm, wrong)).within(stream.span);
        }
        let residual = match (diagnosis.unread(), &diagnosis.residual) {
            (None, Ok(residual)) => residual,
            (Some(why), _) | (None, Err(why)) => return Judged::new(subject, unseen(why, SETTLE)).within(stream.span),
        };
        let length = Unit::Metre.show_measured(&residual.excess_m);
        let angle = Unit::Radian.show(residual.excess_rad.value);
        let outcome = match decide(&residual.excess_m, &figure(facts), subjects) {
            _ if diagnosis.nominal => Outcome::faulty(Fault {
                severity: Severity::Info,
                title: "nominal kinematics",
                message: format!(
                    "{length} rms and {angle} are left, as of a drawing against a calibrated arm"
                ),
                evidence: Evidence {
                    effect_m: Some(residual.excess_m.value),
                    ..Evidence::default()
                },
                fix: "use the arm's calibration; for a UR, calibration.yaml from the controller"
                    .to_owned(),
            }),
            Decision::Pass => Outcome::sound(),
            Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
            Decision::Fail(severity) => {
                let left = format!("{length} rms and {angle} are left");
                Outcome::faulty(unexplained(severity, &left, residual.excess_m.value))
            }
        };
        Judged::new(subject, outcome)
            .within(stream.span)
            .estimated(Estimate::frame("residual", &residual.excess_m, &residual.excess_rad))
            .with_evidence("rms_m", residual.rms_m)
            .with_evidence("rms_rad", residual.rms_rad)
            .with_evidence("before_m", residual.before_m)
            .with_evidence("before_rad", residual.before_rad)
    });
    judged.collect()
}

/// Where more than this is left, rms m, the model may be another arm's.
const UNEXPLAINED_M: f64 = 5e-3;
/// A cause that moves poses by so many times what is left is there whatever else is.
const FAR_BEYOND: f64 = 10.0;

/// Why a cause that moves the poses of `arm` by `effect_m` cannot be believed, where it cannot: what
/// is left beside it makes it a part of whatever the model does not have.
pub(super) fn doubt(arm: &ArmFacts, effect_m: f64) -> Option<String> {
    let left = arm.poses().filter_map(|(_, stream)| stream.residual.as_ref().ok());
    let left_m = left.map(|residual| residual.excess_m.value).fold(0.0, f64::max);
    (left_m > UNEXPLAINED_M && effect_m < FAR_BEYOND * left_m).then(|| {
        let left = Unit::Metre.show(left_m);
        format!("{left} is left that nothing explains (MDL001); check the model")
    })
}

/// What is left when all that was found is taken off.
fn unexplained(severity: Severity, left: &str, effect_m: f64) -> Fault {
    Fault {
        severity,
        title: "unexplained residual",
        message: format!("{left} when all that was found is taken off"),
        evidence: Evidence { effect_m: Some(effect_m), ..Evidence::default() },
        fix: "use the arm's calibrated description, or see whether it is the right one".to_owned(),
    }
}

/// The model that was named is another arm's.
fn wrong_model(facts: &Facts, arm: &ArmFacts, wrong: &WrongModel) -> Outcome {
    let (is, named) = (&arm.name, &wrong.named.name);
    let [fits, off] = [wrong.rival_m, wrong.named_m].map(|left_m| Unit::Metre.show(left_m));
    let with = match wrong.tool_m {
        Some(tool_m) => format!("with a TCP of {}", Unit::Metre.show(tool_m)),
        None => "without any cause".to_owned(),
    };
    let mut evidence = Evidence { effect_m: Some(wrong.named_m), ..Evidence::default() };
    let fits_json = serde_json::json!({
        "robot": is,
        "misfit_m": wrong.rival_m,
        "tool_m": wrong.tool_m,
    });
    evidence.more.insert("fits".to_owned(), fits_json);
    Outcome::faulty(Fault {
        severity: figure(facts).severity(wrong.named_m).unwrap_or(Severity::Warning),
        title: "wrong robot model",
        message: format!(
            "this log is of a {is}, which fits to {fits} {with}, not of the {named} that was named, \
             which leaves {off}"
        ),
        evidence,
        fix: format!("audit with --robot {is}: everything else here is judged with it"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::evaluate;
    use crate::checks::testing::{ask, clean_run, frame, sure};
    use crate::diagnosis::FrameEstimate;
    use crate::robot::catalogue;

    #[test]
    fn an_arm_that_fits_where_the_named_one_does_not_is_the_finding() {
        let mut facts = clean_run();
        let arm = &mut facts.robots[0];
        arm.wrong_model = Some(WrongModel {
            named: catalogue::find("ur3e").unwrap().clone(),
            topic: arm.poses[0].topic.clone(),
            named_m: 0.0274,
            rival_m: 2e-5,
            tool_m: None,
        });
        let finding = ask(&MDL001, &facts).1.remove(0);
        assert!(finding.message.contains("fits to 20 µm without any cause"), "{}", finding.message);
        assert!(finding.message.ends_with("which leaves 27.4 mm"), "{}", finding.message);
        assert_eq!(finding.severity, Severity::Error);
        assert_eq!(finding.evidence.more["fits"]["misfit_m"], 2e-5);
    }

    #[test]
    fn beside_what_nothing_explains_only_what_goes_far_beyond_it_is_believed() {
        let found = |tool_m: f64| {
            let mut facts = clean_run();
            let stream = &mut facts.robots[0].diagnosis.streams[0];
            (stream.growth, stream.growth_chosen) = (Ok(sure(0.01)), true);
            stream.tool = Ok(FrameEstimate { chosen: true, p_value: 0.0, ..frame(tool_m) });
            stream.residual.as_mut().unwrap().excess_m = sure(0.02);
            let findings = evaluate(&facts, &Default::default()).findings;
            let mut codes: Vec<&str> = findings.iter().map(|finding| finding.code).collect();
            codes.sort_unstable();
            codes
        };
        assert_eq!(found(0.03), ["MDL001"]);
        assert_eq!(found(0.3), ["FRM003", "MDL001"]);
    }
}
