//! Commanded straight lines: whether their orientation is interpolated correctly, and whether the arm
//! follows.
//!
//! A line is a set of commands on the chord between two stops. Position and orientation are compared at
//! equal fractions of the path, so the speed profile has no effect. The reference orientation is a slerp, a
//! rotation about one axis in proportion to the distance (Shoemake, "Animating rotation with quaternion
//! curves", SIGGRAPH 1985).

use std::f64::consts::{PI, TAU};

use super::measured_poses::{MeasuredPoses, length_of, variance_of_mean};
use super::rest::{ConstantCommand, MIN_REST_S, Rest, mean_pose, poses_within};
use crate::PoseSeries;
use ground::geometry::{
    Convention, Pose, Rotation, Vec3, angle_between, mean_vector, rotation_from_rotvec,
    rotvec_from_rotation,
};
use ground::stats::{MeasuredLength, highest, lowest};

const MIN_LINE_M: f64 = 0.02;
/// Near half a turn the shortest rotation is ambiguous.
const MAX_ROTATION_RAD: f64 = 170.0 * PI / 180.0;

/// Commanded straight line.
#[derive(Clone, Debug)]
pub struct CommandedLine {
    /// The command leaves its start, from the run's origin.
    pub from_s: f64,
    /// The command reaches its end.
    pub to_s: f64,
    /// Length.
    pub length_m: f64,
    /// Start to end.
    pub turn_rad: f64,
    /// Largest angle of the commanded orientation to the slerp.
    pub command_rad: f64,
    /// Its largest component perpendicular to the slerp's axis.
    pub command_off_axis_rad: f64,
    /// Quantity interpolated instead, if clear.
    pub interpolated: Option<String>,
    /// Per observation; `None` if undetermined.
    pub deviations: Vec<Option<LineDeviation>>,
}

/// Largest deviation of the tip beyond noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineDeviation {
    /// Distance from the line through its own ends.
    pub distance_m: MeasuredLength,
    /// Angle from the slerp between its own ends.
    pub angle_rad: MeasuredLength,
}

struct PoseMotion {
    from: Pose,
    to: Pose,
    along: Vec3,
    length_m: f64,
    /// Start to end, in the start frame, rad.
    turn: Vec3,
}

impl PoseMotion {
    fn new(from: &Pose, to: &Pose) -> Self {
        let chord = to.translation.vector - from.translation.vector;
        let length_m = chord.norm();
        Self {
            from: *from,
            to: *to,
            along: chord / length_m.max(f64::MIN_POSITIVE),
            length_m,
            turn: rotvec_from_rotation(&(from.rotation.inverse() * to.rotation)),
        }
    }

    /// Path fraction, 0 to 1, and perpendicular offset, m.
    fn locate(&self, pose: &Pose) -> (f64, Vec3) {
        let since = pose.translation.vector - self.from.translation.vector;
        let along_m = since.dot(&self.along);
        (along_m / self.length_m.max(f64::MIN_POSITIVE), since - self.along * along_m)
    }

    fn slerp(&self, part: f64) -> Rotation {
        self.from.rotation * rotation_from_rotvec(self.turn * part.clamp(0.0, 1.0))
    }

    /// Component perpendicular to the path's axis: twice the arcsine of the perpendicular part of the
    /// quaternion's vector.
    fn off_axis_rad(&self, rotation: &Rotation) -> f64 {
        let turn = rotvec_from_rotation(&(self.from.rotation.inverse() * rotation));
        let angle = turn.norm();
        let Some(axis) = self.turn.try_normalize(1e-6) else { return angle };
        let vector = turn / angle.max(f64::MIN_POSITIVE) * (0.5 * angle).sin();
        let across = vector - axis * vector.dot(&axis);
        2.0 * across.norm().min(1.0).asin()
    }
}

