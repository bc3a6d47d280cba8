use serde_json::{Value, json};

use crate::checks::{Case, Grade, Judged};
use crate::evidence::{Of, StrayEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Subject, Unit};
use crate::run::{FEWEST_SAMPLES, Strays};

rule! {
    /// Samples jump away and come back.
    ///
    /// ## What it means
    /// One to three samples of a joint, of a pose or of a transform are five times as far from their
    /// neighbours as any near them, and the samples after them go on where those before left off. No
    /// arm moves like that.
    ///
    /// ## Why it matters
    /// The audit leaves such samples out, so that they decide nothing else here. What uses the stream
    /// does not: a controller follows the jump, a filter smears it over a second, a map keeps it.
    ///
    /// ## Evidence
    /// `count` is how many samples are stray, `length_m` (of a joint its own unit) and `angle_rad` how
    /// far the farthest is off, `at_ns` its stamp; `parts` lists the joints or transforms that are
    /// concerned. The estimate is the longest jump as logged, or the widest angle where nothing jumps
    /// in position.
    ///
    /// ## How to fix
    /// Look at what is sent at that time: a pose of zeros before the first is known, a bit that was
    /// dropped between encoder and driver, a tracker that took something else for its target, a
    /// second publisher. Drop or hold such samples where they arise.
    ///
    /// ## When it misleads
    /// A jump for longer than a quarter of a second may be a motion, and is none of this. Where
    /// more than one sample in twenty is off, nothing tells which are stray, and it is inconclusive: two
    /// publishers of one transform are FRM004's. Of poses and bare numbers only positions are looked at.
    /// Fewer than twenty samples do not show what is usual, and it is inconclusive likewise. A stray
    /// of a wrongly scaled stream (ORD008) is as wrongly scaled.
    MOT005 {
        name: "stray-samples",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no joint states, tool poses or transforms in this log",
        check: check,
    }
}

/// Joints or transforms that the evidence lists.
const LISTED: usize = 10;

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.strays.iter().map(|stream| judge(case, stream)).collect()
}

fn judge(case: &Case, stream: &Of<StrayEvidence>) -> Judged {
    let judged = |subject, outcome| Judged::new(subject, outcome).within(stream.span);
    let are_untold = |part: &Strays| part.count() == 0;
    if !stream.parts.is_empty() && stream.parts.iter().all(are_untold) {
        let why = "more than one sample in twenty jumps, so that nothing tells which are stray; look at \
                   the stream itself";
        return judged(stream.subject.clone(), Outcome::Inconclusive(why.to_owned()));
    }
    if stream.parts.is_empty() && stream.samples < FEWEST_SAMPLES {
        let why = format!("fewer than {FEWEST_SAMPLES} samples do not show what is usual");
        return judged(stream.subject.clone(), Outcome::Inconclusive(why));
    }
    let told = || stream.parts.iter().filter(|part| !are_untold(part));
    let amounts = told().map(|part| (part, stream.amount(part)));
    let Some((worst, (unit, amount))) = amounts.max_by(|a, b| a.1.1.total_cmp(&b.1.1)) else {
        return judged(stream.subject.clone(), Outcome::sound());
    };
    let subject = match told().collect::<Vec<_>>().as_slice() {
        [only] => Subject {
            joint: only.joint.clone(),
            frame: only.frame.clone().or_else(|| stream.subject.frame.clone()),
            ..stream.subject.clone()
        },
        _ => stream.subject.clone(),
    };
    let count: usize = stream.parts.iter().map(Strays::count).sum();
    let parts = told().take(LISTED).map(|part| {
        json!({
            "joint": part.joint,
            "frame": part.frame,
            "count": part.count(),
            "length_m": part.farthest.length_m,
            "angle_rad": part.farthest.angle_rad,
            "at_ns": part.at.map(|at| at.to_string()),
        })
    });
    let parts: Vec<Value> = parts.collect();
    judged(subject, Outcome::faulty(fault(case, stream, worst, count, &unit.show(amount))))
        .estimated(Estimate::counted("jump", unit.symbol(), amount))
        .with_evidence("count", count)
        .with_evidence("length_m", worst.farthest.length_m)
        .with_evidence("angle_rad", worst.farthest.angle_rad)
        .with_evidence("at_ns", worst.at.map(|at| at.to_string()))
        .with_evidence("parts", parts)
}

impl StrayEvidence {
    /// The jump of a part in its unit.
    fn amount(&self, part: &Strays) -> (Unit, f64) {
        let turns = part.joint.as_ref().is_some_and(|joint| !self.sliding.contains(joint));
        match (turns, part.farthest.length_m) {
            (true, by) => (Unit::Radian, by),
            (false, 0.0) => (Unit::Radian, part.farthest.angle_rad),
            (false, by) => (Unit::Metre, by),
        }
    }
}

fn fault(
    case: &Case,
    stream: &Of<StrayEvidence>,
    worst: &Strays,
    count: usize,
    shown: &str,
) -> Fault {
    let when = worst.at.map_or(String::new(), |at| format!(" at {}", case.evidence.moment(at)));
    let of = match (stream.parts.len(), &worst.joint, &worst.frame) {
        (1, ..) => String::new(),
        (_, Some(part), _) | (_, None, Some(part)) => format!(" ({part})"),
        _ => String::new(),
    };
    let (samples, topic) =
        (if count == 1 { "sample jumps" } else { "samples jump" }, stream.subject.label());
    let most = if count == 1 { "" } else { "up to " };
    Fault {
        cause: Cause::Seen(Sight::Stream),
        severity: Severity::Warning,
        title: "samples jump away and back",
        message: format!(
            "{count} {samples} away and back, by {most}{shown}{of}{when}; left out of everything else"
        ),
        evidence: Evidence::default(),
        fix: format!("see what is sent on {topic} then, and drop or hold such samples there"),
    }
}
