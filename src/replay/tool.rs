//! A drawn gripper, which shows at a glance which way a pose points.

use re_sdk_types::archetypes::{LineStrips3D, TransformAxes3D};
use re_sdk_types::components::{Color, LineStrip3D, Radius};
use rerun::EntityPath;

use super::recorder::{Recorded, Recorder};

/// Size of the gripper, as a part of the arm's reach.
const SIZE: f64 = 0.16;
/// Length of the axes of its frame, as a part of the arm's reach.
const AXES: f64 = 0.1;

/// How a gripper is drawn.
pub struct Tool {
    /// Its colour.
    pub colour: Color,
    /// How thick it is.
    pub weight: Weight,
    /// What stands beside it.
    pub label: Option<String>,
}

/// How thick a gripper is: of two in one place the bold one surrounds the thin one.
pub enum Weight {
    /// What the others are to be compared with.
    Thin,
    /// What is audited.
    Bold,
}

impl Tool {
    /// Records the gripper in the frame of `entity`, for an arm of reach `reach_m`.
    pub fn record(&self, entity: EntityPath, reach_m: f64, recorder: &Recorder) -> Recorded {
        let size = SIZE * reach_m;
        let radius_m = match self.weight {
            Weight::Thin => 0.02 * size,
            Weight::Bold => 0.04 * size,
        };
        let strip = LineStrips3D::new([LineStrip3D::from_iter(stroke(size))])
            .with_colors([self.colour])
            .with_radii([scene_units(radius_m)]);
        let strip = match &self.label {
            Some(label) => strip.with_labels([label.as_str()]).with_show_labels(true),
            None => strip,
        };
        recorder.fixed(entity.clone(), &strip)?;
        recorder.fixed(entity, &axes(AXES * reach_m))
    }
}

/// Thumb, stem from the frame's origin along z, and two fingers, in one stroke; m.
fn stroke(size_m: f64) -> [[f64; 3]; 9] {
    let (half_width, palm) = (0.3 * size_m, 0.5 * size_m);
    [
        [0.0, half_width, palm],
        [0.0, 0.0, palm],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, palm],
        [-half_width, 0.0, palm],
        [-half_width, 0.0, size_m],
        [-half_width, 0.0, palm],
        [half_width, 0.0, palm],
        [half_width, 0.0, size_m],
    ]
}

/// The axes of a frame, of a length in metres.
pub fn axes(length_m: f64) -> TransformAxes3D {
    TransformAxes3D::new(length_m as f32)
}

/// A radius in metres.
pub fn scene_units(radius_m: f64) -> Radius {
    Radius::new_scene_units(radius_m as f32)
}
