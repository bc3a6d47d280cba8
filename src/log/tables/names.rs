//! Identifies columns by name.

use std::collections::BTreeSet;

use crate::RotationLabels;

/// Whether a name belongs to a transition (action, reward, episode end), as Gymnasium's `step` returns it.
/// A run has one transition fewer than states.
pub(super) fn is_transition(name: &str) -> bool {
    const TRANSITION_WORDS: &[&str] = &[
        "action", "actions", "reward", "rewards", "done", "dones", "terminated", "truncated",
        "success", "discount",
    ];
    has_word(name, TRANSITION_WORDS)
}

pub(super) fn is_joints_or_pose(name: &str) -> bool {
    let words = split_words(name);
    is_joint_positions(&words) || is_pose(&words)
}

pub(super) const DEGREE_WORDS: &[&str] = &["deg", "degs", "degree", "degrees", "grad", "grados"];

pub(super) const RADIAN_WORDS: &[&str] = &["rad", "rads", "radian", "radians"];

pub(super) fn says_degrees(name: &str) -> bool {
    name.contains('°') || has_word(name, DEGREE_WORDS)
}

pub(super) fn singular(word: &str) -> &str {
    word.strip_suffix('s').unwrap_or(word)
}

/// Unit of length at the end of a name, m.
pub(super) fn length_unit_m(name: &str) -> Option<f64> {
    split_words(name).last().and_then(|word| length_by_word(word))
}

/// Unit of a length, m.
fn length_by_word(word: &str) -> Option<f64> {
    Some(match word {
        "m" | "meter" | "meters" | "metre" | "metres" => 1.0,
        "cm" => 1e-2,
        "mm" | "millimeter" | "millimeters" => 1e-3,
        _ => return None,
    })
}

/// Whether a name denotes the base alone, as UR's pendant names the first joint.
pub(super) fn is_base(name: &str) -> bool {
    let mut words = split_words(name);
    words.retain(|word| !is_unit(word));
    words == ["base"]
}

/// Lower-case words. Splits at characters other than letters and digits, before a capital that follows a
/// small letter, and between letters and digits.
pub(super) fn split_words(name: &str) -> Vec<String> {
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
    words.into_iter().flat_map(split_german).collect()
}

/// `ist` and `position` of KUKA's `Istposition`, which no case separates.
fn split_german(word: String) -> Vec<String> {
    const STATES: [&str; 2] = ["ist", "soll"];
    const QUANTITIES: [&str; 6] =
        ["position", "winkel", "geschwindigkeit", "beschleunigung", "moment", "strom"];
    let parts = STATES.iter().find_map(|state| {
        let quantity = word.strip_prefix(state).filter(|rest| QUANTITIES.contains(rest))?;
        Some(vec![(*state).to_owned(), quantity.to_owned()])
    });
    parts.unwrap_or_else(|| vec![word])
}

const VELOCITY_WORDS: &[&str] = &[
    "vel", "vels", "velocity", "velocities", "speed", "speeds", "qd", "dq", "qvel", "qdot", "jvel",
    "dqref", "dqdes", "dqcmd", "dot", "dtheta", "thetadot", "geschwindigkeit",
];

/// Neither joint positions nor poses.
const OTHER_WORDS: &[&str] = &[
    "ddq", "qdd", "qddot", "ddot", "dotdot", "qdotdot", "ddtheta", "dd", "qacc", "fx", "fy", "fz",
    "mx", "my", "mz", "vx", "vy", "vz", "wx", "wy", "wz", "ft", "eff", "torque", "torques",
    "effort", "efforts", "tau", "currents", "force", "forces", "wrench", "moment", "moments",
    "temperature", "temp", "acc", "accel", "accelerations", "acceleration", "beschleunigung",
    "beschleunigungsdifferenz", "geschwindigkeitsdifferenz", "positionsschleppfehler", "strom",
    "cos", "sin", "voltage", "power", "jerk", "reward", "done", "image", "images", "delta",
    "jacobian", "error", "errors", "limit", "limits", "violation", "collision", "contact",
    "reflex", "mask", "std", "sigma", "uncertainty", "mean", "min", "max", "stiffness", "damping",
    "twist", "status", "mode",
];

