//! Arms in embedded files, one per vendor, with source and licence.
//!
//! Parsing all of them takes as long as auditing a short log, so each arm is parsed on first use.

use std::sync::{LazyLock, OnceLock};

use serde::Deserialize;

use super::Robot;
use super::error::RobotError;
use super::names::{NameMatch, match_joint_names};
use super::nearest::nearest;
use super::table::{RobotTable, parse};

pub(super) const VENDORS: [(&str, &str); 19] = [
    ("abb.toml", include_str!("abb.toml")),
    ("agilex.toml", include_str!("agilex.toml")),
    ("annin.toml", include_str!("annin.toml")),
    ("aubo.toml", include_str!("aubo.toml")),
    ("doosan.toml", include_str!("doosan.toml")),
    ("fanuc.toml", include_str!("fanuc.toml")),
    ("flexiv.toml", include_str!("flexiv.toml")),
    ("franka.toml", include_str!("franka.toml")),
    ("interbotix.toml", include_str!("interbotix.toml")),
    ("jaka.toml", include_str!("jaka.toml")),
    ("kinova.toml", include_str!("kinova.toml")),
    ("kuka.toml", include_str!("kuka.toml")),
    ("mecademic.toml", include_str!("mecademic.toml")),
    ("openarm.toml", include_str!("openarm.toml")),
    ("so_arm.toml", include_str!("so_arm.toml")),
    ("techman.toml", include_str!("techman.toml")),
    ("ufactory.toml", include_str!("ufactory.toml")),
    ("universal_robots.toml", include_str!("universal_robots.toml")),
    ("yaskawa.toml", include_str!("yaskawa.toml")),
];

#[derive(Deserialize)]
struct Vendor {
    robot: [RobotTable; 1],
}

/// Catalogue arm whose joint names match a log.
pub struct Candidate {
    entry: &'static Entry,
    /// Mapping to the log's names.
    pub names: NameMatch,
}

impl Candidate {
    /// Robot with its catalogue names.
    pub fn robot(&self) -> &'static Robot {
        self.entry.robot()
    }

    /// With the log's names; `None` if not unique.
    pub fn renamed(&self) -> Option<Robot> {
        self.robot().with_prefix_replaced(&self.names.from_prefix, &self.names.to_prefix)
    }

    /// Base and tip of the controller's poses with the log's names, without parsing the arm.
    pub fn controller_links(&self) -> [Option<String>; 2] {
        self.entry.controller_links.map(|link| Some(self.names.logged_name(link?)))
    }
}

/// Text of one arm, and the arm once it is parsed.
struct Entry {
    text: &'static str,
    /// Independently movable joints.
    joint_names: Vec<&'static str>,
    joint_prefixes: Vec<String>,
    /// Base and tip.
    controller_links: [Option<&'static str>; 2],
    robot: OnceLock<Robot>,
}

static ENTRIES: LazyLock<Vec<Entry>> = LazyLock::new(|| {
    let texts = VENDORS.iter().flat_map(|(_, text)| tables(text, "\n[[robot]]"));
    texts.map(Entry::new).collect()
});

impl Entry {
    fn new(text: &'static str) -> Self {
        let joint_name = |table: &'static str| {
            let name = table.lines().find_map(|line| quoted(line.strip_prefix("name = ")?))?;
            (!table.contains("\ntype = \"fixed\"")).then_some(name)
        };
        let value = |key: &str| text.lines().find_map(|line| line.strip_prefix(key));
        let prefixes = value("joint_prefixes = [");
        let prefixes = prefixes.unwrap_or_default().trim_end_matches(']').split(", ");
        Self {
            text,
            joint_names: tables(text, "\n[[robot.joint]]").filter_map(joint_name).collect(),
            joint_prefixes: prefixes.filter_map(quoted).map(str::to_owned).collect(),
            controller_links: ["controller_base = ", "controller_tip = "]
                .map(|key| value(key).and_then(quoted)),
            robot: OnceLock::new(),
        }
    }

    fn robot(&self) -> &Robot {
        self.robot.get_or_init(|| parse_arm(self.text).expect("the embedded catalogue is valid"))
    }

    /// Whether the text contains the quoted word, as it does for a name or alias.
    fn contains_word(&self, word: &str) -> bool {
        self.text.contains(&format!("\"{word}\""))
    }
}

fn quoted(text: &str) -> Option<&str> {
    text.strip_prefix('"')?.strip_suffix('"')
}

/// Text of each table with this header.
fn tables<'a>(text: &'a str, header: &str) -> impl Iterator<Item = &'a str> + use<'a> {
    let starts: Vec<usize> = text.match_indices(header).map(|(start, _)| start).collect();
    let ends: Vec<usize> = starts.iter().skip(1).copied().chain([text.len()]).collect();
    starts.into_iter().zip(ends).map(|(start, end)| &text[start..end])
}

/// All arms, by vendor.
pub fn entries() -> impl Iterator<Item = &'static Robot> + Clone {
    ENTRIES.iter().map(Entry::robot)
}

/// Names of all arms, by vendor.
pub fn names() -> impl Iterator<Item = &'static str> {
    entries().map(|robot| robot.name.as_str())
}

