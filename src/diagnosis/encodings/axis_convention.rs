//! Unit, axis convention and inversion of a stream, from positions only. They do not depend on the rotation
//! encoding.
//!
//! `logged = turn · (s · (fk + R·tool)) + shift`, with FK's poses or their inverses. This is linear for
//! each of the 48 axis conventions, so all are tested. If the frame's rotation is free, it is fitted
//! alternately with the rest. The simplest of the best solutions comes first.

use crate::distinct::distinct;
use crate::frames::position_fit::{rigid_rotation, spread};
use ground::geometry::{Axes, LengthScale, Pose, Vec3};
use nalgebra::{Matrix3, SMatrix, SVector};

/// As a fraction of the arm's reach.
const MIN_MOTION_SHARE: f64 = 0.01;
/// Below this fraction of the extent, positions as logged are accepted without other tests.
const MAX_LOGGED_RESIDUAL_SHARE: f64 = 0.003;
/// Two solutions are equivalent if their residuals are within this factor.
const MAX_EQUIVALENT_RATIO: f64 = 5.0;
/// They are also equivalent if the residual is at most this fraction of the extent.
const MAX_EQUIVALENT_RESIDUAL_SHARE: f64 = 0.002;
/// For a unit, mirroring or inverse, as a fraction of the extent.
const MAX_RESIDUAL_SHARE: f64 = 0.15;
/// Limits for an unusual unit: residual as a fraction of the extent, and the usual units' residual divided
/// by its own. Strict, because a free scale absorbs part of any other error.
const MAX_UNUSUAL_RESIDUAL_SHARE: f64 = 0.003;
const MIN_UNUSUAL_RATIO: f64 = 30.0;
/// Maximum motion of a marker relative to the tip: 0.3 m from a tip that rotates by 1 rad and moves by 0.1
/// m.
const MAX_MARKER_MOTION_RATIO: f64 = 4.0;
/// Scales (or inverses) closer to 1 are radial scale, not units.
const MIN_UNIT_SCALE: f64 = 1.25;
/// Relative tolerance to identify a usual unit, or the residual if larger.
const UNIT_TOLERANCE: f64 = 0.02;
const MAX_TOOL_M: f64 = 1.5;
/// Of inverse poses in the declared frames.
const INVERSE_RANK: u32 = 4;
const MAX_BASE_DISTANCE_M: f64 = 20.0;

#[derive(Clone, Debug)]
pub(crate) struct PositionEncoding {
    /// Unit of the track's numbers, m.
    pub metres: f64,
    /// Whether the poses are inverted.
    pub is_inverted: bool,
    /// `None` if the rotation of the frame is free.
    pub axes: Option<Axes>,
    /// Maps base directions to logged ones. A rotation, possibly with mirroring.
    pub turn: Matrix3<f64>,
    /// Position residual, rms m.
    pub residual_m: f64,
    /// Whether the residual is small relative to the motion.
    pub is_explained: bool,
    rank: u32,
}

impl PositionEncoding {
    /// Whether the logged axes are left-handed.
    pub fn is_mirrored(&self) -> bool {
        self.turn.determinant() < 0.0
    }

    /// Whether only frames differ from the standard encoding.
    pub fn is_standard(&self) -> bool {
        self.metres == 1.0 && !self.is_inverted && !self.is_mirrored()
    }

    fn is_same(&self, other: &Self) -> bool {
        let kind = |layout: &Self| (layout.is_inverted, layout.axes, layout.is_mirrored());
        self.metres == other.metres && kind(self) == kind(other)
    }
}

pub(crate) struct StreamPositions<'a> {
    pub xyz: &'a [Vec3],
    /// Index of a constant coordinate to ignore.
    pub constant: Option<usize>,
    /// Unit assumed when reading the track, m.
    pub read_as_m: f64,
    /// Whether the frame is fixed relative to the base.
    pub reference_known: bool,
}

/// Whether a marker's extent is plausible for a tip with extent `by_fk`.
pub(crate) fn is_plausible_extent(extent: f64, by_fk: f64) -> bool {
    (extent / by_fk).ln().abs() < MAX_MARKER_MOTION_RATIO.ln()
}

