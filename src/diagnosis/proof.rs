//! The error of a stream straight from FK: as logged, and with what was found taken off. It is what a
//! pass rests on, beside the estimators and without them.
//!
//! An error that lasts for a part of the run is large in that part, whatever its mean: so its size is a
//! high quantile of the whole and of every tenth of the moving run, which single strays do not reach.
//! Whether it is noise is not asked of itself: a tool that slips in mid-run looks like one long
//! fluctuation. What differs from sample to sample is known from second differences over less than the
//! motion takes to become another (von Neumann 1941; Hall, Kay and Titterington 1990), and an error is
//! held against that.

use super::latency::median_period_s;
use super::model::{Blind, StreamState, Sweep, ToolPart, Witness};
use super::nominal::calibrated;
use super::observability::travel;
use super::sampling::still_speeds;
use super::{Aligned, PoseDiagnosis, PoseStream, Seen, Unseen};
use ground::geometry::{Pose, Vec3, pose, rotvec_from_rotation};
use ground::stream::{JointTrack, Orientations};

/// The share of samples that an error's size is reached by.
const MOST: f64 = 0.95;
/// Parts of the moving run that are looked at apart.
const PARTS: usize = 10;
/// A part has as many samples, or the run has fewer parts.
const PART_SAMPLES: usize = 20;
/// Samples without which nothing is said.
const NEED: usize = 8;
/// Moving samples without which the arm rests.
const MOVING: usize = 10;
/// A tip whose points are spread by less rests, rms m.
const AT_REST_M: f64 = 2e-3;
/// Joints that all move by less do not leave their posture, rad or m: as for joint zeros, 3°.
const TRAVEL_RAD: f64 = 0.05;
/// Noise is what differs within this share of the time in which the motion becomes another.
const SHORT: f64 = 0.25;
/// Distance from the tip of the points that show how it turns, m.
const ARM_M: f64 = 0.3;
/// Samples that the motion's memory is told from.
const MEMORY_SAMPLES: usize = 2000;
/// Samples of which is said what a calibration would leave.
const CALIBRATED_SAMPLES: usize = 5000;

/// The error of one stream against FK, straight from both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proof {
    /// Whether the arm rests, so that this is of one posture, or of few.
    pub at_rest: bool,
    /// As logged, against FK of the joint states as recorded at the same stamps.
    pub as_logged: Error,
    /// With everything found taken off.
    pub left: Option<Error>,
    /// With everything found taken off but what was found on the joints and on times: names, units,
    /// zeros, latency and skew.
    pub beside_joints: Option<Error>,
    /// With everything found taken off but what was found on the poses: reading, units and frames.
    pub beside_poses: Option<Error>,
    /// With everything found and small changes of every link's frame taken off, as a calibration of
    /// the arm makes them.
    pub calibrated: Option<Error>,
}

/// By how much poses differ from FK.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Error {
    /// Of position, m.
    pub length: Size,
    /// Of rotation, rad; `None` where the stream's orientations are bare numbers.
    pub angle: Option<Size>,
}

/// The size of an error over the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Size {
    /// Of all of it.
    pub whole: Amount,
    /// Of its parts, in the order of time.
    pub parts: Vec<Part>,
}

/// The size of an error, or of the noise, in m or rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Amount {
    /// Samples.
    pub samples: usize,
    /// Root mean square, of all but the strays.
    pub rms: f64,
    /// What 95 % of the samples stay below.
    pub most: f64,
    /// What differs from sample to sample; `None` where samples are too far apart to tell that from
    /// what the motion does.
    pub noise: Option<Short>,
}

/// What differs from sample to sample, in m or rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Short {
    /// Root mean square.
    pub rms: f64,
    /// What 95 % of the samples stay below.
    pub most: f64,
    /// Samples over which it is forgotten.
    pub over: usize,
}

/// A part of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// From when, s from the run's origin.
    pub from_s: f64,
    /// Until when.
    pub to_s: f64,
    /// Where the tip is by FK when the error is largest, in the stream's reference, m.
    pub at: Vec3,
    /// How large the error is there.
    pub amount: Amount,
}

