//! What the names of columns say.

/// The words of a name, in lower case: cut at everything that is no letter or digit, where a capital follows
/// a small letter, and between letters and digits.
pub(super) fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut last = '/';
    for c in name.chars() {
        let is_cut = !last.is_alphanumeric()
            || (last.is_lowercase() && c.is_uppercase())
            || last.is_ascii_digit() != c.is_ascii_digit();
        match words.last_mut() {
            _ if !c.is_alphanumeric() => {}
            Some(word) if !is_cut => word.extend(c.to_lowercase()),
            _ => words.push(c.to_lowercase().collect()),
        }
        last = c;
    }
    words
}

/// Words of numbers that are neither positions of joints nor poses.
pub(super) const OTHERS: &[&str] = &[
    "vel",
    "velocity",
    "velocities",
    "speed",
    "speeds",
    "qd",
    "dq",
    "ddq",
    "qdd",
    "qvel",
    "qacc",
    "torque",
    "torques",
    "effort",
    "efforts",
    "tau",
    "current",
    "currents",
    "force",
    "forces",
    "wrench",
    "moment",
    "temperature",
    "temp",
    "acc",
    "accel",
    "acceleration",
    "cos",
    "sin",
    "voltage",
    "reward",
    "done",
    "image",
    "images",
    "delta",
    "jacobian",
    "error",
    "mask",
    "std",
    "mean",
    "min",
    "max",
    "stiffness",
    "damping",
    "twist",
    "status",
    "mode",
];

/// Words of grippers.
pub(super) const GRIPPERS: &[&str] =
    &["gripper", "grippers", "finger", "fingers", "jaw", "claw", "hand"];

/// Words of positions of joints.
const JOINTS: &[&str] = &[
    "q",
    "qpos",
    "joint",
    "joints",
    "jointpositions",
    "jpos",
    "axis",
    "motor",
    "motors",
    "theta",
    "servo",
];
/// Words of parts of arms, in names of joints.
const LIMBS: &[&str] =
    &["shoulder", "elbow", "wrist", "waist", "forearm", "upperarm", "joint", "arm"];
/// Words that say nothing more of a joint whose name ends in a number.
const PLAIN: &[&str] = &[
    "actual",
    "measured",
    "state",
    "states",
    "observation",
    "observations",
    "obs",
    "position",
    "positions",
    "pos",
    "robot",
    "arm",
    "angle",
    "angles",
    "feedback",
    "rad",
    "deg",
    "data",
    "action",
    "actions",
    "target",
    "command",
    "commanded",
    "desired",
    "goal",
    "main",
    "follower",
    "leader",
    "value",
    "a",
    "j",
    "d",
    "aipos",
];
/// Words of the position of a tool.
const POSITIONS: &[&str] = &["pos", "position", "xyz", "translation", "trans", "p", "t"];
/// Words of its rotation.
const ROTATIONS: &[&str] = &[
    "quat",
    "quaternion",
    "orientation",
    "orient",
    "ori",
    "rot",
    "rotation",
    "euler",
    "rpy",
    "rotvec",
    "axisangle",
    "angles",
    "angle",
];
/// Words of poses, also of bare numbers.
const POSES: &[&str] =
    &["pose", "tcp", "ee", "eef", "end", "effector", "cartesian", "flange", "tool", "hand"];
/// Words of units, which say nothing of what it is.
const UNITS: &[&str] = &["m", "mm", "rad", "deg", "meter", "meters", "metre", "metres"];

fn has(words: &[String], known: &[&str]) -> bool {
    words.iter().any(|word| known.contains(&word.as_str()))
}

/// Whether numbers are of a gripper or of what no audit asks about.
pub(super) fn is_other(words: &[String]) -> bool {
    has(words, OTHERS)
}

pub(super) fn is_gripper(words: &[String]) -> bool {
    has(words, GRIPPERS) && !has(words, &["wrist"])
}

