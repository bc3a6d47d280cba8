//! Selects the causes that reduce the residual by more than the price of their parameters (see [`crate`]).
//!
//! Sets are scored on the normal equations, so hundreds cost less than one pass over the samples.

use super::stepwise::{ScoredSet, grow};
use crate::Measured;
use crate::distinct::{by_score, distinct};
use crate::model::measurement::{
    LATENCY_COLUMN, MAX_EXPLAINED_M, MAX_EXPLAINED_RAD, PoseObservations, RADIAL_SCALE_COLUMN,
    REFERENCE_COLUMNS_START, SKEW_COLUMN, STREAM_WIDTH, State, TOOL_COLUMNS_START,
};
use crate::priors::price;
use crate::samples::sampling::MAX_SEARCH_SAMPLES;
use crate::solver::linear::{Linear, Normal, SharedEquations, StreamEquations, Weight};
use crate::solver::noise::{Noise, rms};
use crate::solver::robust::{pseudo_inverse, sandwich};
use ground::geometry::Pose;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::mem;
use std::sync::{Arc, Mutex, PoisonError};

/// Minimum share of a parameter's effect that the others cannot imitate. Below it, causes are collinear and the
/// set is rejected.
pub(crate) const MIN_CAUSE_SEPARATION: f64 = 1e-4;

const MAX_EXHAUSTIVE_CAUSES: usize = 4;

/// For white noise; a larger inflation indicates a wrong model.
pub(crate) const MAX_NOISE_INFLATION: f64 = 1.5;

/// Possible cause of a residual: parameters that are freed together, of a joint of the track or of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Cause {
    Zero(usize),
    /// Scale or coupling, by its index in [`State::offsets`].
    JointScale(usize),
    Latency(usize),
    Skew(usize),
    RadialScale(usize),
    Reference(usize),
    Tool(usize),
}

impl Cause {
    pub fn parameters(self, state: &State) -> std::ops::Range<usize> {
        let (stream, first, count) = match self {
            Cause::Zero(joint) | Cause::JointScale(joint) => return joint..joint + 1,
            Cause::Latency(stream) => (stream, LATENCY_COLUMN, 1),
            Cause::Skew(stream) => (stream, SKEW_COLUMN, 1),
            Cause::RadialScale(stream) => (stream, RADIAL_SCALE_COLUMN, 1),
            Cause::Reference(stream) => (stream, REFERENCE_COLUMNS_START, 6),
            Cause::Tool(stream) => {
                let count = if state.streams[stream].is_tool_point { 3 } else { 6 };
                (stream, TOOL_COLUMNS_START, count)
            }
        };
        let start = state.index(stream, first);
        start..start + count
    }

    fn remove_from(self, state: &mut State) {
        match self {
            Cause::Zero(joint) | Cause::JointScale(joint) => state.offsets[joint] = 0.0,
            Cause::Latency(s) => state.streams[s].latency_s = 0.0,
            Cause::Skew(s) => state.streams[s].skew = 0.0,
            Cause::RadialScale(s) => state.streams[s].radial_scale = 0.0,
            Cause::Reference(s) => state.streams[s].reference = Pose::identity(),
            Cause::Tool(s) => state.streams[s].tool = Pose::identity(),
        }
    }
}

impl State {
    pub fn without(mut self, causes: &[Cause]) -> Self {
        causes.iter().for_each(|cause| cause.remove_from(&mut self));
        self
    }
}

/// Parameters in ascending order.
fn parameters_of(causes: &[Cause], state: &State) -> Vec<usize> {
    let mut parameters: Vec<usize> =
        causes.iter().flat_map(|cause| cause.parameters(state)).collect();
    parameters.sort_unstable();
    parameters
}

/// Number of their parameters.
pub(crate) fn parameter_count(causes: &[Cause], state: &State) -> usize {
    causes.iter().map(|cause| cause.parameters(state).len()).sum()
}

/// Model linearised about a state, with its noise.
pub(crate) struct Linearized {
    equations: SharedEquations,
    pub normal: Normal,
    values: DVector<f64>,
    /// Cached for repeated queries.
    free_fit: Mutex<Option<Arc<FreeFit>>>,
}

struct FreeFit {
    parameters: Vec<usize>,
    /// Influence of each score on each parameter.
    influence: DMatrix<f64>,
    /// Covariance under correlated noise.
    covariance: DMatrix<f64>,
    step: DVector<f64>,
}

