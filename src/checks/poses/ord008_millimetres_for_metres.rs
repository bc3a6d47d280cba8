use crate::checks::decision::not_observable;
use crate::checks::imu::{GRAVITY_M_S2, MAX_GRAVITY_ERROR, wrong_gravity};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{AccelUnitError, JointUnit, LengthUnitError};
use crate::evidence::{ArmEvidence, ImuEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit, rounded};
use crate::geometry::{LengthScale, Misread};

rule! {
    /// Millimetres, or another unit, published as metres, or vice versa.
    ///
    /// ## What it means
    /// A pose stream's positions are not in metres (REP 103), but in millimetres as pendants show them,
    /// centimetres, inches or tenths of a millimetre. Or a prismatic joint is in millimetres or
    /// centimetres. Or a stream's declared unit is wrong, either way. Or an IMU's linear acceleration is in
    /// g, mg or cm/s² instead of m/s²; the other rules use the converted values. Or it is off by another factor at rest,
    /// such as 2.
    ///
    /// ## Why it matters
    /// The tip appears a thousand times too far away. Consumers that do not fail may compensate for it
    /// elsewhere.
    ///
    /// ## Evidence
    /// The factor is estimated from the motion, with free constant frames if needed. It is reported only if
    /// it explains the positions: as a common unit if that matches to 2 %, otherwise as the factor to
    /// metres.
    ///
    /// - `as_logged_m`, `corrected_m`: position residual against FK in metres and in the detected unit.
    /// - `felt`: median magnitude of an accelerometer's specific force at rest: 9.81 in m/s², 1 in g. If it is below a
    ///   fifth of gravity, gravity is removed (YAW002).
    ///
    /// ## How to fix
    /// Convert where the message is filled. Undeclared arrays cannot have a wrong unit, unless it changes
    /// within the run; ORD001 reports the unit assumed for them. Declare millimetres to check them: `--declare TOPIC=CONVENTION,mm`.
    ///
    /// ## When it misleads
    /// A factor of 1000 and a scale error of 1000 are the same. Factors within 25 % of 1 are a radial scale
    /// (ZER002), not a unit. If the tip only rotates about one point, a long tool looks like a unit; the
    /// unit is reported.
    ORD008 {
        name: "millimetres-for-metres",
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
        let outcome = match &stream.diagnosis.length_unit {
            Err(why) => not_observable(why, "move the tip by 10 cm or more"),
            Ok(None) => Outcome::pass(),
            Ok(Some(error)) if stream.is_undeclared => Outcome::pass_with_remark(format!(
                "read as {}: no unit is declared for these numbers, so none is violated",
                error.is.plural_name()
            )),
            Ok(Some(error)) if stream.diagnosis.is_far_from_fk() => Outcome::Inconclusive(format!(
                "{} would still have a residual of {}, so it explains nothing (MDL001)",
                error.is.plural_name(),
                Unit::Metre.show(error.residual.corrected)
            )),
            Ok(Some(error)) => {
                let LengthUnitError { is, read_as, residual } = error;
                return stream
                    .judged(Outcome::fail(fault(stream, error)))
                    .estimated(Estimate::misinterpretation(
                        "length unit",
                        is.to_string(),
                        read_as.to_string(),
                    ))
                    .with_evidence("as_logged_m", residual.as_logged)
                    .with_evidence("corrected_m", residual.corrected);
            }
        };
        stream.judged(outcome)
    });
    let imus = case.evidence.imus().filter_map(|(_, imu)| judge_accelerometer(imu));
    judged.chain(case.evidence.robots.iter().flat_map(judge_joints)).chain(imus).collect()
}

/// `None` if it measures neither gravity nor a wrong unit.
fn judge_accelerometer(imu: &StreamEvidence<ImuEvidence>) -> Option<SubjectResult> {
    let Some(AccelUnitError { unit, norm: felt }) = imu.diagnosis.conventions.accel else {
        let feels = imu.proof.as_ref()?.gravity_m_s2.is_some();
        let scale = wrong_gravity(imu).filter(|ratio| *ratio > MAX_GRAVITY_ERROR);
        return match scale {
            Some(scale) => Some(judge_accelerometer_scale(imu, scale)),
            None => feels.then(|| imu.judged(Outcome::pass())),
        };
    };
    let (topic, symbol) = (imu.topic(), unit.symbol());
    let size = rounded(felt, 2);
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::Pictured(Picture::Stream),
        title: "accelerometer not in m/s²",
        message: format!(
            "linear acceleration is in {symbol} instead of m/s²: it reads {size} at rest, while gravity is \
             9.81 m/s²"
        ),
        evidence: Evidence::default(),
        fix: format!("multiply the linear acceleration of {topic} by {}", unit.in_m_s2()),
    };
    let judged = imu.judged(Outcome::fail(fault));
    let judged = judged.estimated(Estimate::misinterpretation("acceleration unit", symbol, "m/s²"));
    Some(judged.with_evidence("felt", felt))
}

