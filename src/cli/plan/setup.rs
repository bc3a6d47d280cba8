//! The planning task: joint ranges, clearances and measurements.

use poseaudit::diagnosis::plan::{
    ClearanceViolation, Clearances, ExpectedPrecision, JointMargins, LimitViolation, MotionPlan,
    PlanRequirements, Purpose, Sensing, TargetVisibility, limit_violations,
};
use poseaudit::finding::Unit;
use poseaudit::geometry::{Pose, Vec3};
use poseaudit::report::Trouble;
use poseaudit::robot::Shape;
use poseaudit::stream::JointTrack;

use super::super::misuse;
use super::Args;
use super::arm::PlannedArm;

/// Prismatic motion equivalent to one radian.
const SLIDE_M_PER_RAD: f64 = 0.2;
/// Speed without a limit in the model.
const DEFAULT_SPEED_RAD_S: f64 = 1.0;
/// Share of the reach, for models without collision shapes; typical of arms.
const DEFAULT_RADIUS_RATIO: f64 = 0.06;
/// Sample interval of written motions.
const ROW_PERIOD_S: f64 = 0.02;

pub struct PlanTask {
    pub around: Vec<f64>,
    pub margins: Vec<JointMargins>,
    pub seconds: f64,
    pub purpose: Purpose,
    pub sensing: Sensing,
    pub clearances: Clearances,
    pub seed: u64,
    /// Joints without a speed limit in the model.
    pub unlimited: Vec<String>,
    /// Arm segments.
    segment_names: Vec<String>,
    /// Whether each radius comes from the model.
    pub has_model_radius: Vec<bool>,
}

/// A given motion, checked.
pub struct MotionCheck {
    pub precision: Vec<ExpectedPrecision>,
    pub limit_violations: Vec<LimitViolation>,
    /// First violated clearance and time, s.
    pub clearance_violation: Option<(f64, ClearanceViolation)>,
}

/// The task around a configuration. Fails if that is beyond a limit or below the floor.
pub fn build_valid_task(
    args: &Args,
    arm: &PlannedArm,
    around: Vec<f64>,
) -> Result<PlanTask, Trouble> {
    let names = arm.chain.joint_names();
    for ((name, limits), &q) in names.iter().zip(arm.chain.limits()).zip(&around) {
        let (low, high) = (limits.lower.unwrap_or(q), limits.upper.unwrap_or(q));
        if q < low || q > high {
            let what = format!("{name} is at {q:.4} there; its limits are {low:.4} to {high:.4}");
            return Err(misuse("--around", what, "choose a configuration within the limits"));
        }
    }
    let task = PlanTask::from_configuration(args, arm, around);
    let below_floor = task.clearances.close_pairs(&arm.chain, &task.around);
    let below_floor = below_floor.iter().find(
        |violation| matches!(violation, ClearanceViolation::Floor(_, height) if *height < 0.0),
    );
    match below_floor {
        Some(violation) => Err(misuse("--floor", task.violation_text(violation), "lower --floor")),
        None => Ok(task),
    }
}

impl PlanTask {
    /// The configuration may be beyond a limit.
    pub fn from_configuration(args: &Args, arm: &PlannedArm, around: Vec<f64>) -> Self {
        let PlannedArm { robot, chain } = arm;
        let amplitude = args.amplitude.to_radians();
        let unit = |joint: usize| if arm.is_prismatic(joint) { SLIDE_M_PER_RAD } else { 1.0 };
        let margin = |(joint, q): (usize, &f64)| {
            let (limits, unit) = (chain.limits()[joint], unit(joint));
            let most = amplitude * unit;
            let margin = |to: Option<f64>| to.map_or(most, |to| to.clamp(0.0, most));
            let model_limit = limits.velocity.unwrap_or(DEFAULT_SPEED_RAD_S * unit);
            JointMargins {
                below: margin(limits.lower.map(|lower| q - lower)),
                above: margin(limits.upper.map(|upper| upper - q)),
                velocity: args.speed.map_or(model_limit, |speed| model_limit.min(speed * unit)),
                acceleration: args.acceleration * unit,
            }
        };
        let margins = around.iter().enumerate().map(margin).collect();
        let named = chain.joint_names().iter().zip(chain.limits());
        let unlimited = named.filter(|(_, limits)| limits.velocity.is_none());
        let unlimited = unlimited.map(|(name, _)| name.clone()).collect();
        let (radius_m, is_from_model) = segment_radii(arm, &around);
        let camera = Pose::identity();
        let target = chain.forward(&around) * nalgebra::Point3::new(0.0, 0.0, args.target);
        let purpose = args.purpose.into();
        let view = (purpose == Purpose::HandEye).then(|| TargetVisibility {
            hand_from_camera: camera,
            target: Vec3::from(target.coords),
            half_rad: args.view.to_radians(),
        });
        let clearances =
            Clearances::from_configuration(chain, &around, radius_m, args.clear, args.floor, view);
        let joints = chain.joint_names().iter();
        let link = |name: &String| {
            robot.joint(name).map_or(name.clone(), |joint| robot.link_name(joint.child).to_owned())
        };
        let segment_names =
            std::iter::once(chain.base_name().to_owned()).chain(joints.map(link)).collect();
        Self {
            around,
            margins,
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
            clearances,
            seed: args.seed,
            unlimited,
            segment_names,
            has_model_radius: is_from_model,
        }
    }