/// Encodings with about the smallest residual, simplest first. Empty if the tip moves too little. If it only rotates, the
/// positions of inverse poses still move.
pub(crate) fn candidate_encodings(
    fk: &[Pose],
    reach_m: f64,
    written: &StreamPositions,
) -> Vec<PositionEncoding> {
    let inverse: Vec<Pose> = fk.iter().map(Pose::inverse).collect();
    let as_logged = EncodingSearch::new(fk, written, false);
    let inverted = EncodingSearch::new(&inverse, written, true);
    let moves = |search: &EncodingSearch| search.extent_m >= MIN_MOTION_SHARE * reach_m;
    if fk.len() < 6 || !(moves(&as_logged) || moves(&inverted)) {
        return Vec::new();
    }
    let extent_m = as_logged.extent_m;
    let mut found = as_logged.candidates(1.0, false);
    let least = |found: &[PositionEncoding], is: fn(&PositionEncoding) -> bool| {
        found.iter().filter(|one| is(one)).map(|one| one.residual_m).fold(f64::INFINITY, f64::min)
    };
    let sound_m = least(&found, PositionEncoding::is_standard);
    // Without a rotated frame, which fits any planar motion as well.
    let unrotated_m = least(&found, |one| one.is_standard() && one.rank <= INVERSE_RANK);
    if unrotated_m > MAX_LOGGED_RESIDUAL_SHARE * extent_m {
        for search in [&as_logged, &inverted].into_iter().filter(|search| moves(search)) {
            for metres in std::iter::once(1.0).chain(search.units()) {
                found.extend(search.candidates(metres, true));
            }
        }
        let is_odd = |one: &PositionEncoding| {
            LengthScale::common()
                .all(|unit| (one.metres * written.read_as_m / unit.in_m() - 1.0).abs() > 1e-6)
        };
        let usual = found.iter().filter(|one| !is_odd(one)).map(|one| one.residual_m);
        let usual_m = usual.fold(f64::INFINITY, f64::min);
        found.retain(|one| {
            let explains = match is_odd(one) {
                true => {
                    one.residual_m <= MAX_UNUSUAL_RESIDUAL_SHARE * extent_m
                        && MIN_UNUSUAL_RATIO * one.residual_m <= usual_m
                }
                false => {
                    let is_plain_inverse = one.is_inverted && one.rank == INVERSE_RANK;
                    let other_m = if is_plain_inverse { unrotated_m } else { sound_m };
                    one.is_explained && MAX_EQUIVALENT_RATIO * one.residual_m <= other_m
                }
            };
            one.is_standard() || explains
        });
    } else {
        found.retain(PositionEncoding::is_standard);
    }
    let near = (MAX_EQUIVALENT_RATIO * least(&found, |_| true))
        .max(MAX_EQUIVALENT_RESIDUAL_SHARE * extent_m);
    found.retain(|one| one.residual_m <= near);
    if !moves(&as_logged) && !found.iter().any(|one| one.is_inverted) {
        return Vec::new();
    }
    found.sort_by(|a, b| a.rank.cmp(&b.rank).then(a.residual_m.total_cmp(&b.residual_m)));
    distinct(found, PositionEncoding::is_same)
}

struct EncodingSearch<'a> {
    fk: &'a [Pose],
    positions: &'a StreamPositions<'a>,
    is_inverted: bool,
    /// m.
    extent_m: f64,
    /// Of each base axis.
    sums: [AxisSums; 3],
    /// Products of the logged coordinates with each other.
    logged_products: Matrix3<f64>,
}

/// Products of the derivatives of one base coordinate by scale (0), tool (1–3) and shift (4–6).
struct AxisSums {
    with_each_other: SMatrix<f64, 7, 7>,
    with_logged: SMatrix<f64, 7, 3>,
}

struct EncodingSolution {
    scale: f64,
    /// In the stream's unit.
    tool: Vec3,
    residual_m: f64,
}

#[derive(Clone, Copy)]
struct FreeOffsets {
    tool: bool,
    shift: bool,
}

impl FreeOffsets {
    const SHIFT: Self = Self { tool: false, shift: true };
    const BOTH: Self = Self { tool: true, shift: true };
    const ALL: [Self; 4] = [
        Self { tool: false, shift: false },
        Self { tool: true, shift: false },
        Self::SHIFT,
        Self::BOTH,
    ];
}

impl<'a> EncodingSearch<'a> {
    fn new(fk: &'a [Pose], positions: &'a StreamPositions<'a>, is_inverted: bool) -> Self {
        let extent_m = spread(fk.iter().map(|pose| pose.translation.vector));
        let sums = [0, 1, 2].map(|axis| AxisSums::new(fk, positions.xyz, axis));
        let logged_products = positions.xyz.iter().map(|xyz| xyz * xyz.transpose()).sum();
        Self { fk, positions, is_inverted, extent_m, sums, logged_products }
    }

