use crate::checks::{Case, Grade, Judged};
use crate::evidence::{Of, UnusableEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight};

rule! {
    /// Samples hold numbers that nothing can have.
    ///
    /// ## What it means
    /// Positions, orientations or readings are NaN, infinite or beyond ±1e12, in whatever unit, or some of
    /// a stream's orientations were never set and others were. Or joint states have other numbers of names
    /// and of positions, or name a joint twice with other positions, and arrays other lengths than the first.
    /// The samples came; what they say is nothing.
    ///
    /// ## Why it matters
    /// The audit leaves such samples out before anything is made of them, so that they decide nothing else
    /// here. What uses the stream may not: one infinity in a mean or in a filter stays there for good. What
    /// is left may not be the whole run.
    ///
    /// ## Evidence
    /// `unusable` is how many samples hold such numbers, `unset` how many have no orientation, `misfits` how
    /// many have more or fewer numbers than they should, `contradictory` how many name a joint twice, of
    /// `samples`. The estimate is their share. Of a
    /// sample without an orientation the position is audited.
    ///
    /// ## How to fix
    /// Look at what is sent: a driver that has no reading yet, a division by a time of zero, a filter that
    /// diverged, an orientation that only some of the senders fill in. Send nothing where there is nothing.
    ///
    /// ## When it misleads
    /// It is `info` where they are few, at most three or one in a thousand: drivers send NaN until they
    /// know better. Of joint states the joints of the arm count. A stream of which no orientation is set is
    /// FRM007's, one of which no sample is usable TIM006's.
    ING003 {
        name: "unusable-samples",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no joint states, poses, transforms or IMU in this log",
        check: check,
    }
}

/// So many samples are few, and such a share of all.
const FEW: u64 = 3;
const FEW_OF_ALL: f64 = 1e-3;

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.unusable.iter().map(judge).collect()
}

fn judge(stream: &Of<UnusableEvidence>) -> Judged {
    let UnusableEvidence { unusable, unset, misfits, contradictory, samples } = stream.found;
    let count = unusable.max(unset).max(misfits).max(contradictory);
    if count == 0 {
        return stream.judged(Outcome::sound());
    }
    let share = count as f64 / samples.max(1) as f64;
    let are_few = count <= FEW || share <= FEW_OF_ALL;
    let of = |count: u64, what: &str| {
        (count > 0).then(|| format!("{count} of {samples} samples {what}"))
    };
    let said = [
        of(misfits, "have more or fewer numbers than they should, and are left out"),
        of(contradictory, "name a joint twice, with other positions; the last is taken"),
        of(unusable, "hold no usable numbers: none, infinite or beyond 1e12; they are left out"),
        of(unset, "have no orientation, while the others have: of these the positions are audited"),
    ];
    let fault = Fault {
        cause: Cause::Seen(Sight::Stream),
        severity: if are_few { Severity::Info } else { Severity::Warning },
        title: "samples hold no usable numbers",
        message: said.into_iter().flatten().collect::<Vec<_>>().join("; "),
        evidence: Evidence::default(),
        fix: "see what is sent then, and send nothing where there is nothing".to_owned(),
    };
    stream
        .judged(Outcome::faulty(fault))
        .estimated(Estimate::counted("unusable samples", "1", share))
        .with_evidence("unusable", unusable)
        .with_evidence("unset", unset)
        .with_evidence("misfits", misfits)
        .with_evidence("contradictory", contradictory)
        .with_evidence("samples", samples)
}
