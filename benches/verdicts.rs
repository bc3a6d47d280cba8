//! The score board: how often the audit is right on logs that it has not seen.
//!
//! Seeded Monte Carlo over arms, motions, rates, noise and planted faults. Every case is made from
//! the seed and its number alone, so that one case can be made again:
//!
//! ```sh
//! cargo bench --bench verdicts                                  # the table
//! cargo bench --bench verdicts -- --logs 5000 --seed 7
//! cargo bench --bench verdicts -- --verbose --keep /tmp/logs    # and what went wrong, with the logs
//! cargo bench --bench verdicts -- --only 812 --keep /tmp/logs   # one log and all that is said of it
//! ```
//!
//! What is planted follows the registry: a rule with a kind of fault in [`KINDS`] takes part as soon
//! as it is there. A seed makes other logs when a rule is added. Lost samples are not simulated.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt::{self, Write as _};
use std::fs;
use std::io::BufWriter;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use poseaudit::checks::{self, Grade};
use poseaudit::finding::{CheckRow, Estimate, Finding, Severity, Status, Subject, Unit};
use poseaudit::geometry::{
    Misreading, Pose, QuaternionSlip, Vec3, misreading_classes, pose, rotation_from_rotvec,
};
use poseaudit::report::Report;
use poseaudit::robot::{Chain, JointKind, Robot, catalogue};
use poseaudit::synth::{self, Coding, Motion, Noise, Scenario};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const DEGREE: f64 = PI / 180.0;

/// Amounts that are planted, in units of the rule's first figure.
const TIMES: [f64; 8] = [0.1, 0.3, 0.6, 0.9, 1.25, 2.0, 5.0, 20.0];
/// From here on a fault has to be found.
const SURE: f64 = 2.0;
/// The rules whose amount is the norm of a vector, or an rms.
const NORMS: [&str; 4] = ["FRM", "YAW002", "YAW003", "YAW004"];
/// The families in which a finding that nothing planted is a false alarm.
const CORE: [&str; 5] = ["ORD", "LAT", "ZER", "FRM", "YAW"];

fn main() {
    let options = Options::from_args();
    let started = Instant::now();
    let board = run(&options);
    if options.only.is_none() {
        print!("{board}");
    }
    eprintln!("{} logs in {:.0} s", board.logs, started.elapsed().as_secs_f64());
}

// ---------------------------------------------------------------------------- options

struct Options {
    logs: usize,
    seed: u64,
    threads: usize,
    /// Where to keep the logs whose outcome is wrong; with `only`, the one log.
    keep: Option<PathBuf>,
    only: Option<usize>,
    /// The numbers of faults to plant, taken in turn.
    faults: Option<Vec<usize>>,
    /// Kinds of fault to choose from, by the beginning of their rule's code.
    kinds: Vec<String>,
    arms: Vec<String>,
    /// Whether to list every wrong outcome.
    verbose: bool,
}

impl Options {
    fn from_args() -> Self {
        // `cargo test --benches` runs this without `--bench`: a look at whether it works.
        let logs = if std::env::args().any(|arg| arg == "--bench") { 1000 } else { 12 };
        let mut options = Self {
            logs,
            seed: 1,
            threads: 2,
            keep: None,
            only: None,
            faults: None,
            kinds: Vec::new(),
            arms: Vec::new(),
            verbose: false,
        };
        let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
        while let Some(name) = args.next() {
            let mut value = || args.next().unwrap_or_else(|| misuse(&name));
            let list = |text: String| text.split(',').map(str::to_owned).collect::<Vec<_>>();
            match name.as_str() {
                "--logs" => options.logs = number(&name, &value()),
                "--seed" => options.seed = number(&name, &value()),
                "--threads" => options.threads = number(&name, &value()),
                "--keep" => options.keep = Some(value().into()),
                "--only" => options.only = Some(number(&name, &value())),
                "--faults" => {
                    let counts = list(value());
                    options.faults = Some(counts.iter().map(|text| number(&name, text)).collect());
                }
                "--kinds" => options.kinds = list(value()),
                "--verbose" => options.verbose = true,
                "--arms" => options.arms = list(value()),
                _ => misuse(&name),
            }
        }
        options
    }
}

fn number<T: std::str::FromStr>(name: &str, text: &str) -> T {
    text.parse().unwrap_or_else(|_| misuse(name))
}

fn misuse(name: &str) -> ! {
    eprintln!(
        "{name}: not understood; options are --logs N --seed N --threads N --keep DIR --only CASE \
         --faults 0,1,2,4 --kinds LAT,ZER001 --arms ur5e,rail --verbose"
    );
    std::process::exit(2)
}

// ---------------------------------------------------------------------------- cases

/// A log and what is wrong with it.
struct Case {
    index: usize,
    arm: &'static str,
    motion: &'static str,
    noise: &'static str,
    scenario: Scenario,
    /// Whether every joint moves enough for every rule to see its fault.
    excited: bool,
    planted: Vec<Planted>,
}

struct Planted {
    kind: Kind,
    code: &'static str,
    /// Topic or joint.
    subject: String,
    /// How many times the first figure; infinite where the fault has no amount.
    times: f64,
    truth: Truth,
}

