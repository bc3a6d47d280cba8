//! ATE and RPE of two trajectories, as evo computes them (Grupp, "evo", `evo_ape` and `evo_rpe`).
//!
//! Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012: with reference poses `Qᵢ`
//! and estimates `Pᵢ`, the absolute error is `Qᵢ⁻¹·S·Pᵢ` and the relative error over a frame is
//! `(Qᵢ⁻¹·Qᵢ₊₁)⁻¹·(Pᵢ⁻¹·Pᵢ₊₁)`.

use crate::frames::position_fit::products;
use ground::geometry::{Pose, Rotation, Vec3, angle_between, mean_vector, pose, rotation_by_wahba};
use ground::stats::mean;
use ground::time::NANOS_PER_SECOND;

/// evo's default of the difference between associated stamps, s.
pub const MAX_STAMP_DIFFERENCE_S: f64 = 0.01;

/// Root mean square of the errors of two trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryError {
    /// m.
    pub translation_rmse_m: f64,
    /// Of the rotation angle, rad.
    pub rotation_rmse_rad: f64,
}

impl TrajectoryError {
    /// `None` without errors.
    fn from_poses(errors: impl Iterator<Item = Pose>) -> Option<Self> {
        let square = |error: Pose| {
            let angle_rad = angle_between(&Rotation::identity(), &error.rotation);
            (error.translation.vector.norm_squared(), angle_rad.powi(2))
        };
        let (squares_m2, squares_rad2): (Vec<f64>, Vec<f64>) = errors.map(square).unzip();
        (!squares_m2.is_empty()).then(|| Self {
            translation_rmse_m: mean(squares_m2).sqrt(),
            rotation_rmse_rad: mean(squares_rad2).sqrt(),
        })
    }
}

/// ATE of associated poses, as `evo_ape` without alignment. `None` without poses.
pub fn absolute_trajectory_error(reference: &[Pose], estimate: &[Pose]) -> Option<TrajectoryError> {
    let pairs = reference.iter().zip(estimate);
    TrajectoryError::from_poses(pairs.map(|(reference, estimate)| reference.inverse() * estimate))
}

/// ATE after [`rigid_alignment`], as `evo_ape --align`. `None` if the alignment is not determined.
pub fn aligned_trajectory_error(reference: &[Pose], estimate: &[Pose]) -> Option<TrajectoryError> {
    let alignment = rigid_alignment(reference, estimate)?;
    let aligned: Vec<Pose> = estimate.iter().map(|estimate| alignment * estimate).collect();
    absolute_trajectory_error(reference, &aligned)
}

/// RPE of consecutive associated poses, as `evo_rpe` by default. `None` with fewer than two.
pub fn relative_pose_error(reference: &[Pose], estimate: &[Pose]) -> Option<TrajectoryError> {
    let step = |pair: &[Pose]| pair[0].inverse() * pair[1];
    let pairs = reference.windows(2).zip(estimate.windows(2));
    let errors = pairs.map(|(reference, estimate)| step(reference).inverse() * step(estimate));
    TrajectoryError::from_poses(errors)
}

/// Transform `reference_from_estimate` that minimizes the squared distances of associated positions, without
/// scale (Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE
/// PAMI 1991, eq. 34 to 43). `None` if the positions are on a line or not finite.
pub fn rigid_alignment(reference: &[Pose], estimate: &[Pose]) -> Option<Pose> {
    let positions =
        |poses: &[Pose]| poses.iter().map(|pose| pose.translation.vector).collect::<Vec<Vec3>>();
    let count = reference.len().min(estimate.len());
    let (reference, estimate) = (positions(&reference[..count]), positions(&estimate[..count]));
    let covariance = products(&estimate, &reference) / count as f64;
    if !covariance.iter().all(|value| value.is_finite()) {
        return None;
    }
    // The rotation needs two directions; evo compares with the same limit.
    let singular_values = covariance.singular_values();
    if singular_values.iter().filter(|value| **value > f64::EPSILON).count() < 2 {
        return None;
    }
    let rotation = rotation_by_wahba(&covariance);
    let translation = mean_vector(&reference) - rotation * mean_vector(&estimate);
    Some(pose(translation.into(), rotation))
}

