//! What is asked of a motion: its room, what it keeps off, and by what it is seen.

use poseaudit::diagnosis::plan::{
    Beyond, Body, Keep, Nearness, Planned, Promise, Purpose, Room, Sensing, Task, View, beyond,
};
use poseaudit::finding::Unit;
use poseaudit::geometry::{Pose, Vec3};
use poseaudit::report::Trouble;
use poseaudit::robot::Shape;
use poseaudit::stream::JointTrack;

use super::super::misuse;
use super::Args;
use super::arm::Planning;

/// What a sliding joint does in m, or m/s, where a turning one does it in rad.
const SLIDE_M_PER_RAD: f64 = 0.2;
/// The speed of a joint whose limit the model does not state, rad/s.
const USUAL_SPEED: f64 = 1.0;
/// The radius of a part of which the model says none, as a share of the reach: that of most arms.
const RADIUS: f64 = 0.06;
/// Time between two rows that are written, s.
const ROW_S: f64 = 0.02;

/// What is asked.
pub struct Asked {
    pub around: Vec<f64>,
    pub rooms: Vec<Room>,
    pub seconds: f64,
    pub purpose: Purpose,
    pub sensing: Sensing,
    pub keep: Keep,
    pub seed: u64,
    /// The joints whose speed the model does not limit, by name.
    pub unlimited: Vec<String>,
    /// The names of the straights of the arm.
    parts: Vec<String>,
    /// The straights whose radius is the model's.
    pub told: Vec<bool>,
}

/// A motion that was given, held against what is asked.
pub struct Checked {
    pub promises: Vec<Promise>,
    pub beyond: Vec<Beyond>,
    /// What it comes too near, and when, s.
    pub near: Option<(f64, Nearness)>,
}

/// What is asked of a motion around a posture.
///
/// # Errors
/// Where the posture is beyond a limit, or below the floor.
pub fn asked(args: &Args, planning: &Planning, around: Vec<f64>) -> Result<Asked, Trouble> {
    let names = planning.chain.joint_names();
    for ((name, limits), &q) in names.iter().zip(planning.chain.limits()).zip(&around) {
        let (low, high) = (limits.lower.unwrap_or(q), limits.upper.unwrap_or(q));
        if q < low || q > high {
            let what =
                format!("{name} is at {q:.4} there, and its limits are {low:.4} to {high:.4}");
            return Err(misuse("--around", what, "name a posture within the limits"));
        }
    }
    let asked = Asked::of_given(args, planning, around);
    let under = asked.keep.near(&planning.chain, &asked.around);
    let under =
        under.iter().find(|near| matches!(near, Nearness::Floor(_, height) if *height < 0.0));
    match under {
        Some(near) => Err(misuse("--floor", asked.nearness(near), "name a lower --floor")),
        None => Ok(asked),
    }
}

impl Asked {
    /// What is asked around a posture that may be beyond a limit.
    pub fn of_given(args: &Args, planning: &Planning, around: Vec<f64>) -> Self {
        let Planning { robot, chain } = planning;
        let amplitude = args.amplitude.to_radians();
        let unit = |joint: usize| if planning.slides(joint) { SLIDE_M_PER_RAD } else { 1.0 };
        let room = |(joint, q): (usize, &f64)| {
            let (limits, unit) = (chain.limits()[joint], unit(joint));
            let most = amplitude * unit;
            let room = |to: Option<f64>| to.map_or(most, |to| to.clamp(0.0, most));
            let stated = limits.velocity.unwrap_or(USUAL_SPEED * unit);
            Room {
                below: room(limits.lower.map(|lower| q - lower)),
                above: room(limits.upper.map(|upper| upper - q)),
                velocity: args.speed.map_or(stated, |speed| stated.min(speed * unit)),
                acceleration: args.acceleration * unit,
            }
        };
        let rooms = around.iter().enumerate().map(room).collect();
        let named = chain.joint_names().iter().zip(chain.limits());
        let unlimited = named.filter(|(_, limits)| limits.velocity.is_none());
        let unlimited = unlimited.map(|(name, _)| name.clone()).collect();
        let (radius_m, told) = radii(planning, &around);
        let camera = Pose::identity();
        let target = chain.forward(&around) * nalgebra::Point3::new(0.0, 0.0, args.target);
        let purpose = args.purpose.into();
        let view = (purpose == Purpose::HandEye).then(|| View {
            hand_from_camera: camera,
            target: Vec3::from(target.coords),
            half_rad: args.view.to_radians(),
        });
        let keep = Keep::around(chain, &around, Body { radius_m }, args.clear, args.floor, view);
        let joints = chain.joint_names().iter();
        let link = |name: &String| {
            robot.joint(name).map_or(name.clone(), |joint| robot.link_name(joint.child).to_owned())
        };
        let parts = std::iter::once(chain.base_name().to_owned()).chain(joints.map(link)).collect();
        Self {
            around,
            rooms,
            seconds: args.seconds,
            purpose,
            sensing: Sensing {
                noise_m: args.noise_mm * 1e-3,
                noise_rad: args.noise_deg.to_radians(),
                rate_hz: args.rate,
                outside: args.outside,
                link_m: args.links_mm * 1e-3,
                hand_from_camera: camera,
                target_m: args.target,
            },
            keep,
            seed: args.seed,
            unlimited,
            parts,
            told,
        }
    }

