//! An IMU on the arm: its latency, its mount, the drift of its yaw and the bias of its gyro.
//!
//! With orientation: `world_from_imu(s) = Rz(drift·(s − middle)) · world_from_base · FK(q(s − τ))
//! · link_from_imu`, the constant world yaw and tilt free, the mount free where the log does not give
//! it or what it gives does not fit. Without: `gyro(s) = link_from_imu⁻¹ · ω_FK(s − τ) + bias`, ω the
//! body rate of the link. FK carries the joint offsets found, since a wrist zero of 1° looks like
//! 0.6 °/min of drift and 0.9° of mount error without them.

use super::arm::still_speeds;
use super::latency::{Peak, angular_speed, arm_speeds, norms, peaks};
use super::linear::{Linear, Normal, Weight, sandwich};
use super::model::FLOOR_RAD;
use super::reading::{Fit, Logged, Samples, mean_rotation, nearest_truth, read, wahba};
use super::{GyroBias, ImuDiagnosis, ImuStream, Measured, ReadingEstimate, Seen, Unseen};
use crate::geometry::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use crate::stream::JointTrack;
use nalgebra::{DMatrix, DVector, Matrix3};

/// Samples of an IMU that are fitted.
const FIT_SAMPLES: usize = 5000;
/// Samples that readings are tried on.
const READING_SAMPLES: usize = 72;
/// Speeds correlate less than this where an IMU does not follow the arm.
const FOLLOWS: f64 = 0.6;
/// Gyro noise below this is no statistics, rad/s.
const FLOOR_RAD_S: f64 = 1e-6;
/// An arm rests where it also does this long before and after, s.
const SETTLING_S: f64 = 0.05;
/// Samples without which nothing is fitted.
const NEED: usize = 20;

/// Diagnoses one IMU against the joint states, which should be those corrected by
/// [`ArmDiagnosis::corrected_joints`](super::ArmDiagnosis::corrected_joints).
pub fn diagnose_imu(joints: &JointTrack, stream: &ImuStream, most_lag_s: f64) -> ImuDiagnosis {
    let link = Link::new(joints, stream);
    let peaks = link.peaks(most_lag_s);
    let moves = peaks.first().is_some_and(|peak| peak.correlation > FOLLOWS);
    let lag_s = peaks.first().filter(|_| moves).map_or(0.0, |peak| peak.lag_s);
    let gyro = link.fit_gyro(lag_s, moves);
    let orientation = if stream.track.orientation.is_empty() {
        Err(Unseen::NoOrientation)
    } else {
        // The gyro's lag is free of any convention, and finer than the speeds'.
        let start_s = gyro
            .as_ref()
            .ok()
            .and_then(|fit| fit.latency_s.as_ref().ok())
            .map_or(lag_s, |m| m.value);
        link.fit_orientation(start_s, moves)
    };
    let from_gyro = || match &gyro {
        Ok(fit) => fit.latency_s.clone(),
        Err(why) => Err(why.clone()),
    };
    let latency_s = match &orientation {
        Ok(fit) => fit.latency_s.clone(),
        Err(_) => from_gyro(),
    };
    let latency_s = match repeats(&peaks) {
        Some(lags) => Err(Unseen::Periodic(lags)),
        None => latency_s.map(|latency| Measured {
            std_error: latency.std_error.hypot(stream.stamp_error_s),
            ..latency
        }),
    };
    let turned = gyro.as_ref().ok().filter(|_| moves).map(|fit| fit.link_from_imu);
    let mount_by_gyro = gyro.as_ref().map_err(Clone::clone).and_then(|fit| fit.mount_rad.clone());
    let gyro_bias = gyro.and_then(|fit| fit.bias);
    let tilt_rad = link.tilt(lag_s);
    match orientation {
        Ok(fit) => ImuDiagnosis {
            reading: Ok(fit.reading),
            latency_s,
            yaw_drift_rad_s: fit.drift_rad_s,
            mount_rad: fit.mount_rad,
            link_from_imu: Some(fit.link_from_imu),
            tilt_rad,
            gyro_bias,
            yaw_error: fit.yaw_error,
        },
        Err(why) => ImuDiagnosis {
            reading: Err(why.clone()),
            latency_s,
            yaw_drift_rad_s: Err(why.clone()),
            mount_rad: mount_by_gyro,
            link_from_imu: turned,
            tilt_rad,
            gyro_bias,
            yaw_error: Vec::new(),
        },
    }
}

