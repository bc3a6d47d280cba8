//! One benchmark log: arm, scene, motion, rates, noise, and faults.

use std::fmt;

use poseaudit::checks;
use poseaudit::geometry::{pose, rotation_from_rotvec};
use poseaudit::synth::{Motion, Noise, POSE, Scenario, Task, Timing};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::PI;

use crate::Options;
use crate::backgrounds::Background;
use crate::fault_kinds::{
    FAULT_SPECS, FaultKind, FaultSpec, MAGNITUDES, MIN_MAGNITUDE_TO_FIND, PlantedFault, TrueValue,
    chain, choose, plant, unit_vector,
};
use crate::observability::is_observable;
use crate::scenes::{ARMS, Arm, Scene, confusable_arm, robot_of};

/// Kind of motion of a case.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotionKind {
    /// Wide or small random motion of all joints.
    Usual,
    /// Motion of industrial cells, see [`Task`]: most of it excites only some directions.
    Industrial,
    /// Demonstrations of 5 to 13 s by uncalibrated arms.
    Short,
}

impl MotionKind {
    pub const ALL: [Self; 3] = [Self::Usual, Self::Industrial, Self::Short];

    pub fn name(self) -> &'static str {
        match self {
            Self::Usual => "usual",
            Self::Industrial => "industrial",
            Self::Short => "short",
        }
    }
}

/// Industrial motions.
const INDUSTRIAL: [(&str, Motion); 17] = [
    ("picking", Motion::Task(Task::Picking)),
    ("palletising", Motion::Task(Task::Palletising)),
    ("welding", Motion::Task(Task::Welding)),
    ("spraying", Motion::Task(Task::Spraying)),
    ("screwdriving", Motion::Task(Task::Screwdriving)),
    ("tending", Motion::Tending),
    ("bin picking", Motion::Task(Task::BinPicking)),
    ("teleoperation", Motion::Task(Task::Teleoperation)),
    ("servoing", Motion::Task(Task::Servoing)),
    ("conveyor", Motion::Task(Task::Conveyor)),
    ("elbow swing", Motion::ElbowSwing),
    ("drawer", Motion::Task(Task::Drawer)),
    ("hand-guided", Motion::Continuous),
    ("cyclic", Motion::Periodic { period_s: 5.0 }),
    ("one joint", Motion::OneJoint(0)),
    ("one by one", Motion::OneByOne),
    ("calibration", Motion::Task(Task::Calibration)),
];

fn usual_motion(run: &mut Scenario, r: &mut Pcg64) -> &'static str {
    let motion = *choose(r, &["pick", "pick", "continuous", "small", "fast"]);
    match motion {
        "pick" => {}
        "continuous" => (run.motion, run.amplitude) = (Motion::Continuous, 0.9),
        "small" => {
            run.motion = *choose(r, &[Motion::PickAndPlace, Motion::Continuous]);
            run.amplitude = r.random_range(0.05..0.2);
        }
        _ => run.speed = 3.0,
    }
    motion
}

fn industrial_motion(run: &mut Scenario, r: &mut Pcg64) -> &'static str {
    let dof = chain(run).dof();
    let possible: Vec<(&str, Motion)> = INDUSTRIAL
        .into_iter()
        .filter(|(_, motion)| match motion {
            Motion::Task(_) => dof >= 6,
            Motion::ElbowSwing => dof == 7,
            _ => true,
        })
        .collect();
    let (name, motion) = *choose(r, &possible);
    (run.motion, run.amplitude, run.speed) = (motion, 0.5, 0.8);
    if let Motion::OneJoint(_) = motion {
        run.motion = Motion::OneJoint(r.random_range(0..dof));
    }
    name
}

fn short_motion(run: &mut Scenario, r: &mut Pcg64) -> &'static str {
    const SHORT: [&str; 6] =
        ["picking", "teleoperation", "drawer", "hand-guided", "calibration", "one joint"];
    let dof = chain(run).dof();
    let possible: Vec<(&str, Motion)> = INDUSTRIAL
        .into_iter()
        .filter(|(name, motion)| {
            SHORT.contains(name) && (dof >= 6 || !matches!(motion, Motion::Task(_)))
        })
        .collect();
    let (name, motion) = *choose(r, &possible);
    run.motion = motion;
    (run.amplitude, run.speed) = (r.random_range(0.2..0.6), 0.8);
    run.duration_s = r.random_range(5.0..13.0);
    if let Motion::OneJoint(_) = motion {
        run.motion = Motion::OneJoint(r.random_range(0..dof));
    }
    name
}

