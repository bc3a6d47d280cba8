//! The caller's topic settings.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::robot::nearest;
use crate::stream::Columns;

use super::arm::Arm;
use super::error::RunError;
use super::role::{FrameKind, Role};
use super::source_kind::PoseSourceKind;
use super::streams::Stream;
use super::tf_tree::{TfTree, strip_slash};

/// The caller's settings for one topic, except its encoding.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopicSettings {
    /// The topic.
    pub topic: String,
    /// Source of the settings, for messages.
    pub place: String,
    /// Its role.
    pub role: Option<RoleSetting>,
    /// Source of its poses.
    pub source_kind: Option<PoseSourceKind>,
    /// Frame of its poses, or of an IMU.
    pub frame: Option<String>,
    /// Link whose poses they are.
    pub link: Option<String>,
    /// Expected rate, Hz.
    pub rate_hz: Option<f64>,
    /// The vendor's encoding, for the reason.
    pub vendor: Option<String>,
    /// Whether it consists of table columns, which other logs may lack.
    pub of_columns: bool,
}

impl TopicSettings {
    /// Whether they apply to this topic.
    pub fn is_of(&self, topic: &str) -> bool {
        self.topic.trim_start_matches('/') == topic.trim_start_matches('/')
    }

    /// Whether the log should contain the topic.
    pub fn is_expected(&self) -> bool {
        let plays = |role| !matches!(role, RoleSetting::Ignored | RoleSetting::Reference);
        !self.of_columns && self.role.map_or(self.rate_hz.is_some(), plays)
    }

    fn refused(&self, what: String, remedy: &'static str) -> RunError {
        RunError::Declared { place: self.place.clone(), what, remedy }
    }
}

/// A role that the caller can assign to a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "SaidRole")]
pub enum RoleSetting {
    /// Joint states.
    Joints,
    /// A measured tool pose.
    Pose,
    /// A command, goal or plan.
    Reference,
    /// A camera detection.
    Target,
    /// Dynamic transforms.
    Tf,
    /// Static transforms.
    TfStatic,
    /// An inertial measurement unit.
    Imu,
    /// A robot description.
    Description,
    /// Not used by this audit.
    Ignored,
}

impl RoleSetting {
    /// All roles, in listing order.
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

    /// Name in reports and configs.
    pub const fn name(self) -> &'static str {
        self.role().name()
    }

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

/// Applies the caller's settings before names are used; skips missing topics.
///
/// # Errors
/// If a topic's content does not fit its settings.
pub(super) fn apply(settings: &[TopicSettings], streams: &mut [Stream]) -> Result<(), RunError> {
    for topic_settings in settings {
        for stream in streams.iter_mut().filter(|stream| topic_settings.is_of(&stream.topic)) {
            apply_to(topic_settings, stream)?;
        }
    }
    Ok(())
}

fn apply_to(topic_settings: &TopicSettings, stream: &mut Stream) -> Result<(), RunError> {
    const ROLE: &str = "check the content of the topic with `poseaudit info`";
    stream.expected_hz = topic_settings.rate_hz;
    if topic_settings.role == Some(RoleSetting::Ignored) {
        (stream.role, stream.is_empty, stream.columns) = (Role::Ignored, false, None);
        stream.reason = format!("its role is set ({})", topic_settings.place);
        return Ok(());
    }
    let Some(columns) = &stream.columns else { return Ok(()) };
    if let Some(role) = topic_settings.role {
        if !role.fits(columns) {
            let what = format!(
                "'{}' contains {} and cannot have the role `{}`",
                stream.topic,
                content(columns),
                role.name()
            );
            return Err(topic_settings.refused(what, ROLE));
        }
        stream.role = role.role();
        stream.reason = format!("its role is set ({})", topic_settings.place);
    }
    let has_link = matches!(columns, Columns::Poses(_) | Columns::Array(_));
    let has_frame = has_link || matches!(columns, Columns::Imu(_));
    for (key, name, has) in
        [("frame", &topic_settings.frame, has_frame), ("link", &topic_settings.link, has_link)]
    {
        if name.is_some() && !has {
            let what =
                format!("'{}' contains {}, which have no `{key}`", stream.topic, content(columns));
            return Err(topic_settings.refused(what, ROLE));
        }
    }
    if let Some(frame) = &topic_settings.frame {
        stream.frame_id = strip_slash(frame).to_owned();
    }
    if let Some(link) = &topic_settings.link {
        stream.child_frame_id = strip_slash(link).to_owned();
    }
    Ok(())
}

/// Checks the caller's frames and links.
///
/// # Errors
/// If a link is not part of an arm, or a frame looks misspelt. A frame without similar names counts as
/// untied to the robot.
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
    let is_known =
        |name: &str| arms.iter().any(|arm| arm.classify_frame(name).0 != FrameKind::Unknown);
    for topic_settings in settings
        .iter()
        .filter(|topic_settings| streams.iter().any(|one| topic_settings.is_of(&one.topic)))
    {
        let links = arms.iter().flat_map(|arm| arm.robot.links().map(|link| arm.frame_of(link)));
        let known: Vec<String> = links.chain(tf.frames().map(str::to_owned)).collect();
        for (key, name) in [("frame", &topic_settings.frame), ("link", &topic_settings.link)] {
            let Some(name) = name.as_deref().map(strip_slash) else { continue };
            if is_known(name) || known.iter().any(|frame| frame == name) {
                continue;
            }
            let near = nearest(name, known.iter().map(String::as_str));
            if let Some(near) = near.first() {
                let what = format!("{key} '{name}' is unknown; did you mean '{near}'?");
                return Err(topic_settings.refused(what, REMEDY));
            }
            if key == "link" {
                return Err(topic_settings
                    .refused(format!("link '{name}' is not a link of an arm"), REMEDY));
            }
        }
    }
    Ok(())
}
