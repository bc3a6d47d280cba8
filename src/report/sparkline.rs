//! Errors over time as a row of bars.

use super::Report;
use super::figures::{Figures, ImuFigure, PoseFigure};
use crate::finding::{Cause, Finding, Severity, Unit};

const CELLS: usize = 32;

const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Cell without samples.
const NO_SAMPLES: char = '·';

/// Whether a finding is more than information.
pub(crate) fn has_fault(findings: &[Finding]) -> bool {
    findings.iter().any(|found| found.severity != Severity::Info)
}

/// One line per stream whose errors the findings explain. Empty without figures or faults.
pub(super) fn error_sparklines(report: &Report) -> Vec<String> {
    /// Fraction of the rms error that may remain.
    const MAX_REMAINING_RATIO: f64 = 0.5;
    let figures = report.figures.as_ref().filter(|_| has_fault(&report.findings));
    let Some(figures) = figures else { return Vec::new() };
    let is_blamed = |topic: &str| {
        report.findings.iter().any(|found| found.subject.topic.as_deref() == Some(topic))
    };
    let poses = figures.poses.iter().filter_map(|figure| {
        let is_inferred = |found: &Finding| {
            matches!(found.cause, Cause::InferredEncoding { .. })
                && found.subject.topic.as_ref() == Some(&figure.topic)
        };
        // Nothing declares how the numbers were logged.
        let before = match report.findings.iter().any(is_inferred) {
            true => "in the encoding tried first",
            false => "as logged",
        };
        pose_sparkline(figures, figure, MAX_REMAINING_RATIO, before)
    });
    let imus = figures.imus.iter().filter(|imu| is_blamed(&imu.topic));
    poses.chain(imus.filter_map(|imu| imu_sparkline(figures, imu))).collect()
}

/// Distance or angle, whichever is larger at a lever arm of 1 m.
fn pose_sparkline(
    figures: &Figures,
    figure: &PoseFigure,
    explained: f64,
    before_text: &str,
) -> Option<String> {
    let sizes = |metres: &[f64], radians: &[f64]| [rms(metres), rms(radians)];
    let before = sizes(&figure.before_m, &figure.before_rad);
    let after = sizes(&figure.after_m, &figure.after_rad);
    let by_angle = before[1] > before[0];
    let which = usize::from(by_angle);
    if !before[which].is_finite() || after[which] > explained * before[which] {
        return None;
    }
    let (errors, unit) = match by_angle {
        true => (&figure.before_rad, Unit::Radian),
        false => (&figure.before_m, Unit::Metre),
    };
    let most = errors.iter().copied().fold(0.0, f64::max);
    let bars = draw_sparkline(
        figures.duration_s,
        figure.t_s.iter().copied().zip(errors.iter().copied()),
        0.0,
    )?;
    let (most, left) = (unit.show(most), unit.show(after[which]));
    Some(format!(
        "{bars}  {}: error up to {most} {before_text}, {left} rms if corrected",
        figure.topic
    ))
}

fn imu_sparkline(figures: &Figures, figure: &ImuFigure) -> Option<String> {
    let errors = || figure.yaw_error.iter().map(|&[t_s, error_rad]| (t_s, error_rad));
    let least = errors().map(|(_, error)| error).fold(f64::INFINITY, f64::min);
    let most = errors().map(|(_, error)| error).fold(f64::NEG_INFINITY, f64::max);
    let bars = draw_sparkline(figures.duration_s, errors(), least)?;
    let (least, most) = (Unit::Radian.show(least), Unit::Radian.show(most));
    Some(format!("{bars}  {}: yaw {least} to {most} ahead of FK's", figure.topic))
}

/// Largest of `samples` (time in s, value) in each of [`CELLS`] intervals. `None` if all are equal.
fn draw_sparkline(
    duration_s: f64,
    samples: impl Iterator<Item = (f64, f64)>,
    floor: f64,
) -> Option<String> {
    let mut largest = [f64::NAN; CELLS];
    for (t_s, value) in samples {
        let cell = (t_s / duration_s * CELLS as f64).clamp(0.0, (CELLS - 1) as f64) as usize;
        // `max` ignores NaN.
        largest[cell] = largest[cell].max(value);
    }
    let most = largest.iter().copied().fold(f64::NAN, f64::max);
    let height = |value: f64| (value - floor) / (most - floor) * (LEVELS.len() - 1) as f64;
    let bar = |&value: &f64| match value.is_nan() {
        true => NO_SAMPLES,
        false => LEVELS[(height(value).round() as usize).min(LEVELS.len() - 1)],
    };
    (most > floor).then(|| largest.iter().map(bar).collect())
}

/// Rms of the finite values, or NaN.
fn rms(errors: &[f64]) -> f64 {
    let finite = errors.iter().filter(|error| error.is_finite());
    let (sum, count) = finite.fold((0.0, 0.0), |(sum, n), error| (sum + error * error, n + 1.0));
    f64::sqrt(sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_show_the_maximum_of_each_interval_and_gaps() {
        let quiet = 10..20;
        let samples = (0..320).filter(|k| !quiet.contains(&(k / 10)));
        let ramp = samples.map(|k| (f64::from(k), if k % 10 == 3 { f64::from(k) } else { 0.0 }));
        let bars: Vec<char> = draw_sparkline(320.0, ramp, 0.0).expect("bars").chars().collect();
        assert_eq!(bars.len(), CELLS);
        assert!(bars[10..20].iter().all(|&bar| bar == NO_SAMPLES));
        let heights: Vec<char> = bars.iter().copied().filter(|&bar| bar != NO_SAMPLES).collect();
        assert!(heights.is_sorted(), "{heights:?}");
        assert_eq!((heights[0], heights[21]), (LEVELS[0], LEVELS[7]));
    }

    #[test]
    fn constant_values_have_no_bars() {
        let flat = |value: f64| draw_sparkline(1.0, [(0.0, value), (0.5, value)].into_iter(), 0.0);
        assert_eq!((flat(0.0), flat(f64::NAN)), (None, None));
        assert!(draw_sparkline(0.0, [(0.0, 1.0)].into_iter(), 0.0).is_some());
    }
}