#[derive(Clone, Copy)]
enum Truth {
    Amount(f64),
    Frame { length_m: f64, angle_rad: f64 },
    Convention(Misreading),
    There,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
enum Kind {
    PoseLate,
    ImuLate,
    TfLate,
    JointsLate,
    Skew,
    Zero,
    Growth,
    Reference,
    BaseTurned,
    Tool,
    YawDrift,
    YawJump,
    Mount,
    GyroBias,
    Misread,
    ImuMisread,
    Wxyz,
    ImuWxyz,
    Transposed,
    Inverted,
    ImuTransposed,
    JointDegrees,
    JointOrder,
    Millimetres,
}

/// Every kind, with the code that must name it, and the slots of which it needs all: two faults that
/// share a slot cannot be told apart or cannot be planted together.
const KINDS: [(Kind, &str, &[&str]); 24] = [
    (Kind::PoseLate, "LAT001", &["pose time"]),
    (Kind::ImuLate, "LAT001", &["imu time"]),
    (Kind::TfLate, "LAT001", &["tf time"]),
    (Kind::JointsLate, "LAT001", &["pose time", "imu time", "tf time"]),
    (Kind::Skew, "LAT002", &["skew"]),
    (Kind::Zero, "ZER001", &[]),
    (Kind::Growth, "ZER002", &["growth"]),
    (Kind::Reference, "FRM002", &["reference"]),
    (Kind::BaseTurned, "FRM002", &["reference"]),
    (Kind::Tool, "FRM003", &["tool"]),
    (Kind::YawDrift, "YAW001", &["drift"]),
    (Kind::YawJump, "YAW001", &["drift"]),
    (Kind::Mount, "YAW003", &["mount"]),
    (Kind::GyroBias, "YAW004", &["gyro"]),
    (Kind::Misread, "ORD001", &["pose coding"]),
    (Kind::ImuMisread, "ORD001", &["imu coding", "mount"]),
    (Kind::Wxyz, "ORD002", &["pose coding"]),
    (Kind::ImuWxyz, "ORD002", &["imu coding", "mount"]),
    (Kind::Transposed, "ORD003", &["pose coding"]),
    (Kind::Inverted, "ORD003", &["pose coding"]),
    (Kind::ImuTransposed, "ORD003", &["imu coding", "mount"]),
    (Kind::JointDegrees, "ORD004", &["joint numbers"]),
    (Kind::JointOrder, "ORD005", &["joint numbers"]),
    (Kind::Millimetres, "ORD008", &["pose units"]),
];

/// The arms: name, base and tip; the rail is made here.
const ARMS: [(&str, &str, &str); 5] = [
    ("ur5e", "base", "tool0"),
    ("franka_fer", "fer_link0", "fer_link8"),
    ("kuka_lbr_iiwa14", "lbr_link_0", "lbr_link_ee"),
    ("so101", "base_link", "gripper_frame_link"),
    ("rail", "rail_base", "tool0"),
];

fn robot(arm: &str) -> Robot {
    if arm != "rail" {
        return catalogue::find(arm).expect("an arm of the catalogue").clone();
    }
    let ur5e = synth::urdf_text(catalogue::find("ur5e").expect("an arm of the catalogue"));
    let rail = "  <link name=\"rail_base\"/>\n  <joint name=\"rail_joint\" type=\"prismatic\">\n    \
                <parent link=\"rail_base\"/>\n    <child link=\"base_link\"/>\n    \
                <origin xyz=\"0.1 0 0.4\" rpy=\"0 0 0.3\"/>\n    <axis xyz=\"1 0 0\"/>\n    \
                <limit effort=\"0\" lower=\"-1\" upper=\"1\" velocity=\"1\"/>\n  </joint>\n</robot>";
    let text = ur5e.replace("</robot>", rail).replace("robot name=\"ur5e\"", "robot name=\"rail\"");
    Robot::from_urdf(&text, "bench").expect("the rail is a valid model")
}

/// The chain from base to tip.
fn chain(run: &Scenario) -> Chain {
    let link = |name: &str| run.robot.link(name).expect("a link of the arm");
    run.robot.chain(link(&run.base), link(&run.tip)).expect("a chain from base to tip")
}

impl Case {
    fn new(options: &Options, index: usize) -> Self {
        let mut random = Pcg64::seed_from_u64(options.seed.rotate_left(32) ^ index as u64);
        let r = &mut random;
        let arms: Vec<_> = ARMS
            .iter()
            .filter(|(arm, ..)| options.arms.is_empty() || options.arms.iter().any(|a| a == arm))
            .collect();
        let &&(arm, base, tip) = choose(r, &arms);
        let mut run = Scenario::new(robot(arm), base, tip);
        run.seed = r.random();
        run.duration_s = *choose(r, &[15.0, 20.0, 20.0, 30.0]);
        let middle = match arm {
            "ur5e" => vec![0.0, -PI / 2.0, PI / 2.0, -PI / 2.0, -PI / 2.0, 0.0],
            "rail" => vec![0.0, 0.0, -PI / 2.0, PI / 2.0, -PI / 2.0, -PI / 2.0, 0.0],
            "franka_fer" => vec![0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8],
            "kuka_lbr_iiwa14" => vec![0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0],
            _ => vec![0.0; 5],
        };
        run.home = middle.into_iter().map(|q| q + r.random_range(-0.3..0.3)).collect();
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
        let noise = match arm {
            "so101" => *choose(r, &["hobby", "white"]),
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
        // At the targets' rates every other time.
        let rates = [20.0, 50.0, 100.0, 125.0, 125.0, 125.0, 125.0, 125.0, 250.0, 500.0];
        let joints_hz = *choose(r, &rates);
        let pose_hz = if r.random_bool(0.7) { joints_hz } else { *choose(r, &rates) };
        run.joints.timing.rate_hz = joints_hz;
        run.joints.with_velocity = r.random_bool(0.7);
        run.pose.timing.rate_hz = pose_hz;
        run.pose.timing.phase_s = r.random_range(0.0..1.0 / pose_hz);
        if r.random_bool(0.3) {
            // A state publisher: the stamps are the joints'.
            (run.tf.timing.rate_hz, run.tf.timing.phase_s) = (joints_hz, 0.0);
        } else {
            run.tf.timing.phase_s = r.random_range(0.001..0.02);
        }
        run.imu.world_yaw_rad = r.random_range(-PI..PI);
        let turn = r.random_range(0.0..0.5) * unit_vector(r);
        run.imu.tip_from_imu = pose([0.02, -0.01, 0.03], rotation_from_rotvec(turn));

        let counts = options.faults.as_deref().unwrap_or(&[0, 1, 2, 0, 1, 4]);
        let count = counts[index % counts.len()];
        let mut case = Self {
            index,
            arm,
            motion,
            noise,
            scenario: run,
            excited: motion != "small",
            planted: Vec::new(),
        };
        case.plant_some(r, count, options);
        case
    }

    fn plant_some(&mut self, r: &mut Pcg64, count: usize, options: &Options) {
        let known = |code: &str| checks::registry().iter().any(|rule| rule.code == code);
        let wanted = |code: &str| {
            options.kinds.is_empty() || options.kinds.iter().any(|kind| code.starts_with(kind))
        };
        let copied = self.scenario.tf.timing.phase_s == 0.0;
        let mut taken: Vec<String> = Vec::new();
        for _ in 0..40 {
            if self.planted.len() == count {
                break;
            }
            // By rule first, so that rules with many kinds are not all there is.
            let codes: Vec<&str> = checks::registry()
                .iter()
                .map(|rule| rule.code)
                .filter(|code| wanted(code) && KINDS.iter().any(|kind| kind.1 == *code))
                .collect();
            if codes.is_empty() {
                break;
            }
            let code = *choose(r, &codes);
            let kinds: Vec<_> = KINDS.iter().filter(|kind| kind.1 == code).collect();
            let &(kind, code, slots) = *choose(r, &kinds);
            // The generator would write the rail's position in degrees, too.
            let senseless = match kind {
                Kind::JointsLate => copied,
                Kind::JointDegrees => self.arm == "rail",
                _ => false,
            };
            if !known(code) || senseless {
                continue;
            }
            let mut slots: Vec<String> = slots.iter().map(|&slot| slot.to_owned()).collect();
            let dof = chain(&self.scenario).dof();
            let joint = r.random_range(0..dof);
            if kind == Kind::Zero {
                slots.push(format!("joint {joint}"));
                // The same by construction as a frame.
                if joint == 0 {
                    slots.push("reference".to_owned());
                }
                if joint + 1 == dof {
                    slots.push("tool".to_owned());
                }
            }
            if slots.iter().any(|slot| taken.contains(slot)) {
                continue;
            }
            taken.append(&mut slots);
            let times = match count {
                1 => *choose(r, &TIMES),
                _ => *choose(r, &TIMES[5..]),
            };
            let planted = plant(&mut self.scenario, r, kind, code, joint, times);
            self.planted.push(planted);
        }
    }

    /// Whether a fault at twice the figure or more must be found in this log.
    fn must_find(&self, planted: &Planted) -> bool {
        planted.times >= SURE && self.excited
    }

    /// 125 Hz, the targets' rate.
    fn at_125_hz(&self) -> bool {
        let run = &self.scenario;
        run.joints.timing.rate_hz == 125.0 && run.pose.timing.rate_hz == 125.0
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let run = &self.scenario;
        write!(
            f,
            "case {} {} {} {} joints {} Hz{} pose {} Hz {} s{}",
            self.index,
            self.arm,
            self.motion,
            self.noise,
            run.joints.timing.rate_hz,
            if run.joints.with_velocity { "" } else { " (no velocity)" },
            run.pose.timing.rate_hz,
            run.duration_s,
            if run.tf.timing.phase_s == 0.0 { " tf=joints' stamps" } else { "" },
        )?;
        if run.motion != Motion::PickAndPlace || self.motion == "small" {
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

impl fmt::Display for Planted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {:?}", self.code, self.subject, self.kind)?;
        match self.truth {
            Truth::Amount(value) => write!(f, " {value:.6} (×{})", self.times),
            Truth::Frame { length_m, angle_rad } => {
                write!(f, " {:.3} mm {:.3}° (×{})", length_m * 1e3, angle_rad / DEGREE, self.times)
            }
            Truth::Convention(Misreading { is, read_as }) => write!(f, " {is} as {read_as}"),
            Truth::There => Ok(()),
        }
    }
}

/// Plants one fault of `times` the first figure, of either sign.
fn plant(
    run: &mut Scenario,
    r: &mut Pcg64,
    kind: Kind,
    code: &'static str,
    joint: usize,
    times: f64,
) -> Planted {
    let sign = if r.random_bool(0.5) { 1.0 } else { -1.0 };
    let figures = first_figures(code);
    let amount = sign * times * figures.first().map_or(0.0, |figure| figure.1);
    let direction = unit_vector(r);
    let mut subject = synth::POSE.to_owned();
    let mut truth = Truth::Amount(amount);
    let mut times = times;
    match kind {
        Kind::PoseLate => run.pose.timing.latency_s += amount,
        Kind::ImuLate => {
            run.imu.timing.latency_s += amount;
            subject = synth::IMU.to_owned();
        }
        Kind::TfLate => {
            run.tf.timing.latency_s += amount;
            subject = synth::TF.to_owned();
        }
        Kind::JointsLate => {
            // Joints that are early make all else late, which is told the other way round.
            run.joints.timing.latency_s += amount.abs();
            truth = Truth::Amount(amount.abs());
            subject = synth::JOINT_STATES.to_owned();
        }
        Kind::Skew => run.pose.timing.skew = amount,
        Kind::Zero => {
            let chain = chain(run);
            let amount = match chain.joint_kinds()[joint] {
                JointKind::Prismatic => sign * times * 0.2e-3,
                _ => sign * times * 0.1 * DEGREE,
            };
            run.joints.zero_offsets.resize(chain.dof(), 0.0);
            run.joints.zero_offsets[joint] = amount;
            truth = Truth::Amount(amount);
            subject = chain.joint_names()[joint].clone();
        }
        Kind::Growth => run.pose.growth = amount,
        Kind::Reference | Kind::Tool => {
            let (length_m, angle_rad) = match r.random_range(0..3) {
                0 => (times * 1e-3, 0.0),
                1 => (0.0, times * 0.1 * DEGREE),
                _ => (times * 1e-3, times * 0.1 * DEGREE),
            };
            let offset = pose(
                (length_m * unit_vector(r)).into(),
                rotation_from_rotvec(angle_rad * direction),
            );
            match kind {
                Kind::Tool => run.pose.tip_from_stream = offset,
                _ => run.pose.reference_from_stream = offset,
            }
            truth = Truth::Frame { length_m, angle_rad };
        }
        Kind::BaseTurned => {
            let turned: Pose = pose([0.0; 3], rotation_from_rotvec(PI * Vec3::z()));
            run.pose.reference_from_stream = turned;
            truth = Truth::Frame { length_m: 0.0, angle_rad: PI };
            times = f64::INFINITY;
        }
        Kind::YawDrift => {
            run.imu.yaw_drift_rad_s = amount;
            subject = synth::IMU.to_owned();
        }
        Kind::YawJump => {
            let amount = sign * times * figures.last().map_or(0.0, |figure| figure.1);
            let at_s = run.duration_s * r.random_range(0.2..0.8);
            run.imu.yaw_jumps = vec![(at_s, amount)];
            truth = Truth::Amount(amount);
            subject = synth::IMU.to_owned();
        }
        Kind::Mount => {
            run.imu.mount_error = pose([0.0; 3], rotation_from_rotvec(amount.abs() * direction));
            truth = Truth::Amount(amount.abs());
            subject = synth::IMU.to_owned();
        }
        Kind::GyroBias => {
            run.imu.gyro_bias_rad_s = amount.abs() * direction;
            truth = Truth::Amount(amount.abs());
            subject = synth::IMU.to_owned();
        }
        Kind::Misread | Kind::ImuMisread => {
            let classes = misreading_classes();
            // The usual ones more often.
            let class = match r.random_bool(0.3) {
                true => &classes[r.random_range(0..classes.len().min(12))],
                false => choose(r, classes),
            };
            let misreading = *choose(r, &class.members);
            truth = Truth::Convention(misreading);
            if kind == Kind::Misread {
                run.pose.coding = Coding::Misread(misreading);
            } else {
                run.imu.coding = Coding::Misread(misreading);
                subject = synth::IMU.to_owned();
            }
        }
        Kind::Wxyz => run.pose.coding = Coding::Slipped(slip(r)),
        Kind::ImuWxyz => {
            run.imu.coding = Coding::Slipped(slip(r));
            subject = synth::IMU.to_owned();
        }
        Kind::Transposed => run.pose.coding = Coding::Transposed,
        Kind::Inverted => run.pose.coding = Coding::Inverted,
        Kind::ImuTransposed => {
            run.imu.coding = Coding::Transposed;
            subject = synth::IMU.to_owned();
        }
        Kind::JointDegrees => {
            run.joints.in_degrees = true;
            subject = synth::JOINT_STATES.to_owned();
        }
        Kind::JointOrder => {
            let dof = chain(run).dof();
            let mut order: Vec<usize> = (0..dof).collect();
            match r.random_range(0..3) {
                0 => {
                    let at = r.random_range(0..dof - 1);
                    order.swap(at, at + 1);
                }
                1 => order.reverse(),
                _ => {
                    let (a, b) = (r.random_range(0..dof), r.random_range(1..dof));
                    order.swap(a, (a + b) % dof);
                }
            }
            run.joints.number_order = Some(order);
            subject = synth::JOINT_STATES.to_owned();
        }
        Kind::Millimetres => run.pose.in_millimetres = true,
    }
    if figures.is_empty() {
        (truth, times) = match truth {
            Truth::Convention(_) => (truth, f64::INFINITY),
            _ => (Truth::There, f64::INFINITY),
        };
    }
    Planted { kind, code, subject, times, truth }
}

/// Unit and first figure of each amount that the rule judges.
fn first_figures(code: &str) -> Vec<(Unit, f64)> {
    match checks::find(code).map(|rule| rule.grade) {
        Ok(Grade::From(figures)) => {
            figures.iter().map(|figure| (figure.unit, figure.warning)).collect()
        }
        _ => Vec::new(),
    }
}

fn slip(r: &mut Pcg64) -> QuaternionSlip {
    *choose(r, &[QuaternionSlip::WxyzReadAsXyzw, QuaternionSlip::XyzwReadAsWxyz])
}

fn choose<'a, T>(r: &mut Pcg64, from: &'a [T]) -> &'a T {
    &from[r.random_range(0..from.len())]
}

fn unit_vector(r: &mut Pcg64) -> Vec3 {
    loop {
        let v = Vec3::from_fn(|_, _| r.random_range(-1.0..1.0));
        if (0.01..1.0).contains(&v.norm()) {
            return v.normalize();
        }
    }
}

// ---------------------------------------------------------------------------- judging

/// How a planted fault fared.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Fate {
    /// Named with its subject.
    Named,
    /// Another cause is named, and this one listed as indistinguishable from it.
    NamedAsTwin,
    /// The rule said that the log does not tell.
    Undecided,
    /// The rule passed it.
    Passed,
    /// Neither passed nor failed: no such row.
    Absent,
}

