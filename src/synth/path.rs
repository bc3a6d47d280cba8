//! Straight tip paths and the joint motion for them.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use rand::RngExt;

use super::Scenario;
use super::noise::{Purpose, random};
use super::task::Task;
use crate::geometry::{
    Convention, Pose, Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation,
};
use crate::robot::Chain;

/// Motion along straight lines.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineMotion {
    /// Deviation of the tip from each line at its middle, m; not commanded.
    pub bow_m: f64,
    /// Quantity interpolated instead of a slerp.
    pub interpolated_as: Option<Convention>,
}

/// Minimum time between stops, s.
const MIN_LEG_S: f64 = 0.5;
/// Sample interval of the joints, s.
const SAMPLE_PERIOD_S: f64 = 0.004;

/// Lines with a rest at each end.
#[derive(Debug, Clone)]
pub(super) struct LinePath {
    lines: LineMotion,
    stops: Vec<PathStop>,
    /// Every [`SAMPLE_PERIOD_S`], from one step before the run.
    q: Vec<Vec<f64>>,
}

#[derive(Debug, Clone)]
struct PathStop {
    arrive_s: f64,
    leave_s: f64,
    pose: Pose,
}

impl LinePath {
    /// Random lines about `home`.
    pub(super) fn new(scenario: &Scenario, lines: LineMotion, chain: &Chain, home: &[f64]) -> Self {
        /// Largest offset of the ends from home, m per axis, and rotation, rad.
        const MAX_OFFSETS: (f64, f64) = (0.12, 0.45);
        const SPEED_M_S: f64 = 0.2;
        let mut random = random(scenario.seed, Purpose::Motion);
        let base_from_home = chain.forward(home);
        let mut stops = Vec::new();
        let mut time_s = 0.0;
        while time_s < scenario.duration_s {
            let mut triple =
                |size: f64| Vec3::from_fn(|_, _| size * random.random_range(-1.0..=1.0));
            let (shift, turn) = (triple(MAX_OFFSETS.0), triple(MAX_OFFSETS.1));
            let pose = Pose::from_parts(
                (base_from_home.translation.vector + shift).into(),
                base_from_home.rotation * rotation_from_rotvec(turn),
            );
            time_s = push_stop(&mut stops, pose, SPEED_M_S, random.random_range(0.6..0.9));
        }
        Self::from_stops(scenario, lines, stops, chain, home)
    }

    /// About `home`, slowed down to the joint limits.
    pub(super) fn from_task(scenario: &Scenario, task: Task, chain: &Chain, home: &[f64]) -> Self {
        const MAX_SLOWDOWNS: usize = 3;
        let base_from_home = chain.forward(home);
        let mut random = random(scenario.seed, Purpose::Motion);
        let count = (scenario.duration_s / MIN_LEG_S) as usize + 1;
        let mut stops = Vec::new();
        for leg in task.legs(&mut random, count) {
            let pose = leg.stop(&base_from_home);
            if push_stop(&mut stops, pose, leg.speed_m_s, leg.rest_s) > scenario.duration_s {
                break;
            }
        }
        let mut path = Self::from_stops(scenario, LineMotion::default(), stops, chain, home);
        for _ in 0..MAX_SLOWDOWNS {
            let slowdown = path.slowdown_factor(scenario, chain);
            if slowdown <= 1.0 {
                break;
            }
            let mut stops = path.stops;
            for stop in &mut stops {
                (stop.arrive_s, stop.leave_s) = (slowdown * stop.arrive_s, slowdown * stop.leave_s);
            }
            path = Self::from_stops(scenario, LineMotion::default(), stops, chain, home);
        }
        path
    }

