//! Search for tool positions in the arm's base frame. Only the tool offset is free, so motion of one or two
//! joints is enough.

use super::{
    ColumnCandidate, JointColumns, MAX_TOOL_M, MappingConstraints, NumericTable, best_candidates,
};
use ground::geometry::{Pose, Vec3, mean_vector};
use ground::robot::Chain;

/// Share of the position's extent, before the latency is fitted.
const MAX_RESIDUAL_SHARE: f64 = 0.3;
/// Joint and position candidates, and arms per candidate.
const MAX_CANDIDATES: usize = 8;
const MAX_ARMS: usize = 4;
/// No arm reaches 10 m: larger positions are in millimetres.
const MAX_REACH_M: f64 = 10.0;

impl NumericTable {
    /// Uses only a tool offset; best first.
    pub(super) fn candidates_at_base(
        &self,
        constraints: &MappingConstraints,
        lags_s: &[f64],
        rows: &[usize],
    ) -> Vec<ColumnCandidate> {
        let logged: Vec<PositionColumns> = self
            .possible_positions(constraints)
            .into_iter()
            .filter_map(|position| PositionColumns::from_columns(self, position, rows))
            .collect();
        let shares = |block: &JointColumns, lag_s: f64| {
            let fk = self.poses_at(block, constraints.chains[block.arm], rows, lag_s);
            let free = logged.iter().filter(|logged| !block.contain_any(&logged.position));
            free.filter_map(|logged| Some((logged.residual_share(&fk)?, logged.position))).collect()
        };
        let blocks = self.candidate_blocks(constraints, 1);
        best_candidates(&blocks, lags_s, (MAX_CANDIDATES, MAX_ARMS), shares)
    }

    /// Compares the whole table at all speeds, at this latency.
    pub(super) fn agrees_at_base(
        &self,
        block: &JointColumns,
        chain: &Chain,
        position: [usize; 3],
        lag_s: f64,
    ) -> bool {
        /// Share of the extent. Above the usual threshold, because the latency is less precise than the
        /// residual.
        const MAX_FITTED_RESIDUAL_SHARE: f64 = 0.1;
        let rows = self.few_rows();
        let logged = PositionColumns::from_columns(self, position, &rows);
        let fk = self.poses_at(block, chain, &rows, lag_s);
        logged
            .and_then(|logged| logged.residual_share(&fk))
            .is_some_and(|share| share < MAX_FITTED_RESIDUAL_SHARE)
    }

    pub(super) fn poses_at(
        &self,
        block: &JointColumns,
        chain: &Chain,
        rows: &[usize],
        lag_s: f64,
    ) -> Vec<Pose> {
        let at = |&row: &usize| chain.forward(&self.joints_at(block, chain, self.t_s[row] - lag_s));
        rows.iter().map(at).collect()
    }
}

struct PositionColumns {
    position: [usize; 3],
    xyz: Vec<Vec3>,
    /// Squared distances from the mean, m².
    extent: f64,
}

impl PositionColumns {
    /// `None` if fewer than two coordinates move, or no arm reaches them.
    fn from_columns(table: &NumericTable, position: [usize; 3], rows: &[usize]) -> Option<Self> {
        let at = |&row: &usize| Vec3::from(position.map(|column| table.columns[column][row]));
        let mut xyz: Vec<Vec3> = rows.iter().map(at).collect();
        let farthest = xyz.iter().map(|xyz| xyz.norm()).fold(0.0, f64::max);
        if farthest > MAX_REACH_M {
            xyz.iter_mut().for_each(|xyz| *xyz *= 1e-3);
        }
        let mean = mean_vector(&xyz);
        let squares: Vec3 = xyz.iter().map(|xyz| (xyz - mean).map(|d| d * d)).sum();
        let extent = squares.sum();
        let moving = squares.iter().filter(|square| **square > 1e-4 * extent).count();
        let is_near = farthest < MAX_REACH_M / 1e-3;
        (extent > 0.0 && moving > 1 && is_near).then_some(Self { position, xyz, extent })
    }

    /// Residual with the best tool offset, as a share of the extent, in the base frame or one turned by
    /// 180° about z. `None` if it is large or the tool longer than [`MAX_TOOL_M`].
    fn residual_share(&self, fk: &[Pose]) -> Option<f64> {
        let shares = [1.0, -1.0].map(|turn| self.residual_share_rotated(fk, turn));
        shares.into_iter().flatten().reduce(f64::min)
    }

    fn residual_share_rotated(&self, fk: &[Pose], turn: f64) -> Option<f64> {
        // Rotations preserve lengths: the least-squares tool offset is a mean.
        let few = fk.len().div_ceil(super::SCREENING_ROWS / 2);
        let square = |step: usize| {
            let (mut count, mut sum, mut squares) = (0.0, Vec3::zeros(), 0.0);
            for (pose, xyz) in fk.iter().zip(&self.xyz).step_by(step) {
                let xyz = Vec3::new(turn * xyz.x, turn * xyz.y, xyz.z);
                let in_tool = pose.rotation.inverse() * (xyz - pose.translation.vector);
                (count, sum, squares) =
                    (count + 1.0, sum + in_tool, squares + in_tool.norm_squared());
            }
            let tool: Vec3 = sum / count;
            let square = (squares / count - tool.norm_squared()).max(0.0);
            let share = (square * self.xyz.len() as f64 / self.extent).sqrt();
            (share < MAX_RESIDUAL_SHARE && tool.norm() < MAX_TOOL_M).then_some(share)
        };
        square(few).and_then(|_| square(1))
    }
}
