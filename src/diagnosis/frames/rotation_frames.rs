//! Fits constant frames between two series of rotations.

use crate::model::measurement::stacked;
use crate::residuals::cause_columns::Frame;
use crate::solver::linear::Normal;
use crate::solver::minimize::{LeastSquares, Limits, minimize};
use ground::geometry::{Rotation, Vec3, rotation_by_wahba, rotation_from_rotvec};
use nalgebra::{DMatrix, DVector, Matrix3, Vector4};

/// Candidate rotations of every sample under one encoding.
#[derive(Default)]
pub(crate) struct CandidateRotations {
    ends: Vec<usize>,
    rotations: Vec<Rotation>,
}

impl CandidateRotations {
    pub fn of_sample(&self, sample: usize) -> &[Rotation] {
        let start = sample.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.rotations[start..self.ends[sample]]
    }

    /// Appends the next sample's candidates.
    pub fn push(&mut self, candidates: &[Rotation]) {
        self.rotations.extend_from_slice(candidates);
        self.ends.push(self.rotations.len());
    }
}

/// Nearest candidate, and the cosine of half its angle.
pub(crate) fn nearest(candidates: &[Rotation], expected: &Rotation) -> Option<(Rotation, f64)> {
    let mut best: Option<(&Rotation, f64)> = None;
    for candidate in candidates {
        let cosine = candidate.coords.dot(&expected.coords).abs();
        if best.is_none_or(|best| cosine >= best.1) {
            best = Some((candidate, cosine));
        }
    }
    best.map(|(candidate, cosine)| (*candidate, cosine))
}

/// Constant frame that best maps FK to the candidates. Tries several samples as anchors, because one may be
/// on a wrong branch.
pub(crate) fn fit_one_frame(
    candidates: &CandidateRotations,
    fk: &[Rotation],
    which: Frame,
) -> Rotation {
    let frame_at = |truth: &Rotation, fk: &Rotation| match which {
        Frame::Reference => truth * fk.inverse(),
        Frame::Tool => fk.inverse() * truth,
    };
    let apply = |frame: &Rotation, fk: &Rotation| match which {
        Frame::Reference => frame * fk,
        Frame::Tool => fk * frame,
    };
    let step = fk.len().div_ceil(4);
    let anchors = (0..fk.len())
        .step_by(step)
        .flat_map(|sample| candidates.of_sample(sample).iter().map(move |truth| (sample, truth)));
    // Sum of cosines. `None` if it cannot reach `least`, because a sample adds at most 1.
    let closeness = |frame: &Rotation, least: f64| -> Option<f64> {
        const TOLERANCE: f64 = 1e-9;
        let mut most = fk.len() as f64 + TOLERANCE;
        let mut sum = 0.0;
        for (sample, fk) in fk.iter().enumerate() {
            let cosine = nearest(candidates.of_sample(sample), &apply(frame, fk))
                .map_or(0.0, |(_, cosine)| cosine);
            (sum, most) = (sum + cosine, most + cosine - 1.0);
            if most < least {
                return None;
            }
        }
        Some(sum)
    };
    let mut best: Option<(f64, Rotation)> = None;
    for (sample, truth) in anchors {
        let frame = frame_at(truth, &fk[sample]);
        let least = best.map_or(f64::NEG_INFINITY, |best| best.0);
        if let Some(sum) = closeness(&frame, least).filter(|sum| sum.total_cmp(&least).is_ge()) {
            best = Some((sum, frame));
        }
    }
    let Some((_, mut frame)) = best else {
        return Rotation::identity();
    };
    for _ in 0..2 {
        let frames = fk.iter().enumerate().filter_map(|(sample, fk)| {
            let (truth, _) = nearest(candidates.of_sample(sample), &apply(&frame, fk))?;
            Some(frame_at(&truth, fk))
        });
        frame = mean_near(&frame, frames);
    }
    frame
}

/// Estimates reference and tool rotation together. The axes of relative rotations determine the reference
/// by Wahba's problem (`AX = XB`); the tool follows.
///
/// Park and Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", 1994; singular
/// value solution by Markley 1988. With a single rotation axis, noise alone determines the angle about it,
/// so Gauss–Newton steps on all samples follow.
pub(crate) fn fit_both_frames(
    candidates: &CandidateRotations,
    fk: &[Rotation],
) -> (Rotation, Rotation) {
    let first = |sample: usize| candidates.of_sample(sample).first().copied();
    let mut chosen: Vec<Option<Rotation>> = (0..fk.len()).map(first).collect();
    let (mut reference, mut tool) = (Rotation::identity(), Rotation::identity());
    for round in 0..3 {
        if round > 0 {
            let nearest = |(sample, fk): (usize, &Rotation)| {
                nearest(candidates.of_sample(sample), &(reference * fk * tool)).map(|n| n.0)
            };
            chosen = fk.iter().enumerate().map(nearest).collect();
        }
        reference = rotation_by_wahba(&relative_rotations(&chosen, fk));
        tool = tool_for(&chosen, fk, &reference);
    }
    const LIMITS: Limits = Limits { steps: 6, min_gain: 1e-6 };
    let pair = RotationPair { candidates: &chosen, fk };
    minimize(&pair, (reference, tool), LIMITS).map_or((reference, tool), |found| found.1)
}