    /// Motion in the null space of the Jacobian (Siciliano et al., *Robotics*, §3.5).
    pub(super) fn elbow_swing(scenario: &Scenario, chain: &Chain, home: &[f64]) -> Self {
        /// Largest null-space speed, rad/s, and frequency, Hz.
        const SWING_SPEED_AND_HZ: (f64, f64) = (0.35, 0.12);
        let mut stops = Vec::new();
        push_stop(&mut stops, chain.forward(home), 1.0, scenario.duration_s);
        let mut path = Self { lines: LineMotion::default(), stops, q: Vec::new() };
        let mut q = home.to_vec();
        let mut jacobian = vec![[0.0; 6]; chain.dof()];
        let mut last = DVector::zeros(chain.dof());
        for step in 0..Self::sample_count(scenario) {
            chain.forward_with_jacobian(&q, &mut jacobian);
            let j = DMatrix::from_fn(6, chain.dof(), |row, column| jacobian[column][row]);
            let eigen = (j.transpose() * j).symmetric_eigen();
            let mut null = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
            if null.dot(&last) < 0.0 {
                null.neg_mut();
            }
            let speed = SWING_SPEED_AND_HZ.0
                * (TAU * SWING_SPEED_AND_HZ.1 * Self::sample_time_s(step)).sin();
            q.iter_mut()
                .zip(null.iter())
                .for_each(|(q, null)| *q += SAMPLE_PERIOD_S * speed * null);
            solve_joints(chain, &path.stops[0].pose, &mut q);
            last = null;
            path.q.push(q.clone());
        }
        path
    }

    fn from_stops(
        scenario: &Scenario,
        lines: LineMotion,
        stops: Vec<PathStop>,
        chain: &Chain,
        home: &[f64],
    ) -> Self {
        let mut path = Self { lines, stops, q: Vec::new() };
        let mut q = home.to_vec();
        for step in 0..Self::sample_count(scenario) {
            solve_joints(chain, &path.pose_at(Self::sample_time_s(step), lines.bow_m), &mut q);
            path.q.push(q.clone());
        }
        path
    }

    /// Slow-down factor for joint speeds and moderate accelerations.
    fn slowdown_factor(&self, scenario: &Scenario, chain: &Chain) -> f64 {
        /// Share of the speed limits, and maximum acceleration, rad/s² or m/s².
        const MAX_SPEED_RATIO: f64 = 0.9;
        const MAX_ACCELERATION: f64 = 12.0;
        let mut slowdown = 0.0_f64;
        for (joint, limits) in chain.limits().iter().enumerate() {
            let limit = limits.velocity.filter(|limit| *limit > 0.0).unwrap_or(f64::INFINITY);
            let limit = MAX_SPEED_RATIO * limit.min(1.5 * scenario.speed);
            for rows in self.q.windows(3) {
                let [before, now, after] = [rows[0][joint], rows[1][joint], rows[2][joint]];
                let speed = (after - before).abs() / (2.0 * SAMPLE_PERIOD_S);
                let acceleration =
                    (after - 2.0 * now + before).abs() / (SAMPLE_PERIOD_S * SAMPLE_PERIOD_S);
                slowdown =
                    slowdown.max(speed / limit).max((acceleration / MAX_ACCELERATION).sqrt());
            }
        }
        slowdown
    }

    fn sample_count(scenario: &Scenario) -> usize {
        (scenario.duration_s / SAMPLE_PERIOD_S).ceil() as usize + 4
    }

    fn sample_time_s(step: usize) -> f64 {
        (step as f64 - 1.0) * SAMPLE_PERIOD_S
    }

    /// Arrival and departure, s.
    pub(super) fn rests(&self) -> Vec<(f64, f64)> {
        self.stops.iter().map(|stop| (stop.arrive_s, stop.leave_s)).collect()
    }

    /// `base_from_tip`.
    pub(super) fn commanded_pose(&self, time_s: f64) -> Pose {
        self.pose_at(time_s, 0.0)
    }

    fn pose_at(&self, time_s: f64, bow_m: f64) -> Pose {
        let next = self.stops.partition_point(|stop| stop.arrive_s <= time_s);
        let from = &self.stops[next.saturating_sub(1)];
        let Some(to) = self.stops.get(next).filter(|_| next > 0 && time_s > from.leave_s) else {
            return from.pose;
        };
        let u = (time_s - from.leave_s) / (to.arrive_s - from.leave_s);
        let part = u * u * u * (10.0 + u * (-15.0 + 6.0 * u));
        let [start, end] = [from, to].map(|stop| stop.pose.translation.vector);
        let chord = end - start;
        let aside = chord.cross(&Vec3::z()).try_normalize(1e-9).unwrap_or_else(Vec3::x);
        let bowed = start + chord * part + aside * (4.0 * bow_m * part * (1.0 - part));
        Pose::from_parts(bowed.into(), self.interpolate_rotation(from, to, part))
    }

