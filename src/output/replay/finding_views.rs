//! Plots specific to single findings.

use re_log_types::EntityPath;
use re_sdk_types::archetypes::{Arrows3D, BarChart, Points3D, Scalars, SeriesLines};

use super::row_times::RowTimes;
use super::timeline_writer::{TimelineWriter, entity_path};
use super::{Replay, ReplayCause, findings};
use crate::checks;
use crate::finding::{Finding, Unit};
use crate::report::Report;
use crate::report::figures::FindingFigure;
use crate::time::Stamp;

const LIMIT_RGB: [u8; 3] = [230, 180, 80];
const LINE_RGBS: [[u8; 3]; 3] = [[240, 80, 60], [60, 200, 110], [110, 170, 240]];

pub(super) struct FindingView {
    pub title: &'static str,
    pub path: EntityPath,
    pub kind: ViewKind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ViewKind {
    Series,
    Bars,
    Space,
}

fn view_path(index: usize, name: &str) -> EntityPath {
    entity_path(&["proof", &format!("{:02}", index + 1), name])
}

pub(super) fn list(report: &Report, index: usize) -> Vec<FindingView> {
    let own = report.figures.iter().flat_map(|figures| &figures.of_findings);
    let own = own.filter(|(of, _)| *of == index);
    let view = |name: &str, title, kind| FindingView { title, path: view_path(index, name), kind };
    let views = own.flat_map(|(_, own)| match own {
        FindingFigure::Vibration { .. } => vec![
            view("spectrum", "spectrum, mm rms over Hz", ViewKind::Bars),
            view("trace", "strongest vibration, mm", ViewKind::Series),
        ],
        FindingFigure::HandEye { .. } => vec![
            view("distance", "residual of each view, mm", ViewKind::Series),
            view("views", "the target as the camera sees it", ViewKind::Space),
        ],
        FindingFigure::RestErrors(_) => vec![view("rests", "goals and rests", ViewKind::Space)],
        FindingFigure::RotationNorms(_) => {
            vec![view("norms", "deviation from a rotation", ViewKind::Series)]
        }
        FindingFigure::ImuAxes { .. } => {
            vec![view("axes", "axes of the IMU in its link", ViewKind::Space)]
        }
        FindingFigure::Gyro { .. } => vec![view("gyro", "gyro, °/s", ViewKind::Series)],
        FindingFigure::Joint(_) => vec![view("speed", "joint speed", ViewKind::Series)],
        FindingFigure::Line { .. } | FindingFigure::Tilt(_) => Vec::new(),
    });
    views.collect()
}

pub(super) fn draw(writer: &TimelineWriter, replay: &Replay<'_>) -> Result<(), ReplayCause> {
    let Some(figures) = &replay.report.figures else { return Ok(()) };
    let start = figures.start.unwrap_or(replay.span.0);
    for (index, own) in &figures.of_findings {
        let Some(finding) = replay.report.findings.get(*index) else { continue };
        let shown = FindingRecorder { writer, replay, finding, index: *index, start };
        shown.draw(own)?;
    }
    Ok(())
}

struct FindingRecorder<'a> {
    writer: &'a TimelineWriter,
    replay: &'a Replay<'a>,
    finding: &'a Finding,
    index: usize,
    start: Stamp,
}

