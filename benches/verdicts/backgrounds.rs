//! Normal imperfections of real arms and sensors, with and without faults.

use std::f64::consts::{PI, TAU};

use poseaudit::robot::Robot;
use poseaudit::synth::{self, Camera, Scenario, SynthCompliance, SynthComplianceKind};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::fault_kinds::{DEGREE, FaultKind, chain, choose, unit_vector};
use crate::scenes::Scene;

/// Imperfection of a log, below every threshold.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Background {
    /// Noise only.
    Ideal,
    /// Encoders of 10 to 12 bits.
    CoarseEncoders,
    /// Backlash of up to 0.1° in one or two joints.
    Backlash,
    /// Sag of up to 0.05° in one or two joints.
    Sag,
    /// Link deviations of 0.05 to 0.2 mm, and 0.1° per millimetre.
    Links,
    /// Link deviations of 0.03 to 0.5 mm, as for uncalibrated arms.
    Uncalibrated,
    /// Link deviations of 1 mm.
    CoarseLinks,
    /// A pose with a random walk of 0.2 mm in 20 s.
    RandomWalk,
    /// A camera with a target, and noise that grows with distance.
    Camera,
    /// An IMU with yaw drift, bias and random walk below their thresholds.
    Mems,
    /// Long rests, and a recording gap of 0.5 s.
    Pauses,
}

impl Background {
    pub const ALL: [Background; 11] = [
        Background::Ideal,
        Background::CoarseEncoders,
        Background::Backlash,
        Background::Sag,
        Background::Links,
        Background::Uncalibrated,
        Background::CoarseLinks,
        Background::RandomWalk,
        Background::Camera,
        Background::Mems,
        Background::Pauses,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Background::Ideal => "ideal",
            Background::CoarseEncoders => "coarse encoders",
            Background::Backlash => "backlash",
            Background::Sag => "sag",
            Background::Links => "links",
            Background::Uncalibrated => "uncalibrated",
            Background::CoarseLinks => "coarse links",
            Background::RandomWalk => "random walk",
            Background::Camera => "camera",
            Background::Mems => "mems",
            Background::Pauses => "pauses",
        }
    }

    /// Whether the arm deviates from its nominal model, so that estimates use a slightly wrong model.
    pub fn has_model_error(self) -> bool {
        use Background::{Backlash, CoarseLinks, Links, Sag, Uncalibrated};
        matches!(self, Links | Uncalibrated | CoarseLinks | Backlash | Sag)
    }

    /// Whether link deviations move the ends of the chain.
    pub fn moves_frames(self) -> bool {
        matches!(self, Background::Links | Background::Uncalibrated | Background::CoarseLinks)
    }

    /// Findings that are right in this background whatever is planted. `excited` is whether the arm reaches
    /// different configurations.
    pub fn allows(self, code: &str, run: &Scenario, is_excited: bool) -> bool {
        match (self, code) {
            (Background::Pauses, "TIM002") => true,
            // 1 mm per link adds up to several at the ends of the chain, so these findings are true.
            (Background::CoarseLinks, "FRM002" | "FRM003") => true,
            // In a single configuration, link deviations are indistinguishable from a frame offset.
            (Background::Links, "FRM002" | "FRM003") => !is_excited,
            // Deviations beyond any calibration are a model error.
            (Background::CoarseLinks, "MDL001") => is_beyond_calibration(run),
            _ => false,
        }
    }

    /// Whether it is plausible in a scene: the arm is upright, and logged as measured.
    pub fn fits(self, scene: Scene) -> bool {
        use Scene::*;
        let one_arm =
            matches!(scene, Plain | Namespaced | Prefixed | TwoPublishers | TrackerWorld | Marker);
        match self {
            Background::Ideal => true,
            Background::Camera => matches!(scene, Plain | Namespaced),
            _ => one_arm || scene == ActiveTcp,
        }
    }

    /// Whether a fault of `times` its threshold is detectable in it.
    pub fn is_detectable(self, kind: FaultKind, times: f64) -> bool {
        use FaultKind::*;
        /// With such links, a zero offset of 0.1° is within the nominal model's error, in thresholds.
        const MIN_MAGNITUDE_ON_COARSE_LINKS: f64 = 20.0;
        let is_hidden_by_links = matches!(kind, Zero | Growth | Reference | Tool | Play | Sag);
        match self {
            Background::Uncalibrated | Background::CoarseLinks if is_hidden_by_links => {
                times >= MIN_MAGNITUDE_ON_COARSE_LINKS
            }
            _ => true,
        }
    }

    /// Applies it to a run.
    pub fn apply(self, run: &mut Scenario, r: &mut Pcg64) {
        match self {
            Background::Ideal => {}
            Background::CoarseEncoders => {
                run.joints.resolution = TAU / *choose(r, &[1024.0, 2048.0, 4096.0]);
            }
            Background::Backlash => add_compliance(run, r, |r| {
                (SynthComplianceKind::Backlash, r.random_range(0.02..0.1))
            }),
            Background::Sag => {
                add_compliance(run, r, |r| (SynthComplianceKind::Sag, r.random_range(0.01..0.05)))
            }
            Background::Links => {
                run.actual_robot =
                    Some(build_with_deviations(run, r.random_range(0.05e-3..0.2e-3), r))
            }
            Background::Uncalibrated => {
                let link_m = r.random_range(0.03e-3_f64.ln()..0.5e-3_f64.ln()).exp();
                run.actual_robot = Some(build_with_deviations(run, link_m, r));
            }
            Background::CoarseLinks => run.actual_robot = Some(build_with_deviations(run, 1e-3, r)),
            Background::RandomWalk => run.noise.pose_walk = (5e-5, 5e-5),
            Background::Camera => {
                run.add_camera(*choose(r, &[Camera::InHand, Camera::InBase])).expect("a chain");
                (run.noise.target_m, run.noise.target_rad) = (2e-4, 7e-4);
                run.noise.far_m = 0.8;
            }
            Background::Mems => {
                let plus_or_minus = |r: &mut Pcg64| r.random_range(-1.0..1.0);
                run.imu.yaw_drift_rad_s = 0.1 * plus_or_minus(r) * DEGREE / 60.0;
                run.imu.gyro_bias_rad_s = 0.05 * DEGREE * unit_vector(r);
                run.imu.yaw_walk_rad_per_sqrt_s = 0.002 * DEGREE;
                run.imu.gyro_from_rate *= 1.0 + 0.01 * plus_or_minus(r);
            }
            Background::Pauses => {
                run.pause_s = r.random_range(1.0..3.0);
                run.duration_s += 10.0;
                let from_s = run.duration_s * r.random_range(0.2..0.8);
                let gap = Some((from_s, from_s + 0.5));
                for timing in [
                    &mut run.joints.timing, &mut run.pose.timing, &mut run.tf.timing,
                    &mut run.imu.timing,
                ] {
                    timing.gap_s = gap;
                }
            }
        }
    }
}

