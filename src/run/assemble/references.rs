//! Commanded poses and joint positions of an arm.

use std::collections::HashSet;

use crate::geometry::Pose;
use crate::run::role::{Role, find_word, may_have_role, split_words};
use crate::stream::{ArrayColumns, Columns, JointColumns, PoseTrack};

use super::super::arm::{Arm, FrameAnchor};
use super::super::poses;
use super::super::role::FrameKind;
use super::super::rows::Rows;
use super::assembly::Assembly;

/// A stream of commands to one arm.
#[derive(Clone, Debug)]
pub struct ReferenceSource {
    /// Index of the stream.
    pub stream: usize,
    /// Index of the arm.
    pub arm: usize,
    /// The commands, or why they cannot be compared.
    pub content: Result<ReferenceContent, String>,
}

/// Commands of a stream. Times are seconds from the run's origin.
#[derive(Clone, Debug)]
pub enum ReferenceContent {
    /// Poses of the arm's tip in its base, `base_from_tip`.
    Poses {
        /// The poses, possibly a single one.
        track: PoseTrack,
        /// Whether the commanded link is named.
        tip_named: bool,
        /// Whether the poses' frame is named; else the controller's base is assumed.
        frame_named: bool,
    },
    /// Joint positions.
    Joints {
        /// Times, strictly increasing.
        t_s: Vec<f64>,
        /// Column in the arm's joint track of each number in a row. `None` if unnamed, with one number per
        /// joint.
        columns: Option<Vec<usize>>,
        /// Positions, row-major, rad or m; NaN if missing.
        q: Vec<f64>,
    },
}

/// Topic words of arrays without joint positions.
const NON_POSITION_WORDS: &[&str] = &[
    "velocity", "velocities", "speed", "torque", "torques", "effort", "efforts", "wrench", "force",
    "forces", "twist", "pose", "tcp", "acceleration", "current",
];

/// Maximum number of rows before thinning, in which case a long run uses only its excerpts.
const MAX_ROWS: usize = 20_000;

