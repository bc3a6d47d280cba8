//! Joint trajectories: smooth, within limits, at realistic speeds.

use std::f64::consts::{PI, TAU};

use rand::RngExt;
use rand_pcg::Pcg64;

use super::Scenario;
use super::noise::{Purpose, random};
use super::path::{LineMotion, LinePath};
use super::task::Task;
use crate::geometry::Pose;
use crate::robot::{Chain, JointKind, Limits};

/// Motion of the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Between random configurations, with rests of 0.15 to 0.5 s.
    PickAndPlace,
    /// All joints, at different frequencies.
    Continuous,
    /// Periodic [`Motion::Continuous`].
    Periodic {
        /// Period, s.
        period_s: f64,
    },
    /// [`Motion::PickAndPlace`] of one joint, counted from the base.
    OneJoint(usize),
    /// Straight tip lines, with rests of 0.6 to 0.9 s.
    Lines(LineMotion),
    /// A task of the tip.
    Task(Task),
    /// Elbow swing of a seven-joint arm with the tip at rest.
    ElbowSwing,
    /// Cycles through three random configurations.
    Tending,
    /// Joints one after the other, forth and back.
    OneByOne,
    /// No motion.
    AtRest,
}

/// Share of a joint's range and speed limit.
const MAX_RANGE_RATIO: f64 = 0.9;
/// Prismatic travel equivalent to a radian, m.
const METRES_PER_RADIAN: f64 = 0.25;

/// Trajectory with two continuous derivatives.
#[derive(Debug, Clone)]
pub(super) enum Trajectory {
    /// At rest before the first and after the last.
    Knots(Vec<Knot>),
    /// Per joint, about home.
    Sines {
        home: Vec<f64>,
        sines: Vec<[Sine; 2]>,
    },
    Path(LinePath),
}

/// At a rest, possibly of zero duration.
#[derive(Debug, Clone)]
pub(super) struct Knot {
    time_s: f64,
    q: Vec<f64>,
}

/// `amplitude · sin(rate · t + phase)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sine {
    amplitude: f64,
    rate_rad_s: f64,
    phase_rad: f64,
}

/// In rad and rad/s or m and m/s.
#[derive(Debug, Clone, Copy)]
struct JointRoom {
    home: f64,
    amplitude: f64,
    speed: f64,
}

impl Trajectory {
    pub(super) fn new(scenario: &Scenario, chain: &Chain) -> Self {
        let rooms: Vec<JointRoom> =
            (0..chain.dof()).map(|joint| JointRoom::new(scenario, chain, joint)).collect();
        match scenario.motion {
            Motion::PickAndPlace => Self::knots(scenario, &rooms, random_configuration),
            Motion::Tending => {
                const POSTURES: usize = 3;
                let mut postures: Vec<Vec<f64>> = Vec::new();
                Self::knots(scenario, &rooms, |random, rooms, count| {
                    if count < POSTURES {
                        postures.push(random_configuration(random, rooms, count));
                    }
                    postures[count % POSTURES].clone()
                })
            }
            Motion::OneByOne => Self::knots(scenario, &rooms, |random, rooms, count| {
                let mut q: Vec<f64> = rooms.iter().map(|room| room.home).collect();
                let joint = count / 2 % rooms.len();
                if count % 2 == 1 {
                    let side = if random.random_bool(0.5) { 1.0 } else { -1.0 };
                    q[joint] += side * rooms[joint].amplitude * random.random_range(0.3..1.0);
                }
                q
            }),
            Motion::OneJoint(moving) => {
                assert!(moving < rooms.len(), "joint {moving} of {} joints moves", rooms.len());
                let mut held = rooms;
                for (joint, room) in held.iter_mut().enumerate() {
                    if joint != moving {
                        room.amplitude = 0.0;
                    }
                }
                Self::knots(scenario, &held, random_configuration)
            }
            Motion::Continuous => Self::sines(scenario, &rooms, |random| {
                [random.random_range(0.08..0.15), random.random_range(0.2..0.3)]
            }),
            Motion::Periodic { period_s } => {
                Self::sines(scenario, &rooms, |_| [1.0 / period_s, 2.0 / period_s])
            }
            Motion::Lines(lines) => {
                let home: Vec<f64> = rooms.iter().map(|room| room.home).collect();
                Self::Path(LinePath::new(scenario, lines, chain, &home))
            }
            Motion::Task(task) => {
                let home: Vec<f64> = rooms.iter().map(|room| room.home).collect();
                Self::Path(LinePath::from_task(scenario, task, chain, &home))
            }
            Motion::ElbowSwing => {
                let home: Vec<f64> = rooms.iter().map(|room| room.home).collect();
                Self::Path(LinePath::elbow_swing(scenario, chain, &home))
            }
            Motion::AtRest => {
                let q = rooms.iter().map(|room| room.home).collect();
                Self::Knots(vec![Knot { time_s: 0.0, q }])
            }
        }
    }

