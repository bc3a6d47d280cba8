//! How the numbers of an IMU are written: in which units, and beyond which value they never go.
//!
//! The gyro is held unintegrated against FK's angular rate: by the median ratio of their lengths, which
//! no mount, order or sign of the axes changes, and which a bias or a lag moves but little.

use super::super::UnitSlip;
use super::super::constant::wahba;
use super::{FOLLOWS, ImuStream, Link, NEED, rms};
use ground::geometry::{Rotation, Vec3, angle_between};
use ground::stats::quantile;
use ground::stream::{ImuTrack, JointTrack};
use nalgebra::Matrix3;
use std::borrow::Cow;

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.80665;
/// A unit is named where the factor is its own to within this share.
const NEAR: f64 = 0.2;

/// How an IMU's numbers are written, where that is not as REP 145 has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuNumbers {
    /// What the gyro leaves of the arm's rates as rad/s and as °/s, rms rad/s, where it is in °/s.
    pub degrees: Option<UnitSlip>,
    /// The unit of the accelerometer, where it is another than m/s².
    pub accel: Option<AccelSlip>,
    /// Where the gyro saturates.
    pub clipped: Option<Clipped>,
    /// The axis of the gyro that is reversed, so that its axes are left-handed: 0 is x. Which one it is only
    /// a known mount tells.
    pub mirrored: Option<usize>,
}

/// An accelerometer in another unit than m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelSlip {
    /// The unit.
    pub unit: AccelUnit,
    /// The specific force that it says it feels, in the logged numbers: the median, at rest where the arm
    /// rests.
    pub felt: f64,
}

/// Units of acceleration that drivers leave in their messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccelUnit {
    /// Standard gravity.
    G,
    /// A thousandth of it.
    MilliG,
    /// cm/s².
    Gal,
}

impl AccelUnit {
    const ALL: [Self; 3] = [Self::G, Self::MilliG, Self::Gal];

    /// One of it in m/s².
    pub const fn in_m_s2(self) -> f64 {
        match self {
            Self::G => GRAVITY_M_S2,
            Self::MilliG => GRAVITY_M_S2 / 1e3,
            Self::Gal => 0.01,
        }
    }

    /// Its symbol.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::G => "g",
            Self::MilliG => "mg",
            Self::Gal => "cm/s²",
        }
    }
}

/// A gyro that never passes a value which the arm's rate does pass.
#[derive(Clone, Debug, PartialEq)]
pub struct Clipped {
    /// The largest size that is read, rad/s.
    pub limit_rad_s: f64,
    /// The axes on which it is reached: 0 is x.
    pub axes: Vec<usize>,
    /// Share of the samples that stand at it, 0 to 1.
    pub share: f64,
    /// How fast the arm turns about such an axis meanwhile: the largest rate, rad/s.
    pub by_fk_rad_s: f64,
}

impl ImuNumbers {
    /// How the numbers of `stream` are written, by the arm that carries it.
    pub fn of(joints: &JointTrack, stream: &ImuStream, most_lag_s: f64) -> Self {
        let none = Self::default();
        let link = Link::new(joints, stream, &none);
        let peak = link.peaks(most_lag_s).into_iter().next();
        let follows = peak.filter(|peak| peak.correlation > FOLLOWS);
        let lag_s = follows.map_or(0.0, |peak| peak.lag_s);
        let pairs = follows.map(|_| link.rate_pairs(lag_s)).unwrap_or_default();
        let plateaus = Plateau::all(&stream.track.gyro);
        let is_free = |pair: &&RatePair| plateaus.iter().all(|plateau| !plateau.at[pair.0]);
        let free: Vec<RatePair> = pairs.iter().filter(is_free).copied().collect();
        // A value that is read all the time is no end of a range.
        let free = if free.len() < NEED { pairs.clone() } else { free };
        let degrees = degrees(&free);
        let factor = if degrees.is_some() { 1f64.to_radians() } else { 1.0 };
        let mirrored = mirrored(&free, factor, stream.link_from_imu.map(|pose| pose.rotation));
        let clipped = clipped(&plateaus, &pairs, &free, factor, stream.track.gyro.len());
        Self { degrees, accel: accel(stream.track, &link.rests(lag_s)), clipped, mirrored }
    }

