//! Selects the plots that support a finding.

use std::collections::BTreeMap;

mod errors;
mod own;

use super::bars::{Bar, Bars, Whisker, Whiskers};
use super::plane::Plane;
use super::plot::{Limit, Mark, Plot, Role, Series, Style};
use crate::checks::{self, LAT001, Rule, ZER001};
use crate::finding::{Cause, CheckRow, Estimate, Finding, Picture, Status, Unit};
use crate::geometry::RotationError;
use crate::report::Report;
use crate::report::figures::{Figures, ImuFigure, PoseFigure, ReadingScore};

/// A joint or a whole arm may have many.
const MOST_STREAMS: usize = 3;

#[derive(Debug, Default)]
pub struct Proof {
    pub plots: Vec<Plot>,
    pub planes: Vec<Plane>,
    pub bars: Vec<Bars>,
    pub whiskers: Vec<Whiskers>,
    /// Findings (from 0) that already show one of these plots, with its title.
    pub shown_by: Vec<(usize, &'static str)>,
    /// Section of the page that shows it: id and name.
    pub part: Option<(&'static str, &'static str)>,
}

impl Proof {
    pub fn is_empty(&self) -> bool {
        self.plots.is_empty()
            && self.planes.is_empty()
            && self.bars.is_empty()
            && self.whiskers.is_empty()
            && self.shown_by.is_empty()
            && self.part.is_none()
    }
}

/// A shared plot appears with the first finding that uses it.
pub fn proofs(report: &Report) -> Vec<Proof> {
    let none = Figures::default();
    let figures = report.figures.as_ref().unwrap_or(&none);
    let mut first_in: BTreeMap<(&str, String, String), usize> = BTreeMap::new();
    let findings = report.findings.iter().enumerate();
    findings
        .map(|(index, finding)| {
            let mut proof = Case { report, figures, finding, index }.proof();
            let plots = std::mem::take(&mut proof.plots);
            for plot in plots {
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

struct Case<'a> {
    report: &'a Report,
    figures: &'a Figures,
    finding: &'a Finding,
    index: usize,
}

impl Case<'_> {
    fn proof(&self) -> Proof {
        let mut proof = Proof::default();
        match &self.finding.cause {
            Cause::Rotation(_) | Cause::InferredEncoding { .. } => {
                proof.plots.extend(self.poses().map(|pose| self.rotation_over_time(pose)));
                let is_whole =
                    |slip| matches!(slip, RotationError::Transposed | RotationError::Inverted);
                if matches!(self.finding.cause, Cause::Rotation(slip) if is_whole(slip)) {
                    proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
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
            | Cause::DhConvention(_)
            | Cause::TfDisagrees
            | Cause::Axes { .. }
            | Cause::ReferenceFrame(_)
            | Cause::ToolFrame(_) => {
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
                proof.plots.extend(self.poses().map(|pose| self.rotation_over_time(pose)));
            }
            Cause::Compliance
            | Cause::ParameterChange
            | Cause::UnexplainedResidual
            | Cause::Disagreement { .. }
            | Cause::OtherRobot(_) => {
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
                proof.plots.extend(self.poses().map(|pose| self.rotation_over_time(pose)));
                proof.plots.extend(self.poses().map(errors::over_reach));
                proof.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::JointZero { .. } => {
                proof.whiskers.extend(self.offsets());
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
                proof.plots.extend(self.poses().map(errors::over_reach));
                proof.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::RadialScale => {
                proof.plots.extend(self.poses().map(errors::over_reach));
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
                proof.planes.extend(self.poses().flat_map(errors::over_workspace));
            }
            Cause::Latency(_) => {
                proof.plots.extend(self.poses().map(|pose| self.valley(pose)));
                proof.plots.extend(self.imus().map(|imu| self.correlation(imu)));
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
            }
            Cause::ClockSkew(_) | Cause::VaryingLatency => {
                let of_poses = self
                    .poses()
                    .map(|pose| self.course([&pose.robot, &pose.topic], &pose.latency_course));
                let of_imus = self
                    .imus()
                    .map(|imu| self.course([&imu.robot, &imu.topic], &imu.latency_course));
                proof.plots.extend(of_poses.chain(of_imus));
            }
            Cause::YawDrift(_) | Cause::YawJump => {
                proof.plots.extend(self.imus().map(|imu| self.yaw_error(imu)));
                proof.plots.extend(self.imus().map(headings));
            }
            Cause::FrameTree => proof.part = Some(("frames", "the tree of frames")),
            Cause::Stamps => proof.part = Some(("timeline", "when each stream was there")),
            Cause::Pictured(Picture::Stream) => {
                proof.plots.extend(self.poses().map(|pose| self.position_over_time(pose)));
                proof.plots.extend(self.poses().map(|pose| self.rotation_over_time(pose)));
                proof.plots.extend(self.imus().map(|imu| self.yaw_error(imu)));
            }
            Cause::ImuMount(_) | Cause::CameraMount { .. } | Cause::Pictured(_) => {
                self.add_own(&mut proof);
                proof.whiskers.extend(self.amounts());
            }
            Cause::Other => proof.whiskers.extend(self.amounts()),
        }
        proof.plots.retain(|plot| !plot.is_empty());
        proof.planes.retain(|plane| !plane.is_empty());
        if proof.is_empty() && !self.figures.timeline.is_empty() {
            proof.part = Some(("timeline", "when each stream was there"));
        }
        proof
    }

    fn amounts(&self) -> Option<Whiskers> {
        let rule = checks::find(self.finding.code).ok()?;
        let rows = self.checks(self.finding.code).flat_map(whiskers).map(|row| {
            let unit = row.amount.map(|(.., unit)| unit);
            Whisker { limit: unit.and_then(|unit| self.report.warns_from(rule, unit)), ..row }
        });
        let rows: Vec<Whisker> = rows.collect();
        let differ = rows.iter().any(|row| row.amount.is_some() && !row.is_fault);
        (!rows.is_empty()).then(|| Whiskers {
            title: if differ { "Compared with the other streams" } else { "Amount" }.to_owned(),
            says: "With 95 % intervals; dashed: the limit.".to_owned(),
            rows,
        })
    }

    /// Poses of the topic, else of the robot.
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

    /// Several arms may share a topic such as /tf.
    fn is_on(&self, robot: &str, topic: &str) -> bool {
        let subject = &self.finding.subject;
        subject.topic.as_deref() == Some(topic)
            && subject.robot.as_deref().is_none_or(|its| its == robot)
    }

    fn checks(&self, code: &str) -> impl Iterator<Item = &CheckRow> {
        let robot = &self.finding.subject.robot;
        self.report.checks.iter().filter(move |row| row.code == code && row.subject.robot == *robot)
    }

    /// Latency, ms.
    fn latency_mark(&self, topic: &str) -> Option<Mark> {
        let row =
            self.checks(LAT001.code).find(|row| row.subject.topic.as_deref() == Some(topic))?;
        let Some(Estimate::Scalar { value, ci95, .. }) = &row.estimate else { return None };
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
        // If the tip rotates in place, only the rotation shows a latency.
        let in_place = spread(1) < 1e-5;
        let (part, factor, unit) =
            if in_place { (2, 1f64.to_degrees(), "rms °") } else { (1, 1e3, "rms mm") };
        let mark = self.latency_mark(&pose.topic);
        Plot {
            title: "Residual vs. assumed latency",
            robot: pose.robot.clone(),
            of: pose.topic.clone(),
            says: "Other causes already corrected; the minimum is the latency.".to_owned(),
            x: pose.left_by_latency.iter().map(|at| at[0] * 1e3).collect(),
            x_label: "latency, ms",
            y_label: unit,
            series: vec![Series {
                label: "residual".to_owned(),
                role: Role::Amount,
                values: pose.left_by_latency.iter().map(|at| at[part] * factor).collect(),
                half_widths: Vec::new(),
            }],
            from_zero: true,
            mark,
            limits: self.limits_along(&LAT001, Unit::Second, 1e3),
            style: Style::Curve,
        }
    }

    fn correlation(&self, imu: &ImuFigure) -> Plot {
        Plot {
            title: "Correlation vs. assumed latency",
            robot: imu.robot.clone(),
            of: imu.topic.clone(),
            says: "Angular speed vs. forward kinematics. The peak is close to the latency; a fit refines it."
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
            limits: self.limits_along(&LAT001, Unit::Second, 1e3),
            style: Style::Curve,
        }
    }

    fn own_limit(&self, unit: Unit) -> Option<f64> {
        self.report.warns_from(checks::find(self.finding.code).ok()?, unit)
    }

    /// For signed amounts. `factor` converts from SI.
    fn limits_along(&self, rule: &Rule, unit: Unit, factor: f64) -> Vec<Limit> {
        let limits = both_signs(self.report.warns_from(rule, unit), unit, factor);
        limits.into_iter().map(|limit| Limit { is_along: true, ..limit }).collect()
    }

    fn offsets(&self) -> Option<Whiskers> {
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
                limit: self.report.warns_from(&ZER001, unit),
            }
        });
        let rows: Vec<Whisker> = rows.collect();
        (rows.len() > 1).then(|| Whiskers {
            title: "Zero offsets of all joints".to_owned(),
            says: "With 95 % intervals; dashed: the limit; q_true = q_reported + offset."
                .to_owned(),
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
        if let (Some(rate), [first, .., last]) =
            (self.own_limit(Unit::RadianPerSecond), t_s.as_slice())
        {
            let middle = 0.5 * (first + last);
            series.push(Series {
                label: format!("limit {}", Unit::RadianPerSecond.show(rate)),
                role: Role::Limit,
                values: t_s.iter().map(|t_s| (rate * (t_s - middle)).to_degrees()).collect(),
                half_widths: Vec::new(),
            });
        }
        Plot {
            title: "IMU yaw − FK yaw",
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

/// `factor` converts from SI.
fn both_signs(limit: Option<f64>, unit: Unit, factor: f64) -> Vec<Limit> {
    let label = limit.map_or(String::new(), |limit| format!("limit ±{}", unit.show(limit)));
    let ends =
        limit.into_iter().flat_map(|limit| [(-limit, String::new()), (limit, label.clone())]);
    ends.map(|(at, label)| Limit { at: at * factor, is_along: false, label }).collect()
}

fn one_sided(limit: Option<f64>, unit: Unit, factor: f64) -> Vec<Limit> {
    let limit = limit.map(|limit| Limit {
        at: limit * factor,
        is_along: false,
        label: format!("limit {}", unit.show(limit)),
    });
    limit.into_iter().collect()
}

fn whiskers(row: &CheckRow) -> Vec<Whisker> {
    let label = row.subject.label();
    let whisker = |what: &str, name: &str, value: f64, ci95, symbol: &str| {
        let label = [label, what].into_iter().filter(|part| !part.is_empty());
        Some(Whisker {
            label: label.collect::<Vec<_>>().join(", "),
            amount: Some((value, ci95, Unit::from_symbol(symbol, name)?)),
            is_fault: row.status == Status::Fail,
            limit: None,
        })
    };
    let radian = Unit::Radian.symbol();
    let amounts = match &row.estimate {
        Some(Estimate::Scalar { name, value, ci95, unit, .. }) => {
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

fn headings(imu: &ImuFigure) -> Plot {
    let series = [(1, "IMU", Role::Before), (2, "FK", Role::Beside)];
    let series = series.map(|(part, label, role)| Series {
        label: label.to_owned(),
        role,
        values: imu.headings.iter().map(|at| at[part].to_degrees()).collect(),
        half_widths: Vec::new(),
    });
    Plot {
        title: "Heading by IMU and by FK",
        robot: imu.robot.clone(),
        of: imu.topic.clone(),
        says: "Direction of one sensor axis about the vertical.".to_owned(),
        x: imu.headings.iter().map(|at| at[0]).collect(),
        x_label: "time, s",
        y_label: "°",
        series: series.into(),
        ..Plot::default()
    }
}

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
        says: "Rms angle to forward kinematics, after fitting the frames of the best encoding."
            .to_owned(),
        bars,
    })
}