    /// Includes left-handed axes only if `any`.
    fn candidates(&self, metres: f64, any: bool) -> Vec<PositionEncoding> {
        let StreamPositions { constant, reference_known, .. } = *self.positions;
        let scale = Some(metres.recip());
        let mut found = Vec::new();
        for is_left_handed in [false, true].into_iter().filter(|is| any || !is) {
            let mut starts: Vec<(f64, Matrix3<f64>)> = Vec::new();
            for axes in axes_of_hand(is_left_handed) {
                let turn = axes_matrix(axes);
                for free in FreeOffsets::ALL {
                    let Some(solved) = self.solve(&turn, scale, free) else { continue };
                    if reference_known || constant.is_some() {
                        found.push(self.encoding(metres, Some(axes), turn, &solved, free));
                    }
                    if free.tool && free.shift && constant.is_none() {
                        starts.push((solved.residual_m, turn));
                    }
                }
            }
            starts.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, start) in starts.iter().take(2) {
                for free in [FreeOffsets::SHIFT, FreeOffsets::BOTH] {
                    let rotated = self.best_rotation(*start, scale, free);
                    found.extend(
                        rotated.map(|(turn, it)| self.encoding(metres, None, turn, &it, free)),
                    );
                }
            }
        }
        found
    }

    fn encoding(
        &self,
        metres: f64,
        axes: Option<Axes>,
        turn: Matrix3<f64>,
        solved: &EncodingSolution,
        free: FreeOffsets,
    ) -> PositionEncoding {
        let (is_inverted, residual_m) = (self.is_inverted, solved.residual_m);
        let known = self.positions.reference_known;
        let is_mirrored = turn.determinant() < 0.0;
        let rank = [
            (metres != 1.0, 4),
            (is_inverted, INVERSE_RANK),
            (is_mirrored, 5),
            (!is_mirrored && axes.is_some_and(|axes| axes != Axes::STANDARD), 4),
            (axes.is_none() && known, 6),
            (free.tool, 2),
            (free.shift && known, 2),
        ];
        let rank = rank.iter().filter(|(is, _)| *is).map(|(_, rank)| rank).sum();
        let is_explained = residual_m <= MAX_RESIDUAL_SHARE * self.extent_m;
        PositionEncoding { metres, is_inverted, axes, turn, residual_m, is_explained, rank }
    }

    /// Candidate units, in metres per number: usual units for which the extents agree, one fitted to the
    /// arm, and one fitted to its mirror image.
    fn units(&self) -> Vec<f64> {
        let StreamPositions { xyz, constant, read_as_m, .. } = *self.positions;
        let ratio = spread(xyz) / self.extent_m;
        let may_be = |metres: &f64| {
            !is_plausible_extent(ratio, 1.0) && is_plausible_extent(ratio * metres, 1.0)
        };
        let usual = LengthScale::common().map(|unit| unit.in_m() / read_as_m);
        let mut units: Vec<f64> = usual.filter(|metres| *metres != 1.0).filter(may_be).collect();
        for is_left_handed in [false, true] {
            let mut solutions: Vec<EncodingSolution> = Vec::new();
            for free in [FreeOffsets::SHIFT, FreeOffsets::BOTH] {
                let fits = axes_of_hand(is_left_handed).filter_map(|axes| {
                    let turn = axes_matrix(axes);
                    Some((turn, self.solve(&turn, None, free)?))
                });
                let fits: Vec<(Matrix3<f64>, EncodingSolution)> = fits.collect();
                let nearest = fits.iter().min_by(|a, b| a.1.residual_m.total_cmp(&b.1.residual_m));
                let start = nearest.map(|(turn, _)| *turn).filter(|_| constant.is_none());
                solutions.extend(fits.into_iter().map(|(_, solved)| solved));
                let rotated = start.and_then(|start| self.best_rotation(start, None, free));
                solutions.extend(rotated.map(|(_, solved)| solved));
            }
            // Prefer the fits without a tool, which can hide the scale of a motion about a point.
            let best = solutions.into_iter().reduce(|best, other| {
                if other.residual_m < 0.5 * best.residual_m { other } else { best }
            });
            let max_m = MAX_RESIDUAL_SHARE * self.extent_m;
            let Some(best) = best.filter(|best| best.residual_m <= max_m) else { continue };
            let metres = best.scale.recip() * read_as_m;
            let tolerance = (2.0 * best.residual_m / self.extent_m).clamp(UNIT_TOLERANCE, 0.1);
            let off = |unit: &LengthScale| (metres / unit.in_m() - 1.0).abs();
            let usual = LengthScale::common()
                .filter(|unit| off(unit) <= tolerance)
                .min_by(|a, b| off(a).total_cmp(&off(b)));
            let factor = usual.map_or(best.scale.recip(), |unit| unit.in_m() / read_as_m);
            let is_unit = !(MIN_UNIT_SCALE.recip()..MIN_UNIT_SCALE).contains(&factor);
            if is_unit && !units.contains(&factor) {
                units.push(factor);
            }
        }
        units
    }

    /// Solution for axes turned by `turn` against the base, without the constant coordinate. `None` if it is implausible.
    fn solve(
        &self,
        turn: &Matrix3<f64>,
        scale: Option<f64>,
        free: FreeOffsets,
    ) -> Option<EncodingSolution> {
        let skipped = self.positions.constant.map(|axis| turn.row(axis).transpose().iamax());
        let (mut normal, mut right) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        let mut square = 0.0;
        for (axis, sums) in self.sums.iter().enumerate().filter(|(axis, _)| Some(*axis) != skipped)
        {
            let along = turn.column(axis);
            normal += sums.with_each_other;
            right += sums.with_logged * along;
            square += along.dot(&(self.logged_products * along));
        }
        let is_free = SVector::<f64, 7>::from_fn(|column, _| {
            f64::from(match column {
                0 => scale.is_none(),
                1..4 => free.tool,
                _ => free.shift,
            })
        });
        let known = scale.unwrap_or(0.0);
        square += known * known * normal[(0, 0)] - 2.0 * known * right[0];
        let rhs = (right - known * normal.column(0)).component_mul(&is_free);
        let matrix = normal.component_mul(&(is_free * is_free.transpose()));
        let samples = self.fk.len() as f64;
        // Keeps an unobservable tool and parameters that are not free at zero.
        let ridge = SVector::<f64, 7>::from_fn(|at, _| match at {
            _ if is_free[at] == 0.0 => 1.0,
            0 => 0.0,
            _ => 1e-6 * samples,
        });
        let found = (matrix + SMatrix::from_diagonal(&ridge)).cholesky()?.solve(&rhs);
        let residual_square = square - 2.0 * found.dot(&rhs) + found.dot(&(matrix * found));
        let scale = scale.unwrap_or(found[0]);
        if scale <= 0.0 {
            return None;
        }
        let tool = found.fixed_rows::<3>(1).into_owned();
        let longest_m = if self.is_inverted { MAX_BASE_DISTANCE_M } else { MAX_TOOL_M };
        let residual_m = (residual_square.max(0.0) / samples).sqrt() / scale;
        (tool.norm() <= longest_m * scale).then_some(EncodingSolution { scale, tool, residual_m })
    }

    /// Alternates between the rotation and the rest, with the scale if it is not given.
    fn best_rotation(
        &self,
        start: Matrix3<f64>,
        scale: Option<f64>,
        free: FreeOffsets,
    ) -> Option<(Matrix3<f64>, EncodingSolution)> {
        const MAX_ROUNDS: usize = 60;
        const MIN_RELATIVE_IMPROVEMENT: f64 = 1e-4;
        let (mut turn, mut last) = (start, f64::INFINITY);
        for round in 0..=MAX_ROUNDS {
            let solved = self.solve(&turn, scale, free)?;
            let max_m = (1.0 - MIN_RELATIVE_IMPROVEMENT) * last;
            if round == MAX_ROUNDS || solved.residual_m > max_m {
                return Some((turn, solved));
            }
            last = solved.residual_m;
            let of = |fk: &Pose| solved.scale * fk.translation.vector + fk.rotation * solved.tool;
            let points: Vec<Vec3> = self.fk.iter().map(of).collect();
            turn = rigid_rotation(&points, self.positions.xyz, start.determinant().signum())?;
        }
        None
    }
}

