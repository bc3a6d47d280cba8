//! Residual of a corrected stream, with a test of whether it exceeds noise.
//!
//! Model errors repeat with the configuration, correlated noise does not. The test is a cross-validation:
//! small changes of all link frames, fitted to three quarters of the log, predict the residual of the rest.

use crate::model::jacobian::pose_changes;
use crate::model::measurement::StreamAt;
use crate::samples::sampling::check_sample_count;
use crate::selection::nominal_model::{FreeAlongside, link_frames};
use crate::solver::linear::{Linear, Normal};
use crate::solver::noise::{Noise, mean_square, rms};
use crate::{AlignedSamples, EstimateResult, Measured, StreamResidual};
use ground::geometry::Vec3;
use ground::stats::mean;
use nalgebra::DVector;

/// For the link frames.
const MAX_SAMPLES: usize = 1000;
/// For link frame changes, m and rad.
const DAMPING_SCALE: f64 = 0.01;
/// Cross-validation folds.
const FOLDS: usize = 4;
/// Fewer folds if noise is correlated for longer.
const BLOCK_COUNTS: std::ops::RangeInclusive<usize> = 8..=20;
/// Below this the correlation is chance, for 95 % of chance correlations even with few blocks.
const CHANCE_STD_ERRORS: f64 = 2.0;

/// Residual of `aligned` beyond the noise, in the estimated state of the stream.
pub(crate) fn excess_residual(
    aligned: &AlignedSamples,
    stream: StreamAt,
) -> EstimateResult<StreamResidual> {
    check_sample_count(aligned.t_s.len(), 8)?;
    let [residual_m, residual_rad] = aligned.residuals(stream.state.tool.translation.vector);
    let [before_m, before_rad] = pose_changes(&aligned.fk, &aligned.logged);
    let [common_m, common_rad] = fold_correlation(stream);
    Ok(StreamResidual {
        excess_m: excess(&residual_m, &common_m),
        excess_rad: excess(&residual_rad, &common_rad),
        rms_m: rms(&residual_m),
        rms_rad: rms(&residual_rad),
        before_m: rms(&before_m),
        before_rad: rms(&before_rad),
    })
}

/// Rms beyond the noise between samples (half the mean squared successive difference, von Neumann 1941).
/// The standard error, from the scatter over blocks, is raised until the value is no more significant than
/// the correlation `in_common` with the prediction.
fn excess(vectors: &[Vec3], in_common: &Measured) -> Measured {
    let blocks = 20.min(vectors.len() / 2).max(1);
    let size = vectors.len() / blocks;
    let noise_free: Vec<f64> = vectors.chunks_exact(size).map(excess_square).collect();
    let Measured { value, std_error: by_spread, .. } = square_root(mean_of(&noise_free));
    let distance = in_common.value / in_common.std_error.max(f64::MIN_POSITIVE);
    Measured {
        value,
        std_error: by_spread.max(value / distance.max(CHANCE_STD_ERRORS)),
        dof: in_common.dof,
    }
}

/// Mean square beyond the noise between samples.
pub(crate) fn excess_square(block: &[Vec3]) -> f64 {
    let steps: Vec<Vec3> = block.windows(2).map(|w| w[1] - w[0]).collect();
    mean_square(block) - 0.5 * mean_square(&steps)
}

/// Root of a mean square. d(√x) = dx / 2√x, limited to √dx near zero.
pub(crate) fn square_root(Measured { value: square, std_error, dof }: Measured) -> Measured {
    let value = square.max(0.0).sqrt();
    let std_error = (std_error / (2.0 * value).max(std_error.sqrt())).max(1e-9);
    Measured { value, std_error, dof }
}

/// The standard error is infinite for fewer than two values.
pub(crate) fn mean_of(values: &[f64]) -> Measured {
    let n = values.len() as f64;
    let mean = mean(values.iter().copied());
    let spread =
        values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let std_error = if n < 2.0 { f64::INFINITY } else { (spread / n).sqrt() };
    Measured { value: mean, std_error, dof: (n - 1.0).max(1.0) }
}

