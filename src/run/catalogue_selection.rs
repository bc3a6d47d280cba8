//! Selects the catalogue arm if several have the log's joint names.

use std::collections::BTreeMap;

use crate::diagnosis::{FitCause, HypothesisFit};
use crate::finding::Unit;
use crate::robot::{Robot, catalogue};

use super::error::RunError;
use super::joint_order;
use super::model::{LogModel, ModelClues};

pub(super) struct RankingCriteria<'a> {
    /// Rms difference of logged transforms and link lengths, m.
    pub by_transforms: &'a dyn Fn(&LogModel) -> Option<f64>,
    /// Ranks models by necessary assumptions.
    pub by_poses: &'a dyn Fn(&[&LogModel]) -> Option<ModelRanking>,
}

/// Minimum score difference of distinguishable models: a likelihood ratio of e¹⁰.
pub(super) const MIN_SCORE_DIFFERENCE: f64 = 20.0;

pub(super) struct ModelRanking {
    /// Best first; the smallest assumption first among indistinguishable ones.
    pub models: Vec<RankedModel>,
}

pub(super) struct RankedModel {
    pub model: usize,
    /// Lower is better.
    pub score: f64,
    pub hypothesis: HypothesisFit,
    /// Rms distance of the positions from their mean, m.
    pub spread_m: f64,
    /// Residual as logged, m.
    pub logged_residual_m: f64,
    /// Whether the residual is small enough.
    pub is_fit: bool,
    pub is_fit_without_fault: bool,
    /// Whether no other model can score lower by [`MIN_SCORE_DIFFERENCE`].
    pub is_unbeatable: bool,
    /// Topic with the smallest residual.
    pub topic: String,
}

/// Maximum residual of a fit that shows something, as a share of the positions' extent: free frames fit a
/// tip at rest with any arm.
pub(super) const MAX_RESIDUAL_SHARE: f64 = 0.02;

impl RankedModel {
    /// Whether two residuals are equal: as far as this motion shows, the links are too, and audits agree.
    pub fn is_equivalent_to(&self, other: &Self) -> bool {
        /// Rounding, and early termination of the fit. With faults, few postures fit other links exactly.
        const ROUNDING_M: f64 = 1e-8;
        const MAX_RELATIVE_DIFFERENCE: f64 = 1e-3;
        let both = |is: fn(&Self) -> bool| is(self) && is(other);
        let (a, b) = (self.hypothesis.residual_m, other.hypothesis.residual_m);
        let rounding_m = if both(Self::needs_no_fault) { ROUNDING_M } else { 0.0 };
        both(Self::is_beyond_chance)
            && (a - b).abs() <= rounding_m + MAX_RELATIVE_DIFFERENCE * a.max(b)
    }

    pub fn needs_no_fault(&self) -> bool {
        self.hypothesis.cause.is_faultless() && !self.hypothesis.is_misinterpreted
    }

    pub fn is_beyond_chance(&self) -> bool {
        self.hypothesis.residual_m < MAX_RESIDUAL_SHARE * self.spread_m
    }

    /// Whether it needs a fault, and a model without one fits at least as well.
    fn is_dominated_by(&self, other: &Self) -> bool {
        other.needs_no_fault()
            && !self.needs_no_fault()
            && self.hypothesis.residual_m >= other.hypothesis.residual_m
    }

    pub fn describe(&self) -> String {
        let residual = Unit::Metre.show(self.hypothesis.residual_m);
        let tool = match self.hypothesis.has_tool {
            true => format!(" with a TCP of {}", Unit::Metre.show(self.hypothesis.tool_m.norm())),
            false => String::new(),
        };
        match self.hypothesis.cause {
            _ if self.fault().is_some() => {
                format!("{residual} {}", self.fault().unwrap_or_default())
            }
            FitCause::HalfTurn => format!("{residual} in a base turned by 180°{tool}"),
            _ => residual + &tool,
        }
    }

    /// The fault that it needs.
    fn fault(&self) -> Option<&'static str> {
        match self.hypothesis.cause {
            _ if self.hypothesis.is_misinterpreted => {
                Some("with inverted poses or joints in degrees")
            }
            FitCause::Nothing | FitCause::HalfTurn => None,
            FitCause::Zero { .. } => Some("with a joint zero offset"),
            FitCause::Reference => Some("in another frame"),
        }
    }
}

