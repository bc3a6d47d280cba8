//! Converts columns to joint tracks and position tracks.

use super::{JointColumns, NumericTable};
use ground::geometry::Vec3;
use ground::robot::Chain;
use ground::stream::{JointTrack, Orientations, PoseTrack};

impl NumericTable {
    pub(super) fn position(&self, columns: [usize; 3]) -> PoseTrack {
        let xyz = |row: usize| Vec3::from(columns.map(|column| self.columns[column][row]));
        PoseTrack {
            t_s: self.t_s.clone(),
            xyz: (0..self.t_s.len()).map(xyz).collect(),
            orientation: Orientations::Unset(self.t_s.len()),
            declared: None,
        }
    }

    pub(super) fn track(&self, block: &JointColumns, chain: &Chain) -> JointTrack {
        let rows = self.t_s.len();
        let dof = block.joints.len();
        let (mut q, mut qd) = (vec![0.0; rows * dof], vec![0.0; rows * dof]);
        for (joint, &column) in block.joints.iter().enumerate() {
            let values = &self.columns[column];
            let (factor, zero) = block.unit.factor_and_offset(chain, joint);
            for row in 0..rows {
                let (before, after) = (row.saturating_sub(1), (row + 1).min(rows - 1));
                let h = self.t_s[after] - self.t_s[before];
                q[row * dof + joint] = factor * values[row] + zero;
                qd[row * dof + joint] = factor * (values[after] - values[before]) / h;
            }
        }
        JointTrack { t_s: self.t_s.clone(), dof, q, qd, noise: Vec::new() }
    }
}