impl Assembly<'_> {
    /// The commands to the arms. Skips streams that command none of their joints.
    pub(super) fn references(&self) -> Vec<ReferenceSource> {
        let mut known_plans: HashSet<&str> = HashSet::new();
        let mut found = Vec::new();
        for (index, stream) in self.streams.iter().enumerate() {
            if !may_have_role(stream, Role::Reference) {
                continue;
            }
            let source = match &stream.columns {
                Some(Columns::Poses(_)) if stream.lists_poses() => {
                    if !known_plans.insert(&stream.topic) {
                        continue;
                    }
                    let why = "each message contains several poses: a plan, not a goal".to_owned();
                    self.likeliest_arm(stream).map(|arm| (arm, Err(why)))
                }
                Some(Columns::Poses(_)) => {
                    self.likeliest_arm(stream).map(|arm| (arm, self.commanded_poses(index, arm)))
                }
                Some(Columns::Joints(joints)) => self.commanded_joints(index, joints),
                Some(Columns::Array(array)) => self
                    .likeliest_arm(stream)
                    .map(|arm| (arm, self.commanded_numbers(index, arm, array))),
                _ => None,
            };
            found.extend(source.map(|(arm, content)| ReferenceSource {
                stream: index,
                arm,
                content,
            }));
        }
        found
    }

    fn selected_rows(&self, index: usize) -> Rows {
        let mut rows = self.timing.clocks.rows(&self.streams, index, 0);
        if rows.len() > MAX_ROWS {
            let around_s = self.options.max_latency_s;
            rows = self.timing.filtered_rows(&self.streams, index, 0, around_s);
            poses::thin(&mut rows);
        }
        rows
    }

    fn commanded_poses(&self, index: usize, owner: usize) -> Result<ReferenceContent, String> {
        let (arm, stream) = (&self.arms[owner], &self.streams[index]);
        let rows = self.selected_rows(index);
        let mut track =
            poses::from_columns(stream.columns.as_ref(), &rows, None, self.origin)?.track;
        if track.t_s.is_empty() {
            return Err("it has no usable sample".to_owned());
        }
        let frame = &stream.frame_id;
        let (place, anchor) = arm.classify_frame(frame);
        // A joint before the base, such as a waist, also moves the base's frames.
        let is_of_base =
            |anchor: FrameAnchor| arm.robot.fixed_transform(arm.base, anchor.link).is_some();
        let (link, link_from_frame) = match (place, anchor) {
            (FrameKind::MovingLink, anchor) if !anchor.is_some_and(is_of_base) => {
                return Err(format!("its frame '{frame}' is moved by the arm itself"));
            }
            (FrameKind::Unnamed, _) => (arm.unnamed_base, Pose::identity()),
            (_, Some(anchor)) => (anchor.link, anchor.link_from_frame),
            (_, None) => {
                return Err(format!("its frame '{frame}' is not fixed to the robot"));
            }
        };
        let base_from_link = arm.robot.fixed_transform(arm.base, link).ok_or_else(|| {
            format!("joints of the arm lie between '{frame}' and '{}'", arm.frame_of(arm.base))
        })?;
        let child = &stream.child_frame_id;
        let (tip_from_child, child_named) = match arm.classify_frame(child) {
            (FrameKind::MovingLink, Some(anchor)) => {
                let tip_from_link = arm.robot.fixed_transform(arm.tip, anchor.link);
                let tip_from_link = tip_from_link.ok_or_else(|| {
                    format!(
                        "'{child}' moves relative to '{}', the arm's tip",
                        arm.frame_of(arm.tip)
                    )
                })?;
                (tip_from_link * anchor.link_from_frame, true)
            }
            (FrameKind::StillLink | FrameKind::StaticallyTied, _) => {
                return Err(format!("the arm does not move its child frame '{child}'"));
            }
            _ => (Pose::identity(), false),
        };
        let before = base_from_link * link_from_frame;
        track.transform(&before, &tip_from_child.inverse());
        Ok(ReferenceContent::Poses {
            track,
            tip_named: arm.tip_named || child_named,
            frame_named: place != FrameKind::Unnamed,
        })
    }

    fn commanded_joints(
        &self,
        index: usize,
        joints: &JointColumns,
    ) -> Option<(usize, Result<ReferenceContent, String>)> {
        let places = |arm: &Arm| -> Vec<(usize, usize)> {
            let column = |name: &String| arm.joint_names.iter().position(|known| known == name);
            let named = joints.joints.iter().enumerate();
            named.filter_map(|(at, joint)| Some((at, column(&joint.name)?))).collect()
        };
        let topic = self.streams[index].topic.as_str();
        let of_arms =
            self.arms.iter().map(|arm| (places(arm), arm.match_names([topic]))).enumerate();
        let (arm, (places, _)) =
            of_arms.rev().max_by_key(|(_, (places, claim))| (places.len(), *claim))?;
        if places.is_empty() {
            return None;
        }
        let rows = self.command_rows(index);
        let t_s = rows.iter().map(|(t_s, _)| *t_s).collect();
        let number = |row: usize, at: usize| joints.joints[at].position[row];
        let q =
            rows.iter().flat_map(|&(_, row)| places.iter().map(move |&(at, _)| number(row, at)));
        let columns = Some(places.iter().map(|&(_, column)| column).collect());
        Some((arm, Ok(ReferenceContent::Joints { t_s, columns, q: q.collect() })))
    }

    /// Unnamed commands: a pose as matrix or quaternion, or one number per joint.
    fn commanded_numbers(
        &self,
        index: usize,
        owner: usize,
        array: &ArrayColumns,
    ) -> Result<ReferenceContent, String> {
        let (arm, stream) = (&self.arms[owner], &self.streams[index]);
        let words = split_words(&stream.topic);
        let word = find_word(&words, NON_POSITION_WORDS);
        let is_of_joints = array.width == arm.chain.dof() && word.is_none();
        match array.width {
            _ if is_of_joints => {
                let rows = self.command_rows(index);
                let t_s = rows.iter().map(|(t_s, _)| *t_s).collect();
                let q = rows.iter().flat_map(|&(_, row)| array.row(row).to_vec()).collect();
                Ok(ReferenceContent::Joints { t_s, columns: None, q })
            }
            7 | 12 | 16 if word.is_none_or(|word| matches!(word, "pose" | "tcp")) => {
                self.commanded_poses(index, owner)
            }
            width => Err(match word {
                Some(word) => {
                    format!(
                        "{width} numbers per row; not joint positions, because of the word '{word}' in \
                        its name"
                    )
                }
                None => {
                    format!("{width} numbers per row, but the arm has {} joints", arm.chain.dof())
                }
            }),
        }
    }

    /// Time and row of the commands, strictly increasing; the last of equal stamps.
    fn command_rows(&self, index: usize) -> Vec<(f64, usize)> {
        let mut rows = self.selected_rows(index);
        rows.sort();
        let last = rows.chunk_by(|a, b| a.0 == b.0).filter_map(|same| same.last());
        last.map(|&(stamp, row)| (stamp.seconds_since(self.origin), row)).collect()
    }
}