/// Lags whose correlations are as good as equal: repeating motion.
fn repeats(peaks: &[Peak]) -> Option<Vec<f64>> {
    let best = peaks.first()?;
    let equal: Vec<f64> = peaks
        .iter()
        .take_while(|peak| 1.0 - peak.correlation < 1.2 * (1.0 - best.correlation) + 1e-4)
        .map(|peak| peak.lag_s)
        .collect();
    (equal.len() > 1).then_some(equal)
}

/// The link that carries the IMU, over time.
struct Link<'a> {
    joints: &'a JointTrack,
    stream: &'a ImuStream<'a>,
    still: Vec<f64>,
    middle_s: f64,
}

/// The link at one moment.
struct Moment {
    /// `base_from_link`.
    rotation: Rotation,
    /// Angular velocity of the link in base, rad/s.
    rate: Vec3,
    /// Whether some joint moves.
    moving: bool,
}

/// Buffers of a sweep.
struct Sweep {
    cursor: usize,
    track: [Vec<f64>; 2],
    q: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
}

/// What a fit of orientations gives.
struct OrientationFit {
    reading: ReadingEstimate,
    latency_s: Seen<Measured>,
    drift_rad_s: Seen<Measured>,
    mount_rad: Seen<Measured>,
    link_from_imu: Rotation,
    yaw_error: Vec<(f64, f64)>,
}

/// What a fit of angular rates gives.
struct GyroFit {
    latency_s: Seen<Measured>,
    bias: Seen<GyroBias>,
    mount_rad: Seen<Measured>,
    link_from_imu: Rotation,
}

impl<'a> Link<'a> {
    fn new(joints: &'a JointTrack, stream: &'a ImuStream<'a>) -> Self {
        let t_s = &stream.track.t_s;
        let middle_s = match (t_s.first(), t_s.last()) {
            (Some(first), Some(last)) => 0.5 * (first + last),
            _ => 0.0,
        };
        Self { joints, stream, still: still_speeds(joints), middle_s }
    }

    fn sweep(&self) -> Sweep {
        let (own, track) = (self.stream.columns.len(), self.joints.dof);
        Sweep {
            cursor: 0,
            track: [vec![0.0; track], vec![0.0; track]],
            q: vec![0.0; own],
            jacobian: vec![[0.0; 6]; own],
        }
    }

    fn at(&self, t_s: f64, sweep: &mut Sweep) -> Option<Moment> {
        let [q, qd] = &mut sweep.track;
        if !self.joints.at(t_s, &mut sweep.cursor, q, qd) {
            return None;
        }
        for (own, &column) in sweep.q.iter_mut().zip(self.stream.columns) {
            *own = q[column];
        }
        let pose = self.stream.chain.forward_with_jacobian(&sweep.q, &mut sweep.jacobian);
        let mut moment = Moment { rotation: pose.rotation, rate: Vec3::zeros(), moving: false };
        for (column, &track) in sweep.jacobian.iter().zip(self.stream.columns) {
            moment.rate += Vec3::new(column[3], column[4], column[5]) * qd[track];
            moment.moving |= qd[track].abs() > self.still[track];
        }
        Some(moment)
    }

    /// Lags at which the IMU turns as fast as the link.
    fn peaks(&self, most_lag_s: f64) -> Vec<Peak> {
        let track = self.stream.track;
        let (_, turning) = arm_speeds(self.joints, self.stream.chain, self.stream.columns);
        let gyro = peaks(&turning, &norms(&track.t_s, &track.gyro), most_lag_s);
        if track.orientation.is_empty() {
            return gyro;
        }
        let oriented = peaks(&turning, &angular_speed(&track.t_s, &track.orientation), most_lag_s);
        let best = |peaks: &[Peak]| peaks.first().map_or(f64::MIN, |peak| peak.correlation);
        if best(&oriented) > best(&gyro) { oriented } else { gyro }
    }

    /// Every so many samples, so that about [`FIT_SAMPLES`] are used.
    fn stride(&self) -> usize {
        self.stream.track.t_s.len().div_ceil(FIT_SAMPLES).max(1)
    }

