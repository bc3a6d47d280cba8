//! Matches joint names that differ between log and model by order and kinematics.
//!
//! The order comes from numbers in the logged names, else from the log. Poses decide between several;
//! ambiguity is an error that asks for `--joint-map` or `--robot`. Numbered table joints take the model's
//! names in order.

use std::collections::BTreeMap;

use super::catalogue_selection::{
    MAX_RESIDUAL_SHARE, MIN_SCORE_DIFFERENCE, RankedModel, RankingCriteria,
};
use super::error::RunError;
use super::model::{LogModel, ModelClues};
use super::role::{NON_ARM_JOINT_WORDS, find_word, split_words};
use super::skeleton;
use crate::log::Topic;
use crate::robot::{Robot, catalogue};
use crate::stream::{Columns, JointColumn, JointColumns};

pub(super) const TABLE: &str = "table";

const MIN_JOINTS: usize = 4;

const PART_WORDS: [&[&str]; 6] = [
    &["rail", "track", "gantry", "slide"],
    &["base", "waist", "pan", "swing", "turret"],
    &["shoulder"],
    &["elbow"],
    &["forearm"],
    &["wrist", "hand", "flange", "tool"],
];

/// Logged joints that may form one arm, in order.
#[derive(Clone, Debug, PartialEq)]
struct JointSeries {
    orders: Vec<Vec<String>>,
    is_numbered: bool,
}

struct JointMatch {
    model: LogModel,
    pairs: Vec<(String, String)>,
    is_numbered: bool,
}

/// Renames the joints of `robot` as in the log, once per series that matches its arm.
///
/// # Errors
/// If no series has as many joints as the arm, or several matches are equally good.
pub(super) fn match_robot(
    robot: &Robot,
    joints: &[String],
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
    found: &str,
) -> Result<Vec<LogModel>, RunError> {
    let mut models = Vec::new();
    let mut question = None;
    for series in find_series(joints) {
        let matches = find_matches(robot, &series, clues);
        match choose_match(matches, criteria) {
            MatchChoice::One { joint_match, why } => models.push(LogModel {
                identified_by: format!(
                    "{found}, joints matched by order ({}; {why})",
                    describe_pairs(&joint_match.pairs)
                ),
                ..joint_match.model
            }),
            MatchChoice::Undetermined { matches } => question = question.or(Some(matches)),
            MatchChoice::None => {}
        }
    }
    match (models.is_empty(), question) {
        (false, _) => Ok(models),
        (true, question) => Err(RunError::UnknownJoints {
            robot: robot.name.clone(),
            source: robot.source.clone(),
            logged: clues.joints.to_vec(),
            modelled: arm_joints(robot).unwrap_or_else(|| skeleton::independent_joint_names(robot)),
            matches: question.unwrap_or_default(),
        }),
    }
}

/// Catalogue arms that match by order, if only one fits the poses.
///
/// # Errors
/// If several fit equally well.
pub(super) fn match_catalogue(
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    let mut models = Vec::new();
    let mut question = None;
    for series in find_series(clues.joints) {
        let of_robot = |robot: &Robot| -> Vec<JointMatch> {
            let Some(path) = arm_joints(robot) else { return Vec::new() };
            let orders = series.orders.iter().filter(|order| order.len() == path.len());
            orders
                .filter_map(|order| build_match(robot, &path, order, series.is_numbered, clues))
                .collect()
        };
        let matches = catalogue::entries().flat_map(of_robot);
        match choose_by_poses(matches.collect(), criteria) {
            MatchChoice::One { joint_match, why } => {
                let found = format!(
                    "the catalogue: only {} fits with its joints in the log's order ({}; {why})",
                    joint_match.model.robot.name,
                    describe_pairs(&joint_match.pairs),
                );
                models.push(LogModel { identified_by: found, ..joint_match.model });
            }
            MatchChoice::Undetermined { matches } => question = question.or(Some(matches)),
            MatchChoice::None => {}
        }
    }
    match question {
        Some(arms) if models.is_empty() && !arms.is_empty() => Err(RunError::SameMotion { arms }),
        _ => Ok(models),
    }
}

/// Catalogue arms with as many joints as are `logged`, in each common order. A table's last number may be a
/// gripper.
pub(super) fn arms_with_joint_count(logged: &[String], clues: &ModelClues<'_>) -> Vec<LogModel> {
    let fewest = logged.len() - usize::from(are_numbered(logged));
    let of_robot = |robot: &Robot| -> Vec<LogModel> {
        let path = arm_joints(robot).filter(|path| (fewest..=logged.len()).contains(&path.len()));
        let orders = path.map(|path| usual_orders(&path)).unwrap_or_default();
        let matches =
            orders.iter().filter_map(|order| build_match(robot, order, logged, true, clues));
        matches.map(|joint_match| joint_match.model).collect()
    };
    catalogue::entries().flat_map(of_robot).collect()
}

