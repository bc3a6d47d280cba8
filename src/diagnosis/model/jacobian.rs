//! Derivatives of a predicted pose `reference · FK(q) · tool`.

use ground::geometry::{Pose, Rotation, Vec3, rotvec_from_rotation};

/// Change of the position in m, and of the rotation as a rotation vector in rad on the left, both in the stream's
/// frame.
pub(crate) type Derivative = [Vec3; 2];

/// Change from one pose to another.
pub(crate) fn pose_change(from: &Pose, to: &Pose) -> Derivative {
    let turn = rotvec_from_rotation(&(to.rotation * from.rotation.inverse()));
    [to.translation.vector - from.translation.vector, turn]
}

/// Changes from the poses of one series to those of another.
pub(crate) fn pose_changes(from: &[Pose], to: &[Pose]) -> [Vec<Vec3>; 2] {
    let change = |(from, to): (&Pose, &Pose)| <(Vec3, Vec3)>::from(pose_change(from, to));
    from.iter().zip(to).map(change).unzip().into()
}

/// Derivatives of a pose at `tip` with respect to changes of a link's frame, multiplied on the right: translation along
/// its axes, then rotation about them.
pub(crate) fn link_derivatives(link: &Pose, tip: &Vec3) -> [Derivative; 6] {
    let units = [0, 1, 2].map(|axis| link.rotation * Vec3::ith(axis, 1.0));
    std::array::from_fn(|column| match column {
        0..3 => [units[column], Vec3::zeros()],
        _ => [units[column - 3].cross(&(tip - link.translation.vector)), units[column - 3]],
    })
}

pub(crate) struct PoseJacobian<'a> {
    /// Geometric Jacobian of the link's origin in the base ([`ground::robot::Chain::forward_with_jacobian`]).
    link: &'a [[f64; 6]],
    pub reference: Rotation,
    /// From the link's origin to the pose, in the base.
    lever: Vec3,
    /// Predicted pose.
    pub pose: Pose,
}

impl<'a> PoseJacobian<'a> {
    pub fn new(link: &'a [[f64; 6]], reference: &Pose, base_from_link: &Pose, tool: &Pose) -> Self {
        Self {
            link,
            reference: reference.rotation,
            lever: base_from_link.rotation * tool.translation.vector,
            pose: reference * base_from_link * tool,
        }
    }

    /// Derivative with respect to one joint position.
    pub fn joint(&self, joint: usize) -> Derivative {
        self.of_pose(self.link[joint])
    }

    /// Velocity of the pose at this velocity of the link.
    fn of_pose(&self, [x, y, z, rx, ry, rz]: [f64; 6]) -> Derivative {
        let angular = Vec3::new(rx, ry, rz);
        let linear = Vec3::new(x, y, z) + angular.cross(&self.lever);
        [self.reference * linear, self.reference * angular]
    }

    /// Derivative with respect to time, at joint velocities `rates`.
    pub fn velocity(&self, rates: &[f64]) -> Derivative {
        let mut twist = [0.0; 6];
        for (column, rate) in self.link.iter().zip(rates) {
            twist.iter_mut().zip(column).for_each(|(sum, part)| *sum += rate * part);
        }
        self.of_pose(twist)
    }

    /// Derivative with respect to a change of the reference, multiplied on the left: translation along `axis` 0
    /// to 2, rotation about 3 to 5.
    pub fn reference(&self, axis: usize) -> Derivative {
        let unit = Vec3::ith(axis % 3, 1.0);
        match axis {
            0..3 => [unit, Vec3::zeros()],
            _ => [unit.cross(&self.pose.translation.vector), unit],
        }
    }

    /// Same for a change of the tool, multiplied on the right.
    pub fn tool(&self, axis: usize) -> Derivative {
        let along = self.pose.rotation * Vec3::ith(axis % 3, 1.0);
        match axis {
            0..3 => [along, Vec3::zeros()],
            _ => [Vec3::zeros(), along],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::measurement::pose_of_twist;
    use ground::robot::catalogue;

    #[test]
    fn derivatives_equal_differences_of_predictions() {
        const STEP: f64 = 1e-6;
        let robot = catalogue::find("ur5e").expect("in the catalogue");
        let link = |name: &str| robot.link(name).expect("a link");
        let chain = robot.chain(link("base_link"), link("tool0")).expect("a chain");
        let reference = pose_of_twist(&[0.4, -0.2, 0.9, 0.3, 1.1, -0.7]);
        let tool = pose_of_twist(&[0.05, 0.02, 0.21, -0.4, 0.2, 0.9]);
        let q = [0.3, -1.2, 1.4, -0.9, -1.5, 0.6];
        let rates = [0.5, -0.3, 0.8, 0.1, -0.6, 1.2];
        let mut columns = [[0.0; 6]; 6];
        let base_from_link = chain.forward_with_jacobian(&q, &mut columns);
        let jacobian = PoseJacobian::new(&columns, &reference, &base_from_link, &tool);
        let assert_equal = |derivative: Derivative, moved: &dyn Fn(f64) -> Pose, name: &str| {
            let change = pose_change(&moved(-STEP), &moved(STEP)).map(|part| part / (2.0 * STEP));
            for kind in 0..2 {
                assert!((derivative[kind] - change[kind]).norm() < 1e-6, "{name}: {derivative:?}");
            }
        };
        let along = |axis: usize, step: f64| {
            pose_of_twist(&std::array::from_fn::<f64, 6, _>(|i| if i == axis { step } else { 0.0 }))
        };
        for axis in 0..6 {
            let with_joint = |step: f64| {
                let mut q = q;
                q[axis] += step;
                reference * chain.forward(&q) * tool
            };
            assert_equal(jacobian.joint(axis), &with_joint, "joint");
            let with_reference = |step: f64| along(axis, step) * reference * base_from_link * tool;
            assert_equal(jacobian.reference(axis), &with_reference, "reference");
            let with_tool = |step: f64| reference * base_from_link * tool * along(axis, step);
            assert_equal(jacobian.tool(axis), &with_tool, "tool");
        }
        let later = |step: f64| {
            let q: Vec<f64> = q.iter().zip(&rates).map(|(q, rate)| q + rate * step).collect();
            reference * chain.forward(&q) * tool
        };
        assert_equal(jacobian.velocity(&rates), &later, "velocity");
    }
}
