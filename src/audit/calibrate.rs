//! Calibration of an arm's links from logs.

use std::path::{Path, PathBuf};

use super::Options;
use super::calibration_input::{CalibrationInput, LogInputs, Measurement, trouble};
use super::competing_arm::{CalibrationPositions, CompetingArm};
use super::fixed_point::{
    self, distances, has_moved, held_out_group, moved_text, outlier_rows, typical_residual_m,
};
use super::tables::{read_points, read_table, read_tables, read_trouble};
use crate::checks::{
    MAX_DEVIATION_M, UnmovedJoint, equals_nominal, implausible_links, rejection_reason,
    stream_rejection_reason, unmoved_joints,
};
use crate::diagnosis::{
    ArmCalibration, CalibrationFailure, CalibrationStream, FrameFreedom, PointDistance,
    StreamCalibration, calibrate_arm,
};
use crate::evidence::{ArmEvidence, PoseEvidence, ReadLosses, RunEvidence};
use crate::geometry::Pose;
use crate::log;
use crate::places::PathRegistry;
use crate::report::{PlanInputs, Trouble, TroubleKind, plan_command};
use crate::robot::Robot;
use crate::run::{Arm, MIN_RESIDUAL_RATIO, PoseSource, PoseSourceKind, Run, load_robot};
use crate::stream::{Orientations, PoseTrack};

/// Larger turns of frames are not link deviations, rad.
const MAX_DEVIATION_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Result of a calibration.
#[derive(Debug)]
pub struct CalibrationResult {
    /// Nominal model.
    pub nominal: Robot,
    /// Joint names of the chain.
    pub joints: Vec<String>,
    /// In the order of [`ArmCalibration::streams`].
    pub streams: Vec<CalibrationInput>,
    /// Data left out, with the reasons.
    pub left_out: Vec<String>,
    /// Estimated calibration.
    pub calibration: ArmCalibration,
    /// Known distances of the points, in the order of [`ArmCalibration::distances_m`].
    pub distances: Vec<PointDistance>,
    /// Joints that moved too little.
    pub unmoved: Vec<UnmovedJoint>,
    /// Command that plans a more informative motion.
    pub plan: Option<String>,
    /// Why no file is written; `None` if the calibration is accepted.
    pub rejection: Option<String>,
    /// The arm equals its nominal model within the uncertainty.
    pub equals_nominal: bool,
    pub(crate) read: PathRegistry,
}

impl CalibrationResult {
    /// The controller only yields its own kinematics, not the arm's.
    pub fn source_kind(&self) -> PoseSourceKind {
        let of = |source_kind| self.streams.iter().all(|stream| stream.source_kind == source_kind);
        match (of(PoseSourceKind::External), of(PoseSourceKind::Controller)) {
            (true, _) => PoseSourceKind::External,
            (_, true) => PoseSourceKind::Controller,
            _ => PoseSourceKind::Unknown,
        }
    }
}

/// Calibrates the arm of `options.logs`, each a separate run, without writing files. `topic` restricts the
/// poses.
///
/// # Errors
/// If a log cannot be read, or has no arm, model or poses to calibrate with.
pub fn calibrate(options: &Options, topic: Option<&str>) -> Result<CalibrationResult, Trouble> {
    let paths: Vec<&Path> = options.logs.iter().map(PathBuf::as_path).collect();
    let table = match paths.as_slice() {
        [] | [_] => None,
        &[one, other] => read_tables([one, other], options)?,
        several => read_points(several, options)?,
    };
    if let Some(table) = table {
        let one_run = Options { logs: options.logs[..1].to_vec(), ..options.clone() };
        return calibrate_inputs(&one_run, |path| table.input(path, &options.run), None);
    }
    let read = |path: &Path| match read_table(path, options)? {
        Some(table) => table.input(path, &options.run),
        None => inputs_from_log(path, options, topic),
    };
    calibrate_inputs(options, read, None)
}