/// A log and its faults.
pub struct Case {
    pub index: usize,
    pub arm: &'static str,
    pub scene: Scene,
    pub background: Background,
    pub motion: &'static str,
    pub motion_kind: MotionKind,
    pub noise: &'static str,
    pub scenario: Scenario,
    /// A second, healthy arm in the log.
    pub other: Option<Scenario>,
    /// Whether the call names the tip.
    pub names_tip: bool,
    /// The robot named by the call.
    pub named_robot: Option<String>,
    /// Whether every joint moves enough for all rules.
    pub is_excited: bool,
    pub planted: Vec<PlantedFault>,
}

impl Case {
    pub fn new(options: &Options, index: usize) -> Self {
        let mut random = Pcg64::seed_from_u64(options.seed.rotate_left(32) ^ index as u64);
        let r = &mut random;
        let wanted = |scene: &&Scene| {
            options.scenes.is_empty()
                || options.scenes.iter().any(|name| scene.name().starts_with(name.as_str()))
        };
        let backgrounds: Vec<Background> = Background::ALL
            .into_iter()
            .filter(|one| {
                options.backgrounds.is_empty()
                    || options.backgrounds.iter().any(|name| one.name().starts_with(name.as_str()))
            })
            .collect();
        let fits = |scene: &&Scene| backgrounds.iter().any(|background| background.fits(**scene));
        let scenes: Vec<&Scene> = Scene::ALL.iter().filter(wanted).filter(fits).collect();
        // Half of the logs have a plain arm, where most faults are encodings and offsets.
        let scene = match r.random_bool(0.4) && options.scenes.is_empty() {
            true => Scene::Plain,
            false => **choose(r, &scenes),
        };
        let backgrounds: Vec<Background> =
            backgrounds.into_iter().filter(|background| background.fits(scene)).collect();
        // Half of the logs have an ideal arm, if possible.
        let mut background = match r.random_bool(0.4) && options.backgrounds.is_empty() {
            true => Background::Ideal,
            false => *choose(r, &backgrounds),
        };
        let arms: Vec<&Arm> = ARMS
            .iter()
            .filter(|arm| scene.arms().contains(&arm.name))
            .filter(|arm| options.arms.is_empty() || options.arms.iter().any(|a| a == arm.name))
            .collect();
        let &Arm { name: arm, base, tip, home } = match arms.as_slice() {
            [] => &ARMS[0],
            arms => choose(r, arms),
        };
        let mut run = Scenario::new(robot_of(arm), base, tip);
        run.seed = r.random();
        run.duration_s = *choose(r, &[15.0, 20.0, 20.0, 30.0]);
        run.home = home.iter().map(|q| q + r.random_range(-0.3..0.3)).collect();
        let kinds: Vec<MotionKind> = MotionKind::ALL
            .into_iter()
            .filter(|kind| scene.is_of_one_arm() || *kind == MotionKind::Usual)
            .filter(|kind| {
                options.motions.is_empty()
                    || options.motions.iter().any(|name| kind.name().starts_with(name.as_str()))
            })
            .collect();
        let motion_kind = if kinds.is_empty() { MotionKind::Usual } else { *choose(r, &kinds) };
        let motion = match motion_kind {
            MotionKind::Usual => usual_motion(&mut run, r),
            MotionKind::Industrial => industrial_motion(&mut run, r),
            MotionKind::Short => short_motion(&mut run, r),
        };
        if motion_kind == MotionKind::Short && options.backgrounds.is_empty() {
            background = Background::Uncalibrated;
        }
        let noise = match arm {
            "so101" => *choose(r, &["hobby", "white"]),
            _ if scene == Scene::Marker => "tracker",
            _ => *choose(r, &["white", "white", "coloured", "coloured", "tracker"]),
        };
        run.noise = match noise {
            "white" => Noise::default(),
            "coloured" => {
                Noise { pose_m: 2e-4, pose_rad: 2e-4, correlation: 0.95, ..Noise::default() }
            }
            "hobby" => Noise { joints: 5e-4, pose_m: 5e-4, pose_rad: 1e-3, ..Noise::default() },
            _ => Noise { pose_m: 5e-4, pose_rad: 1e-3, ..Noise::default() },
        };
        // Half of the logs have the rates of the targets.
        let rates = [20.0, 50.0, 100.0, 125.0, 125.0, 125.0, 125.0, 125.0, 250.0, 500.0];
        let joints_hz = *choose(r, &rates);
        let pose_hz = if r.random_bool(0.7) { joints_hz } else { *choose(r, &rates) };
        run.joints.timing.rate_hz = joints_hz;
        run.joints.has_velocity = r.random_bool(0.7);
        run.pose.timing.rate_hz = pose_hz;
        run.pose.timing.phase_s = r.random_range(0.0..1.0 / pose_hz);
        if r.random_bool(0.3) {
            // A state publisher copies the joints' stamps.
            (run.tf.timing.rate_hz, run.tf.timing.phase_s) = (joints_hz, 0.0);
        } else {
            run.tf.timing.phase_s = r.random_range(0.001..0.02);
        }
        run.imu.world_yaw_rad = r.random_range(-PI..PI);
        let turn = r.random_range(0.0..0.5) * unit_vector(r);
        run.imu.tip_from_imu = pose([0.02, -0.01, 0.03], rotation_from_rotvec(turn));
        let other = scene.apply(&mut run, r);
        background.apply(&mut run, r);

        let counts = options.faults.as_deref().unwrap_or(&[0, 1, 2, 0, 1, 4]);
        let count = counts[index % counts.len()];
        let mut case = Self {
            index,
            arm,
            scene,
            background,
            motion,
            noise,
            scenario: run,
            other,
            names_tip: scene.names_tip(),
            named_robot: None,
            is_excited: motion_kind == MotionKind::Usual && motion != "small",
            motion_kind,
            planted: Vec::new(),
        };
        case.plant_faults(r, count, options);
        case
    }

