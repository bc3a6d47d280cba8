//! Joint zeros of an arm that is not its drawing.
//!
//! Every link of a real arm differs from its drawing by some hundredths of a millimetre and thousandths
//! of a degree, and a joint zero is named only where it stands out of what that makes. So the six
//! deviations of every link are random effects with a prior N(0, s²), lengths to angles as 1 mm to 0.1°,
//! and the zeros are fixed effects beside them; s is the one under which the log is likeliest (marginal
//! likelihood: Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, ch. 5.4; fixed
//! and random effects: Patterson and Thompson, *Recovery of inter-block information*, Biometrika 58,
//! 1971). The interval of a zero then holds the drawing's inaccuracy as well as the noise.

use super::Measured;
use super::linear::{Linear, Normal};
use super::model::{StreamState, Witness};
use super::nominal::{ANYTHING, is_anything, link_frames};
use nalgebra::{DMatrix, DVector};

/// The angle that a link is off where it is off by a length, rad/m: 0.1° to 1 mm.
pub(super) const RAD_PER_M: f64 = 1.745;
/// Deviations of a link that are tried, m: from the least to the most, each so many times the one before.
pub(super) const LINKS_M: (f64, f64, f64) = (1e-5, 3e-3, 1.6);
/// Size of a joint zero that is there, rad or m.
pub(super) const ZERO: f64 = 0.02;
/// A zero is named where the log is so much likelier with it, as twice the log of the ratio: it was
/// chosen among the joints.
const SURE: f64 = 16.0;
/// Zeros that are named at most.
const MOST: usize = 4;
/// Samples that are fitted.
pub(super) const SAMPLES: usize = 1000;
/// Rounds of fitting: zeros of degrees curve.
const ROUNDS: usize = 4;

/// The zeros of an arm's joints beside what its links are off.
#[derive(Clone, Debug)]
pub(super) struct Drawing {
    /// The columns of the joints whose zero is off.
    pub named: Vec<usize>,
    /// The zero of each joint of the track beside those, rad or m; `None` of one outside the chain.
    pub zeros: Vec<Option<Measured>>,
    /// By how much links differ from the drawing, as a standard deviation, m.
    pub link_m: f64,
}

impl Drawing {
    /// Joint offsets with the named zeros in them.
    pub fn with_zeros(&self, offsets: &[f64]) -> Vec<f64> {
        let mut with = offsets.to_vec();
        for &column in &self.named {
            with[column] = self.zeros[column].map_or(with[column], |zero| zero.value);
        }
        with
    }
}

/// The likeliest zeros beside links that are off, from `offsets` on; `plain` is the stream's state
/// without any cause that links may feign.
pub(super) fn drawing(witness: &Witness, plain: &StreamState, offsets: &[f64]) -> Option<Drawing> {
    let stride = witness.len().div_ceil(SAMPLES).max(1);
    let mut offsets = offsets.to_vec();
    let (mut found, mut named) = (None, Vec::new());
    for _ in 0..ROUNDS {
        let model = Model::at(witness, plain, &offsets, stride)?;
        let (chosen, link_m) = model.likeliest(named);
        let posterior = model.posterior(&chosen, link_m)?;
        let mut next = offsets.clone();
        for &joint in &chosen {
            next[witness.columns[joint]] += posterior.of(joint)?.value;
        }
        let moved = next.iter().zip(&offsets).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let zero = |joint: usize| {
            let with = match chosen.contains(&joint) {
                true => posterior.of(joint)?,
                false => {
                    let with: Vec<usize> = chosen.iter().copied().chain([joint]).collect();
                    model.posterior(&with, link_m)?.of(joint)?
                }
            };
            let from = offsets[witness.columns[joint]];
            Some(Measured { value: from + with.value, ..with })
        };
        let mut zeros = vec![None; witness.joints.dof];
        for joint in 0..witness.columns.len() {
            zeros[witness.columns[joint]] = zero(joint);
        }
        let columns = chosen.iter().map(|&joint| witness.columns[joint]).collect();
        found = Some(Drawing { named: columns, zeros, link_m });
        (offsets, named) = (next, chosen);
        if moved < 1e-6 {
            break;
        }
    }
    found
}

/// The log linearised in the link frames, the latency and the zeros.
struct Model {
    normal: Normal,
    /// Joints of the chain.
    joints: usize,
    /// Which of the link frames' parameters may be anything.
    free: Vec<bool>,
    /// Degrees of freedom behind the noise.
    dof: f64,
}

/// What is known of the parameters once the log is.
struct Posterior {
    /// The joints whose zeros are in it, in their order.
    zeros: Vec<usize>,
    first: usize,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    dof: f64,
}

impl Posterior {
    fn of(&self, joint: usize) -> Option<Measured> {
        let at = self.first + self.zeros.iter().position(|zero| *zero == joint)?;
        let variance = self.covariance[(at, at)];
        (variance > 0.0).then(|| Measured {
            value: self.mean[at],
            std_error: variance.sqrt(),
            dof: self.dof,
        })
    }
}