impl Linearized {
    /// Linearises about `state` with about `max_samples` samples per stream. The weights are of the noise with
    /// all `candidates` free.
    pub fn new(
        observations: &[&PoseObservations],
        state: &State,
        max_samples: usize,
        candidates: &[Cause],
    ) -> Self {
        let of_stream = |(s, observations): (usize, &&PoseObservations)| {
            let linear = observations.in_state(state, s).linearize(max_samples);
            let (joints, start) = (state.offsets.len(), state.index(s, 0));
            let parameters = (0..joints).chain(start..start + STREAM_WIDTH).collect();
            StreamEquations { weights: linear.first_weights(), linear, parameters }
        };
        let streams = observations.iter().enumerate().map(of_stream).collect();
        let damping = DVector::from_vec(state.scales()).map(|scale| scale.powi(-2));
        let equations = SharedEquations { streams, prior: DMatrix::from_diagonal(&damping) };
        let (normal, values) = (equations.normal(), state.values());
        let mut linearized = Self { equations, normal, values, free_fit: Mutex::new(None) };
        // The first step's weights are rough.
        linearized.update_weights(state, candidates);
        linearized.update_weights(state, candidates);
        linearized
    }

    /// Sets the weights from the residual with `causes` free. The search frees all candidates, so no fault
    /// counts as noise. Intervals free only the selected causes; others would absorb coloured noise and hide
    /// its autocorrelation.
    ///
    /// Returns the previous weights with their equations.
    fn update_weights(&mut self, state: &State, causes: &[Cause]) -> (Vec<Vec<Weight>>, Normal) {
        let step = self.normal.step(&self.values, &parameters_of(causes, state));
        let weights = self.equations.update_weights(&step);
        self.free_fit = Mutex::new(None);
        (weights, mem::replace(&mut self.normal, self.equations.normal()))
    }

    /// Returns to these weights and their equations.
    fn set_weights(&mut self, weights: Vec<Vec<Weight>>, normal: Normal) {
        for (stream, weights) in self.equations.streams.iter_mut().zip(weights) {
            stream.weights = weights;
        }
        self.normal = normal;
        self.free_fit = Mutex::new(None);
    }

    /// Samples of each stream.
    pub fn streams(&self) -> impl ExactSizeIterator<Item = &Linear> {
        self.equations.streams.iter().map(|stream| &stream.linear)
    }

    /// Normal equations of some samples of each stream.
    pub fn normal_of(&self, samples: &[Vec<usize>]) -> Normal {
        let part = |(stream, rows): (&StreamEquations, &Vec<usize>)| StreamEquations {
            linear: stream.linear.subset(rows),
            weights: stream.weights.iter().map(|weight| weight.subset(rows)).collect(),
            parameters: stream.parameters.clone(),
        };
        let streams = self.equations.streams.iter().zip(samples).map(part).collect();
        SharedEquations { streams, prior: self.equations.prior.clone() }.normal()
    }

    /// Least-squares step of `normal` with `causes` free, in the columns of each stream.
    pub fn stream_steps(&self, normal: &Normal, causes: &[Cause], state: &State) -> Vec<Vec<f64>> {
        let step = normal.step(&self.values, &parameters_of(causes, state));
        self.equations.streams.iter().map(|stream| stream.own_part(&step)).collect()
    }

    /// [`Normal::separation`] of the parameters that have an effect, without the damping: if the noise is strongly
    /// correlated, the damping outweighs the samples.
    pub fn separation(&self, parameters: &[usize]) -> f64 {
        let damping = &self.equations.prior;
        let information = &self.normal.matrix - damping;
        let has_effect = |at: &usize| information[(*at, *at)] > damping[(*at, *at)];
        let effective: Vec<usize> = parameters.iter().copied().filter(has_effect).collect();
        Normal { matrix: information, ..Normal::zeros(0) }.separation(&[], &effective)
    }

    /// Noise of a stream's positions and rotations.
    pub fn noise_of(&self, stream: usize) -> [Noise; 2] {
        [0, 1].map(|kind| self.equations.streams[stream].weights[kind].noise)
    }

    /// Least-squares step with `parameters` free; returns all others to zero.
    pub fn step(&self, parameters: &[usize]) -> DVector<f64> {
        self.normal.step(&self.values, parameters)
    }

    /// Weighted cost after that step.
    pub fn cost(&self, parameters: &[usize]) -> f64 {
        self.normal.cost_after(&self.step(parameters))
    }