/// Words in the names of commands.
pub const COMMAND_WORDS: &[&str] = &[
    "goal", "goals", "target", "targets", "tgt", "command", "commands", "cmd", "commanded",
    "desired", "des", "setpoint", "setpoints", "reference", "ref", "equilibrium", "qref", "qdes",
    "qcmd", "dqref", "dqdes", "dqcmd", "waypoint", "waypoints", "plan", "planned", "interactive",
    "soll",
];

pub(super) const GRIPPER_WORDS: &[&str] =
    &["gripper", "grippers", "finger", "fingers", "jaw", "claw", "hand"];

const JOINT_WORDS: &[&str] = &[
    "q", "qpos", "qref", "qdes", "qcmd", "joint", "joints", "jointpositions", "jpos", "axis",
    "motor", "motors", "theta", "servo", "gelenk", "achse", "axe", "eje", "asse", "关节", "轴",
    "関節", "軸",
];
/// Parts of arms in joint names.
const LIMB_WORDS: &[&str] =
    &["shoulder", "elbow", "wrist", "waist", "forearm", "upperarm", "joint", "arm"];
/// Words in numbered joint names that do not name the joint.
const GENERIC_WORDS: &[&str] = &[
    "actual", "act", "measured", "meas", "state", "states", "observation", "observations", "obs",
    "position", "positions", "pos", "present", "real", "robot", "arm", "angle", "angles",
    "feedback", "rad", "deg", "data", "action", "actions", "target", "tgt", "command", "commanded",
    "cmd", "desired", "des", "ref", "goal", "main", "follower", "leader", "value", "current",
    "field", "ist", "soll", "a", "j", "jt", "rax", "d", "aipos",
];
/// Words for a tool position.
const POSITION_WORDS: &[&str] = &[
    "pos", "position", "positions", "xyz", "translation", "translations", "trans", "tvec", "tvecs",
    "p", "t",
];
/// Words for a tool rotation.
const ROTATION_WORDS: &[&str] = &[
    "quat", "quats", "quaternion", "quaternions", "orientation", "orientations", "orient", "ori",
    "rot", "rotation", "rotations", "attitude", "drehung", "winkel", "orientierung", "euler",
    "rpy", "rotvec", "rv", "rvec", "rvecs", "aa", "axisangle", "theta", "angles", "angle",
];
/// Words for a rotation vector, as in OpenCV.
const ROTATION_VECTOR_WORDS: &[&str] = &["rotvec", "rv", "rvec", "rvecs", "axisangle"];
const QUATERNION_WORDS: &[&str] = &["quat", "quats", "quaternion", "quaternions"];
const POSE_WORDS: &[&str] = &[
    "pose", "coords", "tcp", "ee", "eef", "end", "effector", "cartesian", "flange", "tool", "hand",
];
/// Three rotation angles, in order: FANUC's W P R, KUKA's A B C, Kawasaki's O A T, Epson's U V W and
/// textbook notations.
pub(super) const ANGLE_LABELS: &[[&str; 3]] = &[
    ["rx", "ry", "rz"],
    ["roll", "pitch", "yaw"],
    ["rr", "rp", "ry"],
    ["phix", "phiy", "phiz"],
    ["a", "b", "c"],
    ["w", "p", "r"],
    ["o", "a", "t"],
    ["u", "v", "w"],
    ["alpha", "beta", "gamma"],
    ["phi", "theta", "psi"],
];

fn is_unit(word: &str) -> bool {
    RADIAN_WORDS.contains(&word) || DEGREE_WORDS.contains(&word) || length_by_word(word).is_some()
}