impl Model {
    fn at(witness: &Witness, plain: &StreamState, offsets: &[f64], stride: usize) -> Option<Self> {
        let rows = (0..witness.len()).step_by(stride);
        let linear = link_frames(witness, plain, offsets, rows, true);
        let joints = witness.columns.len();
        let links = 6 * (joints + 1) + 1;
        let free = (0..links).map(|i| is_anything(i, witness, plain)).collect();
        (linear.len() > linear.width).then(|| Self::of(&linear, joints, free))
    }

    /// Weighed by the noise that is left when all links may be off by a millimetre or so.
    fn of(linear: &Linear, joints: usize, free: Vec<bool>) -> Self {
        let all: Vec<usize> = (0..linear.width).collect();
        let every: Vec<usize> = (0..joints).collect();
        let mut weights = linear.first_weights();
        let mut model = Self { normal: Normal::zeros(linear.width), joints, free, dof: 3.0 };
        for _ in 0..4 {
            let mut normal = Normal::zeros(linear.width);
            linear.accumulate(&weights, &all, &mut normal);
            model.dof = (normal.independent - linear.width as f64).max(3.0);
            model.normal = normal;
            let Some(posterior) = model.posterior(&every, 1e-3) else { break };
            weights = linear.weights_after(posterior.mean.as_slice());
        }
        model
    }

    /// The precision of each parameter before the log is known.
    fn prior(&self, zeros: &[usize], link_m: f64) -> Vec<f64> {
        let links = self.free.iter().enumerate().map(|(i, is_free)| match (is_free, i % 6) {
            (true, _) => ANYTHING.powi(-2),
            (false, 0..3) => link_m.powi(-2),
            (false, _) => (RAD_PER_M * link_m).powi(-2),
        });
        links.chain(zeros.iter().map(|_| ZERO.powi(-2))).collect()
    }

    /// The parameters with these zeros, as the whole model numbers them.
    fn parameters(&self, zeros: &[usize]) -> Vec<usize> {
        let first = self.free.len();
        (0..first).chain(zeros.iter().map(|joint| first + joint)).collect()
    }

    /// The precision of the parameters once the log is known, and the right side of its equation.
    fn precision(&self, zeros: &[usize], link_m: f64) -> (DMatrix<f64>, DVector<f64>, Vec<f64>) {
        let at = self.parameters(zeros);
        let prior = self.prior(zeros, link_m);
        let n = at.len();
        let mut precision = DMatrix::from_fn(n, n, |i, j| self.normal.matrix[(at[i], at[j])]);
        for (i, prior) in prior.iter().enumerate() {
            precision[(i, i)] += prior;
        }
        (precision, DVector::from_fn(n, |i, _| self.normal.right[at[i]]), prior)
    }

    /// Twice the log of the marginal likelihood, up to what is the same for all.
    fn evidence(&self, zeros: &[usize], link_m: f64) -> f64 {
        let (precision, right, prior) = self.precision(zeros, link_m);
        let Some(cholesky) = precision.cholesky() else { return f64::NEG_INFINITY };
        let mean = cholesky.solve(&right);
        let log_det: f64 = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        right.dot(&mean) - log_det + prior.iter().map(|prior| prior.ln()).sum::<f64>()
    }

    fn posterior(&self, zeros: &[usize], link_m: f64) -> Option<Posterior> {
        let (precision, right, _) = self.precision(zeros, link_m);
        let cholesky = precision.cholesky()?;
        Some(Posterior {
            zeros: zeros.to_vec(),
            first: self.free.len(),
            mean: cholesky.solve(&right),
            covariance: cholesky.inverse(),
            dof: self.dof,
        })
    }

    /// The best size of the links' deviations with these zeros, and the evidence of it.
    fn best_link(&self, zeros: &[usize]) -> (f64, f64) {
        let (least, most, times) = LINKS_M;
        let tried = std::iter::successors(Some(least), |link_m| Some(link_m * times));
        tried
            .take_while(|link_m| *link_m < most)
            .map(|link_m| (link_m, self.evidence(zeros, link_m)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((least, f64::NEG_INFINITY))
    }

    /// The zeros that stand out of what the links make, those of `named` among them, and by how much
    /// links are off, m.
    fn likeliest(&self, named: Vec<usize>) -> (Vec<usize>, f64) {
        let mut chosen = named;
        let (mut link_m, mut evidence) = self.best_link(&chosen);
        while chosen.len() < MOST {
            let others = (0..self.joints).filter(|joint| !chosen.contains(joint));
            let with = |joint| {
                let with: Vec<usize> = chosen.iter().copied().chain([joint]).collect();
                let (link_m, evidence) = self.best_link(&with);
                (with, link_m, evidence)
            };
            let best = others.map(with).max_by(|a, b| a.2.total_cmp(&b.2));
            match best {
                Some((with, best_m, gained)) if gained > evidence + SURE => {
                    (chosen, link_m, evidence) = (with, best_m, gained);
                }
                _ => break,
            }
        }
        (chosen, link_m)
    }
}
