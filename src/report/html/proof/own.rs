//! Plots specific to single findings.

use super::{Case, Proof, both_signs, one_sided};
use crate::finding::{Estimate, Unit};
use crate::report::figures::{JointFigure, Own};
use crate::report::html::plane::{Arrow, Dot, Plane};
use crate::report::html::plot::{Limit, Mark, Plot, Role, Series, Style};

impl Case<'_> {
    /// Adds nothing without data.
    pub(super) fn add_own(&self, proof: &mut Proof) {
        let own = self.figures.own.iter().filter(|(index, _)| *index == self.index);
        for (_, own) in own {
            match own {
                Own::Shake { spectrum, trace } => {
                    proof.plots.extend([self.spectrum(spectrum), self.trace(trace)]);
                }
                Own::HandEye { each, views, .. } => {
                    let [distance, angle] = self.closures(each);
                    proof.plots.extend([distance, angle]);
                    proof.planes.push(seen_from(views));
                }
                Own::Line { tip, command } => {
                    let plots = [
                        self.beside_line(tip, Unit::Metre),
                        self.beside_line(tip, Unit::Radian),
                        self.command(command),
                    ];
                    proof.plots.extend(plots.into_iter().filter(is_near_its_limit));
                }
                Own::Rests(gaps) => proof.planes.extend(self.rests(gaps)),
                Own::Norms(rows) => proof.plots.push(self.norms(rows)),
                Own::ImuAxes { link, found, logged } => {
                    proof.planes.push(imu_axes(link, found, logged.as_ref()));
                }
                Own::Gyro { rates, at_rest, bias } => {
                    proof.plots.push(self.gyro(rates, *at_rest, *bias));
                }
                Own::Tilt(up) => proof.planes.push(self.tilt(up)),
                Own::Joint(joint) => proof.plots.extend(self.joint(joint)),
            }
        }
    }

    fn plot(&self, title: &'static str, says: impl Into<String>, axes: [&'static str; 2]) -> Plot {
        let subject = &self.finding.subject;
        Plot {
            title,
            robot: subject.robot.clone().unwrap_or_default(),
            of: subject.topic.clone().or_else(|| subject.joint.clone()).unwrap_or_default(),
            says: says.into(),
            x_label: axes[0],
            y_label: axes[1],
            ..Plot::default()
        }
    }

    /// From the finding's evidence.
    fn evidence(&self, key: &str) -> Option<f64> {
        self.finding.evidence.more.get(key)?.as_f64()
    }

    fn spectrum(&self, spectrum: &[[f64; 2]]) -> Plot {
        let peak = self.evidence("frequency_hz");
        let mark = peak.map(|at| Mark { at, interval: None, label: format!("peak {at:.1} Hz") });
        let from = self.evidence("from_hz").map(|at| Limit {
            at,
            is_along: true,
            label: format!("counted above {at:.0} Hz"),
        });
        Plot {
            x: spectrum.iter().map(|at| at[0]).collect(),
            series: vec![series("rms", Role::Amount, spectrum.iter().map(|at| at[1] * 1e3))],
            from_zero: true,
            mark,
            limits: from.into_iter().collect(),
            style: Style::Curve,
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
            series: vec![series("tip", Role::Before, trace.iter().map(|at| at[1] * 1e3))],
            limits: both_signs(self.own_limit(Unit::Metre), Unit::Metre, 1e3),
            style: Style::Curve,
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
            series: vec![series("view", Role::Before, each.iter().map(|at| at[part] * factor))],
            from_zero: true,
            limits: one_sided(self.own_limit(unit), unit, factor),
            style: Style::Points,
            ..self.plot(title, "Closure error of hand, camera and target.", ["time, s", label])
        })
    }

    fn beside_line(&self, tip: &[[f64; 3]], unit: Unit) -> Plot {
        let (title, part, label, factor) = match unit {
            Unit::Metre => ("Deviation from the commanded line", 1, "mm", 1e3),
            _ => ("Deviation from slerp", 2, "°", 1f64.to_degrees()),
        };
        Plot {
            x: tip.iter().map(|at| at[0] * 1e3).collect(),
            series: vec![series("tip by FK", Role::Before, tip.iter().map(|at| at[part] * factor))],
            from_zero: true,
            limits: one_sided(self.own_limit(unit), unit, factor),
            style: Style::Curve,
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
            series: vec![series("command", Role::Amount, angle)],
            from_zero: true,
            limits: one_sided(self.own_limit(Unit::Radian), Unit::Radian, 1f64.to_degrees()),
            style: Style::Curve,
            ..self.plot(
                "Commanded orientation vs. slerp",
                "The command, compared with slerp between its ends.",
                ["along the line, mm", "°"],
            )
        }
    }

    /// Rest positions relative to the goals, and a top view of both.
    fn rests(&self, gaps: &[[[f64; 3]; 2]]) -> [Plane; 2] {
        let off = |axes: [usize; 2]| {
            gaps.iter().map(move |[goal, rest]| axes.map(|axis| (rest[axis] - goal[axis]) * 1e3))
        };
        let limit = self.own_limit(Unit::Metre);
        let around = Plane {
            title: "Rest positions relative to goals".to_owned(),
            says: "Measured − commanded, top view; goals at the centre.".to_owned(),
            axes: ["x, mm", "y, mm"],
            arrows: off([0, 1])
                .map(|to| Arrow { from: [0.0; 2], to, label: String::new(), role: Role::Before })
                .collect(),
            limit: limit.map(|limit| (limit * 1e3, format!("limit {}", Unit::Metre.show(limit)))),
            ..Plane::default()
        };
        let place = |at: &[f64; 3]| [at[0], at[1]];
        let dots = gaps
            .iter()
            .flat_map(|[goal, rest]| [(place(goal), Role::Beside), (place(rest), Role::Before)]);
        let whole = Plane {
            title: "Goals and rests".to_owned(),
            says: "Top view in the base frame: goals dark, rest positions red.".to_owned(),
            axes: ["x, m", "y, m"],
            dots: dots.map(|(at, role)| Dot { at, size: 0.5, role }).collect(),
            ..Plane::default()
        };
        [around, whole]
    }

    fn norms(&self, rows: &[[f64; 2]]) -> Plot {
        Plot {
            x: rows.iter().map(|at| at[0]).collect(),
            series: vec![series("defect", Role::Before, rows.iter().map(|at| at[1]))],
            from_zero: true,
            limits: one_sided(self.own_limit(Unit::One), Unit::One, 1.0),
            ..self.plot(
                "Deviation from a rotation",
                "Quaternion: deviation of the norm from 1. Matrix: deviation from orthonormality.",
                ["time, s", "deviation"],
            )
        }
    }

    fn gyro(&self, rates: &[[f64; 4]], at_rest: bool, bias: Option<[f64; 3]>) -> Plot {
        let roles = [Role::Before, Role::After, Role::Amount];
        let axis = |(part, role): (usize, Role)| {
            let found = bias.map_or(String::new(), |bias| {
                format!(", bias {}", Unit::GyroRate.show_signed_within(bias[part], None))
            });
            let label = format!("{}{found}", ["x", "y", "z"][part]);
            series(&label, role, rates.iter().map(|at| at[part + 1].to_degrees()))
        };
        let says = match at_rest {
            true => "While all joints rest: a good gyro reads zero.",
            false => "The arm never rests, so its motion is included.",
        };
        Plot {
            x: rates.iter().map(|at| at[0]).collect(),
            series: roles.into_iter().enumerate().map(axis).collect(),
            limits: both_signs(self.own_limit(Unit::GyroRate), Unit::GyroRate, 1f64.to_degrees()),
            style: Style::Points,
            ..self.plot(if at_rest { "Gyro at rest" } else { "Gyro" }, says, ["time, s", "°/s"])
        }
    }

    fn tilt(&self, up: &[[f64; 2]]) -> Plane {
        let limit = self.own_limit(Unit::Radian);
        Plane {
            title: "Up direction by the accelerometer".to_owned(),
            says: "In the world frame of the orientation, while the arm rests; level is at the centre."
                .to_owned(),
            axes: ["towards x, °", "towards y, °"],
            dots: up
                .iter()
                .map(|at| Dot { at: at.map(f64::to_degrees), size: 0.2, role: Role::Before })
                .collect(),
            limit: limit
                .map(|limit| (limit.to_degrees(), format!("limit {}", Unit::Radian.show(limit)))),
            ..Plane::default()
        }
    }

    fn joint(&self, joint: &JointFigure) -> [Plot; 2] {
        let factor = if joint.slides { 1e3 } else { 1f64.to_degrees() };
        let [unit, rate] = if joint.slides { ["mm", "mm/s"] } else { ["°", "°/s"] };
        let limit = |at: f64, label: &str| Limit {
            at: at * factor,
            is_along: false,
            label: label.to_owned(),
        };
        let ends = joint.limits.iter().flatten().map(|at| limit(*at, "limit"));
        let speed =
            joint.top_speed.iter().flat_map(|at| [limit(*at, "speed limit"), limit(-at, "")]);
        let is_of_time =
            |key: &str| self.finding.evidence.more.get(key)?.as_str()?.parse::<i64>().ok();
        let start = self.figures.start.map_or(0, |start| start.nanos());
        let mark = is_of_time("at_ns").map(|at| Mark {
            at: crate::time::seconds(at - start),
            interval: None,
            label: self.amount(),
        });
        let velocity = (!joint.velocity.is_empty()).then(|| {
            series("recorded velocity", Role::Before, joint.velocity.iter().map(|v| v * factor))
        });
        let rates =
            series("rate from the positions", Role::After, joint.rate.iter().map(|v| v * factor));
        let says = joint.joint.clone();
        [
            Plot {
                x: joint.t_s.clone(),
                series: velocity.into_iter().chain([rates]).collect(),
                limits: speed.collect(),
                mark: mark.clone(),
                of: says.clone(),
                ..self.plot(
                    "Joint speed",
                    "Recorded, and computed from the positions.",
                    ["time, s", rate],
                )
            },
            Plot {
                x: joint.t_s.clone(),
                series: vec![series(
                    "position",
                    Role::Amount,
                    joint.position.iter().map(|q| q * factor),
                )],
                limits: ends.collect(),
                mark,
                of: says,
                ..self.plot("Joint position", "As recorded.", ["time, s", unit])
            },
        ]
    }

    /// Estimate of the finding.
    fn amount(&self) -> String {
        match &self.finding.estimate {
            Some(Estimate::Scalar { name, value, unit, .. }) => {
                Unit::from_symbol(unit, name).map_or(String::new(), |unit| unit.show(*value))
            }
            _ => String::new(),
        }
    }
}

