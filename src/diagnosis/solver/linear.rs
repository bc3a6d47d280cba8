//! Linear least squares under correlated noise.

use super::noise::Noise;
use super::recurrence::Places;
use super::robust::{MIN_OBSERVABLE_EIGENVALUE, huber, pseudo_inverse, robust_sigma, sandwich};
use ground::geometry::Vec3;
use nalgebra::{DMatrix, DMatrixView, DVector, Dyn};
use std::ops::AddAssign;
use std::sync::OnceLock;

/// Residuals and design matrix of a stream, linearised about a state. Each sample has a three-component
/// residual per kind: position and rotation of a pose, or the rotation of an IMU.
pub(crate) struct Linear {
    /// Number of parameters.
    pub width: usize,
    /// Residuals by kind and sample.
    pub residual: Vec<Vec<Vec3>>,
    /// Minimum standard deviation of each kind, in its unit.
    floor: Vec<f64>,
    /// Derivatives: three rows of `width` per kind and sample.
    design: Vec<f64>,
    /// Upper triangle of `AᵀA` of each kind, computed on first use.
    squares: OnceLock<Vec<DMatrix<f64>>>,
    /// Place of each sample. Empty if recurring errors are not considered.
    pub places: Places,
}

pub(crate) struct Rows<'a> {
    values: &'a mut [f64],
    width: usize,
}

impl Rows<'_> {
    /// Sets the derivatives of `kind` by parameter `column`.
    pub fn set(&mut self, kind: usize, column: usize, derivative: Vec3) {
        for (axis, value) in derivative.iter().enumerate() {
            self.values[(kind * 3 + axis) * self.width + column] = *value;
        }
    }

    /// Sets the derivatives of the first kind by the columns from `first` on.
    pub fn set_from(&mut self, first: usize, derivatives: impl IntoIterator<Item = Vec3>) {
        (first..).zip(derivatives).for_each(|(column, own)| self.set(0, column, own));
    }

    /// The same for every kind.
    pub fn set_all<const N: usize>(&mut self, column: usize, derivatives: [Vec3; N]) {
        derivatives.into_iter().enumerate().for_each(|(kind, own)| self.set(kind, column, own));
    }
}

#[derive(Clone)]
pub(crate) struct Weight {
    pub noise: Noise,
    /// Huber weights, 0 to 1.
    robust: Vec<f64>,
}

/// Fit with weights from its own residuals.
pub(crate) struct ReweightedFit {
    /// Equations of the step.
    pub normal: Normal,
    pub step: DVector<f64>,
    /// After the step, by kind.
    pub residuals: Vec<Vec<Vec3>>,
    /// From these residuals.
    pub weights: Vec<Weight>,
}

impl Weight {
    pub fn leave_out(&mut self, sample: usize) {
        self.robust[sample] = 0.0;
    }
}

impl Linear {
    /// Empty system with one kind per entry of `floor`.
    pub fn new(width: usize, floor: &[f64]) -> Self {
        let residual = floor.iter().map(|_| Vec::new()).collect();
        Self {
            width,
            residual,
            floor: floor.to_vec(),
            design: Vec::new(),
            squares: OnceLock::new(),
            places: Places::default(),
        }
    }

    /// Raises the smallest noise of each kind.
    pub fn raise_floors(&mut self, floors: &[f64]) {
        self.floor.iter_mut().zip(floors).for_each(|(floor, other)| *floor = floor.max(*other));
    }

    pub fn reserve(&mut self, samples: usize) {
        self.residual.iter_mut().for_each(|column| column.reserve(samples));
        self.design.reserve(samples * 3 * self.kinds() * self.width);
    }

