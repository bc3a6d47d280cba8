//! Estimates the encoding of a stream's rotations.
//!
//! Each candidate encoding (as logged, 443 misinterpretations, permuted quaternion components, transposed)
//! is applied to a few dozen samples and compared with FK, with and without constant frame errors. The
//! simplest candidate close to the smallest residual is selected. Frame-independent invariants alone are
//! not sufficient, because several encodings differ only by a constant frame.

use super::arm::EXPLAINED_RAD;
use super::constant::{Side, Truths, both_frames, nearest, one_frame};
use super::{Reading, ReadingEstimate, Seen, Unseen};
use ground::geometry::{
    Convention, QuaternionSlip, Rotation, Vec3, angle_between, misreading_classes,
    rotation_from_xyzw, xyzw_from_rotation,
};
use ground::stream::Orientations;
use rayon::prelude::*;

/// Maximum ratio of an accepted residual to the smallest one, …
const NEAR: f64 = 5.0;
/// … or maximum difference from it, rad (0.05°).
const NEAR_RAD: f64 = 8.7e-4;
/// No candidate is accepted if the smallest residual is larger, rad (20°).
const HOPELESS_RAD: f64 = 0.35;

/// Minimum number of samples for screening all candidates.
const SCREENED_ON: usize = 16;
/// Error factor of the residuals in screening.
const FAR: f64 = 1.5;
/// Approximate number of candidates that pass the screening and are compared on all samples.
const KEPT: usize = 48;

/// Cosine of the largest tilt of an upright world frame (10°).
const UPRIGHT: f64 = 0.985;

/// Rank penalty of a candidate that leaves gravity tilted: it needs a tilt as a further fault.
const LEANS: u8 = 2;

/// Samples to decode, with FK at the same times.
pub(super) struct Samples<'a> {
    pub logged: Logged<'a>,
    pub fk: &'a [Rotation],
    /// Whether the reference frame may have a constant error.
    pub reference_free: bool,
    /// Whether the reference frame is known; if not, its rotation is not a fault.
    pub reference_known: bool,
    /// Whether the log has quaternions, whose components may be permuted.
    pub are_quaternions: bool,
    /// Corrections found from positions, applied after decoding.
    pub after: After,
}

/// Corrections applied to decoded rotations.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct After {
    /// Rotation between the stream's axes and the standard ones, applied by conjugation. `None` for
    /// standard axes.
    pub conjugator: Option<Rotation>,
    /// Whether whole poses are inverted.
    pub inverted: bool,
}

impl After {
    fn undo(&self, rotations: &mut [Rotation]) {
        for rotation in rotations {
            if let Some(conjugator) = self.conjugator {
                *rotation = conjugator.inverse() * *rotation * conjugator;
            }
            if self.inverted {
                *rotation = rotation.inverse();
            }
        }
    }

    /// Encoding to report for a candidate, if whole poses are inverted.
    fn named(&self, reading: Reading) -> Reading {
        match reading {
            Reading::AsLogged if self.inverted => Reading::Inverted,
            Reading::Transposed if self.inverted => Reading::AsLogged,
            reading => reading,
        }
    }
}

/// Orientations as logged.
#[derive(Clone, Copy)]
pub(super) enum Logged<'a> {
    Rotations(&'a [Rotation]),
    Numbers(&'a [[f64; 3]]),
}

impl<'a> Logged<'a> {
    /// Orientations of a stream; none if they are unset.
    pub fn of(orientation: &'a Orientations) -> Self {
        match orientation {
            Orientations::Rotations(rotations) => Self::Rotations(rotations),
            Orientations::Numbers(numbers) => Self::Numbers(numbers),
            Orientations::Unset(_) => Self::Rotations(&[]),
        }
    }
}

/// Constant frame errors allowed for a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frames {
    None,
    Tool,
    Reference,
    Both,
}

impl Frames {
    /// Number of frames.
    pub fn count(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Tool | Self::Reference => 1,
            Self::Both => 2,
        }
    }
}

/// Candidate encoding with fitted frame errors.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub reading: Reading,
    pub frames: Frames,
    pub reference: Rotation,
    pub tool: Rotation,
    /// Rms residual angle over the best 90 % of the samples, rad.
    pub residual_rad: f64,
}

/// Fills in the possible true rotations of every sample under `reading`.
fn fill(truths_of: &mut Truths, reading: &Reading, samples: &Samples, buffer: &mut Vec<Rotation>) {
    truths_of.clear();
    let logged = &samples.logged;
    let count = match logged {
        Logged::Rotations(rotations) => rotations.len(),
        Logged::Numbers(numbers) => numbers.len(),
    };
    for sample in 0..count {
        truths(reading, logged, sample, buffer);
        samples.after.undo(buffer);
        truths_of.push(buffer);
    }
}