pub(super) fn contains_any(words: &[String], known: &[&str]) -> bool {
    words.iter().any(|word| known.contains(&word.as_str()))
}

pub(super) fn has_word(name: &str, known: &[&str]) -> bool {
    contains_any(&split_words(name), known)
}

/// Velocities or other quantities that are not audited.
pub(super) fn is_other_quantity(words: &[String]) -> bool {
    contains_any(words, OTHER_WORDS)
        || words.iter().any(|word| is_rate_of_other(word))
        || has_velocity_word(words)
        || is_motor_current(words)
        || is_tool_twist(words)
        || is_uncertainty(words)
        || words.ends_with(&["per", "s", "2"].map(str::to_owned))
}

/// `dtau`, the rate of a torque.
fn is_rate_of_other(word: &str) -> bool {
    word.strip_prefix('d').is_some_and(|of| OTHER_WORDS.contains(&of))
}

/// `U(95) X` of a laser tracker.
fn is_uncertainty(words: &[String]) -> bool {
    words.windows(2).any(|words| words == ["u", "95"])
}

/// A word for velocities, a differential (`d_theta_1`), or the ending of `wrist_1_v`.
fn has_velocity_word(words: &[String]) -> bool {
    let is_joint = |word: &str| JOINT_WORDS.contains(&word);
    contains_any(words, VELOCITY_WORDS)
        || words.windows(2).any(|pair| pair[0] == "d" && is_joint(&pair[1]))
        || (contains_any(words, LIMB_WORDS) && words.last().is_some_and(|word| word == "v"))
}

/// libfranka's `O_dP_EE`.
fn is_tool_twist(words: &[String]) -> bool {
    words.windows(3).any(|words| words == ["d", "p", "ee"])
}

pub(super) fn is_joint_velocities(words: &[String]) -> bool {
    let of_tool = |word: &String| POSE_WORDS.contains(&word.as_str()) || word.as_str() == "linear";
    has_velocity_word(words)
        && !contains_any(words, OTHER_WORDS)
        && !words.iter().any(of_tool)
        && !is_motor_current(words)
}

/// `current` also means present, as in `current_pos_x`. `motor_iq` and `motor_id` are currents of a three-phase motor.
fn is_motor_current(words: &[String]) -> bool {
    let is_axis = |pair: &[String]| pair[0] == "motor" && matches!(pair[1].as_str(), "id" | "iq");
    let has_quantity = contains_any(words, POSITION_WORDS) || contains_any(words, VELOCITY_WORDS);
    if words.windows(2).any(is_axis) && !has_quantity {
        return true;
    }
    let is_measured = |word: &String| {
        let word = word.as_str();
        let is_short = matches!(word, "p" | "t");
        let is_part = POSITION_WORDS.contains(&word) || ROTATION_WORDS.contains(&word);
        (is_part && !is_short)
            || POSE_WORDS.contains(&word)
            || matches!(word, "x" | "y" | "z" | "q" | "qpos" | "jpos" | "state" | "states")
    };
    let at = words.iter().position(|word| word == "current");
    at.is_some_and(|at| !words[at..].iter().any(is_measured))
}

/// Words that a joint's position and velocity columns share: its number, its side, `target`.
pub(super) fn shared_words(words: &[String]) -> Vec<String> {
    const NEUTRAL_WORDS: &[&str] = &[
        "state", "states", "observation", "observations", "obs", "robot", "arm", "data",
        "measured", "meas", "actual", "act", "feedback", "main", "follower", "field", "current",
        "angle", "angles", "ist", "a", "j", "per", "s", "v",
    ];
    let is_neutral = |at: usize| {
        let is_differential = || {
            words[at] == "d"
                && words.get(at + 1).is_some_and(|next| JOINT_WORDS.contains(&next.as_str()))
        };
        [VELOCITY_WORDS, POSITION_WORDS, JOINT_WORDS, NEUTRAL_WORDS]
            .iter()
            .any(|known| known.contains(&words[at].as_str()))
            || is_unit(&words[at])
            || is_differential()
    };
    (0..words.len()).filter(|&at| !is_neutral(at)).map(|at| words[at].clone()).collect()
}

