//! Joint compliance: backlash, sag under gravity, and eccentric gears or encoders. Positions of one joint that are late
//! are found in the same way.
//!
//! Backlash resembles a latency and sag a joint zero, so the selected model may report those and keep a
//! large residual. The residual is then regressed on one profile per joint ([`search`]): direction of the
//! last motion (hysteresis), gravity torque, joint angle, or speed. Compliance is reported only if correcting it
//! reduces the residual substantially.

mod gains;
mod gravity;
mod search;
mod shapes;
mod system;

use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::joints::correct_joints;
use crate::latency::correlation::stream_lag_s;
use crate::priors::{MAX_LOG_RATIO_OF_CONFOUNDER, MIN_LOG_RATIO_OF_SAG};
use crate::residuals::cause_columns::CauseColumns;
use crate::residuals::comparison::{has_large_residual, restore_recorded};
use crate::samples::sampling::FkSequence;
use crate::selection::evidence::{likeliest, log_bayes_factor};
use crate::{
    AlignedSamples, ArmDiagnosis, Confounder, JointEncoding, JointScale, PoseDiagnosis, PoseStream,
};
use ground::stats::lowest;

pub(super) use gains::diagnose_with_gain;
use gravity::MassModel;
use search::{ComplianceSearch, refine};
pub use shapes::{BacklashCrossing, ComplianceShape, JointCompliance, JointSag};
use shapes::{MASS_STD_ERROR, USUAL_COMPLIANCE_RAD};
pub(super) use shapes::{apply_compliance, motion_directions};

const CONVERGED_RAD: f64 = 2e-5;
/// Tested against sag.
const MIN_ZERO_RAD: f64 = 1e-3;
const MAX_ROUNDS: usize = 3;

/// Residual of a stream under a diagnosis, and the reported joint states at its samples.
struct StreamSamples<'a> {
    columns: CauseColumns<'a>,
    /// Reported, all joints of the track.
    q: Vec<Vec<f64>>,
    /// Velocities of all joints.
    qd: Vec<Vec<f64>>,
    /// Row of the joint track before the sample, and fraction to the next.
    at: Vec<(usize, f64)>,
}

/// `diagnosis` is the diagnosis without compliance. `None` if no joint has any or it does not explain enough.
pub(super) fn diagnose_with_compliance(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
    is_distinct: impl Fn(&ArmDiagnosis) -> bool,
) -> Option<ArmDiagnosis> {
    let ArmRun { joints, streams, is_prismatic, .. } = *run;
    let is_coded = diagnosis.joints.scales.iter().any(JointScale::is_coded);
    let is_applicable = !are_floating(streams)
        && !is_coded
        && diagnosis.joints.patches.is_empty()
        && joints.len() > 1
        && !diagnosis.streams.iter().any(PoseDiagnosis::is_far_from_fk);
    if !is_applicable {
        return None;
    }
    let has_large = diagnosis.streams.iter().any(has_large_residual);
    let diagnose_run = |run: &ArmRun, diagnosis: &ArmDiagnosis| {
        let fitted = has_large.then(|| run.fit_compliance(diagnosis)).flatten();
        let zeros_as_sag = || run.test_zeros_as_sag(diagnosis).filter(&is_distinct);
        fitted.filter(&is_distinct).or_else(zeros_as_sag)
    };
    let encoding = match &diagnosis.joints.encoding {
        Ok(encoding) if !encoding.is_as_logged() => encoding,
        _ => return diagnose_run(run, diagnosis),
    };
    if !has_large && !diagnosis.joints.offsets.iter().any(|offset| offset.is_chosen) {
        return None;
    }
    let corrected = correct_joints(joints, encoding, is_prismatic);
    let run = ArmRun { joints: &corrected, ..*run };
    let mut after = diagnose_run(&run, &run.diagnose_as_logged())?;
    after.joints.encoding.clone_from(&diagnosis.joints.encoding);
    after.joints.scales.clone_from(&diagnosis.joints.scales);
    for ((stream, diagnosis), after) in
        streams.iter().zip(&diagnosis.streams).zip(&mut after.streams)
    {
        restore_recorded(joints, stream, after);
        if let (Ok(after), Ok(diagnosis)) = (&mut after.residual, &diagnosis.residual) {
            (after.before_m, after.before_rad) = (diagnosis.before_m, diagnosis.before_rad);
        }
    }
    Some(after)
}

/// Diagnosis with compliance, if it explains a joint's scale or coupling in `diagnosis` about as well. Over a small range,
/// sag looks like a scale of 1 %, which is rarer. Eccentric gears are rarer still.
pub(super) fn diagnose_gain_as_compliance(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let is_odd = |scale: &JointScale| {
        !scale.is_coded() && (!scale.is_round() || scale.factor.value.round() == 1.0)
    };
    let is_coupled =
        |encoding: &JointEncoding| encoding.couplings.iter().any(|coupling| !coupling.is_round());
    let joints = &diagnosis.joints;
    if !joints.scales.iter().any(is_odd) && !joints.encoding.as_ref().is_ok_and(is_coupled) {
        return None;
    }
    let after = run.fit_compliance(&run.diagnose_as_logged()).filter(has_unusual_compliance)?;
    let is_eccentric = after.joints.compliance.iter().any(JointCompliance::is_eccentric);
    let min_log_ratio = MAX_LOG_RATIO_OF_CONFOUNDER * if is_eccentric { 1.0 } else { -1.0 };
    (log_bayes_factor(&after, diagnosis) > min_log_ratio).then_some(after)
}

