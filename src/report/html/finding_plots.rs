//! Selects the plots that support a finding.

use std::collections::BTreeMap;

mod errors;
mod specific;

use super::bars::{Bar, Bars, Whisker, Whiskers};
use super::plane::Plane;
use super::plot::{Plot, PlotLimit, PlotMark, PlotSeries, PlotStyle, SeriesRole};
use crate::checks::{self, LAT001, Rule, YAW001, ZER001};
use crate::finding::{Amount, Cause, CheckRow, Estimate, Finding, Picture, Status, Unit};
use crate::geometry::RotationError;
use crate::report::Report;
use crate::report::figures::{EncodingScore, Figures, ImuFigure, PoseFigure};

/// A joint or a whole arm may have many.
const MAX_STREAMS: usize = 3;

#[derive(Debug, Default)]
pub struct FindingPlots {
    pub plots: Vec<Plot>,
    pub planes: Vec<Plane>,
    pub bars: Vec<Bars>,
    pub whiskers: Vec<Whiskers>,
    /// Findings (from 0) that already show one of these plots, with its title.
    pub shown_by: Vec<(usize, &'static str)>,
    /// Section of the page that shows it: id and name.
    pub section: Option<(&'static str, &'static str)>,
}

impl FindingPlots {
    pub fn is_empty(&self) -> bool {
        self.plots.is_empty()
            && self.planes.is_empty()
            && self.bars.is_empty()
            && self.whiskers.is_empty()
            && self.shown_by.is_empty()
            && self.section.is_none()
    }
}

/// Line plots of a page.
#[derive(Debug, Default)]
pub struct PagePlots {
    /// By finding. A shared plot appears with the first finding that uses it.
    pub findings: Vec<FindingPlots>,
    /// Errors of the streams, unless a finding shows them.
    pub streams: Vec<Plot>,
}

impl PagePlots {
    pub fn new(report: &Report) -> Self {
        let none = Figures::default();
        let figures = report.figures.as_ref().unwrap_or(&none);
        let mut first_in: BTreeMap<(&str, String, String), usize> = BTreeMap::new();
        let mut findings = Vec::new();
        for (index, finding) in report.findings.iter().enumerate() {
            let mut evidence = FindingContext { report, figures, finding, index }.plots();
            let plots = std::mem::take(&mut evidence.plots);
            for plot in plots {
                match first_in.get(&plot.key()) {
                    Some(&first) if first == index => {}
                    Some(&first) => evidence.shown_by.push((first, plot.title)),
                    None => {
                        first_in.insert(plot.key(), index);
                        evidence.plots.push(plot);
                    }
                }
            }
            findings.push(evidence);
        }
        let mut streams = stream_errors(report, figures);
        streams.retain(|plot| !plot.is_empty() && !first_in.contains_key(&plot.key()));
        Self { findings, streams }
    }

    /// All line plots with their ids.
    pub fn line_plots(&self) -> impl Iterator<Item = (String, &Plot)> {
        let of_findings = self.findings.iter().enumerate().flat_map(|(finding, evidence)| {
            let plots = evidence.plots.iter().enumerate();
            plots.map(move |(plot, drawn)| (finding_plot_id(finding, plot), drawn))
        });
        let streams = self.streams.iter().enumerate();
        of_findings.chain(streams.map(|(stream, drawn)| (stream_plot_id(stream), drawn)))
    }

    /// Keeps the first `most` plots; returns the number of others.
    pub fn truncate(&mut self, most: usize) -> usize {
        let mut room = most;
        let mut omitted = 0;
        let of_findings = self.findings.iter_mut().map(|evidence| &mut evidence.plots);
        for plots in of_findings.chain([&mut self.streams]) {
            omitted += plots.len().saturating_sub(room);
            plots.truncate(room);
            room -= plots.len();
        }
        omitted
    }
}

/// Indices start at 0.
pub fn finding_plot_id(finding: usize, plot: usize) -> String {
    format!("plot-{}-{}", finding + 1, plot + 1)
}

/// Index in [`PagePlots::streams`].
pub fn stream_plot_id(stream: usize) -> String {
    format!("stream-{}", stream + 1)
}

/// Errors of all streams, each with its limit in view.
fn stream_errors(report: &Report, figures: &Figures) -> Vec<Plot> {
    let poses = figures.poses.iter().flat_map(|pose| {
        [errors::position_over_time(report, pose), errors::rotation_over_time(report, pose)]
    });
    let limit = report.warning_threshold(&YAW001, Unit::RadianPerSecond);
    let imus = figures.imus.iter().map(|imu| errors::yaw_error(imu, limit));
    poses.chain(imus).map(|plot| Plot { shows_limits: true, ..plot }).collect()
}

struct FindingContext<'a> {
    report: &'a Report,
    figures: &'a Figures,
    finding: &'a Finding,
    index: usize,
}

