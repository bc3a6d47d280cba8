//! Converts poses, arrays and IMU data to tracks.

use crate::geometry::{
    AngleUnit, Pose, Rotation, RotationEncoding, Vec3, rotation_from_matrix_rows,
    rotation_from_xyzw,
};
use crate::stream::{
    ArrayColumns, Columns, DeclaredUnits, ImuColumns, ImuTrack, Orientations, PoseColumns,
    PoseTrack,
};
use crate::time::Stamp;

use super::declaration::Declaration;
use super::rows::Rows;

#[derive(Clone, Debug)]
pub(super) struct StampedTrack<T> {
    pub track: T,
    pub stamps: Vec<Stamp>,
}

/// Rows in time order; the first of equal stamps.
fn rows_in_order(rows: &Rows, keep: impl Fn(usize) -> bool) -> Rows {
    let mut rows: Rows = rows.iter().copied().filter(|(_, row)| keep(*row)).collect();
    rows.sort_by_key(|(stamp, _)| *stamp);
    rows.dedup_by_key(|(stamp, _)| *stamp);
    rows
}

const MAX_SAMPLES: usize = 20_000;

/// Keeps every n-th element, at most [`MAX_SAMPLES`].
pub(super) fn thin<T>(seen: &mut Vec<T>) {
    let stride = seen.len().div_ceil(MAX_SAMPLES).max(1);
    let mut index = 0..;
    seen.retain(|_| index.next().is_some_and(|index: usize| index.is_multiple_of(stride)));
}

fn track_of(
    rows: &Rows,
    origin: Stamp,
    sample: impl Fn(usize) -> Option<(Vec3, Rotation)>,
) -> StampedTrack<PoseTrack> {
    let mut samples: Vec<_> = rows.iter().filter_map(|row| Some((*row, sample(row.1)?))).collect();
    samples.sort_by_key(|((stamp, _), _)| *stamp);
    samples.dedup_by_key(|((stamp, _), _)| *stamp);
    let rows: Rows = samples.iter().map(|(row, _)| *row).collect();
    let (xyz, rotations) = samples.into_iter().map(|(_, sample)| sample).unzip();
    let orientation = Orientations::Rotations(rotations);
    stamped(&rows, origin, |t_s| PoseTrack { t_s, xyz, orientation, declared: None })
}

fn stamped<T>(
    rows: &[(Stamp, usize)],
    origin: Stamp,
    track: impl FnOnce(Vec<f64>) -> T,
) -> StampedTrack<T> {
    let stamps: Vec<Stamp> = rows.iter().map(|(stamp, _)| *stamp).collect();
    let t_s = stamps.iter().map(|stamp| stamp.seconds_since(origin)).collect();
    StampedTrack { track: track(t_s), stamps }
}

/// Track of a stream of poses, with its declared units.
///
/// # Errors
/// If the columns are not one pose per row, or the declaration does not fit.
pub(super) fn from_columns(
    columns: Option<&Columns>,
    rows: &Rows,
    declared: Option<&Declaration>,
    origin: Stamp,
) -> Result<StampedTrack<PoseTrack>, String> {
    let mut stamped = match columns {
        Some(Columns::Poses(poses)) => match poses.as_slice() {
            [poses] => from_poses(poses, rows, declared, origin)?,
            _ => return Err("each message contains several poses".to_owned()),
        },
        Some(Columns::Array(array)) => from_array(array, rows, declared, origin)?,
        _ => return Err("it has no poses".to_owned()),
    };
    if let Some(&Declaration { length, angle, .. }) = declared {
        let known = stamped.track.declared.take().unwrap_or_default();
        stamped.track.declared = Some(DeclaredUnits { length, angle, ..known });
    }
    Ok(stamped)
}

/// Track without invalid quaternions.
///
/// # Errors
/// If the declaration does not fit quaternions.
pub(super) fn from_poses(
    poses: &PoseColumns,
    rows: &Rows,
    declared: Option<&Declaration>,
    origin: Stamp,
) -> Result<StampedTrack<PoseTrack>, String> {
    if declared.is_some_and(|declared| matches!(declared.coding, RotationEncoding::Three(_))) {
        return Err("the topic contains quaternions, not three rotation numbers".to_owned());
    }
    let scale = unit_m(declared);
    let is_set = |row: &usize| rotation_from_xyzw(poses.q_xyzw[*row]).is_some();
    if !rows.is_empty() && !rows.iter().any(|(_, row)| is_set(row)) {
        // Positions may be valid without orientations.
        let rows = rows_in_order(rows, |_| true);
        let xyz = rows.iter().map(|(_, row)| Vec3::from(poses.xyz[*row]) * scale).collect();
        let orientation = Orientations::Unset(rows.len());
        let track = |t_s| PoseTrack { t_s, xyz, orientation, declared: None };
        return Ok(stamped(&rows, origin, track));
    }
    Ok(track_of(rows, origin, |row| {
        let rotation = rotation_from_xyzw(as_xyzw(poses.q_xyzw[row], declared))?;
        Some((Vec3::from(poses.xyz[row]) * scale, rotation))
    }))
}

