//! What the caller says of topics: their roles, frames, witnesses and rates.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::robot::nearest;
use crate::stream::Columns;

use super::arm::Arm;
use super::error::RunError;
use super::role::{Place, Role};
use super::streams::Stream;
use super::tf_tree::{TfTree, without_slash};
use super::witness::Witness;

/// What the caller says of one topic, beside how its numbers are coded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopicSettings {
    /// The topic.
    pub topic: String,
    /// Where the caller says it, as errors and reasons name it.
    pub place: String,
    /// The part that it plays.
    pub role: Option<SaidRole>,
    /// Whose word its poses are.
    pub witness: Option<Witness>,
    /// The frame that its poses are in, or an IMU's own frame.
    pub frame: Option<String>,
    /// The link whose poses they are.
    pub link: Option<String>,
    /// How often it should come, Hz.
    pub rate_hz: Option<f64>,
    /// What its numbers are by whom the caller says it is from, for the stream's reason.
    pub vendor: Option<String>,
    /// Whether it is made of columns of a table: a log that is none has no such topic.
    pub of_columns: bool,
}

impl TopicSettings {
    /// Whether it is about this topic.
    pub fn is_of(&self, topic: &str) -> bool {
        self.topic.trim_start_matches('/') == topic.trim_start_matches('/')
    }

    /// Whether the log should hold the topic.
    pub fn is_expected(&self) -> bool {
        let plays = |role| !matches!(role, SaidRole::Ignored | SaidRole::Reference);
        !self.of_columns && self.role.map_or(self.rate_hz.is_some(), plays)
    }

    fn refused(&self, what: String, remedy: &'static str) -> RunError {
        RunError::Declared { place: self.place.clone(), what, remedy }
    }
}

/// A part that a caller may give to a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SaidRole {
    /// Joint states.
    Joints,
    /// A measured pose of the tool.
    Pose,
    /// A command, goal or plan.
    Reference,
    /// What a camera sees.
    Target,
    /// Transforms over time.
    Tf,
    /// Transforms that hold at all times.
    TfStatic,
    /// An inertial measurement unit.
    Imu,
    /// A description of the robot.
    Description,
    /// Of no use to this audit.
    Ignored,
}

impl SaidRole {
    /// Every role, in the order in which they are listed.
    pub const ALL: [Self; 9] = [
        Self::Joints,
        Self::Pose,
        Self::Reference,
        Self::Target,
        Self::Tf,
        Self::TfStatic,
        Self::Imu,
        Self::Description,
        Self::Ignored,
    ];

    /// Its name, as reports and configs spell it.
    pub const fn name(self) -> &'static str {
        self.role().name()
    }

    /// The role that it gives.
    pub(super) const fn role(self) -> Role {
        match self {
            Self::Joints => Role::Joints,
            Self::Pose => Role::Pose,
            Self::Reference => Role::Reference,
            Self::Target => Role::Target,
            Self::Tf => Role::Tf,
            Self::TfStatic => Role::TfStatic,
            Self::Imu => Role::Imu,
            Self::Description => Role::Description,
            Self::Ignored => Role::Ignored,
        }
    }

    /// Whether content of this kind can play it.
    fn fits(self, columns: &Columns) -> bool {
        match columns {
            Columns::Joints(_) => matches!(self, Self::Joints | Self::Reference | Self::Ignored),
            Columns::Poses(_) | Columns::Array(_) => {
                matches!(self, Self::Pose | Self::Reference | Self::Target | Self::Ignored)
            }
            Columns::Transforms(_) => matches!(self, Self::Tf | Self::TfStatic | Self::Ignored),
            Columns::Imu(_) => matches!(self, Self::Imu | Self::Ignored),
            Columns::Text(_) => matches!(self, Self::Description | Self::Ignored),
        }
    }
}

