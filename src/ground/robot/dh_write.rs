//! Conversion of a chain to a DH table.

use std::fmt::Write as _;

use super::dh::DhConvention;
use super::joint::JointKind;
use super::model::{LinkId, Robot};
use crate::geometry::{Convention, Pose, Rotation, Vec3, pose, rotation_from_rpy, xyz_of};

/// Maximum FK difference, m and rad.
const MAX_EQUAL_DIFFERENCE: f64 = 1e-9;
/// Below this angle, rad, axes have no unique common normal.
const PARALLEL: f64 = 1e-12;

impl Robot {
    /// Converts the joints from `base` to `tip` to a DH table in the format of [`Robot::from_toml`]. `None`
    /// if a joint is prismatic or a mimic, or if FK differs.
    ///
    /// Joint axes are lines: row i leads from the common normal of axes i − 1 and i to that of axes i and
    /// i + 1 (Craig, *Introduction to Robotics*, ch. 3.5). That of nearly parallel axes is far away and
    /// causes large `d` that cancel.
    pub fn to_dh(&self, base: LinkId, tip: LinkId, convention: DhConvention) -> Option<String> {
        let chain = self.chain(base, tip).ok()?;
        if chain.joint_kinds().contains(&JointKind::Prismatic) {
            return None;
        }
        let (n, zero) = (chain.dof(), vec![0.0; chain.dof()]);
        let mut frames = Vec::new();
        chain.joint_frames(&zero, &mut frames);
        let axis = |joint: usize| -> Option<Pose> {
            let own = self.joint(&chain.joint_names()[joint])?;
            Some(frames[joint] * pose([0.0; 3], super::turn_z_to(&own.axis)))
        };
        let axes: Vec<Pose> = (0..n).map(axis).collect::<Option<_>>()?;
        // Frame i: z along axis i, x along the common normal to axis i + 1.
        let mut at = Vec::with_capacity(n);
        for joint in 0..n {
            let line = axes[joint];
            at.push(axes.get(joint + 1).map_or(line, |next| on_common_normal(&line, next)));
        }
        // Modified rows lead from frame i − 1 to i; `pre` leads to frame 0.
        let mut rows = Vec::new();
        let pre = at[0];
        let mut before = at[0];
        for frame in at.iter().take(n) {
            rows.push(modified_row(&(before.inv_mul(frame))));
            before = *frame;
        }
        let tip_pose = chain.forward(&zero);
        let post = before.inv_mul(&tip_pose);
        let (pre, rows, post) = match convention {
            DhConvention::Modified => (pre, rows, post),
            DhConvention::Standard => {
                // A standard row combines Rz and Dz of a row with Rx and Dx of the next.
                let next =
                    |row: usize| rows.get(row + 1).map_or([0.0; 2], |next| [next[0], next[2]]);
                let standard = |(row, own): (usize, &[f64; 4])| {
                    let [a, alpha] = next(row);
                    [a, own[1], alpha, own[3]]
                };
                (pre, rows.iter().enumerate().map(standard).collect(), post)
            }
        };
        let text = written(self, &chain, base, tip, convention, (&pre, &rows, &post));
        let read = Robot::from_toml(&text, &self.source).ok()?;
        let own =
            read.chain(read.link(self.link_name(base))?, read.link(self.link_name(tip))?).ok()?;
        let is_same = (0..8).all(|k| {
            let q: Vec<f64> =
                (0..n).map(|joint| (1.7 * (joint + 1) as f64 * f64::from(k)).sin()).collect();
            let off = own.forward(&q).inv_mul(&chain.forward(&q));
            off.translation.vector.norm() < MAX_EQUAL_DIFFERENCE
                && off.rotation.angle() < MAX_EQUAL_DIFFERENCE
        });
        is_same.then_some(text)
    }
}

/// Origin and z on the axis `line`, x along the common normal to `next`.
fn on_common_normal(line: &Pose, next: &Pose) -> Pose {
    let [z, other] = [line, next].map(|pose| pose.rotation * Vec3::z());
    let between = next.translation.vector - line.translation.vector;
    let cross = z.cross(&other);
    let (along, x) = match cross.norm_squared() {
        small if small < PARALLEL * PARALLEL => {
            let across = between - z * z.dot(&between);
            let x =
                if across.norm() > 1e-12 { across.normalize() } else { line.rotation * Vec3::x() };
            (0.0, x)
        }
        square => (between.cross(&other).dot(&cross) / square, cross / square.sqrt()),
    };
    let rotation = Rotation::from_basis_unchecked(&[x, z.cross(&x), z]);
    let origin = line.translation.vector + z * along;
    Pose::from_parts(origin.into(), rotation)
}

/// `[a, d, alpha, theta]` if the z axis intersects the previous x axis at a right angle.
fn modified_row(step: &Pose) -> [f64; 4] {
    let z = step.rotation * Vec3::z();
    let alpha = (-z.y).atan2(z.z);
    let x = step.rotation * Vec3::x();
    let turned = rotation_from_rpy([-alpha, 0.0, 0.0]) * x;
    let p = rotation_from_rpy([-alpha, 0.0, 0.0]) * step.translation.vector;
    [p.x, p.z, alpha, turned.y.atan2(turned.x)]
}

fn written(
    robot: &Robot,
    chain: &super::Chain,
    base: LinkId,
    tip: LinkId,
    convention: DhConvention,
    (pre, rows, post): (&Pose, &[[f64; 4]], &Pose),
) -> String {
    let quoted = |name: &str| format!("\"{}\"", name.replace('\\', "\\\\").replace('"', "\\\""));
    let list = |of: &[f64]| {
        let numbers: Vec<String> = of.iter().map(|number| format!("{number:?}")).collect();
        format!("[{}]", numbers.join(", "))
    };
    let names: Vec<String> = chain.joint_names().iter().map(|name| quoted(name)).collect();
    let mut text = format!("id = {}\n\n[dh]\n", quoted(&robot.name));
    let _ = writeln!(text, "convention = \"{}\"", convention.name());
    let _ = writeln!(
        text,
        "base = {}\ntip = {}",
        quoted(robot.link_name(base)),
        quoted(robot.link_name(tip))
    );
    let _ = writeln!(text, "joint_names = [{}]", names.join(", "));
    for (name, pose) in [("pre", pre), ("post", post)] {
        let _ = writeln!(text, "{name}_xyz = {}", list(&xyz_of(pose)));
        let _ = writeln!(text, "{name}_rpy = {}", list(&Convention::RPY.numbers(&pose.rotation)));
    }
    text += "# a, d, alpha, theta: m, rad\nrows = [\n";
    rows.iter().for_each(|row| {
        let _ = writeln!(text, "  {},", list(row));
    });
    text + "]\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::catalogue;

    #[test]
    fn revolute_arms_become_dh_tables_with_equal_kinematics() {
        for name in ["ur5e", "panda", "ur10"] {
            let robot = catalogue::find(name).unwrap();
            let tip = robot.leaf_links().last().unwrap();
            for convention in [DhConvention::Standard, DhConvention::Modified] {
                assert!(
                    robot.to_dh(robot.root(), tip, convention).is_some(),
                    "{name} {convention:?}"
                );
            }
        }
    }
}
