//! Units, saturation and handedness of an IMU's measurements. The gyro is compared with FK by the median
//! ratio of their norms, which mount, axis order and signs do not affect.

use super::{ImuStream, Link, LinkState, MIN_FIT_SAMPLES, followed_lag_s, rms};
use crate::UnitResiduals;
use ground::geometry::{Rotation, Vec3, angle_between, mean_vector, rotation_by_wahba};
use ground::stats::{median, quantile};
use ground::stream::{ImuTrack, JointTrack};
use std::borrow::Cow;

const GRAVITY_M_S2: f64 = 9.80665;
const UNIT_TOLERANCE: f64 = 0.2;

/// Deviations of an IMU's measurements from REP 145.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuConventions {
    /// Rms residual per unit, rad/s, if the gyro is in °/s.
    pub degrees: Option<UnitResiduals>,
    /// Accelerometer unit, if not m/s².
    pub accel: Option<AccelUnitError>,
    /// Median specific force at rest, or over the run if the arm hardly rests and the force is steady, m/s² in the detected
    /// unit. `None` otherwise, or if it is zero.
    pub force_at_rest_m_s2: Option<f64>,
    /// Gyro saturation.
    pub saturation: Option<GyroSaturation>,
    /// Gyro axis (0 is x) with reversed sign: left-handed axes. Only a known mount identifies which.
    pub mirrored_axis: Option<usize>,
}

/// Accelerometer in a unit other than m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelUnitError {
    /// The unit.
    pub unit: AccelUnit,
    /// Median as logged, at rest if the arm rests.
    pub norm: f64,
}

/// Acceleration units that drivers publish unconverted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccelUnit {
    /// Standard gravity.
    G,
    /// A thousandth of standard gravity.
    MilliG,
    /// cm/s².
    Gal,
}

impl AccelUnit {
    const ALL: [Self; 3] = [Self::G, Self::MilliG, Self::Gal];

    /// Size in m/s².
    pub const fn in_m_s2(self) -> f64 {
        match self {
            Self::G => GRAVITY_M_S2,
            Self::MilliG => GRAVITY_M_S2 / 1e3,
            Self::Gal => 0.01,
        }
    }

    /// Symbol.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::G => "g",
            Self::MilliG => "mg",
            Self::Gal => "cm/s²",
        }
    }
}

/// Gyro limited to a range that the arm's rate exceeds.
#[derive(Clone, Debug, PartialEq)]
pub struct GyroSaturation {
    /// Largest measured value.
    pub limit_rad_s: f64,
    /// Saturated axes: 0 is x.
    pub axes: Vec<usize>,
    /// Share of the samples, 0 to 1.
    pub share: f64,
    /// Largest FK rate about them.
    pub by_fk_rad_s: f64,
}

impl ImuConventions {
    /// Detects the conventions by comparison with FK.
    pub fn detect(joints: &JointTrack, stream: &ImuStream, max_lag_s: f64) -> Self {
        let none = Self::default();
        let link = Link::new(joints, stream, &none);
        let followed_s = followed_lag_s(&link.peaks(max_lag_s));
        let states = link.states(link.rows(), link.delay(followed_s.unwrap_or(0.0)));
        let (moving, resting): (Vec<_>, Vec<_>) = states.partition(|(_, state)| state.moving);
        let moving = if followed_s.is_some() { moving } else { Vec::new() };
        let pairs = rate_pairs(stream.track, &moving);
        let plateaus = plateaus(&stream.track.gyro);
        let free = without_plateaus(&pairs, &plateaus);
        // A value read all the time is no range limit.
        let free = if free.len() < MIN_FIT_SAMPLES { pairs.clone() } else { free };
        let degrees = degree_residuals(&free);
        let factor = if degrees.is_some() { 1f64.to_radians() } else { 1.0 };
        let free = scaled(&free, &Vec3::repeat(factor));
        let mirrored_axis = mirrored_axis(&free, link.known_mount());
        let saturation = detect_saturation(&plateaus, &stream.track.gyro, &pairs, &free, factor);
        let rests: Vec<usize> = resting.iter().map(|(row, _)| *row).collect();
        let force = StaticForce::measure(stream.track, &rests);
        let accel = force.and_then(|force| force.unit_error());
        let unit_m_s2 = accel.map_or(1.0, |error| error.unit.in_m_s2());
        let at_rest = force.filter(|force| {
            let is_quiet = !force.vibrates(GRAVITY_M_S2 / unit_m_s2);
            is_quiet && (force.is_at_rest || force.is_steady())
        });
        let force_at_rest_m_s2 =
            at_rest.map(|force| unit_m_s2 * force.median).filter(|force| *force > 0.0);
        Self { degrees, accel, force_at_rest_m_s2, saturation, mirrored_axis }
    }