/// Whether a name states positions or angles, measured or commanded, and not of what.
pub(super) fn is_bare_position(words: &[String]) -> bool {
    let is_command = |word: &String| COMMAND_WORDS.contains(&word.as_str());
    is_position(words) && shared_words(words).iter().all(is_command)
}

fn is_position(words: &[String]) -> bool {
    const WORDS: &[&str] = &["pos", "position", "positions", "winkel", "angle", "angles"];
    contains_any(words, WORDS) && !is_other_quantity(words)
}

/// Whether a name states positions, and another the velocities of the same, as `act_pos_se_deg` and
/// `act_vel_se_deg_per_s`. If they say of what, as `base_position` does, they also state that they are angles.
pub(super) fn are_position_and_velocity(words: &[String], others: &[String]) -> bool {
    let is_command = |word: &String| COMMAND_WORDS.contains(&word.as_str());
    let shared = |words: &[String]| -> Vec<String> {
        shared_words(words).into_iter().filter(|word| !is_command(word)).collect()
    };
    let are_angles = || {
        [words, others]
            .iter()
            .all(|words| contains_any(words, DEGREE_WORDS) || contains_any(words, RADIAN_WORDS))
    };
    is_position(words)
        && !is_pose(words)
        && !is_gripper(words)
        && is_joint_velocities(others)
        && shared(words) == shared(others)
        && (shared(words).is_empty() || are_angles())
}

/// `qd` can mean desired positions or velocities.
pub(super) fn is_ambiguous_velocity(words: &[String]) -> bool {
    contains_any(words, &["qd"])
}

pub(super) fn is_gripper(words: &[String]) -> bool {
    contains_any(words, GRIPPER_WORDS) && !contains_any(words, &["wrist"])
}

/// Whether the name of a gripper denotes its pose, and not its joints.
pub(super) fn is_pose_of_gripper(name: &str, width: usize) -> bool {
    let words = split_words(name);
    let is_named = contains_any(&words, &["pose"]) || is_gripper_in_base(&words);
    let is_whole = matches!(width, 7 | 12 | 16) && is_named;
    is_whole || pose_part(name, width).is_some()
}

/// OpenCV's `gripper2base`.
fn is_gripper_in_base(words: &[String]) -> bool {
    const TO: &[&str] = &["2", "to"];
    const BASES: &[&str] = &["base", "world", "robot"];
    words.windows(3).any(|words| {
        let is_one_of = |at: usize, known: &[&str]| known.contains(&words[at].as_str());
        is_one_of(0, GRIPPER_WORDS) && is_one_of(1, TO) && is_one_of(2, BASES)
    })
}

pub(super) fn is_joint_positions(words: &[String]) -> bool {
    contains_any(words, JOINT_WORDS)
        && !is_other_quantity(words)
        && !contains_any(words, GRIPPER_WORDS)
        && !is_pose(words)
}

pub(super) fn is_pose(words: &[String]) -> bool {
    let is_both = contains_any(words, POSITION_WORDS) && contains_any(words, ROTATION_WORDS);
    (contains_any(words, POSE_WORDS) || is_both)
        && !is_other_quantity(words)
        && !contains_any(words, &["joint", "joints", "gripper"])
}

/// Words before a matrix element, and its row and column: `T_03`, `R[1][2]`.
pub(super) fn matrix_cell(name: &str) -> Option<(Vec<String>, (usize, usize))> {
    let words = split_words(name);
    let first = words.iter().position(|word| is_number(word))?;
    let (stem, cell) = words.split_at(first);
    let text = match cell {
        [both] if both.len() == 2 => both.clone(),
        [row, column] if row.len() == 1 && column.len() == 1 && is_number(column) => {
            format!("{row}{column}")
        }
        _ => return None,
    };
    let number: usize = text.parse().ok()?;
    let is_of_pose = !stem.is_empty() && !is_other_quantity(stem) && !is_stem_of_joints(stem);
    (is_of_pose && number / 10 <= 4 && number % 10 <= 4)
        .then(|| (stem.to_vec(), (number / 10, number % 10)))
}