    /// `next` receives the number of previous configurations.
    fn knots(
        scenario: &Scenario,
        rooms: &[JointRoom],
        mut next: impl FnMut(&mut Pcg64, &[JointRoom], usize) -> Vec<f64>,
    ) -> Self {
        /// Ratio of peak to mean speed in a blend.
        const PEAK_SPEED_RATIO: f64 = 1.875;
        /// Peak acceleration of a blend over distance per time squared, and the maximum for normal motion,
        /// rad/s².
        const PEAK_ACCELERATION_RATIO: f64 = 5.774;
        const MAX_ACCELERATION: f64 = 18.0;
        let mut random = random(scenario.seed, Purpose::Motion);
        let mut knots: Vec<Knot> = Vec::new();
        let mut time_s = 0.0;
        while time_s < scenario.duration_s {
            let q = next(&mut random, rooms, knots.len() / 2);
            if let Some(last) = knots.last() {
                let needed_s = |((to, from), room): ((&f64, &f64), &JointRoom)| {
                    let way = (to - from).abs();
                    (PEAK_SPEED_RATIO * way / room.speed)
                        .max((PEAK_ACCELERATION_RATIO * way / MAX_ACCELERATION).sqrt())
                };
                time_s += q.iter().zip(&last.q).zip(rooms).map(needed_s).fold(0.2, f64::max);
            }
            knots.push(Knot { time_s, q: q.clone() });
            time_s += random.random_range(0.15..0.5);
            if knots.len() % 8 == 7 {
                time_s += scenario.pause_s;
            }
            knots.push(Knot { time_s, q });
        }
        Self::Knots(knots)
    }

    /// Two frequencies per joint from `rates_hz`.
    fn sines(
        scenario: &Scenario,
        rooms: &[JointRoom],
        rates_hz: impl Fn(&mut Pcg64) -> [f64; 2],
    ) -> Self {
        let mut random = random(scenario.seed, Purpose::Motion);
        let sines = rooms
            .iter()
            .map(|room| {
                let rates_rad_s = rates_hz(&mut random).map(|rate| TAU * rate);
                let share = room.amplitude / 2.0;
                let peak_speed = share * (rates_rad_s[0] + rates_rad_s[1]);
                let amplitude = share * (room.speed / peak_speed).min(1.0);
                rates_rad_s.map(|rate_rad_s| Sine {
                    amplitude,
                    rate_rad_s,
                    phase_rad: random.random_range(0.0..TAU),
                })
            })
            .collect();
        Self::Sines { home: rooms.iter().map(|room| room.home).collect(), sines }
    }

