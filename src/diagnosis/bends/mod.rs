//! Joints that give: play, sag under gravity, eccentric gears and encoders.
//!
//! Play looks like a latency and sag like a joint's zero, so that the smallest explanation of a run may
//! name these, and something is left that they do not explain. There it is asked what each joint may do
//! beside them, on the explanation's own linearisation: play goes with the direction of the last motion
//! (hysteresis), sag with the torque of gravity, eccentricity with the joint's angle ([`search`]). What is
//! found is taken off the joint states, and everything else is sought anew on the arm as it would be if
//! no joint gave. Only if far less is left then does one.

mod found;
mod gravity;
mod rival;
mod search;
mod system;

use super::arm::diagnose_arm;
use super::changes::{as_recorded, leaves_much};
use super::joints::corrected;
use super::sampling::stream_lag_s;
use super::{
    Aligned, ArmDiagnosis, JointReading, JointScale, PoseDiagnosis, PoseStream, Residuals,
};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::median;
use ground::stream::JointTrack;

use found::USUAL_RAD;
pub use found::{BendShape, Crossing, JointBend, Sag};
pub(super) use found::{bend, ways};
use gravity::Masses;
pub(super) use rival::gives;
use search::{Free, Kind, MASSES, Search, Term};

/// Samples of a stream that are looked at.
const SAMPLES: usize = 2000;
/// With the bends taken off at most this share is left of what was, beyond the noise.
const LEFT: f64 = 0.5;
/// Where so little of it is left, play and sag are enough.
const ENOUGH: f64 = 0.15;
/// At most this of a drawing that is held against a calibrated arm.
const LEFT_OF_NOMINAL: f64 = 0.25;
/// An amount that moves by less is settled, rad.
const SETTLED_RAD: f64 = 2e-5;
/// How often an amount is bettered on what the explanation with it leaves.
const ROUNDS: usize = 3;

/// A run whose joints may give.
struct Run<'a> {
    joints: &'a JointTrack,
    streams: &'a [PoseStream<'a>],
    slides: &'a [bool],
    most_lag_s: f64,
}

/// Samples of one stream and what an explanation leaves of them, in the base, at the tip.
#[derive(Default)]
struct Samples {
    /// Positions of all joints of the track as they are reported.
    q: Vec<Vec<f64>>,
    /// Their velocities.
    qd: Vec<Vec<f64>>,
    /// The row of the joint track before the sample, and how far it is to the next.
    at: Vec<(usize, f64)>,
    /// Jacobian of each joint of the track.
    jacobian: Vec<Vec<[f64; 6]>>,
    fk: Vec<Pose>,
    /// Of position, m, and of rotation, rad.
    residual: Vec<[[f64; 3]; 2]>,
    has_rotation: bool,
}

/// The diagnosis of an arm some of whose joints give, of the run as it would be if none did; `None` where
/// none does, or where that explains too little. `found` is what the run says otherwise.
pub(super) fn without_bends(
    joints: &JointTrack,
    streams: &[PoseStream],
    slides: &[bool],
    found: &ArmDiagnosis,
    most_lag_s: f64,
) -> Option<ArmDiagnosis> {
    let is_coded = found.joints.scales.iter().any(JointScale::is_coded);
    let may_give = !is_coded
        && found.joints.patches.is_empty()
        && joints.len() > 1
        && !found.streams.iter().any(PoseDiagnosis::strays);
    if !may_give || !found.streams.iter().any(leaves_much) {
        return None;
    }
    let reading = match &found.joints.reading {
        Ok(reading) if !reading.is_as_logged() => reading,
        // Joints that are read in no way are taken as they are logged.
        _ => return Run { joints, streams, slides, most_lag_s }.unbent(found),
    };
    let read = corrected(joints, reading, slides);
    let run = Run { joints: &read, streams, slides, most_lag_s };
    let mut after = run.unbent(&diagnose_arm(&read, streams, most_lag_s))?;
    after.joints.reading.clone_from(&found.joints.reading);
    after.joints.scales.clone_from(&found.joints.scales);
    for ((stream, found), after) in streams.iter().zip(&found.streams).zip(&mut after.streams) {
        as_recorded(joints, stream, after);
        if let (Ok(after), Ok(found)) = (&mut after.residual, &found.residual) {
            (after.before_m, after.before_rad) = (found.before_m, found.before_rad);
        }
    }
    Some(after)
}

/// What is left of an arm's streams, an angle counting at 0.3 m, m.
#[derive(Clone, Copy, Debug)]
struct Left {
    /// Root mean square, beyond the noise.
    rms_m: f64,
    /// Median, with the noise.
    median_m: f64,
}

impl Left {
    fn of(found: &ArmDiagnosis) -> Self {
        let rms = |found: &PoseDiagnosis| match &found.residual {
            Ok(residual) => residual.excess_m.value.hypot(0.3 * residual.excess_rad.value),
            Err(_) => 1.0,
        };
        let half = |found: &PoseDiagnosis| {
            let Residuals { m, rad } = found.aligned.after();
            let mut all: Vec<f64> = m.iter().zip(&rad).map(|(m, rad)| m.hypot(0.3 * rad)).collect();
            median(&mut all).unwrap_or(1.0)
        };
        let streams = || found.streams.iter();
        Self { rms_m: streams().map(rms).sum(), median_m: streams().map(half).sum() }
    }

