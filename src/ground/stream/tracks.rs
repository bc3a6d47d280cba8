use crate::geometry::{AngleUnit, LengthScale, Pose, Rotation, Vec3};
use crate::stats::{STD_DEV_PER_MEDIAN, median};

/// Joint positions over time. Times are seconds from the run's origin, strictly increasing.
#[derive(Clone, Debug, Default)]
pub struct JointTrack {
    /// Sample times, s.
    pub t_s: Vec<f64>,
    /// Number of joints.
    pub dof: usize,
    /// Positions, row-major, `dof` per row, rad or m.
    pub q: Vec<f64>,
    /// Velocities, same layout; as logged if they agree with the positions, otherwise differentiated.
    pub qd: Vec<f64>,
    /// Standard deviations of each joint's position and velocity, which second differences underestimate
    /// after smoothing; empty if unknown.
    pub noise: Vec<[f64; 2]>,
}

impl JointTrack {
    /// Converts revolute joints from degrees.
    pub fn convert_from_degrees(&mut self, slides: &[bool]) {
        for values in [&mut self.q, &mut self.qd] {
            for row in values.chunks_exact_mut(self.dof.max(1)) {
                let turning = row.iter_mut().zip(slides).filter(|(_, slides)| !**slides);
                turning.for_each(|(value, _)| *value = value.to_radians());
            }
        }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Positions at `row`.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.q[row * self.dof..(row + 1) * self.dof]
    }

    /// Positions of some joints at `row`.
    pub fn positions_at(&self, row: usize, joints: &[usize]) -> Vec<f64> {
        joints.iter().map(|&joint| self.row(row)[joint]).collect()
    }

    /// Velocities at `row`.
    pub fn velocities(&self, row: usize) -> &[f64] {
        &self.qd[row * self.dof..(row + 1) * self.dof]
    }

    /// The samples at these rows.
    pub fn at_rows(&self, rows: impl Iterator<Item = usize> + Clone) -> Self {
        Self {
            t_s: rows.clone().map(|row| self.t_s[row]).collect(),
            dof: self.dof,
            q: rows.clone().flat_map(|row| self.row(row)).copied().collect(),
            qd: rows.flat_map(|row| self.velocities(row)).copied().collect(),
            noise: self.noise.clone(),
        }
    }

    /// Positions of one joint.
    pub fn positions_of(&self, joint: usize) -> impl Iterator<Item = f64> {
        self.q.iter().skip(joint).step_by(self.dof.max(1)).copied()
    }

    /// Velocities of one joint.
    pub fn velocities_of(&self, joint: usize) -> impl Iterator<Item = f64> {
        self.qd.iter().skip(joint).step_by(self.dof.max(1)).copied()
    }

    /// Keeps the first `rows`.
    pub fn truncate(&mut self, rows: usize) {
        self.t_s.truncate(rows);
        self.q.truncate(rows * self.dof);
        self.qd.truncate(rows * self.dof);
    }

    /// First and last time, s.
    pub fn span(&self) -> Option<(f64, f64)> {
        Some((*self.t_s.first()?, *self.t_s.last()?))
    }

    /// Interpolator that starts at the first sample.
    pub fn sequence(&self) -> JointSequence<'_> {
        let (q, qd) = (vec![0.0; self.dof], vec![0.0; self.dof]);
        JointSequence { track: self, left: 0, q, qd }
    }

    /// Whether the interval after `row` is too long and a joint moved in it.
    fn is_gap(&self, row: usize) -> bool {
        const MIN_GAP_S: f64 = 0.1;
        const MIN_GAP_PERIODS: f64 = 10.0;
        /// A gap regardless of adjacent intervals, s.
        const MAX_INTERVAL_S: f64 = 2.0;
        /// Change and speed of a joint at rest: rad or m, and rad/s or m/s.
        const MAX_REST_CHANGE_AND_SPEED: (f64, f64) = (1e-3, 1e-2);
        let interval = |row: usize| Some(self.t_s.get(row + 1)? - self.t_s[row]);
        let is_longer = |h: f64, adjacent: Option<f64>| {
            adjacent.is_some_and(|adjacent| h > MIN_GAP_PERIODS * adjacent)
        };
        let h = self.t_s[row + 1] - self.t_s[row];
        if h <= MIN_GAP_S
            || !(h > MAX_INTERVAL_S
                || is_longer(h, row.checked_sub(1).and_then(interval))
                || is_longer(h, interval(row + 1)))
        {
            return false;
        }
        let (a, b) = (self.row(row), self.row(row + 1));
        let speeds = &self.qd[row * self.dof..(row + 2) * self.dof];
        a.iter().zip(b).any(|(a, b)| (a - b).abs() > MAX_REST_CHANGE_AND_SPEED.0)
            || speeds.iter().any(|speed| speed.abs() > MAX_REST_CHANGE_AND_SPEED.1)
    }
}

