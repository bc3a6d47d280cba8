//! Forward kinematics of the path between two links.

use std::sync::OnceLock;

use nalgebra::{Matrix3, Rotation3, Translation3};
use wide::f64x4;

use crate::geometry::{Pose, Rotation, Vec3, rotation_from_xyzw};

use super::error::ChainError;
use super::joint::{JointKind, Limits};
use super::lanes::{LANES, sin_cos};
use super::model::{Joint, LinkId, PathStep, Robot};

/// Kinematic chain from a base link to a tip link.
///
/// Its coordinates are the independently movable joints on the path, from base to tip; a mimic joint moves
/// with its driver. `q` are joint positions, rad or m, even if the path passes a joint from child to
/// parent.
///
/// A single floating joint is a chain of its own with [`FLOATING_COORDINATES`] as coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    base_name: String,
    tip_name: String,
    joint_names: Vec<String>,
    joint_kinds: Vec<JointKind>,
    limits: Vec<Limits>,
    steps: Vec<Step>,
    /// In the frame of the last step.
    step_from_tip: Rigid,
    max_reach_m: Derived,
}

/// Coordinates of a floating joint: position in m, and a quaternion of any length but zero.
pub const FLOATING_COORDINATES: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// Cached; ignored in comparisons.
#[derive(Debug, Clone, Default)]
struct Derived(OnceLock<f64>);

impl PartialEq for Derived {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// A motion about or along the z axis of its frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    /// Before this motion, in the previous step's frame after its motion.
    pub previous_from_step: Rigid,
    /// Motion = `factor · q[coordinate] + offset`.
    pub coordinate: usize,
    pub factor: f64,
    pub offset: f64,
    pub slides: bool,
    /// Child link of the joint, after the motion or, for upward steps, before it.
    step_from_child: Rigid,
    upwards: bool,
    /// Not a mimic joint.
    is_own: bool,
}

/// A matrix is cheaper to multiply and to translate along z than a quaternion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rigid {
    pub rotation: Matrix3<f64>,
    pub translation: Vec3,
}

impl Robot {
    /// Builds the chain through the lowest common ancestor of `base` and `tip`.
    ///
    /// # Errors
    /// If base and tip are equal, no joint between them moves, one is planar or floating beside others, or a mimic
    /// joint has an invalid driver.
    ///
    /// # Panics
    /// If a link belongs to another robot with more links.
    pub fn chain(&self, base: LinkId, tip: LinkId) -> Result<Chain, ChainError> {
        let (base_name, tip_name) = (self.link_name(base), self.link_name(tip));
        if base == tip {
            return Err(ChainError::SameLink { link: base_name.to_owned() });
        }
        let path = self.path(base, tip);
        if let [PathStep { joint, upwards: false }] = path.as_slice()
            && joint.kind == JointKind::Floating
        {
            return Ok(Chain::floating(joint, base_name, tip_name));
        }
        let mut builder = Builder::new(self);
        for step in path {
            builder.push(&step)?;
        }
        if builder.coordinates.is_empty() {
            return Err(ChainError::NothingMoves {
                base: base_name.to_owned(),
                tip: tip_name.to_owned(),
            });
        }
        Ok(builder.finish(base_name, tip_name))
    }

    /// Joint that finally drives `joint`, with factor and offset.
    fn driver<'a>(&'a self, joint: &'a Joint) -> Result<(&'a Joint, f64, f64), ChainError> {
        let (mut driver, mut factor, mut offset) = (joint, 1.0, 0.0);
        for _ in self.joints() {
            let Some(mimic) = &driver.mimic else { return Ok((driver, factor, offset)) };
            let bad = |why| {
                let (joint, master) = (driver.name.clone(), mimic.joint.clone());
                ChainError::Mimic { joint, master, why }
            };
            offset += factor * mimic.offset;
            factor *= mimic.multiplier;
            driver = self.joint(&mimic.joint).ok_or_else(|| bad("is not a joint of the model"))?;
            if !driver.kind.has_position() {
                return Err(bad("does not move"));
            }
        }
        let master = joint.mimic.as_ref().map_or_else(String::new, |mimic| mimic.joint.clone());
        let why = "refers back to itself";
        Err(ChainError::Mimic { joint: joint.name.clone(), master, why })
    }
}

