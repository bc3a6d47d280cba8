//! Estimates the encoding of a stream's rotations.
//!
//! Each candidate (as logged, 443 misinterpretations, permuted quaternions, transposed) is compared with FK
//! on a few dozen samples, with and without constant frame errors. The simplest one near the smallest
//! residual wins. Frame-independent invariants do not suffice, because several encodings differ only by a
//! constant frame.

use crate::frames::rotation_frames::{CandidateRotations, fit_both_frames, fit_one_frame, nearest};
use crate::model::measurement::MAX_EXPLAINED_RAD;
use crate::priors::ZERO_PRIOR;
use crate::residuals::cause_columns::Frame;
use crate::samples::sampling::check_sample_count;
use crate::selection::nominal_model::MAX_TIP_CHANGE_RAD;
use crate::solver::robust::{kept_samples, trimmed_rms};
use crate::{EncodingEstimate, EstimateResult, NotObservable, PoseEncoding};
use ground::geometry::{
    Axes, Convention, QuaternionOrderError, Rotation, Vec3, angle_between,
    misinterpretation_classes, rotation_from_xyzw, xyzw_from_rotation,
};
use ground::stream::Orientations;
use rayon::prelude::*;

/// An accepted residual is within this ratio of the smallest.
const MAX_RESIDUAL_RATIO: f64 = 5.0;
/// A residual within this difference (0.05°) is accepted too.
pub(crate) const MAX_RESIDUAL_DIFFERENCE_RAD: f64 = 8.7e-4;
/// Link deviations rarely cancel to a smaller share in another encoding: a healthy arm whose tool points down has residuals
/// of 0.15° as logged and 0.02° inverted.
const MAX_LINK_RESIDUAL_RATIO: f64 = 20.0;
/// Above this, no candidate is accepted (20°).
pub(crate) const MAX_RESIDUAL_RAD: f64 = 0.35;

const MIN_SCREENING_SAMPLES: usize = 16;
const SCREENING_ERROR_FACTOR: f64 = 1.5;
/// Best candidates to report, besides the selected and the logged encoding.
const MAX_RANKED: usize = 6;
/// Candidates fitted at a time, the nearest first.
const MIN_FITTED: usize = 16;

/// Cosine of the largest tilt of an upright world (10°).
const MIN_UPRIGHT_COSINE: f64 = 0.985;

/// A tilt of gravity and gyro axes other than the orientation's are further faults.
const CONTRADICTION_RANK_PENALTY: u8 = 2;

/// Samples with FK at the same times.
pub(crate) struct RotationSamples<'a> {
    pub logged: LoggedRotations<'a>,
    pub fk: &'a [Rotation],
    /// Frame errors to fit; only the first is faultless.
    pub frames: &'static [FreeFrameErrors],
    /// Whether components may be permuted.
    pub are_quaternions: bool,
    /// Whether rotations are as logged.
    pub only_as_logged: bool,
}

impl<'a> RotationSamples<'a> {
    /// Quaternions in standard axes. The reference may have an error.
    pub fn new(logged: LoggedRotations<'a>, fk: &'a [Rotation], reference_known: bool) -> Self {
        Self {
            logged,
            fk,
            frames: if reference_known { &FreeFrameErrors::ALL } else { &FreeFrameErrors::UNKNOWN },
            are_quaternions: true,
            only_as_logged: false,
        }
    }
}

/// Logged rotations, with the axes and the inversion that positions determine.
#[derive(Clone, Copy)]
pub(crate) struct LoggedRotations<'a> {
    pub values: LoggedValues<'a>,
    /// From the stream's axes to standard ones, by conjugation after decoding. `None` for standard axes.
    conjugator: Option<Rotation>,
    /// Whether whole poses are inverted.
    is_inverted: bool,
}

