//! A calibration: what logs tell of an arm's links.

use std::path::{Path, PathBuf};

use super::Options;
use super::tables::table;
use crate::checks::{Still, gains_nothing, refusal, still};
use crate::diagnosis::{
    ArmCalibration, CalibrationStream, NoCalibration, PoseDiagnosis, Reading, calibrate_arm,
};
use crate::evidence::{ArmEvidence, Lost, PoseEvidence, RunEvidence};
use crate::geometry::Pose;
use crate::log;
use crate::places::Places;
use crate::report::{PlanOf, Trouble, TroubleKind, plan_around};
use crate::robot::Robot;
use crate::run::{Arm, PoseSource, Run, Witness, robot_of};
use crate::stream::JointTrack;

/// Frames that are off by more than this are no link's deviation, m and rad.
const MOST_M: f64 = 10e-3;
const MOST_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// A stream of one of the logs, as the calibration takes it.
#[derive(Clone, Debug)]
pub struct Taken {
    /// The file.
    pub log: PathBuf,
    /// The topic, or what stands for it.
    pub topic: String,
    /// Whose word the poses are.
    pub witness: Witness,
    /// How the rotations are read, where that is not as the log says.
    pub reading: Option<String>,
    /// The link that poses are in, where that is known.
    pub base: String,
    /// The link whose poses they are.
    pub tip: String,
    pub(super) joints: JointTrack,
    pub(super) columns: Vec<usize>,
    pub(super) t_s: Vec<f64>,
    pub(super) poses: Vec<Pose>,
    pub(super) rotation_is_blind: bool,
    pub(super) latency_s: Option<f64>,
    pub(super) skew: f64,
    pub(super) reference: Pose,
    pub(super) reference_is_free: bool,
    pub(super) tool: Pose,
    pub(super) tool_is_free: bool,
    /// The joints whose zero stands out, by name.
    pub(super) zeros: Vec<String>,
}

/// What logs tell of an arm's links.
#[derive(Debug)]
pub struct Calibrated {
    /// The arm as its drawing has it.
    pub drawing: Robot,
    /// The names of the joints of the chain.
    pub joints: Vec<String>,
    /// The streams that it rests on, in the order of [`ArmCalibration::streams`].
    pub streams: Vec<Taken>,
    /// What was left out, and why.
    pub left_out: Vec<String>,
    /// What was found.
    pub found: ArmCalibration,
    /// The joints that moved little.
    pub still: Vec<Still>,
    /// The call that writes a motion which would tell more.
    pub plan: Option<String>,
    /// Why no file is written, where the logs do not carry one.
    pub refused: Option<String>,
    /// What was read.
    pub(crate) read: Places,
}

impl Taken {
    /// Whether its rotations say nothing.
    pub fn rotation_is_blind(&self) -> bool {
        self.rotation_is_blind
    }
}

impl Calibrated {
    /// Whether the poses are the word of the arm's own controller, so that it is the controller's
    /// kinematics that were found, and not where the arm is.
    pub fn witness(&self) -> Witness {
        let of = |witness| self.streams.iter().all(|stream| stream.witness == witness);
        match (of(Witness::External), of(Witness::Controller)) {
            (true, _) => Witness::External,
            (_, true) => Witness::Controller,
            _ => Witness::Unknown,
        }
    }
}

pub(super) fn trouble(place: &Path, what: impl Into<String>, remedy: &str) -> Trouble {
    let place = place.display().to_string();
    Trouble { kind: TroubleKind::Log, what: what.into(), place, remedy: remedy.to_owned() }
}