    fn fit_orientation(&self, lag_s: f64, moves: bool) -> Seen<OrientationFit> {
        let track = self.stream.track;
        let known_mount = self.stream.link_from_imu.map(|pose| pose.rotation);
        let (estimate, fit) = self.read(lag_s, known_mount)?;
        let mut sweep = self.sweep();
        let mut buffer = Vec::new();
        let logged = Logged::Rotations(&track.orientation);
        let mut model = OrientationModel {
            link: self,
            rows: Vec::new(),
            truth: Vec::new(),
            latency_s: lag_s,
            drift_rad_s: 0.0,
            world_from_base: fit.reference,
            link_from_imu: known_mount.unwrap_or_default() * fit.tool,
        };
        for k in (0..track.t_s.len()).step_by(self.stride()) {
            let Some(moment) = self.at(track.t_s[k] - lag_s, &mut sweep) else { continue };
            let expected = model.world_from_base * moment.rotation * model.link_from_imu;
            if let Some(truth) = nearest_truth(&fit.reading, &logged, k, &expected, &mut buffer) {
                model.rows.push(k);
                model.truth.push(truth);
            }
        }
        if model.rows.len() < NEED {
            return Err(Unseen::TooFewSamples { have: model.rows.len(), need: NEED });
        }
        model.start();
        let mut free: Vec<usize> = vec![OrientationModel::DRIFT];
        if moves {
            free.push(OrientationModel::LATENCY);
        }
        free.extend(OrientationModel::WORLD..OrientationModel::MOUNT);
        let mount: Vec<usize> = (OrientationModel::MOUNT..OrientationModel::WIDTH).collect();
        // The log's mount stands unless it costs more than three needless parameters would.
        let mut with_mount = free.clone();
        with_mount.extend(&mount);
        let mut fitted = model.clone();
        let solved = fitted.solve(&with_mount);
        let mount_rad = match known_mount {
            None => Err(Unseen::RestsOn("the IMU's frame in the log")),
            Some(known) => {
                let error = rotvec_from_rotation(&(known.inverse() * fitted.link_from_imu));
                let error = DVector::from_column_slice(error.as_slice());
                solved.norm_of(&mount, &error)
            }
        };
        let link_from_imu = fitted.link_from_imu;
        let mount_stands = known_mount.is_some_and(|known| {
            let error = rotvec_from_rotation(&(known.inverse() * fitted.link_from_imu)).norm();
            mount_rad.as_ref().map_or(true, |measured| error < 4.0 * measured.std_error)
        });
        let (model, solved) = if let (true, Some(known)) = (mount_stands, known_mount) {
            model.link_from_imu = known;
            model.start_world();
            let solved = model.solve(&free);
            (model, solved)
        } else {
            (fitted, solved)
        };
        let latency_s = if moves {
            solved.one(OrientationModel::LATENCY, model.latency_s)
        } else {
            Err(Unseen::AtRest)
        };
        Ok(OrientationFit {
            reading: estimate,
            latency_s,
            drift_rad_s: solved.one(OrientationModel::DRIFT, model.drift_rad_s),
            mount_rad,
            link_from_imu,
            yaw_error: model.yaw_error(),
        })
    }

    /// Which convention the orientation is written in; the mount by the log's frames is taken off.
    fn read(&self, lag_s: f64, known_mount: Option<Rotation>) -> Seen<(ReadingEstimate, Fit)> {
        let track = self.stream.track;
        let step = track.t_s.len().div_ceil(READING_SAMPLES).max(1);
        let mut sweep = self.sweep();
        let (mut fk, mut logged) = (Vec::new(), Vec::new());
        for k in (0..track.t_s.len()).step_by(step) {
            if let Some(moment) = self.at(track.t_s[k] - lag_s, &mut sweep) {
                fk.push(moment.rotation * known_mount.unwrap_or_default());
                logged.push(track.orientation[k]);
            }
        }
        let samples = Samples {
            logged: Logged::Rotations(&logged),
            fk: &fk,
            reference_free: true,
            reference_known: false,
        };
        read(&samples)
    }

    /// The IMU's lean against gravity, from the moments at which the arm rests.
    fn tilt(&self, lag_s: f64) -> Seen<Measured> {
        let track = self.stream.track;
        if track.orientation.is_empty() {
            return Err(Unseen::NoOrientation);
        }
        let mut sweep = self.sweep();
        let mut rests = |t_s: f64| self.at(t_s, &mut sweep).is_some_and(|moment| !moment.moving);
        let resting = (0..track.t_s.len()).step_by(self.stride()).filter(|&k| {
            let t_s = track.t_s[k] - lag_s;
            rests(t_s - SETTLING_S) && rests(t_s) && rests(t_s + SETTLING_S)
        });
        let forces: Vec<Vec3> = resting.map(|k| track.orientation[k] * track.accel[k]).collect();
        tilt(&forces)
    }

