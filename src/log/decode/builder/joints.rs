//! Joint states, appended row by row.

use std::collections::HashMap;

use super::super::row::{self, Names, Row, RowTimes};
use super::super::schema::bounded;
use super::values::{keep_first, push_times};
use ground::stream::{JointColumn, JointColumns, usable};

/// Most joint names a topic may have. Rows are dense, so that a message with a new name each time
/// would fill the memory; the largest humanoids have below a hundred joints.
const MAX_JOINTS: usize = 256;

/// Once this many values are of joints that their message did not name (a gigabyte of them), …
const ABSENT_CELLS: usize = 1 << 26;
/// … one in so many values must be of one that it did: a topic has no more senders.
const SENDERS: usize = 8;

/// What joints are called that nothing names, before their number.
const COUNTED: &str = "q";

/// A message with joints for which there is no room.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TooManyJoints {
    /// It names more joints than a topic may have.
    #[error("more than {MAX_JOINTS} different joint names on one topic")]
    Names,
    /// Too many of the joints that were named before are not in this message and most others.
    #[error("most of the topic's joints are in hardly any of its messages")]
    Absent,
}

/// Joint states, with the way from a message's names to their columns.
#[derive(Clone, Debug, Default)]
pub(in crate::decode) struct Joints {
    /// Index into [`Row::lists`] of the positions,
    pub(super) positions: usize,
    /// and of the velocities.
    pub(super) velocities: usize,
    /// What stands before the number of a joint that the messages do not name.
    pub(super) stem: &'static str,
    pub(super) columns: JointColumns,
    pub(super) by_name: HashMap<String, usize>,
    /// Names of the message before, which the next one mostly repeats,
    pub(super) names: Names,
    /// and the column of each,
    pub(super) order: Vec<usize>,
    /// and whether that is every column once.
    pub(super) is_complete: bool,
    /// Values of all rows, and how many of them no message had.
    pub(super) cells: usize,
    pub(super) absent: usize,
}

impl Joints {
    pub(super) fn of(positions: usize, velocities: usize) -> Self {
        Self { positions, velocities, ..Self::default() }
    }

