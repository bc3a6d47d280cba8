//! Compares positions with FK before rotations are decoded.

use crate::priors::MARKER_PRIOR_M;
use crate::solver::minimize::{LeastSquares, Limits, NormalEquations, minimize};
use ground::geometry::{
    Pose, Rotation, Vec3, mean_vector, pose, rotation_by_wahba, rotation_from_rotvec,
};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector6};

/// Relative to the extent, for positions to match FK.
pub(crate) const MAX_POSITION_RESIDUAL_SHARE: f64 = 0.1;
/// Minimum ratio of the second direction to the first, to determine a rotation.
const MIN_SECOND_SPREAD_SHARE: f64 = 0.02;

/// FK poses at a stream's samples.
pub(crate) struct FkColumns {
    pub xyz: Vec<Vec3>,
    pub rotation: Vec<Rotation>,
}

impl FkColumns {
    /// Columns of `poses`.
    pub fn from_poses(poses: &[Pose]) -> Self {
        let (xyz, rotation) =
            poses.iter().map(|pose| (pose.translation.vector, pose.rotation)).unzip();
        Self { xyz, rotation }
    }

    /// Rms of `xyz − fk − R·t` at the best tool offset `t`.
    pub fn tool_misfit(&self, xyz: &[Vec3]) -> f64 {
        self.misfit_at(xyz, &Pose::identity())
    }

    /// Smallest rms over a tool offset, with or without a rigid reference, in the unit of `xyz`.
    pub fn misfit(&self, xyz: &[Vec3]) -> f64 {
        let plain = self.tool_misfit(xyz);
        self.fit_rigid(xyz)
            .map_or(plain, |(reference, _)| plain.min(self.misfit_at(xyz, &reference)))
    }

    /// Like [`FkColumns::fit_rigid`]. The rotation about collinear positions is arbitrary.
    pub fn fit_rigid_or_collinear(&self, xyz: &[Vec3]) -> (Pose, Vec3) {
        self.fit_rigid(xyz).unwrap_or_else(|| {
            let turn = rotation_by_wahba(&products(&self.xyz, xyz));
            let reference = pose((mean_vector(xyz) - turn * mean_vector(&self.xyz)).into(), turn);
            (reference, self.tool(xyz, &reference))
        })
    }

    /// Reference and tool offset with the smallest misfit, after at most `turns` iterations; 0 fits the
    /// tool only.
    pub fn frames(&self, xyz: &[Vec3], turns: usize) -> (Pose, Vec3) {
        let plain = (Pose::identity(), self.tool(xyz, &Pose::identity()));
        let found = if turns > 0 { self.fit_rigid_iterations(xyz, turns) } else { None };
        match found {
            Some(found) if self.misfit_at(xyz, &found.0) < self.tool_misfit(xyz) => found,
            _ => plain,
        }
    }

    /// Rms of `reference⁻¹·xyz − fk − R·t` at the best `t`.
    fn misfit_at(&self, xyz: &[Vec3], reference: &Pose) -> f64 {
        let tool = self.tool(xyz, reference);
        let residuals = self.offsets(xyz, reference).map(|offset| (offset - tool).norm_squared());
        (residuals.sum::<f64>() / xyz.len().max(1) as f64).sqrt()
    }

    /// Offsets from FK, in the tool frame.
    fn offsets(&self, xyz: &[Vec3], reference: &Pose) -> impl Iterator<Item = Vec3> {
        let to_base = reference.inverse();
        let samples = xyz.iter().zip(self.xyz.iter().zip(&self.rotation));
        samples.map(move |(p, (fk, rotation))| {
            rotation.inverse() * ((to_base * nalgebra::Point3::from(*p)).coords - fk)
        })
    }

    fn tool(&self, xyz: &[Vec3], reference: &Pose) -> Vec3 {
        mean_vector(self.offsets(xyz, reference))
    }

    /// Reference and tool offset with the smallest misfit, from the reference of Kabsch (1976) without a tool.
    /// `None` if positions are collinear.
    pub fn fit_rigid(&self, xyz: &[Vec3]) -> Option<(Pose, Vec3)> {
        self.fit_rigid_iterations(xyz, 30)
    }

    /// The prior on the tool's length is as large as the residual allows: a wrong model would fit with a tool of
    /// several metres.
    fn fit_rigid_iterations(&self, xyz: &[Vec3], steps: usize) -> Option<(Pose, Vec3)> {
        const MIN_GAIN: f64 = 1e-9;
        let start = (rotation_by_wahba(&correlation(&self.xyz, xyz)?), Vec3::zeros());
        let limits = Limits { steps, min_gain: MIN_GAIN };
        let fit = PositionFit { fk: self, xyz };
        let (_, (rotation, tool)) = minimize(&fit, start, limits)?;
        Some((pose(fit.sums(&rotation, &tool).origin.into(), rotation), tool))
    }
}

/// Rotation and tool offset between FK and positions, at the best origin.
struct PositionFit<'a> {
    fk: &'a FkColumns,
    xyz: &'a [Vec3],
}

struct Sums {
    /// `AᵀA` and `Aᵀr` about the mean.
    products: Matrix6<f64>,
    weighted: Vector6<f64>,
    origin: Vec3,
    squares: f64,
}