impl Fate {
    fn is_named(self) -> bool {
        matches!(self, Fate::Named | Fate::NamedAsTwin)
    }
}

struct Verdict {
    fates: Vec<Fate>,
    /// What is wrong with the outcome: what kind of wrong, and the whole of it.
    wrongs: Vec<(String, String)>,
    /// Findings of the core families that nothing planted, by code.
    strangers: Vec<&'static str>,
    /// Findings of the other families, by code.
    other: Vec<&'static str>,
    intervals: Vec<Interval>,
    /// Whether the convention was right, for each ORD001 planted with at least three dwells.
    convention: Vec<bool>,
}

struct Interval {
    /// Code of the rule, and the quantity where it has two.
    code: String,
    topic: String,
    planted: bool,
    error: f64,
    truth: f64,
    covers: bool,
    /// Whether it is the norm of a vector, or an rms.
    is_norm: bool,
}

fn judge(case: &Case, report: &Report) -> Verdict {
    let mut verdict = Verdict {
        fates: Vec::new(),
        wrongs: Vec::new(),
        strangers: Vec::new(),
        other: Vec::new(),
        intervals: Vec::new(),
        convention: Vec::new(),
    };
    let grave = |finding: &&Finding| finding.severity >= Severity::Warning;
    let findings: Vec<&Finding> = report.findings.iter().filter(grave).collect();
    for planted in &case.planted {
        let fate = fate(planted, &findings, &report.checks);
        verdict.fates.push(fate);
        let described =
            || match report.checks.iter().find(|row| is_about(planted, row.code, &row.subject)) {
                Some(row) => {
                    format!("{planted}: {:?} {}", row.status, row.reason.as_deref().unwrap_or(""))
                }
                None => format!("{planted}: no row"),
            };
        match fate {
            Fate::Named | Fate::NamedAsTwin => {}
            Fate::Passed | Fate::Absent if planted.times >= SURE => {
                verdict.wrong(format!("missed {} {:?}", planted.code, planted.kind), described());
            }
            Fate::Undecided if case.must_find(planted) => {
                verdict
                    .wrong(format!("undecided {} {:?}", planted.code, planted.kind), described());
            }
            _ => {}
        }
        let finding =
            findings.iter().find(|finding| is_about(planted, finding.code, &finding.subject));
        let Some(estimate) = finding.and_then(|finding| finding.estimate.as_ref()) else {
            continue;
        };
        if let (Truth::Amount(truth), Some(value)) = (planted.truth, estimate.value()) {
            let figure = truth.abs() / planted.times;
            if (value - truth).abs() > (0.5 * figure).max(0.05 * truth.abs()) {
                let what = format!("{planted}: found {value:.6}");
                verdict.wrong(format!("wrong amount {} {:?}", planted.code, planted.kind), what);
            }
            if planted.times < 0.5 {
                let what = format!("{planted}: found {value:.6}");
                verdict.wrong(format!("overcalled {} {:?}", planted.code, planted.kind), what);
            }
        }
        if let Truth::Convention(truth) = planted.truth {
            let right = is_named(&truth, estimate);
            if !right {
                let what = format!("{planted}: found {:?}", estimate.convention());
                verdict.wrong(format!("wrong convention {:?}", planted.kind), what);
            }
        }
    }
    for planted in &case.planted {
        if let Truth::Convention(truth) = planted.truth
            && case.excited
            && case.motion != "continuous"
        {
            let finding =
                findings.iter().find(|finding| is_about(planted, finding.code, &finding.subject));
            let estimate = finding.and_then(|finding| finding.estimate.as_ref());
            verdict.convention.push(estimate.is_some_and(|estimate| is_named(&truth, estimate)));
        }
    }
    for finding in &findings {
        if case.planted.iter().any(|planted| {
            is_about(planted, finding.code, &finding.subject) || is_twin(planted, finding)
        }) {
            continue;
        }
        if CORE.iter().any(|family| finding.code.starts_with(family)) {
            verdict.strangers.push(finding.code);
            let kind = if case.planted.is_empty() { "false alarm" } else { "misattributed" };
            let codes: Vec<String> = case.planted.iter().map(|p| format!("{:?}", p.kind)).collect();
            verdict.wrong(
                format!("{kind} {}", finding.code),
                format!("{} on {} [{}]", finding.message, finding.subject.label(), codes.join("+")),
            );
        } else {
            verdict.other.push(finding.code);
            verdict.wrong(
                format!("other {}", finding.code),
                format!("{} on {}", finding.message, finding.subject.label()),
            );
        }
    }
    for row in &report.checks {
        verdict.intervals.extend(interval(case, row));
    }
    verdict
}