    /// Covariance with only `parameters` free, under correlated noise (`H⁻¹ S H⁻¹`, White 1980). Infinite
    /// if not observable.
    pub fn covariance(&self, parameters: &[usize]) -> DMatrix<f64> {
        self.fit_free(parameters).covariance.clone()
    }

    fn fit_free(&self, parameters: &[usize]) -> Arc<FreeFit> {
        let mut known = self.free_fit.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(freed) = known.as_ref().filter(|freed| freed.parameters == parameters) {
            return Arc::clone(freed);
        }
        let [information, scores] = self.information_and_scores(parameters);
        let freed = Arc::new(FreeFit {
            parameters: parameters.to_vec(),
            influence: pseudo_inverse(&information).0,
            covariance: sandwich(&information, &scores),
            step: self.step(parameters),
        });
        *known = Some(Arc::clone(&freed));
        freed
    }

    /// [`Self::covariance`] with a prior standard deviation of some parameters.
    pub fn covariance_with_prior(
        &self,
        parameters: &[usize],
        prior: impl Fn(usize) -> Option<f64>,
    ) -> DMatrix<f64> {
        let [mut information, mut scores] = self.information_and_scores(parameters);
        for (i, &parameter) in parameters.iter().enumerate() {
            let more = prior(parameter).map_or(0.0, |sigma| sigma.powi(-2));
            information[(i, i)] += more;
            scores[(i, i)] += more;
        }
        match information.cholesky() {
            Some(cholesky) => cholesky.inverse() * scores * cholesky.inverse(),
            None => DMatrix::from_element(parameters.len(), parameters.len(), f64::INFINITY),
        }
    }

    fn information_and_scores(&self, parameters: &[usize]) -> [DMatrix<f64>; 2] {
        let n = parameters.len();
        let (mut information, mut scores) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        for stream in &self.equations.streams {
            let StreamEquations { linear, weights, .. } = stream;
            let columns = target_columns(parameters, stream);
            linear.accumulate_covariance(weights, &columns, &mut information, &mut scores);
        }
        [information, scores]
    }

    /// Information matrix of one stream, joints first.
    pub fn information_of(&self, stream: usize) -> DMatrix<f64> {
        let StreamEquations { linear, weights, .. } = &self.equations.streams[stream];
        linear.information(weights)
    }

    /// Effective degrees of freedom along `influence`.
    fn dof_along(&self, parameters: &[usize], influence: &DVector<f64>) -> f64 {
        let (mut sum, mut variance) = (0.0, f64::MIN_POSITIVE);
        for stream in &self.equations.streams {
            let columns = target_columns(parameters, stream);
            let squares = stream.linear.squares_along(&stream.weights, &columns, influence);
            sum += squares.0;
            variance += squares.1;
        }
        (2.0 * sum * sum / variance).clamp(3.0, self.normal.dof(parameters.len()))
    }

    /// Estimate of `parameters[which]` with `parameters` free. `None` if not observable.
    pub fn measured(&self, parameters: &[usize], which: usize) -> Option<Measured> {
        let freed = self.fit_free(parameters);
        let variance = freed.covariance[(which, which)];
        let along = freed.influence.column(which).into_owned();
        let value = self.values[parameters[which]] + freed.step[parameters[which]];
        variance.is_finite().then(|| Measured {
            value,
            std_error: variance.max(0.0).sqrt(),
            dof: self.dof_along(parameters, &along),
        })
    }
}

/// Columns of a stream that are among `parameters`, with their index there.
fn target_columns(parameters: &[usize], stream: &StreamEquations) -> Vec<(usize, usize)> {
    let target =
        |(own, column): (usize, &usize)| Some((own, parameters.binary_search(column).ok()?));
    stream.parameters.iter().enumerate().filter_map(target).collect()
}

#[derive(Clone)]
pub(crate) struct CandidateCauses {
    /// Always free.
    pub always: Vec<Cause>,
    /// Must justify their price.
    pub optional: Vec<Cause>,
    /// Whether a stream's reference and tool may both be wrong although the motion does not separate them.
    pub may_confound_frames: bool,
}

impl CandidateCauses {
    pub fn all(&self) -> Vec<Cause> {
        self.free(&self.optional)
    }

    /// `causes` and those that are always free.
    pub fn free(&self, causes: &[Cause]) -> Vec<Cause> {
        self.always.iter().chain(causes).copied().collect()
    }

