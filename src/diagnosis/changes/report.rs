//! Reports the corrected changes.

use super::jumps::Jump;
use super::split_run::{Span, SplitRun};
use super::{BaselineSegment, ChangePoint, FrameChange, JointChange, OtherSegment, ScalarChange};
use crate::{
    ArmDiagnosis, Confounder, EstimateResult, FrameEstimate, LatencyProfile, LatencyStep,
    PoseDiagnosis, PoseStream,
};
use ground::geometry::Pose;
use ground::stats::Measured;

impl BaselineSegment {
    /// Adds changes to `after`, the diagnosis of the corrected run.
    pub(super) fn report_changes<'a>(
        &self,
        run: &SplitRun,
        parts: &[Span],
        others: &[OtherSegment],
        jump_at: impl Fn(f64) -> Option<&'a Jump>,
        after: &mut ArmDiagnosis,
    ) {
        let segment_at = |span: &Span| others.iter().find(|other| other.span == *span);
        let mut latency_jumps: Vec<Vec<LatencyStep>> = vec![Vec::new(); after.streams.len()];
        for pair in parts.windows(2) {
            let (before, next) = (segment_at(&pair[0]), segment_at(&pair[1]));
            let Some(jump) = jump_at(pair[1].0) else { continue };
            for (s, after) in after.streams.iter_mut().enumerate() {
                let baseline = &self.diagnosis.streams[s];
                let at = (jump.at_s + run.lags[s], jump.within_s);
                let frame = |of: fn(&PoseDiagnosis) -> &EstimateResult<FrameEstimate>,
                             is_free: bool| {
                    let of_segment = |segment: Option<&OtherSegment>| {
                        let diagnosis = segment
                            .and_then(|segment| of(&segment.difference.streams[s]).as_ref().ok());
                        diagnosis.filter(|frame| frame.is_chosen).cloned()
                    };
                    let of_baseline =
                        of(baseline).as_ref().ok().filter(|frame| frame.is_chosen || is_free);
                    frame_change(at, of_baseline, of_segment(before), of_segment(next))
                };
                after.tool_changes.extend(frame(|diagnosis| &diagnosis.tool, false));
                let is_free = !run.arm.streams[s].reference_known;
                after.reference_changes.extend(frame(|diagnosis| &diagnosis.reference, is_free));
                let radial_scale = |diagnosis: &PoseDiagnosis| {
                    diagnosis
                        .radial_scale
                        .as_ref()
                        .ok()
                        .filter(|_| diagnosis.is_radial_scale_chosen)
                        .copied()
                };
                let of_segment =
                    |segment: Option<&OtherSegment>| radial_scale(&segment?.difference.streams[s]);
                let of_baseline = radial_scale(baseline);
                let change = scalar_change(
                    at,
                    of_baseline.as_ref(),
                    of_segment(before),
                    of_segment(next),
                    0.0,
                );
                after.radial_scale_changes.extend(change);
            }
            let at = (jump.at_s, jump.within_s);
            for (s, jumps) in latency_jumps.iter_mut().enumerate() {
                let latency_of = |segment: Option<&OtherSegment>| {
                    segment.and_then(|segment| self.latency_increase(s, segment))
                };
                let change = scalar_change(at, None, latency_of(before), latency_of(next), 0.0);
                jumps.extend(change.map(|change| LatencyStep {
                    at_s: change.at_s + run.lags[s],
                    size_s: change.size,
                }));
            }
            for column in 0..run.arm.joints.dof {
                let zero = |segment: Option<&OtherSegment>| {
                    let offset = segment?.difference.joints.offsets.get(column)?;
                    offset.offset.as_ref().ok().filter(|_| offset.is_chosen).copied()
                };
                let factor = |segment: Option<&OtherSegment>| {
                    let scales = &segment?.difference.joints.scales;
                    Some(scales.iter().find(|scale| scale.column == column)?.factor)
                };
                let of_baseline = self.diagnosis.joints.offsets.get(column);
                let of_baseline = of_baseline
                    .filter(|offset| offset.is_chosen)
                    .and_then(|offset| offset.offset.as_ref().ok());
                let zero = scalar_change(at, of_baseline, zero(before), zero(next), 0.0);
                let scales = &self.diagnosis.joints.scales;
                let of_baseline = scales.iter().find(|scale| scale.column == column);
                let of_baseline = of_baseline.map_or(1.0, |scale| scale.factor.value);
                let scaled =
                    |segment| factor(segment).map(|factor: Measured| factor.scaled(of_baseline));
                let factor = scalar_change(at, None, scaled(before), scaled(next), of_baseline);
                if zero.is_some() || factor.is_some() {
                    after.joints.changes.push(JointChange { column, zero, factor });
                }
            }
        }
        report_confounders(run.arm.streams, after);
        for (s, jumps) in latency_jumps.into_iter().enumerate() {
            let level = |span: &Span| {
                let latency_of = segment_at(span).and_then(|other| self.latency_increase(s, other));
                (span.0 + run.lags[s], latency_of.map_or(0.0, |latency_of| latency_of.value))
            };
            let levels = parts.iter().map(level).collect();
            let windows =
                after.streams[s].latency_profile.as_ref().map(|profile| profile.windows.clone());
            let profile = LatencyProfile::from_steps(jumps, levels, windows.unwrap_or_default());
            if let Some(profile) = profile {
                after.streams[s].latency_profile = Ok(profile);
            }
        }
    }
}