/// Interpolates the joint states of a track: O(1) per call in time order.
#[derive(Clone, Debug)]
pub struct JointSequence<'a> {
    track: &'a JointTrack,
    /// Start of the last interval.
    left: usize,
    q: Vec<f64>,
    qd: Vec<f64>,
}

impl JointSequence<'_> {
    /// Positions (cubic Hermite) and velocities (linear), one per joint. The slope of the cubic would amplify
    /// position noise. `None` outside the track and in gaps in which a joint moved: longer than 2 s, or than
    /// 0.1 s and ten adjacent intervals.
    pub fn at(&mut self, t_s: f64) -> Option<(&[f64], &[f64])> {
        let JointTrack { t_s: times, dof, q, qd, .. } = self.track;
        let left = bracket(times, t_s, &mut self.left)?;
        let h = times[left + 1] - times[left];
        if self.track.is_gap(left) && t_s != times[left] && t_s != times[left + 1] {
            return None;
        }
        let s = (t_s - times[left]) / h;
        let [h00, h10, h01, h11] = hermite_basis(s);
        let rows = left * dof..(left + 2) * dof;
        let (qa, qb) = q[rows.clone()].split_at(*dof);
        let (va, vb) = qd[rows].split_at(*dof);
        let (h10, h11) = (h10 * h, h11 * h);
        let ends = qa.iter().zip(qb).zip(va.iter().zip(vb));
        for ((q, qd), ((qa, qb), (va, vb))) in self.q.iter_mut().zip(&mut self.qd).zip(ends) {
            *q = h00 * qa + h10 * va + h01 * qb + h11 * vb;
            *qd = va + s * (vb - va);
        }
        Some(self.last())
    }

    /// Positions and velocities at the last time with joint states; zeros before the first.
    pub fn last(&self) -> (&[f64], &[f64]) {
        (&self.q, &self.qd)
    }
}

/// Weights of the start, its slope, the end and its slope in a cubic with these slopes, at a fraction of an interval of
/// length 1 (Press et al., *Numerical Recipes*, 3rd ed., §3.3).
#[inline]
pub fn hermite_basis(s: f64) -> [f64; 4] {
    let (s2, s3) = (s * s, s * s * s);
    [2.0 * s3 - 3.0 * s2 + 1.0, s3 - 2.0 * s2 + s, 3.0 * s2 - 2.0 * s3, s3 - s2]
}

/// `i` with `t[i] ≤ t_s ≤ t[i+1]`, fastest near the last one; `None` outside `t`.
pub fn bracket(t: &[f64], t_s: f64, last_left: &mut usize) -> Option<usize> {
    let last = t.len().checked_sub(1)?;
    if last == 0 || !(t[0]..=t[last]).contains(&t_s) {
        return None;
    }
    let mut left = (*last_left).min(last - 1);
    if t[left] > t_s || t[(left + 8).min(last)] < t_s {
        left = t.partition_point(|&x| x <= t_s).saturating_sub(1).min(last - 1);
    }
    while t[left + 1] < t_s {
        left += 1;
    }
    *last_left = left;
    Some(left)
}

