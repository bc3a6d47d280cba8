//! Compares a stream directly with FK, as logged and corrected, without the estimators. A `pass` requires
//! it.
//!
//! An error that lasts for part of the run is large there, whatever its mean. Its size is therefore a high
//! quantile, robust to single outliers, over the run and over each tenth of the moving run. Its noise must
//! not come from the error itself, because a tool that slips resembles one long fluctuation. It comes from
//! second differences over times with little motion (von Neumann 1941; Hall, Kay and Titterington 1990).

use crate::latency::correlation::median_period_s;
use crate::model::jacobian::pose_changes;
use crate::model::measurement::{PoseObservations, StreamState};
use crate::model::observability::travel;
use crate::priors::LEVER_M;
use crate::samples::sampling::{FkSequence, as_rotations, check_sample_count, rest_speeds};
use crate::selection::nominal_model::calibrated_residuals;
use crate::{AlignedSamples, EstimateResult, NotObservable, PoseDiagnosis, PoseStream};
use ground::geometry::{Pose, Vec3, mean_vector, pose};
use ground::stats::{mean, median};
use ground::stream::{JointTrack, Orientations};

/// Defines the size of an error.
const ERROR_QUANTILE: f64 = 0.95;
/// Parts of the moving run.
const MAX_PARTS: usize = 10;
/// Shorter runs have fewer parts.
const MIN_PART_SAMPLES: usize = 20;
const MIN_SAMPLES: usize = 8;
/// With fewer, the arm rests.
const MIN_MOVING_SAMPLES: usize = 10;
/// Rms of the tip's points.
const MAX_REST_SPREAD_M: f64 = 2e-3;
/// Joint range, rad or m: 3°, as for joint zeros.
const MAX_SINGLE_CONFIGURATION_RANGE: f64 = 0.05;
/// Relative to the motion's correlation time.
const MAX_NOISE_SPAN_SHARE: f64 = 0.25;
/// For the motion's correlation time.
const CORRELATION_SAMPLES: usize = 2000;
const MAX_CALIBRATION_SAMPLES: usize = 5000;

/// Error of a stream against FK.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResidualCheck {
    /// Whether the arm rests, so few configurations count.
    pub is_at_rest: bool,
    /// As logged, against recorded FK.
    pub as_logged: FkError,
    /// After correcting all findings.
    pub corrected: Option<FkError>,
    /// Only poses corrected, not joints and times: names, units, zeros, latency, skew.
    pub poses_corrected: Option<FkError>,
    /// Only joints and times corrected, not poses: encoding, units, frames.
    pub joints_corrected: Option<FkError>,
    /// All findings and small changes of every link frame corrected, as by a calibration.
    pub calibrated: Option<FkError>,
}

/// Differences from FK.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FkError {
    /// Position error, m.
    pub length: ErrorSize,
    /// Rotation error, rad. `None` for bare numbers, and without recorded rotations.
    pub angle: Option<ErrorSize>,
}

/// Size of an error over the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorSize {
    /// Whole run.
    pub whole: ErrorMagnitude,
    /// Parts in time order.
    pub parts: Vec<PartError>,
}

/// Size of an error, m or rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorMagnitude {
    /// Samples.
    pub samples: usize,
    /// Rms, outliers clipped to the quantile.
    pub rms: f64,
    /// 95 % quantile.
    pub quantile_95: f64,
    /// `None` if samples are too sparse to separate noise from motion.
    pub noise: Option<SampleNoise>,
}

/// Noise between samples, m or rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleNoise {
    /// Rms.
    pub rms: f64,
    /// 95 % quantile.
    pub quantile_95: f64,
    /// Lag of differences, samples.
    pub lag_samples: usize,
}

/// Part of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartError {
    /// Start, s from the run's origin.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// FK position of the largest error, reference frame, m.
    pub at: Vec3,
    /// Error size.
    pub magnitude: ErrorMagnitude,
}

