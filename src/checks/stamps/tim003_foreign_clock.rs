use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::Measured;
use crate::evidence::{StampEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::run::Epoch;
use crate::time::seconds;

rule! {
    /// A stream is stamped by a different clock than the others.
    ///
    /// ## What it means
    /// Its stamps have another epoch (time since boot, simulation time), or an offset of more than
    /// `--max-latency`, which cannot be a latency.
    ///
    /// ## Why it matters
    /// tf2 rejects such stamps or extrapolates. Joining by stamp combines data from different times.
    ///
    /// ## Evidence
    /// The offset of the stream's clock from the others' clock, by the message with the minimum transport
    /// delay. `spread_s` is the scatter of the delay, the limit of any alignment; LAT001's interval
    /// includes it. Tables with another time origin are aligned by their motion, which leaves their delay
    /// unknown. The row of a stream on the common clock reports messages received before their stamps.
    ///
    /// ## How to fix
    /// Stamp with the ROS clock, synchronise the machines (chrony, PTP), or use receive times with `--stamp
    /// log`. In simulation set `use_sim_time` on every node.
    ///
    /// ## When it misleads
    /// All streams may share one clock that is not the recorder's, or the log may contain `/clock`. Then it
    /// is simulation or controller time, and the finding is `info`.
    TIM003 {
        name: "foreign-clock",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stamped stream in this log",
        check: check,
    }
}

/// Clocks on one machine differ by less, s.
const MIN_LEAD_S: f64 = 1e-3;

fn check(case: &Case) -> Vec<SubjectResult> {
    let streams = case.evidence.stamps.iter().map(|stream| judge(stream, case.evidence.simulated));
    shared_clock(case).into_iter().chain(streams).collect()
}

/// The finding if all streams share a foreign clock.
fn shared_clock(case: &Case) -> Option<SubjectResult> {
    let mut offsets: Vec<f64> = case
        .evidence
        .stamps
        .iter()
        .filter(|stream| stream.clock.epoch == Epoch::CommonButNotTheRecorders)
        .filter_map(|stream| stream.clock.log_minus_header_s)
        .map(|log_minus_header_s| -log_minus_header_s)
        .collect();
    offsets.sort_by(f64::total_cmp);
    let offset_s = *offsets.get(offsets.len() / 2)?;
    let outcome = Outcome::fail(Fault {
        cause: Cause::Stamps,
        severity: Severity::Info,
        title: "all stamps are from one foreign clock",
        message: format!("all stamps are {} off the recorder's clock", Unit::Second.show(offset_s)),
        evidence: Evidence::default(),
        fix: "no action needed if this is simulation or controller time".to_owned(),
    });
    Some(
        SubjectResult::new(Subject::default(), outcome)
            .estimated(estimate(offset_s, f64::INFINITY)),
    )
}

fn judge(stream: &StreamEvidence<StampEvidence>, simulated: bool) -> SubjectResult {
    let clock = &stream.clock;
    if clock.epoch != Epoch::Foreign {
        let early_s =
            clock.soonest_s.map(|soonest_s| -soonest_s).filter(|_| clock.epoch == Epoch::Common);
        let outcome = match early_s.filter(|early_s| *early_s > MIN_LEAD_S) {
            None => Outcome::pass(),
            Some(early_s) => Outcome::pass_with_remark(format!(
                "messages arrive up to {} before their own stamps: its clock is ahead of the recorder's, or \
                 it stamps ahead",
                Unit::Second.show(early_s)
            )),
        };
        return stream.judged(outcome);
    }
    let aligned = clock.alignment.map(|aligned| (-seconds(aligned.offset_nanos), aligned.spread_s));
    let offset_s = aligned.map(|(offset_s, _)| offset_s).or(clock.log_minus_header_s.map(|s| -s));
    let by = offset_s.map_or(String::new(), |offset_s| format!("{} ", Unit::Second.show(offset_s)));
    let is_by_motion = clock.alignment.is_some_and(|aligned| aligned.is_by_motion);
    let effect = match aligned {
        Some(_) if is_by_motion => "aligned by motion, so its delay is unknown".to_owned(),
        Some((_, spread_s)) => {
            let spread = Unit::Second.show(spread_s);
            format!("aligned by minimum delay, within the transport's spread of {spread}")
        }
        None => "not aligned, and not compared with other streams".to_owned(),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: if simulated { Severity::Info } else { Severity::Warning },
        title: "stream is on another clock",
        message: format!("stamps are {by}off the other streams' clock"),
        evidence: Evidence { effect: Some(effect), ..Evidence::default() },
        fix: format!(
            "stamp {} with the clock of the other streams{}",
            stream.subject.label(),
            if is_by_motion { "" } else { ", or use --stamp log" }
        ),
    };
    let spread_s = aligned.map(|(_, spread_s)| spread_s);
    stream
        .judged(Outcome::fail(fault))
        .estimated(offset_s.map(|offset_s| estimate(offset_s, spread_s.unwrap_or(f64::INFINITY))))
        .with_evidence("spread_s", spread_s)
}

fn estimate(offset_s: f64, spread_s: f64) -> Estimate {
    let offset = Measured { value: offset_s, std_error: spread_s, dof: f64::INFINITY };
    Estimate::scalar("clock offset", Unit::Second, &offset)
}