    /// The track in rad/s and m/s².
    pub fn mended<'a>(&self, track: &'a ImuTrack) -> Cow<'a, ImuTrack> {
        if self.degrees.is_none() && self.accel.is_none() && self.mirrored.is_none() {
            return Cow::Borrowed(track);
        }
        let rate = if self.degrees.is_some() { 1f64.to_radians() } else { 1.0 };
        let force = self.accel.map_or(1.0, |slip| slip.unit.in_m_s2());
        let mut rates = Vec3::repeat(rate);
        if let Some(axis) = self.mirrored {
            rates[axis] = -rate;
        }
        Cow::Owned(ImuTrack {
            gyro: track.gyro.iter().map(|gyro| gyro.component_mul(&rates)).collect(),
            accel: track.accel.iter().map(|accel| accel * force).collect(),
            ..track.clone()
        })
    }

    /// Whether a rate in rad/s is one at which the gyro saturates.
    pub(super) fn saturates(&self, gyro: &Vec3) -> bool {
        self.clipped.as_ref().is_some_and(|clipped| {
            let limit = clipped.limit_rad_s * (1.0 - SAME);
            clipped.axes.iter().any(|&axis| gyro[axis].abs() >= limit)
        })
    }
}

/// Values that differ by less than this share are one.
const SAME: f64 = 1e-5;

/// A row of the track, its gyro as logged, and the body rate of the link by FK, rad/s.
type RatePair = (usize, Vec3, Vec3);

impl Link<'_> {
    /// What gyro and FK say while the arm moves.
    fn rate_pairs(&self, lag_s: f64) -> Vec<RatePair> {
        let track = self.stream.track;
        let mut sweep = self.sweep();
        let rows = (0..track.t_s.len()).step_by(self.stride());
        rows.filter_map(|k| {
            let moment = self.at(track.t_s[k] - lag_s, &mut sweep)?;
            let rate = moment.rotation.inverse() * moment.rate;
            moment.moving.then_some((k, track.gyro[k], rate))
        })
        .collect()
    }

    /// The rows at which the arm rests.
    fn rests(&self, lag_s: f64) -> Vec<usize> {
        let track = self.stream.track;
        let mut sweep = self.sweep();
        let rows = (0..track.t_s.len()).step_by(self.stride());
        rows.filter(|&k| {
            self.at(track.t_s[k] - lag_s, &mut sweep).is_some_and(|moment| !moment.moving)
        })
        .collect()
    }
}

/// What the gyro leaves in either unit, where it turns as fast as the arm only in °/s.
fn degrees(pairs: &[RatePair]) -> Option<UnitSlip> {
    /// Slower rates than this share of the rms say little of a ratio.
    const FAST: f64 = 0.5;
    /// As degrees it leaves at most this share of the arm's rate, so that it is a gyro at all.
    const LEFT: f64 = 0.7;
    let by_fk = rms(pairs.iter().map(|(_, _, rate)| rate.norm()));
    let fast = pairs.iter().filter(|(_, _, rate)| rate.norm() > FAST * by_fk);
    let mut ratios: Vec<f64> = fast.map(|(_, gyro, rate)| gyro.norm() / rate.norm()).collect();
    if ratios.len() < NEED {
        return None;
    }
    let ratio = quantile(&mut ratios, 0.5)?;
    if (ratio.to_radians() - 1.0).abs() > NEAR {
        return None;
    }
    let left = |factor: f64| {
        let mount = Alignment::of(pairs, factor);
        rms(pairs.iter().map(|(_, gyro, rate)| mount.left(&(gyro * factor), rate).norm()))
    };
    let slip = UnitSlip { as_logged: left(1.0), corrected: left(1f64.to_radians()) };
    (slip.corrected < LEFT * by_fk).then_some(slip)
}

/// The mount and the bias that take the arm's rates to a gyro's.
struct Alignment {
    link_from_imu: Rotation,
    bias: Vec3,
}

impl Alignment {
    fn of(pairs: &[RatePair], factor: f64) -> Self {
        let n = pairs.len().max(1) as f64;
        let mean = pairs.iter().map(|(_, gyro, _)| gyro * factor).sum::<Vec3>() / n;
        let mean_rate = pairs.iter().map(|(_, _, rate)| rate).sum::<Vec3>() / n;
        let correlation: Matrix3<f64> = pairs
            .iter()
            .map(|(_, gyro, rate)| (rate - mean_rate) * (gyro * factor - mean).transpose())
            .sum();
        let link_from_imu = wahba(&correlation);
        Self { link_from_imu, bias: mean - link_from_imu.inverse() * mean_rate }
    }

    /// What the gyro would read, rad/s.
    fn expected(&self, rate: &Vec3) -> Vec3 {
        self.link_from_imu.inverse() * rate + self.bias
    }

    fn left(&self, gyro: &Vec3, rate: &Vec3) -> Vec3 {
        gyro - self.expected(rate)
    }
}