    /// Converts the track to rad/s, m/s² and right-handed axes.
    pub fn convert<'a>(&self, track: &'a ImuTrack) -> Cow<'a, ImuTrack> {
        if self.degrees.is_none() && self.accel.is_none() && self.mirrored_axis.is_none() {
            return Cow::Borrowed(track);
        }
        let rate = if self.degrees.is_some() { 1f64.to_radians() } else { 1.0 };
        let force = self.accel.map_or(1.0, |slip| slip.unit.in_m_s2());
        let mut rates = Vec3::repeat(rate);
        if let Some(axis) = self.mirrored_axis {
            rates[axis] = -rate;
        }
        Cow::Owned(ImuTrack {
            gyro: track.gyro.iter().map(|gyro| gyro.component_mul(&rates)).collect(),
            accel: track.accel.iter().map(|accel| accel * force).collect(),
            ..track.clone()
        })
    }

    pub(super) fn saturates(&self, gyro: &Vec3) -> bool {
        self.saturation.as_ref().is_some_and(|GyroSaturation { limit_rad_s, axes, .. }| {
            axes.iter().any(|&axis| reaches(gyro[axis], *limit_rad_s))
        })
    }
}

fn reaches(rate: f64, limit: f64) -> bool {
    const EQUALITY_TOLERANCE: f64 = 1e-5;
    rate.abs() >= limit * (1.0 - EQUALITY_TOLERANCE)
}

/// Gyro, and FK body rate of the link, rad/s.
pub(super) type RatePair = (Vec3, Vec3);

pub(super) fn rate_pairs(track: &ImuTrack, states: &[(usize, LinkState)]) -> Vec<RatePair> {
    states.iter().map(|(row, state)| (track.gyro[*row], state.body_rate())).collect()
}

/// Multiplies each axis of the gyro by a factor.
fn scaled(pairs: &[RatePair], factors: &Vec3) -> Vec<RatePair> {
    pairs.iter().map(|(gyro, rate)| (gyro.component_mul(factors), *rate)).collect()
}

/// Rms rate of the link.
fn rms_rate(pairs: &[RatePair]) -> f64 {
    rms(pairs.iter().map(|(_, rate)| rate.norm()))
}

/// Residuals if the gyro matches the arm only in °/s.
fn degree_residuals(pairs: &[RatePair]) -> Option<UnitResiduals> {
    /// Share of the rms rate.
    const MIN_RATE_SHARE: f64 = 0.5;
    /// Share of the arm's rate, in °/s; a gyro has smaller residuals.
    const MAX_RESIDUAL_SHARE: f64 = 0.7;
    let by_fk = rms_rate(pairs);
    let fast = pairs.iter().filter(|(_, rate)| rate.norm() > MIN_RATE_SHARE * by_fk);
    let mut ratios: Vec<f64> = fast.map(|(gyro, rate)| gyro.norm() / rate.norm()).collect();
    if ratios.len() < MIN_FIT_SAMPLES {
        return None;
    }
    let ratio = median(&mut ratios)?;
    if (ratio.to_radians() - 1.0).abs() > UNIT_TOLERANCE {
        return None;
    }
    let left = |factor: f64| Alignment::fit(&scaled(pairs, &Vec3::repeat(factor))).residual;
    let slip = UnitResiduals { as_logged: left(1.0), corrected: left(1f64.to_radians()) };
    (slip.corrected < MAX_RESIDUAL_SHARE * by_fk).then_some(slip)
}