    /// Appends a sample. Returns its derivatives, initially zero.
    pub fn push(&mut self, residuals: &[Vec3]) -> Rows<'_> {
        for (column, residual) in self.residual.iter_mut().zip(residuals) {
            column.push(*residual);
        }
        let start = self.design.len();
        self.design.resize(start + 3 * self.kinds() * self.width, 0.0);
        Rows { values: &mut self.design[start..], width: self.width }
    }

    pub fn len(&self) -> usize {
        self.residual.first().map_or(0, Vec::len)
    }

    fn kinds(&self) -> usize {
        self.floor.len()
    }

    /// Sets a derivative of one row of a sample.
    pub fn set(&mut self, sample: usize, row: usize, column: usize, derivative: f64) {
        let start = (sample * 3 * self.kinds() + row) * self.width;
        self.design[start + column] = derivative;
    }

    /// Derivatives of one row of a sample.
    pub fn row(&self, sample: usize, row: usize) -> &[f64] {
        let start = (sample * 3 * self.kinds() + row) * self.width;
        &self.design[start..start + self.width]
    }

    pub fn residual(&self, sample: usize, row: usize) -> f64 {
        self.residual[row / 3][sample][row % 3]
    }

    /// Residuals after a step, by kind.
    pub fn residuals_after(&self, step: &[f64]) -> Vec<Vec<Vec3>> {
        let remaining = |sample: usize, kind: usize| {
            Vec3::from_fn(|axis, _| {
                let row = self.row(sample, 3 * kind + axis);
                let explained: f64 = row.iter().zip(step).map(|(a, d)| a * d).sum();
                self.residual[kind][sample][axis] - explained
            })
        };
        let of_kind = |kind: usize| (0..self.len()).map(|sample| remaining(sample, kind)).collect();
        (0..self.kinds()).map(of_kind).collect()
    }

    pub fn subset(&self, samples: &[usize]) -> Self {
        let mut subset_of = Self::new(self.width, &self.floor);
        let each = 3 * self.kinds() * self.width;
        for &sample in samples {
            for (selected, all) in subset_of.residual.iter_mut().zip(&self.residual) {
                selected.push(all[sample]);
            }
            subset_of.design.extend_from_slice(&self.design[sample * each..(sample + 1) * each]);
        }
        subset_of.places = self.places.subset(samples);
        subset_of
    }

    /// Weights from the spread of the residuals, assuming white noise.
    pub fn first_weights(&self) -> Vec<Weight> {
        let of_kind = |(residual, &floor): (&Vec<Vec3>, &f64)| Weight {
            noise: Noise::white(robust_sigma(residual).max(floor)),
            robust: vec![1.0; residual.len()],
        };
        self.residual.iter().zip(&self.floor).map(of_kind).collect()
    }

    pub fn even_weights(&self) -> Vec<Weight> {
        let noise = Noise::white(1.0);
        self.residual.iter().map(|r| Weight { noise, robust: vec![1.0; r.len()] }).collect()
    }

    /// Weights from the residuals.
    pub fn weights(&self) -> Vec<Weight> {
        self.weights_of(&self.residual)
    }

    /// Weights from the residuals after a step.
    pub fn weights_after(&self, step: &[f64]) -> Vec<Weight> {
        self.weights_of(&self.residuals_after(step))
    }

    /// Weights from residuals of the samples.
    pub fn weights_of(&self, residuals: &[Vec<Vec3>]) -> Vec<Weight> {
        let of_kind = |(residual, &floor): (&Vec<Vec3>, &f64)| {
            let robust = huber(residual, floor);
            let noise = Noise::estimate(residual, &robust, floor);
            let recurrence = self.places.inflation(residual, &robust, &noise);
            Weight { noise: Noise { recurrence, ..noise }, robust }
        };
        residuals.iter().zip(&self.floor).map(of_kind).collect()
    }

    /// Iteratively reweighted least squares. `solve` adds priors to the equations and returns the step.
    pub fn reweighted_fit(
        &self,
        rounds: usize,
        mut solve: impl FnMut(&mut Normal) -> DVector<f64>,
    ) -> ReweightedFit {
        let mut round = |weights: &[Weight]| {
            let mut normal = self.normal(weights);
            let step = solve(&mut normal);
            let residuals = self.residuals_after(step.as_slice());
            let weights = self.weights_of(&residuals);
            ReweightedFit { normal, step, residuals, weights }
        };
        let first = round(&self.first_weights());
        (1..rounds).fold(first, |fit, _| round(&fit.weights))
    }

    /// Row `row` of every sample, and its transpose.
    fn design_of(&self, row: usize) -> [DMatrixView<'_, f64, Dyn, Dyn>; 2] {
        let start = 3 * self.kinds() * self.width;
        let own = self.design.get(row * self.width..).unwrap_or_default();
        let (samples, width) = (self.len(), self.width);
        [
            DMatrixView::from_slice_with_strides(own, samples, width, start, 1),
            DMatrixView::from_slice_with_strides(own, width, samples, 1, start),
        ]
    }

    fn rows_of(&self, sample: usize, kind: usize) -> [&[f64]; 3] {
        std::array::from_fn(|axis| self.row(sample, 3 * kind + axis))
    }

    /// Upper triangle of `Aᵀ W A`. Squares of the many samples with equal weight are summed once.
    fn weighted_squares(&self, weights: &[Weight]) -> DMatrix<f64> {
        let of_kind = |kind: usize| {
            let mut squares = DMatrix::zeros(self.width, self.width);
            for axis in (0..3).filter(|_| self.len() > 0) {
                let [design, transposed] = self.design_of(3 * kind + axis);
                squares.gemm(1.0, &transposed, &design, 1.0);
            }
            squares.transpose()
        };
        let squares = self.squares.get_or_init(|| (0..self.kinds()).map(of_kind).collect());
        let mut sum = DMatrix::zeros(self.width, self.width);
        for (kind, (squares, weight)) in squares.iter().zip(weights).enumerate() {
            let level = weight.base_weight();
            sum += squares * level;
            for (sample, robust) in weight.robust.iter().enumerate().filter(|(_, w)| **w != 1.0) {
                add_squares(&mut sum, self.rows_of(sample, kind), level * (robust - 1.0));
            }
        }
        sum
    }

    /// Adds this stream to `normal`, with its parameters at `columns`.
    pub fn accumulate(&self, weights: &[Weight], columns: &[usize], normal: &mut Normal) {
        let mut right = vec![0.0; self.width];
        for sample in 0..self.len() {
            for (kind, weight) in weights.iter().enumerate() {
                let (component, residual) = (weight.component(sample), self.residual[kind][sample]);
                let weighted = component * residual;
                normal.cost += weighted.dot(&residual);
                let [x, y, z] = self.rows_of(sample, kind);
                for (((right, x), y), z) in right.iter_mut().zip(x).zip(y).zip(z) {
                    *right = *right + weighted[0] * x + weighted[1] * y + weighted[2] * z;
                }
            }
        }
        let squares = self.weighted_squares(weights);
        for (i, &row) in columns.iter().enumerate() {
            normal.right[row] += right[i];
            for (j, &column) in columns[..=i].iter().enumerate() {
                add_both(&mut normal.matrix, row, column, squares[(j, i)]);
            }
        }
        let independent = weights.iter().map(|weight| weight.noise.independent(self.len()));
        normal.independent += independent.sum::<f64>();
    }

    /// Normal equations of this stream alone.
    pub fn normal(&self, weights: &[Weight]) -> Normal {
        let mut normal = Normal::zeros(self.width);
        self.accumulate(weights, &Vec::from_iter(0..self.width), &mut normal);
        normal
    }

    /// `Aᵀ W A` over all parameters.
    pub fn information(&self, weights: &[Weight]) -> DMatrix<f64> {
        let squares = self.weighted_squares(weights);
        DMatrix::from_fn(self.width, self.width, |i, j| squares[(i.min(j), i.max(j))])
    }

    /// Adds the two parts of a sandwich covariance (White 1980): `Aᵀ W A` to `information`, and the
    /// covariance of the score under the noise to `scores`. `chosen` are pairs of a parameter and its target.
    ///
    /// Noise of one joint affects all six components of a sample, depending on the configuration. As in
    /// White's estimator, the sample's whole residual `u = W r` therefore represents its noise. The
    /// autocovariance is from [`Noise`], which is more accurate than a truncated empirical one. Its
    /// autoregressive part is a sum of innovations that affect later samples by powers of ρ, so the
    /// covariance is
    ///
    /// `Σ_j (1−share)·(A_jᵀu_j)² + share·(1−ρ²)·(P_jᵀu_j)²` with `P_j = Σ_{l≤j} ρ^(j−l) A_l`.
    pub fn accumulate_covariance(
        &self,
        weights: &[Weight],
        chosen: &[(usize, usize)],
        information: &mut DMatrix<f64>,
        scores: &mut DMatrix<f64>,
    ) {
        let rows = 3 * self.kinds();
        let mut squares = DMatrix::zeros(chosen.len(), chosen.len());
        let reaching = self.for_each_score(weights, chosen, |white, lasting| {
            add_squares(&mut squares, [white, lasting], 1.0);
        });
        // Innovations after the last sample have no residual.
        for (r, reaching) in reaching.chunks_exact(chosen.len().max(1)).take(rows).enumerate() {
            let Noise { sigma, share, rho, .. } = weights[r / 3].noise;
            let sigma = sigma * weights[r / 3].noise.recurrence_factor();
            let lasting = share * (rho * sigma * weights[r / 3].base_weight()).powi(2);
            add_squares(&mut squares, [reaching], lasting);
        }
        let seen = self.weighted_squares(weights);
        for (a, &(own_a, target_a)) in chosen.iter().enumerate() {
            for (b, &(own_b, target_b)) in chosen[..=a].iter().enumerate() {
                add_both(information, target_a, target_b, seen[(own_b, own_a)]);
                add_both(scores, target_a, target_b, squares[(b, a)]);
            }
        }
    }

    /// The two parts of a sandwich covariance of all parameters.
    pub fn covariance_parts(&self, weights: &[Weight]) -> [DMatrix<f64>; 2] {
        let all: Vec<(usize, usize)> = (0..self.width).map(|own| (own, own)).collect();
        let mut information = DMatrix::zeros(self.width, self.width);
        let mut scores = information.clone();
        self.accumulate_covariance(weights, &all, &mut information, &mut scores);
        [information, scores]
    }

    /// Variance along `influence` (one number per target) as a sum of squares, and the variance of that
    /// sum, including autocorrelation. Together they give the effective degrees of freedom (Satterthwaite
    /// 1946).
    pub fn squares_along(
        &self,
        weights: &[Weight],
        chosen: &[(usize, usize)],
        influence: &DVector<f64>,
    ) -> (f64, f64) {
        let (mut sum, mut fourth) = (0.0, 0.0);
        self.for_each_score(weights, chosen, |white, lasting| {
            let along = |part: &[f64]| -> f64 {
                part.iter().zip(chosen).map(|(s, &(_, target))| s * influence[target]).sum()
            };
            let square = along(white).powi(2) + along(lasting).powi(2);
            sum += square;
            fourth += square * square;
        });
        let lasts = weights.iter().map(|weight| weight.noise.inflation_of_squares());
        // For a normal variable, the fourth moment is 3σ⁴ and the variance of the square 2σ⁴.
        (sum, fourth * 2.0 / 3.0 * lasts.fold(1.0, f64::max))
    }

    /// Visits the contributions of every sample to the score of each parameter, through white and autocorrelated
    /// noise. Returns the weights with which each row continues beyond the last sample.
    fn for_each_score(
        &self,
        weights: &[Weight],
        chosen: &[(usize, usize)],
        mut visit: impl FnMut(&[f64], &[f64]),
    ) -> Vec<f64> {
        let (rows, width) = (3 * self.kinds(), chosen.len());
        let mut reaching = vec![0.0; width * rows];
        let (mut white, mut lasting) = (vec![0.0; width], vec![0.0; width]);
        for sample in 0..self.len() {
            white.fill(0.0);
            lasting.fill(0.0);
            for (r, reaching) in reaching.chunks_exact_mut(width.max(1)).enumerate() {
                let weight = &weights[r / 3];
                let Noise { share, rho, .. } = weight.noise;
                let (row, residual) = (self.row(sample, r), self.residual(sample, r));
                let weighted =
                    weight.component(sample) * weight.noise.recurrence_factor() * residual;
                let at_once = (1.0 - share).sqrt() * weighted;
                let later = (share * (1.0 - rho * rho)).sqrt() * weighted;
                let parts = white.iter_mut().zip(&mut lasting);
                for (((white, lasting), reaching), &(column, _)) in parts.zip(reaching).zip(chosen)
                {
                    *reaching = rho * *reaching + row[column];
                    *white += at_once * row[column];
                    *lasting += later * *reaching;
                }
            }
            visit(&white, &lasting);
        }
        reaching
    }
}