/// Correlation of each fold's residual with the prediction from the other folds, −1 to 1, for position and
/// rotation.
fn fold_correlation(stream: StreamAt) -> [Measured; 2] {
    let rows: Vec<usize> = stream.observations.rows(MAX_SAMPLES).collect();
    let linearized =
        |rows: &[usize]| link_frames(stream, rows.iter().copied(), FreeAlongside::Nothing);
    let folds: Vec<Linear> =
        rows.chunks(rows.len().div_ceil(FOLDS).max(1)).map(linearized).collect();
    let normals: Vec<Normal> =
        folds.iter().map(|fold| fold.normal(&fold.first_weights())).collect();
    let predicted = |fold: usize| {
        let mut normal = Normal::zeros(folds[fold].width);
        for (_, other) in normals.iter().enumerate().filter(|(other, _)| *other != fold) {
            normal += other.clone();
        }
        for i in 0..normal.right.len() {
            normal.matrix[(i, i)] += DAMPING_SCALE.powi(-2);
        }
        normal.full_step()
    };
    let steps: Vec<DVector<f64>> = (0..folds.len()).map(predicted).collect();
    [0, 1].map(|kind| {
        let mut pairs = Vec::new();
        for (fold, step) in folds.iter().zip(&steps) {
            let after = fold.residuals_after(step.as_slice()).swap_remove(kind);
            let residuals = fold.residual[kind].iter().zip(after);
            pairs.extend(residuals.map(|(&residual, after)| (residual, residual - after)));
        }
        correlation(&pairs)
    })
}

/// Mean over blocks. Each is at least twice as long as the first series' correlation.
fn correlation(pairs: &[(Vec3, Vec3)]) -> Measured {
    let residuals: Vec<Vec3> = pairs.iter().map(|pair| pair.0).collect();
    let noise = Noise::unweighted(&residuals, f64::MIN_POSITIVE);
    let lasting = 2.0 * noise.inflation();
    let blocks = (pairs.len() as f64 / lasting) as usize;
    let blocks = blocks.clamp(*BLOCK_COUNTS.start(), *BLOCK_COUNTS.end());
    let of_block = |block: &[(Vec3, Vec3)]| {
        let sum = |product: &dyn Fn(&Vec3, &Vec3) -> f64| -> f64 {
            block.iter().map(|(residual, predicted)| product(residual, predicted)).sum()
        };
        let squares = sum(&|a, _| a.norm_squared()) * sum(&|_, b| b.norm_squared());
        sum(&|a, b| a.dot(b)) / squares.sqrt().max(f64::MIN_POSITIVE)
    };
    let size = pairs.len().div_ceil(blocks).max(1);
    mean_of(&pairs.chunks(size).map(of_block).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose_arm;
    use crate::test_motion;
    use crate::test_random::Lcg;
    use ground::geometry::{pose, rotation_from_rotvec};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn wandering(n: usize, seed: u64) -> Vec<Vec3> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut state = Vec3::zeros();
        let mut next = || {
            state = state.map(|s| {
                let innovation: f64 = StandardNormal.sample(&mut rng);
                0.95 * s + 0.31 * innovation
            });
            state
        };
        (0..n).map(|_| next()).collect()
    }

    fn reaches_zero(vectors: &[Vec3], predicted: &[Vec3]) -> bool {
        let pairs: Vec<_> = vectors.iter().copied().zip(predicted.iter().copied()).collect();
        excess(vectors, &correlation(&pairs)).interval(0.95)[0] <= 0.0
    }

    #[test]
    fn autocorrelated_noise_is_no_excess_and_a_predicted_residual_is() {
        let covered = (0..40)
            .filter(|&seed| reaches_zero(&wandering(1000, seed), &wandering(1000, 1000 + seed)));
        assert!(covered.count() >= 35);
        let predicted = wandering(1000, 7);
        let noise = wandering(1000, 8);
        let mixed: Vec<Vec3> = predicted.iter().zip(&noise).map(|(f, n)| f + 0.2 * n).collect();
        assert!(!reaches_zero(&mixed, &predicted));
    }

    #[test]
    fn a_distant_marker_with_noisy_rotations_has_the_noise_of_its_own_position() {
        let (joints, chain) = test_motion::arm();
        let marker = pose([0.0, 0.2, 0.1], rotation_from_rotvec(Vec3::new(0.3, -0.2, 0.5)));
        let mut random = Lcg::new();
        let logged = joints.q.chunks(6).map(|q| {
            let [shift, turn] = [1e-4, 1e-2].map(|size| Vec3::from(random.triple(size)));
            let pose = chain.forward(q) * marker;
            (pose.translation.vector + shift, rotation_from_rotvec(turn) * pose.rotation)
        });
        let track = test_motion::pose_track(&joints.t_s, logged);
        let found = diagnose_arm(&joints, &[test_motion::tip_stream(&track, &chain)], 1.0);
        let residual = found.streams[0].residual.as_ref().expect("a residual");
        assert!(residual.rms_m < 3e-4 && residual.rms_rad > 5e-3, "{residual:?}");
    }

    #[test]
    fn a_zero_residual_is_zero_and_not_nan() {
        let vectors = vec![Vec3::zeros(); 40];
        let pairs = vec![(Vec3::zeros(), Vec3::zeros()); 40];
        let found = excess(&vectors, &correlation(&pairs));
        assert!(found.value == 0.0 && found.interval(0.95).iter().all(|end| end.is_finite()));
    }
}
