use crate::checks::{Case, Grade, Judged, Limit};
use crate::evidence::{Due, EmptyEvidence, Of, RhythmEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::run::{Cadence, Stretch};

rule! {
    /// A stream that is expected is empty, incomplete or slow.
    ///
    /// ## What it means
    /// A topic of joint states, transforms, tool poses or an IMU is in the log and holds no message, or
    /// none whose numbers are finite; or it begins or ends more than a second off the others, by when
    /// messages were received; or it runs below its own usual rate for two seconds or more, or below the
    /// rate that a config declares; or a config names a topic that the log does not have.
    ///
    /// ## Why it matters
    /// What is not there was not audited, however well the rest passes. A stream that ends early is a
    /// driver that died; one that slows down is a machine that cannot keep up.
    ///
    /// ## Evidence
    /// `late_start_s` and `early_end_s` against the median of the other streams, and how slow the
    /// slowest stretch is. The estimate is the time missed in seconds, or the rate in that stretch.
    ///
    /// ## How to fix
    /// Start the recorder when all drivers run and stop it before them; look into the driver's log at
    /// the time where its stream ends.
    ///
    /// ## When it misleads
    /// A stream that is sent on change begins with the first motion and ends with the last; where the
    /// arm rested meanwhile, that is no fault. What rate a driver should have is a setting of it: one
    /// that is slow from first to last is noticed only where a config declares its `rate_hz`.
    /// Commands, what a camera sees and streams that nobody assigned are not expected, and may be empty
    /// or short.
    TIM006 {
        limits: &[TOGETHER, SLOW, LASTS, BELOW],
        name: "incomplete-stream",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stream that must be whole in this log",
        check: check,
    }
}

/// Streams that begin and end so close together begin and end as one.
const TOGETHER: Limit = Limit {
    key: "together",
    unit: Unit::Second,
    value: 1.0,
    what: "streams that begin and end within this are complete",
};
/// A stream is slow where its interval is this many times the usual, …
const SLOW: Limit = Limit {
    key: "slow",
    unit: Unit::One,
    value: 1.4,
    what: "a stream is slow where its interval is this many times the usual",
};
/// … for this long or longer.
const LASTS: Limit =
    Limit { key: "lasts", unit: Unit::Second, value: 2.0, what: "and stays so for this long" };
/// A stream is slow that runs below this share of its declared rate.
const BELOW: Limit = Limit {
    key: "below",
    unit: Unit::One,
    value: 0.9,
    what: "the share of its declared rate below which a stream is slow",
};

/// What a lower rate is.
#[derive(Clone, Copy)]
pub(in crate::checks) struct Pace {
    slow: f64,
    lasts_s: f64,
}

impl Pace {
    pub(in crate::checks) fn of(case: &Case) -> Self {
        let [slow, lasts_s] = [&SLOW, &LASTS].map(|limit| case.thresholds.limit(&TIM006, limit));
        Self { slow, lasts_s }
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let missing =
        case.evidence.missing.iter().map(|(subject, place)| missing(subject.clone(), place));
    let empty = missing.chain(case.evidence.empty.iter().map(nothing));
    let expected = case.evidence.rhythms.iter().filter(|rhythm| rhythm.due.is_expected());
    empty.chain(expected.map(|rhythm| judge(case, rhythm))).collect()
}

fn nothing(empty: &EmptyEvidence) -> Judged {
    let topic = empty.subject.label();
    let (message, fix) = match empty.messages {
        0 => (
            "topic recorded but empty".to_owned(),
            format!("see whether {topic} was published, with a compatible QoS"),
        ),
        messages => (
            format!("it holds finite numbers in none of its {messages} messages"),
            format!("see what {topic} is computed from"),
        ),
    };
    Judged::new(
        empty.subject.clone(),
        Outcome::faulty(Fault {
            cause: Cause::Stamps,
            severity: Severity::Warning,
            title: "stream is empty",
            message,
            evidence: Evidence::default(),
            fix,
        }),
    )
}

fn missing(subject: Subject, place: &str) -> Judged {
    let topic = subject.label().to_owned();
    Judged::new(
        subject,
        Outcome::faulty(Fault {
            cause: Cause::Stamps,
            severity: Severity::Warning,
            title: "stream is missing",
            message: format!("the log has no such topic, and {place} expects it"),
            evidence: Evidence::default(),
            fix: format!("record {topic}, or correct its name there"),
        }),
    )
}

/// The rate of a stream where it is notably below that which the caller says, and that one, Hz.
fn below_said(case: &Case, rhythm: &Of<RhythmEvidence>) -> Option<(f64, f64)> {
    let (said_hz, rate_hz) = (rhythm.said_hz?, rhythm.rate_hz?);
    (rate_hz < case.thresholds.limit(&TIM006, &BELOW) * said_hz).then_some((rate_hz, said_hz))
}

fn judge(case: &Case, rhythm: &Of<RhythmEvidence>) -> Judged {
    let (pace, together_s) = (Pace::of(case), case.thresholds.limit(&TIM006, &TOGETHER));
    let slowest = |part| slowest(pace, rhythm, part);
    let (late_s, early_s) = missed(rhythm);
    let slow: Vec<&Cadence> = rhythm.wanted().filter(|part| slowest(part).is_some()).collect();
    let worst = slow.iter().filter_map(|part| Some((part.period_s?, slowest(part)?)));
    let worst = worst.min_by(|a, b| (a.0 * a.1.rate_hz).total_cmp(&(b.0 * b.1.rate_hz)));
    let shown = |missed_s: f64| Unit::Second.show(missed_s);
    let (title, message, estimate) = if late_s.max(early_s) > together_s {
        let message = match (late_s > together_s, early_s > together_s) {
            (true, false) => format!("begins {} after the other streams", shown(late_s)),
            (false, _) => format!("ends {} before the other streams", shown(early_s)),
            (true, true) => format!(
                "begins {} after the other streams and ends {} before them",
                shown(late_s),
                shown(early_s)
            ),
        };
        let missed = Estimate::counted("time missed", Unit::Second.symbol(), late_s.max(early_s));
        ("stream is incomplete", message, missed)
    } else if let Some((period_s, stretch)) = worst {
        let (usual_hz, rate_hz) = (1.0 / period_s, stretch.rate_hz);
        let (length, at) = (shown(stretch.seconds()), case.evidence.moment(stretch.start));
        let message =
            format!("runs at {rate_hz:.1} Hz for {length} from {at}, usually at {usual_hz:.1} Hz");
        ("stream is slow", message, Estimate::counted("rate", "Hz", rate_hz))
    } else if let Some((rate_hz, said_hz)) = below_said(case, rhythm) {
        let message = format!("runs at {rate_hz:.1} Hz, and {said_hz:.1} Hz are declared");
        ("stream is slow", message, Estimate::counted("rate", "Hz", rate_hz))
    } else {
        return Judged::new(rhythm.subject_of(&[]), Outcome::sound()).within(rhythm.span);
    };
    if case.evidence.lost_messages() {
        let why = format!("it {message}, but messages of the log itself are lost (ING001)");
        let outcome = Outcome::Inconclusive(format!("{why}; record it again"));
        return Judged::new(rhythm.subject_of(&slow), outcome).within(rhythm.span);
    }
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title,
        message,
        evidence: Evidence::default(),
        fix: format!("see what became of the sender of {} at that time", rhythm.subject.label()),
    };
    Judged::new(rhythm.subject_of(&slow), Outcome::faulty(fault))
        .within(rhythm.span)
        .estimated(estimate)
        .with_evidence("late_start_s", late_s)
        .with_evidence("early_end_s", early_s)
}

/// What a stream misses at its start and at its end, s; nothing where it may be silent because the
/// arm rests.
fn missed(rhythm: &Of<RhythmEvidence>) -> (f64, f64) {
    let Some(extent) = rhythm.extent else { return (0.0, 0.0) };
    // The next sample may have been due a period after the last.
    let period_s = rhythm.wanted().filter_map(|part| part.period_s).fold(0.0, f64::max);
    let counted = |missed_s: f64, moving: Option<bool>| match moving {
        Some(false) if rhythm.due == Due::InMotion => 0.0,
        _ => (missed_s - period_s).max(0.0),
    };
    let [before, after] = extent.moving;
    (counted(extent.late_start_s, before), counted(extent.early_end_s, after))
}

/// Where a part runs below its usual rate.
pub(in crate::checks) fn slow(pace: Pace, part: &Cadence) -> impl Iterator<Item = &Stretch> {
    let usual_s = part.period_s.unwrap_or(f64::INFINITY);
    let is_slow = move |lull: &&Stretch| lull.rate_hz * usual_s * pace.slow < 1.0;
    part.lulls.iter().filter(is_slow).filter(move |lull| lull.seconds() >= pace.lasts_s)
}

/// The slowest stretch of a part, but for those of a rest that may be slow.
fn slowest<'a>(pace: Pace, rhythm: &Of<RhythmEvidence>, part: &'a Cadence) -> Option<&'a Stretch> {
    let is_due = |lull: &&Stretch| lull.moving == Some(true) || rhythm.due != Due::InMotion;
    let stretches = slow(pace, part).filter(is_due);
    stretches.min_by(|a, b| a.rate_hz.total_cmp(&b.rate_hz))
}
