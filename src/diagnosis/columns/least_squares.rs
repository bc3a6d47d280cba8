//! Linear least squares on columns, and selection of rows with motion.

use nalgebra::{DMatrix, DVector};

use super::MAX_ROWS;
use crate::samples::sampling::value_range;
use ground::stats::cumulative;

/// Start of the window with the most motion.
pub(super) fn most_active_window(rows: &[usize], columns: &[Vec<f64>]) -> usize {
    let spread = |values: &Vec<f64>| value_range(values.iter().copied());
    let spreads: Vec<f64> = columns.iter().map(spread).collect();
    let step = |pair: &[usize]| -> f64 {
        let of = |(values, spread): (&Vec<f64>, &f64)| {
            let step = (values[pair[1]] - values[pair[0]]).abs() / spread;
            if step.is_finite() { step } else { 0.0 }
        };
        columns.iter().zip(&spreads).map(of).sum()
    };
    let sums = cumulative(rows.windows(2).map(step));
    let starts = (0..rows.len() - MAX_ROWS).step_by(MAX_ROWS / 10);
    let moved = |start: &usize| sums[start + MAX_ROWS - 1] - sums[*start];
    starts.max_by(|a, b| moved(a).total_cmp(&moved(b))).unwrap_or(0)
}

pub(super) fn centred(mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in matrix.column_iter_mut() {
        let mean = column.mean();
        column.add_scalar_mut(-mean);
    }
    matrix
}

/// Per column of `logged` after regression on `design`, scaled for the degrees of freedom.
pub(super) fn residual_squares(design: &DMatrix<f64>, logged: &DMatrix<f64>) -> DVector<f64> {
    const RIDGE: f64 = 1e-9;
    let mut normal = design.transpose() * design;
    let ridge = RIDGE * normal.trace().max(f64::MIN_POSITIVE);
    (0..normal.nrows()).for_each(|at| normal[(at, at)] += ridge);
    let right = design.transpose() * logged;
    let own = |column: usize| logged.column(column).norm_squared();
    let free = (logged.nrows() as f64 / (logged.nrows() as f64 - 13.0)).max(1.0);
    match normal.cholesky() {
        Some(factor) => {
            let solved = factor.l().solve_lower_triangular(&right).unwrap_or(right * 0.0);
            DVector::from_fn(logged.ncols(), |column, _| {
                free * (own(column) - solved.column(column).norm_squared()).max(0.0)
            })
        }
        None => DVector::from_fn(logged.ncols(), |column, _| own(column)),
    }
}
