//! Selects the robot models of a log, with its names.

use std::collections::BTreeSet;
use std::path::Path;

use crate::robot::{Robot, catalogue, nearest};

use super::catalogue_selection::{
    RankingCriteria, arm_of_type, mapped_models_from_catalogue, models_from_catalogue,
};
use super::declaration::{JointName, RobotSource};
use super::error::RunError;
use super::joint_order;
use super::model::{LogModel, ModelClues};
use super::namespace::{Namespace, NamespaceMatch};
use super::skeleton::independent_joint_names;
use super::{RunOptions, SharedMapping};

/// A robot given by the caller, and its joint name prefix, or a word of its topic.
pub(super) struct GivenRobot {
    robot: Robot,
    prefix: Option<String>,
    selected_by: String,
}

/// Reads the caller's robots.
///
/// # Errors
/// If one is neither a file nor in the catalogue, or its file is invalid.
pub(super) fn read_given(sources: &[RobotSource]) -> Result<Vec<GivenRobot>, RunError> {
    sources
        .iter()
        .map(|source| {
            let (robot, prefix) = (source.robot()?, source.prefix.clone());
            Ok(GivenRobot { robot, prefix, selected_by: "--robot".to_owned() })
        })
        .collect()
}

/// The caller's robots, or the arm determined from other logs.
///
/// # Errors
/// Those of [`read_given`].
pub(super) fn read_given_or_shared(options: &RunOptions) -> Result<Vec<GivenRobot>, RunError> {
    let Some(SharedMapping { robot: Some(robot), from, .. }) = &options.shared else {
        return read_given(&options.robots);
    };
    if !options.robots.is_empty() {
        return read_given(&options.robots);
    }
    let by = format!("the catalogue, as for {}", from.join(", "));
    Ok(vec![GivenRobot { robot: load_robot(robot)?, prefix: None, selected_by: by }])
}

/// Models that may name numbered joints, with prefixes: the caller's, or the metadata's catalogue arm.
pub(super) fn robots_for_numbered_joints<'a>(
    given: &'a [GivenRobot],
    robot_type: Option<&str>,
) -> Vec<(&'a Robot, Option<&'a str>)> {
    if given.is_empty() {
        return robot_type.and_then(arm_of_type).map(|robot| (robot, None)).into_iter().collect();
    }
    given.iter().map(|given| (&given.robot, given.prefix.as_deref())).collect()
}

/// Loads a robot from URDF, TOML, or the catalogue.
///
/// # Errors
/// If the file is invalid, or the catalogue lacks the name.
pub fn load_robot(model: &str) -> Result<Robot, RunError> {
    let path = Path::new(model);
    if path.is_file() || path.extension().is_some() {
        return Ok(Robot::from_file(path)?);
    }
    catalogue::find(model).cloned().ok_or_else(|| RunError::UnknownRobot {
        name: model.to_owned(),
        nearest: catalogue::nearest_names(model).into_iter().map(str::to_owned).collect(),
    })
}

