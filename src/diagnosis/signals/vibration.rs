//! Vibration of a path: power above the commanded motion, in excess of noise.

use ground::stats::{highest, mean, median_of, quantile};
use std::f64::consts::TAU;

use realfft::RealFftPlanner;

use ground::geometry::Vec3;

/// Strongest vibration of a path over 1.5 s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vibration {
    /// Rms above `from_hz` without noise, m.
    pub rms_m: f64,
    /// Lower end of the band, Hz, above the commanded motion.
    pub from_hz: f64,
    /// Rms noise in the band (white), m.
    pub noise_m: f64,
    /// Smallest vibration that exceeds the noise, m.
    pub resolved_m: f64,
    /// Strongest frequency, Hz.
    pub frequency_hz: f64,
    /// Time, s.
    pub at_s: f64,
}

/// Why vibration cannot be estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VibrationFailure {
    /// The sample rate, Hz, leaves no band above `MAX_ARM_MOTION_HZ`.
    Slow(f64),
    /// No 1.5 s of evenly spaced samples.
    Uneven,
}

/// Maximum frequency of usual arm motion, Hz.
pub const MAX_ARM_MOTION_HZ: f64 = 10.0;
/// Minimum frequency, even for slower motion.
const MIN_TONE_HZ: f64 = 4.0;
/// Rms, where the commanded motion ends.
const MIN_COMMANDED_MOTION_M: f64 = 0.1e-3;
/// Share of power near the peak: below `MAX_ARM_MOTION_HZ`, only a single tone is vibration.
const MIN_TONE_SHARE: f64 = 0.7;
/// Relative, of even intervals.
const MAX_INTERVAL_DEVIATION: f64 = 0.01;
/// Lower rates have almost no band above `MAX_ARM_MOTION_HZ`.
const MIN_RATE_HZ: f64 = 25.0;
const WINDOW_S: f64 = 1.0;
/// In blocks over the run.
const MAX_POSITIONS: usize = 60_000;

/// Vibration of a path sampled at `t_s`; `position_m` returns a row's position, m. With `work_m`, the
/// commanded position, the band starts where the commanded motion ends.
///
/// Blocks of two one-second windows overlap by half. Each window is detrended with a parabola and
/// Hann-tapered (Welch 1967). The median power over frequencies estimates the white noise; an excess counts
/// if noise cannot explain it. The smaller value of a block counts, because a single jerk is central in
/// only one window. Single steps are removed.
///
/// # Errors
/// If the sample rate is too low or no block has even samples.
pub fn estimate_vibration(
    t_s: &[f64],
    mut position_m: impl FnMut(usize) -> Vec3,
    work_m: Option<&dyn Fn(usize) -> Vec3>,
) -> Result<Vibration, VibrationFailure> {
    let period_s = period(t_s).ok_or(VibrationFailure::Uneven)?;
    let rate_hz = 1.0 / period_s;
    if rate_hz <= MIN_RATE_HZ {
        return Err(VibrationFailure::Slow(rate_hz));
    }
    let length = (WINDOW_S * rate_hz).round() as usize;
    let hop = length / 2;
    let block = length + hop;
    // Stamps a nanosecond apart would need a huge FFT.
    if t_s.len() < block {
        return Err(VibrationFailure::Uneven);
    }
    let starts = (0..t_s.len() + 1 - block).step_by(length);
    let stride = (starts.len() * block).div_ceil(MAX_POSITIONS).max(1);
    let mut spectrum = Spectrum::new(length, rate_hz);
    let mut strongest: Option<Vibration> = None;
    for start in starts.step_by(stride) {
        let times = &t_s[start..start + block];
        let mut intervals = times.windows(2).map(|pair| (pair[1] - pair[0]) / period_s);
        if !intervals.clone().all(|interval| (0.5..1.5).contains(&interval)) {
            continue;
        }
        let has_jitter = intervals.any(|interval| (interval - 1.0).abs() > MAX_INTERVAL_DEVIATION);
        let mut path: Vec<Vec3> = (start..start + block).map(&mut position_m).collect();
        remove_step(&mut path);
        let work = work_m.map(|at| (start..start + block).map(at).collect::<Vec<Vec3>>());
        let mut of = |path: &[Vec3], work: Option<&[Vec3]>| {
            let [first, second] = [(0, hop), (hop, length)].map(|(from, middle)| {
                let window = from..from + length;
                let work = work.map(|work| &work[window.clone()]);
                spectrum.vibration_in_window(&path[window], work, times[middle])
            });
            if first.rms_m < second.rms_m { first } else { second }
        };
        let mut weakest = of(&path, work.as_deref());
        // Stamps or samples may jitter; real vibration appears in both.
        if weakest.rms_m > 0.0 && has_jitter {
            let work = work.map(|work| resample_evenly(times, &work));
            let as_stamped = of(&resample_evenly(times, &path), work.as_deref());
            if as_stamped.rms_m < weakest.rms_m {
                weakest = as_stamped;
            }
        }
        if strongest.is_none_or(|strongest| weakest.rms_m > strongest.rms_m) {
            strongest = Some(weakest);
        }
    }
    strongest.ok_or(VibrationFailure::Uneven)
}

