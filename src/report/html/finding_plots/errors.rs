//! Errors of streams over time, reach and workspace.

use super::FindingContext;
use crate::checks::MDL001;
use crate::finding::{Cause, Unit};
use crate::report::Report;
use crate::report::figures::{ImuFigure, LatencyProfilePoint, PoseFigure};
use crate::report::html::plane::{Dot, Plane};
use crate::report::html::plot::{Plot, PlotLimit, PlotMark, PlotSeries, PlotStyle, SeriesRole};
use crate::time::Stamp;

/// Position error against FK with the limit of the residual check.
pub fn position_over_time(report: &Report, pose: &PoseFigure) -> Plot {
    over_time(
        report,
        pose,
        "Position error over time",
        "Distance of the logged position from",
        (Unit::Metre, "mm", 1e3),
        [&pose.before_m, &pose.after_m],
    )
}

/// Rotation error against FK with the limit of the residual check.
pub fn rotation_over_time(report: &Report, pose: &PoseFigure) -> Plot {
    over_time(
        report,
        pose,
        "Rotation error over time",
        "Angle of the logged orientation to",
        (Unit::Radian, "°", 1f64.to_degrees()),
        [&pose.before_rad, &pose.after_rad],
    )
}

/// The reference, or forward kinematics.
fn predicted_by<'a>(report: &'a Report, pose: &PoseFigure) -> &'a str {
    let compared = report.comparisons.iter().find(|row| row.topic == pose.topic);
    compared.map_or("forward kinematics", |row| &row.reference)
}

fn over_time(
    report: &Report,
    pose: &PoseFigure,
    title: &'static str,
    what: &str,
    (si, unit, factor): (Unit, &'static str, f64),
    [before, after]: [&Vec<f64>; 2],
) -> Plot {
    // Without findings there is nothing to correct.
    let is_uncorrected = report.findings.is_empty() && !before.is_empty();
    let after = if is_uncorrected { &Vec::new() } else { after };
    let series = before_and_after([before, after], factor);
    Plot {
        title,
        robot: pose.robot.clone(),
        stream: pose.topic.clone(),
        caption: format!(
            "{what} {}: {}.",
            predicted_by(report, pose),
            max_errors_text(&series, unit)
        ),
        x: pose.t_s.clone(),
        x_label: "time, s",
        y_label: unit,
        series,
        from_zero: true,
        limits: PlotLimit::upper(report.warning_threshold(&MDL001, si), si, factor),
        ..Plot::default()
    }
}

/// Yaw of an IMU against FK, with the drift that `limit` allows per second.
pub fn yaw_error(imu: &ImuFigure, limit: Option<f64>) -> Plot {
    let t_s: Vec<f64> = imu.yaw_error.iter().map(|at| at[0]).collect();
    let degrees = imu.yaw_error.iter().map(|at| at[1].to_degrees());
    let error = PlotSeries::new("IMU − FK", SeriesRole::Before, degrees);
    let limit = limit.map(|rate| {
        let label = format!("limit {}", Unit::RadianPerSecond.show(rate));
        drift_line(&t_s, rate, label, SeriesRole::Limit)
    });
    Plot {
        title: "IMU yaw − FK yaw",
        robot: imu.robot.clone(),
        stream: imu.topic.clone(),
        caption: "A slope is drift; a good IMU stays flat.".to_owned(),
        series: [error].into_iter().chain(limit).collect(),
        x: t_s,
        x_label: "time, s",
        y_label: "°",
        ..Plot::default()
    }
}

/// Line through zero at the middle of the run, in degrees; `rate` in rad/s.
pub(super) fn drift_line(t_s: &[f64], rate: f64, label: String, role: SeriesRole) -> PlotSeries {
    let middle = 0.5 * (t_s.first().unwrap_or(&0.0) + t_s.last().unwrap_or(&0.0));
    PlotSeries::new(label, role, t_s.iter().map(|t_s| (rate * (t_s - middle)).to_degrees()))
}

impl FindingContext<'_> {
    pub(super) fn positions_over_time(&self) -> impl Iterator<Item = Plot> {
        self.over_time(position_over_time)
    }

    pub(super) fn rotations_over_time(&self) -> impl Iterator<Item = Plot> {
        self.over_time(rotation_over_time)
    }

    fn over_time(&self, plot: fn(&Report, &PoseFigure) -> Plot) -> impl Iterator<Item = Plot> {
        self.poses().map(move |pose| Plot { mark: self.change_mark(), ..plot(self.report, pose) })
    }

    fn change_mark(&self) -> Option<PlotMark> {
        let change = self.finding.estimate.as_ref()?.change()?;
        let start = self.figures.start?;
        let since = |stamp: Stamp| stamp.seconds_since(start);
        Some(PlotMark {
            at: since(change.change_ns),
            interval: change.change_ci95_ns.map(|ends| ends.map(since)),
            label: "changes".to_owned(),
        })
    }

    pub(super) fn latency_profile(
        &self,
        [robot, topic]: [&str; 2],
        points: &[LatencyProfilePoint],
    ) -> Plot {
        let limits = PlotLimit::signed(self.warning_limit(Unit::Second), Unit::Second, 1e3);
        let mut plot = Plot { limits, ..latency_profile_plot([robot, topic], points) };
        let ([first, .., last], Cause::ClockSkew(skew)) = (plot.x.as_slice(), &self.finding.cause)
        else {
            return plot;
        };
        let middle = 0.5 * (first + last);
        let found = ("found".to_owned(), SeriesRole::Reference, skew.value);
        let limit = self.warning_limit(Unit::SecondPerSecond).map(|limit| {
            (format!("limit {}", Unit::SecondPerSecond.show(limit)), SeriesRole::Limit, limit)
        });
        let lines = [found].into_iter().chain(limit).map(|(label, role, slope)| {
            PlotSeries::new(label, role, plot.x.iter().map(|t_s| slope * (t_s - middle) * 1e3))
        });
        plot.series = std::mem::take(&mut plot.series).into_iter().chain(lines).collect();
        plot.style = PlotStyle::Time;
        plot
    }
}

