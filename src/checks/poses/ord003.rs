use crate::checks::reading::{self, Kind, Wording};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{PoseDiagnosis, Reading, ReadingEstimate};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::geometry::{RotationSlip, Slip};

rule! {
    /// A rotation or a whole pose is inverted.
    ///
    /// ## What it means
    /// `pose-inverse`: the stream holds `tip_from_base` where `base_from_tip` belongs; parent and
    /// child are exchanged. `transpose`: only the rotation is inverted, the position is right;
    /// somebody mixed active and passive rotations, or read a matrix by columns instead of rows.
    ///
    /// ## Why it matters
    /// An inverted pose moves the wrong way, and a transposed one turns the wrong way. Both look
    /// plausible at rest, and both make a calibration converge to a wrong answer.
    ///
    /// ## Evidence
    /// The residual against forward kinematics as logged (`as_logged_rad`) and once inverted
    /// (`corrected_rad`). Positions separate the two: those of an inverted pose are the base seen
    /// from the tip.
    ///
    /// ## How to fix
    /// Publish `base_from_tip`: in tf2, `lookup_transform(base, tip)` and not the other way round.
    /// Transpose a matrix that is stored by columns (Franka's `O_T_EE` is) before it is read by
    /// rows.
    ///
    /// ## When it misleads
    /// Where the reference frame is not tied to the robot, inverse and plain orientation differ by
    /// constant frames only for motions about few axes; the rule then prefers no fault.
    ORD003 {
        name: "inverted-pose",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no stream with orientations beside the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let mut judged = reading::judge(case, Kind::Direction, word);
    // Positions tell an inverse where orientations say nothing.
    let inverted = case.evidence.poses().filter(|(_, stream)| {
        let found = &stream.diagnosis;
        found.inverted && found.reading.is_err() && !found.strays()
    });
    for (_, stream) in inverted {
        if let Some(row) = judged.iter_mut().find(|row| row.subject == stream.subject) {
            *row = stream
                .judged(Outcome::faulty(by_positions(&stream.diagnosis)))
                .estimated(direction(RotationSlip::Inverted));
        }
    }
    judged
}

/// The estimate of a transposed rotation or an inverted pose.
fn direction(slip: RotationSlip) -> Estimate {
    let Slip { is, read_as } = slip.into();
    Estimate::slip("direction", is, read_as)
}

fn by_positions(found: &PoseDiagnosis) -> Fault {
    let residual = found.residual.as_ref().ok();
    let [before, after] = [residual.map(|left| left.before_m), residual.map(|left| left.rms_m)]
        .map(|left| left.unwrap_or_default());
    Fault {
        severity: Severity::Error,
        cause: Cause::Rotation(RotationSlip::Inverted),
        title: "pose is inverted",
        message: format!(
            "positions are those of the inverse of what its frames say, {} off as logged",
            Unit::Metre.show(before)
        ),
        evidence: Evidence {
            effect: Some(format!("{} once inverted", Unit::Metre.show(after))),
            effect_m: Some(before),
            ..Evidence::default()
        },
        fix: EXCHANGE.to_owned(),
    }
}

/// How an inverse pose is mended.
const EXCHANGE: &str =
    "exchange parent and child: publish base_from_tip, as lookup_transform(base, tip) gives it";

fn word(estimate: &ReadingEstimate) -> Option<Wording> {
    let (title, what, fix, slip) = match estimate.best {
        _ if estimate.inverted => (
            "pose is inverted",
            "the pose is the inverse of what its frames say",
            EXCHANGE,
            RotationSlip::Inverted,
        ),
        Reading::Transposed => (
            "rotation is transposed",
            "the rotation is the transpose of what the frames say",
            "invert the rotation where it is written; a matrix stored by columns is read by columns",
            RotationSlip::Transposed,
        ),
        _ => return None,
    };
    Some(Wording {
        title,
        what: what.to_owned(),
        once: "inverted".to_owned(),
        fix: fix.to_owned(),
        slip,
        estimate: direction(slip),
    })
}
