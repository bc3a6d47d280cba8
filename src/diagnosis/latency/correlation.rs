//! Coarse latency, from the correlation of the stream's speed with the arm's. Speed does not depend on the
//! reference frame, so nothing else need be known. A tool offset or wrong convention biases the lag by
//! milliseconds; the model fit refines it.

use std::cell::RefCell;
use std::ops::Range;

use crate::PoseStream;
use crate::model::jacobian::PoseJacobian;
use crate::model::moving_frame::MovingFrame;
use crate::samples::sampling::{as_rotations, row_blocks};
use ground::geometry::{Pose, Rotation, Vec3, angle_between};
use ground::robot::Chain;
use ground::stats::thin::thinned;
use ground::stats::{cumulative, highest, median_of, parabola_minimum};
use ground::stream::{JointTrack, PoseTrack, bracket};
use realfft::RealFftPlanner;

/// Candidate lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LagPeak {
    /// Latency, s. Positive if the stream is late.
    pub lag_s: f64,
    /// Pearson correlation over the common span, −1 to 1.
    pub correlation: f64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct SpeedSeries {
    pub t_s: Vec<f64>,
    pub value: Vec<f64>,
}

impl SpeedSeries {
    pub fn at_rows(&self, rows: impl IntoIterator<Item = usize>) -> Self {
        let (t_s, value) = rows.into_iter().map(|row| (self.t_s[row], self.value[row])).unzip();
        Self { t_s, value }
    }

    /// First and last time, s.
    pub fn span_s(&self) -> Option<(f64, f64)> {
        Some((*self.t_s.first()?, *self.t_s.last()?))
    }

    /// Interpolated, fastest near the last interval. `None` outside the series and in gaps of `max_gap_s` or more.
    pub fn at(&self, t_s: f64, max_gap_s: f64, left: &mut usize) -> Option<f64> {
        let Self { t_s: times, value } = self;
        let before = bracket(times, t_s, left)?;
        let part = (t_s - times[before]) / (times[before + 1] - times[before]);
        let is_known = part == 0.0 || part == 1.0 || times[before + 1] - times[before] < max_gap_s;
        is_known.then(|| value[before] + part * (value[before + 1] - value[before]))
    }
}

/// Speeds of an arm by FK at the joint stamps.
pub(crate) struct ArmSpeeds {
    /// Tip, m/s.
    pub linear: SpeedSeries,
    /// Tip, rad/s.
    pub angular: SpeedSeries,
    /// Base in the tip frame, m/s.
    inverse: SpeedSeries,
}

impl ArmSpeeds {
    pub fn from_joints(joints: &JointTrack, chain: &Chain, columns: &[usize]) -> Self {
        Self::in_frame(joints, chain, columns, None)
    }

    /// Speeds in the frame of the logged poses, if it moves in the base. Times without a velocity of it are omitted.
    pub fn in_frame(
        joints: &JointTrack,
        chain: &Chain,
        columns: &[usize],
        frame: Option<&MovingFrame>,
    ) -> Self {
        /// More do not improve the correlation.
        const MAX_ROWS: usize = 30_000;
        let mut jacobian = vec![[0.0; 6]; columns.len()];
        let identity = Pose::identity();
        let mut speeds: [SpeedSeries; 3] = Default::default();
        for row in thinned(0..joints.len(), MAX_ROWS) {
            let t_s = joints.t_s[row];
            let base = frame.map_or(Some([Vec3::zeros(); 2]), |frame| frame.base_velocity(t_s));
            let Some([base_linear, base_angular]) = base else { continue };
            let q = joints.positions_at(row, columns);
            let qd: Vec<f64> = columns.iter().map(|&joint| joints.velocities(row)[joint]).collect();
            let base_from_tip = chain.forward_with_jacobian(&q, &mut jacobian);
            let tip = base_from_tip.translation.vector;
            let jacobian = PoseJacobian::new(&jacobian, &identity, &base_from_tip, &identity);
            let [linear, angular] = jacobian.velocity(&qd);
            let linear = linear + base_linear + base_angular.cross(&tip);
            let angular = angular + base_angular;
            // Derivative of −Rᵀp: −Rᵀ(v − ω × p).
            let inverse = linear - angular.cross(&tip);
            for (speed, vector) in speeds.iter_mut().zip([linear, angular, inverse]) {
                speed.t_s.push(t_s);
                speed.value.push(vector.norm());
            }
        }
        let [linear, angular, inverse] = speeds;
        Self { linear, angular, inverse }
    }