struct Builder<'a> {
    robot: &'a Robot,
    coordinates: Vec<&'a Joint>,
    steps: Vec<Step>,
    /// From the last step's frame, after its motion, to the end of the path so far.
    since_last_step: Pose,
}

impl<'a> Builder<'a> {
    fn new(robot: &'a Robot) -> Self {
        Self {
            robot,
            coordinates: Vec::new(),
            steps: Vec::new(),
            since_last_step: Pose::identity(),
        }
    }

    fn push(&mut self, path_step: &PathStep<'a>) -> Result<(), ChainError> {
        let joint = path_step.joint;
        match joint.kind {
            JointKind::Fixed => self.since_last_step *= path_step.fixed_part(),
            JointKind::Revolute | JointKind::Continuous | JointKind::Prismatic => {
                self.push_motion(path_step)?;
            }
            JointKind::Floating | JointKind::Planar => {
                let (joint, kind) = (joint.name.clone(), joint.kind);
                return Err(ChainError::NotOneCoordinate { joint, kind });
            }
        }
        Ok(())
    }

    /// Downwards, the motion follows the joint's fixed part; upwards, the negated motion precedes it.
    fn push_motion(&mut self, path_step: &PathStep<'a>) -> Result<(), ChainError> {
        let &PathStep { joint, upwards } = path_step;
        let (driver, factor, offset) = self.robot.driver(joint)?;
        let sign = if upwards { -1.0 } else { 1.0 };
        let joint_from_step = Pose::from_parts(Translation3::identity(), turn_z_to(&joint.axis));
        let step_from_joint = joint_from_step.inverse();
        let ahead = if upwards { Pose::identity() } else { path_step.fixed_part() };
        let after = if upwards { path_step.fixed_part() } else { Pose::identity() };
        let coordinate = self.coordinate_of(driver);
        self.steps.push(Step {
            previous_from_step: Rigid::from(self.since_last_step * ahead * joint_from_step),
            coordinate,
            factor: sign * factor,
            offset: sign * offset,
            slides: joint.kind == JointKind::Prismatic,
            step_from_child: Rigid::from(step_from_joint),
            upwards,
            is_own: std::ptr::eq(driver, joint),
        });
        self.since_last_step = step_from_joint * after;
        Ok(())
    }

    fn coordinate_of(&mut self, driver: &'a Joint) -> usize {
        let known = self.coordinates.iter().position(|joint| std::ptr::eq(*joint, driver));
        known.unwrap_or_else(|| {
            self.coordinates.push(driver);
            self.coordinates.len() - 1
        })
    }

    fn finish(self, base_name: &str, tip_name: &str) -> Chain {
        Chain {
            base_name: base_name.to_owned(),
            tip_name: tip_name.to_owned(),
            joint_names: self.coordinates.iter().map(|joint| joint.name.clone()).collect(),
            joint_kinds: self.coordinates.iter().map(|joint| joint.kind).collect(),
            limits: self.coordinates.iter().map(|joint| joint.limits).collect(),
            steps: self.steps,
            step_from_tip: Rigid::from(self.since_last_step),
            max_reach_m: Derived::default(),
        }
    }
}

impl Chain {
    fn floating(joint: &Joint, base_name: &str, tip_name: &str) -> Self {
        let coordinates = FLOATING_COORDINATES.len();
        let name = |coordinate: &&str| format!("{}/{coordinate}", joint.name);
        Self {
            base_name: base_name.to_owned(),
            tip_name: tip_name.to_owned(),
            joint_names: FLOATING_COORDINATES.iter().map(name).collect(),
            joint_kinds: vec![JointKind::Floating; coordinates],
            limits: vec![Limits::default(); coordinates],
            steps: Vec::new(),
            step_from_tip: Rigid::IDENTITY,
            max_reach_m: Derived::default(),
        }
    }