/// Calibrates the arm of `options.logs`, each a run of its own, and writes nothing. With `topic` by the
/// poses on it alone.
///
/// # Errors
/// Where a log cannot be read, or holds no arm, model or poses to calibrate by.
pub fn calibrate(options: &Options, topic: Option<&str>) -> Result<Calibrated, Trouble> {
    options.places().check()?;
    let (mut streams, mut left_out, mut arm) = (Vec::new(), Vec::new(), None);
    for path in &options.logs {
        let found = match table(path)? {
            Some(table) => table.taken(path, &options.run),
            None => of_log(path, options, topic),
        };
        let (robot, taken, others) = match found {
            Ok(found) => found,
            // Of several logs those that can be used are.
            Err(trouble) if options.logs.len() > 1 && trouble.kind == TroubleKind::Log => {
                left_out.push(format!("{}: {}", path.display(), trouble.what));
                continue;
            }
            Err(trouble) => return Err(trouble),
        };
        left_out.extend(others);
        match &arm {
            None => arm = Some(robot),
            Some(first) if is_same_arm(first, &robot) => {}
            Some(first) => {
                let what =
                    format!("its arm is {}, that of the first log {}", robot.name, first.name);
                return Err(trouble(path, what, "give logs of one arm, with one --robot"));
            }
        }
        streams.extend(taken);
    }
    let place = options.logs.first().map(PathBuf::as_path).unwrap_or(Path::new("LOG"));
    let Some(drawing) = arm.filter(|_| !streams.is_empty()) else {
        let what = match left_out.first() {
            Some(why) => format!("no stream of poses to calibrate by: {why}"),
            None => "no stream of poses to calibrate by".to_owned(),
        };
        return Err(trouble(place, what, "see what `poseaudit audit` says of it"));
    };
    // An outside witness sees the arm; the controller only knows what it was told.
    if streams.iter().any(|stream: &Taken| stream.witness == Witness::External) {
        let (outside, others): (Vec<Taken>, Vec<Taken>) =
            streams.into_iter().partition(|stream| stream.witness == Witness::External);
        left_out.extend(others.iter().map(|other| {
            format!(
                "{}: an outside witness sees the arm itself; --topic takes this one",
                other.topic
            )
        }));
        streams = outside;
    }
    let (joints, found) = fitted_to_most(&drawing, &mut streams, &mut left_out).map_err(|why| {
        let (what, remedy) = words(why);
        trouble(place, what, remedy)
    })?;
    let still = still(&drawing, &joints, &found);
    let refused = refusal(&found, &still);
    let read = options.places();
    let plan = streams.first().and_then(|stream| plan(options, &drawing, stream));
    Ok(Calibrated { drawing, joints, streams, left_out, found, still, plan, refused, read })
}

/// The call of `plan` for a motion around where the arm of `stream` worked.
fn plan(options: &Options, drawing: &Robot, stream: &Taken) -> Option<String> {
    let [base, tip] = [&stream.base, &stream.tip].map(|name| drawing.link(name));
    let chain = drawing.chain(base?, tip?).ok()?;
    let given = options.run.robots.first().map(|given| given.model.clone());
    let name = given.or_else(|| drawing.text().is_none().then(|| drawing.name.clone()));
    let call = plan_around(&PlanOf {
        robot: drawing,
        chain: &chain,
        joints: &stream.joints,
        columns: &stream.columns,
        model: name.and_then(|name| Some((name.clone(), robot_of(&name).ok()?))),
        log: &stream.log,
        in_log: String::new(),
    })?;
    let outside = if stream.witness == Witness::External { " --outside" } else { "" };
    Some(format!("{call} --for calibration{outside}"))
}

/// Whether two models are of one arm: the same joints with the same origins.
fn is_same_arm(a: &Robot, b: &Robot) -> bool {
    let origins = |robot: &Robot| -> Vec<(String, Pose)> {
        robot.joints().iter().map(|joint| (joint.name.clone(), joint.parent_from_joint)).collect()
    };
    origins(a) == origins(b)
}

fn words(why: NoCalibration) -> (&'static str, &'static str) {
    match why {
        NoCalibration::Chain => (
            "its chain leads over a joint from child to parent, or over one that mimics another",
            "name a --base and a --tip with the arm's own joints between them",
        ),
        NoCalibration::OtherJoints => {
            ("its streams are of chains with different joints", "choose one with --topic")
        }
        NoCalibration::TooFewSamples => (
            "too few poses have joint states at their stamps",
            "give a log with joint states and poses at the same time",
        ),
        NoCalibration::Diverges => {
            ("the links' deviations do not settle", "see what `poseaudit audit` says of the log")
        }
    }
}

