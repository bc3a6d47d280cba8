//! Appends rows to columns.

mod joints;
mod poses;
mod values;

use self::joints::Joints;
use self::poses::{Naming, PoseSet, Poses};
use self::values::{Array, Numbers, append_imu, append_text, join_imu, join_texts};
use super::row::{self, Row, RowTimes};
use ground::stream::{Columns, ImuColumns, TextColumns};

pub(crate) use self::joints::TooManyJoints;
pub(crate) use self::poses::MAX_FRAMES;

/// Columns of one topic while rows are appended.
///
/// A type with several kinds of content has one part per kind. The first has the topic's own name, the
/// others append a dot and the field, as in Foxglove's message paths.
#[derive(Clone, Debug)]
pub(crate) struct Builder {
    kinds: &'static [NamedPart],
    parts: Vec<(&'static str, Part)>,
    stamped: bool,
}

/// Suffix of the topic's name, and the columns to fill.
pub(super) type NamedPart = (&'static str, fn() -> Part);

#[derive(Clone, Debug)]
pub(super) enum Part {
    Joints(Joints),
    Poses(Poses),
    Crowd(PoseSet),
    Transforms(Poses),
    Imu(ImuColumns),
    Array(Array),
    Text(TextColumns),
}

impl Part {
    pub(super) fn joints() -> Self {
        Self::Joints(Joints::new(row::VALUES, row::VELOCITIES))
    }

    pub(super) fn reference() -> Self {
        Self::Joints(Joints::new(row::REFERENCE, row::REFERENCE_VELOCITIES))
    }

    /// Messages of a Franka arm have no names, so the drivers' default names are used.
    pub(super) fn franka_joints() -> Self {
        let mut joints = Joints::new(row::VALUES, row::VELOCITIES);
        joints.columns.unnamed = true;
        joints.stem = "panda_joint";
        Self::Joints(joints)
    }

    /// Poses identified by frames.
    pub(super) fn poses() -> Self {
        Self::Poses(Poses::default())
    }

    /// Poses identified by index in the message.
    pub(super) fn numbered_poses() -> Self {
        Self::Crowd(PoseSet { poses: Poses::default(), naming: Naming::Numbers, most: 0 })
    }

    /// Poses identified by the name at their index in the message.
    pub(super) fn named_poses() -> Self {
        Self::Crowd(PoseSet { poses: Poses::default(), naming: Naming::Names, most: 0 })
    }

    pub(super) fn transforms() -> Self {
        Self::Transforms(Poses::default())
    }

    pub(super) fn imu() -> Self {
        Self::Imu(ImuColumns::default())
    }

    pub(super) fn array() -> Self {
        Self::Array(Array::new(Numbers::List(row::VALUES)))
    }

    pub(super) fn matrix() -> Self {
        Self::Array(Array::new(Numbers::List(row::MATRIX)))
    }

    pub(super) fn quaternion() -> Self {
        Self::Array(Array::new(Numbers::Fields(row::QUATERNION..row::QUATERNION + 4)))
    }

    pub(super) fn vector() -> Self {
        Self::Array(Array::new(Numbers::Fields(row::POSITION..row::POSITION + 3)))
    }

    pub(super) fn text() -> Self {
        Self::Text(TextColumns::default())
    }

    fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        match self {
            Part::Joints(joints) => joints.append(row, times)?,
            Part::Poses(poses) | Part::Transforms(poses) => poses.append(row, times),
            Part::Crowd(crowd) => crowd.append(row, times),
            Part::Imu(imu) => append_imu(imu, row, times),
            Part::Array(array) => array.append(row, times),
            Part::Text(text) => append_text(text, row, times),
        }
        Ok(())
    }

    fn fits(&self, later: &Self) -> bool {
        match (self, later) {
            (Part::Joints(own), Part::Joints(later)) => own.fits(later),
            (Part::Poses(own), Part::Poses(later))
            | (Part::Transforms(own), Part::Transforms(later)) => own.fits(later),
            (Part::Crowd(own), Part::Crowd(later)) => own.poses.fits(&later.poses),
            (Part::Imu(_), Part::Imu(_)) | (Part::Text(_), Part::Text(_)) => true,
            (Part::Array(own), Part::Array(later)) => own.fits(later),
            _ => false,
        }
    }

    fn join(&mut self, later: Self) {
        match (self, later) {
            (Part::Joints(own), Part::Joints(later)) => own.join(later),
            (Part::Poses(own), Part::Poses(later))
            | (Part::Transforms(own), Part::Transforms(later)) => own.join(later),
            (Part::Crowd(own), Part::Crowd(later)) => own.join(later),
            (Part::Imu(own), Part::Imu(later)) => join_imu(own, later),
            (Part::Array(own), Part::Array(later)) => own.join(later),
            (Part::Text(own), Part::Text(later)) => join_texts(own, later),
            // `can_join` checks that the parts are the same.
            _ => {}
        }
    }

    fn finalize(self) -> Option<Columns> {
        Some(match self {
            Part::Joints(joints) => Columns::Joints(joints.columns),
            Part::Poses(poses) => Columns::Poses(poses.groups),
            Part::Crowd(crowd) => Columns::Poses(crowd.finalize()?),
            Part::Transforms(poses) => Columns::Transforms(poses.groups),
            Part::Imu(imu) => Columns::Imu(imu),
            Part::Array(array) => Columns::Array(array.columns),
            Part::Text(text) => Columns::Text(text),
        })
    }
}

impl Builder {
    pub(super) fn new(kinds: &'static [NamedPart], stamped: bool) -> Self {
        let parts = kinds.iter().map(|(name, part)| (*name, part())).collect();
        Self { kinds, parts, stamped }
    }

