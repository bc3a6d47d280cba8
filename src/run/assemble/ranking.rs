//! Ranks robot models with the logged joint names by how well FK matches the poses. Also checks a named
//! model.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use rayon::prelude::*;

use super::assembly::{Assembly, is_topic};
use super::groups::Group;
use crate::diagnosis::{FitAssumption, FitHypotheses, ModelFit, PoseStream, ScoredFit, fit_model};
use crate::robot::catalogue;
use crate::run::arm::{Arm, Ends};
use crate::run::by_order;
use crate::run::catalogued::{Ranking, Standing};
use crate::run::model::{Clues, CompetingModel, Model};
use crate::run::role::Role;
use crate::run::skeleton;
use crate::run::sources::PoseSource;
use crate::run::space::Claim;
use crate::run::tf_tree::TfTree;
use crate::stream::Columns;

/// Maximum residual of a model that fits, m: a nominal model against a calibrated arm.
const FITS_M: f64 = 3e-3;
/// The same as a share of the positions' extent, for noisy trackers.
const FITS_SHARE: f64 = 0.01;
const MOST_STREAMS: usize = 6;
/// Minimum score difference of distinguishable arms: a likelihood ratio of e¹⁰.
const APART: f64 = 20.0;

/// Minimum ratio of the named arm's residual to that of another arm.
const STANDS_OUT: f64 = 5.0;
/// Maximum tool length of that other arm, m.
const LONGEST_TOOL_M: f64 = 0.5;

/// With more than `MANY` models, one of which fits within `CLEAR_M` metres without a fault, faults are not
/// fitted for models whose residual is `FAR` times larger.
const MANY: usize = 4;
const CLEAR_M: f64 = 1e-4;
const FAR: f64 = 100.0;

#[derive(Default)]
struct Entry {
    arm: Option<Arm>,
    fits: Vec<Fitted>,
}

struct Fitted {
    stream: usize,
    source: PoseSource,
    /// Whether the fit used the stream's frame.
    knows_frame: bool,
    fit: ModelFit,
}

impl Entry {
    fn of(&self, stream: usize) -> Option<&ModelFit> {
        self.fits.iter().find(|fitted| fitted.stream == stream).map(|fitted| &fitted.fit)
    }

    fn whose_frame_is(&self, known: bool) -> impl Iterator<Item = usize> + '_ {
        let alike = move |fitted: &&Fitted| fitted.knows_frame == known;
        self.fits.iter().filter(alike).map(|fitted| fitted.stream)
    }
}

struct Rank {
    model: usize,
    score: f64,
    decisive: (usize, ScoredFit),
}

pub(super) struct ByPoses<'a> {
    pub assembly: &'a Assembly<'a>,
    pub group: &'a Group<'a>,
    pub tree: &'a Arc<TfTree>,
}

