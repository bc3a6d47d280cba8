//! Change points of a value, as reported.

use crate::FrameEstimate;
use ground::geometry::Pose;
use ground::stats::Measured;

/// Change point of a value.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangePoint<Value, Size> {
    /// Time, s from the run's origin, by the affected stream's stamps.
    pub at_s: f64,
    /// Half-width of the interval.
    pub within_s: f64,
    /// How the value changes in the interval.
    pub course: Course,
    /// Value before.
    pub from: Value,
    /// Value after.
    pub to: Value,
    /// Their difference.
    pub size: Size,
}

impl<Value, Size> ChangePoint<Value, Size> {
    /// Whether it is no step.
    pub fn is_gradual(&self) -> bool {
        self.course != Course::Step
    }

    /// Time constant of a settling change.
    pub fn time_constant_s(&self) -> Option<f64> {
        match self.course {
            Course::Settling(time_constant_s) => Some(time_constant_s),
            _ => None,
        }
    }
}

/// How a value changes in the interval of its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Course {
    /// At once, somewhere in it.
    Step,
    /// At a constant rate throughout it.
    Ramp,
    /// As `1 − exp(−t/τ)` from its start, with this `τ` in s.
    Settling(f64),
}

/// `reference_from_stream` or `tip_from_stream` before and after.
pub type FrameChange = ChangePoint<Pose, FrameEstimate>;
/// Change point of a number.
pub type ScalarChange = ChangePoint<f64, Measured>;

/// Change of a joint's zero or scale.
#[derive(Clone, Debug, PartialEq)]
pub struct JointChange {
    /// Joint's column.
    pub column: usize,
    /// What changes.
    pub parameter: JointParameter,
    /// Its change.
    pub change: ScalarChange,
}

/// Parameter of a joint in `q_true = factor · q_reported + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointParameter {
    /// The offset, rad or m.
    Zero,
    /// The factor.
    Factor,
}

/// Correction of a joint in one segment to match the baseline segment. Applied in the order of the list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPatch {
    /// Joint's column.
    pub column: usize,
    /// Column with which it is exchanged, before the rest.
    pub exchanged_with: Option<usize>,
    /// Start, inclusive, from the run's origin.
    pub from_s: f64,
    /// End, exclusive.
    pub to_s: f64,
    /// Applied to positions.
    pub factor: f64,
    /// Offset after the factor at the start, rad or m.
    pub offset: f64,
    /// Rate of the offset, per s.
    pub rate: f64,
}

impl JointPatch {
    /// Without an effect.
    pub(super) fn unchanged(column: usize, from_s: f64, to_s: f64) -> Self {
        Self { column, exchanged_with: None, from_s, to_s, factor: 1.0, offset: 0.0, rate: 0.0 }
    }
}

/// Spans of a stream's reported encoding, s from the run's origin on the joints' clock. `None` for the
/// whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EncodingSpans {
    /// Convention, component order, inverse.
    pub rotation: Option<(f64, f64)>,
    /// Unit of angles.
    pub degrees: Option<(f64, f64)>,
    /// Unit of positions.
    pub length: Option<(f64, f64)>,
    /// Axis convention.
    pub axes: Option<(f64, f64)>,
}
