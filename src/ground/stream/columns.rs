use super::column::Column;
use super::times::{SharedTimes, Times, permute};

/// Positions and velocities of one joint, one per row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointColumn {
    /// Name in the log.
    pub name: String,
    /// Position, rad or m; NaN if missing.
    pub position: Vec<f64>,
    /// Velocity, rad/s or m/s; NaN if missing.
    pub velocity: Column<f64>,
}

impl JointColumn {
    /// A joint without velocities.
    pub fn from_positions(name: String, position: Vec<f64>) -> Self {
        Self { name, velocity: Column::constant(f64::NAN, position.len()), position }
    }

    /// A joint that is missing from all of `rows` rows.
    pub fn absent(name: String, rows: usize) -> Self {
        Self::from_positions(name, vec![f64::NAN; rows])
    }
}

/// Largest plausible magnitude, in any unit. Its square does not overflow.
const MAX_MAGNITUDE: f64 = 1e12;

/// Whether a value is finite and at most 1e12 in magnitude.
pub fn is_usable(value: f64) -> bool {
    value.abs() <= MAX_MAGNITUDE
}

/// NaN if the value is not [`is_usable`].
pub fn usable_or_nan(value: f64) -> f64 {
    if is_usable(value) { value } else { f64::NAN }
}

/// A JointState topic.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointColumns {
    /// Times of the rows.
    pub times: Times,
    /// Header frame, usually empty.
    pub frame_id: String,
    /// In the order of first appearance.
    pub joints: Vec<JointColumn>,
    /// Dropped messages with unequal numbers of names and positions.
    pub wrong_length: u64,
    /// Messages with two positions of a joint; the last is used.
    pub contradictory: u64,
    /// Dropped positions that are not [`is_usable`].
    pub not_finite: u64,
    /// The same per joint, up to the last with any.
    pub unusable: Vec<u64>,
    /// The type has no names; these are the driver's defaults.
    pub unnamed: bool,
    /// Positions were assumed to be degrees because of their magnitude. They are rad here.
    pub converted_from_degrees: bool,
    /// Factor and offset that converted each position from a unit other than rad and degrees; else empty.
    pub conversions: Vec<[f64; 2]>,
}

/// Poses with quaternions: PoseStamped, Odometry, TransformStamped, one (parent, child) of /tf.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseColumns {
    /// Times of the rows.
    pub times: SharedTimes,
    /// Parent frame, without a leading `/`.
    pub frame_id: String,
    /// Child frame, without a leading `/`; may be empty.
    pub child_frame_id: String,
    /// Position as logged, nominally m.
    pub xyz: Column<[f64; 3]>,
    /// Quaternion as logged: x, y, z, w.
    pub q_xyzw: Column<[f64; 4]>,
    /// Dropped rows with values that are not [`is_usable`].
    pub not_finite: u64,
}

/// An IMU topic.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuColumns {
    /// Times of the rows.
    pub times: Times,
    /// Sensor frame, without a leading `/`.
    pub frame_id: String,
    /// `world_from_imu` as logged (REP 145), x, y, z, w; all zero if unknown.
    pub q_xyzw: Column<[f64; 4]>,
    /// Angular velocity, sensor frame, rad/s.
    pub gyro: Column<[f64; 3]>,
    /// Specific force, sensor frame, m/s².
    pub accel: Column<[f64; 3]>,
    /// Whether a message declares an orientation (`orientation_covariance[0] != -1`).
    pub has_orientation: bool,
    /// Dropped rows with values that are not [`is_usable`].
    pub not_finite: u64,
}

/// Arrays of constant length, such as `std_msgs/Float64MultiArray`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrayColumns {
    /// Times of the rows.
    pub times: Times,
    /// Values per row.
    pub width: usize,
    /// Row-major values.
    pub values: Vec<f64>,
    /// Nothing identifies the numbers.
    pub unnamed: bool,
    /// Dropped messages not as long as the first.
    pub wrong_length: u64,
    /// Dropped rows with values that are not [`is_usable`].
    pub not_finite: u64,
}

/// Texts, such as `robot_description`; equal texts of a latched topic once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TextColumns {
    /// Times of the rows.
    pub times: Times,
    /// Text of each row.
    pub text: Vec<String>,
}

/// Content of a topic.
#[derive(Clone, Debug, PartialEq)]
pub enum Columns {
    /// Joint states.
    Joints(JointColumns),
    /// Poses by (frame, child frame), in the order of first appearance.
    Poses(Vec<PoseColumns>),
    /// Transforms by (parent, child), in the order of first appearance.
    Transforms(Vec<PoseColumns>),
    /// IMU readings.
    Imu(ImuColumns),
    /// Number arrays.
    Array(ArrayColumns),
    /// Texts.
    Text(TextColumns),
}