/// Without a unit in brackets at the end: `Wrist 1` of `Wrist 1 [deg]`.
pub(super) fn without_unit(name: &str) -> &str {
    let bare = name.rsplit_once(['[', '(']).filter(|(_, unit)| {
        let words = split_words(unit);
        unit.contains('°') || (!words.is_empty() && words.iter().all(|it| is_unit(it)))
    });
    bare.map_or(name, |(bare, _)| bare.trim_end())
}

/// Joint name as models write it.
pub(super) fn joint_name(name: &str) -> Option<String> {
    let own = split_words(name);
    if is_other_quantity(&own) {
        return None;
    }
    const ENDINGS: &[&str] =
        &[".pos", "_pos", ".position", "_position", "/position", ".q", "_rad", "_deg", "_p"];
    let name = without_state(without_unit(name));
    let bare = ENDINGS.iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name);
    (contains_any(&own, LIMB_WORDS) || is_gripper(&own)).then(|| without_state(bare).to_owned())
}

/// Without words at its ends for measured or commanded values: `elbow_pos` of `elbow_pos_target` and `cmd_elbow_pos`.
fn without_state(name: &str) -> &str {
    const MEASURED_WORDS: &[&str] =
        &["actual", "act", "measured", "meas", "present", "current", "feedback", "q"];
    let is_state = |word: &str| {
        let word = word.to_lowercase();
        COMMAND_WORDS.contains(&word.as_str()) || MEASURED_WORDS.contains(&word.as_str())
    };
    let mut bare = name;
    while let Some((rest, _)) = bare.rsplit_once(['_', '.', '/']).filter(|it| is_state(it.1)) {
        bare = rest;
    }
    // A path distinguishes streams.
    while let Some((_, rest)) = bare.split_once('_').filter(|it| is_state(it.0)) {
        bare = rest;
    }
    bare
}

/// Word for a command in a name.
pub(super) fn command_word(name: &str) -> Option<&'static str> {
    let words = split_words(name);
    COMMAND_WORDS.iter().copied().find(|word| words.iter().any(|own| own == word))
}

/// Whether the names are of several limbs, or of numbered joints. libfranka logs its elbow configuration as `elbow0` and `elbow1`.
pub(super) fn are_several_limbs(names: &[String]) -> bool {
    let limbs: BTreeSet<String> = names
        .iter()
        .flat_map(|name| split_words(name))
        .filter(|word| LIMB_WORDS.contains(&word.as_str()))
        .collect();
    limbs.len() > 1 || ["joint", "arm"].iter().any(|word| limbs.contains(*word))
}

/// Whether the number belongs to a part of the arm, as in `wrist_1_pos`.
pub(super) fn numbers_a_limb(name: &str) -> bool {
    let words = split_words(name);
    words.windows(2).any(|pair| {
        ["shoulder", "elbow", "wrist", "forearm"].contains(&pair[0].as_str()) && is_number(&pair[1])
    })
}

pub(super) fn numbered(name: &str) -> Option<(Vec<String>, usize)> {
    let words = split_words(name);
    let at = words.iter().rposition(|word| is_number(word))?;
    let number = words[at].parse().ok()?;
    let stem: Vec<String> = words
        .iter()
        .enumerate()
        .filter(|(other, word)| *other != at && !is_unit(word))
        .map(|(_, word)| word.clone())
        .collect();
    Some((stem, number))
}

