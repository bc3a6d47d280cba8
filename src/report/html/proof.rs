//! Which picture proves a finding.

use std::collections::BTreeMap;

use super::bars::{Bar, Bars, Whisker, Whiskers};
use super::plot::{Mark, Plot, Role, Series, Style};
use crate::checks::{LAT001, ZER001};
use crate::finding::{Cause, CheckRow, Estimate, Finding, Status, Unit};
use crate::geometry::RotationSlip;
use crate::report::Report;
use crate::report::figures::{CoursePoint, Figures, ImuFigure, PoseFigure, ReadingScore};

/// Streams that one finding shows; of a joint or a whole arm there may be many.
const MOST_STREAMS: usize = 3;

/// What stands under a finding.
#[derive(Debug, Default)]
pub struct Proof {
    /// Its pictures.
    pub plots: Vec<Plot>,
    /// Its bars.
    pub bars: Vec<Bars>,
    /// Its amounts with their intervals.
    pub whiskers: Vec<Whiskers>,
    /// Findings, counted from 0, that show a picture of this one already, with its title.
    pub shown_by: Vec<(usize, &'static str)>,
    /// A part of the page that shows it: its id, and what it shows.
    pub part: Option<(&'static str, &'static str)>,
}

impl Proof {
    /// Whether nothing shows the finding.
    pub fn is_empty(&self) -> bool {
        self.plots.is_empty()
            && self.bars.is_empty()
            && self.whiskers.is_empty()
            && self.shown_by.is_empty()
            && self.part.is_none()
    }
}

/// The proofs of a report's findings, in their order. A picture that several share stands with the
/// first of them.
pub fn proofs(report: &Report) -> Vec<Proof> {
    let none = Figures::default();
    let figures = report.figures.as_ref().unwrap_or(&none);
    let mut first_in: BTreeMap<(&str, String, String), usize> = BTreeMap::new();
    let findings = report.findings.iter().enumerate();
    findings
        .map(|(index, finding)| {
            let mut proof = Case { report, figures, finding }.proof();
            let plots = std::mem::take(&mut proof.plots);
            for plot in plots.into_iter().filter(|plot| !plot.is_empty()) {
                let key = (plot.title, plot.robot.clone(), plot.of.clone());
                match first_in.get(&key) {
                    Some(&first) if first == index => {}
                    Some(&first) => proof.shown_by.push((first, plot.title)),
                    None => {
                        first_in.insert(key, index);
                        proof.plots.push(plot);
                    }
                }
            }
            proof
        })
        .collect()
}

/// A finding with what its pictures are drawn from.
struct Case<'a> {
    report: &'a Report,
    figures: &'a Figures,
    finding: &'a Finding,
}

