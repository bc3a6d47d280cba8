//! Selects the joints with compliance by linear least squares on the residual of one diagnosis, with constant causes free.

use super::StreamSamples;
use super::gravity::{GravityTorques, MassModel};
use super::shapes::{
    BacklashCrossing, ComplianceShape, JointCompliance, JointSag, MAX_COMPLIANCE_RAD,
};
use super::system::{Coefficient, ComplianceSystem};
use crate::arm_run::ArmRun;
use crate::joints::MIN_MOTION_RAD;
use crate::samples::sampling::value_range;
use crate::selection::stepwise::{ScoredSet, grow};
use ground::stats::{lowest, mean};
use ground::stream::JointTrack;
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
}

impl<'a> ComplianceSearch<'a> {
    pub fn new(
        run: &'a ArmRun,
        samples: &'a [StreamSamples<'a>],
        masses: MassModel,
    ) -> Option<Self> {
        let stream = run.streams.iter().max_by_key(|stream| stream.columns.len())?;
        let gravity = Arc::new(GravityTorques::new(stream.chain, stream.columns, masses));
        let mut max_torque = vec![0.0_f64; run.joints.dof];
        for own in torques(&gravity, samples).iter().flatten() {
            max_torque.iter_mut().zip(own).for_each(|(max, own)| *max = max.max(own.abs()));
        }
        Some(Self { run, samples, gravity, max_torque })
    }

    fn sag(&self, column: usize, load_change_s: Option<(f64, f64)>) -> JointCompliance {
        let (gravity, max_torque) = (Arc::clone(&self.gravity), self.max_torque[column]);
        let sag = JointSag { gravity, max_torque, load_change_s };
        JointCompliance::new(column, ComplianceShape::Sag(sag))
    }

    /// Sag whose mean equals a zero of `offset_rad`. `None` if the sign contradicts gravity or it is too
    /// large.
    pub fn sag_like(&self, column: usize, offset_rad: f64) -> Option<JointCompliance> {
        self.sagging().find(|sagging| *sagging == column)?;
        let torques = torques(&self.gravity, self.samples);
        let torques = torques.iter().flatten().map(|torques| torques[column]);
        let amounts = [offset_rad * self.max_torque[column] / mean(torques), 0.0];
        (amounts[0] > 0.0 && amounts[0] < MAX_COMPLIANCE_RAD)
            .then(|| JointCompliance { amounts, ..self.sag(column, None) })
    }

    /// Price of the selection of one of the candidates, as a log ratio: each is equally likely.
    pub fn selection_price(&self) -> f64 {
        2.0 * (self.candidates().len().max(1) as f64).ln()
    }

    /// Columns of the joints that may sag, also at rest.
    fn sagging(&self) -> impl Iterator<Item = usize> {
        let largest = self.max_torque.iter().copied().fold(0.0, f64::max);
        let sags = move |column: &usize| self.max_torque[*column] > MIN_TORQUE_SHARE * largest;
        self.rotary().filter(sags)
    }

    fn rotary(&self) -> impl Iterator<Item = usize> {
        (0..self.run.joints.dof).filter(|column| self.run.is_rotary(*column))
    }

    fn candidates(&self) -> Vec<JointCompliance> {
        let of_joint = |column: usize| {
            let values = self.samples.iter().flat_map(move |s| s.q.iter().map(move |q| q[column]));
            let range = value_range(values);
            let speeds = self.run.joints.velocities_of(column).map(f64::abs);
            let max_speed = speeds.fold(0.0, f64::max);
            let of_motion = [
                ComplianceShape::Backlash(BacklashCrossing::Gradual),
                ComplianceShape::Backlash(BacklashCrossing::Sudden),
                ComplianceShape::Delay { max_speed },
            ];
            let of_motion = of_motion.into_iter().filter(move |_| range > MIN_MOTION_RAD);
            let eccentric = ECCENTRICITY_ORDERS.map(ComplianceShape::Eccentric);
            let eccentric = eccentric.into_iter().filter(move |_| range > MIN_RANGE_RAD);
            let own = move |shape| JointCompliance::new(column, shape);
            let sag = self.sagging().find(|sagging| *sagging == column);
            let sag = sag.map(|column| self.sag(column, None));
            of_motion.map(own).chain(sag).chain(eccentric.map(own)).collect::<Vec<_>>()
        };
        self.rotary().flat_map(of_joint).collect()
    }

    fn system(&self, terms: &[JointCompliance]) -> ComplianceSystem {
        system(self.run.joints, self.samples, terms)
    }

    /// The terms that are worth their price.
    fn selected(
        &self,
        terms: &[JointCompliance],
        is_candidate: impl Fn(&JointCompliance) -> bool,
        system: &ComplianceSystem,
    ) -> Vec<JointCompliance> {
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
        selected.into_iter().map(|index| terms[index].clone()).collect()
    }

    /// Small sets. The first has no eccentricity; a second follows if eccentricity is selected.
    pub fn terms(&self) -> Vec<Vec<JointCompliance>> {
        let terms = self.candidates();
        let system = self.system(&terms);
        let is_eccentric =
            |term: &JointCompliance| matches!(term.shape, ComplianceShape::Eccentric(_));
        let simple = self.selected(&terms, |term| !is_eccentric(term), &system);
        let mixed = self.selected(&terms, |_| true, &system);
        let is_mixed = mixed.iter().any(is_eccentric);
        let sets = [Some(simple), is_mixed.then_some(mixed)].into_iter().flatten();
        sets.filter(|set| !set.is_empty()).collect()
    }

    /// Sag that changes at one time, and backlash, with everything else free. Empty if constant sag fits
    /// about as well.
    pub fn load_change_terms(&self) -> Vec<JointCompliance> {
        let Some((first, last)) = self.run.joints.span() else { return Vec::new() };
        let length_s = last - first;
        let step_s = length_s / (TRIAL_TIMES as f64 * f64::from(GRID_REFINEMENT));
        let loaded = |at_s: f64| -> Vec<JointCompliance> {
            self.sagging().map(|column| self.sag(column, Some((at_s, step_s)))).collect()
        };
        let cost_at = |at_s: &f64| self.system(&loaded(*at_s)).noise();
        let rough = (1..TRIAL_TIMES).map(|at| first + length_s * at as f64 / TRIAL_TIMES as f64);
        let Some(rough_s) = lowest(rough, cost_at) else { return Vec::new() };
        let near =
            (-GRID_REFINEMENT..=GRID_REFINEMENT).map(|step| rough_s + step_s * f64::from(step));
        let Some(at_s) = lowest(near, cost_at) else { return Vec::new() };
        let mut terms = loaded(at_s);
        terms.extend(self.candidates().into_iter().filter(JointCompliance::is_backlash));
        let set = self.selected(&terms, |_| true, &self.system(&terms));
        let is_loaded = set.iter().any(JointCompliance::is_sag);
        if is_loaded { set } else { Vec::new() }
    }

    /// `Σ n·ln σ` with these terms, of which sag has the masses of this search, and everything else free.
    pub fn residual_noise(&self, terms: &[JointCompliance]) -> f64 {
        let with_masses = |term: &JointCompliance| match term.is_sag() {
            true => self.sag(term.column, None),
            false => term.clone(),
        };
        self.system(&terms.iter().map(with_masses).collect::<Vec<_>>()).noise()
    }
}

