use crate::checks::decision::not_observable;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::AxesError;
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::geometry::Axes;

rule! {
    /// Axes are exchanged or mirrored.
    ///
    /// ## What it means
    /// The numbers use other axes than their frame: y up as in game engines, a left-handed frame, or
    /// components of positions or quaternions permuted between two programs. ROS uses x forward, y left, z
    /// up (REP 103), right-handed.
    ///
    /// ## Why it matters
    /// No static transform corrects mirrored axes: everything that moves left moves right, and rotations
    /// are reversed.
    ///
    /// ## Evidence
    /// Positions are compared with FK under all 48 axis permutations with signs, then rotations under those
    /// that fit the positions and under all others. Axes are reported only if they explain the stream.
    ///
    /// - `positions`, `rotations`: the axes of each.
    /// - `as_logged_m`: position residual as logged; `corrected_m`, `corrected_rad`: residuals after
    ///   correction.
    ///
    /// ## How to fix
    /// Copy the components by name, as listed in `fix`. For a left-handed frame, the quaternion's vector
    /// part also changes sign, because a mirror reverses rotations.
    ///
    /// ## When it misleads
    /// A right-handed world rotated by 90° is a frame offset (FRM002), unless the tool's axes are permuted
    /// alike. In a tracker's world with unknown rotation, all left-handed frames are equivalent; the most
    /// common is reported. Motion in a plane or about one axis cannot reveal a mirror.
    ORD010 {
        name: "axes-exchanged",
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
        let outcome = match stream.diagnosis.axes {
            Err(ref why) => not_observable(why, "move the tip by 10 cm or more in all directions"),
            Ok(None) => Outcome::pass(),
            Ok(Some(_)) if stream.diagnosis.is_far_from_fk() => Outcome::Inconclusive(
                "no axis convention explains its positions (MDL001); check the model and its joints".to_owned(),
            ),
            Ok(Some(error)) => {
                let outcome = Outcome::fail(fault(stream, error));
                return stream
                    .judged(outcome)
                    .estimated(Estimate::misinterpretation("axes", describe_exchange(error), Axes::STANDARD.to_string()))
                    .with_evidence("positions", error.positions.to_string())
                    .with_evidence("rotations", error.rotations.to_string());
            }
        };
        stream.judged(outcome)
    });
    judged.collect()
}

/// A left-handed frame and its opposite encode rotations identically.
fn is_same_exchange(error: AxesError) -> bool {
    error.positions.conjugator() == error.rotations.conjugator()
}

fn describe_exchange(error: AxesError) -> String {
    let AxesError { positions, rotations } = error;
    match (positions == Axes::STANDARD, rotations == Axes::STANDARD) {
        _ if is_same_exchange(error) => positions.to_string(),
        (false, true) => format!("positions {positions}"),
        (true, false) => format!("rotations {rotations}"),
        _ => format!("positions {positions}; rotations {rotations}"),
    }
}

fn fault(stream: &StreamEvidence<PoseEvidence>, error: AxesError) -> Fault {
    let AxesError { positions, rotations } = error;
    let title = match (positions == Axes::STANDARD, rotations == Axes::STANDARD) {
        (true, _) => "axes of the rotations are exchanged",
        _ if positions.are_left_handed() => "axes are left-handed",
        (_, true) => "axes of the positions are exchanged",
        _ => "axes are exchanged",
    };
    let residual = stream.diagnosis.residual.as_ref().ok();
    let before = residual.map_or(0.0, |residual| residual.before_m);
    let after = residual.map_or(0.0, |residual| residual.rms_m);
    let after_rad = residual.map_or(0.0, |residual| residual.rms_rad);
    let mut evidence = Evidence {
        effect: Some(format!(
            "{} and {} once corrected",
            Unit::Metre.show(after),
            Unit::Radian.show(after_rad)
        )),
        effect_m: Some(before),
        ..Evidence::default()
    };
    let amounts = [("as_logged_m", before), ("corrected_m", after), ("corrected_rad", after_rad)];
    for (name, amount) in amounts {
        evidence.more.insert(name.to_owned(), amount.into());
    }
    let mut lines = Vec::new();
    if positions != Axes::STANDARD {
        lines.push(format!("position ({})", positions.standard_names(false).join(", ")));
    }
    if rotations != Axes::STANDARD {
        let handed = if is_same_exchange(error) { positions } else { rotations };
        lines.push(format!("quaternion ({}, w)", handed.standard_names(true).join(", ")));
    }
    Fault {
        severity: Severity::Error,
        cause: Cause::Axes { positions, rotations },
        title,
        message: format!(
            "axes are {} instead of {}, {} off as logged",
            describe_exchange(error),
            Axes::STANDARD,
            Unit::Metre.show(before)
        ),
        evidence,
        fix: format!("fill {} with {} of the current values", stream.topic(), lines.join(" and ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::finding::Status;

    #[test]
    fn the_fix_names_each_component() {
        let mut run = clean_run();
        let error = AxesError { positions: Axes::UNITY, rotations: Axes::UNITY };
        run.robots[0].poses[0].diagnosis.axes = Ok(Some(error));
        let (rows, findings) = evaluate_rule(&ORD010, &run);
        assert_eq!(rows[0].status, Status::Fail);
        let fix = &findings[0].fix;
        assert!(fix.contains("position (z, -x, y) and quaternion (-z, x, -y, w)"), "{fix}");
    }

    #[test]
    fn exchanged_axes_of_rotations_only_are_described() {
        let rotations = "x left, y forward, z down".parse().unwrap();
        let error = AxesError { positions: Axes::STANDARD, rotations };
        assert_eq!(describe_exchange(error), "rotations x left, y forward, z down");
    }
}
