//! Initial camera pose in closed form.

use super::series::{HandEyeSetting, PosePair};
use ground::geometry::{
    Pose, Rotation, Vec3, angle_between, rotation_by_wahba, rotation_from_rotvec,
    rotvec_from_rotation,
};
use ground::stats::median;
use ground::stats::thin::thinned;
use nalgebra::{Matrix3, SMatrix, SVector};

const MAX_CLOSED_FORM_POSES: usize = 150;
/// From the thresholds of a hand-eye chain.
const M_PER_RAD: f64 = 2e-3 / (0.2 * std::f64::consts::PI / 180.0);

pub(super) fn combined_rad(length_m: f64, angle_rad: f64) -> f64 {
    (length_m / M_PER_RAD).hypot(angle_rad)
}

/// 0 without values.
pub(super) fn median_of(values: impl Iterator<Item = f64>) -> f64 {
    median(&mut values.collect::<Vec<f64>>()).unwrap_or(0.0)
}

/// Median closure error, rad, with camera and constant, by Park and Martin's solution. `None` if the orientations do
/// not vary. Rotations about a single axis leave several camera rotations; their positions then decide.
pub(super) fn solve_closed_form(setting: &HandEyeSetting, lag_s: f64) -> Option<(f64, [Pose; 2])> {
    let pairs = setting.pairs_at(lag_s, MAX_CLOSED_FORM_POSES);
    let rotations = camera_rotations(&pairs)?;
    let starts = rotations.into_iter().filter_map(|rotation| with_rotation(&pairs, rotation));
    starts.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Uses a single candidate if there is only one axis.
pub(super) fn solve_closed_form_quick(pairs: &[PosePair]) -> Option<(f64, [Pose; 2])> {
    with_rotation(pairs, *camera_rotations(pairs)?.first()?)
}

fn with_rotation(pairs: &[PosePair], rotation: Rotation) -> Option<(f64, [Pose; 2])> {
    let constant = |pair: &PosePair| pair.carrier_pose.rotation * rotation * pair.target.rotation;
    let constants: Vec<Rotation> = pairs.iter().map(constant).collect();
    let constant_rotation = medoid_rotation(&constants)?;
    let translations = fit_positions(pairs, &rotation, 0, &[])?.values;
    let [camera, constant] = [(0, rotation), (3, constant_rotation)].map(|(first, rotation)| {
        Pose::from_parts(translations.fixed_rows::<3>(first).into_owned().into(), rotation)
    });
    let misfits = pairs.iter().map(|pair| misfit(pair, &camera, &constant));
    Some((median_of(misfits), [camera, constant]))
}

fn misfit(pair: &PosePair, camera: &Pose, constant: &Pose) -> f64 {
    let closed = pair.carrier_pose * camera * pair.target;
    let off_m = (closed.translation.vector - constant.translation.vector).norm();
    combined_rad(off_m, angle_between(&closed.rotation, &constant.rotation))
}

/// Rotations of carrier and camera over several time distances.
fn relative_rotations(pairs: &[PosePair]) -> Vec<(Vec3, Vec3)> {
    let n = pairs.len();
    let strides = [n / 2, n / 3, n / 7].map(|stride| stride.max(1));
    let between = |a: &PosePair, b: &PosePair| {
        let carrier_pose = a.carrier_pose.rotation.inverse() * b.carrier_pose.rotation;
        let camera = a.target.rotation * b.target.rotation.inverse();
        (rotvec_from_rotation(&carrier_pose), rotvec_from_rotation(&camera))
    };
    let all = strides.into_iter().flat_map(|stride| {
        (0..n.saturating_sub(stride)).map(move |i| between(&pairs[i], &pairs[i + stride]))
    });
    all.collect()
}

/// Median difference of the rotation angles of carrier and camera, rad, independent of the mount.
pub(super) fn angle_difference(pairs: &[PosePair]) -> f64 {
    median_of(relative_rotations(pairs).iter().map(|(a, b)| (a.norm() - b.norm()).abs()))
}

/// Those with errors of up to about three times the median.
fn inliers<T>(mut items: Vec<T>, error: impl Fn(&T) -> f64) -> Vec<T> {
    let limit = 3.0 * median_of(items.iter().map(&error)) + 1e-9;
    items.retain(|item| error(item) <= limit);
    items
}

/// Maps camera to carrier rotations. Several candidates if there is only one axis.
fn camera_rotations(pairs: &[PosePair]) -> Option<Vec<Rotation>> {
    /// Share of the first eigenvalue; below it there is only one axis.
    const MAX_SECOND_EIGENVALUE_SHARE: f64 = 0.01;
    const AXIS_CANDIDATES: usize = 12;
    /// Share of the largest rotation.
    const MIN_ROTATION_SHARE: f64 = 0.3;
    /// Near half a turn the axis is ambiguous.
    const MAX_ROTATION_RAD: f64 = 2.9;
    let mut turns = relative_rotations(pairs);
    let largest = turns.iter().map(|(a, _)| a.norm()).filter(|&a| a < MAX_ROTATION_RAD);
    let largest = largest.fold(0.0, f64::max);
    turns.retain(|(a, b)| {
        let (a, b) = (a.norm(), b.norm());
        a.min(b) > MIN_ROTATION_SHARE * largest && a.max(b) < MAX_ROTATION_RAD
    });
    let alike = inliers(turns, |(a, b)| (a.norm() - b.norm()).abs());
    if largest < 1e-6 || alike.len() < 3 {
        return None;
    }
    let rotation_of = |turns: &[(Vec3, Vec3)]| {
        rotation_by_wahba(&turns.iter().map(|(a, b)| a * b.transpose()).sum())
    };
    let initial = rotation_of(&alike);
    let near = inliers(alike, |(a, b)| (a - initial * b).norm());
    let rotation = rotation_of(&near);
    let scatter: Matrix3<f64> = near.iter().map(|(a, _)| a * a.transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let first = eigen.eigenvalues.imax();
    let second = (0..3).filter(|&i| i != first).map(|i| eigen.eigenvalues[i]).fold(0.0, f64::max);
    if second > MAX_SECOND_EIGENVALUE_SHARE * eigen.eigenvalues[first] {
        return Some(vec![rotation]);
    }
    let axis: Vec3 = eigen.eigenvectors.column(first).into();
    let turn = |k: usize| axis * (std::f64::consts::TAU * k as f64 / AXIS_CANDIDATES as f64);
    Some((0..AXIS_CANDIDATES).map(|k| rotation_from_rotvec(turn(k)) * rotation).collect())
}

/// Smallest median distance to all others, among a few candidates.
fn medoid_rotation(rotations: &[Rotation]) -> Option<Rotation> {
    const MAX_CANDIDATES: usize = 15;
    let distance =
        |one: &Rotation| median_of(rotations.iter().map(|other| angle_between(one, other)));
    let tried = thinned(rotations, MAX_CANDIDATES).map(|one| (distance(one), *one));
    tried.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, one)| one)
}

