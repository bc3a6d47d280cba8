use crate::checks::encoding::{compare_labels, inferred_units};
use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Subject};
use crate::log::{Note, RotationLabels};

rule! {
    /// Metadata contradict the data.
    ///
    /// ## What it means
    ///
    /// - The columns declared by a dataset (rate, row length, names) differ from the file's.
    /// - A column named as rad or joint position exceeds two turns, or holds a unit quaternion in each row.
    /// - Rotation columns are named roll, pitch, yaw; A, B, C (KUKA); W, P, R (FANUC); O, A, T (Kawasaki);
    ///   or x, y, z, w, but follow the arm only in another encoding.
    /// - Position or rotation columns are named in a unit in which they do not follow the arm.
    /// - Commands list their joints in a different order than the joints that follow them.
    /// - An episode's columns differ from its dataset's.
    ///
    /// ## Why it matters
    /// Loaders trust the metadata. A wrong rate scales every velocity and latency; a missing name shifts
    /// all following columns.
    ///
    /// ## Evidence
    /// One finding per contradiction, with the file and the declared and measured value.
    ///
    /// ## How to fix
    /// Correct `meta/info.json` or the name, or rewrite the dataset with the declared features.
    ///
    /// ## When it misleads
    /// - Swapped names of two joints that move alike are not found.
    /// - Rates are compared with the median interval of a stamp column. Stamps generated from the declared
    ///   rate always agree with it.
    /// - If the encoding is given (`--declare`, `--columns`, the config, `--corrections`), the names of the
    ///   rotation columns are not compared.
    /// - Joint columns are not checked here: ORD004 compares their unit with the poses. FRM007 detects a pose
    ///   that follows no arm.
    META001 {
        name: "contradicted-metadata",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no metadata that declare the columns",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let arms = case.evidence.robots.iter();
    let labelled = arms.flat_map(|arm| {
        arm.poses.iter().flat_map(|pose| [judge_labels(arm, pose), judge_units(pose)]).flatten()
    });
    let declared = match case.evidence.contradictions.as_deref() {
        None => Vec::new(),
        Some([]) => vec![SubjectResult::new(Subject::default(), Outcome::pass())],
        Some(found) => found.iter().map(judge).collect(),
    };
    declared.into_iter().chain(labelled).collect()
}

fn judge(note: &Note) -> SubjectResult {
    let file = note.file.display().to_string();
    let fix = "correct the metadata, or rewrite the dataset";
    let outcome = contradicted(note.what.clone(), fix.to_owned());
    SubjectResult::new(Subject { topic: Some(file), ..Subject::default() }, outcome)
}

fn contradicted(message: String, fix: String) -> Outcome {
    Outcome::fail(Fault {
        cause: Cause::Other,
        severity: Severity::Warning,
        title: "metadata contradict the data",
        message,
        evidence: Evidence::default(),
        fix,
    })
}

/// `None` unless columns of a pose are named in a unit in which they do not follow the arm.
fn judge_units(pose: &StreamEvidence<PoseEvidence>) -> Option<SubjectResult> {
    let named = pose.named_units;
    let is_determined = pose.diagnosis.encoding.as_ref().is_ok_and(|it| it.is_determined);
    if !pose.is_undeclared || pose.diagnosis.length_unit.is_err() {
        return None;
    }
    let (length, angle) = inferred_units(&pose.diagnosis);
    let lengths = named.length.filter(|named| *named != length).map(|named| {
        format!(
            "position columns are named in {}, but follow the arm only in {}",
            named.plural_name(),
            length.plural_name()
        )
    });
    let angles = named.angle.filter(|named| is_determined && *named != angle).map(|named| {
        format!(
            "rotation columns are named in {}, but follow the arm only in {}",
            named.plural_name(),
            angle.plural_name()
        )
    });
    let found: Vec<String> = lengths.into_iter().chain(angles).collect();
    let fix = "rename the columns, or convert the numbers".to_owned();
    (!found.is_empty()).then(|| pose.judged(contradicted(found.join("; "), fix)))
}

/// `None` if column names or motion do not determine the rotation encoding.
fn judge_labels(arm: &ArmEvidence, pose: &StreamEvidence<PoseEvidence>) -> Option<SubjectResult> {
    let labels = pose.labels?;
    let compared = compare_labels(arm, pose)?;
    let (stated, actual) = (compared.stated, compared.actual);
    let outcome = match compared.is_followed {
        true => Outcome::pass(),
        false => contradicted(
            format!(
                "rotation columns are named {} ({stated}), but they follow the arm only as {actual}",
                label_text(labels)
            ),
            format!("rename the columns, or write the rotation as {stated}"),
        ),
    };
    Some(pose.judged(outcome))
}

fn label_text(labels: RotationLabels) -> &'static str {
    match labels {
        RotationLabels::Quaternion => "x, y, z, w of a quaternion",
        RotationLabels::ScalarFirst => "w, x, y, z of a quaternion",
        RotationLabels::RollPitchYaw => "roll, pitch, yaw",
        RotationLabels::Abc => "A, B, C",
        RotationLabels::Wpr => "W, P, R",
        RotationLabels::Oat => "O, A, T",
        RotationLabels::RotationVector => "a rotation vector",
    }
}
