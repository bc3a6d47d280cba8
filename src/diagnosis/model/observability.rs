//! Observability of each parameter in the motion of a log.
//!
//! The information matrix of a stream's model gives its change, in standard deviations of noise, per change
//! of the parameters. Weak directions are not observable in this log. Those that stay weak in a random
//! motion through the whole joint space, such as the first joint's zero against a base rotation, are not
//! observable in any log and are excluded.

use super::measurement::{PoseObservations, STREAM_WIDTH, StreamAt, StreamState};
use crate::samples::sampling::value_range;
use ground::geometry::{Rotation, Vec3};
use ground::robot::JointKind;
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::PI;

/// Configurations of the reference motion, which excites everything observable.
const CONFIGURATIONS: usize = 200;
const STEP_S: f64 = 0.1;
/// Smaller shares of that motion's largest eigenvalue are not observable in any log.
const MIN_EIGENVALUE_SHARE: f64 = 1e-9;
/// For listing a parameter in a direction.
const MIN_WEIGHT: f64 = 0.2;

/// Parameter of a pose stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamParameter {
    /// Zero of the joint in this column, rad or m.
    JointZero(usize),
    /// Latency, s.
    Latency,
    /// Clock skew, s/s.
    Skew,
    /// Radial scale, m/m.
    RadialScale,
    /// Reference translation along axis 0 to 2, m.
    ReferenceShift(usize),
    /// Reference rotation about axis 0 to 2, rad.
    ReferenceTurn(usize),
    /// Tool translation along axis 0 to 2, m.
    ToolShift(usize),
    /// Tool rotation about axis 0 to 2, rad.
    ToolTurn(usize),
}

impl StreamParameter {
    /// Parameters of a stream, in the order of their columns.
    fn of_stream() -> impl Iterator<Item = Self> {
        let axes = |of: fn(usize) -> Self| (0..3).map(of);
        [Self::Latency, Self::Skew, Self::RadialScale]
            .into_iter()
            .chain(axes(Self::ReferenceShift))
            .chain(axes(Self::ReferenceTurn))
            .chain(axes(Self::ToolShift))
            .chain(axes(Self::ToolTurn))
    }
}

/// Information of a log about each parameter.
#[derive(Clone, Debug)]
pub struct Observability {
    parameters: Vec<StreamParameter>,
    /// `Aᵀ W A` of this log.
    information: DMatrix<f64>,
    /// Same, unweighted, of a motion through the whole joint space.
    possible: DMatrix<f64>,
    /// Range of each joint, rad or m.
    pub travel: Vec<f64>,
}

/// Direction that the log barely observes.
#[derive(Clone, Debug, PartialEq)]
pub struct WeakDirection {
    /// Parameters with weights, in units of their thresholds. The first is largest, ±1.
    pub parameters: Vec<(StreamParameter, f64)>,
    /// Change of the stream, in standard deviations, for changes of weight times threshold, divided by the
    /// norm of the weights.
    pub singular_value: f64,
}

