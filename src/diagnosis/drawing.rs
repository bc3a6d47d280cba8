//! Joint zeros of an arm that is not its drawing.
//!
//! Every link of a real arm differs from its drawing by some hundredths of a millimetre and thousandths
//! of a degree, and a joint zero is named only where it stands out of what that makes. So the deviations
//! of every link are random effects with a prior N(0, s²), lengths to angles as 1 mm to 0.1°, and the zeros
//! are fixed effects beside them (Patterson and Thompson, *Recovery of inter-block information*, Biometrika
//! 58, 1971). The interval of a zero then holds the drawing's inaccuracy as well as the noise.
//!
//! What a link is off about or along its joint's axis is that joint's zero. It is a random effect, too: what
//! all joints of an arm are off by is no fault of one.
//!
//! Links are not off alike: of a UR5 as it left the factory one is turned by 0.37° and the next worst by
//! 0.1°, and no joint's zero is off by 0.01°. So each link has an s of its own, and the zeros have one, and
//! these vary about that of the arm so that deviations are Student's t with [`ALIKE`] degrees of freedom;
//! the sizes are those under which the log is likeliest (variational bound on the marginal likelihood:
//! Bishop, *Pattern Recognition and Machine Learning*, 2006, ch. 10.1 and 10.3).

use super::explain::{Cause, price};
use super::linear::{Linear, Normal};
use super::model::{StreamState, Witness};
use super::nominal::{ANYTHING, USUAL_M, With, is_anything, link_frames};
use super::{Measured, Twin};
use ground::geometry::{Rotation, Vec3};
use ground::robot::{JointKind, turn_z_to};
use nalgebra::{DMatrix, DVector};

/// The angle that a link is off where it is off by a length, rad/m: 0.1° to 1 mm.
pub(super) const RAD_PER_M: f64 = 1.745;
/// Deviations of a link that are tried, m: from the least to the most, each so many times the one before.
pub(super) const LINKS_M: (f64, f64, f64) = (1e-5, 3e-3, 1.6);
/// Size of a joint zero that is there, rad or m.
pub(super) const ZERO: f64 = 0.02;
/// Size of a radial growth that is there: some millimetres a metre. And of none.
const GROWTH: f64 = 0.01;
const NO_GROWTH: f64 = 1e-9;
/// A zero is named where the log is so much likelier with it, as twice the log of the ratio: fifty times.
const SURE: f64 = 8.0;
/// Another joint's zero may be it as well where the log is no more than so much less likely with that,
/// in the same measure: a twentieth as likely.
const AS_LIKELY: f64 = 6.0;
/// A zero of which the log leaves more than this share of [`ZERO`] is not told by it.
const LEARNT: f64 = 0.5;
/// Zeros that are named at most.
const MOST: usize = 4;
/// Samples that are fitted.
pub(super) const SAMPLES: usize = 1000;
/// Rounds of fitting: zeros of degrees curve.
const ROUNDS: usize = 4;
/// How alike the sizes of the deviations of links and zeros are, in degrees of freedom.
const ALIKE: f64 = 8.0;
/// Rounds in which the sizes of the deviations settle, and how little twice the log of the
/// likelihood then changes.
const SETTLING: (usize, f64) = (40, 0.02);

/// The zeros of an arm's joints beside what its links are off.
#[derive(Clone, Debug)]
pub(super) struct Drawing {
    /// The columns of the joints whose zero is off, and which of the others may be instead, with the zero
    /// that each would have.
    pub named: Vec<(usize, Vec<Twin>)>,
    /// The zero of each joint of the track beside those, rad or m; `None` of one outside the chain.
    pub zeros: Vec<Option<Measured>>,
    /// By how much links differ from the drawing, as a standard deviation, m.
    pub link_m: f64,
}

impl Drawing {
    /// Joint offsets with the named zeros in them.
    pub fn with_zeros(&self, offsets: &[f64]) -> Vec<f64> {
        let mut with = offsets.to_vec();
        for &(column, _) in &self.named {
            with[column] = self.zeros[column].map_or(with[column], |zero| zero.value);
        }
        with
    }

    /// Zeros of other joints that may be in the place of that of the joint of `column`; `None` where it is
    /// not named.
    pub fn twins(&self, column: usize) -> Option<&[Twin]> {
        self.named.iter().find(|named| named.0 == column).map(|named| named.1.as_slice())
    }
}