/// Fits the arm's links to the streams. A minority of streams that gain nothing by it is left out, with the
/// reason: it may be of another state of the arm. If most gain nothing, all are kept, and the result is
/// refused.
fn fitted_to_most(
    robot: &Robot,
    streams: &mut Vec<Taken>,
    left_out: &mut Vec<String>,
) -> Result<(Vec<String>, ArmCalibration), NoCalibration> {
    let given = streams.len();
    loop {
        let (joints, found) = fitted(robot, streams)?;
        let useless: Vec<Option<String>> = found.streams.iter().map(gains_nothing).collect();
        let kept = useless.iter().filter(|why| why.is_none()).count();
        if kept == streams.len() || 2 * kept <= given {
            return Ok((joints, found));
        }
        let mut why_not = useless.into_iter();
        streams.retain(|stream| match why_not.next().flatten() {
            Some(why) => {
                left_out.push(format!("{} {}: {why}", stream.log.display(), stream.topic));
                false
            }
            None => true,
        });
    }
}

fn fitted(
    robot: &Robot,
    streams: &[Taken],
) -> Result<(Vec<String>, ArmCalibration), NoCalibration> {
    let link = |name: &str| robot.link(name).ok_or(NoCalibration::Chain);
    let mut given = Vec::with_capacity(streams.len());
    for stream in streams {
        given.push(CalibrationStream {
            joints: &stream.joints,
            columns: stream.columns.clone(),
            base: link(&stream.base)?,
            tip: link(&stream.tip)?,
            t_s: stream.t_s.clone(),
            poses: stream.poses.clone(),
            blind: [false; 3],
            rotation_is_blind: stream.rotation_is_blind,
            latency_s: stream.latency_s.unwrap_or(0.0),
            latency_is_free: stream.latency_s.is_some(),
            skew: stream.skew,
            reference: stream.reference,
            reference_is_free: stream.reference_is_free,
            tool: stream.tool,
            tool_is_free: stream.tool_is_free,
        });
    }
    let first = given.first().ok_or(NoCalibration::TooFewSamples)?;
    let chain = robot.chain(first.base, first.tip).map_err(|_| NoCalibration::Chain)?;
    let joints = chain.joint_names().to_vec();
    let is_off = |joint: &String| streams.iter().any(|stream| stream.zeros.contains(joint));
    let zeros: Vec<usize> = (0..joints.len()).filter(|&at| is_off(&joints[at])).collect();
    let found = calibrate_arm(robot, &given, &zeros)?;
    Ok((joints, found))
}

pub(super) type FromLog = (Robot, Vec<Taken>, Vec<String>);

/// The arm of a log, the streams of its poses, and what is left out.
fn of_log(path: &Path, options: &Options, topic: Option<&str>) -> Result<FromLog, Trouble> {
    let log = log::open(&[path.to_path_buf()], &options.read)?;
    let mut run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()))?;
    let evidence = RunEvidence::of(&mut run, &Lost::default(), &options.run);
    if let Some(error) = &run.no_arm {
        return Err(error.into());
    }
    let (mut found, mut left_out) = (Vec::new(), Vec::new());
    for (arm, of) in run.arms.iter().zip(&evidence.robots) {
        let mut streams = Vec::new();
        for (source, stream) in arm.poses.iter().zip(&of.poses) {
            if topic.is_some_and(|topic| topic != stream.topic()) {
                continue;
            }
            match taken(path, arm, of, source, stream.topic(), &stream.found) {
                Ok(taken) => streams.push(taken),
                Err(why) => left_out.push(format!("{}: {why}", stream.topic())),
            }
        }
        if !streams.is_empty() {
            found.push((arm.robot.clone(), streams));
        }
    }
    match found.len() {
        0 => {
            let what = match left_out.first() {
                Some(why) => format!("no stream of poses to calibrate by: {why}"),
                None => "no stream of poses to calibrate by".to_owned(),
            };
            Err(trouble(
                path,
                what,
                "see what `poseaudit audit` says of it, or name one with --topic",
            ))
        }
        1 => {
            let (robot, streams) = found.swap_remove(0);
            Ok((robot, streams, left_out))
        }
        arms => {
            Err(trouble(path, format!("poses of {arms} arms are in it"), "choose one with --topic"))
        }
    }
}

