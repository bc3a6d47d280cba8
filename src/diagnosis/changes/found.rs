//! What is said of an amount that changes in mid-run.

use crate::FrameEstimate;
use ground::geometry::Pose;
use ground::stats::Measured;

/// A moment from which on an amount is another.
#[derive(Clone, Debug, PartialEq)]
pub struct Change<Value, Size> {
    /// When, s from the run's origin, by the stamps of the stream whose amount it is.
    pub at_s: f64,
    /// The change came so much before or after that at most, s.
    pub within_s: f64,
    /// The amount before.
    pub from: Value,
    /// The amount after.
    pub to: Value,
    /// What takes the one to the other.
    pub by: Size,
}

/// A change of a frame: `reference_from_stream` or `tip_from_stream` before and after.
pub type FrameChange = Change<Pose, FrameEstimate>;
/// A change of a number.
pub type AmountChange = Change<f64, Measured>;

impl AmountChange {
    /// The largest of some changes, where there is one.
    pub fn largest<'a>(changes: impl IntoIterator<Item = &'a Self>) -> Option<&'a Self> {
        let size = |change: &Self| change.by.value.abs();
        changes.into_iter().max_by(|a, b| size(a).total_cmp(&size(b)))
    }
}

/// A joint whose zero or scale changes.
#[derive(Clone, Debug, PartialEq)]
pub struct JointChange {
    /// The joint's column.
    pub column: usize,
    /// Of `q_true = factor · q_reported + offset` the offset, rad or m.
    pub zero: Option<AmountChange>,
    /// The factor.
    pub factor: Option<AmountChange>,
}

/// What makes the positions of a joint in a part of the run those of the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPatch {
    /// The joint's column.
    pub column: usize,
    /// From this stamp on, s from the run's origin, …
    pub from_s: f64,
    /// … and before this one, …
    pub to_s: f64,
    /// … positions are multiplied by this, …
    pub factor: f64,
    /// … and this is added, rad or m.
    pub offset: f64,
}

/// The parts of the run in which a stream's numbers are coded as its diagnosis says, s from the run's origin by
/// the joints' clock; `None` of what is coded so throughout.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CodedParts {
    /// Its rotations: convention, order of components, inverse.
    pub rotation: Option<(f64, f64)>,
    /// The unit of its angles.
    pub degrees: Option<(f64, f64)>,
    /// The unit of its positions.
    pub length: Option<(f64, f64)>,
    /// Its axes.
    pub axes: Option<(f64, f64)>,
}
