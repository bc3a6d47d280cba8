//! Frame tree as nested lists.

use std::collections::{BTreeMap, BTreeSet};

use maud::{Markup, html};

use crate::report::figures::{Figures, FrameEdge, FrameEdgeKind};
use crate::report::{RobotRow, StreamRow};

/// Maximum depth; real arms are shallower.
const MAX_DEPTH: usize = 60;

pub fn section(figures: &Figures, robots: &[RobotRow]) -> Markup {
    let tree = FrameTree::from_edges(&figures.frames, robots);
    html! {
        @if !figures.frames.is_empty() {
            section #frames aria-labelledby="frames-title" {
                h2 #frames-title { "Frames" }
                p .says {
                    "Each frame under its parent; " b { "bold" } " are the base and the tip of the \
                     audited chain."
                }
                div .scroll .tree tabindex="0" role="region" aria-labelledby="frames-title" {
                    @let mut drawn = BTreeSet::new();
                    ul {
                        @for root in tree.roots() { (tree.branch(root, None, 0, &mut drawn)) }
                        @for frame in tree.frames() {
                            @if !drawn.contains(frame) { (tree.branch(frame, None, 0, &mut drawn)) }
                        }
                    }
                }
            }
        }
    }
}

/// Frames of a row in the table of streams.
pub fn stream_frames(stream: &StreamRow) -> Markup {
    let parent = stream.frame_id.as_deref().or(stream.reference.as_deref());
    let child = stream.child_frame_id.as_deref().or(stream.link.as_deref());
    html! {
        @match (parent, child) {
            (Some(parent), Some(child)) if parent != child => { (parent) " → " (child) }
            (Some(frame), _) | (None, Some(frame)) => { (frame) }
            (None, None) => {}
        }
    }
}

struct FrameTree<'a> {
    children: BTreeMap<&'a str, Vec<&'a FrameEdge>>,
    parents: BTreeMap<&'a str, Vec<&'a str>>,
    /// In order of occurrence.
    frames: Vec<&'a str>,
    robot_links: BTreeSet<&'a str>,
}

impl<'a> FrameTree<'a> {
    fn from_edges(edges: &'a [FrameEdge], robots: &'a [RobotRow]) -> Self {
        let mut tree = Self {
            children: BTreeMap::new(),
            parents: BTreeMap::new(),
            frames: Vec::new(),
            robot_links: robots.iter().flat_map(|robot| [&*robot.base, &*robot.tip]).collect(),
        };
        let mut known = BTreeSet::new();
        for edge in edges {
            let (parent, child) = (edge.parent.as_str(), edge.child.as_str());
            tree.frames.extend([parent, child].into_iter().filter(|frame| known.insert(*frame)));
            let siblings = tree.children.entry(parent).or_default();
            // The log and the model may have the same transform.
            if !siblings.iter().any(|other| other.child == child) {
                siblings.push(edge);
                tree.parents.entry(child).or_default().push(parent);
            }
        }
        tree
    }

    fn frames(&self) -> impl Iterator<Item = &'a str> {
        self.frames.iter().copied()
    }

    fn roots(&self) -> impl Iterator<Item = &'a str> {
        self.frames().filter(|frame| !self.parents.contains_key(frame))
    }

    /// A frame that was already drawn is not expanded, which ends cycles.
    fn branch(
        &self,
        frame: &'a str,
        edge: Option<&FrameEdge>,
        depth: usize,
        drawn: &mut BTreeSet<&'a str>,
    ) -> Markup {
        let is_again = !drawn.insert(frame);
        let children = self.children.get(frame).filter(|_| !is_again && depth < MAX_DEPTH);
        let parents = self.parents.get(frame).map_or(0, Vec::len);
        html! {
            li {
                span .frame .named[self.robot_links.contains(frame)] { (frame) }
                @if let Some(edge) = edge { " " span .quiet { (kind_name(edge.kind)) } }
                @if parents > 1 { " " strong { (parents) " parents" } }
                @if is_again { " " span .quiet { "as above" } }
                @if let Some(children) = children {
                    ul {
                        @for edge in children {
                            (self.branch(&edge.child, Some(*edge), depth + 1, drawn))
                        }
                    }
                }
            }
        }
    }
}

const fn kind_name(kind: FrameEdgeKind) -> &'static str {
    match kind {
        FrameEdgeKind::Moving => "moving",
        FrameEdgeKind::Static => "static",
        FrameEdgeKind::Model => "only in the model",
    }
}