/// Robots of the log: the caller's, else the log's, else catalogue arms with matching joints. Of equal
/// names, takes the one with the fewest causes by `criteria`.
///
/// # Errors
/// If no robot has the joints.
pub(super) fn select_models(
    given: &[GivenRobot],
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    if !given.is_empty() {
        let alone = given.len() == 1;
        let models = given.iter().map(|given| models_of_given(given, alone, clues, criteria));
        if !clues.namespace.is_one_of_several() {
            return models.collect::<Result<Vec<_>, _>>().map(|models| models.concat());
        }
        // Each model may belong to one of several arms.
        let (found, refused): (Vec<_>, Vec<_>) = models.partition(Result::is_ok);
        let found: Vec<LogModel> = found.into_iter().flatten().flatten().collect();
        return match refused.into_iter().next() {
            Some(refusal) if found.is_empty() => refusal,
            _ => Ok(found),
        };
    }
    let mut refusal: Option<RunError> = None;
    let mut described: Vec<LogModel> = Vec::new();
    let places: Vec<&String> = clues.descriptions.iter().map(|(place, _)| place).collect();
    let namespaces = Namespace::from_names(&places);
    let read = |(place, text): &(String, String)| {
        Robot::from_text(text, place)
            .map_err(|error| refusal = refusal.take().or(Some(error.into())))
            .ok()
    };
    let robots: Vec<Option<Robot>> = clues.descriptions.iter().map(read).collect();
    // Other prefixes may not give a robot the joints of another one.
    let is_of_another = |joint: &str, own: &Robot| {
        own.joint(joint).is_none() && robots.iter().flatten().any(|it| it.joint(joint).is_some())
    };
    for (((place, _), namespace), robot) in clues.descriptions.iter().zip(&namespaces).zip(&robots)
    {
        let found = format!("the description in the log ({place})");
        // Each of several descriptions describes the joints of its topic name.
        let is_its =
            |joint: &&String| namespace.match_names([joint.as_str()]) == NamespaceMatch::Own;
        let own: Vec<String> = clues.joints.iter().filter(is_its).cloned().collect();
        let mut joints = if own.is_empty() { clues.joints.to_vec() } else { own };
        let Some(robot) = robot else { continue };
        joints.retain(|joint| !is_of_another(joint, robot));
        match match_names((robot, &joints, true), clues, criteria, &found) {
            Ok(models) => {
                let is_new = |model: &LogModel| {
                    !described.iter().any(|other| have_same_joints(other, model))
                };
                let new: Vec<LogModel> = models.into_iter().filter(is_new).collect();
                described.extend(new);
            }
            Err(error) => refusal = refusal.or(Some(error)),
        }
    }
    if !described.is_empty() {
        return Ok(described);
    }
    let maps = joint_maps(clues.joint_map, clues.joints);
    let mut catalogued = match maps.is_empty() {
        true => models_from_catalogue(clues, criteria)?,
        false => mapped_models_from_catalogue(&maps, clues, criteria)?,
    };
    if catalogued.is_empty() {
        catalogued = joint_order::match_catalogue(clues, criteria)?;
    }
    if catalogued.is_empty() {
        let none = || RunError::NoModel { logged: clues.joints.to_vec() };
        return Err(refusal.unwrap_or_else(none));
    }
    if let Some(RunError::Robot(error)) = refusal {
        for model in &mut catalogued {
            model.identified_by += &format!("; the description in the log was skipped: {error}");
        }
    }
    Ok(catalogued)
}

fn models_of_given(
    given: &GivenRobot,
    alone: bool,
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    let is_of_space = given
        .prefix
        .as_deref()
        .is_some_and(|prefix| clues.namespace.match_names([prefix]) == NamespaceMatch::Own);
    let fits = |name: &&String| {
        is_of_space || given.prefix.as_deref().is_none_or(|prefix| name.starts_with(prefix))
    };
    let joints: Vec<String> = clues.joints.iter().filter(fits).cloned().collect();
    let may_repeat = alone && given.prefix.is_none();
    match_names((&given.robot, &joints, may_repeat), clues, criteria, &given.selected_by)
}

/// Matches a robot's joint names by the caller's mapping, else spelling, else order.
fn match_names(
    (robot, joints, may_repeat): (&Robot, &[String], bool),
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
    found: &str,
) -> Result<Vec<LogModel>, RunError> {
    let maps = joint_maps(clues.joint_map, joints);
    if !maps.is_empty() {
        let found = format!("{found}, joints mapped by --joint-map");
        let mapped = maps.iter().map(|map| {
            let lacking = map.iter().find(|(_, modelled)| robot.joint(modelled).is_none());
            if let Some((_, name)) = lacking {
                let near = nearest(name, robot.joints().iter().map(|joint| joint.name.as_str()));
                let near =
                    near.first().map_or(String::new(), |near| format!("; did you mean '{near}'?"));
                let what = format!("'{name}' is not a joint of {}{near}", robot.name);
                return Err(RunError::JointMap { what });
            }
            let what = format!("two joints of {} would have the same name", robot.name);
            let renamed =
                joint_order::rename_joints(robot, map).ok_or(RunError::JointMap { what })?;
            match_by_prefix(&renamed, clues, joints.to_vec(), false, &found)
        });
        return mapped.collect::<Result<Vec<_>, _>>().map(|models| models.concat());
    }
    match match_by_prefix(robot, clues, joints.to_vec(), may_repeat, found) {
        Err(RunError::UnknownJoints { .. }) => {
            let by_words = joint_order::match_words(robot, joints, clues, found);
            match by_words.len() {
                0 => joint_order::match_robot(robot, joints, clues, criteria, found),
                1 => Ok(by_words),
                _ if may_repeat => Ok(by_words),
                _ => joint_order::match_robot(robot, joints, clues, criteria, found),
            }
        }
        models => models,
    }
}

