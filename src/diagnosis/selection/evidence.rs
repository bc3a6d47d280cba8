//! The criterion between two diagnoses of one run: constant causes, change points, drifts or joint compliance.
//!
//! Twice the log Bayes factor, approximated as by Schwarz (1978, *Estimating the Dimension of a Model*): twice the
//! log-likelihood ratio of the residuals, minus [`price`] for each additional parameter. Autocorrelation reduces the
//! number of independent samples, so the systematic residual of a wrong model counts as few. Residuals below the link
//! deviations of the arm, if either diagnosis estimates them, distinguish nothing.

use crate::priors::{MODEL_ERROR_M, RAD_PER_M, price};
use crate::residuals::comparison::residual_vectors;
use crate::solver::noise::Noise;
use crate::{ArmDiagnosis, EncodingSpans, JointCompliance, JointDiagnosis, PoseDiagnosis};
use ground::geometry::Vec3;

/// Residual of a stream that does not follow the arm, m and rad.
const SIGMA_UNEXPLAINED: f64 = 1.0;

/// Twice the log Bayes factor of `one` over `other`.
pub(crate) fn log_bayes_factor(one: &ArmDiagnosis, other: &ArmDiagnosis) -> f64 {
    let (gain, independent) = log_likelihood_ratio(one, other);
    gain - price(independent) * (parameter_count(one) as f64 - parameter_count(other) as f64)
}

/// Whether `one` is as likely as `other`, whatever their numbers of parameters.
pub(crate) fn fits_as_well(one: &ArmDiagnosis, other: &ArmDiagnosis) -> bool {
    log_likelihood_ratio(one, other).0 >= 0.0
}

/// The likeliest of several diagnoses of one run.
pub(crate) fn likeliest(diagnoses: impl IntoIterator<Item = ArmDiagnosis>) -> Option<ArmDiagnosis> {
    let likelier = |best, one| if log_bayes_factor(&one, &best) > 0.0 { one } else { best };
    diagnoses.into_iter().reduce(likelier)
}

/// Twice the log-likelihood ratio of `one` to `other`, and the number of independent samples.
fn log_likelihood_ratio(one: &ArmDiagnosis, other: &ArmDiagnosis) -> (f64, f64) {
    /// A longer correlation comes from the motion.
    const MAX_CORRELATION_SAMPLES: f64 = 200.0;
    let (mut gain, mut independent) = (0.0, 0.0);
    for (one, other) in one.streams.iter().zip(&other.streams) {
        let link_m = [one.link_m, other.link_m].into_iter().flatten().fold(MODEL_ERROR_M, f64::max);
        for (one, other) in noises(one, link_m).into_iter().zip(noises(other, link_m)) {
            let (samples, better) = if one.1.sigma < other.1.sigma { one } else { other };
            let inflation = better.inflation().clamp(1.0, MAX_CORRELATION_SAMPLES);
            let samples = 3.0 * samples as f64 / inflation;
            independent += samples;
            gain += 2.0 * samples * (other.1.sigma / one.1.sigma).ln();
        }
    }
    (gain, independent)
}

/// Numbers of samples, and noise of positions, m, and rotations, rad, including link deviations of this size.
fn noises(stream: &PoseDiagnosis, link_m: f64) -> [(usize, Noise); 2] {
    let follows = stream.followed_residual().is_some();
    let [positions, rotations] = residual_vectors(stream);
    let noise = |residuals: Vec<Vec3>, model_error: f64, is_explained: bool| {
        let mut noise = Noise::unweighted(&residuals, 0.0);
        noise.sigma = if is_explained { noise.sigma.hypot(model_error) } else { SIGMA_UNEXPLAINED };
        (residuals.len(), noise)
    };
    [
        noise(positions, link_m, follows),
        noise(rotations, RAD_PER_M * link_m, follows && stream.encoding.is_ok()),
    ]
}

/// Without latencies, and encodings other than scales and couplings, that hold for the whole run.
fn parameter_count(diagnosis: &ArmDiagnosis) -> usize {
    let JointDiagnosis { encoding, scales, changes, compliance, partial_encoding, .. } =
        &diagnosis.joints;
    diagnosis.joints.chosen_zeros()
        + scales.len()
        + encoding.as_ref().map_or(0, |encoding| encoding.couplings.len())
        + 2 * changes.len()
        + compliance.iter().map(JointCompliance::parameters).sum::<usize>()
        + usize::from(partial_encoding.is_some())
        + diagnosis.streams.iter().map(stream_parameter_count).sum::<usize>()
}

fn stream_parameter_count(stream: &PoseDiagnosis) -> usize {
    const FRAME: usize = 6;
    let EncodingSpans { rotation, degrees, length, axes } = stream.encoding_spans;
    let steps = stream.latency_profile.as_ref().map_or(0, |profile| profile.steps.len());
    FRAME * stream.chosen_frames()
        + (FRAME + 1) * (stream.tool_changes.len() + stream.reference_changes.len())
        + usize::from(stream.is_skew_chosen)
        + usize::from(stream.is_radial_scale_chosen)
        + 2 * (stream.radial_scale_changes.len() + steps)
        + 2 * [rotation, degrees, length, axes].into_iter().flatten().count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::diagnose_arm;
    use crate::test_motion;
    use crate::test_random::Lcg;

    #[test]
    fn a_smaller_residual_is_likelier_and_a_parameter_has_its_price() {
        let (joints, chain) = test_motion::arm();
        let mut random = Lcg::new();
        let noisy = |q: &[f64]| {
            let pose = chain.forward(q);
            (pose.translation.vector + Vec3::from(random.triple(1e-3)), pose.rotation)
        };
        let track = test_motion::pose_track(&joints.t_s, joints.q.chunks(6).map(noisy));
        let stream = test_motion::tip_stream(&track, &chain);
        let healthy = diagnose_arm(&joints, &[stream], 1.0);
        let mut off = healthy.clone();
        for pose in &mut off.streams[0].aligned.corrected {
            pose.translation.vector.x += 3e-3;
        }
        let factor = log_bayes_factor(&healthy, &off);
        assert!(factor > 100.0, "{factor}");
        assert_eq!(factor, -log_bayes_factor(&off, &healthy));
        let mut skewed = healthy.clone();
        skewed.streams[0].is_skew_chosen = true;
        let independent = log_likelihood_ratio(&skewed, &healthy).1;
        assert_eq!(log_bayes_factor(&skewed, &healthy), -price(independent));
    }
}