impl ErrorSize {
    /// Part with the largest error, if any.
    pub fn worst(&self) -> Option<&PartError> {
        self.parts.iter().max_by(|a, b| a.magnitude.quantile_95.total_cmp(&b.magnitude.quantile_95))
    }
}

/// Error as logged and corrected for `diagnosis`, with corrected joint states `corrected_joints`.
///
/// # Errors
/// If the joint states cover too few samples.
pub fn check_residual(
    joints: &JointTrack,
    corrected_joints: &JointTrack,
    stream: &PoseStream,
    diagnosis: &PoseDiagnosis,
) -> EstimateResult<ResidualCheck> {
    let logged = align_with_fk(joints, stream);
    if logged.t_s.is_empty() {
        return Err(NotObservable::NoOverlap);
    }
    check_sample_count(logged.t_s.len(), MIN_SAMPLES)?;
    // The tip rests during null-space motion of a seven-joint arm.
    let is_in_one_posture = variance(&tip_points(&logged.fk)) < MAX_REST_SPREAD_M.powi(2)
        && stream
            .columns
            .iter()
            .all(|&column| travel(joints, column) < MAX_SINGLE_CONFIGURATION_RANGE);
    let moving = moving_rows(joints, stream, &logged.t_s);
    let is_at_rest = moving.len() < MIN_MOVING_SAMPLES || is_in_one_posture;
    let rows = |moving: Vec<usize>, t_s: &[f64]| match is_at_rest {
        true => (0..t_s.len()).collect(),
        false => moving,
    };
    let has_rotation = matches!(stream.track.orientation, Orientations::Rotations(_));
    let has_decoded_rotation = !matches!(stream.track.orientation, Orientations::Unset(_));
    let as_logged = ErrorSeries::from_poses(&logged.t_s, &logged.logged, &logged.fk, has_rotation)
        .error(&rows(moving, &logged.t_s));
    let AlignedSamples { t_s, logged, fk, corrected, fk_at_truth, .. } = &diagnosis.aligned;
    let rows = rows(moving_rows(joints, stream, t_s), t_s);
    let error = |poses: &[Pose], fk: &[Pose], has_rotation: bool| {
        let series = ErrorSeries::from_poses(t_s, poses, fk, has_rotation);
        (t_s.len() >= MIN_SAMPLES).then(|| series.error(&rows))
    };
    let true_joints = if diagnosis.is_derived { joints } else { corrected_joints };
    let calibrated = || residual_with_calibration(true_joints, stream, diagnosis);
    Ok(ResidualCheck {
        is_at_rest,
        as_logged,
        corrected: error(corrected, fk_at_truth, has_decoded_rotation),
        poses_corrected: error(corrected, fk, has_decoded_rotation),
        joints_corrected: error(logged, fk_at_truth, has_rotation),
        calibrated: (!is_at_rest && t_s.len() >= MIN_SAMPLES).then(calibrated).flatten(),
    })
}

fn residual_with_calibration(
    corrected_joints: &JointTrack,
    stream: &PoseStream,
    diagnosis: &PoseDiagnosis,
) -> Option<FkError> {
    let AlignedSamples { t_s, corrected, fk_at_truth, .. } = &diagnosis.aligned;
    let still = rest_speeds(corrected_joints);
    let PoseStream { chain, columns, moving_frame, .. } = *stream;
    let observations = PoseObservations {
        moving_frame,
        ..PoseObservations::new(corrected_joints, chain, columns, &still, t_s, corrected)
    };
    let plain = StreamState {
        skew: diagnosis.chosen_skew(),
        ..StreamState::at_latency(diagnosis.latency_s.as_ref().map_or(0.0, |latency| latency.value))
    };
    let none = vec![0.0; corrected_joints.dof];
    let stream_at = observations.at(&plain, &none);
    let mut predictor = stream_at.predictor();
    let rows: Vec<usize> = observations
        .rows(MAX_CALIBRATION_SAMPLES)
        .filter(|&row| predictor.at(row).is_some())
        .collect();
    let kinds = calibrated_residuals(stream_at, diagnosis.link_m, MAX_CALIBRATION_SAMPLES);
    let [length, angle] = kinds.try_into().ok()?;
    let t_s: Vec<f64> = rows.iter().map(|&row| t_s[row]).collect();
    let fk: Vec<Pose> = rows.iter().map(|&row| fk_at_truth[row]).collect();
    let moving = moving_rows(corrected_joints, stream, &t_s);
    let has_rotation = !matches!(stream.track.orientation, Orientations::Unset(_));
    let angle = has_rotation.then_some(angle);
    Some(ErrorSeries::new(&t_s, &fk, length, angle).error(&moving))
}