/// Joints under gravity load in an upright arm: the second, and the next with a horizontal axis.
pub fn gravity_loaded_joints(run: &Scenario) -> [usize; 2] {
    if chain(run).dof() == 7 { [1, 3] } else { [1, 2] }
}

/// Makes one or two joints compliant; `how` returns the kind and the magnitude in degrees.
fn add_compliance(
    run: &mut Scenario,
    r: &mut Pcg64,
    how: impl Fn(&mut Pcg64) -> (SynthComplianceKind, f64),
) {
    let [first, second] = gravity_loaded_joints(run);
    for joint in [Some(first), Some(second).filter(|_| r.random_bool(0.5))].into_iter().flatten() {
        let (how, by_deg) = how(r);
        run.compliance.push(SynthCompliance { joint, kind: how, amplitude_rad: by_deg * DEGREE });
    }
}

/// Whether the rms deviation of the arm from its nominal model exceeds that of a calibration.
fn is_beyond_calibration(run: &Scenario) -> bool {
    /// Limits of nominal kinematics, m and rad.
    const MAX_RMS_M_RAD: (f64, f64) = (10e-3, 0.5 * DEGREE);
    const CONFIGURATIONS: usize = 200;
    let Some(built) = &run.actual_robot else { return false };
    let nominal = chain(run);
    let built = chain(&Scenario { robot: built.clone(), ..run.clone() });
    let (mut m, mut rad) = (0.0, 0.0);
    for configuration in 0..CONFIGURATIONS {
        let angle = |joint: usize| (configuration * (joint + 2)) as f64 * 0.618_034 * TAU;
        let home = run.home.iter().enumerate();
        let q: Vec<f64> = home.map(|(joint, q)| q + run.amplitude * angle(joint).sin()).collect();
        let deviation = nominal.forward(&q).inv_mul(&built.forward(&q));
        m += deviation.translation.vector.norm_squared() / CONFIGURATIONS as f64;
        rad += deviation.rotation.angle().powi(2) / CONFIGURATIONS as f64;
    }
    m.sqrt() > MAX_RMS_M_RAD.0 || rad.sqrt() > MAX_RMS_M_RAD.1
}

/// A manufactured arm: every joint frame deviates by `link_m` along each axis, and by 0.1° per millimetre
/// about each axis (standard deviations).
fn build_with_deviations(run: &Scenario, link_m: f64, r: &mut Pcg64) -> Robot {
    let link_rad = link_m / 1e-3 * PI / 1800.0;
    let text = synth::urdf_text(&run.robot);
    let mut parts = text.split("<origin xyz=\"");
    let mut changed_urdf = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (origin, rest) = part.split_once("\"/>").expect("the end of an origin");
        let joint = rest.split_once("</joint>").map_or("", |(joint, _)| joint);
        let (xyz, rpy) = origin.split_once("\" rpy=\"").expect("angles");
        let mut off = |numbers: &str, sigma: f64| -> String {
            let moves = joint.contains("<axis");
            let off = numbers.split(' ').map(|number| {
                let unit: f64 = StandardNormal.sample(r);
                let number: f64 = number.parse().expect("a number");
                (number + if moves { sigma * unit } else { 0.0 }).to_string()
            });
            off.collect::<Vec<_>>().join(" ")
        };
        let (xyz, rpy) = (off(xyz, link_m), off(rpy, link_rad));
        changed_urdf += &format!("<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>{rest}");
    }
    Robot::from_urdf(&changed_urdf, "as built").expect("an arm that is a little other is an arm")
}
