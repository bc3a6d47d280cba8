//! Determines a topic's role from name, type and frames.

use crate::geometry::{Convention, RotationEncoding, vendors};
use crate::log::{COMMAND_WORDS, RotationLabels};
use crate::stats::median;
use crate::stream::{ArrayColumns, Columns};

use super::poses::not_a_pose;
use super::streams::Stream;

/// Role of a stream in the audit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Joint states.
    Joints,
    /// A measured tool pose.
    Pose,
    /// A tool pose if it follows the arm; see `Run::resolve_candidate`.
    Candidate {
        /// Whether its frame suggests a tool pose, which holds if the motion does not decide.
        presumed: bool,
    },
    /// A command, goal or plan.
    Reference,
    /// A camera detection of a tag, board or object.
    Target,
    /// Dynamic transforms.
    Tf,
    /// Static transforms.
    TfStatic,
    /// An inertial measurement unit.
    Imu,
    /// A robot description.
    Description,
    /// A pose without an arm.
    Unassigned,
    /// Not used by the audit.
    Ignored,
}

impl Role {
    /// Name in reports; open candidates are unassigned.
    pub const fn name(self) -> &'static str {
        match self {
            Role::Joints => "joints",
            Role::Pose => "pose",
            Role::Reference => "reference",
            Role::Target => "target",
            Role::Tf => "tf",
            Role::TfStatic => "tf_static",
            Role::Imu => "imu",
            Role::Description => "description",
            Role::Candidate { .. } | Role::Unassigned => "unassigned",
            Role::Ignored => "ignored",
        }
    }
}

pub(super) type RoleDecision = (Role, String);

/// Names of joints outside an arm.
pub(super) const NON_ARM_JOINT_WORDS: &[&str] = &[
    "finger", "fingers", "thumb", "gripper", "hand", "jaw", "knuckle", "wheel", "wheels", "caster",
    "steering", "head", "neck", "camera", "leg", "hip", "knee", "ankle", "toe",
];

/// Last words of the names of desired (`_d`) and commanded (`_c`) values. Source: libfranka, `RobotState`.
const COMMAND_ENDINGS: &[(&[&str], &str)] = &[
    (&["o", "t", "ee", "d"], "O_T_EE_d"),
    (&["o", "t", "ee", "c"], "O_T_EE_c"),
    (&["q", "d"], "q_d"),
    (&["dq", "d"], "dq_d"),
    (&["ddq", "d"], "ddq_d"),
    (&["tau", "j", "d"], "tau_J_d"),
];

/// Words of camera detections.
pub(super) const DETECTION_WORDS: &[&str] = &[
    "tag", "tags", "apriltag", "aruco", "charuco", "marker", "markers", "board", "chessboard",
    "checkerboard", "fiducial", "fiducials", "detection", "detections", "object", "objects",
];

/// Of [`DETECTION_WORDS`], also used for tracked bodies on a tool.
const BODY_WORDS: &[&str] = &["tag", "tags", "marker", "markers", "object", "objects"];
/// Words of things that a gripper carries at times, in poses without frames. They follow the arm then.
const CARRIED_WORDS: &[&str] = &[
    "object", "objects", "obj", "cube", "cubes", "block", "blocks", "box", "ball", "bottle", "cup",
    "mug", "bowl", "peg", "obstacle",
];
/// Of [`COMMAND_WORDS`], also used for tracked bodies on a tool.
const TARGET_WORDS: &[&str] = &["target", "targets"];

/// Words of camera frames.
pub(super) const CAMERA_WORDS: &[&str] = &["camera", "cam", "optical", "rgb", "depth"];

/// Words of mobile base poses.
const MOBILE_BASE_WORDS: &[&str] =
    &["odom", "odometry", "amcl", "slam", "localization", "gps", "initialpose", "footprint"];

/// Words of tools.
const TOOL_WORDS: &[&str] = &["tool", "tcp", "ee", "eef", "effector", "flange", "wrist"];

/// Words of arrays that are not poses.
const NON_POSE_WORDS: &[&str] = &[
    "joint", "joints", "velocity", "velocities", "speed", "torque", "torques", "effort", "efforts",
    "wrench", "force", "forces", "twist", "temperature", "temperatures",
];

