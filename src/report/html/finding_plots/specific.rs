//! Plots specific to single findings.

use super::{FindingContext, FindingPlots};
use crate::finding::{Estimate, Unit};
use crate::report::figures::{FindingFigure, JointFigure};
use crate::report::html::plane::{Arrow, Dot, Plane};
use crate::report::html::plot::{Plot, PlotLimit, PlotMark, PlotSeries, PlotStyle, SeriesRole};

impl FindingContext<'_> {
    /// Adds nothing without data.
    pub(super) fn add_specific(&self, evidence: &mut FindingPlots) {
        let own = self.figures.of_findings.iter().filter(|(index, _)| *index == self.index);
        for (_, own) in own {
            match own {
                FindingFigure::Vibration { spectrum, trace } => {
                    evidence.plots.extend([self.spectrum(spectrum), self.trace(trace)]);
                }
                FindingFigure::HandEye { closures: each, directions: views, .. } => {
                    let [distance, angle] = self.closures(each);
                    evidence.plots.extend([distance, angle]);
                    evidence.planes.push(view_directions(views));
                }
                FindingFigure::Line { tip, command } => {
                    let plots = [
                        self.line_deviation(tip, Unit::Metre),
                        self.line_deviation(tip, Unit::Radian),
                        self.command(command),
                    ];
                    evidence.plots.extend(plots.into_iter().filter(is_near_limit));
                }
                FindingFigure::RestErrors(gaps) => evidence.planes.extend(self.rest_errors(gaps)),
                FindingFigure::RotationNorms(rows) => {
                    evidence.plots.push(self.rotation_norms(rows))
                }
                FindingFigure::ImuAxes { link, estimated: found, logged } => {
                    evidence.planes.push(imu_axes(link, found, logged.as_ref()));
                }
                FindingFigure::Gyro { rates, is_at_rest: at_rest, bias } => {
                    evidence.plots.push(self.gyro(rates, *at_rest, *bias));
                }
                FindingFigure::Tilt(up) => evidence.planes.push(self.tilt(up)),
                FindingFigure::Joint(joint) => evidence.plots.extend(self.joint(joint)),
            }
        }
    }

    fn plot(&self, title: &'static str, says: impl Into<String>, axes: [&'static str; 2]) -> Plot {
        let subject = &self.finding.subject;
        Plot {
            title,
            robot: subject.arm().cloned().unwrap_or_default(),
            stream: subject.topic.clone().or_else(|| subject.joint.clone()).unwrap_or_default(),
            caption: says.into(),
            x_label: axes[0],
            y_label: axes[1],
            ..Plot::default()
        }
    }

    fn evidence(&self, key: &str) -> Option<f64> {
        self.finding.evidence.more.get(key)?.as_f64()
    }

    fn spectrum(&self, spectrum: &[[f64; 2]]) -> Plot {
        let peak = self.evidence("frequency_hz");
        let mark =
            peak.map(|at| PlotMark { at, interval: None, label: format!("peak {at:.1} Hz") });
        let from = self.evidence("from_hz").map(|at| PlotLimit {
            at,
            is_vertical: true,
            label: format!("counted above {at:.0} Hz"),
        });
        Plot {
            x: spectrum.iter().map(|at| at[0]).collect(),
            series: vec![PlotSeries::new(
                "rms",
                SeriesRole::Amount,
                spectrum.iter().map(|at| at[1] * 1e3),
            )],
            from_zero: true,
            mark,
            limits: from.into_iter().collect(),
            style: PlotStyle::Curve,
            ..self.plot(
                "Spectrum of the tip's path",
                "Rms per bin over the second with the strongest vibration, all axes.",
                ["frequency, Hz", "mm rms"],
            )
        }
    }

    fn trace(&self, trace: &[[f64; 2]]) -> Plot {
        Plot {
            x: trace.iter().map(|at| at[0]).collect(),
            series: vec![PlotSeries::new(
                "tip",
                SeriesRole::Before,
                trace.iter().map(|at| at[1] * 1e3),
            )],
            limits: PlotLimit::signed(self.warning_limit(Unit::Metre), Unit::Metre, 1e3),
            style: PlotStyle::Curve,
            ..self.plot(
                "Path during the strongest vibration",
                "Deviation from a parabola along the axis with most motion; the limit applies to the rms.",
                ["time, s", "mm"],
            )
        }
    }

    fn closures(&self, each: &[[f64; 3]]) -> [Plot; 2] {
        let parts = [
            ("Hand-eye residual of each view", 1, Unit::Metre, "mm", 1e3),
            ("Hand-eye residual angle of each view", 2, Unit::Radian, "°", 1f64.to_degrees()),
        ];
        parts.map(|(title, part, unit, label, factor)| Plot {
            x: each.iter().map(|at| at[0]).collect(),
            series: vec![PlotSeries::new(
                "view",
                SeriesRole::Before,
                each.iter().map(|at| at[part] * factor),
            )],
            from_zero: true,
            limits: PlotLimit::upper(self.warning_limit(unit), unit, factor),
            style: PlotStyle::Points,
            ..self.plot(title, "Closure error of hand, camera and target.", ["time, s", label])
        })
    }

    fn line_deviation(&self, tip: &[[f64; 3]], unit: Unit) -> Plot {
        let (title, part, label, factor) = match unit {
            Unit::Metre => ("Deviation from the commanded line", 1, "mm", 1e3),
            _ => ("Deviation from slerp", 2, "°", 1f64.to_degrees()),
        };
        Plot {
            x: tip.iter().map(|at| at[0] * 1e3).collect(),
            series: vec![PlotSeries::new(
                "tip by FK",
                SeriesRole::Before,
                tip.iter().map(|at| at[part] * factor),
            )],
            from_zero: true,
            limits: PlotLimit::upper(self.warning_limit(unit), unit, factor),
            style: PlotStyle::Curve,
            ..self.plot(
                title,
                "The worst line, compared with the straight line between its ends.",
                ["along the line, mm", label],
            )
        }
    }

    fn command(&self, command: &[[f64; 3]]) -> Plot {
        let angle = command.iter().map(|at| at[2].to_degrees());
        Plot {
            x: command.iter().map(|at| at[0] * 1e3).collect(),
            series: vec![PlotSeries::new("command", SeriesRole::Amount, angle)],
            from_zero: true,
            limits: PlotLimit::upper(
                self.warning_limit(Unit::Radian),
                Unit::Radian,
                1f64.to_degrees(),
            ),
            style: PlotStyle::Curve,
            ..self.plot(
                "Commanded orientation vs. slerp",
                "The command, compared with slerp between its ends.",
                ["along the line, mm", "°"],
            )
        }
    }

    /// Rest positions relative to the goals, and a top view of both.
    fn rest_errors(&self, gaps: &[[[f64; 3]; 2]]) -> [Plane; 2] {
        let off = |axes: [usize; 2]| {
            gaps.iter().map(move |[goal, rest]| axes.map(|axis| (rest[axis] - goal[axis]) * 1e3))
        };
        let limit = self.warning_limit(Unit::Metre);
        let around = Plane {
            title: "Rest positions relative to goals".to_owned(),
            caption: "Measured − commanded, top view; goals at the centre.".to_owned(),
            axes: ["x, mm", "y, mm"],
            arrows: off([0, 1])
                .map(|to| Arrow {
                    from: [0.0; 2],
                    to,
                    label: String::new(),
                    role: SeriesRole::Before,
                })
                .collect(),
            limit: limit.map(|limit| (limit * 1e3, format!("limit {}", Unit::Metre.show(limit)))),
            ..Plane::default()
        };
        let place = |at: &[f64; 3]| [at[0], at[1]];
        let dots = gaps.iter().flat_map(|[goal, rest]| {
            [(place(goal), SeriesRole::Reference), (place(rest), SeriesRole::Before)]
        });
        let whole = Plane {
            title: "Goals and rests".to_owned(),
            caption: "Top view in the base frame: goals dark, rest positions red.".to_owned(),
            axes: ["x, m", "y, m"],
            dots: dots.map(|(at, role)| Dot { at, size: 0.5, role }).collect(),
            ..Plane::default()
        };
        [around, whole]
    }

    fn rotation_norms(&self, rows: &[[f64; 2]]) -> Plot {
        Plot {
            x: rows.iter().map(|at| at[0]).collect(),
            series: vec![PlotSeries::new(
                "defect",
                SeriesRole::Before,
                rows.iter().map(|at| at[1]),
            )],
            from_zero: true,
            limits: PlotLimit::upper(self.warning_limit(Unit::One), Unit::One, 1.0),
            ..self.plot(
                "Deviation from a rotation",
                "Quaternion: deviation of the norm from 1. Matrix: deviation from orthonormality.",
                ["time, s", "deviation"],
            )
        }
    }

    fn gyro(&self, rates: &[[f64; 4]], at_rest: bool, bias: Option<[f64; 3]>) -> Plot {
        let roles = [SeriesRole::Before, SeriesRole::After, SeriesRole::Amount];
        let axis = |(part, role): (usize, SeriesRole)| {
            let found = bias.map_or(String::new(), |bias| {
                format!(", bias {}", Unit::GyroRate.show_signed_within(bias[part], None))
            });
            let label = format!("{}{found}", ["x", "y", "z"][part]);
            PlotSeries::new(label, role, rates.iter().map(|at| at[part + 1].to_degrees()))
        };
        let says = match at_rest {
            true => "While all joints rest: a good gyro reads zero.",
            false => "The arm never rests, so its motion is included.",
        };
        Plot {
            x: rates.iter().map(|at| at[0]).collect(),
            series: roles.into_iter().enumerate().map(axis).collect(),
            limits: PlotLimit::signed(
                self.warning_limit(Unit::GyroRate),
                Unit::GyroRate,
                1f64.to_degrees(),
            ),
            style: PlotStyle::Points,
            ..self.plot(if at_rest { "Gyro at rest" } else { "Gyro" }, says, ["time, s", "°/s"])
        }
    }

    fn tilt(&self, up: &[[f64; 2]]) -> Plane {
        let limit = self.warning_limit(Unit::Radian);
        Plane {
            title: "Up direction by the accelerometer".to_owned(),
            caption: "In the world frame of the orientation, while the arm rests; level is at the centre."
                .to_owned(),
            axes: ["towards x, °", "towards y, °"],
            dots: up
                .iter()
                .map(|at| Dot { at: at.map(f64::to_degrees), size: 0.2, role: SeriesRole::Before })
                .collect(),
            limit: limit
                .map(|limit| (limit.to_degrees(), format!("limit {}", Unit::Radian.show(limit)))),
            ..Plane::default()
        }
    }

    fn joint(&self, joint: &JointFigure) -> [Plot; 2] {
        let factor = if joint.is_prismatic { 1e3 } else { 1f64.to_degrees() };
        let [unit, rate] = if joint.is_prismatic { ["mm", "mm/s"] } else { ["°", "°/s"] };
        let limit = |at: f64, label: &str| PlotLimit {
            at: at * factor,
            is_vertical: false,
            label: label.to_owned(),
        };
        let ends = joint.limits.iter().flatten().map(|at| limit(*at, "limit"));
        let speed =
            joint.max_speed.iter().flat_map(|at| [limit(*at, "speed limit"), limit(-at, "")]);
        let is_of_time =
            |key: &str| self.finding.evidence.more.get(key)?.as_str()?.parse::<i64>().ok();
        let start = self.figures.start.map_or(0, |start| start.nanos());
        let mark = is_of_time("at_ns").map(|at| PlotMark {
            at: crate::time::seconds(at - start),
            interval: None,
            label: self.amount_text(),
        });
        let velocity = (!joint.velocity.is_empty()).then(|| {
            PlotSeries::new(
                "recorded velocity",
                SeriesRole::Before,
                joint.velocity.iter().map(|v| v * factor),
            )
        });
        let rates = PlotSeries::new(
            "rate from the positions",
            SeriesRole::After,
            joint.differentiated.iter().map(|v| v * factor),
        );
        let says = joint.joint.clone();
        [
            Plot {
                x: joint.t_s.clone(),
                series: velocity.into_iter().chain([rates]).collect(),
                limits: speed.collect(),
                mark: mark.clone(),
                stream: says.clone(),
                ..self.plot(
                    "Joint speed",
                    "Recorded, and computed from the positions.",
                    ["time, s", rate],
                )
            },
            Plot {
                x: joint.t_s.clone(),
                series: vec![PlotSeries::new(
                    "position",
                    SeriesRole::Amount,
                    joint.position.iter().map(|q| q * factor),
                )],
                limits: ends.collect(),
                mark,
                stream: says,
                ..self.plot("Joint position", "As recorded.", ["time, s", unit])
            },
        ]
    }

    fn amount_text(&self) -> String {
        match &self.finding.estimate {
            Some(Estimate::Scalar { name, value, unit, .. }) => {
                Unit::from_symbol(unit, name).map_or(String::new(), |unit| unit.show(*value))
            }
            _ => String::new(),
        }
    }
}

