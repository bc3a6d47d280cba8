//! Rows appended to columns, then finalized.

use std::collections::HashMap;
use std::ops::Range;

use super::row::{self, Group, Names, Row, RowTimes};
use super::schema::bounded;
use crate::stream::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns, Times,
    usable,
};

/// Most joint names a topic may have. Rows are dense, so that a message with a new name each time
/// would fill the memory; the largest humanoids have below a hundred joints.
const MAX_JOINTS: usize = 256;

/// Once this many values are of joints that their message did not name (a gigabyte of them), …
const ABSENT_CELLS: usize = 1 << 26;
/// … one in so many values must be of one that it did: a topic has no more senders.
const SENDERS: usize = 8;

/// Most distinct texts kept of a topic.
const MAX_TEXTS: usize = 64;

/// Longest text kept, in bytes.
const MAX_TEXT_BYTES: usize = 16 << 20;

/// What stands for the child frame of poses that are told apart by their place in the message; the
/// first has none, as where it is the only one. Particle clouds and paths have more.
const PLACES: [&str; 16] = [
    "", "[1]", "[2]", "[3]", "[4]", "[5]", "[6]", "[7]", "[8]", "[9]", "[10]", "[11]", "[12]",
    "[13]", "[14]", "[15]",
];

/// Most pairs of frames on one topic. The largest trees have a few hundred.
pub(in crate::log) const MAX_FRAMES: usize = 1 << 12;

/// What Gazebo calls the frame that its states are in.
const SIMULATED_WORLD: &str = "world";

/// A message with joints for which there is no room.
#[derive(Debug, thiserror::Error)]
pub(in crate::log) enum TooManyJoints {
    /// It names more joints than a topic may have.
    #[error("more than {MAX_JOINTS} different joint names on one topic")]
    Names,
    /// Too many of the joints that were named before are not in this message and most others.
    #[error("most of the topic's joints are in hardly any of its messages")]
    Absent,
}

