//! Ranks robot models with the logged joint names by how well FK matches the poses. Also checks a named
//! model.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use rayon::prelude::*;

use super::assembly::Assembly;
use super::groups::JointStateGroup;
use crate::diagnosis::{FitCause, FitHypotheses, ModelFit, PoseStream, ScoredFit, fit_model};
use crate::robot::catalogue;
use crate::run::arm::{Arm, ChainEnds};
use crate::run::catalogue_selection::{MIN_SCORE_DIFFERENCE, ModelRanking, RankedModel};
use crate::run::joint_order;
use crate::run::model::{CompetingModel, LogModel, ModelClues};
use crate::run::namespace::NamespaceMatch;
use crate::run::role::Role;
use crate::run::skeleton;
use crate::run::sources::PoseSource;
use crate::run::tf_tree::TfTree;
use crate::stream::Columns;

const MAX_STREAMS: usize = 6;

/// Minimum ratio of the named arm's residual to that of another arm.
pub(crate) const MIN_RESIDUAL_RATIO: f64 = 5.0;
/// Maximum tool length of that other arm, m.
pub(crate) const MAX_TOOL_M: f64 = 0.5;

#[derive(Default)]
struct FittedModel {
    arm: Option<Arm>,
    fits: Vec<StreamFit>,
}

struct StreamFit {
    stream: usize,
    source: PoseSource,
    /// Whether the fit used the stream's frame.
    is_frame_known: bool,
    fit: ModelFit,
}

impl FittedModel {
    fn fit_to(&self, stream: usize) -> Option<&ModelFit> {
        self.fits.iter().find(|fitted| fitted.stream == stream).map(|fitted| &fitted.fit)
    }

    /// Score of a perfect fit to all streams.
    fn lowest_score(&self) -> f64 {
        self.fits.iter().map(|fitted| fitted.fit.lowest_score()).sum()
    }

    /// Whether it fits some stream.
    fn fits_without_fault(&self) -> bool {
        self.fits
            .iter()
            .any(|StreamFit { fit, .. }| fit.faultless_residual_m() <= max_residual_m(fit.spread_m))
    }

    fn streams_by_frame(&self, known: bool) -> impl Iterator<Item = usize> + '_ {
        let alike = move |fitted: &&StreamFit| fitted.is_frame_known == known;
        self.fits.iter().filter(alike).map(|fitted| fitted.stream)
    }
}

struct ScoredModel {
    model: usize,
    score: f64,
    decisive: (usize, ScoredFit),
}

pub(super) struct PoseRanking<'a> {
    pub assembly: &'a Assembly<'a>,
    pub group: &'a JointStateGroup<'a>,
    pub tree: &'a Arc<TfTree>,
}