/// Indices of associated poses, as evo's `sync.associate_trajectories`: for each stamp of the shorter
/// trajectory the nearest of the other, if they differ by at most `max_difference_s`. Stamps in ns, ascending;
/// differences are rounded as in evo, which has seconds.
pub fn associate_stamps(
    reference_ns: &[i64],
    estimate_ns: &[i64],
    max_difference_s: f64,
) -> Vec<(usize, usize)> {
    let seconds = |stamps: &[i64]| stamps.iter().map(|stamp| seconds(*stamp)).collect::<Vec<_>>();
    let (reference_s, estimate_s) = (seconds(reference_ns), seconds(estimate_ns));
    match estimate_s.len() > reference_s.len() {
        true => nearest_stamps(&reference_s, &estimate_s, max_difference_s).collect(),
        false => {
            let pairs = nearest_stamps(&estimate_s, &reference_s, max_difference_s);
            pairs.map(|(estimate, reference)| (reference, estimate)).collect()
        }
    }
}

/// The number that a parser of the decimal stamp returns.
fn seconds(stamp_ns: i64) -> f64 {
    let second = stamp_ns.div_euclid(NANOS_PER_SECOND);
    let nanos = stamp_ns.rem_euclid(NANOS_PER_SECOND);
    second as f64 + nanos as f64 / NANOS_PER_SECOND as f64
}

/// For each of `stamps_s` the nearest of `others_s`, which ascend, if they differ by at most `max_difference_s`.
pub(crate) fn nearest_stamps(
    stamps_s: &[f64],
    others_s: &[f64],
    max_difference_s: f64,
) -> impl Iterator<Item = (usize, usize)> {
    stamps_s.iter().enumerate().filter_map(move |(at, &stamp_s)| {
        let after = others_s.partition_point(|other_s| *other_s <= stamp_s);
        let difference_s = |other: usize| others_s.get(other).map(|own_s| (own_s - stamp_s).abs());
        let before = after.checked_sub(1);
        let distance_s =
            |other: Option<usize>| other.and_then(difference_s).unwrap_or(f64::INFINITY);
        let (before_s, after_s) = (distance_s(before), distance_s(Some(after)));
        let nearest = if after_s < before_s { Some(after) } else { before };
        nearest.filter(|_| before_s.min(after_s) <= max_difference_s).map(|other| (at, other))
    })
}

#[cfg(test)]
mod tests {
    use ground::geometry::{Vec3, rotation_from_rotvec};

    use super::*;

    const START_NS: i64 = 1_700_000_000_000_000_000;

    fn motion(t_s: f64) -> Pose {
        let xyz = [0.4 * (0.9 * t_s).sin(), 0.3 * (1.3 * t_s).cos(), 0.2 * (0.5 * t_s + 1.0).sin()];
        let rotvec = [0.8 * (0.7 * t_s).sin(), 0.6 * (1.1 * t_s).cos(), 0.5 * (0.4 * t_s).sin()];
        pose(xyz, rotation_from_rotvec(rotvec.into()))
    }

    /// At 100 Hz.
    fn reference() -> (Vec<i64>, Vec<Pose>) {
        (0..400).map(|row| (START_NS + 10_000_000 * row, motion(0.01 * row as f64))).unzip()
    }