/// Interpolates with the cubic through the four nearest samples.
fn resample_evenly(t_s: &[f64], path: &[Vec3]) -> Vec<Vec3> {
    const INTERPOLATION_POINTS: usize = 4;
    let (count, first_s, last_s) = (t_s.len(), t_s[0], t_s[t_s.len() - 1]);
    let step_s = (last_s - first_s) / (count - 1) as f64;
    let at = |row: usize| {
        let at_s = first_s + row as f64 * step_s;
        let after = t_s.partition_point(|t_s| *t_s < at_s);
        let from = after.saturating_sub(INTERPOLATION_POINTS / 2).min(count - INTERPOLATION_POINTS);
        let points = from..from + INTERPOLATION_POINTS;
        let weight = |point: usize| {
            let others = points.clone().filter(|other| *other != point);
            others.map(|other| (at_s - t_s[other]) / (t_s[point] - t_s[other])).product::<f64>()
        };
        points.clone().map(|point| path[point] * weight(point)).sum()
    };
    (0..count).map(at).collect()
}

/// Path around its strongest vibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VibrationPath {
    /// Hz, and rms over all axes, m.
    pub spectrum: Vec<[f64; 2]>,
    /// Time, s, and position on the strongest axis, m, minus the best parabola.
    pub trace: Vec<[f64; 2]>,
}

/// Spectrum and trace for 1 s around `at_s`, as in [`estimate_vibration`]. `None` if samples are uneven.
pub fn vibration_path(
    t_s: &[f64],
    mut position_m: impl FnMut(usize) -> Vec3,
    at_s: f64,
) -> Option<VibrationPath> {
    let period_s = period(t_s)?;
    let length = (WINDOW_S / period_s).round() as usize;
    let middle = t_s.partition_point(|t_s| *t_s < at_s);
    let start = middle.saturating_sub(length / 2);
    let times = t_s.get(start..start + length)?;
    if length < 8 || times[length - 1] - times[0] > 1.5 * WINDOW_S {
        return None;
    }
    let mut path: Vec<Vec3> = (start..start + length).map(&mut position_m).collect();
    let mut spectrum = Spectrum::new(length, 1.0 / period_s);
    let power = spectrum.power(&path).into_iter().enumerate().skip(1);
    let lines = power.map(|(bin, power)| [bin as f64 * spectrum.bin_hz, power.sqrt()]);
    remove_parabola(&mut path);
    let size = |axis: &usize| path.iter().map(|point| point[*axis].powi(2)).sum::<f64>();
    let most = highest(0..3, size)?;
    let trace = times.iter().zip(&path).map(|(&t_s, point)| [t_s, point[most]]);
    Some(VibrationPath { spectrum: lines.collect(), trace: trace.collect() })
}

/// Median interval, s.
fn period(t_s: &[f64]) -> Option<f64> {
    median_of(t_s.windows(2).map(|pair| pair[1] - pair[0])).filter(|period_s| *period_s > 0.0)
}

/// Ratio for the power of three axes of noise: χ² with six degrees of freedom.
const MEDIAN_TO_MEAN_POWER: f64 = 0.891;

struct Spectrum {
    plan: std::sync::Arc<dyn realfft::RealToComplex<f64>>,
    /// Hann, unit mean square.
    taper: Vec<f64>,
    /// Width of a bin.
    bin_hz: f64,
}

