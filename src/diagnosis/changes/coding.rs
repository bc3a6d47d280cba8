//! Encodings that differ between segments of a run.

use super::cut::Span;
use super::{BaselineSegment, EncodingSpans, OtherSegment};
use crate::{PoseDiagnosis, PoseEncoding};

impl BaselineSegment {
    /// Reports the encoding of stream `s` in its diagnosis `after`. If an encoding differs between
    /// segments, reports the one that is not as logged, with the time span in which it applies.
    pub(super) fn read_as(&self, s: usize, others: &[OtherSegment], after: &mut PoseDiagnosis) {
        let own = &self.found.streams[s];
        let first = others.iter().find(|other| self.is_reread(s, other));
        let part = |is_same: EncodingComparison, is_as_logged: fn(&PoseDiagnosis) -> bool| {
            let its =
                &first.filter(|first| !is_same(own, &first.alone.streams[s]))?.alone.streams[s];
            if !is_as_logged(own) {
                return Some((own, self.span));
            }
            let alike = others.iter().filter(|other| is_same(its, &other.alone.streams[s]));
            alike.map(|other| other.span).reduce(|a, b| (a.0, b.1)).map(|span| (its, span))
        };
        let rotation = part(same_rotation, reads_rotation_as_logged);
        let degrees = part(same_degrees, |found| found.degrees.is_none());
        let length = part(same_length, |found| !matches!(found.length, Ok(Some(_))));
        let axes = part(same_axes, |found| !matches!(found.axes, Ok(Some(_))));
        let [of_rotation, of_degrees, of_length, of_axes] = [rotation, degrees, length, axes]
            .map(|part: Option<(&PoseDiagnosis, Span)>| part.map_or(own, |(found, _)| found));
        after.reading.clone_from(&of_rotation.reading);
        after.inverted = of_rotation.inverted;
        after.degrees = of_degrees.degrees;
        after.length.clone_from(&of_length.length);
        after.axes.clone_from(&of_axes.axes);
        after.constant.clone_from(&own.constant);
        let [rotation, degrees, length, axes] =
            [rotation, degrees, length, axes].map(|part| part.map(|(_, span)| span));
        after.coded = EncodingSpans { rotation, degrees, length, axes };
    }
}

/// Compares one aspect of the encoding of two streams.
type EncodingComparison = fn(&PoseDiagnosis, &PoseDiagnosis) -> bool;

fn same_rotation(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of = |found: &PoseDiagnosis| {
        let best = found.reading.as_ref().ok().map(|reading| reading.best);
        let other = best.filter(|best| !matches!(best, PoseEncoding::AsLogged));
        (other.map(|best| format!("{best:?}")), found.inverted)
    };
    of(a) == of(b)
}

fn same_degrees(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    a.degrees.is_some() == b.degrees.is_some()
}

fn same_length(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of = |found: &PoseDiagnosis| Some(found.length.as_ref().ok()?.as_ref()?.factor());
    of(a) == of(b)
}

fn same_axes(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let of = |found: &PoseDiagnosis| found.axes.as_ref().ok().copied().flatten();
    of(a) == of(b)
}

/// Returns whether two streams use the same encoding.
pub(super) fn same_coding(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let all: [EncodingComparison; 4] = [same_rotation, same_degrees, same_length, same_axes];
    all.into_iter().all(|same| same(a, b))
}

fn reads_rotation_as_logged(found: &PoseDiagnosis) -> bool {
    !found.inverted && found.reading.as_ref().is_ok_and(|reading| reading.best.is_as_logged())
}
