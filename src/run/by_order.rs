//! Matches joint names that differ between log and model by order and kinematics.
//!
//! The order comes from numbers in the logged names, else from the log. Poses decide between several;
//! ambiguity is an error that asks for `--joint-map` or `--robot`. Numbered table joints take the model's
//! names in order.

use std::collections::BTreeMap;

use super::catalogued::{RankingCriteria, Standing};
use super::error::RunError;
use super::model::{Clues, Model};
use super::role::{OTHER_JOINTS, shared, words};
use super::skeleton;
use crate::log::Topic;
use crate::robot::{Robot, catalogue};
use crate::stream::{Columns, JointColumn, JointColumns};

pub(super) const TABLE: &str = "table";

const FEWEST: usize = 4;
/// Maximum residual of a match, as a share of the positions' extent.
const FITS_SHARE: f64 = 0.02;

const PARTS: [&[&str]; 6] = [
    &["rail", "track", "gantry", "slide"],
    &["base", "waist", "pan", "swing", "turret"],
    &["shoulder"],
    &["elbow"],
    &["forearm"],
    &["wrist", "hand", "flange", "tool"],
];

/// Logged joints that may form one arm, in order.
#[derive(Clone, Debug, PartialEq)]
struct Series {
    orders: Vec<Vec<String>>,
    is_numbered: bool,
}

struct Match {
    model: Model,
    pairs: Vec<(String, String)>,
    is_numbered: bool,
}

/// Renames the joints of `robot` as in the log, once per series that matches its arm.
///
/// # Errors
/// If no series has as many joints as the arm, or several matches are equally good.
pub(super) fn matched(
    robot: &Robot,
    joints: &[String],
    clues: &Clues<'_>,
    criteria: &RankingCriteria<'_>,
    found: &str,
) -> Result<Vec<Model>, RunError> {
    let mut models = Vec::new();
    let mut question = None;
    for series in series(joints) {
        let ways = ways(robot, &series, clues);
        match settled(ways, criteria) {
            Settled::One { way, why } => models.push(Model {
                found: format!("{found}, joints matched by order ({}; {why})", shown(&way.pairs)),
                ..way.model
            }),
            Settled::Open { ways } => question = question.or(Some(ways)),
            Settled::None => {}
        }
    }
    match (models.is_empty(), question) {
        (false, _) => Ok(models),
        (true, question) => Err(RunError::UnknownJoints {
            robot: robot.name.clone(),
            source: robot.source.clone(),
            logged: clues.joints.to_vec(),
            modelled: path_of(robot).unwrap_or_else(|| own_names(robot)),
            ways: question.unwrap_or_default(),
        }),
    }
}

