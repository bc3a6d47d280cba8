//! Steps of a stream's latency, fitted together with link deviations: for motion that starts and stops too rarely for a
//! latency in every part of the run.

use super::step_test::{ChangeKind, StepOrDrift, likeliest_change};
use crate::latency::profile::largest;
use crate::residuals::cause_columns::{CauseColumns, LATENCY, VariableColumns};
use crate::residuals::comparison::has_slow_residual;
use crate::solver::linear::ridged;
use crate::{LatencyProfile, LatencyShape, LatencyStep, Measured, PoseDiagnosis};
use ground::robot::Chain;

/// Profile of a latency with steps, if they are significant and likelier than other changes of causes. `found` has a
/// constant latency.
pub(crate) fn latency_steps(found: &PoseDiagnosis, chain: &Chain) -> Option<LatencyProfile> {
    const MAX_STEPS: usize = 4;
    /// Half of what LAT003 reports. Smaller ones are also errors of the model.
    const MIN_SWING_S: f64 = 2.5e-3;
    if found.residual.is_err() || found.is_far_from_fk() || !has_slow_residual(found) {
        return None;
    }
    let columns = CauseColumns::new(found, chain).with_free_zeros();
    let mut steps: Vec<StepOrDrift> = Vec::new();
    while steps.len() < MAX_STEPS {
        let linear = columns.linearize(&variable(&columns, &steps));
        let weights = columns.local_weights(&linear);
        let next = likeliest_change(&columns, &steps, (&linear, &weights), ChangeKind::Any);
        let is_step = |it: &StepOrDrift| it.columns.start == LATENCY && it.step.is_some();
        let Some((next, _)) = next.filter(|(next, _)| is_step(next)) else { break };
        steps.push(next);
        steps.sort_by(|a, b| at_s(a).total_cmp(&at_s(b)));
    }
    let linear = columns.linearize(&variable(&columns, &steps));
    let first = columns.fit(&linear, &linear.first_weights());
    let normal = columns.normal_equations(&linear, &linear.weights_after(first.as_slice()));
    let covariance = ridged(normal.matrix).cholesky()?.inverse();
    let halves = &covariance * &normal.right;
    let dof = (normal.independent - linear.width as f64).max(3.0);
    let measured = |(step, column): (&StepOrDrift, usize)| LatencyStep {
        at_s: at_s(step),
        size_s: Measured {
            value: 2.0 * halves[column],
            std_error: 2.0 * covariance[(column, column)].sqrt(),
            dof,
        },
    };
    let steps: Vec<LatencyStep> = steps.iter().zip(columns.constant()..).map(measured).collect();
    let is_significant =
        |swing: &Measured| swing.value.abs() > swing.half_width(0.95).max(MIN_SWING_S);
    let swing_s = largest(&steps).filter(is_significant)?;
    let mut level_s = 0.0;
    let later = steps.iter().map(|step| {
        level_s += step.size_s.value;
        (step.at_s, level_s)
    });
    let levels = std::iter::once((f64::NEG_INFINITY, 0.0)).chain(later).collect();
    let windows =
        found.latency_profile.as_ref().map_or_else(|_| Vec::new(), |it| it.windows.clone());
    let shape = LatencyShape::Steps;
    Some(LatencyProfile { swing_s, is_unsteady: true, shape, skew: 0.0, levels, steps, windows })
}

fn at_s(it: &StepOrDrift) -> f64 {
    it.step.map_or(f64::NEG_INFINITY, |step| step.at_s)
}

fn variable(columns: &CauseColumns, steps: &[StepOrDrift]) -> Vec<VariableColumns> {
    let of_step = |it: &StepOrDrift| {
        let times = columns.samples().map(|row| columns.aligned.t_s[row]);
        let factors = times.map(|t_s| it.factor(columns, t_s)).collect();
        VariableColumns { columns: it.columns.clone(), factors }
    };
    steps.iter().map(of_step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::diagnose_arm;
    use crate::test_motion::{arm, deviating_chain, tip_stream};
    use crate::test_random::Lcg;
    use ground::geometry::Vec3;
    use ground::stream::{Orientations, PoseTrack};

    /// Latency steps that are found for an arm that deviates.
    fn steps_of(latency_s: impl Fn(f64) -> f64) -> Vec<LatencyStep> {
        let (joints, chain) = arm();
        let deviating = deviating_chain(3e-4);
        let mut random = Lcg::new();
        let (mut q, mut qd, mut cursor) = (vec![0.0; 6], vec![0.0; 6], 0);
        let (mut t_s, mut xyz, mut rotations) = (Vec::new(), Vec::new(), Vec::new());
        for stamp in (10..980).map(|row| f64::from(row) * 0.02) {
            assert!(joints.at(stamp - latency_s(stamp), &mut cursor, &mut q, &mut qd));
            let pose = deviating.forward(&q);
            t_s.push(stamp);
            xyz.push(pose.translation.vector + Vec3::from(random.triple(2e-5)));
            rotations.push(pose.rotation);
        }
        let orientation = Orientations::Rotations(rotations);
        let track = PoseTrack { t_s, xyz, orientation, declared: None };
        let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
        latency_steps(&found.streams[0], &chain).map_or_else(Vec::new, |profile| profile.steps)
    }

    #[test]
    fn a_latency_step_of_an_arm_that_deviates_is_measured() {
        let steps = steps_of(|t_s| if t_s > 12.0 { 0.013 } else { 0.005 });
        let [step] = steps.as_slice() else { panic!("{steps:?}") };
        assert!((step.at_s - 12.0).abs() < 0.1, "{step:?}");
        assert!((step.size_s.value - 0.008).abs() < 2e-4, "{step:?}");
        for drift_s_s in [0.0, 2e-4] {
            assert_eq!(steps_of(|t_s| 0.005 + drift_s_s * t_s), []);
        }
    }
}