impl ModelRanking {
    /// Adds a penalty per unused logged joint, such as a gripper.
    pub fn with_unused_joints(mut self, unused: impl Fn(usize) -> usize) -> Self {
        for standing in &mut self.models {
            standing.score += MIN_SCORE_DIFFERENCE * unused(standing.model) as f64;
        }
        let least = self.models.iter().map(|one| one.score).fold(f64::INFINITY, f64::min);
        let is_near = |one: &RankedModel| one.score <= least + MIN_SCORE_DIFFERENCE;
        // Stable: the smallest assumption stays first.
        self.models.sort_by(|a, b| match (is_near(a), is_near(b)) {
            (true, true) => std::cmp::Ordering::Equal,
            _ => a.score.total_cmp(&b.score),
        });
        self
    }

    /// The best model, and those indistinguishable from it that fit.
    pub fn ties(&self) -> Vec<&RankedModel> {
        let Some(best) = self.models.first() else { return Vec::new() };
        let others = self.models.iter().skip(1);
        let is_same = |other: &&RankedModel| {
            other.is_fit
                && other.score <= best.score + MIN_SCORE_DIFFERENCE
                && !other.is_dominated_by(best)
        };
        std::iter::once(best).chain(others.filter(is_same)).collect()
    }

    /// Arms with other links that this motion cannot distinguish from the best.
    fn indistinguishable(&self) -> Vec<&RankedModel> {
        let Some(best) = self.models.first() else { return Vec::new() };
        let others = self.ties().into_iter().skip(1);
        others.filter(|other| !other.is_equivalent_to(best)).collect()
    }

    fn not_distinguished(&self) -> Vec<&RankedModel> {
        let Some(best) = self.models.first() else { return Vec::new() };
        let least = self.models.iter().map(|one| one.score).fold(f64::INFINITY, f64::min);
        let others = self.models.iter().skip(1).filter(|other| !other.is_dominated_by(best));
        others.filter(|other| other.score <= least + MIN_SCORE_DIFFERENCE).collect()
    }

    /// Compares the best model with the others, in words.
    pub fn describe(&self, names: &[&str], shared_property: &str) -> String {
        let [best, others @ ..] = self.models.as_slice() else { return String::new() };
        let same = self.not_distinguished();
        let is_near = |one: &RankedModel| same.iter().any(|other| other.model == one.model);
        let mut words = format!(
            "the catalogue: best match of {} arms with {shared_property}: {} fits within {}",
            names.len(),
            best.topic,
            best.describe()
        );
        if let Some(next) = others.iter().find(|one| !is_near(one)) {
            // With a fault, the residual of the sampled positions says little about the arm.
            words += &match next.fault() {
                Some(fault) => format!("; next best {}, but only {fault}", names[next.model]),
                None => format!("; next best {}, within {}", names[next.model], next.describe()),
            };
            if next.hypothesis.residual_m < best.hypothesis.residual_m {
                words += ", which is less likely";
            }
        }
        if !same.is_empty() {
            let same: Vec<String> = same
                .iter()
                .map(|other| format!("{} ({})", names[other.model], other.describe()))
                .collect();
            words += &format!(
                "; this motion cannot distinguish it from {}: name yours with --robot",
                same.join(", ")
            );
        }
        words
    }
}

/// Catalogue arms with the log's joint names. Of arms with equal names, the one that needs the fewest
/// causes.
///
/// If the names match only without an unknown prefix, or are as short as `J1`, the arm must also fit,
/// because such names are common.
pub(super) fn models_from_catalogue(
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    let mut joints = clues.joints.to_vec();
    if joint_order::are_numbered(&joints) {
        return joint_order::match_numbered(clues, criteria);
    }
    let mut models: Vec<LogModel> = Vec::new();
    loop {
        let found = catalogue::candidates_for(&joints);
        let counts_alike = |candidate: &catalogue::Candidate| {
            candidate.renamed().is_some_and(|robot| !skips_lower_numbers(&robot, &joints))
        };
        let found: Vec<catalogue::Candidate> = found.into_iter().filter(counts_alike).collect();
        let equals: Vec<LogModel> = found
            .iter()
            .filter(|other| {
                other.names.is_complete() && other.names.joints == found[0].names.joints
            })
            .filter(|other| other.names.unknown_prefix_chars == found[0].names.unknown_prefix_chars)
            .filter_map(|candidate| LogModel::from_candidate(candidate, String::new(), clues))
            .collect();
        if equals.is_empty() {
            return Ok(models);
        }
        let must_fit = found[0].names.unknown_prefix_chars > 0 || has_short_names(&equals[0].robot);
        match select_one(equals, must_fit, criteria)
            .or_else(|error| model_by_type(&found, clues).ok_or(error))
        {
            Ok(Some(model)) => {
                joints.retain(|joint| model.robot.joint(joint).is_none());
                models.push(model);
            }
            Ok(None) => return Ok(models),
            Err(_) if !models.is_empty() => return Ok(models),
            Err(error) => return Err(error),
        }
    }
}

