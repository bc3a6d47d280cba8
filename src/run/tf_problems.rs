//! TF problems: violations of tf2's tree structure.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use crate::stream::{Columns, PoseColumns, encoder_tick, is_whole};

use super::Run;
use super::pose_distance::PoseDistance;
use super::publishers::TwoPublishers;
use super::role::{FrameKind, Role};
use super::streams::{Stream, with_key};
use super::tf_tree::{EdgeKind, strip_slash};

/// A TF problem, and its topics.
#[derive(Clone, Debug, PartialEq)]
pub struct TfProblem {
    /// Kind of problem.
    pub kind: TfProblemKind,
    /// The topics, each once.
    pub topics: Vec<String>,
}

/// Kinds of TF problems.
#[derive(Clone, Debug, PartialEq)]
pub enum TfProblemKind {
    /// Several parents at the same time.
    SeveralParents {
        /// The frame.
        child: String,
        /// Its parents.
        parents: Vec<String>,
    },
    /// A cycle: each frame is the child of the next.
    Cycle {
        /// The frames.
        frames: Vec<String>,
    },
    /// A transform on a static topic changes.
    StaticMoves {
        /// The transform.
        edge: FramePair,
        /// Largest change.
        by: PoseDistance,
    },
    /// Publishers send different values of a transform.
    Conflict {
        /// The transform.
        edge: FramePair,
        /// Distance between the values.
        by: PoseDistance,
        /// Samples from another publisher than their neighbours.
        jumps: usize,
        /// Number of samples.
        rows: usize,
    },
    /// Two publishers send a topic or some of its transforms.
    Publishers {
        /// Transform with the largest disagreement, or the first. `None` for poses and joint states.
        edge: Option<FramePair>,
        /// Transforms that they disagree on.
        edges: usize,
        /// Distance of their values; `None` if they agree.
        by: Option<PoseDistance>,
        /// Rate of each publisher, Hz.
        rates_hz: [f64; 2],
        /// Rows of each publisher.
        rows: [usize; 2],
        /// Whether they disagree on joints, not poses.
        are_joints: bool,
    },
    /// A stream's frame and the arm's base are disconnected.
    Disconnected {
        /// The topic of the stream.
        needed_by: String,
        /// The frame.
        frame: String,
        /// The arm's base.
        base: String,
    },
}

/// A parent and a child frame.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FramePair {
    /// Frame that the transform is expressed in.
    pub parent: String,
    /// Frame whose pose it is.
    pub child: String,
}

/// Maximum rounding, m on a 1 m lever.
const MAX_ROUNDING_M: f64 = 1e-4;

struct TransformPart<'a> {
    topic: &'a str,
    is_static: bool,
    /// Whether its publishers are separated and reported alone.
    has_two_publishers: bool,
    poses: &'a PoseColumns,
}

impl TransformPart<'_> {
    fn frame_pair(&self) -> FramePair {
        FramePair { parent: self.parent().to_owned(), child: self.child().to_owned() }
    }

    fn parent(&self) -> &str {
        strip_slash(&self.poses.frame_id)
    }

    fn child(&self) -> &str {
        strip_slash(&self.poses.child_frame_id)
    }
}

/// Problems per namespace: robots with their own TF topics may share frame names.
pub(super) fn detect_tf_problems(
    streams: &[Stream],
    publishers: &[TwoPublishers],
) -> Vec<TfProblem> {
    let mut spaces: BTreeMap<&str, Vec<TransformPart<'_>>> = BTreeMap::new();
    for (index, stream) in streams.iter().enumerate() {
        let Some(Columns::Transforms(transforms)) = &stream.columns else { continue };
        let space = stream.topic.rsplit_once('/').map_or("", |(space, _)| space);
        let is_static = stream.role == Role::TfStatic;
        let of_two = |piece: usize| TwoPublishers::of_part(publishers, index, piece).is_some();
        let filled = transforms.iter().enumerate().filter(|(_, poses)| !poses.times.is_empty());
        let pieces = filled.map(|(piece, poses)| TransformPart {
            topic: &stream.topic,
            is_static,
            has_two_publishers: of_two(piece),
            poses,
        });
        spaces.entry(space).or_default().extend(pieces);
    }
    let mut problems: Vec<TfProblem> =
        spaces.values().flat_map(|pieces| problems_of(pieces)).collect();
    problems.extend(streams.iter().enumerate().filter_map(|(index, stream)| {
        several_publishers(stream, with_key(publishers, index, |two| two.stream))
    }));
    problems
}

