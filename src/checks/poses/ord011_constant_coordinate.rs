use crate::checks::decision::not_observable;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::ConstantCoordinate;
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit, rounded};

rule! {
    /// A coordinate never changes while the arm moves it.
    ///
    /// ## What it means
    /// The x, y or z of a pose stream is the same in every sample, while FK moves it. It was never filled,
    /// or comes from a planar pose (x, y and a heading).
    ///
    /// ## Why it matters
    /// The pose is off by the arm's full motion along that axis, and nothing in the message shows it.
    ///
    /// ## Evidence
    /// `value` is the range over which FK moves the coordinate, `constant` its value in the log. The other
    /// coordinates are audited normally.
    ///
    /// ## How to fix
    /// Fill the coordinate where the message is written.
    ///
    /// ## When it misleads
    /// Changes below 1 % of the other coordinates' range count as noise. If FK also keeps the coordinate
    /// constant, as in a task at one height, nothing is reported.
    ORD011 {
        name: "constant-coordinate",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let streams = case.evidence.poses_and_tf();
    let judged = streams.map(|(_, stream)| {
        let found = &stream.diagnosis;
        match (&found.axes, found.constant_coordinates.as_slice()) {
            (Err(why), _) => stream.judged(not_observable(why, "move the tip by 10 cm or more")),
            (Ok(_), []) => stream.judged(Outcome::pass()),
            (Ok(_), constants) => {
                let range_m = constants.iter().map(|constant| constant.moved_m).fold(0.0, f64::max);
                let values: serde_json::Map<String, serde_json::Value> = constants
                    .iter()
                    .map(|constant| (constant.coordinate.to_string(), constant.value.into()))
                    .collect();
                stream
                    .judged(Outcome::fail(fault(stream, constants, range_m)))
                    .estimated(Estimate::exact(
                        "motion that is missing",
                        Unit::Metre.symbol(),
                        range_m,
                    ))
                    .with_evidence("constant", values)
            }
        }
    });
    judged.collect()
}

fn fault(
    stream: &StreamEvidence<PoseEvidence>,
    constants: &[ConstantCoordinate],
    range_m: f64,
) -> Fault {
    let descriptions: Vec<String> = constants
        .iter()
        .map(|ConstantCoordinate { coordinate, value, moved_m }| {
            let (value, moved) = (rounded(*value, 4), Unit::Metre.show(*moved_m));
            format!("{coordinate} is {value} throughout while FK moves it by {moved}")
        })
        .collect();
    let names: Vec<String> =
        constants.iter().map(|constant| constant.coordinate.to_string()).collect();
    Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Error,
        title: "a coordinate never changes",
        message: descriptions.join("; "),
        evidence: Evidence { effect_m: Some(range_m), ..Evidence::default() },
        fix: format!("fill {} of {} where it is written", names.join(" and "), stream.topic()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};

    #[test]
    fn a_constant_coordinate_is_reported_with_its_value() {
        let mut run = clean_run();
        assert!(evaluate_rule(&ORD011, &run).1.is_empty());
        run.robots[0].poses[0].diagnosis.constant_coordinates =
            vec![ConstantCoordinate { coordinate: 'z', value: 0.0, moved_m: 0.43 }];
        let findings = evaluate_rule(&ORD011, &run).1;
        let expected = "z is 0.0000 throughout while FK moves it by 430 mm";
        assert_eq!(findings[0].message, expected);
    }
}