    pub fn requirements<'a>(&'a self, chain: &'a poseaudit::robot::Chain) -> PlanRequirements<'a> {
        PlanRequirements {
            chain,
            around: &self.around,
            margins: &self.margins,
            seconds: self.seconds,
            purpose: self.purpose,
            sensing: self.sensing,
            clearances: &self.clearances,
            seed: self.seed,
        }
    }

    pub fn motion(&self, planned: &MotionPlan) -> JointTrack {
        planned.series.track((self.seconds / ROW_PERIOD_S).ceil() as usize + 1)
    }

    pub fn violation_text(&self, violation: &ClearanceViolation) -> String {
        match *violation {
            ClearanceViolation::Parts(i, j, distance) => format!(
                "{} and {} come within {} of each other",
                self.segment_names[i],
                self.segment_names[j],
                Unit::Metre.show(distance.max(0.0))
            ),
            ClearanceViolation::Floor(at, height) if height < 0.0 => {
                format!(
                    "{} is {} below the floor",
                    self.segment_names[at],
                    Unit::Metre.show(-height)
                )
            }
            ClearanceViolation::Floor(at, height) => {
                format!(
                    "{} comes within {} of the floor",
                    self.segment_names[at],
                    Unit::Metre.show(height)
                )
            }
            ClearanceViolation::View(angle) => {
                format!("the target is {} off the camera axis", Unit::Radian.show(angle))
            }
        }
    }
}

impl MotionCheck {
    pub fn new(
        arm: &PlannedArm,
        task: &PlanTask,
        motion: &JointTrack,
        precision: Vec<ExpectedPrecision>,
    ) -> Self {
        let speed: Vec<f64> = task.margins.iter().map(|margin| margin.velocity).collect();
        let acceleration: Vec<f64> =
            task.margins.iter().map(|margin| margin.acceleration).collect();
        let violations = limit_violations(&arm.chain, motion, &speed, &acceleration);
        let violation = (0..motion.len()).find_map(|row| {
            let violation = task.clearances.first_violation(&arm.chain, motion.row(row))?;
            Some((motion.t_s[row], violation))
        });
        Self { precision, limit_violations: violations, clearance_violation: violation }
    }

    /// Whether all limits and clearances hold.
    pub fn is_within(&self) -> bool {
        self.limit_violations.is_empty() && self.clearance_violation.is_none()
    }
}

/// Radius of each segment, m, and whether it comes from the model's primitive collision shapes, as far as
/// they extend from the segment. Otherwise a fraction of the reach.
fn segment_radii(arm: &PlannedArm, around: &[f64]) -> (Vec<f64>, Vec<bool>) {
    let PlannedArm { robot, chain } = arm;
    let default_radius = DEFAULT_RADIUS_RATIO * chain.max_reach_m();
    let mut frames = Vec::new();
    chain.joint_frames(around, &mut frames);
    let tip = chain.forward(around);
    let shapes = robot.collisions();
    let ends = |at: usize| {
        let to = frames.get(at + 1).unwrap_or(&tip).translation.vector;
        (frames[at].translation.vector, to)
    };
    let from_shapes = |at: usize| -> Option<f64> {
        let link = robot.joint(&chain.joint_names()[at])?.child;
        let (from, to) = ends(at);
        let along = (to - from).norm_squared();
        let extents = shapes.iter().filter(|shape| shape.link == link).filter_map(|shape| {
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
        extents.reduce(f64::max)
    };
    let from_shapes: Vec<Option<f64>> =
        std::iter::once(None).chain((0..chain.dof()).map(from_shapes)).collect();
    (
        from_shapes.iter().map(|from_shapes| from_shapes.unwrap_or(default_radius)).collect(),
        from_shapes.iter().map(Option::is_some).collect(),
    )
}