    /// Whether its coordinates are those of one floating joint, which no zero, scale or sag changes.
    pub fn is_floating(&self) -> bool {
        self.joint_kinds.first() == Some(&JointKind::Floating)
    }

    /// Number of coordinates.
    pub fn dof(&self) -> usize {
        self.joint_names.len()
    }

    /// Joint names from base to tip.
    pub fn joint_names(&self) -> &[String] {
        &self.joint_names
    }

    /// Revolute, continuous or prismatic, or all floating.
    pub fn joint_kinds(&self) -> &[JointKind] {
        &self.joint_kinds
    }

    /// Whether a joint is prismatic.
    pub fn slides(&self, joint: usize) -> bool {
        self.joint_kinds[joint] == JointKind::Prismatic
    }

    /// Joints that are not prismatic.
    pub fn turning_joints(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.dof()).filter(|joint| !self.slides(*joint))
    }

    /// Limits of each coordinate's joint.
    pub fn limits(&self) -> &[Limits] {
        &self.limits
    }

    /// Base link.
    pub fn base_name(&self) -> &str {
        &self.base_name
    }

    /// Tip link.
    pub fn tip_name(&self) -> &str {
        &self.tip_name
    }

    /// Computes `base_from_tip` at `q`.
    ///
    /// # Panics
    /// If `q` has not `dof` values.
    pub fn forward(&self, q: &[f64]) -> Pose {
        if self.is_floating() {
            return floating_pose(q);
        }
        self.walk(q, |_, _, _| ()).to_pose()
    }

    /// Computes `base_from_tip` and its geometric Jacobian: column i is the tip's linear (m/s) and angular
    /// velocity (rad/s) in base at unit speed of joint i.
    ///
    /// Revolute steps add `z × (tip − origin)` and `z`, prismatic steps `z` and zero, times the factor
    /// (Siciliano et al., "Robotics", eq. 3.30).
    ///
    /// # Panics
    /// If `q` or `jacobian` has not `dof` values.
    pub fn forward_with_jacobian(&self, q: &[f64], jacobian: &mut [[f64; 6]]) -> Pose {
        assert_eq!(jacobian.len(), self.dof(), "one column per coordinate");
        jacobian.fill([0.0; 6]);
        if self.is_floating() {
            return floating_jacobian(q, jacobian);
        }
        let base_from_tip = self.walk(q, |step, _, base_from_step| {
            let z = step.factor * base_from_step.z();
            let column = &mut jacobian[step.coordinate];
            if step.slides {
                add(column, &z, &Vec3::zeros());
            } else {
                add(column, &base_from_step.translation.cross(&z), &z);
            }
        });
        for column in jacobian {
            let angular = Vec3::new(column[3], column[4], column[5]);
            add(column, &angular.cross(&base_from_tip.translation), &Vec3::zeros());
        }
        base_from_tip.to_pose()
    }

    /// `base_from_joint` of the first joint's fixed frame.
    pub fn first_joint_frame(&self) -> Pose {
        let first =
            |step: &Step| step.previous_from_step.to_pose() * step.step_from_child.to_pose();
        self.steps.first().map_or_else(Pose::identity, first)
    }

    /// `link_from_tip` of the last coordinate's child link. The identity if the chain has no coordinates.
    pub fn last_from_tip(&self) -> Pose {
        let (q, mut frames) = (vec![0.0; self.dof()], Vec::new());
        self.joint_frames(&q, &mut frames);
        frames.last().map_or_else(Pose::identity, |last| last.inv_mul(&self.forward(&q)))
    }

    /// Computes `base_from_link` of the child link of each coordinate's joint, or of its first mimic joint
    /// on the path.
    ///
    /// # Panics
    /// If `q` has not `dof` values.
    pub fn joint_frames(&self, q: &[f64], out: &mut Vec<Pose>) {
        out.clear();
        if self.is_floating() {
            out.resize(self.dof(), floating_pose(q));
            return;
        }
        out.resize(self.dof(), Pose::identity());
        let mut filled = vec![false; self.dof()];
        self.walk(q, |step, before, after| {
            if step.is_own || !filled[step.coordinate] {
                let base_from_step = if step.upwards { before } else { after };
                out[step.coordinate] = (*base_from_step * step.step_from_child).to_pose();
                filled[step.coordinate] = true;
            }
        });
    }

    /// Unit vector of each coordinate's axis, in the child link.
    pub fn joint_axes(&self) -> Vec<Vec3> {
        let own = |coordinate: usize| {
            let mut steps = self.steps.iter().filter(move |step| step.coordinate == coordinate);
            let first = steps.clone().next();
            steps.find(|step| step.is_own).or(first)
        };
        let axis = |step: &Step| step.step_from_child.rotation.tr_mul(&Vec3::z());
        (0..self.dof()).map(|coordinate| own(coordinate).map_or_else(Vec3::z, axis)).collect()
    }

    /// Approximate reach: largest distance found between the origins of base and tip, m.
    ///
    /// Never above the true reach, and rarely more than 1 % below; 0 for a floating joint. From the middle and the
    /// quarters of the
    /// ranges, each joint in turn takes the best of 48 positions. Revolute joints without limits cover ±π;
    /// such prismatic joints stay at zero.
    pub fn max_reach_m(&self) -> f64 {
        *self.max_reach_m.0.get_or_init(|| {
            if self.is_floating() {
                return 0.0;
            }
            let ranges: Vec<[f64; 2]> = (0..self.dof()).map(|joint| self.range(joint)).collect();
            let starts = [0.5, 0.25, 0.75].map(|part| self.climb_to_reach(&ranges, part));
            starts.into_iter().fold(0.0, f64::max)
        })
    }

    fn climb_to_reach(&self, ranges: &[[f64; 2]], start: f64) -> f64 {
        const SWEEPS: usize = 3;
        const POSITIONS: usize = 48;
        let between = |[lower, upper]: [f64; 2], part: f64| lower + part * (upper - lower);
        let mut q: Vec<f64> = ranges.iter().map(|&range| between(range, start)).collect();
        let mut best_m = self.walk(&q, |_, _, _| ()).translation.norm();
        for _ in 0..SWEEPS {
            let before_m = best_m;
            for joint in 0..ranges.len() {
                let mut best_position = q[joint];
                let mut reach_m = self.reach_by_joint(&q, joint);
                for index in 0..POSITIONS {
                    let position = between(ranges[joint], index as f64 / (POSITIONS - 1) as f64);
                    let reach_m = reach_m(position);
                    if reach_m > best_m {
                        (best_m, best_position) = (reach_m, position);
                    }
                }
                q[joint] = best_position;
            }
            if best_m == before_m {
                break;
            }
        }
        best_m
    }

    /// Distance of the tip from the base as a function of one joint's position, m. The steps before and after the joint's
    /// motions are walked once.
    fn reach_by_joint<'a>(&'a self, q: &[f64], joint: usize) -> impl FnMut(f64) -> f64 + use<'a> {
        let is_moved = |step: &Step| step.coordinate == joint;
        let first = self.steps.iter().position(is_moved).unwrap_or(0);
        let after = self.steps.iter().rposition(is_moved).map_or(0, |last| last + 1);
        let base_from_first = walk(&self.steps[..first], q, |_, _, _| ());
        let tip = walk(&self.steps[after..], q, |_, _, _| ()) * self.step_from_tip;
        let mut q = q.to_vec();
        move |position| {
            q[joint] = position;
            let moved = walk(&self.steps[first..after], &q, |_, _, _| ());
            (base_from_first * (moved * tip.translation)).norm()
        }
    }

    fn range(&self, joint: usize) -> [f64; 2] {
        use std::f64::consts::PI;
        let Limits { lower, upper, .. } = self.limits[joint];
        let stated = lower.zip(upper);
        match self.joint_kinds[joint] {
            JointKind::Prismatic => stated.map_or([0.0, 0.0], |(lower, upper)| [lower, upper]),
            _ => match stated {
                Some((lower, upper)) if upper - lower < 2.0 * PI => [lower, upper],
                _ => [-PI, PI],
            },
        }
    }

    pub(super) fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// In the frame of the last motion.
    pub(super) fn step_from_tip(&self) -> &Rigid {
        &self.step_from_tip
    }

    /// Calls `visit` with each step and its frame in base before and after the motion; returns
    /// `base_from_tip`.
    #[inline]
    fn walk(&self, q: &[f64], visit: impl FnMut(&Step, &Rigid, &Rigid)) -> Rigid {
        assert_eq!(q.len(), self.dof(), "one position per coordinate");
        walk(&self.steps, q, visit) * self.step_from_tip
    }
}

