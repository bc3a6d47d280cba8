//! Reports the corrected changes.

use super::jumps::Jump;
use super::split_run::{Span, SplitRun};
use super::{BaselineSegment, ChangePoint, FrameChange, JointChange, OtherSegment, ScalarChange};
use crate::{
    ArmDiagnosis, Confounder, EstimateResult, FrameEstimate, LatencyProfile, LatencyStep,
    PoseDiagnosis,
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
        moment: impl Fn(f64) -> Option<&'a Jump>,
        after: &mut ArmDiagnosis,
    ) {
        let beyond = |span: &Span| others.iter().find(|other| other.span == *span);
        let mut latency_jumps: Vec<Vec<LatencyStep>> = vec![Vec::new(); after.streams.len()];
        for pair in parts.windows(2) {
            let (before, next) = (beyond(&pair[0]), beyond(&pair[1]));
            let Some(jump) = moment(pair[1].0) else { continue };
            for (s, after) in after.streams.iter_mut().enumerate() {
                let own = &self.found.streams[s];
                let at = (jump.at_s + run.lags[s], jump.within_s);
                let frame = |of: fn(&PoseDiagnosis) -> &EstimateResult<FrameEstimate>,
                             is_free: bool| {
                    let of_part = |part: Option<&OtherSegment>| {
                        let found =
                            part.and_then(|part| of(&part.difference.streams[s]).as_ref().ok());
                        found.filter(|frame| frame.is_chosen).cloned()
                    };
                    let kept = of(own).as_ref().ok().filter(|own| own.is_chosen || is_free);
                    frame_change(at, kept, of_part(before), of_part(next))
                };
                after.tool_changes.extend(frame(|found| &found.tool, false));
                let is_free = !run.streams[s].reference_known;
                after.reference_changes.extend(frame(|found| &found.reference, is_free));
                let growth = |found: &PoseDiagnosis| {
                    found
                        .radial_scale
                        .as_ref()
                        .ok()
                        .filter(|_| found.is_radial_scale_chosen)
                        .copied()
                };
                let of_part = |part: Option<&OtherSegment>| growth(&part?.difference.streams[s]);
                let kept = growth(own);
                let change = scalar_change(at, kept.as_ref(), of_part(before), of_part(next), 0.0);
                after.radial_scale_changes.extend(change);
            }
            let at = (jump.at_s, jump.within_s);
            for (s, jumps) in latency_jumps.iter_mut().enumerate() {
                let later = |part: Option<&OtherSegment>| {
                    part.and_then(|part| self.latency_increase(s, part))
                };
                let change = scalar_change(at, None, later(before), later(next), 0.0);
                jumps.extend(change.map(|change| LatencyStep {
                    at_s: change.at_s + run.lags[s],
                    size_s: change.size,
                }));
            }
            for column in 0..run.joints.dof {
                let zero = |part: Option<&OtherSegment>| {
                    let offset = part?.difference.joints.offsets.get(column)?;
                    offset.offset.as_ref().ok().filter(|_| offset.is_chosen).copied()
                };
                let factor = |part: Option<&OtherSegment>| {
                    let scales = &part?.difference.joints.scales;
                    Some(scales.iter().find(|scale| scale.column == column)?.factor)
                };
                let own = &self.found.joints.offsets.get(column);
                let own = own.filter(|own| own.is_chosen).and_then(|own| own.offset.as_ref().ok());
                let zero = scalar_change(at, own, zero(before), zero(next), 0.0);
                let scales = &self.found.joints.scales;
                let own = scales.iter().find(|scale| scale.column == column);
                let own = own.map_or(1.0, |scale| scale.factor.value);
                let scaled = |part| factor(part).map(|factor: Measured| factor.scaled(own));
                let factor = scalar_change(at, None, scaled(before), scaled(next), own);
                if zero.is_some() || factor.is_some() {
                    after.joints.changes.push(JointChange { column, zero, factor });
                }
            }
        }
        if let [stream] = run.streams {
            let joints = &mut after.joints;
            for change in joints.changes.iter().filter(|change| change.zero.is_some()) {
                let by = change.zero.as_ref().map_or(0.0, |zero| zero.size.value.abs());
                let is_at = |end: Option<&usize>| end == Some(&change.column);
                // For a single stream, the first joint's zero is equivalent to a base rotation, the last
                // joint's to a tool rotation.
                let base = is_at(stream.columns.first()).then_some(Confounder::Reference(0, by));
                let tool = is_at(stream.columns.last()).then_some(Confounder::Tool(0, by));
                if let Some(offset) = joints.offsets.get_mut(change.column) {
                    offset.confounders = base.into_iter().chain(tool).collect();
                }
            }
        }
        for (s, jumps) in latency_jumps.into_iter().enumerate() {
            let level = |span: &Span| {
                let later = beyond(span).and_then(|other| self.latency_increase(s, other));
                (span.0 + run.lags[s], later.map_or(0.0, |later| later.value))
            };
            let levels = parts.iter().map(level).collect();
            let windows =
                after.streams[s].latency_profile.as_ref().map(|course| course.windows.clone());
            let course = LatencyProfile::from_steps(jumps, levels, windows.unwrap_or_default());
            if let Some(course) = course {
                after.streams[s].latency_profile = Ok(course);
            }
        }
    }
}

