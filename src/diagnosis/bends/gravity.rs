//! What gravity does to the joints of an arm.

use ground::geometry::{Pose, Vec3};
use ground::robot::{Chain, JointKind};

/// How the masses of an arm go from link to link, where its model says nothing of them: each link's is
/// so many times that of the one before it, and the tool's so many times the last link's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Masses {
    pub taper: f64,
    pub tool: f64,
}

impl Masses {
    /// Those that are tried: alike, lighter outwards as arms are built, and with a tool or without.
    pub const TRIED: [Self; 9] = {
        const fn of(taper: f64, tool: f64) -> Masses {
            Masses { taper, tool }
        }
        [
            of(0.8, 0.5),
            of(1.0, 0.0),
            of(0.8, 0.0),
            of(0.6, 0.0),
            of(1.0, 1.0),
            of(0.8, 2.0),
            of(0.6, 1.0),
            of(0.6, 3.0),
            of(0.4, 0.5),
        ]
    };
}

/// The torques of gravity about the joints of a chain whose base stands upright, up to a factor that
/// all share: links are masses in the middle between their joints.
#[derive(Clone, Debug)]
pub(super) struct Gravity {
    chain: Chain,
    /// For each joint of the chain, its column in the joint track.
    columns: Vec<usize>,
    masses: Masses,
}

/// What the torques of one posture are reckoned in.
#[derive(Default)]
pub(super) struct Postures {
    q: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
    frames: Vec<Pose>,
}

impl Gravity {
    pub fn of(chain: &Chain, columns: &[usize], masses: Masses) -> Self {
        Self { chain: chain.clone(), columns: columns.to_vec(), masses }
    }

    /// The torque about the joint of each column of `out` at the positions of a row of the track, in
    /// the sense of the joint's motion; 0 for joints that slide.
    pub fn torques(&self, row: &[f64], buffer: &mut Postures, out: &mut [f64]) {
        let Postures { q, jacobian, frames } = buffer;
        q.clear();
        q.extend(self.columns.iter().map(|&column| row[column]));
        jacobian.resize(q.len(), [0.0; 6]);
        let tip = self.chain.forward_with_jacobian(q, jacobian).translation.vector;
        self.chain.joint_frames(q, frames);
        out.fill(0.0);
        let at = |link: usize| frames.get(link).map_or(tip, |frame| frame.translation.vector);
        let links = (0..q.len()).map(|link| {
            let mass = self.masses.taper.powi(link as i32);
            (link, mass, 0.5 * (at(link) + at(link + 1)))
        });
        let last = q.len().saturating_sub(1);
        let tool = self.masses.tool * self.masses.taper.powi(last as i32);
        for (link, mass, center) in links.chain([(last, tool, tip)]) {
            for (joint, column) in jacobian.iter().enumerate().take(link + 1) {
                if self.chain.joint_kinds()[joint] == JointKind::Prismatic {
                    continue;
                }
                let axis = Vec3::new(column[3], column[4], column[5]);
                let rises = column[2] + axis.cross(&(center - tip)).z;
                out[self.columns[joint]] -= mass * rises;
            }
        }
    }
}
