//! Selects the joints with compliance by linear least squares on the residual of one diagnosis, with constant causes free.

use super::StreamSamples;
use super::gravity::{GravityTorques, MassModel, TorqueBuffers};
use super::shapes::{BacklashCrossing, ComplianceShape, JointCompliance, JointSag};
use super::system::{Coefficient, ComplianceSystem};
use super::term::{ComplianceKind, ComplianceTerm, MAX_COMPLIANCE_RAD};
use crate::arm_run::ArmRun;
use crate::joints::MIN_MOTION_RAD;
use crate::samples::sampling::value_range;
use crate::selection::stepwise::{ScoredSet, grow};
use crate::{ChangePoint, Course};
use ground::stats::{Measured, mean};
use std::ops::Range;
use std::sync::Arc;

/// During the search. The profile depends weakly on it.
const INITIAL_BACKLASH_RAD: f64 = 3e-3;
/// Share of the explainable excess residual.
const MIN_EXPLAINED_SHARE: f64 = 0.03;
/// Cycles per turn: joint, encoder, bearing.
const ECCENTRICITY_ORDERS: [u32; 3] = [1, 2, 3];
/// Share of the largest gravity torque, to test for sag.
const MIN_TORQUE_SHARE: f64 = 0.05;
/// Relative, of sag, due to the assumed link masses.
pub(super) const MASS_STD_ERROR: f64 = 0.07;
/// To test for eccentricity.
const MIN_RANGE_RAD: f64 = 1.0;

/// For a load change, and the finer grid around the best.
const TRIAL_TIMES: usize = 12;
const GRID_REFINEMENT: i32 = 4;

pub(super) struct ComplianceSearch<'a> {
    run: &'a ArmRun<'a>,
    samples: &'a [StreamSamples<'a>],
    gravity: Arc<GravityTorques>,
    /// Per joint over the run.
    max_torque: Vec<f64>,
    /// Per joint over the run, rad/s.
    max_speed: Vec<f64>,
    /// Indexed by stream, sample and joint.
    torques: Vec<Vec<Vec<f64>>>,
}