impl Spectrum {
    fn new(length: usize, rate_hz: f64) -> Self {
        let plan = RealFftPlanner::new().plan_fft_forward(length);
        let hann = |at: usize| 0.5 * (1.0 - (TAU * at as f64 / length as f64).cos());
        let unit = (8.0_f64 / 3.0).sqrt();
        let taper = (0..length).map(|at| unit * hann(at)).collect();
        Self { plan, taper, bin_hz: rate_hz / length as f64 }
    }

    /// Centred at `at_s`; `work` is the commanded path.
    fn vibration_in_window(
        &mut self,
        path: &[Vec3],
        work: Option<&[Vec3]>,
        at_s: f64,
    ) -> Vibration {
        let power = self.power(path);
        let from = (MAX_ARM_MOTION_HZ / self.bin_hz).ceil() as usize;
        let fast = self.vibration_above(&power, from, at_s);
        let Some(work) = work.map(|work| self.power(work)) else { return fast };
        let slow = self.vibration_above(&power, self.end_of_commanded_motion(&work, from), at_s);
        let strongest = (slow.frequency_hz / self.bin_hz).round() as usize;
        let about = power.get(strongest.saturating_sub(2)..).unwrap_or_default();
        let tone: f64 = about.iter().take(5).sum();
        let is_tone = strongest < from && tone > MIN_TONE_SHARE * slow.rms_m.powi(2);
        if is_tone && slow.rms_m > fast.rms_m { slow } else { fast }
    }

    /// Summed over three axes, m².
    fn power(&mut self, path: &[Vec3]) -> Vec<f64> {
        let length = path.len();
        let mut power = vec![0.0; length / 2 + 1];
        let mut detrended = path.to_vec();
        remove_parabola(&mut detrended);
        // Both signs of a frequency, so powers sum to the mean square (Parseval).
        let scale = 2.0 / (length as f64).powi(2);
        for axis in 0..3 {
            let tapered =
                detrended.iter().zip(&self.taper).map(|(point, taper)| point[axis] * taper);
            let mut bins = self.plan.make_output_vec();
            // Fails only if the length differs from that planned.
            let done = self.plan.process(&mut tapered.collect::<Vec<f64>>(), &mut bins);
            debug_assert!(done.is_ok());
            power.iter_mut().zip(&bins).for_each(|(power, bin)| *power += scale * bin.norm_sqr());
        }
        power
    }

    /// Bins from `from` upwards, without the Nyquist bin, whose power counts once.
    fn band<'p>(&self, power: &'p [f64], from: usize) -> &'p [f64] {
        power.get(from..self.taper.len().div_ceil(2)).unwrap_or_default()
    }

    /// First bin above the commanded motion, at most `max_bin`.
    fn end_of_commanded_motion(&self, power: &[f64], max_bin: usize) -> usize {
        let min_bin = (MIN_TONE_HZ / self.bin_hz).ceil() as usize;
        // Encoder noise.
        let floor = noise_power(self.band(power, max_bin));
        let mut power_above = 0.0;
        for bin in (min_bin..max_bin).rev() {
            power_above += (power.get(bin).unwrap_or(&0.0) - 3.0 * floor).max(0.0);
            if power_above > MIN_COMMANDED_MOTION_M.powi(2) {
                return bin + 1;
            }
        }
        min_bin
    }

    /// Vibration from bin `from` upwards.
    fn vibration_above(&self, power: &[f64], from: usize, at_s: f64) -> Vibration {
        /// Not exceeded by chance.
        const NOISE_SIGMAS: f64 = 6.0;
        let band = self.band(power, from);
        let Some((strongest, _)) = highest(band.iter().enumerate(), |bin| *bin.1) else {
            return Vibration::default();
        };
        let count = band.len() as f64;
        let floor = noise_power(band);
        let excess = band.iter().sum::<f64>() - count * floor;
        // With six degrees of freedom the standard deviation is 1/√3 of the mean; neighbouring bins are
        // correlated.
        let by_chance = NOISE_SIGMAS * floor * count.sqrt();
        let is_shake = excess > by_chance && excess.is_finite();
        Vibration {
            rms_m: if is_shake { excess.sqrt() } else { 0.0 },
            from_hz: from as f64 * self.bin_hz,
            noise_m: (count * floor).sqrt(),
            resolved_m: by_chance.sqrt(),
            frequency_hz: (from + strongest) as f64 * self.bin_hz,
            at_s,
        }
    }
}

/// Mean power of white noise in a band.
fn noise_power(band: &[f64]) -> f64 {
    median_of(band.iter().copied()).unwrap_or(0.0) / MEDIAN_TO_MEAN_POWER
}

