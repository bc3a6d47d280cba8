//! Frames of a log and their transforms.

use std::collections::{HashMap, VecDeque};

use super::tf_error::TfError;
use crate::geometry::{Pose, interpolate};
use crate::robot::nearest;
use crate::time::Stamp;

/// Source of the transform between two frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// A static TF topic: one transform for all times.
    Static,
    /// A TF topic: interpolated samples.
    Dynamic,
    /// An unpublished fixed joint of the model.
    Model,
}

/// Transform between a frame and one parent.
#[derive(Clone, Debug)]
pub struct Edge {
    /// Its source.
    pub kind: EdgeKind,
    parent: usize,
    child: usize,
    /// Strictly increasing; one unused entry unless dynamic.
    stamps: Vec<Stamp>,
    parent_from_child: Vec<Pose>,
}

impl Edge {
    /// `parent_from_child`, interpolated linearly and by slerp. `None` outside the samples.
    fn pose_at(&self, at: Stamp) -> Option<Pose> {
        if self.kind != EdgeKind::Dynamic {
            return self.parent_from_child.first().copied();
        }
        let right = self.stamps.partition_point(|&stamp| stamp < at);
        let (stamp, pose) = (self.stamps.get(right)?, self.parent_from_child.get(right)?);
        if *stamp == at {
            return Some(*pose);
        }
        let left = right.checked_sub(1)?;
        let part = at.seconds_since(self.stamps[left]) / stamp.seconds_since(self.stamps[left]);
        Some(interpolate(&self.parent_from_child[left], pose, part))
    }

    /// `parent_from_child` of its first sample.
    pub fn first(&self) -> Option<&Pose> {
        self.parent_from_child.first()
    }

    fn outside_by_s(&self, at: Stamp) -> f64 {
        match (self.stamps.first(), self.stamps.last()) {
            (Some(&first), _) if at < first => at.seconds_since(first),
            (_, Some(&last)) => at.seconds_since(last),
            _ => 0.0,
        }
    }
}

/// Frames of a log and their transforms.
///
/// Frames may have two parents or form a cycle. Paths have the fewest edges, then the earliest inserted
/// ones.
#[derive(Clone, Debug, Default)]
pub struct TfTree {
    frames: Vec<String>,
    ids: HashMap<String, usize>,
    edges: Vec<Edge>,
    touching: Vec<Vec<usize>>,
}

impl TfTree {
    /// Adds a static transform.
    pub fn insert_fixed(
        &mut self,
        parent: &str,
        child: &str,
        kind: EdgeKind,
        parent_from_child: Pose,
    ) {
        self.insert(parent, child, kind, vec![Stamp::default()], vec![parent_from_child]);
    }

    /// Adds samples; `stamps` must strictly increase.
    pub fn insert(
        &mut self,
        parent: &str,
        child: &str,
        kind: EdgeKind,
        stamps: Vec<Stamp>,
        parent_from_child: Vec<Pose>,
    ) {
        let (parent, child) = (self.intern(parent), self.intern(child));
        for frame in [parent, child] {
            self.touching[frame].push(self.edges.len());
        }
        self.edges.push(Edge { kind, parent, child, stamps, parent_from_child });
    }

    fn intern(&mut self, frame: &str) -> usize {
        let frame = strip_slash(frame);
        if let Some(&id) = self.ids.get(frame) {
            return id;
        }
        let id = self.frames.len();
        self.frames.push(frame.to_owned());
        self.ids.insert(frame.to_owned(), id);
        self.touching.push(Vec::new());
        id
    }

    /// Frames, in order of first appearance.
    pub fn frames(&self) -> impl Iterator<Item = &str> {
        self.frames.iter().map(String::as_str)
    }

    /// Whether the frame exists.
    pub fn contains(&self, frame: &str) -> bool {
        self.ids.contains_key(strip_slash(frame))
    }

    /// First inserted transform in this direction.
    pub fn edge(&self, parent: &str, child: &str) -> Option<&Edge> {
        let parent = self.known(parent)?;
        self.edges_to(self.known(child)?).find(|edge| edge.parent == parent)
    }

    /// Whether the frame has a parent.
    pub fn has_parent(&self, child: &str) -> bool {
        self.known(child).is_some_and(|child| self.edges_to(child).next().is_some())
    }

    /// Whether the frame has a child.
    pub(super) fn has_child(&self, parent: &str) -> bool {
        let edges = |parent: usize| self.touching[parent].iter().map(|&edge| &self.edges[edge]);
        self.known(parent).is_some_and(|parent| edges(parent).any(|edge| edge.parent == parent))
    }

