//! Errors over time, in everyday units.

use re_log_types::EntityPath;

use super::tape::{Tape, entity};
use super::{
    MOST_ROWS, Receipts, ReplayArm, ReplayCause, ReplayImu, ReplayStream, State, StreamKind, proofs,
};
use crate::checks::MDL001;
use crate::finding::Unit;
use crate::report::Report;
use crate::robot::JointKind;
use crate::stats::thin;
use crate::time::Stamp;

const ERRORS: &str = "errors";
const JOINT_RGB: [u8; 3] = [110, 170, 240];

/// One view each.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Position,
    Rotation,
    Yaw,
}

impl Quantity {
    pub const fn title(self) -> &'static str {
        match self {
            Quantity::Position => "position against FK, mm",
            Quantity::Rotation => "rotation against FK, °",
            Quantity::Yaw => "IMU yaw against FK, °",
        }
    }

    /// Parent of its series.
    pub fn root(self, arm: &str) -> EntityPath {
        entity(&[ERRORS, arm, self.name()])
    }

    const fn name(self) -> &'static str {
        match self {
            Quantity::Position => "position_mm",
            Quantity::Rotation => "rotation_deg",
            Quantity::Yaw => "yaw_deg",
        }
    }

    /// Parent of the series of one topic.
    pub fn of_topic(self, arm: &str, topic: &str) -> EntityPath {
        self.root(arm).join(&entity(&[topic]))
    }

    /// Factor from SI to the displayed unit.
    fn factor(self) -> f64 {
        match self {
            Quantity::Position => 1e3,
            Quantity::Rotation | Quantity::Yaw => 1f64.to_degrees(),
        }
    }
}

/// Joint positions, errors of streams with limits, and yaw of IMUs.
pub(super) fn draw(tape: &Tape, arm: &ReplayArm<'_>, report: &Report) -> Result<(), ReplayCause> {
    joints(tape, arm)?;
    for stream in &arm.streams {
        residuals(tape, arm, stream)?;
        limits(tape, arm, stream, report)?;
    }
    for imu in &arm.imus {
        yaw(tape, arm, imu)?;
    }
    Ok(())
}

/// Entity and plotted unit.
pub(super) fn joint(arm: &ReplayArm<'_>, name: &str) -> Option<(EntityPath, &'static str)> {
    let index = arm.chain.joint_names().iter().position(|known| known == name)?;
    let unit = if arm.chain.joint_kinds()[index] == JointKind::Prismatic { "mm" } else { "°" };
    Some((entity(&["joints", arm.name]).join(&entity(&[name])), unit))
}

fn joints(tape: &Tape, arm: &ReplayArm<'_>) -> Result<(), ReplayCause> {
    let stamps: Vec<Stamp> = arm.corrected.t_s.iter().map(|&t_s| tape.stamp(t_s)).collect();
    for (name, &column) in arm.chain.joint_names().iter().zip(arm.columns) {
        let Some((path, unit)) = joint(arm, name) else { continue };
        let series = Series {
            path,
            label: name.clone(),
            rgb: JOINT_RGB,
            width: 1.5,
            factor: if unit == "mm" { 1e3 } else { 1f64.to_degrees() },
        };
        let positions = arm.corrected.q.iter().skip(column).step_by(arm.corrected.dof.max(1));
        let positions: Vec<f64> = positions.copied().collect();
        series.draw(tape, arm, &arm.received, &stamps, &positions)?;
    }
    Ok(())
}

fn residuals(
    tape: &Tape,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
) -> Result<(), ReplayCause> {
    let stamps: Vec<Stamp> = stream.aligned.t_s.iter().map(|&t_s| tape.stamp(t_s)).collect();
    let drawn: Vec<_> =
        State::drawn(stream).map(|state| (state, state.residuals(stream))).collect();
    for quantity in [Quantity::Position, Quantity::Rotation] {
        for (state, residuals) in &drawn {
            let (state, values) = match quantity {
                Quantity::Position => (*state, &residuals.m),
                _ => (*state, &residuals.rad),
            };
            let series = Series {
                path: entity(&[ERRORS, arm.name, quantity.name(), stream.topic, state.entity()]),
                label: arm.label(stream, state),
                rgb: state.rgb(stream.kind),
                width: if state == State::Explained { 2.5 } else { 1.0 },
                factor: quantity.factor(),
            };
            series.draw(tape, arm, &stream.received, &stamps, values)?;
        }
    }
    Ok(())
}

/// Limit of a residual (MDL001), over the time of a stream.
fn limits(
    tape: &Tape,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
    report: &Report,
) -> Result<(), ReplayCause> {
    let [Some(first), Some(last)] = [stream.aligned.t_s.first(), stream.aligned.t_s.last()] else {
        return Ok(());
    };
    let stamps = [first, last].map(|&t_s| tape.stamp(t_s));
    let moments = tape.moments(arm, &stream.received, stamps.into_iter());
    for (quantity, unit) in [(Quantity::Position, Unit::Metre), (Quantity::Rotation, Unit::Radian)]
    {
        let Some(limit) = report.warning_threshold(&MDL001, unit) else { continue };
        let path = quantity.of_topic(arm.name, stream.topic).join(&entity(&["limit"]));
        let label = format!("limit {}", unit.show(limit));
        proofs::limit(tape, &path, &moments, &label, limit * quantity.factor())?;
    }
    Ok(())
}

fn yaw(tape: &Tape, arm: &ReplayArm<'_>, imu: &ReplayImu<'_>) -> Result<(), ReplayCause> {
    let series = Series {
        path: entity(&[ERRORS, arm.name, Quantity::Yaw.name(), imu.topic]),
        label: imu.topic.to_owned(),
        rgb: State::Logged.rgb(StreamKind::Pose),
        width: 1.0,
        factor: Quantity::Yaw.factor(),
    };
    let (stamps, yaw_rad): (Vec<Stamp>, Vec<f64>) =
        imu.yaw_error.iter().map(|&(t_s, yaw_rad)| (tape.stamp(t_s), yaw_rad)).unzip();
    series.draw(tape, arm, &imu.received, &stamps, &yaw_rad)
}

struct Series {
    path: EntityPath,
    label: String,
    rgb: [u8; 3],
    /// UI points. A line below another one is wider.
    width: f32,
    /// Factor from SI to the displayed unit.
    factor: f64,
}

impl Series {
    /// `values` are in SI units.
    fn draw(
        &self,
        tape: &Tape,
        arm: &ReplayArm<'_>,
        received: &Receipts,
        stamps: &[Stamp],
        values: &[f64],
    ) -> Result<(), ReplayCause> {
        let rows = thin::extreme_rows(&[values], MOST_ROWS);
        let moments = tape.moments(arm, received, rows.iter().map(|&row| stamps[row]));
        let shown = rows.iter().map(|&row| values[row] * self.factor);
        let shown: Vec<f64> = shown.collect();
        proofs::line(tape, &self.path, (&self.label, self.rgb, self.width), &moments, &shown)
    }
}