impl Case<'_> {
    fn proof(&self) -> Proof {
        let mut proof = Proof::default();
        match &self.finding.cause {
            Cause::Rotation(_) | Cause::Bare { .. } => {
                proof.plots.extend(self.poses().map(rotation_over_time));
                let is_whole =
                    |slip| matches!(slip, RotationSlip::Transposed | RotationSlip::Inverted);
                if matches!(self.finding.cause, Cause::Rotation(slip) if is_whole(slip)) {
                    proof.plots.extend(self.poses().map(position_over_time));
                }
                let of_poses = self.poses().map(|pose| readings(&pose.readings));
                let of_imus = self.imus().map(|imu| readings(&imu.readings));
                proof.bars.extend(of_poses.chain(of_imus).flatten());
            }
            Cause::AngleUnit(_)
            | Cause::LengthUnit(_)
            | Cause::JointUnit(_)
            | Cause::JointScale(_)
            | Cause::JointOrder { .. }
            | Cause::Dh(_)
            | Cause::TfDisagrees
            | Cause::Reference(_)
            | Cause::Tool(_) => {
                proof.plots.extend(self.poses().map(position_over_time));
                proof.plots.extend(self.poses().map(rotation_over_time));
            }
            Cause::Bend
            | Cause::Changes
            | Cause::Model
            | Cause::Disagreement { .. }
            | Cause::OtherRobot(_) => {
                proof.plots.extend(self.poses().map(position_over_time));
                proof.plots.extend(self.poses().map(rotation_over_time));
                proof.plots.extend(self.poses().map(error_over_reach));
            }
            Cause::JointZero { .. } => {
                proof.whiskers.extend(self.offsets());
                proof.plots.extend(self.poses().map(position_over_time));
                proof.plots.extend(self.poses().map(error_over_reach));
            }
            Cause::Growth => {
                proof.plots.extend(self.poses().map(error_over_reach));
                proof.plots.extend(self.poses().map(position_over_time));
            }
            Cause::Latency(_) => {
                proof.plots.extend(self.poses().map(|pose| self.valley(pose)));
                proof.plots.extend(self.imus().map(|imu| self.correlation(imu)));
                proof.plots.extend(self.poses().map(position_over_time));
            }
            Cause::Skew(_) | Cause::UnsteadyLatency => {
                let of_poses = self
                    .poses()
                    .map(|pose| course([&pose.robot, &pose.topic], &pose.latency_course));
                let of_imus =
                    self.imus().map(|imu| course([&imu.robot, &imu.topic], &imu.latency_course));
                proof.plots.extend(of_poses.chain(of_imus));
            }
            Cause::YawDrift(_) | Cause::YawJump => {
                proof.plots.extend(self.imus().map(|imu| self.yaw_error(imu)));
                proof.plots.extend(self.imus().map(headings));
            }
            Cause::Frames => proof.part = Some(("frames", "the tree of frames")),
            Cause::Stamps => proof.part = Some(("timeline", "when each stream was there")),
            Cause::Axes { .. } | Cause::ImuMount(_) | Cause::CameraMount { .. } | Cause::Other => {
                proof.whiskers.extend(self.amounts())
            }
        }
        proof
    }

    /// What the rule found on everything of this robot that it was asked about.
    fn amounts(&self) -> Option<Whiskers> {
        let rows: Vec<Whisker> = self.checks(self.finding.code).flat_map(whiskers).collect();
        let differ = rows.iter().any(|row| row.amount.is_some() && !row.is_fault);
        (!rows.is_empty()).then(|| Whiskers {
            title: if differ { "Compared with the other streams" } else { "What was found" }
                .to_owned(),
            says: "Bars are 95 % intervals.".to_owned(),
            rows,
        })
    }

    /// The pose streams that the finding is on: that of its topic, else those of its robot.
    fn poses(&self) -> impl Iterator<Item = &PoseFigure> {
        let subject = &self.finding.subject;
        let is_its = |pose: &&PoseFigure| self.is_on(&pose.robot, &pose.topic);
        let has_own = self.figures.poses.iter().any(|pose| is_its(&pose));
        let is_of_imu = self.imus().next().is_some();
        let is_of_robot = move |pose: &&PoseFigure| {
            !is_of_imu && !pose.is_derived && subject.robot.as_ref() == Some(&pose.robot)
        };
        let poses = self.figures.poses.iter();
        poses
            .filter(move |pose| if has_own { is_its(pose) } else { is_of_robot(pose) })
            .take(MOST_STREAMS)
    }

    fn imus(&self) -> impl Iterator<Item = &ImuFigure> {
        let imus = self.figures.imus.iter();
        imus.filter(|imu| self.is_on(&imu.robot, &imu.topic)).take(MOST_STREAMS)
    }

    /// Whether the finding is on this stream: several arms may share a topic, such as /tf.
    fn is_on(&self, robot: &str, topic: &str) -> bool {
        let subject = &self.finding.subject;
        subject.topic.as_deref() == Some(topic)
            && subject.robot.as_deref().is_none_or(|its| its == robot)
    }

    /// The check of another rule or subject of the report.
    fn checks(&self, code: &str) -> impl Iterator<Item = &CheckRow> {
        let robot = &self.finding.subject.robot;
        self.report.checks.iter().filter(move |row| row.code == code && row.subject.robot == *robot)
    }

    /// The latency found on a topic, as a mark in ms.
    fn latency_mark(&self, topic: &str) -> Option<Mark> {
        let row =
            self.checks(LAT001.code).find(|row| row.subject.topic.as_deref() == Some(topic))?;
        let Some(Estimate::Amount { value, ci95, .. }) = &row.estimate else { return None };
        Some(Mark {
            at: value * 1e3,
            interval: ci95.map(|ends| ends.map(|end| end * 1e3)),
            label: Unit::Second.show_within(*value, *ci95),
        })
    }

    fn valley(&self, pose: &PoseFigure) -> Plot {
        let spread = |part: usize| {
            let values = pose.left_by_latency.iter().map(|at| at[part]);
            values.clone().fold(0.0, f64::max) - values.fold(f64::INFINITY, f64::min)
        };
        // A tip that turns on the spot shows a latency in its rotation only.
        let in_place = spread(1) < 1e-5;
        let (part, factor, unit) =
            if in_place { (2, 1f64.to_degrees(), "rms °") } else { (1, 1e3, "rms mm") };
        let mark = self.latency_mark(&pose.topic);
        Plot {
            title: "What is left at each latency",
            robot: pose.robot.clone(),
            of: pose.topic.clone(),
            says: "The rest of the error, all else taken off, if the stream were late by so much: \
                   the bottom of the valley is the latency."
                .to_owned(),
            x: pose.left_by_latency.iter().map(|at| at[0] * 1e3).collect(),
            x_label: "latency, ms",
            y_label: unit,
            series: vec![Series {
                label: "left".to_owned(),
                role: Role::Amount,
                values: pose.left_by_latency.iter().map(|at| at[part] * factor).collect(),
                half_widths: Vec::new(),
            }],
            from_zero: true,
            mark,
            style: Style::Curve,
        }
    }

    fn correlation(&self, imu: &ImuFigure) -> Plot {
        Plot {
            title: "How it follows the arm at each latency",
            robot: imu.robot.clone(),
            of: imu.topic.clone(),
            says:
                "Correlation of its speed of turning with forward kinematics, if it were late by \
                   so much: the peak is near the latency, which a finer fit gives."
                    .to_owned(),
            x: imu.correlation_by_latency.iter().map(|at| at[0] * 1e3).collect(),
            x_label: "latency, ms",
            y_label: "correlation",
            series: vec![Series {
                label: "correlation".to_owned(),
                role: Role::Amount,
                values: imu.correlation_by_latency.iter().map(|at| at[1]).collect(),
                half_widths: Vec::new(),
            }],
            from_zero: false,
            mark: self.latency_mark(&imu.topic),
            style: Style::Curve,
        }
    }

    /// The zero offsets of all joints of the robot.
    fn offsets(&self) -> Option<Whiskers> {
        let rows = self.checks(ZER001.code).map(|row| {
            let joint = row.subject.label().to_owned();
            let Some(Estimate::Amount { value, ci95, unit, .. }) = &row.estimate else {
                return Whisker { label: joint, amount: None, is_fault: false };
            };
            let unit = if *unit == Unit::Metre.symbol() { Unit::Metre } else { Unit::Radian };
            Whisker {
                label: joint,
                amount: Some((*value, *ci95, unit)),
                is_fault: row.status == Status::Fail,
            }
        });
        let rows: Vec<Whisker> = rows.collect();
        (rows.len() > 1).then(|| Whiskers {
            title: "Zero offsets of all joints".to_owned(),
            says: "With their 95 % intervals; q_true = q_reported + offset.".to_owned(),
            rows,
        })
    }

    fn yaw_error(&self, imu: &ImuFigure) -> Plot {
        let t_s: Vec<f64> = imu.yaw_error.iter().map(|at| at[0]).collect();
        let mut series = vec![Series {
            label: "IMU − FK".to_owned(),
            role: Role::Before,
            values: imu.yaw_error.iter().map(|at| at[1].to_degrees()).collect(),
            half_widths: Vec::new(),
        }];
        if let (Cause::YawDrift(drift), [first, .., last]) = (&self.finding.cause, t_s.as_slice()) {
            let middle = 0.5 * (first + last);
            series.push(Series {
                label: "drift found".to_owned(),
                role: Role::Beside,
                values: t_s.iter().map(|t_s| (drift.value * (t_s - middle)).to_degrees()).collect(),
                half_widths: Vec::new(),
            });
        }
        Plot {
            title: "Yaw over that of the arm",
            robot: imu.robot.clone(),
            of: imu.topic.clone(),
            says: "A slope is drift; a good IMU stays flat.".to_owned(),
            x: t_s,
            x_label: "time, s",
            y_label: "°",
            series,
            ..Plot::default()
        }
    }
}

