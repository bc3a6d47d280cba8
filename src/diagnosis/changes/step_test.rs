//! Score test for a step of a frame at any time: finds steps within the noise, which no single sample shows.

use super::frame_columns::{CONSTANT, Frame, FrameColumns};
use super::jumps::Jump;
use crate::PoseDiagnosis;
use crate::priors::price;
use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::solver::linear::{Linear, Normal, Weight};
use nalgebra::{DVector, SMatrix, SVector};

type Matrix = SMatrix<f64, CONSTANT, CONSTANT>;
type Vector = SVector<f64, CONSTANT>;

/// Columns of a step, and of both.
const STEP: usize = 6;
const WIDTH: usize = CONSTANT + STEP;

/// Sums over the samples before each sample, and over all.
struct PrefixSums {
    matrix: Vec<Matrix>,
    right: Vec<Vector>,
}

impl PrefixSums {
    fn new(linear: &Linear, weights: &[Weight]) -> Self {
        let (mut matrix, mut right) = (vec![Matrix::zeros()], vec![Vector::zeros()]);
        for sample in 0..linear.len() {
            let (mut squares, mut products) = (Matrix::zeros(), Vector::zeros());
            for row in 0..6 {
                let derivatives = Vector::from_column_slice(linear.row(sample, row));
                let weight = weights[row / 3].component(sample);
                squares.ger(weight, &derivatives, &derivatives, 1.0);
                products.axpy(weight * linear.residual(sample, row), &derivatives, 1.0);
            }
            matrix.push(matrix[sample] + squares);
            right.push(right[sample] + products);
        }
        Self { matrix, right }
    }

    /// Reduction of the cost by a step of `frame` before `sample`, in excess of constant frames.
    fn gain(&self, sample: usize, frame: Frame) -> f64 {
        let last = self.matrix.len() - 1;
        let (all, later) = (&self.matrix[last], self.matrix[last] - self.matrix[sample]);
        let later_right = self.right[last] - self.right[sample];
        let own = frame.columns();
        let mut matrix = SMatrix::<f64, WIDTH, WIDTH>::zeros();
        let mut right = SVector::<f64, WIDTH>::zeros();
        matrix.fixed_view_mut::<CONSTANT, CONSTANT>(0, 0).copy_from(all);
        right.fixed_rows_mut::<CONSTANT>(0).copy_from(&self.right[last]);
        let of_step = later.fixed_columns::<STEP>(own.start);
        matrix.fixed_view_mut::<CONSTANT, STEP>(0, CONSTANT).copy_from(&of_step);
        matrix.fixed_view_mut::<STEP, CONSTANT>(CONSTANT, 0).copy_from(&of_step.transpose());
        let both = of_step.fixed_rows::<STEP>(own.start);
        matrix.fixed_view_mut::<STEP, STEP>(CONSTANT, CONSTANT).copy_from(&both);
        right
            .fixed_rows_mut::<STEP>(CONSTANT)
            .copy_from(&later_right.fixed_rows::<STEP>(own.start));
        explained(matrix, right) - explained(*all, self.right[last])
    }
}

/// Reduction of the cost by the best step in parameters. Unobservable directions count little.
fn explained<const N: usize>(mut matrix: SMatrix<f64, N, N>, right: SVector<f64, N>) -> f64 {
    const RIDGE: f64 = 1e-9;
    let scale = matrix.diagonal();
    for i in 0..N {
        matrix[(i, i)] += RIDGE * scale[i] + f64::MIN_POSITIVE;
    }
    matrix.cholesky().map_or(0.0, |cholesky| right.dot(&cholesky.solve(&right)))
}

/// The likeliest step of a frame of the stream, if the likelihood justifies one. Its strength is relative to the price
/// of a step's parameters.
pub(super) fn likeliest_step(diagnosis: &PoseDiagnosis) -> Option<Jump> {
    /// In the log-likelihood, of the 95 % interval of its time.
    const TIME_TOLERANCE: f64 = 1.92;
    let columns = FrameColumns::new(diagnosis);
    let rows: Vec<usize> = columns.samples().collect();
    if rows.len() < 2 * MIN_SEGMENT_SAMPLES {
        return None;
    }
    let candidates = MIN_SEGMENT_SAMPLES..rows.len() - MIN_SEGMENT_SAMPLES;
    let best = |sums: &PrefixSums| {
        let of = |sample: usize| Frame::BOTH.map(|frame| (sums.gain(sample, frame), sample, frame));
        candidates.clone().flat_map(of).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let constant = columns.linearize(CONSTANT, |_| None);
    let (_, sample, frame) = best(&PrefixSums::new(&constant, &constant.first_weights()))?;
    // The noise without that step.
    let at_s = columns.aligned.t_s[rows[sample]];
    let with_step =
        columns.linearize(WIDTH, |t_s| Some((frame, if t_s < at_s { 0.0 } else { 1.0 })));
    let all: Vec<usize> = (0..WIDTH).collect();
    let mut normal = Normal::zeros(WIDTH);
    with_step.accumulate(&with_step.first_weights(), &all, &mut normal);
    let step = normal.step(&DVector::zeros(WIDTH), &all);
    let weights = with_step.weights_after(step.as_slice());
    let sums = PrefixSums::new(&constant, &weights);
    let (gain, sample, frame) = best(&sums)?;
    let mut normal = Normal::zeros(WIDTH);
    with_step.accumulate(&weights, &all, &mut normal);
    let price = price(normal.independent) * STEP as f64;
    if gain < price {
        return None;
    }
    let is_likely = |at: &usize| sums.gain(*at, frame) > gain - 2.0 * TIME_TOLERANCE;
    let first = candidates.clone().take_while(|&at| at < sample).find(is_likely).unwrap_or(sample);
    let last = candidates.rev().take_while(|&at| at > sample).find(is_likely).unwrap_or(sample);
    let t_s = |sample: usize| columns.aligned.t_s[rows[sample]];
    Some(Jump {
        at_s: 0.5 * (t_s(sample - 1) + t_s(sample)),
        within_s: 0.5 * (t_s(last) - t_s(first - 1)),
        strength: gain / price,
        window_s: 0.0,
    })
}