/// Samples with FK at their stamps. Fills only `t_s`, `logged` and `fk`.
pub(crate) fn align_with_fk(joints: &JointTrack, stream: &PoseStream) -> AlignedSamples {
    let track = stream.track;
    let rotations = as_rotations(&track.orientation);
    let mut sequence = FkSequence::new(joints, stream.chain, stream.columns);
    let mut aligned = AlignedSamples::default();
    for (row, &t_s) in track.t_s.iter().enumerate() {
        let Some(fk) = sequence.at(t_s) else { continue };
        let rotation = rotations.map(|all| all[row]).unwrap_or_default();
        aligned.t_s.push(t_s);
        aligned.logged.push(pose(track.xyz[row].into(), rotation));
        aligned.fk.push(fk);
    }
    aligned
}

/// Rows of the stamps at which a joint of the chain moves.
fn moving_rows(joints: &JointTrack, stream: &PoseStream, t_s: &[f64]) -> Vec<usize> {
    let still = rest_speeds(joints);
    let mut sequence = joints.sequence();
    let mut moves = |row: &usize| {
        sequence.at(t_s[*row]).is_some_and(|(_, qd)| {
            stream.columns.iter().any(|&column| qd[column].abs() > still[column])
        })
    };
    (0..t_s.len()).filter(|row| moves(row)).collect()
}

pub(crate) struct ErrorSeries<'a> {
    t_s: &'a [f64],
    fk: &'a [Pose],
    length: Vec<Vec3>,
    angle: Option<Vec<Vec3>>,
    /// Longest lag, in samples, with negligible motion; 0 without such a lag.
    short: usize,
    period_s: f64,
}

impl<'a> ErrorSeries<'a> {
    pub fn from_poses(t_s: &'a [f64], poses: &[Pose], fk: &'a [Pose], has_rotation: bool) -> Self {
        let [length, angle] = pose_changes(fk, poses);
        Self::new(t_s, fk, length, has_rotation.then_some(angle))
    }

    pub fn new(
        t_s: &'a [f64],
        fk: &'a [Pose],
        length: Vec<Vec3>,
        angle: Option<Vec<Vec3>>,
    ) -> Self {
        let period_s = median_period_s(t_s);
        let short = MAX_NOISE_SPAN_SHARE * correlation_time_s(t_s, fk, period_s)
            / period_s.max(f64::MIN_POSITIVE);
        let short = (short as usize).min(t_s.len() / 4);
        Self { t_s, fk, length, angle, short, period_s }
    }

    pub fn error(&self, rows: &[usize]) -> FkError {
        FkError {
            length: self.size(&self.length, rows),
            angle: self.angle.as_ref().map(|angle| self.size(angle, rows)),
        }
    }

    fn size(&self, error: &[Vec3], rows: &[usize]) -> ErrorSize {
        let parts = (rows.len() / MIN_PART_SAMPLES).clamp(1, MAX_PARTS);
        let parts = (0..parts)
            .map(|part| &rows[part * rows.len() / parts..(part + 1) * rows.len() / parts]);
        let part = |rows: &[usize]| {
            let magnitude = self.magnitude(error, rows);
            let (from_s, to_s) = (self.t_s[*rows.first()?], self.t_s[*rows.last()?]);
            let large = rows.iter().filter(|&&row| error[row].norm() >= magnitude.quantile_95);
            let at = mean_vector(large.map(|&row| self.fk[row].translation.vector));
            Some(PartError { from_s, to_s, at, magnitude })
        };
        let mut parts: Vec<PartError> = parts.filter_map(part).collect();
        limit_noise(&mut parts);
        ErrorSize { whole: self.magnitude(error, rows), parts }
    }