    /// Their parameters, ascending.
    pub fn free_parameters(&self, causes: &[Cause], state: &State) -> Vec<usize> {
        let mut parameters = parameters_of(&self.free(causes), state);
        parameters.dedup();
        parameters
    }

    /// The same with fewer optional causes.
    pub fn retaining(&self, is_retained: impl Fn(&Cause) -> bool) -> Self {
        let optional = self.optional.iter().copied().filter(is_retained).collect();
        Self { optional, ..self.clone() }
    }
}

/// Optional causes with the lowest weighted cost plus price, ascending.
fn select_causes(linear: &Linearized, candidates: &CandidateCauses, state: &State) -> Vec<Cause> {
    let price = price(linear.normal.independent);
    let score_of = |set: &[Cause]| -> f64 {
        let causes = candidates.free(set);
        let parameters = parameters_of(&causes, state);
        if !set.is_empty() && is_collinear(linear, candidates, &causes, state) {
            return f64::INFINITY;
        }
        linear.cost(&parameters) + price * parameter_count(set, state) as f64
    };
    let mut best = ScoredSet { members: Vec::new(), score: score_of(&[]) };
    // Lower bound on the cost of any set.
    let min_cost = linear.cost(&parameters_of(&candidates.all(), state));
    let mut set = Vec::new();
    let depth = MAX_EXHAUSTIVE_CAUSES - usize::from(candidates.optional.len() > 16);
    subsets(&candidates.optional, depth, &mut set, &mut |set| {
        if min_cost + price * parameter_count(set, state) as f64 >= best.score {
            return;
        }
        let score = score_of(set);
        if score < best.score {
            best = ScoredSet { score, members: set.to_vec() };
        }
    });
    if best.members.len() >= depth {
        best = grow(&candidates.optional, best, score_of);
    }
    best.members.sort_unstable();
    best.members
}

/// If a stream's reference is unknown, its tool is unknown, too, and weak motion leaves common directions of
/// the two unobservable. These are harmless: steps do not move along them. Any other cause, such as a joint
/// zero, must be separable from these frames and from the rest.
fn is_collinear(
    linear: &Linearized,
    candidates: &CandidateCauses,
    causes: &[Cause],
    state: &State,
) -> bool {
    let is_unknown = |cause: &&Cause| match **cause {
        Cause::Reference(s) | Cause::Tool(s) => {
            candidates.always.contains(&Cause::Reference(s))
                || (candidates.may_confound_frames
                    && causes.contains(&Cause::Reference(s))
                    && causes.contains(&Cause::Tool(s)))
        }
        _ => false,
    };
    let parameters = |causes: Vec<&Cause>| -> Vec<usize> {
        causes.into_iter().flat_map(|cause| cause.parameters(state)).collect()
    };
    let known = candidates.always.iter().chain(&candidates.optional);
    let unknown = parameters(known.filter(is_unknown).collect());
    let others = parameters(causes.iter().filter(|cause| !is_unknown(cause)).collect());
    linear.normal.separation(&unknown, &others) < MIN_CAUSE_SEPARATION
}

/// Visits every subset of 1 to `depth` elements.
fn subsets(causes: &[Cause], depth: usize, set: &mut Vec<Cause>, visit: &mut dyn FnMut(&[Cause])) {
    if depth == 0 {
        return;
    }
    for (i, &cause) in causes.iter().enumerate() {
        set.push(cause);
        visit(set);
        subsets(&causes[i + 1..], depth - 1, set, visit);
        set.pop();
    }
}

/// Selected model with its final linearisation.
pub(crate) struct SelectedModel {
    pub state: State,
    /// Selected optional causes, ascending.
    pub causes: Vec<Cause>,
    pub linear: Linearized,
    /// Whether further rounds would not change it.
    pub is_converged: bool,
    /// Weights and equations of `linear` with all candidates free, from which a search continues.
    search: (Vec<Vec<Weight>>, Normal),
}

/// Alternates selection and Gauss–Newton steps from `start`.
pub(crate) fn select_model(
    observations: &[&PoseObservations],
    start: State,
    candidates: &CandidateCauses,
) -> SelectedModel {
    let linear = Linearized::new(observations, &start, FIT_SAMPLES, &candidates.all());
    continue_rounds(observations, (start, &linear), candidates, Rounds::FIT)
}

/// Per stream, except in the search for a start.
pub(crate) const FIT_SAMPLES: usize = 4000;

/// Of the noise, between models. A smooth residual keeps enough samples.
const MAX_INFLATION: f64 = 20.0;

