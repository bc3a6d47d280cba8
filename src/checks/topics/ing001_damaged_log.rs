use crate::checks::{Case, Grade, SubjectResult};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Span, Subject};
use crate::log::{Extent, Loss};

rule! {
    /// The log is damaged.
    ///
    /// ## What it means
    /// Part of the file is unreadable; the rest was audited.
    ///
    /// ## Why it matters
    /// A missing index costs only time. If messages are lost, a verdict on the rest is not a verdict on the
    /// run.
    ///
    /// ## Evidence
    /// - `offset`: start of the damage, in bytes from the start of the file.
    /// - `messages_lost`: lost messages, if known; for a table, rows, and the message names the column.
    /// - The finding is dated to the lost messages, if known.
    ///
    /// ## How to fix
    /// If messages are lost, record again, and check for a full disk or a killed recorder. `mcap recover`
    /// rebuilds a missing index. Two size limits leave data unread; raise them with `--max-unpacked GIB`:
    ///
    /// - Unpacking to more than 16 GiB and 2000 times the file size (a sixteenth of both for a bz2 chunk or
    ///   a packed file).
    /// - Tables that need more memory than 32 MiB and 32 times the size of their files.
    ///
    /// ## When it misleads
    /// - A warning if only the index, the summary or a partial last chunk is missing (a killed recorder), a
    ///   sound log exceeds the size limits, or a segment cannot be audited. An error if messages within the
    ///   file are lost.
    /// - Table rows without a usable number are missing samples (ING003). Rows with some count here.
    /// - Missing Zarr or HDF5 chunks are not a loss if the values around them equal the fill value: writers
    ///   omit such chunks.
    /// - Bit errors in a file without checksums are not detected. `--verify` checks all existing checksums.
    ING001 {
        name: "damaged-log",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: false,
        missing: "no log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    if case.evidence.losses.is_empty() {
        return vec![SubjectResult::new(Subject::default(), Outcome::pass())];
    }
    case.evidence.losses.iter().map(judge).collect()
}

fn judge(loss: &Loss) -> SubjectResult {
    let file = loss.file.display().to_string();
    let (severity, title, fix) = match loss.extent {
        Extent::Index => (
            Severity::Warning,
            "index is missing",
            "rebuild the index: `mcap recover`, or `rosbag reindex` for a ROS 1 bag",
        ),
        Extent::Tail => (
            Severity::Warning,
            "end of the log is missing",
            "stop the recorder before it is killed",
        ),
        Extent::Unread => (
            Severity::Warning,
            "part of the log was not read",
            "audit again with --max-unpacked GIB, or audit part of the log",
        ),
        Extent::NotAudited => (
            Severity::Warning,
            "segment is not audited",
            "audit the segment alone, or cut it off if it is not part of the run",
        ),
        Extent::Messages => {
            (Severity::Error, "messages are lost", "record again, or audit only the undamaged part")
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
    SubjectResult::new(Subject { topic: Some(file), ..Subject::default() }, Outcome::fail(fault))
        .within(loss.span.map(|(start, end)| Span { start, end }))
        .with_evidence("offset", loss.offset)
        .with_evidence("messages_lost", loss.messages)
}

fn message(loss: &Loss) -> String {
    let place = loss.offset.map_or_else(String::new, |offset| format!("at byte {offset}: "));
    let seconds = loss.span.map(|(start, end)| end.seconds_since(start));
    let gone = match loss.extent {
        Extent::Unread => "not read",
        Extent::NotAudited => "not audited",
        Extent::Index | Extent::Tail | Extent::Messages => "lost",
    };
    let lost = match (loss.messages, seconds) {
        (None, None) => String::new(),
        (None, Some(seconds)) => format!("; {seconds:.3} s of data {gone}"),
        (Some(0), _) => format!("; no messages {gone}"),
        (Some(1), _) => format!("; 1 message {gone}"),
        (Some(messages), None) => format!("; {messages} messages {gone}"),
        (Some(messages), Some(seconds)) => {
            format!("; {messages} messages within {seconds:.3} s {gone}")
        }
    };
    format!("{place}{}{lost}", loss.what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Stamp;

    #[test]
    fn a_loss_starts_with_its_place_and_ends_with_its_size() {
        const WHAT: &str = "the file ends within a chunk; 813 of its messages were read";
        let span = Some((Stamp::from_nanos(2_000_000_000), Stamp::from_nanos(2_512_000_000)));
        for (offset, messages, span, expected) in [
            (Some(38), None, None, format!("at byte 38: {WHAT}")),
            (None, Some(0), None, format!("{WHAT}; no messages lost")),
            (None, Some(1), span, format!("{WHAT}; 1 message lost")),
            (None, Some(12), None, format!("{WHAT}; 12 messages lost")),
            (
                Some(38),
                Some(12),
                span,
                format!("at byte 38: {WHAT}; 12 messages within 0.512 s lost"),
            ),
            (None, None, span, format!("{WHAT}; 0.512 s of data lost")),
        ] {
            let (file, what) = ("run.mcap".into(), WHAT.to_owned());
            let loss = Loss { file, offset, what, messages, span, extent: Extent::Tail };
            assert_eq!(message(&loss), expected);
        }
    }
}