impl Size {
    /// The part in which the error is largest; `None` of no samples.
    pub fn worst(&self) -> Option<&Part> {
        self.parts.iter().max_by(|a, b| a.amount.most.total_cmp(&b.amount.most))
    }
}

/// The error of a stream, as logged and with what was `found` on it taken off. `mended` are the joint
/// states with what was found on them taken off.
///
/// # Errors
/// Where too few of its samples are covered by the joint states.
pub fn proof(
    joints: &JointTrack,
    mended: &JointTrack,
    stream: &PoseStream,
    found: &PoseDiagnosis,
) -> Seen<Proof> {
    let logged = beside_fk(joints, stream, 0.0);
    let have = logged.t_s.len();
    if have == 0 {
        return Err(Unseen::NoOverlap);
    }
    if have < NEED {
        return Err(Unseen::TooFewSamples { have, need: NEED });
    }
    let moves = moving(joints, stream, &logged.t_s);
    let points = tip_points(&logged.fk);
    // A tip may rest while the joints move about it, as in the null space of an arm with seven.
    let is_in_one_posture = variance(&points) < AT_REST_M * AT_REST_M
        && stream.columns.iter().all(|&column| travel(joints, column) < TRAVEL_RAD);
    let at_rest = moves.iter().filter(|moves| **moves).count() < MOVING || is_in_one_posture;
    let has_rotation = matches!(stream.track.orientation, Orientations::Rotations(_));
    let as_logged =
        Series::of(&logged.t_s, &logged.logged, &logged.fk, has_rotation).error(&moves, at_rest);
    let aligned = &found.aligned;
    let moves = moving(joints, stream, &aligned.t_s);
    let error = |poses: &[Pose], fk: &[Pose], has_rotation: bool| {
        let series = Series::of(&aligned.t_s, poses, fk, has_rotation);
        (aligned.t_s.len() >= NEED).then(|| series.error(&moves, at_rest))
    };
    Ok(Proof {
        at_rest,
        as_logged,
        left: error(&aligned.corrected, &aligned.fk_at_truth, true),
        beside_joints: error(&aligned.corrected, &aligned.fk, true),
        beside_poses: error(&aligned.logged, &aligned.fk_at_truth, has_rotation),
        calibrated: by_calibration(mended, stream, found, at_rest),
    })
}

/// What small changes of every link's frame leave beside what was found.
fn by_calibration(
    mended: &JointTrack,
    stream: &PoseStream,
    found: &PoseDiagnosis,
    at_rest: bool,
) -> Option<Error> {
    let Aligned { t_s, corrected, fk_at_truth, .. } = &found.aligned;
    let (first, last) = (t_s.first()?, t_s.last()?);
    if at_rest || t_s.len() < NEED {
        return None;
    }
    let still = still_speeds(mended);
    let witness = Witness {
        joints: mended,
        chain: stream.chain,
        columns: stream.columns,
        gained: &[],
        reference_known: true,
        still: &still,
        t_s: t_s.clone(),
        xyz: corrected.iter().map(|pose| pose.translation.vector).collect(),
        rotation: corrected.iter().map(|pose| pose.rotation).collect(),
        blind: Blind::default(),
        tool_part: ToolPart::Whole,
        middle_s: 0.5 * (first + last),
    };
    let skew = found.skew.as_ref().ok().filter(|_| found.skew_chosen);
    let plain = StreamState {
        skew: skew.map_or(0.0, |skew| skew.value),
        ..StreamState::at_latency(found.latency_s.as_ref().map_or(0.0, |latency| latency.value))
    };
    let stride = t_s.len().div_ceil(CALIBRATED_SAMPLES);
    let (mut sweep, none) = (Sweep::new(&witness), vec![0.0; mended.dof]);
    let rows: Vec<usize> = (0..t_s.len())
        .step_by(stride)
        .filter(|&row| witness.pose_at(row, &plain, &none, &mut sweep).is_some())
        .collect();
    let kinds = calibrated(&witness, &plain, stride);
    let [length, angle] = kinds.try_into().ok()?;
    let vectors = |of: Vec<[f64; 3]>| of.into_iter().map(Vec3::from).collect::<Vec<Vec3>>();
    let (length, angle) = (vectors(length), vectors(angle));
    if length.len() != rows.len() {
        return None;
    }
    let t_s: Vec<f64> = rows.iter().map(|&row| t_s[row]).collect();
    let fk: Vec<Pose> = rows.iter().map(|&row| fk_at_truth[row]).collect();
    let moves = moving(mended, stream, &t_s);
    Some(Series::new(&t_s, &fk, length, Some(angle)).error(&moves, false))
}