/// Adds `weight · Σ vᵀv` to an upper triangle. Skips columns in which all rows are zero.
fn add_squares<const N: usize>(triangle: &mut DMatrix<f64>, rows: [&[f64]; N], weight: f64) {
    let width = triangle.nrows().max(1);
    for (i, column) in triangle.as_mut_slice().chunks_exact_mut(width).enumerate() {
        let scaled = rows.map(|row| weight * row[i]);
        if scaled == [0.0; N] {
            continue;
        }
        let rows = rows.map(|row| &row[..=i]);
        for (j, value) in column[..=i].iter_mut().enumerate() {
            *value += (0..N).map(|n| scaled[n] * rows[n][j]).sum::<f64>();
        }
    }
}

fn add_both(matrix: &mut DMatrix<f64>, row: usize, column: usize, value: f64) {
    matrix[(row, column)] += value;
    if row != column {
        matrix[(column, row)] += value;
    }
}

impl Weight {
    pub fn subset(&self, samples: &[usize]) -> Self {
        Self { noise: self.noise, robust: samples.iter().map(|&at| self.robust[at]).collect() }
    }

    /// Of one component of a sample.
    pub fn component(&self, sample: usize) -> f64 {
        self.robust[sample] * self.base_weight()
    }

    /// Weight without the robust factor. A component counts as `1 / inflation` independent ones, so a
    /// strongly autocorrelated kind does not outvote the other.
    pub fn base_weight(&self) -> f64 {
        1.0 / (self.noise.sigma.powi(2) * self.noise.inflation())
    }
}