    /// Maximum tip speed, m/s.
    pub fn top_m_s(&self) -> f64 {
        self.linear.value.iter().copied().fold(0.0, f64::max)
    }

    /// Candidate lags from the speed (linear or angular) that correlates best.
    pub fn lag_peaks(
        &self,
        t_s: &[f64],
        xyz: &[Vec3],
        rotation: Option<&[Rotation]>,
        max_lag_s: f64,
    ) -> Vec<LagPeak> {
        let linear = linear_speed(t_s, xyz);
        // Inverse poses can be identified without rotations.
        let mut found = vec![
            lag_peaks(&self.linear, &linear, max_lag_s),
            lag_peaks(&self.inverse, &linear, max_lag_s),
        ];
        if let Some(rotation) = rotation {
            found.push(lag_peaks(&self.angular, &angular_speed(t_s, rotation), max_lag_s));
            // Of the origin of inverse poses.
            let origin = rotation.iter().zip(xyz).map(|(turn, xyz)| turn.inverse() * xyz);
            let inverse = linear_speed(t_s, &origin.collect::<Vec<Vec3>>());
            found.push(lag_peaks(&self.linear, &inverse, max_lag_s));
        }
        let best = |peaks: &Vec<LagPeak>| peaks.first().map_or(f64::MIN, |peak| peak.correlation);
        highest(found, best).unwrap_or_default()
    }
}

/// Lags of the two highest correlations of the combined joint speeds with a stream's speed, if they are high enough.
pub(crate) fn joint_speed_lags(
    joints: &JointTrack,
    units: &[f64],
    speed: &SpeedSeries,
    max_lag_s: f64,
) -> Vec<f64> {
    const MIN_CORRELATION: f64 = 0.4;
    let rows = joints.qd.chunks_exact(joints.dof.max(1));
    let value = rows.map(|row| combined_speed(row, units)).collect();
    let of_joints = SpeedSeries { t_s: joints.t_s.clone(), value };
    let peaks = lag_peaks(&of_joints, speed, max_lag_s).into_iter();
    let high = peaks.filter(|peak| peak.correlation > MIN_CORRELATION);
    high.take(2).map(|peak| peak.lag_s).collect()
}

/// Root of the sum of squared joint speeds, each in its unit. Without units, invariant to permuted joint names.
pub(crate) fn combined_speed(speeds: &[f64], units: &[f64]) -> f64 {
    speeds.iter().zip(units).map(|(speed, unit)| (speed / unit).powi(2)).sum::<f64>().sqrt()
}

/// Speed between samples `window_s` apart.
pub(crate) fn differenced_speed(
    t_s: &[f64],
    window_s: f64,
    distance: impl Fn(usize, usize) -> f64,
) -> SpeedSeries {
    let mut speed = SpeedSeries::default();
    let mut first = 0;
    for last in 0..t_s.len() {
        while first + 1 < last && t_s[last] - t_s[first + 1] >= window_s {
            first += 1;
        }
        let span = t_s[last] - t_s[first];
        if span >= window_s && span < 4.0 * window_s {
            speed.t_s.push(0.5 * (t_s[last] + t_s[first]));
            speed.value.push(distance(first, last) / span);
        }
    }
    speed
}

/// Averaging time, s: long relative to noise, short relative to a motion.
pub(crate) fn window_s(t_s: &[f64]) -> f64 {
    (2.5 * median_period_s(t_s)).clamp(0.02, 0.2)
}

pub(crate) fn median_period_s(t_s: &[f64]) -> f64 {
    /// More do not improve the median.
    const MAX_INTERVALS: usize = 5_000;
    let stretches = row_blocks(t_s.len(), MAX_INTERVALS);
    let periods = stretches.flat_map(|rows| t_s[rows].windows(2).map(|pair| pair[1] - pair[0]));
    median_of(periods).unwrap_or(0.0)
}

/// Position speed, in the logged unit per second.
pub(crate) fn linear_speed(t_s: &[f64], xyz: &[Vec3]) -> SpeedSeries {
    differenced_speed(t_s, window_s(t_s), |a, b| (xyz[b] - xyz[a]).norm())
}