    /// Whether it is at most a share of `other`. Where a joint crosses its play at once, as on a sudden
    /// load, some is left at each reversal and nothing beside it.
    fn is_within(&self, share: f64, other: &Self) -> bool {
        let is_mostly = self.median_m < 0.5 * share * other.median_m;
        self.rms_m <= share * other.rms_m || (is_mostly && self.rms_m <= 1.5 * share * other.rms_m)
    }
}

impl Run<'_> {
    /// The diagnosis of a run of which `found` is what it says otherwise, as it would be if no joint gave;
    /// `None` where none does, or where that explains too little.
    fn unbent(&self, found: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let samples = self.samples(self.joints, found);
        let before = Left::of(found);
        let mut best: Option<(Left, ArmDiagnosis)> = None;
        let found_sets = self.search(&samples);
        for (search, terms) in found_sets
            .iter()
            .flat_map(|(search, sets)| sets.iter().map(move |terms| (search, terms.clone())))
        {
            let is_eccentric = terms.iter().any(|term| matches!(term.kind, Kind::Eccentric(_)));
            // An eccentricity can be bent to many shapes: play and sag come before it.
            let enough = |(left, _): &(Left, ArmDiagnosis)| left.is_within(ENOUGH, &before);
            if is_eccentric && best.as_ref().is_some_and(enough) {
                break;
            }
            let Some(after) = self.without(search, terms) else { continue };
            let left = Left::of(&after);
            if best.as_ref().is_none_or(|(best, _)| left.is_within(LEFT, best)) {
                best = Some((left, after));
            }
        }
        let enough = |(left, _): &(Left, ArmDiagnosis)| left.is_within(ENOUGH, &before);
        if !best.as_ref().is_some_and(enough) {
            // Another load makes of one sag two.
            let loaded = found_sets.as_ref().map(|(search, _)| (search, search.loaded()));
            let loaded = loaded.filter(|(_, terms)| !terms.is_empty());
            if let Some(after) = loaded.and_then(|(search, terms)| self.without(search, terms)) {
                let left = Left::of(&after);
                if best.as_ref().is_none_or(|(best, _)| left.is_within(LEFT, best)) {
                    best = Some((left, after));
                }
            }
        }
        // What is left of a drawing is of many small causes, of which a few bends take off something too.
        let is_nominal = found.streams.iter().any(|found| found.nominal);
        let most = if is_nominal { LEFT_OF_NOMINAL } else { LEFT };
        let (left, mut after) = best?;
        let is_read = after.joints.reading.as_ref().is_ok_and(JointReading::is_as_logged);
        if !is_read || !left.is_within(most, &before) {
            return None;
        }
        if after.joints.bends.iter().any(JointBend::is_eccentric) {
            self.leave_unnamed(&mut after);
        }
        // Other masses than those that are guessed make something of a sag that a zero makes, too.
        for bend in after.joints.bends.iter().filter(|bend| bend.is_sag()) {
            let offset = after.joints.offsets.get_mut(bend.column);
            if let Some(Ok(offset)) = offset.map(|offset| &mut offset.offset) {
                offset.std_error = offset.std_error.hypot(MASSES * bend.amount.value);
            }
        }
        Some(after)
    }

    /// What may give on `samples`, as few joints as explain most, and the search that found them: by the
    /// masses that fit best where some joint sags.
    fn search<'a>(&'a self, samples: &'a [Samples]) -> Option<(Search<'a>, Vec<Vec<Term>>)> {
        let search = Search::new(self, samples, Masses::TRIED[0])?;
        let sets = search.terms();
        let sags = |set: &&Vec<Term>| set.iter().any(|term| term.kind == Kind::Sag);
        let Some(first) = sets.iter().find(sags) else { return Some((search, sets)) };
        let searches = Masses::TRIED.into_iter().filter_map(|masses| {
            let search = Search::new(self, samples, masses)?;
            Some((search.left(first), search))
        });
        let search = searches.min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        let sets = search.terms();
        Some((search, sets))
    }

    /// The diagnosis of the run with the bends that `terms` are taken off; `None` where they are none.
    fn without(&self, search: &Search, mut terms: Vec<Term>) -> Option<ArmDiagnosis> {
        let free = Free::all(self);
        for _ in 0..ROUNDS {
            search.refine(&mut terms, &free, false);
        }
        let mut after = self.bent(&search.bends(&terms))?;
        for _ in 0..ROUNDS {
            // What the explanation needs no more is not free beside the bends.
            let before: Vec<f64> = terms.iter().map(Term::size).collect();
            let samples = self.samples(&after.0, &after.1);
            search.on(&samples).refine(&mut terms, &Free::chosen(self, &after.1), true);
            let mut moved = terms.iter().map(Term::size).zip(&before);
            let is_settled = terms.len() == before.len()
                && moved.all(|(size, before)| (size - before).abs() < SETTLED_RAD);
            if is_settled {
                break;
            }
            after = self.bent(&search.bends(&terms))?;
        }
        let bends = search.bends(&terms);
        let gives = bends.iter().any(|bend| bend.amount.value.abs() > USUAL_RAD);
        after.1.joints.bends = bends;
        gives.then_some(after.1)
    }

    /// The joint states with `bends` taken off, and what the run says of them then; `None` of no bends.
    fn bent(&self, bends: &[JointBend]) -> Option<(JointTrack, ArmDiagnosis)> {
        if bends.is_empty() {
            return None;
        }
        let mut joints = self.joints.clone();
        bend(&mut joints, bends);
        let found = diagnose_arm(&joints, self.streams, self.most_lag_s);
        Some((joints, found))
    }

    /// The samples of every stream, and what is left of them where `joints` are those that were `found`
    /// that of.
    fn samples(&self, joints: &JointTrack, found: &ArmDiagnosis) -> Vec<Samples> {
        let corrected = found.joints.corrected_joints(joints, self.slides);
        let both = self.streams.iter().zip(&found.streams);
        both.map(|(stream, found)| self.of_stream(&corrected, stream, found)).collect()
    }

    /// When what a stream says at a stamp was true, s.
    fn truth_s(&self, stream: &PoseStream, found: &PoseDiagnosis) -> impl Fn(f64) -> f64 + use<> {
        let lag_s = match &found.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(self.joints, stream, self.most_lag_s),
        };
        let skew = found.skew.as_ref().ok().filter(|_| found.skew_chosen);
        let skew = skew.map_or(0.0, |skew| skew.value);
        let middle_s = found.aligned.middle_s();
        move |t_s| t_s - lag_s - skew * (t_s - middle_s)
    }

    /// Leaves in the aligned samples what no rule names: eccentricity.
    fn leave_unnamed(&self, after: &mut ArmDiagnosis) {
        let named = after.joints.as_named().corrected_joints(self.joints, self.slides);
        let (mut q, mut qd) = (vec![0.0; named.dof], vec![0.0; named.dof]);
        for (stream, found) in self.streams.iter().zip(&mut after.streams) {
            let truth_s = self.truth_s(stream, found);
            let Aligned { t_s, fk_at_truth, .. } = &mut found.aligned;
            let mut cursor = 0;
            for (t_s, fk) in t_s.iter().zip(fk_at_truth) {
                if named.at(truth_s(*t_s), &mut cursor, &mut q, &mut qd) {
                    let own: Vec<f64> = stream.columns.iter().map(|&column| q[column]).collect();
                    *fk = stream.chain.forward(&own);
                }
            }
        }
    }

    fn of_stream(
        &self,
        corrected: &JointTrack,
        stream: &PoseStream,
        found: &PoseDiagnosis,
    ) -> Samples {
        let truth_s = self.truth_s(stream, found);
        let Aligned { t_s, corrected: poses, fk_at_truth, .. } = &found.aligned;
        let dof = self.joints.dof;
        let mut samples = Samples { has_rotation: found.reading.is_ok(), ..Samples::default() };
        let (mut cursor, mut cursor_corrected) = (0, 0);
        let mut chain_q = vec![0.0; stream.columns.len()];
        let mut own = vec![[0.0; 6]; stream.columns.len()];
        for k in (0..t_s.len()).step_by(t_s.len().div_ceil(SAMPLES).max(1)) {
            let at_s = truth_s(t_s[k]);
            let (mut q, mut qd) = (vec![0.0; dof], vec![0.0; dof]);
            let (mut true_q, mut true_qd) = (vec![0.0; dof], vec![0.0; dof]);
            let is_covered = self.joints.at(at_s, &mut cursor, &mut q, &mut qd)
                && corrected.at(at_s, &mut cursor_corrected, &mut true_q, &mut true_qd);
            if !is_covered {
                continue;
            }
            let row = self.joints.t_s.partition_point(|t_s| *t_s <= at_s).saturating_sub(1);
            let next = (row + 1).min(self.joints.len() - 1);
            let period_s = (self.joints.t_s[next] - self.joints.t_s[row]).max(f64::MIN_POSITIVE);
            let part = ((at_s - self.joints.t_s[row]) / period_s).clamp(0.0, 1.0);
            chain_q.iter_mut().zip(stream.columns).for_each(|(q, &column)| *q = true_q[column]);
            stream.chain.forward_with_jacobian(&chain_q, &mut own);
            let mut jacobian = vec![[0.0; 6]; dof];
            own.iter().zip(stream.columns).for_each(|(own, &column)| jacobian[column] = *own);
            let (is, fk) = (&poses[k], &fk_at_truth[k]);
            let turn = rotvec_from_rotation(&(is.rotation * fk.rotation.inverse()));
            let turn = if samples.has_rotation { turn } else { Vec3::zeros() };
            samples
                .residual
                .push([(is.translation.vector - fk.translation.vector).into(), turn.into()]);
            samples.fk.push(*fk);
            samples.q.push(q);
            samples.qd.push(true_qd);
            samples.at.push((row, part));
            samples.jacobian.push(jacobian);
        }
        samples
    }
}
