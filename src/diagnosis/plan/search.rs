//! Search for the motion with the largest information on the requested parameters.

use super::fourier::{FourierMotion, sampled};
use super::precision::{ExpectedPrecision, LinearizedMotion};
use super::{ClearanceViolation, JointMargins, PlanRequirements, Purpose, Sensing};
use ground::robot::Chain;
use ground::stream::JointTrack;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Arms can follow it, and it shows a latency of some milliseconds.
const MAX_FREQUENCY_HZ: f64 = 0.3;
/// Fewer leave too little freedom, more take too long.
const SINES_PER_JOINT: std::ops::RangeInclusive<usize> = 5..=18;
/// At either end; some estimates need samples at rest.
const REST_S: f64 = 2.0;
const MAX_REST_SHARE: f64 = 0.05;
const EVALUATION_ROWS: usize = 160;
/// During the search, and for the result.
const SEARCH_CLEARANCE_HZ: f64 = 10.0;
const RESULT_CLEARANCE_HZ: f64 = 50.0;
/// Their median serves as a baseline.
const INITIAL_MOTIONS: usize = 15;
const SEARCH_STEPS: usize = 1500;
/// Tried in turn until the clearance is kept.
const MARGIN_SHARES: [f64; 8] = [1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05];

/// Result of the search, with expected precisions.
#[derive(Clone, Debug)]
pub struct MotionPlan {
    /// The motion.
    pub series: FourierMotion,
    /// Fraction of the room used.
    pub share: f64,
    /// This motion.
    pub precision: Vec<ExpectedPrecision>,
    /// Median random motion within the limits.
    pub random_precision: Vec<ExpectedPrecision>,
    /// Joints moving in turn for the same time.
    pub one_by_one_precision: Vec<ExpectedPrecision>,
}

/// Why no motion was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Infeasible {
    /// No joint can move.
    NoMargin,
    /// All attempts violated a clearance; here at the smallest fraction.
    ClearanceViolated(Option<ClearanceViolation>),
    /// The requested parameters remain unobservable.
    NothingObservable,
}

/// Expected precision of a motion. `None` if its rows are more than 2 s apart during motion.
pub fn expected_precision(
    chain: &Chain,
    motion: &JointTrack,
    purpose: Purpose,
    sensing: &Sensing,
) -> Option<Vec<ExpectedPrecision>> {
    let sampled = sample_motion(motion)?;
    Some(LinearizedMotion::new(chain, &sampled, purpose, sensing)?.expected_precisions())
}

/// Samples evaluation rows. `None` if these are more than 2 s apart during motion.
fn sample_motion(motion: &JointTrack) -> Option<JointTrack> {
    let (first, last) = motion.span()?;
    let mut sampled = JointTrack { dof: motion.dof, ..JointTrack::default() };
    let mut sequence = motion.sequence();
    let rows = 2 * EVALUATION_ROWS;
    for row in 0..rows {
        let t_s = first + (last - first) * row as f64 / (rows - 1) as f64;
        let (q, qd) = sequence.at(t_s.min(last))?;
        sampled.t_s.push(t_s);
        sampled.q.extend_from_slice(q);
        sampled.qd.extend_from_slice(qd);
    }
    Some(sampled)
}

/// Finds the motion with the largest information.
///
/// # Errors
/// If no motion satisfies the limits.
pub fn plan(requirements: &PlanRequirements) -> Result<MotionPlan, Infeasible> {
    let can_move = |&JointMargins { below, above, velocity, acceleration }: &JointMargins| {
        [below, above, velocity, acceleration].into_iter().all(|margin| margin > 0.0)
    };
    if !requirements.margins.iter().any(can_move) {
        return Err(Infeasible::NoMargin);
    }
    let rest_s = REST_S.min(MAX_REST_SHARE * requirements.seconds);
    let seconds = requirements.seconds - 2.0 * rest_s;
    let harmonics = (MAX_FREQUENCY_HZ * seconds).round() as usize;
    let harmonics = harmonics.clamp(*SINES_PER_JOINT.start(), *SINES_PER_JOINT.end());
    let at_rest = FourierMotion::at_rest(requirements.around, seconds, rest_s, harmonics);
    let search = MotionSearch { requirements, at_rest };
    let mut last = None;
    for share in MARGIN_SHARES {
        let mut random = Pcg64::seed_from_u64(requirements.seed);
        let mut draws: Vec<(f64, FourierMotion)> = Vec::new();
        for _ in 0..INITIAL_MOTIONS {
            let series = search.random_motion(&mut random, share);
            match search.first_violation(&series, SEARCH_CLEARANCE_HZ) {
                None => draws.push((search.score(&series), series)),
                offence => last = offence,
            }
        }
        draws.retain(|(score, _)| score.is_finite());
        draws.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(middle) = draws.get(draws.len() / 2).cloned() else { continue };
        let (_, series) = search.improve(draws.swap_remove(0), share, &mut random);
        let offence = search.first_violation(&series, RESULT_CLEARANCE_HZ);
        if offence.is_some() {
            last = offence;
            continue;
        }
        let promises = |motion: &JointTrack| {
            search.linearized(motion).map_or_else(Vec::new, |it| it.expected_precisions())
        };
        return Ok(MotionPlan {
            precision: promises(&series.track(2 * EVALUATION_ROWS)),
            random_precision: promises(&middle.1.track(2 * EVALUATION_ROWS)),
            one_by_one_precision: promises(&search.single_joint_motion(share, 2 * EVALUATION_ROWS)),
            series,
            share,
        });
    }
    match last {
        None => Err(Infeasible::NothingObservable),
        near => Err(Infeasible::ClearanceViolated(near)),
    }
}

