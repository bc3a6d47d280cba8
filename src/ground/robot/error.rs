//! Errors of models and chains, with place and advice.

use std::fmt;

use super::joint::JointKind;

pub(super) type Located = (usize, Problem);

/// Error of reading a robot model.
#[derive(Debug)]
pub struct RobotError {
    file: String,
    line: Option<usize>,
    problem: Problem,
}

impl RobotError {
    pub(super) fn new(file: &str, line: Option<usize>, problem: Problem) -> Self {
        Self { file: file.to_owned(), line, problem }
    }

    pub(super) fn located(file: &str, text: &str, (offset, problem): Located) -> Self {
        let before = &text.as_bytes()[..offset.min(text.len())];
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        Self::new(file, Some(line), problem)
    }

    /// `arm.urdf:12`; without the line if unknown.
    pub fn place(&self) -> String {
        match self.line {
            Some(line) => format!("{}:{line}", self.file),
            None => self.file.clone(),
        }
    }

    /// Names link, joint and value.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }
}

impl fmt::Display for RobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place(), self.problem, self.problem.advice())
    }
}

impl std::error::Error for RobotError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        std::error::Error::source(&self.problem)
    }
}

/// Problem in a model's text.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages document the variants")]
pub enum Problem {
    #[error("cannot be read as text")]
    Unreadable(#[source] std::io::Error),
    #[error("cannot be read as text")]
    UnreadableCalibration(#[source] std::io::Error),
    #[error("not a calibration of a UR: {0}")]
    Calibration(String),
    #[error("'{robot}' has no joint '{joint}', which every UR has")]
    NoSuchJoint { robot: String, joint: String },
    #[error(
        "not the calibration of '{robot}': joint '{joint}' would move by {millimetres:.1} mm and \
         {degrees:.2}°"
    )]
    AnotherArm { robot: String, joint: String, millimetres: f64, degrees: f64 },
    #[error("not well-formed XML: {0}")]
    Xml(String),
    #[error("document type declares entities, which are not supported")]
    DocumentType,
    #[error("it has more than {limit} {what}")]
    TooMuch { what: &'static str, limit: usize },
    #[error("the XML's root element is <{found}>, not <robot>")]
    NotARobot { found: String },
    #[error("{found} is a leftover of xacro")]
    Xacro { found: String },
    #[error("not a robot in TOML: {0}")]
    Toml(String),
    #[error("units are \"{found}\", not \"m, rad\"")]
    Units { found: String },
    #[error("{found} of [dh] for {rows} rows")]
    DhCount { found: String, rows: usize },
    #[error("dof = {stated}, but {counted} joints can move")]
    Dof { stated: usize, counted: usize },
    #[error("the file has neither [[joint]] nor [dh]")]
    NoKinematics,
    #[error("the model has no link")]
    NoLink,
    #[error("{element} has no {missing}")]
    Missing { element: String, missing: &'static str },
    #[error("{element}: {attribute}=\"{found}\" is not {expected}")]
    Number { element: String, attribute: &'static str, found: String, expected: &'static str },
    #[error("{element} has a number that is not finite, or beyond 1000000")]
    NotFinite { element: String },
    #[error(
        "joint '{joint}' of link '{link}' has the number {found:e}; the largest allowed is {most}"
    )]
    Beyond { joint: String, link: String, found: f64, most: f64 },
    #[error("joint '{joint}': the axis is zero")]
    ZeroAxis { joint: String },
    #[error("joint '{joint}': type \"{found}\" is unknown")]
    JointType { joint: String, found: String },
    #[error("a second {what} is named '{name}'")]
    DuplicateName { what: &'static str, name: String },
    #[error("joint '{joint}': its {end} link '{link}' is not declared")]
    UnknownLink { joint: String, end: &'static str, link: String },
    #[error("link '{link}' is the child of two joints, '{first}' and '{second}'")]
    TwoParents { link: String, first: String, second: String },
    #[error("two links have no parent joint: '{first}' and '{second}'")]
    TwoRoots { first: String, second: String },
    #[error("joint '{joint}' closes a loop")]
    Loop { joint: String },
    #[error("the {what} '{name}' is not a link of the model")]
    NamedLink { what: &'static str, name: String },
}

impl Problem {
    /// Suggested action.
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Unreadable(_) => "check that it exists and is a URDF or a TOML file",
            Self::UnreadableCalibration(_) | Self::Calibration(_) => {
                "give the YAML that ur_calibration extracts from the controller"
            }
            Self::NoSuchJoint { .. } => "use it with a UR, and with its prefix: PREFIX=FILE",
            Self::AnotherArm { .. } => {
                "use this arm's calibration, or a model with the frames of ur_description"
            }
            Self::Xml(_) => "repair the file, or export the URDF again",
            Self::DocumentType => "expand it first: xmllint --noent --dropdtd FILE",
            Self::TooMuch { .. } => "provide a model with links and joints only",
            Self::NotARobot { .. } => "give the arm's URDF (not an SDF, SRDF or MJCF file)",
            Self::Xacro { .. } => "expand it first: xacro FILE.xacro > FILE.urdf",
            Self::Toml(_) => "compare it with an arm of the catalogue",
            Self::Units { .. } => "convert the numbers to metres and radians",
            Self::DhCount { .. } => "give one per row",
            Self::Dof { .. } => "correct dof, or the joints' types",
            Self::NoKinematics => "add one of the two",
            Self::NoLink => "give the URDF itself (an SRDF has only groups)",
            Self::Missing { .. } => "add it",
            Self::Number { .. } | Self::NotFinite { .. } | Self::Beyond { .. } => {
                "correct the number"
            }
            Self::ZeroAxis { .. } => "give the axis a direction",
            Self::JointType { .. } => {
                "use revolute, continuous, prismatic, fixed, floating or planar"
            }
            Self::DuplicateName { .. } => "rename one of them",
            Self::UnknownLink { .. } => "add the link, or correct its name",
            Self::TwoParents { .. } => "remove one of the joints: a URDF is a tree",
            Self::TwoRoots { .. } => "join them by a joint",
            Self::Loop { .. } => "remove the joint: a URDF is a tree",
            Self::NamedLink { .. } => "correct the name",
        }
    }
}

/// Error of building the chain between two links.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages document the variants")]
pub enum ChainError {
    #[error("robot '{robot}' has no link '{link}'; try '{}'", instead.join("' or '"))]
    UnknownLink { robot: String, link: String, instead: Vec<String> },
    #[error("base and tip are the same link '{link}'; choose another tip")]
    SameLink { link: String },
    #[error(
        "no joint between '{base}' and '{tip}' can move; \
         choose a base and a tip that the arm's joints lie between"
    )]
    NothingMoves { base: String, tip: String },
    #[error(
        "joint '{joint}' between base and tip is {}; \
         choose a base and a tip on the same side of it",
        kind.name()
    )]
    NotOneCoordinate { joint: String, kind: JointKind },
    #[error(
        "joint '{joint}' mimics '{master}', which {why}; \
         correct its <mimic>, or choose a tip before it"
    )]
    Mimic { joint: String, master: String, why: &'static str },
}
