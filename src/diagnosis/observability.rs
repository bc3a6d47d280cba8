//! What the motion of a log shows of each cause, and what it cannot show.
//!
//! The information matrix of a stream's whole model (every joint's zero, latency, skew, growth and
//! both frames) says how far each change of the parameters moves the stream, in standard deviations
//! of its noise. Directions in which it is small are those that the log does not see. Some are seen
//! in no log, as the first joint's zero against a turn of the base: those are what a motion through
//! every posture leaves blind, and they are set apart.

use super::model::{GROWTH, LATENCY, REFERENCE, SKEW, STREAM_WIDTH, StreamState, TOOL, Witness};
use ground::geometry::{Rotation, Vec3};
use ground::robot::JointKind;
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::PI;

/// Postures of the motion that shows all that can be seen.
const POSTURES: usize = 200;
/// Time between them, s.
const STEP_S: f64 = 0.1;
/// Directions of which that motion shows less than this share are seen in no log.
const NEVER: f64 = 1e-9;
/// Parameters with a smaller weight than this take no part in a direction.
const TAKES_PART: f64 = 0.2;

/// One number of the model of a pose stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Zero offset of a joint, by its column in the joint track, rad or m.
    JointZero(usize),
    /// Latency, s.
    Latency,
    /// Clock skew, s/s.
    Skew,
    /// Growth with reach, m/m.
    Growth,
    /// Shift of the reference frame along an axis (0 to 2), m.
    ReferenceShift(usize),
    /// Turn of the reference frame about an axis (0 to 2), rad.
    ReferenceTurn(usize),
    /// Shift of the tool frame along an axis (0 to 2), m.
    ToolShift(usize),
    /// Turn of the tool frame about an axis (0 to 2), rad.
    ToolTurn(usize),
}

impl Parameter {
    fn of_stream(column: usize) -> Self {
        match column {
            LATENCY => Self::Latency,
            SKEW => Self::Skew,
            GROWTH => Self::Growth,
            _ if column < REFERENCE + 3 => Self::ReferenceShift(column - REFERENCE),
            _ if column < TOOL => Self::ReferenceTurn(column - REFERENCE - 3),
            _ if column < TOOL + 3 => Self::ToolShift(column - TOOL),
            _ => Self::ToolTurn(column - TOOL - 3),
        }
    }
}

/// How much a stream's log tells of each parameter.
#[derive(Clone, Debug)]
pub struct Observability {
    parameters: Vec<Parameter>,
    /// What this log tells: `Aᵀ W A`.
    information: DMatrix<f64>,
    /// The same of a motion through every posture, in units of its own.
    possible: DMatrix<f64>,
    /// How far each joint of the track moves over the run, rad or m.
    pub travel: Vec<f64>,
}

/// A change of the parameters that a log hardly shows.
#[derive(Clone, Debug, PartialEq)]
pub struct BlindDirection {
    /// The parameters that take part with their weights, in units of each one's threshold; the greatest
    /// weight, which is 1 or −1, first.
    pub parameters: Vec<(Parameter, f64)>,
    /// By how many standard deviations the log moves where the parameters change by their weights
    /// times their thresholds, over the root of the sum of squares of the weights.
    pub singular_value: f64,
}

