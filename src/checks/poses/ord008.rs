use crate::checks::decision::unseen;
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{AccelSlip, JointUnit, LengthSlip};
use crate::evidence::{ArmEvidence, ImuEvidence, Of, PoseEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Unit, rounded};
use crate::geometry::{LengthScale, Slip};

rule! {
    /// Millimetres, or another unit, published as metres, or vice versa.
    ///
    /// ## What it means
    /// The positions of a pose stream are in another unit than the metres that a message wants (REP 103):
    /// millimetres as pendants show them, centimetres, inches, tenths of a millimetre. Or the positions
    /// of a sliding joint are millimetres or centimetres. Of a stream that was declared it is the
    /// declaration that names the wrong unit, either way. Or the linear acceleration of an IMU is in g,
    /// thousandths of it or cm/s² where a message wants m/s²: then the other rules judge the IMU with it
    /// converted.
    ///
    /// ## Why it matters
    /// The tip appears a thousand times too far out. What does not crash on that will scale it
    /// silently somewhere else.
    ///
    /// ## Evidence
    /// The factor is estimated from the motion, with the frames that it may need left free. Where it is
    /// that of a usual unit to 2 %, that unit is named, else the metres of one number. What the positions
    /// leave against forward kinematics as metres is `as_logged_m`, in the unit found `corrected_m`. A unit
    /// is named only where it explains the positions. Of an accelerometer, `felt` is the size of the
    /// specific force in the logged numbers, the median at rest: 9.81 in m/s², 1 in g.
    ///
    /// ## How to fix
    /// Convert where the message is filled. A bare array of which nothing is declared has no unit to
    /// violate; what it was read as is said by ORD001. To hold it to millimetres declare it:
    /// `--declare TOPIC=CONVENTION,mm`.
    ///
    /// ## When it misleads
    /// A factor of a thousand and a scale error of a thousand are the same thing; nothing else
    /// comes near it. A factor within a quarter of 1 is growth (ZER002) and no unit. Where the tip turns
    /// about one point only, a long tool does what a unit does; the unit is named.
    ORD008 {
        name: "millimetres-for-metres",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let streams = case.evidence.poses_and_tf();
    let judged = streams.map(|(_, stream)| {
        let outcome = match &stream.diagnosis.length {
            Err(why) => unseen(why, "move the tip by 10 cm or more"),
            Ok(None) => Outcome::sound(),
            Ok(Some(slip)) if stream.bare => Outcome::sound_because(format!(
                "read as {}: bare numbers of which nothing is declared have no unit to violate",
                slip.is.words()
            )),
            Ok(Some(slip)) if stream.diagnosis.strays() => Outcome::Inconclusive(format!(
                "{} would leave {}, which explains nothing (MDL001)",
                slip.is.words(),
                Unit::Metre.show(slip.residual.corrected)
            )),
            Ok(Some(slip)) => {
                let LengthSlip { is, read_as, residual } = slip;
                return stream
                    .judged(Outcome::faulty(fault(stream, slip)))
                    .estimated(Estimate::slip("length unit", is.to_string(), read_as.to_string()))
                    .with_evidence("as_logged_m", residual.as_logged)
                    .with_evidence("corrected_m", residual.corrected);
            }
        };
        stream.judged(outcome)
    });
    let imus = case.evidence.imus().filter_map(|(_, imu)| judge_accelerometer(imu));
    judged.chain(case.evidence.robots.iter().flat_map(judge_joints)).chain(imus).collect()
}

/// The unit of an accelerometer; `None` of one that feels nothing or motion alone.
fn judge_accelerometer(imu: &Of<ImuEvidence>) -> Option<Judged> {
    let Some(AccelSlip { unit, felt }) = imu.diagnosis.numbers.accel else {
        let feels = imu.proof.as_ref()?.gravity_m_s2.is_some();
        return feels.then(|| imu.judged(Outcome::sound()).within(imu.span));
    };
    let (topic, symbol) = (imu.topic(), unit.symbol());
    let size = rounded(felt, 2);
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::Seen(Sight::Stream),
        title: "accelerometer not in m/s²",
        message: format!(
            "linear acceleration is in {symbol} where m/s² belong: it reads {size} at rest, where \
             gravity is 9.81 m/s²"
        ),
        evidence: Evidence::default(),
        fix: format!("multiply the linear acceleration of {topic} by {}", unit.in_m_s2()),
    };
    let judged = imu.judged(Outcome::faulty(fault)).within(imu.span);
    let judged = judged.estimated(Estimate::slip("acceleration unit", symbol, "m/s²"));
    Some(judged.with_evidence("felt", felt))
}

/// The sliding joints whose positions are not metres.
fn judge_joints(arm: &ArmEvidence) -> Vec<Judged> {
    let Ok(reading) = &arm.diagnosis.reading else { return Vec::new() };
    let units = [
        (JointUnit::Millimetres, "mm", "millimetres", 1000),
        (JointUnit::Centimetres, "cm", "centimetres", 100),
    ];
    let slips = units.into_iter().flat_map(|(unit, is, what, number)| {
        reading.slips_of(unit).map(move |(slip, left)| (slip, left, is, what, number))
    });
    let judged = slips.map(|(slip, left, is, what, number)| {
        let subject = arm.joint_states(slip.column);
        let joint = subject.joint.as_deref().unwrap_or_default();
        let (before, after) = (Unit::Metre.show(left.as_logged), Unit::Metre.show(left.corrected));
        let fault = Fault {
            severity: Severity::Error,
            cause: Cause::JointUnit(slip.factor),
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
            .estimated(Estimate::slip("length unit", is, "m"))
            .with_evidence("as_logged_m", left.as_logged)
            .with_evidence("corrected_m", left.corrected)
    });
    judged.collect()
}

/// The fault of positions that are in another unit than they were read as.
fn fault(stream: &Of<PoseEvidence>, slip: &LengthSlip) -> Fault {
    let topic = stream.topic();
    let (is, read_as) = (slip.is.words(), slip.read_as.words());
    let is_metres = slip.is == LengthScale::METRE;
    let is_millimetres = slip.is == LengthScale::MILLIMETRE;
    let (title, what, fix) = match stream.declared {
        Some(_) => (
            if is_metres {
                "metres declared as millimetres"
            } else {
                "another unit of length declared"
            },
            format!("positions are {is} and were declared as {read_as}"),
            match (is_metres, is_millimetres) {
                (true, _) => format!("declare {topic} without `,mm`"),
                (_, true) => format!("declare {topic} with `,mm`"),
                _ => format!("publish {topic} in metres"),
            },
        ),
        None => (
            if is_millimetres {
                "millimetres where metres belong"
            } else {
                "another unit of length where metres belong"
            },
            format!("positions are {is} where metres belong"),
            match is_millimetres {
                true => format!("divide the positions of {topic} by 1000"),
                false => format!("multiply the positions of {topic} by {}", slip.is.in_m()),
            },
        ),
    };
    let [before, after] =
        [slip.residual.as_logged, slip.residual.corrected].map(|left| Unit::Metre.show(left));
    Fault {
        severity: Severity::Error,
        cause: Cause::LengthUnit(Slip { is: slip.is, read_as: slip.read_as }),
        title,
        message: format!("{what}, {before} off as logged"),
        evidence: Evidence {
            effect: Some(format!("{after} once read as {is}")),
            effect_m: Some(slip.residual.as_logged),
            ..Evidence::default()
        },
        fix,
    }
}