impl Verdict {
    fn wrong(&mut self, kind: String, what: String) {
        self.wrongs.push((kind, what));
    }
}

fn is_about(planted: &Planted, code: &str, subject: &Subject) -> bool {
    planted.code == code && subject_name(subject) == Some(&planted.subject)
}

fn subject_name(subject: &Subject) -> Option<&str> {
    subject.joint.as_deref().or(subject.topic.as_deref())
}

/// Whether the finding lists the planted fault among those that the log cannot tell from it.
fn is_twin(planted: &Planted, finding: &Finding) -> bool {
    let mut twins = finding.evidence.indistinguishable.iter();
    twins.any(|twin| is_about(planted, twin.code, &twin.subject))
}

fn fate(planted: &Planted, findings: &[&Finding], rows: &[CheckRow]) -> Fate {
    if findings.iter().any(|finding| is_about(planted, finding.code, &finding.subject)) {
        return Fate::Named;
    }
    if findings.iter().any(|finding| is_twin(planted, finding)) {
        return Fate::NamedAsTwin;
    }
    match rows.iter().find(|row| is_about(planted, row.code, &row.subject)).map(|row| row.status) {
        Some(Status::Inconclusive | Status::Skipped) => Fate::Undecided,
        Some(_) => Fate::Passed,
        None => Fate::Absent,
    }
}