impl ByPoses<'_> {
    /// Ranking by necessary assumptions, best first. `None` if no stream distinguishes the models. Uses a
    /// stream's frame only if every model locates it.
    pub fn ranking(&self, models: &[&Model]) -> Option<Ranking> {
        let none = BTreeSet::new();
        let arms: Vec<Option<Arm>> = models.iter().map(|model| self.arm(model)).collect();
        let mut entries: Vec<Entry> =
            arms.into_par_iter().map(|arm| self.entry(arm, &none)).collect();
        let unknown = entries.iter().flat_map(|entry| entry.whose_frame_is(false));
        let free: BTreeSet<usize> = unknown.collect();
        entries.par_iter_mut().for_each(|entry| {
            if entry.whose_frame_is(true).any(|stream| free.contains(&stream)) {
                *entry = self.entry(entry.arm.take(), &free);
            }
        });
        // Fit faults only for models that could become the best.
        let near = near(&entries);
        entries.par_iter_mut().zip(near).for_each(|(Entry { arm, fits }, is_near)| {
            let Some(arm) = arm.as_ref().filter(|_| is_near) else { return };
            let open = fits.iter_mut().filter(|it| !it.fit.is_conclusive());
            open.for_each(|it| {
                let all = self.fit_of(arm, &it.source, it.knows_frame, FitHypotheses::All);
                it.fit = all.unwrap_or_else(|| it.fit.clone());
            });
        });
        let ranks = ranks(&entries);
        let standings = ranks.into_iter().map(|rank| {
            let (stream, ScoredFit { fit: way, .. }) = rank.decisive;
            let fit = entries[rank.model].of(stream);
            let spread_m = fit.map_or(0.0, |fit| fit.spread_m);
            Standing {
                model: rank.model,
                score: rank.score,
                way,
                spread_m,
                as_is_m: fit.map_or(f64::INFINITY, |fit| fit.as_is_m),
                fits: way.residual_m <= FITS_M.max(FITS_SHARE * spread_m),
                fits_without_fault: fit.is_some_and(|fit| {
                    fit.faultless_residual_m() <= FITS_M.max(FITS_SHARE * spread_m)
                }),
                topic: self.assembly.streams[stream].topic.clone(),
            }
        });
        let standings: Vec<Standing> = standings.collect();
        (!standings.is_empty()).then_some(Ranking { standings, apart: APART })
    }

    /// Catalogue arm that fits far better than the named `model`.
    pub fn better(&self, model: &Model, clues: &Clues<'_>) -> Option<CompetingModel> {
        let path = self.only_path(model)?;
        let own = self.ranking(&[model])?;
        let own = own.standings.first()?;
        if own.fits && own.way.assumption == FitAssumption::Nothing && !own.way.is_misinterpreted {
            return None;
        }
        // The other DH convention of the same table is ORD007, not another arm.
        if let Some(robot) = model.robot.under_other_convention() {
            let ranking = self.ranking(&[&Model { robot, ..model.clone() }]);
            let turned = ranking.as_ref().and_then(|ranking| ranking.standings.first());
            if turned.is_some_and(|it| {
                it.fits && it.way.assumption.is_faultless() && !it.way.is_misinterpreted
            }) {
                return None;
            }
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
        let named = complete
            .filter_map(|other| Some((other.renamed()?, &other.names.to_prefix)))
            .map(|(robot, prefix)| Model::new(robot, String::new(), prefix, clues));
        let candidates = match model.by_order {
            true => by_order::along(&path.joints, clues),
            false => named.collect(),
        };
        let rivals: Vec<Model> = candidates
            .into_iter()
            .filter(|rival| {
                let path = self.only_path(rival);
                let has_all =
                    path.is_some_and(|path| path.joints.iter().collect::<BTreeSet<_>>() == joints);
                has_all && rival.robot.name != model.robot.name
            })
            .collect();
        let all: Vec<&Model> = std::iter::once(model).chain(&rivals).collect();
        let ranking = self.ranking(&all)?;
        let best = ranking.standings.first().filter(|best| best.model > 0)?;
        let own = ranking.standings.iter().find(|standing| standing.model == 0);
        let is_better = own.is_none_or(|own| {
            best.score + APART < own.score && STANDS_OUT * best.way.residual_m < own.way.residual_m
        });
        let is_sound = best.way.assumption.is_faultless() && !best.way.is_misinterpreted;
        let is_plausible = is_sound && best.way.tool_m.norm() < LONGEST_TOOL_M;
        if !is_better || !best.fits || !is_plausible {
            return None;
        }
        let rival = &rivals[best.model.checked_sub(1)?];
        Some(CompetingModel {
            name: rival.robot.name.clone(),
            topic: best.topic.clone(),
            named_m: own.map_or(f64::INFINITY, |own| own.as_is_m),
            left_m: best.way.residual_m,
            tool_m: best.way.assumption.has_tool().then(|| best.way.tool_m.norm()),
        })
    }

    fn fits_in_another_order(&self, model: &Model, path: &[String]) -> bool {
        let others = by_order::usual_orders(path).into_iter().skip(1).filter_map(|order| {
            let pairs: Vec<(String, String)> = path.iter().cloned().zip(order).collect();
            Some(Model { robot: by_order::renamed(&model.robot, &pairs)?, ..model.clone() })
        });
        others.into_iter().any(|other| {
            let ranking = self.ranking(&[&other]);
            let best = ranking.as_ref().and_then(|ranking| ranking.standings.first());
            best.is_some_and(|it| {
                it.fits && it.way.assumption.is_faultless() && !it.way.is_misinterpreted
            })
        })
    }

    /// The path through the logged joints, if there is exactly one.
    fn only_path(&self, model: &Model) -> Option<skeleton::ArmPath> {
        let is_logged = |name: &str| self.group.joints.topics.iter().any(|topic| topic.holds(name));
        let paths = skeleton::arms(&model.robot, is_logged);
        <[_; 1]>::try_from(paths).ok().map(|[path]| path)
    }

    fn arm(&self, model: &Model) -> Option<Arm> {
        let Assembly { options, .. } = self.assembly;
        let ends = Ends { base: options.base.as_deref(), tip: options.tip.as_deref() };
        let arm = Arm::new(model, &self.only_path(model)?, ends, &self.group.joints).ok()?;
        Some(Arm { space: self.group.space.clone(), tree: Arc::clone(self.tree), ..arm })
    }

    /// Fits an arm to the streams, without the frames of those in `free`.
    fn entry(&self, arm: Option<Arm>, free: &BTreeSet<usize>) -> Entry {
        let streams = &self.assembly.streams;
        let Some(arm) = arm else { return Entry::default() };
        // Longest streams first, without copies.
        let mut longest: Vec<usize> = (0..streams.len()).collect();
        longest.sort_by_key(|&stream| Reverse(streams[stream].count));
        let mut fits: Vec<Fitted> = Vec::new();
        let mut untold: HashMap<_, Vec<PoseSource>> = HashMap::new();
        for stream in longest {
            let Some(source) = self.source_of(&arm, stream) else { continue };
            let key = source.copy_key();
            let alike = untold.get(&key).into_iter().flatten();
            let mut others = fits.iter().map(|fitted| &fitted.source).chain(alike);
            if others.any(|other| source.is_copy_of(other)) {
                continue;
            }
            let knows_frame = source.reference_known && !free.contains(&stream);
            match self.fit_of(&arm, &source, knows_frame, FitHypotheses::Faultless) {
                Some(fit) => fits.push(Fitted { stream, source, knows_frame, fit }),
                None => untold.entry(key).or_default().push(source),
            }
            if fits.len() == MOST_STREAMS {
                break;
            }
        }
        Entry { arm: Some(arm), fits }
    }

    fn source_of(&self, arm: &Arm, index: usize) -> Option<PoseSource> {
        let assembly = self.assembly;
        let stream = &assembly.streams[index];
        let is_foreign = self.group.space.claim([stream.topic.as_str()]) == Claim::Foreign;
        if is_foreign || !matches!(stream.columns, Some(Columns::Poses(_) | Columns::Array(_))) {
            return None;
        }
        let declared =
            assembly.options.declared.iter().find(|declared| is_topic(stream, &declared.topic));
        let declared = declared.filter(|declared| declared.fits(stream.columns.as_ref()));
        let site = assembly.site(arm, stream);
        let (role, _) = assembly.role_of(stream, Some(&site), declared.is_some());
        if !matches!(role, Role::Pose | Role::Candidate { .. }) || assembly.is_transform(stream) {
            return None;
        }
        assembly.pose_source(index, arm, &site, declared, (false, &mut Vec::new())).ok()
    }

    fn fit_of(
        &self,
        arm: &Arm,
        source: &PoseSource,
        knows_frame: bool,
        tried: FitHypotheses,
    ) -> Option<ModelFit> {
        let stream = PoseStream {
            track: &source.track,
            chain: &source.chain,
            columns: &source.columns,
            reference_known: knows_frame,
            stamp_error_s: source.stamp_error_s,
            stamps_copied: source.stamps_copied,
            removed_ramp: None,
        };
        fit_model(&arm.joints, &stream, self.assembly.options.max_latency_s, tried)
    }
}

