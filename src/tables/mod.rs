//! The one bridge to Polars: a stream's samples beside forward kinematics, and what else is stored as
//! a table.
//!
//! Whatever shows or stores samples reads these frames, so that a recording, a plot and a table say
//! the same. Units stand last in a column's name. `docs/tables.md` lists the columns of the files.

mod configurations;
mod parquet;
mod rows;
pub mod thin;
mod workspace;

pub use configurations::{Configurations, kinematics_frame};
pub use parquet::{TableError, write_frame, write_table};
pub use rows::{checks_frame, findings_frame, joints_frame};
pub use workspace::{ArmWorkspace, reach_map_frame, reached_poses_frame};

use polars::prelude::{Column, DataFrame, PolarsResult};

use crate::diagnosis::Aligned;
use crate::geometry::{Pose, angle_between, xyz_of, xyzw_from_rotation};
use crate::time::Stamp;

/// The tables of an audit, in the order in which they are written.
pub(crate) const TABLE_FILES: [&str; 6] =
    ["findings", "checks", "joints", "aligned", "reach_map", "reached_poses"];

/// Stamp of the sample, ns since the epoch of its clock (`i64`; every other column is `f64`).
pub const STAMP_NS: &str = "stamp_ns";
/// Stamp of the sample, s from the run's origin.
pub const T_S: &str = "t_s";
/// Distance of the logged position from FK's as recorded, m.
pub const BEFORE_M: &str = "before_m";
/// Angle of the rotation from the logged orientation to FK's as recorded, rad.
pub const BEFORE_RAD: &str = "before_rad";
/// Distance of the corrected position from where the tip truly was, m.
pub const AFTER_M: &str = "after_m";
/// Angle of the rotation from the corrected orientation to the tip's true one, rad.
pub const AFTER_RAD: &str = "after_rad";
/// Distance of FK's position as recorded from the origin of the reference frame, m.
pub const REACH_M: &str = "reach_m";

/// One of the frame's poses; each is seven columns, `{name}_x_m` … `{name}_qw`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Posed {
    /// `reference_from_child` as logged.
    Logged,
    /// `reference_from_tip` by FK of the joint states as recorded, at the sample's stamp.
    Fk,
    /// The logged pose with everything found taken off.
    Corrected,
    /// `reference_from_tip` by FK with the joint offsets found, when the content was true.
    FkAtTruth,
}

impl Posed {
    /// All of them, in the order of their columns.
    pub const ALL: [Posed; 4] = [Posed::Logged, Posed::Fk, Posed::Corrected, Posed::FkAtTruth];

    /// The columns of the position, m.
    pub fn xyz_columns(self) -> [String; 3] {
        ["x_m", "y_m", "z_m"].map(|part| format!("{}_{part}", self.name()))
    }

    /// The columns of the unit quaternion, x y z w.
    pub fn xyzw_columns(self) -> [String; 4] {
        ["qx", "qy", "qz", "qw"].map(|part| format!("{}_{part}", self.name()))
    }

    const fn name(self) -> &'static str {
        match self {
            Posed::Logged => "logged",
            Posed::Fk => "fk",
            Posed::Corrected => "corrected",
            Posed::FkAtTruth => "fk_at_truth",
        }
    }

    fn of(self, aligned: &Aligned) -> &[Pose] {
        match self {
            Posed::Logged => &aligned.logged,
            Posed::Fk => &aligned.fk,
            Posed::Corrected => &aligned.corrected,
            Posed::FkAtTruth => &aligned.fk_at_truth,
        }
    }
}

