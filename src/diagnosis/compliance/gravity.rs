//! Gravity torques about the joints of an arm.

use ground::geometry::Vec3;
use ground::robot::{Chain, JointKind};

/// Relative masses, assumed if the model has none. `taper` is the mass ratio of successive links, `tool` the mass ratio of
/// tool and last link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MassModel {
    pub taper: f64,
    pub tool: f64,
}

impl MassModel {
    /// Equal or tapered links, with and without a tool.
    pub const CANDIDATES: [Self; 9] = [
        Self { taper: 0.8, tool: 0.5 },
        Self { taper: 1.0, tool: 0.0 },
        Self { taper: 0.8, tool: 0.0 },
        Self { taper: 0.6, tool: 0.0 },
        Self { taper: 1.0, tool: 1.0 },
        Self { taper: 0.8, tool: 2.0 },
        Self { taper: 0.6, tool: 1.0 },
        Self { taper: 0.6, tool: 3.0 },
        Self { taper: 0.4, tool: 0.5 },
    ];
}

/// Torques with an upright base, up to a common factor. Each link is a point mass midway between its
/// joints.
#[derive(Clone, Debug)]
pub(super) struct GravityTorques {
    chain: Chain,
    /// Column in the joint track per joint.
    columns: Vec<usize>,
    masses: MassModel,
}

impl GravityTorques {
    pub fn new(chain: &Chain, columns: &[usize], masses: MassModel) -> Self {
        Self { chain: chain.clone(), columns: columns.to_vec(), masses }
    }

    /// Torques at `row`, positive along the joint's motion, 0 for prismatic joints. One for each position of the row.
    pub fn torques(&self, row: &[f64]) -> Vec<f64> {
        let q: Vec<f64> = self.columns.iter().map(|&column| row[column]).collect();
        let (mut jacobian, mut frames) = (vec![[0.0; 6]; q.len()], Vec::new());
        let tip = self.chain.forward_with_jacobian(&q, &mut jacobian).translation.vector;
        self.chain.joint_frames(&q, &mut frames);
        let mut torques = vec![0.0; row.len()];
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
                torques[self.columns[joint]] -= mass * rises;
            }
        }
        torques
    }
}
