use crate::checks::decision::not_observable;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{JointUnit, UnitResiduals};
use crate::evidence::{ArmEvidence, ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Subject, Unit};
use crate::geometry::{AngleUnit, Misread};

rule! {
    /// Degrees published as radians, or vice versa.
    ///
    /// ## What it means
    /// One, some or all joints are in degrees instead of radians (REP 103). Or all joints are in radians although
    /// column names or `--columns` state degrees. Or the declared unit of rotation numbers is wrong, either
    /// way. Undeclared numbers cannot have a wrong unit; ORD001 reports the unit assumed for them. Or an
    /// IMU's angular velocity is in degrees per second.
    ///
    /// ## Why it matters
    /// FK of degrees read as radians is noise within the arm's reach. All other rules use the converted
    /// numbers.
    ///
    /// ## Evidence
    /// The residual against FK as logged (`as_logged`) and as degrees (`corrected`): metres for joint
    /// positions, radians for rotation numbers, radians per second for a gyro, which is compared with the
    /// arm's rate without integration.
    ///
    /// ## How to fix
    /// Convert at the source with `np.deg2rad(q)` or `np.deg2rad(angular_velocity)`. Declare a stream meant
    /// to be in degrees: `--declare TOPIC=CONVENTION,deg`.
    ///
    /// ## When it misleads
    /// A prismatic joint is in metres and is not converted. Within a degree of zero, both units fit: no
    /// finding.
    ORD004 {
        name: "degrees-for-radians",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states with a stream to compare them with",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.robots.iter().filter(|arm| !arm.is_trajectory).flat_map(judge_arm).collect()
}

fn judge_arm(arm: &ArmEvidence) -> Vec<SubjectResult> {
    let topic = arm.topic(&arm.joints_topic);
    let joints = match arm.diagnosis.reported_encoding() {
        Err(why) => vec![SubjectResult::new(topic, not_observable(why, "also log a pose or /tf"))],
        Ok(_) if let Some(residuals) = arm.radians_as_degrees() => {
            let declared = AssumedUnit::Declared(AngleUnit::Degree);
            vec![judge(arm, topic, Some(residuals), Unit::Metre, declared)]
        }
        Ok(reading) => {
            let alone = reading.unit_errors(JointUnit::Degrees).map(|(unit_error, residuals)| {
                let subject = arm.joint_states(unit_error.column);
                let mut judged =
                    judge(arm, subject, Some(residuals), Unit::Metre, AssumedUnit::Logged);
                judged.caused_by(Cause::JointUnit(unit_error.factor));
                judged
            });
            let alone: Vec<SubjectResult> = alone.collect();
            match alone.is_empty() {
                true => {
                    let residuals = reading.residual.filter(|_| reading.is_in_degrees);
                    vec![judge(arm, topic, residuals, Unit::Metre, AssumedUnit::Logged)]
                }
                false => alone,
            }
        }
    };
    let numbers = arm.poses.iter().filter_map(|stream| {
        let declared = stream.declared.and_then(|declared| declared.angles);
        if stream.is_undeclared {
            let why = "no unit is declared for these numbers, so none is violated";
            return (stream.has_bare_numbers && stream.diagnosis.degrees.is_some())
                .then(|| stream.judged(Outcome::pass_with_remark(why.to_owned())));
        }
        let assumed = if stream.has_bare_numbers {
            AssumedUnit::Logged
        } else {
            AssumedUnit::Declared(declared?)
        };
        let subject = stream.subject.clone();
        let judged = judge(arm, subject, stream.diagnosis.degrees, Unit::Radian, assumed);
        Some(judged.within(stream.span))
    });
    let gyros = arm.imus.iter().filter_map(judge_gyro);
    joints.into_iter().map(|joints| joints.within(arm.span)).chain(numbers).chain(gyros).collect()
}

/// `None` if the IMU does not rotate with the arm.
fn judge_gyro(imu: &StreamEvidence<ImuEvidence>) -> Option<SubjectResult> {
    let Some(UnitResiduals { as_logged, corrected }) = imu.diagnosis.conventions.degrees else {
        let turns = imu.proof.as_ref()?.gyro.is_some();
        return turns.then(|| imu.judged(Outcome::pass()));
    };
    let [before, after] = [as_logged, corrected].map(|residual| Unit::GyroRate.show(residual));
    let topic = imu.topic();
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::Pictured(Picture::Stream),
        title: "gyro in degrees per second",
        message: format!(
            "angular velocity is in °/s instead of rad/s: residual {before} rms against the arm's rate as \
             logged, {after} once read as °/s"
        ),
        evidence: Evidence {
            effect: Some("integrating it gives 57 times too large an angle".to_owned()),
            ..Evidence::default()
        },
        fix: format!("publish {topic} in rad/s: np.deg2rad(angular_velocity)"),
    };
    let [is, read_as] = [AngleUnit::Degree, AngleUnit::Radian].map(|unit| unit.symbol());
    let judged = imu.judged(Outcome::fail(fault));
    let judged = judged.estimated(Estimate::misinterpretation("angle unit", is, read_as));
    Some(judged.with_evidence("as_logged", as_logged).with_evidence("corrected", corrected))
}