/// The aligned samples of a stream and their residuals, one row a sample in the order of time.
///
/// # Errors
/// Where the columns of `aligned` differ in length.
pub fn aligned_frame(aligned: &Aligned, origin: Stamp) -> PolarsResult<DataFrame> {
    let stamps_ns: Vec<i64> = aligned.t_s.iter().map(|&t_s| origin.shifted(t_s).nanos()).collect();
    let mut columns = vec![Column::new(STAMP_NS.into(), stamps_ns), column(T_S, &aligned.t_s)];
    for posed in Posed::ALL {
        let poses = posed.of(aligned);
        let (xyz, xyzw): (Vec<_>, Vec<_>) =
            poses.iter().map(|pose| (xyz_of(pose), xyzw_from_rotation(&pose.rotation))).unzip();
        columns.extend(split(posed.xyz_columns(), &xyz));
        columns.extend(split(posed.xyzw_columns(), &xyzw));
    }
    let (before_m, before_rad) = residuals(&aligned.logged, &aligned.fk);
    let (after_m, after_rad) = residuals(&aligned.corrected, &aligned.fk_at_truth);
    let reach_m: Vec<f64> = aligned.fk.iter().map(|fk| fk.translation.vector.norm()).collect();
    columns.extend([
        column(BEFORE_M, &before_m),
        column(BEFORE_RAD, &before_rad),
        column(AFTER_M, &after_m),
        column(AFTER_RAD, &after_rad),
        column(REACH_M, &reach_m),
    ]);
    DataFrame::new(aligned.t_s.len(), columns)
}

/// The aligned samples of several streams, with the robot and the topic of each before its columns.
///
/// # Errors
/// Where the columns of one differ in length.
pub fn aligned_frames<'a>(
    streams: impl Iterator<Item = (&'a str, &'a str, &'a Aligned)>,
    origin: Stamp,
) -> PolarsResult<DataFrame> {
    let mut frames: Option<DataFrame> = None;
    for (robot, topic, aligned) in streams {
        let mut frame = aligned_frame(aligned, origin)?;
        for (place, (name, text)) in [("robot", robot), ("topic", topic)].into_iter().enumerate() {
            let names = Column::new(name.into(), vec![text; frame.height()]);
            frame.insert_column(place, names)?;
        }
        match &mut frames {
            Some(frames) => frames.vstack_mut(&frame).map(|_| ())?,
            None => frames = Some(frame),
        }
    }
    match frames {
        Some(mut frames) => {
            frames.rechunk_mut();
            Ok(frames)
        }
        None => aligned_frames([("", "", &Aligned::default())].into_iter(), origin),
    }
}

/// The stamps of a frame's rows, ns.
///
/// # Errors
/// Where `frame` is not one of [`aligned_frame`]'s.
pub fn stamps_ns(frame: &DataFrame) -> PolarsResult<Vec<i64>> {
    Ok(frame.column(STAMP_NS)?.i64()?.into_no_null_iter().collect())
}

/// A column of numbers.
///
/// # Errors
/// Where `frame` has no such column, or it holds something else.
pub fn numbers(frame: &DataFrame, name: &str) -> PolarsResult<Vec<f64>> {
    Ok(frame.column(name)?.f64()?.into_no_null_iter().collect())
}

/// The positions of a frame's rows in the reference frame, m.
///
/// # Errors
/// Where `frame` is not one of [`aligned_frame`]'s.
pub fn positions(frame: &DataFrame, posed: Posed) -> PolarsResult<Vec<[f64; 3]>> {
    joined(frame, posed.xyz_columns())
}

/// The orientations of a frame's rows in the reference frame, as unit quaternions x y z w.
///
/// # Errors
/// Where `frame` is not one of [`aligned_frame`]'s.
pub fn quaternions_xyzw(frame: &DataFrame, posed: Posed) -> PolarsResult<Vec<[f64; 4]>> {
    joined(frame, posed.xyzw_columns())
}

fn column(name: &str, values: &[f64]) -> Column {
    Column::new(name.into(), values)
}

/// A column for each component of `rows`.
fn split<const N: usize>(names: [String; N], rows: &[[f64; N]]) -> impl Iterator<Item = Column> {
    names.into_iter().enumerate().map(|(part, name)| {
        let values: Vec<f64> = rows.iter().map(|row| row[part]).collect();
        Column::new(name.into(), values)
    })
}

fn joined<const N: usize>(frame: &DataFrame, names: [String; N]) -> PolarsResult<Vec<[f64; N]>> {
    let mut rows = vec![[0.0; N]; frame.height()];
    for (part, name) in names.iter().enumerate() {
        for (row, value) in rows.iter_mut().zip(numbers(frame, name)?) {
            row[part] = value;
        }
    }
    Ok(rows)
}

