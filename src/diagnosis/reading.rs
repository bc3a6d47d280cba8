//! Which convention a stream's rotations are written in.
//!
//! Every reading (as logged, 443 different misreadings, swapped quaternion components, transposed)
//! is applied to a few dozen samples and held against FK, alone and with a constant frame error that
//! it may need. The simplest reading near the least residual wins. Frame-free invariants alone
//! cannot do this: several readings differ by a constant frame only.

use super::arm::EXPLAINED_RAD;
use super::constant::{Side, Truths, both_frames, nearest, one_frame};
use super::{Reading, ReadingEstimate, Seen, Unseen};
use ground::geometry::{
    Convention, QuaternionSlip, Rotation, Vec3, angle_between, misreading_classes,
    rotation_from_xyzw, xyzw_from_rotation,
};
use ground::stream::Orientations;
use rayon::prelude::*;

/// A reading fits when its residual is within this factor of the least one …
const NEAR: f64 = 5.0;
/// … or within this angle of it, rad (0.05°).
const NEAR_RAD: f64 = 8.7e-4;
/// No reading fits where the least residual is above this, rad (20°).
const HOPELESS_RAD: f64 = 0.35;

/// Samples on which all readings are screened, at least.
const SCREENED_ON: usize = 16;
/// What is left there is off by less than this factor.
const FAR: f64 = 1.5;
/// Readings that come nearest there and are held against all samples, about.
const KEPT: usize = 48;

/// Cosine of the tilt within which a world is upright (10°).
const UPRIGHT: f64 = 0.985;

/// Ranks by which a reading that leaves gravity leaning comes later: it needs a lean besides.
const LEANS: u8 = 2;

/// Samples to read, and what FK says at the same moments.
pub(super) struct Samples<'a> {
    pub logged: Logged<'a>,
    pub fk: &'a [Rotation],
    /// Whether a constant error of the reference frame may be needed.
    pub reference_free: bool,
    /// Whether the reference frame is known at all; if not, its error is no fault.
    pub reference_known: bool,
    /// Whether they were logged as quaternions, whose components may be in another order.
    pub are_quaternions: bool,
    /// What positions say is to be undone once the numbers are read.
    pub after: After,
}

/// What is undone of rotations once their numbers are read.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct After {
    /// What writes rotations in the axes that they are in, by conjugation; `None` of standard ones.
    pub conjugator: Option<Rotation>,
    /// Whether the poses are inverted as a whole.
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

    /// What a reading of rotations says of a stream whose poses are inverted as a whole.
    fn named(&self, reading: Reading) -> Reading {
        match reading {
            Reading::AsLogged if self.inverted => Reading::Inverted,
            Reading::Transposed if self.inverted => Reading::AsLogged,
            reading => reading,
        }
    }
}

/// Orientations as the log has them.
#[derive(Clone, Copy)]
pub(super) enum Logged<'a> {
    Rotations(&'a [Rotation]),
    Numbers(&'a [[f64; 3]]),
}

impl<'a> Logged<'a> {
    /// The orientations of a stream.
    pub fn of(orientation: &'a Orientations) -> Self {
        match orientation {
            Orientations::Rotations(rotations) => Self::Rotations(rotations),
            Orientations::Numbers(numbers) => Self::Numbers(numbers),
            Orientations::Unset(_) => Self::Rotations(&[]),
        }
    }
}

/// Constant frames that a reading is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frames {
    None,
    Tool,
    Reference,
    Both,
}

impl Frames {
    /// How many they are.
    pub fn count(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Tool | Self::Reference => 1,
            Self::Both => 2,
        }
    }
}

/// A reading with the frames that it needs.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub reading: Reading,
    pub frames: Frames,
    pub reference: Rotation,
    pub tool: Rotation,
    /// Residual angle, rms rad over the best nine tenths of the samples.
    pub residual_rad: f64,
}

/// Fills in the candidate true rotations of every sample under `reading`.
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

/// Replaces `out` by the rotations that sample `sample` may mean under `reading`.
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

/// The rotation of one sample under `reading`, with what comes `after` it undone, that lies nearest to
/// `expected`.
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

/// Which reading follows FK.
///
/// # Errors
/// Too few samples, or none of the readings follows.
pub(super) fn read(samples: &Samples) -> Seen<(ReadingEstimate, Fit)> {
    read_in_gravity(samples, &[])
}

/// As [`read`], where the specific force in the sensor's frame is known with every sample: a reading
/// as logged with another mount, and any misreading, must leave gravity upright on average, or they
/// explain one fault by two.
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
    // As logged an arm is this far off because its links differ from their drawing.
    let is_accepted = |(rank, fit): &&(u8, &Fit)| {
        fit.residual_rad <= accepted || (*rank == 0 && fit.residual_rad <= EXPLAINED_RAD)
    };
    let accepted_ranks = ranked.iter().filter(is_accepted);
    let simplest = accepted_ranks.map(|&(rank, _)| rank).min();
    let simple = || ranked.iter().filter(|(rank, _)| Some(*rank) == simplest).map(|(_, fit)| *fit);
    let least = simple().map(|fit| fit.residual_rad).min_by(f64::total_cmp).unwrap_or(least);
    let near = (NEAR * least).max(least + NEAR_RAD);
    // Of those that the log cannot tell apart, the one in an upright world, then the most usual.
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

/// The readings with the least residuals, once each, and the stream as logged, all with the frames
/// that the best one needs.
fn ranking(fits: &[Fit], best: &Fit) -> Vec<(Reading, f64)> {
    /// Readings beside those two.
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

/// Whether a reading that needs more than a turned world leaves gravity other than upright in it.
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
    // Without an accelerometer nothing leans. Forces that cancel each other do.
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

/// Less is simpler: no fault before one fault before several. Where the reference frame is not
/// known, turning it is no fault, and no fault comes before any.
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

/// Every reading with the frames that it may need. Where the stream as logged fits without a fault no
/// other frames can be chosen, and none are tried.
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
    // All readings are screened on a few samples, and those that come near are held against all.
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

/// The frames that readings are allowed; the first is no fault.
fn allowed(samples: &Samples) -> &'static [Frames] {
    match (samples.reference_known, samples.reference_free) {
        (false, _) => &[Frames::Reference, Frames::Both],
        (true, false) => &[Frames::None, Frames::Tool],
        (true, true) => &[Frames::None, Frames::Tool, Frames::Reference, Frames::Both],
    }
}

/// The fits of one reading, with each of `frames`.
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

/// The simplest fit of a reading that is known, near the best of its fits.
pub(super) fn fit_known(samples: &Samples, reading: Reading) -> Option<Fit> {
    let known = &mut Truths::default();
    let fits = fits_of(samples, allowed(samples), reading, known, &mut Vec::new());
    let least = fits.iter().map(|fit| fit.residual_rad).min_by(f64::total_cmp)?;
    let near = (NEAR * least).max(least + NEAR_RAD);
    let near = fits.into_iter().filter(|fit| fit.residual_rad <= near);
    near.min_by_key(|fit| simplicity(fit, samples.reference_known))
}

/// Rms angle of the best nine tenths of the samples between the nearest truths and
/// `reference · fk · tool`.
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