/// Consecutive topic words of measured tool poses, and their drivers.
const DRIVER_TOPICS: &[(&[&str], &str)] = &[
    (&["tcp", "pose"], "UR drivers"),
    (&["o", "t", "ee"], "Franka drivers"),
    (&["current", "pose"], "Cartesian controllers"),
    (&["cartesian", "pose"], "iiwa drivers"),
    (&["tool", "pose"], "arm drivers"),
    (&["tool", "position"], "JAKA drivers"),
    (&["tool", "vector"], "UR interfaces"),
    (&["measured", "cp"], "surgical robots"),
    (&["flange", "pose"], "arm drivers"),
    (&["ee", "pose"], "arm drivers"),
    (&["eef", "pose"], "arm drivers"),
    (&["end", "effector", "pose"], "arm drivers"),
];

/// Child frame of the transform that UR drivers publish for the tool pose.
const UR_TOOL_FRAME: &str = "tool0_controller";

/// Consecutive topic words of tool poses whose three rotation numbers have a documented convention: Universal Robots,
/// RTDE and client interfaces.
const DOCUMENTED_CONVENTIONS: &[(&[&str], Convention)] =
    &[(&["actual", "tcp", "pose"], Convention::RotVec), (&["tool", "vector"], Convention::RotVec)];

/// Relation of a stream's frame to the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FrameKind {
    /// No frame is named.
    Unnamed,
    /// A link that the arm does not move.
    StillLink,
    /// A link that the arm moves.
    MovingLink,
    /// A moving link with most joints further out, such as a waist.
    Upstream,
    /// A link that moves with the tool whose pose it expresses.
    Tool,
    /// Tied to an unmoved link by static transforms.
    StaticallyTied,
    /// Tied to one by dynamic transforms, such as odometry.
    DynamicallyTied,
    /// Not tied to the robot.
    Unknown,
}

/// Evidence for the role of a pose stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseTopic<'a> {
    pub topic: &'a str,
    pub frame_id: &'a str,
    pub child_frame_id: &'a str,
    pub frame: FrameKind,
    pub child: FrameKind,
    pub is_declared: bool,
}

pub(super) fn role_by_content(topic: &str, columns: &Columns) -> Option<RoleDecision> {
    let verdict = match columns {
        Columns::Joints(_) => match command_word(topic) {
            Some(word) => (Role::Reference, format!("joint commands, by the word '{word}'")),
            None => (Role::Joints, "joint states".to_owned()),
        },
        Columns::Transforms(_) if topic.ends_with("tf_static") => {
            (Role::TfStatic, "static transforms".to_owned())
        }
        Columns::Transforms(_) => (Role::Tf, "transforms over time".to_owned()),
        Columns::Imu(_) => (Role::Imu, "inertial measurements".to_owned()),
        Columns::Text(_) if topic.ends_with("robot_description") => {
            (Role::Description, "robot description".to_owned())
        }
        Columns::Text(_) => (Role::Ignored, "text, not a robot description".to_owned()),
        Columns::Poses(_) | Columns::Array(_) => return None,
    };
    Some(verdict)
}

pub(super) fn role_by_name(topic: &str) -> Role {
    let (frame, child) = (FrameKind::Unnamed, FrameKind::Unnamed);
    let unnamed =
        PoseTopic { topic, frame_id: "", child_frame_id: "", frame, child, is_declared: false };
    pose_role(&unnamed).0
}

/// Role by topic name, unless a tool pose.
pub(super) fn role_outside_arm(topic: &str) -> Role {
    match role_by_name(topic) {
        role @ (Role::Target | Role::Reference) => role,
        _ => Role::Unassigned,
    }
}

/// Whether a stream has a role, or has it by name while open.
pub(super) fn may_have_role(stream: &Stream, role: Role) -> bool {
    let is_open = matches!(stream.role, Role::Candidate { .. })
        && match stream.columns {
            Some(Columns::Poses(_)) => true,
            Some(Columns::Array(_)) => role == Role::Target && is_of_camera(&stream.topic),
            _ => false,
        };
    stream.role == role || (is_open && role_outside_arm(&stream.topic) == role)
}

