use serde_json::json;

use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{RepeatedColumnEvidence, RepeatedColumnKind};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Subject};

rule! {
    /// Columns repeat others or never change.
    ///
    /// ## What it means
    /// Two columns of a table are identical in every row, bit for bit, so one is a copy: measurements
    /// differ in noise. Or a column is constant while the arm moves.
    ///
    /// ## Why it matters
    /// A copy is not independent evidence. Commands that equal the states teach a policy to stay in place.
    /// If a joint is copied from another, one of them is unknown.
    ///
    /// ## Evidence
    /// `of`: the original column; null if constant. Columns are identical in all rows of all episodes read.
    ///
    /// A warning if commands equal states, independent poses equal the controller's, or a joint equals
    /// another. Other copies, resting joints and constant topics are `info`.
    ///
    /// ## How to fix
    /// Check where the recorder takes the column from, and record the intended signal.
    ///
    /// ## When it misleads
    /// A recorder may deliberately write one measurement under two names, as LIBERO does; this is `info`.
    /// An unused joint is constant if its encoder is coarse. Copies in another unit or type, or shifted by
    /// a row, are not detected. Episodes shorter than 20 rows are skipped.
    META002 {
        name: "repeated-columns",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no table in this log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    match case.evidence.repeated_columns.as_deref() {
        None => Vec::new(),
        Some([]) => vec![SubjectResult::new(Subject::default(), Outcome::pass())],
        Some(found) => found.iter().map(judge).collect(),
    }
}

fn judge(found: &RepeatedColumnEvidence) -> SubjectResult {
    let RepeatedColumnEvidence { repeat, kind } = found;
    let of = repeat.of.as_deref().unwrap_or_default();
    let (severity, title, message) = match kind {
        RepeatedColumnKind::CommandEqualsState => (
            Severity::Warning,
            "commands equal the states",
            format!("identical to {of} in every row: one of the two is a copy"),
        ),
        RepeatedColumnKind::ReferenceEqualsRobot => (
            Severity::Warning,
            "independent pose is a copy",
            format!("identical to {of} in every row: not an independent measurement"),
        ),
        RepeatedColumnKind::IdenticalJoints => (
            Severity::Warning,
            "a joint is a copy of another",
            format!("identical to {of} in every row of {}", repeat.topic),
        ),
        RepeatedColumnKind::ConstantJoint => (
            Severity::Info,
            "a joint never moves",
            format!("constant in every row of {} while other joints move", repeat.topic),
        ),
        RepeatedColumnKind::ConstantTopic => (
            Severity::Info,
            "columns never change",
            "constant in every row while the arm moves; not compared with anything".to_owned(),
        ),
        RepeatedColumnKind::IdenticalTopics => (
            Severity::Info,
            "columns are copies",
            format!("identical to {of} in every row: it adds no evidence to {of}"),
        ),
    };
    let fault = Fault {
        cause: Cause::Other,
        severity,
        title,
        message,
        evidence: Evidence::default(),
        fix: "check where the recorder takes these columns from".to_owned(),
    };
    let (topic, joint) = (Some(repeat.topic.clone()), repeat.number.clone());
    SubjectResult::new(Subject { topic, joint, ..Subject::default() }, Outcome::fail(fault))
        .with_evidence("of", json!(repeat.of))
}