/// The likeliest zeros beside links that are off, from `offsets` on; `plain` is the stream's state
/// without any cause that links may feign.
pub(super) fn drawing(witness: &Witness, plain: &StreamState, offsets: &[f64]) -> Option<Drawing> {
    let stride = witness.len().div_ceil(SAMPLES).max(1);
    let mut offsets = offsets.to_vec();
    let mut chosen: Option<Fit> = None;
    for round in 1.. {
        let model = Model::at(witness, plain, &offsets, stride)?;
        let fit = model.likeliest(chosen)?;
        let mut next = offsets.clone();
        for &joint in &fit.zeros {
            next[witness.columns[joint]] += model.zero(&fit, joint)?.value;
        }
        let moved = next.iter().zip(&offsets).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if moved < 1e-6 || round == ROUNDS {
            return Some(model.told(&fit, witness, &offsets));
        }
        (offsets, chosen) = (next, Some(fit));
    }
    None
}

/// What a parameter is of.
#[derive(Clone, Copy, PartialEq)]
enum Of {
    /// Nothing that a drawing says.
    Anything,
    /// A deviation of one group, whose size is as long as it says where the group's is a metre.
    Deviation { group: usize, unit: f64 },
    /// Radial growth, which no deviation of a link is.
    Growth,
}

/// Causes beside the deviations of links.
#[derive(Clone, Debug, Default, PartialEq)]
struct Beside {
    /// Joints of the chain whose zero is off.
    zeros: Vec<usize>,
    reference: bool,
    tool: bool,
    growth: bool,
}

impl Beside {
    /// Those of `causes` that concern one stream.
    fn of(causes: &[Cause], witness: &Witness, stream: usize) -> Self {
        let mut beside = Self::default();
        for cause in causes {
            match *cause {
                Cause::Zero(column) => {
                    let joint = witness.columns.iter().position(|own| *own == column);
                    beside.zeros.extend(joint);
                }
                Cause::Reference(s) => beside.reference |= s == stream,
                Cause::Tool(s) => beside.tool |= s == stream,
                Cause::Growth(s) => beside.growth |= s == stream,
                Cause::Gain(_) | Cause::Latency(_) | Cause::Skew(_) => {}
            }
        }
        beside
    }
}

/// Those of `causes` that stand out of what links make that are off as those of usual arms: without such a
/// one the log is less likely, whatever size the links' deviations have up to that, by more than the price of a
/// parameter: links that are exact, beside a cause, are less usual than links that deviate.
///
/// The stream is linearised about `plain` and `offsets`, which are without the causes.
pub(super) fn standing_out(
    (witness, stream): (&Witness, usize),
    plain: &StreamState,
    offsets: &[f64],
    causes: &[Cause],
) -> Vec<Cause> {
    let stride = witness.len().div_ceil(SAMPLES).max(1);
    let Some(model) = Model::at(witness, plain, offsets, stride) else { return causes.to_vec() };
    let evidence = |causes: &[Cause]| {
        let beside = Beside::of(causes, witness, stream);
        let fits = sizes_m(USUAL_M).filter_map(|size_m| {
            model.fit_beside(&beside, &model.alike(size_m)).map(|fit| fit.evidence)
        });
        fits.fold(f64::NEG_INFINITY, f64::max)
    };
    let sure = price(model.dof);
    let mut kept = causes.to_vec();
    let mut present = evidence(&kept);
    while !kept.is_empty() {
        let without = (0..kept.len()).map(|at| {
            let mut rest = kept.clone();
            rest.remove(at);
            (evidence(&rest), rest)
        });
        match without.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((likelihood, rest)) if likelihood + sure >= present => {
                (present, kept) = (present.max(likelihood), rest);
            }
            _ => break,
        }
    }
    kept
}

/// Sizes of deviations that are tried, m: up to `most`, ascending.
fn sizes_m(most: f64) -> impl Iterator<Item = f64> {
    let (least, _, times) = LINKS_M;
    let tried = std::iter::successors(Some(least), move |size_m| Some(size_m * times));
    tried.take_while(move |size_m| *size_m < most).chain([most])
}

/// The log linearised in the link frames, the latency and the zeros.
struct Model {
    normal: Normal,
    /// What each parameter is of. The zeros of the chain's joints are the last but for the growth.
    of: Vec<Of>,
    /// Joints of the chain.
    joints: usize,
    /// Degrees of freedom behind the noise.
    dof: f64,
}