pub(super) fn over_reach(pose: &PoseFigure) -> Plot {
    let mut rows: Vec<usize> = (0..pose.reach_m.len()).collect();
    rows.sort_by(|&a, &b| pose.reach_m[a].total_cmp(&pose.reach_m[b]));
    let sorted = |values: &Vec<f64>| -> Vec<f64> {
        rows.iter().filter_map(|&row| values.get(row).copied()).collect()
    };
    let series = before_and_after([&sorted(&pose.before_m), &sorted(&pose.after_m)], 1e3);
    Plot {
        title: "Position error vs. reach",
        robot: pose.robot.clone(),
        stream: pose.topic.clone(),
        caption: "A wrong zero or length causes more error the further the arm reaches.".to_owned(),
        x: sorted(&pose.reach_m),
        x_label: "distance from the base, m",
        y_label: "mm",
        series,
        from_zero: true,
        style: PlotStyle::Points,
        ..Plot::default()
    }
}

/// Before correction only if the log connects the stream's frame to the arm.
fn before_and_after([before, after]: [&Vec<f64>; 2], factor: f64) -> Vec<PlotSeries> {
    let states =
        [("as logged", SeriesRole::Before, before), ("after correction", SeriesRole::After, after)];
    let drawn = states.into_iter().filter(|(.., values)| !values.is_empty());
    drawn
        .map(|(label, role, values)| {
            PlotSeries::new(label, role, values.iter().map(|value| value * factor))
        })
        .collect()
}

/// `up to 24 mm as logged, up to 0.1 mm after correction`.
fn max_errors_text(series: &[PlotSeries], unit: &str) -> String {
    let parts = series.iter().map(|series| {
        let finite = series.values.iter().copied().filter(|value| value.is_finite());
        let most = finite.fold(0.0, f64::max);
        let decimals = if most >= 10.0 { 1 } else { 3 };
        let space = if unit == "°" { "" } else { " " };
        format!("up to {most:.decimals$}{space}{unit} {}", series.label)
    });
    parts.collect::<Vec<_>>().join(", ")
}

fn latency_profile_plot([robot, topic]: [&str; 2], points: &[LatencyProfilePoint]) -> Plot {
    Plot {
        title: "Latency over time",
        robot: robot.to_owned(),
        stream: topic.to_owned(),
        caption:
            "Per one-second window with 95 % intervals, relative to the latency of the whole run."
                .to_owned(),
        x: points.iter().map(|point| point.t_s).collect(),
        x_label: "time, s",
        y_label: "ms",
        series: vec![PlotSeries {
            half_widths: points.iter().map(|point| point.half_width_s * 1e3).collect(),
            ..PlotSeries::new(
                "latency",
                SeriesRole::Amount,
                points.iter().map(|point| point.deviation_s * 1e3),
            )
        }],
        style: PlotStyle::Points,
        ..Plot::default()
    }
}

/// Top and side view.
pub(super) fn over_workspace(pose: &PoseFigure) -> Vec<Plane> {
    /// Maximum number of points.
    const MAX_POINTS: usize = 300;
    let errors = if pose.before_m.is_empty() { &pose.after_m } else { &pose.before_m };
    let what = if pose.before_m.is_empty() { "after correction" } else { "as logged" };
    let step = pose.at_m.len().div_ceil(MAX_POINTS).max(1);
    let rows = || (0..pose.at_m.len().min(errors.len())).step_by(step);
    let most = rows().map(|row| errors[row]).filter(|m| m.is_finite()).fold(0.0, f64::max);
    let view = |title: &str, axes: [usize; 2], labels: [&'static str; 2]| Plane {
        title: format!("Position error {title}"),
        caption: format!(
            "Radius ∝ error {what}, largest {}; {}.",
            Unit::Metre.show(most),
            pose.topic
        ),
        axes: labels,
        dots: rows()
            .map(|row| Dot {
                at: axes.map(|axis| pose.at_m[row][axis]),
                size: if most > 0.0 { errors[row] / most } else { 0.0 },
                role: SeriesRole::Before,
            })
            .collect(),
        ..Plane::default()
    };
    if most <= 0.0 {
        return Vec::new();
    }
    vec![
        view("from above", [0, 1], ["x, m", "y, m"]),
        view("from the side", [0, 2], ["x, m", "z, m"]),
    ]
}