/// The model without optional causes if it is likelier. Linearised steps can leave it for a worse one.
pub(crate) fn or_without_causes(
    observations: &[&PoseObservations],
    model: SelectedModel,
    candidates: &CandidateCauses,
) -> SelectedModel {
    /// Ratio of the residuals up to which the model without causes may be likelier; not calibrated.
    const MAX_RATIO: f64 = 2.0;
    const SAMPLES_OF_FIRST_COMPARISON: usize = 200;
    if model.causes.is_empty() {
        return model;
    }
    let start = model.state.clone().without(&model.causes);
    let is_near = |(s, with): (usize, &Linear)| {
        let at = observations[s].in_state(&start, s);
        let without = at.linearize(SAMPLES_OF_FIRST_COMPARISON);
        rms(&without.residual[0]) < MAX_RATIO * rms(&with.residual[0])
    };
    if !model.linear.streams().enumerate().all(is_near) {
        return model;
    }
    let without = select_model(observations, start, &candidates.retaining(|_| false));
    // Rounded positions repeat with the configuration, so the noise is as correlated as without the causes.
    let gain = |(with, without): (Noise, Noise)| {
        let inflation = with.inflation().max(without.inflation()).min(MAX_INFLATION);
        (without.sigma / with.sigma).ln() / inflation
    };
    let samples = |stream: &Linear| [2.0 * 3.0 * stream.len() as f64; 2];
    let samples = model.linear.streams().flat_map(samples);
    let gains = samples.zip(model.noise().into_iter().zip(without.noise()).map(gain));
    let gained: f64 = gains.map(|(samples, gain)| samples * gain).sum();
    if gained > model.price() - without.price() { model } else { without }
}

/// Best model of one stream from several `starts`. Few rounds of each show which to continue, if any.
pub(crate) fn select_from_starts(
    observations: &PoseObservations,
    starts: Vec<State>,
    candidates: &CandidateCauses,
) -> Option<SelectedModel> {
    const FIRST_ROUNDS: usize = 4;
    const CONTINUED: usize = 4;
    /// Best if several large causes add up. Without them, best near the solution or with little information.
    const ROUNDS_WITH_ALL_CAUSES: usize = 3;
    let observations = &[observations];
    let first: Vec<SelectedModel> = starts
        .into_par_iter()
        .flat_map_iter(|state| {
            let samples = MAX_SEARCH_SAMPLES;
            let linear = Linearized::new(observations, &state, samples, &candidates.all());
            let after_rounds = |all_free: usize| {
                let rounds = Rounds { all_free, most: FIRST_ROUNDS, samples };
                continue_rounds(observations, (state.clone(), &linear), candidates, rounds)
            };
            let near = after_rounds(0);
            let far = (!near.leaves_only_noise()).then(|| after_rounds(ROUNDS_WITH_ALL_CAUSES));
            std::iter::once(near).chain(far)
        })
        .collect();
    let distinct = distinct(ranked(first).into_iter().take(CONTINUED), SelectedModel::is_at);
    let continued: Vec<SelectedModel> = distinct
        .into_par_iter()
        .map(|model| {
            if model.is_converged {
                return model;
            }
            let SelectedModel { state, mut linear, search: (weights, normal), .. } = model;
            linear.set_weights(weights, normal);
            let rounds = Rounds { samples: MAX_SEARCH_SAMPLES, ..Rounds::FIT };
            continue_rounds(observations, (state, &linear), candidates, rounds)
        })
        .collect();
    ranked(continued).into_iter().next()
}

struct Rounds {
    /// First rounds with all causes free.
    all_free: usize,
    most: usize,
    /// Per stream.
    samples: usize,
}

impl Rounds {
    const FIT: Self = Self { all_free: 0, most: 12, samples: FIT_SAMPLES };
}