/// Same with `options.logs` as tables of configurations, or logs of an arm that rests in them. One point of the
/// tool stays at an unknown place in each. The points of the two files in a folder have the distance `distance_m`.
///
/// # Errors
/// If no file can be used, or no folder has two for the distance.
pub fn calibrate_at_fixed_points(
    options: &Options,
    distance_m: Option<f64>,
) -> Result<CalibrationResult, Trouble> {
    calibrate_inputs(options, |path| fixed_point::input(path, options), distance_m)
}

fn calibrate_inputs(
    options: &Options,
    read: impl Fn(&Path) -> Result<LogInputs, Trouble>,
    distance_m: Option<f64>,
) -> Result<CalibrationResult, Trouble> {
    options.places().check()?;
    let (mut streams, mut left_out, mut arm) = (Vec::new(), Vec::new(), None);
    for path in &options.logs {
        let (robot, input, others) = match read(path) {
            Ok(found) => found,
            // Several logs: skip unusable ones.
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
                let what = format!(
                    "its arm is {}, but that of the first log is {}",
                    robot.name, first.name
                );
                return Err(trouble(path, what, "use logs of one arm, with one --robot"));
            }
        }
        streams.extend(input);
    }
    let place = options.logs.first().map(PathBuf::as_path).unwrap_or(Path::new("LOG"));
    let Some(nominal) = arm.filter(|_| !streams.is_empty()) else {
        let what = match left_out.first() {
            Some(why) => format!("no pose stream to calibrate with: {why}"),
            None => "no pose stream to calibrate with".to_owned(),
        };
        return Err(trouble(place, what, "run `poseaudit audit` on it for the reason"));
    };
    // Only external trackers observe the arm itself.
    if streams
        .iter()
        .any(|stream: &CalibrationInput| stream.source_kind == PoseSourceKind::External)
    {
        let (external, others): (Vec<CalibrationInput>, Vec<CalibrationInput>) =
            streams.into_iter().partition(|stream| stream.source_kind == PoseSourceKind::External);
        left_out.extend(others.iter().map(|other| {
            format!(
                "{}: an external measurement of the arm is preferred; use --topic to select this one",
                other.topic
            )
        }));
        streams = external;
    }
    let (joints, calibration) =
        calibrate_consistent(&nominal, &mut streams, distance_m, &mut left_out).map_err(|why| {
            let (what, remedy) = failure_text(why);
            trouble(place, what, remedy)
        })?;
    let distances = distances(&streams, distance_m);
    if distance_m.is_some() && distances.is_empty() {
        let what = "no folder has exactly two files of fixed points";
        let remedy = "put the two files of a tool into one folder, or omit --distance";
        return Err(Trouble::call("--distance", what, remedy));
    }
    left_out.extend(streams.iter().zip(&calibration.streams).filter_map(|(stream, found)| {
        let rows = (stream.measurement == Measurement::FixedPoint)
            .then(|| outlier_rows(&found.errors_m))
            .flatten()?;
        Some(format!("{}: {rows}", stream.log.display()))
    }));
    let unmoved = unmoved_joints(&nominal, &joints, &calibration);
    let typical_m = typical_residual_m(&calibration);
    let mut moved = streams.iter().zip(&calibration.streams);
    let moved = moved.find(|(stream, found)| has_moved(stream, found, typical_m, &calibration));
    let moved_point = moved.and_then(|(stream, _)| moved_text(stream, &calibration));
    let rejection = moved_point
        .or_else(|| wrong_arm(&nominal, &streams, &calibration, options.run.max_latency_s))
        .or_else(|| rejection_reason(&calibration, &unmoved));
    let equals_nominal = equals_nominal(&calibration);
    let read = options.places();
    // A planned motion has no fixed point.
    let measured = streams.first().filter(|one| one.measurement != Measurement::FixedPoint);
    let plan = measured.and_then(|stream| calibration_plan_command(options, &nominal, stream));
    Ok(CalibrationResult {
        nominal,
        joints,
        streams,
        left_out,
        calibration,
        distances,
        unmoved,
        plan,
        rejection,
        equals_nominal,
        read,
    })
}