/// Role of a pose stream with frames.
pub(super) fn pose_role(pose: &PoseTopic<'_>) -> RoleDecision {
    let PoseTopic { topic, frame_id, child_frame_id, .. } = *pose;
    let topic_words = split_words(topic);
    if let Some(seen) = target_of_camera(topic) {
        return seen;
    }
    if pose.is_declared {
        return (Role::Pose, "declared".to_owned());
    }
    let is_of_camera = find_word(&split_words(frame_id), CAMERA_WORDS).is_some();
    if let Some(found) = ambiguous_role(&topic_words, pose.frame).filter(|_| !is_of_camera) {
        return found;
    }
    if let Some(word) = find_word(&topic_words, DETECTION_WORDS) {
        return (Role::Target, format!("seen by a camera, by the word '{word}' in its name"));
    }
    let has_frames = (pose.frame, pose.child) != (FrameKind::Unnamed, FrameKind::Unnamed);
    if let Some(word) = carried_word(&topic_words).filter(|_| !has_frames) {
        return (Role::Target, format!("an object, by the word '{word}' in its name"));
    }
    if pose.child != FrameKind::MovingLink && is_of_camera {
        return (Role::Target, format!("seen by a camera: its frame is '{frame_id}'"));
    }
    if let Some(word) =
        find_word(&decisive_words(topic), COMMAND_WORDS).or_else(|| command_ending(&topic_words))
    {
        return (Role::Reference, format!("a command, by the word '{word}' in its name"));
    }
    if let Some(word) = find_word(&topic_words, COMMAND_WORDS) {
        let reason = format!("the word '{word}' in its namespace may be that of a command");
        return (Role::Candidate { presumed: false }, reason);
    }
    match pose.child {
        FrameKind::MovingLink => {
            return (
                Role::Pose,
                format!("its child frame '{child_frame_id}' is a link that the arm moves"),
            );
        }
        FrameKind::StillLink | FrameKind::StaticallyTied => {
            return (
                Role::Unassigned,
                format!("the arm does not move its child frame '{child_frame_id}'"),
            );
        }
        _ => {}
    }
    let child_words = split_words(child_frame_id);
    if let Some(word) = find_word(&topic_words, MOBILE_BASE_WORDS)
        .or_else(|| find_word(&child_words, MOBILE_BASE_WORDS))
    {
        let role = match tool_word(topic) {
            Some(_) => Role::Candidate { presumed: false },
            None => Role::Unassigned,
        };
        return (role, format!("the pose of a mobile base, by the word '{word}'"));
    }
    if let Some(driver) = find_driver(&topic_words) {
        return (Role::Pose, format!("the topic name that {driver} use for the tool pose"));
    }
    match pose.frame {
        FrameKind::MovingLink => {
            (Role::Unassigned, format!("its frame '{frame_id}' is moved by the arm itself"))
        }
        FrameKind::Tool => (
            Role::Candidate { presumed: false },
            format!("its frame '{frame_id}' is the tool's own, where the tool cannot move"),
        ),
        FrameKind::StillLink | FrameKind::Upstream => (
            Role::Candidate { presumed: true },
            format!("its frame '{frame_id}' is a link of the robot"),
        ),
        FrameKind::DynamicallyTied => (
            Role::Candidate { presumed: false },
            format!("its frame '{frame_id}' moves relative to the arm's base, by the transforms"),
        ),
        FrameKind::StaticallyTied | FrameKind::Unnamed | FrameKind::Unknown => (
            Role::Candidate { presumed: false },
            "neither its name nor its frames identify the body".to_owned(),
        ),
    }
}

