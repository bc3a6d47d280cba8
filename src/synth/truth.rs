//! True motion during the recording.

use std::f64::consts::TAU;

use super::compliance::ComplianceMotion;
use super::motion::Trajectory;
use super::{FinalStop, JointOscillation, Scenario, SynthError};
use crate::geometry::{Pose, Vec3};
use crate::robot::Chain;

/// In m/s².
pub(super) const GRAVITY_M_S2: f64 = 9.80665;

/// Times are seconds after the start.
pub(super) struct Truth {
    /// Root to tip.
    pub(super) chain: Chain,
    /// Root to base, if there are joints between them.
    root_to_base: Option<Chain>,
    /// First link to tip.
    first_to_tip: Chain,
    trajectory: Trajectory,
    brake: Option<Brake>,
    oscillation: Option<JointOscillation>,
    compliance: ComplianceMotion,
}

struct Brake {
    from_s: f64,
    length_s: f64,
}

impl Brake {
    /// At the highest speed within 3 s after the given time.
    fn new(stop: &FinalStop, trajectory: &Trajectory) -> Self {
        const SEARCH_STEPS: u32 = 3000;
        let speed = |time_s: f64| {
            trajectory.joints_at(time_s).1.iter().fold(0.0_f64, |most, speed| most.max(speed.abs()))
        };
        let times = (0..SEARCH_STEPS).map(|step| stop.after_s + f64::from(step) * 1e-3);
        let fastest =
            times.map(|time_s| (time_s, speed(time_s))).max_by(|a, b| a.1.total_cmp(&b.1));
        let (from_s, speed) = fastest.unwrap_or_default();
        Self { from_s, length_s: speed / stop.deceleration }
    }

    /// Path parameter (time along the original motion, s) and its rate.
    fn path_time(&self, time_s: f64) -> (f64, f64) {
        let since_s = time_s - self.from_s;
        if since_s <= 0.0 {
            (time_s, 1.0)
        } else if since_s < self.length_s {
            let slower = since_s / self.length_s;
            (self.from_s + since_s * (1.0 - 0.5 * slower), 1.0 - slower)
        } else {
            (self.from_s + 0.5 * self.length_s, 0.0)
        }
    }
}

impl Truth {
    pub(super) fn new(scenario: &Scenario) -> Result<Self, SynthError> {
        let robot = scenario.actual_robot.as_ref().unwrap_or(&scenario.robot);
        let base = robot.link_or_nearest(&scenario.base)?;
        let tip = robot.link_or_nearest(&scenario.tip)?;
        let root = scenario.root.as_deref().map(|root| robot.link_or_nearest(root)).transpose()?;
        let chain = robot.chain(root.unwrap_or(base), tip)?;
        let above = root.map(|root| robot.chain(root, base)).transpose()?;
        let whole = robot.chain(robot.root(), tip)?;
        let trajectory = Trajectory::new(scenario, &chain);
        let brake = scenario.final_stop.as_ref().map(|stop| Brake::new(stop, &trajectory));
        let shake = scenario.oscillation;
        let deflections =
            ComplianceMotion::new(&scenario.compliance, &trajectory, &chain, scenario.duration_s);
        Ok(Self {
            chain,
            root_to_base: above,
            first_to_tip: whole,
            trajectory,
            brake,
            oscillation: shake,
            compliance: deflections,
        })
    }

    /// Joint positions and velocities, with compliance.
    pub(super) fn joints(&self, time_s: f64) -> (Vec<f64>, Vec<f64>) {
        let (mut positions, mut velocities) = self.encoder_joints(time_s);
        self.compliance.add(time_s, &mut positions, &mut velocities);
        (positions, velocities)
    }

    pub(super) fn encoder_joints(&self, time_s: f64) -> (Vec<f64>, Vec<f64>) {
        let unbraked = || (time_s, 1.0);
        let (along_s, rate) =
            self.brake.as_ref().map_or_else(unbraked, |brake| brake.path_time(time_s));
        let (mut positions, mut velocities) = self.trajectory.joints_at(along_s);
        velocities.iter_mut().for_each(|velocity| *velocity *= rate);
        if let Some(JointOscillation { joint, amplitude, frequency_hz }) = self.oscillation {
            let rate_rad_s = TAU * frequency_hz;
            positions[joint] += amplitude * (rate_rad_s * time_s).sin();
            velocities[joint] += amplitude * rate_rad_s * (rate_rad_s * time_s).cos();
        }
        (positions, velocities)
    }

    /// `base_from_tip`, for motion along lines.
    pub(super) fn commanded_pose(&self, time_s: f64) -> Option<Pose> {
        self.trajectory.commanded_pose(time_s)
    }

    /// Arrival and departure, s.
    pub(super) fn rests(&self) -> Vec<(f64, f64)> {
        self.trajectory.rests()
    }

    pub(super) fn base_from_tip(&self, time_s: f64) -> Pose {
        let q = self.joints(time_s).0;
        let root_from_tip = self.chain.forward(&q);
        match &self.root_to_base {
            Some(above) => above.forward(&q[..above.dof()]).inverse() * root_from_tip,
            None => root_from_tip,
        }
    }

    /// Tip pose in the first link, which moves with the base.
    pub(super) fn first_from_tip(&self, time_s: f64) -> Pose {
        self.first_to_tip.forward(&self.joints(time_s).0)
    }

    /// Angular velocity of the tip in the base, rad/s.
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

    /// In the base, of the origin of a frame fixed to the tip, m/s².
    pub(super) fn acceleration(&self, time_s: f64, tip_from_frame: &Pose) -> Vec3 {
        // Accurate to about 1e-5 m/s².
        const STEP_S: f64 = 1e-3;
        let [before, now, after] = [-STEP_S, 0.0, STEP_S].map(|step_s| {
            (self.base_from_tip(time_s + step_s) * tip_from_frame).translation.vector
        });
        (before - 2.0 * now + after) / (STEP_S * STEP_S)
    }
}