/// Detects lines and measures each observation's deviation.
pub(super) fn detect_lines(
    series: &PoseSeries,
    constant_commands: &[ConstantCommand],
    rests: &[Rest],
    measured_poses: &[MeasuredPoses<'_>],
) -> Vec<CommandedLine> {
    let duration_s = |stop: &ConstantCommand| series.t_s[stop.last] - series.t_s[stop.first];
    let stops: Vec<&ConstantCommand> =
        constant_commands.iter().filter(|stop| duration_s(stop) >= MIN_REST_S).collect();
    let pairs = stops.windows(2).filter_map(|pair| {
        let (mut line, motion) = commanded_line(series, pair[0].last..pair[1].first + 1)?;
        let deviation =
            |poses: &MeasuredPoses| line_deviation(&line, &motion, rests, pair[1], poses);
        line.deviations = measured_poses.iter().map(deviation).collect();
        Some(line)
    });
    pairs.collect()
}

/// `None` if the commands in `rows` are not on a line.
fn commanded_line(
    series: &PoseSeries,
    rows: std::ops::Range<usize>,
) -> Option<(CommandedLine, PoseMotion)> {
    const MIN_COMMANDS: usize = 8;
    /// Rounding, m, plus a share of the length.
    const MAX_LINE_DEVIATION: (f64, f64) = (2e-5, 1e-4);
    let poses = series.poses.get(rows.clone())?;
    let times = series.t_s.get(rows)?;
    let motion = PoseMotion::new(poses.first()?, poses.last()?);
    let turn_rad = motion.turn.norm();
    if poses.len() < MIN_COMMANDS || motion.length_m < MIN_LINE_M || turn_rad > MAX_ROTATION_RAD {
        return None;
    }
    let most_m = MAX_LINE_DEVIATION.0 + MAX_LINE_DEVIATION.1 * motion.length_m;
    let margin = most_m / motion.length_m;
    let located: Vec<(f64, Vec3)> = poses.iter().map(|pose| motion.locate(pose)).collect();
    let is_on = |(part, off_line): &(f64, Vec3)| {
        off_line.norm() <= most_m && (-margin..=1.0 + margin).contains(part)
    };
    // A pause or a jump is not a line.
    let longest = poses.windows(2).map(|pair| {
        (pair[1].translation.vector - pair[0].translation.vector).norm() / motion.length_m
    });
    if !located.iter().all(is_on) || longest.fold(0.0, f64::max) > 0.3 {
        return None;
    }
    let placed = located.iter().zip(poses).map(|((part, _), pose)| (*part, pose.rotation));
    let placed: Vec<(f64, Rotation)> = placed.collect();
    let off_line =
        |(part, rotation): &(f64, Rotation)| angle_between(rotation, &motion.slerp(*part));
    let command_rad = placed.iter().map(off_line).fold(0.0, f64::max);
    let off_axis = placed.iter().map(|(_, rotation)| motion.off_axis_rad(rotation));
    let line = CommandedLine {
        from_s: times[0],
        to_s: times[times.len() - 1],
        length_m: motion.length_m,
        turn_rad,
        command_rad,
        command_off_axis_rad: off_axis.fold(0.0, f64::max),
        interpolated: identify_interpolation(&motion, &placed),
        deviations: Vec::new(),
    };
    Some((line, motion))
}

/// Linear in Euler angles, rotation vector, quaternion components or matrix elements. `None` for a slerp,
/// or if no candidate fits well.
fn identify_interpolation(motion: &PoseMotion, placed: &[(f64, Rotation)]) -> Option<String> {
    /// Rms; smaller deviations are a slerp with rounded numbers.
    const MIN_SLERP_DEVIATION_RAD: f64 = 5e-4;
    /// Share of the slerp's residual.
    const MAX_RESIDUAL_SHARE: f64 = 0.05;
    let rms = |interpolate: &dyn Fn(f64) -> Rotation| {
        let square = |(part, rotation): &(f64, Rotation)| {
            angle_between(rotation, &interpolate(*part)).powi(2)
        };
        (placed.iter().map(square).sum::<f64>() / placed.len().max(1) as f64).sqrt()
    };
    let by_slerp = rms(&|part| motion.slerp(part));
    if by_slerp < MIN_SLERP_DEVIATION_RAD {
        return None;
    }
    let (angle, axis) = (motion.turn.norm(), motion.turn.try_normalize(1e-9)?);
    // Linear blend of two unit vectors `angle` apart.
    let blended =
        |angle: f64, part: f64| (part * angle.sin()).atan2(1.0 - part + part * angle.cos());
    let at_angle = |angle: f64| motion.from.rotation * rotation_from_rotvec(axis * angle);
    let blends = [
        (rms(&|s| at_angle(2.0 * blended(angle / 2.0, s))), "quaternion components".to_owned()),
        (rms(&|s| at_angle(blended(angle, s))), "matrix elements".to_owned()),
    ];
    let numbers = Convention::all().iter().map(|&convention| {
        let [a, b] = [motion.from, motion.to].map(|end| convention.numbers(&end.rotation));
        let by: [f64; 3] = std::array::from_fn(|at| match (convention, b[at] - a[at]) {
            (Convention::RotVec, by) => by,
            (_, by) => by - TAU * (by / TAU).round(),
        });
        let interpolate =
            |part: f64| convention.rotation(std::array::from_fn(|at| a[at] + part * by[at]));
        (rms(&interpolate), convention.to_string())
    });
    // The first of equal candidates is the most common.
    let interpolations = blends.into_iter().chain(numbers);
    let (min_rms, name) = lowest(interpolations, |it| it.0)?;
    (min_rms <= MAX_RESIDUAL_SHARE * by_slerp).then_some(name)
}

/// Compares with line and slerp between the rests before and after, so delay and constant pose errors have
/// no effect.
fn line_deviation(
    line: &CommandedLine,
    motion: &PoseMotion,
    rests: &[Rest],
    stop: &ConstantCommand,
    measured_poses: &MeasuredPoses<'_>,
) -> Option<LineDeviation> {
    /// Rests averaged to locate the ends.
    const END_S: f64 = 0.3;
    /// In path length: m, plus a share.
    const MAX_LENGTH_DIFFERENCE: (f64, f64) = (5e-3, 0.1);
    /// In total rotation.
    const MAX_ROTATION_DIFFERENCE_RAD: f64 = 3.0 * PI / 180.0;
    /// Along the path.
    const MAX_BINS: usize = 20;
    const SAMPLES_PER_BIN: usize = 4;
    let before = rests.iter().rev().find(|rest| rest.from_s < line.from_s)?;
    let after = rests.iter().find(|rest| rest.from_s > line.from_s && rest.from_s < stop.to_s)?;
    if before.to_s > after.from_s {
        return None;
    }
    let series = measured_poses.series;
    let ends = [
        poses_within(series, (before.to_s - END_S).max(before.from_s), before.to_s),
        poses_within(series, after.from_s, (after.from_s + END_S).min(after.to_s)),
    ];
    let [first, last] = [mean_pose(ends[0])?, mean_pose(ends[1])?];
    let tip_from_point = motion.commanded_point(&first, &last)?;
    let measured_motion = PoseMotion::new(&(first * tip_from_point), &(last * tip_from_point));
    let is_same_motion = (measured_motion.length_m - motion.length_m).abs()
        <= MAX_LENGTH_DIFFERENCE.0 + MAX_LENGTH_DIFFERENCE.1 * motion.length_m
        && (measured_motion.turn.norm() - line.turn_rad).abs() <= MAX_ROTATION_DIFFERENCE_RAD;
    if !is_same_motion {
        return None;
    }
    let place = |pose: &Pose| {
        let pose = pose * tip_from_point;
        let (part, deviation) = measured_motion.locate(&pose);
        let turn = rotvec_from_rotation(&(pose.rotation * measured_motion.slerp(part).inverse()));
        (part, [deviation, turn])
    };
    let mut placed: Vec<(f64, [Vec3; 2])> =
        poses_within(series, before.to_s, after.from_s).iter().map(place).collect();
    placed.retain(|(part, _)| (0.0..1.0).contains(part));
    let count = (placed.len() / SAMPLES_PER_BIN).min(MAX_BINS);
    if count < 3 {
        return None;
    }
    let mut bins: Vec<Vec<[Vec3; 2]>> = vec![Vec::new(); count];
    for (part, deviations) in placed {
        bins[((part * count as f64) as usize).min(count - 1)].push(deviations);
    }
    let fewest = ends[0].len().min(ends[1].len());
    let farthest = |kind: usize| {
        let noise = &measured_poses.noise[kind];
        let lengths = bins.iter().filter(|bin| !bin.is_empty()).map(|bin| {
            let variance = variance_of_mean(noise, bin.len()) + variance_of_mean(noise, fewest);
            length_of(mean_vector(bin.iter().map(|deviations| deviations[kind])), variance)
        });
        let longest = highest(lengths, |length| length.norm.value)?;
        // Bonferroni: maximum over the bins.
        Some(MeasuredLength { p_value: (longest.p_value * count as f64).min(1.0), ..longest })
    };
    Some(LineDeviation { distance_m: farthest(0)?, angle_rad: farthest(1)? })
}

impl PoseMotion {
    /// Commanded point in the tip's frame, from the tip's poses at both ends. `None` if the point cannot be located and its
    /// path may differ from the tip's.
    fn commanded_point(&self, first: &Pose, last: &Pose) -> Option<Pose> {
        /// The tip then counts as the commanded point.
        const MAX_POINT_DISTANCE_M: f64 = 5e-3;
        /// With less rotation, all points follow the same path.
        const MIN_ROTATION_RAD: f64 = 2.0 * PI / 180.0;
        /// Between start and end, for one and the same point.
        const MAX_POINT_DIFFERENCE_M: f64 = 2e-3;
        let [at_first, at_last] = [first.inv_mul(&self.from), last.inv_mul(&self.to)]
            .map(|point| point.translation.vector);
        let far_m = at_first.norm().max(at_last.norm());
        if far_m <= MAX_POINT_DISTANCE_M || self.turn.norm() <= MIN_ROTATION_RAD {
            return Some(Pose::identity());
        }
        let middle = Pose::from_parts(at_first.lerp(&at_last, 0.5).into(), Rotation::identity());
        ((at_first - at_last).norm() <= MAX_POINT_DIFFERENCE_M).then_some(middle)
    }
}