/// The samples of a stream beside FK when they were true, a stream being late by `lag_s`; only stamps
/// and these two are filled.
pub(super) fn beside_fk(joints: &JointTrack, stream: &PoseStream, lag_s: f64) -> Aligned {
    let track = stream.track;
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let mut aligned = Aligned::default();
    for (row, &t_s) in track.t_s.iter().enumerate() {
        if !joints.at(t_s - lag_s, &mut cursor, &mut q, &mut qd) {
            continue;
        }
        let own: Vec<f64> = stream.columns.iter().map(|&column| q[column]).collect();
        let rotation = match &track.orientation {
            Orientations::Rotations(all) => all[row],
            Orientations::Numbers(_) | Orientations::Unset(_) => Default::default(),
        };
        aligned.t_s.push(t_s);
        aligned.logged.push(pose(track.xyz[row].into(), rotation));
        aligned.fk.push(stream.chain.forward(&own));
    }
    aligned
}

/// At which of some stamps a joint of the stream's chain moves.
fn moving(joints: &JointTrack, stream: &PoseStream, t_s: &[f64]) -> Vec<bool> {
    let still = still_speeds(joints);
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let mut moves = |t_s: &f64| {
        joints.at(*t_s, &mut cursor, &mut q, &mut qd)
            && stream.columns.iter().any(|&column| qd[column].abs() > still[column])
    };
    t_s.iter().map(&mut moves).collect()
}

/// The error of every sample.
pub(super) struct Series<'a> {
    t_s: &'a [f64],
    fk: &'a [Pose],
    length: Vec<Vec3>,
    angle: Option<Vec<Vec3>>,
    /// The most samples between two that differ by noise alone, but for a hair; 0 where even
    /// neighbours differ by motion.
    short: usize,
    /// Median time from one sample to the next, s.
    period_s: f64,
}

impl<'a> Series<'a> {
    pub fn of(t_s: &'a [f64], poses: &[Pose], fk: &'a [Pose], has_rotation: bool) -> Self {
        let both = || poses.iter().zip(fk);
        let length = both().map(|(a, b)| a.translation.vector - b.translation.vector).collect();
        let turn =
            |(a, b): (&Pose, &Pose)| rotvec_from_rotation(&(a.rotation * b.rotation.inverse()));
        let angle = has_rotation.then(|| both().map(turn).collect());
        Self::new(t_s, fk, length, angle)
    }

    pub fn new(
        t_s: &'a [f64],
        fk: &'a [Pose],
        length: Vec<Vec3>,
        angle: Option<Vec<Vec3>>,
    ) -> Self {
        let period_s = median_period_s(t_s);
        let short = SHORT * memory_s(t_s, fk, period_s) / period_s.max(f64::MIN_POSITIVE);
        let short = (short as usize).min(t_s.len() / 4);
        Self { t_s, fk, length, angle, short, period_s }
    }

    /// The size of the error over the samples at which the arm moves, of all where it rests.
    pub fn error(&self, moves: &[bool], at_rest: bool) -> Error {
        let rows: Vec<usize> = (0..self.t_s.len()).filter(|&row| at_rest || moves[row]).collect();
        Error {
            length: self.size(&self.length, &rows),
            angle: self.angle.as_ref().map(|angle| self.size(angle, &rows)),
        }
    }

    fn size(&self, error: &[Vec3], rows: &[usize]) -> Size {
        let parts = (rows.len() / PART_SAMPLES).clamp(1, PARTS);
        let parts = (0..parts)
            .map(|part| &rows[part * rows.len() / parts..(part + 1) * rows.len() / parts]);
        let part = |rows: &[usize]| {
            let amount = self.amount(error, rows);
            let (first, last) = (*rows.first()?, *rows.last()?);
            let at = self.where_largest(error, rows, amount.most);
            Some(Part { from_s: self.t_s[first], to_s: self.t_s[last], at, amount })
        };
        Size { whole: self.amount(error, rows), parts: parts.filter_map(part).collect() }
    }

