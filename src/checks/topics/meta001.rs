use crate::checks::{Case, Grade, Judged};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Subject};
use crate::log::Note;

rule! {
    /// Metadata contradict the numbers.
    ///
    /// ## What it means
    /// What a dataset declares of its columns (the rate, how many numbers a row has, their names) is not
    /// what the file holds; or the name of a column says rad or joint position, and its numbers go beyond two
    /// turns or hold a unit quaternion in each row; or commands name their numbers in another order than the
    /// joints that these move as; or an episode's columns are others than its dataset's.
    ///
    /// ## Why it matters
    /// Loaders believe the metadata. A wrong rate scales every velocity and every latency; a name too few
    /// shifts the meaning of all numbers behind it.
    ///
    /// ## Evidence
    /// One finding for each contradiction, with the file; the message has the declared and the measured value.
    ///
    /// ## How to fix
    /// Correct `meta/info.json` or the name, or write the dataset again with the features it declares.
    ///
    /// ## When it misleads
    /// Two joints that move alike are not told from each other, and swapped names of such are not found. Rates are compared with the median step of the stamps, where the stamps are a column: stamps that the
    /// recorder made from the declared rate agree with it whatever the true rate was. Other
    /// units and meanings are not compared here: joints in degrees are ORD004's, a pose that follows no arm is
    /// FRM007's.
    META001 {
        name: "contradicted-metadata",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no metadata that declare what the numbers are",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    match case.evidence.contradictions.as_deref() {
        None => Vec::new(),
        Some([]) => vec![Judged::new(Subject::default(), Outcome::sound())],
        Some(found) => found.iter().map(judge).collect(),
    }
}

fn judge(note: &Note) -> Judged {
    let file = note.file.display().to_string();
    let fault = Fault {
        cause: Cause::Other,
        severity: Severity::Warning,
        title: "metadata contradict the numbers",
        message: note.what.clone(),
        evidence: Evidence::default(),
        fix: "correct the metadata, or write the dataset again".to_owned(),
    };
    Judged::new(Subject { topic: Some(file), ..Subject::default() }, Outcome::faulty(fault))
}