/// Replaces `out` by the possible true rotations of one sample under `reading`.
fn truths(reading: &Reading, logged: &Logged, sample: usize, out: &mut Vec<Rotation>) {
    out.clear();
    match (reading, logged) {
        (Reading::Numbers(convention), Logged::Numbers(numbers)) => {
            out.push(convention.rotation(numbers[sample]));
        }
        (_, Logged::Numbers(_)) => {}
        (Reading::AsLogged | Reading::Numbers(_), Logged::Rotations(rotations)) => {
            out.push(rotations[sample]);
        }
        (Reading::Transposed | Reading::Inverted, Logged::Rotations(rotations)) => {
            out.push(rotations[sample].inverse());
        }
        (Reading::QuaternionOrder(slip), Logged::Rotations(rotations)) => {
            let q_xyzw = slip.truth(xyzw_from_rotation(&rotations[sample]));
            out.extend(rotation_from_xyzw(q_xyzw));
        }
        (Reading::Misread(class), Logged::Rotations(rotations)) => {
            class.members[0].truths(&rotations[sample], out);
        }
    }
}

/// Decodes one sample under `reading` and `after`. Returns the branch nearest to `expected`.
pub(super) fn nearest_truth(
    reading: &Reading,
    after: &After,
    logged: &Logged,
    sample: usize,
    expected: &Rotation,
    buffer: &mut Vec<Rotation>,
) -> Option<Rotation> {
    truths(reading, logged, sample, buffer);
    after.undo(buffer);
    nearest(buffer, expected).map(|(rotation, _)| rotation)
}

/// Selects the encoding that follows FK.
///
/// # Errors
/// Returns an error if there are too few samples or no candidate follows FK.
pub(super) fn read(samples: &Samples) -> Seen<(ReadingEstimate, Fit)> {
    read_in_gravity(samples, &[])
}

/// Like [`read`], with the specific force in the sensor frame for each sample. A candidate must leave
/// gravity upright on average, unless it is the logged encoding with only the world rotated. Otherwise it
/// explains one fault by two.
pub(super) fn read_in_gravity(samples: &Samples, forces: &[Vec3]) -> Seen<(ReadingEstimate, Fit)> {
    let need = 3;
    if samples.fk.len() < need {
        return Err(Unseen::TooFewSamples { have: samples.fk.len(), need });
    }
    let fits = all_fits(samples);
    let Some(least) = fits.iter().map(|fit| fit.residual_rad).min_by(f64::total_cmp) else {
        return Err(Unseen::NoOrientation);
    };
    if least > HOPELESS_RAD {
        return Err(Unseen::DoesNotFollow(least.cos()));
    }
    let accepted = (NEAR * least).max(least + NEAR_RAD).min(HOPELESS_RAD);
    let ranked: Vec<(u8, &Fit)> = fits
        .iter()
        .map(|fit| {
            let leans = fit.residual_rad <= accepted && leans(fit, samples, forces);
            (simplicity(fit, samples.reference_known) + if leans { LEANS } else { 0 }, fit)
        })
        .collect();
    // A healthy arm with link deviations has residuals up to this as logged.
    let is_accepted = |(rank, fit): &&(u8, &Fit)| {
        fit.residual_rad <= accepted || (*rank == 0 && fit.residual_rad <= EXPLAINED_RAD)
    };
    let accepted_ranks = ranked.iter().filter(is_accepted);
    let simplest = accepted_ranks.map(|&(rank, _)| rank).min();
    let simple = || ranked.iter().filter(|(rank, _)| Some(*rank) == simplest).map(|(_, fit)| *fit);
    let least = simple().map(|fit| fit.residual_rad).min_by(f64::total_cmp).unwrap_or(least);
    let near = (NEAR * least).max(least + NEAR_RAD);
    // Among equivalent candidates, prefer an upright world, then the most common encoding.
    let leaning = |fit: &&Fit| (fit.reference * Vec3::z()).z < UPRIGHT;
    let best =
        *simple().filter(|fit| fit.residual_rad <= near).min_by_key(leaning).unwrap_or(&fits[0]);
    let near_best = (NEAR * best.residual_rad).max(best.residual_rad + NEAR_RAD);
    let (mut equivalent, mut runner_up): (Vec<Reading>, Option<(Reading, f64)>) =
        (Vec::new(), None);
    let others = fits
        .iter()
        .filter(|fit| fit.frames == best.frames && !same_reading(&fit.reading, &best.reading));
    let mut worse = 0;
    for fit in others {
        let named = samples.after.named(fit.reading);
        if fit.residual_rad <= near_best {
            equivalent.push(named);
            continue;
        }
        worse += 1;
        if runner_up.is_none_or(|(_, residual)| fit.residual_rad < residual) {
            runner_up = Some((named, fit.residual_rad));
        }
    }
    let named = |fit: &Fit| samples.after.named(fit.reading);
    let as_logged = fits
        .iter()
        .find(|fit| matches!(named(fit), Reading::AsLogged) && fit.frames == best.frames);
    let ranked = ranking(&fits, &best).into_iter();
    let estimate = ReadingEstimate {
        ranked: ranked.map(|(reading, rad)| (samples.after.named(reading), rad)).collect(),
        best: named(&best),
        inverted: samples.after.inverted,
        as_logged_rad: as_logged.map(|fit| fit.residual_rad),
        best_rad: best.residual_rad,
        runner_up,
        is_told: worse > equivalent.len(),
        equivalent,
    };
    Ok((estimate, best))
}

