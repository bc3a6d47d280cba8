//! Score test for a step of a frame or the latency at any time: finds steps within the noise, which no single sample
//! shows.

use super::frame_columns::{CONSTANT, Frame, FrameColumns, LATENCY};
use super::jumps::Jump;
use crate::PoseDiagnosis;
use crate::priors::price;
use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::solver::linear::{Linear, Normal, Weight};
use nalgebra::{DVector, SMatrix, SVector};
use std::ops::Range;

type Matrix = SMatrix<f64, CONSTANT, CONSTANT>;
type Vector = SVector<f64, CONSTANT>;

/// Columns that may step together.
const CAUSES: [Range<usize>; 3] =
    [Frame::Reference.columns(), Frame::Tool.columns(), LATENCY..LATENCY + 1];
/// Columns of constant causes and of a frame's step.
const MAX_WIDTH: usize = CONSTANT + 6;

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

    /// Reduction of the cost by a step of `columns` before `sample`, in excess of constant causes.
    fn gain(&self, sample: usize, columns: &Range<usize>) -> f64 {
        let last = self.matrix.len() - 1;
        let (all, later) = (&self.matrix[last], self.matrix[last] - self.matrix[sample]);
        let later_right = self.right[last] - self.right[sample];
        let mut matrix = SMatrix::<f64, MAX_WIDTH, MAX_WIDTH>::zeros();
        let mut right = SVector::<f64, MAX_WIDTH>::zeros();
        matrix.fixed_view_mut::<CONSTANT, CONSTANT>(0, 0).copy_from(all);
        right.fixed_rows_mut::<CONSTANT>(0).copy_from(&self.right[last]);
        for (at, column) in (CONSTANT..).zip(columns.clone()) {
            for other in 0..CONSTANT {
                let product = later[(other, column)];
                (matrix[(other, at)], matrix[(at, other)]) = (product, product);
            }
            for (other_at, other) in (CONSTANT..).zip(columns.clone()) {
                matrix[(at, other_at)] = later[(column, other)];
            }
            right[at] = later_right[column];
        }
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

/// The likeliest step of the stream, if the likelihood justifies one. Its strength is relative to the price of its
/// parameters.
pub(super) fn likeliest_step(diagnosis: &PoseDiagnosis) -> Option<Jump> {
    /// In the log-likelihood, of the 95 % interval of its time.
    const TIME_TOLERANCE: f64 = 1.92;
    let columns = FrameColumns::new(diagnosis);
    let rows: Vec<usize> = columns.samples().collect();
    if rows.len() < 2 * MIN_SEGMENT_SAMPLES {
        return None;
    }
    let candidates = MIN_SEGMENT_SAMPLES..rows.len() - MIN_SEGMENT_SAMPLES;
    let best = |sums: &PrefixSums, price: f64| {
        // The time is a parameter, too.
        let score = |sample: usize, step: Range<usize>| {
            let score = sums.gain(sample, &step) - price * (step.len() + 1) as f64;
            (score, sample, step)
        };
        let of = |sample: usize| CAUSES.map(|step| score(sample, step));
        candidates.clone().flat_map(of).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let constant = columns.linearize(CONSTANT, |_| None);
    let normal_equations = |linear: &Linear, weights: &[Weight]| {
        let all: Vec<usize> = (0..linear.width).collect();
        let mut normal = Normal::zeros(linear.width);
        linear.accumulate(weights, &all, &mut normal);
        normal
    };
    let weights = constant.first_weights();
    let price_of =
        |linear: &Linear, weights: &[Weight]| price(normal_equations(linear, weights).independent);
    let (_, sample, step) =
        best(&PrefixSums::new(&constant, &weights), price_of(&constant, &weights))?;
    // The noise without that step.
    let at_s = columns.aligned.t_s[rows[sample]];
    let with_step = columns.linearize(CONSTANT + step.len(), |t_s| {
        Some((step.clone(), if t_s < at_s { 0.0 } else { 1.0 }))
    });
    let all: Vec<usize> = (0..with_step.width).collect();
    let fit = normal_equations(&with_step, &with_step.first_weights())
        .step(&DVector::zeros(with_step.width), &all);
    let weights = with_step.weights_after(fit.as_slice());
    let price = price_of(&with_step, &weights);
    let sums = PrefixSums::new(&constant, &weights);
    let (score, sample, step) = best(&sums, price)?;
    if score < 0.0 {
        return None;
    }
    let gain = sums.gain(sample, &step);
    let is_likely = |at: &usize| sums.gain(*at, &step) > gain - 2.0 * TIME_TOLERANCE;
    let first = candidates.clone().take_while(|&at| at < sample).find(is_likely).unwrap_or(sample);
    let last = candidates.rev().take_while(|&at| at > sample).find(is_likely).unwrap_or(sample);
    let t_s = |sample: usize| columns.aligned.t_s[rows[sample]];
    Some(Jump {
        at_s: 0.5 * (t_s(sample - 1) + t_s(sample)),
        within_s: 0.5 * (t_s(last) - t_s(first - 1)),
        strength: gain / (price * (step.len() + 1) as f64),
        window_s: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::diagnose_arm;
    use crate::test_motion;
    use crate::test_random::Lcg;
    use ground::geometry::Vec3;
    use ground::stream::{Orientations, PoseTrack};

    /// Likeliest step of 20 s of poses with 5 mm of noise, whose latency and tool depend on time.
    fn likeliest_step_of(
        latency_s: impl Fn(f64) -> f64,
        tool_m: impl Fn(f64) -> f64,
    ) -> Option<Jump> {
        let (joints, chain) = test_motion::arm();
        let mut random = Lcg::new();
        let (mut q, mut qd, mut cursor) = (vec![0.0; 6], vec![0.0; 6], 0);
        let (mut t_s, mut xyz, mut rotations) = (Vec::new(), Vec::new(), Vec::new());
        for at_s in (10..980).map(|row| f64::from(row) * 0.02) {
            assert!(joints.at(at_s - latency_s(at_s), &mut cursor, &mut q, &mut qd));
            let pose = chain.forward(&q);
            let tip = pose * nalgebra::Point3::new(0.0, tool_m(at_s), 0.0);
            t_s.push(at_s);
            xyz.push(tip.coords + Vec3::from(random.triple(5e-3)));
            rotations.push(pose.rotation);
        }
        let orientation = Orientations::Rotations(rotations);
        let track = PoseTrack { t_s, xyz, orientation, declared: None };
        let stream = test_motion::tip_stream(&track, &chain);
        likeliest_step(&diagnose_arm(&joints, &[stream], 1.0).streams[0])
    }

    #[test]
    fn a_step_within_the_noise_is_dated() {
        let after = |t_s: f64, size: f64| if t_s > 12.0 { size } else { 0.0 };
        for step in [
            likeliest_step_of(|t_s| after(t_s, 0.02), |_| 0.0),
            likeliest_step_of(|_| 0.0, |t_s| after(t_s, 4e-3)),
        ] {
            let step = step.expect("a step");
            assert!((step.at_s - 12.0).abs() < 0.5, "{step:?}");
        }
        assert_eq!(likeliest_step_of(|_| 0.01, |_| 2e-3), None);
    }
}