/// Refines the amounts of terms. If `are_removed`, residuals are already corrected for them, and insignificant terms are
/// removed.
pub(super) fn refine(
    joints: &JointTrack,
    samples: &[StreamSamples],
    terms: &mut Vec<JointCompliance>,
    are_removed: bool,
) {
    let system = system(joints, samples, terms);
    let (values, covariance) = system.estimate();
    let all = coefficients(terms);
    for (term, own) in terms.iter_mut().zip(all) {
        let mut variance: f64 = 0.0;
        for (amount, at) in term.amounts.iter_mut().zip(own) {
            *amount = f64::from(u8::from(are_removed)) * *amount + values[at];
            variance = variance.max(covariance[(at, at)]);
        }
        term.std_error = variance.sqrt();
        term.dof = system.dof();
    }
    if are_removed {
        terms.retain(JointCompliance::is_significant);
    }
}

/// Equations of these terms, which have the same masses.
fn system(
    joints: &JointTrack,
    samples: &[StreamSamples],
    terms: &[JointCompliance],
) -> ComplianceSystem {
    let gravity = terms.iter().find_map(|term| match &term.shape {
        ComplianceShape::Sag(sag) => Some(&sag.gravity),
        _ => None,
    });
    let torques = gravity.map_or_else(Vec::new, |gravity| torques(gravity, samples));
    let of_term = |term| coefficients_of(term, joints, samples, &torques);
    ComplianceSystem::new(samples, &terms.iter().flat_map(of_term).collect::<Vec<_>>())
}

/// Coefficients of a term, with their profiles.
fn coefficients_of(
    term: &JointCompliance,
    joints: &JointTrack,
    samples: &[StreamSamples],
    torques: &[Vec<Vec<f64>>],
) -> Vec<Coefficient> {
    let column = term.column;
    let behind = match term.shape {
        ComplianceShape::Backlash(crossing) => {
            let width = match term.amounts[0].abs() {
                0.0 => INITIAL_BACKLASH_RAD,
                width => width,
            };
            crossing.link_offsets(joints.len(), |row| joints.row(row)[column], width)
        }
        _ => Vec::new(),
    };
    let values = |s: usize, k: usize| -> [f64; 2] {
        let StreamSamples { q, qd, at, .. } = &samples[s];
        let (row, part) = at[k];
        match &term.shape {
            ComplianceShape::Backlash(_) => {
                let next = (row + 1).min(behind.len() - 1);
                [behind[row] * (1.0 - part) + behind[next] * part, 0.0]
            }
            ComplianceShape::Sag(sag) => {
                let mut shares = [0.0; 2];
                shares[sag.amount_at(joints.t_s[row])] = torques[s][k][column] / sag.max_torque;
                shares
            }
            ComplianceShape::Eccentric(order) => {
                (f64::from(*order) * q[k][column]).sin_cos().into()
            }
            ComplianceShape::Delay { max_speed } => [qd[k][column] / max_speed, 0.0],
        }
    };
    let coefficient = |at: usize| {
        let of_stream = |s: usize| (0..samples[s].q.len()).map(|k| values(s, k)[at]).collect();
        Coefficient { column, profiles: (0..samples.len()).map(of_stream).collect() }
    };
    (0..term.width()).map(coefficient).collect()
}

/// Coefficients of each term.
fn coefficients(terms: &[JointCompliance]) -> Vec<Range<usize>> {
    let mut end = 0;
    let own = |term: &JointCompliance| {
        end += term.width();
        end - term.width()..end
    };
    terms.iter().map(own).collect()
}

/// Indexed by stream, sample and joint.
fn torques(gravity: &GravityTorques, samples: &[StreamSamples]) -> Vec<Vec<Vec<f64>>> {
    let of_stream =
        |samples: &StreamSamples| samples.q.iter().map(|q| gravity.torques(q)).collect();
    samples.iter().map(of_stream).collect()
}
