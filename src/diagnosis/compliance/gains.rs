//! Scales of joints and couplings between joints, found in the residual of a diagnosis.
//!
//! Encodings are searched with exact links (`joints`), whose deviations hide a scale of a few per mille. Here, errors of a
//! joint that are proportional to its own or another joint's position are tested beside constant causes and link
//! deviations.

use super::system::{Coefficient, ComplianceSystem};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::changes::is_explained_by_links;
use crate::priors::price;
use crate::residuals::comparison::has_large_residual;
use crate::selection::evidence::log_bayes_factor;
use crate::{
    ArmDiagnosis, JointCoupling, JointEncoding, JointUnit, JointUnitError, PoseDiagnosis,
    PoseStream, UnitResiduals,
};
use ground::stats::Measured;

/// A joint's position error, proportional to the position of joint `by`. Columns of the joint track.
#[derive(Clone, Copy)]
struct Gain {
    column: usize,
    by: usize,
}

/// Diagnosis with other scales or couplings of joints. `None` if they are not likelier than `diagnosis`, without
/// compliance and changes.
pub(crate) fn diagnose_with_gains(run: &ArmRun, diagnosis: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    /// Of a joint and a coupled one.
    const MAX_GAINS: usize = 3;
    if are_floating(run.streams) || diagnosis.streams.iter().any(PoseDiagnosis::is_far_from_fk) {
        return None;
    }
    let mut found: Option<ArmDiagnosis> = None;
    for _ in 0..MAX_GAINS {
        let before = found.as_ref().unwrap_or(diagnosis);
        let is_open = |(found, stream): (&PoseDiagnosis, &PoseStream)| {
            has_large_residual(found) && !is_explained_by_links(found, stream)
        };
        if !before.streams.iter().zip(run.streams).any(is_open) {
            break;
        }
        let Some((encoding, price)) = run.encoding_with_another_gain(before) else { break };
        let mut after = run.diagnose_encoded(encoding);
        if let Ok(encoding) = &mut after.joints.encoding {
            let [as_logged, corrected] =
                [&diagnosis.streams, &after.streams].map(|streams| rms_m(streams));
            encoding.residual = Some(UnitResiduals { as_logged, corrected });
        }
        if log_bayes_factor(&after, before) <= price {
            break;
        }
        found = Some(after);
    }
    found
}

impl ArmRun<'_> {
    /// The encoding of `diagnosis` with the gain that explains most of the residual, and the price of its selection.
    /// `None` if none is worth it.
    fn encoding_with_another_gain(&self, diagnosis: &ArmDiagnosis) -> Option<(JointEncoding, f64)> {
        let encoding = diagnosis.joints.encoding.as_ref().ok()?;
        let joints = diagnosis.joints.corrected_joints(self.joints, self.is_prismatic);
        let run = ArmRun { joints: &joints, ..*self };
        let samples = run.samples(diagnosis);
        let gains = run.possible_gains(encoding);
        let middles: Vec<f64> =
            (0..joints.dof).map(|column| middle(&joints.q, column, joints.dof)).collect();
        let coefficient = |gain: &Gain| {
            let from_middle = |q: &Vec<f64>| q[gain.by] - middles[gain.by];
            let profiles =
                samples.iter().map(|samples| samples.q.iter().map(from_middle).collect());
            Coefficient { column: gain.column, profiles: profiles.collect() }
        };
        let coefficients: Vec<Coefficient> = gains.iter().map(coefficient).collect();
        let system = ComplianceSystem::new(&samples, &coefficients);
        let cost = |gain: &usize| system.cost(&[*gain]);
        let best = (0..gains.len()).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        let selection = 2.0 * (gains.len() as f64).ln();
        let is_worth = system.cost(&[]) - cost(&best) > price(system.independent()) + selection;
        let amount = system.best_value(best);
        is_worth.then(|| (with_gain(encoding, gains[best], amount), selection))
    }

    /// Of moving joints, on joints whose encoding is in no doubt.
    fn possible_gains(&self, encoding: &JointEncoding) -> Vec<Gain> {
        /// As for a joint's sign.
        const MIN_MOTION_RAD: f64 = 0.05;
        let dof = self.joints.dof;
        let moves = |column: &usize| {
            let positions = self.joints.q.iter().skip(*column).step_by(dof);
            let (low, high) = positions
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| {
                    (low.min(*q), high.max(*q))
                });
            high - low > MIN_MOTION_RAD
        };
        let is_used =
            |column: &usize| self.streams.iter().any(|stream| stream.columns.contains(column));
        let is_free = |column: &usize| {
            !encoding.unit_errors.iter().any(|error| error.column == *column)
                && !encoding.couplings.iter().any(|coupling| coupling.column == *column)
        };
        let rotary = |column: &usize| is_used(column) && !self.is_prismatic[*column];
        let driving: Vec<usize> = (0..dof).filter(rotary).filter(moves).collect();
        let driven = (0..dof).filter(rotary).filter(is_free);
        driven.flat_map(|column| driving.iter().map(move |&by| Gain { column, by })).collect()
    }
}

/// Of the positions of all streams.
fn rms_m(streams: &[PoseDiagnosis]) -> f64 {
    let residuals = streams.iter().filter_map(|stream| stream.residual.as_ref().ok());
    residuals.map(|residual| residual.rms_m).fold(0.0, f64::max)
}

fn middle(q: &[f64], column: usize, dof: usize) -> f64 {
    let positions = || q.iter().skip(column).step_by(dof.max(1));
    positions().sum::<f64>() / positions().count().max(1) as f64
}

fn with_gain(encoding: &JointEncoding, Gain { column, by }: Gain, amount: f64) -> JointEncoding {
    let mut with = encoding.clone();
    match column == by {
        true => with.unit_errors.push(JointUnitError {
            column,
            unit: JointUnit::Scaled,
            factor: 1.0 + amount,
        }),
        false => with.couplings.push(JointCoupling {
            column,
            by,
            factor: Measured { value: amount, std_error: 0.0, dof: 1.0 },
        }),
    }
    with
}
