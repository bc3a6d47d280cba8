//! Appends poses by their pair of frames.

use std::collections::HashMap;

use super::super::row::{self, Group, Row, RowTimes};
use super::super::schema::bounded;
use super::values::{all_usable, push_times, quaternion};
use ground::stream::{PoseColumns, SharedTimes};

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
    /// Whether rows were appended since the groups shared their times.
    pub(super) may_share_times: bool,
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
        self.may_share_times = true;
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

    pub(super) fn join(&mut self, mut later: Self) {
        self.share_times();
        later.share_times();
        self.refused += later.refused;
        let keys: Vec<String> = later.keys().into_iter().map(str::to_owned).collect();
        let mut added: Vec<(usize, SharedTimes)> = Vec::new();
        for (key, group) in keys.into_iter().zip(later.groups) {
            match self.by_frames.get(&key) {
                Some(&known) => {
                    let own = &mut self.groups[known];
                    own.not_finite += group.not_finite;
                    own.xyz.extend_from(&group.xyz);
                    own.q_xyzw.extend_from(&group.q_xyzw);
                    added.push((known, group.times));
                }
                None => {
                    self.by_frames.insert(key, self.groups.len());
                    self.groups.push(group);
                }
            }
        }
        self.append_times(&added);
    }

    /// Lets successive groups with equal times share them: a message contains transforms of one stamp.
    fn share_times(&mut self) {
        /// Bounds the time of comparisons if joins alternate with appended rows.
        const MAX_COMPARED_ROWS: usize = 1 << 16;
        if !std::mem::take(&mut self.may_share_times) {
            return;
        }
        for at in 1..self.groups.len() {
            let (before, own) = (&self.groups[at - 1].times, &self.groups[at].times);
            if own.len() <= MAX_COMPARED_ROWS && before == own {
                self.groups[at].times = before.clone();
            }
        }
    }

    /// Appends times to groups. Groups that share times and receive shared ones still share them.
    fn append_times(&mut self, added: &[(usize, SharedTimes)]) {
        let groups = &mut self.groups;
        let mut rest = added;
        while let [(first, times), ..] = rest {
            let is_shared = |(group, other): &&(usize, SharedTimes)| {
                times.is_shared_with(other)
                    && groups[*first].times.is_shared_with(&groups[*group].times)
            };
            let (alike, others) = rest.split_at(rest.iter().take_while(is_shared).count());
            rest = others;
            let mut all = std::mem::take(&mut groups[*first].times);
            // The times are copied unless this is their only use.
            alike.iter().for_each(|(group, _)| groups[*group].times = SharedTimes::default());
            all.append(times);
            alike.iter().for_each(|(group, _)| groups[*group].times = all.clone());
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    const CHILDREN: [&str; 3] = ["a", "b", "c"];

    /// Rows of one chunk, by index of the child frame and stamps.
    fn chunk(rows: &[(usize, Vec<i64>)]) -> Poses {
        let mut poses = Poses { may_share_times: true, ..Poses::default() };
        for (child, stamps) in rows {
            let group = poses.find("base", CHILDREN[*child]).expect("room for the pair");
            let group = &mut poses.groups[group];
            for &stamp in stamps {
                group.times.push(stamp, stamp + 1, stamp + 1);
                group.xyz.push([stamp as f64, 0.0, 0.0]);
                group.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
            }
        }
        poses
    }

    #[test]
    fn transforms_of_the_same_messages_share_their_times() {
        let mut joined = Poses::default();
        for first in [10, 30] {
            joined.join(chunk(&[(0, vec![first, first + 9]), (1, vec![first, first + 9])]));
        }
        let [a, b] = [0, 1].map(|group| &joined.groups[group].times);
        assert!(a.is_shared_with(b) && a.header == [10, 19, 30, 39]);
        joined.join(chunk(&[(0, vec![50]), (1, vec![51])]));
        let [a, b] = [0, 1].map(|group| joined.groups[group].times.header.last());
        assert_eq!((a, b), (Some(&50), Some(&51)));
    }

    proptest! {
        #[test]
        fn shared_times_are_those_of_the_rows(
            chunks in prop::collection::vec(
                prop::collection::vec((0..CHILDREN.len(), prop::collection::vec(1_i64..3, 0..3)), 0..4),
                0..5,
            )
        ) {
            let mut joined = Poses::default();
            let mut expected: BTreeMap<&str, Vec<i64>> = BTreeMap::new();
            for rows in &chunks {
                for (child, stamps) in rows {
                    expected.entry(CHILDREN[*child]).or_default().extend(stamps);
                }
                joined.join(chunk(rows));
            }
            prop_assert_eq!(joined.groups.len(), expected.len());
            for group in &joined.groups {
                let stamps = &expected[group.child_frame_id.as_str()];
                prop_assert_eq!(&group.times.header, stamps);
                let x: Vec<f64> = group.xyz.iter().map(|xyz| xyz[0]).collect();
                prop_assert!(x.iter().zip(stamps).all(|(x, stamp)| *x == *stamp as f64));
            }
        }
    }
}