/// Normal equations of a model.
#[derive(Clone)]
pub(crate) struct Normal {
    /// `Aᵀ W A`.
    pub matrix: DMatrix<f64>,
    /// `Aᵀ W r`.
    pub right: DVector<f64>,
    /// `rᵀ W r`.
    pub cost: f64,
    /// Effective number of independent residual components.
    pub independent: f64,
}

impl Normal {
    pub fn zeros(width: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(width, width),
            right: DVector::zeros(width),
            cost: 0.0,
            independent: 0.0,
        }
    }

    /// Equations of the parameters that `columns` map to these.
    pub fn mapped(&self, columns: &DMatrix<f64>) -> Self {
        Self {
            matrix: columns.tr_mul(&self.matrix) * columns,
            right: columns.tr_mul(&self.right),
            ..*self
        }
    }

    /// Step that minimises the cost over `free` and returns the other parameters to zero.
    pub fn step(&self, values: &DVector<f64>, free: &[usize]) -> DVector<f64> {
        let mut step = -values;
        for &parameter in free {
            step[parameter] = 0.0;
        }
        if free.is_empty() {
            return step;
        }
        let right = &self.right - &self.matrix * &step;
        let n = free.len();
        let right = DVector::from_fn(n, |i, _| right[free[i]]);
        let (matrix, scale) = self.scaled(free);
        let solution = match matrix.cholesky() {
            Some(cholesky)
                if cholesky.l_dirty().diagonal().min() > MIN_OBSERVABLE_EIGENVALUE.sqrt() =>
            {
                cholesky.solve(&right.component_mul(&scale)).component_mul(&scale)
            }
            _ => {
                let matrix = DMatrix::from_fn(n, n, |i, j| self.matrix[(free[i], free[j])]);
                pseudo_inverse(&matrix).0 * right
            }
        };
        for (i, &parameter) in free.iter().enumerate() {
            step[parameter] = solution[i];
        }
        step
    }

    /// Step from zero that minimises the cost over `free`.
    pub fn step_from_zero(&self, free: &[usize]) -> DVector<f64> {
        self.step(&DVector::zeros(self.right.len()), free)
    }

    /// The same over all parameters.
    pub fn full_step(&self) -> DVector<f64> {
        self.step_from_zero(&Vec::from_iter(0..self.right.len()))
    }

    /// Step with each diagonal entry increased by the share `damping`. `None` if the residuals do not determine it.
    pub fn damped_step(&self, damping: f64) -> Option<DVector<f64>> {
        let cholesky = damped(self.matrix.clone(), damping).cholesky()?;
        Some(cholesky.solve(&self.right))
    }

    /// Equations of these parameters alone.
    pub fn selected(&self, parameters: &[usize]) -> Self {
        Self {
            matrix: self.matrix.select_rows(parameters).select_columns(parameters),
            right: self.right.select_rows(parameters),
            ..*self
        }
    }

    /// Adds a residual of one parameter with a weight.
    pub fn add_prior(&mut self, parameter: usize, weight: f64, residual: f64) {
        self.matrix[(parameter, parameter)] += weight * weight;
        self.right[parameter] += weight * (weight * residual);
        self.cost += (weight * residual).powi(2);
    }

    /// Degrees of freedom besides this number of parameters.
    pub fn dof(&self, parameters: usize) -> f64 {
        (self.independent - parameters as f64).max(3.0)
    }

    pub fn cost_after(&self, step: &DVector<f64>) -> f64 {
        self.cost - 2.0 * self.right.dot(step) + step.dot(&(&self.matrix * step))
    }

    /// Equations of the first `kept` parameters, with the best values of the others.
    pub fn profiled(&self, kept: usize) -> Self {
        let rest = self.right.len() - kept;
        let own = ridged(self.matrix.view((kept, kept), (rest, rest)).into_owned());
        let inverse =
            own.clone().cholesky().map_or_else(|| pseudo_inverse(&own).0, |own| own.inverse());
        let right = self.right.rows(kept, rest);
        let mixed = self.matrix.view((0, kept), (kept, rest)) * &inverse;
        Self {
            matrix: self.matrix.view((0, 0), (kept, kept))
                - &mixed * self.matrix.view((kept, 0), (rest, kept)),
            right: self.right.rows(0, kept) - &mixed * right,
            cost: self.cost - right.dot(&(&inverse * right)),
            independent: self.independent,
        }
    }

    /// Minimum share of a parameter's effect that `given` and the preceding ones do not explain.
    pub fn separation(&self, given: &[usize], parameters: &[usize]) -> f64 {
        let all = [given, parameters].concat();
        let cholesky = self.scaled(&all).0.cholesky();
        let share = |cholesky: nalgebra::Cholesky<f64, Dyn>| {
            let own = cholesky.l_dirty().diagonal().rows(given.len(), parameters.len()).min();
            own.powi(2)
        };
        if parameters.is_empty() { 1.0 } else { cholesky.map_or(0.0, share) }
    }

    /// Submatrix scaled to a unit diagonal, and the scale.
    fn scaled(&self, parameters: &[usize]) -> (DMatrix<f64>, DVector<f64>) {
        let n = parameters.len();
        let at = |i: usize, j: usize| self.matrix[(parameters[i], parameters[j])];
        let scale = DVector::from_fn(n, |i, _| at(i, i).max(f64::MIN_POSITIVE).sqrt().recip());
        (DMatrix::from_fn(n, n, |i, j| at(i, j) * scale[i] * scale[j]), scale)
    }
}

