//! The one bridge to Polars: a pose stream beside forward kinematics, one row a sample.
//!
//! Pictures, recordings and files read this table, so that they all show the same numbers. Units
//! stand last in a column's name; components of unit quaternions have none.
//!
//! | column | what |
//! |---|---|
//! | `stamp_ns` | stamp of the sample, ns since the epoch of the run's clock |
//! | `t_s` | the same from the run's origin |
//! | `true_t_s` | when the content was true: `t_s` less the latency found |
//! | `logged_…` | `reference_from_child` as logged |
//! | `fk_…` | `reference_from_tip` by FK of the joint states as recorded, at the stamp |
//! | `corrected_…` | the logged pose with everything found taken off |
//! | `fk_at_truth_…` | `reference_from_tip` by FK with the joint offsets found, when the content was true |
//! | `residual_before_m`, `residual_before_rad` | distance and angle between `logged` and `fk` |
//! | `residual_after_m`, `residual_after_rad` | distance and angle between `corrected` and `fk_at_truth` |
//! | `reach_m` | distance of `fk` from the origin of the reference frame |
//!
//! Each of the four poses is the columns `…_x_m`, `…_y_m`, `…_z_m`, `…_qx`, `…_qy`, `…_qz`, `…_qw`.

use polars::prelude::{Column, DataFrame, PolarsResult};

use crate::diagnosis::{Aligned, PoseDiagnosis};
use crate::geometry::{Pose, angle_between, xyz_of, xyzw_from_rotation};
use crate::time::Stamp;

/// By how much the stamps of a stream lag behind its content.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lag {
    /// Latency at mid-run, s: what is stamped *t* was true at *t − latency*.
    pub latency_s: f64,
    /// By how much it grows with each second of stamp, s/s.
    pub skew: f64,
}

impl Lag {
    /// The lag that was estimated. What could not be estimated is zero, and so is a skew whose 95 %
    /// interval holds zero.
    pub fn of(diagnosis: &PoseDiagnosis) -> Self {
        let skew = diagnosis.skew.as_ref().ok();
        let skew = skew.filter(|skew| skew.value.abs() > skew.half_width(0.95));
        Self {
            latency_s: diagnosis.latency_s.as_ref().map_or(0.0, |latency| latency.value),
            skew: skew.map_or(0.0, |skew| skew.value),
        }
    }
}

/// Which of a sample's four poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// `reference_from_child` as logged.
    Logged,
    /// `reference_from_tip` by FK of the joint states as recorded, at the stamp.
    Fk,
    /// The logged pose with everything found taken off.
    Corrected,
    /// `reference_from_tip` by FK with the joint offsets found, when the content was true.
    FkAtTruth,
}

impl Version {
    /// The columns of its position (m) and of its quaternion.
    const fn columns(self) -> [&'static str; 7] {
        macro_rules! columns {
            ($name:literal) => {
                [
                    concat!($name, "_x_m"),
                    concat!($name, "_y_m"),
                    concat!($name, "_z_m"),
                    concat!($name, "_qx"),
                    concat!($name, "_qy"),
                    concat!($name, "_qz"),
                    concat!($name, "_qw"),
                ]
            };
        }
        match self {
            Version::Logged => columns!("logged"),
            Version::Fk => columns!("fk"),
            Version::Corrected => columns!("corrected"),
            Version::FkAtTruth => columns!("fk_at_truth"),
        }
    }
}

/// A number of every sample that is not part of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Stamp, s from the run's origin.
    Time,
    /// When the content was true, s from the run's origin.
    TrueTime,
    /// Distance of the logged pose from FK, m.
    DistanceBefore,
    /// Angle of the logged pose to FK, rad.
    AngleBefore,
    /// Distance of the corrected pose from FK when it was true, m.
    DistanceAfter,
    /// Angle of the corrected pose to FK when it was true, rad.
    AngleAfter,
    /// Distance of the FK position from the origin of the reference frame, m.
    Reach,
}

impl Quantity {
    const fn column(self) -> &'static str {
        match self {
            Quantity::Time => "t_s",
            Quantity::TrueTime => "true_t_s",
            Quantity::DistanceBefore => "residual_before_m",
            Quantity::AngleBefore => "residual_before_rad",
            Quantity::DistanceAfter => "residual_after_m",
            Quantity::AngleAfter => "residual_after_rad",
            Quantity::Reach => "reach_m",
        }
    }
}

const STAMP: &str = "stamp_ns";