    /// The mean place of the tip over the samples whose error is as large as `most`.
    fn where_largest(&self, error: &[Vec3], rows: &[usize], most: f64) -> Vec3 {
        let large = rows.iter().filter(|&&row| error[row].norm() >= most);
        let places: Vec<Vec3> = large.map(|&row| self.fk[row].translation.vector).collect();
        places.iter().sum::<Vec3>() / places.len().max(1) as f64
    }

    fn amount(&self, error: &[Vec3], rows: &[usize]) -> Amount {
        let [rms, most] = sizes(rows.iter().map(|&row| error[row].norm()).collect());
        Amount { samples: rows.len(), rms, most, noise: self.noise(error, rows) }
    }

    /// What differs from sample to sample, over each distance at which the motion hardly shows: the
    /// most of it, as noise that remembers shows at the longer ones only.
    fn noise(&self, error: &[Vec3], rows: &[usize]) -> Option<Short> {
        let distances = std::iter::successors(Some(1), |k| Some(2 * k));
        let noises = distances.take_while(|&k| k <= self.short).filter_map(|over| {
            let span_s = over as f64 * self.period_s;
            let is_whole = |from: usize, to: usize| {
                (self.t_s[to] - self.t_s[from] - span_s).abs() < 0.5 * span_s
            };
            let difference = |&row: &usize| {
                let (before, after) = (row.checked_sub(over)?, row + over);
                let is_even = after < error.len() && is_whole(before, row) && is_whole(row, after);
                // Of independent noise the square is six times its own.
                is_even
                    .then(|| (error[before] - 2.0 * error[row] + error[after]).norm() / 6f64.sqrt())
            };
            let differences: Vec<f64> = rows.iter().filter_map(difference).collect();
            let enough = differences.len() >= NEED;
            let [rms, most] = sizes(differences);
            enough.then_some(Short { rms, most, over })
        });
        noises.max_by(|a, b| a.rms.total_cmp(&b.rms))
    }
}

/// Root mean square, where what is beyond the quantile counts as much as that, and the quantile.
fn sizes(mut sizes: Vec<f64>) -> [f64; 2] {
    if sizes.is_empty() {
        return [0.0; 2];
    }
    let at = ((sizes.len() - 1) as f64 * MOST) as usize;
    let most = *sizes.select_nth_unstable_by(at, f64::total_cmp).1;
    let squares: f64 = sizes.iter().map(|size| size.min(most).powi(2)).sum();
    [(squares / sizes.len() as f64).sqrt(), most]
}

/// Three points of the tip, which show how it moves and turns: itself, and two beside it from it, m.
type Points = [Vec3; 3];

fn tip_points(fk: &[Pose]) -> Vec<Points> {
    let points = |pose: &Pose| {
        let [x, y] = [Vec3::x(), Vec3::y()].map(|axis| pose.rotation * axis * ARM_M);
        [pose.translation.vector, x, y]
    };
    fk.iter().map(points).collect()
}

/// The square of how far apart two sets of points are, m².
fn apart(a: &Points, b: &Points) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum()
}

/// The mean square of how far points are from their mean, m².
fn variance(points: &[Points]) -> f64 {
    let n = points.len().max(1) as f64;
    let mean: Points =
        std::array::from_fn(|of| points.iter().map(|points| points[of]).sum::<Vec3>() / n);
    points.iter().map(|points| apart(points, &mean)).sum::<f64>() / n
}