/// rad/s.
pub(crate) fn angular_speed(t_s: &[f64], rotation: &[Rotation]) -> SpeedSeries {
    differenced_speed(t_s, window_s(t_s), |a, b| angle_between(&rotation[a], &rotation[b]))
}

pub(crate) fn norm_series(t_s: &[f64], vectors: &[Vec3]) -> SpeedSeries {
    SpeedSeries { t_s: t_s.to_vec(), value: vectors.iter().map(Vec3::norm).collect() }
}

/// Lags within ±`max_lag_s` at correlation peaks, best first; of nearly equal ones, as in periodic motion, the shortest
/// first. Empty without motion or a common span.
pub(crate) fn lag_peaks(arm: &SpeedSeries, stream: &SpeedSeries, max_lag_s: f64) -> Vec<LagPeak> {
    let by_lag = correlation_by_lag(arm, stream, max_lag_s);
    let mut peaks: Vec<LagPeak> = by_lag
        .windows(3)
        .filter_map(|around| {
            let [a, b, c] = [0, 1, 2].map(|at| around[at].correlation);
            let is_peak = b.is_finite() && b >= a && b > c;
            let shift = parabola_minimum([-a, -b, -c]);
            let step = around[2].lag_s - around[1].lag_s;
            let peak = LagPeak { lag_s: around[1].lag_s + shift * step, correlation: b };
            is_peak.then_some(peak)
        })
        .collect();
    peaks.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let equal = equal_peaks(&peaks);
    peaks[..equal].sort_by(|a, b| a.lag_s.abs().total_cmp(&b.lag_s.abs()));
    peaks
}

/// Number of peaks with nearly the highest correlation, which come first.
pub(crate) fn equal_peaks(peaks: &[LagPeak]) -> usize {
    let best = peaks.iter().map(|peak| peak.correlation).fold(f64::MIN, f64::max);
    let is_equal = |peak: &&LagPeak| 1.0 - peak.correlation < 1.2 * (1.0 - best) + 1e-4;
    peaks.iter().take_while(is_equal).count()
}

/// Correlation at evenly spaced lags within ±`max_lag_s`. NaN if not comparable. Empty without a common span.
/// Long gaps split the arm's speed into pieces, whose sums are added.
pub(crate) fn correlation_by_lag(
    arm: &SpeedSeries,
    stream: &SpeedSeries,
    max_lag_s: f64,
) -> Vec<LagPeak> {
    /// Over all pieces.
    const MAX_STEPS: f64 = 30_000.0;
    let periods = [arm, stream].map(|speed| median_period_s(&speed.t_s));
    let silences = periods.map(max_gap_s);
    let unbroken_spans = unbroken_spans(&arm.t_s, silences[0]);
    let covered_s: f64 = unbroken_spans.iter().map(|(start, end)| end - start).sum();
    let step = periods[0].max(periods[1]).clamp(0.004, 0.02).max(covered_s / MAX_STEPS);
    if stream.t_s.is_empty() || covered_s < 20.0 * step {
        return Vec::new();
    }
    let lags = (max_lag_s.min(covered_s / 3.0) / step).floor() as usize;
    let mut sums =
        CorrelationSums { sums: std::array::from_fn(|_| vec![0.0; 2 * lags + 1]), known: [0.0; 2] };
    for (start, end) in unbroken_spans {
        let count = ((end - start) / step) as usize + 1;
        // A late stream describes the piece after its end.
        let before = start - lags as f64 * step;
        sums.add(
            &SpeedGrid::resample(arm, silences[0], start, step, count),
            &SpeedGrid::resample(stream, silences[1], before, step, count + 2 * lags),
        );
    }
    let lag_s = |at: usize| (at as f64 - lags as f64) * step;
    let correlations = sums.correlations().into_iter().enumerate();
    correlations.map(|(at, correlation)| LagPeak { lag_s: lag_s(at), correlation }).collect()
}

/// Longest gap to interpolate, s.
pub(super) fn max_gap_s(period_s: f64) -> f64 {
    (20.0 * period_s).max(2.0)
}

/// Start and end of each piece without long gaps.
pub(super) fn unbroken_spans(t_s: &[f64], longest_s: f64) -> Vec<(f64, f64)> {
    let unbroken = t_s.chunk_by(|a, b| b - a <= longest_s);
    unbroken.map(|piece| (piece[0], piece[piece.len() - 1])).collect()
}

