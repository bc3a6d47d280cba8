//! Identifies columns that contain the rotation of the tool.

use super::{ColumnMapping, NumericTable};
use ground::geometry::{Convention, Rotation, angle_between, rotation_from_xyzw};
use ground::robot::Chain;
use ground::stats::thin::thinned;

impl NumericTable {
    /// Whether the columns are the tool's rotation: 3 numbers in some convention, a quaternion in any
    /// order, or a 3×3 matrix. Compares frame-independent angles between poses. `None` if the tool rotates
    /// too little.
    pub fn is_tool_rotation(
        &self,
        mapping: &ColumnMapping,
        chain: &Chain,
        columns: &[usize],
    ) -> Option<bool> {
        /// The minimum rotation of the tool is rms.
        const COMPARED_ROWS: usize = 60;
        const MAX_DIFFERENCE_RAD: f64 = 0.05;
        const MIN_ROTATION_RAD: f64 = 0.2;
        let rows: Vec<usize> = thinned(self.few_rows(), COMPARED_ROWS).collect();
        let block = mapping.block();
        let fk = self.poses_at(&block, chain, &rows, mapping.lag_s);
        let pairs: Vec<(usize, usize)> =
            (1..rows.len()).flat_map(|at| [(0, at), (at - 1, at), (at / 2, at)]).collect();
        let rms = |angle: &dyn Fn(usize, usize) -> f64, other: &dyn Fn(usize, usize) -> f64| {
            let differences = pairs.iter().map(|&(a, b)| (angle(a, b) - other(a, b)).powi(2));
            (differences.sum::<f64>() / pairs.len().max(1) as f64).sqrt()
        };
        let expected = |a: usize, b: usize| angle_between(&fk[a].rotation, &fk[b].rotation);
        let rotation_rad = rms(&expected, &|_, _| 0.0);
        if rotation_rad < MIN_ROTATION_RAD {
            return None;
        }
        let number = |row: usize, at: usize| self.columns[columns[at]][rows[row]];
        let max_difference = MAX_DIFFERENCE_RAD.min(0.15 * rotation_rad);
        let agrees = |all: Option<Vec<Rotation>>| {
            all.is_some_and(|all| {
                rms(&expected, &|a, b| angle_between(&all[a], &all[b])) < max_difference
            })
        };
        let norms_are_one = |of: usize| {
            let norm =
                |row: usize| (0..columns.len()).map(|at| number(row, at).powi(2)).sum::<f64>();
            (0..rows.len()).all(|row| (norm(row) / of as f64 - 1.0).abs() < 0.02)
        };
        Some(match columns.len() {
            3 => [1.0, 1_f64.to_radians()].into_iter().any(|unit| {
                Convention::all().iter().any(|convention| {
                    let read =
                        |row| convention.rotation([0, 1, 2].map(|at| unit * number(row, at)));
                    agrees(Some((0..rows.len()).map(read).collect()))
                })
            }),
            4 if norms_are_one(1) => {
                let read = |row| rotation_from_xyzw([0, 1, 2, 3].map(|at| number(row, at)));
                agrees((0..rows.len()).map(read).collect())
            }
            9 if norms_are_one(3) => {
                let angle = |a: usize, b: usize| {
                    let trace: f64 = (0..9).map(|at| number(a, at) * number(b, at)).sum();
                    (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos()
                };
                rms(&expected, &angle) < max_difference
            }
            _ => false,
        })
    }
}