impl PoseRanking<'_> {
    /// Ranking by necessary assumptions, best first. `None` if no stream distinguishes the models. Uses a
    /// stream's frame only if every model locates it.
    pub fn rank(&self, models: &[&LogModel]) -> Option<ModelRanking> {
        self.rank_with_faults(self.fit_models(models, FitHypotheses::Faultless))
    }

    /// Ranking after adding fits with a fault to these without one.
    fn rank_with_faults(&self, mut entries: Vec<FittedModel>) -> Option<ModelRanking> {
        let max_scores = max_scores(&entries);
        entries.par_iter_mut().for_each(|FittedModel { arm, fits }| {
            let Some(arm) = arm.as_ref() else { return };
            for StreamFit { stream, source, is_frame_known, fit } in fits {
                let max_score = max_scores.get(stream).copied().unwrap_or(f64::INFINITY);
                let stream = PoseStream { reference_known: *is_frame_known, ..source.as_stream() };
                let max_lag_s = self.assembly.options.max_latency_s;
                fit.add_faulty_fits(&arm.joints, &stream, max_lag_s, max_score);
            }
        });
        self.ranking(&entries)
    }

    /// Fits of the models, with the frame of a stream only if every model locates it.
    fn fit_models(&self, models: &[&LogModel], tried: FitHypotheses) -> Vec<FittedModel> {
        let none = BTreeSet::new();
        let arms: Vec<Option<Arm>> = models.iter().map(|model| self.build_arm(model)).collect();
        let mut entries: Vec<FittedModel> =
            arms.into_par_iter().map(|arm| self.fit_arm(arm, &none, tried)).collect();
        let unknown = entries.iter().flat_map(|entry| entry.streams_by_frame(false));
        let free: BTreeSet<usize> = unknown.collect();
        entries.par_iter_mut().for_each(|entry| {
            if entry.streams_by_frame(true).any(|stream| free.contains(&stream)) {
                *entry = self.fit_arm(entry.arm.take(), &free, tried);
            }
        });
        entries
    }

    fn ranking(&self, entries: &[FittedModel]) -> Option<ModelRanking> {
        let ranks = rank_models(entries);
        let ranked = ranks.into_iter().map(|rank| {
            let (stream, ScoredFit { fit: hypothesis, .. }) = rank.decisive;
            let fit = entries[rank.model].fit_to(stream);
            let spread_m = fit.map_or(0.0, |fit| fit.spread_m);
            RankedModel {
                model: rank.model,
                score: rank.score,
                hypothesis,
                spread_m,
                logged_residual_m: fit.map_or(f64::INFINITY, |fit| fit.as_is_m),
                is_fit: hypothesis.residual_m <= max_residual_m(spread_m),
                is_fit_without_fault: fit
                    .is_some_and(|fit| fit.faultless_residual_m() <= max_residual_m(spread_m)),
                is_unbeatable: rank.score
                    <= entries[rank.model].lowest_score() + MIN_SCORE_DIFFERENCE,
                topic: self.assembly.streams[stream].topic.clone(),
            }
        });
        let models: Vec<RankedModel> = ranked.collect();
        (!models.is_empty()).then_some(ModelRanking { models })
    }

    /// Catalogue arm that fits far better than the named `model`.
    pub fn find_competing_model(
        &self,
        model: &LogModel,
        clues: &ModelClues<'_>,
    ) -> Option<CompetingModel> {
        let path = self.only_path(model)?;
        // More hypotheses only lower the score.
        let as_logged = self.ranking(&self.fit_models(&[model], FitHypotheses::Nothing));
        let as_logged = as_logged.as_ref().and_then(|ranking| ranking.models.first());
        if as_logged.is_some_and(|it| it.is_unbeatable) {
            return None;
        }
        let own = self.rank(&[model])?;
        let own = own.models.first()?;
        if own.is_unbeatable {
            return None;
        }
        if own.is_fit
            && own.hypothesis.cause == FitCause::Nothing
            && !own.hypothesis.has_tool
            && !own.hypothesis.is_misinterpreted
        {
            return None;
        }
        // The other DH convention of the same table is ORD007, not another arm.
        if let Some(robot) = model.robot.under_other_convention()
            && self.fits_without_fault(&LogModel { robot, ..model.clone() })
        {
            return None;
        }
        // Another common joint order is ORD005, not another arm.
        if self.fits_in_another_order(model, &path.joints) {
            return None;
        }
        let joints: BTreeSet<&String> = path.joints.iter().collect();
        let candidates = catalogue::candidates_for(&path.joints);
        let complete = candidates
            .iter()
            .filter(|other| other.names.is_complete() && other.names.joints == path.joints.len());
        let named =
            complete.filter_map(|other| LogModel::from_candidate(other, String::new(), clues));
        let candidates = match model.is_matched_by_order {
            true => joint_order::arms_with_joint_count(&path.joints, clues),
            false => named.collect(),
        };
        let competitors: Vec<LogModel> = candidates
            .into_iter()
            .filter(|competitor| {
                let path = self.only_path(competitor);
                let has_all =
                    path.is_some_and(|path| path.joints.iter().collect::<BTreeSet<_>>() == joints);
                has_all && competitor.robot.name != model.robot.name
            })
            .collect();
        let all: Vec<&LogModel> = std::iter::once(model).chain(&competitors).collect();
        let entries = self.fit_models(&all, FitHypotheses::Faultless);
        if !entries[1..].iter().any(FittedModel::fits_without_fault) {
            return None;
        }
        let ranking = self.rank_with_faults(entries)?;
        let best = ranking.models.first().filter(|best| best.model > 0)?;
        let own = ranking.models.iter().find(|standing| standing.model == 0);
        let is_better = own.is_none_or(|own| {
            best.score + MIN_SCORE_DIFFERENCE < own.score
                && MIN_RESIDUAL_RATIO * best.hypothesis.residual_m < own.hypothesis.residual_m
        });
        let is_plausible = best.needs_no_fault() && best.hypothesis.tool_m.norm() < MAX_TOOL_M;
        if !is_better || !best.is_fit || !is_plausible {
            return None;
        }
        let competitor = &competitors[best.model.checked_sub(1)?];
        Some(CompetingModel {
            name: competitor.robot.name.clone(),
            topic: best.topic.clone(),
            named_residual_m: own.map_or(f64::INFINITY, |own| own.logged_residual_m),
            residual_m: best.hypothesis.residual_m,
            tool_m: best.hypothesis.has_tool.then(|| best.hypothesis.tool_m.norm()),
        })
    }

    fn fits_in_another_order(&self, model: &LogModel, path: &[String]) -> bool {
        let others = joint_order::usual_orders(path).into_iter().skip(1).filter_map(|order| {
            let pairs: Vec<(String, String)> = path.iter().cloned().zip(order).collect();
            Some(LogModel {
                robot: joint_order::rename_joints(&model.robot, &pairs)?,
                ..model.clone()
            })
        });
        others.into_iter().any(|other| self.fits_without_fault(&other))
    }

    fn fits_without_fault(&self, model: &LogModel) -> bool {
        let ranking = self.rank(&[model]);
        let best = ranking.as_ref().and_then(|ranking| ranking.models.first());
        best.is_some_and(|it| it.is_fit && it.needs_no_fault())
    }

    /// The path through the logged joints, if there is exactly one.
    fn only_path(&self, model: &LogModel) -> Option<skeleton::ArmPath> {
        let is_logged =
            |name: &str| self.group.joints.topics.iter().any(|topic| topic.has_joint(name));
        skeleton::find_only_arm_path(&model.robot, is_logged)
    }

    fn build_arm(&self, model: &LogModel) -> Option<Arm> {
        let Assembly { options, .. } = self.assembly;
        let ends = ChainEnds { base: options.base.as_deref(), tip: options.tip.as_deref() };
        let arm = Arm::new(model, &self.only_path(model)?, ends, &self.group.joints).ok()?;
        Some(Arm { namespace: self.group.namespace.clone(), tree: Arc::clone(self.tree), ..arm })
    }

    /// Fits an arm to the streams, without the frames of those in `free`.
    fn fit_arm(
        &self,
        arm: Option<Arm>,
        free: &BTreeSet<usize>,
        tried: FitHypotheses,
    ) -> FittedModel {
        let streams = &self.assembly.streams;
        let Some(arm) = arm else { return FittedModel::default() };
        // Longest streams first, without copies.
        let mut longest: Vec<usize> = (0..streams.len()).collect();
        longest.sort_by_key(|&stream| Reverse(streams[stream].count));
        let mut fits: Vec<StreamFit> = Vec::new();
        let mut without_fit: HashMap<_, Vec<PoseSource>> = HashMap::new();
        for stream in longest {
            let Some(source) = self.source_of(&arm, stream) else { continue };
            let key = source.content_hash();
            let alike = without_fit.get(&key).into_iter().flatten();
            let mut others = fits.iter().map(|fitted| &fitted.source).chain(alike);
            if others.any(|other| source.is_copy_of(other)) {
                continue;
            }
            let knows_frame = source.reference_known && !free.contains(&stream);
            let seen = PoseStream { reference_known: knows_frame, ..source.as_stream() };
            let max_latency_s = self.assembly.options.max_latency_s;
            match fit_model(&arm.joints, &seen, max_latency_s, tried) {
                Some(fit) => {
                    fits.push(StreamFit { stream, source, is_frame_known: knows_frame, fit })
                }
                None => without_fit.entry(key).or_default().push(source),
            }
            if fits.len() == MAX_STREAMS {
                break;
            }
        }
        FittedModel { arm: Some(arm), fits }
    }

    fn source_of(&self, arm: &Arm, index: usize) -> Option<PoseSource> {
        let assembly = self.assembly;
        let stream = &assembly.streams[index];
        let is_foreign =
            self.group.namespace.match_names([stream.topic.as_str()]) == NamespaceMatch::Foreign;
        if is_foreign || !matches!(stream.columns, Some(Columns::Poses(_) | Columns::Array(_))) {
            return None;
        }
        let declared = assembly.fitting_declaration(stream);
        let site = assembly.locate_frames(arm, stream);
        let (role, _) = assembly.role_of(stream, Some(&site), declared.is_some());
        if !matches!(role, Role::Pose | Role::Candidate { .. }) || assembly.is_transform(stream) {
            return None;
        }
        assembly.pose_source(index, arm, &site, declared, (false, &mut Vec::new())).ok()
    }
}