/// Last frame of `steps` in the frame before them; see [`Chain::walk`].
#[inline]
fn walk(steps: &[Step], q: &[f64], mut visit: impl FnMut(&Step, &Rigid, &Rigid)) -> Rigid {
    let mut first_from_here: Option<Rigid> = None;
    for few in steps.chunks(LANES) {
        let motion_of = |step: &Step| step.factor * q[step.coordinate] + step.offset;
        let motions: [f64; LANES] =
            std::array::from_fn(|lane| few.get(lane).map_or(0.0, motion_of));
        let (sin, cos) = sin_cos(f64x4::new(motions));
        let turns = sin.to_array().into_iter().zip(cos.to_array());
        for ((step, motion), turn) in few.iter().zip(motions).zip(turns) {
            let before = match first_from_here {
                None => step.previous_from_step,
                Some(first_from_here) => first_from_here * step.previous_from_step,
            };
            let after =
                if step.slides { before.slid_along_z(motion) } else { before.turned_about_z(turn) };
            visit(step, &before, &after);
            first_from_here = Some(after);
        }
    }
    first_from_here.unwrap_or(Rigid::IDENTITY)
}

/// A zero quaternion is no rotation.
fn floating_pose(q: &[f64]) -> Pose {
    let [x, y, z, q_xyzw @ ..] = floating_coordinates(q);
    let rotation = rotation_from_xyzw(q_xyzw).unwrap_or_default();
    Pose::from_parts(Translation3::new(x, y, z), rotation)
}