#[derive(Clone, Copy)]
pub(crate) enum LoggedValues<'a> {
    Rotations(&'a [Rotation]),
    Numbers(&'a [[f64; 3]]),
}

impl<'a> LoggedRotations<'a> {
    /// In standard axes, of poses that are not inverted.
    pub fn new(rotations: &'a [Rotation]) -> Self {
        let values = LoggedValues::Rotations(rotations);
        Self { values, conjugator: None, is_inverted: false }
    }

    pub fn from_orientations(orientation: &'a Orientations) -> Self {
        match orientation {
            Orientations::Rotations(rotations) => Self::new(rotations),
            Orientations::Numbers(all) => {
                Self { values: LoggedValues::Numbers(all), ..Self::new(&[]) }
            }
            Orientations::Unset(_) => Self::new(&[]),
        }
    }

    pub fn with_axes(self, axes: Axes, is_inverted: bool) -> Self {
        let conjugator = (axes != Axes::STANDARD).then(|| axes.conjugator());
        Self { conjugator, is_inverted, ..self }
    }

    fn len(&self) -> usize {
        match self.values {
            LoggedValues::Rotations(rotations) => rotations.len(),
            LoggedValues::Numbers(numbers) => numbers.len(),
        }
    }

    /// Possible true rotations of a sample in an encoding.
    fn decode(&self, encoding: PoseEncoding, sample: usize) -> Vec<Rotation> {
        let mut decoded = Vec::new();
        match (encoding, self.values) {
            (PoseEncoding::Numbers(convention), LoggedValues::Numbers(numbers)) => {
                decoded.push(convention.rotation(numbers[sample]));
            }
            (_, LoggedValues::Numbers(_)) => {}
            (_, LoggedValues::Rotations(all)) => {
                encoding.true_rotations(&all[sample], &mut decoded)
            }
        }
        for rotation in &mut decoded {
            if let Some(conjugator) = self.conjugator {
                *rotation = conjugator.inverse() * *rotation * conjugator;
            }
            if self.is_inverted {
                *rotation = rotation.inverse();
            }
        }
        decoded
    }

    /// Of the possible true rotations of a sample, the one nearest to `expected`.
    pub fn nearest(
        &self,
        encoding: PoseEncoding,
        sample: usize,
        expected: &Rotation,
    ) -> Option<Rotation> {
        nearest(&self.decode(encoding, sample), expected).map(|(rotation, _)| rotation)
    }

    /// Reported encoding if whole poses are inverted.
    fn reported_encoding(&self, encoding: PoseEncoding) -> PoseEncoding {
        match encoding {
            PoseEncoding::AsLogged if self.is_inverted => PoseEncoding::Inverted,
            PoseEncoding::Transposed if self.is_inverted => PoseEncoding::AsLogged,
            encoding => encoding,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FreeFrameErrors {
    None,
    Tool,
    Reference,
    Both,
}

impl FreeFrameErrors {
    pub const ALL: [Self; 4] = [Self::None, Self::Tool, Self::Reference, Self::Both];
    /// If the reference has no error.
    pub const OF_TOOL: [Self; 2] = [Self::None, Self::Tool];
    /// If the reference is unknown, so that its rotation is not a fault.
    const UNKNOWN: [Self; 2] = [Self::Reference, Self::Both];

    pub fn frame_count(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Tool | Self::Reference => 1,
            Self::Both => 2,
        }
    }
}

#[derive(Clone, Copy)]
pub(crate) struct EncodingFit {
    pub encoding: PoseEncoding,
    pub frames: FreeFrameErrors,
    pub reference: Rotation,
    pub tool: Rotation,
    /// Rms angle over the best 90 %, rad.
    pub residual_rad: f64,
}

impl PoseEncoding {
    /// Replaces `out` by the possible true rotations of a logged one.
    pub(crate) fn true_rotations(&self, logged: &Rotation, out: &mut Vec<Rotation>) {
        out.clear();
        match self {
            Self::AsLogged | Self::Numbers(_) => out.push(*logged),
            Self::Transposed | Self::Inverted => out.push(logged.inverse()),
            Self::QuaternionOrder(slip) => {
                out.extend(rotation_from_xyzw(slip.true_xyzw(xyzw_from_rotation(logged))));
            }
            Self::Misinterpreted(class) => class.members[0].true_rotations(logged, out),
        }
    }
}

impl RotationSamples<'_> {
    pub fn is_reference_known(&self) -> bool {
        self.frames[0] == FreeFrameErrors::None
    }

    fn candidates(&self, encoding: PoseEncoding) -> CandidateRotations {
        let mut candidates = CandidateRotations::default();
        let samples = 0..self.logged.len();
        samples.for_each(|sample| candidates.push(&self.logged.decode(encoding, sample)));
        candidates
    }
}

/// Largest residual of a candidate as good as one of `residual_rad`.
fn max_similar(residual_rad: f64) -> f64 {
    (MAX_RESIDUAL_RATIO * residual_rad).max(residual_rad + MAX_RESIDUAL_DIFFERENCE_RAD)
}

/// Largest residual as logged of an arm with link deviations or a wrong joint zero, if another encoding has
/// `min_residual_rad`.
fn max_by_links(min_residual_rad: f64) -> f64 {
    let max_rad = MAX_TIP_CHANGE_RAD.max(ZERO_PRIOR);
    (MAX_LINK_RESIDUAL_RATIO * min_residual_rad).clamp(MAX_EXPLAINED_RAD, max_rad)
}

/// Largest residual of a candidate that may be accepted if the smallest is `min_residual_rad`.
fn max_accepted(min_residual_rad: f64) -> f64 {
    max_similar(min_residual_rad).max(max_by_links(min_residual_rad)).min(MAX_RESIDUAL_RAD)
}

/// Encoding that follows FK.
///
/// # Errors
/// If there are too few samples or no candidate follows FK.
pub(crate) fn estimate_encoding(
    samples: &RotationSamples,
) -> EstimateResult<(EncodingEstimate, EncodingFit)> {
    estimate_imu_encoding(samples, &[], &|_| false)
}

/// Like [`estimate_encoding`], with specific forces in the sensor frame, and whether the gyro contradicts a rotation of
/// the tool. A candidate must agree with the gyro and leave gravity upright on average, unless only the world is
/// rotated. Otherwise it explains one fault by two.
pub(crate) fn estimate_imu_encoding(
    samples: &RotationSamples,
    forces: &[Vec3],
    contradicts_gyro: &dyn Fn(&Rotation) -> bool,
) -> EstimateResult<(EncodingEstimate, EncodingFit)> {
    check_sample_count(samples.fk.len(), 3)?;
    let agrees =
        |fit: &EncodingFit| !contradicts_gyro(&fit.tool) && !tilts_gravity(fit, samples, forces);
    let fits = all_fits(samples, &agrees);
    let min_residual = min_residual_rad(&fits).ok_or(NotObservable::NoOrientation)?;
    if min_residual > MAX_RESIDUAL_RAD {
        return Err(NotObservable::DoesNotFollow(min_residual.cos()));
    }
    let accepted = max_similar(min_residual).min(MAX_RESIDUAL_RAD);
    let by_links = max_by_links(min_residual);
    // A common slip under which gravity is upright is likelier than a tilted world.
    let is_upright_slip = |fit: &EncodingFit| {
        matches!(fit.encoding, PoseEncoding::Transposed | PoseEncoding::QuaternionOrder(_))
            && fit.frames == FreeFrameErrors::Reference
            && fit.residual_rad <= accepted
            && !tilts_gravity(fit, samples, forces)
    };
    let may_tilt_world = forces.is_empty() || !fits.iter().any(is_upright_slip);
    let rank_of = |fit: &EncodingFit| {
        // The world's rotation may be the only fault.
        let may_tilt = may_tilt_world
            && matches!(fit.frames, FreeFrameErrors::None | FreeFrameErrors::Reference)
            && matches!(fit.encoding, PoseEncoding::AsLogged);
        let is_contradicted = fit.residual_rad <= accepted.max(by_links)
            && ((!may_tilt && tilts_gravity(fit, samples, forces)) || contradicts_gyro(&fit.tool));
        let penalty = if is_contradicted { CONTRADICTION_RANK_PENALTY } else { 0 };
        simplicity(fit, samples.is_reference_known()) + penalty
    };
    let ranked: Vec<(u8, &EncodingFit)> = fits.iter().map(|fit| (rank_of(fit), fit)).collect();
    // With the same frame errors, another encoding must explain more than link deviations. So must frame errors with
    // another encoding.
    let is_accepted = |(rank, fit): &&(u8, &EncodingFit)| {
        let is_usual = *rank == 0
            || matches!(fit.encoding, PoseEncoding::AsLogged)
            || fit.frames == FreeFrameErrors::None;
        fit.residual_rad <= accepted || (is_usual && fit.residual_rad <= by_links)
    };
    let simplest = ranked.iter().filter(is_accepted).map(|&(rank, _)| rank).min();
    let simple = || ranked.iter().filter(|(rank, _)| Some(*rank) == simplest).map(|(_, fit)| *fit);
    let max_residual = max_similar(min_residual_rad(simple()).unwrap_or(min_residual));
    // Prefer an upright world, then the most common encoding.
    let leaning = |fit: &&EncodingFit| (fit.reference * Vec3::z()).z < MIN_UPRIGHT_COSINE;
    let best = *simple()
        .filter(|fit| fit.residual_rad <= max_residual)
        .min_by_key(leaning)
        .unwrap_or(&fits[0]);
    // With the same frame errors.
    let mut alike: Vec<&EncodingFit> =
        fits.iter().filter(|fit| fit.frames == best.frames).collect();
    let max_equivalent = max_similar(best.residual_rad);
    let is_equivalent = |fit: &&&EncodingFit| fit.residual_rad <= max_equivalent;
    let is_other = |fit: &&&EncodingFit| fit.encoding != best.encoding;
    let named = |fit: &&EncodingFit| samples.logged.reported_encoding(fit.encoding);
    let with_residual = |fit: &&EncodingFit| (named(fit), fit.residual_rad);
    let equivalent: Vec<PoseEncoding> =
        alike.iter().filter(is_other).filter(is_equivalent).map(named).collect();
    let as_logged = alike.iter().find(|fit| matches!(named(fit), PoseEncoding::AsLogged));
    let as_logged_rad = as_logged.map(|fit| fit.residual_rad);
    alike.sort_by(|a, b| a.residual_rad.total_cmp(&b.residual_rad));
    let is_ranked = |(rank, fit): &(usize, &&EncodingFit)| {
        *rank < MAX_RANKED || matches!(fit.encoding, PoseEncoding::AsLogged) || !is_other(fit)
    };
    let estimate = EncodingEstimate {
        ranked: alike.iter().enumerate().filter(is_ranked).map(|it| with_residual(it.1)).collect(),
        best: named(&&best),
        is_inverted: samples.logged.is_inverted,
        as_logged_rad,
        best_rad: best.residual_rad,
        runner_up: alike.iter().filter(is_other).find(|fit| !is_equivalent(fit)).map(with_residual),
        is_determined: candidate_encodings(samples).len() > 2 * equivalent.len() + 1,
        equivalent,
    };
    Ok((estimate, best))
}

fn min_residual_rad<'f>(fits: impl IntoIterator<Item = &'f EncodingFit>) -> Option<f64> {
    fits.into_iter().map(|fit| fit.residual_rad).min_by(f64::total_cmp)
}

/// Whether the fit tilts gravity.
fn tilts_gravity(fit: &EncodingFit, samples: &RotationSamples, forces: &[Vec3]) -> bool {
    let in_world = forces.iter().enumerate().filter_map(|(sample, force)| {
        let expected = fit.reference * samples.fk[sample] * fit.tool;
        Some(samples.logged.nearest(fit.encoding, sample, &expected)? * force)
    });
    let gravity: Vec3 = in_world.sum();
    // Without an accelerometer nothing tilts. Cancelling forces count as tilted.
    let all: f64 = forces.iter().map(Vec3::norm).sum();
    all > 0.0 && gravity.z < MIN_UPRIGHT_COSINE * gravity.norm().max(0.5 * all)
}

/// Rank by faults; lower is simpler. Rotation of an unknown reference does not count.
fn simplicity(fit: &EncodingFit, reference_known: bool) -> u8 {
    let fault = u8::from(!fit.encoding.is_as_logged());
    let is_tool_free = matches!(fit.frames, FreeFrameErrors::Tool | FreeFrameErrors::Both);
    match reference_known {
        true => 2 * fit.frames.frame_count() + fault,
        false => 2 * fault + u8::from(is_tool_free),
    }
}

/// Common slips, the simplest first.
pub(crate) fn simple_encodings() -> impl Iterator<Item = PoseEncoding> {
    [PoseEncoding::AsLogged, PoseEncoding::Transposed]
        .into_iter()
        .chain(QuaternionOrderError::BOTH.map(PoseEncoding::QuaternionOrder))
}

pub(super) fn number_encodings() -> impl Iterator<Item = PoseEncoding> {
    Convention::all().iter().map(|&convention| PoseEncoding::Numbers(convention))
}

fn candidate_encodings(samples: &RotationSamples) -> Vec<PoseEncoding> {
    let is_possible = |encoding: &PoseEncoding| {
        samples.are_quaternions || !matches!(encoding, PoseEncoding::QuaternionOrder(_))
    };
    let misread = misinterpretation_classes().iter().map(PoseEncoding::Misinterpreted);
    match samples.logged.values {
        LoggedValues::Numbers(_) => number_encodings().collect(),
        LoggedValues::Rotations(_) if samples.only_as_logged => vec![PoseEncoding::AsLogged],
        LoggedValues::Rotations(_) => {
            simple_encodings().chain(misread).filter(is_possible).collect()
        }
    }
}

/// Fits of the candidates that may be accepted, of at least [`MIN_FITTED`], and as logged. If the stream fits
/// without a fault and `agrees` with other sensors, other frames cannot win and are not tried. Numbers fit
/// without a fault in any convention.
fn all_fits(samples: &RotationSamples, agrees: &dyn Fn(&EncodingFit) -> bool) -> Vec<EncodingFit> {
    let mut frames = samples.frames;
    let encodings = candidate_encodings(samples).into_iter();
    let fits_without_fault = |encoding: PoseEncoding| {
        let fits = fits(encoding, &samples.candidates(encoding), samples.fk, &frames[..1]);
        fits.iter().all(|fit| fit.residual_rad <= MAX_EXPLAINED_RAD && agrees(fit))
    };
    if encodings.filter(PoseEncoding::is_as_logged).any(fits_without_fault) {
        frames = &frames[..1];
    }
    let stride = samples.fk.len() / MIN_SCREENING_SAMPLES;
    let logged: Vec<Rotation> = match samples.logged.values {
        LoggedValues::Rotations(all) if stride > 1 => all.iter().step_by(stride).copied().collect(),
        _ => return nearest_fits(samples, frames, 1.0).concat(),
    };
    let fk: Vec<Rotation> = samples.fk.iter().step_by(stride).copied().collect();
    let logged = LoggedRotations { values: LoggedValues::Rotations(&logged), ..samples.logged };
    let coarse = RotationSamples { logged, fk: &fk, ..*samples };
    let screened = nearest_fits(&coarse, frames, SCREENING_ERROR_FACTOR);
    let refit = |coarse: Vec<EncodingFit>| {
        let encoding = coarse[0].encoding;
        fits(encoding, &samples.candidates(encoding), samples.fk, frames)
    };
    screened.into_par_iter().flat_map_iter(refit).collect()
}

/// Fits per candidate, in the order of the candidates. Keeps residuals up to `factor` times the largest
/// that may be accepted, at least [`MIN_FITTED`], and as logged.
fn nearest_fits(
    samples: &RotationSamples,
    frames: &[FreeFrameErrors],
    factor: f64,
) -> Vec<Vec<EncodingFit>> {
    let encodings = candidate_encodings(samples);
    let is_as_logged = |candidate: usize| matches!(encodings[candidate], PoseEncoding::AsLogged);
    let with_bound = |(candidate, &encoding): (usize, &PoseEncoding)| {
        let rotations = samples.candidates(encoding);
        let bound = match is_as_logged(candidate) {
            true => f64::NEG_INFINITY,
            false => residual_bound(&rotations, samples.fk),
        };
        (bound, candidate, rotations)
    };
    let mut nearest: Vec<(f64, usize, CandidateRotations)> =
        encodings.par_iter().enumerate().map(with_bound).collect();
    nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fitted: Vec<(f64, usize, Vec<EncodingFit>)> = Vec::new();
    let mut limit = f64::INFINITY;
    for batch in nearest.chunks(MIN_FITTED) {
        if batch[0].0 > limit {
            break;
        }
        let fit = |&(_, candidate, ref rotations): &(f64, usize, CandidateRotations)| {
            let fits = fits(encodings[candidate], rotations, samples.fk, frames);
            (min_residual_rad(&fits).unwrap_or(f64::INFINITY), candidate, fits)
        };
        fitted.par_extend(batch.par_iter().map(fit));
        let min_residual =
            fitted.iter().map(|(residual, ..)| *residual).fold(f64::INFINITY, f64::min);
        limit = factor * max_accepted(min_residual);
    }
    fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let limit = fitted.get(MIN_FITTED - 1).map_or(f64::INFINITY, |last| last.0.max(limit));
    fitted.retain(|(residual, candidate, _)| *residual <= limit || is_as_logged(*candidate));
    fitted.sort_by_key(|(_, candidate, _)| *candidate);
    fitted.into_iter().map(|(.., fits)| fits).collect()
}

/// Lower bound of [`residual`] with any constant frames: they keep the angle between two rotations, so the
/// angles of a pair differ by at most the sum of its residuals.
fn residual_bound(candidates: &CandidateRotations, fk: &[Rotation]) -> f64 {
    let half = fk.len() / 2;
    let difference = |a: usize| {
        let b = a + half;
        let angle = angle_between(&fk[a], &fk[b]);
        let cosine_of = |a: &Rotation, b: &Rotation| a.coords.dot(&b.coords).abs();
        let cosine = cosine_of(&fk[a], &fk[b]);
        let pairs = candidates
            .of_sample(a)
            .iter()
            .flat_map(|first| candidates.of_sample(b).iter().map(move |second| (first, second)));
        // The angle decreases with the cosine of its half, so the nearest angles have the nearest cosines.
        let (mut above, mut below): (Option<(f64, _, _)>, _) = (None, None);
        for (first, second) in pairs {
            let own = cosine_of(first, second);
            let nearest = if own >= cosine { &mut above } else { &mut below };
            if nearest.is_none_or(|(nearest, ..)| (own - cosine).abs() < (nearest - cosine).abs()) {
                *nearest = Some((own, first, second));
            }
        }
        [above, below]
            .into_iter()
            .flatten()
            .map(|(_, first, second)| (angle_between(first, second) - angle).abs())
            .fold(std::f64::consts::PI, f64::min)
    };
    let mut squares: Vec<f64> = (0..half).map(|a| difference(a).powi(2)).collect();
    squares.sort_unstable_by(f64::total_cmp);
    let kept = kept_samples(fk.len());
    let kept_pairs = half.saturating_sub(fk.len() - kept);
    // (a + b)² ≤ 2a² + 2b².
    (squares[..kept_pairs].iter().sum::<f64>() / (2 * kept) as f64).sqrt()
}

/// One fit of an encoding with its candidates per entry of `frames`.
fn fits(
    encoding: PoseEncoding,
    candidates: &CandidateRotations,
    fk: &[Rotation],
    frames: &[FreeFrameErrors],
) -> Vec<EncodingFit> {
    let fit = |&frames: &FreeFrameErrors| {
        let one = |which| fit_one_frame(candidates, fk, which);
        let (reference, tool) = match frames {
            FreeFrameErrors::None => Default::default(),
            FreeFrameErrors::Tool => (Rotation::identity(), one(Frame::Tool)),
            FreeFrameErrors::Reference => (one(Frame::Reference), Rotation::identity()),
            FreeFrameErrors::Both => fit_both_frames(candidates, fk),
        };
        let residual_rad = residual(candidates, fk, &reference, &tool);
        EncodingFit { encoding, frames, reference, tool, residual_rad }
    };
    frames.iter().map(fit).collect()
}

/// Simplest among the close fits of a known encoding.
pub(crate) fn fit_known(samples: &RotationSamples, encoding: PoseEncoding) -> Option<EncodingFit> {
    let candidates = samples.candidates(encoding);
    let fits = fits(encoding, &candidates, samples.fk, samples.frames);
    let max_residual = max_similar(min_residual_rad(&fits)?);
    let max_residual = fits.into_iter().filter(|fit| fit.residual_rad <= max_residual);
    max_residual.min_by_key(|fit| simplicity(fit, samples.is_reference_known()))
}

/// Rms angle to `reference · fk · tool` over the best 90 %.
fn residual(
    candidates: &CandidateRotations,
    fk: &[Rotation],
    reference: &Rotation,
    tool: &Rotation,
) -> f64 {
    let squares = fk.iter().enumerate().map(|(sample, fk)| {
        let expected = reference * fk * tool;
        nearest(candidates.of_sample(sample), &expected)
            .map_or(std::f64::consts::PI, |(truth, _)| angle_between(&truth, &expected))
            .powi(2)
    });
    trimmed_rms(squares.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::rotation_from_rotvec;

    /// Turns mostly about one axis look alike inverted, with a mount turned by half a turn. Gravity and gyro decide.
    #[test]
    fn a_transposed_imu_is_no_turned_mount() {
        let fk: Vec<Rotation> = (0..72)
            .map(|k| {
                let wobble = 0.02 * (0.7 * k as f64).sin();
                rotation_from_rotvec(Vec3::new(0.0, wobble, 0.0))
                    * rotation_from_rotvec(Vec3::x() * (0.3 * k as f64).sin())
            })
            .collect();
        let noise = |k: usize| rotation_from_rotvec(Vec3::y() * 1.4e-3 * (1.9 * k as f64).sin());
        let logged: Vec<Rotation> =
            fk.iter().enumerate().map(|(k, fk)| fk.inverse() * noise(k)).collect();
        let forces: Vec<Vec3> = fk.iter().map(|fk| fk.inverse() * Vec3::z() * 9.81).collect();
        let samples = RotationSamples::new(LoggedRotations::new(&logged), &fk, false);
        let is_turned = |mount: &Rotation| mount.angle() > 0.1;
        let (estimate, _) = estimate_imu_encoding(&samples, &forces, &is_turned).unwrap();
        assert_eq!(estimate.best, PoseEncoding::Transposed);
        let as_logged = all_fits(&samples, &|_| false)
            .into_iter()
            .filter(|fit| matches!(fit.encoding, PoseEncoding::AsLogged));
        let as_logged_rad = as_logged.map(|fit| fit.residual_rad).fold(f64::INFINITY, f64::min);
        assert!(
            (max_similar(estimate.best_rad)..max_by_links(estimate.best_rad))
                .contains(&as_logged_rad),
            "{as_logged_rad}"
        );
    }

    #[test]
    fn no_residual_is_below_its_bound() {
        let rotation = |seed: usize| {
            let part = |i: usize| ((seed * 37 + i * 101) % 89) as f64 / 89.0 - 0.5;
            rotation_from_rotvec(Vec3::new(part(1), part(2), part(3)) * 4.0)
        };
        let fk: Vec<Rotation> = (0..21).map(rotation).collect();
        let mut smaller = 0;
        for (case, encoding) in misinterpretation_classes().iter().enumerate().step_by(7) {
            let [reference, tool, noise] = [1, 2, 3].map(|k| rotation(50 * case + k));
            let noise = noise.powf(0.05);
            let read = &encoding.members[0];
            let logged: Vec<Rotation> = (0..fk.len())
                .map(|k| reference * fk[k] * if k % 2 == 0 { tool } else { tool * noise })
                .map(|truth| read.read_as.rotation(read.is.numbers(&truth)))
                .collect();
            let samples = RotationSamples::new(LoggedRotations::new(&logged), &fk, false);
            for encoding in candidate_encodings(&samples) {
                let candidates = samples.candidates(encoding);
                let both = &[FreeFrameErrors::Both];
                let residual = fits(encoding, &candidates, &fk, both)[0].residual_rad;
                let bound = residual_bound(&candidates, &fk);
                assert!(bound <= residual + 1e-9, "{encoding:?}: {residual} < {bound}");
                smaller += usize::from(residual < 0.1);
            }
        }
        assert!(smaller > 0);
    }
}