/// What is known of the parameters with some zeros once the log is.
struct Fit {
    /// The joints whose zeros are in it, in their order.
    zeros: Vec<usize>,
    /// The size of each group's deviations, m.
    sizes_m: Vec<f64>,
    /// Twice the log of the likelihood, up to what is the same for all.
    evidence: f64,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Fit {
    /// The zeros without that of `joint`.
    fn without(&self, joint: usize) -> Vec<usize> {
        self.zeros.iter().copied().filter(|zero| *zero != joint).collect()
    }
}

impl Model {
    fn at(witness: &Witness, plain: &StreamState, offsets: &[f64], stride: usize) -> Option<Self> {
        let rows = (0..witness.len()).step_by(stride);
        let linear = link_frames(witness, plain, offsets, rows, With::ZerosAndGrowth);
        let joints = witness.columns.len();
        let (columns, of) = parameters(witness, plain);
        (linear.len() > of.len()).then(|| Self::of(&linear, joints, &columns, of))
    }

    /// Weighed by the noise that is left when all links may be off by a millimetre or so.
    fn of(linear: &Linear, joints: usize, columns: &DMatrix<f64>, of: Vec<Of>) -> Self {
        let all: Vec<usize> = (0..linear.width).collect();
        let every: Vec<usize> = (0..joints).collect();
        let mut weights = linear.first_weights();
        let mut model = Self { normal: Normal::zeros(of.len()), of, joints, dof: 3.0 };
        for _ in 0..4 {
            let mut normal = Normal::zeros(linear.width);
            linear.accumulate(&weights, &all, &mut normal);
            model.dof = (normal.independent - model.of.len() as f64).max(3.0);
            model.normal.matrix = columns.tr_mul(&normal.matrix) * columns;
            model.normal.right = columns.tr_mul(&normal.right);
            let Some(fit) = model.fit(&every, &model.alike(1e-3)) else { break };
            weights = linear.weights_after((columns * &fit.mean).as_slice());
        }
        model
    }

    /// Groups that are all off by the same, m.
    fn alike(&self, size_m: f64) -> Vec<f64> {
        vec![size_m; self.joints + 2]
    }

    /// The parameter that is the zero of a joint.
    fn zero_at(&self, joint: usize) -> usize {
        self.of.len() - 1 - self.joints + joint
    }

    /// The groups that have deviations, of a drawing's links and of the zeros.
    fn groups(&self) -> impl Iterator<Item = usize> {
        let has = |group: usize| {
            let is_its = |of: &Of| matches!(of, Of::Deviation { group: own, .. } if *own == group);
            self.of.iter().any(is_its)
        };
        (0..self.joints + 2).filter(move |group| has(*group))
    }

    /// The parameters with these zeros where the groups' deviations are of these sizes.
    fn fit(&self, zeros: &[usize], sizes_m: &[f64]) -> Option<Fit> {
        let beside = Beside { zeros: zeros.to_vec(), ..Beside::default() };
        self.fit_beside(&beside, sizes_m)
    }

    /// The parameters with these causes where the groups' deviations are of these sizes.
    fn fit_beside(&self, beside: &Beside, sizes_m: &[f64]) -> Option<Fit> {
        let is_of_frame = |group: usize| {
            (beside.reference && group == 0) || (beside.tool && group == self.joints)
        };
        let mut variances: Vec<f64> = self
            .of
            .iter()
            .map(|of| match of {
                Of::Anything => ANYTHING.powi(2),
                Of::Deviation { group, unit } => {
                    let frame = if is_of_frame(*group) { ANYTHING } else { 0.0 };
                    (unit * sizes_m[*group]).powi(2) + frame.powi(2)
                }
                Of::Growth => if beside.growth { GROWTH } else { NO_GROWTH }.powi(2),
            })
            .collect();
        for &joint in &beside.zeros {
            variances[self.zero_at(joint)] += ZERO.powi(2);
        }
        if let Some(last) = self.joints.checked_sub(1).filter(|_| beside.tool) {
            // A tool's turn about the last axis is a zero of the last joint.
            variances[self.zero_at(last)] += ANYTHING.powi(2);
        }
        let mut precision = self.normal.matrix.clone();
        for (i, variance) in variances.iter().enumerate() {
            precision[(i, i)] += variance.recip();
        }
        let cholesky = precision.cholesky()?;
        let mean = cholesky.solve(&self.normal.right);
        let log_det: f64 = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        let log_prior: f64 = variances.iter().map(|variance| variance.ln()).sum();
        let usual_m = self.usual(sizes_m);
        let unlike: f64 = self.groups().map(|group| (sizes_m[group] / usual_m).ln()).sum();
        Some(Fit {
            zeros: beside.zeros.clone(),
            sizes_m: sizes_m.to_vec(),
            evidence: self.normal.right.dot(&mean) - log_det - log_prior - 2.0 * ALIKE * unlike,
            mean,
            covariance: cholesky.inverse(),
        })
    }