/// The role of a target's pose in the frame of a camera that its name states, such as `target2cam`, `T_cam_target` or
/// `cam2marker`.
pub(super) fn target_of_camera(topic: &str) -> Option<RoleDecision> {
    let words = split_words(&topic.replace('2', "_"));
    let parts: Vec<&str> = topic.split('2').collect();
    let is_between = |pair: &[&str]| {
        pair[0].ends_with(char::is_alphabetic) && pair[1].starts_with(char::is_alphabetic)
    };
    let is_transform =
        parts.windows(2).any(is_between) || find_word(&words, &["t", "to", "from"]).is_some();
    let camera = find_word(&words, CAMERA_WORDS)?;
    let detected = || find_word(&words, DETECTION_WORDS).filter(|_| is_transform);
    let target = find_word(&words, TARGET_WORDS).or_else(detected)?;
    Some((Role::Target, format!("seen by a camera, by '{target}' and '{camera}' in its name")))
}

/// Whether columns are named after something that only a camera detects, such as `chessboard_data`. Files may have such
/// names for other reasons.
pub(super) fn is_detection_of_columns(stream: &Stream) -> bool {
    let is_of_layout = stream.topic.ends_with("/pose");
    stream.is_from_table
        && names_detection(&stream.topic)
        && (is_of_layout || stream.cells.iter().any(|cell| names_detection(cell)))
}

/// Whether a name has a word for something that only a camera detects.
fn names_detection(name: &str) -> bool {
    let words = split_words(name);
    let mut known = DETECTION_WORDS.iter().filter(|word| !BODY_WORDS.contains(word));
    known.any(|word| words.iter().any(|own| own == word))
}

/// Whether a topic is named after a target that a camera sees, as for a hand-eye calibration.
pub(crate) fn is_of_camera(topic: &str) -> bool {
    target_of_camera(topic).is_some() || names_detection(topic)
}

/// Role of ambiguous names: tracked bodies on a tool, or camera targets and goals. The motion decides.
fn ambiguous_role(topic_words: &[String], frame: FrameKind) -> Option<RoleDecision> {
    let is_only = |known: &[&'static str], open: &[&'static str]| {
        let others = || known.iter().copied().filter(|word| !open.contains(word));
        let has = |word: &str| topic_words.iter().any(|own| own == word);
        find_word(topic_words, open).filter(|_| !others().any(has))
    };
    let word =
        match (is_only(DETECTION_WORDS, BODY_WORDS), is_only(COMMAND_WORDS, TARGET_WORDS), frame) {
            (_, _, FrameKind::Unnamed) => return None,
            (Some(word), _, _) if find_word(topic_words, COMMAND_WORDS).is_none() => word,
            (_, Some(word), FrameKind::Unknown)
                if find_word(topic_words, DETECTION_WORDS).is_none() =>
            {
                word
            }
            _ => return None,
        };
    let why =
        format!("the word '{word}' in its name may be a tracker's name for a body on the tool");
    Some((Role::Candidate { presumed: false }, why))
}

/// Role of unnamed numbers, `width` per row.
pub(super) fn array_role(topic: &str, width: usize, is_declared: bool) -> RoleDecision {
    let topic_words = split_words(topic);
    let is_pose_width = matches!(width, 6 | 7 | 12 | 16);
    if let Some(seen) = target_of_camera(topic).filter(|_| is_pose_width) {
        return seen;
    }
    if is_declared && is_pose_width {
        return (Role::Pose, "declared".to_owned());
    }
    if let Some(word) = command_word(topic) {
        return (Role::Reference, format!("a command, by the word '{word}' in its name"));
    }
    if let Some(word) = find_word(&topic_words, NON_POSE_WORDS) {
        return (Role::Ignored, format!("not a pose, by the word '{word}' in its name"));
    }
    if !is_pose_width {
        return (Role::Ignored, not_a_pose(width));
    }
    if let Some(word) = carried_word(&topic_words) {
        return (Role::Unassigned, format!("an object, by the word '{word}' in its name"));
    }
    if let Some(driver) = find_driver(&topic_words) {
        let reason = format!("the name that {driver} use for the tool pose");
        return (Role::Candidate { presumed: true }, reason);
    }
    (Role::Candidate { presumed: false }, format!("{width} numbers per row may be a pose"))
}

/// Largest deviation from unit norm of quaternions with two digits.
const MAX_NORM_DEFECT: f64 = 0.03;