/// Common driver orders: from base to tip, and by name as in `joint_state_broadcaster` and MoveIt (a UR's
/// elbow comes first).
pub(super) fn usual_orders(path: &[String]) -> Vec<Vec<String>> {
    let mut sorted = path.to_vec();
    sorted.sort();
    let mut orders = vec![path.to_vec()];
    orders.extend((sorted != path).then_some(sorted));
    orders
}

/// Names numbered joints after those of `robots`, each for names with its prefix.
pub(super) fn name_numbered_joints(topics: &mut [Topic], robots: &[(&Robot, Option<&str>)]) {
    for topic in topics {
        let Some(Columns::Joints(joints)) = &mut topic.columns else { continue };
        let Some(side) = numbered_prefix(joints) else { continue };
        let fits = |prefix: &Option<&str>| {
            prefix.is_none_or(|prefix| prefix.trim_end_matches('_') == side)
        };
        let Some((robot, _)) = robots.iter().find(|(_, prefix)| fits(prefix)) else { continue };
        let path = arm_joints(robot).filter(|path| path.len() <= joints.joints.len());
        for (joint, own) in joints.joints.iter_mut().zip(path.unwrap_or_default()) {
            joint.name = own;
        }
    }
}

/// Prefix of numbered names: `left` for `left_q1`, empty for `q1`. `None` if joints have proper names.
fn numbered_prefix(joints: &JointColumns) -> Option<String> {
    let first = joints.joints.first().filter(|_| joints.unnamed)?;
    let side = first.name.strip_suffix("q1")?;
    let is_its = |(at, joint): (usize, &JointColumn)| joint.name == format!("{side}q{}", at + 1);
    let is_counted = joints.joints.iter().enumerate().all(is_its);
    is_counted.then(|| side.trim_end_matches('_').to_owned())
}

pub(super) fn are_numbered(joints: &[String]) -> bool {
    let is_it = |(at, name): (usize, &String)| *name == format!("q{}", at + 1);
    joints.len() >= MIN_JOINTS && joints.iter().enumerate().all(is_it)
}