/// The angular velocity in the base is the vector part of `2 q̇ q⁻¹` (Diebel, "Representing attitude", 2006, §5.4).
fn floating_jacobian(q: &[f64], jacobian: &mut [[f64; 6]]) -> Pose {
    let [_, _, _, x, y, z, w] = floating_coordinates(q);
    let vector = Vec3::new(x, y, z);
    let square = vector.norm_squared() + w * w;
    let factor = if square > 0.0 { 2.0 / square } else { 0.0 };
    for (coordinate, column) in jacobian.iter_mut().enumerate() {
        let unit = Vec3::ith(coordinate % 3, 1.0);
        match coordinate {
            0..3 => add(column, &unit, &Vec3::zeros()),
            3..6 => add(column, &Vec3::zeros(), &(factor * (w * unit + vector.cross(&unit)))),
            _ => add(column, &Vec3::zeros(), &(-factor * vector)),
        }
    }
    floating_pose(q)
}

fn floating_coordinates(q: &[f64]) -> [f64; FLOATING_COORDINATES.len()] {
    q.try_into().expect("seven coordinates of a floating joint")
}

/// Maps z to the unit vector `axis`; the identity if equal.
pub fn turn_z_to(axis: &Vec3) -> Rotation {
    Rotation::rotation_between(&Vec3::z(), axis)
        .unwrap_or_else(|| Rotation::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI))
}