/// Whether the values reach a tenth of the limit.
fn is_near_its_limit(plot: &Plot) -> bool {
    let values = plot.series.iter().flat_map(|series| &series.values);
    let most = values.map(|value| value.abs()).fold(0.0, f64::max);
    plot.limits.iter().all(|limit| most >= 0.1 * limit.at)
}

fn series(label: &str, role: Role, values: impl Iterator<Item = f64>) -> Series {
    Series { label: label.to_owned(), role, values: values.collect(), half_widths: Vec::new() }
}

fn seen_from(views: &[[f64; 2]]) -> Plane {
    Plane {
        title: "Viewing directions".to_owned(),
        says: "Directions from which the camera sees the target, relative to their mean. A good \
               calibration spans 30° or more in both."
            .to_owned(),
        axes: ["tilt, °", "tilt across, °"],
        dots: views
            .iter()
            .map(|at| Dot { at: at.map(f64::to_degrees), size: 0.2, role: Role::Amount })
            .collect(),
        ..Plane::default()
    }
}

/// Oblique view.
fn imu_axes(link: &str, found: &[[f64; 3]; 3], logged: Option<&[[f64; 3]; 3]>) -> Plane {
    // x points left and down, y right, z up.
    let place = |at: &[f64; 3]| [at[1] - 0.5 * at[0], at[2] - 0.35 * at[0]];
    let axes = |columns: &[[f64; 3]; 3], size: f64, role: Role, prefix: &str| -> Vec<Arrow> {
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
    let link_axes = axes(&own, 1.25, Role::Beside, &format!("{link} "));
    let logged = logged.map_or_else(Vec::new, |logged| axes(logged, 0.95, Role::Before, "logged "));
    Plane {
        title: "Axes of the IMU in its link".to_owned(),
        says: "Dark: link. Red: IMU by the log's frames. Green: IMU by its motion.".to_owned(),
        arrows: [link_axes, logged, axes(found, 0.65, Role::After, "imu ")].concat(),
        ..Plane::default()
    }
}