    /// The runs of all arms in the log.
    pub fn arms(&self) -> Vec<Scenario> {
        std::iter::once(&self.scenario).chain(&self.other).cloned().collect()
    }

    fn plant_faults(&mut self, r: &mut Pcg64, count: usize, options: &Options) {
        let has_rule = |spec: &FaultSpec| {
            spec.codes.iter().any(|code| checks::registry().iter().any(|rule| rule.code == *code))
        };
        let is_requested = |spec: &FaultSpec| {
            options.kinds.is_empty()
                || options.kinds.iter().any(|kind| {
                    spec.codes[0].starts_with(kind) || format!("{:?}", spec.kind).starts_with(kind)
                })
        };
        let possible: Vec<&FaultSpec> = FAULT_SPECS
            .iter()
            .filter(|spec| has_rule(spec) && is_requested(spec) && self.scene.supports(spec.kind))
            .filter(|spec| !self.is_implausible(spec.kind))
            .collect();
        let mut used_slots: Vec<String> = Vec::new();
        let mut chosen: Vec<(&FaultSpec, usize, f64)> = Vec::new();
        for _ in 0..40 {
            if chosen.len() == count || possible.is_empty() {
                break;
            }
            // Chooses the rule first, so that rules with many kinds do not dominate. With link deviations,
            // half of the faults are zero offsets.
            let mut codes: Vec<&str> = possible.iter().map(|spec| spec.codes[0]).collect();
            codes.dedup();
            let of_links = self.background.moves_frames() && r.random_bool(0.5);
            let kinds: Vec<&FaultSpec> =
                match possible.iter().find(|spec| spec.kind == FaultKind::Zero) {
                    Some(zero) if of_links => vec![zero],
                    _ => {
                        let code = *choose(r, &codes);
                        possible.iter().copied().filter(|spec| spec.codes[0] == code).collect()
                    }
                };
            let spec = *choose(r, &kinds);
            let mut slots: Vec<String> = spec.slots.iter().map(|&slot| slot.to_owned()).collect();
            let dof = chain(&self.scenario).dof();
            let joint = r.random_range(0..dof);
            if matches!(spec.kind, FaultKind::Zero | FaultKind::Homed | FaultKind::ZeroChanges) {
                slots.push(format!("joint {joint}"));
                // Equivalent to a frame offset by construction.
                if joint == 0 {
                    slots.push("reference".to_owned());
                }
                if joint + 1 == dof {
                    slots.push("tool".to_owned());
                }
            }
            let is_known = |slot: &String| match self.scene {
                // A change contains the value before it.
                _ if spec.kind.starts_mid_run() => true,
                Scene::TrackerWorld if slot == "reference" => false,
                // An unnamed link may be intended.
                scene => scene.names_tip() || slot != "tool",
            };
            if slots.iter().any(|slot| used_slots.contains(slot) || !is_known(slot)) {
                continue;
            }
            used_slots.append(&mut slots);
            let times = match count {
                1 => *choose(r, &MAGNITUDES),
                _ => *choose(r, &MAGNITUDES[5..]),
            };
            chosen.push((spec, joint, times));
        }
        chosen.sort_by_key(|(spec, ..)| spec.kind.starts_mid_run());
        for (spec, joint, times) in chosen {
            let planted = plant(&mut self.scenario, r, spec, joint, times);
            if spec.kind == FaultKind::WrongArm {
                self.named_robot = confusable_arm(self.arm).map(str::to_owned);
            }
            self.planted.push(planted);
            if spec.kind == FaultKind::HeldPose {
                self.planted.push(repeated_value_latency(&self.scenario));
            }
        }
    }