impl FindingContext<'_> {
    fn plots(&self) -> FindingPlots {
        let mut evidence = FindingPlots::default();
        match &self.finding.cause {
            Cause::Rotation(_) | Cause::InferredEncoding { .. } => {
                evidence.plots.extend(self.rotations_over_time());
                let is_whole =
                    |slip| matches!(slip, RotationError::Transposed | RotationError::Inverted);
                if matches!(self.finding.cause, Cause::Rotation(slip) if is_whole(slip)) {
                    evidence.plots.extend(self.positions_over_time());
                }
                let of_poses = self.poses().map(|pose| encoding_bars(&pose.encodings));
                let of_imus = self.imus().map(|imu| encoding_bars(&imu.encodings));
                evidence.bars.extend(of_poses.chain(of_imus).flatten());
            }
            Cause::AngleUnit(_)
            | Cause::LengthUnit(_)
            | Cause::JointUnit(_)
            | Cause::JointScale(_)
            | Cause::JointCoupling { .. }
            | Cause::JointOrder { .. }
            | Cause::DhConvention(_)
            | Cause::TfDisagrees
            | Cause::Axes { .. }
            | Cause::ReferenceFrame(_)
            | Cause::ToolFrame(_) => {
                evidence.plots.extend(self.positions_over_time());
                evidence.plots.extend(self.rotations_over_time());
            }
            Cause::Compliance
            | Cause::ParameterChange
            | Cause::UnexplainedResidual
            | Cause::Disagreement { .. }
            | Cause::UnreadOrientations
            | Cause::OtherRobot(_) => {
                evidence.plots.extend(self.positions_over_time());
                evidence.plots.extend(self.rotations_over_time());
                evidence.plots.extend(self.over_reach());
                evidence.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::JointZero { .. } => {
                evidence.whiskers.extend(self.zero_offsets());
                evidence.plots.extend(self.positions_over_time());
                evidence.plots.extend(self.over_reach());
                evidence.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::RadialScale => {
                evidence.plots.extend(self.over_reach());
                evidence.plots.extend(self.positions_over_time());
                evidence.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::Latency(_) => {
                evidence.plots.extend(self.poses().map(|pose| self.latency_residual(pose)));
                evidence.plots.extend(self.imus().map(|imu| self.correlation(imu)));
                evidence.plots.extend(self.positions_over_time());
            }
            Cause::ClockSkew(_) | Cause::VaryingLatency => {
                let of_poses = self.poses().map(|pose| {
                    self.latency_profile([&pose.robot, &pose.topic], &pose.latency_profile)
                });
                let of_imus = self.imus().map(|imu| {
                    self.latency_profile([&imu.robot, &imu.topic], &imu.latency_profile)
                });
                evidence.plots.extend(of_poses.chain(of_imus));
            }
            Cause::YawDrift(_) | Cause::YawJump => {
                evidence.plots.extend(self.yaw_errors());
                evidence.plots.extend(self.imus().map(heading_plot));
            }
            Cause::FrameTree => evidence.section = Some(("frames", "the tree of frames")),
            Cause::Stamps => evidence.section = Some(("timeline", "when each stream was there")),
            Cause::Pictured(Picture::Stream) => {
                evidence.plots.extend(self.positions_over_time());
                evidence.plots.extend(self.rotations_over_time());
                evidence.plots.extend(self.yaw_errors());
            }
            Cause::ImuMount(_) | Cause::CameraMount { .. } | Cause::Pictured(_) => {
                self.add_specific(&mut evidence);
                evidence.whiskers.extend(self.amount_whiskers());
            }
            Cause::Other => evidence.whiskers.extend(self.amount_whiskers()),
        }
        evidence.plots.retain(|plot| !plot.is_empty());
        evidence.planes.retain(|plane| !plane.is_empty());
        if evidence.is_empty() && !self.figures.timeline.is_empty() {
            evidence.section = Some(("timeline", "when each stream was there"));
        }
        evidence
    }

    fn amount_whiskers(&self) -> Option<Whiskers> {
        let rule = checks::find(self.finding.code).ok()?;
        let rows = self.checks(self.finding.code).flat_map(whiskers).map(|row| {
            let unit = row.amount.map(|(.., unit)| unit);
            Whisker {
                limit: unit.and_then(|unit| self.report.warning_threshold(rule, unit)),
                ..row
            }
        });
        let rows: Vec<Whisker> = rows.collect();
        let differ = rows.iter().any(|row| row.amount.is_some() && !row.is_fault);
        (!rows.is_empty()).then(|| Whiskers {
            title: if differ { "Compared with the other streams" } else { "Amount" }.to_owned(),
            caption: "With 95 % intervals; dashed: the limit.".to_owned(),
            rows,
        })
    }

    /// Poses of the topic, else of the robot.
    fn poses(&self) -> impl Iterator<Item = &PoseFigure> {
        let subject = &self.finding.subject;
        let is_of_subject = |pose: &&PoseFigure| self.is_subject(&pose.robot, &pose.topic);
        let has_own = self.figures.poses.iter().any(|pose| is_of_subject(&pose));
        let is_of_imu = self.imus().next().is_some();
        let is_of_robot = move |pose: &&PoseFigure| {
            !is_of_imu && !pose.is_derived && subject.arm() == Some(&pose.robot)
        };
        let poses = self.figures.poses.iter();
        poses
            .filter(move |pose| if has_own { is_of_subject(pose) } else { is_of_robot(pose) })
            .take(MAX_STREAMS)
    }

    fn imus(&self) -> impl Iterator<Item = &ImuFigure> {
        let imus = self.figures.imus.iter();
        imus.filter(|imu| self.is_subject(&imu.robot, &imu.topic)).take(MAX_STREAMS)
    }

    /// Only an arm has a reach.
    fn over_reach(&self) -> impl Iterator<Item = Plot> {
        let is_of_arm = self.finding.subject.reference.is_none();
        self.poses().filter(move |_| is_of_arm).map(errors::over_reach)
    }

    /// Several arms may share a topic such as /tf.
    fn is_subject(&self, robot: &str, topic: &str) -> bool {
        let subject = &self.finding.subject;
        subject.topic.as_deref() == Some(topic) && subject.arm().is_none_or(|its| its == robot)
    }

    fn checks(&self, code: &str) -> impl Iterator<Item = &CheckRow> {
        let robot = &self.finding.subject.robot;
        self.report.checks.iter().filter(move |row| row.code == code && row.subject.robot == *robot)
    }

    /// Latency, ms.
    fn latency_mark(&self, topic: &str) -> Option<PlotMark> {
        let row =
            self.checks(LAT001.code).find(|row| row.subject.topic.as_deref() == Some(topic))?;
        let Some(Estimate::Scalar { value, ci95, .. }) = &row.estimate else { return None };
        Some(PlotMark {
            at: value * 1e3,
            interval: ci95.map(|ends| ends.map(|end| end * 1e3)),
            label: Unit::Second.show_within(*value, *ci95),
        })
    }

    fn latency_residual(&self, pose: &PoseFigure) -> Plot {
        let spread = |part: usize| {
            let values = pose.residual_by_latency.iter().map(|at| at[part]);
            values.clone().fold(0.0, f64::max) - values.fold(f64::INFINITY, f64::min)
        };
        // If the tip rotates in place, only the rotation shows a latency.
        let in_place = spread(1) < 1e-5;
        let (part, factor, unit) =
            if in_place { (2, 1f64.to_degrees(), "rms °") } else { (1, 1e3, "rms mm") };
        let mark = self.latency_mark(&pose.topic);
        Plot {
            title: "Residual vs. assumed latency",
            robot: pose.robot.clone(),
            stream: pose.topic.clone(),
            caption: "Other causes already corrected; the minimum is the latency.".to_owned(),
            x: pose.residual_by_latency.iter().map(|at| at[0] * 1e3).collect(),
            x_label: "latency, ms",
            y_label: unit,
            series: vec![PlotSeries::new(
                "residual",
                SeriesRole::Amount,
                pose.residual_by_latency.iter().map(|at| at[part] * factor),
            )],
            from_zero: true,
            mark,
            limits: self.latency_limits(&LAT001, Unit::Second, 1e3),
            style: PlotStyle::Curve,
            ..Plot::default()
        }
    }

    fn correlation(&self, imu: &ImuFigure) -> Plot {
        Plot {
            title: "Correlation vs. assumed latency",
            robot: imu.robot.clone(),
            stream: imu.topic.clone(),
            caption: "Angular speed vs. forward kinematics. The peak is close to the latency; a fit refines it."
                .to_owned(),
            x: imu.correlation_by_latency.iter().map(|at| at[0] * 1e3).collect(),
            x_label: "latency, ms",
            y_label: "correlation",
            series: vec![PlotSeries::new(
                "correlation",
                SeriesRole::Amount,
                imu.correlation_by_latency.iter().map(|at| at[1]),
            )],
            from_zero: false,
            mark: self.latency_mark(&imu.topic),
            limits: self.latency_limits(&LAT001, Unit::Second, 1e3),
            style: PlotStyle::Curve,
            ..Plot::default()
        }
    }

    fn warning_limit(&self, unit: Unit) -> Option<f64> {
        self.report.warning_threshold(checks::find(self.finding.code).ok()?, unit)
    }

    /// For signed amounts. `factor` converts from SI.
    fn latency_limits(&self, rule: &Rule, unit: Unit, factor: f64) -> Vec<PlotLimit> {
        let limits = PlotLimit::signed(self.report.warning_threshold(rule, unit), unit, factor);
        limits.into_iter().map(|limit| PlotLimit { is_vertical: true, ..limit }).collect()
    }

    fn zero_offsets(&self) -> Option<Whiskers> {
        let rows = self.checks(ZER001.code).map(|row| {
            let joint = row.subject.label().to_owned();
            let Some(Estimate::Scalar { value, ci95, unit, .. }) = &row.estimate else {
                return Whisker { label: joint, amount: None, is_fault: false, limit: None };
            };
            let unit = if *unit == Unit::Metre.symbol() { Unit::Metre } else { Unit::Radian };
            Whisker {
                label: joint,
                amount: Some((*value, *ci95, unit)),
                is_fault: row.status == Status::Fail,
                limit: self.report.warning_threshold(&ZER001, unit),
            }
        });
        let rows: Vec<Whisker> = rows.collect();
        (rows.len() > 1).then(|| Whiskers {
            title: "Zero offsets of all joints".to_owned(),
            caption: "With 95 % intervals; dashed: the limit; q_true = q_reported + offset."
                .to_owned(),
            rows,
        })
    }

    fn yaw_errors(&self) -> impl Iterator<Item = Plot> {
        let limit = self.warning_limit(Unit::RadianPerSecond);
        self.imus().map(move |imu| {
            let mut plot = errors::yaw_error(imu, limit);
            if let Cause::YawDrift(drift) = &self.finding.cause {
                let label = "drift found".to_owned();
                let line = errors::drift_line(&plot.x, drift.value, label, SeriesRole::Reference);
                plot.series.insert(1, line);
            }
            plot
        })
    }
}

fn whiskers(row: &CheckRow) -> Vec<Whisker> {
    let label = row.subject.label();
    let amounts = row.estimate.as_ref().map(Estimate::amounts).unwrap_or_default();
    let names = match amounts.as_slice() {
        [only] if label.is_empty() => [only.name, ""],
        [_] => ["", ""],
        _ => ["distance", "angle"],
    };
    let whisker = |(amount, name): (&Amount, &str)| {
        let label = [label, name].into_iter().filter(|part| !part.is_empty());
        Some(Whisker {
            label: label.collect::<Vec<_>>().join(", "),
            amount: Some((amount.value, amount.ci95, amount.unit()?)),
            is_fault: row.status == Status::Fail,
            limit: None,
        })
    };
    amounts.iter().zip(names).filter_map(whisker).collect()
}

fn heading_plot(imu: &ImuFigure) -> Plot {
    let series = [(1, "IMU", SeriesRole::Before), (2, "FK", SeriesRole::Reference)];
    let series = series.map(|(part, label, role)| {
        PlotSeries::new(label, role, imu.headings.iter().map(|at| at[part].to_degrees()))
    });
    Plot {
        title: "Heading by IMU and by FK",
        robot: imu.robot.clone(),
        stream: imu.topic.clone(),
        caption: "Direction of one sensor axis about the vertical.".to_owned(),
        x: imu.headings.iter().map(|at| at[0]).collect(),
        x_label: "time, s",
        y_label: "°",
        series: series.into(),
        ..Plot::default()
    }
}

fn encoding_bars(scores: &[EncodingScore]) -> Option<Bars> {
    let bars = scores.iter().map(|score| Bar {
        label: match (score.is_as_logged, score.actual == score.assumed) {
            (true, _) => "as logged".to_owned(),
            (_, true) => score.actual.clone(),
            _ => format!("{} read as {}", score.actual, score.assumed),
        },
        value: score.rms_rad.to_degrees(),
        text: Unit::Radian.show(score.rms_rad),
        is_best: score.is_best,
    });
    let bars: Vec<Bar> = bars.collect();
    (!bars.is_empty()).then(|| Bars {
        title: "Residual under each rotation convention".to_owned(),
        caption: "Rms angle to forward kinematics, after fitting the frames of the best encoding."
            .to_owned(),
        bars,
    })
}