/// What columns hold, in words.
fn content(columns: &Columns) -> &'static str {
    match columns {
        Columns::Joints(_) => "joint states",
        Columns::Poses(_) => "poses",
        Columns::Transforms(_) => "transforms",
        Columns::Imu(_) => "inertial measurements",
        Columns::Array(_) => "bare numbers",
        Columns::Text(_) => "text",
    }
}

/// Takes over what the caller says of the streams, before anything is told from their names. Topics
/// that the log does not hold are passed over.
///
/// # Errors
/// Where a topic cannot be what it is said to be.
pub(super) fn apply(settings: &[TopicSettings], streams: &mut [Stream]) -> Result<(), RunError> {
    for said in settings {
        for stream in streams.iter_mut().filter(|stream| said.is_of(&stream.topic)) {
            apply_to(said, stream)?;
        }
    }
    Ok(())
}

fn apply_to(said: &TopicSettings, stream: &mut Stream) -> Result<(), RunError> {
    const ROLE: &str = "see with `poseaudit info` what the topic holds";
    stream.said_hz = said.rate_hz;
    if said.role == Some(SaidRole::Ignored) {
        (stream.role, stream.is_empty, stream.columns) = (Role::Ignored, false, None);
        stream.reason = format!("its role is set ({})", said.place);
        return Ok(());
    }
    let Some(columns) = &stream.columns else { return Ok(()) };
    if let Some(role) = said.role {
        if !role.fits(columns) {
            let what = format!(
                "'{}' holds {} and cannot have the role `{}`",
                stream.topic,
                content(columns),
                role.name()
            );
            return Err(said.refused(what, ROLE));
        }
        stream.role = role.role();
        stream.reason = format!("its role is set ({})", said.place);
    }
    let has_link = matches!(columns, Columns::Poses(_) | Columns::Array(_));
    let has_frame = has_link || matches!(columns, Columns::Imu(_));
    for (key, name, has) in [("frame", &said.frame, has_frame), ("link", &said.link, has_link)] {
        if name.is_some() && !has {
            let what =
                format!("'{}' holds {}, which have no `{key}`", stream.topic, content(columns));
            return Err(said.refused(what, ROLE));
        }
    }
    if let Some(frame) = &said.frame {
        stream.frame_id = without_slash(frame).to_owned();
    }
    if let Some(link) = &said.link {
        stream.child_frame_id = without_slash(link).to_owned();
    }
    Ok(())
}

/// Holds the frames and links that the caller names against those that there are.
///
/// # Errors
/// Where a link is none of an arm, or a frame looks like a misspelt one. A frame that is like none is
/// one that nothing ties to the robot.
pub(super) fn check_frames(
    settings: &[TopicSettings],
    streams: &[Stream],
    arms: &[Arm],
    tf: &TfTree,
) -> Result<(), RunError> {
    const REMEDY: &str = "name a link of the robot or a frame of the log";
    if arms.is_empty() {
        return Ok(());
    }
    let is_known = |name: &str| arms.iter().any(|arm| arm.place(name).0 != Place::Unknown);
    for said in settings.iter().filter(|said| streams.iter().any(|one| said.is_of(&one.topic))) {
        let links = arms.iter().flat_map(|arm| arm.robot.links().map(|link| arm.frame_of(link)));
        let known: Vec<String> = links.chain(tf.frames().map(str::to_owned)).collect();
        for (key, name) in [("frame", &said.frame), ("link", &said.link)] {
            let Some(name) = name.as_deref().map(without_slash) else { continue };
            if is_known(name) || known.iter().any(|frame| frame == name) {
                continue;
            }
            let near = nearest(name, known.iter().map(String::as_str));
            if let Some(near) = near.first() {
                let what = format!("{key} '{name}' is unknown; did you mean '{near}'?");
                return Err(said.refused(what, REMEDY));
            }
            if key == "link" {
                return Err(said.refused(format!("link '{name}' is no link of an arm"), REMEDY));
            }
        }
    }
    Ok(())
}