    fn fit_gyro(&self, lag_s: f64, moves: bool) -> Seen<GyroFit> {
        let track = self.stream.track;
        let mut sweep = self.sweep();
        let mut correlation = Matrix3::zeros();
        let rows: Vec<usize> = (0..track.t_s.len())
            .step_by(self.stride())
            .filter(|&k| match self.at(track.t_s[k] - lag_s, &mut sweep) {
                Some(moment) => {
                    correlation +=
                        moment.rotation.inverse() * moment.rate * track.gyro[k].transpose();
                    true
                }
                None => false,
            })
            .collect();
        if rows.len() < NEED {
            return Err(Unseen::TooFewSamples { have: rows.len(), need: NEED });
        }
        let link_from_imu = if moves { wahba(&correlation) } else { Rotation::identity() };
        let mut model = GyroModel {
            link: self,
            rows,
            latency_s: lag_s,
            link_from_imu,
            bias_rad_s: Vec3::zeros(),
        };
        let bias: Vec<usize> = (GyroModel::BIAS..GyroModel::WIDTH).collect();
        let free: Vec<usize> = if moves { (0..GyroModel::WIDTH).collect() } else { bias.clone() };
        let solved = model.solve(&free);
        let latency_s = if moves {
            solved.one(GyroModel::LATENCY, model.latency_s)
        } else {
            Err(Unseen::AtRest)
        };
        let vector = DVector::from_column_slice(model.bias_rad_s.as_slice());
        let bias = solved.norm_of(&bias, &vector).map(|norm_rad_s| GyroBias {
            vector_rad_s: model.bias_rad_s,
            norm_rad_s,
            yaw_rate_rad_s: model.yaw_rate(),
        });
        let mount_rad = match self.stream.link_from_imu {
            None => Err(Unseen::RestsOn("the IMU's frame in the log")),
            Some(known) => {
                let error = rotvec_from_rotation(&(known.rotation.inverse() * model.link_from_imu));
                let mount: Vec<usize> = (GyroModel::MOUNT..GyroModel::BIAS).collect();
                solved.norm_of(&mount, &DVector::from_column_slice(error.as_slice()))
            }
        };
        Ok(GyroFit { latency_s, bias, mount_rad, link_from_imu: model.link_from_imu })
    }
}

/// Angle between the mean of the specific `forces` felt at rest, in the world by the logged
/// orientation, and the vertical; the standard error is from the spread over blocks.
fn tilt(forces: &[Vec3]) -> Seen<Measured> {
    const BLOCKS: usize = 20;
    let n = forces.len();
    if n < 2 * BLOCKS {
        return Err(Unseen::NeverRests);
    }
    let mean = |forces: &[Vec3]| forces.iter().sum::<Vec3>() / forces.len() as f64;
    let whole = mean(forces);
    if whole.norm() < 1.0 {
        return Err(Unseen::RestsOn("an accelerometer that feels gravity"));
    }
    let blocks: Vec<Vec3> = forces.chunks_exact(n / BLOCKS).map(mean).collect();
    let leaning = |force: &Vec3| (force - whole).xy().norm_squared() / whole.norm_squared();
    let count = blocks.len() as f64;
    let variance = blocks.iter().map(leaning).sum::<f64>() / 2.0 / (count - 1.0) / count;
    let value = whole.xy().norm().atan2(whole.z);
    Ok(Measured { value, std_error: variance.sqrt(), dof: count - 1.0 })
}

/// Covariance of the parameters that a fit left free.
struct Solved {
    free: Vec<usize>,
    covariance: DMatrix<f64>,
    dof: f64,
}

impl Solved {
    fn one(&self, parameter: usize, value: f64) -> Seen<Measured> {
        let at = self.free.binary_search(&parameter).map_err(|_| Unseen::NotExcited)?;
        let variance = self.covariance[(at, at)];
        if !variance.is_finite() {
            return Err(Unseen::NotExcited);
        }
        Ok(Measured { value, std_error: variance.max(0.0).sqrt(), dof: self.dof })
    }

