//! Identifies columns that contain the rotation of the tool.

use super::{ColumnMapping, NumericTable};
use ground::geometry::{Convention, Rotation, angle_between, rotation_from_xyzw};
use ground::robot::Chain;
use ground::stats::mean;
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
        let angle = |&(a, b): &(usize, usize)| angle_between(&fk[a].rotation, &fk[b].rotation);
        let expected: Vec<f64> = pairs.iter().map(angle).collect();
        let rotation_rad = mean(expected.iter().map(|angle| angle * angle)).sqrt();
        if rotation_rad < MIN_ROTATION_RAD {
            return None;
        }
        let number = |row: usize, at: usize| self.columns[columns[at]][rows[row]];
        let max_difference = MAX_DIFFERENCE_RAD.min(0.15 * rotation_rad);
        let agrees = |angle: &dyn Fn(usize, usize) -> f64| {
            let difference = |(&(a, b), expected): (&(usize, usize), &f64)| angle(a, b) - expected;
            let squares = pairs.iter().zip(&expected).map(|pair| difference(pair).powi(2));
            mean(squares).sqrt() < max_difference
        };
        let rotations_agree = |all: Option<Vec<Rotation>>| {
            all.is_some_and(|all| agrees(&|a, b| angle_between(&all[a], &all[b])))
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
                    rotations_agree(Some((0..rows.len()).map(read).collect()))
                })
            }),
            4 if norms_are_one(1) => {
                let read = |row| rotation_from_xyzw([0, 1, 2, 3].map(|at| number(row, at)));
                rotations_agree((0..rows.len()).map(read).collect())
            }
            9 if norms_are_one(3) => agrees(&|a, b| {
                let trace: f64 = (0..9).map(|at| number(a, at) * number(b, at)).sum();
                (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos()
            }),
            _ => false,
        })
    }
}
