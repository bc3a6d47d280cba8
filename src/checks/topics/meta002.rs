use serde_json::json;

use crate::checks::{Case, Grade, Judged};
use crate::evidence::{RepeatEvidence, RepeatKind};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Subject};

rule! {
    /// Columns repeat others, or never change.
    ///
    /// ## What it means
    /// Two columns of a table hold the same numbers in every row, to the last bit, or a column holds one
    /// value while the arm moves. What was measured twice differs in its noise: one of the two is a copy.
    ///
    /// ## Why it matters
    /// A copy confirms nothing. Commands that are the states teach a policy to stay where it is, a tracker's
    /// pose that is the controller's is no witness from outside, and a joint that is another joint leaves
    /// one of them unknown.
    ///
    /// ## Evidence
    /// `of` is what is repeated; there is none where the column holds one value. All rows of all episodes
    /// that were read repeat.
    ///
    /// A warning where commands are states, where poses from outside are the controller's, and where a joint
    /// is another one; `info` of other copies, of joints that rest, and of topics that stand still.
    ///
    /// ## How to fix
    /// See where the recorder takes the column from, and record what it should hold.
    ///
    /// ## When it misleads
    /// A recorder may write one measurement under two names on purpose, as LIBERO does; that is `info`. A
    /// joint that is not used rests to the bit where its encoder is coarse. Copies by another unit or type,
    /// and with a shift by a row, are not told; nor is anything in episodes of less than 20 rows.
    META002 {
        name: "repeated-columns",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no table in this log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    match case.evidence.repeats.as_deref() {
        None => Vec::new(),
        Some([]) => vec![Judged::new(Subject::default(), Outcome::sound())],
        Some(found) => found.iter().map(judge).collect(),
    }
}

fn judge(found: &RepeatEvidence) -> Judged {
    let RepeatEvidence { repeat, kind } = found;
    let of = repeat.of.as_deref().unwrap_or_default();
    let (severity, title, message) = match kind {
        RepeatKind::CommandIsState => (
            Severity::Warning,
            "commands are the states",
            format!("equals {of} in every row, to the bit: one of the two is a copy"),
        ),
        RepeatKind::WitnessIsOther => (
            Severity::Warning,
            "a witness is a copy",
            format!("equals {of} in every row, to the bit: it is no witness from outside"),
        ),
        RepeatKind::JointIsJoint => (
            Severity::Warning,
            "a joint is a copy of another",
            format!("equals {of} in every row of {}, to the bit", repeat.topic),
        ),
        RepeatKind::JointRests => (
            Severity::Info,
            "a joint never moves",
            format!("holds one value in every row of {} while other joints move", repeat.topic),
        ),
        RepeatKind::Still => (
            Severity::Info,
            "columns never change",
            "hold one value in every row while the arm moves; nothing is held against them"
                .to_owned(),
        ),
        RepeatKind::Same => (
            Severity::Info,
            "columns are copies",
            format!("equals {of} in every row, to the bit: it confirms nothing that {of} does not"),
        ),
    };
    let fault = Fault {
        cause: Cause::Other,
        severity,
        title,
        message,
        evidence: Evidence::default(),
        fix: "see where the recorder takes these columns from".to_owned(),
    };
    let (topic, joint) = (Some(repeat.topic.clone()), repeat.number.clone());
    Judged::new(Subject { topic, joint, ..Subject::default() }, Outcome::faulty(fault))
        .with_evidence("of", json!(repeat.of))
}