fn is_named(truth: &Misreading, estimate: &Estimate) -> bool {
    let Some((is, read_as)) = estimate.convention() else { return false };
    let class = misreading_classes().iter().find(|class| class.members.contains(truth));
    class.is_some_and(|class| {
        class
            .members
            .iter()
            .any(|one| one.is.to_string() == is && one.read_as.to_string() == read_as)
    })
}

/// The interval of a row against the truth, where there are both.
fn interval(case: &Case, row: &CheckRow) -> Vec<Interval> {
    let estimate = match &row.estimate {
        Some(estimate) if !row.indistinguishable => estimate,
        _ => return Vec::new(),
    };
    if !CORE.iter().any(|family| row.code.starts_with(family)) {
        return Vec::new();
    }
    let planted = case.planted.iter().find(|planted| is_about(planted, row.code, &row.subject));
    if planted.is_some_and(|planted| planted.times < SURE) {
        return Vec::new();
    }
    // With a skew, the latency is that at mid-run, which is known to milliseconds only.
    let skewed = case.scenario.pose.timing.skew != 0.0;
    if row.code == "LAT001" && skewed && row.subject.topic.as_deref() == Some(synth::POSE) {
        return Vec::new();
    }
    let joints_late = case.scenario.joints.timing.latency_s;
    let is_planted = planted.is_some() || (row.code == "LAT001" && joints_late != 0.0);
    let make = |code: String, value: f64, ci95: Option<[f64; 2]>, truth: f64| {
        let [low, high] = ci95?;
        let covers = (low..=high).contains(&truth);
        let mut topic = row.subject.topic.clone().unwrap_or("joints".to_owned());
        if topic == synth::TF && case.scenario.tf.timing.phase_s == 0.0 {
            topic += " with the joints' stamps";
        }
        let is_norm = NORMS.iter().any(|norm| code.starts_with(norm));
        Some(Interval {
            code,
            topic,
            planted: is_planted,
            error: value - truth,
            truth,
            covers,
            is_norm,
        })
    };
    match *estimate {
        Estimate::Amount { name, value, ci95, .. } => {
            // A jump of yaw and a drift have a row each.
            let is_jump = name == "yaw jump";
            let planted = planted.filter(|one| (one.kind == Kind::YawJump) == is_jump);
            let mut truth = match planted.map(|planted| planted.truth) {
                Some(Truth::Amount(truth)) => truth,
                _ => 0.0,
            };
            if row.code == "LAT001" && row.subject.topic.as_deref() != Some(synth::JOINT_STATES) {
                truth -= joints_late;
            }
            let code = if is_jump { format!("{} jump", row.code) } else { row.code.to_owned() };
            make(code, value, ci95, truth).into_iter().collect()
        }
        Estimate::Frame { value, ci95, rotation, .. } => {
            let (length_m, angle_rad) = match planted.map(|planted| planted.truth) {
                Some(Truth::Frame { length_m, angle_rad }) => (length_m, angle_rad),
                _ => (0.0, 0.0),
            };
            let length = make(format!("{} m", row.code), value, ci95, length_m);
            let angle = make(format!("{} rad", row.code), rotation.value, rotation.ci95, angle_rad);
            length.into_iter().chain(angle).collect()
        }
        _ => Vec::new(),
    }
}