/// Track of an unnamed array: 6 numbers are position and three rotation numbers, 7 position and quaternion,
/// 12 and 16 a matrix.
///
/// # Errors
/// If the declaration does not fit, or a matrix is no pose.
fn from_array(
    array: &ArrayColumns,
    rows: &Rows,
    declared: Option<&Declaration>,
    origin: Stamp,
) -> Result<StampedTrack<PoseTrack>, String> {
    let scale = unit_m(declared);
    let xyz = |row: usize| Vec3::from_column_slice(&array.row(row)[..3]) * scale;
    let is_quaternion = declared.map(|declared| !declared.coding.has_angles());
    match array.width {
        6 if is_quaternion == Some(true) => {
            Err("the topic contains three rotation numbers, not a quaternion".to_owned())
        }
        6 => {
            let rows = rows_in_order(rows, |_| true);
            let numbers = rows.iter().map(|(_, row)| {
                let row = array.row(*row);
                [row[3], row[4], row[5]]
            });
            let (orientation, declared) = match declared {
                Some(&Declaration {
                    coding: RotationEncoding::Three(convention), angle, ..
                }) => {
                    let in_unit = |unit: AngleUnit| -> Vec<Rotation> {
                        let radians = |n: [f64; 3]| n.map(|n| n * unit.in_rad());
                        numbers.clone().map(|n| convention.rotation(radians(n))).collect()
                    };
                    let in_other_angles = Some(in_unit(angle.other()));
                    let units = DeclaredUnits { in_other_angles, ..DeclaredUnits::default() };
                    (Orientations::Rotations(in_unit(angle)), Some(units))
                }
                _ => (Orientations::Numbers(numbers.collect()), None),
            };
            let xyz = rows.iter().map(|(_, row)| xyz(*row)).collect();
            Ok(stamped(&rows, origin, |t_s| PoseTrack { t_s, xyz, orientation, declared }))
        }
        7 if is_quaternion == Some(false) => {
            Err("the topic contains a quaternion, not three rotation numbers".to_owned())
        }
        7 => Ok(track_of(rows, origin, |row| {
            let values = array.row(row);
            let logged = [values[3], values[4], values[5], values[6]];
            Some((xyz(row), rotation_from_xyzw(as_xyzw(logged, declared))?))
        })),
        12 | 16 => {
            let layout = MatrixOrder::detect(array).ok_or_else(|| {
                format!("its {} numbers per row are not a pose matrix", array.width)
            })?;
            Ok(track_of(rows, origin, |row| {
                let (translation, rows) = layout.split(array.row(row));
                let (rotation, _) = rotation_from_matrix_rows(rows)?;
                Some((Vec3::from(translation) * scale, rotation))
            }))
        }
        width => Err(not_a_pose(width)),
    }
}

/// Why arrays of this width are not poses.
pub(super) fn not_a_pose(width: usize) -> String {
    format!("{width} numbers per row are not a pose (6, 7, 12 or 16 are)")
}

fn unit_m(declared: Option<&Declaration>) -> f64 {
    declared.map_or(1.0, |declared| declared.length.in_m())
}

fn as_xyzw(logged: [f64; 4], declared: Option<&Declaration>) -> [f64; 4] {
    match declared.map(|declared| declared.coding) {
        Some(RotationEncoding::Wxyz) => [logged[1], logged[2], logged[3], logged[0]],
        _ => logged,
    }
}

/// Memory order of a matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MatrixOrder {
    RowMajor,
    ColumnMajor,
}

impl MatrixOrder {
    /// The order with the most valid poses: by 0 0 0 1 for 16 numbers, orthonormality for 12. `None` for other widths.
    pub(super) fn detect(array: &ArrayColumns) -> Option<Self> {
        if ![12, 16].contains(&array.width) {
            return None;
        }
        let rows = array.times.len();
        [Self::RowMajor, Self::ColumnMajor].into_iter().find(|layout| {
            let fits = (0..rows).filter(|&row| layout.fits(array.row(row))).count();
            2 * fits > rows
        })
    }

