//! Compares positions with FK before rotations are decoded.

use crate::priors::MARKER_PRIOR_M;
use crate::solver::linear::Normal;
use crate::solver::minimize::{LeastSquares, Limits, minimize};
use ground::geometry::{
    Pose, Rotation, Vec3, mean_vector, pose, rotation_by_wahba, rotation_from_rotvec,
};
use ground::stats::mean;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x6, Matrix6, Vector6};
use std::borrow::Borrow;

/// Relative to the extent, for positions to match FK.
pub(crate) const MAX_POSITION_RESIDUAL_SHARE: f64 = 0.1;
/// Minimum ratio of the second direction to the first, to determine a rotation.
const MIN_SECOND_SPREAD_SHARE: f64 = 0.02;

/// Positions of a stream, and FK at its samples.
#[derive(Clone, Copy)]
pub(crate) struct PositionFit<'a> {
    pub fk: &'a [Pose],
    pub xyz: &'a [Vec3],
}

impl PositionFit<'_> {
    /// Rms of `xyz − fk − R·t` at the best tool offset `t`.
    pub fn tool_misfit(self) -> f64 {
        self.misfit_at(&Pose::identity())
    }

    /// Smallest rms over a tool offset, with or without a rigid reference, in the unit of `xyz`.
    pub fn misfit(self) -> f64 {
        let plain = self.tool_misfit();
        self.fit_rigid().map_or(plain, |(reference, _)| plain.min(self.misfit_at(&reference)))
    }

    /// Like [`PositionFit::fit_rigid`]. The rotation about collinear positions is arbitrary.
    pub fn fit_rigid_or_collinear(self) -> (Pose, Vec3) {
        self.fit_rigid().unwrap_or_else(|| {
            let fk = self.fk_positions();
            let turn = rotation_by_wahba(&products(&fk, self.xyz));
            let reference = pose((mean_vector(self.xyz) - turn * mean_vector(&fk)).into(), turn);
            (reference, self.tool(&reference))
        })
    }

    /// Reference and tool offset with the smallest misfit, after at most `turns` iterations; 0 fits the
    /// tool only.
    pub fn frames(self, turns: usize) -> (Pose, Vec3) {
        let found = if turns > 0 { self.fit_rigid_iterations(turns) } else { None };
        found
            .filter(|(reference, _)| self.misfit_at(reference) < self.tool_misfit())
            .unwrap_or_else(|| (Pose::identity(), self.tool(&Pose::identity())))
    }

    fn fk_positions(self) -> Vec<Vec3> {
        self.fk.iter().map(|fk| fk.translation.vector).collect()
    }

    /// Rms of `reference⁻¹·xyz − fk − R·t` at the best `t`.
    fn misfit_at(self, reference: &Pose) -> f64 {
        let tool = self.tool(reference);
        mean(self.offsets(reference).map(|offset| (offset - tool).norm_squared())).sqrt()
    }

    /// Offsets from FK, in the tool frame.
    fn offsets(&self, reference: &Pose) -> impl Iterator<Item = Vec3> {
        let to_base = reference.inverse();
        self.fk.iter().zip(self.xyz).map(move |(fk, xyz)| {
            let in_base = (to_base * nalgebra::Point3::from(*xyz)).coords;
            fk.rotation.inverse() * (in_base - fk.translation.vector)
        })
    }

    fn tool(self, reference: &Pose) -> Vec3 {
        mean_vector(self.offsets(reference))
    }

    /// Reference and tool offset with the smallest misfit, from the reference of Kabsch (1976) without a tool.
    /// `None` if positions are collinear.
    pub fn fit_rigid(self) -> Option<(Pose, Vec3)> {
        self.fit_rigid_iterations(30)
    }

    /// The prior on the tool's length is as large as the residual allows: a wrong model would fit with a tool of
    /// several metres.
    fn fit_rigid_iterations(self, steps: usize) -> Option<(Pose, Vec3)> {
        const MIN_GAIN: f64 = 1e-9;
        let correlation = correlation(&self.fk_positions(), self.xyz)?;
        let start = (rotation_by_wahba(&correlation), Vec3::zeros());
        let limits = Limits { steps, min_gain: MIN_GAIN };
        let (_, (rotation, tool)) = minimize(&self, start, limits)?;
        let (_, origin) = self.equations(&rotation, &tool);
        Some((pose(origin.into(), rotation), tool))
    }

    /// Equations of a small turn of `rotation` and of `tool`, for residuals `xyz − rotation·(fk + R·tool) − origin`, and the
    /// best origin.
    fn equations(self, rotation: &Rotation, tool: &Vec3) -> (Normal, Vec3) {
        let reference = rotation.to_rotation_matrix();
        let (mut products, mut weighted) = (Matrix6::zeros(), Vector6::zeros());
        let (mut columns, mut sum, mut squares) = (Matrix3x6::zeros(), Vec3::zeros(), 0.0);
        for (logged, fk) in self.xyz.iter().zip(self.fk) {
            let turned = reference * fk.rotation.to_rotation_matrix();
            let point = reference * fk.translation.vector + turned * tool;
            let mut own = Matrix3x6::zeros();
            own.fixed_view_mut::<3, 3>(0, 0).copy_from(&-point.cross_matrix());
            own.fixed_view_mut::<3, 3>(0, 3).copy_from(turned.matrix());
            let residual = logged - point;
            products += own.transpose() * own;
            weighted += own.transpose() * residual;
            columns += own;
            sum += residual;
            squares += residual.norm_squared();
        }
        let n = self.xyz.len().max(1) as f64;
        let origin = sum / n;
        let matrix = products - columns.transpose() * columns / n;
        let right = weighted - columns.transpose() * origin;
        let normal = Normal {
            matrix: DMatrix::from_column_slice(6, 6, matrix.as_slice()),
            right: DVector::from_column_slice(right.as_slice()),
            cost: squares - n * origin.norm_squared(),
            independent: 0.0,
        };
        (normal, origin)
    }
}