/// The columns of one topic while rows are appended.
///
/// A type that holds several kinds of content has a part for each: the first under the topic's own
/// name, the others under that name with the field after a dot, as in Foxglove's message paths.
#[derive(Debug)]
pub(in crate::log) struct Builder {
    parts: Vec<(&'static str, Part)>,
    /// Whether the type has a stamp.
    stamped: bool,
}

/// What comes after the topic's name, and the columns to fill.
pub(super) type PartOf = (&'static str, fn() -> Part);

/// The columns of one kind of content.
#[derive(Debug)]
pub(super) enum Part {
    Joints(Joints),
    Poses(Poses),
    Crowd(Crowd),
    Transforms(Poses),
    Imu(ImuColumns),
    Array(Array),
    Text(TextColumns),
}

impl Part {
    /// The names and positions of joints.
    pub(super) fn joints() -> Self {
        Self::Joints(Joints::of(row::VALUES, row::VELOCITIES))
    }

    /// The names of joints and the positions that they shall have.
    pub(super) fn reference() -> Self {
        Self::Joints(Joints::of(row::REFERENCE, row::REFERENCE_VELOCITIES))
    }

    /// The positions of a Franka arm's joints, whose names are not in the message: what its drivers
    /// call them unless told otherwise.
    pub(super) fn franka_joints() -> Self {
        let mut joints = Joints::of(row::VALUES, row::VELOCITIES);
        joints.columns.unnamed = true;
        Self::Joints(joints)
    }

    /// Poses by their frames.
    pub(super) fn poses() -> Self {
        Self::Poses(Poses::default())
    }

    /// Poses by their place in the message.
    pub(super) fn numbered_poses() -> Self {
        Self::Crowd(Crowd { poses: Poses::default(), naming: Naming::Numbers, most: 0 })
    }

    /// Poses by the name at their place in the message.
    pub(super) fn named_poses() -> Self {
        Self::Crowd(Crowd { poses: Poses::default(), naming: Naming::Names, most: 0 })
    }

    /// Transforms by their frames.
    pub(super) fn transforms() -> Self {
        Self::Transforms(Poses::default())
    }

    /// Inertial readings.
    pub(super) fn imu() -> Self {
        Self::Imu(ImuColumns::default())
    }

    /// Bare numbers, from a list.
    pub(super) fn array() -> Self {
        Self::Array(Array::of(Numbers::List(row::VALUES)))
    }

    /// The numbers of a matrix.
    pub(super) fn matrix() -> Self {
        Self::Array(Array::of(Numbers::List(row::MATRIX)))
    }

    /// The components of a quaternion alone.
    pub(super) fn quaternion() -> Self {
        Self::Array(Array::of(Numbers::Fields(row::QUATERNION..row::QUATERNION + 4)))
    }

    /// The components of a vector alone.
    pub(super) fn vector() -> Self {
        Self::Array(Array::of(Numbers::Fields(row::POSITION..row::POSITION + 3)))
    }

    /// Texts.
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
    /// Empty columns for the parts of a type, which has a stamp or not.
    pub(super) fn new(parts: &[PartOf], stamped: bool) -> Self {
        Self { parts: parts.iter().map(|(name, part)| (*name, part())).collect(), stamped }
    }

    /// Appends one row, or counts why it is dropped.
    pub(in crate::log) fn append(
        &mut self,
        row: &Row,
        times: RowTimes,
    ) -> Result<(), TooManyJoints> {
        self.parts.iter_mut().try_for_each(|(_, part)| part.append(row, times))
    }

    /// Rows that were not taken, because the topic has more pairs of frames than [`MAX_FRAMES`].
    pub(in crate::log) fn refused(&self) -> u64 {
        let refused = |part: &Part| match part {
            Part::Poses(poses) | Part::Transforms(poses) => poses.refused,
            Part::Crowd(crowd) => crowd.poses.refused,
            Part::Joints(_) | Part::Imu(_) | Part::Array(_) | Part::Text(_) => 0,
        };
        self.parts.iter().map(|(_, part)| refused(part)).sum()
    }

    /// Why what was appended is of no use, where it is of none.
    pub(in crate::log) fn useless(&self) -> Option<String> {
        self.parts.iter().find_map(|(_, part)| match part {
            Part::Crowd(crowd) if crowd.is_too_large() => Some(format!(
                "a message of it holds {} poses, and an arm has no more than {}",
                crowd.most,
                crowd.naming.most()
            )),
            _ => None,
        })
    }

    /// The columns of each part, with what comes after the topic's name; none for a part that turned
    /// out to be of no use.
    pub(in crate::log) fn finalize(self) -> Vec<(&'static str, Option<Columns>)> {
        let unstamped = !self.stamped;
        let finalized = |(name, part): (&'static str, Part)| {
            let mut columns = part.finalize();
            for times in columns.iter_mut().flat_map(Columns::times_mut) {
                times.unstamped = unstamped;
            }
            (name, columns)
        };
        self.parts.into_iter().map(finalized).collect()
    }
}

/// Joint states, with the way from a message's names to their columns.
#[derive(Debug, Default)]
pub(super) struct Joints {
    /// Index into [`Row::lists`] of the positions,
    positions: usize,
    /// and of the velocities.
    velocities: usize,
    columns: JointColumns,
    by_name: HashMap<String, usize>,
    /// Names of the message before, which the next one mostly repeats,
    names: Names,
    /// and the column of each,
    order: Vec<usize>,
    /// and whether that is every column once.
    is_complete: bool,
    /// Values of all rows, and how many of them no message had.
    cells: usize,
    absent: usize,
}

impl Joints {
    fn of(positions: usize, velocities: usize) -> Self {
        Self { positions, velocities, ..Self::default() }
    }

    fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        let [positions, velocities] =
            [self.positions, self.velocities].map(|index| row.lists[index].as_slice());
        let unnamed = self.columns.unnamed;
        if !unnamed && positions.len() != row.names.len() {
            self.columns.wrong_length += 1;
            return Ok(());
        }
        if unnamed && positions.len() != self.names.len() {
            self.map_names(&usual_names(positions.len()))?;
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

    /// Finds the columns of `names`, and makes those that are new.
    fn map_names(&mut self, names: &Names) -> Result<(), TooManyJoints> {
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

/// What Franka's drivers call `count` joints unless told otherwise.
fn usual_names(count: usize) -> Names {
    let mut names = Names::default();
    for joint in 1..=count {
        names.push(format!("panda_joint{joint}").as_bytes());
    }
    names
}

/// Poses split by frame and child frame.
#[derive(Debug, Default)]
pub(super) struct Poses {
    groups: Vec<PoseColumns>,
    by_frames: HashMap<String, usize>,
    /// Scratch for a key of `by_frames`.
    key: String,
    /// The group of the row before,
    last: usize,
    /// and for each group the one whose row came after its own the last time: trees are published
    /// in one order.
    next: Vec<usize>,
    /// Rows of pairs of frames beyond [`MAX_FRAMES`].
    refused: u64,
}

impl Poses {
    fn append(&mut self, row: &Row, times: RowTimes) {
        self.append_of(row.frame(row::FRAME), row.frame(row::CHILD), row, times);
    }

    fn append_of(&mut self, frame_id: &str, child_frame_id: &str, row: &Row, times: RowTimes) {
        let group = match row.group.get() {
            Group::Known(group) => Some(group),
            Group::Wanted | Group::ByTexts => self.group(frame_id, child_frame_id),
        };
        let Some(group) = group else {
            self.refused += 1;
            return;
        };
        if row.group.get() == Group::Wanted {
            row.group.set(Group::Known(group));
        }
        let group = &mut self.groups[group];
        let xyz = row.numbers::<3>(row::POSITION);
        let q_xyzw = quaternion(row);
        if !all_usable(&xyz) || !all_usable(&q_xyzw) {
            group.not_finite += 1;
            return;
        }
        push_times(&mut group.times, row.stamp(), times);
        group.xyz.push(xyz);
        group.q_xyzw.push(q_xyzw);
    }

    /// The group of a pair of frames; `None` where there are too many of them.
    fn group(&mut self, frame_id: &str, child_frame_id: &str) -> Option<usize> {
        let group = self.find(frame_id, child_frame_id)?;
        self.next.resize(self.groups.len(), 0);
        if let Some(next) = self.next.get_mut(self.last) {
            *next = group;
        }
        self.last = group;
        Some(group)
    }

    fn find(&mut self, frame_id: &str, child_frame_id: &str) -> Option<usize> {
        let same = |group: &PoseColumns| {
            group.frame_id == frame_id && group.child_frame_id == child_frame_id
        };
        let next = self.next.get(self.last).copied().unwrap_or(self.last);
        let mut likely = [next, self.last].into_iter();
        if let Some(group) = likely.find(|&group| self.groups.get(group).is_some_and(same)) {
            return Some(group);
        }
        self.key.clear();
        self.key.push_str(frame_id);
        self.key.push('\0');
        self.key.push_str(child_frame_id);
        if let Some(&group) = self.by_frames.get(&self.key) {
            return Some(group);
        }
        if self.groups.len() == MAX_FRAMES {
            return None;
        }
        self.groups.push(PoseColumns {
            frame_id: bounded(frame_id).into_owned(),
            child_frame_id: bounded(child_frame_id).into_owned(),
            ..PoseColumns::default()
        });
        let group = self.groups.len() - 1;
        self.by_frames.insert(self.key.clone(), group);
        Some(group)
    }
}

/// The poses of messages that hold several at once.
#[derive(Debug)]
pub(super) struct Crowd {
    poses: Poses,
    naming: Naming,
    /// Most that a message held.
    most: usize,
}

/// How the poses of one message are told apart.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Naming {
    /// By their place; see [`PLACES`].
    Numbers,
    /// By the name at their place, in the frame of the simulated world.
    Names,
}

impl Naming {
    const fn most(self) -> usize {
        match self {
            Naming::Numbers => PLACES.len(),
            Naming::Names => MAX_FRAMES,
        }
    }
}

impl Crowd {
    fn append(&mut self, row: &Row, times: RowTimes) {
        self.most = self.most.max(row.index + 1);
        if self.is_too_large() {
            return;
        }
        match self.naming {
            Naming::Numbers => {
                self.poses.append_of(row.frame(row::FRAME), PLACES[row.index], row, times);
            }
            Naming::Names => {
                if let Some(name) = row.names.get(row.index) {
                    self.poses.append_of(SIMULATED_WORLD, name, row, times);
                }
            }
        }
    }

    /// Whether a message held too many to be those of an arm.
    fn is_too_large(&self) -> bool {
        self.most > self.naming.most()
    }

    /// The poses, unless they are too many to be an arm's.
    fn finalize(self) -> Option<Vec<PoseColumns>> {
        let is_too_large = self.is_too_large();
        let mut groups = self.poses.groups;
        if self.naming == Naming::Names {
            take_off_models(&mut groups);
        }
        (!is_too_large).then_some(groups)
    }
}

/// Takes the model off `model::link` where the links can be told apart without it.
fn take_off_models(groups: &mut [PoseColumns]) {
    let link = |name: &str| name.rsplit("::").next().unwrap_or(name).to_owned();
    let links: Vec<String> = groups.iter().map(|group| link(&group.child_frame_id)).collect();
    let mut models = HashMap::<&str, usize>::new();
    for link in &links {
        *models.entry(link).or_default() += 1;
    }
    for (group, link) in groups.iter_mut().zip(&links) {
        if models[link.as_str()] == 1 {
            group.child_frame_id.clone_from(link);
        }
    }
}

fn append_imu(imu: &mut ImuColumns, row: &Row, times: RowTimes) {
    keep_first(&mut imu.frame_id, row.frame(row::FRAME));
    // REP 145: −1 in the first place says that there is no orientation.
    let has_orientation = row.lists[row::VALUES].first() != Some(&-1.0);
    let q_xyzw = if has_orientation { row.numbers(row::QUATERNION) } else { [0.0; 4] };
    let gyro = row.numbers(row::GYRO);
    let accel = row.numbers(row::ACCEL);
    if !all_usable(&q_xyzw) || !all_usable(&gyro) || !all_usable(&accel) {
        imu.not_finite += 1;
        return;
    }
    imu.has_orientation |= has_orientation;
    push_times(&mut imu.times, row.stamp(), times);
    imu.q_xyzw.push(q_xyzw);
    imu.gyro.push(gyro);
    imu.accel.push(accel);
}

/// Bare numbers, and where they are from.
#[derive(Debug)]
pub(super) struct Array {
    numbers: Numbers,
    columns: ArrayColumns,
}

/// Which numbers of a row.
#[derive(Debug)]
enum Numbers {
    /// One of [`Row::lists`].
    List(usize),
    /// Some of [`Row::numbers`].
    Fields(Range<usize>),
}

impl Array {
    fn of(numbers: Numbers) -> Self {
        Self { numbers, columns: ArrayColumns::default() }
    }

    fn append(&mut self, row: &Row, times: RowTimes) {
        let array = &mut self.columns;
        let values = match &self.numbers {
            Numbers::List(index) => row.lists[*index].as_slice(),
            Numbers::Fields(fields) => &row.numbers[fields.clone()],
        };
        if array.width == 0 {
            array.width = values.len();
        }
        if values.is_empty() || values.len() != array.width {
            array.wrong_length += 1;
        } else if !all_usable(values) {
            array.not_finite += 1;
        } else {
            push_times(&mut array.times, row.stamp(), times);
            array.values.extend_from_slice(values);
        }
    }
}

fn append_text(column: &mut TextColumns, row: &Row, times: RowTimes) {
    let text = &row.texts[row::BODY];
    let full = column.text.len() == MAX_TEXTS || text.len() > MAX_TEXT_BYTES;
    if !full && !column.text.contains(text) {
        push_times(&mut column.times, 0, times);
        column.text.push(text.clone());
    }
}

/// Appends the times of a row and returns its index.
fn push_times(column: &mut Times, stamp: i64, times: RowTimes) -> usize {
    column.push(stamp, times.log, times.publish);
    column.sequence.push(times.sequence);
    column.len() - 1
}

fn keep_first(kept: &mut String, text: &str) {
    if kept.is_empty() && !text.is_empty() {
        *kept = bounded(text).into_owned();
    }
}

fn all_usable(values: &[f64]) -> bool {
    values.iter().all(|value| usable(*value))
}

/// A quaternion; not a number in all four places says what zeros say: nobody set it.
fn quaternion(row: &Row) -> [f64; 4] {
    let q_xyzw = row.numbers::<4>(row::QUATERNION);
    if q_xyzw.iter().all(|part| part.is_nan()) { [0.0; 4] } else { q_xyzw }
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
