use serde_json::{Value, json};

use crate::checks::decision::Threshold;
use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::StreamEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Subject, Unit};
use crate::run::{NormDefects, RotationStorage};

rule! {
    /// Quaternions are not unit-norm, or matrices not orthonormal.
    ///
    /// ## What it means
    /// The maximum of `| |q| − 1 |`, or of `max |RᵀR − I|` for matrices, over all samples of a stream
    /// reaches the threshold. All-zero quaternions were never set; they are counted but not judged.
    ///
    /// ## Why it matters
    /// Consumers normalise, scale and shear, or throw. A norm that dips between samples indicates
    /// component-wise interpolation of orientations; the angle is then also wrong.
    ///
    /// ## Evidence
    /// - `written`: `quaternion` or `matrix`.
    /// - `median`: median defect. It distinguishes a rough encoding from single bad samples.
    /// - `unset`: number of all-zero quaternions; `at_ns`: stamp of the largest defect.
    /// - `frames`: affected transforms of a TF topic, each with its largest defect.
    ///
    /// ## How to fix
    /// Interpolate rotations along the arc (slerp), not their components or matrix entries, and normalise
    /// before publishing. If all samples deviate equally, look for fixed-point or single-precision numbers,
    /// or values printed with few digits.
    ///
    /// ## When it misleads
    /// Quaternions printed with three decimals deviate by up to 1e-3. Components in the wrong order have
    /// unit norm; ORD002 detects them.
    FRM005 {
        name: "not-a-rotation",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: false,
        missing: "no stream with quaternions or matrices in this log",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::One, warning: 1e-3, error: 1e-2 };
/// In the evidence.
const MAX_LISTED: usize = 10;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.norms.iter().map(|norms| judge(case, norms)).collect()
}

fn judge(case: &Case, stream: &StreamEvidence<Vec<NormDefects>>) -> SubjectResult {
    let threshold = case.thresholds.threshold(&FRM005, THRESHOLD);
    let worst = stream.iter().max_by(|a, b| a.largest.total_cmp(&b.largest));
    let Some(worst) = worst.filter(|worst| worst.rows > 0) else {
        let outcome = Outcome::Skipped("none of its quaternions is set".to_owned());
        return stream.judged(outcome);
    };
    let unset: usize = stream.iter().map(|part| part.unset).sum();
    let concerned: Vec<&NormDefects> =
        stream.iter().filter(|part| threshold.severity(part.largest).is_some()).collect();
    let subject = match concerned.as_slice() {
        [only] if stream.len() > 1 => {
            let frame = only.frame.clone().or_else(|| stream.subject.frame.clone());
            Subject { frame, ..stream.subject.clone() }
        }
        _ => stream.subject.clone(),
    };
    let outcome = match threshold.severity(worst.largest) {
        Some(severity) => Outcome::fail(fault(case, worst, severity)),
        None if unset > 0 => Outcome::pass_with_remark(format!("{unset} quaternions are not set")),
        None => Outcome::pass(),
    };
    let frames: Vec<Value> = concerned
        .iter()
        .take(MAX_LISTED)
        .filter_map(|part| Some(json!({ "frame": part.frame.as_ref()?, "largest": part.largest })))
        .collect();
    SubjectResult::new(subject, outcome)
        .within(stream.span)
        .estimated(Estimate::exact("largest defect", Unit::One.symbol(), worst.largest))
        .with_evidence("written", storage_name(worst.storage))
        .with_evidence("median", worst.median)
        .with_evidence("unset", unset)
        .with_evidence("at_ns", worst.at.map(|at| at.to_string()))
        .with_evidence("frames", frames)
}

fn storage_name(written: RotationStorage) -> &'static str {
    match written {
        RotationStorage::Quaternion => "quaternion",
        RotationStorage::Matrix => "matrix",
    }
}

fn fault(case: &Case, worst: &NormDefects, severity: Severity) -> Fault {
    let shown = Unit::One.show(worst.largest);
    let when = worst.at.map_or(String::new(), |at| format!(" at {}", case.evidence.moment(at)));
    let half = match case.thresholds.threshold(&FRM005, THRESHOLD).severity(worst.median) {
        Some(_) => format!("median {}", Unit::One.show(worst.median)),
        None => "most samples are within the limit".to_owned(),
    };
    let (title, what) = match worst.storage {
        RotationStorage::Quaternion => {
            ("quaternion is not of unit norm", "quaternion norms deviate from 1")
        }
        RotationStorage::Matrix => {
            ("matrix is not orthonormal", "matrices deviate from orthonormal")
        }
    };
    Fault {
        cause: Cause::Pictured(Picture::RotationNorm),
        severity,
        title,
        message: format!("{what} by up to {shown}{when}, {half}"),
        evidence: Evidence::default(),
        fix: "interpolate along the arc (slerp), and normalise before publishing".to_owned(),
    }
}