/// False for seven numbers without a quaternion, such as joint positions.
pub(crate) fn may_be_poses(array: &ArrayColumns) -> bool {
    array.width != 7 || norm_defect(array, 3) < MAX_NORM_DEFECT
}

/// Median deviation of four numbers of a row from unit norm.
fn norm_defect(array: &ArrayColumns, first: usize) -> f64 {
    let rows = array.values.chunks_exact(array.width).map(|row| &row[first..first + 4]);
    let norm = |row: &[f64]| row.iter().map(|part| part * part).sum::<f64>().sqrt();
    let mut defects: Vec<f64> = rows.map(|row| (norm(row) - 1.0).abs()).collect();
    median(&mut defects).unwrap_or(f64::INFINITY)
}

/// First columns of positions and of the quaternions after or before them, in rows of numbers without names: four that
/// change and have unit norm.
pub(crate) fn unnamed_poses(array: &ArrayColumns) -> Vec<[usize; 2]> {
    const POSE: usize = 7;
    let width = array.width;
    let changes = |first: usize, count: usize| {
        let mut rows = array.values.chunks_exact(width).map(|row| &row[first..first + count]);
        let start = rows.next();
        rows.any(|row| Some(row) != start)
    };
    let last = if width < POSE { 0 } else { width - 3 };
    let mut found: Vec<(f64, usize)> = (0..last)
        .map(|first| (norm_defect(array, first), first))
        .filter(|(defect, first)| *defect < MAX_NORM_DEFECT && changes(*first, 4))
        .collect();
    found.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut is_taken = vec![false; width];
    let mut poses: Vec<[usize; 2]> = Vec::new();
    for (_, rotation) in found {
        let is_free = |start: usize| {
            is_taken.get(start..start + POSE).is_some_and(|own| own.iter().all(|taken| !taken))
        };
        let before = rotation.checked_sub(3).filter(|start| is_free(*start) && changes(*start, 3));
        let (start, position) = match before {
            Some(start) => (start, start),
            None if is_free(rotation) && changes(rotation + 4, 3) => (rotation, rotation + 4),
            None => continue,
        };
        is_taken[start..start + POSE].fill(true);
        poses.push([position, rotation]);
    }
    poses.sort_unstable();
    poses
}

/// Word that marks a command. Table columns use additional words.
fn command_word(topic: &str) -> Option<&'static str> {
    const COMMAND_COLUMN_WORDS: &[&str] = &["action", "actions", "rsol", "asol", "aspos"];
    let is_column = !topic.starts_with('/');
    let words = decisive_words(topic);
    let is_detection = target_of_camera(topic).is_some();
    find_word(&words, COMMAND_WORDS)
        .filter(|_| !is_detection)
        .or_else(|| find_word(&words, COMMAND_COLUMN_WORDS).filter(|_| is_column))
        .or_else(|| command_ending(&words))
}

fn command_ending(words: &[String]) -> Option<&'static str> {
    let ends_with = |ending: &[&str]| {
        let start = words.len().checked_sub(ending.len());
        start.is_some_and(|start| words[start..] == *ending)
    };
    COMMAND_ENDINGS.iter().find(|(ending, _)| ends_with(ending)).map(|(_, name)| *name)
}

/// Words of a topic that determine its role. If the last segment names a tool or joint states, a namespace such as
/// `plan_a` determines nothing, but a namespace such as `command` does.
fn decisive_words(topic: &str) -> Vec<String> {
    let (namespaces, name) = topic.rsplit_once('/').unwrap_or(("", topic));
    let segments = namespaces.split('/').map(split_words);
    let is_clear = tool_word(topic).is_some() || name.starts_with("joint_state");
    let segments = segments.filter(|words| !is_clear || words.len() == 1);
    segments.flatten().chain(split_words(name)).collect()
}

/// Whether poses are named after an object, and not after a camera that sees it.
pub(super) fn names_object(topic: &str) -> bool {
    target_of_camera(topic).is_none() && carried_word(&split_words(topic)).is_some()
}

/// Word of an object, unless the name also has a tool.
fn carried_word(topic_words: &[String]) -> Option<&'static str> {
    find_word(topic_words, CARRIED_WORDS).filter(|_| find_word(topic_words, TOOL_WORDS).is_none())
}

