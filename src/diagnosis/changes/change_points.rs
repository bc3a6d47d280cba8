//! Change points of a value, as reported.

use crate::FrameEstimate;
use ground::geometry::Pose;
use ground::stats::Measured;

/// Change point of a value.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangePoint<Value, Size> {
    /// Time, s from the run's origin, by the stamps of the affected stream.
    pub at_s: f64,
    /// Half-width of the interval that contains the change, s.
    pub within_s: f64,
    /// Value before.
    pub from: Value,
    /// Value after.
    pub to: Value,
    /// Difference between the two.
    pub size: Size,
}

/// Change point of a frame: `reference_from_stream` or `tip_from_stream` before and after.
pub type FrameChange = ChangePoint<Pose, FrameEstimate>;
/// Change point of a number.
pub type ScalarChange = ChangePoint<f64, Measured>;

impl ScalarChange {
    /// Returns the largest of several changes. `None` if there are none.
    pub fn largest<'a>(changes: impl IntoIterator<Item = &'a Self>) -> Option<&'a Self> {
        let size = |change: &Self| change.size.value.abs();
        changes.into_iter().max_by(|a, b| size(a).total_cmp(&size(b)))
    }
}

/// Change point of a joint's zero or scale.
#[derive(Clone, Debug, PartialEq)]
pub struct JointChange {
    /// Column of the joint.
    pub column: usize,
    /// Offset in `q_true = factor · q_reported + offset`, rad or m.
    pub zero: Option<ScalarChange>,
    /// Factor in the same equation.
    pub factor: Option<ScalarChange>,
}

/// Correction that makes a joint's positions in one segment consistent with the baseline segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPatch {
    /// Column of the joint.
    pub column: usize,
    /// Start of the segment (inclusive), s from the run's origin.
    pub from_s: f64,
    /// End of the segment (exclusive), s from the run's origin.
    pub to_s: f64,
    /// Factor applied to positions.
    pub factor: f64,
    /// Offset that is then added, rad or m.
    pub offset: f64,
}

/// Part of the run that uses the reported encoding of a stream, s from the run's origin on the joints'
/// clock. `None` if it is the whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EncodingSpans {
    /// Rotations: convention, order of components, inverse.
    pub rotation: Option<(f64, f64)>,
    /// Unit of angles.
    pub degrees: Option<(f64, f64)>,
    /// Unit of positions.
    pub length: Option<(f64, f64)>,
    /// Axis convention.
    pub axes: Option<(f64, f64)>,
}