/// Why the poses are of another arm than `nominal`: its links are implausible, or a catalogue arm fits far better.
fn wrong_arm(
    nominal: &Robot,
    streams: &[CalibrationInput],
    calibration: &ArmCalibration,
    max_latency_s: f64,
) -> Option<String> {
    let implausible = implausible_links(calibration);
    // No links fit better than the calibrated ones.
    let is_suspect = |found: &StreamCalibration| {
        implausible.is_some() || found.before.m > MIN_RESIDUAL_RATIO * found.after.m
    };
    let suspects = streams.iter().zip(&calibration.streams);
    let mut suspects = suspects.filter(|(_, found)| is_suspect(found)).map(|(stream, _)| stream);
    let other = suspects.find_map(|stream| competing_arm(nominal, stream, max_latency_s));
    match (implausible, other) {
        (Some(why), Some(other)) => {
            Some(format!("{why}; {}; {}", other.describe(&nominal.name), other.remedy()))
        }
        (Some(why), None) => {
            Some(format!("{why}; check that --robot is the arm's model, and its joint zeros"))
        }
        (None, other) => {
            other.map(|other| format!("{}; {}", other.describe(&nominal.name), other.remedy()))
        }
    }
}

/// Estimated from the positions of `stream`; a fixed point has none.
fn competing_arm(
    nominal: &Robot,
    stream: &CalibrationInput,
    max_latency_s: f64,
) -> Option<CompetingArm> {
    let [base, tip] = [&stream.base, &stream.tip].map(|name| nominal.link(name));
    let chain = nominal.chain(base?, tip?).ok()?;
    let track = PoseTrack {
        t_s: stream.t_s.clone(),
        xyz: stream.poses.iter().map(|pose| pose.translation.vector).collect(),
        orientation: Orientations::Unset(stream.poses.len()),
        declared: None,
    };
    let positions = CalibrationPositions {
        joints: &stream.joints,
        columns: &stream.columns,
        track: &track,
        max_lag_s: stream.latency_s.map_or(0.0, |_| max_latency_s),
    };
    let is_measured = stream.measurement != Measurement::FixedPoint;
    is_measured.then(|| positions.competing_arm(&nominal.name, &chain)).flatten()
}

/// Plan around the configurations of `stream`.
fn calibration_plan_command(
    options: &Options,
    nominal: &Robot,
    stream: &CalibrationInput,
) -> Option<String> {
    let [base, tip] = [&stream.base, &stream.tip].map(|name| nominal.link(name));
    let chain = nominal.chain(base?, tip?).ok()?;
    let given = options.run.robots.first().map(|given| given.model.clone());
    let name = given.or_else(|| nominal.text().is_none().then(|| nominal.name.clone()));
    let call = plan_command(&PlanInputs {
        robot: nominal,
        chain: &chain,
        joints: &stream.joints,
        columns: &stream.columns,
        model: name.and_then(|name| Some((name.clone(), load_robot(&name).ok()?))),
        log: &stream.log,
        log_options: String::new(),
    })?;
    let external = if stream.source_kind == PoseSourceKind::External { " --outside" } else { "" };
    Some(format!("{call} --for calibration{external}"))
}

fn is_same_arm(a: &Robot, b: &Robot) -> bool {
    let origins = |robot: &Robot| -> Vec<(String, Pose)> {
        robot.joints().iter().map(|joint| (joint.name.clone(), joint.parent_from_joint)).collect()
    };
    origins(a) == origins(b)
}

fn failure_text(why: CalibrationFailure) -> (&'static str, &'static str) {
    match why {
        CalibrationFailure::Chain => (
            "its chain contains a joint from child to parent, or a mimic joint",
            "choose --base and --tip with only the arm's own joints between them",
        ),
        CalibrationFailure::OtherJoints => {
            ("its streams belong to chains with different joints", "choose one with --topic")
        }
        CalibrationFailure::TooFewSamples => (
            "too few poses have joint states at their stamps",
            "use a log with joint states and poses at the same time",
        ),
        CalibrationFailure::Diverges => (
            "the estimation of the link deviations does not converge",
            "run `poseaudit audit` on the log for the reason",
        ),
    }
}

