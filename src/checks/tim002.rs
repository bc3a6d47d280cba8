use serde_json::{Value, json};

use crate::checks::{Facts, Grade, Judged, RhythmFacts};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::{Cadence, Stretch};

rule! {
    /// A stream has gaps, or loses samples.
    ///
    /// ## What it means
    /// Nothing came for longer than ten periods and 0.1 s while the arm moved, or more than 1 % of
    /// the samples are missing between the others. The period is the stream's own, by the interval
    /// that most of its samples keep.
    ///
    /// ## Why it matters
    /// Whoever interpolates over a gap invents a path. Samples that get lost under load get lost when
    /// it matters, and a controller that runs on them stutters.
    ///
    /// ## Evidence
    /// `gaps` lists where a gap begins, how long it is, and `count` how many there are; `lost` and
    /// `samples` how many samples are missing, and there. The estimate is the longest gap in
    /// seconds, or without gaps the share of samples lost.
    ///
    /// ## How to fix
    /// Compare with the receive times of other streams: if all stop, it is the recorder's disk or
    /// CPU; if one, its driver or network. Use reliable transport or a longer queue.
    ///
    /// ## When it misleads
    /// A stream that is sent on change is silent while the arm rests; that is no gap. A stream
    /// without a fixed period cannot be counted, and a lower rate over seconds is TIM006's.
    TIM002 {
        name: "gaps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stream of an arm in this log",
        check: check,
    }
}

/// The share of samples from which on losing them is a fault.
const LOST: f64 = 0.01;
/// Fewer lost samples than this are no share.
const COUNTS: usize = 3;
/// Gaps that the evidence lists.
const LISTED: usize = 10;

/// What would tell where it could not be told.
const SETTLE: &str = "record the joint states beside it";

fn check(facts: &Facts) -> Vec<Judged> {
    facts.rhythms.iter().map(|rhythm| judge(facts, rhythm)).collect()
}

fn judge(facts: &Facts, rhythm: &RhythmFacts) -> Judged {
    let silent = |moving: Option<bool>| {
        let parts = rhythm.wanted().flat_map(|part| &part.gaps);
        parts.filter(move |gap| gap.moving == moving).max_by(|a, b| longer(a, b))
    };
    let concerned: Vec<&Cadence> =
        rhythm.wanted().filter(|part| has_gaps(part) || loses(part)).collect();
    let subject = rhythm.subject(&concerned);
    if !concerned.is_empty() && facts.lost_messages() {
        let why = "samples are missing, but so are messages of the log itself (ING001)";
        let outcome = Outcome::Inconclusive(format!("{why}; record it again"));
        return Judged::new(subject, outcome).within(rhythm.span);
    }
    if !concerned.is_empty() {
        return fault(facts, rhythm, &concerned).within(rhythm.span);
    }
    let shown = |gap: &Stretch| {
        format!("{} at {}", Unit::Second.show(gap.seconds()), facts.moment(gap.start))
    };
    let outcome = if rhythm.wanted().next().is_none() {
        Outcome::Skipped("no robot says which of its transforms an arm needs".to_owned())
    } else if let Some(gap) = silent(None) {
        let gap = shown(gap);
        Outcome::Inconclusive(format!(
            "nothing came for {gap}, and no joint states say whether the arm moved; {SETTLE}"
        ))
    } else if rhythm.wanted().any(|part| part.lost.is_none()) {
        let why = "its samples come at no fixed period, so that lost ones cannot be counted";
        Outcome::Inconclusive(format!("{why}; send them at one, or count them in the message"))
    } else if let Some(gap) = silent(Some(false)) {
        Outcome::sound_because(format!("nothing came for {}, while the arm rested", shown(gap)))
    } else {
        Outcome::sound()
    };
    Judged::new(subject, outcome).within(rhythm.span)
}

fn longer(a: &Stretch, b: &Stretch) -> std::cmp::Ordering {
    a.seconds().total_cmp(&b.seconds())
}

fn moving(part: &Cadence) -> impl Iterator<Item = &Stretch> {
    part.gaps.iter().filter(|gap| gap.moving == Some(true))
}

fn has_gaps(part: &Cadence) -> bool {
    moving(part).next().is_some()
}

/// The share of a part's samples that is lost.
fn lost_share(part: &Cadence) -> f64 {
    let lost = part.lost.unwrap_or(0);
    lost as f64 / (lost + part.rows).max(1) as f64
}

fn loses(part: &Cadence) -> bool {
    part.lost.is_some_and(|lost| lost >= COUNTS) && lost_share(part) > LOST
}

fn fault(facts: &Facts, rhythm: &RhythmFacts, concerned: &[&Cadence]) -> Judged {
    let gaps = || concerned.iter().flat_map(|part| moving(part));
    let worst = concerned.iter().copied().max_by(|a, b| lost_share(a).total_cmp(&lost_share(b)));
    let (lost, samples) = worst.map_or((0, 0), |part| (part.lost.unwrap_or(0), part.rows));
    let share = worst.map_or(0.0, lost_share);
    let loss = format!("{:.1} % of samples are lost: {lost} of {}", 100.0 * share, lost + samples);
    let (title, message, estimate) = match gaps().max_by(|a, b| longer(a, b)) {
        Some(gap) => {
            let (length, at) = (Unit::Second.show(gap.seconds()), facts.moment(gap.start));
            let message = match gaps().count() {
                1 => format!("nothing came for {length} at {at}, while the arm moved"),
                count => {
                    format!("{count} gaps while the arm moved, the longest of {length} at {at}")
                }
            };
            let estimate = Estimate::counted("longest gap", Unit::Second.symbol(), gap.seconds());
            ("stream has gaps", message, estimate)
        }
        None => ("samples are lost", loss, Estimate::counted("lost samples", "1", share)),
    };
    let listed: Vec<Value> = gaps()
        .take(LISTED)
        .map(|gap| json!({ "start_ns": gap.start.to_string(), "length_s": gap.seconds() }))
        .collect();
    let fault = Fault {
        severity: Severity::Warning,
        title,
        message,
        evidence: Evidence::default(),
        fix: "look at the load of recorder and network, and use a reliable, longer queue".to_owned(),
    };
    Judged::new(rhythm.subject(concerned), Outcome::faulty(fault))
        .estimated(estimate)
        .with_evidence("count", gaps().count())
        .with_evidence("gaps", listed)
        .with_evidence("lost", lost)
        .with_evidence("samples", samples)
}