fn several_publishers(stream: &Stream, found: &[TwoPublishers]) -> Option<TfProblem> {
    let size = |two: &TwoPublishers| two.distance.map_or(0.0, PoseDistance::size_m);
    let worst = found.iter().rev().max_by(|a, b| size(a).total_cmp(&size(b)))?;
    let between = |(parent, child): &(String, String)| FramePair {
        parent: strip_slash(parent).to_owned(),
        child: strip_slash(child).to_owned(),
    };
    let kind = TfProblemKind::Publishers {
        edge: worst.frames.as_ref().map(between),
        edges: found.iter().filter(|two| two.distance.is_some()).count(),
        by: worst.distance,
        rates_hz: worst.rates_hz,
        rows: worst.rows,
        are_joints: matches!(stream.columns, Some(Columns::Joints(_))),
    };
    Some(TfProblem { kind, topics: vec![stream.topic.clone()] })
}

fn problems_of(pieces: &[TransformPart<'_>]) -> Vec<TfProblem> {
    let mut problems = several_parents(pieces);
    problems.extend(cycles(pieces));
    problems.extend(pieces.iter().filter(|piece| piece.is_static).filter_map(static_that_moves));
    problems.extend(conflicts(pieces));
    problems
}

fn topic_names<'a, 'b: 'a>(pieces: impl Iterator<Item = &'a TransformPart<'b>>) -> Vec<String> {
    pieces
        .map(|piece| piece.topic)
        .collect::<BTreeSet<_>>()
        .into_iter()
        .map(str::to_owned)
        .collect()
}

