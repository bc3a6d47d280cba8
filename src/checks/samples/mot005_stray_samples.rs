use serde_json::{Value, json};

use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{OutlierEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Subject, Unit};
use crate::run::{MIN_OUTLIER_SAMPLES, Outliers, outlier_count};

rule! {
    /// Samples jump away and back (outliers).
    ///
    /// ## What it means
    /// One to three consecutive samples of a joint, pose or transform are at least five times as far from
    /// their neighbours as any samples nearby, and the motion then continues from its old place. No arm
    /// moves like that. In joint states, also all rows in which all joints are exactly 0 and to and from which
    /// the joints jump, however many; poses that copy their stamps are excluded with them.
    ///
    /// ## Why it matters
    /// Other checks exclude these samples. Consumers do not: a controller follows the jump, a filter smears
    /// it over a second, a map keeps it.
    ///
    /// ## Evidence
    /// - `count`: number of samples that are outliers; joints that jump together are one sample.
    /// - `length_m` (in the joint's unit for a joint), `angle_rad`: distance of the farthest; `at_ns`: its
    ///   stamp.
    /// - `parts`: affected joints or transforms; with `zeros`, the rows of zeros and the joint that jumps farthest.
    /// - The estimate is the longest jump as logged, or the largest angle if no position jumps.
    ///
    /// ## How to fix
    /// Check the source at that time: a zero pose before the first measurement, a bit error between encoder
    /// and driver, a tracker that locked on another target, or a second publisher. Rows of zeros are the
    /// defaults of a message that a driver sends before or between its readings. Drop such samples at the
    /// source.
    ///
    /// ## When it misleads
    /// - A jump longer than 0.25 s may be a motion and is not reported.
    /// - If more than 5 % of the samples jump elsewhere than to 0, outliers cannot be identified and the rule is
    ///   inconclusive. FRM004 reports two publishers of one transform.
    /// - A simulated arm that is reset to 0 and then to another place has such rows.
    /// - Fewer than 20 samples are also inconclusive.
    /// - For poses and untyped arrays only positions are checked.
    /// - In a stream whose declared unit is wrong (ORD008) the jump has the same wrong scale.
    MOT005 {
        name: "stray-samples",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no joint states, tool poses or transforms in this log",
        check: check,
    }
}

/// In the evidence.
const MAX_LISTED: usize = 10;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.outliers.iter().map(|stream| judge(case, stream)).collect()
}

