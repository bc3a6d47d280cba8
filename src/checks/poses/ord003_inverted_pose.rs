use crate::checks::encoding::{self, EncodingFaultKind, EncodingReport};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{EncodingEstimate, PoseDiagnosis, PoseEncoding};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::geometry::{Misread, RotationError};

rule! {
    /// A rotation or a whole pose is inverted.
    ///
    /// ## What it means
    /// - `pose-inverse`: the stream holds `tip_from_base` instead of `base_from_tip`; parent and child are
    ///   swapped.
    /// - `transpose`: only the rotation is inverted. Active and passive rotations were mixed, or a matrix
    ///   was read by columns instead of rows.
    ///
    /// ## Why it matters
    /// Inverted poses move, and transposed rotations turn, the wrong way. Both look plausible at rest, and
    /// calibrations converge to a wrong result.
    ///
    /// ## Evidence
    /// The residual against FK as logged (`as_logged_rad`) and once inverted (`corrected_rad`). Positions
    /// distinguish the two cases: an inverted pose has the base position in the tip frame.
    ///
    /// ## How to fix
    /// Publish `base_from_tip`: in tf2, call `lookup_transform(base, tip)`, not the reverse. Transpose a
    /// column-major matrix (such as Franka's `O_T_EE`) before reading it by rows.
    ///
    /// ## When it misleads
    /// With a reference frame not fixed to the robot and motion about few axes, inverted and plain
    /// orientations differ only by constant frames. The rule then prefers no fault.
    ORD003 {
        name: "inverted-pose",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no stream with orientations to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let mut judged = encoding::judge(case, EncodingFaultKind::Direction, report);
    // Positions also show an inverted pose. The orientation of a tool that points down hardly differs from its inverse.
    let inverted = case.evidence.poses().filter(|(_, stream)| {
        let found = &stream.diagnosis;
        found.is_inverted && !found.is_far_from_fk()
    });
    for (_, stream) in inverted {
        let is_open = |row: &&mut SubjectResult| matches!(row.outcome, Outcome::Inconclusive(_));
        let row = judged.iter_mut().find(|row| row.subject == stream.subject);
        if let Some(row) = row.filter(is_open) {
            *row = stream
                .judged(Outcome::fail(by_positions(&stream.diagnosis)))
                .estimated(direction(RotationError::Inverted));
        }
    }
    judged
}

fn direction(error: RotationError) -> Estimate {
    let Misread { is, read_as } = error.into();
    Estimate::misinterpretation("direction", is, read_as)
}

fn by_positions(found: &PoseDiagnosis) -> Fault {
    let residual = found.residual.as_ref().ok();
    let [before, after] = [
        residual.map(|residual_of| residual_of.before_m),
        residual.map(|residual_of| residual_of.rms_m),
    ]
    .map(|residual_of| residual_of.unwrap_or_default());
    Fault {
        severity: Severity::Error,
        cause: Cause::Rotation(RotationError::Inverted),
        title: "pose is inverted",
        message: format!(
            "positions are those of the inverse pose, {} off as logged",
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

const EXCHANGE: &str =
    "swap parent and child: publish base_from_tip, as returned by lookup_transform(base, tip)";

fn report(estimate: &EncodingEstimate) -> Option<EncodingReport> {
    let (title, what, fix, error) = match estimate.best {
        _ if estimate.is_inverted => (
            "pose is inverted",
            "the pose is inverted relative to its frame names",
            EXCHANGE,
            RotationError::Inverted,
        ),
        PoseEncoding::Transposed => (
            "rotation is transposed",
            "the rotation is transposed relative to its frame names",
            "invert the rotation where it is written; read a column-major matrix by columns",
            RotationError::Transposed,
        ),
        _ => return None,
    };
    Some(EncodingReport {
        title,
        what: what.to_owned(),
        corrected_reading: "inverted".to_owned(),
        fix: fix.to_owned(),
        error,
        estimate: direction(error),
    })
}