/// Standard deviation of the noise between samples, in the unit of `q`, from the median magnitude of second
/// differences. Long series are subsampled; 0 for fewer than three samples.
pub fn sample_noise(q: &[f64]) -> f64 {
    /// Determines the median within 1 %.
    const MAX_DIFFERENCES: usize = 25_000;
    let some = q.windows(3).step_by(q.len().div_ceil(MAX_DIFFERENCES).max(1));
    let mut second_differences: Vec<f64> = some.map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    STD_DEV_PER_MEDIAN * median(&mut second_differences).unwrap_or(0.0) / 6f64.sqrt()
}

/// Orientations of a pose stream.
#[derive(Clone, Debug, PartialEq)]
pub enum Orientations {
    /// `reference_from_child` as logged.
    Rotations(Vec<Rotation>),
    /// Three numbers per sample, undeclared convention.
    Numbers(Vec<[f64; 3]>),
    /// Number of orientations, none ever set.
    Unset(usize),
}

impl Orientations {
    /// Number of samples.
    pub fn len(&self) -> usize {
        match self {
            Orientations::Rotations(rotations) => rotations.len(),
            Orientations::Numbers(numbers) => numbers.len(),
            Orientations::Unset(samples) => *samples,
        }
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The samples at these rows.
    pub fn at_rows(&self, rows: &[usize]) -> Self {
        match self {
            Self::Rotations(all) => Self::Rotations(at_rows(all, rows)),
            Self::Numbers(all) => Self::Numbers(at_rows(all, rows)),
            Self::Unset(_) => Self::Unset(rows.len()),
        }
    }
}

fn at_rows<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
    rows.iter().map(|&row| values[row]).collect()
}

/// Poses over time. Times as in [`JointTrack`].
#[derive(Clone, Debug)]
pub struct PoseTrack {
    /// Sample times, s.
    pub t_s: Vec<f64>,
    /// Positions in the reference frame as logged, nominally m.
    pub xyz: Vec<Vec3>,
    /// One per position.
    pub orientation: Orientations,
    /// Units declared by the caller.
    pub declared: Option<DeclaredUnits>,
}

impl PoseTrack {
    /// Adds the samples of another track, of which the orientations are decoded if they are here.
    pub fn append(&mut self, other: Self) {
        self.t_s.extend(other.t_s);
        self.xyz.extend(other.xyz);
        match (&mut self.orientation, other.orientation) {
            (Orientations::Rotations(own), Orientations::Rotations(other)) => own.extend(other),
            (own, _) => *own = Orientations::Unset(self.xyz.len()),
        }
    }

    /// The samples at these rows.
    pub fn at_rows(&self, rows: &[usize]) -> Self {
        let declared = self.declared.as_ref().map(|declared| DeclaredUnits {
            in_other_angles: declared.in_other_angles.as_ref().map(|all| at_rows(all, rows)),
            ..*declared
        });
        let (t_s, xyz) = (at_rows(&self.t_s, rows), at_rows(&self.xyz, rows));
        Self { t_s, xyz, orientation: self.orientation.at_rows(rows), declared }
    }

    /// Transforms each pose from both sides. Positions without orientations change only their reference. Unnamed numbers
    /// have no frames and stay.
    pub fn transform(&mut self, before: &Pose, after: &Pose) {
        match &mut self.orientation {
            Orientations::Rotations(rotations) => {
                for (xyz, rotation) in self.xyz.iter_mut().zip(rotations) {
                    let pose = before * Pose::from_parts((*xyz).into(), *rotation) * after;
                    (*xyz, *rotation) = (pose.translation.vector, pose.rotation);
                }
            }
            Orientations::Unset(_) => {
                for xyz in &mut self.xyz {
                    *xyz = before.rotation * *xyz + before.translation.vector;
                }
            }
            Orientations::Numbers(_) => {}
        }
    }

    /// Whether any two poses differ.
    pub fn changes(&self) -> bool {
        let turns = match &self.orientation {
            Orientations::Rotations(all) => all.windows(2).any(|pair| pair[0] != pair[1]),
            Orientations::Numbers(all) => all.windows(2).any(|pair| pair[0] != pair[1]),
            Orientations::Unset(_) => false,
        };
        turns || self.xyz.windows(2).any(|pair| pair[0] != pair[1])
    }
}

