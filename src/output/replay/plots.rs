//! Errors over time, in everyday units.

use re_log_types::EntityPath;

use super::timeline_writer::{TimelineWriter, entity_path};
use super::{
    MAX_ROWS, PoseState, ReceiveTimes, ReplayArm, ReplayCause, ReplayImu, ReplayStream, StreamKind,
    finding_views,
};
use crate::checks::MDL001;
use crate::finding::Unit;
use crate::report::Report;
use crate::robot::JointKind;
use crate::stats::thin;
use crate::time::Stamp;

const ERRORS_ENTITY: &str = "errors";
const JOINT_RGB: [u8; 3] = [110, 170, 240];

/// One view each.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum PlotQuantity {
    Position,
    Rotation,
    Yaw,
}

impl PlotQuantity {
    pub const fn title(self) -> &'static str {
        match self {
            PlotQuantity::Position => "position against FK, mm",
            PlotQuantity::Rotation => "rotation against FK, °",
            PlotQuantity::Yaw => "IMU yaw against FK, °",
        }
    }

    /// Parent of its series.
    pub fn root(self, arm: &str) -> EntityPath {
        entity_path(&[ERRORS_ENTITY, arm, self.name()])
    }

    const fn name(self) -> &'static str {
        match self {
            PlotQuantity::Position => "position_mm",
            PlotQuantity::Rotation => "rotation_deg",
            PlotQuantity::Yaw => "yaw_deg",
        }
    }

    /// Parent of the series of one topic.
    pub fn topic_root(self, arm: &str, topic: &str) -> EntityPath {
        self.root(arm).join(&entity_path(&[topic]))
    }

    /// Factor from SI to the displayed unit.
    fn factor(self) -> f64 {
        match self {
            PlotQuantity::Position => 1e3,
            PlotQuantity::Rotation | PlotQuantity::Yaw => 1f64.to_degrees(),
        }
    }
}

/// Joint positions, errors of streams with limits, and yaw of IMUs.
pub(super) fn draw(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    report: &Report,
) -> Result<(), ReplayCause> {
    draw_joints(writer, arm)?;
    for stream in &arm.streams {
        draw_residuals(writer, arm, stream)?;
        draw_limits(writer, arm, stream, report)?;
    }
    for imu in &arm.imus {
        draw_yaw(writer, arm, imu)?;
    }
    Ok(())
}

/// Entity and plotted unit.
pub(super) fn joint_entity(arm: &ReplayArm<'_>, name: &str) -> Option<(EntityPath, &'static str)> {
    let index = arm.chain.joint_names().iter().position(|known| known == name)?;
    let unit = if arm.chain.joint_kinds()[index] == JointKind::Prismatic { "mm" } else { "°" };
    Some((entity_path(&["joints", arm.name]).join(&entity_path(&[name])), unit))
}

fn draw_joints(writer: &TimelineWriter, arm: &ReplayArm<'_>) -> Result<(), ReplayCause> {
    let stamps: Vec<Stamp> = arm.corrected.t_s.iter().map(|&t_s| writer.stamp(t_s)).collect();
    for (name, &column) in arm.chain.joint_names().iter().zip(arm.columns) {
        let Some((path, unit)) = joint_entity(arm, name) else { continue };
        let series = ReplaySeries {
            path,
            label: name.clone(),
            rgb: JOINT_RGB,
            width: 1.5,
            factor: if unit == "mm" { 1e3 } else { 1f64.to_degrees() },
        };
        let positions: Vec<f64> = arm.corrected.positions_of(column).collect();
        series.draw(writer, arm, &arm.received, &stamps, &positions)?;
    }
    Ok(())
}

fn draw_residuals(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
) -> Result<(), ReplayCause> {
    let stamps: Vec<Stamp> = stream.aligned.t_s.iter().map(|&t_s| writer.stamp(t_s)).collect();
    let drawn: Vec<_> =
        PoseState::drawn_states(stream).map(|state| (state, state.residuals(stream))).collect();
    for quantity in [PlotQuantity::Position, PlotQuantity::Rotation] {
        for (state, residuals) in &drawn {
            let (state, values) = match quantity {
                PlotQuantity::Position => (*state, &residuals.m),
                _ => (*state, &residuals.rad),
            };
            let series = ReplaySeries {
                path: entity_path(&[
                    ERRORS_ENTITY,
                    arm.name,
                    quantity.name(),
                    stream.topic,
                    state.entity(),
                ]),
                label: arm.label(stream, state),
                rgb: state.rgb(stream.kind),
                width: if state == PoseState::Corrected { 2.5 } else { 1.0 },
                factor: quantity.factor(),
            };
            series.draw(writer, arm, &stream.received, &stamps, values)?;
        }
    }
    Ok(())
}

/// Limit of a residual (MDL001), over the time of a stream.
fn draw_limits(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
    report: &Report,
) -> Result<(), ReplayCause> {
    let [Some(first), Some(last)] = [stream.aligned.t_s.first(), stream.aligned.t_s.last()] else {
        return Ok(());
    };
    let stamps = [first, last].map(|&t_s| writer.stamp(t_s));
    let times = writer.row_times(arm, &stream.received, stamps.into_iter());
    for (quantity, unit) in
        [(PlotQuantity::Position, Unit::Metre), (PlotQuantity::Rotation, Unit::Radian)]
    {
        let Some(limit) = report.warning_threshold(&MDL001, unit) else { continue };
        let path = quantity.topic_root(arm.name, stream.topic).join(&entity_path(&["limit"]));
        let label = format!("limit {}", unit.show(limit));
        finding_views::draw_limit(writer, &path, &times, &label, limit * quantity.factor())?;
    }
    Ok(())
}

fn draw_yaw(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    imu: &ReplayImu<'_>,
) -> Result<(), ReplayCause> {
    let series = ReplaySeries {
        path: entity_path(&[ERRORS_ENTITY, arm.name, PlotQuantity::Yaw.name(), imu.topic]),
        label: imu.topic.to_owned(),
        rgb: PoseState::Logged.rgb(StreamKind::Pose),
        width: 1.0,
        factor: PlotQuantity::Yaw.factor(),
    };
    let (stamps, yaw_rad): (Vec<Stamp>, Vec<f64>) =
        imu.yaw_error.iter().map(|&(t_s, yaw_rad)| (writer.stamp(t_s), yaw_rad)).unzip();
    series.draw(writer, arm, &imu.received, &stamps, &yaw_rad)
}

struct ReplaySeries {
    path: EntityPath,
    label: String,
    rgb: [u8; 3],
    /// UI points. A line below another one is wider.
    width: f32,
    /// Factor from SI to the displayed unit.
    factor: f64,
}

impl ReplaySeries {
    /// `values` are in SI units.
    fn draw(
        &self,
        writer: &TimelineWriter,
        arm: &ReplayArm<'_>,
        received: &ReceiveTimes,
        stamps: &[Stamp],
        values: &[f64],
    ) -> Result<(), ReplayCause> {
        let rows = thin::extreme_rows(&[values], MAX_ROWS);
        let times = writer.row_times(arm, received, rows.iter().map(|&row| stamps[row]));
        let shown = rows.iter().map(|&row| values[row] * self.factor);
        let shown: Vec<f64> = shown.collect();
        finding_views::draw_line(
            writer,
            &self.path,
            (&self.label, self.rgb, self.width),
            &times,
            &shown,
        )
    }
}
