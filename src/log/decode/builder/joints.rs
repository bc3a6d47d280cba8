//! Appends joint states.

use std::collections::HashMap;

use super::super::row::{self, Names, Row, RowTimes};
use super::super::schema::bounded;
use super::values::{keep_first, push_times};
use ground::stream::{JointColumn, JointColumns, is_usable, usable_or_nan};

/// Rows are dense, so new names in every message would fill the memory. The largest humanoids have fewer
/// than a hundred joints.
const MAX_JOINTS: usize = 256;

/// Maximum number of missing values (one gigabyte) in sparse topics.
const MAX_ABSENT_CELLS: usize = 1 << 26;
/// Above it, at least one value in this many must be present. A topic does not have more senders.
const MAX_SENDERS: usize = 8;

/// Followed by the joint's number.
const UNNAMED_PREFIX: &str = "q";

#[derive(Debug, thiserror::Error)]
pub(crate) enum TooManyJoints {
    #[error("topic has more than {MAX_JOINTS} different joint names")]
    Names,
    #[error("most joints of the topic are missing from most of its messages")]
    Absent,
}

#[derive(Clone, Debug, Default)]
pub(in crate::decode) struct Joints {
    /// Indices into [`Row::lists`].
    pub(super) positions: usize,
    pub(super) velocities: usize,
    /// Prefix of unnamed joints' numbers.
    pub(super) stem: &'static str,
    pub(super) columns: JointColumns,
    pub(super) by_name: HashMap<String, usize>,
    /// Names of the previous message; the next one usually repeats them.
    pub(super) names: Names,
    /// Column of each name.
    pub(super) order: Vec<usize>,
    /// Whether the names are all columns, each once.
    pub(super) is_complete: bool,
    /// Values in all rows; `absent` counts those missing from their messages.
    pub(super) cells: usize,
    pub(super) absent: usize,
}

impl Joints {
    pub(super) fn new(positions: usize, velocities: usize) -> Self {
        Self { positions, velocities, ..Self::default() }
    }

    pub(super) fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        let [positions, velocities] =
            [self.positions, self.velocities].map(|index| row.lists[index].as_slice());
        let is_counted = self.columns.unnamed && self.stem == UNNAMED_PREFIX;
        if is_counted && !row.names.is_empty() {
            // Messages with names take precedence over earlier ones without.
            let dropped = self.columns.wrong_length + self.columns.times.len() as u64;
            *self = Self::new(self.positions, self.velocities);
            self.columns.wrong_length = dropped;
        } else if row.names.is_empty()
            && !positions.is_empty()
            && self.columns.joints.is_empty()
            && self.stem.is_empty()
        {
            (self.columns.unnamed, self.stem) = (true, UNNAMED_PREFIX);
        }
        let unnamed = self.columns.unnamed;
        if !unnamed && positions.len() != row.names.len() {
            self.columns.wrong_length += 1;
            return Ok(());
        }
        if unnamed && positions.len() != self.names.len() {
            self.map_names(&default_names(self.stem, positions.len()))?;
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
            let velocity = usable_or_nan(velocity);
            let position = if is_usable(position) {
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
                // For duplicate names, the last value that is not NaN counts.
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

    /// Checks the limits with the rows of `later`.
    pub(super) fn fits(&self, later: &Self) -> bool {
        let is_new = |joint: &&JointColumn| !self.by_name.contains_key(&joint.name);
        let new = later.columns.joints.iter().filter(is_new).count();
        let (cells, absent) = self.with(later, self.columns.joints.len() + new);
        // Truncated names and names with spaces must match in full.
        let is_whole = |joint: &JointColumn| later.by_name.contains_key(&joint.name);
        // If only some messages name the joints, match one message at a time.
        let is_alike = self.columns.joints.is_empty()
            || later.columns.joints.is_empty()
            || self.columns.unnamed == later.columns.unnamed;
        is_alike
            && self.columns.joints.len() + new <= MAX_JOINTS
            && !is_too_sparse(cells, absent)
            && later.columns.joints.iter().all(is_whole)
    }

    /// All and missing values after joining `later` into columns for `width` joints.
    fn with(&self, later: &Self, width: usize) -> (usize, usize) {
        let cells = later.columns.times.len() * width;
        let there = later.cells - later.absent;
        (self.cells + cells, self.absent + cells.saturating_sub(there))
    }

    pub(super) fn join(&mut self, later: Self) {
        // The next single message maps its names again.
        self.names.clear();
        self.order.clear();
        self.is_complete = false;
        let (before, rows) = (self.columns.times.len(), later.columns.times.len());
        let mut order = Vec::with_capacity(later.columns.joints.len());
        for joint in &later.columns.joints {
            order.push(*self.by_name.entry(joint.name.clone()).or_insert_with(|| {
                self.columns.joints.push(JointColumn::absent(joint.name.clone(), before));
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
            own.joints[column].velocity.extend_from(&joint.velocity);
        }
        for (&column, &unusable) in order.iter().zip(&later.unusable) {
            own.count_unusable(column, unusable);
        }
        for joint in &mut own.joints {
            joint.position.resize(before + rows, f64::NAN);
            joint.velocity.extend_constant(f64::NAN, before + rows - joint.velocity.len());
        }
    }

    pub(super) fn map_names(&mut self, names: &Names) -> Result<(), TooManyJoints> {
        // After a failure the next message must be mapped again.
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
                    let shown = bounded(name).into_owned();
                    self.columns.joints.push(JointColumn::absent(shown, rows));
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

/// The rows need far more memory than their content.
fn is_too_sparse(cells: usize, absent: usize) -> bool {
    absent > MAX_ABSENT_CELLS && cells / MAX_SENDERS > cells - absent
}

fn default_names(stem: &str, count: usize) -> Names {
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
    fn overly_sparse_joint_messages_are_refused() {
        const MANY: usize = 1 << 30;
        assert!(!is_too_sparse(MANY, MANY / 2));
        assert!(!is_too_sparse(1 << 25, 1 << 25));
        assert!(is_too_sparse(MANY, MANY - MANY / 20));
    }
}
