use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{ExpectedTiming, StampEvidence, StreamEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::{HeaderStamps, RoundedStamps};
use crate::time::Clock;

rule! {
    /// Stamps are zero, constant, backward, missing, rounded or far outside the run.
    ///
    /// ## What it means
    /// The messages have no valid acquisition time; the audit uses their receive time.
    ///
    /// Stamps far outside the run are at least a day, and a hundred times the length of the run, from all
    /// others. Their samples are excluded.
    ///
    /// Rounded stamps are multiples of a tick, such as whole seconds or hundredths, so rows share one or
    /// intervals alternate. The audit restores them from the row order (`info`; a warning if most messages of a topic share
    /// the previous one's stamp). Intervals of one and two ticks may also be losses; they are restored if the motion is much
    /// smoother at the restored times.
    ///
    /// ## Why it matters
    /// Receive times, and a latency found from them, include the transport delay and its scatter.
    ///
    /// ## Evidence
    /// - `samples`: number of samples; `zero`, `far`: those with a zero stamp, or one far outside the run.
    /// - For rounded stamps: `tick_s` is the tick, `shared` the number of rows with the previous row's
    ///   stamp, `resolution_s` the maximum error of a restored stamp.
    ///
    /// ## How to fix
    /// Fill `header.stamp` at acquisition. If the type lacks a header, use one with it (PoseStamped instead
    /// of a bare array).
    ///
    /// ## When it misleads
    /// `info`: a type without a header (only for audited streams), unstamped commands for immediate
    /// execution, up to three stamps outside the run or one in a thousand, and a single zero stamp. Not
    /// counted: a zero stamp of the first sample (a simulation clock starts at zero), and zero stamps of
    /// static transforms.
    TIM005 {
        name: "unusable-stamps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stream in this log",
        check: check,
    }
}

const BEYOND: &str = "stamps are far outside the run";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.stamps.iter().filter(|stream| is_asked(stream)).map(judge).collect()
}

fn is_asked(stream: &StreamEvidence<StampEvidence>) -> bool {
    stream.due.is_expected() || stream.clock.stamps != HeaderStamps::Absent
}

fn judge(stream: &StreamEvidence<StampEvidence>) -> SubjectResult {
    let (rows, zero) = (stream.clock.rows, stream.clock.zero);
    if let Some(rounded) = &stream.rounded {
        return judge_rounded(stream, rounded);
    }
    // Many commands are sent without a stamp, for immediate execution.
    let usual = match stream.due {
        ExpectedTiming::Occasional => Severity::Info,
        ExpectedTiming::Always | ExpectedTiming::WhileMoving | ExpectedTiming::Unknown => {
            Severity::Warning
        }
    };
    let far = stream.clock.out_of_range;
    let are_few = far <= 3 || far as f64 <= 1e-3 * rows as f64;
    let (severity, title, message) = match stream.clock.stamps {
        HeaderStamps::Sound if zero <= 1 && far > 0 => (
            if are_few { Severity::Info } else { usual },
            BEYOND,
            format!("{far} of {rows} stamps are a day or more from all others"),
        ),
        HeaderStamps::Sound if zero == 0 => return stream.judged(Outcome::pass()),
        // A simulation clock starts at zero.
        HeaderStamps::Sound if zero == 1 && stream.clock.begins_at_zero => {
            let why = "the first stamp is zero; its sample is excluded";
            return stream.judged(Outcome::pass_with_remark(why));
        }
        HeaderStamps::Sound if zero == 1 => {
            (Severity::Info, "a stamp is zero", format!("one of {rows} stamps is zero or invalid"))
        }
        HeaderStamps::Sound | HeaderStamps::Zero => {
            (usual, "stamps are zero", format!("{zero} of {rows} stamps are zero or invalid"))
        }
        HeaderStamps::Backward => (
            usual,
            "stamps run backward",
            format!("most of {rows} stamps are earlier than the previous one"),
        ),
        HeaderStamps::Constant => {
            (usual, "stamps stand still", format!("all {rows} stamps are the same"))
        }
        HeaderStamps::Absent => (
            Severity::Info,
            "messages have no stamps",
            format!("{rows} messages have no stamp: their type has no header"),
        ),
    };
    let message = match far {
        0 => message,
        _ if title == BEYOND => message,
        _ => format!("{message}; {far} samples are a day or more from all others and excluded"),
    };
    let effect = match stream.clock.clock {
        _ if title == BEYOND => "these samples are excluded".to_owned(),
        Clock::Header => "samples without a stamp are excluded".to_owned(),
        clock => format!("judged by {} time, which includes the transport delay", clock.name()),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity,
        title,
        message,
        evidence: Evidence { effect: Some(effect), ..Evidence::default() },
        fix: "fill header.stamp at acquisition".to_owned(),
    };
    stream
        .judged(Outcome::fail(fault))
        .with_evidence("samples", rows)
        .with_evidence("zero", zero)
        .with_evidence("far", far)
}

fn judge_rounded(stream: &StreamEvidence<StampEvidence>, rounded: &RoundedStamps) -> SubjectResult {
    let RoundedStamps { tick_s, shared_rows: shared, resolution_s, .. } = *rounded;
    let [tick, resolution] = [tick_s, resolution_s].map(|s| Unit::Second.show(s));
    let rows = stream.clock.rows;
    let sharing = match shared {
        0 => String::new(),
        shared => format!(", {shared} of {rows} rows share one with the previous row"),
    };
    // The columns of a table need no stamps to be compared.
    let are_mostly_constant = 2 * shared as u64 > rows && !rounded.is_of_table;
    let fault = Fault {
        cause: Cause::Stamps,
        severity: if are_mostly_constant { Severity::Warning } else { Severity::Info },
        title: "stamps are rounded",
        message: format!(
            "stamps are multiples of {tick}{sharing}; restored from the row order to ±{resolution}, plus a \
             constant offset of up to half the tick"
        ),
        evidence: Evidence::default(),
        fix: "record stamps with full resolution: nanoseconds, or seconds with six decimals"
            .to_owned(),
    };
    stream
        .judged(Outcome::fail(fault))
        .with_evidence("samples", stream.clock.rows)
        .with_evidence("tick_s", tick_s)
        .with_evidence("shared", shared)
        .with_evidence("resolution_s", resolution_s)
}