/// Distance (m) and angle (rad) between the poses of each pair.
fn residuals(a: &[Pose], b: &[Pose]) -> (Vec<f64>, Vec<f64>) {
    let pair = |(a, b): (&Pose, &Pose)| {
        let distance_m = (a.translation.vector - b.translation.vector).norm();
        (distance_m, angle_between(&a.rotation, &b.rotation))
    };
    a.iter().zip(b).map(pair).unzip()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Vec3, pose, rotation_from_rotvec};
    use polars::prelude::DataType;

    const ORIGIN: Stamp = Stamp::from_nanos(1_780_000_000_000_000_001);

    fn turned_about_z(xyz: [f64; 3], angle_rad: f64) -> Pose {
        pose(xyz, rotation_from_rotvec(Vec3::new(0.0, 0.0, angle_rad)))
    }

    fn aligned() -> Aligned {
        Aligned {
            t_s: vec![0.0, 0.5],
            logged: vec![turned_about_z([3.0, 4.0, 0.0], 0.3), turned_about_z([0.0; 3], -0.2)],
            fk: vec![turned_about_z([0.0; 3], 0.1), turned_about_z([1.0, 2.0, 2.0], 0.2)],
            corrected: vec![turned_about_z([1.0, 1.0, 1.0], 0.0), Pose::identity()],
            fk_at_truth: vec![turned_about_z([1.0, 1.0, 1.5], 0.25), Pose::identity()],
        }
    }

    fn assert_close(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
        }
    }

    #[test]
    fn a_row_a_sample_and_the_units_in_the_names() -> PolarsResult<()> {
        let frame = aligned_frame(&aligned(), ORIGIN)?;
        assert_eq!(frame.shape(), (2, 2 + 4 * 7 + 5));
        let names: Vec<&str> =
            frame.columns().iter().map(|column| column.name().as_str()).collect();
        assert_eq!(names[..5], ["stamp_ns", "t_s", "logged_x_m", "logged_y_m", "logged_z_m"]);
        assert_eq!(
            names[26..30],
            ["fk_at_truth_qx", "fk_at_truth_qy", "fk_at_truth_qz", "fk_at_truth_qw"]
        );
        let integers = frame.columns().iter().filter(|column| column.dtype() == &DataType::Int64);
        assert_eq!(integers.count(), 1);
        Ok(())
    }

    #[test]
    fn residuals_are_those_computed_by_hand() -> PolarsResult<()> {
        let frame = aligned_frame(&aligned(), ORIGIN)?;
        assert_close(&numbers(&frame, BEFORE_M)?, &[5.0, 3.0]);
        assert_close(&numbers(&frame, BEFORE_RAD)?, &[0.2, 0.4]);
        assert_close(&numbers(&frame, AFTER_M)?, &[0.5, 0.0]);
        assert_close(&numbers(&frame, AFTER_RAD)?, &[0.25, 0.0]);
        assert_close(&numbers(&frame, REACH_M)?, &[0.0, 3.0]);
        Ok(())
    }

    #[test]
    fn stamps_keep_every_nanosecond_and_poses_come_back() -> PolarsResult<()> {
        let frame = aligned_frame(&aligned(), ORIGIN)?;
        let origin_ns = ORIGIN.nanos();
        assert_eq!(stamps_ns(&frame)?, [origin_ns, origin_ns + 500_000_000]);
        assert_eq!(positions(&frame, Posed::Fk)?, [[0.0; 3], [1.0, 2.0, 2.0]]);
        let xyzw = quaternions_xyzw(&frame, Posed::Logged)?;
        assert_close(&xyzw[0], &[0.0, 0.0, 0.15f64.sin(), 0.15f64.cos()]);
        Ok(())
    }

    #[test]
    fn columns_of_unlike_length_are_an_error() {
        let mut aligned = aligned();
        aligned.corrected.pop();
        assert!(aligned_frame(&aligned, ORIGIN).is_err());
    }

    #[test]
    fn no_samples_make_an_empty_frame() -> PolarsResult<()> {
        let frame = aligned_frame(&Aligned::default(), ORIGIN)?;
        assert_eq!(frame.height(), 0);
        assert!(positions(&frame, Posed::Corrected)?.is_empty());
        Ok(())
    }
}