struct SpeedGrid {
    /// 0 if invalid.
    value: Vec<f64>,
    /// 1 if valid, else 0.
    known: Vec<f64>,
}

impl SpeedGrid {
    /// Interpolates across gaps up to `longest_s`.
    fn resample(speed: &SpeedSeries, longest_s: f64, start: f64, step: f64, count: usize) -> Self {
        let mut left = 0;
        let at = |row: usize| speed.at(start + row as f64 * step, longest_s, &mut left);
        let values = (0..count).map(at).map(|value| value.map_or((0.0, 0.0), |value| (value, 1.0)));
        let (value, known) = values.unzip();
        Self { value, known }
    }

    fn squares(&self) -> Vec<f64> {
        self.value.iter().map(|value| value * value).collect()
    }
}

thread_local! {
    /// Planning a transform takes longer than computing it.
    static FFT_PLANS: RefCell<RealFftPlanner<f64>> = RefCell::new(RealFftPlanner::new());
}

/// Adds the sum of the values of one speed at which the other is known, for lags from the first on. The other speed is
/// shifted by `direction` per lag.
fn add_common_sums(sums: &mut [f64], values: &[f64], other: &SpeedGrid, direction: isize) {
    let cumulative = cumulative(values.iter().copied());
    let mut end = 0;
    let ranges = other.known.chunk_by(|a, b| a == b).filter_map(|run| {
        end += run.len();
        (run[0] == 1.0).then_some(end - run.len()..end)
    });
    let ranges: Vec<Range<usize>> = ranges.collect();
    for (lag, sum) in sums.iter_mut().enumerate() {
        let before = |at: usize| {
            let shifted = at as isize + direction * lag as isize;
            cumulative[shifted.clamp(0, values.len() as isize) as usize]
        };
        *sum += ranges.iter().map(|own| before(own.end) - before(own.start)).sum::<f64>();
    }
}

/// Sums for Pearson's correlation at every lag.
struct CorrelationSums {
    /// Number of common times, and sums of x, x², y, y² and xy.
    sums: [Vec<f64>; 6],
    /// Valid times of each speed.
    known: [f64; 2],
}

impl CorrelationSums {
    /// Adds a piece. `stream` has one step more than `arm` for each lag after the first.
    ///
    /// Products at all lags by Fourier transforms (Press et al., *Numerical Recipes*, 3rd ed., §13.2), other sums
    /// over the valid times of both.
    fn add(&mut self, arm: &SpeedGrid, stream: &SpeedGrid) {
        let [n, x, xx, y, yy, xy] = &mut self.sums;
        for (sums, values) in [(n, &arm.known), (x, &arm.value), (xx, &arm.squares())] {
            add_common_sums(sums, values, stream, -1);
        }
        for (sums, values) in [(y, &stream.value), (yy, &stream.squares())] {
            add_common_sums(sums, values, arm, 1);
        }
        let length = stream.value.len().next_power_of_two();
        let (forward, inverse) = FFT_PLANS.with_borrow_mut(|planner| {
            (planner.plan_fft_forward(length), planner.plan_fft_inverse(length))
        });
        let spectrum = |values: &Vec<f64>| {
            let (mut padded, mut spectrum) = (values.clone(), forward.make_output_vec());
            padded.resize(length, 0.0);
            // Fails only if lengths differ from those planned.
            let done = forward.process(&mut padded, &mut spectrum);
            debug_assert!(done.is_ok());
            spectrum
        };
        let [a, b] = [&arm.value, &stream.value].map(spectrum);
        let product = a.iter().zip(&b).map(|(a, b)| a.conj() * b);
        let (mut product, mut lags): (Vec<_>, _) = (product.collect(), inverse.make_output_vec());
        for end in [0, length / 2] {
            // Real in theory; required by the transform.
            product[end].im = 0.0;
        }
        let done = inverse.process(&mut product, &mut lags);
        debug_assert!(done.is_ok());
        xy.iter_mut().zip(&lags).for_each(|(sum, lag)| *sum += lag / length as f64);
        self.known[0] += arm.known.iter().sum::<f64>();
        self.known[1] += stream.known.iter().sum::<f64>();
    }