#[derive(Clone, Copy)]
enum AssumedUnit {
    /// Radians, the default.
    Logged,
    Declared(AngleUnit),
}

impl AssumedUnit {
    fn slip(self) -> Misread<AngleUnit> {
        let (degrees, radians) = (AngleUnit::Degree, AngleUnit::Radian);
        match self {
            Self::Declared(AngleUnit::Degree) => Misread { is: radians, read_as: degrees },
            Self::Logged | Self::Declared(_) => Misread { is: degrees, read_as: radians },
        }
    }
}

fn judge(
    arm: &ArmEvidence,
    subject: Subject,
    residuals: Option<UnitResiduals>,
    residual: Unit,
    assumed: AssumedUnit,
) -> SubjectResult {
    let topic = subject.joint.as_deref().or(subject.topic.as_deref()).unwrap_or_default();
    let Some(residuals) = residuals else {
        return SubjectResult::new(subject, Outcome::pass());
    };
    let unit = assumed.slip();
    let (title, what, fix) = match (assumed, unit.is) {
        (AssumedUnit::Logged, _) => (
            "degrees instead of radians",
            "the numbers are degrees instead of radians".to_owned(),
            format!("publish {topic} in radians: np.deg2rad(q)"),
        ),
        (AssumedUnit::Declared(_), AngleUnit::Degree) => (
            "degrees declared as radians",
            "the numbers are degrees but were declared as radians".to_owned(),
            format!("declare {topic} with `,deg`"),
        ),
        (AssumedUnit::Declared(_), _) => (
            "radians declared as degrees",
            "the numbers are radians but were declared as degrees".to_owned(),
            match residual {
                Unit::Metre => format!("correct the unit of {topic} in the names or in --columns"),
                _ => format!("declare {topic} without `,deg`"),
            },
        ),
    };
    let (before, after) = (residual.show(residuals.as_logged), residual.show(residuals.corrected));
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::AngleUnit(unit),
        title,
        message: format!("{what}, {before} off as logged"),
        evidence: Evidence {
            effect: Some(format!("{after} once read as {}", unit.is.plural_name())),
            effect_m: Some(match residual {
                Unit::Metre => residuals.as_logged,
                _ => residuals.as_logged * arm.reach_m,
            }),
            ..Evidence::default()
        },
        fix,
    };
    SubjectResult::new(subject, Outcome::fail(fault))
        .estimated(Estimate::misinterpretation(
            "angle unit",
            unit.is.symbol(),
            unit.read_as.symbol(),
        ))
        .with_evidence("as_logged", residuals.as_logged)
        .with_evidence("corrected", residuals.corrected)
}
