//! Norm defects of logged rotations: quaternions off unit norm, matrices off orthonormality. Checks all
//! rows.

use std::collections::HashSet;

use rayon::prelude::*;

use crate::stats::median;
use crate::stream::{ArrayColumns, Column, Columns, ImuColumns, PoseColumns, Times};
use crate::time::Stamp;

use super::Run;
use super::poses::MatrixOrder;
use super::streams::{Stream, StreamClocks, with_key};

/// Maximum defect by rounding; larger ones are kept for the report.
const MAX_ROUNDING_DEFECT: f64 = 1e-5;
/// Norm below which a quaternion counts as unset.
const MAX_UNSET_NORM: f64 = 1e-6;

/// Encoding of a stream's rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationStorage {
    /// Four numbers; the defect is `| |q| − 1 |`.
    Quaternion,
    /// Nine numbers; the defect is `max |RᵀR − I|`.
    Matrix,
}

/// Norm defects of a stream or transform.
#[derive(Clone, Debug, PartialEq)]
pub struct NormDefects {
    /// Index of the stream.
    pub stream: usize,
    /// Child frame of the transform.
    pub frame: Option<String>,
    /// Encoding of the rotations.
    pub storage: RotationStorage,
    /// Number of set rotations.
    pub rows: usize,
    /// Number of all-zero quaternions.
    pub unset: usize,
    /// Index of the stream's part.
    piece: usize,
    /// Largest defect.
    pub largest: f64,
    /// Median defect; of a subset if there are many rows.
    pub median: f64,
    /// Stamp of the largest defect, if any.
    pub at: Option<Stamp>,
}

/// Norm defects of quaternions, and of arrays that may hold rotations.
pub(super) fn measure_norm_defects(streams: &[Stream], clocks: &StreamClocks) -> Vec<NormDefects> {
    let of = |(index, stream): (usize, &Stream)| {
        let at = |piece: usize, row| {
            clocks.clock(index, piece)?.stamp_of(stream.times().get(piece)?, row)
        };
        let pieces = pieces(stream).into_iter().enumerate();
        let norm_defects = pieces.filter_map(|(piece, (frame, written, rows, defect))| {
            let of = (index, piece, frame);
            NormDefects::measure(of, written, (0..rows).map(defect), |row| at(piece, row))
        });
        norm_defects.collect::<Vec<_>>()
    };
    streams.par_iter().enumerate().flat_map_iter(of).collect()
}

/// Releases values of poses and IMUs. Keeps stamps, invalid rotations, and rows with repeated stamps.
pub(super) fn release_values(streams: &mut [Stream], norm_defects: &[NormDefects]) {
    for (index, stream) in streams.iter_mut().enumerate() {
        let own = with_key(norm_defects, index, |norm_defects| norm_defects.stream).iter();
        let odd: HashSet<usize> = own
            .filter(|norm_defects| norm_defects.largest > MAX_ROUNDING_DEFECT)
            .map(|norm_defects| norm_defects.piece)
            .collect();
        if let Some(columns) = &mut stream.columns {
            columns.release_values(|piece, times| odd.contains(&piece) || !are_increasing(times));
        }
    }
}

/// Whether stamps strictly increase in receive order.
fn are_increasing(times: &Times) -> bool {
    let stamped = times.header.iter().filter(|stamp| **stamp != 0);
    times.log.is_sorted() && stamped.is_sorted_by(|a, b| a < b)
}

impl Run {
    /// Stamp and defect of each rotation. Empty if all are valid up to rounding.
    pub fn defect_series(&self, norm_defects: &NormDefects) -> Vec<(Stamp, f64)> {
        let Some(stream) = self.streams.get(norm_defects.stream) else { return Vec::new() };
        let Some(clock) = self.clocks_of(norm_defects.stream).first() else { return Vec::new() };
        let times = stream.times();
        let pieces = pieces(stream).into_iter().zip(times);
        let mut own = pieces.filter(|((frame, ..), _)| *frame == norm_defects.frame);
        let Some(((_, _, rows, defect), times)) = own.next() else { return Vec::new() };
        let row = |row: usize| Some((clock.stamp_of(times, row)?, defect(row)));
        (0..rows).filter_map(row).filter(|(_, defect)| defect.is_finite()).collect()
    }
}