/// For a single stream, the first joint's zero is equivalent to a base rotation, the last joint's to a tool rotation.
pub(super) fn report_confounders(streams: &[PoseStream], after: &mut ArmDiagnosis) {
    let [stream] = streams else { return };
    let joints = &mut after.joints;
    for JointChange { column, zero, .. } in &joints.changes {
        let Some(zero) = zero else { continue };
        let by = zero.size.value.abs();
        let is_at = |end: Option<&usize>| end == Some(column);
        let base = is_at(stream.columns.first()).then_some(Confounder::Reference(0, by));
        let tool = is_at(stream.columns.last()).then_some(Confounder::Tool(0, by));
        if let Some(offset) = joints.offsets.get_mut(*column) {
            offset.confounders = base.into_iter().chain(tool).collect();
        }
    }
}

/// `baseline` is the baseline's frame; `from` and `to` are the segments' differences from it.
fn frame_change(
    (at_s, within_s): (f64, f64),
    baseline: Option<&FrameEstimate>,
    from: Option<FrameEstimate>,
    to: Option<FrameEstimate>,
) -> Option<FrameChange> {
    let surest = to.as_ref().or(from.as_ref())?;
    let pose_of =
        |frame: &Option<FrameEstimate>| frame.as_ref().map_or_else(Pose::identity, |f| f.pose);
    let difference = pose_of(&from).inv_mul(&pose_of(&to));
    let errors = [baseline, from.as_ref(), to.as_ref()].into_iter().flatten();
    let (length, angle) = errors.fold((0.0_f64, 0.0_f64), |(length, angle), frame| {
        (length.hypot(frame.translation_m.std_error), angle.hypot(frame.rotation_rad.std_error))
    });
    let both = from.is_some() && to.is_some();
    let size = |value: f64, std_error: f64, dof: f64| Measured { value, std_error, dof };
    let (length_m, angle_rad) = (difference.translation.vector.norm(), difference.rotation.angle());
    let by = FrameEstimate {
        pose: difference,
        translation_m: size(length_m, length, surest.translation_m.dof),
        rotation_rad: size(angle_rad, angle, surest.rotation_rad.dof),
        p_value: surest.p_value,
        is_chosen: true,
    };
    // The segments do not differ from each other.
    let is_same = both && length_m < 4.0 * length + 1e-4 && angle_rad < 4.0 * angle + 1e-4;
    let base = baseline.map_or_else(Pose::identity, |baseline| baseline.pose);
    (!is_same).then(|| ChangePoint {
        at_s,
        within_s,
        is_gradual: false,
        from: pose_of(&from) * base,
        to: pose_of(&to) * base,
        size: by,
    })
}

/// `none` is the value without a difference.
fn scalar_change(
    (at_s, within_s): (f64, f64),
    baseline: Option<&Measured>,
    from: Option<Measured>,
    to: Option<Measured>,
    none: f64,
) -> Option<ScalarChange> {
    let surest = to.or(from)?;
    let value = |one: Option<Measured>| one.map_or(none, |one| one.value);
    let std_error = [baseline.copied(), from, to]
        .into_iter()
        .flatten()
        .fold(0.0_f64, |sum, one| sum.hypot(one.std_error));
    let by = Measured { value: value(to) - value(from), std_error, ..surest };
    let base = baseline.map_or(0.0, |baseline| baseline.value);
    let is_same = from.is_some() && to.is_some() && by.value.abs() < 4.0 * by.std_error + 1e-5;
    (!is_same).then(|| ChangePoint {
        at_s,
        within_s,
        is_gradual: false,
        from: base + value(from),
        to: base + value(to),
        size: by,
    })
}