/// The caller's mapping as logged and model names; one map per arm if several logged joints share a model
/// joint.
fn joint_maps(names: &[JointName], joints: &[String]) -> Vec<Vec<(String, String)>> {
    let mut maps: Vec<Vec<(String, String)>> = Vec::new();
    for JointName { logged, modelled } in names.iter().filter(|name| joints.contains(&name.logged))
    {
        let lacks = |map: &&mut Vec<(String, String)>| map.iter().all(|pair| pair.1 != *modelled);
        let pair = (logged.clone(), modelled.clone());
        match maps.iter_mut().find(lacks) {
            Some(map) => map.push(pair),
            None => maps.push(vec![pair]),
        }
    }
    maps
}

/// Renames `robot` with the best prefix. If it `may_repeat`, adds a model per equally good set of names
/// (two arms of one model).
fn match_by_prefix(
    robot: &Robot,
    clues: &ModelClues<'_>,
    mut joints: Vec<String>,
    may_repeat: bool,
    found: &str,
) -> Result<Vec<LogModel>, RunError> {
    let unprefixed = without_space(robot, clues.namespace, &joints);
    let robot = unprefixed.as_ref().unwrap_or(robot);
    let mut models: Vec<LogModel> = Vec::new();
    let mut fitted = 0;
    while let Some(names) = robot.match_joint_names(&joints).into_iter().next() {
        let is_enough = match models.is_empty() {
            true => names.matched > 1 || names.is_complete(),
            false => may_repeat && names.matched == fitted,
        };
        if !is_enough {
            break;
        }
        fitted = names.matched;
        let Some(renamed) = robot.with_prefix_replaced(&names.from_prefix, &names.to_prefix) else {
            break;
        };
        let renamed = with_plain_names(&renamed, robot, &joints).unwrap_or(renamed);
        joints.retain(|joint| renamed.joint(joint).is_none());
        let found = match names.from_prefix == names.to_prefix {
            true => found.to_owned(),
            false => format!(
                "{found}, with '{}' for '{}' in its names",
                names.to_prefix, names.from_prefix
            ),
        };
        models.push(LogModel::new(renamed, found, &names.to_prefix, clues));
    }
    if models.is_empty() {
        return Err(RunError::UnknownJoints {
            robot: robot.name.clone(),
            source: robot.source.clone(),
            logged: clues.joints.to_vec(),
            modelled: independent_joint_names(robot),
            matches: Vec::new(),
        });
    }
    Ok(models)
}

/// Removes an arm's prefix that the log has in the topic name: model `left_elbow`, `elbow` on
/// `/left/joint_states`.
fn without_space(robot: &Robot, namespace: &Namespace, joints: &[String]) -> Option<Robot> {
    let known = |robot: &Robot| joints.iter().filter(|name| robot.joint(name).is_some()).count();
    let own: Vec<&str> = robot
        .joints()
        .iter()
        .map(|joint| joint.name.as_str())
        .filter(|name| namespace.match_names([*name]) == NamespaceMatch::Own)
        .collect();
    let prefixes: BTreeSet<&str> = own
        .iter()
        .flat_map(|name| joints.iter().filter_map(move |logged| name.strip_suffix(logged.as_str())))
        .filter(|prefix| !prefix.is_empty())
        .collect();
    let bare = prefixes.into_iter().filter_map(|prefix| {
        let strip = |name: &str| match namespace.match_names([name]) {
            NamespaceMatch::Own => name.strip_prefix(prefix).unwrap_or(name).to_owned(),
            _ => name.to_owned(),
        };
        robot.with_joints_renamed(strip)
    });
    bare.max_by_key(|bare| known(bare)).filter(|bare| known(bare) > known(robot))
}

