//! Joints that give beside something that changes in mid-run: a joint with play that turns back a few times
//! is much as one whose zero, or a frame, changes there.

use crate::changes::left_m;
use crate::{
    AmountChange, ArmDiagnosis, FrameChange, FrameEstimate, JointChange, JointDiagnosis,
    PoseDiagnosis, Residuals, Seen,
};
use std::cmp::Ordering;

/// A joint that gives before one that changes, where it leaves at most so many times as much.
const AS_LITTLE: f64 = 1.5;
/// The same where that takes fewer causes: amounts that are fitted beside what a crossing leaves are not
/// quite those that they are.
const AS_LITTLE_WITH_FEWER: f64 = 3.0;

/// Whether joints give, as `bend` says, rather than that something changes, as `change` does.
pub(crate) fn gives(bend: &ArmDiagnosis, change: &ArmDiagnosis) -> bool {
    let (own, other) = (causes(bend), causes(change));
    // A load that changes does so to one joint as a zero that changes, which is simpler.
    let is_loaded = bend.joints.bends.iter().any(|bend| bend.change.is_some());
    let most = match own.cmp(&other) {
        Ordering::Greater => return false,
        _ if is_loaded => AS_LITTLE.recip(),
        Ordering::Equal => AS_LITTLE,
        Ordering::Less => AS_LITTLE_WITH_FEWER,
    };
    // While a joint crosses its play, and before it first moves, nobody knows where in it its link is.
    left_m(bend) <= most * left_m(change) || mostly_left_m(bend) <= most * mostly_left_m(change)
}

/// What is left of nine of ten samples of an arm's streams, an angle counting at 0.3 m, rms.
fn mostly_left_m(found: &ArmDiagnosis) -> f64 {
    const MOSTLY: f64 = 0.9;
    let of_stream = |found: &PoseDiagnosis| {
        let Residuals { m, rad } = found.aligned.after();
        let mut all: Vec<f64> = m.iter().zip(&rad).map(|(m, rad)| m.hypot(0.3 * rad)).collect();
        all.sort_by(f64::total_cmp);
        all.truncate((MOSTLY * all.len() as f64) as usize);
        (all.iter().map(|one| one * one).sum::<f64>() / all.len().max(1) as f64).sqrt()
    };
    found.streams.iter().map(of_stream).sum()
}

/// How many causes an explanation of an arm has beside latencies and readings; a change of an amount that
/// is wrong before as well as after counts as two.
fn causes(found: &ArmDiagnosis) -> usize {
    /// So little of a change is no amount of its own.
    const LITTLE: f64 = 0.2;
    let JointDiagnosis { offsets, changes, bends, .. } = &found.joints;
    let of_zero = |zero: &AmountChange| {
        let ends = [zero.from, zero.to].into_iter();
        ends.filter(|end| end.abs() > LITTLE * zero.by.value.abs()).count().max(1)
    };
    let of_change = |change: &JointChange| {
        change.zero.as_ref().map_or(0, of_zero) + usize::from(change.factor.is_some())
    };
    let changes_zero =
        |column| changes.iter().any(|change| change.column == column && change.zero.is_some());
    let zeros = offsets.iter().enumerate();
    let zeros = zeros.filter(|(column, offset)| offset.chosen && !changes_zero(*column)).count();
    let of_frame = |frame: &Seen<FrameEstimate>, changes: &[FrameChange]| {
        changes.len().max(usize::from(frame.as_ref().is_ok_and(|frame| frame.chosen)))
    };
    let of_stream = |found: &PoseDiagnosis| {
        of_frame(&found.tool, &found.tool_changes)
            + of_frame(&found.reference, &found.reference_changes)
            + found.growth_changes.len().max(usize::from(found.growth_chosen))
    };
    let changing: usize = changes.iter().map(of_change).sum();
    zeros + changing + bends.len() + found.streams.iter().map(of_stream).sum::<usize>()
}