fn judge(case: &Case, stream: &StreamEvidence<OutlierEvidence>) -> SubjectResult {
    let judged = |subject, outcome| SubjectResult::new(subject, outcome).within(stream.span);
    let are_unreported = |part: &Outliers| part.count() == 0;
    if !stream.parts.is_empty() && stream.parts.iter().all(are_unreported) {
        let why = "more than 5 % of the samples jump, so outliers cannot be identified; check the stream \
            itself";
        return judged(stream.subject.clone(), Outcome::Inconclusive(why.to_owned()));
    }
    if stream.parts.is_empty() && stream.samples < MIN_OUTLIER_SAMPLES {
        let why = format!("fewer than {MIN_OUTLIER_SAMPLES} samples: too few to identify outliers");
        return judged(stream.subject.clone(), Outcome::Inconclusive(why));
    }
    let reported = || stream.parts.iter().filter(|part| !are_unreported(part));
    let factor = factor_to_m(case, stream);
    let amount = |part| match stream.amount(part) {
        (Unit::Metre, by) => (Unit::Metre, by * factor),
        other => other,
    };
    let amounts = reported().map(|part| (part, amount(part)));
    let order = |(part, (_, by)): &(&Outliers, (Unit, f64))| (part.are_zeros, *by);
    let worst = amounts.max_by(|a, b| {
        let (a, b) = (order(a), order(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let Some((worst, (unit, amount))) = worst else {
        return judged(stream.subject.clone(), Outcome::pass());
    };
    let subject = match reported().collect::<Vec<_>>().as_slice() {
        [only] => Subject {
            joint: only.joint.clone().filter(|_| !only.are_zeros),
            frame: only.frame.clone().or_else(|| stream.subject.frame.clone()),
            ..stream.subject.clone()
        },
        _ => stream.subject.clone(),
    };
    let count = outlier_count(&stream.parts);
    let parts = reported().take(MAX_LISTED).map(|part| {
        json!({
            "joint": part.joint,
            "zeros": part.are_zeros,
            "frame": part.frame,
            "count": part.count(),
            "length_m": part.largest_jump.length_m * factor,
            "angle_rad": part.largest_jump.angle_rad,
            "at_ns": part.largest_at.map(|at| at.to_string()),
        })
    });
    let parts: Vec<Value> = parts.collect();
    judged(subject, Outcome::fail(fault(case, stream, worst, count, &unit.show(amount))))
        .estimated(Estimate::exact("jump", unit.symbol(), amount))
        .with_evidence("count", count)
        .with_evidence("length_m", worst.largest_jump.length_m * factor)
        .with_evidence("angle_rad", worst.largest_jump.angle_rad)
        .with_evidence("at_ns", worst.largest_at.map(|at| at.to_string()))
        .with_evidence("parts", parts)
}

/// Of the numbers of a table, whose unit the motion shows. A declared unit is kept (ORD008).
fn factor_to_m(case: &Case, stream: &StreamEvidence<OutlierEvidence>) -> f64 {
    let poses = case.evidence.poses_and_tf().map(|(_, pose)| pose);
    let mut own =
        poses.filter(|pose| pose.is_undeclared && pose.subject.topic == stream.subject.topic);
    let unit =
        own.next().and_then(|pose| pose.diagnosis.length_unit.as_ref().ok().copied().flatten());
    unit.map_or(1.0, |error| error.factor())
}

impl OutlierEvidence {
    /// Jump of a part.
    fn amount(&self, part: &Outliers) -> (Unit, f64) {
        let is_turning = |joint: &String| !self.sliding.contains(joint);
        let is_angle = part.joint.as_ref().is_some_and(is_turning);
        match (is_angle, part.largest_jump.length_m) {
            (true, by) => (Unit::Radian, by),
            (false, 0.0) => (Unit::Radian, part.largest_jump.angle_rad),
            (false, by) => (Unit::Metre, by),
        }
    }
}

fn fault(
    case: &Case,
    stream: &StreamEvidence<OutlierEvidence>,
    worst: &Outliers,
    count: usize,
    shown: &str,
) -> Fault {
    let topic = stream.subject.label();
    let when =
        worst.largest_at.map_or(String::new(), |at| format!(" at {}", case.evidence.moment(at)));
    if worst.are_zeros {
        let (rows, all) = (worst.count(), stream.samples);
        let others = match count - rows {
            0 => String::new(),
            others => format!("; {others} other samples jump away and back"),
        };
        return Fault {
            cause: Cause::Pictured(Picture::Stream),
            severity: Severity::Warning,
            title: "all joints jump to exactly 0",
            message: format!(
                "all joints jump to exactly 0 in {rows} of {all} samples, by up to {shown}{when}; excluded from all \
                 other checks{others}"
            ),
            evidence: Evidence::default(),
            fix: format!(
                "check why the driver fills {topic} with zeros instead of readings, and publish nothing then"
            ),
        };
    }
    let of = match (stream.parts.len(), &worst.joint, &worst.frame) {
        (1, ..) => String::new(),
        (_, Some(part), _) | (_, None, Some(part)) => format!(" ({part})"),
        _ => String::new(),
    };
    let samples = if count == 1 { "sample jumps" } else { "samples jump" };
    let most = if count == 1 { "" } else { "up to " };
    Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Warning,
        title: "samples jump away and back",
        message: format!(
            "{count} {samples} away and back, by {most}{shown}{of}{when}; excluded from all other checks"
        ),
        evidence: Evidence::default(),
        fix: format!(
            "check what is published on {topic} then, and drop such samples at the source"
        ),
    }
}