/// The amount of a check: of a frame, its length and its angle.
fn whiskers(row: &CheckRow) -> Vec<Whisker> {
    let label = row.subject.label();
    let whisker = |what: &str, name: &str, value: f64, ci95, symbol: &str| {
        let label = [label, what].into_iter().filter(|part| !part.is_empty());
        Some(Whisker {
            label: label.collect::<Vec<_>>().join(", "),
            amount: Some((value, ci95, Unit::of(symbol, name)?)),
            is_fault: row.status == Status::Fail,
        })
    };
    let radian = Unit::Radian.symbol();
    let amounts = match &row.estimate {
        Some(Estimate::Amount { name, value, ci95, unit, .. }) => {
            let what = if label.is_empty() { name } else { "" };
            vec![whisker(what, name, *value, *ci95, unit)]
        }
        Some(Estimate::Frame { name, value, ci95, unit, rotation, .. }) => vec![
            whisker("distance", name, *value, *ci95, unit),
            whisker("angle", name, rotation.value, rotation.ci95, radian),
        ],
        _ => Vec::new(),
    };
    amounts.into_iter().flatten().collect()
}

fn position_over_time(pose: &PoseFigure) -> Plot {
    over_time(
        pose,
        "Position error over time",
        "Distance of the logged position from forward kinematics",
        ("mm", 1e3),
        [&pose.before_m, &pose.after_m],
    )
}