impl LeastSquares for PositionFit<'_> {
    type State = (Rotation, Vec3);

    /// The cost is the sum of squares times `1 + |tool|² / (3n·MARKER_PRIOR_M²)`: a prior in units of the residual.
    fn linearize(&self, (rotation, tool): &Self::State) -> Option<Normal> {
        let (mut normal, _) = self.equations(rotation, tool);
        let squares = normal.cost;
        let prior = 1.0 / ((3 * self.xyz.len()).max(1) as f64 * MARKER_PRIOR_M.powi(2));
        let factor = 1.0 + prior * tool.norm_squared();
        normal.matrix *= factor;
        normal.right *= factor;
        normal.cost *= factor;
        for axis in 0..3 {
            normal.matrix[(3 + axis, 3 + axis)] += squares * prior;
            normal.right[3 + axis] -= squares * prior * tool[axis];
        }
        Some(normal)
    }

    fn moved(&self, (rotation, tool): &Self::State, step: &[f64]) -> Self::State {
        let part = |first: usize| Vec3::new(step[first], step[first + 1], step[first + 2]);
        (rotation_from_rotvec(part(0)) * rotation, tool + part(3))
    }
}

/// Best rotation about the means, with a reflection if `sign` is −1. `None` if collinear.
pub(crate) fn rigid_rotation(from: &[Vec3], to: &[Vec3], sign: f64) -> Option<Matrix3<f64>> {
    let correlation = correlation(from, to)?;
    // A reflection through the origin commutes with rotations.
    let turn = rotation_by_wahba(&(correlation * sign)).to_rotation_matrix();
    Some(turn.matrix() * sign)
}

/// `Σ to·fromᵀ` about the means.
pub(crate) fn products(from: &[Vec3], to: &[Vec3]) -> Matrix3<f64> {
    let (centre, target) = (mean_vector(from), mean_vector(to));
    let both = from.iter().zip(to);
    both.map(|(a, b)| (b - target) * (a - centre).transpose()).sum()
}

/// `None` if collinear.
fn correlation(from: &[Vec3], to: &[Vec3]) -> Option<Matrix3<f64>> {
    let correlation = products(from, to);
    // In descending order.
    let singular = correlation.singular_values();
    (singular[1] > MIN_SECOND_SPREAD_SHARE * MIN_SECOND_SPREAD_SHARE * singular[0])
        .then_some(correlation)
}

/// Rms distance from the mean.
pub(crate) fn spread(points: impl IntoIterator<Item = impl Borrow<Vec3>> + Clone) -> f64 {
    let centre = mean_vector(points.clone());
    mean(points.into_iter().map(|point| (point.borrow() - centre).norm_squared())).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{angle_between, rotation_from_rotvec};

    fn arm() -> Vec<Pose> {
        (0..40)
            .map(|i| {
                let t = f64::from(i) * 0.2;
                let turn = rotation_from_rotvec(Vec3::new(t.sin(), (0.7 * t).cos(), 0.5 * t.cos()));
                pose([0.5 * t.cos(), 0.4 * (1.3 * t).sin(), 0.3 + 0.2 * (0.6 * t).sin()], turn)
            })
            .collect()
    }

    #[test]
    fn a_rotated_base_and_a_tool_are_separated_by_positions() {
        let arm = arm();
        let reference = pose([0.2, -0.1, 0.4], rotation_from_rotvec(Vec3::new(0.0, 0.0, 3.1)));
        let tool = Vec3::new(0.02, 0.0, 0.14);
        let point = |fk: &Pose| (reference * fk * nalgebra::Point3::from(tool)).coords;
        let xyz: Vec<Vec3> = arm.iter().map(point).collect();
        let fit = PositionFit { fk: &arm, xyz: &xyz };
        let (found, offset) = fit.fit_rigid().expect("a reference");
        assert!(angle_between(&found.rotation, &reference.rotation) < 1e-6);
        assert!((found.translation.vector - reference.translation.vector).norm() < 1e-6);
        assert!((offset - tool).norm() < 1e-6);
        assert!(fit.misfit() < 1e-6);
    }

    /// The height of the tool and of the reference are then one unknown.
    #[test]
    fn a_hand_that_turns_about_one_axis_still_fits_and_needs_no_long_tool() {
        let mut arm = arm();
        for (k, fk) in arm.iter_mut().enumerate() {
            fk.rotation = rotation_from_rotvec(Vec3::new(0.0, 0.0, 0.1 * k as f64));
        }
        let tool = Vec3::new(0.06, -0.03, 0.2);
        let xyz: Vec<Vec3> =
            arm.iter().map(|fk| fk.translation.vector + fk.rotation * tool).collect();
        let fit = PositionFit { fk: &arm, xyz: &xyz };
        let (_, found) = fit.fit_rigid().expect("a reference");
        assert!((found - tool).xy().norm() < 1e-6, "{found}");
        assert!(found.z.abs() < 0.5, "{found}");
        assert!(fit.misfit() < 1e-6);
    }

    #[test]
    fn positions_of_another_arm_have_no_reference() {
        let arm = arm();
        let at: Vec<Vec3> = arm.iter().map(|fk| fk.translation.vector).collect();
        let xyz: Vec<Vec3> = at.iter().map(|p| Vec3::new(p.y * p.y, p.z, p.x.abs())).collect();
        let fit = PositionFit { fk: &arm, xyz: &xyz };
        assert!(fit.misfit() > MAX_POSITION_RESIDUAL_SHARE * spread(&at));
    }
}
