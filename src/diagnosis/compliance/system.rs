//! Normal equations of compliance terms. All constant causes are free, links within their prior.

use super::StreamSamples;
use crate::priors::{ZERO_PRIOR, price};
use crate::residuals::cause_columns::{VariableColumns, shared_equations};
use crate::solver::linear::{Normal, SharedEquations, StreamEquations};
use nalgebra::{DMatrix, DVector};

/// Coefficient of a term: its joint, and its profile by stream and sample.
pub(super) struct Coefficient {
    pub column: usize,
    pub profiles: Vec<Vec<f64>>,
}

/// Parameters are the coefficients, then the constant causes of each stream.
pub(super) struct ComplianceSystem {
    equations: SharedEquations,
    /// Equations of the coefficients, with the best constant causes.
    profiled: Normal,
}

impl ComplianceSystem {
    pub fn new<'a>(samples: &'a [StreamSamples<'a>], coefficients: &[Coefficient]) -> Self {
        let of_stream = |(s, stream): (usize, &'a StreamSamples)| {
            let variable = |(parameter, it): (usize, &Coefficient)| {
                let (columns, factors) = (stream.columns.zero(it.column)?, it.profiles[s].clone());
                Some((parameter, VariableColumns { columns, factors, along: None }))
            };
            (&stream.columns, coefficients.iter().enumerate().filter_map(variable).collect())
        };
        let streams = samples.iter().enumerate().map(of_stream);
        let mut equations = shared_equations(coefficients.len(), streams);
        (0..coefficients.len()).for_each(|at| equations.prior[(at, at)] = ZERO_PRIOR.powi(-2));
        let mut normal = equations.normal();
        for _ in 0..2 {
            equations.update_weights(&normal.full_step());
            normal = equations.normal();
        }
        Self { profiled: normal.profiled(coefficients.len()), equations }
    }

    /// Price of a coefficient.
    pub fn price(&self) -> f64 {
        price(self.profiled.independent)
    }

    /// Degrees of freedom besides the parameters.
    pub fn dof(&self) -> f64 {
        self.profiled.dof(self.equations.prior.nrows())
    }

    /// Cost with the best values of these coefficients.
    pub fn cost(&self, coefficients: &[usize]) -> f64 {
        self.profiled.cost_after(&self.profiled.step_from_zero(coefficients))
    }

    /// Best value of a coefficient alone.
    pub fn best_value(&self, coefficient: usize) -> f64 {
        self.profiled.step_from_zero(&[coefficient])[coefficient]
    }

    /// `Σ n·ln σ`.
    pub fn noise(&self) -> f64 {
        let of_stream = |StreamEquations { linear, weights, .. }: &StreamEquations| {
            let log = weights.iter().map(|weight| weight.noise.sigma.ln()).sum::<f64>();
            linear.len() as f64 * log
        };
        self.equations.streams.iter().map(of_stream).sum()
    }

    /// Best values of all coefficients, and their covariance.
    pub fn estimate(&self) -> (DVector<f64>, DMatrix<f64>) {
        let covariance = self.equations.covariance();
        let values = self.profiled.full_step();
        let own = covariance.view((0, 0), (values.len(), values.len())).into_owned();
        (values, own)
    }
}
