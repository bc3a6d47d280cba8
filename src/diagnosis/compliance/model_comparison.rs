//! Compares joint compliance with change points: a few reversals with backlash look like steps of a zero or
//! frame.

use crate::residuals::comparison::residual_m;
use crate::{
    ArmDiagnosis, EstimateResult, FrameChange, FrameEstimate, JointChange, JointDiagnosis,
    PoseDiagnosis, PoseDistances, ScalarChange,
};
use std::cmp::Ordering;

/// Over change points with the same number of causes.
const MAX_RESIDUAL_RATIO: f64 = 1.5;
/// With fewer causes. Larger, because backlash crossings bias the fitted values.
const MAX_RESIDUAL_RATIO_WITH_FEWER: f64 = 3.0;

pub(crate) fn prefers_compliance(compliance: &ArmDiagnosis, change: &ArmDiagnosis) -> bool {
    if compliance.joints.compliance.is_empty() {
        return false;
    }
    let (causes_with_compliance, causes_with_changes) =
        (cause_count(compliance), cause_count(change));
    // A step of one joint's zero is simpler than a load change.
    let is_loaded =
        compliance.joints.compliance.iter().any(|compliance| compliance.change.is_some());
    let max_ratio = match causes_with_compliance.cmp(&causes_with_changes) {
        Ordering::Greater => return false,
        _ if is_loaded => MAX_RESIDUAL_RATIO.recip(),
        Ordering::Equal => MAX_RESIDUAL_RATIO,
        Ordering::Less => MAX_RESIDUAL_RATIO_WITH_FEWER,
    };
    // During a crossing and before the first motion, the position within the backlash is unknown.
    residual_m(compliance) <= max_ratio * residual_m(change)
        || trimmed_residual_m(compliance) <= max_ratio * trimmed_residual_m(change)
}

/// The best nine tenths of the samples. Angles are weighted by 0.3 m.
fn trimmed_residual_m(diagnosis: &ArmDiagnosis) -> f64 {
    const TRIMMED_SHARE: f64 = 0.9;
    let of_stream = |diagnosis: &PoseDiagnosis| {
        let PoseDistances { m, rad } = diagnosis.aligned.after();
        let mut all: Vec<f64> = m.iter().zip(&rad).map(|(m, rad)| m.hypot(0.3 * rad)).collect();
        all.sort_by(f64::total_cmp);
        all.truncate((TRIMMED_SHARE * all.len() as f64) as usize);
        (all.iter().map(|one| one * one).sum::<f64>() / all.len().max(1) as f64).sqrt()
    };
    diagnosis.streams.iter().map(of_stream).sum()
}

/// Excludes latencies and encodings. A change counts twice if the value is wrong before and after.
fn cause_count(diagnosis: &ArmDiagnosis) -> usize {
    /// Share of the step; smaller values count as zero.
    const MAX_ZERO_SHARE: f64 = 0.2;
    let JointDiagnosis { offsets, changes, compliance: compliances, .. } = &diagnosis.joints;
    let of_zero = |zero: &ScalarChange| {
        let ends = [zero.from, zero.to].into_iter();
        ends.filter(|end| end.abs() > MAX_ZERO_SHARE * zero.size.value.abs()).count().max(1)
    };
    let of_change = |change: &JointChange| {
        change.zero.as_ref().map_or(0, of_zero) + usize::from(change.factor.is_some())
    };
    let changes_zero =
        |column| changes.iter().any(|change| change.column == column && change.zero.is_some());
    let zeros = offsets.iter().enumerate();
    let zeros = zeros.filter(|(column, offset)| offset.is_chosen && !changes_zero(*column)).count();
    let of_frame = |frame: &EstimateResult<FrameEstimate>, changes: &[FrameChange]| {
        changes.len().max(usize::from(frame.as_ref().is_ok_and(|frame| frame.is_chosen)))
    };
    let of_stream = |diagnosis: &PoseDiagnosis| {
        of_frame(&diagnosis.tool, &diagnosis.tool_changes)
            + of_frame(&diagnosis.reference, &diagnosis.reference_changes)
            + diagnosis
                .radial_scale_changes
                .len()
                .max(usize::from(diagnosis.is_radial_scale_chosen))
    };
    let changing: usize = changes.iter().map(of_change).sum();
    zeros + changing + compliances.len() + diagnosis.streams.iter().map(of_stream).sum::<usize>()
}
