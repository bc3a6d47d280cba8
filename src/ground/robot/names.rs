//! Matching of joint names with prefixes.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashSet};

use super::model::Robot;

/// Mapping from a robot's joint names to those in a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NameMatch {
    /// Prefix to remove.
    pub from_prefix: String,
    /// Prefix to add, see [`Robot::with_prefix_replaced`].
    pub to_prefix: String,
    /// Joints found in the log.
    pub matched: usize,
    /// Independently movable joints.
    pub joints: usize,
    /// Characters of the prefixes that this robot does not use.
    pub unknown_prefix_chars: usize,
}

impl NameMatch {
    /// Whether the log has every joint.
    pub fn is_complete(&self) -> bool {
        self.matched == self.joints
    }

    /// Logged name of a joint or link.
    pub fn logged_name(&self, name: &str) -> String {
        with_prefix_replaced(name, &self.from_prefix, &self.to_prefix)
    }
}

impl Robot {
    /// Finds prefixes that map its movable joints to `logged` names: most joints first, then fewest unknown characters. Two
    /// identical arms yield two matches.
    pub fn match_joint_names<S: AsRef<str>>(&self, logged: &[S]) -> Vec<NameMatch> {
        let moving = |joint: &&super::Joint| joint.kind.has_position() && joint.mimic.is_none();
        let own = self.joints().iter().filter(moving).map(|joint| joint.name.as_str());
        let own: Vec<&str> = own.collect();
        match_joint_names(&own, &self.joint_prefixes, logged)
    }

    /// Copy with the prefix `from` of link and joint names replaced by `to`; `None` if two names would
    /// become equal.
    pub fn with_prefix_replaced(&self, from: &str, to: &str) -> Option<Robot> {
        self.renamed(|name| with_prefix_replaced(name, from, to))
    }
}

/// Finds prefixes that map independently movable joints to `logged` names: most joints first, then fewest
/// unknown characters. Two identical arms yield two matches.
///
/// A log may add a namespace or `tf_prefix`, or use one of the `declared` prefixes.
pub(super) fn match_joint_names<S: AsRef<str>>(
    own: &[&str],
    declared: &[String],
    logged: &[S],
) -> Vec<NameMatch> {
    let logged: HashSet<&str> = logged.iter().map(AsRef::as_ref).collect();
    let own_prefixes = own_prefixes(own, declared);
    let mut matches = Vec::new();
    for from in &own_prefixes {
        let stems: Vec<&str> = own.iter().filter_map(|name| name.strip_prefix(from)).collect();
        for to in logged_prefixes(&stems, &logged) {
            let present = |stem: &&&str| logged.contains(format!("{to}{stem}").as_str());
            matches.push(NameMatch {
                matched: stems.iter().filter(present).count(),
                joints: own.len(),
                unknown_prefix_chars: unknown_prefix_chars(from, &to, &own_prefixes, declared),
                from_prefix: (*from).to_owned(),
                to_prefix: to,
            });
        }
    }
    matches.sort_by_key(|m| (Reverse(m.matched), m.unknown_prefix_chars));
    let mut seen = HashSet::new();
    matches.retain(|m| seen.insert(own.first().map(|name| m.logged_name(name))));
    matches
}

/// The empty prefix, declared and common prefixes of all joints, and that of most joints (for an arm on
/// a rail).
fn own_prefixes<'a>(names: &[&'a str], declared: &'a [String]) -> BTreeSet<&'a str> {
    let declared = declared.iter().map(String::as_str);
    let shared = |prefix: &&str| names.iter().all(|name| name.starts_with(prefix));
    let common = common_prefix(names).or_else(|| {
        let most = |prefix: &Vec<&'a str>| 2 * prefix.len() > names.len();
        let first = names.iter().filter_map(|name| name.split(is_separator).next());
        let sharing = first.map(|word| {
            names.iter().copied().filter(|name| name.starts_with(word)).collect::<Vec<&str>>()
        });
        common_prefix(&sharing.into_iter().find(most)?)
    });
    [""].into_iter().chain(declared.filter(shared)).chain(common).collect()
}

fn with_prefix_replaced(name: &str, from: &str, to: &str) -> String {
    match name.strip_prefix(from) {
        Some(rest) => format!("{to}{rest}"),
        None => name.to_owned(),
    }
}

fn logged_prefixes(stems: &[&str], logged: &HashSet<&str>) -> BTreeSet<String> {
    let before = |name: &str, stem: &str| {
        let prefix = name.strip_suffix(stem)?;
        (prefix.is_empty() || prefix.ends_with(is_separator)).then(|| prefix.to_owned())
    };
    logged.iter().flat_map(|name| stems.iter().filter_map(move |stem| before(name, stem))).collect()
}

/// Characters of `to` before a known prefix of the robot; without one, the length of both.
fn unknown_prefix_chars(from: &str, to: &str, own: &BTreeSet<&str>, declared: &[String]) -> usize {
    if from.is_empty() {
        return to.len();
    }
    let known = own.iter().copied().chain(declared.iter().map(String::as_str));
    known
        .filter(|prefix| !prefix.is_empty())
        .filter_map(|prefix| to.strip_suffix(prefix))
        .map(str::len)
        .min()
        .unwrap_or(from.len() + to.len())
}

/// Up to a separator that a letter follows.
fn common_prefix<'a>(names: &[&'a str]) -> Option<&'a str> {
    let first: &'a str = names.first()?;
    let ends = first.rmatch_indices(is_separator).map(|(at, separator)| at + separator.len());
    ends.map(|end| &first[..end]).find(|prefix| {
        names.iter().all(|name| {
            name.strip_prefix(prefix).is_some_and(|stem| stem.starts_with(char::is_alphabetic))
        })
    })
}

fn is_separator(c: char) -> bool {
    matches!(c, '_' | '-' | '/' | '.' | ':')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_prefix_leaves_stems_that_start_with_a_letter() {
        assert_eq!(common_prefix(&["fer_joint1", "fer_joint2"]), Some("fer_"));
        assert_eq!(common_prefix(&["joint_1", "joint_2"]), None);
        assert_eq!(common_prefix(&["shoulder_pan", "elbow"]), None);
    }
}
