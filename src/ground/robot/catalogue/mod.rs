//! Arms in embedded files, one per vendor, with source and licence.

use std::sync::LazyLock;

use serde::Deserialize;

use super::Robot;
use super::error::RobotError;
use super::names::NameMatch;
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
    robot: Vec<RobotTable>,
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

/// All arms, by vendor.
pub fn entries() -> &'static [Robot] {
    static ENTRIES: LazyLock<Vec<Robot>> = LazyLock::new(|| {
        let tables = VENDORS.iter().map(|(file, text)| read_vendor(file, text));
        let robots: Result<Vec<_>, _> = tables.collect();
        robots.expect("the embedded catalogue is valid").concat()
    });
    &ENTRIES
}

/// Names of all arms, by vendor.
pub fn names() -> impl Iterator<Item = &'static str> {
    entries().iter().map(|robot| robot.name.as_str())
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
    entries().iter().find(is_called).or_else(|| {
        let mut short = entries().iter().filter(is_short_for);
        short.next().filter(|_| short.next().is_none())
    })
}

/// Up to three names or aliases like a misspelt or shortened `name`, most similar first. Those that contain
/// it precede similar ones, with or without vendor.
pub fn nearest_names(name: &str) -> Vec<&'static str> {
    let normalized_name = normalised(name);
    let aliases = || entries().iter().flat_map(|robot| &robot.aliases).map(String::as_str);
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
    let mut candidates: Vec<Candidate> = entries()
        .iter()
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

fn read_vendor(file: &str, text: &str) -> Result<Vec<Robot>, RobotError> {
    let vendor: Vendor = parse(text, file)?;
    let robots = vendor.robot.into_iter().map(|table| table.into_robot("catalogue"));
    robots.collect::<Result<_, _>>().map_err(|located| RobotError::located(file, text, located))
}
