//! Changes as reported, with the diagnosis of the run without them.

use super::change::{Change, Subject, TO_START, value_at};
use super::change_fit::Equations;
use super::changing_stream::Stream;
use super::removal::Removal;
use super::{FrameChange, JointChange, JointParameter, ScalarChange};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::model::measurement::{pose_of_twist, twist_at, twist_lengths};
use crate::priors::{MODEL_ERROR_M, MODEL_ERROR_RAD};
use crate::residuals::cause_columns::{CauseColumns, Frame};
use crate::residuals::comparison::{has_slow_residual, residual_m, restore_recorded};
use crate::{ArmDiagnosis, Confounder, FrameEstimate, JointOffset, PoseDiagnosis, PoseStream};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::stats::Measured;
use nalgebra::{DMatrix, Matrix6, Vector6};

/// Confidence of decisions under autocorrelated noise.
const NOISE_CONFIDENCE: f64 = 0.999;

impl Removal {
    /// The diagnosis with the changes. `None` if one of them is not significant, or a residual remains that link deviations
    /// do not explain: unknown faults of joints can look like changes.
    pub fn reported(self, run: &ArmRun, before: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let Self { changes, mut after, .. } = self;
        let found = after.clone();
        let streams = Stream::all(run, &found);
        let confidence = required_confidence(run, before, &found, &streams, &changes)?;
        let equations = Equations::new(&streams, &changes, None);
        let dof = equations.normal.dof(equations.normal.right.len());
        let covariance = equations.shared.covariance();
        for (change, own) in changes.iter().zip(&equations.changes) {
            // Of half of its amount.
            let amounts = (change.columns.len(), change.columns.len());
            let covariance = &covariance.view((own.start, own.start), amounts).into_owned();
            let std_error = 2.0 * covariance[(0, 0)].sqrt();
            let size = Measured { value: 2.0 * change.half[0], std_error, dof };
            let differs = |size: &Measured| size.value.abs() > size.half_width(confidence);
            let is_significant = match change.subject {
                Subject::Frame { stream, frame } => {
                    let stream = streams.iter().find(|it| it.index == stream)?;
                    let reported = stream.report_frame(change, frame, (covariance, dof), &changes);
                    let FrameEstimate { translation_m, rotation_rad, .. } = &reported.size;
                    if translation_m.value < MODEL_ERROR_M && rotation_rad.value < MODEL_ERROR_RAD {
                        continue;
                    }
                    let is_significant = differs(translation_m) || differs(rotation_rad);
                    let stream = &mut after.streams[stream.index];
                    match frame {
                        Frame::Reference => stream.reference_changes.push(reported),
                        Frame::Tool => stream.tool_changes.push(reported),
                    }
                    is_significant
                }
                Subject::RadialScale { stream } => {
                    let stream = &mut after.streams[stream];
                    let base = stream.radial_scale.as_ref().ok();
                    let base = base.filter(|_| stream.is_radial_scale_chosen);
                    let at_start = base.map_or(0.0, |base| base.value);
                    let reported = report_value(change, at_start, size, &changes);
                    stream.radial_scale_changes.push(reported);
                    differs(&size)
                }
                Subject::Zero { column } => {
                    let at_start =
                        after.joints.offsets.get(column).map_or(0.0, JointOffset::chosen);
                    let change = report_value(change, at_start, size, &changes);
                    let parameter = JointParameter::Zero;
                    after.joints.changes.push(JointChange { column, parameter, change });
                    differs(&size)
                }
            };
            if !is_significant {
                return None;
            }
        }
        for (s, stream) in after.streams.iter_mut().enumerate() {
            stream.reference_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            stream.tool_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            stream.radial_scale_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            let is_own = changes.iter().any(|change| change.subject.stream() == Some(s));
            if is_own {
                keep_encoding(&before.streams[s], stream);
            }
            if is_own || !after.joints.patches.is_empty() {
                restore_recorded(run.joints, &run.streams[s], stream);
            }
        }
        let is_reported = !after.joints.changes.is_empty()
            || after.streams.iter().any(PoseDiagnosis::has_changes);
        report_confounders(run.streams, &mut after);
        is_reported.then_some(after)
    }
}