impl Columns {
    /// Times of each transform or pose, or of the topic.
    pub fn times(&self) -> Vec<&Times> {
        match self {
            Columns::Joints(joints) => vec![&joints.times],
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                poses.iter().map(|poses| &*poses.times).collect()
            }
            Columns::Imu(imu) => vec![&imu.times],
            Columns::Array(array) => vec![&array.times],
            Columns::Text(text) => vec![&text.times],
        }
    }

    /// Dropped rows, or positions of joints, that are not [`is_usable`].
    pub fn not_finite(&self) -> u64 {
        match self {
            Columns::Joints(joints) => joints.not_finite,
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                poses.iter().map(|poses| poses.not_finite).sum()
            }
            Columns::Imu(imu) => imu.not_finite,
            Columns::Array(array) => array.not_finite,
            Columns::Text(_) => 0,
        }
    }

    /// The times of [`Columns::times`], mutable.
    pub fn times_mut(&mut self) -> Vec<&mut Times> {
        match self {
            Columns::Joints(joints) => vec![&mut joints.times],
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                poses.iter_mut().map(|poses| &mut *poses.times).collect()
            }
            Columns::Imu(imu) => vec![&mut imu.times],
            Columns::Array(array) => vec![&mut array.times],
            Columns::Text(text) => vec![&mut text.times],
        }
    }
}

impl Columns {
    /// Keeps the given rows of each part of [`Columns::times`], and removes poses and transforms without
    /// rows and dropped samples.
    pub fn retain(&mut self, rows: &[Vec<usize>]) {
        match self {
            Columns::Joints(joints) => rows.iter().for_each(|rows| joints.select(rows)),
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                poses.iter_mut().zip(rows).for_each(|(poses, rows)| poses.select(rows));
                poses.retain(|poses| !poses.times.is_empty() || poses.not_finite > 0);
            }
            Columns::Imu(imu) => rows.iter().for_each(|rows| imu.select(rows)),
            Columns::Array(array) => rows.iter().for_each(|rows| array.select(rows)),
            Columns::Text(_) => {}
        }
    }

    /// Zeroes the counts of dropped samples unless `is_kept`.
    pub fn clear_dropped(&mut self, is_kept: impl Fn(usize) -> bool) {
        match self {
            Columns::Joints(joints) if !is_kept(0) => {
                joints.unusable.clear();
                (joints.not_finite, joints.wrong_length, joints.contradictory) = (0, 0, 0);
            }
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                let others = poses.iter_mut().enumerate().filter(|(part, _)| !is_kept(*part));
                others.for_each(|(_, poses)| poses.not_finite = 0);
            }
            Columns::Imu(imu) if !is_kept(0) => imu.not_finite = 0,
            Columns::Array(array) if !is_kept(0) => {
                (array.not_finite, array.wrong_length) = (0, 0);
            }
            Columns::Joints(_) | Columns::Imu(_) | Columns::Array(_) | Columns::Text(_) => {}
        }
    }
}

impl Columns {
    /// Frees values of poses and IMUs, but not their times, unless `kept` (part index and times).
    pub fn release_values(&mut self, kept: impl Fn(usize, &Times) -> bool) {
        match self {
            Columns::Poses(poses) | Columns::Transforms(poses) => {
                let parts = poses.iter_mut().enumerate();
                for (_, poses) in parts.filter(|(part, poses)| !kept(*part, &poses.times)) {
                    (poses.xyz, poses.q_xyzw) = Default::default();
                }
            }
            Columns::Imu(imu) if !kept(0, &imu.times) => {
                (imu.q_xyzw, imu.gyro, imu.accel) = Default::default();
            }
            Columns::Imu(_) | Columns::Joints(_) | Columns::Array(_) | Columns::Text(_) => {}
        }
    }
}

impl JointColumns {
    /// Counts a position that is not [`is_usable`].
    pub fn drop_value(&mut self, joint: usize) {
        self.not_finite += 1;
        self.count_unusable(joint, 1);
    }

    /// Counts dropped positions, without changing [`JointColumns::not_finite`].
    pub fn count_unusable(&mut self, joint: usize, count: u64) {
        if count > 0 && self.unusable.len() <= joint {
            self.unusable.resize(joint + 1, 0);
        }
        if let Some(own) = self.unusable.get_mut(joint) {
            *own += count;
        }
    }

    fn select(&mut self, rows: &[usize]) {
        self.times.permute(rows);
        for joint in &mut self.joints {
            permute(&mut joint.position, rows);
            joint.velocity.select(rows);
        }
    }
}

impl PoseColumns {
    fn select(&mut self, rows: &[usize]) {
        self.times.permute(rows);
        self.xyz.select(rows);
        self.q_xyzw.select(rows);
    }
}

impl ImuColumns {
    fn select(&mut self, rows: &[usize]) {
        self.times.permute(rows);
        self.q_xyzw.select(rows);
        self.gyro.select(rows);
        self.accel.select(rows);
    }
}

impl ArrayColumns {
    /// Numbers of one row.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.width..(row + 1) * self.width]
    }

    fn select(&mut self, rows: &[usize]) {
        self.times.permute(rows);
        self.values = rows.iter().flat_map(|&row| self.row(row).to_vec()).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selecting_moves_whole_rows() {
        let mut poses = PoseColumns::default();
        for (stamp, x) in [(30, 3.0), (10, 1.0), (20, 2.0)] {
            poses.times.push(stamp, 100 - stamp, 0);
            poses.xyz.push([x, 0.0, 0.0]);
            poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
        }
        poses.select(&[1, 2, 0]);
        assert_eq!(poses.times.header, [10, 20, 30]);
        assert_eq!(poses.times.log, [90, 80, 70]);
        let x: Vec<f64> = poses.xyz.iter().map(|xyz| xyz[0]).collect();
        assert_eq!(x, [1.0, 2.0, 3.0]);
    }
}
