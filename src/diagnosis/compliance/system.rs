//! Normal equations of compliance terms. All constant causes are free, links within their prior.

use super::StreamSamples;
use crate::priors::ZERO_PRIOR;
use crate::residuals::cause_columns::{VariableColumns, ZEROS};
use crate::solver::linear::{Linear, Normal, Weight};
use crate::solver::robust::sandwich;
use nalgebra::{DMatrix, DVector};

/// Coefficient of a term: its joint, and its profile by stream and sample.
pub(super) struct Coefficient {
    pub column: usize,
    pub profiles: Vec<Vec<f64>>,
}

/// Parameters are the coefficients, then the constant causes of each stream.
pub(super) struct ComplianceSystem<'a> {
    samples: &'a [StreamSamples<'a>],
    coefficients: usize,
    linears: Vec<Linear>,
    weights: Vec<Vec<Weight>>,
    /// Parameter of each column of a stream.
    parameters: Vec<Vec<usize>>,
    normal: Normal,
    /// Equations of the coefficients, with the best constant causes.
    profiled: Normal,
}

impl<'a> ComplianceSystem<'a> {
    pub fn new(samples: &'a [StreamSamples<'a>], coefficients: &[Coefficient]) -> Self {
        let mut width = coefficients.len();
        let (mut linears, mut parameters) = (Vec::new(), Vec::new());
        for (s, stream) in samples.iter().enumerate() {
            let (mut seen, mut variable) = (Vec::new(), Vec::new());
            for (parameter, Coefficient { column, profiles }) in coefficients.iter().enumerate() {
                if let Some(joint) = stream.joint(*column) {
                    seen.push(parameter);
                    let columns = ZEROS + joint..ZEROS + joint + 1;
                    let factors = profiles[s].clone();
                    variable.push(VariableColumns { columns, factors, along: None });
                }
            }
            let constant = stream.columns.constant();
            parameters.push((width..width + constant).chain(seen).collect::<Vec<usize>>());
            width += constant;
            linears.push(stream.columns.linearize(&variable));
        }
        let weights = linears.iter().map(Linear::first_weights).collect();
        let (normal, profiled) = (Normal::zeros(width), Normal::zeros(coefficients.len()));
        let coefficients = coefficients.len();
        let mut system =
            Self { samples, coefficients, linears, weights, parameters, normal, profiled };
        system.sum();
        for _ in 0..2 {
            let step = system.normal.full_step();
            let own = |parameters: &[usize]| parameters.iter().map(|&p| step[p]).collect();
            let own: Vec<Vec<f64>> = system.parameters.iter().map(|it| own(it)).collect();
            let weights = system.linears.iter().zip(own);
            system.weights = weights.map(|(linear, step)| linear.weights_after(&step)).collect();
            system.sum();
        }
        system
    }

    fn sum(&mut self) {
        self.normal = Normal::zeros(self.normal.right.len());
        for ((linear, weights), parameters) in
            self.linears.iter().zip(&self.weights).zip(&self.parameters)
        {
            linear.accumulate(weights, parameters, &mut self.normal);
        }
        self.normal.matrix += self.prior();
        self.profiled = self.normal.profiled(self.coefficients);
    }

    /// Precision of the prior.
    fn prior(&self) -> DMatrix<f64> {
        let width = self.normal.right.len();
        let mut prior = DMatrix::zeros(width, width);
        for coefficient in 0..self.coefficients {
            prior[(coefficient, coefficient)] = ZERO_PRIOR.powi(-2);
        }
        let mut start = self.coefficients;
        for stream in self.samples {
            let own = stream.columns.constant();
            prior.view_mut((start, start), (own, own)).copy_from(&stream.columns.prior());
            start += own;
        }
        prior
    }

    pub fn independent(&self) -> f64 {
        self.normal.independent
    }

    /// Degrees of freedom besides the parameters.
    pub fn dof(&self) -> f64 {
        (self.normal.independent - self.normal.right.len() as f64).max(3.0)
    }

    /// Cost with the best values of these coefficients.
    pub fn cost(&self, coefficients: &[usize]) -> f64 {
        let step = self.profiled.step(&DVector::zeros(self.coefficients), coefficients);
        self.profiled.cost_after(&step)
    }

    /// Best value of a coefficient alone.
    pub fn best_value(&self, coefficient: usize) -> f64 {
        self.profiled.step(&DVector::zeros(self.coefficients), &[coefficient])[coefficient]
    }

    /// `Σ n·ln σ`.
    pub fn noise(&self) -> f64 {
        let of_stream = |(linear, weights): (&Linear, &Vec<Weight>)| {
            let log = weights.iter().map(|weight| weight.noise.sigma.ln()).sum::<f64>();
            linear.len() as f64 * log
        };
        self.linears.iter().zip(&self.weights).map(of_stream).sum()
    }

    /// Best values of all coefficients, and their covariance.
    pub fn estimate(&self) -> (DVector<f64>, DMatrix<f64>) {
        let values = self.profiled.full_step();
        // The prior is as good as samples.
        let mut information = self.prior();
        let mut scores = information.clone();
        for ((linear, weights), parameters) in
            self.linears.iter().zip(&self.weights).zip(&self.parameters)
        {
            let targets: Vec<Option<usize>> = parameters.iter().copied().map(Some).collect();
            linear.accumulate_covariance(weights, &targets, &mut information, &mut scores);
        }
        let covariance = sandwich(&information, &scores);
        (values, covariance.view((0, 0), (self.coefficients, self.coefficients)).into_owned())
    }
}
