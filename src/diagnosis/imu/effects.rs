//! Effects: a block of parameters times a profile over the run. A gyro bias that steps, a mount that slips, a
//! yaw that jumps, depends on the heading or settles after power-on differ only in block and profile.

use super::estimates::ImuMountChange;
use super::extension_tests::{ExtensionTests, ModelExtension};
use super::solve::{Model, Prior, Solved};
use crate::priors::{BIAS_PRIOR_RAD_S, MOUNT_PRIOR_RAD, YAW_PRIOR_RAD};
use crate::solver::linear::Rows;
use ground::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use std::ops::Range;

/// Knots of a random walk: at most this many, for a density known to 10 %, and at least this far apart.
const MAX_KNOTS: f64 = 60.0;
const MIN_KNOT_DISTANCE_S: f64 = 0.4;
const MAX_EFFECTS: usize = 6;

/// Parameters that may vary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Block {
    Yaw,
    /// World frame about all axes: competes with a mount.
    World,
    Mount,
    Bias,
}

impl Block {
    /// Standard deviation of an effect, rad or rad/s.
    fn prior(self) -> f64 {
        match self {
            Self::Yaw | Self::World => YAW_PRIOR_RAD,
            Self::Mount => MOUNT_PRIOR_RAD,
            Self::Bias => BIAS_PRIOR_RAD_S,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Profile {
    /// Time and its 95 % interval.
    Step {
        at_s: f64,
        interval_s: [f64; 2],
    },
    Decay {
        first_s: f64,
        time_constant_s: f64,
    },
    /// First and second harmonic of this IMU axis' heading. Hard and soft iron act there, as in a ship's
    /// compass.
    Heading {
        axis: usize,
    },
}

/// Kinds of profiles to test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    Step,
    Decay,
    Heading,
    Walk,
}

impl Profile {
    /// Values of its functions.
    pub fn weights(&self, t_s: f64, world_from_imu: &Rotation) -> Vec<f64> {
        match *self {
            Self::Step { at_s, .. } => vec![f64::from(t_s > at_s)],
            Self::Decay { first_s, time_constant_s } => {
                vec![(-(t_s - first_s) / time_constant_s).exp()]
            }
            Self::Heading { axis } => {
                let points = world_from_imu * Vec3::ith(axis, 1.0);
                let heading = points.y.atan2(points.x);
                let (sin, cos) = heading.sin_cos();
                let (sin_2, cos_2) = (2.0 * heading).sin_cos();
                vec![sin, cos, sin_2, cos_2]
            }
        }
    }

    pub fn change_s(&self) -> Option<(f64, [f64; 2])> {
        match *self {
            Self::Step { at_s, interval_s } => Some((at_s, interval_s)),
            _ => None,
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Effect {
    pub block: Block,
    pub profile: Profile,
    /// Per function of the profile, one value per parameter of the block.
    pub values: Vec<f64>,
    /// Columns of the design.
    pub columns: Range<usize>,
}

/// Random walk of the yaw, linear between knots.
#[derive(Clone, Debug)]
pub(super) struct Walk {
    pub density: f64,
    first_s: f64,
    pub step_s: f64,
    pub increments: usize,
}

impl Walk {
    fn over(t_s: &[f64]) -> Option<Self> {
        let (first_s, last) = (*t_s.first()?, *t_s.last()?);
        let count = ((last - first_s) / MIN_KNOT_DISTANCE_S).min(MAX_KNOTS).floor();
        let step_s = (last - first_s) / count;
        (count > 2.0).then_some(Self { density: 0.0, first_s, step_s, increments: count as usize })
    }

    /// Share of each increment that has passed.
    pub fn weights(&self, t_s: f64) -> impl Iterator<Item = f64> {
        let passed = self.passed(t_s);
        (0..self.increments).map(move |k| (passed - k as f64).clamp(0.0, 1.0))
    }

    /// Increment that passes at this time, and the share of it that has passed.
    pub fn position(&self, t_s: f64) -> (usize, f64) {
        let passed = self.passed(t_s);
        let increment = (passed as usize).min(self.increments - 1);
        (increment, (passed - increment as f64).clamp(0.0, 1.0))
    }

    fn passed(&self, t_s: f64) -> f64 {
        (t_s - self.first_s) / self.step_s
    }
}

/// Effects of a model, in columns after its own.
#[derive(Clone, Debug)]
pub(super) struct Effects {
    own_width: usize,
    pub list: Vec<Effect>,
    pub walk: Option<Walk>,
}

impl Effects {
    pub fn new(own_width: usize) -> Self {
        Self { own_width, list: Vec::new(), walk: None }
    }

    fn end(&self) -> usize {
        self.list.last().map_or(self.own_width, |effect| effect.columns.end)
    }

    /// Width of the design.
    pub fn width(&self) -> usize {
        self.end() + self.walk.as_ref().map_or(0, |walk| walk.increments)
    }

    pub fn columns(&self) -> Range<usize> {
        self.own_width..self.end()
    }

    /// Priors of all effects and of the increments of a walk.
    pub fn priors(&self) -> Vec<Prior> {
        let of_effect = |effect: &Effect| {
            let variance = effect.block.prior().powi(2);
            let columns = effect.columns.clone().zip(effect.values.clone());
            columns.map(move |(column, value)| Prior { column, variance, value })
        };
        let walk = self.walk.iter().flat_map(|walk| {
            let variance = walk.density.powi(2) * walk.step_s;
            (self.end()..self.width()).map(move |column| Prior { column, variance, value: 0.0 })
        });
        self.list.iter().flat_map(of_effect).chain(walk).collect()
    }

    pub fn of(&self, block: Block) -> impl Iterator<Item = &Effect> {
        self.list.iter().filter(move |effect| effect.block == block)
    }

    /// Sum of the effects on a block; its first entries.
    pub fn sum(&self, block: Block, t_s: f64, world_from_imu: &Rotation) -> Vec3 {
        let mut sum = Vec3::zeros();
        for effect in self.of(block) {
            let weights = effect.profile.weights(t_s, world_from_imu);
            let each = effect.values.len() / weights.len();
            for (values, weight) in effect.values.chunks_exact(each).zip(weights) {
                values.iter().enumerate().for_each(|(at, value)| sum[at] += weight * value);
            }
        }
        sum
    }

    /// `link_from_imu` at this time, from that at the start.
    pub fn mount_at(&self, link_from_imu: &Rotation, t_s: f64) -> Rotation {
        let slip = self.sum(Block::Mount, t_s, &Rotation::identity());
        link_from_imu * rotation_from_rotvec(slip)
    }

    /// Slip of the mount.
    pub fn mount_change(
        &self,
        link_from_imu: &Rotation,
        solved: &Solved,
    ) -> Option<ImuMountChange> {
        let effect = self.of(Block::Mount).next()?;
        let (at_s, interval_s) = effect.profile.change_s()?;
        let size_rad = solved.length(effect.columns.clone(), &effect.values).ok()?;
        let slip = rotation_from_rotvec(Vec3::from_column_slice(&effect.values));
        Some(ImuMountChange { at_s, interval_s, link_from_imu: link_from_imu * slip, size_rad })
    }

    /// Sets the derivatives by the effects, given those by the parameters of the blocks.
    pub fn set_rows(
        &self,
        rows: &mut Rows,
        t_s: f64,
        world_from_imu: &Rotation,
        derivatives: impl Fn(Block) -> Vec<Vec3>,
    ) {
        for effect in &self.list {
            let derivatives = derivatives(effect.block);
            let weights = effect.profile.weights(t_s, world_from_imu);
            let products =
                weights.iter().flat_map(|weight| derivatives.iter().map(move |d| d * *weight));
            for (column, derivative) in effect.columns.clone().zip(products) {
                rows.set(0, column, derivative);
            }
        }
        if let Some(walk) = &self.walk {
            let by_yaw = derivatives(Block::Yaw)[0];
            for (column, weight) in (self.end()..).zip(walk.weights(t_s)) {
                rows.set(0, column, by_yaw * weight);
            }
        }
    }

    pub fn apply(&mut self, delta: &[f64]) {
        for effect in &mut self.list {
            let step = &delta[effect.columns.clone()];
            if effect.block == Block::Mount {
                let slip = rotation_from_rotvec(Vec3::from_column_slice(&effect.values))
                    * rotation_from_rotvec(Vec3::from_column_slice(step));
                effect.values = rotvec_from_rotation(&slip).as_slice().to_vec();
            } else {
                effect.values.iter_mut().zip(step).for_each(|(value, step)| *value += step);
            }
        }
    }

    fn remove(&mut self, block: Block) {
        self.list.retain(|effect| effect.block != block);
        let mut start = self.own_width;
        for effect in &mut self.list {
            effect.columns = start..start + effect.columns.len();
            start = effect.columns.end;
        }
    }

    fn push(&mut self, block: Block, profile: Profile, parameters: usize) {
        let functions = profile.weights(0.0, &Rotation::identity()).len();
        let columns = self.end()..self.end() + functions * parameters;
        self.list.push(Effect { block, profile, values: vec![0.0; columns.len()], columns });
    }
}

/// Adds effects of these kinds as long as one is likelier than the model without it, and fits each.
pub(super) fn add_likeliest_effects<M: Model>(
    mut model: M,
    candidates: &[(Block, Shape)],
    fit: impl Fn(&mut M) -> Solved,
) -> (M, Solved) {
    let mut solved = fit(&mut model);
    for _ in 0..MAX_EFFECTS {
        let Some(mut extended) = with_likeliest_effect(&model, candidates) else { break };
        let wanders = extended.effects().walk.is_some() && model.effects().walk.is_none();
        if wanders && model.effects().of(Block::Yaw).next().is_some() {
            // The walk was taken for other effects on the yaw. Its density is estimated without them.
            model.effects().remove(Block::Yaw);
            fit(&mut model);
            let with_walk = with_likeliest_effect(&model, &[(Block::Yaw, Shape::Walk)]);
            model = with_walk.unwrap_or(extended);
        } else {
            model = extended;
        }
        solved = fit(&mut model);
    }
    (model, solved)
}

/// Candidate for [`with_likeliest_effect`].
enum Addition {
    Effect(Block, Profile),
    Walk(Walk),
}

fn step_at(test: &ModelExtension) -> Profile {
    Profile::Step { at_s: test.at, interval_s: test.interval_s }
}

fn with_likeliest_effect<M: Model>(model: &M, candidates: &[(Block, Shape)]) -> Option<M> {
    let linearization = model.linearize();
    let t_s = &linearization.t_s;
    let mut base = model.tested_with();
    for Prior { column, variance, .. } in model.priors() {
        base.retain(|parameter| parameter.0 != column);
        base.push((column, variance.recip()));
    }
    let tests = ExtensionTests::new(&linearization.linear, t_s, &base, M::MODEL_ERROR)?;
    let mut extended = model.clone();
    let effects = extended.effects().clone();
    let is_free = |&&(block, shape): &&(Block, Shape)| match (block, shape) {
        (Block::Yaw, Shape::Walk) => effects.walk.is_none(),
        (Block::Yaw, Shape::Step) | (Block::World, _) => true,
        (Block::Yaw, _) => effects.of(block).all(|effect| effect.profile.change_s().is_some()),
        _ => effects.of(block).next().is_none(),
    };
    let first_s = *t_s.first()?;
    let mut found: Vec<(f64, Addition)> = Vec::new();
    for &(block, shape) in candidates.iter().filter(is_free) {
        let (columns, size) = (model.columns_of(block), block.prior());
        let effect = |test: ModelExtension, profile| {
            (test.log_bayes_factor, Addition::Effect(block, profile))
        };
        match shape {
            Shape::Step => {
                let test = tests.step(&columns, size);
                found.extend(test.map(|test| effect(test, step_at(&test))));
            }
            Shape::Decay => {
                let test = tests.decay(&columns, size);
                let profile = |time_constant_s| Profile::Decay { first_s, time_constant_s };
                found.extend(test.map(|test| effect(test, profile(test.at))));
            }
            Shape::Heading => found.extend((0..3).filter_map(|axis| {
                let profile = Profile::Heading { axis };
                let moments = t_s.iter().zip(&linearization.world_from_imu);
                let by_sample: Vec<Vec<f64>> =
                    moments.map(|(t_s, rotation)| profile.weights(*t_s, rotation)).collect();
                let functions = (0..by_sample.first().map_or(0, Vec::len))
                    .map(|function| by_sample.iter().map(|all| all[function]).collect())
                    .collect();
                Some(effect(tests.best_extension(&columns, functions, size)?, profile))
            })),
            Shape::Walk => found.extend(Walk::over(t_s).and_then(|walk| {
                let test = tests.walk(columns[0], &walk)?;
                let walk = Walk { density: test.at, ..walk };
                Some((test.log_bayes_factor, Addition::Walk(walk)))
            })),
        }
    }
    // The first of equally likely ones.
    let likely = found.into_iter().rev().filter(|one| one.0 > 0.0);
    let (_, addition) = likely.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut push = |block: Block, profile: Profile| {
        extended.effects().push(block, profile, model.columns_of(block).len());
    };
    match addition {
        // Only the yaw of the world is reported.
        Addition::Effect(Block::World, _) => {
            let yaw = tests.step(&model.columns_of(Block::Yaw), Block::World.prior())?;
            (yaw.log_bayes_factor > 0.0).then(|| push(Block::Yaw, step_at(&yaw)))?;
        }
        Addition::Effect(block, profile) => push(block, profile),
        Addition::Walk(walk) => extended.effects().walk = Some(walk),
    }
    Some(extended)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::solve::{DesignNoise, Linearization, solve};
    use crate::solver::linear::Linear;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const RATE_HZ: f64 = 100.0;
    const NOISE_RAD: f64 = 3e-4;

    /// Yaw errors over time, with an offset and a drift.
    #[derive(Clone)]
    struct Series {
        t_s: Vec<f64>,
        errors: Vec<Vec3>,
        offset: [f64; 2],
        effects: Effects,
    }

    impl Series {
        /// 20 s with `error`, autoregressive noise and a random walk of density `walk`.
        fn new(seed: u64, rho: f64, walk: f64, error: impl Fn(f64) -> f64) -> Self {
            let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let (mut noise, mut wandered) = (Vec3::zeros(), 0.0);
            let t_s: Vec<f64> = (0..2000).map(|k| f64::from(k) / RATE_HZ).collect();
            let errors = t_s.iter().map(|&t_s| {
                let innovation = (1.0 - rho * rho).sqrt();
                noise = noise.map(|one| rho * one + innovation * normal());
                wandered += walk * RATE_HZ.sqrt().recip() * normal();
                NOISE_RAD * noise + Vec3::z() * (error(t_s) + wandered)
            });
            Self { errors: errors.collect(), t_s, offset: [0.0; 2], effects: Effects::new(2) }
        }

        fn fitted(self) -> (Self, Solved) {
            let shapes = [Shape::Step, Shape::Decay, Shape::Walk].map(|shape| (Block::Yaw, shape));
            add_likeliest_effects(self, &shapes, |model| {
                let free: Vec<usize> = [0, 1].into_iter().chain(model.effects.columns()).collect();
                solve(model, &free)
            })
        }
    }

    impl Model for Series {
        const MODEL_ERROR: f64 = 1e-6;

        fn linearize(&self) -> Linearization {
            let mut linear = Linear::new(self.effects.width(), &[1e-6]);
            for (&t_s, error) in self.t_s.iter().zip(&self.errors) {
                let yaw = self.effects.sum(Block::Yaw, t_s, &Rotation::identity()).x;
                let fitted = self.offset[0] + self.offset[1] * (t_s - 10.0) + yaw;
                let mut rows = linear.push(&[error - Vec3::z() * fitted]);
                rows.set(0, 0, Vec3::z());
                rows.set(0, 1, Vec3::z() * (t_s - 10.0));
                self.effects.set_rows(&mut rows, t_s, &Rotation::identity(), |_| vec![Vec3::z()]);
            }
            Linearization { linear, t_s: self.t_s.clone(), world_from_imu: Vec::new() }
        }

        fn design_noise(&self) -> DesignNoise {
            DesignNoise::zeros(self.effects.width())
        }

        fn apply(&mut self, delta: &[f64]) {
            self.offset.iter_mut().zip(delta).for_each(|(offset, delta)| *offset += delta);
            self.effects.apply(delta);
        }

        fn effects(&mut self) -> &mut Effects {
            &mut self.effects
        }

        fn columns_of(&self, _: Block) -> Vec<usize> {
            vec![0]
        }

        fn tested_with(&self) -> Vec<(usize, f64)> {
            [0, 1].into_iter().chain(self.effects.columns()).map(|column| (column, 0.0)).collect()
        }

        fn priors(&self) -> Vec<Prior> {
            self.effects.priors()
        }
    }

    #[test]
    fn a_drift_in_noise_has_no_effects() {
        let steady = (0..60).filter(|&seed| {
            let rho = if seed % 2 == 0 { 0.0 } else { 0.95 };
            let (model, _) = Series::new(seed, rho, 0.0, |t_s| 1e-3 * t_s).fitted();
            model.effects.list.is_empty() && model.effects.walk.is_none()
        });
        assert_eq!(steady.count(), 60);
    }

    #[test]
    fn a_jump_is_estimated_with_time_size_and_drift() {
        for (rho, size) in [(0.0, 0.01), (0.0, -0.003), (0.95, 0.01), (0.95, -0.2)] {
            let jump = |t_s: f64| if t_s > 7.123 { size } else { 0.0 };
            let (model, solved) = Series::new(5, rho, 0.0, |t_s| 1e-4 * t_s + jump(t_s)).fitted();
            let [found] = model.effects.list.as_slice() else {
                panic!("{rho} {size}: {:?}", model.effects)
            };
            let (at_s, _) = found.profile.change_s().expect("a step");
            assert!((at_s - 7.123).abs() < 0.1, "{found:?}");
            assert!((found.values[0] - size).abs() < 5e-4, "{found:?}");
            assert!(model.effects.walk.is_none());
            let drift = solved.measure(1, model.offset[1]).expect("a drift");
            assert!((drift.value - 1e-4).abs() < 4.0 * drift.std_error, "{drift:?}");
        }
    }

    #[test]
    fn a_walk_is_mostly_no_jump_and_its_drift_has_an_interval() {
        let (mut walks, mut covered, mut others) = (0, 0, 0);
        let mut ratios = Vec::new();
        for seed in 0..60 {
            let (model, solved) = Series::new(seed, 0.0, 2e-3, |_| 0.0).fitted();
            let density = model.effects.walk.as_ref().map_or(0.0, |walk| walk.density);
            walks += usize::from((1e-3..4e-3).contains(&density));
            ratios.push(density / 2e-3);
            others += model.effects.list.len();
            let [low, high] = solved.measure(1, model.offset[1]).expect("a drift").interval(0.95);
            covered += usize::from((low..=high).contains(&0.0));
        }
        assert!(walks >= 51 && others <= 12 && covered >= 51, "{walks} {others} {covered}");
        let median = ground::stats::median(&mut ratios).expect("ratios");
        assert!((0.85..1.15).contains(&median), "{median}");
    }

    #[test]
    fn a_part_that_no_effect_explains_has_none() {
        let unrelated = |t_s: f64| if t_s < 2.2 { (3.0 * t_s).sin() } else { 0.0 };
        let (model, _) = Series::new(4, 0.5, 0.0, unrelated).fitted();
        assert!(model.effects.list.is_empty(), "{:?}", model.effects);
    }

    #[test]
    fn a_jump_is_detected_within_a_walk() {
        let jump = |t_s: f64| if t_s > 12.0 { 0.05 } else { 0.0 };
        let (model, _) = Series::new(9, 0.0, 1e-3, jump).fitted();
        assert_eq!(model.effects.list.len(), 1, "{:?}", model.effects);
        assert!(model.effects.walk.is_some(), "{:?}", model.effects);
    }

    #[test]
    fn a_decay_is_estimated_with_its_time_constant() {
        let (model, _) = Series::new(3, 0.5, 0.0, |t_s| 0.02 * (-t_s / 4.0).exp()).fitted();
        let [Effect { profile: Profile::Decay { time_constant_s, .. }, values, .. }] =
            model.effects.list.as_slice()
        else {
            panic!("{:?}", model.effects)
        };
        assert!((time_constant_s - 4.0).abs() < 0.3 && (values[0] - 0.02).abs() < 1e-3);
    }
}
