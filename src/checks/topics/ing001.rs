use crate::checks::{Case, Grade, Judged};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Span, Subject};
use crate::log::{Extent, Loss};

rule! {
    /// The log is damaged.
    ///
    /// ## What it means
    /// Part of the file is unreadable; the rest was audited.
    ///
    /// ## Why it matters
    /// Without an index nothing is lost but time. Where messages are lost, a verdict on the rest is
    /// not a verdict on the run.
    ///
    /// ## Evidence
    /// Where the damage begins (`offset`, bytes from the start of the file) and how many messages
    /// went with it (`messages_lost`), as far as anything in the file says so. The time of the finding
    /// is that of what was lost, where the file says so. Of a table the rows that are lost are named with their
    /// column: `messages_lost` counts rows.
    ///
    /// ## How to fix
    /// Record again where messages are lost; see whether the disk was full or the recorder was
    /// killed. A missing index is made again by `mcap recover`. What is not read, because it would unpack to
    /// more than 16 GiB and 2000 times the size of the file (a bz2 chunk or a packed file to a sixteenth of
    /// that), or because its numbers would take more memory than 32 MiB and 32 times the size of its files (tables),
    /// is read with `--max-unpacked GIB`.
    ///
    /// ## When it misleads
    /// It is a warning where only index, summary or a partial last chunk is missing, as after a
    /// recorder was killed, or where the log is sound and this program did not read all of it unasked; it
    /// is an error where messages amid the file are lost. A Zarr or HDF5 chunk that is missing is no loss if the
    /// numbers before and after it are the fill value, too: writers leave such chunks out. Bits that flipped in
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

fn check(case: &Case) -> Vec<Judged> {
    if case.evidence.losses.is_empty() {
        return vec![Judged::new(Subject::default(), Outcome::sound())];
    }
    case.evidence.losses.iter().map(judge).collect()
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
        Extent::Unread => (
            Severity::Warning,
            "a part of the log is not read",
            "audit again with --max-unpacked GIB, or audit a part of the log alone",
        ),
        Extent::Messages => {
            (Severity::Error, "messages are lost", "record again, or audit the sound part alone")
        }
    };
    let fault = Fault {
        cause: Cause::Other,
        severity,
        title,
        message: message(loss),
        evidence: Evidence::default(),
        fix: fix.to_owned(),
    };
    Judged::new(Subject { topic: Some(file), ..Subject::default() }, Outcome::faulty(fault))
        .within(loss.span.map(|(start, end)| Span { start, end }))
        .with_evidence("offset", loss.offset)
        .with_evidence("messages_lost", loss.messages)
}

/// Where it is, what it is, and what it took.
fn message(loss: &Loss) -> String {
    let place = loss.offset.map_or_else(String::new, |offset| format!("at byte {offset}: "));
    let seconds = loss.span.map(|(start, end)| end.seconds_since(start));
    let gone = if loss.extent == Extent::Unread { "not read" } else { "lost" };
    let lost = match (loss.messages, seconds) {
        (None, None) => String::new(),
        (None, Some(seconds)) => format!("; what is {gone} lasts {seconds:.3} s"),
        (Some(0), _) => format!("; no message is {gone}"),
        (Some(1), _) => format!("; one message is {gone}"),
        (Some(messages), None) => format!("; {messages} messages are {gone}"),
        (Some(messages), Some(seconds)) => {
            format!("; {messages} messages within {seconds:.3} s are {gone}")
        }
    };
    format!("{place}{}{lost}", loss.what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Stamp;

    #[test]
    fn the_place_stands_first_and_what_is_lost_last() {
        const WHAT: &str = "the file ends within a chunk; 813 messages of it were read";
        let span = Some((Stamp::from_nanos(2_000_000_000), Stamp::from_nanos(2_512_000_000)));
        for (offset, messages, span, expected) in [
            (Some(38), None, None, format!("at byte 38: {WHAT}")),
            (None, Some(0), None, format!("{WHAT}; no message is lost")),
            (None, Some(1), span, format!("{WHAT}; one message is lost")),
            (None, Some(12), None, format!("{WHAT}; 12 messages are lost")),
            (
                Some(38),
                Some(12),
                span,
                format!("at byte 38: {WHAT}; 12 messages within 0.512 s are lost"),
            ),
            (None, None, span, format!("{WHAT}; what is lost lasts 0.512 s")),
        ] {
            let (file, what) = ("run.mcap".into(), WHAT.to_owned());
            let loss = Loss { file, offset, what, messages, span, extent: Extent::Tail };
            assert_eq!(message(&loss), expected);
        }
    }
}