impl<'a> ComplianceSearch<'a> {
    pub fn new(
        run: &'a ArmRun,
        samples: &'a [StreamSamples<'a>],
        masses: MassModel,
    ) -> Option<Self> {
        let stream = run.streams.iter().max_by_key(|stream| stream.columns.len())?;
        let gravity = Arc::new(GravityTorques::new(stream.chain, stream.columns, masses));
        let torques = torques(&gravity, samples, run.joints.dof);
        let mut max_torque = vec![0.0_f64; run.joints.dof];
        for own in torques.iter().flatten() {
            max_torque.iter_mut().zip(own).for_each(|(max, own)| *max = max.max(own.abs()));
        }
        let fastest =
            |column| run.joints.velocities_of(column).fold(0.0, |max: f64, own| max.max(own.abs()));
        let max_speed = (0..run.joints.dof).map(fastest).collect();
        Some(Self { run, samples, gravity, max_torque, max_speed, torques })
    }

    pub fn on_samples<'b>(&self, samples: &'b [StreamSamples<'b>]) -> ComplianceSearch<'b>
    where
        'a: 'b,
    {
        let torques = torques(&self.gravity, samples, self.run.joints.dof);
        let (gravity, max_torque) = (Arc::clone(&self.gravity), self.max_torque.clone());
        let max_speed = self.max_speed.clone();
        ComplianceSearch { run: self.run, samples, gravity, max_torque, max_speed, torques }
    }

    /// Sag whose mean equals a zero of `offset_rad`. `None` if the sign contradicts gravity or it is too
    /// large.
    pub fn sag_like(&self, column: usize, offset_rad: f64) -> Option<ComplianceTerm> {
        let mut sags = self.candidates_of(|kind| *kind == ComplianceKind::Sag);
        let term = sags.find(|term| term.column == column)?;
        let torques = self.torques.iter().flatten().map(|torques| torques[column]);
        let amount = [offset_rad * self.max_torque[column] / mean(torques), 0.0];
        (amount[0] > 0.0 && amount[0] < MAX_COMPLIANCE_RAD)
            .then_some(ComplianceTerm { amount, ..term })
    }

    /// Price of the selection of one of the candidates, as a log ratio: each is equally likely.
    pub fn selection_price(&self) -> f64 {
        2.0 * (self.candidates().len().max(1) as f64).ln()
    }

    /// Candidates of these kinds.
    fn candidates_of(
        &self,
        is_kind: impl Fn(&ComplianceKind) -> bool,
    ) -> impl Iterator<Item = ComplianceTerm> {
        self.candidates().into_iter().filter(move |term| is_kind(&term.kind))
    }

    fn candidates(&self) -> Vec<ComplianceTerm> {
        let largest = self.max_torque.iter().copied().fold(0.0, f64::max);
        let of_joint = |column: usize| {
            let values = self.samples.iter().flat_map(move |s| s.q.iter().map(move |q| q[column]));
            let range = value_range(values);
            let sags = self.max_torque[column] > MIN_TORQUE_SHARE * largest;
            let turns = range > MIN_RANGE_RAD;
            let moves = range > MIN_MOTION_RAD;
            let orders = ECCENTRICITY_ORDERS.iter().map(|&order| ComplianceKind::Eccentric(order));
            let crossings = [BacklashCrossing::Gradual, BacklashCrossing::Sudden].into_iter();
            let kinds = crossings
                .filter(move |_| moves)
                .map(ComplianceKind::Backlash)
                .chain(moves.then_some(ComplianceKind::Delay))
                // A joint at rest sags as well.
                .chain(sags.then_some(ComplianceKind::Sag))
                .chain(orders.filter(move |_| turns));
            kinds.map(move |kind| ComplianceTerm::new(column, kind)).collect::<Vec<_>>()
        };
        let columns = 0..self.run.joints.dof;
        columns.filter(|column| self.run.is_rotary(*column)).flat_map(of_joint).collect()
    }

    /// Coefficients of a term, with their profiles.
    fn coefficients_of(&self, term: &ComplianceTerm) -> Vec<Coefficient> {
        let (joints, column) = (self.run.joints, term.column);
        let behind = match term.kind {
            ComplianceKind::Backlash(crossing) => {
                let width = match term.amount[0].abs() {
                    0.0 => INITIAL_BACKLASH_RAD,
                    width => width,
                };
                let q = |row: usize| joints.row(row)[column];
                crossing.link_offsets(joints.len(), q, width)
            }
            _ => Vec::new(),
        };
        let values = |samples: &StreamSamples, torques: &[Vec<f64>], k: usize| -> [f64; 2] {
            let share = torques[k][column] / self.max_torque[column];
            match term.kind {
                ComplianceKind::Backlash(_) => {
                    let (row, part) = samples.at[k];
                    let next = (row + 1).min(behind.len() - 1);
                    [behind[row] * (1.0 - part) + behind[next] * part, 0.0]
                }
                ComplianceKind::Sag => [share, 0.0],
                ComplianceKind::LoadedSag(from_s) => {
                    let is_before = joints.t_s[samples.at[k].0] < from_s;
                    if is_before { [share, 0.0] } else { [0.0, share] }
                }
                ComplianceKind::Eccentric(order) => {
                    (f64::from(order) * samples.q[k][column]).sin_cos().into()
                }
                ComplianceKind::Delay => [samples.qd[k][column] / self.max_speed[column], 0.0],
            }
        };
        let coefficient = |at: usize| {
            let of_stream = |(samples, torques): (&StreamSamples, &Vec<Vec<f64>>)| {
                (0..samples.q.len()).map(|k| values(samples, torques, k)[at]).collect()
            };
            let profiles = self.samples.iter().zip(&self.torques).map(of_stream).collect();
            Coefficient { column, profiles }
        };
        (0..term.width()).map(coefficient).collect()
    }

    fn system(&self, terms: &[ComplianceTerm]) -> ComplianceSystem {
        let coefficients: Vec<Coefficient> =
            terms.iter().flat_map(|term| self.coefficients_of(term)).collect();
        ComplianceSystem::new(self.samples, &coefficients)
    }

    /// The terms that are worth their price.
    fn selected(
        &self,
        terms: &[ComplianceTerm],
        is_candidate: impl Fn(&ComplianceTerm) -> bool,
        system: &ComplianceSystem,
    ) -> Vec<ComplianceTerm> {
        let coefficients = coefficients(terms);
        let cost = |set: &[usize]| {
            let set: Vec<usize> = set.iter().flat_map(|&term| coefficients[term].clone()).collect();
            system.cost(&set)
        };
        let every: Vec<usize> = (0..terms.len()).collect();
        let (without_terms, with_all) = (cost(&[]), cost(&every));
        let min_worth = MIN_EXPLAINED_SHARE * (without_terms - with_all);
        let worth = |&index: &usize| (system.price() * terms[index].width() as f64).max(min_worth);
        let score = |set: &[usize]| cost(set) + set.iter().map(worth).sum::<f64>();
        let candidates: Vec<usize> =
            every.into_iter().filter(|&index| is_candidate(&terms[index])).collect();
        let none = ScoredSet { members: Vec::new(), score: without_terms };
        let selected = grow(&candidates, none, score).members;
        selected.into_iter().map(|index| terms[index]).collect()
    }

    /// Small sets. The first has no eccentricity; a second follows if eccentricity is selected.
    pub fn terms(&self) -> Vec<Vec<ComplianceTerm>> {
        let terms = self.candidates();
        let system = self.system(&terms);
        let is_eccentric =
            |term: &ComplianceTerm| matches!(term.kind, ComplianceKind::Eccentric(_));
        let simple = self.selected(&terms, |term| !is_eccentric(term), &system);
        let mixed = self.selected(&terms, |_| true, &system);
        let is_mixed = mixed.iter().any(is_eccentric);
        let sets = [Some(simple), is_mixed.then_some(mixed)].into_iter().flatten();
        sets.filter(|set| !set.is_empty()).collect()
    }

    /// Sag that changes at one time, and backlash, with everything else free. Empty if constant sag fits
    /// about as well.
    pub fn load_change_terms(&self) -> Vec<ComplianceTerm> {
        let Some((first, last)) = self.run.joints.span() else { return Vec::new() };
        let loaded = |at_s: f64| -> Vec<ComplianceTerm> {
            let kind = ComplianceKind::LoadedSag(at_s);
            let sags = self.candidates_of(|kind| *kind == ComplianceKind::Sag);
            sags.map(|term| ComplianceTerm { kind, ..term }).collect()
        };
        let cost_at = |at_s: f64| self.residual_noise(&loaded(at_s));
        let length_s = last - first;
        let rough = (1..TRIAL_TIMES).map(|at| first + length_s * at as f64 / TRIAL_TIMES as f64);
        let best = |tried: &mut dyn Iterator<Item = f64>| {
            let costs = tried.map(|at_s| (cost_at(at_s), at_s));
            costs.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let Some((_, rough_s)) = best(&mut rough.into_iter()) else { return Vec::new() };
        let near = (-GRID_REFINEMENT..=GRID_REFINEMENT)
            .map(|step| rough_s + self.step_s() * f64::from(step));
        let Some((_, at_s)) = best(&mut near.into_iter()) else { return Vec::new() };
        let mut terms = loaded(at_s);
        terms.extend(self.candidates_of(|kind| matches!(kind, ComplianceKind::Backlash(_))));
        let set = self.selected(&terms, |_| true, &self.system(&terms));
        let is_loaded = set.iter().any(|term| matches!(term.kind, ComplianceKind::LoadedSag(_)));
        if is_loaded { set } else { Vec::new() }
    }

    /// Resolution of the load change.
    fn step_s(&self) -> f64 {
        let (first, last) = self.run.joints.span().unwrap_or_default();
        (last - first) / (TRIAL_TIMES as f64 * f64::from(GRID_REFINEMENT))
    }

    /// `Σ n·ln σ` with `terms` and everything else free.
    pub fn residual_noise(&self, terms: &[ComplianceTerm]) -> f64 {
        self.system(terms).noise()
    }

    /// Refines values. If `are_removed`, residuals are already corrected for them, and insignificant terms are
    /// removed.
    pub fn refine(&self, terms: &mut Vec<ComplianceTerm>, are_removed: bool) {
        let system = self.system(terms);
        let (values, covariance) = system.estimate();
        let all = coefficients(terms);
        for (term, own) in terms.iter_mut().zip(all) {
            let mut variance: f64 = 0.0;
            for (amount, at) in term.amount.iter_mut().zip(own) {
                *amount = f64::from(u8::from(are_removed)) * *amount + values[at];
                variance = variance.max(covariance[(at, at)]);
            }
            term.std_error = variance.sqrt();
            term.dof = system.dof();
        }
        if are_removed {
            terms.retain(ComplianceTerm::is_significant);
        }
    }

    pub fn to_compliance(&self, terms: &[ComplianceTerm]) -> Vec<JointCompliance> {
        let compliance = |term: &ComplianceTerm| {
            let ComplianceTerm { column, amount, std_error, dof, .. } = *term;
            let shape = match term.kind {
                ComplianceKind::Backlash(crossing) => ComplianceShape::Backlash(crossing),
                ComplianceKind::Sag | ComplianceKind::LoadedSag(_) => {
                    ComplianceShape::Sag(JointSag {
                        gravity: Arc::clone(&self.gravity),
                        max_torque: self.max_torque[column],
                    })
                }
                ComplianceKind::Eccentric(order) => {
                    ComplianceShape::Eccentric { order, phase_rad: amount[1].atan2(amount[0]) }
                }
                ComplianceKind::Delay => {
                    ComplianceShape::Delay { max_speed: self.max_speed[column] }
                }
            };
            let value = term.size();
            let is_sag = matches!(term.kind, ComplianceKind::Sag | ComplianceKind::LoadedSag(_));
            let measured = |value: f64, share: f64| Measured {
                value,
                std_error: share
                    * std_error.hypot(if is_sag { MASS_STD_ERROR * value } else { 0.0 }),
                dof,
            };
            let change = match term.kind {
                ComplianceKind::LoadedSag(at_s) => Some(ChangePoint {
                    at_s,
                    within_s: self.step_s(),
                    course: Course::Step,
                    from: amount[0],
                    to: amount[1],
                    size: measured(amount[1] - amount[0], std::f64::consts::SQRT_2),
                }),
                _ => None,
            };
            JointCompliance { column, value: measured(value, 1.0), shape, change }
        };
        terms.iter().map(compliance).collect()
    }
}

/// Coefficients of each term.
fn coefficients(terms: &[ComplianceTerm]) -> Vec<Range<usize>> {
    let mut end = 0;
    let own = |term: &ComplianceTerm| {
        end += term.width();
        end - term.width()..end
    };
    terms.iter().map(own).collect()
}

/// Indexed by stream, sample and joint.
fn torques(gravity: &GravityTorques, samples: &[StreamSamples], dof: usize) -> Vec<Vec<Vec<f64>>> {
    let mut buffer = TorqueBuffers::default();
    let mut of_sample = |q: &Vec<f64>| {
        let mut torques = vec![0.0; dof];
        gravity.torques(q, &mut buffer, &mut torques);
        torques
    };
    samples.iter().map(|samples| samples.q.iter().map(&mut of_sample).collect()).collect()
}