/// Mount and bias that map the link's rates to the gyro's.
pub(super) struct Alignment {
    pub link_from_imu: Rotation,
    pub bias: Vec3,
    pub mean_rate: Vec3,
    /// Rms.
    pub residual: f64,
}

impl Alignment {
    pub fn fit(pairs: &[RatePair]) -> Self {
        let mean = mean_vector(pairs.iter().map(|(gyro, _)| gyro));
        let mean_rate = mean_vector(pairs.iter().map(|(_, rate)| rate));
        let products =
            pairs.iter().map(|(gyro, rate)| (rate - mean_rate) * (gyro - mean).transpose());
        let link_from_imu = rotation_by_wahba(&products.sum());
        let bias = mean - link_from_imu.inverse() * mean_rate;
        let mut found = Self { link_from_imu, bias, mean_rate, residual: 0.0 };
        let residuals = pairs.iter().map(|(gyro, rate)| (gyro - found.expected(rate)).norm());
        found.residual = rms(residuals);
        found
    }

    fn expected(&self, rate: &Vec3) -> Vec3 {
        self.link_from_imu.inverse() * rate + self.bias
    }
}

/// Reversed gyro axis, if only left-handed axes match. Selects the axis whose mount is closest to the
/// logged one.
fn mirrored_axis(pairs: &[RatePair], known_mount: Option<Rotation>) -> Option<usize> {
    /// Share of the right-handed residual and of the arm's rate.
    const MAX_RESIDUAL_SHARE: f64 = 0.3;
    if pairs.len() < MIN_FIT_SAMPLES {
        return None;
    }
    let (by_fk, right_handed) = (rms_rate(pairs), Alignment::fit(pairs).residual);
    if right_handed < MAX_RESIDUAL_SHARE * by_fk {
        return None;
    }
    let reversed = |axis: usize| {
        let mut signs = Vec3::repeat(1.0);
        signs[axis] = -1.0;
        let Alignment { link_from_imu, residual, .. } = Alignment::fit(&scaled(pairs, &signs));
        let turned = known_mount.map_or(0.0, |known| angle_between(&known, &link_from_imu));
        (residual < MAX_RESIDUAL_SHARE * right_handed.min(by_fk)).then_some((axis, turned))
    };
    let all = (0..3).filter_map(reversed);
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(axis, _)| axis)
}

/// Gyro axes that repeatedly measure their extreme value, with that value.
fn plateaus(gyro: &[Vec3]) -> Vec<(usize, f64)> {
    const MIN_SATURATED_SAMPLES: usize = 8;
    const MIN_CONSECUTIVE_SAMPLES: usize = 3;
    let of = |axis: usize| {
        let extreme = gyro.iter().map(|gyro| gyro[axis].abs()).fold(0.0, f64::max);
        let at: Vec<bool> = gyro.iter().map(|gyro| reaches(gyro[axis], extreme)).collect();
        let mut runs = at.chunk_by(|a, b| a == b).filter(|run| run[0]);
        let is_plateau = extreme > 0.0
            && runs.any(|run| run.len() >= MIN_CONSECUTIVE_SAMPLES)
            && at.iter().filter(|at| **at).count() >= MIN_SATURATED_SAMPLES;
        is_plateau.then_some((axis, extreme))
    };
    (0..3).filter_map(of).collect()
}

fn without_plateaus(pairs: &[RatePair], plateaus: &[(usize, f64)]) -> Vec<RatePair> {
    let is_at = |gyro: &Vec3| plateaus.iter().any(|&(axis, extreme)| reaches(gyro[axis], extreme));
    pairs.iter().filter(|(gyro, _)| !is_at(gyro)).copied().collect()
}