    /// Transforms to the frame from its parents, in insertion order.
    fn edges_to(&self, child: usize) -> impl Iterator<Item = &Edge> {
        let edges = self.touching[child].iter().map(|&edge| &self.edges[edge]);
        edges.filter(move |edge| edge.child == child)
    }

    /// Transforms, in insertion order.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// Parent and child of an edge.
    pub fn names(&self, edge: &Edge) -> (&str, &str) {
        (&self.frames[edge.parent], &self.frames[edge.child])
    }

    /// `target_from_source`, like tf2's `lookup_transform`.
    ///
    /// # Errors
    /// If a frame is unknown, the two are not connected, or a transform has no samples on both sides of
    /// `at`.
    pub fn lookup(&self, target: &str, source: &str, at: Stamp) -> Result<Pose, TfError> {
        self.path(target, source, |_| true)?.pose_at(at)
    }

    /// Path from `source` to `target` over edges that satisfy `admits`.
    ///
    /// # Errors
    /// If a frame is unknown or the two are not connected.
    pub fn path(
        &self,
        target: &str,
        source: &str,
        admits: impl Fn(&Edge) -> bool,
    ) -> Result<TfPath<'_>, TfError> {
        let (from, to) = (self.id(target)?, self.id(source)?);
        self.shortest_path(from, to, admits).ok_or_else(|| TfError::NotConnected {
            target: self.frames[from].clone(),
            source_frame: self.frames[to].clone(),
            target_root: self.root_above(from).to_owned(),
            source_root: self.root_above(to).to_owned(),
        })
    }

    /// The same, without an explanation if the frames are not connected.
    pub(super) fn find_path(
        &self,
        target: &str,
        source: &str,
        admits: impl Fn(&Edge) -> bool,
    ) -> Option<TfPath<'_>> {
        self.shortest_path(self.known(target)?, self.known(source)?, admits)
    }

    fn shortest_path(
        &self,
        from: usize,
        to: usize,
        admits: impl Fn(&Edge) -> bool,
    ) -> Option<TfPath<'_>> {
        let came_by = self.flood(from, |frame| frame == to, admits);
        let mut steps = Vec::new();
        let mut frame = to;
        while frame != from {
            let edge = *came_by.get(&frame)?;
            let downwards = self.edges[edge].child == frame;
            steps.push(Step { edge: &self.edges[edge], downwards });
            frame = if downwards { self.edges[edge].parent } else { self.edges[edge].child };
        }
        steps.reverse();
        Some(TfPath { tree: self, steps })
    }

    /// Nearest accepted frame that is statically tied to `frame`, with `accepted_from_frame`.
    pub fn nearest_fixed(
        &self,
        frame: &str,
        accepts: impl Fn(&str) -> bool,
    ) -> Option<(&str, Pose)> {
        let from = self.known(frame)?;
        let fixed = |edge: &Edge| edge.kind != EdgeKind::Dynamic;
        let mut found = None;
        self.flood(
            from,
            |reached| {
                let accepted = accepts(&self.frames[reached]);
                if accepted {
                    found = Some(reached);
                }
                accepted
            },
            fixed,
        );
        let name = &self.frames[found?];
        let accepted_from_frame = self.find_path(name, frame, fixed)?;
        Some((name, accepted_from_frame.pose_at(Stamp::default()).ok()?))
    }

    /// Breadth-first search until `stop`. Returns the edge to each reached frame.
    fn flood(
        &self,
        from: usize,
        mut stop: impl FnMut(usize) -> bool,
        admits: impl Fn(&Edge) -> bool,
    ) -> HashMap<usize, usize> {
        let mut came_by = HashMap::new();
        let mut pending = VecDeque::from([from]);
        while let Some(frame) = pending.pop_front() {
            if stop(frame) {
                break;
            }
            for &index in &self.touching[frame] {
                let edge = &self.edges[index];
                let next = if edge.parent == frame { edge.child } else { edge.parent };
                if next != from && !came_by.contains_key(&next) && admits(edge) {
                    came_by.insert(next, index);
                    pending.push_back(next);
                }
            }
        }
        came_by
    }

    /// Whether `upper` is an ancestor by first parents.
    pub fn is_above(&self, upper: &str, lower: &str) -> bool {
        let (Some(upper), Some(lower)) = (self.known(upper), self.known(lower)) else {
            return false;
        };
        self.ancestors(lower).any(|frame| frame == upper)
    }

    /// Transforms up to the root, by first parents.
    pub(super) fn edges_above(&self, frame: &str) -> Vec<&Edge> {
        let Some(id) = self.known(frame) else { return Vec::new() };
        let up = |frame: usize| self.edges_to(frame).next();
        std::iter::once(id).chain(self.ancestors(id)).filter_map(up).collect()
    }

    pub(super) fn root_of(&self, frame: &str) -> &str {
        self.known(frame).map_or("", |id| self.root_above(id))
    }

    /// Root by first parents, or a frame of the cycle.
    fn root_above(&self, frame: usize) -> &str {
        &self.frames[self.ancestors(frame).last().unwrap_or(frame)]
    }

    /// Ancestors by first parents; limited in number for cycles.
    fn ancestors(&self, frame: usize) -> impl Iterator<Item = usize> {
        let parent = |frame: &usize| self.edges_to(*frame).next().map(|edge| edge.parent);
        std::iter::successors(parent(&frame), parent).take(self.frames.len())
    }

    fn known(&self, frame: &str) -> Option<usize> {
        self.ids.get(strip_slash(frame)).copied()
    }

    fn id(&self, frame: &str) -> Result<usize, TfError> {
        let frame = strip_slash(frame);
        self.known(frame).ok_or_else(|| TfError::UnknownFrame {
            frame: frame.to_owned(),
            nearest: nearest(frame, self.frames()).into_iter().map(str::to_owned).collect(),
        })
    }
}