    pub fn task<'a>(&'a self, chain: &'a poseaudit::robot::Chain) -> Task<'a> {
        Task {
            chain,
            around: &self.around,
            rooms: &self.rooms,
            seconds: self.seconds,
            purpose: self.purpose,
            sensing: self.sensing,
            keep: &self.keep,
            seed: self.seed,
        }
    }

    /// The rows that are written of a motion that was found.
    pub fn motion(&self, planned: &Planned) -> JointTrack {
        planned.series.track((self.seconds / ROW_S).ceil() as usize + 1)
    }

    /// In words.
    pub fn nearness(&self, near: &Nearness) -> String {
        match *near {
            Nearness::Parts(i, j, apart) => format!(
                "{} and {} come within {} of each other",
                self.parts[i],
                self.parts[j],
                Unit::Metre.show(apart.max(0.0))
            ),
            Nearness::Floor(at, height) if height < 0.0 => {
                format!("{} is {} below the floor", self.parts[at], Unit::Metre.show(-height))
            }
            Nearness::Floor(at, height) => {
                format!("{} comes within {} of the floor", self.parts[at], Unit::Metre.show(height))
            }
            Nearness::View(angle) => {
                format!("the target is {} off the camera's axis", Unit::Radian.show(angle))
            }
        }
    }
}

impl Checked {
    pub fn of(
        planning: &Planning,
        asked: &Asked,
        motion: &JointTrack,
        promises: Vec<Promise>,
    ) -> Self {
        let speed: Vec<f64> = asked.rooms.iter().map(|room| room.velocity).collect();
        let acceleration: Vec<f64> = asked.rooms.iter().map(|room| room.acceleration).collect();
        let beyond = beyond(&planning.chain, motion, &speed, &acceleration);
        let near = (0..motion.len()).find_map(|row| {
            let near = asked.keep.offence(&planning.chain, motion.row(row))?;
            Some((motion.t_s[row], near))
        });
        Self { promises, beyond, near }
    }

    /// Whether it stays within all limits and off all that it should.
    pub fn is_within(&self) -> bool {
        self.beyond.is_empty() && self.near.is_none()
    }
}

/// The radius of each straight of the arm, m, and whether it is the model's: that of the simple shapes that
/// stand for a link in collisions, as far as they stand out of the straight; else a share of the reach.
fn radii(planning: &Planning, around: &[f64]) -> (Vec<f64>, Vec<bool>) {
    let Planning { robot, chain } = planning;
    let usual = RADIUS * chain.max_reach_m();
    let mut frames = Vec::new();
    chain.joint_frames(around, &mut frames);
    let tip = chain.forward(around);
    let shapes = robot.collisions();
    let ends = |at: usize| {
        let to = frames.get(at + 1).unwrap_or(&tip).translation.vector;
        (frames[at].translation.vector, to)
    };
    let own = |at: usize| -> Option<f64> {
        let link = robot.joint(&chain.joint_names()[at])?.child;
        let (from, to) = ends(at);
        let along = (to - from).norm_squared();
        let stands_out = shapes.iter().filter(|shape| shape.link == link).filter_map(|shape| {
            let radius = match shape.shape {
                Shape::Mesh { .. } => return None,
                Shape::Box(mut edges) => {
                    edges.sort_by(f64::total_cmp);
                    0.5 * edges[0].hypot(edges[1])
                }
                Shape::Cylinder { radius_m, .. } | Shape::Sphere(radius_m) => radius_m,
            };
            let centre = (frames[at] * shape.link_from_visual).translation.vector;
            let part = if along > 0.0 { (centre - from).dot(&(to - from)) / along } else { 0.0 };
            let nearest = from + (to - from) * part.clamp(0.0, 1.0);
            Some(radius + (centre - nearest).norm())
        });
        stands_out.reduce(f64::max)
    };
    let own: Vec<Option<f64>> = std::iter::once(None).chain((0..chain.dof()).map(own)).collect();
    (
        own.iter().map(|own| own.unwrap_or(usual)).collect(),
        own.iter().map(Option::is_some).collect(),
    )
}