/// Rounds from a state with its linearisation.
fn continue_rounds(
    observations: &[&PoseObservations],
    (mut state, linear): (State, &Linearized),
    candidates: &CandidateCauses,
    rounds: Rounds,
) -> SelectedModel {
    let all = candidates.all();
    let mut causes: Vec<Cause> = all.clone();
    // Moves the state and returns whether it converged.
    let mut step_from = |linear: &Linearized, state: &mut State, round: usize| {
        let frees_all = round < rounds.all_free;
        let next = if frees_all {
            candidates.optional.clone()
        } else {
            select_causes(linear, candidates, state)
        };
        let step = linear.step(&candidates.free_parameters(&next, state));
        let is_converged = !frees_all && next == causes && is_negligible(&step);
        state.step(&step);
        causes = next;
        is_converged
    };
    let linearized = |state: &State| Linearized::new(observations, state, rounds.samples, &all);
    let mut is_converged = step_from(linear, &mut state, 0);
    let mut linear = linearized(&state);
    for round in 1..rounds.most {
        if is_converged {
            break;
        }
        let mut next = state.clone();
        is_converged = step_from(&linear, &mut next, round);
        // After a negligible step, the linearisation is still valid.
        if !is_converged {
            (linear, state) = (linearized(&next), next);
        }
    }
    let search = linear.update_weights(&state, &candidates.free(&causes));
    SelectedModel { state, causes, linear, is_converged, search }
}

/// Whether the step is below the resolution of any estimate.
fn is_negligible(step: &DVector<f64>) -> bool {
    step.amax() < 1e-7
}

/// Several models of the same streams, best first, by `Σ n·ln σ²` of the residuals plus the price of parameters
/// and of round frame errors, such as a quarter turn.
///
/// The autocorrelation, which reduces `n`, is that of the model with the smallest residual. Otherwise small
/// differences of it would decide between equally good models.
fn ranked(models: Vec<SelectedModel>) -> Vec<SelectedModel> {
    let noises: Vec<Vec<Noise>> = models.iter().map(SelectedModel::noise).collect();
    let log_sigmas = |noise: &[Noise]| noise.iter().map(|noise| noise.sigma.ln()).sum::<f64>();
    let quietest = noises.iter().min_by(|a, b| log_sigmas(a).total_cmp(&log_sigmas(b)));
    let inflations: Vec<f64> =
        quietest.into_iter().flatten().map(|noise| noise.inflation().min(MAX_INFLATION)).collect();
    let score = |(model, noise): &(SelectedModel, Vec<Noise>)| -> f64 {
        let streams = model.linear.streams();
        let samples = streams.flat_map(|stream| [3.0 * stream.len() as f64; 2]);
        let fit: f64 = samples
            .zip(noise.iter().zip(&inflations))
            .map(|(n, (noise, inflation))| 2.0 * n / inflation * noise.sigma.ln())
            .sum();
        fit + model.price()
    };
    by_score(models.into_iter().zip(noises).map(|pair| (score(&pair), pair.0))).collect()
}

impl SelectedModel {
    /// The state, with frames that are no cause exactly the identity.
    pub fn exact_state(&self, candidates: &CandidateCauses) -> State {
        let causes = candidates.free(&self.causes);
        let mut state = self.state.clone();
        for (s, stream) in state.streams.iter_mut().enumerate() {
            if !causes.contains(&Cause::Reference(s)) && stream.round_reference.is_none() {
                stream.reference = Pose::identity();
            }
            if !causes.contains(&Cause::Tool(s)) && stream.round_tool.is_none() {
                stream.tool = Pose::identity();
            }
        }
        state
    }

    /// Noise per stream and residual kind (positions, rotations).
    pub fn noise(&self) -> Vec<Noise> {
        let weights = self.linear.streams().flat_map(Linear::weights);
        weights.map(|weight| weight.noise).collect()
    }

    /// Whether a model without optional causes leaves small white residuals. Other causes cannot explain more.
    fn leaves_only_noise(&self) -> bool {
        let is_white = |noise: Noise, max_sigma: f64| {
            noise.sigma < max_sigma && noise.inflation() < MAX_NOISE_INFLATION
        };
        let is_explained = |s: usize| {
            let [m, rad] = self.linear.noise_of(s);
            is_white(m, MAX_EXPLAINED_M) && is_white(rad, MAX_EXPLAINED_RAD)
        };
        self.causes.is_empty() && (0..self.linear.streams().len()).all(is_explained)
    }

    /// Whether both have the same causes and converge to the same state.
    fn is_at(&self, other: &Self) -> bool {
        const MAX_DIFFERENCE: f64 = 1e-6;
        self.causes == other.causes
            && (self.state.values() - other.state.values()).amax() < MAX_DIFFERENCE
            && (self.state.round_frames()).eq(other.state.round_frames())
    }

    fn price(&self) -> f64 {
        let tuned = parameter_count(&self.causes, &self.state);
        let round = self.state.round_frames().flatten().count();
        // A round frame error (such as 90°) is likelier than an estimated one and costs less.
        price(self.linear.normal.independent) * (tuned as f64 + 0.5 * round as f64)
    }
}