impl FindingRecorder<'_> {
    fn draw(&self, own: &FindingFigure) -> Result<(), ReplayCause> {
        let f32s = |at: &[f64; 3]| at.map(|part| part as f32);
        match own {
            FindingFigure::Vibration { spectrum, trace } => {
                let [hz, mm]: [Vec<f64>; 2] =
                    [0, 1].map(|part| spectrum.iter().map(|at| at[part]).collect());
                let mm: Vec<f64> = mm.iter().map(|rms_m| rms_m * 1e3).collect();
                let bars = BarChart::new(mm).with_abscissa(hz).with_color(LINE_RGBS[2]);
                self.writer.log_static(&view_path(self.index, "spectrum"), &bars)?;
                let rows = || trace.iter().map(|at| (at[0], at[1] * 1e3));
                self.draw_line("trace", "tip", "tip, mm", LINE_RGBS[0], rows())?;
                self.draw_limits("trace", Unit::Metre, 1e3, true, rows())
            }
            FindingFigure::HandEye { closures: each, positions: seen, .. } => {
                let rows = || each.iter().map(|at| (at[0], at[1] * 1e3));
                self.draw_line("distance", "view", "residual, mm", LINE_RGBS[0], rows())?;
                self.draw_limits("distance", Unit::Metre, 1e3, false, rows())?;
                let root = view_path(self.index, "views");
                let target = Points3D::new(seen.iter().map(f32s))
                    .with_colors([LINE_RGBS[2]])
                    .with_radii([0.004]);
                self.writer.log_static(&root.join(&entity_path(&["target"])), &target)?;
                let length = seen.iter().map(|at| at[2].abs()).fold(0.0, f64::max).max(0.1) * 0.3;
                self.draw_axes(&root.join(&entity_path(&["camera"])), &unit_axes(length), "camera ")
            }
            FindingFigure::RestErrors(gaps) => {
                let root = view_path(self.index, "rests");
                let points = |part: usize, rgb| {
                    Points3D::new(gaps.iter().map(|gap| f32s(&gap[part])))
                        .with_colors([rgb])
                        .with_radii([0.004])
                };
                self.writer
                    .log_static(&root.join(&entity_path(&["goals"])), &points(0, LINE_RGBS[1]))?;
                self.writer
                    .log_static(&root.join(&entity_path(&["rests"])), &points(1, LINE_RGBS[0]))
            }
            FindingFigure::RotationNorms(rows) => {
                let rows = || rows.iter().map(|at| (at[0], at[1]));
                self.draw_line("norms", "deviation", "deviation", LINE_RGBS[0], rows())?;
                self.draw_limits("norms", Unit::One, 1.0, false, rows())
            }
            FindingFigure::ImuAxes { link, estimated: found, logged } => {
                let root = view_path(self.index, "axes");
                self.draw_axes(
                    &root.join(&entity_path(&["link"])),
                    &unit_axes(1.0),
                    &format!("{link} "),
                )?;
                let scaled =
                    |axes: &[[f64; 3]; 3], size: f64| axes.map(|axis| axis.map(|part| part * size));
                if let Some(logged) = logged {
                    self.draw_axes(
                        &root.join(&entity_path(&["logged"])),
                        &scaled(logged, 0.8),
                        "logged ",
                    )?;
                }
                self.draw_axes(
                    &root.join(&entity_path(&["found"])),
                    &scaled(found, 0.6),
                    "by motion ",
                )
            }
            FindingFigure::Gyro { rates, .. } => {
                for (part, name) in ["x", "y", "z"].into_iter().enumerate() {
                    let rows = rates.iter().map(|at| (at[0], at[part + 1].to_degrees()));
                    self.draw_line("gyro", name, name, LINE_RGBS[part], rows)?;
                }
                let rows = rates.iter().map(|at| (at[0], 0.0));
                self.draw_limits("gyro", Unit::GyroRate, 1f64.to_degrees(), true, rows)
            }
            FindingFigure::Joint(joint) => {
                let factor = if joint.is_prismatic { 1e3 } else { 1f64.to_degrees() };
                let rows = |values: &[f64]| -> Vec<(f64, f64)> {
                    joint
                        .t_s
                        .iter()
                        .zip(values)
                        .map(|(&t_s, value)| (t_s, value * factor))
                        .collect()
                };
                self.draw_line(
                    "speed",
                    "recorded",
                    "recorded",
                    LINE_RGBS[0],
                    rows(&joint.velocity).into_iter(),
                )?;
                self.draw_line(
                    "speed",
                    "by_positions",
                    "by positions",
                    LINE_RGBS[1],
                    rows(&joint.differentiated).into_iter(),
                )?;
                let ends =
                    joint.max_speed.iter().flat_map(|limit| [limit * factor, -limit * factor]);
                let span = rows(&joint.differentiated);
                for (at, limit) in ends.enumerate() {
                    let rows =
                        span.first().into_iter().chain(span.last()).map(|row| (row.0, limit));
                    self.draw_line("speed", &format!("limit_{at}"), "limit", LIMIT_RGB, rows)?;
                }
                Ok(())
            }
            FindingFigure::Line { .. } | FindingFigure::Tilt(_) => Ok(()),
        }
    }

    fn draw_line(
        &self,
        view: &str,
        name: &str,
        label: &str,
        rgb: [u8; 3],
        rows: impl Iterator<Item = (f64, f64)>,
    ) -> Result<(), ReplayCause> {
        let (stamps, values): (Vec<Stamp>, Vec<f64>) =
            rows.map(|(t_s, value)| (self.start.shifted(t_s), value)).unzip();
        let path = view_path(self.index, view).join(&entity_path(&[name]));
        let times = findings::finding_times(self.writer, self.replay, self.finding, &stamps);
        draw_line(self.writer, &path, (label, rgb, 1.5), &times, &values)
    }

    /// Limit of the finding's rule in this unit.
    fn draw_limits(
        &self,
        view: &str,
        unit: Unit,
        factor: f64,
        both_signs: bool,
        rows: impl Iterator<Item = (f64, f64)>,
    ) -> Result<(), ReplayCause> {
        let rule = checks::find(self.finding.code).ok();
        let Some(limit) = rule.and_then(|rule| self.replay.report.warning_threshold(rule, unit))
        else {
            return Ok(());
        };
        let times: Vec<f64> = rows.map(|row| row.0).collect();
        let ends = || times.first().into_iter().chain(times.last());
        let label = format!("limit {}", unit.show(limit));
        let signs: &[f64] = if both_signs { &[1.0, -1.0] } else { &[1.0] };
        for (at, sign) in signs.iter().enumerate() {
            let rows = ends().map(|&t_s| (t_s, sign * limit * factor));
            self.draw_line(view, &format!("limit_{at}"), &label, LIMIT_RGB, rows)?;
        }
        Ok(())
    }

    fn draw_axes(
        &self,
        path: &EntityPath,
        axes: &[[f64; 3]; 3],
        name: &str,
    ) -> Result<(), ReplayCause> {
        let arrows = Arrows3D::from_vectors(axes.map(|axis| axis.map(|part| part as f32)))
            .with_origins([[0.0f32; 3]])
            .with_colors([[230, 70, 60], [70, 190, 90], [80, 130, 240]])
            .with_labels(["x", "y", "z"].map(|axis| format!("{name}{axis}")))
            .with_show_labels(true);
        self.writer.log_static(path, &arrows)
    }
}

fn unit_axes(length: f64) -> [[f64; 3]; 3] {
    [[length, 0.0, 0.0], [0.0, length, 0.0], [0.0, 0.0, length]]
}

/// Name, colour and width of a plot's line.
pub(super) fn draw_line(
    writer: &TimelineWriter,
    path: &EntityPath,
    (label, rgb, width): (&str, [u8; 3], f32),
    times: &RowTimes,
    values: &[f64],
) -> Result<(), ReplayCause> {
    let style = SeriesLines::new().with_names([label]).with_colors([rgb]).with_widths([width]);
    writer.log_static(path, &style)?;
    writer.log_columns(path, times, Scalars::new(values.iter().copied()).columns_of_unit_batches()?)
}

/// From the first to the last time.
pub(super) fn draw_limit(
    writer: &TimelineWriter,
    path: &EntityPath,
    times: &RowTimes,
    label: &str,
    value: f64,
) -> Result<(), ReplayCause> {
    draw_line(writer, path, (label, LIMIT_RGB, 1.5), times, &[value; 2])
}
