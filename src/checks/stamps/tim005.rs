use crate::checks::{Case, Grade, Judged};
use crate::evidence::{Due, Of, StampEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::{HeaderStamps, RoundedStamps};
use crate::time::Clock;

rule! {
    /// Stamps are zero, constant, backward, missing, rounded or beyond the run.
    ///
    /// ## What it means
    /// The messages do not say when their content was true. The audit then takes the time at which
    /// the recorder received them. Or a few samples carry a time a day or more from all the others, and a
    /// hundred times as far as these are from each other: no run is that long, and they are left out.
    ///
    /// Rounded stamps are multiples of a tick, such as whole seconds or hundredths, so that several rows share
    /// one or their intervals alternate. The audit restores them from the order of the rows; this is `info`.
    ///
    /// ## Why it matters
    /// Receive times carry the transport's delay and its scatter: a latency found on such a stream
    /// is that of content and transport together.
    ///
    /// ## Evidence
    /// `samples` is how many samples there are, `zero` how many of them carry a zero stamp,
    /// `far` how many one that is beyond the run. Of rounded stamps `tick_s` is the tick, `shared` how many rows
    /// had the stamp of the row before them, and `resolution_s` how far a restored stamp may be off.
    ///
    /// ## How to fix
    /// Fill `header.stamp` when the sample is taken. Where the type has no header, use one that has
    /// (PoseStamped for a bare array).
    ///
    /// ## When it misleads
    /// A type without a header cannot carry a stamp; that is said as `info`, and only of a stream that
    /// is audited. Commands are often sent without a stamp, to be followed at once: `info`, too.
    /// Of stamps beyond the run at most three, or one in a thousand, are `info`.
    /// Static transforms may carry stamp zero by design and are not counted.
    TIM005 {
        name: "unusable-stamps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stream in this log",
        check: check,
    }
}

const BEYOND: &str = "stamps are beyond the run";

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.stamps.iter().filter(|stream| is_asked(stream)).map(judge).collect()
}

/// Whether the rule is asked about a stream: not where nothing is audited by it and its type has no
/// stamp to fill.
fn is_asked(stream: &Of<StampEvidence>) -> bool {
    stream.due.is_expected() || stream.clock.stamps != HeaderStamps::Absent
}

fn judge(stream: &Of<StampEvidence>) -> Judged {
    let (rows, zero) = (stream.clock.rows, stream.clock.zero);
    if let Some(rounded) = &stream.rounded {
        return judge_rounded(stream, rounded);
    }
    // Many a command is sent without a stamp, to be followed at once.
    let usual = match stream.due {
        Due::OnOccasion => Severity::Info,
        Due::Always | Due::InMotion | Due::Untold => Severity::Warning,
    };
    let far = stream.clock.far;
    let are_few = far <= 3 || far as f64 <= 1e-3 * rows as f64;
    let (severity, title, message) = match stream.clock.stamps {
        HeaderStamps::Sound if zero <= 1 && far > 0 => (
            if are_few { Severity::Info } else { usual },
            BEYOND,
            format!("{far} of {rows} stamps are a day or more from all others"),
        ),
        // A simulation's clock starts at zero.
        HeaderStamps::Sound if zero <= 1 => {
            let outcome = match zero {
                0 => Outcome::sound(),
                _ => Outcome::sound_because("one stamp is zero, and its sample left out"),
            };
            return stream.judged(outcome);
        }
        HeaderStamps::Sound | HeaderStamps::Zero => {
            (usual, "stamps are zero", format!("{zero} of {rows} stamps are zero or no time"))
        }
        HeaderStamps::Backward => (
            usual,
            "stamps run backward",
            format!("most of {rows} stamps are before the one before"),
        ),
        HeaderStamps::Constant => {
            (usual, "stamps stand still", format!("all {rows} stamps are the same"))
        }
        HeaderStamps::Absent => (
            Severity::Info,
            "messages carry no stamps",
            format!("{rows} messages carry no stamp, as their type has none"),
        ),
    };
    let message = match far {
        0 => message,
        _ if title == BEYOND => message,
        _ => format!("{message}; {far} samples are a day or more from all others and left out"),
    };
    let effect = match stream.clock.clock {
        _ if title == BEYOND => "these samples are left out".to_owned(),
        Clock::Header => "the samples without a stamp are left out".to_owned(),
        clock => format!("judged by {} time, which includes the transport's delay", clock.name()),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity,
        title,
        message,
        evidence: Evidence { effect: Some(effect), ..Evidence::default() },
        fix: "fill header.stamp when the sample is taken".to_owned(),
    };
    stream
        .judged(Outcome::faulty(fault))
        .with_evidence("samples", rows)
        .with_evidence("zero", zero)
        .with_evidence("far", far)
}

fn judge_rounded(stream: &Of<StampEvidence>, rounded: &RoundedStamps) -> Judged {
    let RoundedStamps { tick_s, shared, resolution_s, .. } = *rounded;
    let [tick, resolution] = [tick_s, resolution_s].map(|s| Unit::Second.show(s));
    let sharing = match shared {
        0 => String::new(),
        shared => format!(", {shared} of {} rows share one with the row before", stream.clock.rows),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Info,
        title: "stamps are rounded",
        message: format!(
            "stamps are multiples of {tick}{sharing}; restored from the order of the rows to ±{resolution}, beside \
             a constant offset of up to half the tick"
        ),
        evidence: Evidence::default(),
        fix: "record stamps with all their digits: nanoseconds, or seconds with six decimals"
            .to_owned(),
    };
    stream
        .judged(Outcome::faulty(fault))
        .with_evidence("samples", stream.clock.rows)
        .with_evidence("tick_s", tick_s)
        .with_evidence("shared", shared)
        .with_evidence("resolution_s", resolution_s)
}
