//! Normal equations of the compliance terms together with all other causes of the model.

use super::ResidualSamples;
use super::term::{ComplianceTerm, FreeParameters};
use crate::model::measurement::{FLOOR_M, FLOOR_RAD};
use crate::solver::linear::{Linear, Normal, Weight};
use crate::solver::robust::sandwich;
use ground::geometry::Vec3;
use nalgebra::{DMatrix, DVector};

/// Per stream: latency, radial scale, reference and tool.
pub(super) const STREAM_PARAMETERS: usize = 14;
const CAUSE_COLUMNS: [std::ops::Range<usize>; 4] = [0..1, 1..2, 2..8, 8..14];

pub(super) struct ComplianceSystem {
    pub linears: Vec<Linear>,
    pub weights: Vec<Vec<Weight>>,
    pub normal: Normal,
    /// Parameters of each stream in the full system.
    pub columns: Vec<Vec<usize>>,
    /// First column per term.
    pub starts: Vec<usize>,
}

impl ComplianceSystem {
    pub fn sum(&mut self) {
        let width = self.columns.iter().flatten().max().map_or(0, |last| last + 1);
        /// Prior that damps the steps, as in the fit of the model.
        const DAMPING_SCALE: f64 = 0.02;
        let mut normal = Normal::zeros(width);
        for ((linear, weights), columns) in
            self.linears.iter().zip(&self.weights).zip(&self.columns)
        {
            linear.accumulate(weights, columns, &mut normal);
        }
        for parameter in 0..width {
            normal.matrix[(parameter, parameter)] += DAMPING_SCALE.powi(-2);
        }
        self.normal = normal;
    }

    pub fn update_weights(&mut self, step: &DVector<f64>) {
        let own = |columns: &[usize]| -> Vec<f64> { columns.iter().map(|&c| step[c]).collect() };
        self.weights = self
            .linears
            .iter()
            .zip(&self.columns)
            .map(|(linear, columns)| linear.weights_after(&own(columns)))
            .collect();
        self.sum();
    }

    /// Indices of the terms in `set` and the `free` parameters, ascending.
    pub fn parameters(
        &self,
        terms: &[ComplianceTerm],
        set: &[usize],
        free: &FreeParameters,
    ) -> Vec<usize> {
        let dof = free.zeros.len();
        let parameters_of_arm = dof + terms.iter().map(ComplianceTerm::width).sum::<usize>();
        let zeros =
            free.zeros.iter().enumerate().filter(|(_, free)| **free).map(|(joint, _)| joint);
        let mut parameters: Vec<usize> = zeros.collect();
        for &index in set {
            parameters.extend((0..terms[index].width()).map(|i| self.starts[index] + i));
        }
        for (s, parts) in free.streams.iter().enumerate() {
            for (part, _) in CAUSE_COLUMNS.into_iter().zip(parts).filter(|(_, free)| **free) {
                parameters.extend(
                    part.map(|parameter| parameters_of_arm + s * STREAM_PARAMETERS + parameter),
                );
            }
        }
        parameters.sort_unstable();
        parameters
    }

    pub fn step(&self, parameters: &[usize]) -> DVector<f64> {
        let none = DVector::zeros(self.normal.right.len());
        self.normal.step(&none, parameters)
    }

    pub fn cost(&self, parameters: &[usize]) -> f64 {
        self.normal.cost_after(&self.step(parameters))
    }

    /// `Σ n·ln σ`.
    pub fn noise(&self) -> f64 {
        let of_stream = |(linear, weights): (&Linear, &Vec<Weight>)| {
            let log = weights.iter().map(|weight| weight.noise.sigma.ln()).sum::<f64>();
            linear.len() as f64 * log
        };
        self.linears.iter().zip(&self.weights).map(of_stream).sum()
    }

    pub fn covariance(&self, parameters: &[usize]) -> DMatrix<f64> {
        let n = parameters.len();
        let (mut information, mut scores) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        for ((linear, weights), columns) in
            self.linears.iter().zip(&self.weights).zip(&self.columns)
        {
            let targets: Vec<Option<usize>> =
                columns.iter().map(|column| parameters.binary_search(column).ok()).collect();
            linear.accumulate_covariance(weights, &targets, &mut information, &mut scores);
        }
        sandwich(&information, &scores)
    }
}

/// Residuals and derivatives, in the base frame at the tip.
pub(super) fn linear(
    samples: &ResidualSamples,
    shapes: &[Vec<f64>],
    terms: &[ComplianceTerm],
    starts: &[usize],
    own: usize,
) -> Linear {
    const POSITION: usize = 0;
    const ROTATION: usize = 1;
    let mut linear = Linear::new(own + STREAM_PARAMETERS, &[FLOOR_M, FLOOR_RAD]);
    for (k, shapes) in shapes.iter().enumerate() {
        let mut rows = linear.push(&samples.residual[k]);
        let mut set = |column: usize, length: Vec3, angle: Vec3| {
            rows.set(POSITION, column, length.into());
            let angle = if samples.has_rotation { angle } else { Vec3::zeros() };
            rows.set(ROTATION, column, angle.into());
        };
        let of_joint = |joint: usize| {
            let [a, b, c, d, e, f] = samples.jacobian[k][joint];
            (Vec3::new(a, b, c), Vec3::new(d, e, f))
        };
        let (mut v, mut w) = (Vec3::zeros(), Vec3::zeros());
        for (joint, speed) in samples.qd[k].iter().enumerate() {
            let (length, angle) = of_joint(joint);
            set(joint, length, angle);
            v += length * *speed;
            w += angle * *speed;
        }
        let mut shapes = shapes.iter();
        for (term, &start) in terms.iter().zip(starts) {
            let (length, angle) = of_joint(term.column);
            for (i, shape) in shapes.by_ref().take(term.width()).enumerate() {
                set(start + i, length * *shape, angle * *shape);
            }
        }
        let fk = &samples.fk[k];
        let at = fk.translation.vector;
        set(own, -v, -w);
        set(own + 1, at, Vec3::zeros());
        for axis in 0..3 {
            let unit = Vec3::ith(axis, 1.0);
            set(own + 2 + axis, unit, Vec3::zeros());
            set(own + 5 + axis, unit.cross(&at), unit);
            let tool = fk.rotation * unit;
            set(own + 8 + axis, tool, Vec3::zeros());
            set(own + 11 + axis, Vec3::zeros(), tool);
        }
    }
    linear
}