/// Maximum residual of a model that fits, m.
fn max_residual_m(spread_m: f64) -> f64 {
    /// Of a nominal model against a calibrated arm, m.
    const MAX_RESIDUAL_M: f64 = 3e-3;
    /// As a share of the positions' extent, for noisy trackers.
    const MAX_RESIDUAL_SHARE: f64 = 0.01;
    MAX_RESIDUAL_M.max(MAX_RESIDUAL_SHARE * spread_m)
}

/// Per stream, the score above which a model is distinguishable from the best one without a fault.
fn max_scores(entries: &[FittedModel]) -> HashMap<usize, f64> {
    let mut scores = HashMap::new();
    for fitted in entries.iter().flat_map(|entry| &entry.fits) {
        let score = fitted.fit.best().map_or(f64::INFINITY, |best| best.score);
        let max_score = scores.entry(fitted.stream).or_insert(f64::INFINITY);
        *max_score = max_score.min(score + MIN_SCORE_DIFFERENCE);
    }
    scores
}

/// Ranks by the streams that at least one model explains, else by all.
fn rank_models(entries: &[FittedModel]) -> Vec<ScoredModel> {
    let streams: BTreeSet<usize> =
        entries.iter().flat_map(|entry| entry.fits.iter().map(|fitted| fitted.stream)).collect();
    let of = |stream: usize| entries.iter().filter_map(move |entry| entry.fit_to(stream));
    let is_explained = |stream: &&usize| {
        of(**stream).any(|fit| {
            let least = fit
                .fits
                .iter()
                .map(|hypothesis| hypothesis.residual_m)
                .fold(f64::INFINITY, f64::min);
            least <= max_residual_m(fit.spread_m)
        })
    };
    let explained: Vec<usize> = streams.iter().filter(is_explained).copied().collect();
    let counted: Vec<usize> =
        if explained.is_empty() { streams.into_iter().collect() } else { explained };
    let rank = |(model, entry): (usize, &FittedModel)| {
        let each = counted.iter().map(|&stream| {
            let best = entry.fit_to(stream)?.best()?;
            Some((stream, best))
        });
        let each: Vec<(usize, ScoredFit)> = each.collect::<Option<_>>()?;
        let score = each.iter().map(|(_, best)| best.score).sum();
        let decisive =
            *each.iter().min_by(|a, b| a.1.fit.residual_m.total_cmp(&b.1.fit.residual_m))?;
        Some(ScoredModel { model, score, decisive })
    };
    let mut ranks: Vec<ScoredModel> = entries.iter().enumerate().filter_map(rank).collect();
    ranks.sort_by(|a, b| a.score.total_cmp(&b.score));
    // Among indistinguishable models, prefer the smallest assumption, then the lowest score.
    let least = ranks.first().map_or(0.0, |best| best.score);
    let near = ranks.iter().take_while(|rank| rank.score <= least + MIN_SCORE_DIFFERENCE).count();
    ranks[..near].sort_by_key(|rank| {
        let hypothesis = &rank.decisive.1.fit;
        (hypothesis.is_misinterpreted, hypothesis.cause, hypothesis.has_tool)
    });
    ranks
}