    /// The zero of a joint that is in `fit`. What the joint's is off as all joints' are is in its error,
    /// whose size is known by the other joints alone.
    fn zero(&self, fit: &Fit, joint: usize) -> Option<Measured> {
        let at = self.zero_at(joint);
        let Of::Deviation { group, unit } = self.of[at] else { return None };
        let variance = fit.covariance[(at, at)] + (unit * fit.sizes_m[group]).powi(2);
        let others = ALIKE + (self.joints - fit.zeros.len()) as f64;
        (variance > 0.0).then(|| Measured {
            value: fit.mean[at],
            std_error: variance.sqrt(),
            dof: self.dof.min(others),
        })
    }

    /// The size about which those of the groups vary, m.
    fn usual(&self, sizes_m: &[f64]) -> f64 {
        let (least, most, _) = LINKS_M;
        let precisions: f64 = self.groups().map(|group| sizes_m[group].powi(-2)).sum();
        (self.groups().count() as f64 / precisions).sqrt().clamp(least, most)
    }

    /// The likeliest sizes of the groups' deviations with these zeros, from `sizes_m` on. Where the log says
    /// little of a group its size follows that of the others slowly, so that steps grow while they gain.
    fn settled(&self, zeros: &[usize], sizes_m: &[f64]) -> Option<Fit> {
        let (most, little) = SETTLING;
        let mut fit = self.fit(zeros, sizes_m)?;
        let mut stride = 1.0;
        for _ in 0..most {
            let likelier = self.likelier(&fit);
            let step = |(&size, &next): (&f64, &f64)| size * (next / size).powf(stride);
            let next: Vec<f64> = fit.sizes_m.iter().zip(&likelier).map(step).collect();
            // A step too far may leave no solution.
            match self.fit(zeros, &next).filter(|next| next.evidence > fit.evidence) {
                Some(next) => {
                    let gained = next.evidence - fit.evidence;
                    (fit, stride) = (next, 2.0 * stride);
                    if gained < little {
                        break;
                    }
                }
                None if stride > 1.0 => stride = 1.0,
                None => break,
            }
        }
        Some(fit)
    }

    /// The sizes under which the deviations of `fit` are likeliest, as they are known by it.
    fn likelier(&self, fit: &Fit) -> Vec<f64> {
        let named: Vec<usize> = fit.zeros.iter().map(|joint| self.zero_at(*joint)).collect();
        let usual_m = self.usual(&fit.sizes_m);
        let mut sums = vec![(ALIKE * usual_m.powi(2), ALIKE); fit.sizes_m.len()];
        for (i, of) in self.of.iter().enumerate().filter(|(i, _)| !named.contains(i)) {
            if let Of::Deviation { group, unit } = of {
                let square = fit.mean[i].powi(2) + fit.covariance[(i, i)];
                sums[*group].0 += square / unit.powi(2);
                sums[*group].1 += 1.0;
            }
        }
        sums.into_iter().map(|(sum, count)| (sum / count).sqrt()).collect()
    }

    /// No zeros, and links of the one size that fits best.
    fn without_zeros(&self) -> Option<Fit> {
        let (_, most, _) = LINKS_M;
        let fits = sizes_m(most).filter_map(|link_m| self.fit(&[], &self.alike(link_m)));
        let best = fits.max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
        self.settled(&[], &best.sizes_m)
    }

    /// Those `zeros` and one more, for each of the other joints.
    fn with_another(&self, zeros: &[usize], sizes_m: &[f64], but: &[usize]) -> Vec<(usize, Fit)> {
        let others =
            (0..self.joints).filter(|joint| !zeros.contains(joint) && !but.contains(joint));
        let with = |joint| {
            let with: Vec<usize> = zeros.iter().copied().chain([joint]).collect();
            Some((joint, self.settled(&with, sizes_m)?))
        };
        others.filter_map(with).collect()
    }