    /// Positions and velocities, `time_s` after the start.
    pub(super) fn joints_at(&self, time_s: f64) -> (Vec<f64>, Vec<f64>) {
        match self {
            Self::Knots(knots) => {
                let next = knots.partition_point(|knot| knot.time_s <= time_s);
                match (next.checked_sub(1).map(|last| &knots[last]), knots.get(next)) {
                    (Some(from), Some(to)) => interpolate_knots(from, to, time_s),
                    (Some(knot), None) | (None, Some(knot)) => knot_at_rest(knot),
                    (None, None) => unreachable!("a trajectory has at least one knot"),
                }
            }
            Self::Sines { home, sines } => home
                .iter()
                .zip(sines)
                .map(|(home, sines)| {
                    let angle = |sine: &Sine| sine.rate_rad_s * time_s + sine.phase_rad;
                    let position: f64 = sines.iter().map(|s| s.amplitude * angle(s).sin()).sum();
                    let velocity: f64 =
                        sines.iter().map(|s| s.amplitude * s.rate_rad_s * angle(s).cos()).sum();
                    (home + position, velocity)
                })
                .unzip(),
            Self::Path(path) => path.joints_at(time_s),
        }
    }

    /// `base_from_tip`, if it differs from the motion.
    pub(super) fn commanded_pose(&self, time_s: f64) -> Option<Pose> {
        match self {
            Self::Path(path) => Some(path.commanded_pose(time_s)),
            Self::Knots(_) | Self::Sines { .. } => None,
        }
    }

    /// Arrival and departure, s.
    pub(super) fn rests(&self) -> Vec<(f64, f64)> {
        match self {
            Self::Knots(knots) => {
                let pairs = knots.chunks_exact(2);
                pairs.map(|pair| (pair[0].time_s, pair[1].time_s)).collect()
            }
            Self::Sines { .. } => Vec::new(),
            Self::Path(path) => path.rests(),
        }
    }
}

fn random_configuration(random: &mut Pcg64, rooms: &[JointRoom], _count: usize) -> Vec<f64> {
    let joint = |room: &JointRoom| room.home + room.amplitude * random.random_range(-1.0..=1.0);
    rooms.iter().map(joint).collect()
}

fn knot_at_rest(knot: &Knot) -> (Vec<f64>, Vec<f64>) {
    (knot.q.clone(), vec![0.0; knot.q.len()])
}

/// Quintic: zero velocity and acceleration at both ends.
fn interpolate_knots(from: &Knot, to: &Knot, time_s: f64) -> (Vec<f64>, Vec<f64>) {
    let length_s = to.time_s - from.time_s;
    let u = (time_s - from.time_s) / length_s;
    let blend = u * u * u * (10.0 + u * (-15.0 + 6.0 * u));
    let speed = 30.0 * u * u * (1.0 - u) * (1.0 - u) / length_s;
    let pairs = from.q.iter().zip(&to.q);
    pairs.map(|(from, to)| (from + blend * (to - from), speed * (to - from))).unzip()
}

impl JointRoom {
    fn new(scenario: &Scenario, chain: &Chain, joint: usize) -> Self {
        let Limits { lower, upper, velocity } = chain.limits()[joint];
        let (unit, range) = match chain.joint_kinds()[joint] {
            JointKind::Prismatic => (METRES_PER_RADIAN, METRES_PER_RADIAN),
            _ => (1.0, PI),
        };
        let (lower, upper) = (lower.unwrap_or(-range), upper.unwrap_or(range));
        let middle = (lower + upper) / 2.0;
        let comfortable = MAX_RANGE_RATIO * (upper - lower).max(0.0) / 2.0;
        let amplitude = (scenario.amplitude * unit).min(comfortable);
        let most = comfortable - amplitude;
        let home = scenario.home.get(joint).copied().unwrap_or(middle);
        let limit = velocity.filter(|limit| *limit > 0.0).unwrap_or(f64::INFINITY);
        Self {
            home: home.clamp(middle - most, middle + most),
            amplitude,
            speed: (scenario.speed * unit).min(MAX_RANGE_RATIO * limit),
        }
    }
}