/// Candidates with the smallest residuals, without duplicates, plus the best and the logged encoding. All
/// use the frames of the best one.
fn ranking(fits: &[Fit], best: &Fit) -> Vec<(Reading, f64)> {
    /// Number of candidates besides those two.
    const SHOWN: usize = 6;
    let alike = fits.iter().filter(|fit| fit.frames == best.frames);
    let mut alike: Vec<&Fit> = alike.collect();
    alike.sort_by(|a, b| a.residual_rad.total_cmp(&b.residual_rad));
    let is_kept = |(rank, fit): &(usize, &Fit)| {
        *rank < SHOWN
            || matches!(fit.reading, Reading::AsLogged)
            || same_reading(&fit.reading, &best.reading)
    };
    let kept = alike.into_iter().enumerate().filter(is_kept);
    kept.map(|(_, fit)| (fit.reading, fit.residual_rad)).collect()
}

/// Whether a candidate other than a rotated world leaves gravity tilted.
fn leans(fit: &Fit, samples: &Samples, forces: &[Vec3]) -> bool {
    let turned_world_only = matches!(fit.frames, Frames::None | Frames::Reference);
    if turned_world_only && matches!(fit.reading, Reading::AsLogged) {
        return false;
    }
    let mut buffer = Vec::new();
    let felt: Vec3 = forces
        .iter()
        .enumerate()
        .filter_map(|(sample, force)| {
            let expected = fit.reference * samples.fk[sample] * fit.tool;
            let truth = nearest_truth(
                &fit.reading,
                &samples.after,
                &samples.logged,
                sample,
                &expected,
                &mut buffer,
            )?;
            Some(truth * force)
        })
        .sum();
    // Without an accelerometer nothing is tilted. Forces that cancel count as tilted.
    let all: f64 = forces.iter().map(Vec3::norm).sum();
    all > 0.0 && felt.z < UPRIGHT * felt.norm().max(0.5 * all)
}

fn same_reading(a: &Reading, b: &Reading) -> bool {
    match (a, b) {
        (Reading::Misread(a), Reading::Misread(b)) => std::ptr::eq(*a, *b),
        (Reading::QuaternionOrder(a), Reading::QuaternionOrder(b)) => a == b,
        (Reading::Numbers(a), Reading::Numbers(b)) => a == b,
        _ => std::mem::discriminant(a) == std::mem::discriminant(b),
    }
}

/// Rank of a candidate by its faults; lower is simpler. If the reference frame is unknown, its rotation is
/// not a fault.
fn simplicity(fit: &Fit, reference_known: bool) -> u8 {
    let fault = u8::from(!matches!(fit.reading, Reading::AsLogged | Reading::Numbers(_)));
    match (reference_known, fit.frames) {
        (true, Frames::None) => fault,
        (true, Frames::Tool | Frames::Reference) => 2 + fault,
        (true, Frames::Both) => 4 + fault,
        (false, Frames::None | Frames::Reference) => 2 * fault,
        (false, Frames::Tool | Frames::Both) => 1 + 2 * fault,
    }
}

fn readings(samples: &Samples) -> Vec<Reading> {
    let is_possible = |reading: &Reading| {
        samples.are_quaternions || !matches!(reading, Reading::QuaternionOrder(_))
    };
    match samples.logged {
        Logged::Numbers(_) => Convention::all().iter().map(|&c| Reading::Numbers(c)).collect(),
        Logged::Rotations(_) => [Reading::AsLogged, Reading::Transposed]
            .into_iter()
            .chain(QuaternionSlip::BOTH.map(Reading::QuaternionOrder))
            .chain(misreading_classes().iter().map(Reading::Misread))
            .filter(is_possible)
            .collect(),
    }
}