    /// NaN if a speed is constant or less than a third of the times are common.
    fn correlations(&self) -> Vec<f64> {
        /// Speeds below this are constant; rounding stays below it.
        const MIN_RELATIVE_VARIANCE: f64 = 1e-10;
        let min_overlap = self.known[0].min(self.known[1]) / 3.0;
        let at = |lag: usize| {
            let [n, x, xx, y, yy, xy] = self.sums.each_ref().map(|sums| sums[lag]);
            if n < min_overlap.max(0.5) {
                return f64::NAN;
            }
            let (vx, vy) = (xx - x * x / n, yy - y * y / n);
            if vx <= MIN_RELATIVE_VARIANCE * xx || vy <= MIN_RELATIVE_VARIANCE * yy {
                return f64::NAN;
            }
            (xy - x * y / n) / (vx * vy).sqrt()
        };
        (0..self.sums[0].len()).map(at).collect()
    }
}

/// For a stream that follows the arm.
pub(crate) const MIN_SPEED_CORRELATION: f64 = 0.3;

/// Candidate lags, most likely first.
pub(crate) fn stream_peaks(arm: &ArmSpeeds, stream: &PoseStream, max_lag_s: f64) -> Vec<LagPeak> {
    let PoseTrack { t_s, xyz, orientation, .. } = stream.track;
    arm.lag_peaks(t_s, xyz, as_rotations(orientation), max_lag_s)
}

/// Lag of the highest correlation, s; 0 if none is high enough.
pub(crate) fn stream_lag_s(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> f64 {
    let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
    let peaks = stream_peaks(&arm, stream, max_lag_s);
    let best = peaks.first().filter(|peak| peak.correlation > MIN_SPEED_CORRELATION);
    best.map_or(0.0, |peak| peak.lag_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bumps(offset_s: f64, from: f64, to: f64, rate: f64) -> SpeedSeries {
        let shape = |t: f64| (1.3 * t).sin().powi(2) + 0.5 * (0.37 * t * t).sin().powi(2);
        let t_s: Vec<f64> =
            (0..((to - from) * rate) as usize).map(|i| from + i as f64 / rate).collect();
        let value = t_s.iter().map(|t| shape(t - offset_s)).collect();
        SpeedSeries { t_s, value }
    }

    #[test]
    fn a_lag_is_estimated_to_a_fraction_of_a_sample() {
        for lag in [-0.4, -0.015, 0.0, 0.0221, 0.9] {
            let found = lag_peaks(&bumps(0.0, 0.0, 10.0, 125.0), &bumps(lag, 0.31, 9.7, 90.0), 2.0);
            assert!((found[0].lag_s - lag).abs() < 2e-3, "{lag}: {:?}", found[0]);
        }
    }

    #[test]
    fn the_shortest_lag_of_periodic_motion_comes_first() {
        let wave = |lag_s: f64| {
            let t_s: Vec<f64> = (0..1500).map(|i| f64::from(i) * 0.01).collect();
            let value = t_s.iter().map(|t| (t - lag_s).sin().powi(2)).collect();
            SpeedSeries { t_s, value }
        };
        let found = lag_peaks(&wave(0.0), &wave(0.02), 4.0);
        assert!(found.len() > 1, "{found:?}");
        assert!((found[0].lag_s - 0.02).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn spans_between_gaps_are_summed() {
        let excerpts = |speed: SpeedSeries, around: f64| {
            let kept = speed.t_s.iter().zip(&speed.value).filter(|(t, _)| {
                let within = |from: f64| (from - around..from + 8.0 + around).contains(*t);
                within(3.0) || within(30.0) || within(71.0)
            });
            let (t_s, value) = kept.map(|(t, v)| (*t, *v)).unzip();
            SpeedSeries { t_s, value }
        };
        let lag = 0.713;
        let arm = excerpts(bumps(0.0, 0.0, 90.0, 125.0), 0.0);
        for around in [0.0, 2.0] {
            let stream = excerpts(bumps(lag, 0.31, 89.0, 90.0), around);
            let found = lag_peaks(&arm, &stream, 2.0)[0];
            assert!((found.lag_s - lag).abs() < 2e-3, "{found:?}");
            assert!(found.correlation > 0.99, "{found:?}");
        }
    }

    #[test]
    fn a_constant_speed_has_no_peak() {
        let still = SpeedSeries {
            t_s: (0..1000).map(|i| i as f64 * 0.01).collect(),
            value: vec![0.3; 1000],
        };
        assert!(lag_peaks(&still, &bumps(0.0, 0.0, 10.0, 100.0), 1.0).is_empty());
    }
}