impl Observability {
    /// From `information` over the track's joints, then the stream's parameters.
    pub(crate) fn new(stream: StreamAt, information: &DMatrix<f64>) -> Self {
        let StreamAt { observations, offsets, .. } = stream;
        let dof = observations.joints.dof;
        let has_zero = |joint: &usize| {
            !observations.chain.is_floating() && observations.columns.contains(joint)
        };
        let joints: Vec<usize> = (0..dof).filter(has_zero).collect();
        let own = offsets.len();
        let zeros = joints.iter().copied().map(StreamParameter::JointZero);
        let parameters = zeros.chain(StreamParameter::of_stream()).collect();
        let kept: Vec<usize> = joints.into_iter().chain(own..own + STREAM_WIDTH).collect();
        let part = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(kept.len(), kept.len(), |i, j| matrix[(kept[i], kept[j])])
        };
        Self {
            parameters,
            information: part(information),
            possible: part(&achievable_information(stream)),
            travel: (0..dof).map(|joint| travel(observations.joints, joint)).collect(),
        }
    }

    /// Track columns of joints with a parameter.
    pub fn joints(&self) -> impl Iterator<Item = usize> {
        self.parameters.iter().filter_map(|parameter| match parameter {
            StreamParameter::JointZero(joint) => Some(*joint),
            _ => None,
        })
    }

    /// Directions in which a change by one threshold moves the log by less than `least` standard
    /// deviations. Excludes those that no log observes. `threshold` returns the smallest relevant value of
    /// a parameter, in its unit.
    pub fn weak_directions(
        &self,
        threshold: impl Fn(StreamParameter) -> f64,
        least: f64,
    ) -> Vec<WeakDirection> {
        let thresholds: Vec<f64> = self.parameters.iter().map(|&one| threshold(one)).collect();
        let n = thresholds.len();
        let scaled = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * thresholds[i] * thresholds[j])
        };
        let information = scaled(&self.information);
        let possible = scaled(&self.possible);
        // Absurd positions overflow, and directions are undefined.
        if n == 0 || !information.iter().chain(possible.iter()).all(|entry| entry.is_finite()) {
            return Vec::new();
        }
        let possible = possible.symmetric_eigen();
        let threshold = MIN_EIGENVALUE_SHARE * possible.eigenvalues.max();
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

    /// Joint ranges only.
    pub fn from_travel(travel: Vec<f64>) -> Self {
        let parameters = (0..travel.len()).map(StreamParameter::JointZero).collect();
        let none = DMatrix::zeros(travel.len(), travel.len());
        Self { parameters, information: none.clone(), possible: none, travel }
    }

    fn described(&self, direction: &DVector<f64>, information: &DMatrix<f64>) -> WeakDirection {
        let square = direction.dot(&(information * direction)) / direction.norm_squared();
        let weights = self.parameters.iter().copied().zip(direction.iter().copied());
        let mut parameters: Vec<(StreamParameter, f64)> =
            weights.filter(|(_, weight)| weight.abs() > MIN_WEIGHT).collect();
        // Rounding makes the order of equal weights portable.
        let digits = |weight: f64| (weight.abs() * 1e6).round();
        parameters.sort_by(|a, b| digits(b.1).total_cmp(&digits(a.1)));
        WeakDirection { parameters, singular_value: square.max(0.0).sqrt() }
    }
}

/// Combines columns so that each has its own dominant parameter, of weight 1 there and 0 elsewhere
/// (Gauss–Jordan with complete pivoting). Combinations of unobservable directions are unobservable; these
/// are the most readable.
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

pub(crate) fn travel(joints: &JointTrack, joint: usize) -> f64 {
    value_range(joints.positions_of(joint)).max(0.0)
}

/// Random configurations over the joints' ranges, at speeds of both signs.
fn achievable_information(StreamAt { observations, state, offsets }: StreamAt) -> DMatrix<f64> {
    let dof = observations.joints.dof;
    let mut random = Pcg64::seed_from_u64(1);
    let kinds = observations.chain.joint_kinds();
    // Prismatic, or the position of a floating joint; its quaternion may have any length.
    let mut is_short = vec![false; dof];
    for (at, (kind, &column)) in kinds.iter().zip(observations.columns).enumerate() {
        is_short[column] =
            *kind == JointKind::Prismatic || (*kind == JointKind::Floating && at < 3);
    }
    let mut drawn = |most: f64| -> Vec<f64> {
        let draw =
            |i: usize| random.random_range(-1.0..1.0) * if is_short[i % dof] { 0.5 } else { most };
        (0..CONFIGURATIONS * dof).map(draw).collect()
    };
    let t_s: Vec<f64> = (0..CONFIGURATIONS).map(|row| row as f64 * STEP_S).collect();
    let (q, qd) = (drawn(PI), drawn(1.0));
    let joints = JointTrack { t_s: t_s.clone(), dof, q, qd, noise: Vec::new() };
    let ideal = PoseObservations {
        joints: &joints,
        rest_speeds: &vec![0.0; dof],
        xyz: vec![Vec3::zeros(); CONFIGURATIONS],
        rotation: vec![Rotation::identity(); CONFIGURATIONS],
        middle_s: 0.5 * t_s[CONFIGURATIONS - 1],
        moving_frame: None,
        t_s,
        ..*observations
    };
    // Without latency, stamps match the configurations.
    let at_postures = StreamState { latency_s: 0.0, skew: 0.0, ..state.clone() };
    let linear = ideal.at(&at_postures, offsets).linearize(CONFIGURATIONS);
    linear.information(&linear.even_weights())
}