/// Whether a column of bare numbers holds positions of joints, by its name.
pub(super) fn are_joints(words: &[String]) -> bool {
    has(words, JOINTS) && !is_other(words) && !has(words, GRIPPERS) && !is_pose(words)
}

/// Whether a column of bare numbers holds poses, by its name.
pub(super) fn is_pose(words: &[String]) -> bool {
    has(words, POSES) && !is_other(words) && !has(words, &["joint", "joints", "gripper"])
}

/// The name of a joint that a name is of, as models have it.
pub(super) fn joint_name(name: &str) -> Option<String> {
    let own = words(name);
    if is_other(&own) {
        return None;
    }
    let bare = [".pos", "_pos", ".position", "_position", ".q", "_rad", "_deg"]
        .iter()
        .find_map(|end| name.strip_suffix(end))
        .unwrap_or(name);
    (has(&own, LIMBS) || is_gripper(&own)).then(|| bare.to_owned())
}

/// A name that ends in a number, or has one behind its stem: the stem's words, and the number.
pub(super) fn numbered(name: &str) -> Option<(Vec<String>, usize)> {
    let words = words(name);
    let at = words.iter().rposition(|word| word.chars().all(|c| c.is_ascii_digit()))?;
    let number = words[at].parse().ok()?;
    let stem: Vec<String> = words
        .iter()
        .enumerate()
        .filter(|(other, word)| *other != at && !UNITS.contains(&word.as_str()))
        .map(|(_, word)| word.clone())
        .collect();
    Some((stem, number))
}

/// Whether the stem of numbered names is one of joints. A single letter is, where the letter is usual.
pub(super) fn is_stem_of_joints(stem: &[String]) -> bool {
    let letters = stem.last().is_some_and(|word| ["a", "j"].contains(&word.as_str()));
    !is_other(stem) && !is_pose(stem) && !has(stem, GRIPPERS) && (has(stem, JOINTS) || letters)
}

/// What of a stem tells one arm from another: `left`, `right` and the like; empty for plain words.
pub(super) fn side(stem: &[String]) -> String {
    let mut own = stem.iter().map(String::as_str);
    match own.find(|word| ["left", "right", "l", "r"].contains(word)) {
        Some("l") => "left_".to_owned(),
        Some("r") => "right_".to_owned(),
        Some(side) => format!("{side}_"),
        None => String::new(),
    }
}

/// Whether the words of a stem are those that everybody uses, beside a side.
pub(super) fn is_plain(stem: &[String]) -> bool {
    stem.iter().all(|word| {
        let word = word.as_str();
        JOINTS.contains(&word)
            || PLAIN.contains(&word)
            || ["left", "right", "l", "r"].contains(&word)
            || word.chars().all(|c| c.is_ascii_digit())
    })
}

/// A number of a position or of a rotation.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Axis {
    /// Of a position, or of either.
    Xyz(usize),
    /// Of a position and nothing else.
    Position(usize),
    /// Of three numbers of a rotation.
    Turn(usize),
    /// Of a quaternion: x, y, z, w.
    Quaternion(usize),
    /// KUKA's A, B, C.
    Letter(usize),
}