/// A stream as it is calibrated by, or why it is not.
fn taken(
    path: &Path,
    arm: &Arm,
    of: &ArmEvidence,
    source: &PoseSource,
    topic: &str,
    found: &PoseEvidence,
) -> Result<Taken, String> {
    let diagnosis = &found.diagnosis;
    if of.diagnosis.reading.is_err() {
        return Err("the joint states cannot be read so that they fit the poses".to_owned());
    }
    if diagnosis.residual.is_err() || diagnosis.strays() {
        return Err("it does not follow the arm".to_owned());
    }
    if diagnosis.changes() {
        return Err("something of it changes in mid-run; cut the log there".to_owned());
    }
    if let Some(part) = diagnosis.constant.first() {
        return Err(format!("its {} never changes", part.coordinate));
    }
    if let Some(growth) = diagnosis.growth.as_ref().ok().filter(|_| diagnosis.growth_chosen) {
        return Err(format!(
            "its positions grow with reach by {:.2} mm/m, which no log tells from longer links; mend that first",
            1e3 * growth.value
        ));
    }
    if source.carrier.is_some() {
        return Err("it is in a frame that moves".to_owned());
    }
    let mut unzeroed = of.diagnosis.clone();
    let mut zeros = Vec::new();
    for (column, offset) in unzeroed.offsets.iter_mut().enumerate() {
        if std::mem::take(&mut offset.chosen) {
            zeros.push(arm.joint_names[column].clone());
        }
    }
    let is_small = |frame: &Pose| {
        frame.translation.vector.norm() <= MOST_M && frame.rotation.angle() <= MOST_RAD
    };
    let is_outside = found.witness == Witness::External;
    let frames = &diagnosis.taken;
    let reference_is_free = !source.reference_known || !is_small(&frames.reference);
    let tool_is_free = (is_outside && !source.tip_named) || !is_small(&frames.tool);
    let kept = |frame: Pose, is_free: bool| if is_free { frame } else { Pose::identity() };
    Ok(Taken {
        log: path.to_path_buf(),
        topic: topic.to_owned(),
        witness: found.witness,
        reading: reading(diagnosis),
        base: source.chain.base_name().to_owned(),
        tip: source.chain.tip_name().to_owned(),
        joints: unzeroed.corrected_joints(&arm.joints, &arm.slides()),
        columns: source.columns.clone(),
        t_s: diagnosis.aligned.t_s.clone(),
        poses: diagnosis.aligned.corrected.iter().map(|pose| frames.back(pose)).collect(),
        rotation_is_blind: diagnosis.reading.is_err(),
        latency_s: diagnosis.latency_s.as_ref().ok().map(|latency| latency.value),
        skew: diagnosis
            .skew
            .as_ref()
            .ok()
            .filter(|_| diagnosis.skew_chosen)
            .map_or(0.0, |skew| skew.value),
        reference: kept(frames.reference, reference_is_free),
        reference_is_free,
        tool: kept(frames.tool, tool_is_free),
        tool_is_free,
        zeros,
    })
}

/// How rotations are read, where that is not as the log says.
pub(super) fn reading(found: &PoseDiagnosis) -> Option<String> {
    let reading = match found.reading.as_ref().ok()?.best {
        Reading::AsLogged => return None,
        Reading::Misread(class) => {
            let misreading = class.members.first()?;
            format!("{} read as {}", misreading.is, misreading.read_as)
        }
        Reading::QuaternionOrder(_) => "components of the quaternion in another order".to_owned(),
        Reading::Transposed => "transposed".to_owned(),
        Reading::Inverted => "inverted".to_owned(),
        Reading::Numbers(convention) => convention.to_string(),
    };
    let unit = if found.degrees.is_some() { ", in degrees" } else { "" };
    Some(format!("{reading}{unit}"))
}