    fn fits(self, values: &[f64]) -> bool {
        const BOTTOM: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
        let bottom = match (self, values.len()) {
            (Self::RowMajor, 16) => Some([12, 13, 14, 15]),
            (Self::ColumnMajor, 16) => Some([3, 7, 11, 15]),
            _ => None,
        };
        let is_bottom = |places: [usize; 4]| {
            places.iter().zip(BOTTOM).all(|(&place, wanted)| (values[place] - wanted).abs() < 1e-6)
        };
        bottom.is_none_or(is_bottom) && rotation_from_matrix_rows(self.split(values).1).is_some()
    }

    pub(super) fn split(self, values: &[f64]) -> ([f64; 3], [[f64; 3]; 3]) {
        let height = values.len() / 4;
        let at = |row: usize, column: usize| match self {
            Self::RowMajor => values[4 * row + column],
            Self::ColumnMajor => values[height * column + row],
        };
        let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| at(row, column)));
        ([0, 1, 2].map(|row| at(row, 3)), rows)
    }
}

pub(super) fn from_samples(samples: Vec<(Stamp, Pose)>, origin: Stamp) -> StampedTrack<PoseTrack> {
    let rows: Rows = samples.iter().map(|(stamp, _)| *stamp).zip(0..).collect();
    track_of(&rows, origin, |row| {
        let pose = samples[row].1;
        Some((pose.translation.vector, pose.rotation))
    })
}

/// IMU track. Omits rows without orientation if most have one, else all orientations.
pub(super) fn from_imu(imu: &ImuColumns, rows: &Rows, origin: Stamp) -> StampedTrack<ImuTrack> {
    let rotation = |row: usize| rotation_from_xyzw(imu.q_xyzw[row]);
    let all = imu.q_xyzw.len();
    let has_orientation =
        imu.has_orientation && 2 * (0..all).filter(|&row| rotation(row).is_some()).count() > all;
    let rows = rows_in_order(rows, |row| !has_orientation || rotation(row).is_some());
    let kept = || rows.iter().map(|(_, row)| *row);
    let orientation =
        if has_orientation { kept().filter_map(rotation).collect() } else { Vec::new() };
    let gyro = kept().map(|row| Vec3::from(imu.gyro[row])).collect();
    let accel = kept().map(|row| Vec3::from(imu.accel[row])).collect();
    stamped(&rows, origin, |t_s| ImuTrack { t_s, orientation, gyro, accel })
}

