//! How much is left of a run, and whether what changes in it explains enough.

use super::PART_SAMPLES;
use crate::explain::price;
use crate::model::{FLOOR_M, FLOOR_RAD};
use crate::noise::Noise;
use crate::proof::{Part, Series, Size};
use crate::{Aligned, ArmDiagnosis, PoseDiagnosis, Unseen};
use ground::geometry::{Vec3, rotvec_from_rotation};

/// With the changes undone at most this share is left of what was; more where they are worth it all the same.
pub(super) const LEFT: f64 = 0.85;
/// Where so little is left nothing else is asked.
const LITTLE_LEFT: f64 = 0.5;
/// Less than this is left of a healthy stream, m and rad.
const LITTLE: [f64; 2] = [0.3e-3, 0.5e-3];

/// Whether what was found on a stream leaves more of it than its noise, in some part of the run.
pub(crate) fn leaves_much(found: &PoseDiagnosis) -> bool {
    /// So many times the noise is more than noise.
    const TIMES: f64 = 2.0;
    let aligned = &found.aligned;
    let does_not_follow = matches!(found.reading, Err(Unseen::DoesNotFollow(_)));
    if does_not_follow || aligned.t_s.len() < PART_SAMPLES {
        return does_not_follow
            || found.unread().is_some_and(|why| matches!(why, Unseen::DoesNotFollow(_)));
    }
    let moves = vec![true; aligned.t_s.len()];
    let has_rotation = found.reading.is_ok();
    let series = Series::of(&aligned.t_s, &aligned.corrected, &aligned.fk_at_truth, has_rotation);
    let error = series.error(&moves, true);
    let is_much = |(size, least): (&Size, f64)| {
        size.parts.iter().any(|Part { amount, .. }| {
            let noise = amount.noise.map_or(0.0, |noise| noise.rms);
            amount.rms > least.max(TIMES * noise)
        })
    };
    std::iter::once(&error.length).chain(&error.angle).zip(LITTLE).any(is_much)
}

/// Whether the latency of a stream surely jumps.
pub(crate) fn jumps_in_time(found: &PoseDiagnosis) -> bool {
    found.course.as_ref().is_ok_and(|course| course.is_unsteady && !course.jumps.is_empty())
}

/// All that is left of an arm's streams, an angle counting at 0.3 m; a metre where one was not read.
pub(crate) fn left_m(found: &ArmDiagnosis) -> f64 {
    let left = |found: &PoseDiagnosis| match (&found.residual, &found.reading) {
        (Ok(residual), Ok(_)) => residual.together_m(),
        _ => 1.0,
    };
    found.streams.iter().map(left).sum()
}

/// Whether what was found on a stream leaves more of it than its noise, or a mean in some part of the run that
/// noise does not have.
pub(super) fn leaves_slowly(found: &PoseDiagnosis) -> bool {
    /// Parts of the run.
    const PARTS: usize = 10;
    /// A mean is told from none by so many standard errors.
    const SURE: f64 = 6.0;
    if leaves_much(found) {
        return true;
    }
    let is_slow = |(left, (floor, little)): (Vec<[f64; 3]>, (f64, f64))| {
        let parts: Vec<&[[f64; 3]]> =
            left.chunks(left.len().div_ceil(PARTS).max(PART_SAMPLES)).collect();
        let beside_mean = |part: &&[[f64; 3]]| -> Vec<[f64; 3]> {
            let mean = mean(part);
            part.iter().map(|v| (Vec3::from(*v) - mean).into()).collect()
        };
        let beside: Vec<[f64; 3]> = parts.iter().flat_map(beside_mean).collect();
        let noise = Noise::of(&beside, &vec![1.0; beside.len()], floor);
        parts.iter().any(|part| {
            let variance = 3.0 * noise.sigma.powi(2) * noise.inflation() / part.len() as f64;
            mean(part).norm() > f64::max(little, SURE * variance.sqrt())
        })
    };
    let floors = [(FLOOR_M, LITTLE[0]), (FLOOR_RAD, LITTLE[1])];
    left(&found.aligned).into_iter().zip(floors).any(is_slow)
}

fn mean(vectors: &[[f64; 3]]) -> Vec3 {
    vectors.iter().map(|v| Vec3::from(*v)).sum::<Vec3>() / vectors.len().max(1) as f64
}

/// What is left of a stream's samples: of position, m, and of rotation, rad.
fn left(aligned: &Aligned) -> [Vec<[f64; 3]>; 2] {
    let both = || aligned.corrected.iter().zip(&aligned.fk_at_truth);
    let length = both().map(|(is, fk)| (is.translation.vector - fk.translation.vector).into());
    let turn =
        both().map(|(is, fk)| rotvec_from_rotation(&(is.rotation * fk.rotation.inverse())).into());
    [length.collect(), turn.collect()]
}

/// Whether changes that are told by so many `parameters` are worth it: they leave half at most, or the log is
/// so much likelier with them as these cost (after Chow 1960, with the price that causes have and the memory of
/// the noise that they leave, so that what a wrong model leaves counts as few samples).
pub(super) fn is_worth(before: &ArmDiagnosis, after: &ArmDiagnosis, parameters: usize) -> bool {
    /// More memory is that of a motion, samples.
    const MEMORY: f64 = 200.0;
    if left_m(after) <= LITTLE_LEFT * left_m(before) {
        return true;
    }
    if left_m(after) > LEFT * left_m(before) {
        return false;
    }
    let (mut gain, mut independent) = (0.0, 0.0);
    for (before, after) in before.streams.iter().zip(&after.streams) {
        let pairs = left(&before.aligned).into_iter().zip(left(&after.aligned));
        for ((before, after), floor) in pairs.zip([FLOOR_M, FLOOR_RAD]) {
            let noise = |left: &[[f64; 3]]| Noise::of(left, &vec![1.0; left.len()], floor);
            let (was, is) = (noise(&before), noise(&after));
            let samples = 3.0 * after.len().min(before.len()) as f64;
            let samples = samples / is.inflation().clamp(1.0, MEMORY);
            independent += samples;
            gain += 2.0 * samples * (was.sigma / is.sigma).ln();
        }
    }
    gain > price(independent) * parameters as f64
}