fn several_parents(pieces: &[TransformPart<'_>]) -> Vec<TfProblem> {
    let mut by_child: BTreeMap<&str, Vec<&TransformPart<'_>>> = BTreeMap::new();
    for piece in pieces {
        by_child.entry(piece.child()).or_default().push(piece);
    }
    let problem = |(child, pieces): (&str, Vec<&TransformPart<'_>>)| {
        let conflicting: Vec<&TransformPart<'_>> = pieces
            .iter()
            .filter(|a| pieces.iter().any(|b| a.parent() != b.parent() && overlap_in_time(a, b)))
            .copied()
            .collect();
        let parents: BTreeSet<&str> = conflicting.iter().map(|piece| piece.parent()).collect();
        (!conflicting.is_empty()).then(|| TfProblem {
            kind: TfProblemKind::SeveralParents {
                child: child.to_owned(),
                parents: parents.into_iter().map(str::to_owned).collect(),
            },
            topics: topic_names(conflicting.into_iter()),
        })
    };
    by_child.into_iter().filter_map(problem).collect()
}

/// Whether transforms coincide in time, unlike an object that is picked and placed.
fn overlap_in_time(a: &TransformPart<'_>, b: &TransformPart<'_>) -> bool {
    /// Alternations that pick and place may cause.
    const MIN_ALTERNATIONS: usize = 4;
    if a.is_static || b.is_static {
        return true;
    }
    let (a, b) = (&a.poses.times.log, &b.poses.times.log);
    let (mut next, mut turns) = (0, 0);
    for at in a {
        let from = next;
        while b.get(next).is_some_and(|other| other <= at) {
            next += 1;
        }
        turns += usize::from(next > from);
    }
    turns >= MIN_ALTERNATIONS && 4 * turns >= a.len().min(b.len())
}

/// Each cycle once, from its first named frame.
fn cycles(pieces: &[TransformPart<'_>]) -> Vec<TfProblem> {
    let mut parent_of: BTreeMap<&str, &TransformPart<'_>> = BTreeMap::new();
    for piece in pieces {
        parent_of.entry(piece.child()).or_insert(piece);
    }
    let mut done: BTreeSet<&str> = BTreeSet::new();
    let mut found = Vec::new();
    for start in pieces.iter().map(TransformPart::child) {
        let mut trail: Vec<&str> = Vec::new();
        let mut frame = start;
        while done.insert(frame) {
            trail.push(frame);
            let Some(piece) = parent_of.get(frame) else { break };
            frame = piece.parent();
        }
        if let Some(first) = trail.iter().position(|seen| *seen == frame)
            && let Some(cycle) = trail.get(first..).filter(|_| parent_of.contains_key(frame))
        {
            let of_ring = cycle.iter().filter_map(|frame| parent_of.get(frame).copied());
            let frames = cycle.iter().map(|&frame| frame.to_owned()).collect();
            found.push(TfProblem {
                kind: TfProblemKind::Cycle { frames },
                topics: topic_names(of_ring),
            });
        }
    }
    found
}

fn static_that_moves(piece: &TransformPart<'_>) -> Option<TfProblem> {
    let by = largest_distance(piece, piece)?;
    Some(TfProblem {
        kind: TfProblemKind::StaticMoves { edge: piece.frame_pair(), by },
        topics: vec![piece.topic.to_owned()],
    })
}

/// Largest distance of a pose from the first of `fixed`; `None` within rounding.
fn largest_distance(fixed: &TransformPart<'_>, piece: &TransformPart<'_>) -> Option<PoseDistance> {
    let rows = 0..piece.poses.times.len();
    rows.map(|row| PoseDistance::between((fixed.poses, 0), (piece.poses, row)))
        .max_by(|a, b| a.size_m().total_cmp(&b.size_m()))
        .filter(|by| by.size_m() > MAX_ROUNDING_M)
}

fn conflicts(pieces: &[TransformPart<'_>]) -> Vec<TfProblem> {
    let mut fixed: HashMap<(&str, &str), Vec<&TransformPart<'_>>> = HashMap::new();
    for piece in pieces.iter().filter(|piece| piece.is_static) {
        fixed.entry((piece.parent(), piece.child())).or_default().push(piece);
    }
    let mut found = Vec::new();
    for piece in pieces.iter().filter(|piece| !piece.is_static) {
        let alternation = (!piece.has_two_publishers).then(|| detect_alternation(piece)).flatten();
        found.extend(
            alternation.filter(|(_, jump_m)| !is_resolution(pieces, *jump_m)).map(|it| it.0),
        );
        let same = fixed.get(&(piece.parent(), piece.child())).into_iter().flatten();
        found.extend(same.filter_map(|other| conflict_with_static(other, piece)));
    }
    found
}

fn conflict_with_static(fixed: &TransformPart<'_>, piece: &TransformPart<'_>) -> Option<TfProblem> {
    let rows = piece.poses.times.len();
    let by = largest_distance(fixed, piece)?;
    Some(TfProblem {
        kind: TfProblemKind::Conflict { edge: piece.frame_pair(), by, jumps: rows, rows },
        topics: topic_names([fixed, piece].into_iter()),
    })
}

/// Detects alternating publishers: samples far from neighbours that agree. With the size of the jumps, m.
fn detect_alternation(piece: &TransformPart<'_>) -> Option<(TfProblem, f64)> {
    /// Minimum jump, m on a 1 m lever.
    const MIN_JUMP_M: f64 = 1e-3;
    /// Maximum distance of the neighbours, as a share of the jump.
    const MAX_NEIGHBOUR_SHARE: f64 = 0.02;
    /// Minimum share and number of jumps.
    const MIN_JUMP_SHARE: f64 = 0.1;
    const MIN_JUMPS: usize = 5;
    /// Maximum distance to the samples two rows away, in jumps. A motion that reverses is then four times
    /// as far away; of two publishers, one sent that sample.
    const MAX_SECOND_NEIGHBOUR_RATIO: f64 = 1.5;
    /// Maximum number of samples, and consecutive ones.
    const MAX_CHECKED_ROWS: usize = 20_000;
    const CONSECUTIVE_ROWS: usize = 500;
    let poses = piece.poses;
    let distance = |a: usize, b: usize| PoseDistance::between((poses, a), (poses, b));
    let (mut rows, mut jumps, mut largest) = (0, 0, PoseDistance::default());
    let inner = 2..poses.times.len().saturating_sub(2);
    // Consecutive, because publishers may alternate regularly.
    let parts = inner.len().div_ceil(MAX_CHECKED_ROWS).max(1);
    let is_looked_at = |row: &usize| (row / CONSECUTIVE_ROWS).is_multiple_of(parts);
    for row in inner.filter(is_looked_at) {
        rows += 1;
        let (before, after) = (distance(row - 1, row), distance(row, row + 1));
        let (least, most) =
            (before.size_m().min(after.size_m()), before.size_m().max(after.size_m()));
        if least > MIN_JUMP_M
            && distance(row - 1, row + 1).size_m() < MAX_NEIGHBOUR_SHARE * least
            && [row - 2, row + 2]
                .iter()
                .all(|&other| distance(row, other).size_m() < MAX_SECOND_NEIGHBOUR_RATIO * most)
        {
            jumps += 1;
            largest = if before.size_m() > largest.size_m() { before } else { largest };
        }
    }
    let alternates = jumps >= MIN_JUMPS && jumps as f64 > MIN_JUMP_SHARE * rows as f64;
    let kind = TfProblemKind::Conflict { edge: piece.frame_pair(), by: largest, jumps, rows };
    let problem = TfProblem { kind, topics: vec![piece.topic.to_owned()] };
    alternates.then(|| (problem, largest.size_m()))
}

/// Whether `jump_m` is a few ticks of an encoder: one of the joints moves by more, and only by whole ticks. Joints that
/// hardly move may flicker.
fn is_resolution(pieces: &[TransformPart<'_>], jump_m: f64) -> bool {
    /// Noise of an encoder at rest.
    const MAX_JUMP_TICKS: f64 = 3.5;
    pieces.iter().filter(|piece| !piece.is_static).any(|piece| {
        let poses = piece.poses;
        let size_m = |a: usize, b: usize| PoseDistance::between((poses, a), (poses, b)).size_m();
        let tick_m = encoder_tick(poses.times.len(), size_m, MAX_ROUNDING_M);
        tick_m.is_some_and(|tick_m| jump_m < MAX_JUMP_TICKS * tick_m && is_whole(jump_m / tick_m))
    })
}

impl Run {
    /// Disconnected frames that an audited stream needs: both frame and base are in the log's transforms,
    /// and the frame is not tied to the robot.
    pub fn disconnected_frames(&self) -> Vec<TfProblem> {
        let poses = self.streams.iter();
        let poses = poses.filter(|stream| matches!(stream.columns, Some(Columns::Poses(_))));
        let poses: HashSet<(&str, &str)> =
            poses.map(|stream| (&*stream.frame_id, &*stream.child_frame_id)).collect();
        // Frames of the transforms that are neither the model's nor streams of poses.
        let logged = self.tf.edges().iter().filter(|edge| edge.kind != EdgeKind::Model);
        let logged = logged.map(|edge| self.tf.names(edge)).filter(|names| !poses.contains(names));
        let logged: HashSet<&str> = logged.flat_map(<[&str; 2]>::from).collect();
        let of_streams = self.streams.iter().filter_map(|stream| {
            let is_audited = matches!(stream.role, Role::Pose | Role::Imu);
            let arm = self.arms.get(stream.arm.filter(|_| is_audited)?)?;
            let (place, _) = arm.classify_frame(&stream.frame_id);
            let base = arm.frame_of(arm.base);
            let is_loose = place == FrameKind::Unknown;
            let are_logged =
                [stream.frame_id.as_str(), &base].iter().all(|&frame| logged.contains(frame));
            (is_loose && are_logged)
                .then(|| self.disconnection(&stream.topic, &stream.frame_id, &base))
                .flatten()
        });
        of_streams.collect()
    }

    fn disconnection(&self, needed_by: &str, frame: &str, base: &str) -> Option<TfProblem> {
        let are_disconnected = self.tf.find_path(base, frame, |_| true).is_none();
        let is_tf = |stream: &&Stream| matches!(stream.role, Role::Tf | Role::TfStatic);
        are_disconnected.then(|| TfProblem {
            kind: TfProblemKind::Disconnected {
                needed_by: needed_by.to_owned(),
                frame: frame.to_owned(),
                base: base.to_owned(),
            },
            topics: self.streams.iter().filter(is_tf).map(|stream| stream.topic.clone()).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Transform at 10 Hz for 4 s; `x_m` is the x coordinate of each row.
    fn poses(parent: &str, child: &str, from_s: i64, x_m: impl Fn(usize) -> f64) -> PoseColumns {
        let mut poses = PoseColumns {
            frame_id: parent.to_owned(),
            child_frame_id: child.to_owned(),
            ..PoseColumns::default()
        };
        for row in 0..40 {
            let at = from_s * 1_000_000_000 + row as i64 * 100_000_000;
            poses.times.push(at, at, at);
            poses.xyz.push([x_m(row), 0.0, 0.0]);
            poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
        }
        poses
    }

    fn dynamic(poses: &PoseColumns) -> TransformPart<'_> {
        TransformPart { topic: "/tf", is_static: false, has_two_publishers: false, poses }
    }

    fn fixed(poses: &PoseColumns) -> TransformPart<'_> {
        TransformPart { topic: "/tf_static", is_static: true, has_two_publishers: false, poses }
    }

    #[test]
    fn a_frame_with_two_simultaneous_parents_is_reported() {
        let (a, b) = (poses("a", "c", 0, |_| 0.0), poses("b", "c", 0, |_| 0.0));
        let found = problems_of(&[dynamic(&a), dynamic(&b)]);
        let [TfProblem { kind: TfProblemKind::SeveralParents { child, parents }, .. }] =
            found.as_slice()
        else {
            panic!("{found:?}")
        };
        assert_eq!((child.as_str(), parents.as_slice()), ("c", &["a".into(), "b".into()][..]));
        // An object that is moved has one parent at a time.
        let later = poses("b", "c", 5, |_| 0.0);
        assert_eq!(problems_of(&[dynamic(&a), dynamic(&later)]), []);
    }

    #[test]
    fn a_cycle_is_reported_once_without_frames_below_it() {
        let edges = [["b", "a"], ["c", "b"], ["a", "c"], ["a", "d"]];
        let all = edges.map(|[parent, child]| poses(parent, child, 0, |_| 0.0));
        let found = problems_of(&all.each_ref().map(dynamic));
        let [TfProblem { kind: TfProblemKind::Cycle { frames }, .. }] = found.as_slice() else {
            panic!("{found:?}")
        };
        assert_eq!(frames, &["a", "b", "c"]);
        let itself = poses("a", "a", 0, |_| 0.0);
        assert_eq!(problems_of(&[dynamic(&itself)]).len(), 1);
        assert_eq!(problems_of(&[dynamic(&all[0]), dynamic(&all[1])]), []);
    }

    #[test]
    fn a_static_transform_with_two_values_moves() {
        let still = poses("a", "b", 0, |_| 0.3);
        assert_eq!(problems_of(&[fixed(&still)]), []);
        let moved = poses("a", "b", 0, |row| if row < 20 { 0.3 } else { 0.31 });
        let found = problems_of(&[fixed(&moved)]);
        let [TfProblem { kind: TfProblemKind::StaticMoves { by, .. }, .. }] = found.as_slice()
        else {
            panic!("{found:?}")
        };
        assert!((by.length_m - 0.01).abs() < 1e-12 && by.angle_rad < 1e-12, "{by:?}");
    }

    #[test]
    fn two_publishers_alternate_and_a_moving_one_does_not() {
        let moves = poses("a", "b", 0, |row| 0.1 * (row as f64 * 0.3).sin());
        assert_eq!(problems_of(&[dynamic(&moves)]), []);
        for every in [2, 5] {
            let two = poses("a", "b", 0, |row| if row % every == 1 { 0.05 } else { 0.0 });
            let found = problems_of(&[dynamic(&two)]);
            let [TfProblem { kind: TfProblemKind::Conflict { by, .. }, .. }] = found.as_slice()
            else {
                panic!("{found:?}")
            };
            assert!((by.length_m - 0.05).abs() < 1e-12);
        }
    }

    #[test]
    fn an_encoder_that_flickers_by_whole_ticks_is_no_second_publisher() {
        const TICK_M: f64 = 2e-3;
        let ticks = |row: usize| TICK_M * (row / 6 + row % 2) as f64;
        let flickers = poses("a", "b", 0, ticks);
        assert_eq!(problems_of(&[dynamic(&flickers)]), []);
        let two = poses("a", "b", 0, |row| ticks(row) + 10.5 * TICK_M * (row % 2) as f64);
        assert_eq!(problems_of(&[dynamic(&two)]).len(), 1);
        // Noise of two ticks, and two publishers that differ by one and a half.
        let noisy = |offset: f64| {
            move |row: usize| {
                TICK_M * ((row / 4) as f64 + offset * (row % 2 * (1 + row / 3 % 2)) as f64)
            }
        };
        let (whole, parted) = (poses("a", "b", 0, noisy(1.0)), poses("a", "b", 0, noisy(1.5)));
        assert_eq!(problems_of(&[dynamic(&whole)]), []);
        assert_eq!(problems_of(&[dynamic(&parted)]).len(), 1);
    }

    #[test]
    fn a_transform_on_both_topics_must_be_the_same_on_both() {
        let (here, there) = (poses("a", "b", 0, |_| 0.3), poses("a", "b", 0, |_| 0.4));
        assert_eq!(problems_of(&[fixed(&here), dynamic(&here)]), []);
        for pieces in [[fixed(&here), dynamic(&there)], [dynamic(&there), fixed(&here)]] {
            assert_eq!(problems_of(&pieces).len(), 1);
        }
    }

    #[test]
    fn a_quaternion_and_its_negative_are_equal() {
        let mut poses = poses("a", "b", 0, |_| 0.0);
        poses.q_xyzw[1] = [0.0, 0.0, 0.0, -1.0];
        poses.q_xyzw[2] = [0.0, 0.0, (0.5e-3_f64).sin(), (0.5e-3_f64).cos()];
        poses.q_xyzw[3] = [0.0; 4];
        let angle = |row| PoseDistance::between((&poses, 0), (&poses, row)).angle_rad;
        assert!(angle(1) < 1e-12 && (angle(2) - 1e-3).abs() < 1e-9 && angle(3) == 0.0);
    }
}