/// The axis that is reversed, where the gyro turns as the arm does only with its axes left-handed: the one
/// with which it is turned in its link as the log's frames say, as near as can be.
fn mirrored(pairs: &[RatePair], factor: f64, known_mount: Option<Rotation>) -> Option<usize> {
    /// It leaves at most this share of what right-handed axes leave, and of the arm's rate.
    const LEFT: f64 = 0.3;
    if pairs.len() < NEED {
        return None;
    }
    let left = |pairs: &[RatePair]| {
        let mount = Alignment::of(pairs, factor);
        let off =
            rms(pairs.iter().map(|(_, gyro, rate)| mount.left(&(gyro * factor), rate).norm()));
        (off, mount.link_from_imu)
    };
    let by_fk = rms(pairs.iter().map(|(_, _, rate)| rate.norm()));
    let right_handed = left(pairs).0;
    let reversed = |axis: usize| {
        let flipped = |(row, gyro, rate): &RatePair| {
            let mut gyro = *gyro;
            gyro[axis] = -gyro[axis];
            (*row, gyro, *rate)
        };
        let (off, mount) = left(&pairs.iter().map(flipped).collect::<Vec<_>>());
        let turned = known_mount.map_or(0.0, |known| angle_between(&known, &mount));
        (off < LEFT * right_handed.min(by_fk)).then_some((axis, turned))
    };
    if right_handed < LEFT * by_fk {
        return None;
    }
    let all = (0..3).filter_map(reversed);
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(axis, _)| axis)
}

/// An axis of a gyro that stands at its extreme again and again.
struct Plateau {
    axis: usize,
    /// The extreme, as logged.
    most: f64,
    /// Whether each row stands at it.
    at: Vec<bool>,
}

impl Plateau {
    fn all(gyro: &[Vec3]) -> Vec<Self> {
        /// So many samples at the extreme, and so many of them in a row, are no chance.
        const SAMPLES: usize = 8;
        const IN_A_ROW: usize = 3;
        let of = |axis: usize| {
            let most = gyro.iter().map(|gyro| gyro[axis].abs()).fold(0.0, f64::max);
            let limit = most * (1.0 - SAME);
            let at: Vec<bool> = gyro.iter().map(|gyro| gyro[axis].abs() >= limit).collect();
            let runs = at.chunk_by(|a, b| a == b).filter(|run| run[0]).map(<[bool]>::len);
            let is_long = runs.max().is_some_and(|longest| longest >= IN_A_ROW);
            let is_plateau =
                most > 0.0 && is_long && at.iter().filter(|at| **at).count() >= SAMPLES;
            is_plateau.then_some(Self { axis, most, at })
        };
        (0..3).filter_map(of).collect()
    }
}

/// Where the gyro, of so many `rows`, stays at one extreme while the arm turns faster, by those pairs that are
/// `free` of extremes; `factor` takes it to rad/s.
fn clipped(
    plateaus: &[Plateau],
    pairs: &[RatePair],
    free: &[RatePair],
    factor: f64,
    rows: usize,
) -> Option<Clipped> {
    /// The arm turns faster than the extreme by this share, in the median over those samples.
    const FASTER: f64 = 1.03;
    if plateaus.is_empty() || free.len() < NEED {
        return None;
    }
    let mount = Alignment::of(free, factor);
    let mut by_fk_rad_s = 0.0_f64;
    let mut is_passed = |plateau: &&Plateau| {
        let Plateau { axis, most, at } = plateau;
        let rates = pairs.iter().filter(|(row, ..)| at[*row]);
        let expected =
            |(_, gyro, rate): &RatePair| mount.expected(rate)[*axis] * gyro[*axis].signum();
        let mut faster: Vec<f64> = rates.map(expected).collect();
        let Some(median) = quantile(&mut faster, 0.5) else { return false };
        let is_passed = median > FASTER * most * factor;
        if is_passed {
            by_fk_rad_s = faster.iter().copied().fold(by_fk_rad_s, f64::max);
        }
        is_passed
    };
    let passed: Vec<&Plateau> = plateaus.iter().filter(|plateau| is_passed(plateau)).collect();
    let limit = passed.iter().map(|plateau| plateau.most).reduce(f64::min)?;
    let any = (0..rows).filter(|&row| passed.iter().any(|plateau| plateau.at[row])).count();
    Some(Clipped {
        limit_rad_s: limit * factor,
        axes: passed.iter().map(|plateau| plateau.axis).collect(),
        share: any as f64 / rows as f64,
        by_fk_rad_s,
    })
}

