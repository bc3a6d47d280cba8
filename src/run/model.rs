//! A model as it stands for an arm of the log.

use std::collections::BTreeSet;

use super::declaration::JointName;
use super::role::words;
use super::space::{Claim, Space};
use crate::robot::{LinkId, Robot, catalogue};

/// A robot of the log.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// The robot, its joints named as in the log.
    pub robot: Robot,
    /// How it was found, in words.
    pub found: String,
    /// How the log names its links.
    pub frames: FrameNames,
    /// The link that the controller reports poses in, if the robot has it.
    pub controller_base: Option<LinkId>,
    /// The link whose pose the controller reports, if the robot has it.
    pub controller_tip: Option<LinkId>,
    /// Whether its joints are matched to the log's by their order, the names being others.
    pub by_order: bool,
    /// Another arm that fits the poses far better than this one, which was named.
    pub better: Option<BetterModel>,
}

/// An arm of the catalogue that fits the poses far better than the model that was named.
#[derive(Clone, Debug)]
pub struct BetterModel {
    /// Its name.
    pub name: String,
    /// The topic of the poses.
    pub topic: String,
    /// Residual of these with the named model if neither frame nor joint is off, rms m.
    pub named_m: f64,
    /// Residual with this arm, rms m.
    pub left_m: f64,
    /// Length of the tool that it needs, m; `None` if it needs none.
    pub tool_m: Option<f64>,
}

impl Model {
    pub(super) fn new(robot: Robot, found: String, joint_prefix: &str, clues: &Clues<'_>) -> Self {
        let frames = FrameNames::fit(&robot, joint_prefix, clues.frames, clues.space);
        let known = controller_links(&robot, clues.joints);
        let link = |own: &Option<String>, known: Option<String>| {
            own.as_deref().and_then(|own| robot.link(own)).or_else(|| robot.link(&known?))
        };
        let controller_base = link(&robot.controller_base, known.0);
        let controller_tip = link(&robot.controller_tip, known.1);
        let (by_order, better) = (false, None);
        Self { robot, found, frames, controller_base, controller_tip, by_order, better }
    }
}

/// What the log says of its robots.
pub(super) struct Clues<'a> {
    /// Joints with at least one sample, in the order in which they appear.
    pub joints: &'a [String],
    /// Frames that streams and transforms name.
    pub frames: &'a BTreeSet<String>,
    /// Robot descriptions, each with the name of where it was.
    pub descriptions: &'a [(String, String)],
    /// Calibrations of a UR, each with the name of where it was.
    pub calibrations: &'a [(String, String)],
    /// What the caller says of joints that the model names otherwise.
    pub joint_map: &'a [JointName],
    /// What tells this arm from others whose joints have the same names.
    pub space: &'a Space,
    /// The type of the robot, as metadata say it.
    pub robot_type: Option<&'a str>,
}

/// The base and tip that controllers of catalogue arms with the joints of `robot` report in, each
/// where all of these arms agree.
fn controller_links(robot: &Robot, joints: &[String]) -> (Option<String>, Option<String>) {
    let own: Vec<&String> = joints.iter().filter(|joint| robot.joint(joint).is_some()).collect();
    let arms: Vec<Robot> = catalogue::candidates_for(&own)
        .iter()
        .filter(|candidate| candidate.names.is_complete())
        .filter_map(catalogue::Candidate::renamed)
        .collect();
    let agreed = |link: fn(&Robot) -> &Option<String>| {
        let first = link(arms.first()?);
        arms.iter().all(|arm| link(arm) == first).then(|| first.clone()).flatten()
    };
    (agreed(|arm| &arm.controller_base), agreed(|arm| &arm.controller_tip))
}

/// Whether a link has a name that trackers and maps give frames of their own, too.
fn is_world(link: &str) -> bool {
    const WORLDS: &[&str] = &["world", "map", "odom", "origin", "earth"];
    words(link).iter().all(|word| WORLDS.contains(&word.as_str()))
}

/// How the log's frames are named after a robot's links: a prefix taken off, another put on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct FrameNames {
    strip: String,
    add: String,
}

impl FrameNames {
    /// The naming under which most links are among the logged `frames`: as the joints are, without
    /// the joints' prefix, or with a prefix that the joints do not have, as where only a `tf_prefix`
    /// was set.
    ///
    /// A prefix counts that more frames have than one of a name that every program gives a world of its
    /// own. Of two arms each has its own.
    fn fit(robot: &Robot, joint_prefix: &str, frames: &BTreeSet<String>, space: &Space) -> Self {
        let links: Vec<&str> = robot.links().map(|link| robot.link_name(link)).collect();
        let prefixes: BTreeSet<&str> = frames
            .iter()
            .flat_map(|frame| links.iter().filter_map(move |link| frame.strip_suffix(link)))
            .filter(|prefix| prefix.ends_with(['/', '_', '-', '.']))
            .filter(|prefix| space.claim([*prefix]) != Claim::Foreign)
            .filter(|prefix| {
                let is_logged = |link: &str| frames.contains(&format!("{prefix}{link}"));
                links.iter().any(|link| is_logged(link) && !is_world(link))
            })
            .collect();
        let mut namings =
            vec![Self::default(), Self { strip: joint_prefix.to_owned(), ..Self::default() }];
        namings.extend(
            prefixes.into_iter().map(|add| Self { add: add.to_owned(), ..Self::default() }),
        );
        let logged = |naming: &Self| {
            let count = links.iter().filter(|link| frames.contains(&naming.frame_of(link))).count();
            (count, space.claim([naming.add.as_str()]) == Claim::Own)
        };
        // Of namings that fit as well the first, which is to change nothing.
        namings.into_iter().rev().max_by_key(logged).unwrap_or_default()
    }

    /// The frame of a link.
    pub fn frame_of(&self, link: &str) -> String {
        format!("{}{}", self.add, link.strip_prefix(&self.strip).unwrap_or(link))
    }

    /// The link of a frame.
    pub fn link_of(&self, robot: &Robot, frame: &str) -> Option<LinkId> {
        robot.links().find(|link| self.frame_of(robot.link_name(*link)) == frame)
    }
}
