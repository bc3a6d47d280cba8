//! Appends poses by their pair of frames.

use std::collections::HashMap;

use super::super::row::{self, Group, Row, RowTimes};
use super::super::schema::bounded;
use super::values::{all_usable, push_times, quaternion};
use ground::stream::PoseColumns;

/// Child frames of poses identified by index; the first one names a single pose. Particle clouds and
/// paths have more poses.
const INDEX_NAMES: [&str; 16] = [
    "", "[1]", "[2]", "[3]", "[4]", "[5]", "[6]", "[7]", "[8]", "[9]", "[10]", "[11]", "[12]",
    "[13]", "[14]", "[15]",
];

/// Pairs on a topic. The largest trees have a few hundred.
pub(crate) const MAX_FRAMES: usize = 1 << 12;

/// Gazebo's frame of its states.
const SIMULATED_WORLD: &str = "world";

#[derive(Clone, Debug, Default)]
pub(in crate::decode) struct Poses {
    pub(super) groups: Vec<PoseColumns>,
    pub(super) by_frames: HashMap<String, usize>,
    /// Buffer for a key of `by_frames`.
    pub(super) key: String,
    /// Group of the previous row.
    pub(super) last: usize,
    /// Group that followed each group last time: trees are published in a constant order.
    pub(super) next: Vec<usize>,
    /// Rows beyond [`MAX_FRAMES`].
    pub(super) refused: u64,
}

impl Poses {
    pub(super) fn append(&mut self, row: &Row, times: RowTimes) {
        self.append_of(row.frame(row::FRAME), row.frame(row::CHILD), row, times);
    }

    pub(super) fn append_of(
        &mut self,
        frame_id: &str,
        child_frame_id: &str,
        row: &Row,
        times: RowTimes,
    ) {
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

    /// `None` if there are too many.
    pub(super) fn group(&mut self, frame_id: &str, child_frame_id: &str) -> Option<usize> {
        let group = self.find(frame_id, child_frame_id)?;
        self.next.resize(self.groups.len(), 0);
        if let Some(next) = self.next.get_mut(self.last) {
            *next = group;
        }
        self.last = group;
        Some(group)
    }

    pub(super) fn find(&mut self, frame_id: &str, child_frame_id: &str) -> Option<usize> {
        // Comparing two empty strings with glibc's vector instructions takes longer than everything else
        // here.
        let is = |own: &str, other: &str| {
            own.is_empty() == other.is_empty() && (own.is_empty() || own == other)
        };
        let same = |group: &PoseColumns| {
            is(&group.frame_id, frame_id) && is(&group.child_frame_id, child_frame_id)
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

impl Poses {
    fn keys(&self) -> Vec<&str> {
        let mut keys = vec![""; self.groups.len()];
        self.by_frames.iter().for_each(|(key, &group)| keys[group] = key.as_str());
        keys
    }

    /// Checks [`MAX_FRAMES`].
    pub(super) fn fits(&self, later: &Self) -> bool {
        let is_new = |key: &&&str| !self.by_frames.contains_key(**key);
        self.groups.len() + later.keys().iter().filter(is_new).count() <= MAX_FRAMES
    }

    pub(super) fn join(&mut self, later: Self) {
        self.refused += later.refused;
        let keys: Vec<String> = later.keys().into_iter().map(str::to_owned).collect();
        for (key, group) in keys.into_iter().zip(later.groups) {
            match self.by_frames.get(&key) {
                Some(&known) => {
                    let own = &mut self.groups[known];
                    own.not_finite += group.not_finite;
                    own.times.append(&group.times);
                    own.xyz.extend_from_slice(&group.xyz);
                    own.q_xyzw.extend_from_slice(&group.q_xyzw);
                }
                None => {
                    self.by_frames.insert(key, self.groups.len());
                    self.groups.push(group);
                }
            }
        }
    }
}

#[derive(Clone, Debug)]
pub(in crate::decode) struct PoseSet {
    pub(super) poses: Poses,
    pub(super) naming: Naming,
    /// Maximum number of poses in one message.
    pub(super) most: usize,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Naming {
    /// Index; see [`INDEX_NAMES`].
    Numbers,
    /// Name at their index, in the frame of the simulated world.
    Names,
}

impl Naming {
    pub(super) const fn max_poses(self) -> usize {
        match self {
            Naming::Numbers => INDEX_NAMES.len(),
            Naming::Names => MAX_FRAMES,
        }
    }
}

impl PoseSet {
    pub(super) fn append(&mut self, row: &Row, times: RowTimes) {
        self.most = self.most.max(row.index + 1);
        if self.is_too_large() {
            return;
        }
        match self.naming {
            Naming::Numbers => {
                self.poses.append_of(row.frame(row::FRAME), INDEX_NAMES[row.index], row, times);
            }
            Naming::Names => {
                if let Some(name) = row.names.get(row.index) {
                    self.poses.append_of(SIMULATED_WORLD, name, row, times);
                }
            }
        }
    }

    pub(super) fn join(&mut self, later: Self) {
        if !self.is_too_large() {
            self.poses.join(later.poses);
        }
        self.most = self.most.max(later.most);
    }

    pub(super) fn is_too_large(&self) -> bool {
        self.most > self.naming.max_poses()
    }

    /// `None` if there are too many for an arm.
    pub(super) fn finalize(self) -> Option<Vec<PoseColumns>> {
        let is_too_large = self.is_too_large();
        let mut groups = self.poses.groups;
        if self.naming == Naming::Names {
            remove_model_names(&mut groups);
        }
        (!is_too_large).then_some(groups)
    }
}

/// Shortens `model::link` if links are unique without the model.
fn remove_model_names(groups: &mut [PoseColumns]) {
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
