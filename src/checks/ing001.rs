use crate::checks::{Facts, Grade, Judged};
use crate::finding::{Evidence, Fault, Outcome, Severity, Span, Subject};
use crate::log::{Extent, Loss};

rule! {
    /// The log is damaged.
    ///
    /// ## What it means
    /// A part of the file cannot be read. What can be read around it was read and is audited.
    ///
    /// ## Why it matters
    /// Without an index nothing is lost but time. Where messages are lost, a verdict on the rest is
    /// not a verdict on the run.
    ///
    /// ## Evidence
    /// Where the damage begins (`offset`, bytes from the start of the file) and how many messages
    /// went with it (`messages_lost`), as far as anything in the file says so. The time of the finding
    /// is that of what was lost, where the file says so.
    ///
    /// ## How to fix
    /// Record again where messages are lost; see whether the disk was full or the recorder was
    /// killed. A missing index is made again by `mcap recover`.
    ///
    /// ## When it misleads
    /// It is a warning where only index, summary or a partial last chunk is missing, as after a
    /// recorder was killed, and an error where messages amid the file are lost. Bits that flipped in
    /// a file without checksums are not seen; `--verify` checks all the checksums that there are.
    ING001 {
        name: "damaged-log",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: false,
        missing: "no log",
        check: check,
    }
}

fn check(facts: &Facts) -> Vec<Judged> {
    if facts.losses.is_empty() {
        return vec![Judged::new(Subject::default(), Outcome::sound())];
    }
    facts.losses.iter().map(judge).collect()
}

fn judge(loss: &Loss) -> Judged {
    let file = loss.file.display().to_string();
    let (severity, title, fix) = match loss.extent {
        Extent::Index => {
            (Severity::Warning, "index is missing", "write the index anew: mcap recover")
        }
        Extent::Tail => (
            Severity::Warning,
            "end of the log is cut off",
            "stop the recorder before it is killed",
        ),
        Extent::Messages => {
            (Severity::Error, "messages are lost", "record again, or audit the sound part alone")
        }
    };
    let place = loss.offset.map_or_else(String::new, |offset| format!(" at byte {offset}"));
    let mut lost = match loss.messages {
        Some(messages) => format!(", {messages} messages lost"),
        None => String::new(),
    };
    if let Some((start, end)) = loss.span {
        lost += &format!(" of {:.3} s", end.seconds_since(start));
    }
    let fault = Fault {
        severity,
        title,
        message: format!("{}{place}{lost}", loss.what),
        evidence: Evidence::default(),
        fix: fix.to_owned(),
    };
    Judged::new(Subject { topic: Some(file), ..Subject::default() }, Outcome::faulty(fault))
        .within(loss.span.map(|(start, end)| Span { start, end }))
        .with_evidence("offset", loss.offset)
        .with_evidence("messages_lost", loss.messages)
}