/// `kept` is the baseline's frame; `from` and `to` are the segments' differences from it.
fn frame_change(
    (at_s, within_s): (f64, f64),
    kept: Option<&FrameEstimate>,
    from: Option<FrameEstimate>,
    to: Option<FrameEstimate>,
) -> Option<FrameChange> {
    let surest = to.as_ref().or(from.as_ref())?;
    let pose_of =
        |frame: &Option<FrameEstimate>| frame.as_ref().map_or_else(Pose::identity, |f| f.pose);
    let turn = pose_of(&from).inv_mul(&pose_of(&to));
    let errors = [kept, from.as_ref(), to.as_ref()].into_iter().flatten();
    let (length, angle) = errors.fold((0.0_f64, 0.0_f64), |(length, angle), frame| {
        (length.hypot(frame.translation_m.std_error), angle.hypot(frame.rotation_rad.std_error))
    });
    let both = from.is_some() && to.is_some();
    let size = |value: f64, std_error: f64, dof: f64| Measured { value, std_error, dof };
    let (length_m, angle_rad) = (turn.translation.vector.norm(), turn.rotation.angle());
    let by = FrameEstimate {
        pose: turn,
        translation_m: size(length_m, length, surest.translation_m.dof),
        rotation_rad: size(angle_rad, angle, surest.rotation_rad.dof),
        p_value: surest.p_value,
        is_chosen: true,
    };
    // The segments do not differ from each other.
    let is_same = both && length_m < 4.0 * length + 1e-4 && angle_rad < 4.0 * angle + 1e-4;
    let base = kept.map_or_else(Pose::identity, |kept| kept.pose);
    (!is_same).then(|| ChangePoint {
        at_s,
        within_s,
        from: pose_of(&from) * base,
        to: pose_of(&to) * base,
        size: by,
    })
}

/// `none` is the value without a difference.
fn scalar_change(
    (at_s, within_s): (f64, f64),
    kept: Option<&Measured>,
    from: Option<Measured>,
    to: Option<Measured>,
    none: f64,
) -> Option<ScalarChange> {
    let surest = to.or(from)?;
    let value = |one: Option<Measured>| one.map_or(none, |one| one.value);
    let std_error = [kept.copied(), from, to]
        .into_iter()
        .flatten()
        .fold(0.0_f64, |sum, one| sum.hypot(one.std_error));
    let by = Measured { value: value(to) - value(from), std_error, ..surest };
    let base = kept.map_or(0.0, |kept| kept.value);
    let is_same = from.is_some() && to.is_some() && by.value.abs() < 4.0 * by.std_error + 1e-5;
    (!is_same).then(|| ChangePoint {
        at_s,
        within_s,
        from: base + value(from),
        to: base + value(to),
        size: by,
    })
}