fn rotation_over_time(pose: &PoseFigure) -> Plot {
    over_time(
        pose,
        "Rotation error over time",
        "Angle of the logged orientation to forward kinematics",
        ("°", 1f64.to_degrees()),
        [&pose.before_rad, &pose.after_rad],
    )
}

fn over_time(
    pose: &PoseFigure,
    title: &'static str,
    what: &str,
    (unit, factor): (&'static str, f64),
    series: [&Vec<f64>; 2],
) -> Plot {
    let series = before_and_after(series, factor);
    Plot {
        title,
        robot: pose.robot.clone(),
        of: pose.topic.clone(),
        says: format!("{what}: {}.", most(&series, unit)),
        x: pose.t_s.clone(),
        x_label: "time, s",
        y_label: unit,
        series,
        from_zero: true,
        ..Plot::default()
    }
}

fn error_over_reach(pose: &PoseFigure) -> Plot {
    let mut rows: Vec<usize> = (0..pose.reach_m.len()).collect();
    rows.sort_by(|&a, &b| pose.reach_m[a].total_cmp(&pose.reach_m[b]));
    let sorted = |values: &Vec<f64>| -> Vec<f64> {
        rows.iter().filter_map(|&row| values.get(row).copied()).collect()
    };
    let series = before_and_after([&sorted(&pose.before_m), &sorted(&pose.after_m)], 1e3);
    Plot {
        title: "Position error vs. reach",
        robot: pose.robot.clone(),
        of: pose.topic.clone(),
        says: "A wrong zero or length shows more the further the arm reaches.".to_owned(),
        x: sorted(&pose.reach_m),
        x_label: "distance from the base, m",
        y_label: "mm",
        series,
        from_zero: true,
        style: Style::Points,
        mark: None,
    }
}

/// The two states of a stream; as logged only where the log ties its frame to the arm.
fn before_and_after([before, after]: [&Vec<f64>; 2], factor: f64) -> Vec<Series> {
    let states = [("as logged", Role::Before, before), ("after correction", Role::After, after)];
    let drawn = states.into_iter().filter(|(.., values)| !values.is_empty());
    drawn
        .map(|(label, role, values)| Series {
            label: label.to_owned(),
            role,
            values: values.iter().map(|value| value * factor).collect(),
            half_widths: Vec::new(),
        })
        .collect()
}

/// `up to 24 mm as logged, up to 0.1 mm explained`.
fn most(series: &[Series], unit: &str) -> String {
    let parts = series.iter().map(|series| {
        let finite = series.values.iter().copied().filter(|value| value.is_finite());
        let most = finite.fold(0.0, f64::max);
        let decimals = if most >= 10.0 { 1 } else { 3 };
        let space = if unit == "°" { "" } else { " " };
        format!("up to {most:.decimals$}{space}{unit} {}", series.label)
    });
    parts.collect::<Vec<_>>().join(", ")
}

fn course([robot, topic]: [&str; 2], points: &[CoursePoint]) -> Plot {
    Plot {
        title: "Latency over time",
        robot: robot.to_owned(),
        of: topic.to_owned(),
        says: "In windows of a second with their 95 % intervals, beyond that of the whole run."
            .to_owned(),
        x: points.iter().map(|point| point.t_s).collect(),
        x_label: "time, s",
        y_label: "ms",
        series: vec![Series {
            label: "latency".to_owned(),
            role: Role::Amount,
            values: points.iter().map(|point| point.beyond_s * 1e3).collect(),
            half_widths: points.iter().map(|point| point.half_width_s * 1e3).collect(),
        }],
        style: Style::Points,
        ..Plot::default()
    }
}

fn headings(imu: &ImuFigure) -> Plot {
    let series = [(1, "IMU", Role::Before), (2, "FK", Role::Beside)];
    let series = series.map(|(part, label, role)| Series {
        label: label.to_owned(),
        role,
        values: imu.headings.iter().map(|at| at[part].to_degrees()).collect(),
        half_widths: Vec::new(),
    });
    Plot {
        title: "Heading by the IMU and by the arm",
        robot: imu.robot.clone(),
        of: imu.topic.clone(),
        says: "Where one axis of the sensor points about the vertical.".to_owned(),
        x: imu.headings.iter().map(|at| at[0]).collect(),
        x_label: "time, s",
        y_label: "°",
        series: series.into(),
        ..Plot::default()
    }
}

/// What each reading of a stream's rotations leaves.
fn readings(scores: &[ReadingScore]) -> Option<Bars> {
    let bars = scores.iter().map(|score| Bar {
        label: match (score.is_as_logged, score.is == score.read_as) {
            (true, _) => "as logged".to_owned(),
            (_, true) => score.is.clone(),
            _ => format!("{} read as {}", score.is, score.read_as),
        },
        value: score.rms_rad.to_degrees(),
        shown: Unit::Radian.show(score.rms_rad),
        is_best: score.is_best,
    });
    let bars: Vec<Bar> = bars.collect();
    (!bars.is_empty()).then(|| Bars {
        title: "Residual under each rotation convention".to_owned(),
        says: "Angle to forward kinematics, rms, with the frames that the best reading needs."
            .to_owned(),
        bars,
    })
}