impl PositionFit<'_> {
    /// Residuals `xyz − rotation·(fk + R·tool) − origin` with their derivatives by a small turn of `rotation` and by
    /// `tool`.
    fn sums(&self, rotation: &Rotation, tool: &Vec3) -> Sums {
        let reference = rotation.to_rotation_matrix();
        let (mut products, mut weighted) = (Matrix6::zeros(), Vector6::zeros());
        let (mut columns, mut sum, mut squares) = (Matrix3x6::zeros(), Vec3::zeros(), 0.0);
        let FkColumns { xyz, rotation } = self.fk;
        for (logged, (fk, rotation)) in self.xyz.iter().zip(xyz.iter().zip(rotation)) {
            let turned = reference * rotation.to_rotation_matrix();
            let point = reference * fk + turned * tool;
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
        Sums {
            products: products - columns.transpose() * columns / n,
            weighted: weighted - columns.transpose() * origin,
            origin,
            squares: squares - n * origin.norm_squared(),
        }
    }
}

impl LeastSquares for PositionFit<'_> {
    type State = (Rotation, Vec3);

    /// The cost is the sum of squares times `1 + |tool|² / (3n·MARKER_PRIOR_M²)`: a prior in units of the residual.
    fn linearize(&self, (rotation, tool): &Self::State) -> Option<NormalEquations> {
        let Sums { products, weighted, squares, .. } = self.sums(rotation, tool);
        let prior = 1.0 / ((3 * self.xyz.len()).max(1) as f64 * MARKER_PRIOR_M.powi(2));
        let factor = 1.0 + prior * tool.norm_squared();
        let (mut matrix, mut right) = (products * factor, weighted * factor);
        for axis in 0..3 {
            matrix[(3 + axis, 3 + axis)] += squares * prior;
            right[3 + axis] -= squares * prior * tool[axis];
        }
        let cost = squares * factor;
        Some(NormalEquations::from_sums(|i, j| matrix[(i, j)], right.iter().copied(), cost))
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
fn products(from: &[Vec3], to: &[Vec3]) -> Matrix3<f64> {
    let (centre, target) = (mean_vector(from), mean_vector(to));
    let both = from.iter().zip(to);
    both.map(|(a, b)| (b - target) * (a - centre).transpose()).sum()
}

/// `None` if collinear.
fn correlation(from: &[Vec3], to: &[Vec3]) -> Option<Matrix3<f64>> {
    let correlation = products(from, to);
    let mut singular: Vec<f64> = correlation.singular_values().iter().copied().collect();
    singular.sort_by(|a, b| b.total_cmp(a));
    (singular[1] > MIN_SECOND_SPREAD_SHARE * MIN_SECOND_SPREAD_SHARE * singular[0])
        .then_some(correlation)
}

/// Rms distance from the mean.
pub(crate) fn spread(points: &[Vec3]) -> f64 {
    let mean = mean_vector(points);
    let squares: f64 = points.iter().map(|p| (p - mean).norm_squared()).sum();
    (squares / points.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{angle_between, rotation_from_rotvec};

    fn arm() -> FkColumns {
        let poses: Vec<Pose> = (0..40)
            .map(|i| {
                let t = f64::from(i) * 0.2;
                let turn = rotation_from_rotvec(Vec3::new(t.sin(), (0.7 * t).cos(), 0.5 * t.cos()));
                pose([0.5 * t.cos(), 0.4 * (1.3 * t).sin(), 0.3 + 0.2 * (0.6 * t).sin()], turn)
            })
            .collect();
        FkColumns::from_poses(&poses)
    }

    #[test]
    fn a_rotated_base_and_a_tool_are_separated_by_positions() {
        let arm = arm();
        let reference = pose([0.2, -0.1, 0.4], rotation_from_rotvec(Vec3::new(0.0, 0.0, 3.1)));
        let tool = Vec3::new(0.02, 0.0, 0.14);
        let samples = arm.xyz.iter().zip(&arm.rotation);
        let xyz: Vec<Vec3> = samples
            .map(|(fk, r)| (reference * nalgebra::Point3::from(fk + r * tool)).coords)
            .collect();
        let (found, offset) = arm.fit_rigid(&xyz).expect("a reference");
        assert!(angle_between(&found.rotation, &reference.rotation) < 1e-6);
        assert!((found.translation.vector - reference.translation.vector).norm() < 1e-6);
        assert!((offset - tool).norm() < 1e-6);
        assert!(arm.misfit(&xyz) < 1e-6);
    }

    /// The height of the tool and of the reference are then one unknown.
    #[test]
    fn a_hand_that_turns_about_one_axis_still_fits_and_needs_no_long_tool() {
        let arm = arm();
        let vertical = |k: usize| rotation_from_rotvec(Vec3::new(0.0, 0.0, 0.1 * k as f64));
        let rotation: Vec<Rotation> = (0..arm.xyz.len()).map(vertical).collect();
        let arm = FkColumns { rotation, ..arm };
        let tool = Vec3::new(0.06, -0.03, 0.2);
        let both = arm.xyz.iter().zip(&arm.rotation);
        let xyz: Vec<Vec3> = both.map(|(fk, rotation)| fk + rotation * tool).collect();
        let (_, found) = arm.fit_rigid(&xyz).expect("a reference");
        assert!((found - tool).xy().norm() < 1e-6, "{found}");
        assert!(found.z.abs() < 0.5, "{found}");
        assert!(arm.misfit(&xyz) < 1e-6);
    }

    #[test]
    fn positions_of_another_arm_have_no_reference() {
        let arm = arm();
        let xyz: Vec<Vec3> = arm.xyz.iter().map(|p| Vec3::new(p.y * p.y, p.z, p.x.abs())).collect();
        assert!(arm.misfit(&xyz) > MAX_POSITION_RESIDUAL_SHARE * spread(&arm.xyz));
    }
}
