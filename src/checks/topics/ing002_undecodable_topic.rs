use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{UndecodableContent, UndecodableTopic};
use crate::finding::{Cause, Evidence, Fault, Outcome, Picture, Severity, Subject};

rule! {
    /// A topic needed by the audit cannot be decoded.
    ///
    /// ## What it means
    /// The schema is missing or malformed, the encoding is unknown, or messages are shorter than their
    /// schema. Or a robot description cannot be parsed and no `--robot` replaces it. An arm from the
    /// catalogue may be used instead, but does not verify it.
    ///
    /// ## Why it matters
    /// The topic was not audited and may be wrong.
    ///
    /// ## Evidence
    /// The number of affected messages, and why the first could not be decoded.
    ///
    /// ## How to fix
    /// Record with the schema in the log (rosbag2 does so for MCAP since Iron), and with the publisher's
    /// message definitions.
    ///
    /// ## When it misleads
    /// A single short message, for instance from a killed recorder, also counts.
    ING002 {
        name: "undecodable-topic",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    if case.evidence.undecodable.is_empty() {
        return vec![SubjectResult::new(Subject::default(), Outcome::pass())];
    }
    case.evidence.undecodable.iter().map(judge).collect()
}

fn judge(topic: &UndecodableTopic) -> SubjectResult {
    let (message, fix) = match &topic.what {
        UndecodableContent::Messages(type_name) => (
            format!("{} messages of {type_name} cannot be decoded: {}", topic.messages, topic.why),
            "record with the publisher's message definitions",
        ),
        UndecodableContent::Description => (
            format!("robot description cannot be parsed: {}", topic.why),
            "correct the description, or pass a model with --robot",
        ),
    };
    let fault = Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Warning,
        title: "topic cannot be decoded",
        message,
        evidence: Evidence::default(),
        fix: fix.to_owned(),
    };
    let subject = Subject { topic: Some(topic.topic.clone()), ..Subject::default() };
    SubjectResult::new(subject, Outcome::fail(fault)).with_evidence("messages", topic.messages)
}
