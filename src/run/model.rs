//! Robot model with the names used in the log.

use std::collections::BTreeSet;

use super::declaration::JointName;
use super::role::words;
use super::space::{Claim, Space};
use crate::robot::{LinkId, Robot, catalogue};

/// A robot of the log.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// The robot, with joint names as in the log.
    pub robot: Robot,
    /// How it was found.
    pub found: String,
    /// Names of its links in the log.
    pub frames: FrameNames,
    /// Reference link of the controller's poses, if the robot has it.
    pub controller_base: Option<LinkId>,
    /// Tip link of the controller's poses, if the robot has it.
    pub controller_tip: Option<LinkId>,
    /// Whether its joints are matched to the log's by order, because their names differ.
    pub by_order: bool,
    /// A different arm that fits the poses far better than this named one.
    pub better: Option<CompetingModel>,
    /// Other catalogue arms with different links that fit the log about as well as this one, which was guessed.
    pub indistinguishable: Vec<String>,
}

/// A catalogue arm that fits the poses far better than the named model.
#[derive(Clone, Debug)]
pub struct CompetingModel {
    /// Its name.
    pub name: String,
    /// Topic of the poses.
    pub topic: String,
    /// Residual with the named model and no frame or zero offset, rms m.
    pub named_m: f64,
    /// Residual with this arm, rms m.
    pub left_m: f64,
    /// Length of the required tool, m; `None` if no tool is required.
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
        Self {
            robot,
            found,
            frames,
            controller_base,
            controller_tip,
            by_order: false,
            better: None,
            indistinguishable: Vec::new(),
        }
    }
}

/// Information in the log about its robots.
pub(super) struct Clues<'a> {
    /// Joints with at least one sample, in the order in which they appear.
    pub joints: &'a [String],
    /// Frames named by streams and transforms.
    pub frames: &'a BTreeSet<String>,
    /// Source and text of each robot description.
    pub descriptions: &'a [(String, String)],
    /// Source and text of each UR calibration.
    pub calibrations: &'a [(String, String)],
    /// The caller's mapping of joint names.
    pub joint_map: &'a [JointName],
    /// Names that distinguish this arm from others with the same joint names.
    pub space: &'a Space,
    /// Robot type in the metadata.
    pub robot_type: Option<&'a str>,
}

/// Controller base and tip of catalogue arms with the joints of `robot`, if all of these arms agree.
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

/// Whether a link name is also common for the frames of trackers and maps.
fn is_world(link: &str) -> bool {
    const WORLDS: &[&str] = &["world", "map", "odom", "origin", "earth"];
    words(link).iter().all(|word| WORLDS.contains(&word.as_str()))
}

/// How frame names in the log derive from a robot's link names: one prefix removed, another added.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct FrameNames {
    strip: String,
    add: String,
}

impl FrameNames {
    /// Selects the naming with the most links among the logged `frames`: as the joints, without the joints'
    /// prefix, or with a prefix that the joints lack, such as a `tf_prefix`.
    ///
    /// Ignores prefixes that occur only before generic names such as `world`. With two arms, each has its
    /// own prefix.
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
        // Of equal namings, the first, which changes nothing.
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