/// Removes one step, such as a slipping tool or clock adjustment. Vibration repeats.
fn remove_step(path: &mut [Vec3]) {
    /// Relative to this quantile of deviations from linear interpolation.
    const MIN_STEP_RATIO: f64 = 10.0;
    const DEVIATION_QUANTILE: f64 = 0.95;
    let around = |at: usize| {
        let [a, b, c, d] = [path[at - 1], path[at], path[at + 1], path[at + 2]];
        (c - b) - 0.5 * ((b - a) + (d - c))
    };
    let steps: Vec<(f64, usize)> =
        (1..path.len().saturating_sub(2)).map(|at| (around(at).norm(), at)).collect();
    let Some(&(largest, at)) = highest(&steps, |step| step.0) else { return };
    let mut sizes: Vec<f64> = steps.iter().map(|step| step.0).collect();
    let usual = quantile(&mut sizes, DEVIATION_QUANTILE).unwrap_or(largest);
    if largest > MIN_STEP_RATIO * usual {
        let step = around(at);
        path[at + 1..].iter_mut().for_each(|point| *point -= step);
    }
}

/// Uses orthogonal Legendre polynomials.
fn remove_parabola(path: &mut [Vec3]) {
    let middle = (path.len() as f64 - 1.0) / 2.0;
    let at = |row: usize| row as f64 - middle;
    let mean_square = mean((0..path.len()).map(|row| at(row).powi(2)));
    let shapes: [&dyn Fn(f64) -> f64; 3] = [&|_| 1.0, &|x| x, &|x| x * x - mean_square];
    for shape in shapes {
        let shape: Vec<f64> = (0..path.len()).map(|row| shape(at(row))).collect();
        let along: Vec3 = shape.iter().zip(&*path).map(|(shape, point)| *shape * point).sum();
        let own: f64 = shape.iter().map(|shape| shape * shape).sum();
        if own > 0.0 {
            let part = along / own;
            path.iter_mut().zip(&shape).for_each(|(point, shape)| *point -= part * *shape);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_motion::noise;

    /// 10 s over half a metre, plus `beside` by time and row.
    fn shaken(
        rate_hz: f64,
        beside: impl Fn(f64, usize) -> f64,
    ) -> Result<Vibration, VibrationFailure> {
        let t_s: Vec<f64> =
            (0..(10.0 * rate_hz) as usize).map(|row| row as f64 / rate_hz).collect();
        let work = |t: f64| 0.5 * (0.8 * t).sin();
        estimate_vibration(
            &t_s,
            |row| Vec3::new(work(t_s[row]), beside(t_s[row], row), 0.3 * work(t_s[row])),
            None,
        )
    }

    #[test]
    fn stamps_a_nanosecond_apart_give_no_spectrum() {
        let t_s: Vec<f64> = (0..100).map(|k| f64::from(k) * 1e-9).collect();
        assert_eq!(
            estimate_vibration(&t_s, |_| Vec3::zeros(), None),
            Err(VibrationFailure::Uneven)
        );
    }

    #[test]
    fn rms_and_frequency_of_a_tone_are_found_at_any_rate() {
        for rate_hz in [60.0, 125.0, 500.0] {
            let found = shaken(rate_hz, |t, _| 1e-3 * (TAU * 17.0 * t).sin()).expect("even");
            assert!((found.rms_m - 1e-3 / 2f64.sqrt()).abs() < 3e-5, "{rate_hz}: {found:?}");
            assert!((found.frequency_hz - 17.0).abs() < 1.1, "{found:?}");
        }
    }

    #[test]
    fn the_path_of_a_tone_contains_its_spectral_line_and_its_trace() {
        let t_s: Vec<f64> = (0..500).map(|row| f64::from(row) / 100.0).collect();
        let tone = |row: usize| Vec3::new(0.0, 2e-3 * (TAU * 17.0 * t_s[row]).sin(), 1.0);
        let seen = vibration_path(&t_s, tone, 2.5).expect("even");
        let strongest = seen.spectrum.iter().max_by(|a, b| a[1].total_cmp(&b[1]));
        assert!(strongest.is_some_and(|line| (line[0] - 17.0).abs() < 1.1), "{strongest:?}");
        let swing = seen.trace.iter().map(|at| at[1].abs()).fold(0.0, f64::max);
        assert!((swing - 2e-3).abs() < 2e-4 && seen.trace.len() == 100, "{swing}");
        assert_eq!(vibration_path(&t_s, tone, 9.0), None);
    }

    #[test]
    fn noise_is_no_vibration_and_does_not_hide_one() {
        let white = |row: usize| 1e-3 * noise(row);
        let found = shaken(125.0, |_, row| white(row)).expect("even");
        assert!(found.rms_m < 2e-4, "{found:?}");
        // 1/√3 mm on one axis; 52.5 of 62.5 Hz.
        assert!(
            (found.noise_m - 1e-3 * (52.5_f64 / 62.5 / 3.0).sqrt()).abs() < 1.5e-4,
            "{found:?}"
        );
        let found = shaken(125.0, |t, row| white(row) + 2e-3 * (TAU * 14.0 * t).sin());
        let found = found.expect("even");
        assert!((found.rms_m - 2e-3 / 2f64.sqrt()).abs() < 2e-4, "{found:?}");
    }

    #[test]
    fn commanded_motion_and_slow_swing_are_no_vibration() {
        for swing_hz in [0.5, 3.0, 6.0] {
            let found = shaken(125.0, |t, _| 5e-3 * (TAU * swing_hz * t).sin()).expect("even");
            assert!(found.rms_m < 5e-5, "{swing_hz}: {found:?}");
        }
    }

    #[test]
    fn an_uncommanded_slow_tone_is_vibration() {
        let t_s: Vec<f64> = (0..1250).map(|row| f64::from(row) / 125.0).collect();
        let work = |row: usize| Vec3::new(0.5 * (0.8 * t_s[row]).sin(), 0.0, 0.0);
        let tone = |row: usize| Vec3::new(0.0, 2e-3 * (TAU * 7.0 * t_s[row]).sin(), 0.0);
        let both = |row: usize| work(row) + tone(row);
        let found = estimate_vibration(&t_s, both, Some(&work)).expect("even");
        assert!((found.rms_m - 2e-3 / 2f64.sqrt()).abs() < 1e-4, "{found:?}");
        assert!((found.frequency_hz - 7.0).abs() < 1.1 && found.from_hz < 7.0, "{found:?}");
        let found = estimate_vibration(&t_s, both, Some(&both)).expect("even");
        assert!(found.rms_m < 1e-4, "{found:?}");
    }

    #[test]
    fn jittering_stamps_are_no_vibration() {
        // Every fifth interval is longer: in the motion, then in the stamps only.
        let uneven_s: Vec<f64> =
            (0..2000).map(|row| 0.0104 * f64::from(row) + 0.0004 * f64::from(row % 5)).collect();
        let even_s: Vec<f64> = (0..2000).map(|row| 0.0104 * f64::from(row)).collect();
        let work = |t: f64| Vec3::new(0.6 * (1.9 * t).sin(), 0.4 * (1.1 * t).cos(), 0.3);
        for truth_s in [&uneven_s, &even_s] {
            let found =
                estimate_vibration(&uneven_s, |row| work(truth_s[row]), None).expect("even enough");
            assert!(found.rms_m < 5e-5, "{found:?}");
            let tone = |t: f64| Vec3::new(0.0, 0.0, 1.4e-3 * (TAU * 17.0 * t).sin());
            let both = |row: usize| work(truth_s[row]) + tone(truth_s[row]);
            let found = estimate_vibration(&uneven_s, both, None).expect("even enough");
            assert!((found.rms_m - 1e-3).abs() < 1e-4, "{found:?}");
        }
    }

    #[test]
    fn slow_or_uneven_samples_are_not_evaluated() {
        let slow = shaken(20.0, |_, _| 0.0);
        let is_told = |rate_hz: f64| (rate_hz - 20.0).abs() < 1e-9;
        assert!(
            matches!(slow, Err(VibrationFailure::Slow(rate_hz)) if is_told(rate_hz)),
            "{slow:?}"
        );
        assert_eq!(estimate_vibration(&[], |_| Vec3::zeros(), None), Err(VibrationFailure::Uneven));
        let ragged: Vec<f64> = (0..1000)
            .map(|row| f64::from(row) * 0.01 + if row % 50 < 25 { 0.0 } else { 0.3 })
            .collect();
        assert_eq!(
            estimate_vibration(&ragged, |_| Vec3::zeros(), None),
            Err(VibrationFailure::Uneven)
        );
    }
}
