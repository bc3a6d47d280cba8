//! Errors over time: positions in mm, rotations and yaw in degrees, as people read them.

use re_sdk_types::archetypes::{Scalars, SeriesLines};
use re_sdk_types::components::Color;
use rerun::{EntityPath, entity_path};

use crate::tables::Quantity;

use super::recorder::{Recorded, Recorder};
use super::{MOST_POINTS, ReplayArm, palette, thinning};

/// A plot of an arm, and what is in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plot {
    /// Distance of poses from FK.
    Position,
    /// Angle of poses to FK.
    Rotation,
    /// Yaw of IMUs minus FK's.
    Yaw,
}

impl Plot {
    /// All plots, in the order in which they stand.
    pub const ALL: [Plot; 3] = [Plot::Position, Plot::Rotation, Plot::Yaw];

    /// What is over the plot.
    pub const fn title(self) -> &'static str {
        match self {
            Plot::Position => "position error (mm)",
            Plot::Rotation => "rotation error (°)",
            Plot::Yaw => "IMU yaw − FK yaw (°)",
        }
    }

    /// Whether `arm` has anything for it.
    pub fn has_data(self, arm: &ReplayArm) -> bool {
        match self {
            Plot::Position | Plot::Rotation => arm.streams.iter().any(|stream| !stream.table.is_empty()),
            Plot::Yaw => arm.imus.iter().any(|imu| !imu.yaw_error.is_empty()),
        }
    }

    /// The entity below which its series lie.
    pub fn entity(self, arm: &ReplayArm) -> EntityPath {
        let name = match self {
            Plot::Position => "position_mm",
            Plot::Rotation => "rotation_deg",
            Plot::Yaw => "yaw_deg",
        };
        arm.entity().join(&entity_path!["plots", name])
    }

    /// The residuals before and after the correction, and what takes them to the plot's unit.
    fn residuals(self) -> Option<(Quantity, Quantity, f64)> {
        match self {
            Plot::Position => Some((Quantity::DistanceBefore, Quantity::DistanceAfter, 1e3)),
            Plot::Rotation => {
                Some((Quantity::AngleBefore, Quantity::AngleAfter, 1f64.to_degrees()))
            }
            Plot::Yaw => None,
        }
    }
}

/// Records the series of all plots of `arm`.
pub fn record(arm: &ReplayArm, recorder: &Recorder) -> Recorded {
    for plot in Plot::ALL {
        let Some((before, after, factor)) = plot.residuals() else { continue };
        for (index, stream) in arm.streams.iter().enumerate() {
            let name = arm.stream_name(index);
            let t_s = stream.table.numbers(Quantity::Time);
            let series = |version: &str, quantity, colour| {
                let entity = plot.entity(arm).join(&entity_path![name, version]);
                let values: Vec<f64> =
                    stream.table.numbers(quantity).iter().map(|value| factor * value).collect();
                line(entity, &format!("{name} {version}"), colour, t_s, &values, recorder)
            };
            let (logged, corrected) = palette::stream(index);
            if stream.derived {
                series("as logged", before, palette::DERIVED)?;
                continue;
            }
            if stream.estimated_reference.is_none() {
                series("as logged", before, logged)?;
            }
            series("corrected", after, corrected)?;
        }
    }
    for (index, imu) in arm.imus.iter().enumerate() {
        let entity = Plot::Yaw.entity(arm).join(&entity_path![imu.topic]);
        let (t_s, yaw_deg): (Vec<f64>, Vec<f64>) =
            imu.yaw_error.iter().map(|(t_s, yaw)| (t_s, yaw.to_degrees())).unzip();
        line(entity, imu.topic, palette::imu(index), &t_s, &yaw_deg, recorder)?;
    }
    Ok(())
}

/// One line of a plot.
fn line(
    entity: EntityPath,
    name: &str,
    colour: Color,
    t_s: &[f64],
    values: &[f64],
    recorder: &Recorder,
) -> Recorded {
    let rows = thinning::extremes(values, MOST_POINTS);
    let times: Vec<f64> = rows.iter().map(|&row| t_s[row]).collect();
    let kept = rows.iter().map(|&row| values[row]);
    let columns = Scalars::update_fields().with_scalars(kept).columns_of_unit_batches();
    recorder.moving(entity.clone(), &times, columns)?;
    let look = SeriesLines::new().with_colors([colour]).with_names([name]).with_widths([1.5]);
    recorder.fixed(entity, &look)
}