/// Restores names that the log has without the new prefix, such as a rail's.
fn with_plain_names(renamed: &Robot, robot: &Robot, joints: &[String]) -> Option<Robot> {
    let plain: Vec<(&String, &String)> = renamed
        .joints()
        .iter()
        .zip(robot.joints())
        .map(|(new, old)| (&new.name, &old.name))
        .filter(|(new, old)| new != old && !joints.contains(new) && joints.contains(old))
        .collect();
    if plain.is_empty() {
        return None;
    }
    renamed.with_joints_renamed(|name| {
        let old = plain.iter().find(|(new, _)| *new == name).map(|(_, old)| old.as_str());
        old.unwrap_or(name).to_owned()
    })
}

fn have_same_joints(a: &LogModel, b: &LogModel) -> bool {
    let [a, b] = [a, b].map(|model| BTreeSet::from_iter(independent_joint_names(&model.robot)));
    a == b
}

#[cfg(test)]
mod tests {
    use super::super::given_calibrations::{GivenCalibration, overlay_all};
    use super::*;
    use crate::robot::Calibration;

    const UR: [&str; 6] = [
        "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint",
        "wrist_2_joint", "wrist_3_joint",
    ];

    static ALONE: std::sync::LazyLock<Namespace> = std::sync::LazyLock::new(Namespace::default);

