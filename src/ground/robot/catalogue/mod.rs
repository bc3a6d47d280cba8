//! Arms in embedded files, one per vendor, with source and licence.
//!
//! Parsing all of them takes as long as auditing a short log, so each arm is parsed on first use.

use std::sync::{LazyLock, OnceLock};

use serde::Deserialize;

use super::Robot;
use super::error::RobotError;
use super::names::{NameMatch, last_word};
use super::nearest::nearest;
use super::table::{RobotTable, parse};

pub(super) const VENDORS: [(&str, &str); 16] = [
    ("abb.toml", include_str!("abb.toml")),
    ("annin.toml", include_str!("annin.toml")),
    ("aubo.toml", include_str!("aubo.toml")),
    ("doosan.toml", include_str!("doosan.toml")),
    ("fanuc.toml", include_str!("fanuc.toml")),
    ("flexiv.toml", include_str!("flexiv.toml")),
    ("franka.toml", include_str!("franka.toml")),
    ("jaka.toml", include_str!("jaka.toml")),
    ("kinova.toml", include_str!("kinova.toml")),
    ("kuka.toml", include_str!("kuka.toml")),
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
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Robot with its catalogue names.
    pub robot: &'static Robot,
    /// Mapping to the log's names.
    pub names: NameMatch,
}

impl Candidate {
    /// With the log's names; `None` if not unique.
    pub fn renamed(&self) -> Option<Robot> {
        self.robot.with_prefix_replaced(&self.names.from_prefix, &self.names.to_prefix)
    }
}

/// Text of one arm, and the arm once it is parsed.
struct Entry {
    text: &'static str,
    /// Fixed joints, too.
    joint_names: Vec<&'static str>,
    robot: OnceLock<Robot>,
}

static ENTRIES: LazyLock<Vec<Entry>> = LazyLock::new(|| {
    let texts = VENDORS.iter().flat_map(|(_, text)| arm_texts(text));
    texts.map(Entry::new).collect()
});

impl Entry {
    fn new(text: &'static str) -> Self {
        let name = |line: &'static str| line.strip_prefix("name = \"")?.strip_suffix('"');
        Self { text, joint_names: text.lines().filter_map(name).collect(), robot: OnceLock::new() }
    }

    fn robot(&self) -> &Robot {
        self.robot.get_or_init(|| parse_arm(self.text).expect("the embedded catalogue is valid"))
    }

    /// Whether the text contains the quoted word, as it does for a name or alias.
    fn contains_word(&self, word: &str) -> bool {
        self.text.contains(&format!("\"{word}\""))
    }

    /// Whether at least two joints may have a logged name: one ends with the last word of the other, whatever the
    /// prefixes.
    fn may_have_joints<S: AsRef<str>>(&self, logged: &[S]) -> bool {
        let may_be =
            |joint: &&&str| logged.iter().any(|name| joint.ends_with(last_word(name.as_ref())));
        self.joint_names.iter().filter(may_be).nth(1).is_some()
    }
}

/// Text of each `[[robot]]` table.
fn arm_texts(vendor: &str) -> impl Iterator<Item = &str> {
    const HEADER: &str = "\n[[robot]]";
    let starts: Vec<usize> = vendor.match_indices(HEADER).map(|(start, _)| start).collect();
    let ends: Vec<usize> = starts.iter().skip(1).copied().chain([vendor.len()]).collect();
    starts.into_iter().zip(ends).map(|(start, end)| &vendor[start..end])
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
        .filter(|entry| entry.may_have_joints(logged))
        .map(Entry::robot)
        .flat_map(|robot| {
            let matches = robot.match_joint_names(logged);
            matches.into_iter().map(move |names| Candidate { robot, names })
        })
        .filter(|candidate| 2 * candidate.names.matched >= candidate.names.joints)
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

    #[test]
    fn each_arm_is_parsed_alone() {
        for entry in ENTRIES.iter() {
            let arm = parse_arm(entry.text).unwrap();
            assert!(entry.contains_word(&arm.name) && find(&arm.name) == Some(entry.robot()));
            assert!(arm.aliases.iter().all(|alias| entry.contains_word(alias)), "{}", arm.name);
        }
    }

    #[test]
    fn the_arms_that_are_not_parsed_do_not_match() {
        let prefixes = ["", "left_", "left/", "robot1_left_"];
        for arm in entries() {
            let joints = || arm.joints().iter().map(|joint| &joint.name);
            for prefix in prefixes {
                let logged: Vec<String> = joints().map(|name| format!("{prefix}{name}")).collect();
                let stems: Vec<String> = joints()
                    .map(|name| format!("{prefix}{}", name.rsplit('_').next().unwrap()))
                    .collect();
                for logged in [logged, stems] {
                    for entry in ENTRIES.iter().filter(|entry| !entry.may_have_joints(&logged)) {
                        let matches = entry.robot().match_joint_names(&logged);
                        assert!(matches.iter().all(|it| 2 * it.matched < it.joints), "{logged:?}");
                    }
                }
            }
        }
    }
}
