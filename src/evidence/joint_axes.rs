//! Joint axes in the base and in the tip, at one configuration of the run.

use crate::geometry::{Pose, rotvec_from_rotation};
use crate::robot::{Chain, JointKind, turn_z_to};
use crate::stream::JointTrack;

/// Axes of the joints of a stream's chain. A joint that has the same effect as a constant frame has a constant
/// axis, so one configuration is enough.
#[derive(Clone, Debug, Default)]
pub struct JointAxes {
    axes: Vec<JointAxis>,
    base_from_tip: Pose,
}

#[derive(Clone, Debug)]
struct JointAxis {
    /// Column of the arm's joint states.
    column: usize,
    is_prismatic: bool,
    /// The joint moves about or along z.
    base_from_axis: Pose,
}

/// Largest deviation of a frame from a motion of the joint, m and rad.
pub type Tolerance = (f64, f64);

impl JointAxes {
    /// `columns` are those of the chain's joints in `joints`.
    pub(super) fn in_the_middle(chain: &Chain, columns: &[usize], joints: &JointTrack) -> Self {
        if joints.is_empty() {
            return Self::default();
        }
        let q = joints.positions_at(joints.len() / 2, columns);
        let mut frames = Vec::new();
        chain.joint_frames(&q, &mut frames);
        let kinds = chain.joint_kinds().iter();
        let axes = chain.joint_axes().into_iter().zip(kinds).zip(frames).zip(columns);
        let axes = axes.map(|(((axis, kind), base_from_joint), &column)| JointAxis {
            column,
            is_prismatic: *kind == JointKind::Prismatic,
            base_from_axis: base_from_joint
                * Pose::from_parts(Default::default(), turn_z_to(&axis)),
        });
        Self { axes: axes.collect(), base_from_tip: chain.forward(&q) }
    }

    /// Column of the joint next to the base.
    pub fn first_column(&self) -> Option<usize> {
        self.axes.first().map(|axis| axis.column)
    }

    /// Column of the joint next to the tip.
    pub fn last_column(&self) -> Option<usize> {
        self.axes.last().map(|axis| axis.column)
    }

    /// Zero offset of a joint with the effect of `reference_from_stream`; `None` if no offset has it.
    pub fn zero_from_reference(
        &self,
        column: usize,
        reference_from_stream: &Pose,
        tolerance: Tolerance,
    ) -> Option<f64> {
        // The frame moves the poses back that the zero moves forward.
        self.axis(column)?.motion(&Pose::identity(), &reference_from_stream.inverse(), tolerance)
    }

    /// Zero offset of a joint with the effect of `tip_from_stream`; `None` if no offset has it.
    pub fn zero_from_tool(
        &self,
        column: usize,
        tip_from_stream: &Pose,
        tolerance: Tolerance,
    ) -> Option<f64> {
        self.axis(column)?.motion(&self.base_from_tip, tip_from_stream, tolerance)
    }

    fn axis(&self, column: usize) -> Option<&JointAxis> {
        self.axes.iter().find(|axis| axis.column == column)
    }
}

impl JointAxis {
    /// Coordinate of the joint whose motion is `moved`, a change of `base_from_frame` in that frame.
    fn motion(
        &self,
        base_from_frame: &Pose,
        moved: &Pose,
        (length_m, angle_rad): Tolerance,
    ) -> Option<f64> {
        let axis_from_frame = self.base_from_axis.inverse() * base_from_frame;
        let moved = axis_from_frame * moved * axis_from_frame.inverse();
        let (mut shift, mut turn) =
            (moved.translation.vector, rotvec_from_rotation(&moved.rotation));
        let coordinate = if self.is_prismatic { &mut shift.z } else { &mut turn.z };
        let coordinate = std::mem::take(coordinate);
        (shift.norm() < length_m && turn.norm() < angle_rad).then_some(coordinate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Vec3, pose, rotation_from_rotvec};
    use crate::robot::catalogue;

    const TOLERANCE: Tolerance = (1e-3, 1e-3);

    fn axes() -> JointAxes {
        let robot = catalogue::find("ur5e").expect("it is in the catalogue");
        let link = |name| robot.link(name).expect("a link");
        let chain = robot.chain(link("base_link"), link("tool0")).expect("a chain");
        let q = vec![0.3, -1.2, 1.4, -1.6, -1.5, 0.2];
        let joints = JointTrack { dof: 6, t_s: vec![0.0], q, ..JointTrack::default() };
        JointAxes::in_the_middle(&chain, &[0, 1, 2, 3, 4, 5], &joints)
    }

    #[test]
    fn a_base_turned_about_the_first_axis_is_a_zero_of_the_first_joint() {
        let turned = pose([0.0; 3], rotation_from_rotvec(Vec3::z() * 0.5));
        let zero = axes().zero_from_reference(0, &turned, TOLERANCE).expect("an offset");
        assert!((zero + 0.5).abs() < 1e-9, "{zero}");
        let zero = axes().zero_from_tool(5, &turned, TOLERANCE).expect("an offset");
        assert!((zero - 0.5).abs() < 1e-9, "{zero}");
    }

    #[test]
    fn a_base_turned_about_another_axis_or_shifted_is_no_zero() {
        let turned = pose([0.0; 3], rotation_from_rotvec(Vec3::x() * 0.5));
        assert_eq!(axes().zero_from_reference(0, &turned, TOLERANCE), None);
        let shifted = pose([0.01, 0.0, 0.0], rotation_from_rotvec(Vec3::z() * 0.5));
        assert_eq!(axes().zero_from_reference(0, &shifted, TOLERANCE), None);
        assert_eq!(JointAxes::default().zero_from_reference(0, &turned, TOLERANCE), None);
    }
}