/// A single letter indicates joints only if it is a common one.
pub(super) fn is_stem_of_joints(stem: &[String]) -> bool {
    let letters = stem.last().is_some_and(|word| ["a", "j", "jt", "rax"].contains(&word.as_str()));
    // `rostopic echo -p` of a JointState.
    let is_field = stem.ends_with(&["field".to_owned(), "position".to_owned()]);
    let is_joint = contains_any(stem, JOINT_WORDS) || letters || is_field;
    is_joint
        && !is_other_quantity(stem)
        && (!is_pose(stem) || contains_any(stem, &["joint", "joints"]))
        && !contains_any(stem, GRIPPER_WORDS)
}

/// `left_`, `right_` or empty.
pub(super) fn arm_prefix(stem: &[String]) -> String {
    let sides = stem.iter().enumerate().filter(|(at, word)| {
        // In `R0.05` the letter is a symbol.
        let is_symbol = || stem.get(at + 1).is_some_and(|next| is_number(next));
        match word.as_str() {
            "left" | "right" => true,
            "l" | "r" => !is_symbol(),
            _ => false,
        }
    });
    match sides.map(|(_, word)| word.as_str()).next() {
        Some("l") => "left_".to_owned(),
        Some("r") => "right_".to_owned(),
        Some(side) => format!("{side}_"),
        None => String::new(),
    }
}

fn is_number(word: &str) -> bool {
    word.bytes().all(|byte| byte.is_ascii_digit())
}

