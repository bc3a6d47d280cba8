//! Encodings that differ between segments of a run.

use super::split_run::Span;
use super::{BaselineSegment, EncodingSpans, OtherSegment};
use crate::{ArmDiagnosis, JointDiagnosis, JointEncoding, PoseDiagnosis, PoseEncoding};

/// Reports in `after`, the diagnosis of decoded poses, the encoding that they had.
pub(super) fn keep_encoding(before: &PoseDiagnosis, after: &mut PoseDiagnosis) {
    after.encoding.clone_from(&before.encoding);
    after.is_inverted = before.is_inverted;
    after.degrees = before.degrees;
    after.length_unit.clone_from(&before.length_unit);
    after.axes.clone_from(&before.axes);
    after.constant_coordinates.clone_from(&before.constant_coordinates);
}

impl BaselineSegment {
    /// If an encoding differs between segments, reports the one not as logged, with its time span.
    pub(super) fn report_encoding(
        &self,
        s: usize,
        others: &[OtherSegment],
        after: &mut PoseDiagnosis,
    ) {
        let baseline = &self.diagnosis.streams[s];
        let first = others.iter().find(|other| self.has_other_encoding(s, other));
        let component = |is_same: EncodingComparison, is_as_logged: fn(&PoseDiagnosis) -> bool| {
            let is_different = |other: &&OtherSegment| !is_same(baseline, &other.alone.streams[s]);
            let first = &first.filter(is_different)?.alone.streams[s];
            if !is_as_logged(baseline) {
                return Some((baseline, self.span));
            }
            let same = others.iter().filter(|other| is_same(first, &other.alone.streams[s]));
            same.map(|other| other.span).reduce(|a, b| (a.0, b.1)).map(|span| (first, span))
        };
        let rotation = component(is_same_rotation, is_rotation_as_logged);
        let degrees = component(is_same_angle_unit, |diagnosis| diagnosis.degrees.is_none());
        let length = component(is_same_length_unit, |diagnosis| {
            !matches!(diagnosis.length_unit, Ok(Some(_)))
        });
        let axes = component(is_same_axes, |diagnosis| !matches!(diagnosis.axes, Ok(Some(_))));
        let [of_rotation, of_degrees, of_length, of_axes] =
            [rotation, degrees, length, axes].map(|component: Option<(&PoseDiagnosis, Span)>| {
                component.map_or(baseline, |(diagnosis, _)| diagnosis)
            });
        after.encoding.clone_from(&of_rotation.encoding);
        after.is_inverted = of_rotation.is_inverted;
        after.degrees = of_degrees.degrees;
        after.length_unit.clone_from(&of_length.length_unit);
        after.axes.clone_from(&of_axes.axes);
        after.constant_coordinates.clone_from(&baseline.constant_coordinates);
        let [rotation, degrees, length, axes] =
            [rotation, degrees, length, axes].map(|component| component.map(|(_, span)| span));
        after.encoding_spans = EncodingSpans { rotation, degrees, length, axes };
    }

    /// The baseline's joint diagnosis with the unit of angles and the order of another segment, if known.
    pub(super) fn joints_in_encoding_of(&self, own: &ArmDiagnosis) -> JointDiagnosis {
        let mut joints = self.diagnosis.joints.clone();
        if let (Ok(encoding), Ok(own)) = (&mut joints.encoding, &own.joints.encoding) {
            encoding.degrees = own.degrees;
            encoding.permutation.clone_from(&own.permutation);
        }
        joints
    }

    /// Encoding and span of the segments whose joints are in degrees or in another order, if others are not.
    pub(super) fn partial_joint_encoding(
        &self,
        others: &[OtherSegment],
    ) -> Option<(JointEncoding, Span)> {
        let own = std::iter::once((self.span, &self.diagnosis));
        let others = others.iter().map(|other| (other.span, &other.alone));
        let known = own
            .chain(others)
            .filter_map(|(span, diagnosis)| Some((span, diagnosis.joints.encoding.as_ref().ok()?)));
        let (wrong, right): (Vec<_>, Vec<_>) = known.partition(|(_, encoding)| {
            encoding.degrees.is_some() || encoding.permutation.is_some()
        });
        let &(_, encoding) = wrong.first().filter(|_| !right.is_empty())?;
        let ends = wrong.iter().map(|(span, _)| *span);
        let span = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        Some((encoding.clone(), span))
    }
}

type EncodingComparison = fn(&PoseDiagnosis, &PoseDiagnosis) -> bool;

fn is_same_rotation(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of = |diagnosis: &PoseDiagnosis| {
        let best = diagnosis.encoding.as_ref().ok().map(|reading| reading.best);
        let other = best.filter(|best| !matches!(best, PoseEncoding::AsLogged));
        (other.map(|best| format!("{best:?}")), diagnosis.is_inverted)
    };
    of(a) == of(b)
}

fn is_same_angle_unit(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    a.degrees.is_some() == b.degrees.is_some()
}

fn is_same_length_unit(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of =
        |diagnosis: &PoseDiagnosis| Some(diagnosis.length_unit.as_ref().ok()?.as_ref()?.factor());
    of(a) == of(b)
}

fn is_same_axes(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of = |diagnosis: &PoseDiagnosis| diagnosis.axes.as_ref().ok().copied().flatten();
    of(a) == of(b)
}

pub(super) fn is_same_encoding(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let all: [EncodingComparison; 4] =
        [is_same_rotation, is_same_angle_unit, is_same_length_unit, is_same_axes];
    all.into_iter().all(|same| same(a, b))
}

fn is_rotation_as_logged(diagnosis: &PoseDiagnosis) -> bool {
    !diagnosis.is_inverted
        && diagnosis.encoding.as_ref().is_ok_and(|reading| reading.best.is_as_logged())
}