impl Observability {
    /// Of a stream whose model at `state` has `information`: over the joints of the track and then
    /// the stream's own parameters.
    pub(super) fn of(
        witness: &Witness,
        state: &StreamState,
        offsets: &[f64],
        information: &DMatrix<f64>,
    ) -> Self {
        let dof = witness.joints.dof;
        let joints = (0..dof).filter(|joint| witness.columns.contains(joint));
        let own = offsets.len();
        let kept: Vec<usize> = joints.chain(own..own + STREAM_WIDTH).collect();
        let parameter = |&column: &usize| match column.checked_sub(own) {
            None => Parameter::JointZero(column),
            Some(own) => Parameter::of_stream(own),
        };
        let part = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(kept.len(), kept.len(), |i, j| matrix[(kept[i], kept[j])])
        };
        Self {
            parameters: kept.iter().map(parameter).collect(),
            information: part(information),
            possible: part(&possible(witness, state, offsets)),
            travel: (0..dof).map(|joint| travel(witness.joints, joint)).collect(),
        }
    }

    /// The joints that take part, by their columns in the joint track.
    pub fn joints(&self) -> impl Iterator<Item = usize> {
        self.parameters.iter().filter_map(|parameter| match parameter {
            Parameter::JointZero(joint) => Some(*joint),
            _ => None,
        })
    }

    /// The directions, orthogonal to those that no log shows, in which a change of the parameters by
    /// their thresholds moves the log by less than `least` standard deviations.
    ///
    /// `threshold` is the amount of each parameter that matters, in its unit.
    pub fn blind(&self, threshold: impl Fn(Parameter) -> f64, least: f64) -> Vec<BlindDirection> {
        let thresholds: Vec<f64> = self.parameters.iter().map(|&one| threshold(one)).collect();
        let n = thresholds.len();
        let scaled = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * thresholds[i] * thresholds[j])
        };
        let information = scaled(&self.information);
        let possible = scaled(&self.possible);
        // Positions and lengths that no arm has overflow; of no number there is no direction.
        if n == 0 || !information.iter().chain(possible.iter()).all(|entry| entry.is_finite()) {
            return Vec::new();
        }
        let possible = possible.symmetric_eigen();
        let threshold = NEVER * possible.eigenvalues.max();
        let seen: Vec<usize> = (0..n).filter(|&i| possible.eigenvalues[i] > threshold).collect();
        if seen.is_empty() {
            return Vec::new();
        }
        let basis = possible.eigenvectors.select_columns(&seen);
        let eigen = (basis.transpose() * &information * &basis).symmetric_eigen();
        let weak: Vec<usize> =
            (0..seen.len()).filter(|&i| eigen.eigenvalues[i] < least * least).collect();
        let directions = simplest(basis * eigen.eigenvectors.select_columns(&weak));
        directions.iter().map(|direction| self.described(direction, &information)).collect()
    }

    /// Of joints that move so far, with nothing else known.
    pub fn of_travel(travel: Vec<f64>) -> Self {
        let parameters = (0..travel.len()).map(Parameter::JointZero).collect();
        let none = DMatrix::zeros(travel.len(), travel.len());
        Self { parameters, information: none.clone(), possible: none, travel }
    }

    fn described(&self, direction: &DVector<f64>, information: &DMatrix<f64>) -> BlindDirection {
        let square = direction.dot(&(information * direction)) / direction.norm_squared();
        let weights = self.parameters.iter().copied().zip(direction.iter().copied());
        let mut parameters: Vec<(Parameter, f64)> =
            weights.filter(|(_, weight)| weight.abs() > TAKES_PART).collect();
        // Weights that are equal but for rounding stay in the model's order, on every machine.
        let digits = |weight: f64| (weight.abs() * 1e6).round();
        parameters.sort_by(|a, b| digits(b.1).total_cmp(&digits(a.1)));
        BlindDirection { parameters, singular_value: square.max(0.0).sqrt() }
    }
}

/// The columns mixed so that each has a parameter of its own: the one with the most weight in it,
/// which is 1 there and 0 in all others (Gauss–Jordan with complete pivoting). Any mix of blind
/// directions is blind; these are those that can be read.
fn simplest(columns: DMatrix<f64>) -> Vec<DVector<f64>> {
    let mut rows = columns.transpose();
    for row in 0..rows.nrows() {
        let (down, pivot) = rows.rows_range(row..).iamax_full();
        rows.swap_rows(row, row + down);
        let value = rows[(row, pivot)];
        let own = rows.row(row) / value;
        rows.set_row(row, &own);
        for other in (0..rows.nrows()).filter(|&other| other != row) {
            let share = rows[(other, pivot)];
            let reduced = rows.row(other) - share * &own;
            rows.set_row(other, &reduced);
        }
    }
    rows.row_iter().map(|row| row.transpose() / row.amax().max(f64::MIN_POSITIVE)).collect()
}

/// How far a joint moves over the run.
pub(super) fn travel(joints: &JointTrack, joint: usize) -> f64 {
    let column = || joints.q.iter().skip(joint).step_by(joints.dof.max(1)).copied();
    let (low, high) = column()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| (low.min(q), high.max(q)));
    (high - low).max(0.0)
}

/// The information of a motion through postures all over the joints' ranges, at speeds of all signs.
fn possible(witness: &Witness, state: &StreamState, offsets: &[f64]) -> DMatrix<f64> {
    let dof = witness.joints.dof;
    let mut random = Pcg64::seed_from_u64(1);
    let kinds = witness.chain.joint_kinds();
    let mut slides = vec![false; dof];
    for (kind, &column) in kinds.iter().zip(witness.columns) {
        slides[column] = *kind == JointKind::Prismatic;
    }
    let mut drawn = |most: f64| -> Vec<f64> {
        let draw =
            |i: usize| random.random_range(-1.0..1.0) * if slides[i % dof] { 0.5 } else { most };
        (0..POSTURES * dof).map(draw).collect()
    };
    let t_s: Vec<f64> = (0..POSTURES).map(|row| row as f64 * STEP_S).collect();
    let (q, qd) = (drawn(PI), drawn(1.0));
    let joints = JointTrack { t_s: t_s.clone(), dof, q, qd, noise: Vec::new() };
    let ideal = Witness {
        joints: &joints,
        chain: witness.chain,
        columns: witness.columns,
        gained: witness.gained,
        reference_known: witness.reference_known,
        still: &vec![0.0; dof],
        xyz: vec![Vec3::zeros(); POSTURES],
        rotation: vec![Rotation::identity(); POSTURES],
        blind: witness.blind,
        tool_part: witness.tool_part,
        middle_s: 0.5 * t_s[POSTURES - 1],
        t_s,
    };
    // Stamps at which the content is that of the postures themselves.
    let at_postures = StreamState { latency_s: 0.0, skew: 0.0, ..state.clone() };
    let linear = ideal.linearize(&at_postures, offsets, 1);
    linear.information(&linear.even_weights())
}