/// Drops a minority of streams that the calibration does not improve: the arm may have been in a different
/// state. If it does not improve most streams, keeps all and rejects the result.
fn calibrate_consistent(
    robot: &Robot,
    streams: &mut Vec<CalibrationInput>,
    distance_m: Option<f64>,
    left_out: &mut Vec<String>,
) -> Result<(Vec<String>, ArmCalibration), CalibrationFailure> {
    let given = streams.len();
    let mut dropped: Vec<(CalibrationInput, Option<String>)> = Vec::new();
    loop {
        let (joints, found) = calibrate_streams(robot, streams, distance_m)?;
        let typical_m = typical_residual_m(&found);
        // A moved point is described by the final calibration.
        let why_useless = |(stream, one): (&CalibrationInput, &StreamCalibration)| match has_moved(
            stream, one, typical_m, &found,
        ) {
            true => Some(None),
            false => stream_rejection_reason(one).map(Some),
        };
        let useless: Vec<Option<Option<String>>> =
            streams.iter().zip(&found.streams).map(why_useless).collect();
        let kept = useless.iter().filter(|why| why.is_none()).count();
        if kept == streams.len() || 2 * kept <= given {
            left_out.extend(dropped.into_iter().map(|(stream, why)| {
                let topic = match stream.measurement {
                    Measurement::FixedPoint => String::new(),
                    Measurement::Pose | Measurement::Point => format!(" {}", stream.topic),
                };
                let why = why.or_else(|| moved_text(&stream, &found)).unwrap_or_default();
                format!("{}{topic}: {why}", stream.log.display())
            }));
            return Ok((joints, found));
        }
        let all = std::mem::take(streams);
        for (stream, why) in all.into_iter().zip(useless) {
            match why {
                Some(why) => dropped.push((stream, why)),
                None => streams.push(stream),
            }
        }
    }
}

fn calibrate_streams(
    robot: &Robot,
    streams: &[CalibrationInput],
    distance_m: Option<f64>,
) -> Result<(Vec<String>, ArmCalibration), CalibrationFailure> {
    let link = |name: &str| robot.link(name).ok_or(CalibrationFailure::Chain);
    let mut given = Vec::with_capacity(streams.len());
    for (s, stream) in streams.iter().enumerate() {
        let same_log = streams.iter().position(|other| other.log == stream.log).unwrap_or(s);
        let (reference, tool) = match stream.measurement {
            Measurement::Pose => (FrameFreedom::Pose(s), FrameFreedom::Pose(s)),
            Measurement::Point if stream.is_rotation_excluded => {
                (FrameFreedom::Pose(same_log), FrameFreedom::Position(s))
            }
            Measurement::Point => (FrameFreedom::Pose(same_log), FrameFreedom::Pose(s)),
            // One tool in all files.
            Measurement::FixedPoint => (FrameFreedom::Position(s), FrameFreedom::Position(0)),
        };
        let freedom = |is_free: bool, frame| if is_free { frame } else { FrameFreedom::Known };
        given.push(CalibrationStream {
            joints: &stream.joints,
            columns: stream.columns.clone(),
            base: link(&stream.base)?,
            tip: link(&stream.tip)?,
            t_s: stream.t_s.clone(),
            poses: stream.poses.clone(),
            excluded: [false; 3],
            is_rotation_excluded: stream.is_rotation_excluded,
            latency_s: stream.latency_s.unwrap_or(0.0),
            latency_is_free: stream.latency_s.is_some(),
            skew: stream.skew,
            reference: stream.reference,
            reference_freedom: freedom(stream.is_reference_free, reference),
            tool: stream.tool,
            tool_freedom: freedom(stream.is_tool_free, tool),
            held_out_group: held_out_group(streams, s),
        });
    }
    let first = given.first().ok_or(CalibrationFailure::TooFewSamples)?;
    let chain = robot.chain(first.base, first.tip).map_err(|_| CalibrationFailure::Chain)?;
    let joints = chain.joint_names().to_vec();
    let is_off = |joint: &String| streams.iter().any(|stream| stream.zeros.contains(joint));
    // The base includes the zero of the first joint, the point on the tool the zero of the last one.
    let is_inner = |at: usize| (1..joints.len().saturating_sub(1)).contains(&at);
    let fixed_points = streams.iter().all(|one| one.measurement == Measurement::FixedPoint);
    let is_free = |&at: &usize| is_off(&joints[at]) || (fixed_points && is_inner(at));
    let zeros: Vec<usize> = (0..joints.len()).filter(is_free).collect();
    let found = calibrate_arm(robot, &given, &zeros, &distances(streams, distance_m))?;
    Ok((joints, found))
}