    /// At 30 Hz, in another frame, with errors.
    fn estimate() -> (Vec<i64>, Vec<Pose>) {
        let frame = pose([1.0, -2.0, 0.5], rotation_from_rotvec([0.3, -0.2, 1.1].into()));
        let row = |row: i64| {
            let k = row as f64;
            let xyz = [0.004 * (2.0 * k).sin(), 0.003 * (3.0 * k).cos(), 0.002 * (5.0 * k).sin()];
            let rotvec = [0.01 * (1.7 * k).cos(), 0.006 * (2.3 * k).sin(), 0.008 * (0.9 * k).sin()];
            let own = motion(0.1 + 0.033 * k);
            let position = own.translation.vector + Vec3::from(xyz);
            let rotation = own.rotation * rotation_from_rotvec(rotvec.into());
            (START_NS + 103_456_789 + 33_000_000 * row, frame * pose(position.into(), rotation))
        };
        (0..120).map(row).unzip()
    }

    fn associated(max_difference_s: f64) -> (Vec<(usize, usize)>, Vec<Pose>, Vec<Pose>) {
        let ((reference_ns, reference), (estimate_ns, estimate)) = (reference(), estimate());
        let pairs = associate_stamps(&reference_ns, &estimate_ns, max_difference_s);
        let (own, other) =
            pairs.iter().map(|(own, other)| (reference[*own], estimate[*other])).unzip();
        (pairs, own, other)
    }

    fn assert_equal(own: Option<TrajectoryError>, translation_rmse_m: f64, rotation_rmse_rad: f64) {
        let own = own.expect("errors");
        assert!((own.translation_rmse_m / translation_rmse_m - 1.0).abs() < 1e-9, "{own:?}");
        assert!((own.rotation_rmse_rad / rotation_rmse_rad - 1.0).abs() < 1e-9, "{own:?}");
    }

    /// The numbers are those of evo 1.38.1.
    #[test]
    fn errors_are_those_of_evo() {
        let (_, reference, estimate) = associated(MAX_STAMP_DIFFERENCE_S);
        assert_equal(
            absolute_trajectory_error(&reference, &estimate),
            2.147146789874474,
            1.1574352225017972,
        );
        assert_equal(
            aligned_trajectory_error(&reference, &estimate),
            0.004165414385599223,
            0.010994364685051529,
        );
        assert_equal(
            relative_pose_error(&reference, &estimate),
            0.006994165964953756,
            0.014340428152761372,
        );
    }

    #[test]
    fn stamps_are_associated_as_in_evo() {
        let (pairs, ..) = associated(MAX_STAMP_DIFFERENCE_S);
        assert_eq!((pairs.len(), pairs.iter().map(|pair| pair.0).sum::<usize>()), (119, 24400));
        assert_eq!(pairs[..3], [(10, 0), (14, 1), (17, 2)]);
        let (pairs, ..) = associated(0.003);
        let sums = pairs.iter().fold((0, 0), |sums, pair| (sums.0 + pair.0, sums.1 + pair.1));
        assert_eq!((pairs.len(), sums), (70, (14317, 4119)));
        let (reference_ns, estimate_ns) = (reference().0, estimate().0);
        let exchanged = associate_stamps(&estimate_ns, &reference_ns, 0.003);
        assert!(exchanged.iter().map(|pair| (pair.1, pair.0)).eq(pairs));
        assert_eq!(associate_stamps(&[], &estimate_ns, 0.01), []);
        assert_eq!(associate_stamps(&[0, 20_000_000], &[10_000_000], 0.02), [(0, 0)]);
    }

    #[test]
    fn positions_on_a_line_are_not_aligned() {
        let line: Vec<Pose> =
            (0..9).map(|at| pose([at as f64, 0.0, 0.0], Rotation::identity())).collect();
        assert_eq!(rigid_alignment(&line, &line), None);
        assert_eq!(aligned_trajectory_error(&[], &[]), None);
        assert_eq!(relative_pose_error(&line[..1], &line), None);
        let mut unusable = reference().1;
        unusable[3].translation.vector.x = f64::NAN;
        assert_eq!(rigid_alignment(&unusable, &unusable), None);
    }
}
