//! Rotation encoding of a stream, given candidate position encodings.

use super::axis_convention::{PositionEncoding, axes_matrix};
use super::rotation::{
    EncodingFit, FreeFrameErrors, LoggedRotations, LoggedValues, RotationSamples,
    estimate_encoding, fit_known, number_encodings, simple_encodings,
};
use crate::PoseEncoding;
use crate::frames::position_fit::MAX_POSITION_RESIDUAL_SHARE;
use crate::{AxesError, EncodingEstimate, EstimateResult, NotObservable};
use ground::geometry::{Axes, Rotation, Vec3, angle_between};
use ground::stats::mean;
use nalgebra::Matrix3;

/// Correct encodings stay below this although joints may be off by some degrees.
pub(crate) const MAX_ENCODING_RESIDUAL_RAD: f64 = 0.05;

/// Interpretation of positions and axes before rotations are decoded.
#[derive(Clone, Copy)]
pub(crate) struct PositionInterpretation {
    pub metres: f64,
    pub axes: AxesError,
    pub is_inverted: bool,
    /// Rotation of the reference, if determined.
    pub reference: Option<Rotation>,
}

impl PositionInterpretation {
    /// Standard axes, with a free rotation of the reference.
    pub fn unanchored(metres: f64) -> Self {
        Self { metres, axes: AxesError::NONE, is_inverted: false, reference: None }
    }

    /// Interpretations of `layout` for a motion of `extent_m`.
    pub fn from_encoding(layout: &PositionEncoding, extent_m: f64) -> Vec<Self> {
        let standard = AxesError::NONE;
        let interpretation = |axes, reference: Option<Rotation>| {
            let PositionEncoding { metres, is_inverted, .. } = *layout;
            // Inverse positions do not determine the base's rotation.
            let reference = reference.filter(|_| !is_inverted);
            PositionInterpretation { metres, axes, is_inverted, reference }
        };
        if layout.residual_m > MAX_POSITION_RESIDUAL_SHARE * extent_m {
            return vec![interpretation(standard, None)];
        }
        let both = |axes| AxesError { positions: axes, rotations: axes };
        let positions = |axes| AxesError { positions: axes, ..standard };
        let unturned = |axes| interpretation(axes, Some(Rotation::identity()));
        match (layout.axes, layout.is_mirrored()) {
            (Some(axes), true) => vec![unturned(both(axes)), unturned(positions(axes))],
            (None, true) => {
                // In a freely rotated world all mirrors are equivalent; use the most common.
                let back = axes_matrix(Axes::UNITY).transpose();
                let turn = rotation_of(&(back * layout.turn));
                vec![
                    interpretation(both(Axes::UNITY), Some(turn)),
                    interpretation(positions(Axes::UNITY), None),
                ]
            }
            (Some(axes), false) if axes.are_exchanged() && !layout.is_inverted => vec![
                interpretation(standard, Some(rotation_of(&layout.turn))),
                unturned(both(axes)),
                unturned(positions(axes)),
            ],
            (_, false) => vec![interpretation(standard, Some(rotation_of(&layout.turn)))],
        }
    }

    /// Whether rotations have the same interpretation.
    pub fn has_rotations_of(&self, other: &Self) -> bool {
        (self.axes, self.is_inverted, self.reference)
            == (other.axes, other.is_inverted, other.reference)
    }

    /// Logged rotations in this interpretation.
    pub fn rotations<'a>(&self, logged: LoggedRotations<'a>) -> LoggedRotations<'a> {
        logged.with_axes(self.axes.rotations, self.is_inverted)
    }

    /// m, before any inversion.
    pub fn positions(&self, xyz: &[Vec3]) -> Vec<Vec3> {
        xyz.iter().map(|p| self.axes.positions.to_standard(*p) * self.metres).collect()
    }
}

fn rotation_of(matrix: &Matrix3<f64>) -> Rotation {
    Rotation::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*matrix))
}

/// Interpretation with the rotation encoding under it.
type Interpreted = (PositionInterpretation, EncodingEstimate, EncodingFit);

