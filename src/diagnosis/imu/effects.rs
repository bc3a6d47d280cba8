//! Effects: a block of parameters times a profile over the run. A gyro bias that steps, a mount that slips, a
//! yaw that jumps, depends on the heading or settles after power-on differ only in block and profile.

use super::extension_tests::ExtensionTests;
use super::model::{Column, Model, Parameters};
use super::solve::Solved;
use crate::priors::{BIAS_PRIOR_RAD_S, MOUNT_PRIOR_RAD, YAW_PRIOR_RAD};
use ground::geometry::{Rotation, Vec3};
use std::ops::Range;

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
    Constant,
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
    /// Random walk of this density per √s, linear between knots. Its increments are not part of a model's state.
    Walk {
        density: f64,
        first_s: f64,
        step_s: f64,
        increments: usize,
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
            Self::Constant => vec![1.0],
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
            Self::Walk { first_s, step_s, increments, .. } => {
                let passed = (t_s - first_s) / step_s;
                (0..increments).map(|k| (passed - k as f64).clamp(0.0, 1.0)).collect()
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
    /// Per function of the profile, one per parameter of the block.
    pub columns: Range<usize>,
}

impl Effect {
    fn is_walk(&self) -> bool {
        matches!(self.profile, Profile::Walk { .. })
    }

    fn prior_variance(&self) -> f64 {
        match self.profile {
            Profile::Walk { density, step_s, .. } => density.powi(2) * step_s,
            _ => self.block.prior().powi(2),
        }
    }
}

impl Parameters {
    pub fn effects_on(&self, block: Block) -> impl Iterator<Item = &Effect> {
        self.effects.iter().filter(move |effect| effect.block == block)
    }

    fn has_walk(&self) -> bool {
        self.effects.iter().any(Effect::is_walk)
    }

    /// Sum of the effects on a block; its first entries.
    pub fn sum_of_effects(&self, block: Block, t_s: f64, world_from_imu: &Rotation) -> Vec3 {
        let mut sum = Vec3::zeros();
        for effect in self.effects_on(block).filter(|effect| !effect.is_walk()) {
            let weights = effect.profile.weights(t_s, world_from_imu);
            let each = effect.columns.len() / weights.len();
            let functions = self.columns[effect.columns.clone()].chunks(each);
            for (columns, weight) in functions.zip(weights) {
                columns.iter().enumerate().for_each(|(at, it)| sum[at] += weight * it.value);
            }
        }
        sum
    }

    fn remove_effects(&mut self, block: Block) {
        let (effects, columns) = (std::mem::take(&mut self.effects), self.columns.clone());
        self.columns.truncate(effects.first().map_or(columns.len(), |first| first.columns.start));
        for effect in effects.into_iter().filter(|effect| effect.block != block) {
            let start = self.columns.len();
            self.columns.extend_from_slice(&columns[effect.columns]);
            self.effects.push(Effect { columns: start..self.columns.len(), ..effect });
        }
    }

    fn add_effect(&mut self, block: Block, profile: Profile, parameters: usize) {
        let functions = profile.weights(0.0, &Rotation::identity()).len();
        let start = self.columns.len();
        let columns = start..start + functions * parameters;
        let effect = Effect { block, profile, columns: columns.clone() };
        let (is_free, precision) = (!effect.is_walk(), effect.prior_variance().recip());
        self.columns.resize(columns.end, Column { is_free, precision, ..Column::default() });
        self.effects.push(effect);
    }
}

/// Adds effects of these kinds to a fitted model as long as one is likelier than the model without it, and fits each.
pub(super) fn add_likeliest_effects<M: Model>(
    (mut model, mut solved): (M, Solved),
    candidates: &[(Block, Shape)],
) -> (M, Solved) {
    for _ in 0..MAX_EFFECTS {
        let Some(mut extended) = with_likeliest_effect(&model, candidates) else { break };
        let wanders = extended.parameters().has_walk() && !model.parameters().has_walk();
        if wanders && model.parameters().effects_on(Block::Yaw).next().is_some() {
            // The walk was taken for other effects on the yaw. Its density is estimated without them.
            model.parameters().remove_effects(Block::Yaw);
            model.fit();
            let with_walk = with_likeliest_effect(&model, &[(Block::Yaw, Shape::Walk)]);
            model = with_walk.unwrap_or(extended);
        } else {
            model = extended;
        }
        solved = model.fit();
    }
    (model, solved)
}

fn with_likeliest_effect<M: Model>(model: &M, candidates: &[(Block, Shape)]) -> Option<M> {
    let linearization = model.linearize();
    let mut extended = model.clone();
    let parameters = extended.parameters();
    let tests = ExtensionTests::new(&linearization, &parameters.tested(), M::MODEL_ERROR)?;
    let is_free = |&&(block, shape): &&(Block, Shape)| match (block, shape) {
        (Block::Yaw, Shape::Walk) => !parameters.has_walk(),
        (Block::Yaw, Shape::Step) | (Block::World, _) => true,
        (Block::Yaw, _) => parameters
            .effects_on(block)
            .all(|effect| effect.is_walk() || effect.profile.change_s().is_some()),
        _ => parameters.effects_on(block).next().is_none(),
    };
    let test = |&(block, shape): &(Block, Shape)| {
        let (log_bayes_factor, profile) =
            tests.likeliest(M::columns_of(block), shape, block.prior())?;
        (log_bayes_factor > 0.0).then_some((log_bayes_factor, block, profile))
    };
    // The first of equally likely ones.
    let found = candidates.iter().rev().filter(is_free).filter_map(test);
    let (_, block, profile) = match found.max_by(|a, b| a.0.total_cmp(&b.0))? {
        // Only the yaw of the world is reported.
        (_, Block::World, _) => test(&(Block::Yaw, Shape::Step))?,
        likeliest => likeliest,
    };
    parameters.add_effect(block, profile, M::columns_of(block).len());
    Some(extended)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::Delay;
    use crate::imu::model::{Linearization, Moment, Sample};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const RATE_HZ: f64 = 100.0;
    const NOISE_RAD: f64 = 3e-4;

    /// Yaw errors over time, with an offset and a drift.
    #[derive(Clone)]
    struct Series {
        t_s: Vec<f64>,
        errors: Vec<Vec3>,
        parameters: Parameters,
    }

    impl Series {
        const OFFSET: usize = Parameters::WIDTH;
        const DRIFT: usize = Self::OFFSET + 1;

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
            let errors = errors.collect();
            let delay = Delay { latency_s: 0.0, skew: 0.0, middle_s: 10.0 };
            let mount = Rotation::identity();
            let mut columns = vec![Column::default(); Self::OFFSET];
            let own = Column { is_free: true, tested: Some(0.0), ..Column::default() };
            columns.resize(Self::DRIFT + 1, own);
            let parameters = Parameters::new(delay, mount, false, columns);
            Self { errors, t_s, parameters }
        }

        fn fitted(mut self) -> (Self, Solved) {
            let shapes = [Shape::Step, Shape::Decay, Shape::Walk].map(|shape| (Block::Yaw, shape));
            let solved = self.fit();
            add_likeliest_effects((self, solved), &shapes)
        }
    }

    impl Model for Series {
        const MODEL_ERROR: f64 = 1e-6;

        fn parameters(&mut self) -> &mut Parameters {
            &mut self.parameters
        }

        fn linearize(&self) -> Linearization {
            let mut linearization = Linearization::new(&self.parameters, self.t_s.len(), 1e-6);
            for (&t_s, error) in self.t_s.iter().zip(&self.errors) {
                let world_from_imu = Rotation::identity();
                let yaw = self.parameters.sum_of_effects(Block::Yaw, t_s, &world_from_imu).x;
                let since_s = t_s - self.parameters.middle_s;
                let columns = &self.parameters.columns;
                let drifted = columns[Self::DRIFT].value * since_s;
                let fitted = columns[Self::OFFSET].value + drifted + yaw;
                let sample = Sample {
                    moment: Moment { t_s, world_from_imu },
                    residual: error - Vec3::z() * fitted,
                    by_latency: Vec3::zeros(),
                    since_middle_s: since_s,
                    by_mount: [Vec3::zeros(); 3],
                    by_own: &[Vec3::z(), Vec3::z() * since_s],
                };
                linearization.push::<Self>(&self.parameters, sample);
            }
            linearization
        }

        fn columns_of(_: Block) -> Range<usize> {
            Self::OFFSET..Self::OFFSET + 1
        }
    }

    #[test]
    fn a_drift_in_noise_has_no_effects() {
        let steady = (0..60).filter(|&seed| {
            let rho = if seed % 2 == 0 { 0.0 } else { 0.95 };
            let (model, _) = Series::new(seed, rho, 0.0, |t_s| 1e-3 * t_s).fitted();
            model.parameters.effects.is_empty()
        });
        assert_eq!(steady.count(), 60);
    }

    #[test]
    fn a_jump_is_estimated_with_time_size_and_drift() {
        for (rho, size) in [(0.0, 0.01), (0.0, -0.003), (0.95, 0.01), (0.95, -0.2)] {
            let jump = |t_s: f64| if t_s > 7.123 { size } else { 0.0 };
            let (model, solved) = Series::new(5, rho, 0.0, |t_s| 1e-4 * t_s + jump(t_s)).fitted();
            let [found] = model.parameters.effects.as_slice() else {
                panic!("{rho} {size}: {:?}", model.parameters.effects)
            };
            let (at_s, _) = found.profile.change_s().expect("a step");
            assert!((at_s - 7.123).abs() < 0.1, "{found:?}");
            let jumped = model.parameters.columns[found.columns.start].value;
            assert!((jumped - size).abs() < 5e-4, "{found:?}: {jumped}");
            let drift = solved.measure(Series::DRIFT).expect("a drift");
            assert!((drift.value - 1e-4).abs() < 4.0 * drift.std_error, "{drift:?}");
        }
    }

    #[test]
    fn a_walk_is_mostly_no_jump_and_its_drift_has_an_interval() {
        let (mut walks, mut covered, mut others) = (0, 0, 0);
        let mut ratios = Vec::new();
        for seed in 0..60 {
            let (model, solved) = Series::new(seed, 0.0, 2e-3, |_| 0.0).fitted();
            let density = |effect: &Effect| match effect.profile {
                Profile::Walk { density, .. } => Some(density),
                _ => None,
            };
            let density = model.parameters.effects.iter().find_map(density).unwrap_or(0.0);
            walks += usize::from((1e-3..4e-3).contains(&density));
            ratios.push(density / 2e-3);
            others += model.parameters.effects.iter().filter(|effect| !effect.is_walk()).count();
            let [low, high] = solved.measure(Series::DRIFT).expect("a drift").interval(0.95);
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
        assert!(model.parameters.effects.is_empty(), "{:?}", model.parameters.effects);
    }

    #[test]
    fn a_jump_is_detected_within_a_walk() {
        let jump = |t_s: f64| if t_s > 12.0 { 0.05 } else { 0.0 };
        let (model, _) = Series::new(9, 0.0, 1e-3, jump).fitted();
        assert_eq!(model.parameters.effects.len(), 2, "{:?}", model.parameters.effects);
        assert!(model.parameters.has_walk(), "{:?}", model.parameters.effects);
    }

    #[test]
    fn a_decay_is_estimated_with_its_time_constant() {
        let (model, _) = Series::new(3, 0.5, 0.0, |t_s| 0.02 * (-t_s / 4.0).exp()).fitted();
        let [Effect { profile: Profile::Decay { time_constant_s, .. }, columns, .. }] =
            model.parameters.effects.as_slice()
        else {
            panic!("{:?}", model.parameters.effects)
        };
        let size = model.parameters.columns[columns.start].value;
        assert!((time_constant_s - 4.0).abs() < 0.3 && (size - 0.02).abs() < 1e-3);
    }
}