    pub(super) fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        let [positions, velocities] =
            [self.positions, self.velocities].map(|index| row.lists[index].as_slice());
        let is_counted = self.columns.unnamed && self.stem == COUNTED;
        if is_counted && !row.names.is_empty() {
            // Messages with names count more than those before them without.
            let dropped = self.columns.wrong_length + self.columns.times.len() as u64;
            *self = Self::of(self.positions, self.velocities);
            self.columns.wrong_length = dropped;
        } else if row.names.is_empty()
            && !positions.is_empty()
            && self.columns.joints.is_empty()
            && self.stem.is_empty()
        {
            (self.columns.unnamed, self.stem) = (true, COUNTED);
        }
        let unnamed = self.columns.unnamed;
        if !unnamed && positions.len() != row.names.len() {
            self.columns.wrong_length += 1;
            return Ok(());
        }
        if unnamed && positions.len() != self.names.len() {
            self.map_names(&usual_names(self.stem, positions.len()))?;
        } else if !unnamed && row.names != self.names {
            self.map_names(&row.names)?;
        }
        let (width, own) = (self.columns.joints.len(), self.order.len());
        let (cells, absent) = (self.cells + width, self.absent + width.saturating_sub(own));
        if is_too_sparse(cells, absent) {
            return Err(TooManyJoints::Absent);
        }
        (self.cells, self.absent) = (cells, absent);
        keep_first(&mut self.columns.frame_id, row.frame(row::FRAME));
        let index = push_times(&mut self.columns.times, row.stamp(), times);
        if !self.is_complete {
            for joint in &mut self.columns.joints {
                joint.position.push(f64::NAN);
                joint.velocity.push(f64::NAN);
            }
        }
        let with_velocity = velocities.len() == positions.len();
        let mut contradicts = false;
        for (i, (&column, &position)) in self.order.iter().zip(positions).enumerate() {
            let velocity = if with_velocity { velocities[i] } else { f64::NAN };
            let velocity = if usable(velocity) { velocity } else { f64::NAN };
            let position = if usable(position) {
                position
            } else {
                self.columns.drop_value(column);
                f64::NAN
            };
            let joint = &mut self.columns.joints[column];
            if self.is_complete {
                joint.position.push(position);
                joint.velocity.push(velocity);
            } else {
                // Of a name that is there twice the last value counts that is one.
                if !position.is_nan() {
                    let known = joint.position[index];
                    contradicts |= !known.is_nan() && known != position;
                    joint.position[index] = position;
                }
                if with_velocity {
                    joint.velocity[index] = velocity;
                }
            }
        }
        self.columns.contradictory += u64::from(contradicts);
        Ok(())
    }

    /// Whether there is room for the rows of `later`.
    pub(super) fn fits(&self, later: &Self) -> bool {
        let is_new = |joint: &&JointColumn| !self.by_name.contains_key(&joint.name);
        let new = later.columns.joints.iter().filter(is_new).count();
        let (cells, absent) = self.with(later, self.columns.joints.len() + new);
        // Names that are cut off, or no single words, are told apart by all of their text.
        let is_whole = |joint: &JointColumn| later.by_name.contains_key(&joint.name);
        // Joints that only some messages name are told apart one after the other.
        let is_alike = self.columns.joints.is_empty()
            || later.columns.joints.is_empty()
            || self.columns.unnamed == later.columns.unnamed;
        is_alike
            && self.columns.joints.len() + new <= MAX_JOINTS
            && !is_too_sparse(cells, absent)
            && later.columns.joints.iter().all(is_whole)
    }

    /// Values of all rows, and how many of them no message had, with those of `later` in columns for
    /// `width` joints.
    fn with(&self, later: &Self, width: usize) -> (usize, usize) {
        let cells = later.columns.times.len() * width;
        let there = later.cells - later.absent;
        (self.cells + cells, self.absent + cells.saturating_sub(there))
    }

    /// Appends the rows of `later`.
    pub(super) fn join(&mut self, later: Self) {
        // The next message that is appended alone finds its columns anew.
        self.names.clear();
        self.order.clear();
        self.is_complete = false;
        let (before, rows) = (self.columns.times.len(), later.columns.times.len());
        let mut order = Vec::with_capacity(later.columns.joints.len());
        for joint in &later.columns.joints {
            order.push(*self.by_name.entry(joint.name.clone()).or_insert_with(|| {
                let absent = vec![f64::NAN; before];
                let name = joint.name.clone();
                let own = JointColumn { name, position: absent.clone(), velocity: absent };
                self.columns.joints.push(own);
                self.columns.joints.len() - 1
            }));
        }
        (self.cells, self.absent) = self.with(&later, self.columns.joints.len());
        self.stem = if self.stem.is_empty() { later.stem } else { self.stem };
        let (own, later) = (&mut self.columns, later.columns);
        keep_first(&mut own.frame_id, &later.frame_id);
        own.unnamed |= later.unnamed;
        own.wrong_length += later.wrong_length;
        own.contradictory += later.contradictory;
        own.not_finite += later.not_finite;
        own.times.append(&later.times);
        for (&column, joint) in order.iter().zip(&later.joints) {
            own.joints[column].position.extend_from_slice(&joint.position);
            own.joints[column].velocity.extend_from_slice(&joint.velocity);
        }
        for (&column, &unusable) in order.iter().zip(&later.unusable) {
            own.count_unusable(column, unusable);
        }
        for joint in &mut own.joints {
            joint.position.resize(before + rows, f64::NAN);
            joint.velocity.resize(before + rows, f64::NAN);
        }
    }

    /// Finds the columns of `names`, and makes those that are new.
    pub(super) fn map_names(&mut self, names: &Names) -> Result<(), TooManyJoints> {
        // Should the columns run out halfway, the next message must be mapped anew.
        self.names.clear();
        self.order.clear();
        self.is_complete = false;
        let rows = self.columns.times.len();
        for name in names.iter() {
            let column = match self.by_name.get(name) {
                Some(&column) => column,
                None if self.columns.joints.len() == MAX_JOINTS => {
                    return Err(TooManyJoints::Names);
                }
                None => {
                    let absent = vec![f64::NAN; rows];
                    self.columns.joints.push(JointColumn {
                        name: bounded(name).into_owned(),
                        position: absent.clone(),
                        velocity: absent,
                    });
                    let column = self.columns.joints.len() - 1;
                    self.by_name.insert(name.to_owned(), column);
                    column
                }
            };
            self.order.push(column);
        }
        let mut once = self.order.clone();
        once.sort_unstable();
        self.is_complete = once.iter().copied().eq(0..self.columns.joints.len());
        self.names.clone_from(names);
        Ok(())
    }
}

/// Whether the rows of joint states take far more memory than what is in them, with so many values, of
/// which so many are of joints that their message did not name.
fn is_too_sparse(cells: usize, absent: usize) -> bool {
    absent > ABSENT_CELLS && cells / SENDERS > cells - absent
}

/// The names of `count` joints that a message does not name, in their order.
fn usual_names(stem: &str, count: usize) -> Names {
    let mut names = Names::default();
    for joint in 1..=count {
        names.push(format!("{stem}{joint}").as_bytes());
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_single_joints_are_bounded_by_what_is_in_them() {
        const MANY: usize = 1 << 30;
        assert!(!is_too_sparse(MANY, MANY / 2));
        assert!(!is_too_sparse(1 << 25, 1 << 25));
        assert!(is_too_sparse(MANY, MANY - MANY / 20));
    }
}