impl AddAssign for Normal {
    fn add_assign(&mut self, other: Self) {
        self.matrix += other.matrix;
        self.right += other.right;
        self.cost += other.cost;
        self.independent += other.independent;
    }
}

/// Stream whose columns are some of the parameters.
pub(crate) struct StreamEquations {
    pub linear: Linear,
    pub weights: Vec<Weight>,
    /// Parameter of each column.
    pub parameters: Vec<usize>,
}

impl StreamEquations {
    /// Part of a step in the columns of the stream.
    pub fn own_part(&self, step: &DVector<f64>) -> Vec<f64> {
        self.parameters.iter().map(|&parameter| step[parameter]).collect()
    }
}

/// Equations of several streams with shared parameters, which have a prior.
pub(crate) struct SharedEquations {
    pub streams: Vec<StreamEquations>,
    /// Precision of the prior.
    pub prior: DMatrix<f64>,
}

impl SharedEquations {
    pub fn normal(&self) -> Normal {
        let mut normal = Normal::zeros(self.prior.nrows());
        for StreamEquations { linear, weights, parameters } in &self.streams {
            linear.accumulate(weights, parameters, &mut normal);
        }
        normal.matrix += &self.prior;
        normal
    }

    /// Sets the weights from the residuals after a step. Returns the previous ones.
    pub fn update_weights(&mut self, step: &DVector<f64>) -> Vec<Vec<Weight>> {
        let update = |stream: &mut StreamEquations| {
            let weights = stream.linear.weights_after(&stream.own_part(step));
            std::mem::replace(&mut stream.weights, weights)
        };
        self.streams.iter_mut().map(update).collect()
    }

    /// Covariance of all parameters.
    pub fn covariance(&self) -> DMatrix<f64> {
        // The prior is as good as samples.
        let (mut information, mut scores) = (self.prior.clone(), self.prior.clone());
        for StreamEquations { linear, weights, parameters } in &self.streams {
            let targets: Vec<(usize, usize)> = parameters.iter().copied().enumerate().collect();
            linear.accumulate_covariance(weights, &targets, &mut information, &mut scores);
        }
        sandwich(&information, &scores)
    }
}

/// Unobservable directions count little.
pub(crate) fn ridged(matrix: DMatrix<f64>) -> DMatrix<f64> {
    const RIDGE: f64 = 1e-9;
    damped(matrix, RIDGE)
}

fn damped(mut matrix: DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    for i in 0..matrix.nrows() {
        matrix[(i, i)] += damping * matrix[(i, i)].abs() + f64::MIN_POSITIVE;
    }
    matrix
}