/// The unit in which the accelerometer feels gravity, where that is not m/s²: at rest where the arm rests
/// often enough, else over the run where what it feels is mostly one size.
fn accel(track: &ImuTrack, rests: &[usize]) -> Option<AccelSlip> {
    /// What is felt varies by less than this share of it, between the quartiles: gravity, not motion.
    const STEADY: f64 = 0.2;
    let sizes = |rows: &mut dyn Iterator<Item = usize>| -> Vec<f64> {
        rows.map(|row| track.accel[row].norm()).collect()
    };
    let mut felt = match rests.len() >= NEED {
        true => sizes(&mut rests.iter().copied()),
        false => sizes(&mut (0..track.accel.len())),
    };
    let [low, median, high] = [0.25, 0.5, 0.75].map(|share| quantile(&mut felt, share));
    let felt = median?;
    if high? - low? > STEADY * felt {
        return None;
    }
    let off = |unit: &AccelUnit| (felt * unit.in_m_s2() / GRAVITY_M_S2 - 1.0).abs();
    let nearest = AccelUnit::ALL.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    (off(&nearest) < NEAR).then_some(AccelSlip { unit: nearest, felt })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Rates about changing axes, and what a gyro turned by a mount says of them.
    fn pairs(gyro: impl Fn(Vec3) -> Vec3) -> Vec<RatePair> {
        let mount = ground::geometry::rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0));
        let rate = |k: usize| {
            let t = 0.01 * k as f64;
            Vec3::new((1.3 * t).sin(), (0.7 * t + PI / 3.0).cos(), (2.1 * t).sin())
        };
        (0..2000).map(|k| (k, gyro(mount.inverse() * rate(k)), rate(k))).collect()
    }

    #[test]
    fn a_gyro_in_degrees_is_told_whatever_its_mount_and_bias() {
        let bias = Vec3::new(2.0, -1.0, 0.5);
        let slip = degrees(&pairs(|rate| rate * 1f64.to_degrees() + bias)).unwrap();
        assert!(slip.corrected < 1e-9 && slip.as_logged > 10.0, "{slip:?}");
        assert_eq!(degrees(&pairs(|rate| rate + 0.01 * bias)), None);
        assert_eq!(degrees(&pairs(|rate| rate * 1.3)), None);
    }

    #[test]
    fn a_gyro_that_stays_at_a_value_which_the_arm_passes_saturates() {
        let clip = |rate: Vec3| rate.map(|one| one.clamp(-0.8, 0.8));
        let both = pairs(clip);
        let gyro: Vec<Vec3> = both.iter().map(|pair| pair.1).collect();
        let found = saturation(&gyro, &both).unwrap();
        assert!((found.limit_rad_s - 0.8).abs() < 1e-9 && found.share > 0.05, "{found:?}");
        assert!(found.by_fk_rad_s > 1.0, "{found:?}");
    }

    fn saturation(gyro: &[Vec3], pairs: &[RatePair]) -> Option<Clipped> {
        let plateaus = Plateau::all(gyro);
        let is_free = |pair: &&RatePair| plateaus.iter().all(|plateau| !plateau.at[pair.0]);
        let free: Vec<RatePair> = pairs.iter().filter(is_free).copied().collect();
        clipped(&plateaus, pairs, &free, 1.0, gyro.len())
    }

    #[test]
    fn a_reversed_axis_is_told_by_the_mount() {
        let reversed = pairs(|rate| Vec3::new(rate.x, -rate.y, rate.z));
        let mount = ground::geometry::rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0));
        assert_eq!(mirrored(&reversed, 1.0, Some(mount)), Some(1));
        assert!(mirrored(&reversed, 1.0, None).is_some());
        assert_eq!(mirrored(&pairs(|rate| Vec3::new(-rate.x, -rate.y, rate.z)), 1.0, None), None);
    }

    #[test]
    fn a_coarse_gyro_that_reads_its_peak_often_does_not_saturate() {
        let coarse = |rate: Vec3| rate.map(|one| (one / 0.05).round() * 0.05);
        let both = pairs(coarse);
        let gyro: Vec<Vec3> = both.iter().map(|pair| pair.1).collect();
        assert_eq!(saturation(&gyro, &both), None);
    }

    #[test]
    fn gravity_tells_the_unit_and_a_force_without_it_none() {
        let track = |size: f64| ImuTrack {
            accel: (0..200).map(|k| Vec3::new(0.0, 1e-3 * f64::from(k % 7), 1.0) * size).collect(),
            ..ImuTrack::default()
        };
        let unit = |size| accel(&track(size), &[]).map(|slip| slip.unit);
        assert_eq!(unit(1.01), Some(AccelUnit::G));
        assert_eq!(unit(997.0), Some(AccelUnit::MilliG));
        assert_eq!(unit(983.0), Some(AccelUnit::Gal));
        assert_eq!(unit(9.7), None);
        assert_eq!(unit(0.05), None);
        let motion = (0..200).map(|k| Vec3::x() * (f64::from(k) * 0.01)).collect();
        assert_eq!(accel(&ImuTrack { accel: motion, ..ImuTrack::default() }, &[]), None);
    }
}