/// The gyro stays at an extreme while the arm turns faster. `free` pairs, in rad/s, determine the mount; `factor`
/// converts the others.
fn detect_saturation(
    plateaus: &[(usize, f64)],
    gyro: &[Vec3],
    pairs: &[RatePair],
    free: &[RatePair],
    factor: f64,
) -> Option<GyroSaturation> {
    /// Median ratio of the expected rate to the extreme.
    const MIN_EXPECTED_RATIO: f64 = 1.03;
    if plateaus.is_empty() || free.len() < MIN_FIT_SAMPLES {
        return None;
    }
    let mount = Alignment::fit(free);
    // With the largest rate by FK.
    let passed = plateaus.iter().filter_map(|&(axis, extreme)| {
        let rates = pairs.iter().filter(|(gyro, _)| reaches(gyro[axis], extreme));
        let expected = |(gyro, rate): &RatePair| mount.expected(rate)[axis] * gyro[axis].signum();
        let mut faster: Vec<f64> = rates.map(expected).collect();
        let is_passed = median(&mut faster)? > MIN_EXPECTED_RATIO * extreme * factor;
        is_passed.then(|| (axis, extreme, faster.into_iter().fold(0.0, f64::max)))
    });
    let passed: Vec<(usize, f64, f64)> = passed.collect();
    let limit = passed.iter().map(|(_, extreme, _)| *extreme).reduce(f64::min)?;
    let is_clipped =
        |gyro: &&Vec3| passed.iter().any(|&(axis, extreme, _)| reaches(gyro[axis], extreme));
    Some(GyroSaturation {
        limit_rad_s: limit * factor,
        axes: passed.iter().map(|(axis, ..)| *axis).collect(),
        share: gyro.iter().filter(is_clipped).count() as f64 / gyro.len() as f64,
        by_fk_rad_s: passed.iter().map(|(.., by_fk)| *by_fk).fold(0.0, f64::max),
    })
}

/// Norm of the specific force at rest, or in the whole run if the arm hardly rests, as logged.
#[derive(Clone, Copy)]
struct StaticForce {
    is_at_rest: bool,
    median: f64,
    interquartile_range: f64,
    /// Median change from sample to sample over the run: a joint that vibrates seems to rest where it turns back.
    change: f64,
}

impl StaticForce {
    fn measure(track: &ImuTrack, rests: &[usize]) -> Option<Self> {
        let is_at_rest = rests.len() >= MIN_FIT_SAMPLES;
        let all: Vec<usize> = (0..track.accel.len()).collect();
        let rows: &[usize] = if is_at_rest { rests } else { &all };
        let mut felt: Vec<f64> = rows.iter().map(|row| track.accel[*row].norm()).collect();
        let [low, median, high] = [0.25, 0.5, 0.75].map(|share| quantile(&mut felt, share));
        let mut changes: Vec<f64> =
            track.accel.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        let change = quantile(&mut changes, 0.5)?;
        Some(Self { is_at_rest, median: median?, interquartile_range: high? - low?, change })
    }

    /// Whether it can be gravity: a larger spread is motion or noise.
    fn is_steady(&self) -> bool {
        /// Share of the median.
        const MAX_INTERQUARTILE_SHARE: f64 = 0.2;
        self.interquartile_range <= MAX_INTERQUARTILE_SHARE * self.median
    }

    /// Whether the force changes more than the noise of usual accelerometers. Vibration raises its norm.
    fn vibrates(&self, gravity: f64) -> bool {
        const MAX_CHANGE_SHARE: f64 = 0.1;
        self.change > MAX_CHANGE_SHARE * gravity
    }

