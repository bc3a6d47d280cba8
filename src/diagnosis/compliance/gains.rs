//! A scale of a joint, or a coupling between two joints, found in the residual of a diagnosis.
//!
//! Encodings are searched with exact links (`joints`). Link deviations hide a scale of a few per mille there. Here, an error
//! of a joint that is proportional to its own or another joint's position is tested together with constant causes and link
//! deviations.

use super::shapes::USUAL_COMPLIANCE_RAD;
use super::system::{Coefficient, ComplianceSystem};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::joints::MIN_MOTION_RAD;
use crate::model::observability::travel;
use crate::selection::evidence::log_bayes_factor;
use crate::{
    ArmDiagnosis, JointCoupling, JointEncoding, JointUnit, JointUnitError, PoseDiagnosis,
    UnitResiduals,
};
use ground::stats::{Measured, lowest, mean};

/// Diagnosis with another scale or coupling of a joint. `None` if it is not likelier than `diagnosis`, which has no
/// compliance and no changes, or if that has another encoding of the joint states.
pub(crate) fn diagnose_with_gain(run: &ArmRun, diagnosis: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    let is_applicable = !are_floating(run.streams)
        && diagnosis.joints.encoding.as_ref().is_ok_and(JointEncoding::is_as_logged)
        && !diagnosis.streams.iter().any(PoseDiagnosis::is_far_from_fk);
    if !is_applicable {
        return None;
    }
    let (encoding, selection_price) = run.likeliest_gain(diagnosis)?;
    let mut after = run.diagnose_encoded(encoding);
    if let Ok(encoding) = &mut after.joints.encoding {
        let [as_logged, corrected] = [&diagnosis.streams[..], &after.streams[..]].map(rms_m);
        encoding.residual = Some(UnitResiduals { as_logged, corrected });
    }
    (log_bayes_factor(&after, diagnosis) > selection_price).then_some(after)
}

impl ArmRun<'_> {
    /// Encoding with the position error of a joint, in proportion to the position of a joint, that explains most of the
    /// residual, and the price of its selection. `None` if none is worth it.
    fn likeliest_gain(&self, diagnosis: &ArmDiagnosis) -> Option<(JointEncoding, f64)> {
        let joints = diagnosis.joints.corrected_joints(self.joints, self.is_prismatic);
        let run = ArmRun { joints: &joints, ..*self };
        let samples = run.samples(diagnosis);
        let rotary = || (0..joints.dof).filter(|column| self.is_rotary(*column));
        let driving = || rotary().filter(|by| travel(&joints, *by) > MIN_MOTION_RAD);
        let gains: Vec<[usize; 2]> =
            rotary().flat_map(|column| driving().map(move |by| [column, by])).collect();
        let middles: Vec<f64> =
            (0..joints.dof).map(|column| mean(joints.positions_of(column))).collect();
        let coefficient = |&[column, by]: &[usize; 2]| {
            let from_middle = |q: &Vec<f64>| q[by] - middles[by];
            let profiles =
                samples.iter().map(|samples| samples.q.iter().map(from_middle).collect());
            Coefficient { column, profiles: profiles.collect() }
        };
        let coefficients: Vec<Coefficient> = gains.iter().map(coefficient).collect();
        let system = ComplianceSystem::new(&samples, &coefficients);
        let cost = |gain: &usize| system.cost(&[*gain]);
        let best = lowest(0..gains.len(), cost)?;
        let selection_price = 2.0 * (gains.len() as f64).ln();
        let gained = system.cost(&[]) - cost(&best);
        let ([column, by], amount) = (gains[best], system.best_value(best));
        // Usual sag and eccentricity have a larger effect than a smaller gain.
        let is_large = amount.abs() * 0.5 * travel(&joints, by) > USUAL_COMPLIANCE_RAD;
        let is_worth_it = gained > system.price() + selection_price;
        let mut encoding = JointEncoding::default();
        if column == by {
            let (unit, factor) = (JointUnit::Scaled, 1.0 + amount);
            encoding.unit_errors.push(JointUnitError { column, unit, factor });
        } else {
            let factor = Measured { value: amount, std_error: 0.0, dof: 1.0 };
            encoding.couplings.push(JointCoupling { column, by, factor });
        }
        (is_large && is_worth_it).then_some((encoding, selection_price))
    }
}

/// Of the positions, the largest of all streams.
fn rms_m(streams: &[PoseDiagnosis]) -> f64 {
    let residuals = streams.iter().filter_map(|stream| stream.residual.as_ref().ok());
    residuals.map(|residual| residual.rms_m).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use crate::test_motion;
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, diagnose_run};
    use ground::geometry::{Vec3, rotation_from_rotvec};

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
        let t_s: Vec<f64> = joints.t_s.iter().map(|t_s| t_s + late_by(*t_s)).collect();
        let track = test_motion::pose_track(&t_s, joints.q.chunks(6).map(noisy));
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