/// The aligned samples of one pose stream and what they miss FK by, as a Polars frame.
#[derive(Clone, Debug)]
pub struct AlignedTable {
    frame: DataFrame,
}

impl AlignedTable {
    /// The table of `aligned`, whose times count from `origin` and lag by `lag`.
    ///
    /// # Panics
    /// Where the columns of `aligned` are not of one length.
    pub fn new(aligned: &Aligned, lag: Lag, origin: Stamp) -> Self {
        let Aligned { t_s, logged, fk, corrected, fk_at_truth } = aligned;
        let middle_s = t_s.first().zip(t_s.last()).map_or(0.0, |(first, last)| 0.5 * (first + last));
        let true_t_s = t_s.iter().map(|t_s| t_s - lag.latency_s - lag.skew * (t_s - middle_s));
        let stamps_ns = t_s.iter().map(|&t_s| origin.shifted(t_s).nanos());
        let poses = [
            (Version::Logged, logged),
            (Version::Fk, fk),
            (Version::Corrected, corrected),
            (Version::FkAtTruth, fk_at_truth),
        ];
        let mut columns = vec![
            Column::new(STAMP.into(), stamps_ns.collect::<Vec<_>>()),
            numbers(Quantity::Time, t_s.iter().copied()),
            numbers(Quantity::TrueTime, true_t_s),
        ];
        columns.extend(poses.into_iter().flat_map(|(version, poses)| components(version, poses)));
        columns.extend([
            numbers(Quantity::DistanceBefore, pairwise(logged, fk, distance_m)),
            numbers(Quantity::AngleBefore, pairwise(logged, fk, angle_rad)),
            numbers(Quantity::DistanceAfter, pairwise(corrected, fk_at_truth, distance_m)),
            numbers(Quantity::AngleAfter, pairwise(corrected, fk_at_truth, angle_rad)),
            numbers(Quantity::Reach, fk.iter().map(|pose| pose.translation.vector.norm())),
        ]);
        let frame = DataFrame::new(t_s.len(), columns).expect("columns of one length");
        Self { frame }
    }

    /// The frame, with the columns that the module's documentation lists.
    pub fn frame(&self) -> &DataFrame {
        &self.frame
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.frame.height()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One number of every sample, in the unit that the quantity says.
    pub fn numbers(&self, quantity: Quantity) -> &[f64] {
        self.column(quantity.column())
    }

    /// One pose of every sample.
    pub fn poses(&self, version: Version) -> PoseColumns<'_> {
        PoseColumns { columns: version.columns().map(|name| self.column(name)) }
    }

    fn column(&self, name: &str) -> &[f64] {
        let column = || -> PolarsResult<&[f64]> { self.frame.column(name)?.f64()?.cont_slice() };
        column().expect("every table has every column, in one piece")
    }
}

/// The poses of one version in every sample.
#[derive(Clone, Copy, Debug)]
pub struct PoseColumns<'a> {
    columns: [&'a [f64]; 7],
}

impl PoseColumns<'_> {
    /// Position of sample `row` in the reference frame, m.
    pub fn xyz(&self, row: usize) -> [f64; 3] {
        let [x, y, z, ..] = self.columns;
        [x[row], y[row], z[row]]
    }

    /// Unit quaternion of sample `row`, x, y, z, w with w ≥ 0.
    pub fn xyzw(&self, row: usize) -> [f64; 4] {
        let [.., x, y, z, w] = self.columns;
        [x[row], y[row], z[row], w[row]]
    }
}

fn numbers(quantity: Quantity, values: impl Iterator<Item = f64>) -> Column {
    Column::new(quantity.column().into(), values.collect::<Vec<_>>())
}

fn components(version: Version, poses: &[Pose]) -> impl Iterator<Item = Column> {
    let mut values = [(); 7].map(|()| Vec::with_capacity(poses.len()));
    for pose in poses {
        let components = xyz_of(pose).into_iter().chain(xyzw_from_rotation(&pose.rotation));
        values.iter_mut().zip(components).for_each(|(values, component)| values.push(component));
    }
    version.columns().into_iter().zip(values).map(|(name, values)| Column::new(name.into(), values))
}

fn pairwise(a: &[Pose], b: &[Pose], measure: fn(&Pose, &Pose) -> f64) -> impl Iterator<Item = f64> {
    a.iter().zip(b).map(move |(a, b)| measure(a, b))
}

fn distance_m(a: &Pose, b: &Pose) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

fn angle_rad(a: &Pose, b: &Pose) -> f64 {
    angle_between(&a.rotation, &b.rotation)
}