/// Catalogue arms that match by order, if only one fits the poses.
///
/// # Errors
/// If several fit equally well.
pub(super) fn catalogued(
    clues: &Clues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<Model>, RunError> {
    let mut models = Vec::new();
    let mut question = None;
    for series in series(clues.joints) {
        let of_robot = |robot: &Robot| -> Vec<Match> {
            let Some(path) = path_of(robot) else { return Vec::new() };
            let orders = series.orders.iter().filter(|order| order.len() == path.len());
            orders.filter_map(|order| way(robot, &path, order, series.is_numbered, clues)).collect()
        };
        let ways = catalogue::entries().iter().flat_map(of_robot);
        match proven(ways.collect(), criteria) {
            Settled::One { way, why } => {
                let found = format!(
                    "the catalogue: only {} fits with its joints in the log's order ({}; {why})",
                    way.model.robot.name,
                    shown(&way.pairs),
                );
                models.push(Model { found, ..way.model });
            }
            Settled::Open { ways } => question = question.or(Some(ways)),
            Settled::None => {}
        }
    }
    match question {
        Some(arms) if models.is_empty() && !arms.is_empty() => Err(RunError::SameMotion { arms }),
        _ => Ok(models),
    }
}

/// Catalogue arms with as many joints as are `logged`, in each common order. A table's last number may be a
/// gripper.
pub(super) fn along(logged: &[String], clues: &Clues<'_>) -> Vec<Model> {
    let fewest = logged.len() - usize::from(is_counted(logged));
    let of_robot = |robot: &Robot| -> Vec<Model> {
        let path = path_of(robot).filter(|path| (fewest..=logged.len()).contains(&path.len()));
        let orders = path.map(|path| usual_orders(&path)).unwrap_or_default();
        let ways = orders.iter().filter_map(|order| way(robot, order, logged, true, clues));
        ways.map(|way| way.model).collect()
    };
    catalogue::entries().iter().flat_map(of_robot).collect()
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
pub(super) fn name_counted(topics: &mut [Topic], robots: &[(&Robot, Option<&str>)]) {
    for topic in topics {
        let Some(Columns::Joints(joints)) = &mut topic.columns else { continue };
        let Some(side) = side_of(joints) else { continue };
        let fits = |prefix: &Option<&str>| {
            prefix.is_none_or(|prefix| prefix.trim_end_matches('_') == side)
        };
        let Some((robot, _)) = robots.iter().find(|(_, prefix)| fits(prefix)) else { continue };
        let path = path_of(robot).filter(|path| path.len() <= joints.joints.len());
        for (joint, own) in joints.joints.iter_mut().zip(path.unwrap_or_default()) {
            joint.name = own;
        }
    }
}

/// Prefix of numbered names: `left` for `left_q1`, empty for `q1`. `None` if joints have proper names.
fn side_of(joints: &JointColumns) -> Option<String> {
    let first = joints.joints.first().filter(|_| joints.unnamed)?;
    let side = first.name.strip_suffix("q1")?;
    let is_its = |(at, joint): (usize, &JointColumn)| joint.name == format!("{side}q{}", at + 1);
    let is_counted = joints.joints.iter().enumerate().all(is_its);
    is_counted.then(|| side.trim_end_matches('_').to_owned())
}

pub(super) fn is_counted(joints: &[String]) -> bool {
    let is_it = |(at, name): (usize, &String)| *name == format!("q{}", at + 1);
    joints.len() >= FEWEST && joints.iter().enumerate().all(is_it)
}

/// Catalogue arm of a table with numbered joints, if it explains the poses far better than the others.
///
/// # Errors
/// If the table has no poses, no arm fits them, or several arms that move differently fit about as well.
pub(super) fn counted(
    clues: &Clues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<Model>, RunError> {
    /// Maximum residual of an arm that fits only with a fault, m: nominal model against calibrated arm.
    const FITS_M: f64 = 5e-4;
    let joints = clues.joints.len();
    let models = along(clues.joints, clues);
    let names: Vec<String> = models.iter().map(|model| label(model, clues.joints)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let Some(ranking) = (criteria.by_poses)(&models.iter().collect::<Vec<_>>()) else {
        return Err(RunError::Numbered { joints, arms: Vec::new(), best: None });
    };
    let ranking = ranking.with_unused_joints(|at| joints - moved(&models[at], clues.joints));
    let Some(best) = ranking.standings.first() else {
        return Err(RunError::Numbered { joints, arms: Vec::new(), best: None });
    };
    // A zero offset may fit slightly better, because it absorbs link deviations.
    let is_sound = best.fits_without_fault;
    let is_close = best.way.residual_m < FITS_M.min(FITS_SHARE * best.spread_m);
    if !best.fits || !(is_sound || is_close) {
        let best = Some(format!("{} ({})", names[best.model], best.words()));
        return Err(RunError::Numbered { joints, arms: Vec::new(), best });
    }
    let same = ranking.same();
    if same.iter().any(|other| !other.moves_as(best)) {
        let mut arms: Vec<String> = Vec::new();
        for one in same {
            if !arms.iter().any(|arm| arm == names[one.model]) {
                arms.push(names[one.model].to_owned());
            }
        }
        return Err(RunError::Numbered { joints, arms, best: None });
    }
    let found = ranking.words(&names, "as many joints");
    Ok(vec![Model { found, ..models[best.model].clone() }])
}

fn moved(model: &Model, logged: &[String]) -> usize {
    logged.iter().filter(|name| model.robot.joint(name).is_some()).count()
}

fn label(model: &Model, logged: &[String]) -> String {
    let name = &model.robot.name;
    let path = path_of(&model.robot).unwrap_or_default();
    match logged.starts_with(&path) {
        true => name.clone(),
        false => format!("{name} with its joints sorted by name"),
    }
}

enum Settled {
    One { way: Box<Match>, why: String },
    Open { ways: Vec<String> },
    None,
}

/// The match confirmed by poses, else the only one with numbered names that no pose contradicts.
fn settled(ways: Vec<Match>, criteria: &RankingCriteria<'_>) -> Settled {
    let is_only = ways.len() == 1 && ways[0].is_numbered;
    if !is_only {
        return proven(ways, criteria);
    }
    let ranking = (criteria.by_poses)(&[&ways[0].model]);
    let best = ranking.as_ref().and_then(|ranking| ranking.standings.first());
    let why = match best {
        None => Some("by their numbers, not confirmed by a pose stream".to_owned()),
        Some(best) if best.fits => Some(fits(best)),
        Some(_) => None,
    };
    match (why, ways.into_iter().next()) {
        (Some(why), Some(way)) => Settled::One { way: Box::new(way), why },
        (None, Some(way)) => Settled::Open { ways: vec![map_of(&way.pairs)] },
        _ => Settled::None,
    }
}

/// The match that fits the poses without a fault, if no other fits as well.
fn proven(ways: Vec<Match>, criteria: &RankingCriteria<'_>) -> Settled {
    let models: Vec<&Model> = ways.iter().map(|way| &way.model).collect();
    let Some(ranking) = (criteria.by_poses)(&models) else {
        return match ways.as_slice() {
            [] => Settled::None,
            _ => Settled::Open { ways: Vec::new() },
        };
    };
    let Some(best) = ranking.standings.iter().find(|one| is_sound(one)) else {
        return Settled::Open { ways: Vec::new() };
    };
    // A match with a fault counts if it explains as much.
    let is_as_good = |other: &&Standing| other.fits && other.score <= best.score + ranking.apart;
    let same: Vec<&Standing> = ranking.standings.iter().filter(is_as_good).collect();
    if same.len() > 1 {
        let label = |one: &&Standing| ways[one.model].model.robot.name.clone();
        let is_one_robot = same.iter().all(|one| label(one) == label(&same[0]));
        let shown = |one: &&Standing| match is_one_robot {
            true => map_of(&ways[one.model].pairs),
            false => label(one),
        };
        return Settled::Open { ways: same.iter().map(shown).collect() };
    }
    let next = ranking.standings.iter().find(|one| one.model != best.model);
    let why = match next {
        Some(next) => {
            let name = |one: &Standing| ways[one.model].model.robot.name.as_str();
            let other = if name(next) == name(best) { "in another order" } else { name(next) };
            let (count, how) = (ways.len(), next.words());
            format!("{}; the next best of {count}, {other}, within {how}", fits(best))
        }
        None => fits(best),
    };
    match ways.into_iter().nth(best.model) {
        Some(way) => Settled::One { way: Box::new(way), why },
        None => Settled::None,
    }
}

/// Whether a model fits without a fault, too closely for chance.
fn is_sound(one: &Standing) -> bool {
    one.fits
        && one.way.assumption.is_faultless()
        && !one.way.is_misinterpreted
        && one.way.residual_m < FITS_SHARE * one.spread_m
}

fn fits(one: &Standing) -> String {
    format!("{} fits within {}", one.topic, one.words())
}

fn ways(robot: &Robot, series: &Series, clues: &Clues<'_>) -> Vec<Match> {
    let Some(path) = path_of(robot) else { return Vec::new() };
    let windows = series.orders.iter().flat_map(|order| {
        let is_numbered = series.is_numbered && path.len() == order.len();
        order.windows(path.len().max(1)).map(move |window| (window, is_numbered))
    });
    let ways =
        windows.filter_map(|(window, is_numbered)| way(robot, &path, window, is_numbered, clues));
    ways.collect()
}

fn way(
    robot: &Robot,
    path: &[String],
    logged: &[String],
    is_numbered: bool,
    clues: &Clues<'_>,
) -> Option<Match> {
    let pairs: Vec<(String, String)> = logged.iter().cloned().zip(path.iter().cloned()).collect();
    let model = Model::new(renamed(robot, &pairs)?, String::new(), "", clues);
    let model = Model { by_order: true, ..model };
    Some(Match { model, pairs, is_numbered })
}

pub(super) fn renamed(robot: &Robot, pairs: &[(String, String)]) -> Option<Robot> {
    robot.with_joints_renamed(|name| {
        let pair = pairs.iter().find(|(_, modelled)| modelled == name);
        pair.map_or(name, |(logged, _)| logged).to_owned()
    })
}

fn path_of(robot: &Robot) -> Option<Vec<String>> {
    let paths = skeleton::arms(robot, |_| true);
    <[_; 1]>::try_from(paths).ok().map(|[path]| path.joints)
}

fn own_names(robot: &Robot) -> Vec<String> {
    let own = robot.joints().iter().filter(|joint| skeleton::is_own(joint));
    own.map(|joint| joint.name.clone()).collect()
}

/// Series of joints: names that differ only in a number. Otherwise all joints, in the log's order or that
/// of the arm parts they name.
fn series(joints: &[String]) -> Vec<Series> {
    let is_arms = |name: &&String| shared(&parts(name), OTHER_JOINTS).is_none();
    let arms: Vec<&String> = joints.iter().filter(is_arms).collect();
    let mut families: BTreeMap<(&str, &str), BTreeMap<u64, &String>> = BTreeMap::new();
    for name in &arms {
        if let Some((before, number, after)) = numbered(name) {
            families.entry((before, after)).or_default().insert(number, name);
        }
    }
    let numbered = families.into_values().filter(|family| family.len() >= FEWEST).map(|family| {
        Series { orders: vec![family.into_values().cloned().collect()], is_numbered: true }
    });
    let numbered: Vec<Series> = numbered.collect();
    match numbered.is_empty() {
        false => numbered,
        true if arms.len() < FEWEST => Vec::new(),
        true => {
            let logged: Vec<String> = arms.into_iter().cloned().collect();
            let by_part = by_part(&logged).filter(|order| *order != logged);
            let orders = std::iter::once(logged).chain(by_part).collect();
            vec![Series { orders, is_numbered: false }]
        }
    }
}

/// Joints ordered by arm part, then name. `None` if one names no part.
fn by_part(joints: &[String]) -> Option<Vec<String>> {
    let rank = |name: &String| {
        let words = parts(name);
        PARTS.iter().position(|part| shared(&words, part).is_some())
    };
    let mut ranked: Vec<(usize, &String)> =
        joints.iter().map(|name| Some((rank(name)?, name))).collect::<Option<_>>()?;
    ranked.sort();
    Some(ranked.into_iter().map(|(_, name)| name.clone()).collect())
}

fn parts(name: &str) -> Vec<String> {
    let words = words(name).into_iter();
    words.map(|word| word.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned()).collect()
}

/// Last number in a name, with the text around it.
fn numbered(name: &str) -> Option<(&str, u64, &str)> {
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = name[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + name[at..].chars().next().map_or(1, char::len_utf8));
    Some((&name[..start], name[start..end].parse().ok()?, &name[end..]))
}

/// Short form of a match: `a1…a7 are lbr_A1…lbr_A7`.
fn shown(pairs: &[(String, String)]) -> String {
    let ends = |name: fn(&(String, String)) -> &String| match pairs {
        [first, .., last] => format!("{}…{}", name(first), name(last)),
        _ => pairs.iter().map(name).cloned().collect(),
    };
    format!("{} are {}", ends(|pair| &pair.0), ends(|pair| &pair.1))
}

fn map_of(pairs: &[(String, String)]) -> String {
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
    fn numbers_say_the_order_and_each_arm_has_a_series() {
        let logged = names("l3 l1 r2 l2 r1 r4 l4 r3 finger1 finger2 finger3 finger4");
        let found = series(&logged);
        let joints: Vec<String> = found.iter().map(|series| series.orders[0].join(" ")).collect();
        assert_eq!(joints, ["l1 l2 l3 l4", "r1 r2 r3 r4"]);
        assert!(found.iter().all(|series| series.is_numbered));
    }

    #[test]
    fn without_numbers_it_is_the_order_of_the_log_or_that_of_the_parts_of_an_arm() {
        let logged = names("base elbow shoulder wrist_a wrist_b");
        let by_part = names("base shoulder elbow wrist_a wrist_b");
        let orders = |joints: &[String]| series(joints).pop().map(|series| series.orders);
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
        let ur = path_of(catalogue::find("ur5e").unwrap()).unwrap();
        let sorted = [2, 1, 0, 3, 4, 5].map(|at: usize| ur[at].clone()).to_vec();
        assert_eq!(usual_orders(&ur), [ur, sorted]);
        let panda = path_of(catalogue::find("franka_fr3").unwrap()).unwrap();
        assert_eq!(usual_orders(&panda), [panda]);
    }

    #[test]
    fn counted_joints_are_tried_in_both_orders_and_arms_with_fewer_joints_only_beside_a_gripper() {
        let frames = std::collections::BTreeSet::new();
        let space = super::super::space::Space::default();
        let clues = Clues {
            joints: &[],
            frames: &frames,
            descriptions: &[],
            calibrations: &[],
            joint_map: &[],
            space: &space,
            robot_type: None,
        };
        let arms = along(&names("q1 q2 q3 q4 q5 q6 q7"), &clues);
        assert_eq!(arms.iter().filter(|model| model.robot.name == "ur5e").count(), 2);
        let dof = |model: &Model| path_of(&model.robot).map_or(0, |path| path.len());
        assert!(arms.iter().all(|model| (6..=7).contains(&dof(model))));
    }

    #[test]
    fn the_last_number_counts() {
        assert_eq!(numbered("arm2_joint10_pos"), Some(("arm2_joint", 10, "_pos")));
        assert_eq!(numbered("7"), Some(("", 7, "")));
        assert_eq!(numbered("gelenk_ä3"), Some(("gelenk_ä", 3, "")));
        assert_eq!(numbered("elbow"), None);
    }
}