/// Whether there are only generic words and a side.
pub(super) fn is_generic(stem: &[String]) -> bool {
    stem.iter().all(|word| {
        let word = word.as_str();
        JOINT_WORDS.contains(&word)
            || GENERIC_WORDS.contains(&word)
            || ["left", "right", "l", "r"].contains(&word)
            || is_number(word)
    })
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum PoseComponent {
    /// Component of a position or of a rotation.
    Xyz(usize),
    /// Component of a position.
    Position(usize),
    /// Component of a rotation, or of a quaternion if there is also a w.
    Rotation(usize),
    /// x, y, z, w.
    Quaternion(usize),
    /// Index into [`ANGLE_LABELS`], and index within that triple.
    Label(usize, usize),
}

/// All components that a name may mean, each with the words that the components of one pose share.
pub(super) fn pose_components(name: &str) -> Vec<(Vec<String>, PoseComponent)> {
    let words = split_words(name);
    if is_other_quantity(&words) || is_gripper(&words) {
        return Vec::new();
    }
    let of_rotation = contains_any(&words, ROTATION_WORDS);
    let place = |all: &[&str], word: &str| all.iter().position(|axis| *axis == word);
    let mut found = Vec::new();
    for (at, word) in words.iter().enumerate() {
        let word = word.as_str();
        let before = |known: &str| words[..at].iter().any(|word| word == known);
        let mut axes: Vec<PoseComponent> = Vec::new();
        if let Some(of) = place(&["x", "y", "z"], word) {
            axes.push(match () {
                () if contains_any(&words, QUATERNION_WORDS) || before("q") => {
                    PoseComponent::Quaternion(of)
                }
                () if of_rotation || before("r") => PoseComponent::Rotation(of),
                () => PoseComponent::Xyz(of),
            });
        }
        for position in [["px", "py", "pz"], ["tx", "ty", "tz"]] {
            axes.extend(place(&position, word).map(PoseComponent::Position));
        }
        axes.extend(place(&["qx", "qy", "qz", "qw"], word).map(PoseComponent::Quaternion));
        if word == "w" && (of_rotation || before("q")) {
            axes.push(PoseComponent::Quaternion(3));
        } else {
            let labels = ANGLE_LABELS.iter().enumerate();
            axes.extend(
                labels.filter_map(|(label, all)| {
                    Some(PoseComponent::Label(label, place(all, word)?))
                }),
            );
        }
        let rest = words.iter().enumerate().filter(|(other, _)| *other != at);
        let key = pose_key(rest.map(|(_, word)| word));
        found.extend(axes.into_iter().map(|axis| (key.clone(), axis)));
    }
    found
}

/// Rotation encoding indicated by the names of its numbers.
pub(super) fn rotation_labels(names: &[&str]) -> Option<RotationLabels> {
    let has_axis = |name: &&str, wanted: PoseComponent| {
        pose_components(name).iter().any(|(_, axis)| *axis == wanted)
    };
    let is_all = |of: &dyn Fn(usize) -> PoseComponent| {
        names.iter().enumerate().all(|(at, name)| has_axis(name, of(at)))
    };
    let are_named = |known: &[&str]| names.iter().all(|name| has_word(name, known));
    let are_rotation_vectors = || names.iter().all(|name| is_rotation_vector(&split_words(name)));
    let label = |label: usize| is_all(&|at| PoseComponent::Label(label, at));
    match names.len() {
        4 if are_named(&["wxyz"]) => Some(RotationLabels::ScalarFirst),
        4 if are_named(&["xyzw"]) => Some(RotationLabels::Quaternion),
        4 => {
            let by_letter = |at| {
                if at < 3 { PoseComponent::Rotation(at) } else { PoseComponent::Quaternion(3) }
            };
            let is_it = is_all(&PoseComponent::Quaternion) || is_all(&by_letter);
            is_it.then_some(RotationLabels::Quaternion)
        }
        3 if label(1) || (are_named(&["rpy"]) && is_all(&PoseComponent::Rotation)) => {
            Some(RotationLabels::RollPitchYaw)
        }
        3 if are_rotation_vectors()
            && (is_all(&PoseComponent::Rotation) || are_in_one_column(names)) =>
        {
            Some(RotationLabels::RotationVector)
        }
        3 if label(4) => Some(RotationLabels::Abc),
        3 if label(5) => Some(RotationLabels::Wpr),
        3 if label(6) => Some(RotationLabels::Oat),
        _ => None,
    }
}

fn is_rotation_vector(words: &[String]) -> bool {
    let is_pair = |pair: &[String]| {
        matches!(pair[0].as_str(), "rot" | "rotation")
            && matches!(pair[1].as_str(), "vec" | "vector")
    };
    contains_any(words, ROTATION_VECTOR_WORDS) || words.windows(2).any(is_pair)
}

/// Whether the numbers of one column, or numbered ones, have these names.
fn are_in_one_column(names: &[&str]) -> bool {
    names.windows(2).all(|pair| {
        let is_next = || {
            let [(stem, number), (next, other)] = [numbered(pair[0])?, numbered(pair[1])?];
            Some(stem == next && number + 1 == other)
        };
        pair[0] == pair[1] || is_next() == Some(true)
    })
}

/// Words that name a pose, without those for parts and units.
pub(super) fn pose_key<'a>(words: impl IntoIterator<Item = &'a String>) -> Vec<String> {
    let is_of_part = |word: &str| {
        POSITION_WORDS.contains(&word)
            || ROTATION_WORDS.contains(&word)
            || is_unit(word)
            || ["q", "r", "matrix", "mat", "wxyz", "xyzw"].contains(&word)
    };
    let words: Vec<&String> = words.into_iter().collect();
    // `vector` of `rotation_vector`, but not of `tool_vector`.
    let is_vector_of_part = |at: usize| {
        matches!(words[at].as_str(), "vec" | "vecs" | "vector" | "vectors")
            && at > 0
            && is_of_part(words[at - 1])
    };
    let is_of_pose = |at: &usize| !is_of_part(words[*at]) && !is_vector_of_part(*at);
    (0..words.len()).filter(is_of_pose).map(|at| words[at].clone()).collect()
}

