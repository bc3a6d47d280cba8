//! Compares joint compliance with change points. A few reversals of a joint with backlash look much like
//! steps of its zero or of a frame.

use crate::changes::left_m;
use crate::{
    ArmDiagnosis, EstimateResult, FrameChange, FrameEstimate, JointChange, JointDiagnosis,
    PoseDiagnosis, PoseDistances, ScalarChange,
};
use std::cmp::Ordering;

/// Maximum ratio of the residual with compliance to the residual with change points, if both models have
/// the same number of causes.
const AS_LITTLE: f64 = 1.5;
/// Same if compliance needs fewer causes. Larger, because the backlash crossings bias the fitted values.
const AS_LITTLE_WITH_FEWER: f64 = 3.0;

/// Returns whether the compliance model `bend` is preferred to the change-point model `change`.
pub(crate) fn gives(bend: &ArmDiagnosis, change: &ArmDiagnosis) -> bool {
    if bend.joints.bends.is_empty() {
        return false;
    }
    let (own, other) = (causes(bend), causes(change));
    // A step of one joint's zero is simpler than a load change, so compliance must fit better.
    let is_loaded = bend.joints.bends.iter().any(|bend| bend.change.is_some());
    let most = match own.cmp(&other) {
        Ordering::Greater => return false,
        _ if is_loaded => AS_LITTLE.recip(),
        Ordering::Equal => AS_LITTLE,
        Ordering::Less => AS_LITTLE_WITH_FEWER,
    };
    // The position within the backlash is unknown during a crossing and before the first motion.
    left_m(bend) <= most * left_m(change) || mostly_left_m(bend) <= most * mostly_left_m(change)
}

/// Trimmed rms residual of an arm's streams: the best nine tenths of the samples. Angles are weighted by
/// 0.3 m.
fn mostly_left_m(found: &ArmDiagnosis) -> f64 {
    const MOSTLY: f64 = 0.9;
    let of_stream = |found: &PoseDiagnosis| {
        let PoseDistances { m, rad } = found.aligned.after();
        let mut all: Vec<f64> = m.iter().zip(&rad).map(|(m, rad)| m.hypot(0.3 * rad)).collect();
        all.sort_by(f64::total_cmp);
        all.truncate((MOSTLY * all.len() as f64) as usize);
        (all.iter().map(|one| one * one).sum::<f64>() / all.len().max(1) as f64).sqrt()
    };
    found.streams.iter().map(of_stream).sum()
}

/// Number of causes in a diagnosis, excluding latencies and encodings. A change point counts twice if the
/// value is wrong both before and after it.
fn causes(found: &ArmDiagnosis) -> usize {
    /// A value below this fraction of the step counts as zero.
    const LITTLE: f64 = 0.2;
    let JointDiagnosis { offsets, changes, bends, .. } = &found.joints;
    let of_zero = |zero: &ScalarChange| {
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
    let of_frame = |frame: &EstimateResult<FrameEstimate>, changes: &[FrameChange]| {
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
