//! What is really the case while the log is recorded.

use super::motion::Trajectory;
use super::{Scenario, SynthError};
use crate::geometry::{Pose, Vec3};
use crate::robot::Chain;

/// Gravity, m/s².
pub(super) const GRAVITY: f64 = 9.80665;

/// The true motion of a scenario's arm; times are seconds after the start.
pub(super) struct Truth {
    pub(super) chain: Chain,
    trajectory: Trajectory,
}

impl Truth {
    pub(super) fn new(scenario: &Scenario) -> Result<Self, SynthError> {
        let robot = &scenario.robot;
        let base = robot.link_or_nearest(&scenario.base)?;
        let tip = robot.link_or_nearest(&scenario.tip)?;
        let chain = robot.chain(base, tip)?;
        let trajectory = Trajectory::new(scenario, &chain);
        Ok(Self { chain, trajectory })
    }

    /// Positions and velocities of the joints.
    pub(super) fn joints(&self, time_s: f64) -> (Vec<f64>, Vec<f64>) {
        self.trajectory.at(time_s)
    }

    pub(super) fn base_from_tip(&self, time_s: f64) -> Pose {
        self.chain.forward(&self.joints(time_s).0)
    }

    /// The angular velocity of the tip in the base, rad/s.
    pub(super) fn angular_velocity(&self, time_s: f64) -> Vec3 {
        let (q, q_dot) = self.joints(time_s);
        let mut jacobian = vec![[0.0; 6]; self.chain.dof()];
        self.chain.forward_with_jacobian(&q, &mut jacobian);
        jacobian
            .iter()
            .zip(q_dot)
            .map(|(column, speed)| Vec3::new(column[3], column[4], column[5]) * speed)
            .sum()
    }

    /// The acceleration in the base of the origin of a frame fixed to the tip, m/s².
    pub(super) fn acceleration(&self, time_s: f64, tip_from_frame: &Pose) -> Vec3 {
        // Good to some 1e-5 m/s², from the step's square and the rounding of positions.
        const STEP_S: f64 = 1e-3;
        let [before, now, after] = [-STEP_S, 0.0, STEP_S].map(|step_s| {
            (self.base_from_tip(time_s + step_s) * tip_from_frame).translation.vector
        });
        (before - 2.0 * now + after) / (STEP_S * STEP_S)
    }
}