/// Declared units, already applied to the stream; they may be wrong.
#[derive(Clone, Debug, Default)]
pub struct DeclaredUnits {
    /// Length unit: m or mm.
    pub length: LengthScale,
    /// Angle unit.
    pub angle: AngleUnit,
    /// Orientations in the other unit; `None` without angles.
    pub in_other_angles: Option<Vec<Rotation>>,
}

/// IMU readings over time. Times as in [`JointTrack`].
#[derive(Clone, Debug, Default)]
pub struct ImuTrack {
    /// Sample times, s.
    pub t_s: Vec<f64>,
    /// `world_from_imu`, one per sample; may be empty.
    pub orientation: Vec<Rotation>,
    /// Angular velocity, sensor frame, rad/s.
    pub gyro: Vec<Vec3>,
    /// Specific force, sensor frame, m/s².
    pub accel: Vec<Vec3>,
}

impl ImuTrack {
    /// The samples at these rows.
    pub fn at_rows(&self, rows: &[usize]) -> Self {
        let Self { t_s, orientation, gyro, accel } = self;
        let of_orientation = if orientation.is_empty() { &[] } else { rows };
        Self {
            t_s: at_rows(t_s, rows),
            orientation: at_rows(orientation, of_orientation),
            gyro: at_rows(gyro, rows),
            accel: at_rows(accel, rows),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(t: f64) -> (f64, f64) {
        (1.0 - 2.0 * t + 3.0 * t * t * t, -2.0 + 9.0 * t * t)
    }

    fn track() -> JointTrack {
        let t_s: Vec<f64> =
            (0..40).map(|i| i as f64 * 0.01 + if i % 3 == 0 { 0.002 } else { 0.0 }).collect();
        let (q, qd) = t_s.iter().map(|&t| cubic(t)).unzip();
        JointTrack { t_s, dof: 1, q, qd, noise: Vec::new() }
    }

    #[test]
    fn a_cubic_is_interpolated_exactly_for_times_in_any_order() {
        let track = track();
        let mut sequence = track.sequence();
        for t in [0.35, 0.0021, 0.2, 0.2, 0.38999, 0.01, 0.1234] {
            let (q, qd) = sequence.at(t).expect("a covered time");
            assert!((q[0] - cubic(t).0).abs() < 1e-12 && (qd[0] - cubic(t).1).abs() < 1e-3);
        }
    }

    #[test]
    fn a_gap_is_interpolated_only_if_the_joints_rest() {
        let t_s: Vec<f64> =
            (0..20).map(|i| f64::from(i) * 0.01 + if i < 10 { 0.0 } else { 0.5 }).collect();
        let mut track =
            JointTrack { q: t_s.clone(), qd: vec![1.0; 20], dof: 1, t_s, noise: Vec::new() };
        assert!(track.sequence().at(0.3).is_none());
        assert!([0.09, 0.6].iter().all(|t_s| track.sequence().at(*t_s).is_some()));
        track.q.fill(2.0);
        track.qd.fill(0.0);
        assert_eq!(track.sequence().at(0.3), Some(([2.0].as_slice(), [0.0].as_slice())));
    }

    #[test]
    fn a_low_sampling_rate_is_no_gap() {
        let t_s: Vec<f64> = (0..20).map(|i| f64::from(i) * 0.2).collect();
        let track =
            JointTrack { q: t_s.clone(), qd: vec![1.0; 20], dof: 1, t_s, noise: Vec::new() };
        assert!(track.sequence().at(0.3).is_some());
    }

    #[test]
    fn outside_the_span_there_is_no_value() {
        let track = track();
        let mut sequence = JointSequence { left: 7, ..track.sequence() };
        for t in [-0.1, 0.0, 0.4, f64::NAN] {
            assert!(sequence.at(t).is_none());
        }
    }
}