impl RotationSamples<'_> {
    /// Rotation encoding under one interpretation, with its rotated reference.
    fn estimate_encoding(
        &self,
        interpretation: PositionInterpretation,
    ) -> EstimateResult<Interpreted> {
        let (mut encoding, mut fit) = self.interpreted(&interpretation, estimate_encoding)?;
        fit.reference *= interpretation.reference.unwrap_or_default();
        if interpretation.axes != AxesError::NONE {
            encoding.as_logged_rad = self.as_logged_rad();
        }
        Ok((interpretation, encoding, fit))
    }

    /// Smallest residual of the simplest encodings, rad.
    fn simplest_residual_rad(&self, interpretation: &PositionInterpretation) -> f64 {
        let encodings: Vec<PoseEncoding> = match self.logged.values {
            LoggedValues::Rotations(_) => simple_encodings().collect(),
            LoggedValues::Numbers(_) => number_encodings().collect(),
        };
        self.interpreted(interpretation, |samples| {
            let fits = encodings.into_iter().filter_map(|encoding| fit_known(samples, encoding));
            fits.map(|fit| fit.residual_rad).fold(f64::INFINITY, f64::min)
        })
    }

    /// Evaluates the samples under an interpretation.
    fn interpreted<T>(
        &self,
        interpretation: &PositionInterpretation,
        evaluate: impl FnOnce(&RotationSamples) -> T,
    ) -> T {
        let reference = interpretation.reference.unwrap_or_default();
        let turned: Vec<Rotation> = self.fk.iter().map(|fk| reference * fk).collect();
        evaluate(&RotationSamples {
            fk: &turned,
            frames: if interpretation.reference.is_some() {
                &FreeFrameErrors::OF_TOOL
            } else {
                self.frames
            },
            logged: interpretation.rotations(self.logged),
            ..*self
        })
    }

    /// Rms angle of logged rotations to FK, rad.
    fn as_logged_rad(&self) -> Option<f64> {
        let LoggedValues::Rotations(logged) = self.logged.values else { return None };
        let squares = logged.iter().zip(self.fk).map(|(a, b)| angle_between(a, b).powi(2));
        Some(mean(squares).sqrt())
    }

    /// Interpretation under which rotations fit best. After weak motion, the rotation of an unknown reference by
    /// positions may be wrong. If no interpretation fits, `unanchored` leaves it free.
    pub fn best_of(
        &self,
        interpretations: Vec<PositionInterpretation>,
        unanchored: PositionInterpretation,
    ) -> EstimateResult<Interpreted> {
        let fits = |found: &EstimateResult<Interpreted>| {
            found.as_ref().is_ok_and(|(_, _, fit)| fit.residual_rad <= MAX_ENCODING_RESIDUAL_RAD)
        };
        let best = self.best(interpretations);
        if self.is_reference_known() || fits(&best) {
            return best;
        }
        let free = self.best(vec![unanchored]);
        if fits(&free) { free } else { best }
    }

    fn best(&self, interpretations: Vec<PositionInterpretation>) -> EstimateResult<Interpreted> {
        /// For other axes of rotations only.
        const MIN_RESIDUAL_RATIO: f64 = 5.0;
        let mut best: EstimateResult<Interpreted> = Err(NotObservable::NoOrientation);
        // Rotations may have other axes even if positions have standard ones.
        let is_declared = |interpretation: &&PositionInterpretation| {
            interpretation.reference.is_some() && interpretation.axes == AxesError::NONE
        };
        let declared_frame = interpretations.iter().find(is_declared).copied();
        let order = |(_, _, fit): &Interpreted| match fit.residual_rad {
            ..=MAX_ENCODING_RESIDUAL_RAD => (0, f64::from(fit.frames.frame_count())),
            residual_rad => (1, residual_rad),
        };
        for interpretation in interpretations {
            let found = self.estimate_encoding(interpretation);
            // Reversed joints may mirror positions, but not rotations.
            let is_rejected = found.as_ref().is_ok_and(|(interpretation, _, fit)| {
                interpretation.axes != AxesError::NONE
                    && fit.residual_rad > MAX_ENCODING_RESIDUAL_RAD
            });
            let is_better = match (&found, &best) {
                (Ok(found), Ok(best)) => order(found) < order(best),
                (found, best) => found.is_ok() || best.is_err(),
            };
            if is_better && !is_rejected {
                best = found;
            }
            if best.as_ref().is_ok_and(|best| order(best) == (0, 0.0)) {
                break;
            }
        }
        let residual_rad = best.as_ref().map_or(f64::INFINITY, |(_, _, fit)| fit.residual_rad);
        let Some(declared_frame) =
            declared_frame.filter(|_| residual_rad > MAX_ENCODING_RESIDUAL_RAD)
        else {
            return best;
        };
        let right_handed = Axes::all().iter().filter(|axes| !axes.are_left_handed());
        let turned = right_handed.map(|&rotations| {
            let axes = AxesError { rotations, ..declared_frame.axes };
            let interpretation = PositionInterpretation { axes, ..declared_frame };
            (self.simplest_residual_rad(&interpretation), interpretation)
        });
        let rotated = turned.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(rad, _)| {
            *rad <= MAX_ENCODING_RESIDUAL_RAD && rad * MIN_RESIDUAL_RATIO < residual_rad
        });
        let rotated = rotated.and_then(|(_, turned)| self.estimate_encoding(turned).ok());
        rotated.map_or(best, Ok)
    }
}