/// Axis times the sine of half the angle. It maps between frames as the rotation vector does, at less
/// cost.
fn half_angle_vector(rotation: &Rotation) -> Vec3 {
    rotation.imag() * rotation.w.signum()
}

/// Correlation `Σ stream·FKᵀ` of relative rotations.
fn relative_rotations(truths: &[Option<Rotation>], fk: &[Rotation]) -> Matrix3<f64> {
    let stride = (fk.len() / 3).max(1);
    let pair = |a: usize| {
        let b = (a + stride) % fk.len();
        let (truth_a, truth_b) = truths[a].zip(truths[b])?;
        let by_stream = half_angle_vector(&(truth_b * truth_a.inverse()));
        let by_fk = half_angle_vector(&(fk[b] * fk[a].inverse()));
        Some(by_stream * by_fk.transpose())
    };
    (0..fk.len()).filter_map(pair).sum()
}

fn tool_for(truths: &[Option<Rotation>], fk: &[Rotation], reference: &Rotation) -> Rotation {
    let offset =
        |(truth, fk): (&Option<Rotation>, &Rotation)| Some((reference * fk).inverse() * (*truth)?);
    mean_rotation(&truths.iter().zip(fk).filter_map(offset).collect::<Vec<_>>())
}

/// Reference and tool rotation between FK and candidates.
struct RotationPair<'a> {
    candidates: &'a [Option<Rotation>],
    fk: &'a [Rotation],
}

impl LeastSquares for RotationPair<'_> {
    type State = (Rotation, Rotation);

    fn linearize(&self, (reference, tool): &Self::State) -> Option<Normal> {
        let (mut products, mut sum) = (Matrix3::zeros(), Vec3::zeros());
        let (mut weighted, mut count, mut cost) = (Vec3::zeros(), 0.0, 0.0);
        for (truth, fk) in self.candidates.iter().zip(self.fk) {
            let Some(truth) = truth else { continue };
            let predicted = reference * fk * tool;
            let residual = 2.0 * half_angle_vector(&(truth * predicted.inverse()));
            let hand = predicted.to_rotation_matrix();
            products += hand.matrix();
            sum += residual;
            weighted += hand.inverse() * residual;
            count += 1.0;
            cost += residual.norm_squared();
        }
        // The design of a sample is `[I, hand]`.
        let mut matrix = DMatrix::identity(6, 6) * count;
        matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&products);
        matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(&products.transpose());
        let right = DVector::from_row_slice(&stacked([sum, weighted]));
        Some(Normal { matrix, right, cost, independent: 0.0 })
    }

    fn moved(&self, (reference, tool): &Self::State, step: &[f64]) -> Self::State {
        let turn =
            |first: usize| rotation_from_rotvec(Vec3::from_column_slice(&step[first..first + 3]));
        (turn(0) * reference, tool * turn(3))
    }
}

/// Mean of similar rotations ([`mean_near`]).
pub(crate) fn mean_rotation(rotations: &[Rotation]) -> Rotation {
    let Some(first) = rotations.get(rotations.len() / 2) else {
        return Rotation::identity();
    };
    (0..2).fold(*first, |mean, _| mean_near(&mean, rotations.iter().copied()))
}

/// Mean of the unit quaternions with the signs nearest to `guess`. For similar rotations, it has the least
/// sum of squared distances (Markley et al., "Averaging quaternions", 2007).
fn mean_near(guess: &Rotation, rotations: impl Iterator<Item = Rotation>) -> Rotation {
    let signed = rotations.map(|one| one.coords * one.coords.dot(&guess.coords).signum());
    let sum: Vector4<f64> = signed.sum();
    if sum.norm_squared() == 0.0 { *guess } else { Rotation::new_normalize(sum.into()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::angle_between;

    #[test]
    fn frames_are_found_if_the_hand_turns_mostly_about_one_axis() {
        let rotvec = |seed: usize| {
            let part = |i: usize| ((seed * 37 + i * 101) % 89) as f64 / 89.0 - 0.5;
            Vec3::new(part(1), part(2), part(3)) * 4.0
        };
        for seed in 0..40 {
            let [reference, tool, axes] =
                [0, 1, 2].map(|k| rotation_from_rotvec(rotvec(3 * seed + k)));
            let fk: Vec<Rotation> = (0..60)
                .map(|k| {
                    let t = 0.21 * f64::from(k);
                    let turn =
                        Vec3::new(0.5 * t.sin(), 0.12 * (1.7 * t).cos(), 0.05 * (2.9 * t).sin());
                    axes * rotation_from_rotvec(turn)
                })
                .collect();
            let mut candidates = CandidateRotations::default();
            fk.iter().for_each(|fk| candidates.push(&[reference * fk * tool]));
            let (found, found_tool) = fit_both_frames(&candidates, &fk);
            let worst = fk.iter().enumerate().map(|(k, fk)| {
                angle_between(&candidates.of_sample(k)[0], &(found * fk * found_tool))
            });
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 1e-6, "seed {seed}: {worst} rad");
        }
    }
}