    fn magnitude(&self, error: &[Vec3], rows: &[usize]) -> ErrorMagnitude {
        let [rms, quantile_95] = sizes(rows.iter().map(|&row| error[row].norm()).collect());
        ErrorMagnitude { samples: rows.len(), rms, quantile_95, noise: self.noise(error, rows) }
    }

    /// The largest over lags with negligible motion, because correlated noise appears only at longer lags.
    fn noise(&self, error: &[Vec3], rows: &[usize]) -> Option<SampleNoise> {
        let distances = std::iter::successors(Some(1), |k| Some(2 * k));
        let noises = distances.take_while(|&k| k <= self.short).filter_map(|over| {
            let span_s = over as f64 * self.period_s;
            let is_whole = |from: usize, to: usize| {
                (self.t_s[to] - self.t_s[from] - span_s).abs() < 0.5 * span_s
            };
            let difference = |&row: &usize| {
                let (before, after) = (row.checked_sub(over)?, row + over);
                let is_even = after < error.len() && is_whole(before, row) && is_whole(row, after);
                // Their variance is six times the variance of independent noise.
                is_even
                    .then(|| (error[before] - 2.0 * error[row] + error[after]).norm() / 6f64.sqrt())
            };
            let differences: Vec<f64> = rows.iter().filter_map(difference).collect();
            let has_enough = differences.len() >= MIN_SAMPLES;
            let [rms, quantile_95] = sizes(differences);
            has_enough.then_some(SampleNoise { rms, quantile_95, lag_samples: over })
        });
        noises.max_by(|a, b| a.rms.total_cmp(&b.rms))
    }
}

/// Limits the noise of each part by the noise of the others, because an error may jump within a part.
fn limit_noise(parts: &mut [PartError]) {
    /// To the median. Noise that grows with speed differs between parts.
    const MAX_NOISE_RATIO: f64 = 3.0;
    let noises = parts.iter().filter_map(|part| Some(part.magnitude.noise?.quantile_95));
    let Some(median) = median(&mut noises.collect::<Vec<f64>>()) else { return };
    for noise in parts.iter_mut().filter_map(|part| part.magnitude.noise.as_mut()) {
        let share = (MAX_NOISE_RATIO * median / noise.quantile_95).min(1.0);
        if share.is_finite() {
            noise.rms *= share;
            noise.quantile_95 *= share;
        }
    }
}

/// Rms clipped to the quantile, and the quantile.
fn sizes(mut sizes: Vec<f64>) -> [f64; 2] {
    if sizes.is_empty() {
        return [0.0; 2];
    }
    let at = ((sizes.len() - 1) as f64 * ERROR_QUANTILE) as usize;
    let quantile = *sizes.select_nth_unstable_by(at, f64::total_cmp).1;
    let squares: f64 = sizes.iter().map(|size| size.min(quantile).powi(2)).sum();
    [(squares / sizes.len() as f64).sqrt(), quantile]
}

/// Origin of the tip, and two levers from it, m.
type TipPoints = [Vec3; 3];

fn tip_points(fk: &[Pose]) -> Vec<TipPoints> {
    let points = |pose: &Pose| {
        let [x, y] = [Vec3::x(), Vec3::y()].map(|axis| pose.rotation * axis * LEVER_M);
        [pose.translation.vector, x, y]
    };
    fk.iter().map(points).collect()
}

fn squared_distance(a: &TipPoints, b: &TipPoints) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum()
}

/// m².
fn variance(points: &[TipPoints]) -> f64 {
    let middle: TipPoints =
        std::array::from_fn(|of| mean_vector(points.iter().map(|points| points[of])));
    mean(points.iter().map(|points| squared_distance(points, &middle)))
}