    fn unit_error(&self) -> Option<AccelUnitError> {
        let off = |unit: &AccelUnit| (self.median * unit.in_m_s2() / GRAVITY_M_S2 - 1.0).abs();
        let nearest = AccelUnit::ALL.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (self.is_steady() && off(&nearest) < UNIT_TOLERANCE)
            .then_some(AccelUnitError { unit: nearest, norm: self.median })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Rates about changing axes, with a rotated mount.
    fn pairs(gyro: impl Fn(Vec3) -> Vec3) -> Vec<RatePair> {
        let mount = ground::geometry::rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0));
        let rate = |k: usize| {
            let t = 0.01 * k as f64;
            Vec3::new((1.3 * t).sin(), (0.7 * t + PI / 3.0).cos(), (2.1 * t).sin())
        };
        (0..2000).map(|k| (gyro(mount.inverse() * rate(k)), rate(k))).collect()
    }

    #[test]
    fn a_gyro_in_degrees_is_identified_with_any_mount_and_bias() {
        let bias = Vec3::new(2.0, -1.0, 0.5);
        let slip = degree_residuals(&pairs(|rate| rate * 1f64.to_degrees() + bias)).unwrap();
        assert!(slip.corrected < 1e-9 && slip.as_logged > 10.0, "{slip:?}");
        assert_eq!(degree_residuals(&pairs(|rate| rate + 0.01 * bias)), None);
        assert_eq!(degree_residuals(&pairs(|rate| rate * 1.3)), None);
    }

    #[test]
    fn a_gyro_that_stops_at_a_value_below_the_arms_rate_saturates() {
        let clip = |rate: Vec3| rate.map(|one| one.clamp(-0.8, 0.8));
        let both = pairs(clip);
        let found = saturation(&both).unwrap();
        assert!((found.limit_rad_s - 0.8).abs() < 1e-9 && found.share > 0.05, "{found:?}");
        assert!(found.by_fk_rad_s > 1.0, "{found:?}");
    }

    fn saturation(pairs: &[RatePair]) -> Option<GyroSaturation> {
        let gyro: Vec<Vec3> = pairs.iter().map(|pair| pair.0).collect();
        let plateaus = plateaus(&gyro);
        let free = without_plateaus(pairs, &plateaus);
        detect_saturation(&plateaus, &gyro, pairs, &free, 1.0)
    }

    #[test]
    fn a_reversed_axis_is_identified_by_the_mount() {
        let reversed = pairs(|rate| Vec3::new(rate.x, -rate.y, rate.z));
        let mount = ground::geometry::rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0));
        assert_eq!(mirrored_axis(&reversed, Some(mount)), Some(1));
        assert!(mirrored_axis(&reversed, None).is_some());
        assert_eq!(mirrored_axis(&pairs(|rate| Vec3::new(-rate.x, -rate.y, rate.z)), None), None);
    }

    #[test]
    fn a_coarse_gyro_that_repeats_its_peak_does_not_saturate() {
        let coarse = |rate: Vec3| rate.map(|one| (one / 0.05).round() * 0.05);
        let both = pairs(coarse);
        assert_eq!(saturation(&both), None);
    }

    #[test]
    fn gravity_determines_the_acceleration_unit() {
        let track = |size: f64| ImuTrack {
            accel: (0..200).map(|k| Vec3::new(0.0, 1e-3 * f64::from(k % 7), 1.0) * size).collect(),
            ..ImuTrack::default()
        };
        let unit_error = |track: &ImuTrack| {
            StaticForce::measure(track, &[]).and_then(|force| force.unit_error())
        };
        let unit = |size| unit_error(&track(size)).map(|slip| slip.unit);
        assert_eq!(unit(1.01), Some(AccelUnit::G));
        assert_eq!(unit(997.0), Some(AccelUnit::MilliG));
        assert_eq!(unit(983.0), Some(AccelUnit::Gal));
        assert_eq!(unit(9.7), None);
        assert_eq!(unit(0.05), None);
        let motion = (0..200).map(|k| Vec3::x() * (f64::from(k) * 0.01)).collect();
        assert_eq!(unit_error(&ImuTrack { accel: motion, ..ImuTrack::default() }), None);
    }
}
