//! The planning task: joint ranges, clearances and measurements.

use poseaudit::diagnosis::plan::{
    ArmCapsules, ClearanceViolation, Clearances, ExpectedPrecision, JointMargins, LimitViolation,
    MotionPlan, PlanRequirements, Purpose, Sensing, TargetVisibility, limit_violations,
};
use poseaudit::finding::Unit;
use poseaudit::geometry::{Pose, Vec3};
use poseaudit::report::Trouble;
use poseaudit::robot::Shape;
use poseaudit::stream::JointTrack;

use super::super::misuse;
use super::Args;
use super::arm::Planning;

/// Prismatic motion equivalent to one radian.
const SLIDE_M_PER_RAD: f64 = 0.2;
/// Without a limit in the model.
const USUAL_SPEED: f64 = 1.0;
/// Share of the reach, for models without collision shapes; typical of arms.
const RADIUS: f64 = 0.06;
/// Sample interval of written motions.
const ROW_S: f64 = 0.02;

pub struct Asked {
    pub around: Vec<f64>,
    pub rooms: Vec<JointMargins>,
    pub seconds: f64,
    pub purpose: Purpose,
    pub sensing: Sensing,
    pub keep: Clearances,
    pub seed: u64,
    /// Joints without a speed limit in the model.
    pub unlimited: Vec<String>,
    /// Arm segments.
    parts: Vec<String>,
    /// Whether each radius comes from the model.
    pub told: Vec<bool>,
}

/// A given motion, checked.
pub struct Checked {
    pub promises: Vec<ExpectedPrecision>,
    pub beyond: Vec<LimitViolation>,
    /// First violated clearance and time, s.
    pub near: Option<(f64, ClearanceViolation)>,
}

/// The task around a configuration. Fails if that is beyond a limit or below the floor.
pub fn asked(args: &Args, planning: &Planning, around: Vec<f64>) -> Result<Asked, Trouble> {
    let names = planning.chain.joint_names();
    for ((name, limits), &q) in names.iter().zip(planning.chain.limits()).zip(&around) {
        let (low, high) = (limits.lower.unwrap_or(q), limits.upper.unwrap_or(q));
        if q < low || q > high {
            let what = format!("{name} is at {q:.4} there; its limits are {low:.4} to {high:.4}");
            return Err(misuse("--around", what, "choose a configuration within the limits"));
        }
    }
    let asked = Asked::of_given(args, planning, around);
    let under = asked.keep.close_pairs(&planning.chain, &asked.around);
    let under = under
        .iter()
        .find(|near| matches!(near, ClearanceViolation::Floor(_, height) if *height < 0.0));
    match under {
        Some(near) => Err(misuse("--floor", asked.nearness(near), "lower --floor")),
        None => Ok(asked),
    }
}

impl Asked {
    /// The configuration may be beyond a limit.
    pub fn of_given(args: &Args, planning: &Planning, around: Vec<f64>) -> Self {
        let Planning { robot, chain } = planning;
        let amplitude = args.amplitude.to_radians();
        let unit = |joint: usize| if planning.slides(joint) { SLIDE_M_PER_RAD } else { 1.0 };
        let room = |(joint, q): (usize, &f64)| {
            let (limits, unit) = (chain.limits()[joint], unit(joint));
            let most = amplitude * unit;
            let room = |to: Option<f64>| to.map_or(most, |to| to.clamp(0.0, most));
            let stated = limits.velocity.unwrap_or(USUAL_SPEED * unit);
            JointMargins {
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
        let view = (purpose == Purpose::HandEye).then(|| TargetVisibility {
            hand_from_camera: camera,
            target: Vec3::from(target.coords),
            half_rad: args.view.to_radians(),
        });
        let keep = Clearances::from_configuration(
            chain,
            &around,
            ArmCapsules { radius_m },
            args.clear,
            args.floor,
            view,
        );
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

    pub fn task<'a>(&'a self, chain: &'a poseaudit::robot::Chain) -> PlanRequirements<'a> {
        PlanRequirements {
            chain,
            around: &self.around,
            margins: &self.rooms,
            seconds: self.seconds,
            purpose: self.purpose,
            sensing: self.sensing,
            clearances: &self.keep,
            seed: self.seed,
        }
    }

    pub fn motion(&self, planned: &MotionPlan) -> JointTrack {
        planned.series.track((self.seconds / ROW_S).ceil() as usize + 1)
    }

    pub fn nearness(&self, near: &ClearanceViolation) -> String {
        match *near {
            ClearanceViolation::Parts(i, j, apart) => format!(
                "{} and {} come within {} of each other",
                self.parts[i],
                self.parts[j],
                Unit::Metre.show(apart.max(0.0))
            ),
            ClearanceViolation::Floor(at, height) if height < 0.0 => {
                format!("{} is {} below the floor", self.parts[at], Unit::Metre.show(-height))
            }
            ClearanceViolation::Floor(at, height) => {
                format!("{} comes within {} of the floor", self.parts[at], Unit::Metre.show(height))
            }
            ClearanceViolation::View(angle) => {
                format!("the target is {} off the camera axis", Unit::Radian.show(angle))
            }
        }
    }
}

impl Checked {
    pub fn of(
        planning: &Planning,
        asked: &Asked,
        motion: &JointTrack,
        promises: Vec<ExpectedPrecision>,
    ) -> Self {
        let speed: Vec<f64> = asked.rooms.iter().map(|room| room.velocity).collect();
        let acceleration: Vec<f64> = asked.rooms.iter().map(|room| room.acceleration).collect();
        let beyond = limit_violations(&planning.chain, motion, &speed, &acceleration);
        let near = (0..motion.len()).find_map(|row| {
            let near = asked.keep.first_violation(&planning.chain, motion.row(row))?;
            Some((motion.t_s[row], near))
        });
        Self { promises, beyond, near }
    }

    /// Whether all limits and clearances hold.
    pub fn is_within(&self) -> bool {
        self.beyond.is_empty() && self.near.is_none()
    }
}

/// Radius of each segment, m, and whether it comes from the model's primitive collision shapes, as far as
/// they extend from the segment. Otherwise a fraction of the reach.
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