// ---------------------------------------------------------------------------- running

fn run(options: &Options) -> Board {
    let cases: Vec<usize> = match options.only {
        Some(only) => vec![only],
        None => (0..options.logs).collect(),
    };
    let (next, board) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let dir = std::env::temp_dir().join(format!("poseaudit-verdicts-{}", std::process::id()));
    fs::create_dir_all(&dir).expect("a folder for the logs");
    std::thread::scope(|scope| {
        for _ in 0..options.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&index) = cases.get(at) else { break };
                    let case = Case::new(options, index);
                    let outcome = outcome(&case, &dir, options);
                    if at % 100 == 99 {
                        eprintln!("{} of {}", at + 1, cases.len());
                    }
                    board.lock().expect("no thread panics").push((case, outcome));
                }
            });
        }
    });
    fs::remove_dir_all(&dir).expect("the folder of the logs can be removed");
    let mut outcomes = board.into_inner().expect("no thread panics");
    outcomes.sort_by_key(|(case, _)| case.index);
    Board::new(options, &outcomes)
}

fn outcome(case: &Case, dir: &Path, options: &Options) -> Result<Verdict, String> {
    let log = dir.join(format!("{}.mcap", case.index));
    write(case, &log);
    let audit_options = poseaudit::Options {
        logs: vec![log.clone()],
        tip: Some(case.scenario.tip.clone()),
        ..Default::default()
    };
    let audited = catch_unwind(AssertUnwindSafe(|| poseaudit::audit(&audit_options)));
    let outcome = match &audited {
        Err(_) => Err("panicked".to_owned()),
        Ok(Err(trouble)) => Err(format!("trouble: {}", trouble.what)),
        Ok(Ok(report)) => match &report.error {
            Some(trouble) => Err(format!("trouble: {}", trouble.what)),
            None => Ok(judge(case, report)),
        },
    };
    let is_wrong = outcome.as_ref().map_or(true, |verdict| !verdict.wrongs.is_empty());
    if options.only.is_some() {
        println!("{case}");
        if let Ok(Ok(report)) = &audited {
            for row in &report.checks {
                println!(
                    "{row:?}",
                    row = (
                        row.code,
                        row.subject.label(),
                        row.status,
                        row.reason.as_deref().unwrap_or(""),
                        &row.estimate
                    )
                );
            }
        }
        match &outcome {
            Ok(verdict) => {
                println!("fates: {:?}", verdict.fates);
                for (kind, what) in &verdict.wrongs {
                    println!("{kind}: {what}");
                }
            }
            Err(trouble) => println!("{trouble}"),
        }
    }
    if let Some(keep) = &options.keep
        && (is_wrong || options.only.is_some())
    {
        fs::create_dir_all(keep).expect("the folder to keep logs in");
        let name = format!("s{}-{}", options.seed, case.index);
        fs::copy(&log, keep.join(format!("{name}.mcap"))).expect("the log can be kept");
        let mut text = format!("{case}\nBIN audit {name}.mcap --tip {}\n", case.scenario.tip);
        if let Ok(verdict) = &outcome {
            for (kind, what) in &verdict.wrongs {
                writeln!(text, "{kind}: {what}").expect("text takes text");
            }
        }
        fs::write(keep.join(format!("{name}.txt")), text).expect("the truth can be kept");
    }
    fs::remove_file(&log).expect("the log can be removed");
    outcome
}