    pub(crate) fn empty_copy(&self) -> Self {
        Self::new(self.kinds, self.stamped)
    }

    /// Whether [`Builder::join`] equals appending the rows of `later`, which has the same parts, one by
    /// one.
    pub(crate) fn can_join(&self, later: &Self) -> bool {
        let parts = self.parts.iter().zip(&later.parts);
        parts.into_iter().all(|((_, own), (_, later))| own.fits(later))
    }

    /// `later` must pass [`Builder::can_join`].
    pub(crate) fn join(&mut self, later: Self) {
        for ((_, own), (_, later)) in self.parts.iter_mut().zip(later.parts) {
            own.join(later);
        }
    }

    /// Appends one row, or counts why it is dropped.
    pub(crate) fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        self.parts.iter_mut().try_for_each(|(_, part)| part.append(row, times))
    }

    /// Rows beyond [`MAX_FRAMES`] pairs of frames.
    pub(crate) fn rejected_rows(&self) -> u64 {
        let refused = |part: &Part| match part {
            Part::Poses(poses) | Part::Transforms(poses) => poses.refused,
            Part::Crowd(crowd) => crowd.poses.refused,
            Part::Joints(_) | Part::Imu(_) | Part::Array(_) | Part::Text(_) => 0,
        };
        self.parts.iter().map(|(_, part)| refused(part)).sum()
    }

    pub(crate) fn unusable_reason(&self) -> Option<String> {
        self.parts.iter().find_map(|(_, part)| match part {
            Part::Crowd(crowd) if crowd.is_too_large() => Some(format!(
                "a message contains {} poses; an arm has at most {}",
                crowd.most,
                crowd.naming.max_poses()
            )),
            _ => None,
        })
    }

    /// With topic name suffixes; `None` for an unusable part.
    pub(crate) fn finalize(self) -> Vec<(&'static str, Option<Columns>)> {
        let unstamped = !self.stamped;
        let finalized = |(name, part): (&'static str, Part)| {
            let mut columns = part.finalize();
            // Access would copy shared times.
            for times in columns.iter_mut().filter(|_| unstamped).flat_map(Columns::times_mut) {
                times.unstamped = true;
            }
            (name, columns)
        };
        self.parts.into_iter().map(finalized).collect()
    }
}