/// Transforms between two frames.
#[derive(Clone, Debug)]
pub struct TfPath<'a> {
    tree: &'a TfTree,
    /// Steps from target to source.
    steps: Vec<Step<'a>>,
}

#[derive(Clone, Copy, Debug)]
struct Step<'a> {
    edge: &'a Edge,
    downwards: bool,
}

impl TfPath<'_> {
    /// `target_from_source` at `at`.
    ///
    /// # Errors
    /// [`TfError::Extrapolation`] if a transform has no samples on both sides of `at`.
    pub fn pose_at(&self, at: Stamp) -> Result<Pose, TfError> {
        let mut target_from_here = Pose::identity();
        for Step { edge, downwards } in &self.steps {
            let parent_from_child = edge.pose_at(at).ok_or_else(|| {
                let (parent, child) = self.tree.names(edge);
                TfError::Extrapolation {
                    parent: parent.to_owned(),
                    child: child.to_owned(),
                    outside_by_s: edge.outside_by_s(at),
                }
            })?;
            target_from_here *=
                if *downwards { parent_from_child } else { parent_from_child.inverse() };
        }
        Ok(target_from_here)
    }

    /// `target_from_source` at each stamp with a value.
    pub(super) fn poses_at(&self, stamps: &[Stamp]) -> Vec<(Stamp, Pose)> {
        stamps.iter().filter_map(|&stamp| Some((stamp, self.pose_at(stamp).ok()?))).collect()
    }

    /// Time range of dynamic transforms; `None` without any.
    pub fn span(&self) -> Option<(Stamp, Stamp)> {
        let first = self.dynamic_edges().filter_map(|edge| edge.stamps.first()).max()?;
        let last = self.dynamic_edges().filter_map(|edge| edge.stamps.last()).min()?;
        Some((*first, *last))
    }

    /// Whether each dynamic transform has a sample at `at`.
    pub fn is_sampled(&self, at: Stamp) -> bool {
        self.dynamic_edges().all(|edge| edge.stamps.binary_search(&at).is_ok())
    }

    /// Oldest of the dynamic transforms' latest samples up to `at`.
    pub fn newest_before(&self, at: Stamp) -> Option<Stamp> {
        let newest = self.dynamic_edges().filter_map(|edge| {
            let behind = edge.stamps.partition_point(|&stamp| stamp <= at);
            edge.stamps.get(behind.checked_sub(1)?).copied()
        });
        newest.min()
    }

    /// Edges from target to source.
    pub fn edges(&self) -> impl Iterator<Item = &Edge> {
        self.steps.iter().map(|step| step.edge)
    }

    /// Dynamic edges from target to source.
    pub fn dynamic_edges(&self) -> impl Iterator<Item = &Edge> {
        self.edges().filter(|edge| edge.kind == EdgeKind::Dynamic)
    }

    /// Sorted distinct stamps of dynamic transforms.
    pub fn stamps(&self) -> Vec<Stamp> {
        let dynamic = self.dynamic_edges();
        let mut stamps: Vec<Stamp> = dynamic.flat_map(|edge| edge.stamps.iter().copied()).collect();
        // A stable sort is fast on sorted runs.
        stamps.sort();
        stamps.dedup();
        stamps
    }
}