/// Finds an arm by name or alias, ignoring case; `-` and spaces are `_`. Vendor and suffix may be omitted
/// if unique: `iiwa14` is `kuka_lbr_iiwa14`, `irb120` is `abb_irb120_3_58`.
pub fn find(name: &str) -> Option<&'static Robot> {
    let normalized_name = normalised(name);
    let is_called =
        |robot: &&Robot| robot.name == normalized_name || robot.aliases.contains(&normalized_name);
    // A vendor has one or two words; a model starts with a letter and contains a digit.
    let is_model = normalized_name.starts_with(|first: char| first.is_ascii_alphabetic())
        && normalized_name.contains(|c: char| c.is_ascii_digit());
    let is_short_for = |robot: &&Robot| {
        let makers = robot.name.match_indices('_').take(2);
        let mut ends =
            makers.filter_map(|(at, _)| robot.name[at + 1..].strip_prefix(&normalized_name));
        is_model && ends.any(|rest| rest.is_empty() || rest.starts_with('_'))
    };
    let mentioned = ENTRIES.iter().filter(|entry| entry.contains_word(&normalized_name));
    mentioned.map(Entry::robot).find(is_called).or_else(|| {
        let mut short = entries().filter(is_short_for);
        short.next().filter(|_| short.next().is_none())
    })
}

/// Up to three names or aliases like a misspelt or shortened `name`, most similar first. Those that contain
/// it precede similar ones, with or without vendor.
pub fn nearest_names(name: &str) -> Vec<&'static str> {
    let normalized_name = normalised(name);
    let aliases = || entries().flat_map(|robot| &robot.aliases).map(String::as_str);
    let known = || names().chain(aliases());
    let contains_name =
        |known: &&str| normalized_name.len() > 1 && known.contains(normalized_name.as_str());
    let mut longer: Vec<&str> = known().filter(contains_name).collect();
    longer.sort_by_key(|known| known.len());
    longer.truncate(3);
    if !longer.is_empty() {
        return longer;
    }
    let similar_ids = nearest(&normalized_name, known());
    if !similar_ids.is_empty() {
        return similar_ids;
    }
    let model = |known: &'static str| known.rsplit('_').next().unwrap_or(known);
    let similar = nearest(&normalized_name, known().map(model));
    let mut candidates: Vec<&str> =
        known().filter(|known| similar.contains(&model(known))).collect();
    candidates.truncate(3);
    candidates
}

/// Finds arms with at least half of their joints among the `logged` names, best first.
///
/// Sorted by the share of joints in the log, then by their number, then by the fewest unknown prefix
/// characters. Two arms in one log yield two candidates. Many arms have names such as `joint_1`; equal
/// candidates keep the catalogue's order, and only the motion distinguishes them.
pub fn candidates_for<S: AsRef<str>>(logged: &[S]) -> Vec<Candidate> {
    let mut candidates: Vec<Candidate> = ENTRIES
        .iter()
        .flat_map(|entry| {
            let matches = match_joint_names(&entry.joint_names, &entry.joint_prefixes, logged);
            let is_match = |names: &NameMatch| 2 * names.matched >= names.joints;
            let matches = matches.into_iter().filter(is_match);
            matches.map(move |names| Candidate { entry, names })
        })
        .collect();
    candidates.sort_by(|a, b| {
        let (a, b) = (&a.names, &b.names);
        let by_matched_share = (b.matched * a.joints).cmp(&(a.matched * b.joints));
        by_matched_share
            .then(b.matched.cmp(&a.matched))
            .then(a.unknown_prefix_chars.cmp(&b.unknown_prefix_chars))
    });
    candidates
}

fn normalised(name: &str) -> String {
    name.trim().to_lowercase().replace(['-', ' '], "_")
}

fn parse_arm(text: &str) -> Result<Robot, RobotError> {
    let Vendor { robot: [table] } = parse(text, "catalogue")?;
    table.into_robot("catalogue").map_err(|located| RobotError::located("catalogue", text, located))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Joint;

    #[test]
    fn each_arm_is_parsed_alone() {
        for entry in ENTRIES.iter() {
            let arm = parse_arm(entry.text).unwrap();
            assert!(entry.contains_word(&arm.name) && find(&arm.name) == Some(entry.robot()));
            assert!(arm.aliases.iter().all(|alias| entry.contains_word(alias)), "{}", arm.name);
        }
    }

    #[test]
    fn names_of_joints_and_links_are_known_without_parsing() {
        for entry in ENTRIES.iter() {
            let arm = entry.robot();
            let moving = |joint: &&Joint| joint.kind.has_position() && joint.mimic.is_none();
            let names = arm.joints().iter().filter(moving).map(|joint| joint.name.as_str());
            assert!(names.eq(entry.joint_names.iter().copied()), "{}", arm.name);
            assert_eq!(arm.joint_prefixes, entry.joint_prefixes);
            let links = [&arm.controller_base, &arm.controller_tip].map(Option::as_deref);
            assert_eq!(links, entry.controller_links, "{}", arm.name);
        }
    }
}