impl AxisSums {
    fn new(fk: &[Pose], logged: &[Vec3], axis: usize) -> Self {
        let mut sums = Self { with_each_other: SMatrix::zeros(), with_logged: SMatrix::zeros() };
        for (pose, logged) in fk.iter().zip(logged) {
            let rotation = pose.rotation.to_rotation_matrix();
            let mut design = SVector::<f64, 7>::zeros();
            design[0] = pose.translation.vector[axis];
            design.fixed_rows_mut::<3>(1).tr_copy_from(&rotation.matrix().row(axis));
            design[4 + axis] = 1.0;
            sums.with_each_other.ger(1.0, &design, &design, 1.0);
            sums.with_logged.ger(1.0, &design, logged, 1.0);
        }
        sums
    }
}

fn axes_of_hand(is_left_handed: bool) -> impl Iterator<Item = Axes> {
    Axes::all().iter().copied().filter(move |axes| axes.are_left_handed() == is_left_handed)
}

/// Matrix from base directions to `axes`.
pub(crate) fn axes_matrix(axes: Axes) -> Matrix3<f64> {
    let columns = [Vec3::x(), Vec3::y(), Vec3::z()].map(|unit| axes.convert_from_standard(unit));
    Matrix3::from_columns(&columns)
}

#[cfg(test)]
mod tests;