/// Word for a tool in the topic's last segment.
pub(super) fn tool_word(topic: &str) -> Option<&'static str> {
    let name = topic.rsplit_once('/').map_or(topic, |(_, name)| name);
    find_word(&split_words(name), TOOL_WORDS)
}

pub(super) fn is_detection_frame(frame: &str) -> bool {
    let words = split_words(frame);
    find_word(&words, DETECTION_WORDS).or_else(|| find_word(&words, CAMERA_WORDS)).is_some()
}

/// Whether a driver publishes its tool pose under this name.
pub(super) fn is_driver_topic(topic: &str) -> bool {
    find_driver(&split_words(topic)).is_some()
}

/// Whether a driver publishes its tool pose as a transform to this frame.
pub(super) fn is_driver_frame(child_frame_id: &str) -> bool {
    child_frame_id.ends_with(UR_TOOL_FRAME)
}

pub(super) fn find_driver(topic_words: &[String]) -> Option<&'static str> {
    find_sequence(topic_words, DRIVER_TOPICS)
}

/// Convention that the driver of this topic documents for three rotation numbers.
pub(super) fn documented_convention(topic: &str) -> Option<Convention> {
    find_sequence(&split_words(topic), DOCUMENTED_CONVENTIONS)
}

/// Encodings that the names of rotation columns may denote; the usual one of the arm's vendor first.
pub fn named_encodings(labels: RotationLabels, arm: &str) -> Vec<RotationEncoding> {
    let is_of = |vendor: &str| arm.to_lowercase().contains(vendor);
    // Vendors in `vendors.toml`.
    let vendors: &[&str] = match labels {
        RotationLabels::Quaternion => return vec![RotationEncoding::Xyzw],
        RotationLabels::ScalarFirst => return vec![RotationEncoding::Wxyz],
        RotationLabels::RotationVector => return vec![RotationEncoding::Three(Convention::RotVec)],
        RotationLabels::RollPitchYaw => &["xarm"],
        RotationLabels::Wpr => &["fanuc"],
        RotationLabels::Oat => &["kawasaki"],
        // A Doosan is configurable to other orders.
        RotationLabels::Abc if is_of("doosan") => &["doosan", "kuka", "mitsubishi"],
        RotationLabels::Abc if is_of("mitsubishi") => &["mitsubishi"],
        RotationLabels::Abc => &["kuka"],
    };
    vendors.iter().filter_map(|vendor| Some(vendors::find(vendor)?.coding)).collect()
}

fn find_sequence<Of: Copy>(words: &[String], known: &[(&[&str], Of)]) -> Option<Of> {
    let has = |sequence: &[&str]| words.windows(sequence.len()).any(|window| window == sequence);
    known.iter().find(|(sequence, _)| has(sequence)).map(|(_, of)| *of)
}