/// The part in a column of bare numbers, and the words that name the pose.
pub(super) fn pose_part(name: &str, width: usize) -> Option<(Vec<String>, PosePart)> {
    let words = split_words(name);
    // A hand's position is that of the tool.
    let is_gripper =
        is_gripper(&words) && !contains_any(&words, &["hand"]) && !is_gripper_in_base(&words);
    if is_other_quantity(&words) || contains_any(&words, &["joint", "joints"]) || is_gripper {
        return None;
    }
    let is_position = contains_any(&words, POSITION_WORDS);
    let part = match width {
        3 if contains_any(&words, ROTATION_WORDS) => PosePart::Rotation,
        4 if contains_any(&words, ROTATION_WORDS) => PosePart::Quaternion,
        9 if contains_any(&words, ROTATION_WORDS) && !is_position => PosePart::Matrix,
        3 if is_position || is_pose(&words) => PosePart::Position,
        _ => return None,
    };
    Some((pose_key(&words), part))
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum PosePart {
    Position,
    Rotation,
    Quaternion,
    Matrix,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is(name: &str) -> Vec<(String, PoseComponent)> {
        pose_components(name).into_iter().map(|(key, axis)| (key.join(" "), axis)).collect()
    }

    #[test]
    fn names_of_pose_components_are_identified() {
        for (name, key, axis) in [
            ("x", "", PoseComponent::Xyz(0)),
            ("tcp_qw", "tcp", PoseComponent::Quaternion(3)),
            ("pose.orientation.w", "pose", PoseComponent::Quaternion(3)),
            ("pose.position.y", "pose", PoseComponent::Xyz(1)),
            ("pose.orientation.x", "pose", PoseComponent::Rotation(0)),
            ("ee_roll_deg", "ee", PoseComponent::Label(1, 0)),
            ("A_RIst", "rist", PoseComponent::Label(4, 0)),
            ("W [deg]", "", PoseComponent::Label(5, 0)),
            ("A [Grad]", "", PoseComponent::Label(4, 0)),
            ("P", "", PoseComponent::Label(5, 1)),
            ("T", "", PoseComponent::Label(6, 2)),
            ("current_pos_x", "current", PoseComponent::Xyz(0)),
            ("goal_orientation_w", "goal", PoseComponent::Quaternion(3)),
            ("r_x", "", PoseComponent::Rotation(0)),
            ("Z_RSol", "rsol", PoseComponent::Xyz(2)),
            ("rot_x", "", PoseComponent::Rotation(0)),
        ] {
            assert!(is(name).contains(&(key.to_owned(), axis)), "{name}: {:?}", is(name));
        }
        for name in [
            "timestamp", "gripper", "vel_x", "q_1", "force_z", "shoulder_pan.pos", "U(95) X [mm]",
            "current_1",
        ] {
            assert_eq!(is(name), [], "{name}");
        }
    }

    #[test]
    fn joints_are_of_several_limbs() {
        let are = |names: &[&str]| {
            are_several_limbs(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
        };
        assert!(are(&["shoulder_pan", "shoulder_lift", "elbow", "wrist_1"]));
        assert!(are(&["joint_1", "joint_2", "joint_3", "joint_4"]));
        assert!(!are(&["elbow0", "elbow1", "elbow_d0", "elbow_d1"]));
    }

    #[test]
    fn numbered_joints_are_distinguished_from_other_columns() {
        for (name, is_joint) in [
            ("q1", true),
            ("actual_q_0", true),
            ("joint_3", true),
            ("J6", true),
            ("AIPos A1", true),
            ("observation.state.motor_2", true),
            ("C11", false),
            ("i4", false),
            ("JT4", true),
            ("field.position5", true),
            ("qd_3", false),
            ("torque_joint_1", false),
            ("q1_dot", false),
            ("q_dot_2", false),
            ("D_Theta_1", false),
            ("DD_Theta_1", false),
            ("dtheta3", false),
            ("field.dtau_J0", false),
            ("field.joint_collision2", false),
        ] {
            let found = numbered(name).is_some_and(|(stem, _)| is_stem_of_joints(&stem));
            assert_eq!(found, is_joint, "{name}");
        }
    }
}