/// Whether the values reach a tenth of the limit.
fn is_near_limit(plot: &Plot) -> bool {
    let values = plot.series.iter().flat_map(|series| &series.values);
    let most = values.map(|value| value.abs()).fold(0.0, f64::max);
    plot.limits.iter().all(|limit| most >= 0.1 * limit.at)
}

fn view_directions(views: &[[f64; 2]]) -> Plane {
    Plane {
        title: "Viewing directions".to_owned(),
        caption:
            "Directions from which the camera sees the target, relative to their mean. A good \
               calibration spans 30° or more in both."
                .to_owned(),
        axes: ["tilt, °", "tilt across, °"],
        dots: views
            .iter()
            .map(|at| Dot { at: at.map(f64::to_degrees), size: 0.2, role: SeriesRole::Amount })
            .collect(),
        ..Plane::default()
    }
}

/// Oblique view.
fn imu_axes(link: &str, found: &[[f64; 3]; 3], logged: Option<&[[f64; 3]; 3]>) -> Plane {
    // x points left and down, y right, z up.
    let place = |at: &[f64; 3]| [at[1] - 0.5 * at[0], at[2] - 0.35 * at[0]];
    let axes = |columns: &[[f64; 3]; 3], size: f64, role: SeriesRole, prefix: &str| -> Vec<Arrow> {
        let named = columns.iter().zip(["x", "y", "z"]);
        let arrow = named.map(|(axis, name)| Arrow {
            from: [0.0; 2],
            to: place(&axis.map(|part| part * size)),
            label: format!("{prefix}{name}"),
            role,
        });
        arrow.collect()
    };
    let own = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let link_axes = axes(&own, 1.25, SeriesRole::Reference, &format!("{link} "));
    let logged =
        logged.map_or_else(Vec::new, |logged| axes(logged, 0.95, SeriesRole::Before, "logged "));
    Plane {
        title: "Axes of the IMU in its link".to_owned(),
        caption: "Dark: link. Red: IMU by the log's frames. Green: IMU by its motion.".to_owned(),
        arrows: [link_axes, logged, axes(found, 0.65, SeriesRole::After, "imu ")].concat(),
        ..Plane::default()
    }
}