fn inputs_from_log(
    path: &Path,
    options: &Options,
    topic: Option<&str>,
) -> Result<LogInputs, Trouble> {
    let log = log::open(&[path.to_path_buf()], &options.read)
        .map_err(|error| read_trouble(error, &[path], options))?;
    let mut run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()))?;
    let evidence = RunEvidence::collect(&mut run, &ReadLosses::default(), &options.run);
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
            match input_from_stream(path, arm, of, source, stream.topic(), &stream.value) {
                Ok(input) => streams.push(input),
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
                Some(why) => format!("no pose stream to calibrate with: {why}"),
                None => "no pose stream to calibrate with".to_owned(),
            };
            Err(trouble(
                path,
                what,
                "run `poseaudit audit` on it for the reason, or select a stream with --topic",
            ))
        }
        1 => {
            let (robot, streams) = found.swap_remove(0);
            Ok((robot, streams, left_out))
        }
        arms => {
            Err(trouble(path, format!("it has poses of {arms} arms"), "choose one with --topic"))
        }
    }
}

/// # Errors
/// The reason for leaving the stream out.
fn input_from_stream(
    path: &Path,
    arm: &Arm,
    of: &ArmEvidence,
    source: &PoseSource,
    topic: &str,
    found: &PoseEvidence,
) -> Result<CalibrationInput, String> {
    let diagnosis = &found.diagnosis;
    if of.diagnosis.encoding.is_err() {
        return Err("the encoding of the joint states is undetermined".to_owned());
    }
    if diagnosis.residual.is_err() || diagnosis.is_far_from_fk() {
        return Err("it does not follow the arm".to_owned());
    }
    if diagnosis.has_changes() {
        return Err("a parameter changes during the run; cut the log there".to_owned());
    }
    if let Some(part) = diagnosis.constant_coordinates.first() {
        return Err(format!("its {} never changes", part.coordinate));
    }
    if let Some(growth) =
        diagnosis.radial_scale.as_ref().ok().filter(|_| diagnosis.is_radial_scale_chosen)
    {
        return Err(format!(
            "its positions grow with reach by {:.2} mm/m, which is indistinguishable from longer links; \
             correct that first",
            1e3 * growth.value
        ));
    }
    if source.moving_base.is_some() {
        return Err("its frame moves".to_owned());
    }
    let mut unzeroed = of.diagnosis.clone();
    let mut zeros = Vec::new();
    for (column, offset) in unzeroed.offsets.iter_mut().enumerate() {
        if std::mem::take(&mut offset.is_chosen) {
            zeros.push(arm.joint_names[column].clone());
        }
    }
    let is_small = |frame: &Pose| {
        frame.translation.vector.norm() <= MAX_DEVIATION_M
            && frame.rotation.angle() <= MAX_DEVIATION_RAD
    };
    let is_outside = found.source_kind == PoseSourceKind::External;
    let frames = &diagnosis.frame_correction;
    let reference_is_free = !source.reference_known || !is_small(&frames.reference);
    let tool_is_free = (is_outside && !source.tip_named) || !is_small(&frames.tool);
    let kept = |frame: Pose, is_free: bool| if is_free { frame } else { Pose::identity() };
    let joints = unzeroed.corrected_joints(&arm.joints, &arm.are_prismatic());
    let joints = (joints, source.columns.clone());
    Ok(CalibrationInput {
        source_kind: found.source_kind,
        latency_s: diagnosis.latency_s.as_ref().ok().map(|latency| latency.value),
        skew: diagnosis.chosen_skew(),
        reference: kept(frames.reference, reference_is_free),
        is_reference_free: reference_is_free,
        tool: kept(frames.tool, tool_is_free),
        is_tool_free: tool_is_free,
        zeros,
        ..CalibrationInput::new(path, topic.to_owned(), &source.chain, joints, diagnosis)
    })
}