/// Whether some joint has more compliance than usual.
pub(super) fn has_unusual_compliance(diagnosis: &ArmDiagnosis) -> bool {
    let is_unusual = |joint: &JointCompliance| joint.size().abs() > USUAL_COMPLIANCE_RAD;
    diagnosis.joints.compliance.iter().any(is_unusual)
}

/// Whether sizes differ by less than they are uncertain.
fn are_converged(terms: &[JointCompliance], before: &[JointCompliance]) -> bool {
    /// Of the standard error.
    const MAX_CHANGE_SHARE: f64 = 0.1;
    let is_converged = |(now, before): (&JointCompliance, &JointCompliance)| {
        let change = (now.size() - before.size()).abs();
        change < CONVERGED_RAD.max(MAX_CHANGE_SHARE * now.std_error)
    };
    terms.len() == before.len() && terms.iter().zip(before).all(is_converged)
}

impl ArmRun<'_> {
    fn fit_compliance(&self, diagnosis: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let is_explained = |after: &ArmDiagnosis| !after.streams.iter().any(has_large_residual);
        let samples = self.samples(diagnosis);
        let (search, sets) = self.search(&samples)?;
        let mut found = Vec::new();
        for terms in sets {
            found.extend(self.diagnose_without(&samples, terms));
            // Eccentricity is flexible: backlash and sag take precedence.
            if found.iter().any(is_explained) {
                break;
            }
        }
        if !found.iter().any(is_explained) {
            // A load change gives one joint two sag values.
            let terms = search.load_change_terms();
            if !terms.is_empty() {
                found.extend(self.diagnose_without(&samples, terms));
            }
        }
        let mut after = likeliest(found)?;
        if log_bayes_factor(&after, diagnosis) <= search.selection_price() {
            return None;
        }
        // An error of the assumed link masses looks like a zero offset.
        for compliance in after.joints.compliance.iter().filter(|compliance| compliance.is_sag()) {
            let offset = after.joints.offsets.get_mut(compliance.column);
            if let Some(Ok(offset)) = offset.map(|offset| &mut offset.offset) {
                offset.std_error = offset.std_error.hypot(MASS_STD_ERROR * compliance.size());
            }
        }
        Some(after)
    }

    /// Replaces a joint zero by sag if that is clearly likelier, or lists sag as its confounder if both are
    /// similarly likely. `None` if neither holds.
    fn test_zeros_as_sag(&self, diagnosis: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let is_as_logged =
            diagnosis.joints.encoding.as_ref().is_ok_and(JointEncoding::is_as_logged);
        let is_nominal = diagnosis.streams.iter().any(|diagnosis| diagnosis.is_nominal);
        let offsets = diagnosis.joints.offsets.iter().enumerate();
        let zeros: Vec<(usize, f64)> = offsets
            .map(|(column, offset)| (column, offset.chosen()))
            .filter(|(column, zero)| !self.is_prismatic[*column] && zero.abs() > MIN_ZERO_RAD)
            .collect();
        if !is_as_logged || zeros.is_empty() {
            return None;
        }
        let samples = self.samples(diagnosis);
        let search = ComplianceSearch::new(self, &samples, MassModel::CANDIDATES[0])?;
        let mut with_confounders: Option<ArmDiagnosis> = None;
        for (column, zero) in zeros {
            let Some(term) = search.sag_like(column, zero) else { continue };
            let term = vec![term];
            let refined = self.diagnose_converged(term.clone());
            let is_refined = refined.is_some();
            // A constant torque does not distinguish them.
            let equal = || self.corrected(&term);
            let after = refined.or_else(equal).filter(has_unusual_compliance);
            let Some(after) = after else { continue };
            let is_zero_still_chosen =
                after.joints.offsets.get(column).is_some_and(|offset| offset.is_chosen);
            let sag = after.joints.compliance.first().map_or(0.0, JointCompliance::size);
            let gain = log_bayes_factor(&after, diagnosis);
            if !is_zero_still_chosen && is_refined && gain > MIN_LOG_RATIO_OF_SAG && !is_nominal {
                return Some(after);
            }
            if !is_zero_still_chosen && gain > -MAX_LOG_RATIO_OF_CONFOUNDER {
                let diagnosis = with_confounders.get_or_insert_with(|| diagnosis.clone());
                diagnosis.joints.offsets[column].confounders.push(Confounder::Sag(column, sag));
            }
        }
        with_confounders
    }

    /// Sets that explain most with few joints, with the mass distribution that fits best.
    fn search<'a>(
        &'a self,
        samples: &'a [StreamSamples<'a>],
    ) -> Option<(ComplianceSearch<'a>, Vec<Vec<JointCompliance>>)> {
        let with_masses = |masses| ComplianceSearch::new(self, samples, masses);
        let search = with_masses(MassModel::CANDIDATES[0])?;
        let sets = search.terms();
        let sags = |set: &&Vec<JointCompliance>| set.iter().any(JointCompliance::is_sag);
        let Some(first) = sets.iter().find(sags) else { return Some((search, sets)) };
        let searches = MassModel::CANDIDATES.into_iter().filter_map(with_masses);
        let search = lowest(searches, |search| search.residual_noise(first))?;
        let sets = search.terms();
        Some((search, sets))
    }

    /// `None` if no term remains.
    fn diagnose_without(
        &self,
        samples: &[StreamSamples],
        mut terms: Vec<JointCompliance>,
    ) -> Option<ArmDiagnosis> {
        for _ in 0..MAX_ROUNDS {
            refine(self.joints, samples, &mut terms, false);
        }
        self.diagnose_converged(terms)
    }

    /// [`Self::diagnose_without`] from the values in `terms`.
    fn diagnose_converged(&self, mut terms: Vec<JointCompliance>) -> Option<ArmDiagnosis> {
        let mut after = self.corrected(&terms)?;
        for _ in 0..MAX_ROUNDS {
            let before = terms.clone();
            refine(self.joints, &self.samples(&after), &mut terms, true);
            if are_converged(&terms, &before) {
                break;
            }
            after = self.corrected(&terms)?;
        }
        after.joints.compliance = terms;
        Some(after)
    }

    /// Diagnosis with these compliances. `None` without any.
    fn corrected(&self, compliances: &[JointCompliance]) -> Option<ArmDiagnosis> {
        if compliances.is_empty() {
            return None;
        }
        let mut joints = self.joints.clone();
        apply_compliance(&mut joints, compliances);
        let mut after = ArmRun { joints: &joints, ..*self }.diagnose_as_logged();
        after.joints.compliance = compliances.to_vec();
        Some(after)
    }

    fn samples<'b>(&'b self, diagnosis: &'b ArmDiagnosis) -> Vec<StreamSamples<'b>> {
        let both = self.streams.iter().zip(&diagnosis.streams);
        both.map(|(stream, diagnosis)| self.stream_samples(stream, diagnosis)).collect()
    }

    /// Time of measurement of a stamp, s.
    fn truth_s(
        &self,
        stream: &PoseStream,
        diagnosis: &PoseDiagnosis,
    ) -> impl Fn(f64) -> f64 + use<> {
        let lag_s = match &diagnosis.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(self.joints, stream, self.max_lag_s),
        };
        let (skew, middle_s) = (diagnosis.chosen_skew(), diagnosis.aligned.middle_s());
        move |t_s| t_s - lag_s - skew * (t_s - middle_s)
    }

    /// Returns eccentricity to the residual, because no rule reports it.
    pub(super) fn restore_eccentricity(&self, after: &mut ArmDiagnosis) {
        if !after.joints.compliance.iter().any(JointCompliance::is_eccentric) {
            return;
        }
        let named =
            after.joints.without_eccentricity().corrected_joints(self.joints, self.is_prismatic);
        for (stream, diagnosis) in self.streams.iter().zip(&mut after.streams) {
            let truth_s = self.truth_s(stream, diagnosis);
            let AlignedSamples { t_s, fk_at_truth, .. } = &mut diagnosis.aligned;
            let mut sequence = FkSequence::new(&named, stream.chain, stream.columns);
            for (t_s, fk) in t_s.iter().zip(fk_at_truth) {
                *fk = sequence.at(truth_s(*t_s)).unwrap_or(*fk);
            }
        }
    }

    fn stream_samples<'b>(
        &self,
        stream: &PoseStream<'b>,
        diagnosis: &'b PoseDiagnosis,
    ) -> StreamSamples<'b> {
        let truth_s = self.truth_s(stream, diagnosis);
        let columns = CauseColumns::new(diagnosis, stream).with_free_zeros();
        let (mut all, mut all_qd, mut at) = (Vec::new(), Vec::new(), Vec::new());
        let mut sequence = self.joints.sequence();
        for row in columns.samples() {
            let at_s = truth_s(diagnosis.aligned.t_s[row]);
            // Beyond the joint states, the last positions stay.
            sequence.at(at_s);
            let (q, qd) = sequence.last();
            let row = self.joints.t_s.partition_point(|t_s| *t_s <= at_s).saturating_sub(1);
            let next = (row + 1).min(self.joints.len() - 1);
            let period_s = (self.joints.t_s[next] - self.joints.t_s[row]).max(f64::MIN_POSITIVE);
            let part = ((at_s - self.joints.t_s[row]) / period_s).clamp(0.0, 1.0);
            all.push(q.to_vec());
            all_qd.push(qd.to_vec());
            at.push((row, part));
        }
        StreamSamples { columns, q: all, qd: all_qd, at }
    }
}
