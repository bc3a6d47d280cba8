use serde_json::{Value, json};

use crate::checks::decision::Threshold;
use crate::checks::{Case, Grade, Judged};
use crate::evidence::Of;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Subject, Unit};
use crate::run::{Norms, Written};

rule! {
    /// Quaternions are not of unit norm, or matrices not orthonormal.
    ///
    /// ## What it means
    /// The numbers of a rotation are no rotation: the largest of `| |q| − 1 |` over all samples of a
    /// stream, or of `max |RᵀR − I|` where it logs matrices, reaches the threshold. Quaternions of all
    /// zeros were never set; they are counted and not judged.
    ///
    /// ## Why it matters
    /// Every reader mends it in a way of its own: one normalises, one scales and shears what it
    /// turns, one throws. A norm that dips between samples is the mark of orientations that were
    /// blended number by number, and then the angle is wrong, too, not only the norm.
    ///
    /// ## Evidence
    /// `written` is `quaternion` or `matrix`; `median` the defect that half of the samples exceed,
    /// which tells a coding that is always rough from single samples; `unset` how many quaternions
    /// are all zeros; `at_ns` the stamp of the largest defect; `frames` lists the transforms of a TF
    /// topic that are concerned, each with its largest defect.
    ///
    /// ## How to fix
    /// Interpolate rotations along the arc (slerp), not their components or matrix entries, and
    /// normalise before publishing. Where all samples are off by the same, look for a fixed-point or
    /// single-precision conversion, or for numbers printed with few digits.
    ///
    /// ## When it misleads
    /// Quaternions printed with three decimals are off by up to 1e-3. Components in the wrong order
    /// have unit norm all the same; that is ORD002's.
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
/// Transforms that the evidence lists.
const LISTED: usize = 10;

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.norms.iter().map(|norms| judge(case, norms)).collect()
}

fn judge(case: &Case, stream: &Of<Vec<Norms>>) -> Judged {
    let threshold = case.thresholds.of(&FRM005, THRESHOLD);
    let worst = stream.iter().max_by(|a, b| a.largest.total_cmp(&b.largest));
    let Some(worst) = worst.filter(|worst| worst.rows > 0) else {
        let outcome = Outcome::Skipped("none of its quaternions is set".to_owned());
        return stream.judged(outcome);
    };
    let unset: usize = stream.iter().map(|part| part.unset).sum();
    let concerned: Vec<&Norms> =
        stream.iter().filter(|part| threshold.severity(part.largest).is_some()).collect();
    let subject = match concerned.as_slice() {
        [only] if stream.len() > 1 => {
            let frame = only.frame.clone().or_else(|| stream.subject.frame.clone());
            Subject { frame, ..stream.subject.clone() }
        }
        _ => stream.subject.clone(),
    };
    let outcome = match threshold.severity(worst.largest) {
        Some(severity) => Outcome::faulty(fault(case, worst, severity)),
        None if unset > 0 => Outcome::sound_because(format!("{unset} quaternions are not set")),
        None => Outcome::sound(),
    };
    let frames: Vec<Value> = concerned
        .iter()
        .take(LISTED)
        .filter_map(|part| Some(json!({ "frame": part.frame.as_ref()?, "largest": part.largest })))
        .collect();
    Judged::new(subject, outcome)
        .within(stream.span)
        .estimated(Estimate::counted("largest defect", Unit::One.symbol(), worst.largest))
        .with_evidence("written", word(worst.written))
        .with_evidence("median", worst.median)
        .with_evidence("unset", unset)
        .with_evidence("at_ns", worst.at.map(|at| at.to_string()))
        .with_evidence("frames", frames)
}

fn word(written: Written) -> &'static str {
    match written {
        Written::Quaternion => "quaternion",
        Written::Matrix => "matrix",
    }
}

fn fault(case: &Case, worst: &Norms, severity: Severity) -> Fault {
    let shown = Unit::One.show(worst.largest);
    let when = worst.at.map_or(String::new(), |at| format!(" at {}", case.evidence.moment(at)));
    let half = match case.thresholds.of(&FRM005, THRESHOLD).severity(worst.median) {
        Some(_) => format!("median {}", Unit::One.show(worst.median)),
        None => "most samples by less than the limit".to_owned(),
    };
    let (title, what) = match worst.written {
        Written::Quaternion => {
            ("quaternion is not of unit norm", "quaternion norms deviate from 1")
        }
        Written::Matrix => ("matrix is not orthonormal", "matrices deviate from orthonormal"),
    };
    Fault {
        cause: Cause::Seen(Sight::Norm),
        severity,
        title,
        message: format!("{what} by up to {shown}{when}, {half}"),
        evidence: Evidence::default(),
        fix: "interpolate along the arc (slerp), and normalise before publishing".to_owned(),
    }
}
