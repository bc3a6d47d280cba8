use std::fmt;

use crate::robot::{ChainError, RobotError};

/// Why a run has no arm to audit, or why the caller's options cannot be followed.
///
/// Each case says what is wrong, where, and what to do about it; its text is all three in one line.
#[derive(Debug)]
pub enum RunError {
    /// No topic holds joint states.
    NoJointStates {
        /// JointState topics that hold commands, not states.
        commands: Vec<String>,
        /// What the columns of a table leave open.
        question: Option<String>,
    },
    /// The joint states hold no finite sample of the joints that the arm needs.
    NoSamples {
        /// The robot.
        robot: String,
        /// Its joints.
        joints: Vec<String>,
    },
    /// There is no model of the robot.
    NoModel {
        /// Joints in the log.
        logged: Vec<String>,
    },
    /// Several catalogue arms have these joint names, and the log cannot tell them apart.
    Ambiguous {
        /// The arms.
        arms: Vec<String>,
    },
    /// A table does not name its joints, and no arm of the catalogue or more than one fits its poses.
    Numbered {
        /// How many there are.
        joints: usize,
        /// The arms that fit about as well.
        arms: Vec<String>,
        /// The arm that comes nearest and how near, if none fits.
        best: Option<String>,
    },
    /// The model's joints are not those of the log.
    UnknownJoints {
        /// The model.
        robot: String,
        /// Where it came from.
        source: String,
        /// Joints in the log.
        logged: Vec<String>,
        /// Joints of the model.
        modelled: Vec<String>,
        /// Options that would match them, of which the log does not say which it is.
        ways: Vec<String>,
    },
    /// Several catalogue arms, under other joint names, fit the log as well.
    SameMotion {
        /// The arms.
        arms: Vec<String>,
    },
    /// A `--joint-map` cannot be followed.
    JointMap {
        /// What is wrong with it.
        what: String,
    },
    /// A `--robot` is neither a file nor an arm of the catalogue.
    UnknownRobot {
        /// What was asked for.
        name: String,
        /// Catalogue names that come near.
        nearest: Vec<String>,
    },
    /// A model could not be read.
    Robot(RobotError),
    /// A calibration could not be read, or is not of the arm.
    Calibration(RobotError),
    /// A calibration whose arm is not in the log, or could be one of several.
    CalibrationOf {
        /// Where it was read from.
        source: String,
        /// What the joints of the arms that it could be of start with.
        prefixes: Vec<String>,
    },
    /// `--base` or `--tip` is no link of the robot.
    UnknownLink {
        /// The option: `--base` or `--tip`.
        option: &'static str,
        /// The name given.
        link: String,
        /// Where the model came from.
        source: String,
        /// Links whose names come near.
        nearest: Vec<String>,
    },
    /// No chain leads from base to tip.
    Chain(ChainError),
    /// Joints between base and tip that the joint states do not hold.
    MissingJoints {
        /// The base link.
        base: String,
        /// The tip link.
        tip: String,
        /// The joints.
        joints: Vec<String>,
    },
    /// A declared topic is not in the log, or holds nothing that the declaration fits.
    Declared {
        /// Where the caller declares it.
        place: String,
        /// What is wrong with it.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
}

impl RunError {
    /// Whether the caller's options are at fault, not what the log holds.
    pub(super) fn is_of_the_call(&self) -> bool {
        match self {
            Self::UnknownRobot { .. }
            | Self::Calibration(_)
            | Self::CalibrationOf { .. }
            | Self::UnknownLink { .. }
            | Self::Chain(_)
            | Self::MissingJoints { .. }
            | Self::JointMap { .. }
            | Self::Declared { .. } => true,
            Self::NoJointStates { .. }
            | Self::NoSamples { .. }
            | Self::NoModel { .. }
            | Self::Ambiguous { .. }
            | Self::Numbered { .. }
            | Self::SameMotion { .. }
            | Self::UnknownJoints { .. }
            | Self::Robot(_) => false,
        }
    }

