use serde_json::{Value, json};

use crate::checks::{Case, Grade, Judged};
use crate::evidence::Of;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Unit};
use crate::run::Frozen;

rule! {
    /// A stream of poses or joint states repeats one value while the arm moves.
    ///
    /// ## What it means
    /// For a quarter of a second and ten samples or more a stream says the same pose, to the last bit,
    /// with new stamps, and at no latency that is sought do the joints rest for half of that time, or at
    /// none that its speeds allow they rest throughout. Or joint states say the same as long, but for
    /// their noise, and then go on from elsewhere at once, amid a motion.
    ///
    /// ## Why it matters
    /// The stream looks alive: its rate and its stamps are as they should be. Whoever uses it takes an
    /// old pose for the present one, and the error is as large as the arm moves meanwhile.
    ///
    /// ## Evidence
    /// `times` lists when the stream stood still, each with its samples and how far a joint moved
    /// meanwhile at least; `count` says how many there are. The estimate is the longest, in seconds.
    /// Nothing else in the report is told from these samples.
    ///
    /// ## How to fix
    /// Look for the source that stopped while something else goes on publishing its last value: a
    /// driver that lost its connection, a tracker that lost its target, a filter that holds. Publish
    /// nothing then, or say that the value is stale.
    ///
    /// ## When it misleads
    /// A slow source in a fast stream looks alike where it comes less than four times a second: its
    /// stamps are the fault then. A stream that stands still at the very end of the log may as well be
    /// late, and is not reported; nor is one that stands still near a rest of the arm, unless its speeds
    /// say how late it is. Transforms are not looked at: those that
    /// stand still while the joints move are FRM001's. Joint states that stand still to the very end are
    /// not told from an arm that rests. Of a long run only the excerpts are looked at, and
    /// `samples` counts those that were.
    TIM007 {
        name: "frozen-stream",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states, and no tool pose that could be held against an arm",
        check: check,
    }
}

/// Times that the evidence lists.
const LISTED: usize = 10;

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.frozen.iter().map(|stream| judge(case, stream)).collect()
}

fn seconds(time: &Frozen) -> f64 {
    time.end.seconds_since(time.start)
}

fn judge(case: &Case, stream: &Of<Vec<Frozen>>) -> Judged {
    let longest = stream.iter().max_by(|a, b| seconds(a).total_cmp(&seconds(b)));
    let Some(longest) = longest else {
        return stream.judged(Outcome::sound());
    };
    let others = match stream.len() {
        1 => String::new(),
        2 => ", and once more".to_owned(),
        times => format!(", and {} more times", times - 1),
    };
    let topic = stream.subject.label();
    let outcome = Outcome::faulty(Fault {
        cause: Cause::Seen(Sight::Stream),
        severity: Severity::Error,
        title: "stream stands still while the arm moves",
        message: format!(
            "says one value for {} from {} on while the arm moves{others}; left out of everything else",
            Unit::Second.show(seconds(longest)),
            case.evidence.moment(longest.start),
        ),
        evidence: Evidence::default(),
        fix: format!(
            "see why the source of {topic} stopped then, and what repeated its last value"
        ),
    });
    let times = stream.iter().take(LISTED).map(|time| {
        json!({
            "start_ns": time.start.to_string(),
            "end_ns": time.end.to_string(),
            "samples": time.samples,
            "moved": time.moved,
        })
    });
    stream
        .judged(outcome)
        .estimated(Estimate::counted("stands still", Unit::Second.symbol(), seconds(longest)))
        .with_evidence("count", stream.len())
        .with_evidence("times", times.collect::<Vec<Value>>())
}
