use std::fmt;

use crate::robot::{ChainError, RobotError};

/// Why a run has no arm, or why the options are invalid.
///
/// Each text gives the place, the problem and the remedy in one line.
#[derive(Debug)]
pub enum RunError {
    /// No topic contains joint states.
    NoJointStates {
        /// JointState topics that contain commands.
        commands: Vec<String>,
        /// Unresolved ambiguity of a table's columns.
        question: Option<String>,
        /// Whether the log consists of tables.
        is_of_tables: bool,
        /// Whether the caller named the robot.
        is_robot_named: bool,
    },
    /// No finite sample has all joints of the arm.
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
    /// Several catalogue arms have these joint names.
    Ambiguous {
        /// The arms.
        arms: Vec<String>,
    },
    /// Several of them, by different makers, fit the poses equally well.
    Undistinguished {
        /// The arms.
        arms: Vec<String>,
    },
    /// A table's joints are unnamed, and its poses fit no catalogue arm, or several.
    Numbered {
        /// Number of joints.
        joints: usize,
        /// The arms that fit equally well.
        arms: Vec<String>,
        /// The closest arm and its residual, if none fits.
        best: Option<String>,
        /// Whether the tool moves too little to distinguish arms.
        is_at_rest: bool,
    },
    /// Joint names differ between model and log.
    UnknownJoints {
        /// The model.
        robot: String,
        /// Source of the model.
        source: String,
        /// Joints in the log.
        logged: Vec<String>,
        /// Joints of the model.
        modelled: Vec<String>,
        /// Options that match them.
        matches: Vec<String>,
    },
    /// Several catalogue arms with other joint names fit equally well.
    SameMotion {
        /// The arms.
        arms: Vec<String>,
    },
    /// Invalid `--joint-map`.
    JointMap {
        /// The problem.
        what: String,
    },
    /// A `--robot` that is neither file nor catalogue arm.
    UnknownRobot {
        /// The given name.
        name: String,
        /// Similar catalogue names.
        nearest: Vec<String>,
    },
    /// A model could not be read.
    Robot(RobotError),
    /// An invalid calibration, or one of a different arm.
    Calibration(RobotError),
    /// A calibration matches no arm of the log, or several.
    CalibrationOf {
        /// Source of the calibration.
        source: String,
        /// Joint prefixes of the arms that it matches.
        prefixes: Vec<String>,
    },
    /// `--base` or `--tip` is not a link of the robot.
    UnknownLink {
        /// The option: `--base` or `--tip`.
        option: &'static str,
        /// The given name.
        link: String,
        /// Source of the model.
        source: String,
        /// Links with similar names.
        nearest: Vec<String>,
    },
    /// No chain connects base and tip.
    Chain(ChainError),
    /// Joints between base and tip are not logged.
    MissingJoints {
        /// The base link.
        base: String,
        /// The tip link.
        tip: String,
        /// The joints.
        joints: Vec<String>,
    },
    /// Tables of one run have different time origins, and the motion does not show the offset.
    TimeOrigins {
        /// The problem.
        what: String,
    },
    /// A declaration without a topic, or that does not fit its messages.
    Declared {
        /// Source of the declaration.
        place: String,
        /// The problem.
        what: String,
        /// The remedy.
        remedy: &'static str,
    },
}

impl RunError {
    pub(super) fn is_of_the_call(&self) -> bool {
        matches!(
            self,
            Self::UnknownRobot { .. }
                | Self::Calibration(_)
                | Self::CalibrationOf { .. }
                | Self::UnknownLink { .. }
                | Self::Chain(_)
                | Self::MissingJoints { .. }
                | Self::JointMap { .. }
                | Self::Declared { .. }
        )
    }