/// What a name says of a pose: whose number it is, and the words that are left, which those of one pose share.
pub(super) fn axis(name: &str) -> Option<(Vec<String>, Axis)> {
    let words = words(name);
    if is_other(&words) || is_gripper(&words) {
        return None;
    }
    let axis_of = |word: &str| {
        let one = |axes: &[&str], of: fn(usize) -> Axis| {
            axes.iter().position(|axis| *axis == word).map(of)
        };
        one(&["x", "y", "z"], Axis::Xyz)
            .or_else(|| one(&["px", "py", "pz"], Axis::Position))
            .or_else(|| one(&["tx", "ty", "tz"], Axis::Position))
            .or_else(|| one(&["qx", "qy", "qz", "qw"], Axis::Quaternion))
            .or_else(|| one(&["rx", "ry", "rz"], Axis::Turn))
            .or_else(|| one(&["roll", "pitch", "yaw"], Axis::Turn))
            .or_else(|| one(&["phix", "phiy", "phiz"], Axis::Turn))
            .or_else(|| one(&["rr", "rp"], Axis::Turn))
            .or_else(|| one(&["a", "b", "c"], Axis::Letter))
    };
    let last_w = words.last().is_some_and(|word| word == "w");
    let at = words.iter().rposition(|word| axis_of(word).is_some());
    let (at, found) = match (at, last_w && has(&words, ROTATIONS)) {
        (_, true) => (words.len() - 1, Axis::Quaternion(3)),
        (Some(at), false) => (at, axis_of(&words[at])?),
        (None, false) => return None,
    };
    let of_rotation = has(&words, ROTATIONS);
    let axis = match found {
        Axis::Xyz(of) if has(&words, &["quat", "quaternion"]) => Axis::Quaternion(of),
        Axis::Xyz(of) if words[..at].iter().any(|word| word == "q") && words.len() > 1 => {
            Axis::Quaternion(of)
        }
        Axis::Xyz(of) if of_rotation => Axis::Turn(of),
        found => found,
    };
    let key = key(words.iter().enumerate().filter(|(other, _)| *other != at).map(|(_, word)| word));
    Some((key, axis))
}

/// The words that name a pose, without those that say which part of it.
fn key<'a>(words: impl Iterator<Item = &'a String>) -> Vec<String> {
    let is_of_part = |word: &str| {
        POSITIONS.contains(&word)
            || ROTATIONS.contains(&word)
            || UNITS.contains(&word)
            || word == "q"
            || word == "r"
    };
    words.filter(|word| !is_of_part(word)).cloned().collect()
}

/// Which part of a pose a column of several bare numbers is, and the words that name the pose.
pub(super) fn part(name: &str, width: usize) -> Option<(Vec<String>, Part)> {
    let words = words(name);
    if is_other(&words) || has(&words, &["joint", "joints"]) || is_gripper(&words) {
        return None;
    }
    let part = match width {
        3 if has(&words, ROTATIONS) => Part::Turn,
        4 if has(&words, ROTATIONS) => Part::Quaternion,
        3 if has(&words, POSITIONS) => Part::Position,
        _ => return None,
    };
    Some((key(words.iter()), part))
}

/// A part of a pose.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Part {
    Position,
    Turn,
    Quaternion,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is(name: &str) -> Option<(String, Axis)> {
        axis(name).map(|(key, axis)| (key.join(" "), axis))
    }

    #[test]
    fn names_of_numbers_of_poses_are_read() {
        for (name, key, axis) in [
            ("x", "", Axis::Xyz(0)),
            ("tcp_qw", "tcp", Axis::Quaternion(3)),
            ("pose.orientation.w", "pose", Axis::Quaternion(3)),
            ("pose.position.y", "pose", Axis::Xyz(1)),
            ("ee_roll_deg", "ee", Axis::Turn(0)),
            ("A_RIst", "rist", Axis::Letter(0)),
            ("Z_RSol", "rsol", Axis::Xyz(2)),
            ("rot_x", "", Axis::Turn(0)),
        ] {
            assert_eq!(is(name), Some((key.to_owned(), axis)), "{name}");
        }
        for name in ["timestamp", "gripper", "vel_x", "q_1", "force_z", "shoulder_pan.pos"] {
            assert_eq!(is(name), None, "{name}");
        }
    }

    #[test]
    fn numbered_joints_are_told_from_other_families() {
        for (name, is_joint) in [
            ("q1", true),
            ("actual_q_0", true),
            ("joint_3", true),
            ("J6", true),
            ("AIPos A1", true),
            ("observation.state.motor_2", true),
            ("C11", false),
            ("i4", false),
            ("qd_3", false),
            ("torque_joint_1", false),
        ] {
            let found = numbered(name).is_some_and(|(stem, _)| is_stem_of_joints(&stem));
            assert_eq!(found, is_joint, "{name}");
        }
    }
}