/// Catalogue arm of a table with numbered joints, if it explains the poses far better than the others.
///
/// # Errors
/// If the table has no poses, no arm fits them, or several arms that move differently fit about as well.
pub(super) fn match_numbered(
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    /// Maximum residual of an arm that fits only with a fault, m: nominal model against calibrated arm.
    const MAX_RESIDUAL_M: f64 = 5e-4;
    let joints = clues.joints.len();
    let no_arm = |best| RunError::Numbered { joints, arms: Vec::new(), best, is_at_rest: false };
    let models = arms_with_joint_count(clues.joints, clues);
    let names: Vec<String> = models.iter().map(|model| order_label(model, clues.joints)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let Some(ranking) = (criteria.by_poses)(&models.iter().collect::<Vec<_>>()) else {
        return Err(no_arm(None));
    };
    let ranking =
        ranking.with_unused_joints(|at| joints - count_used_joints(&models[at], clues.joints));
    let Some(best) = ranking.models.first() else {
        return Err(no_arm(None));
    };
    // A zero offset may fit slightly better, because it absorbs link deviations.
    let is_sound = best.is_fit_without_fault;
    let is_close =
        best.hypothesis.residual_m < MAX_RESIDUAL_M.min(MAX_RESIDUAL_SHARE * best.spread_m);
    if !best.is_fit || !(is_sound || is_close) {
        let best = Some(format!("{} ({})", names[best.model], best.describe()));
        return Err(no_arm(best));
    }
    let same = ranking.ties();
    if same.iter().skip(1).any(|other| !other.is_equivalent_to(best)) {
        let mut arms: Vec<String> = Vec::new();
        for one in same {
            if !arms.iter().any(|arm| arm == names[one.model]) {
                arms.push(names[one.model].to_owned());
            }
        }
        let is_at_rest = !best.is_beyond_chance();
        return Err(RunError::Numbered { joints, arms, best: None, is_at_rest });
    }
    let found = ranking.describe(&names, "as many joints");
    Ok(vec![LogModel { identified_by: found, ..models[best.model].clone() }])
}

fn count_used_joints(model: &LogModel, logged: &[String]) -> usize {
    logged.iter().filter(|name| model.robot.joint(name).is_some()).count()
}

fn order_label(model: &LogModel, logged: &[String]) -> String {
    let name = &model.robot.name;
    let path = arm_joints(&model.robot).unwrap_or_default();
    match logged.starts_with(&path) {
        true => name.clone(),
        false => format!("{name} with its joints sorted by name"),
    }
}

enum MatchChoice {
    One { joint_match: Box<JointMatch>, why: String },
    Undetermined { matches: Vec<String> },
    None,
}

/// The match confirmed by poses, else the only one with numbered names that no pose contradicts.
fn choose_match(matches: Vec<JointMatch>, criteria: &RankingCriteria<'_>) -> MatchChoice {
    let is_only = matches.len() == 1 && matches[0].is_numbered;
    if !is_only {
        return choose_by_poses(matches, criteria);
    }
    let ranking = (criteria.by_poses)(&[&matches[0].model]);
    let best = ranking.as_ref().and_then(|ranking| ranking.models.first());
    let why = match best {
        None => Some("by their numbers, not confirmed by a pose stream".to_owned()),
        Some(best) if best.is_fit => Some(describe_fit(best)),
        Some(_) => None,
    };
    match (why, matches.into_iter().next()) {
        (Some(why), Some(joint_match)) => {
            MatchChoice::One { joint_match: Box::new(joint_match), why }
        }
        (None, Some(joint_match)) => {
            MatchChoice::Undetermined { matches: vec![joint_map_option(&joint_match.pairs)] }
        }
        _ => MatchChoice::None,
    }
}

/// The match that fits the poses without a fault, if no other fits as well.
fn choose_by_poses(matches: Vec<JointMatch>, criteria: &RankingCriteria<'_>) -> MatchChoice {
    let models: Vec<&LogModel> = matches.iter().map(|joint_match| &joint_match.model).collect();
    let Some(ranking) = (criteria.by_poses)(&models) else {
        return match matches.as_slice() {
            [] => MatchChoice::None,
            _ => MatchChoice::Undetermined { matches: Vec::new() },
        };
    };
    let Some(best) = ranking.models.iter().find(|one| is_fit_without_fault(one)) else {
        return MatchChoice::Undetermined { matches: Vec::new() };
    };
    // A match with a fault counts if it explains as much.
    let is_as_good =
        |other: &&RankedModel| other.is_fit && other.score <= best.score + MIN_SCORE_DIFFERENCE;
    let same: Vec<&RankedModel> = ranking.models.iter().filter(is_as_good).collect();
    if same.len() > 1 {
        let label = |one: &&RankedModel| matches[one.model].model.robot.name.clone();
        let is_one_robot = same.iter().all(|one| label(one) == label(&same[0]));
        let shown = |one: &&RankedModel| match is_one_robot {
            true => joint_map_option(&matches[one.model].pairs),
            false => label(one),
        };
        return MatchChoice::Undetermined { matches: same.iter().map(shown).collect() };
    }
    let next = ranking.models.iter().find(|one| one.model != best.model);
    let why = match next {
        Some(next) => {
            let name = |one: &RankedModel| matches[one.model].model.robot.name.as_str();
            let other = if name(next) == name(best) { "in another order" } else { name(next) };
            let (count, how) = (matches.len(), next.describe());
            format!("{}; the next best of {count}, {other}, within {how}", describe_fit(best))
        }
        None => describe_fit(best),
    };
    match matches.into_iter().nth(best.model) {
        Some(joint_match) => MatchChoice::One { joint_match: Box::new(joint_match), why },
        None => MatchChoice::None,
    }
}

/// Whether a model fits without a fault, too closely for chance.
fn is_fit_without_fault(one: &RankedModel) -> bool {
    one.is_fit && one.needs_no_fault() && one.is_beyond_chance()
}

fn describe_fit(one: &RankedModel) -> String {
    format!("{} fits within {}", one.topic, one.describe())
}

fn find_matches(robot: &Robot, series: &JointSeries, clues: &ModelClues<'_>) -> Vec<JointMatch> {
    let Some(path) = arm_joints(robot) else { return Vec::new() };
    let windows = series.orders.iter().flat_map(|order| {
        let is_numbered = series.is_numbered && path.len() == order.len();
        order.windows(path.len().max(1)).map(move |window| (window, is_numbered))
    });
    let matches = windows
        .filter_map(|(window, is_numbered)| build_match(robot, &path, window, is_numbered, clues));
    matches.collect()
}

fn build_match(
    robot: &Robot,
    path: &[String],
    logged: &[String],
    is_numbered: bool,
    clues: &ModelClues<'_>,
) -> Option<JointMatch> {
    let pairs: Vec<(String, String)> = logged.iter().cloned().zip(path.iter().cloned()).collect();
    let model = LogModel::new(rename_joints(robot, &pairs)?, String::new(), "", clues);
    let model = LogModel { is_matched_by_order: true, ..model };
    Some(JointMatch { model, pairs, is_numbered })
}

/// Renames the joints of `robot` as in the log if the names differ only in separators, in the word `joint` and in
/// a prefix of each arm: `left_wrist1` is `wrist_1_joint`. Empty if an arm lacks a joint.
pub(super) fn match_words(
    robot: &Robot,
    joints: &[String],
    clues: &ModelClues<'_>,
    found: &str,
) -> Vec<LogModel> {
    const MIN_LETTERS: usize = 3;
    let plain = |name: &str| -> String {
        let text: String = name.chars().filter(|c| c.is_alphanumeric()).collect();
        text.to_lowercase().replace("joint", "")
    };
    let letters = |name: &str| plain(name).chars().filter(|c| c.is_alphabetic()).count();
    let Some(path) = arm_joints(robot) else { return Vec::new() };
    if path.iter().any(|name| letters(name) < MIN_LETTERS) {
        return Vec::new();
    }
    let mut arms: BTreeMap<String, Vec<(String, String)>> = BTreeMap::new();
    for logged in joints {
        let own = plain(logged);
        let part = path.iter().find(|name| own.ends_with(&plain(name)));
        if let Some(name) = part {
            let prefix = own[..own.len() - plain(name).len()].to_owned();
            arms.entry(prefix).or_default().push((logged.clone(), name.clone()));
        }
    }
    let is_whole = |pairs: &[(String, String)]| {
        pairs.len() == path.len()
            && path.iter().all(|name| pairs.iter().any(|pair| pair.1 == *name))
    };
    let models = arms.into_values().filter(|pairs| is_whole(pairs)).filter_map(|pairs| {
        let found = format!("{found}, joints matched by name ({})", describe_pairs(&pairs));
        Some(LogModel::new(rename_joints(robot, &pairs)?, found, "", clues))
    });
    models.collect()
}

pub(super) fn rename_joints(robot: &Robot, pairs: &[(String, String)]) -> Option<Robot> {
    robot.with_joints_renamed(|name| {
        let pair = pairs.iter().find(|(_, modelled)| modelled == name);
        pair.map_or(name, |(logged, _)| logged).to_owned()
    })
}

fn arm_joints(robot: &Robot) -> Option<Vec<String>> {
    skeleton::find_only_arm_path(robot, |_| true).map(|path| path.joints)
}

/// Series of joints: names that differ only in a number. Otherwise all joints, in the log's order or that
/// of the arm parts they name.
fn find_series(joints: &[String]) -> Vec<JointSeries> {
    let is_arms =
        |name: &&String| find_word(&words_without_digits(name), NON_ARM_JOINT_WORDS).is_none();
    let arms: Vec<&String> = joints.iter().filter(is_arms).collect();
    let mut families: BTreeMap<(&str, &str), BTreeMap<u64, &String>> = BTreeMap::new();
    for name in &arms {
        if let Some((before, number, after)) = split_at_number(name) {
            families.entry((before, after)).or_default().insert(number, name);
        }
    }
    let numbered =
        families.into_values().filter(|family| family.len() >= MIN_JOINTS).map(|family| {
            JointSeries { orders: vec![family.into_values().cloned().collect()], is_numbered: true }
        });
    let numbered: Vec<JointSeries> = numbered.collect();
    match numbered.is_empty() {
        false => numbered,
        true if arms.len() < MIN_JOINTS => Vec::new(),
        true => {
            let logged: Vec<String> = arms.into_iter().cloned().collect();
            let by_part = order_by_part(&logged).filter(|order| *order != logged);
            let orders = std::iter::once(logged).chain(by_part).collect();
            vec![JointSeries { orders, is_numbered: false }]
        }
    }
}

/// Joints ordered by arm part, then name. `None` if one names no part.
fn order_by_part(joints: &[String]) -> Option<Vec<String>> {
    let rank = |name: &String| {
        let words = words_without_digits(name);
        PART_WORDS.iter().position(|part| find_word(&words, part).is_some())
    };
    let mut ranked: Vec<(usize, &String)> =
        joints.iter().map(|name| Some((rank(name)?, name))).collect::<Option<_>>()?;
    ranked.sort();
    Some(ranked.into_iter().map(|(_, name)| name.clone()).collect())
}

fn words_without_digits(name: &str) -> Vec<String> {
    let words = split_words(name).into_iter();
    words.map(|word| word.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned()).collect()
}

/// Last number in a name, with the text around it.
pub(super) fn split_at_number(name: &str) -> Option<(&str, u64, &str)> {
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = name[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + name[at..].chars().next().map_or(1, char::len_utf8));
    Some((&name[..start], name[start..end].parse().ok()?, &name[end..]))
}

/// Short form of a match: `a1…a7 are lbr_A1…lbr_A7`.
fn describe_pairs(pairs: &[(String, String)]) -> String {
    let ends = |name: fn(&(String, String)) -> &String| match pairs {
        [first, .., last] => format!("{}…{}", name(first), name(last)),
        _ => pairs.iter().map(name).cloned().collect(),
    };
    format!("{} are {}", ends(|pair| &pair.0), ends(|pair| &pair.1))
}

fn joint_map_option(pairs: &[(String, String)]) -> String {
    let pairs: Vec<String> =
        pairs.iter().map(|(logged, modelled)| format!("{logged}={modelled}")).collect();
    format!("--joint-map {}", pairs.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn numbers_give_the_order_of_each_arm() {
        let logged = names("l3 l1 r2 l2 r1 r4 l4 r3 finger1 finger2 finger3 finger4");
        let found = find_series(&logged);
        let joints: Vec<String> = found.iter().map(|series| series.orders[0].join(" ")).collect();
        assert_eq!(joints, ["l1 l2 l3 l4", "r1 r2 r3 r4"]);
        assert!(found.iter().all(|series| series.is_numbered));
    }

    #[test]
    fn without_numbers_log_order_and_arm_parts_give_the_order() {
        let logged = names("base elbow shoulder wrist_a wrist_b");
        let by_part = names("base shoulder elbow wrist_a wrist_b");
        let orders = |joints: &[String]| find_series(joints).pop().map(|series| series.orders);
        assert_eq!(orders(&logged), Some(vec![logged.clone(), by_part.clone()]));
        assert_eq!(orders(&by_part), Some(vec![by_part.clone()]));
        let ur = names("elbow shoulder_lift shoulder_pan wrist_1 wrist_2 wrist_3");
        let by_part = names("shoulder_pan shoulder_lift elbow wrist_1 wrist_2 wrist_3");
        assert_eq!(orders(&ur), Some(vec![ur.clone(), by_part]));
        let nameless = names("alpha beta gamma delta");
        assert_eq!(orders(&nameless), Some(vec![nameless.clone()]));
        assert_eq!(orders(&logged[..3]), None);
    }

    #[test]
    fn drivers_write_joints_along_the_arm_or_sorted_by_name() {
        let ur = arm_joints(catalogue::find("ur5e").unwrap()).unwrap();
        let sorted = [2, 1, 0, 3, 4, 5].map(|at: usize| ur[at].clone()).to_vec();
        assert_eq!(usual_orders(&ur), [ur, sorted]);
        let panda = arm_joints(catalogue::find("franka_fr3").unwrap()).unwrap();
        assert_eq!(usual_orders(&panda), [panda]);
    }

    #[test]
    fn numbered_joints_are_tried_in_both_orders_and_shorter_arms_only_with_a_gripper() {
        let frames = std::collections::BTreeSet::new();
        let space = super::super::namespace::Namespace::default();
        let clues = ModelClues {
            joints: &[],
            frames: &frames,
            descriptions: &[],
            calibrations: &[],
            joint_map: &[],
            namespace: &space,
            robot_type: None,
        };
        let arms = arms_with_joint_count(&names("q1 q2 q3 q4 q5 q6 q7"), &clues);
        assert_eq!(arms.iter().filter(|model| model.robot.name == "ur5e").count(), 2);
        let dof = |model: &LogModel| arm_joints(&model.robot).map_or(0, |path| path.len());
        assert!(arms.iter().all(|model| (6..=7).contains(&dof(model))));
    }

    #[test]
    fn the_last_number_counts() {
        assert_eq!(split_at_number("arm2_joint10_pos"), Some(("arm2_joint", 10, "_pos")));
        assert_eq!(split_at_number("7"), Some(("", 7, "")));
        assert_eq!(split_at_number("gelenk_ä3"), Some(("gelenk_ä", 3, "")));
        assert_eq!(split_at_number("elbow"), None);
    }
}