    fn no_clues() -> ModelClues<'static> {
        let (joints, frames) = (&[], const { &BTreeSet::new() });
        ModelClues {
            joints,
            frames,
            descriptions: &[],
            calibrations: &[],
            namespace: &ALONE,
            robot_type: None,
            joint_map: &[],
        }
    }

    const NOBODY: RankingCriteria<'static> =
        RankingCriteria { by_transforms: &|_| None, by_poses: &|_| None };

    fn prefixed(prefix: &str) -> Vec<String> {
        UR.iter().map(|name| format!("{prefix}{name}")).collect()
    }

    fn ur5e(joints: &[String], frames: &[&str]) -> Result<Vec<LogModel>, RunError> {
        let frames = frames.iter().map(|&frame| frame.to_owned()).collect();
        let clues = ModelClues { joints, frames: &frames, ..no_clues() };
        select_models(&read_given(&["ur5e".into()])?, &clues, &NOBODY)
    }

    #[test]
    fn a_joint_prefix_is_added_to_the_model_names() {
        let models = ur5e(&prefixed("left_"), &["left_base_link", "left_tool0"]).unwrap();
        assert!(models[0].robot.joint("left_elbow_joint").is_some());
        assert!(models[0].frames.link_of(&models[0].robot, "left_tool0").is_some());
    }

    #[test]
    fn frames_may_carry_a_prefix_that_joints_do_not_and_the_other_way_round() {
        let model = &ur5e(&prefixed(""), &["ur5e/base", "ur5e/tool0", "world"]).unwrap()[0];
        let tool = model.frames.link_of(&model.robot, "ur5e/tool0").unwrap();
        assert_eq!(model.robot.link_name(tool), "tool0");
        assert_eq!(model.frames.frame_of("flange"), "ur5e/flange");
        let model = &ur5e(&prefixed("a/"), &["base", "tool0"]).unwrap()[0];
        assert_eq!(model.frames.frame_of("a/tool0"), "tool0");
    }

    #[test]
    fn the_world_of_a_tracker_is_not_that_of_the_model() {
        for world in ["mocap_world", "vive/world", "tracker/map"] {
            let model = &ur5e(&prefixed(""), &[world]).unwrap()[0];
            assert!(model.frames.link_of(&model.robot, world).is_none(), "{world}");
        }
    }

    #[test]
    fn a_rail_may_go_without_the_prefix_of_its_arm() {
        let joints = ["rail revolute base cart", "a1 revolute cart l1", "a2 revolute l1 l2"];
        let robot = crate::run::skeleton::tests::robot(&joints);
        let logged = ["rail", "x_a1", "x_a2"].map(str::to_owned);
        let clues = ModelClues { joints: &logged, ..no_clues() };
        let found = match_by_prefix(&robot, &clues, logged.to_vec(), true, "test").unwrap();
        assert!(logged.iter().all(|name| found[0].robot.joint(name).is_some()));
    }

    #[test]
    fn joints_of_one_of_two_arms_are_matched_by_topic_name() {
        let joints =
            ["left_a1 revolute base l1", "left_a2 revolute l1 l2", "right_a1 revolute base r1"];
        let robot = crate::run::skeleton::tests::robot(&joints);
        let logged = ["a1", "a2"].map(str::to_owned);
        let namespaces = Namespace::from_names(&["/left/joint_states", "/right/joint_states"]);
        let clues = ModelClues { joints: &logged, namespace: &namespaces[0], ..no_clues() };
        let found = match_by_prefix(&robot, &clues, logged.to_vec(), true, "test").unwrap();
        assert!(found[0].robot.joint("a2").is_some() && found[0].robot.joint("right_a1").is_some());
    }

    #[test]
    fn one_model_may_describe_two_arms() {
        let joints = [prefixed("left_"), prefixed("right_")].concat();
        let models = ur5e(&joints, &[]).unwrap();
        assert_eq!(models.len(), 2);
        assert!(models[1].robot.joint("right_elbow_joint").is_some());
    }

    /// With another prefix, the second description would have two of the three joints of the first.
    #[test]
    fn joints_of_one_description_do_not_get_another() {
        let joints = |prefix: &str, count: usize| -> Vec<String> {
            let joint = |i: usize| format!("{prefix}{i} revolute l{i} l{}", i + 1);
            (1..=count).map(joint).collect()
        };
        let texts = [joints("a_axis_", 3), joints("b_axis_", 2)].map(|joints| {
            let joints: Vec<&str> = joints.iter().map(String::as_str).collect();
            crate::run::skeleton::tests::urdf(&joints)
        });
        let places = ["/left/robot_description", "/right/robot_description"];
        let descriptions: Vec<(String, String)> =
            places.map(str::to_owned).into_iter().zip(texts).collect();
        let logged = ["a_axis_1", "a_axis_2", "a_axis_3", "b_axis_1", "b_axis_2"];
        let logged = logged.map(str::to_owned);
        let clues = ModelClues { joints: &logged, descriptions: &descriptions, ..no_clues() };
        let models = select_models(&[], &clues, &NOBODY).unwrap();
        assert_eq!(models.len(), 2);
    }

    #[test]
    fn separators_the_word_joint_and_prefixes_do_not_matter() {
        let plain = ["shoulder_pan", "ShoulderLift", "elbow", "wrist1", "Wrist 2", "wrist-3"];
        let of = |prefix: &str| plain.map(|name| format!("{prefix}{name}")).to_vec();
        let model = &ur5e(&of(""), &[]).unwrap()[0];
        assert!(plain.iter().all(|name| model.robot.joint(name).is_some()));
        let models = ur5e(&[of("R_"), of("S_")].concat(), &[]).unwrap();
        assert_eq!(models.len(), 2);
        assert!(models[1].robot.joint("S_wrist1").is_some());
        assert!(ur5e(&of("")[1..], &[]).is_err());
    }

    #[test]
    fn joints_of_another_robot_are_an_error_that_shows_both() {
        let error = ur5e(&["panda_joint1".to_owned(), "panda_joint2".to_owned()], &[]).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("panda_joint1") && text.contains("elbow_joint"), "{text}");
    }

    #[test]
    fn joint_names_give_the_controller_links() {
        let model = &ur5e(&prefixed(""), &[]).unwrap()[0];
        assert_eq!(model.controller_base.map(|link| model.robot.link_name(link)), Some("base"));
    }

    #[test]
    fn an_unknown_robot_is_an_error_with_near_names() {
        for (name, meant) in
            [("ur5f", "'ur5'"), ("fer", "'franka_fer'"), ("iiwa_14", "'kuka_lbr_iiwa14'")]
        {
            let text = read_given(&[name.into()]).err().map(|error| error.to_string()).unwrap();
            assert!(text.contains("did you mean ") && text.contains(meant), "{name}: {text}");
        }
    }

    const CALIBRATION: &str = "\
kinematics:
  shoulder: {x: 0, y: 0, z: 0.1627, roll: 0, pitch: 0, yaw: 0}
  upper_arm: {x: 0.0001, y: 0, z: 0, roll: 1.5706, pitch: 0, yaw: 0}
  forearm: {x: -0.4254, y: 0, z: 0, roll: 0.0009, pitch: 0.0022, yaw: 0}
  wrist_1: {x: -0.3926, y: 0, z: 0.1339, roll: 0, pitch: -0.0012, yaw: 0}
  wrist_2: {x: 0.0001, y: -0.0997, z: 0.0001, roll: 1.5694, pitch: 0, yaw: 0}
  wrist_3: {x: 0, y: 0.0996, z: 0.0001, roll: 1.5716, pitch: 3.14159265, yaw: -3.14159262}
  hash: calib_1";

    fn height_of_shoulder(model: &LogModel, prefix: &str) -> f64 {
        let joint = model.robot.joint(&format!("{prefix}shoulder_pan_joint")).unwrap();
        joint.parent_from_joint.translation.z
    }

    #[test]
    fn a_calibration_in_the_log_is_applied_to_its_ur_and_reported_for_another() {
        let joints = prefixed("");
        let found = [("arm.yaml".to_owned(), CALIBRATION.to_owned())];
        let clues = ModelClues { joints: &joints, calibrations: &found, ..no_clues() };
        let of_ur5e = ("ur5e", 0.1627, "with the calibration arm.yaml (calib_1)");
        for (robot, shoulder_m, remark) in [of_ur5e, ("ur10e", 0.1807, "was skipped")] {
            let given = read_given(&[robot.into()]).unwrap();
            let mut models = select_models(&given, &clues, &NOBODY).unwrap();
            overlay_all(&mut models, &[], &clues).unwrap();
            assert_eq!(height_of_shoulder(&models[0], ""), shoulder_m);
            assert!(models[0].identified_by.contains(remark), "{}", models[0].identified_by);
        }
    }

    #[test]
    fn the_prefix_assigns_a_calibration_to_one_of_two_arms() {
        let joints = [prefixed("left_"), prefixed("right_")].concat();
        let both = || ur5e(&joints, &[]).unwrap();
        let calibration = || Calibration::from_text(CALIBRATION, "arm.yaml").unwrap();
        let named = |prefix: Option<&str>| {
            let prefix = prefix.map(str::to_owned);
            [GivenCalibration { calibration: calibration(), prefix }]
        };
        let mut models = both();
        overlay_all(&mut models, &named(Some("right_")), &no_clues()).unwrap();
        assert_eq!(height_of_shoulder(&models[0], "left_"), 0.1625);
        assert_eq!(height_of_shoulder(&models[1], "right_"), 0.1627);
        let error = overlay_all(&mut both(), &named(None), &no_clues()).unwrap_err().to_string();
        assert!(error.contains("'left_', 'right_'") && error.contains("PREFIX="), "{error}");
        let error =
            overlay_all(&mut both(), &named(Some("x_")), &no_clues()).unwrap_err().to_string();
        assert!(error.starts_with("arm.yaml: no arm of the log"), "{error}");
    }
}