/// Frame name without the leading `/` of older logs.
pub(super) fn strip_slash(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{pose, rotation_from_rpy};
    use crate::time::NANOS_PER_SECOND;

    fn stamp(s: f64) -> Stamp {
        Stamp::from_nanos((s * NANOS_PER_SECOND as f64) as i64)
    }

    fn some_pose(seed: f64) -> Pose {
        pose([seed, 0.5 - seed, 2.0 * seed], rotation_from_rpy([0.3 * seed, -0.2, 1.1 * seed]))
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        let gap = a.inverse() * b;
        gap.translation.vector.norm() + gap.rotation.angle()
    }

    /// world ─static→ base ─dynamic→ arm ─static→ tool, and world ─static→ camera.
    fn tree() -> TfTree {
        let mut tree = TfTree::default();
        tree.insert_fixed("world", "base", EdgeKind::Static, some_pose(0.1));
        let (stamps, poses) = (vec![stamp(1.0), stamp(2.0)], vec![some_pose(0.2), some_pose(0.9)]);
        tree.insert("/base", "arm", EdgeKind::Dynamic, stamps, poses);
        tree.insert_fixed("arm", "tool", EdgeKind::Model, some_pose(0.3));
        tree.insert_fixed("world", "camera", EdgeKind::Static, some_pose(0.4));
        tree
    }

    #[test]
    fn a_lookup_is_the_product_over_the_common_ancestor() {
        let camera_from_tool = tree().lookup("camera", "tool", stamp(2.0)).unwrap();
        let by_hand = some_pose(0.4).inverse() * some_pose(0.1) * some_pose(0.9) * some_pose(0.3);
        assert!(distance(&camera_from_tool, &by_hand) < 1e-12);
        let back = tree().lookup("tool", "camera", stamp(2.0)).unwrap();
        assert!(distance(&(back * camera_from_tool), &Pose::identity()) < 1e-12);
    }

    #[test]
    fn between_samples_position_is_linear_and_rotation_a_slerp() {
        let (a, b) = (some_pose(0.2), some_pose(0.9));
        let got = tree().lookup("base", "arm", stamp(1.25)).unwrap();
        let slerp = a.rotation.slerp(&b.rotation, 0.25);
        let lerp = a.translation.vector.lerp(&b.translation.vector, 0.25);
        assert!(distance(&got, &Pose::from_parts(lerp.into(), slerp)) < 1e-12);
    }

    #[test]
    fn outside_the_samples_the_error_gives_the_distance() {
        let error = tree().lookup("world", "tool", stamp(2.043)).unwrap_err();
        let TfError::Extrapolation { parent, outside_by_s, .. } = &error else { panic!("{error}") };
        assert_eq!(parent, "base");
        assert!((outside_by_s - 0.043).abs() < 1e-9);
        assert!(error.to_string().contains("0.043 s after the last"), "{error}");
        let early = tree().lookup("world", "tool", stamp(0.5)).unwrap_err().to_string();
        assert!(early.contains("0.5 s before the first"), "{early}");
        assert!(tree().lookup("world", "camera", stamp(9.0)).is_ok());
    }

    #[test]
    fn an_unknown_frame_is_named_with_its_neighbours() {
        let error = tree().lookup("world", "tol", stamp(1.0)).unwrap_err().to_string();
        assert_eq!(error, "frame 'tol' is not in the tree; did you mean 'tool'?");
    }

    #[test]
    fn disconnected_trees_are_named_by_their_roots() {
        let mut tree = tree();
        tree.insert_fixed("map", "tag", EdgeKind::Static, some_pose(0.0));
        let error = tree.lookup("tool", "tag", stamp(1.0)).unwrap_err().to_string();
        assert!(error.contains("roots 'world' and 'map'"), "{error}");
    }

    #[test]
    fn two_parents_and_cycles_end() {
        let mut tree = tree();
        tree.insert_fixed("camera", "tool", EdgeKind::Static, some_pose(0.5));
        tree.insert_fixed("tool", "world", EdgeKind::Static, some_pose(0.6));
        tree.insert_fixed("tool", "tool", EdgeKind::Static, some_pose(0.7));
        assert!(tree.lookup("base", "tool", stamp(1.5)).is_ok());
        tree.insert_fixed("a", "b", EdgeKind::Static, some_pose(0.1));
        tree.insert_fixed("b", "a", EdgeKind::Static, some_pose(0.1));
        assert!(tree.is_above("a", "b") && !tree.is_above("a", "world"));
        assert!(matches!(tree.lookup("a", "world", stamp(1.0)), Err(TfError::NotConnected { .. })));
    }

    #[test]
    fn only_fixed_transforms_connect_a_frame_to_the_nearest_accepted_one() {
        let tree = tree();
        let (name, base_from_camera) = tree.nearest_fixed("camera", |name| name == "base").unwrap();
        assert_eq!(name, "base");
        assert!(distance(&base_from_camera, &(some_pose(0.1).inverse() * some_pose(0.4))) < 1e-12);
        assert_eq!(tree.nearest_fixed("camera", |name| name == "arm"), None);
    }
}