/// Models near the best one without a fault. All if none is clear or they are few.
fn near(entries: &[Entry]) -> Vec<bool> {
    let streams: BTreeSet<usize> =
        entries.iter().flat_map(|entry| entry.fits.iter().map(|fitted| fitted.stream)).collect();
    let left = |stream: usize, entry: &Entry| {
        entry.of(stream).map_or(f64::INFINITY, ModelFit::faultless_residual_m)
    };
    let least_m: Vec<(usize, f64)> = streams
        .into_iter()
        .map(|stream| {
            (stream, entries.iter().map(|it| left(stream, it)).fold(f64::INFINITY, f64::min))
        })
        .collect();
    let is_clear = !least_m.is_empty() && least_m.iter().all(|(_, least_m)| *least_m < CLEAR_M);
    let is_near = |entry: &Entry| {
        least_m.iter().any(|&(stream, least_m)| left(stream, entry) <= FITS_M.max(FAR * least_m))
    };
    let is_asked = |entry| entries.len() <= MANY || !is_clear || is_near(entry);
    entries.iter().map(is_asked).collect()
}

/// Ranks by the streams that at least one model explains, else by all.
fn ranks(entries: &[Entry]) -> Vec<Rank> {
    let streams: BTreeSet<usize> =
        entries.iter().flat_map(|entry| entry.fits.iter().map(|fitted| fitted.stream)).collect();
    let of = |stream: usize| entries.iter().filter_map(move |entry| entry.of(stream));
    let is_explained = |stream: &&usize| {
        of(**stream).any(|fit| {
            let least = fit.fits.iter().map(|way| way.residual_m).fold(f64::INFINITY, f64::min);
            least <= FITS_M.max(FITS_SHARE * fit.spread_m)
        })
    };
    let explained: Vec<usize> = streams.iter().filter(is_explained).copied().collect();
    let counted: Vec<usize> =
        if explained.is_empty() { streams.into_iter().collect() } else { explained };
    let rank = |(model, entry): (usize, &Entry)| {
        let each = counted.iter().map(|&stream| {
            let best = entry.of(stream)?.best()?;
            Some((stream, best))
        });
        let each: Vec<(usize, ScoredFit)> = each.collect::<Option<_>>()?;
        let score = each.iter().map(|(_, best)| best.score).sum();
        let decisive =
            *each.iter().min_by(|a, b| a.1.fit.residual_m.total_cmp(&b.1.fit.residual_m))?;
        Some(Rank { model, score, decisive })
    };
    let mut ranks: Vec<Rank> = entries.iter().enumerate().filter_map(rank).collect();
    ranks.sort_by(|a, b| a.score.total_cmp(&b.score));
    // Among indistinguishable models, prefer the smallest assumption, then the tool nearest to the flange
    // axis.
    let least = ranks.first().map_or(0.0, |best| best.score);
    let near = ranks.iter().take_while(|rank| rank.score <= least + APART).count();
    let harm = |rank: &Rank| {
        let way = &rank.decisive.1.fit;
        let aside_m =
            if way.assumption == FitAssumption::Nothing { 0.0 } else { way.tool_m.xy().norm() };
        (way.is_misinterpreted, way.assumption, aside_m)
    };
    ranks[..near].sort_by(|a, b| {
        let (a, b) = (harm(a), harm(b));
        a.0.cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.total_cmp(&b.2))
    });
    ranks
}