/// Columns of the linear fit of positions: camera, constant, and two scale errors of the target's positions.
const POSITION_COLUMNS: usize = 8;
/// Scale error of all coordinates of the target.
pub(super) const SIZE_COLUMN: usize = 6;
/// Additional one of its depth.
pub(super) const DEPTH_COLUMN: usize = 7;
/// Length of three normal components, median in standard deviations.
pub(super) const MEDIAN_NORMAL_LENGTH: f64 = 1.5382;

/// Linear fit of positions for a known camera rotation.
pub(super) struct PositionFit {
    pub values: SVector<f64, POSITION_COLUMNS>,
    /// Inverse of the normal equations.
    pub inverse: SMatrix<f64, POSITION_COLUMNS, POSITION_COLUMNS>,
    /// Median.
    pub residual_m: f64,
}

/// Fits camera and constant with the `scales` (columns) of positions that are free; `along` is the depth axis.
/// Linear in `R_c·t_x − t_y + a·R_c·R_x·t + d·R_c·R_x·t_z·z = −t_c − R_c·R_x·t`, with Cauchy weights.
pub(super) fn fit_positions(
    pairs: &[PosePair],
    rotation: &Rotation,
    along: usize,
    scales: &[usize],
) -> Option<PositionFit> {
    const ROUNDS: usize = 4;
    let [size, depth] =
        [SIZE_COLUMN, DEPTH_COLUMN].map(|column| f64::from(scales.contains(&column)));
    let row = |PosePair { carrier_pose, target }: &PosePair| {
        let base_from_camera = carrier_pose.rotation * rotation;
        let observed = target.translation.vector;
        let deep = base_from_camera * Vec3::ith(along, observed[along]);
        let observed = base_from_camera * observed;
        let mut row = SMatrix::<f64, 3, POSITION_COLUMNS>::zeros();
        row.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(carrier_pose.rotation.to_rotation_matrix().matrix());
        row.fixed_view_mut::<3, 3>(0, 3).copy_from(&-Matrix3::identity());
        row.set_column(SIZE_COLUMN, &(size * observed));
        row.set_column(DEPTH_COLUMN, &(depth * deep));
        (row, -carrier_pose.translation.vector - observed)
    };
    let rows: Vec<_> = pairs.iter().map(row).collect();
    // Keeps camera and constant apart if only their difference is observable, and fixed scales at zero.
    let ridge = SVector::from_fn(|column, _| match column {
        ..SIZE_COLUMN => 1e-9 * rows.len() as f64,
        _ => f64::from(!scales.contains(&column)),
    });
    let mut weights = vec![1.0; rows.len()];
    let mut fit = None;
    for _ in 0..ROUNDS {
        let mut normal = SMatrix::from_diagonal(&ridge);
        let mut right = SVector::zeros();
        for ((row, value), &weight) in rows.iter().zip(&weights) {
            normal += row.tr_mul(row) * weight;
            right += row.tr_mul(value) * weight;
        }
        let inverse = normal.cholesky()?.inverse();
        let values = inverse * right;
        let deviations = rows.iter().map(|(row, value)| (row * values - value).norm());
        let residual_m = median(&mut deviations.clone().collect::<Vec<f64>>())?;
        let scale = (2.0 * residual_m).max(1e-9);
        weights = deviations.map(|deviation| 1.0 / (1.0 + (deviation / scale).powi(2))).collect();
        fit = Some(PositionFit { values, inverse, residual_m });
    }
    fit
}