struct MotionSearch<'a> {
    requirements: &'a PlanRequirements<'a>,
    at_rest: FourierMotion,
}

impl MotionSearch<'_> {
    fn random_motion(&self, random: &mut Pcg64, share: f64) -> FourierMotion {
        let mut series = self.at_rest.clone();
        for joint in 0..series.dof() {
            let falls = random.random_range(0.3..1.5);
            for k in 0..series.harmonics {
                let size = ((k + 1) as f64).powf(-falls);
                let mut normal = || -> f64 { StandardNormal.sample(&mut *random) };
                let at = joint * series.harmonics + k;
                (series.sin[at], series.cos[at]) = (size * normal(), size * normal());
            }
            series.project(joint, &self.requirements.margins[joint], share);
        }
        series
    }

    /// Checked at `rate_hz`.
    fn first_violation(&self, series: &FourierMotion, rate_hz: f64) -> Option<ClearanceViolation> {
        let track = series.track((series.length_s() * rate_hz).ceil() as usize + 1);
        (0..track.len()).find_map(|row| {
            self.requirements.clearances.first_violation(self.requirements.chain, track.row(row))
        })
    }

    fn linearized<'m>(&'m self, motion: &'m JointTrack) -> Option<LinearizedMotion<'m>> {
        let PlanRequirements { chain, purpose, sensing, .. } = self.requirements;
        LinearizedMotion::new(chain, motion, *purpose, sensing)
    }

    fn score(&self, series: &FourierMotion) -> f64 {
        let track = series.track(EVALUATION_ROWS);
        self.linearized(&track).map_or(f64::INFINITY, |linearized| linearized.score())
    }

    /// (1+1) evolution strategy, one joint at a time. The step size adapts to the success rate (Rechenberg,
    /// *Evolutionsstrategie*, 1973).
    fn improve(
        &self,
        start: (f64, FourierMotion),
        share: f64,
        random: &mut Pcg64,
    ) -> (f64, FourierMotion) {
        let (mut best, mut size) = (start, 0.5);
        for _ in 0..SEARCH_STEPS {
            let mut next = best.1.clone();
            let joint = random.random_range(0..next.dof());
            let own = joint * next.harmonics..(joint + 1) * next.harmonics;
            let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
            let squares = square(&next.sin[own.clone()]) + square(&next.cos[own.clone()]);
            let typical = (squares / (2 * own.len()) as f64).sqrt();
            for value in next.sin[own.clone()].iter_mut().chain(&mut next.cos[own]) {
                let change: f64 = StandardNormal.sample(&mut *random);
                *value += size * typical * change;
            }
            next.project(joint, &self.requirements.margins[joint], share);
            let score = self.score(&next);
            let is_better =
                score < best.0 && self.first_violation(&next, SEARCH_CLEARANCE_HZ).is_none();
            size = (size * if is_better { 1.5 } else { 0.9 }).clamp(0.03, 2.0);
            if is_better {
                best = (score, next);
            }
        }
        best
    }

    /// Each joint in turn moves forth and back once, as far and as fast as the limits allow.
    fn single_joint_motion(&self, share: f64, rows: usize) -> JointTrack {
        let FourierMotion { around, seconds: whole_s, rest_s, .. } = &self.at_rest;
        let dof = around.len();
        let seconds = whole_s / dof as f64;
        let mut series = FourierMotion::at_rest(around, seconds, 0.0, 2);
        for joint in 0..dof {
            // Starts and ends at rest.
            (series.sin[2 * joint], series.sin[2 * joint + 1]) = (1.0, -0.5);
            series.project(joint, &self.requirements.margins[joint], share);
        }
        sampled(rows, self.at_rest.length_s(), dof, |joint, t_s| {
            let t_s = (t_s - rest_s).clamp(0.0, *whole_s);
            let mover = ((t_s / seconds) as usize).min(dof - 1);
            match joint == mover {
                true => series.at(joint, t_s - mover as f64 * seconds),
                false => [around[joint], 0.0, 0.0],
            }
        })
    }
}