/// The time after which the pose of the tip is half another, s: its mean square change is half of what
/// it is between any two times. Infinite where the tip does not move.
fn memory_s(t_s: &[f64], fk: &[Pose], period_s: f64) -> f64 {
    let stride = fk.len().div_ceil(MEMORY_SAMPLES).max(1);
    let points = tip_points(fk);
    let variance = variance(&points);
    let mut before = (0, 0.0);
    let mut k = 1;
    while k < points.len() {
        let span_s = k as f64 * period_s;
        let (mut sum, mut count) = (0.0, 0.0);
        for row in (k..points.len()).step_by(stride) {
            if (t_s[row] - t_s[row - k] - span_s).abs() < 0.5 * span_s {
                sum += apart(&points[row], &points[row - k]);
                count += 1.0;
            }
        }
        // 2·(1 − ρ)·variance, ρ the correlation after k samples.
        let change = if count > 0.0 { sum / count } else { 0.0 };
        if change >= variance {
            let (from, at) = before;
            let share = (variance - at) / (change - at).max(f64::MIN_POSITIVE);
            return (from as f64 + share * (k - from) as f64) * period_s;
        }
        before = (k, change);
        k += k.div_ceil(4);
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::rotation_from_rotvec;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const N: usize = 4000;

    /// 32 s of a tip that swings through half a metre every 4 s, at 125 Hz.
    fn motion() -> (Vec<f64>, Vec<Pose>) {
        let t_s: Vec<f64> = (0..N).map(|row| row as f64 / 125.0).collect();
        let at = |t_s: &f64| {
            let phase = t_s * std::f64::consts::TAU / 4.0;
            let turn = rotation_from_rotvec(Vec3::new(0.4 * phase.sin(), 0.0, 0.0));
            pose([0.25 * phase.sin(), 0.2 * (0.7 * phase).cos(), 0.4], turn)
        };
        let fk = t_s.iter().map(at).collect();
        (t_s, fk)
    }

    /// Noise of 1 mm a component that remembers by `rho` from sample to sample.
    fn noise(rho: f64, seed: u64) -> Vec<Vec3> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut state = Vec3::zeros();
        let mut next = || {
            let new: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            state = state * rho + Vec3::from(new) * 1e-3 * (1.0 - rho * rho).sqrt();
            state
        };
        (0..N).map(|_| next()).collect()
    }

    fn size_of(error: Vec<Vec3>) -> Size {
        let (t_s, fk) = motion();
        Series::new(&t_s, &fk, error, None).error(&[true; N], false).length
    }

    /// How many times the noise the error is in its worst part.
    fn beyond(size: &Size) -> f64 {
        let amount = size.worst().expect("a part").amount;
        amount.rms / amount.noise.expect("its noise").rms
    }

    #[test]
    fn noise_is_noise_whether_or_not_it_remembers() {
        for (seed, rho) in [(1, 0.0), (2, 0.6), (3, 0.9)] {
            let size = size_of(noise(rho, seed));
            assert!(beyond(&size) < 1.6, "{rho}: {}", beyond(&size));
        }
    }

    #[test]
    fn a_step_is_far_beyond_the_noise_and_begins_where_it_does() {
        let mut error = noise(0.6, 4);
        error[2000..].iter_mut().for_each(|error| error.x += 0.07);
        let size = size_of(error);
        assert!(beyond(&size) > 20.0, "{}", beyond(&size));
        let large: Vec<f64> = size
            .parts
            .iter()
            .filter(|part| part.amount.most > 0.02)
            .map(|part| part.from_s)
            .collect();
        assert_eq!(large.len(), 5);
        assert!((large[0] - 16.0).abs() < 0.1, "{large:?}");
    }

    #[test]
    fn what_comes_again_with_the_posture_is_no_noise() {
        let (_, fk) = motion();
        let bent = fk.iter().map(|fk| fk.translation.vector.cross(&Vec3::z()) * 0.02);
        let error = bent.zip(noise(0.0, 5)).map(|(bent, noise)| bent + 0.1 * noise).collect();
        assert!(beyond(&size_of(error)) > 5.0);
    }

    #[test]
    fn single_strays_do_not_count() {
        let mut error = noise(0.0, 6);
        let before = size_of(error.clone()).whole.most;
        (0..N).step_by(200).for_each(|row| error[row].z = 3.0);
        assert!(size_of(error).whole.most < 1.2 * before);
    }

    #[test]
    fn samples_as_far_apart_as_the_motion_tell_no_noise() {
        let (t_s, fk) = motion();
        let few: Vec<usize> = (0..N).step_by(125).collect();
        let (t_s, fk): (Vec<f64>, Vec<Pose>) = few.iter().map(|&row| (t_s[row], fk[row])).unzip();
        let series = Series::new(&t_s, &fk, vec![Vec3::x(); few.len()], None);
        assert_eq!(series.error(&vec![true; few.len()], false).length.whole.noise, None);
    }
}