/// Whether the arm lacks the first joints of its series in the log, such as `joint_0` of seven: then the names
/// count from another number, and match by chance.
fn skips_lower_numbers(robot: &Robot, logged: &[String]) -> bool {
    let mut series: BTreeMap<(&str, &str), BTreeMap<u64, bool>> = BTreeMap::new();
    for name in logged {
        if let Some((before, number, after)) = joint_order::split_at_number(name) {
            let is_own = robot.joint(name).is_some();
            series.entry((before, after)).or_default().insert(number, is_own);
        }
    }
    let begins_with_another =
        |numbers: &BTreeMap<u64, bool>| numbers.values().next() == Some(&false);
    series.values().any(|numbers| begins_with_another(numbers) && numbers.values().any(|own| *own))
}

/// Whether all joints have a number and at most two letters, such as `J1`.
fn has_short_names(robot: &Robot) -> bool {
    const MAX_LETTERS: usize = 2;
    let letters = |name: &str| name.chars().filter(|c| c.is_alphabetic()).count();
    let mut moving = robot.joints().iter().filter(|joint| joint.kind.has_position());
    moving.all(|joint| letters(&joint.name) <= MAX_LETTERS)
}

fn model_by_type(
    found: &[catalogue::Candidate],
    clues: &ModelClues<'_>,
) -> Option<Option<LogModel>> {
    let robot_type = clues.robot_type?;
    let named = arm_of_type(robot_type)?;
    let candidate = found.iter().find(|candidate| candidate.robot().name == named.name)?;
    let how = format!("the catalogue, by the robot type '{robot_type}' in the metadata");
    LogModel::from_candidate(candidate, how, clues).map(Some)
}

/// Catalogue arm named in the metadata: `so101_follower` is a `so101`.
pub(super) fn arm_of_type(robot_type: &str) -> Option<&'static Robot> {
    let words: Vec<&str> = robot_type.split(['_', '-', ' ']).collect();
    (1..=words.len()).rev().find_map(|count| catalogue::find(&words[..count].join("_")))
}