    /// What is wrong.
    pub fn what(&self) -> String {
        match self {
            Self::NoJointStates { question: Some(question), .. } => question.clone(),
            Self::NoJointStates { commands, .. } if commands.is_empty() => {
                "the log has no joint states".to_owned()
            }
            Self::NoJointStates { commands, .. } => {
                format!("the log has joint commands ({}) but no joint states", few(commands))
            }
            Self::NoSamples { robot, joints } => {
                format!("no sample holds all joints of '{robot}' ({})", few(joints))
            }
            Self::NoModel { logged } => {
                format!("no robot model matches the joints {}", few(logged))
            }
            Self::Ambiguous { arms } => {
                format!(
                    "{} arms of the catalogue have these joint names: {}",
                    arms.len(),
                    few(arms)
                )
            }
            Self::Numbered { joints, best: Some(best), .. } => format!(
                "the table does not name its {joints} joints, and no arm of the catalogue fits its poses; nearest \
                 is {best}"
            ),
            Self::Numbered { joints, arms, .. } if arms.is_empty() => format!(
                "the table does not name its {joints} joints, and no pose that moves in it identifies the arm"
            ),
            Self::Numbered { joints, arms, .. } => format!(
                "the table does not name its {joints} joints, and {} arms of the catalogue fit its poses about \
                 equally: {}",
                arms.len(),
                few(arms)
            ),
            Self::UnknownJoints { robot, logged, modelled, .. } if modelled.is_empty() => {
                format!("'{robot}' has no joint that moves: the log has {}", few(logged))
            }
            Self::UnknownJoints { robot, logged, modelled, ways, .. } => {
                let said = match ways.as_slice() {
                    [] => String::new(),
                    [way] => format!("; in their order the poses do not fit ({way})"),
                    ways => format!("; {} ways fit as well: {}", ways.len(), ways.join(" or ")),
                };
                let (logged, modelled) = (few(logged), few(modelled));
                format!("joint names differ: the log has {logged}, {robot} has {modelled}{said}")
            }
            Self::SameMotion { arms } => format!(
                "the joints have names of no arm of the catalogue, and in their order {} arms fit as well: {}",
                arms.len(),
                few(arms)
            ),
            Self::JointMap { what } => what.clone(),
            Self::UnknownRobot { name, nearest } => {
                format!(
                    "'{name}' is neither a file nor an arm of the catalogue{}",
                    did_you_mean(nearest)
                )
            }
            Self::Robot(error) | Self::Calibration(error) => error.problem().to_string(),
            Self::CalibrationOf { prefixes, .. } if prefixes.is_empty() => {
                "no arm of the log has the joints of a UR that it could be of".to_owned()
            }
            Self::CalibrationOf { prefixes, .. } => {
                let arms: Vec<String> = prefixes.iter().map(|it| format!("'{it}'")).collect();
                format!("it could be of several arms, whose joints start with {}", few(&arms))
            }
            Self::UnknownLink { option, link, nearest, .. } => {
                format!("{option} '{link}' is not a link of the robot{}", did_you_mean(nearest))
            }
            Self::Chain(error) => error.to_string(),
            Self::MissingJoints { base, tip, joints } => {
                format!(
                    "the joint states lack joints between '{base}' and '{tip}': {}",
                    few(joints)
                )
            }
            Self::Declared { what, .. } => what.clone(),
        }
    }

    /// Where it is wrong: a file with its line, a topic, an option.
    pub fn place(&self) -> String {
        match self {
            Self::NoJointStates { .. }
            | Self::NoModel { .. }
            | Self::Ambiguous { .. }
            | Self::Numbered { .. }
            | Self::SameMotion { .. } => "the log".to_owned(),
            Self::JointMap { .. } => "--joint-map".to_owned(),
            Self::NoSamples { .. } | Self::MissingJoints { .. } => "joint states".to_owned(),
            Self::UnknownJoints { source, .. } | Self::UnknownLink { source, .. } => source.clone(),
            Self::UnknownRobot { .. } => "--robot".to_owned(),
            Self::Robot(error) | Self::Calibration(error) => error.place(),
            Self::CalibrationOf { source, .. } => source.clone(),
            Self::Chain(_) => "--base, --tip".to_owned(),
            Self::Declared { place, .. } => place.clone(),
        }
    }

    /// What the reader of the message can do, as a short clause.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NoJointStates { question: Some(_), .. } => {
                "say it in the config of --config, or name the arm with --robot"
            }
            Self::NoJointStates { .. } => {
                "record the topic /joint_states (sensor_msgs/JointState), or name a table's columns in [columns] of the \
                 config"
            }
            Self::NoSamples { .. } => "record the joint states of the whole arm",
            Self::NoModel { .. } => {
                "pass --robot FILE with the arm's URDF, or --robot NAME of the catalogue, such as ur5e"
            }
            Self::Ambiguous { .. } | Self::Numbered { .. } | Self::SameMotion { .. } => {
                "pass --robot NAME with the one it is"
            }
            Self::JointMap { .. } => {
                "write --joint-map LOG=MODEL,… with names of the log and of the model"
            }
            Self::UnknownJoints { .. } => {
                "say which is which with --joint-map LOG=MODEL,…, or pass the --robot that was recorded"
            }
            Self::UnknownRobot { .. } => {
                "pass a URDF or TOML file, or a name of the catalogue, such as ur5e"
            }
            Self::Robot(error) | Self::Calibration(error) => error.problem().advice(),
            Self::CalibrationOf { prefixes, .. } if prefixes.is_empty() => {
                "leave --calibration out, or name the --robot that was recorded"
            }
            Self::CalibrationOf { .. } => "say which: --calibration PREFIX=FILE",
            Self::UnknownLink { .. } => "name a link of the model, or leave the option out",
            Self::Chain(_) => "or leave --base and --tip out",
            Self::MissingJoints { .. } => "choose a tip before these joints, or record them",
            Self::Declared { remedy, .. } => remedy,
        }
    }
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place(), self.what(), self.remedy())
    }
}

impl std::error::Error for RunError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Robot(error) | Self::Calibration(error) => std::error::Error::source(error),
            _ => None,
        }
    }
}

impl From<RobotError> for RunError {
    fn from(error: RobotError) -> Self {
        Self::Robot(error)
    }
}

impl From<ChainError> for RunError {
    fn from(error: ChainError) -> Self {
        Self::Chain(error)
    }
}

/// The first few of `names`, and how many more there are.
fn few(names: &[String]) -> String {
    const SHOWN: usize = 8;
    // One more takes no more room than to say so.
    let count = if names.len() == SHOWN + 1 { names.len() } else { SHOWN };
    let shown = names.iter().take(count).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len().saturating_sub(count) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

fn did_you_mean(nearest: &[String]) -> String {
    match nearest {
        [] => String::new(),
        names => format!(" (did you mean '{}'?)", names.join("' or '")),
    }
}