fn write(case: &Case, log: &Path) {
    let out = BufWriter::new(fs::File::create(log).expect("a log can be made"));
    case.scenario.write_mcap(out, None).expect("a log can be written");
}

// ---------------------------------------------------------------------------- the table

struct Board {
    logs: usize,
    text: String,
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

type Outcomes = [(Case, Result<Verdict, String>)];

impl Board {
    fn new(options: &Options, outcomes: &Outcomes) -> Self {
        let mut text = String::new();
        table(&mut text, options, outcomes).expect("text takes text");
        Self { logs: outcomes.len(), text }
    }
}

fn table(t: &mut String, options: &Options, outcomes: &Outcomes) -> fmt::Result {
    let count = |few: usize, many: usize| {
        let of = |(case, _): &&(Case, _)| (few..=many).contains(&case.planted.len());
        outcomes.iter().filter(of).count()
    };
    writeln!(
        t,
        "{} logs, seed {}: {} clean, {} with one fault, {} with two, {} with more.",
        outcomes.len(),
        options.seed,
        count(0, 0),
        count(1, 1),
        count(2, 2),
        count(3, usize::MAX),
    )?;
    targets(t, outcomes)?;
    detection(t, outcomes)?;
    strangers(t, outcomes)?;
    intervals(t, outcomes, options.verbose)?;
    if options.verbose {
        wrongs(t, outcomes)?;
    }
    Ok(())
}

/// Those logs that were audited, with what came of it.
fn judged(outcomes: &Outcomes) -> impl Iterator<Item = (&Case, &Verdict)> {
    outcomes.iter().filter_map(|(case, outcome)| Some((case, outcome.as_ref().ok()?)))
}

fn targets(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    writeln!(t, "\n## Targets\n\n| what | reached | target |\n|---|---|---|")?;
    let clean = || judged(outcomes).filter(|(case, _)| case.planted.is_empty());
    let alarmed = clean().filter(|(_, verdict)| !verdict.strangers.is_empty()).count();
    writeln!(
        t,
        "| clean logs with a false alarm of ORD, LAT, ZER, FRM or YAW | {} | ≤ 0.5 % |",
        share(alarmed, clean().count())
    )?;

    let sure = |case: &Case| {
        !case.planted.is_empty()
            && case.excited
            && case.planted.iter().all(|planted| planted.times >= SURE)
    };
    let fates = |least: usize, most: usize| {
        judged(outcomes)
            .filter(move |(case, _)| sure(case) && (least..=most).contains(&case.planted.len()))
    };
    for (least, most, what) in
        [(1, 1, "one fault"), (2, 2, "two faults"), (3, usize::MAX, "four faults")]
    {
        let faults = || fates(least, most).flat_map(|(_, verdict)| &verdict.fates);
        let named = faults().filter(|fate| fate.is_named()).count();
        let target = if most == 1 { "≥ 99 %" } else { "≥ 98 %" };
        writeln!(
            t,
            "| {what}, each at twice its figure or more: named | {} | {target} |",
            share(named, faults().count())
        )?;
        let right = |(_, verdict): &(&Case, &Verdict)| {
            verdict.fates.iter().all(|fate| fate.is_named()) && verdict.strangers.is_empty()
        };
        let logs = fates(least, most).count();
        writeln!(
            t,
            "| {what}: logs with all of them named and nothing else | {} | |",
            share(fates(least, most).filter(right).count(), logs)
        )?;
    }

    let conventions: Vec<bool> =
        judged(outcomes).flat_map(|(_, verdict)| verdict.convention.iter().copied()).collect();
    let right = conventions.iter().filter(|&&right| right).count();
    writeln!(
        t,
        "| convention right where the motion dwells | {} | 100 % |",
        share(right, conventions.len())
    )?;

    for (noise, latency, zero) in
        [("white", "≤ 20 µs", "≤ 0.001°"), ("coloured", "≤ 0.2 ms", "≤ 0.01°")]
    {
        let errors = |code: &'static str| {
            let cases = judged(outcomes)
                .filter(move |(case, _)| case.noise == noise && case.at_125_hz() && case.excited);
            cases.flat_map(|(_, verdict)| &verdict.intervals).filter(move |one| one.code == code)
        };
        let absolute = |code| median(errors(code).map(|one| one.error.abs()).collect());
        let shown = |value: Option<f64>, show: &dyn Fn(f64) -> String| {
            value.map_or_else(|| "no such log".to_owned(), show)
        };
        writeln!(
            t,
            "| median latency error at 125 Hz, {noise} noise | {} | {latency} |",
            shown(absolute("LAT001"), &|s| format!("{:.1} µs", s * 1e6))
        )?;
        writeln!(
            t,
            "| median joint zero error at 125 Hz, {noise} noise | {} | {zero} |",
            shown(absolute("ZER001"), &|rad| format!("{:.5}°", rad / DEGREE))
        )?;
        let drifting = errors("YAW001").filter(|one| one.truth != 0.0);
        let relative = median(drifting.map(|one| (one.error / one.truth).abs()).collect());
        writeln!(
            t,
            "| median drift rate error at 125 Hz, {noise} noise | {} | ≤ 1 % |",
            shown(relative, &|share| format!("{:.2} %", 100.0 * share))
        )?;
    }

    let covered = |norms: bool| {
        let all: Vec<&Interval> = judged(outcomes)
            .flat_map(|(_, verdict)| &verdict.intervals)
            .filter(|one| one.is_norm == norms)
            .collect();
        share(all.iter().filter(|one| one.covers).count(), all.len())
    };
    writeln!(t, "| coverage of the 95 % intervals of amounts | {} | 92–98 % |", covered(false))?;
    writeln!(t, "| coverage of the 95 % intervals of norms | {} | 92–98 % |", covered(true))
}