    /// The problem.
    pub fn what(&self) -> String {
        match self {
            Self::NoJointStates { question: Some(question), .. } => question.clone(),
            Self::NoJointStates { commands, is_of_tables, .. } if commands.is_empty() => {
                match is_of_tables {
                    true => {
                        "no columns hold joint positions, by their names and numbers".to_owned()
                    }
                    false => "the log has no joint states".to_owned(),
                }
            }
            Self::NoJointStates { commands, .. } => {
                format!("the log has joint commands ({}) but no joint states", few(commands))
            }
            Self::NoSamples { robot, joints } => {
                format!("no sample contains all joints of '{robot}' ({})", few(joints))
            }
            Self::NoModel { logged } => {
                format!("no robot model matches the joints {}", few(logged))
            }
            Self::Ambiguous { arms } => {
                format!("{} catalogue arms have these joint names: {}", arms.len(), few(arms))
            }
            Self::Undistinguished { arms } => format!(
                "this motion does not distinguish {} catalogue arms with these joint names: {}",
                arms.len(),
                few(arms)
            ),
            Self::Numbered { joints, best: Some(best), .. } => format!(
                "the table does not name its {joints} joints, and no catalogue arm fits its poses; closest: \
                 {best}"
            ),
            Self::Numbered { joints, arms, .. } if arms.is_empty() => format!(
                "the table does not name its {joints} joints, and has no moving pose that identifies the arm"
            ),
            Self::Numbered { joints, arms, is_at_rest, .. } => format!(
                "the table does not name its {joints} joints, and {} catalogue arms fit its poses about \
                 equally well{}: {}",
                arms.len(),
                if *is_at_rest { ", because the tool hardly moves" } else { "" },
                few(arms)
            ),
            Self::UnknownJoints { robot, logged, modelled, .. } if modelled.is_empty() => {
                format!("'{robot}' has no movable joint, but the log has {}", few(logged))
            }
            Self::UnknownJoints { robot, logged, modelled, matches, .. } => {
                let alternatives = match matches.as_slice() {
                    [] => String::new(),
                    [way] => format!("; matched by order, the poses do not fit ({way})"),
                    matches => {
                        format!(
                            "; {} ways fit equally well: {}",
                            matches.len(),
                            matches.join(" or ")
                        )
                    }
                };
                let (logged, modelled) = (few(logged), few(modelled));
                format!(
                    "joint names differ: the log has {logged}, {robot} has {modelled}{alternatives}"
                )
            }
            Self::SameMotion { arms } => format!(
                "no catalogue arm has these joint names, and {} arms fit equally well in their order: {}",
                arms.len(),
                few(arms)
            ),
            Self::JointMap { what } | Self::TimeOrigins { what } => what.clone(),
            Self::UnknownRobot { name, nearest } => {
                format!("'{name}' is neither a file nor a catalogue arm{}", did_you_mean(nearest))
            }
            Self::Robot(error) | Self::Calibration(error) => error.problem().to_string(),
            Self::CalibrationOf { prefixes, .. } if prefixes.is_empty() => {
                "no arm of the log has UR joints that it could belong to".to_owned()
            }
            Self::CalibrationOf { prefixes, .. } => {
                let arms: Vec<String> = prefixes.iter().map(|it| format!("'{it}'")).collect();
                format!(
                    "it could belong to several arms, whose joint names start with {}",
                    few(&arms)
                )
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

    /// File with line, topic, or option.
    pub fn place(&self) -> String {
        match self {
            Self::NoJointStates { .. }
            | Self::NoModel { .. }
            | Self::Ambiguous { .. }
            | Self::Undistinguished { .. }
            | Self::Numbered { .. }
            | Self::TimeOrigins { .. }
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

    /// Suggested action, as a clause.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NoJointStates { question: Some(_), is_robot_named: true, .. } => {
                "pass that option"
            }
            Self::NoJointStates { question: Some(_), .. } => {
                "pass that option, and name the arm with --robot"
            }
            Self::NoJointStates { is_of_tables: true, .. } => {
                "record the joint positions in the same run, or name their columns with --columns \
                 (docs/datasets.md); to compare two streams of poses, state the encoding of both, as in \
                 --declare TOPIC=rotvec,mm"
            }
            Self::NoJointStates { .. } => "record the topic /joint_states (sensor_msgs/JointState)",
            Self::NoSamples { .. } => "record the joint states of the whole arm",
            Self::NoModel { .. } => {
                "pass --robot FILE with the arm's URDF, or --robot NAME from the catalogue, such as ur5e"
            }
            Self::Numbered { arms, .. } if arms.is_empty() => {
                "pass --robot FILE with the arm's URDF or DH table, or --robot NAME if the catalogue has it \
                 (`poseaudit robots`)"
            }
            Self::Ambiguous { .. }
            | Self::Undistinguished { .. }
            | Self::Numbered { .. }
            | Self::SameMotion { .. } => {
                "pass --robot NAME with the correct one, or --robot FILE with another arm's URDF or DH table"
            }
            Self::TimeOrigins { .. } => {
                "write the same clock into all files, or audit them separately"
            }
            Self::JointMap { .. } => {
                "write --joint-map LOG=MODEL,… with joint names of the log and of the model"
            }
            Self::UnknownJoints { .. } => {
                "map them with --joint-map LOG=MODEL,…, or pass the --robot that was recorded"
            }
            Self::UnknownRobot { .. } => {
                "pass a URDF or TOML file, or a catalogue name such as ur5e"
            }
            Self::Robot(error) | Self::Calibration(error) => error.problem().advice(),
            Self::CalibrationOf { prefixes, .. } if prefixes.is_empty() => {
                "omit --calibration, or name the --robot that was recorded"
            }
            Self::CalibrationOf { .. } => "select one with --calibration PREFIX=FILE",
            Self::UnknownLink { .. } => "name a link of the model, or omit the option",
            Self::Chain(_) => "or omit --base and --tip",
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

fn few(names: &[String]) -> String {
    const SHOWN: usize = 8;
    // One more name is as short as the remark.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_file_is_asked_for_if_no_catalogue_arm_fits() {
        let remedy = |arms: &[&str], best: Option<&str>| {
            let error = RunError::Numbered {
                joints: 7,
                arms: arms.iter().map(|&arm| arm.to_owned()).collect(),
                best: best.map(str::to_owned),
                is_at_rest: false,
            };
            error.remedy()
        };
        for best in [None, Some("iiwa7, 41.2 mm")] {
            assert!(remedy(&[], best).starts_with("pass --robot FILE"), "{best:?}");
        }
        assert!(remedy(&["ur3e", "ur5e"], None).starts_with("pass --robot NAME"));
    }
}