fn add(column: &mut [f64; 6], linear: &Vec3, angular: &Vec3) {
    for axis in 0..3 {
        column[axis] += linear[axis];
        column[axis + 3] += angular[axis];
    }
}

impl Rigid {
    const IDENTITY: Rigid = Rigid {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vec3::new(0.0, 0.0, 0.0),
    };

    fn z(&self) -> Vec3 {
        self.rotation.column(2).into_owned()
    }

    /// Only the x and y columns change.
    #[inline]
    fn turned_about_z(mut self, (sin, cos): (f64, f64)) -> Self {
        let x = self.rotation.column(0).into_owned();
        let y = self.rotation.column(1).into_owned();
        self.rotation.set_column(0, &(x * cos + y * sin));
        self.rotation.set_column(1, &(y * cos - x * sin));
        self
    }

    #[inline]
    fn slid_along_z(mut self, distance_m: f64) -> Self {
        self.translation += self.z() * distance_m;
        self
    }

    pub fn to_pose(self) -> Pose {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Pose::from_parts(
            Translation3::from(self.translation),
            Rotation::from_rotation_matrix(&rotation),
        )
    }
}

impl From<Pose> for Rigid {
    fn from(pose: Pose) -> Self {
        Self {
            rotation: pose.rotation.to_rotation_matrix().into_inner(),
            translation: pose.translation.vector,
        }
    }
}

impl std::ops::Mul<Vec3> for Rigid {
    type Output = Vec3;

    fn mul(self, point: Vec3) -> Vec3 {
        self.rotation * point + self.translation
    }
}

impl std::ops::Mul for Rigid {
    type Output = Rigid;

    #[inline]
    fn mul(self, b_from_c: Rigid) -> Rigid {
        Rigid {
            rotation: self.rotation * b_from_c.rotation,
            translation: self.translation + self.rotation * b_from_c.translation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{angle_between, pose, rotation_from_rotvec, rotvec_from_rotation};

    fn floating() -> Chain {
        let robot = Robot::floating_body("body", "world", "tag");
        let link = |name| robot.link(name).expect("a link");
        robot.chain(link("world"), link("tag")).expect("a chain")
    }

    #[test]
    fn a_floating_joint_has_the_pose_of_its_coordinates_for_quaternions_of_any_length() {
        let rotation = rotation_from_rotvec(Vec3::new(0.4, -1.2, 2.0));
        let [x, y, z, w] = [rotation.i, rotation.j, rotation.k, rotation.w];
        for length in [1.0, -1.0, 0.3] {
            let q = [0.5, -0.2, 1.1, length * x, length * y, length * z, length * w];
            let found = floating().forward(&q);
            assert!((found.translation.vector - Vec3::new(0.5, -0.2, 1.1)).norm() < 1e-12);
            assert!(angle_between(&found.rotation, &rotation) < 1e-9);
        }
    }

    #[test]
    fn the_jacobian_of_a_floating_joint_equals_differences() {
        const STEP: f64 = 1e-6;
        let q = [0.5, -0.2, 1.1, 0.2, 0.7, -0.4, 0.5];
        let mut jacobian = [[0.0; 6]; 7];
        let at = floating().forward_with_jacobian(&q, &mut jacobian);
        assert_eq!(at, floating().forward(&q));
        for coordinate in 0..7 {
            let [before, after] = [-STEP, STEP].map(|step| {
                let mut q = q;
                q[coordinate] += step;
                floating().forward(&q)
            });
            let linear = after.translation.vector - before.translation.vector;
            let turn = rotvec_from_rotation(&(after.rotation * before.rotation.inverse()));
            for axis in 0..3 {
                assert!((jacobian[coordinate][axis] - linear[axis] / (2.0 * STEP)).abs() < 1e-6);
                assert!((jacobian[coordinate][axis + 3] - turn[axis] / (2.0 * STEP)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_zero_quaternion_is_no_rotation() {
        let expected = pose([1.0, 2.0, 3.0], Rotation::identity());
        assert_eq!(floating().forward(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0]), expected);
    }
}
