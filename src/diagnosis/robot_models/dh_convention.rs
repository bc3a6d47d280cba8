//! Checks the declared convention of a DH table by the residuals under each convention.

use crate::selection::nominal_model::is_calibratable;
use crate::{ArmDiagnosis, PoseDiagnosis};

/// Between the two conventions.
const MIN_RESIDUAL_RATIO: f64 = 10.0;
/// Smaller residuals do not distinguish conventions, rms m.
const MIN_DISTINGUISHABLE_M: f64 = 1e-4;

/// Excess residual under one convention. Infinite if the stream could not be decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhResidual {
    /// Position residual, rms m.
    pub m: f64,
    /// Rotation residual, rms rad.
    pub rad: f64,
}

/// Residuals of a stream under both conventions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DhStreamResiduals {
    /// Under the declared convention.
    pub declared: DhResidual,
    /// Declared convention with constant frames fitted, rms m. `None` if not computed.
    pub declared_positions_m: Option<f64>,
    /// Under the other convention. `None` if not computed or excluded by positions.
    pub other: Option<DhResidual>,
}

/// Residuals of an arm under both conventions.
#[derive(Clone, Debug, PartialEq)]
pub struct DhComparison {
    /// One entry per pose stream.
    pub streams: Vec<DhStreamResiduals>,
    /// Faults under the declared convention: misinterpretations, joint zeros, frames, radial scale.
    pub declared_faults: usize,
    /// Faults under the other convention.
    pub other_faults: usize,
}

/// Convention of a table, determined from the streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DhConventionResult {
    /// The declared convention.
    AsDeclared,
    /// The other convention.
    Other,
    /// Undetermined: the other needs fewer faults, or each explains some streams.
    Either,
    /// Neither convention explains a stream.
    Neither,
}

impl DhResidual {
    /// Excess residual of each stream in a diagnosis.
    pub fn from_diagnosis(diagnosis: &ArmDiagnosis) -> Vec<Self> {
        let is_read = diagnosis.joints.encoding.is_ok();
        let residual =
            |stream: &PoseDiagnosis| match stream.encoding.as_ref().and(stream.residual.as_ref()) {
                Ok(left) if is_read => Self { m: left.excess_m.value, rad: left.excess_rad.value },
                _ => Self { m: f64::INFINITY, rad: f64::INFINITY },
            };
        diagnosis.streams.iter().map(residual).collect()
    }

    /// Whether the residual is normal for a calibrated arm with a nominal model.
    pub fn is_explained(&self) -> bool {
        is_calibratable([self.m, self.rad])
    }
}

/// Number of faults in a diagnosis.
pub fn fault_count(diagnosis: &ArmDiagnosis) -> usize {
    let of_joints = diagnosis.joints.encoding.as_ref().map_or(0, |encoding| {
        usize::from(encoding.is_in_degrees) + usize::from(encoding.permutation.is_some())
    });
    let of_stream = |stream: &PoseDiagnosis| {
        stream.chosen_frames()
            + usize::from(stream.is_misread())
            + usize::from(stream.is_radial_scale_chosen)
    };
    of_joints
        + diagnosis.joints.chosen_zeros()
        + diagnosis.streams.iter().map(of_stream).sum::<usize>()
}

impl DhStreamResiduals {
    /// Result for the declared and for the other convention.
    fn explained_by(&self) -> [bool; 2] {
        [self.declared.is_explained(), self.other.is_some_and(|other| other.is_explained())]
    }

    /// Whether only the other convention explains the stream, and clearly better.
    pub fn supports_other(&self) -> bool {
        let is_clear = self.other.is_some_and(|other| {
            self.declared.m > MIN_RESIDUAL_RATIO * other.m.max(MIN_DISTINGUISHABLE_M)
        });
        self.explained_by() == [false, true] && is_clear
    }
}

impl DhComparison {
    /// Determines the convention. Ignores streams that neither explains; they may belong to another arm.
    pub fn convention(&self) -> DhConventionResult {
        let count = |is: &dyn Fn(&DhStreamResiduals) -> bool| {
            self.streams.iter().filter(|one| is(one)).count()
        };
        let for_declared = count(&|stream| stream.explained_by() == [true, false]);
        let for_other = count(&DhStreamResiduals::supports_other);
        let not_clear = count(&|stream| stream.explained_by() == [false, true]) - for_other;
        let by_both = count(&|stream| stream.explained_by() == [true, true]);
        match (for_declared, for_other, not_clear) {
            (0, 1.., _) => DhConventionResult::Other,
            (1.., 0, 0) => DhConventionResult::AsDeclared,
            (0, 0, 0) if by_both == 0 => DhConventionResult::Neither,
            (0, 0, 0) if self.declared_faults <= self.other_faults => {
                DhConventionResult::AsDeclared
            }
            _ => DhConventionResult::Either,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LARGE_RESIDUAL: [f64; 2] = [0.3, 0.4];
    const SMALL_RESIDUAL: [f64; 2] = [2e-5, 1e-5];
    const NOMINAL: [f64; 2] = [4e-3, 4e-3];
    const NOT_DECODED: [f64; 2] = [f64::INFINITY, f64::INFINITY];

    fn convention_of(
        streams: &[([f64; 2], Option<[f64; 2]>)],
        faults: [usize; 2],
    ) -> DhConventionResult {
        let residual = |[m, rad]: [f64; 2]| DhResidual { m, rad };
        let streams = streams.iter().map(|&(declared, other)| DhStreamResiduals {
            declared: residual(declared),
            declared_positions_m: None,
            other: other.map(residual),
        });
        let [declared_faults, other_faults] = faults;
        DhComparison { streams: streams.collect(), declared_faults, other_faults }.convention()
    }

    #[test]
    fn a_convention_is_identified_if_only_the_other_explains() {
        for (declared, other, faults, expected) in [
            (LARGE_RESIDUAL, Some(SMALL_RESIDUAL), [2, 0], DhConventionResult::Other),
            (NOT_DECODED, Some(NOMINAL), [0, 1], DhConventionResult::Other),
            (SMALL_RESIDUAL, None, [1, 0], DhConventionResult::AsDeclared),
            (SMALL_RESIDUAL, Some(SMALL_RESIDUAL), [1, 1], DhConventionResult::AsDeclared),
            (SMALL_RESIDUAL, Some(SMALL_RESIDUAL), [2, 0], DhConventionResult::Either),
            ([0.02, 0.0], Some(NOMINAL), [0, 0], DhConventionResult::Either),
            (LARGE_RESIDUAL, Some(LARGE_RESIDUAL), [0, 0], DhConventionResult::Neither),
            (LARGE_RESIDUAL, None, [0, 0], DhConventionResult::Neither),
        ] {
            let found = convention_of(&[(declared, other)], faults);
            assert_eq!(found, expected, "{declared:?} {other:?} {faults:?}");
        }
    }

    #[test]
    fn a_stream_that_neither_convention_explains_is_ignored() {
        let stranger = (NOT_DECODED, Some(NOT_DECODED));
        let (for_declared, for_other) =
            ((SMALL_RESIDUAL, Some(LARGE_RESIDUAL)), (LARGE_RESIDUAL, Some(SMALL_RESIDUAL)));
        for (streams, expected) in [
            ([stranger, (SMALL_RESIDUAL, None)], DhConventionResult::AsDeclared),
            ([for_other, stranger], DhConventionResult::Other),
            ([for_other, for_declared], DhConventionResult::Either),
        ] {
            assert_eq!(convention_of(&streams, [0, 0]), expected, "{streams:?}");
        }
    }
}