    /// The norm of a vector of parameters, with its largest standard error in any direction.
    fn norm_of(&self, parameters: &[usize], vector: &DVector<f64>) -> Seen<Measured> {
        let at: Vec<usize> = parameters
            .iter()
            .map(|parameter| self.free.binary_search(parameter).map_err(|_| Unseen::NotExcited))
            .collect::<Seen<_>>()?;
        let block = DMatrix::from_fn(at.len(), at.len(), |i, j| self.covariance[(at[i], at[j])]);
        if !block.iter().all(|value| value.is_finite()) {
            return Err(Unseen::NotExcited);
        }
        let largest = block.symmetric_eigen().eigenvalues.max().max(0.0);
        Ok(Measured { value: vector.norm(), std_error: largest.sqrt(), dof: self.dof })
    }
}

/// One Gauss–Newton step of `free` on a linearised model, and the covariance there.
fn step(linear: &Linear, free: &[usize]) -> (DVector<f64>, Solved) {
    let columns: Vec<usize> = (0..linear.width).collect();
    let zero = DVector::zeros(linear.width);
    let mut weights: Vec<Weight> = linear.first_weights();
    let mut step = zero.clone();
    let mut normal = Normal::zeros(linear.width);
    for _ in 0..2 {
        normal = Normal::zeros(linear.width);
        linear.accumulate(&weights, &columns, &mut normal);
        step = normal.step(&zero, free);
        weights = linear.weights_after(step.as_slice());
    }
    let mut sorted = free.to_vec();
    sorted.sort_unstable();
    let targets: Vec<Option<usize>> =
        columns.iter().map(|c| sorted.binary_search(c).ok()).collect();
    let mut information = DMatrix::zeros(sorted.len(), sorted.len());
    let mut scores = information.clone();
    linear.accumulate_covariance(&weights, &targets, &mut information, &mut scores);
    let covariance = sandwich(&information, &scores);
    let dof = (normal.independent - sorted.len() as f64).max(3.0);
    (step, Solved { free: sorted, covariance, dof })
}

/// The model of the orientations.
#[derive(Clone)]
struct OrientationModel<'a> {
    link: &'a Link<'a>,
    rows: Vec<usize>,
    truth: Vec<Rotation>,
    latency_s: f64,
    drift_rad_s: f64,
    world_from_base: Rotation,
    link_from_imu: Rotation,
}

impl OrientationModel<'_> {
    const LATENCY: usize = 0;
    const DRIFT: usize = 1;
    const WORLD: usize = 2;
    const MOUNT: usize = 5;
    const WIDTH: usize = 8;

    /// Makes the world's rotation fit the mount by averaging.
    fn start_world(&mut self) {
        let mut sweep = self.link.sweep();
        let t_s = &self.link.stream.track.t_s;
        let worlds: Vec<Rotation> = self
            .rows
            .iter()
            .zip(&self.truth)
            .filter_map(|(&k, truth)| {
                let moment = self.link.at(t_s[k] - self.latency_s, &mut sweep)?;
                Some(truth * (moment.rotation * self.link_from_imu).inverse())
            })
            .collect();
        self.world_from_base = mean_rotation(&worlds);
    }

    /// First guess of the world's rotation, where the reading left one to be found.
    fn start(&mut self) {
        if self.link.stream.link_from_imu.is_some() {
            self.start_world();
        }
    }

    fn linearize(&self) -> Linear {
        let mut linear = Linear::new(Self::WIDTH, &[FLOOR_RAD]);
        let mut sweep = self.link.sweep();
        for (&k, truth) in self.rows.iter().zip(&self.truth) {
            let stamp = self.link.stream.track.t_s[k];
            let Some(moment) = self.link.at(stamp - self.latency_s, &mut sweep) else { continue };
            let since = stamp - self.link.middle_s;
            let drifted = rotation_from_rotvec(Vec3::z() * (self.drift_rad_s * since));
            let world = drifted * self.world_from_base;
            let predicted = world * moment.rotation * self.link_from_imu;
            let residual = rotvec_from_rotation(&(truth * predicted.inverse()));
            let mut rows = linear.push(&[residual.into()]);
            if moment.moving {
                rows.set(0, Self::LATENCY, (-(world * moment.rate)).into());
            }
            rows.set(0, Self::DRIFT, (Vec3::z() * since).into());
            for axis in 0..3 {
                let unit = Vec3::ith(axis, 1.0);
                rows.set(0, Self::WORLD + axis, (drifted * unit).into());
                rows.set(0, Self::MOUNT + axis, (predicted * unit).into());
            }
        }
        linear
    }

    fn solve(&mut self, free: &[usize]) -> Solved {
        let mut solved = None;
        for _ in 0..8 {
            let (delta, now) = step(&self.linearize(), free);
            solved = Some(now);
            self.latency_s += delta[Self::LATENCY];
            self.drift_rad_s += delta[Self::DRIFT];
            let part = |first: usize| Vec3::new(delta[first], delta[first + 1], delta[first + 2]);
            self.world_from_base = rotation_from_rotvec(part(Self::WORLD)) * self.world_from_base;
            self.link_from_imu *= rotation_from_rotvec(part(Self::MOUNT));
            if delta.amax() < 1e-9 {
                break;
            }
        }
        solved.unwrap_or_else(|| Solved {
            free: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            dof: 3.0,
        })
    }

    /// Stamp, and yaw of the IMU over that of the arm with the drift left in.
    fn yaw_error(&self) -> Vec<(f64, f64)> {
        let still = Self { drift_rad_s: 0.0, ..self.clone() };
        let mut sweep = self.link.sweep();
        let t_s = &self.link.stream.track.t_s;
        let stamps = self
            .rows
            .iter()
            .filter(|&&k| self.link.at(t_s[k] - self.latency_s, &mut sweep).is_some());
        let stamps: Vec<f64> = stamps.map(|&k| t_s[k]).collect();
        let linear = still.linearize();
        stamps.into_iter().zip(linear.residual[0].iter().map(|residual| residual[2])).collect()
    }
}

