use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{StreamEvidence, UnusableSampleEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity};

rule! {
    /// Samples have unusable values.
    ///
    /// ## What it means
    /// Positions, orientations or sensor values are NaN, infinite or beyond ±1e12 in any unit. Or some
    /// orientations of a stream are unset while others are set. Or joint states have different numbers of
    /// names and positions, or list a joint twice with different positions, or an array differs in length
    /// from the first.
    ///
    /// ## Why it matters
    /// Other checks exclude such samples. Consumers may not: one infinity stays in a mean or a filter for
    /// good. The remaining samples may not cover the whole run.
    ///
    /// ## Evidence
    /// Among all `samples`, `unusable` have such values, `unset` have no orientation, `misfits` have
    /// the wrong number of values, and `contradictory` list a joint twice. The estimate is the fraction
    /// affected. The position of a sample without an orientation is audited.
    ///
    /// ## How to fix
    /// Check the publisher: a driver without a first measurement, a division by zero time, a diverged
    /// filter, or an orientation that only some publishers set. Publish only valid values.
    ///
    /// ## When it misleads
    /// At most three samples, or one in a thousand, are `info`, because drivers often send NaN at startup.
    /// For joint states only the joints of the arm count. FRM007 reports a stream without any orientation,
    /// TIM006 one without any usable sample.
    ING003 {
        name: "unusable-samples",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no joint states, poses, transforms or IMU in this log",
        check: check,
    }
}

/// Up to this number or fraction of samples, the finding is `info`.
const MAX_FEW_SAMPLES: u64 = 3;
const MAX_FEW_FRACTION: f64 = 1e-3;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.unusable.iter().map(judge).collect()
}

fn judge(stream: &StreamEvidence<UnusableSampleEvidence>) -> SubjectResult {
    let UnusableSampleEvidence { unusable, unset, misfits, contradictory, samples } = stream.value;
    let count = unusable.max(unset).max(misfits).max(contradictory);
    if count == 0 {
        return stream.judged(Outcome::pass());
    }
    let share = count as f64 / samples.max(1) as f64;
    let are_few = count <= MAX_FEW_SAMPLES || share <= MAX_FEW_FRACTION;
    let of = |count: u64, what: &str| {
        (count > 0).then(|| format!("{count} of {samples} samples {what}"))
    };
    let said = [
        of(misfits, "have the wrong number of values; excluded"),
        of(contradictory, "list a joint twice with different positions; the last one is used"),
        of(unusable, "have unusable values (NaN, infinite or beyond 1e12); excluded"),
        of(unset, "have no orientation, although others do; only their positions are audited"),
    ];
    let fault = Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: if are_few { Severity::Info } else { Severity::Warning },
        title: "samples have unusable values",
        message: said.into_iter().flatten().collect::<Vec<_>>().join("; "),
        evidence: Evidence::default(),
        fix: "check the publisher at these times; publish nothing while there is no valid value"
            .to_owned(),
    };
    stream
        .judged(Outcome::fail(fault))
        .estimated(Estimate::exact("unusable samples", "1", share))
        .with_evidence("unusable", unusable)
        .with_evidence("unset", unset)
        .with_evidence("misfits", misfits)
        .with_evidence("contradictory", contradictory)
        .with_evidence("samples", samples)
}