/// Fits of every candidate with the allowed frames. If the stream fits as logged without a fault, no other
/// frames are tried, because none could be selected.
fn all_fits(samples: &Samples) -> Vec<Fit> {
    let mut frames = allowed(samples);
    if let Logged::Rotations(_) = samples.logged {
        let plain = &frames[..1];
        let known = &mut Default::default();
        let as_logged = fits_of(samples, plain, Reading::AsLogged, known, &mut Vec::new());
        if as_logged.iter().all(|fit| fit.residual_rad <= NEAR_RAD) {
            frames = plain;
        }
    }
    let each_of = |samples: &Samples, readings: Vec<Reading>| -> Vec<Vec<Fit>> {
        let fits_of = |(truths, buffer): &mut (Truths, Vec<_>), reading: Reading| {
            fits_of(samples, frames, reading, truths, buffer)
        };
        readings.into_par_iter().map_init(Default::default, fits_of).collect()
    };
    let stride = samples.fk.len() / SCREENED_ON;
    let logged: Vec<Rotation> = match samples.logged {
        Logged::Rotations(all) if stride > 1 => all.iter().step_by(stride).copied().collect(),
        _ => return each_of(samples, readings(samples)).concat(),
    };
    // Screen all candidates on a few samples, then fit the near ones on all samples.
    let fk: Vec<Rotation> = samples.fk.iter().step_by(stride).copied().collect();
    let few = Samples { logged: Logged::Rotations(&logged), fk: &fk, ..*samples };
    let screened = each_of(&few, readings(samples));
    let left = |fits: &[Fit]| fits.iter().map(|fit| fit.residual_rad).fold(f64::INFINITY, f64::min);
    let mut all: Vec<f64> = screened.iter().map(|fits| left(fits)).collect();
    all.sort_by(f64::total_cmp);
    let few_near = all[KEPT.min(all.len() - 1)];
    let near = match all[0] > FAR * HOPELESS_RAD {
        true => few_near,
        false => few_near.max(FAR * (NEAR * all[0]).max(all[0] + NEAR_RAD)),
    };
    let again = |few: Vec<Fit>| match few[0].reading {
        reading if left(&few) <= near || matches!(reading, Reading::AsLogged) => {
            fits_of(samples, frames, reading, &mut Truths::default(), &mut Vec::new())
        }
        _ => few,
    };
    screened.into_par_iter().flat_map_iter(again).collect()
}

/// Frames allowed for a candidate; the first is not a fault.
fn allowed(samples: &Samples) -> &'static [Frames] {
    match (samples.reference_known, samples.reference_free) {
        (false, _) => &[Frames::Reference, Frames::Both],
        (true, false) => &[Frames::None, Frames::Tool],
        (true, true) => &[Frames::None, Frames::Tool, Frames::Reference, Frames::Both],
    }
}

/// Fits of one candidate, one per entry of `frames`.
fn fits_of(
    samples: &Samples,
    frames: &[Frames],
    reading: Reading,
    truths: &mut Truths,
    buffer: &mut Vec<Rotation>,
) -> Vec<Fit> {
    fill(truths, &reading, samples, buffer);
    let fit = |&frames: &Frames| {
        let (reference, tool) = match frames {
            Frames::None => (Rotation::identity(), Rotation::identity()),
            Frames::Tool => (Rotation::identity(), one_frame(truths, samples.fk, Side::Tool)),
            Frames::Reference => {
                (one_frame(truths, samples.fk, Side::Reference), Rotation::identity())
            }
            Frames::Both => both_frames(truths, samples.fk),
        };
        let residual_rad = residual(truths, samples.fk, &reference, &tool);
        Fit { reading, frames, reference, tool, residual_rad }
    };
    frames.iter().map(fit).collect()
}

/// Simplest fit of a known encoding, among those close to its best fit.
pub(super) fn fit_known(samples: &Samples, reading: Reading) -> Option<Fit> {
    let known = &mut Truths::default();
    let fits = fits_of(samples, allowed(samples), reading, known, &mut Vec::new());
    let least = fits.iter().map(|fit| fit.residual_rad).min_by(f64::total_cmp)?;
    let near = (NEAR * least).max(least + NEAR_RAD);
    let near = fits.into_iter().filter(|fit| fit.residual_rad <= near);
    near.min_by_key(|fit| simplicity(fit, samples.reference_known))
}

/// Rms angle between the nearest true rotations and `reference · fk · tool`, over the best 90 % of the
/// samples.
fn residual(truths: &Truths, fk: &[Rotation], reference: &Rotation, tool: &Rotation) -> f64 {
    let mut squares: Vec<f64> = fk
        .iter()
        .enumerate()
        .map(|(sample, fk)| {
            let expected = reference * fk * tool;
            nearest(truths.of(sample), &expected)
                .map_or(std::f64::consts::PI, |(truth, _)| angle_between(&truth, &expected))
                .powi(2)
        })
        .collect();
    let kept = (squares.len() * 9).div_ceil(10);
    squares.sort_unstable_by(f64::total_cmp);
    (squares[..kept].iter().sum::<f64>() / kept as f64).sqrt()
}