/// Time after which the tip's mean squared change is half that between random times, s. Infinite without
/// motion.
fn correlation_time_s(t_s: &[f64], fk: &[Pose], period_s: f64) -> f64 {
    let stride = fk.len().div_ceil(CORRELATION_SAMPLES).max(1);
    let points = tip_points(fk);
    let variance = variance(&points);
    let mut before = (0, 0.0);
    let mut k = 1;
    while k < points.len() {
        let span_s = k as f64 * period_s;
        let (mut sum, mut count) = (0.0, 0.0);
        for row in (k..points.len()).step_by(stride) {
            if (t_s[row] - t_s[row - k] - span_s).abs() < 0.5 * span_s {
                sum += squared_distance(&points[row], &points[row - k]);
                count += 1.0;
            }
        }
        // 2·(1 − ρ)·variance, for correlation ρ.
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

    /// 32 s at 125 Hz: half a metre every 4 s.
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

    /// Autoregressive, 1 mm per component.
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

    fn size_of(error: Vec<Vec3>) -> ErrorSize {
        let (t_s, fk) = motion();
        ErrorSeries::new(&t_s, &fk, error, None).error(&Vec::from_iter(0..N)).length
    }

    fn beyond(size: &ErrorSize) -> f64 {
        let amount = size.worst().expect("a part").magnitude;
        amount.rms / amount.noise.expect("its noise").rms
    }

    #[test]
    fn white_and_autocorrelated_noise_stay_within_the_noise_estimate() {
        for (seed, rho) in [(1, 0.0), (2, 0.6), (3, 0.9)] {
            let size = size_of(noise(rho, seed));
            assert!(beyond(&size) < 1.6, "{rho}: {}", beyond(&size));
        }
    }

    #[test]
    fn an_error_that_leaps_within_a_part_is_no_noise() {
        let mut error = noise(0.0, 7);
        error[2100..2160].iter_mut().for_each(|error| error.x += 0.05);
        let size = size_of(error);
        let part = size.worst().expect("a part").magnitude;
        let noise = part.noise.expect("its noise");
        assert!(part.quantile_95 > 5.0 * noise.quantile_95, "{part:?}");
    }

    #[test]
    fn a_step_exceeds_the_noise_from_the_part_where_it_begins() {
        let mut error = noise(0.6, 4);
        error[2000..].iter_mut().for_each(|error| error.x += 0.07);
        let size = size_of(error);
        assert!(beyond(&size) > 20.0, "{}", beyond(&size));
        let large: Vec<f64> = size
            .parts
            .iter()
            .filter(|part| part.magnitude.quantile_95 > 0.02)
            .map(|part| part.from_s)
            .collect();
        assert_eq!(large.len(), 5);
        assert!((large[0] - 16.0).abs() < 0.1, "{large:?}");
    }

    #[test]
    fn a_configuration_dependent_error_is_no_noise() {
        let (_, fk) = motion();
        let bent = fk.iter().map(|fk| fk.translation.vector.cross(&Vec3::z()) * 0.02);
        let error = bent.zip(noise(0.0, 5)).map(|(bent, noise)| bent + 0.1 * noise).collect();
        assert!(beyond(&size_of(error)) > 5.0);
    }

    #[test]
    fn single_outliers_do_not_count() {
        let mut error = noise(0.0, 6);
        let before = size_of(error.clone()).whole.quantile_95;
        (0..N).step_by(200).for_each(|row| error[row].z = 3.0);
        assert!(size_of(error).whole.quantile_95 < 1.2 * before);
    }

    #[test]
    fn sparse_samples_give_no_noise_estimate() {
        let (t_s, fk) = motion();
        let few: Vec<usize> = (0..N).step_by(125).collect();
        let (t_s, fk): (Vec<f64>, Vec<Pose>) = few.iter().map(|&row| (t_s[row], fk[row])).unzip();
        let series = ErrorSeries::new(&t_s, &fk, vec![Vec3::x(); few.len()], None);
        assert_eq!(series.error(&Vec::from_iter(0..few.len())).length.whole.noise, None);
    }
}