pub(super) fn find_word(words: &[String], known: &[&'static str]) -> Option<&'static str> {
    known.iter().copied().find(|known| words.iter().any(|word| word == known))
}

/// Whether a joint's name is that of a gripper, hand, wheel, head or leg.
pub(crate) fn is_outside_arm(joint: &str) -> bool {
    find_word(&split_words(joint), NON_ARM_JOINT_WORDS).is_some()
}

/// Words in lower case: split at other characters than letters and digits, and before a capital after a
/// small letter.
pub(super) fn split_words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut last = '/';
    for c in name.chars() {
        let starts = !last.is_alphanumeric() || (last.is_lowercase() && c.is_uppercase());
        match words.last_mut() {
            _ if !c.is_alphanumeric() => {}
            Some(word) if !starts => word.extend(c.to_lowercase()),
            _ => words.push(c.to_lowercase().collect()),
        }
        last = c;
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use FrameKind::{MovingLink, StaticallyTied, StillLink, Unknown, Unnamed};

    fn role(
        topic: &str,
        (frame_id, frame): (&str, FrameKind),
        (child_frame_id, child): (&str, FrameKind),
    ) -> Role {
        pose_role(&PoseTopic { topic, frame_id, child_frame_id, frame, child, is_declared: false })
            .0
    }

    #[test]
    fn only_documented_topics_have_a_convention() {
        for (topic, documented) in [
            ("actual_TCP_pose", Some(Convention::RotVec)),
            ("/ur/actual_TCP_pose", Some(Convention::RotVec)),
            ("tool_vector_actual", Some(Convention::RotVec)),
            ("/xarm/tcp_pose", None),
            ("/tool_position", None),
        ] {
            assert_eq!(documented_convention(topic), documented, "{topic}");
        }
    }

    #[test]
    fn names_of_rotation_columns_state_an_encoding() {
        for (labels, arm, encoding) in [
            (RotationLabels::RollPitchYaw, "ufactory_lite6", "euler:xyz"),
            (RotationLabels::Abc, "kuka_kr6_r900_2", "euler:ZYX"),
            (RotationLabels::Abc, "doosan_m0609", "euler:ZYZ"),
            (RotationLabels::RotationVector, "ur5e", "rotvec"),
        ] {
            let first = named_encodings(labels, arm).first().map(RotationEncoding::to_string);
            assert_eq!(first.as_deref(), Some(encoding), "{arm}");
        }
    }

    #[test]
    fn names_are_split_at_marks_and_capitals() {
        assert_eq!(
            split_words("/iiwa/state/CartesianPose"),
            ["iiwa", "state", "cartesian", "pose"]
        );
        assert_eq!(split_words("O_T_EE"), ["o", "t", "ee"]);
        assert_eq!(split_words("//"), [""; 0]);
    }

    #[test]
    fn the_role_table() {
        let (weak, strong) =
            (Role::Candidate { presumed: false }, Role::Candidate { presumed: true });
        let (base, map, none) = (("base", StillLink), ("map", Unknown), ("", Unnamed));
        for (topic, frame, child, expected) in [
            ("/tcp_pose_broadcaster/pose", base, none, Role::Pose),
            ("/tcp_pose_broadcaster/pose", ("mocap_world", Unknown), none, Role::Pose),
            ("/franka_robot_state_broadcaster/current_pose", none, none, Role::Pose),
            ("/franka_robot_state_broadcaster/o_t_ee", base, none, Role::Pose),
            ("/franka_robot_state_broadcaster/robot_state.o_t_ee", base, none, Role::Pose),
            ("/franka_robot_state_broadcaster/robot_state.o_t_ee_d", base, none, Role::Reference),
            ("/iiwa/state/CartesianPose", base, none, Role::Pose),
            ("/iiwa/command/CartesianPose", base, none, Role::Reference),
            ("/arm/equilibrium_pose", base, none, Role::Reference),
            ("/goal_pose", map, none, Role::Reference),
            ("/setpoint_cp", base, none, Role::Reference),
            ("/target_pose", ("camera", Unknown), none, Role::Target),
            ("/target_pose", base, none, Role::Reference),
            ("/aruco_single/pose", base, none, Role::Target),
            ("target2cam", none, none, Role::Target),
            ("T_cam_target", none, none, Role::Target),
            ("T_cam_target_tvec", none, none, Role::Target),
            ("cam2marker", none, none, Role::Target),
            ("/vicon/ee_marker/pose", ("vicon", Unknown), none, weak),
            ("/tcp_target", ("mocap", Unknown), none, weak),
            ("/wrist_tag", ("camera_optical", Unknown), none, Role::Target),
            ("/aruco_marker/pose", ("world", Unknown), none, Role::Target),
            ("/target/command", ("world", Unknown), none, Role::Reference),
            ("/object_pose", none, none, Role::Target),
            ("cube_position", none, none, Role::Target),
            ("cube_task/ee_pos", none, none, weak),
            ("/vrpn/cube", map, none, weak),
            ("/vision/pose", ("camera_color_optical_frame", MovingLink), none, Role::Target),
            ("/hand_pose", base, none, strong),
            ("/hand_pose", ("world", StaticallyTied), none, weak),
            ("/camera_mount_pose", map, none, weak),
            ("/vrpn/tool", map, none, weak),
            ("/vrpn/tool", ("odom", Unknown), ("tool0", MovingLink), Role::Pose),
            ("/odom", ("odom", Unknown), ("base_link", StillLink), Role::Unassigned),
            ("/odom", ("odom", Unknown), ("base_footprint", Unknown), Role::Unassigned),
            ("/amcl_pose", map, none, Role::Unassigned),
            ("/ee_pose_odom", base, none, weak),
            ("/slam_cart/tool_pose", base, none, weak),
            ("/plan_a/robot/tcp_pose", base, none, weak),
            ("/cmd_station/measured_tool_pose", base, none, weak),
            ("/cartesian_goal/ee_pose", base, none, weak),
            ("/command/tcp_pose", base, none, Role::Reference),
            ("/goal_state/pose", base, none, Role::Reference),
            ("/grasp", ("tool0", MovingLink), none, Role::Unassigned),
        ] {
            assert_eq!(role(topic, frame, child), expected, "{topic} in {frame:?} of {child:?}");
        }
    }

    #[test]
    fn arrays_may_be_poses_and_are_presumed_to_be_under_a_drivers_name() {
        let [candidate, presumed] = [false, true].map(|presumed| Role::Candidate { presumed });
        for (topic, width, declared, expected) in [
            ("/recorded/values", 6, false, candidate),
            ("/recorded/values", 6, true, Role::Pose),
            ("cube/pose", 7, false, Role::Unassigned),
            ("/ur/actual_tcp_pose", 6, false, presumed),
            ("/O_T_EE", 16, false, presumed),
            ("/franka_state_controller/franka_states.O_T_EE", 16, false, presumed),
            ("/franka_state_controller/franka_states.O_T_EE_d", 16, false, Role::Reference),
            ("/franka/O_T_EE_c", 16, false, Role::Reference),
            ("/franka/tau_J_d", 7, false, Role::Reference),
            ("/forward_position_controller/commands", 6, false, Role::Reference),
            ("/arm/joint_torques", 6, false, Role::Ignored),
            ("/ft_sensor/wrench", 6, false, Role::Ignored),
            ("/battery", 3, false, Role::Ignored),
            ("object_pose", 2, false, Role::Ignored),
            ("/battery", 3, true, Role::Ignored),
        ] {
            assert_eq!(array_role(topic, width, declared).0, expected, "{topic}");
        }
    }

    #[test]
    fn four_numbers_of_unit_norm_beside_three_others_are_a_pose() {
        let row = |row: usize| -> Vec<f64> {
            let a = 0.1 * row as f64;
            let [w, x] = [a.cos(), a.sin()];
            // A counter, a pose, a padding and a pose with its rotation first.
            vec![a, 0.5, a, 0.1, w, 0.0, 0.0, x, 0.0, 0.0, 0.0, 1.0, x, 0.0, w, 0.0, a, 2.0, 3.0]
        };
        let width = row(0).len();
        let values = (0..20).flat_map(row).collect();
        let array = ArrayColumns { width, values, ..ArrayColumns::default() };
        assert_eq!(unnamed_poses(&array), [[1, 4], [16, 12]]);
        let array = ArrayColumns { width: 6, values: vec![0.5; 60], ..ArrayColumns::default() };
        assert_eq!(unnamed_poses(&array), [[0; 2]; 0]);
    }

    #[test]
    fn joint_commands_are_no_joint_states() {
        let joints = Columns::Joints(crate::stream::JointColumns::default());
        assert_eq!(
            role_by_content("/joint_states", &joints).map(|(role, _)| role),
            Some(Role::Joints)
        );
        let states = role_by_content("/target_robot/joint_states", &joints);
        assert_eq!(states.map(|(role, _)| role), Some(Role::Joints));
        for topic in [
            "/isaac_joint_commands",
            "/arm_controller/state.reference",
            "/cmd/joint_states",
            "/q_d",
        ] {
            assert_eq!(
                role_by_content(topic, &joints).map(|(role, _)| role),
                Some(Role::Reference)
            );
        }
        let feedback = role_by_content("/arm_controller/controller_state", &joints);
        assert_eq!(feedback.map(|(role, _)| role), Some(Role::Joints));
    }
}
