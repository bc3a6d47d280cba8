//! Polars tables. Column names end with the unit. `docs/tables.md` lists the columns of the files.

mod audited;
mod configurations;
mod parquet;
mod rows;
mod workspace;

pub use audited::register_outputs;
pub use configurations::{Configurations, kinematics_frame};
pub use parquet::{TableError, write_frame, write_table};
use rows::joints_frame;
pub use rows::{checks_frame, findings_frame};

use polars::prelude::{Column, DataFrame, PolarsResult};

use crate::diagnosis::AlignedSamples;
use crate::geometry::{Pose, xyz_of, xyzw_from_rotation};
use crate::time::Stamp;

/// ns since the epoch of its clock (`i64`; every other column is `f64`).
const STAMP_NS: &str = "stamp_ns";
/// s from the run's origin.
const T_S: &str = "t_s";

/// Aligned samples and residuals, one row per sample in time order.
///
/// # Errors
/// If the columns of `aligned` differ in length.
fn aligned_frame(aligned: &AlignedSamples, origin: Stamp) -> PolarsResult<DataFrame> {
    let stamps_ns: Vec<i64> = aligned.t_s.iter().map(|&t_s| origin.shifted(t_s).nanos()).collect();
    let mut columns = vec![Column::new(STAMP_NS.into(), stamps_ns), column(T_S, &aligned.t_s)];
    for (prefix, poses) in [
        ("logged_", &aligned.logged),
        ("fk_", &aligned.fk),
        ("corrected_", &aligned.corrected),
        ("fk_at_truth_", &aligned.fk_at_truth),
    ] {
        columns.extend(pose_columns(prefix, poses));
    }
    let (before, after) = (aligned.before(), aligned.after());
    columns.extend([
        column("before_m", &before.m),
        column("before_rad", &before.rad),
        column("after_m", &after.m),
        column("after_rad", &after.rad),
        column("reach_m", &aligned.reach_m()),
    ]);
    DataFrame::new(aligned.t_s.len(), columns)
}

/// Preceded by the columns robot and topic.
///
/// # Errors
/// If the columns of a stream differ in length.
fn aligned_frames<'a>(
    streams: impl Iterator<Item = (&'a str, &'a str, &'a AlignedSamples)>,
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
        None => aligned_frames([("", "", &AlignedSamples::default())].into_iter(), origin),
    }
}

fn column(name: &str, values: &[f64]) -> Column {
    Column::new(name.into(), values)
}

/// Position and quaternion: `{prefix}x_m` … `{prefix}qw`.
fn pose_columns<'a>(prefix: &str, poses: impl IntoIterator<Item = &'a Pose>) -> Vec<Column> {
    let (xyz, xyzw): (Vec<_>, Vec<_>) =
        poses.into_iter().map(|pose| (xyz_of(pose), xyzw_from_rotation(&pose.rotation))).unzip();
    let positions =
        split_components(["x_m", "y_m", "z_m"].map(|part| format!("{prefix}{part}")), &xyz);
    let rotations =
        split_components(["qx", "qy", "qz", "qw"].map(|part| format!("{prefix}{part}")), &xyzw);
    positions.chain(rotations).collect()
}

/// One column per component of `rows`.
fn split_components<const N: usize>(
    names: [String; N],
    rows: &[[f64; N]],
) -> impl Iterator<Item = Column> {
    names.into_iter().enumerate().map(|(part, name)| {
        let values: Vec<f64> = rows.iter().map(|row| row[part]).collect();
        Column::new(name.into(), values)
    })
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

    fn aligned() -> AlignedSamples {
        AlignedSamples {
            t_s: vec![0.0, 0.5],
            logged: vec![turned_about_z([3.0, 4.0, 0.0], 0.3), turned_about_z([0.0; 3], -0.2)],
            fk: vec![turned_about_z([0.0; 3], 0.1), turned_about_z([1.0, 2.0, 2.0], 0.2)],
            corrected: vec![turned_about_z([1.0, 1.0, 1.0], 0.0), Pose::identity()],
            fk_at_truth: vec![turned_about_z([1.0, 1.0, 1.5], 0.25), Pose::identity()],
            q_at_truth: Vec::new(),
            frame_from_base: Vec::new(),
        }
    }

    fn numbers(frame: &DataFrame, name: &str) -> PolarsResult<Vec<f64>> {
        Ok(frame.column(name)?.f64()?.into_no_null_iter().collect())
    }

    fn assert_close(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
        }
    }

    #[test]
    fn there_is_one_row_per_sample_and_names_state_units() -> PolarsResult<()> {
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
    fn residuals_match_values_computed_by_hand() -> PolarsResult<()> {
        let frame = aligned_frame(&aligned(), ORIGIN)?;
        assert_close(&numbers(&frame, "before_m")?, &[5.0, 3.0]);
        assert_close(&numbers(&frame, "before_rad")?, &[0.2, 0.4]);
        assert_close(&numbers(&frame, "after_m")?, &[0.5, 0.0]);
        assert_close(&numbers(&frame, "after_rad")?, &[0.25, 0.0]);
        assert_close(&numbers(&frame, "reach_m")?, &[0.0, 3.0]);
        Ok(())
    }

    #[test]
    fn stamps_are_exact_and_poses_round_trip() -> PolarsResult<()> {
        let frame = aligned_frame(&aligned(), ORIGIN)?;
        let origin_ns = ORIGIN.nanos();
        let stamps: Vec<i64> = frame.column(STAMP_NS)?.i64()?.into_no_null_iter().collect();
        assert_eq!(stamps, [origin_ns, origin_ns + 500_000_000]);
        assert_eq!(numbers(&frame, "fk_x_m")?, [0.0, 1.0]);
        assert_eq!(numbers(&frame, "fk_z_m")?, [0.0, 2.0]);
        assert_close(&numbers(&frame, "logged_qz")?, &[0.15f64.sin(), (-0.1f64).sin()]);
        assert_close(&numbers(&frame, "logged_qw")?, &[0.15f64.cos(), 0.1f64.cos()]);
        Ok(())
    }

    #[test]
    fn columns_of_different_lengths_are_an_error() {
        let mut aligned = aligned();
        aligned.corrected.pop();
        assert!(aligned_frame(&aligned, ORIGIN).is_err());
    }

    #[test]
    fn no_samples_make_an_empty_frame() -> PolarsResult<()> {
        let frame = aligned_frame(&AlignedSamples::default(), ORIGIN)?;
        assert_eq!(frame.height(), 0);
        assert!(numbers(&frame, "corrected_x_m")?.is_empty());
        Ok(())
    }
}