    /// The zeros that stand out of what the links make, those of `before` among them.
    fn likeliest(&self, before: Option<Fit>) -> Option<Fit> {
        let mut chosen = match before {
            Some(before) => self.settled(&before.zeros, &before.sizes_m)?,
            None => self.without_zeros()?,
        };
        while chosen.zeros.len() < MOST {
            let with = self.with_another(&chosen.zeros, &chosen.sizes_m, &[]);
            let best = with.into_iter().max_by(|a, b| a.1.evidence.total_cmp(&b.1.evidence));
            match best {
                Some((_, best)) if best.evidence > chosen.evidence + SURE => chosen = best,
                _ => break,
            }
        }
        Some(chosen)
    }

    /// `fit` in the columns of the joint track, where the model is linearised about `offsets`.
    fn told(&self, fit: &Fit, witness: &Witness, offsets: &[f64]) -> Drawing {
        let absolute = |joint: usize, zero: Measured| {
            let column = witness.columns[joint];
            (column, Measured { value: offsets[column] + zero.value, ..zero })
        };
        let mut zeros = vec![None; witness.joints.dof];
        let others = self.with_another(&fit.zeros, &fit.sizes_m, &[]);
        let named = fit.zeros.iter().filter_map(|&joint| Some((joint, self.zero(fit, joint)?)));
        let beside =
            others.iter().filter_map(|(joint, with)| Some((*joint, self.zero(with, *joint)?)));
        let told = beside.filter(|(_, zero)| zero.std_error < LEARNT * ZERO);
        for (joint, zero) in named.chain(told) {
            let (column, zero) = absolute(joint, zero);
            zeros[column] = Some(zero);
        }
        let twins = |&joint: &usize| {
            let instead = self.with_another(&fit.without(joint), &fit.sizes_m, &fit.zeros);
            let as_likely =
                instead.into_iter().filter(|(_, it)| it.evidence > fit.evidence - AS_LIKELY);
            let twin = |(other, it): (usize, Fit)| {
                let (column, zero) = absolute(other, self.zero(&it, other)?);
                Some(Twin::JointZero(column, zero.value))
            };
            (witness.columns[joint], as_likely.filter_map(twin).collect())
        };
        let links: Vec<usize> = self.groups().filter(|group| *group <= self.joints).collect();
        let squares: f64 = links.iter().map(|link| fit.sizes_m[*link].powi(2)).sum();
        Drawing {
            named: fit.zeros.iter().map(twins).collect(),
            zeros,
            link_m: (squares / links.len().max(1) as f64).sqrt(),
        }
    }
}

/// What each parameter changes of the columns of [`link_frames`], and what it is of: of each link's frame
/// the six deviations but for that which is its joint's zero, the latency, the zeros, which are a group of
/// their own, and the radial growth.
fn parameters(witness: &Witness, plain: &StreamState) -> (DMatrix<f64>, Vec<Of>) {
    let joints = witness.columns.len();
    let latency = 6 * (joints + 1);
    let unit = |turns: bool| if turns { RAD_PER_M } else { 1.0 };
    let mut columns: Vec<DVector<f64>> = Vec::new();
    let mut of = Vec::new();
    let growth = latency + 1 + joints;
    let axes = witness.chain.joint_axes();
    let kinds = witness.chain.joint_kinds();
    for link in 0..=joints {
        let is_free = is_anything(6 * link, witness, plain);
        let joint = link.checked_sub(1).filter(|_| !is_free);
        let basis = joint.map_or_else(Rotation::identity, |joint| turn_z_to(&axes[joint]));
        for (axis, turns) in (0..6).map(|i| (i % 3, i >= 3)) {
            let is_zero = |joint: usize| turns != (kinds[joint] == JointKind::Prismatic);
            if axis == 2 && joint.is_some_and(is_zero) {
                continue;
            }
            let first = 6 * link + if turns { 3 } else { 0 };
            let mut column = DVector::zeros(growth + 1);
            column.fixed_rows_mut::<3>(first).copy_from(&(basis * Vec3::ith(axis, 1.0)));
            columns.push(column);
            of.push(match is_free {
                true => Of::Anything,
                false => Of::Deviation { group: link, unit: unit(turns) },
            });
        }
    }
    for own in latency..=latency + joints {
        let mut column = DVector::zeros(growth + 1);
        column[own] = 1.0;
        columns.push(column);
        of.push(match own.checked_sub(latency + 1) {
            None => Of::Anything,
            Some(joint) => {
                let turns = kinds[joint] != JointKind::Prismatic;
                Of::Deviation { group: joints + 1, unit: unit(turns) }
            }
        });
    }
    let mut column = DVector::zeros(growth + 1);
    column[growth] = 1.0;
    columns.push(column);
    of.push(Of::Growth);
    (DMatrix::from_columns(&columns), of)
}