impl Stream<'_> {
    /// A frame's change as reported, including the state of the other changes at its time. Steps refer to the frame's origin,
    /// drifts to the middle of the motion.
    fn report_frame(
        &self,
        change: &Change,
        frame: Frame,
        (covariance, dof): (&DMatrix<f64>, f64),
        all: &[Change],
    ) -> FrameChange {
        let mut of_twist = Matrix6::zeros();
        let first = change.columns.start - frame.columns().start;
        of_twist.view_mut((first, first), covariance.shape()).copy_from(&(covariance * 4.0));
        let is_step = change.profile.step().is_some();
        let about = match frame {
            Frame::Reference if is_step => self.columns.centre,
            _ => Vec3::zeros(),
        };
        // A rotation about the middle of the motion moves the origin.
        let to_origin = twist_at(&-about);
        let of_twist = to_origin * of_twist * to_origin.transpose();
        let [shift, turn] = twist_lengths(&(to_origin * change.twist(2.0)).into(), &of_twist, dof);
        let (at_s, _) = change.profile.interval_s();
        let base = [&self.found.reference, &self.found.tool][frame as usize].as_ref().ok();
        let base = base.filter(|base| base.is_chosen).map_or_else(Pose::identity, |base| base.pose);
        let others =
            all.iter().filter(|it| it.subject == change.subject && it.profile != change.profile);
        let of_others: Vector6<f64> =
            others.map(|other| other.twist(other.profile.factor(at_s) + TO_START)).sum();
        let about = Pose::from_parts(about.into(), Rotation::identity());
        let frame = |part: f64| {
            let twist = of_others + change.twist(part);
            let changed = about * pose_of_twist(twist.as_slice()) * about.inverse();
            match frame {
                // From the stream to the reference.
                Frame::Reference => changed.inverse(),
                Frame::Tool => changed,
            }
        };
        let (from, to) = (frame(0.0), frame(2.0));
        let pose = from.inv_mul(&to);
        let exact = |value: f64, linear: Measured| Measured { value, ..linear };
        let size = FrameEstimate {
            pose,
            translation_m: exact(pose.translation.vector.norm(), shift.norm),
            rotation_rad: exact(pose.rotation.angle(), turn.norm),
            p_value: shift.p_value.min(turn.p_value),
            is_chosen: true,
        };
        change.profile.change_point(from * base, to * base, size)
    }
}

/// Confidence with which each change must differ from zero. `None` if a residual remains that link deviations do not
/// explain: unknown faults of joints can look like changes.
fn required_confidence(
    run: &ArmRun,
    before: &ArmDiagnosis,
    after: &ArmDiagnosis,
    streams: &[Stream],
    changes: &[Change],
) -> Option<f64> {
    /// Share of the residual before, for changes under autocorrelated noise.
    const MAX_RESIDUAL_SHARE: f64 = 0.5;
    let is_explained = |stream: &Stream| {
        let seen = changes.iter().any(|change| stream.seen(change).is_some());
        let columns = CauseColumns::new(stream.found, &run.streams[stream.index]);
        !seen || !has_slow_residual(stream.found) || !columns.has_unexplained_residual()
    };
    if are_floating(run.streams) || streams.iter().all(is_explained) {
        return Some(0.95);
    }
    let is_noise = residual_m(after) < MAX_RESIDUAL_SHARE * residual_m(before)
        && !streams.iter().any(|stream| depends_on_configuration(stream.found));
    is_noise.then_some(NOISE_CONFIDENCE)
}

/// Whether the residual repeats with the configuration, unlike autocorrelated noise.
fn depends_on_configuration(found: &PoseDiagnosis) -> bool {
    let exceeds = |excess: &Measured| excess.value > excess.half_width(NOISE_CONFIDENCE);
    found.residual.as_ref().is_ok_and(|it| exceeds(&it.excess_m) || exceeds(&it.excess_rad))
}

/// A change of a joint's zero or a radial scale as reported.
fn report_value(change: &Change, at_start: f64, size: Measured, all: &[Change]) -> ScalarChange {
    let (at_s, _) = change.profile.interval_s();
    let others = all.iter().filter(|other| other.profile != change.profile);
    let from = at_start + value_at(others, change.subject, at_s);
    change.profile.change_point(from, from + size.value, size)
}

/// Reports in `after`, the diagnosis of decoded poses, the encoding that they had.
fn keep_encoding(before: &PoseDiagnosis, after: &mut PoseDiagnosis) {
    after.encoding.clone_from(&before.encoding);
    after.is_inverted = before.is_inverted;
    after.degrees = before.degrees;
    after.length_unit.clone_from(&before.length_unit);
    after.axes.clone_from(&before.axes);
    after.constant_coordinates.clone_from(&before.constant_coordinates);
}

/// For a single stream, the first joint's zero is equivalent to a base rotation, the last joint's to a tool rotation.
fn report_confounders(streams: &[PoseStream], after: &mut ArmDiagnosis) {
    let [stream] = streams else { return };
    let joints = &mut after.joints;
    for JointChange { column, change, .. } in &joints.changes {
        let by = change.size.value.abs();
        let is_at = |end: Option<&usize>| end == Some(column);
        let base = is_at(stream.columns.first()).then_some(Confounder::Reference(0, by));
        let tool = is_at(stream.columns.last()).then_some(Confounder::Tool(0, by));
        if let Some(offset) = joints.offsets.get_mut(*column) {
            offset.confounders = base.into_iter().chain(tool).collect();
        }
    }
}