/// Defect of a row, NaN if unset.
type Defect<'a> = Box<dyn Fn(usize) -> f64 + 'a>;

fn pieces(stream: &Stream) -> Vec<(Option<String>, RotationStorage, usize, Defect<'_>)> {
    use RotationStorage::{Matrix, Quaternion};
    match &stream.columns {
        Some(Columns::Poses(poses) | Columns::Transforms(poses)) => {
            let named = |poses: &PoseColumns| {
                (!poses.child_frame_id.is_empty()).then(|| poses.child_frame_id.clone())
            };
            let of = |poses| {
                (named(poses), Quaternion, poses.q_xyzw.len(), quaternion_defects(&poses.q_xyzw))
            };
            poses.iter().map(of).collect()
        }
        Some(Columns::Imu(imu)) => {
            let ImuColumns { q_xyzw, has_orientation, .. } = imu;
            let orientation = || (None, Quaternion, q_xyzw.len(), quaternion_defects(q_xyzw));
            has_orientation.then(orientation).into_iter().collect()
        }
        Some(Columns::Array(array)) if array.width == 7 => {
            let of_row =
                |row| norm_defect(array.row(row)[3..].iter().map(|number| number * number).sum());
            vec![(None, Quaternion, array.times.len(), Box::new(of_row))]
        }
        Some(Columns::Array(array)) => {
            let matrices = matrix_defects(array).into_iter();
            matrices.map(|defect| (None, Matrix, array.times.len(), defect)).collect()
        }
        _ => Vec::new(),
    }
}

fn quaternion_defects(q_xyzw: &Column<[f64; 4]>) -> Defect<'_> {
    let square = |q: &[f64; 4]| q.iter().map(|number| number * number).sum();
    Box::new(move |row| norm_defect(square(&q_xyzw[row])))
}

fn norm_defect(square: f64) -> f64 {
    let norm = square.sqrt();
    if norm < MAX_UNSET_NORM { f64::NAN } else { (norm - 1.0).abs() }
}

fn matrix_defects(array: &ArrayColumns) -> Option<Defect<'_>> {
    let layout = MatrixOrder::detect(array)?;
    Some(Box::new(move |row| orthonormality(layout.split(array.row(row)).1)))
}

/// `max |RᵀR − I|`, from the matrix rows.
fn orthonormality(rows: [[f64; 3]; 3]) -> f64 {
    let mut largest = 0.0_f64;
    for a in 0..3 {
        for b in a..3 {
            let product: f64 = rows.iter().map(|row| row[a] * row[b]).sum();
            largest = largest.max((product - if a == b { 1.0 } else { 0.0 }).abs());
        }
    }
    largest
}