/// `scale` is the specific force at rest over gravity.
fn judge_accelerometer_scale(imu: &StreamEvidence<ImuEvidence>, scale: f64) -> SubjectResult {
    let (felt, topic) = (scale * GRAVITY_M_S2, imu.topic());
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::Pictured(Picture::Stream),
        title: "accelerometer scale is wrong",
        message: format!(
            "linear acceleration reads {} m/s² at rest, {} times gravity ({GRAVITY_M_S2} m/s²)",
            rounded(felt, 2),
            rounded(scale, 2)
        ),
        evidence: Evidence::default(),
        fix: format!(
            "convert the counts of {topic} with the accelerometer's full-scale range{}",
            if scale > 1.0 { ", and check that gravity is not added twice" } else { "" }
        ),
    };
    imu.judged(Outcome::fail(fault))
        .estimated(Estimate::exact("acceleration scale", Unit::One.symbol(), scale))
        .with_evidence("felt", felt)
}

/// Prismatic joints not in metres.
fn judge_joints(arm: &ArmEvidence) -> Vec<SubjectResult> {
    let Ok(reading) = &arm.diagnosis.encoding else { return Vec::new() };
    let units = [
        (JointUnit::Millimetres, "mm", "millimetres", 1000),
        (JointUnit::Centimetres, "cm", "centimetres", 100),
    ];
    let unit_errors = units.into_iter().flat_map(|(unit, is, what, number)| {
        reading
            .unit_errors(unit)
            .map(move |(unit_error, residuals)| (unit_error, residuals, is, what, number))
    });
    let judged = unit_errors.map(|(unit_error, residuals, is, what, number)| {
        let subject = arm.joint_states(unit_error.column);
        let joint = subject.joint.as_deref().unwrap_or_default();
        let (before, after) =
            (Unit::Metre.show(residuals.as_logged), Unit::Metre.show(residuals.corrected));
        let fault = Fault {
            severity: Severity::Error,
            cause: Cause::JointUnit(unit_error.factor),
            title: "prismatic joint not in metres",
            message: format!("the positions of {joint} are {what}, {before} off as logged"),
            evidence: Evidence {
                effect: Some(format!("{after} once read as {what}")),
                effect_m: Some(residuals.as_logged),
                ..Evidence::default()
            },
            fix: format!("divide the positions of {joint} by {number}"),
        };
        SubjectResult::new(subject, Outcome::fail(fault))
            .within(arm.span)
            .estimated(Estimate::misinterpretation("length unit", is, "m"))
            .with_evidence("as_logged_m", residuals.as_logged)
            .with_evidence("corrected_m", residuals.corrected)
    });
    judged.collect()
}

fn fault(stream: &StreamEvidence<PoseEvidence>, error: &LengthUnitError) -> Fault {
    let topic = stream.topic();
    let (is, read_as) = (error.is.plural_name(), error.read_as.plural_name());
    let is_metres = error.is == LengthScale::METRE;
    let is_millimetres = error.is == LengthScale::MILLIMETRE;
    let (title, what, fix) = match stream.declared {
        Some(_) => (
            if is_metres {
                "metres declared as millimetres"
            } else {
                "wrong unit of length declared"
            },
            format!("positions are {is} but were declared as {read_as}"),
            match (is_metres, is_millimetres) {
                (true, _) => format!("declare {topic} without `,mm`"),
                (_, true) => format!("declare {topic} with `,mm`"),
                _ => format!("publish {topic} in metres"),
            },
        ),
        None => (
            if is_millimetres { "millimetres instead of metres" } else { "wrong unit of length" },
            format!("positions are {is} instead of metres"),
            match is_millimetres {
                true => format!("divide the positions of {topic} by 1000"),
                false => format!("multiply the positions of {topic} by {}", error.is.in_m()),
            },
        ),
    };
    let [before, after] = [error.residual.as_logged, error.residual.corrected]
        .map(|residual| Unit::Metre.show(residual));
    Fault {
        severity: Severity::Error,
        cause: Cause::LengthUnit(Misread { is: error.is, read_as: error.read_as }),
        title,
        message: format!("{what}, {before} off as logged"),
        evidence: Evidence {
            effect: Some(format!("{after} once read as {is}")),
            effect_m: Some(error.residual.as_logged),
            ..Evidence::default()
        },
        fix,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};

    #[test]
    fn a_wrong_scale_of_an_accelerometer_is_reported_as_a_multiple_of_gravity() {
        for (scale, times, is_twice) in [(0.5, "0.50", false), (2.0, "2.00", true)] {
            let mut run = clean_run();
            let imu = &mut run.robots[0].imus[0].diagnosis;
            imu.conventions.force_at_rest_m_s2 = Some(scale * GRAVITY_M_S2);
            let (_, findings) = evaluate_rule(&ORD008, &run);
            let finding =
                findings.iter().find(|found| found.title == "accelerometer scale is wrong");
            let finding = finding.expect("a wrong scale");
            let said = format!("at rest, {times} times gravity");
            assert!(finding.message.contains(&said), "{}", finding.message);
            assert_eq!(finding.fix.contains("added twice"), is_twice, "{}", finding.fix);
        }
    }
}