    /// Whether a kind of fault is not plausible in this case.
    fn is_implausible(&self, kind: FaultKind) -> bool {
        let has_copied_stamps = self.scenario.tf.timing.phase_s == 0.0;
        match kind {
            FaultKind::JointsLate => has_copied_stamps,
            // The generator would also write the rail's position in degrees.
            FaultKind::JointDegrees => self.arm == "rail",
            FaultKind::WrongArm => confusable_arm(self.arm).is_none(),
            // The other arm would also be named.
            FaultKind::OwnFrame => self.other.is_some(),
            _ => false,
        }
    }

    /// Whether a fault of at least twice the threshold must be found in this log.
    pub fn must_find(&self, planted: &PlantedFault) -> bool {
        /// Minimum duration for a rate, s, unless the latency has changed by the threshold.
        const MIN_DURATION_S: f64 = 60.0;
        const MIN_LATENCY_CHANGE_S: f64 = 2e-3;
        /// Minimum pose rate that shows vibration, Hz.
        const MIN_POSE_RATE_HZ: f64 = 25.0;
        let is_long_enough = match (planted.kind, planted.truth) {
            (FaultKind::Skew, TrueValue::Amount(skew)) => {
                let duration_s = self.scenario.duration_s;
                duration_s >= MIN_DURATION_S || skew.abs() * duration_s > 1.1 * MIN_LATENCY_CHANGE_S
            }
            _ => true,
        };
        // With an unexplained residual, no other cause is certain.
        let has_no_cause = |kind: FaultKind| kind == FaultKind::WrongArm;
        let is_attributable = has_no_cause(planted.kind)
            || !self.planted.iter().any(|other| has_no_cause(other.kind));
        let is_detectable = match planted.kind {
            FaultKind::Shake => self.scenario.pose.timing.rate_hz >= MIN_POSE_RATE_HZ,
            kind => self.background.is_detectable(kind, planted.magnitude),
        };
        let is_observable_in_motion = match self.motion_kind {
            MotionKind::Usual => self.is_excited,
            MotionKind::Industrial | MotionKind::Short => is_observable(self, planted),
        };
        planted.magnitude >= MIN_MAGNITUDE_TO_FIND
            && is_observable_in_motion
            && is_long_enough
            && is_attributable
            && is_detectable
    }

    /// 125 Hz, the rate of the targets.
    pub fn is_at_125_hz(&self) -> bool {
        let run = &self.scenario;
        run.joints.timing.rate_hz == 125.0 && run.pose.timing.rate_hz == 125.0
    }
}

/// Latency of a run's poses due to repeated values.
fn repeated_value_latency(run: &Scenario) -> PlantedFault {
    /// First threshold of LAT001, s.
    const THRESHOLD_S: f64 = 2e-3;
    let age_s = mean_age_s(run);
    PlantedFault {
        kind: FaultKind::HeldAge,
        codes: &["LAT001"],
        related_codes: &[],
        subject: Some(format!("{}{}", run.namespace, POSE)),
        magnitude: age_s / THRESHOLD_S,
        truth: TrueValue::Amount(age_s),
    }
}

/// Mean age of a pose, s.
fn mean_age_s(run: &Scenario) -> f64 {
    let Timing { rate_hz, update_hz: new_hz, .. } = run.pose.timing;
    let rows = (run.duration_s * rate_hz) as u32;
    let ages = (0..rows).map(|row| {
        let sent_s = f64::from(row) / rate_hz;
        sent_s - (sent_s * new_hz + 1e-9).floor() / new_hz
    });
    ages.sum::<f64>() / f64::from(rows)
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let run = &self.scenario;
        write!(
            f,
            "case {} {} {} ({}) {} {} joints {} Hz{} pose {} Hz {} s{}",
            self.index,
            self.arm,
            self.scene.name(),
            self.background.name(),
            self.motion,
            self.noise,
            run.joints.timing.rate_hz,
            if run.joints.has_velocity { "" } else { " (no velocity)" },
            run.pose.timing.rate_hz,
            run.duration_s,
            if run.tf.timing.phase_s == 0.0 { " tf=joints' stamps" } else { "" },
        )?;
        if let Some(named) = &self.named_robot {
            write!(f, " --robot {named}")?;
        }
        if self.motion_kind != MotionKind::Usual {
            write!(f, " {} {:?}", self.motion_kind.name(), run.motion)?;
        } else if run.motion != Motion::PickAndPlace || self.motion == "small" {
            write!(f, " {:?} ±{:.2}", run.motion, run.amplitude)?;
        }
        let planted: Vec<String> = self.planted.iter().map(ToString::to_string).collect();
        write!(
            f,
            " | planted: {}",
            if planted.is_empty() { "nothing".into() } else { planted.join(", ") }
        )
    }
}