/// The model of the angular rates.
struct GyroModel<'a> {
    link: &'a Link<'a>,
    rows: Vec<usize>,
    latency_s: f64,
    link_from_imu: Rotation,
    bias_rad_s: Vec3,
}

impl GyroModel<'_> {
    const LATENCY: usize = 0;
    const MOUNT: usize = 1;
    const BIAS: usize = 4;
    const WIDTH: usize = 7;
    /// Half the time over which a change of rate is taken, s.
    const STEP_S: f64 = 0.01;

    fn linearize(&self) -> Linear {
        let mut linear = Linear::new(Self::WIDTH, &[FLOOR_RAD_S]);
        let mut sweep = self.link.sweep();
        let track = self.link.stream.track;
        for &k in &self.rows {
            let truth_s = track.t_s[k] - self.latency_s;
            let mut rate = |t_s: f64| {
                let moment = self.link.at(t_s, &mut sweep)?;
                Some((
                    self.link_from_imu.inverse() * (moment.rotation.inverse() * moment.rate),
                    moment.moving,
                ))
            };
            let (Some((before, _)), Some((now, moving)), Some((after, _))) =
                (rate(truth_s - Self::STEP_S), rate(truth_s), rate(truth_s + Self::STEP_S))
            else {
                continue;
            };
            let residual = track.gyro[k] - now - self.bias_rad_s;
            let mut rows = linear.push(&[residual.into()]);
            if moving {
                rows.set(0, Self::LATENCY, ((before - after) / (2.0 * Self::STEP_S)).into());
            }
            for axis in 0..3 {
                let unit = Vec3::ith(axis, 1.0);
                rows.set(0, Self::MOUNT + axis, now.cross(&unit).into());
                rows.set(0, Self::BIAS + axis, unit.into());
            }
        }
        linear
    }

    /// Mean rate about the base's z that the bias would feign, rad/s.
    fn yaw_rate(&self) -> f64 {
        let mut sweep = self.link.sweep();
        let t_s = &self.link.stream.track.t_s;
        let (mut sum, mut count) = (0.0, 0.0);
        for &k in &self.rows {
            if let Some(moment) = self.link.at(t_s[k] - self.latency_s, &mut sweep) {
                sum += (moment.rotation * (self.link_from_imu * self.bias_rad_s)).z;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }

    fn solve(&mut self, free: &[usize]) -> Solved {
        let mut solved = None;
        for _ in 0..8 {
            let (delta, now) = step(&self.linearize(), free);
            solved = Some(now);
            self.latency_s += delta[Self::LATENCY];
            let part = |first: usize| Vec3::new(delta[first], delta[first + 1], delta[first + 2]);
            self.link_from_imu *= rotation_from_rotvec(part(Self::MOUNT));
            self.bias_rad_s += part(Self::BIAS);
            if delta.amax() < 1e-9 {
                break;
            }
        }
        solved.unwrap_or_else(|| Solved {
            free: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            dof: 3.0,
        })
    }
}
