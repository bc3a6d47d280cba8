//! Errors over time, in the units that people read.

use re_sdk_types::archetypes::{Scalars, SeriesLines};
use rerun::EntityPath;

use super::tape::{Tape, entity};
use super::{MOST_ROWS, ReplayArm, ReplayCause, ReplayImu, ReplayStream, State, StreamKind};
use crate::tables::{self, AFTER_M, AFTER_RAD, BEFORE_M, BEFORE_RAD, thin};

const ERRORS: &str = "errors";

/// What is plotted; one view each.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    Position,
    Rotation,
    Yaw,
}

impl Quantity {
    /// Title of its view.
    pub const fn title(self) -> &'static str {
        match self {
            Quantity::Position => "position against FK, mm",
            Quantity::Rotation => "rotation against FK, °",
            Quantity::Yaw => "IMU yaw against FK, °",
        }
    }

    /// The entity above its series.
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

    /// From SI to the unit shown.
    fn factor(self) -> f64 {
        match self {
            Quantity::Position => 1e3,
            Quantity::Rotation | Quantity::Yaw => 1f64.to_degrees(),
        }
    }
}

/// Adds the errors of an arm's streams and the yaw of its IMUs.
pub(super) fn draw(tape: &Tape, arm: &ReplayArm<'_>) -> Result<(), ReplayCause> {
    for stream in &arm.streams {
        residuals(tape, arm, stream)?;
    }
    for imu in &arm.imus {
        yaw(tape, arm.name, imu)?;
    }
    Ok(())
}

fn residuals(
    tape: &Tape,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
) -> Result<(), ReplayCause> {
    let stamps_ns = tables::stamps_ns(&stream.frame)?;
    for quantity in [Quantity::Position, Quantity::Rotation] {
        for state in State::drawn(stream) {
            let column = match (quantity, state) {
                (Quantity::Position, State::Logged) => BEFORE_M,
                (Quantity::Position, State::Explained) => AFTER_M,
                (_, State::Logged) => BEFORE_RAD,
                (_, State::Explained) => AFTER_RAD,
            };
            let series = Series {
                path: entity(&[ERRORS, arm.name, quantity.name(), stream.topic, state.entity()]),
                label: arm.label(stream, state),
                rgb: state.rgb(stream.kind),
                width: if state == State::Explained { 2.5 } else { 1.0 },
                factor: quantity.factor(),
            };
            series.draw(tape, &stamps_ns, &tables::numbers(&stream.frame, column)?)?;
        }
    }
    Ok(())
}

fn yaw(tape: &Tape, arm: &str, imu: &ReplayImu<'_>) -> Result<(), ReplayCause> {
    let series = Series {
        path: entity(&[ERRORS, arm, Quantity::Yaw.name(), imu.topic]),
        label: imu.topic.to_owned(),
        rgb: State::Logged.rgb(StreamKind::Pose),
        width: 1.0,
        factor: Quantity::Yaw.factor(),
    };
    let (stamps_ns, yaw_rad): (Vec<i64>, Vec<f64>) =
        imu.yaw_error.iter().map(|&(t_s, yaw_rad)| (tape.stamp_ns(t_s), yaw_rad)).unzip();
    series.draw(tape, &stamps_ns, &yaw_rad)
}

/// One line of a plot.
struct Series {
    path: EntityPath,
    label: String,
    rgb: [u8; 3],
    /// Width, UI points; what lies under another line is broader.
    width: f32,
    /// From SI to the unit shown.
    factor: f64,
}

impl Series {
    /// Adds the line through `values`, in SI.
    fn draw(&self, tape: &Tape, stamps_ns: &[i64], values: &[f64]) -> Result<(), ReplayCause> {
        let rows = thin::extremes(&[values], MOST_ROWS);
        let kept_ns: Vec<i64> = rows.iter().map(|&row| stamps_ns[row]).collect();
        let shown = rows.iter().map(|&row| values[row] * self.factor);
        let style = SeriesLines::new()
            .with_names([self.label.as_str()])
            .with_colors([self.rgb])
            .with_widths([self.width]);
        tape.still(&self.path, &style)?;
        tape.columns(&self.path, &kept_ns, Scalars::new(shown).columns_of_unit_batches()?)?;
        Ok(())
    }
}