/// Each rule's detection rate by amount.
fn detection(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    writeln!(
        t,
        "\n## Detection by amount, in units of the first figure\n\n\
         The share that is named of those planted, one fault or more in the log. Motions of less than 0.2 rad \
         stand apart. What is not named is undecided (`?`) or passed (`!`).\n"
    )?;
    let slip = f64::INFINITY;
    let columns: Vec<f64> = TIMES.into_iter().chain([slip]).collect();
    write!(t, "| rule |")?;
    for times in &columns {
        if *times == slip { write!(t, " slip |")? } else { write!(t, " ×{times} |")? }
    }
    writeln!(t, "\n|---|{}", "---|".repeat(columns.len()))?;
    let mut codes: Vec<(&str, bool)> = judged(outcomes)
        .flat_map(|(case, _)| case.planted.iter().map(|planted| (planted.code, !case.excited)))
        .collect();
    codes.sort_unstable();
    codes.dedup();
    for (code, small) in codes {
        write!(t, "| {code}{} |", if small { ", small motion" } else { "" })?;
        for &times in &columns {
            let fates: Vec<Fate> = judged(outcomes)
                .filter(|(case, _)| case.excited != small)
                .flat_map(|(case, verdict)| case.planted.iter().zip(&verdict.fates))
                .filter(|(planted, _)| planted.code == code && planted.times == times)
                .map(|(_, fate)| *fate)
                .collect();
            let named = fates.iter().filter(|fate| fate.is_named()).count();
            let undecided = fates.iter().filter(|&&fate| fate == Fate::Undecided).count();
            let passed = fates.len() - named - undecided;
            if fates.is_empty() {
                write!(t, " |")?;
                continue;
            }
            write!(t, " {:.0} % of {}", percent(named, fates.len()), fates.len())?;
            if undecided > 0 {
                write!(t, " {undecided}?")?;
            }
            if passed > 0 {
                write!(t, " {passed}!")?;
            }
            write!(t, " |")?;
        }
        writeln!(t)?;
    }
    Ok(())
}

/// Findings that nothing planted, by rule.
fn strangers(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let clean = judged(outcomes).filter(|(case, _)| case.planted.is_empty()).count();
    let faulty = judged(outcomes).count() - clean;
    writeln!(
        t,
        "\n## Findings that nothing planted, in 1000 logs\n\n\
         | rule | clean ({clean}) | faulty ({faulty}) |\n|---|---|---|"
    )?;
    let mut logs: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for (case, verdict) in judged(outcomes) {
        let mut codes: Vec<&str> =
            verdict.strangers.iter().chain(&verdict.other).copied().collect();
        codes.sort_unstable();
        codes.dedup();
        for code in codes {
            logs.entry(code).or_default()[usize::from(!case.planted.is_empty())] += 1;
        }
    }
    for (code, [alarms, misattributions]) in logs {
        writeln!(
            t,
            "| {code} | {:.1} | {:.1} |",
            10.0 * percent(alarms, clean),
            10.0 * percent(misattributions, faulty)
        )?;
    }
    Ok(())
}

/// Coverage and errors by rule; where all is wanted, by noise, motion, velocities and topic too.
fn intervals(t: &mut String, outcomes: &Outcomes, verbose: bool) -> fmt::Result {
    writeln!(
        t,
        "\n## Intervals at 95 %\n\nFaults that are not planted, and those at twice the figure or more; \
         SI units.\n\n\
         | rule | fault | estimates | covered | bias | median error |\n|---|---|---|---|---|---|"
    )?;
    let mut rows: BTreeMap<(String, &str), Vec<&Interval>> = BTreeMap::new();
    for (case, verdict) in judged(outcomes) {
        for one in &verdict.intervals {
            let planted = if one.planted { "planted" } else { "none" };
            rows.entry((one.code.clone(), planted)).or_default().push(one);
            if verbose {
                let velocity = case.scenario.joints.with_velocity;
                let velocity = if velocity { "with" } else { "without" };
                for detail in [
                    format!("{}, {} noise", one.code, case.noise),
                    format!("{}, {} motion", one.code, case.motion),
                    format!("{}, {velocity} velocities", one.code),
                    format!("{}, {}", one.code, one.topic),
                ] {
                    rows.entry((detail, planted)).or_default().push(one);
                }
            }
        }
    }
    for ((row, planted), of) in rows {
        let covered = of.iter().filter(|one| one.covers).count();
        let bias = of.iter().map(|one| one.error).sum::<f64>() / of.len() as f64;
        let error = median(of.iter().map(|one| one.error.abs()).collect()).unwrap_or_default();
        writeln!(
            t,
            "| {row} | {planted} | {} | {:.1} % | {bias:+.1e} | {error:.1e} |",
            of.len(),
            percent(covered, of.len())
        )?;
    }
    Ok(())
}

/// Every outcome that is not as it should be, with what makes its log again.
fn wrongs(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let mut groups: BTreeMap<&str, Vec<(&Case, &str)>> = BTreeMap::new();
    for (case, outcome) in outcomes {
        match outcome {
            Ok(verdict) => {
                for (kind, what) in &verdict.wrongs {
                    groups.entry(kind).or_default().push((case, what));
                }
            }
            Err(trouble) => groups.entry("trouble").or_default().push((case, trouble)),
        }
    }
    writeln!(t, "\n## Wrong outcomes")?;
    for (kind, cases) in groups {
        writeln!(t, "\n### {kind}: {}\n", cases.len())?;
        for (case, what) in cases {
            writeln!(t, "- {case}\n  {what}")?;
        }
    }
    Ok(())
}

fn share(part: usize, whole: usize) -> String {
    match whole {
        0 => "no such log".to_owned(),
        _ => format!("{:.1} % ({part} of {whole})", percent(part, whole)),
    }
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