/// Whether 90 % of `stamps` are among `of`; both sorted.
pub(super) fn are_copied_stamps(stamps: &[Stamp], of: &[Stamp]) -> bool {
    let copies = stamps.iter().filter(|stamp| of.binary_search(stamp).is_ok()).count();
    !stamps.is_empty() && 10 * copies >= 9 * stamps.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{angle_between, rotation_from_rpy, xyzw_from_rotation};

    fn rows(count: i64) -> Rows {
        (0..count).map(|row| Stamp::from_nanos(row * 1_000_000)).zip(0..).collect()
    }

    fn rotation(row: usize) -> Rotation {
        rotation_from_rpy([0.3, -0.2 * row as f64, 1.0])
    }

    fn array(width: usize, row_of: impl Fn(usize) -> Vec<f64>) -> ArrayColumns {
        let mut array = ArrayColumns { width, ..Default::default() };
        for row in 0..5 {
            array.times.push(0, row as i64, 0);
            array.values.extend(row_of(row));
        }
        array
    }

    fn rotations(track: &PoseTrack) -> &[Rotation] {
        match &track.orientation {
            Orientations::Rotations(rotations) => rotations,
            _ => panic!("rotations expected"),
        }
    }

    #[test]
    fn matrices_are_read_by_rows_or_by_columns() {
        let matrix = |row: usize| {
            let mut matrix = rotation(row).to_homogeneous();
            matrix[(0, 3)] = row as f64;
            matrix
        };
        let by_columns = |row: usize| matrix(row).as_slice().to_vec();
        let by_rows = |row: usize| matrix(row).transpose().as_slice().to_vec();
        let short_by_rows = |row: usize| by_rows(row)[..12].to_vec();
        let short_by_columns =
            |row: usize| matrix(row).fixed_rows::<3>(0).iter().copied().collect::<Vec<f64>>();
        for array in [
            array(16, by_columns),
            array(16, by_rows),
            array(12, short_by_rows),
            array(12, short_by_columns),
        ] {
            let track = from_array(&array, &rows(5), None, Stamp::default()).unwrap().track;
            for row in 0..5 {
                assert_eq!(track.xyz[row], Vec3::new(row as f64, 0.0, 0.0));
                assert!(angle_between(&rotations(&track)[row], &rotation(row)) < 1e-12);
            }
        }
        for width in [2, 4, 16] {
            let junk = array(width, |row| vec![row as f64; width]);
            assert!(from_array(&junk, &rows(5), None, Stamp::default()).is_err(), "{width}");
        }
    }

    #[test]
    fn six_numbers_stay_numbers_until_declared() {
        let array = array(6, |row| vec![1000.0, 0.0, 0.0, 90.0, 0.0, row as f64]);
        let bare = from_array(&array, &rows(5), None, Stamp::default()).unwrap().track;
        assert!(matches!(&bare.orientation, Orientations::Numbers(n) if n[3] == [90.0, 0.0, 3.0]));
        let declared: Declaration = "/tcp=euler:xyz,deg,mm".parse().unwrap();
        let track = from_array(&array, &rows(5), Some(&declared), Stamp::default()).unwrap().track;
        assert_eq!(track.xyz[0], Vec3::x());
        let quarter = rotation_from_rpy([90_f64.to_radians(), 0.0, 0.0]);
        assert!(angle_between(&rotations(&track)[0], &quarter) < 1e-12);
        let wrong: Declaration = "/tcp=quat:wxyz".parse().unwrap();
        assert!(from_array(&array, &rows(5), Some(&wrong), Stamp::default()).is_err());
    }

    #[test]
    fn seven_numbers_are_a_quaternion_with_its_scalar_last_unless_declared() {
        let [x, y, z, w] = xyzw_from_rotation(&rotation(1));
        let array = array(7, |_| vec![0.0, 0.0, 0.0, w, x, y, z]);
        let declared: Declaration = "/tcp=quat:wxyz".parse().unwrap();
        let track = from_array(&array, &rows(5), Some(&declared), Stamp::default()).unwrap().track;
        assert!(angle_between(&rotations(&track)[0], &rotation(1)) < 1e-12);
    }

    #[test]
    fn rows_without_stamp_or_rotation_and_repeated_stamps_are_excluded() {
        let mut poses = PoseColumns::default();
        for row in 0..6 {
            poses.times.push(row, 0, 0);
            poses.xyz.push([row as f64, 0.0, 0.0]);
            poses.q_xyzw.push(if row == 2 { [0.0; 4] } else { [0.0, 0.0, 0.0, 1.0] });
        }
        let mut rows = rows(6);
        rows[4].0 = rows[3].0;
        (rows[1].0, rows[5].0) = (rows[5].0, rows[1].0);
        rows.remove(0);
        let StampedTrack { track, stamps } =
            from_poses(&poses, &rows, None, Stamp::default()).unwrap();
        let x: Vec<f64> = track.xyz.iter().map(|xyz| xyz.x).collect();
        assert_eq!(x, [5.0, 3.0, 1.0]);
        assert!(stamps.is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn copied_stamps_are_distinguished_from_own_stamps() {
        let joints: Vec<Stamp> = (0..100).map(|i| Stamp::from_nanos(i * 8)).collect();
        let decimated: Vec<Stamp> = joints.iter().copied().step_by(5).collect();
        let own: Vec<Stamp> =
            joints.iter().map(|stamp| Stamp::from_nanos(stamp.nanos() + 1)).collect();
        assert!(are_copied_stamps(&decimated, &joints));
        assert!(!are_copied_stamps(&own, &joints) && !are_copied_stamps(&[], &joints));
    }

    #[test]
    fn an_imu_without_orientation_has_an_empty_column() {
        let mut imu = ImuColumns { has_orientation: false, ..Default::default() };
        for row in 0..3 {
            imu.times.push(row, 0, 0);
            imu.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
            imu.gyro.push([row as f64, 0.0, 0.0]);
            imu.accel.push([0.0, 0.0, 9.8]);
        }
        let track = from_imu(&imu, &rows(3), Stamp::default()).track;
        assert_eq!((track.orientation.len(), track.gyro.len()), (0, 3));
        imu.has_orientation = true;
        assert_eq!(from_imu(&imu, &rows(3), Stamp::default()).track.orientation.len(), 3);
    }
}
