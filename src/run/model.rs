//! Robot model with the log's names.

use std::collections::BTreeSet;

use super::declaration::JointName;
use super::namespace::{Namespace, NamespaceMatch};
use super::role::split_words;
use crate::robot::{LinkId, Robot, catalogue};

#[derive(Clone, Debug)]
pub(super) struct LogModel {
    /// Robot with the log's joint names.
    pub robot: Robot,
    pub identified_by: String,
    /// Its link names in the log.
    pub frames: FrameNames,
    /// Reference link of controller poses.
    pub controller_base: Option<LinkId>,
    /// Tip link of controller poses.
    pub controller_tip: Option<LinkId>,
    /// Whether joints are matched by order, because names differ.
    pub is_matched_by_order: bool,
    pub competing: Option<CompetingModel>,
    pub indistinguishable: Vec<String>,
}

/// A catalogue arm that fits far better than the named model.
#[derive(Clone, Debug)]
pub struct CompetingModel {
    /// Its name.
    pub name: String,
    /// Topic of the poses.
    pub topic: String,
    /// Residual of the named model without frame or zero offset, rms m.
    pub named_residual_m: f64,
    /// Residual with this arm, rms m.
    pub residual_m: f64,
    /// Required tool length, m; `None` without a tool.
    pub tool_m: Option<f64>,
}

impl LogModel {
    /// Catalogue arm with the log's names; `None` if not unique.
    pub(super) fn from_candidate(
        candidate: &catalogue::Candidate,
        found: String,
        clues: &ModelClues<'_>,
    ) -> Option<Self> {
        Some(Self::new(candidate.renamed()?, found, &candidate.names.to_prefix, clues))
    }

    pub(super) fn new(
        robot: Robot,
        found: String,
        joint_prefix: &str,
        clues: &ModelClues<'_>,
    ) -> Self {
        let frames = FrameNames::fit(&robot, joint_prefix, clues.frames, clues.namespace);
        let own = |name: &Option<String>| robot.link(name.as_deref()?);
        let [mut controller_base, mut controller_tip] =
            [own(&robot.controller_base), own(&robot.controller_tip)];
        if controller_base.is_none() || controller_tip.is_none() {
            let [base, tip] = controller_links(&robot, clues.joints);
            controller_base = controller_base.or_else(|| robot.link(&base?));
            controller_tip = controller_tip.or_else(|| robot.link(&tip?));
        }
        Self {
            robot,
            identified_by: found,
            frames,
            controller_base,
            controller_tip,
            is_matched_by_order: false,
            competing: None,
            indistinguishable: Vec::new(),
        }
    }
}

pub(super) struct ModelClues<'a> {
    /// Joints with samples, in order of appearance.
    pub joints: &'a [String],
    /// Frames of streams and transforms.
    pub frames: &'a BTreeSet<String>,
    /// Source and text of each description.
    pub descriptions: &'a [(String, String)],
    pub calibrations: &'a [(String, String)],
    /// The caller's joint names.
    pub joint_map: &'a [JointName],
    /// Names that distinguish this arm.
    pub namespace: &'a Namespace,
    /// Robot type in the metadata.
    pub robot_type: Option<&'a str>,
}

/// Controller base and tip, if all catalogue arms with these joints agree.
fn controller_links(robot: &Robot, joints: &[String]) -> [Option<String>; 2] {
    let own: Vec<&String> = joints.iter().filter(|joint| robot.joint(joint).is_some()).collect();
    let arms: Vec<[Option<String>; 2]> = catalogue::candidates_for(&own)
        .iter()
        .filter(|candidate| candidate.names.is_complete())
        .map(catalogue::Candidate::controller_links)
        .collect();
    let agreed = |link: usize| {
        let first = &arms.first()?[link];
        arms.iter().all(|arm| arm[link] == *first).then(|| first.clone()).flatten()
    };
    [0, 1].map(agreed)
}

/// Whether trackers and maps also use this name.
fn is_world(link: &str) -> bool {
    const WORLD_WORDS: &[&str] = &["world", "map", "odom", "origin", "earth"];
    split_words(link).iter().all(|word| WORLD_WORDS.contains(&word.as_str()))
}

/// Frame names in the log: link names with one prefix removed, another added.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct FrameNames {
    strip: String,
    add: String,
}

impl FrameNames {
    /// Selects the naming with the most links in `frames`: as the joints, without their prefix, or with
    /// another, such as a `tf_prefix`.
    ///
    /// Ignores prefixes only of generic names such as `world`. Two arms have their own prefixes.
    fn fit(
        robot: &Robot,
        joint_prefix: &str,
        frames: &BTreeSet<String>,
        namespace: &Namespace,
    ) -> Self {
        let links: Vec<&str> = robot.links().map(|link| robot.link_name(link)).collect();
        let prefixes: BTreeSet<&str> = frames
            .iter()
            .flat_map(|frame| links.iter().filter_map(move |link| frame.strip_suffix(link)))
            .filter(|prefix| prefix.ends_with(['/', '_', '-', '.']))
            .filter(|prefix| namespace.match_names([*prefix]) != NamespaceMatch::Foreign)
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
            (count, namespace.match_names([naming.add.as_str()]) == NamespaceMatch::Own)
        };
        // The first of equal namings changes nothing.
        namings.into_iter().rev().max_by_key(logged).unwrap_or_default()
    }

    /// Frame of a link.
    pub fn frame_of(&self, link: &str) -> String {
        format!("{}{}", self.add, link.strip_prefix(&self.strip).unwrap_or(link))
    }

    /// Link of a frame.
    pub fn link_of(&self, robot: &Robot, frame: &str) -> Option<LinkId> {
        robot.links().find(|link| self.frame_of(robot.link_name(*link)) == frame)
    }
}