impl NormDefects {
    fn measure(
        (stream, piece, frame): (usize, usize, Option<String>),
        written: RotationStorage,
        defects: impl ExactSizeIterator<Item = f64>,
        at: impl Fn(usize) -> Option<Stamp>,
    ) -> Option<Self> {
        const MAX_MEDIAN_ROWS: usize = 20_000;
        let all = defects.len();
        if all == 0 {
            return None;
        }
        let stride = all.div_ceil(MAX_MEDIAN_ROWS).max(1);
        let (mut rows, mut worst, mut some) = (0, (0, 0.0), Vec::new());
        for (row, defect) in defects.enumerate().filter(|(_, defect)| defect.is_finite()) {
            rows += 1;
            if row % stride == 0 {
                some.push(defect);
            }
            if defect > worst.1 {
                worst = (row, defect);
            }
        }
        let median = median(&mut some).unwrap_or(0.0);
        let (row, largest) = worst;
        let at = at(row);
        let unset = all - rows;
        Some(Self { stream, frame, storage: written, rows, unset, piece, largest, median, at })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::Topic;
    use crate::run::streams::split;
    use crate::time::Clock;

    fn measure_quaternions(q_xyzw: &[[f64; 4]]) -> NormDefects {
        let q_xyzw: &Column<[f64; 4]> = &q_xyzw.to_vec().into();
        let at = |row| Some(Stamp::from_nanos(row as i64));
        let defects = (0..q_xyzw.len()).map(quaternion_defects(q_xyzw));
        NormDefects::measure((0, 0, None), RotationStorage::Quaternion, defects, at)
            .expect("there are rows")
    }

    /// Poses with the given norm of the last quaternion.
    fn poses(stamps: [i64; 3], length: f64) -> Columns {
        let mut poses = PoseColumns::default();
        for (row, stamp) in stamps.into_iter().enumerate() {
            poses.times.push(stamp, 100 + row as i64, 100 + row as i64);
            poses.xyz.push([1.0; 3]);
            poses.q_xyzw.push([0.0, 0.0, 0.0, if row == 2 { length } else { 1.0 }]);
        }
        Columns::Poses(vec![poses])
    }

    #[test]
    fn values_are_released_unless_needed_later() {
        for (stamps, length, is_kept) in [
            ([1, 2, 3], 1.0, false),
            ([0, 2, 3], 1.0, false),
            ([1, 2, 3], 0.9, true),
            ([1, 2, 2], 1.0, true),
            ([1, 3, 2], 1.0, true),
        ] {
            let topic = Topic {
                name: "/pose".to_owned(),
                type_name: "geometry_msgs/msg/PoseStamped".to_owned(),
                encoding: "cdr".to_owned(),
                messages: 3,
                columns: Some(poses(stamps, length)),
                ..Topic::default()
            };
            let mut streams = split(vec![topic]);
            let clocks = StreamClocks::select(&streams, Clock::Header, 5.0);
            let norm_defects = measure_norm_defects(&streams, &clocks);
            release_values(&mut streams, &norm_defects);
            let Some(Columns::Poses(left)) = &streams[0].columns else { panic!("poses") };
            assert_eq!(left[0].times.len(), 3);
            let rows = if is_kept { 3 } else { 0 };
            assert_eq!((left[0].xyz.len(), left[0].q_xyzw.len()), (rows, rows), "{stamps:?}");
        }
    }

    #[test]
    fn the_largest_defect_has_its_time_and_unset_ones_do_not_count() {
        let unit = [0.6, 0.0, 0.0, 0.8];
        let norm_defects =
            measure_quaternions(&[unit, [0.0; 4], unit.map(|c| 0.97 * c), unit.map(|c| -c)]);
        assert!(
            (norm_defects.largest - 0.03).abs() < 1e-12 && norm_defects.median < 1e-12,
            "{norm_defects:?}"
        );
        assert_eq!((norm_defects.rows, norm_defects.unset), (3, 1));
        assert_eq!(norm_defects.at, Some(Stamp::from_nanos(2)));
        assert_eq!(measure_quaternions(&[[0.0; 4]]).rows, 0);
        // Dropped rows have no time.
        let none_logged = Column::default();
        let none = (0..0).map(quaternion_defects(&none_logged));
        let unasked = |_| unreachable!("there is no row");
        assert_eq!(
            NormDefects::measure((0, 0, None), RotationStorage::Quaternion, none, unasked),
            None
        );
    }

    #[test]
    fn a_lerp_between_two_quaternions_is_short_by_the_cosine() {
        // Halfway between 0° and 60°: the chord of a 30° arc in quaternion space.
        let [a, b] = [0.0_f64, 30.0].map(|half| half.to_radians());
        let middle = [(a.sin() + b.sin()) / 2.0, 0.0, 0.0, (a.cos() + b.cos()) / 2.0];
        let expected = 1.0 - 15.0_f64.to_radians().cos();
        assert!((measure_quaternions(&[middle]).largest - expected).abs() < 1e-12);
    }

    #[test]
    fn a_lerp_between_two_matrices_is_not_orthonormal() {
        // Halfway between 0° and 90° about z, columns have length 1/√2.
        let rows = [[0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]];
        assert!((orthonormality(rows) - 0.5).abs() < 1e-15);
        assert_eq!(orthonormality([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 0.0);
    }
}
