use crate::checks::{Case, Grade, Judged};
use crate::evidence::{Undecodable, UndecodableTopic};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Sight, Subject};

rule! {
    /// A topic that the audit wants cannot be decoded.
    ///
    /// ## What it means
    /// The topic's type is one that an audit uses, but its messages cannot be read: the schema is
    /// missing or malformed, the encoding is unknown, or messages are shorter than the schema says. Or
    /// the topic holds a robot description that cannot be read, and no `--robot` stands in for it: the
    /// catalogue's arm may, and is no proof that the description is right.
    ///
    /// ## Why it matters
    /// What is on the topic was not audited. That must not be taken for "fine".
    ///
    /// ## Evidence
    /// How many messages are concerned, and why the first of them could not be read.
    ///
    /// ## How to fix
    /// Record with the schema in the log (rosbag2 does so for MCAP since Iron), and with the
    /// message definitions that the publisher was built with.
    ///
    /// ## When it misleads
    /// A single short message, as of a recorder that was killed, counts like any other.
    ING002 {
        name: "undecodable-topic",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    if case.evidence.undecodable.is_empty() {
        return vec![Judged::new(Subject::default(), Outcome::sound())];
    }
    case.evidence.undecodable.iter().map(judge).collect()
}

fn judge(topic: &UndecodableTopic) -> Judged {
    let (message, fix) = match &topic.what {
        Undecodable::Messages(type_name) => (
            format!("{} messages of {type_name} cannot be decoded: {}", topic.messages, topic.why),
            "record with the message definitions that the publisher was built with",
        ),
        Undecodable::Description => (
            format!("its robot description cannot be read: {}", topic.why),
            "correct the description, or name the model with --robot",
        ),
    };
    let fault = Fault {
        cause: Cause::Seen(Sight::Stream),
        severity: Severity::Warning,
        title: "topic cannot be decoded",
        message,
        evidence: Evidence::default(),
        fix: fix.to_owned(),
    };
    let subject = Subject { topic: Some(topic.topic.clone()), ..Subject::default() };
    Judged::new(subject, Outcome::faulty(fault)).with_evidence("messages", topic.messages)
}
