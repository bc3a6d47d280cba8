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

#[cfg(test)]
mod tests {
    use crate::test_motion;
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, diagnose_run};
    use ground::geometry::{Vec3, rotation_from_rotvec};
    use ground::stream::{Orientations, PoseTrack};

    /// Diagnosis of poses of the arm where the joints actually are, with link deviations of 0.1 mm.
    fn diagnosed(
        actual: impl Fn(&[f64]) -> Vec<f64>,
        late_by: impl Fn(f64) -> f64,
    ) -> ArmDiagnosis {
        let (joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(1e-4);
        let mut random = Lcg::new();
        let noisy = |q: &[f64]| {
            let [shift, turn] = [1e-5, 1e-5].map(|size| random.triple(size));
            let pose = deviating.forward(&actual(q));
            let turn = rotation_from_rotvec(turn.into());
            (pose.translation.vector + Vec3::from(shift), turn * pose.rotation)
        };
        let (xyz, rotations) = joints.q.chunks(6).map(noisy).unzip();
        let orientation = Orientations::Rotations(rotations);
        let t_s = joints.t_s.iter().map(|t_s| t_s + late_by(*t_s)).collect();
        let track = PoseTrack { t_s, xyz, orientation, declared: None };
        diagnose_run(&joints, &[test_motion::tip_stream(&track, &chain)], &[false; 6], 1.0)
    }

    #[test]
    fn a_small_scale_of_a_joint_is_measured_beside_link_deviations() {
        let scaled = |q: &[f64]| {
            let mut q = q.to_vec();
            q[3] *= 1.01;
            q
        };
        let found = diagnosed(scaled, |_| 0.0);
        let scales: Vec<usize> = found.joints.scales.iter().map(|scale| scale.column).collect();
        assert_eq!(scales, [3]);
        let factor = found.joints.scales[0].factor;
        assert!((factor.value - 1.01).abs() < 5e-4, "{factor:?}");
    }

    #[test]
    fn a_weak_coupling_of_joints_is_measured_beside_link_deviations() {
        let coupled = |q: &[f64]| {
            let mut q = q.to_vec();
            q[5] += 0.03 * q[4];
            q
        };
        let found = diagnosed(coupled, |_| 0.0);
        let encoding = found.joints.encoding.expect("an encoding");
        let couplings: Vec<(usize, usize)> =
            encoding.couplings.iter().map(|coupling| (coupling.column, coupling.by)).collect();
        assert_eq!(couplings, [(5, 4)]);
        let factor = encoding.couplings[0].factor;
        assert!((factor.value - 0.03).abs() < 5e-4, "{factor:?}");
    }

    #[test]
    fn a_deviating_arm_needs_no_gains_and_shows_a_small_skew() {
        let found = diagnosed(|q| q.to_vec(), |t_s| 1e-4 * t_s);
        assert!(found.joints.scales.is_empty());
        assert!(found.joints.encoding.is_ok_and(|encoding| encoding.is_as_logged()));
        let stream = &found.streams[0];
        let skew = stream.skew.as_ref().expect("a skew");
        assert!(stream.is_skew_chosen && (skew.value - 1e-4).abs() < 1e-5, "{skew:?}");
    }
}