/// Catalogue arms with the joints of the caller's maps; per map, the one with the fewest causes.
pub(super) fn mapped_models_from_catalogue(
    maps: &[Vec<(String, String)>],
    clues: &ModelClues<'_>,
    criteria: &RankingCriteria<'_>,
) -> Result<Vec<LogModel>, RunError> {
    let each = maps.iter().map(|map| {
        let has_all = |robot: &&Robot| map.iter().all(|(_, name)| robot.joint(name).is_some());
        let renamed = catalogue::entries().filter(has_all).filter_map(|robot| {
            Some(LogModel::new(joint_order::rename_joints(robot, map)?, String::new(), "", clues))
        });
        let equals: Vec<LogModel> = renamed.collect();
        if equals.is_empty() {
            let names: Vec<&str> = map.iter().map(|(_, name)| name.as_str()).collect();
            let what = format!("no catalogue arm has the joints {}", names.join(", "));
            return Err(RunError::JointMap { what });
        }
        select_one(equals, false, criteria)
    });
    Ok(each.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
}

fn select_one(
    equals: Vec<LogModel>,
    must_fit: bool,
    criteria: &RankingCriteria<'_>,
) -> Result<Option<LogModel>, RunError> {
    const MAX_MISFIT_M: f64 = 0.01;
    /// Minimum margin over the next arm, m.
    const MIN_MARGIN_M: f64 = 1e-3;
    let take = |at: usize, found: String| {
        let model = equals.get(at).cloned()?;
        Some(LogModel { identified_by: found, ..model })
    };
    let names: Vec<&str> = equals.iter().map(|model| model.robot.name.as_str()).collect();
    let mut by_transforms: Vec<(f64, usize)> = equals
        .iter()
        .enumerate()
        .map(|(at, model)| ((criteria.by_transforms)(model).unwrap_or(f64::INFINITY), at))
        .collect();
    by_transforms.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let [(_, only)] = by_transforms.as_slice() {
        let fits = || {
            let by_poses = (criteria.by_poses)(&equals.iter().collect::<Vec<_>>());
            by_transforms[0].0 < MAX_MISFIT_M
                || by_poses.is_some_and(|ranking| ranking.models.iter().any(|one| one.is_fit))
        };
        let is_it = !must_fit || fits();
        let found = "the catalogue: the only arm with these joint names".to_owned();
        return Ok(is_it.then(|| take(*only, found)).flatten());
    }
    if let [(misfit, best), (next, _), ..] = by_transforms[..]
        && misfit < MAX_MISFIT_M
        && next > 2.0 * misfit + MIN_MARGIN_M
    {
        let found = format!(
            "the catalogue: matches /tf within {:.1} mm, the closest of {} arms with these joint names (next \
             best {:.1} mm)",
            1e3 * misfit,
            names.len(),
            1e3 * next
        );
        return Ok(take(best, found));
    }
    let vendor = |model: &LogModel| model.robot.provenance.as_ref().map(|of| of.vendor.clone());
    let is_one_makers = equals.iter().all(|model| vendor(model) == vendor(&equals[0]));
    let ranking = (criteria.by_poses)(&equals.iter().collect::<Vec<_>>());
    match ranking.as_ref().and_then(|ranking| Some((ranking, ranking.models.first()?))) {
        // Names such as joint_1 are common, so one that does not fit may be another maker's.
        Some((ranking, best)) if best.is_fit || is_one_makers => {
            let others = ranking.indistinguishable();
            let arms = std::iter::once(best).chain(others.iter().copied());
            let arms: Vec<String> = arms.map(|one| names[one.model].to_owned()).collect();
            if others.iter().any(|one| vendor(&equals[one.model]) != vendor(&equals[best.model])) {
                return Err(RunError::Undistinguished { arms });
            }
            let model = take(best.model, ranking.describe(&names, "these joint names"));
            let indistinguishable = arms[1..].to_vec();
            Ok(model.map(|model| LogModel { indistinguishable, ..model }))
        }
        Some(_) if must_fit => Ok(None),
        _ => Err(RunError::Ambiguous { arms: names.into_iter().map(str::to_owned).collect() }),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::namespace::Namespace;
    use super::*;
    use crate::geometry::Vec3;

    const UR: [&str; 6] = [
        "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint",
        "wrist_2_joint", "wrist_3_joint",
    ];

    fn select(
        joints: &[String],
        criteria: &RankingCriteria<'_>,
    ) -> Result<Vec<LogModel>, RunError> {
        let frames = BTreeSet::new();
        let space = Namespace::default();
        let clues = ModelClues {
            joints,
            frames: &frames,
            descriptions: &[],
            calibrations: &[],
            namespace: &space,
            robot_type: None,
            joint_map: &[],
        };
        models_from_catalogue(&clues, criteria)
    }

    fn ur() -> Vec<String> {
        UR.map(str::to_owned).to_vec()
    }

    const NOTHING: (FitCause, bool) = (FitCause::Nothing, false);
    const TOOL: (FitCause, bool) = (FitCause::Nothing, true);

    fn standing(
        model: usize,
        (cause, has_tool): (FitCause, bool),
        left_m: f64,
        score: f64,
    ) -> RankedModel {
        let tool_m = Vec3::new(0.0, 0.0, 0.15);
        let way = HypothesisFit {
            cause,
            has_tool,
            is_misinterpreted: false,
            residual_m: left_m,
            tool_m,
            lag_s: 0.0,
        };
        let topic = "actual_TCP_pose".to_owned();
        let (fits, fits_without_fault) = (left_m < 3e-3, left_m < 3e-3 && cause.is_faultless());
        RankedModel {
            model,
            score,
            hypothesis: way,
            spread_m: 0.3,
            logged_residual_m: left_m,
            is_fit: fits,
            is_fit_without_fault: fits_without_fault,
            is_unbeatable: false,
            topic,
        }
    }

    #[test]
    fn transforms_select_the_closest_arm() {
        let by_transforms =
            |model: &LogModel| Some(if model.robot.name == "ur10e" { 1e-4 } else { 0.1 });
        let criteria = RankingCriteria { by_transforms: &by_transforms, by_poses: &|_| None };
        let found = select(&ur(), &criteria).unwrap();
        assert_eq!(found[0].robot.name, "ur10e");
        assert!(found[0].identified_by.contains("within 0.1 mm"), "{}", found[0].identified_by);
    }

    #[test]
    fn poses_select_the_arm_with_the_fewest_assumptions_and_name_the_next() {
        let by_poses = |models: &[&LogModel]| {
            let at = |name: &str| models.iter().position(|model| model.robot.name == name);
            let best = standing(at("ur3")?, NOTHING, 2e-5, -700.0);
            let next = standing(at("ur3e")?, TOOL, 0.0081, -300.0);
            Some(ModelRanking { models: vec![best, next] })
        };
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &by_poses };
        let found = select(&ur(), &criteria).unwrap();
        assert_eq!(found[0].robot.name, "ur3");
        let reason = &found[0].identified_by;
        assert!(reason.contains("actual_TCP_pose fits within 20 µm"), "{reason}");
        assert!(reason.contains("next best ur3e, within 8.1 mm with a TCP of 150 mm"), "{reason}");
        let best = standing(0, NOTHING, 2e-5, -700.0);
        let next = standing(1, (FitCause::Reference, false), 1e-4, -300.0);
        let reason =
            ModelRanking { models: vec![best, next] }.describe(&["ur3", "ur3e"], "its joints");
        assert!(reason.ends_with("; next best ur3e, but only in another frame"), "{reason}");
    }

    #[test]
    fn indistinguishable_arms_are_listed() {
        let by_poses = |models: &[&LogModel]| {
            let at = |name: &str| models.iter().position(|model| model.robot.name == name);
            let best = standing(at("ur5e")?, TOOL, 1e-5, -700.0);
            let next = standing(at("ur16e")?, TOOL, 1e-5, -701.0);
            Some(ModelRanking { models: vec![best, next] })
        };
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &by_poses };
        let found = select(&ur(), &criteria).unwrap();
        let reason = &found[0].identified_by;
        assert!(
            reason.contains("cannot distinguish it from ur16e") && reason.contains("--robot"),
            "{reason}"
        );
    }

    fn plain_names() -> Vec<String> {
        (1..=6).map(|i| format!("joint_{i}")).collect()
    }

    #[test]
    fn arms_of_different_makers_that_fit_alike_are_no_arm() {
        let at_rest = |models: &[&LogModel]| {
            let standings = (0..models.len())
                .map(|at| RankedModel { spread_m: 1e-7, ..standing(at, NOTHING, 6e-8, -700.0) });
            Some(ModelRanking { models: standings.collect() })
        };
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &at_rest };
        let error = select(&plain_names(), &criteria).unwrap_err();
        assert!(matches!(error, RunError::Undistinguished { .. }), "{error}");
        // One maker's arms differ in their links and limits only.
        let found = select(&ur(), &criteria).unwrap();
        assert!(found[0].indistinguishable.len() > 2, "{:?}", found[0].indistinguishable);
    }

    #[test]
    fn an_arm_that_needs_a_fault_and_fits_no_better_is_distinguished() {
        let by_poses = |models: &[&LogModel]| {
            let at = |name: &str| models.iter().position(|model| model.robot.name == name);
            let zero = (FitCause::Zero { joint: 2 }, true);
            let best = standing(at("ur3e")?, TOOL, 4.4e-4, -700.0);
            let next = standing(at("ur3")?, zero, 8.9e-4, -701.0);
            Some(ModelRanking { models: vec![best, next] })
        };
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &by_poses };
        let found = select(&ur(), &criteria).unwrap();
        assert!(found[0].robot.name == "ur3e" && found[0].indistinguishable.is_empty());
        let reason = &found[0].identified_by;
        assert!(reason.ends_with("next best ur3, but only with a joint zero offset"), "{reason}");
    }

    #[test]
    fn an_arm_without_the_first_of_the_numbered_joints_is_another() {
        let fits = |models: &[&LogModel]| {
            let best = standing(0, NOTHING, 2e-5, -700.0);
            (!models.is_empty()).then(|| ModelRanking { models: vec![best] })
        };
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &fits };
        let seven: Vec<String> = (0..7).map(|i| format!("lbr_joint_{i}")).collect();
        assert!(select(&seven, &criteria).unwrap().is_empty());
        assert_eq!(select(&seven[1..], &criteria).unwrap().len(), 1);
    }

    #[test]
    fn without_transforms_and_poses_nothing_is_guessed() {
        let criteria = RankingCriteria { by_transforms: &|_| None, by_poses: &|_| None };
        let unknown = select(&ur(), &criteria).unwrap_err();
        assert!(matches!(unknown, RunError::Ambiguous { .. }), "{unknown}");
    }

    #[test]
    fn common_joint_names_do_not_identify_an_arm() {
        let off = |models: &[&LogModel]| {
            let standings =
                (0..models.len()).map(|at| standing(at, (FitCause::Reference, true), 0.2, 0.0));
            Some(ModelRanking { models: standings.collect() })
        };
        let criteria = RankingCriteria { by_transforms: &|_| Some(0.2), by_poses: &off };
        let strange: Vec<String> = (1..=7).map(|i| format!("iiwa_joint_{i}")).collect();
        assert!(select(&strange, &criteria).unwrap().is_empty());
        let error = select(&plain_names(), &criteria).unwrap_err();
        assert!(matches!(error, RunError::Ambiguous { .. }), "{error}");
    }
}