    fn interpolate_rotation(&self, from: &PathStop, to: &PathStop, part: f64) -> Rotation {
        let (a, b) = (from.pose.rotation, to.pose.rotation);
        match self.lines.interpolated_as {
            None => a * rotation_from_rotvec(rotvec_from_rotation(&(a.inverse() * b)) * part),
            Some(convention) => {
                // The shorter way about each axis, as a planner that unwraps angles.
                let by = |by: f64| by - TAU * (by / TAU).round();
                let (a, b) = (convention.numbers(&a), convention.numbers(&b));
                convention.rotation(std::array::from_fn(|at| a[at] + part * by(b[at] - a[at])))
            }
        }
    }

    pub(super) fn joints_at(&self, time_s: f64) -> (Vec<f64>, Vec<f64>) {
        let steps = (time_s / SAMPLE_PERIOD_S + 1.0).clamp(1.0, self.q.len() as f64 - 2.0 - 1e-9);
        let (row, s) = (steps.floor() as usize, steps.fract());
        let (s2, s3) = (s * s, s * s * s);
        let joint = |joint: usize| {
            let q = |row: usize| self.q[row.min(self.q.len() - 1)][joint];
            let slope = |row: usize| 0.5 * (q(row + 1) - q(row - 1));
            let (qa, qb, va, vb) = (q(row), q(row + 1), slope(row), slope(row + 1));
            // Cubic Hermite: Press et al., *Numerical Recipes*, 3rd ed., §3.3.
            let position = (2.0 * s3 - 3.0 * s2 + 1.0) * qa
                + (s3 - 2.0 * s2 + s) * va
                + (3.0 * s2 - 2.0 * s3) * qb
                + (s3 - s2) * vb;
            let speed = 6.0 * (s2 - s) * (qa - qb)
                + (3.0 * s2 - 4.0 * s + 1.0) * va
                + (3.0 * s2 - 2.0 * s) * vb;
            (position, speed / SAMPLE_PERIOD_S)
        };
        (0..self.q[0].len()).map(joint).unzip()
    }
}

/// Returns its departure time, s.
fn push_stop(stops: &mut Vec<PathStop>, pose: Pose, speed_m_s: f64, rest_s: f64) -> f64 {
    /// Mean speed between stops, rad/s.
    const SPEED_RAD_S: f64 = 0.8;
    let on_the_way_s = stops.last().map_or(0.0, |last| {
        let far_m = (pose.translation.vector - last.pose.translation.vector).norm();
        let far_rad = last.pose.rotation.angle_to(&pose.rotation);
        (far_m / speed_m_s).max(far_rad / SPEED_RAD_S).max(MIN_LEG_S)
    });
    let arrive_s = stops.last().map_or(0.0, |last| last.leave_s + on_the_way_s);
    let leave_s = arrive_s + rest_s;
    stops.push(PathStop { arrive_s, leave_s, pose });
    leave_s
}

/// Damped least squares on the geometric Jacobian from a nearby `q` (Siciliano et al., *Robotics*, §3.7).
fn solve_joints(chain: &Chain, pose: &Pose, q: &mut [f64]) {
    const DAMPING: f64 = 1e-10;
    const ROUNDS: usize = 30;
    const MAX_ERROR: f64 = 1e-12;
    let mut jacobian = vec![[0.0; 6]; chain.dof()];
    for _ in 0..ROUNDS {
        let here = chain.forward_with_jacobian(q, &mut jacobian);
        let shift = pose.translation.vector - here.translation.vector;
        let turn = rotvec_from_rotation(&(pose.rotation * here.rotation.inverse()));
        let error = DVector::from_iterator(6, shift.iter().chain(turn.iter()).copied());
        if error.norm() < MAX_ERROR {
            return;
        }
        let j = DMatrix::from_fn(6, chain.dof(), |row, column| jacobian[column][row]);
        let normal = &j * j.transpose() + DMatrix::identity(6, 6) * DAMPING;
        let Some(solved) = normal.lu().solve(&error) else { return };
        let step = j.transpose() * solved;
        q.iter_mut().zip(step.iter()).for_each(|(q, step)| *q += step);
    }
}
