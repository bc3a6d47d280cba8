//! What joins the rooms: a run's streams into the diagnosis, its results into facts for the rules,
//! and both into the report.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use crate::checks::{
    ArmFacts, Declared, DhFacts, Due, EmptyFacts, EulerFacts, EvaluatedPart, Evaluation, Facts,
    FrameFacts, FrozenFacts, HeldFacts, ImuFacts, JointFacts, JointMotion, NormFacts, PoseFacts,
    RhythmFacts, Settings, ShakeFacts, StampFacts, StrayFacts, UnauditedFacts, Undecodable,
    UndecodableTopic, UnusableFacts, evaluate, merged,
};
use crate::corrections::{Given, Mending};
use crate::diagnosis::{
    ArmDiagnosis, DhEstimate, DhStream, DhTold, ImuDiagnosis, ImuStream, JointOffset, JointReading,
    LatencySteps, Left, NoShake, PoseDiagnosis, PoseStream, Reading, Residual, Series, Shake,
    Unseen, abruptness, beyond_positions, beyond_speed, diagnose_arm, diagnose_derived,
    diagnose_imu, faults, follows, imu_steps, pose_steps, position_misfit_m, proof, proof_of_imu,
    shake,
};
use crate::finding::{Severity, Span, Subject};
use crate::hand_eye::{hand_eyes, settle_hands};
use crate::log::{Log, Loss, Progress};
use crate::pictures::figures;
use crate::places::Places;
use crate::references::references;
use crate::replay::Recording;
use crate::report::{
    Figures, FileRow, LogSummary, NoteRow, Report, RobotRow, StreamRow, Trouble, TroubleKind,
    tells_hand_eye,
};
use crate::robot::{JointKind, RobotError};
use crate::run::{
    Arm, CalibrationSource, Coding, Declaration, Excerpts, HeaderStamps, ImuSource, JointMending,
    JointSamples, PoseSource, RobotSource, Role, Run, RunOptions, Segment, Strays, Stream,
    TopicSettings, Unaudited, Velocities, WhyNot, Witness, segments,
};
use crate::settle::{retake_carried, settle, together};
use crate::stream::{
    Columns, DeclaredUnits, ImuTrack, JointColumn, JointTrack, Orientations, PoseColumns, PoseTrack,
};
use crate::tables::{
    TABLE_FILES, TableError, aligned_frames, checks_frame, findings_frame, joints_frame,
    reach_map_frame, reached_poses_frame, write_table,
};
use crate::time::Clock;
use crate::workspace::{coverage, reached};

/// What to audit, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// The files of one run.
    pub logs: Vec<PathBuf>,
    /// The robots in it; where none is named, the log is asked and then the catalogue.
    pub robots: Vec<RobotSource>,
    /// Calibrations of the URs among them; where none is named, the log may hold one.
    pub calibrations: Vec<CalibrationSource>,
    /// The link that the chain begins at.
    pub base: Option<String>,
    /// The link that it ends at.
    pub tip: Option<String>,
    /// The time that places a sample.
    pub stamp: Clock,
    /// The largest latency that is sought, s; what is off by more is on another clock.
    pub max_latency_s: f64,
    /// Whether every checksum in the files is checked.
    pub verify: bool,
    /// What the compressed parts of a file may unpack to, GiB, where that is more than 16 GiB and 2000 times
    /// its size.
    pub max_unpacked_gib: Option<u32>,
    /// How the rotations of single streams are coded.
    pub declarations: Vec<Declaration>,
    /// What else is said of single topics.
    pub topics: Vec<TopicSettings>,
    /// The config that all this was taken from, to be named in the report.
    pub config: Option<PathBuf>,
    /// A file of corrections, which are applied to the streams before anything is judged.
    pub corrections: Option<PathBuf>,
    /// The folder to write what mends the findings into. Where `corrections` are applied that is what
    /// they leave, to be mended after them.
    pub fix: Option<PathBuf>,
    /// Which rules are asked.
    pub rules: Settings,
    /// Findings of this severity or above fail the run; `None`: none does.
    pub fail_on: Option<Severity>,
    /// Whether a verdict that is inconclusive fails the run, too.
    pub fail_on_inconclusive: bool,
    /// The recording for the Rerun viewer to write.
    pub recording: Option<Recording>,
    /// The folder to write tables into, as Parquet.
    pub tables: Option<PathBuf>,
    /// Whether the report carries what its pictures show.
    pub figures: bool,
    /// Kept up to date while the files are read.
    pub progress: Option<Arc<Progress>>,
}

impl Default for Options {
    fn default() -> Self {
        let run = RunOptions::default();
        Self {
            logs: Vec::new(),
            robots: run.robots,
            calibrations: run.calibrations,
            base: run.base,
            tip: run.tip,
            stamp: run.stamp,
            max_latency_s: run.max_latency_s,
            verify: false,
            max_unpacked_gib: None,
            declarations: run.declared,
            topics: run.topics,
            config: None,
            corrections: None,
            fix: None,
            rules: Settings::default(),
            fail_on: Some(Severity::Warning),
            fail_on_inconclusive: false,
            recording: None,
            tables: None,
            figures: false,
            progress: None,
        }
    }
}

impl Options {
    /// The part that concerns the run.
    pub(crate) fn run(&self) -> RunOptions {
        RunOptions {
            robots: self.robots.clone(),
            calibrations: self.calibrations.clone(),
            base: self.base.clone(),
            tip: self.tip.clone(),
            stamp: self.stamp,
            max_latency_s: self.max_latency_s,
            declared: self.declarations.clone(),
            topics: self.topics.clone(),
        }
    }
}

/// What the report says of the files themselves.
pub(crate) struct Read {
    summary: LogSummary,
    losses: Vec<Loss>,
    undecodable: Vec<UndecodableTopic>,
}

impl Read {
    /// Says what a file of corrections changes.
    pub fn note_corrections(&mut self, given: &Given<'_>) {
        let path = given.file.to_owned();
        let notes = given.notes().into_iter().map(|note| NoteRow { path: path.clone(), note });
        self.summary.notes.extend(notes);
    }

    /// Says something of the run, with its first file.
    fn note(&mut self, what: &str) {
        if let Some(file) = self.summary.files.first() {
            let path = file.path.clone();
            self.summary.notes.push(NoteRow { path, note: what.to_owned() });
        }
    }

    pub fn of(log: &Log) -> Self {
        let files = log.files.iter().map(|file| FileRow {
            path: file.path.clone(),
            container: file.container.name(),
            bytes: file.bytes,
            fetched_bytes: file.fetched,
            crc: file.crc.name(),
        });
        let notes = log
            .notes
            .iter()
            .map(|note| NoteRow { path: note.file.clone(), note: note.what.clone() });
        let undecodable = log.topics.iter().filter_map(|topic| {
            let undecodable = topic.undecodable.as_ref()?;
            Some(UndecodableTopic {
                topic: topic.name.clone(),
                what: Undecodable::Messages(topic.type_name.clone()),
                messages: undecodable.messages,
                why: undecodable.first.clone(),
            })
        });
        Self {
            summary: LogSummary {
                files: files.collect(),
                notes: notes.collect(),
                messages: log.messages,
                start_ns: log.span.map(|span| span.0),
                end_ns: log.span.map(|span| span.1),
                duration_s: log.span.map(|(start, end)| end.seconds_since(start)),
            },
            losses: log.losses.clone(),
            undecodable: undecodable.collect(),
        }
    }
}

/// Standard error of receive times, s, where a stream has no stamps of its own: transports differ by
/// about a millisecond.
const TRANSPORT_S: f64 = 1e-3;

pub(crate) fn pose_stream<'a>(run: &Run, source: &'a PoseSource) -> PoseStream<'a> {
    let mut clocks = run.clocks.iter().filter(|clock| clock.stream == source.stream);
    let received = clocks.any(|clock| clock.stamps != HeaderStamps::Sound);
    PoseStream {
        track: &source.track,
        chain: &source.chain,
        columns: &source.columns,
        reference_known: source.reference_known,
        stamp_error_s: source.stamp_error_s.max(if received { TRANSPORT_S } else { 0.0 }),
        stamps_copied: source.stamps_copied,
    }
}

pub(crate) fn imu_stream(source: &ImuSource) -> ImuStream<'_> {
    ImuStream {
        track: &source.track,
        chain: &source.chain,
        columns: &source.columns,
        link_from_imu: source.link_from_imu,
        stamp_error_s: source.stamp_error_s,
    }
}

/// What was estimated on one arm.
struct Diagnosis {
    pub arm: ArmDiagnosis,
    pub tf: Option<PoseDiagnosis>,
    pub imus: Vec<ImuDiagnosis>,
    pub dh: Option<DhFacts>,
}

/// Diagnoses every arm of a run. An arm whose DH table proves to be of the other convention than it
/// says is read by that one from here on.
fn diagnose(run: &mut Run, most_lag_s: f64) -> Vec<Diagnosis> {
    let arms = 0..run.arms.len();
    arms.map(|index| {
        let found = diagnose_one(run, &run.arms[index], most_lag_s);
        let found = match retake_carried(run, index, &found.arm) {
            true => diagnose_one(run, &run.arms[index], most_lag_s),
            false => found,
        };
        let Some(dh) = &run.arms[index].robot.dh else { return found };
        let declared = dh.convention;
        let (estimate, other) = by_other_convention(run, &run.arms[index], &found.arm, most_lag_s);
        let is_other = estimate.told() == DhTold::Other;
        let dh = Some(DhFacts { declared, estimate });
        match other.filter(|_| is_other) {
            Some((mut arm, other)) => {
                let convention = declared.other().name();
                arm.found += &format!(", its DH table read as {convention}");
                run.replace_arm(index, arm);
                Diagnosis { dh, ..other }
            }
            None => Diagnosis { dh, ..found },
        }
    })
    .collect()
}

/// What the convention that an arm's DH table does not name leaves of its streams, beside what was
/// `found` under the one that it names. Nothing is looked for where that explains them without a
/// fault, or where the positions alone rule the other out.
fn by_other_convention(
    run: &Run,
    arm: &Arm,
    found: &ArmDiagnosis,
    most_lag_s: f64,
) -> (DhEstimate, Option<(Arm, Diagnosis)>) {
    /// Positions lie on an arm to this much with any faults, m, …
    const NEAR_M: f64 = 0.02;
    /// … or to this share of what they do on another.
    const NEARER: f64 = 0.5;
    let declared = Left::of(found);
    let mut estimate = DhEstimate {
        streams: declared
            .iter()
            .map(|&declared| DhStream { declared, declared_positions_m: None, other: None })
            .collect(),
        declared_faults: faults(found),
        other_faults: 0,
    };
    if estimate.declared_faults == 0 && declared.iter().any(Left::is_explained) {
        return (estimate, None);
    }
    let misfits_m = |arm: &Arm| -> Vec<Option<f64>> {
        let streams = arm.poses.iter().zip(&found.streams).map(|(source, found)| {
            let stream = pose_stream(run, source);
            let lag_s = follows(&arm.joints, &stream, most_lag_s).map_or(0.0, |peak| peak.lag_s);
            position_misfit_m(&arm.joints, &stream, position_factor(found), lag_s)
        });
        streams.collect()
    };
    let declared_m = misfits_m(arm);
    for (stream, declared_m) in estimate.streams.iter_mut().zip(&declared_m) {
        stream.declared_positions_m = *declared_m;
    }
    let Some(other) = arm.robot.under_other_convention().and_then(|robot| arm.with_robot(robot))
    else {
        return (estimate, None);
    };
    let ruled_out = declared_m.iter().zip(misfits_m(&other)).map(|(declared_m, other_m)| {
        let both = declared_m.zip(other_m);
        both.is_some_and(|(declared_m, other_m)| other_m > NEAR_M && other_m > NEARER * declared_m)
    });
    let ruled_out: Vec<bool> = ruled_out.collect();
    let contradicts = |(left, ruled_out): (&Left, &bool)| left.is_explained() && *ruled_out;
    if declared.iter().zip(&ruled_out).any(contradicts) || ruled_out.iter().all(|is| *is) {
        return (estimate, None);
    }
    let diagnosis = diagnose_one(run, &other, most_lag_s);
    for (stream, left) in estimate.streams.iter_mut().zip(Left::of(&diagnosis.arm)) {
        stream.other = Some(left);
    }
    estimate.other_faults = faults(&diagnosis.arm);
    (estimate, Some((other, diagnosis)))
}

/// What takes the positions of a stream to m.
fn position_factor(found: &PoseDiagnosis) -> f64 {
    found.length.as_ref().ok().copied().flatten().map_or(1.0, |slip| slip.factor())
}

fn diagnose_one(run: &Run, arm: &Arm, most_lag_s: f64) -> Diagnosis {
    let streams: Vec<PoseStream> =
        arm.poses.iter().map(|source| pose_stream(run, source)).collect();
    let together = together(arm);
    let mut diagnosis = diagnose_steadied(arm, &streams[..together], most_lag_s);
    let corrected = diagnosis.corrected_joints(&arm.joints, &prismatic(arm));
    let alone = (together..streams.len()).into_par_iter().map(|index| {
        let same = (0..together).find(|&of| arm.poses[index].is_copy_of(&arm.poses[of]));
        match same {
            Some(of) => diagnosis.streams[of].clone(),
            None => diagnose_derived(&corrected, None, &streams[index], most_lag_s),
        }
    });
    let alone: Vec<PoseDiagnosis> = alone.collect();
    diagnosis.streams.extend(alone);
    let reading = diagnosis.joints.as_ref().ok();
    let derived = |stream: &PoseStream| {
        let left = |found: &PoseDiagnosis| {
            found.residual.as_ref().map_or(f64::INFINITY, Residual::together_m)
        };
        let found = diagnose_derived(&arm.joints, reading, stream, most_lag_s);
        // What publishes the log's transforms knows of no correction.
        let as_recorded = arm
            .recorded
            .as_ref()
            .map(|(recorded, _)| diagnose_derived(recorded, None, stream, most_lag_s));
        match as_recorded {
            Some(as_recorded) if left(&as_recorded) < left(&found) => as_recorded,
            _ => found,
        }
    };
    let tf = || {
        let source = arm.tf.as_ref().ok()?;
        let stream = pose_stream(run, source);
        let found = derived(&stream);
        Some(match steadied(&stream, &found) {
            None => found,
            Some(track) => {
                let stream = PoseStream { track: &track, ..stream };
                PoseDiagnosis { course: found.course, ..derived(&stream) }
            }
        })
    };
    let imu = |source| match &diagnosis.joints {
        // No reading of the joint states fits the poses, so that FK of them tells nothing.
        Err(Unseen::NotExcited) => {
            ImuDiagnosis::unseen(&Unseen::RestsOn("the order and the unit of the joint positions"))
        }
        _ => diagnose_imu_steadied(&corrected, source, most_lag_s),
    };
    let (tf, imus) = rayon::join(tf, || arm.imus.iter().map(imu).collect());
    Diagnosis { arm: diagnosis, tf, imus, dh: None }
}

/// The diagnosis of an arm's pose streams; where the latency of some is not steady, that of the
/// streams as they would be if it were, so that no other cause is sought for what it does.
fn diagnose_steadied(arm: &Arm, streams: &[PoseStream], most_lag_s: f64) -> ArmDiagnosis {
    let steps_by = |joints: &JointTrack| -> Vec<Option<LatencySteps>> {
        streams.par_iter().map(|stream| pose_steps(joints, stream, most_lag_s)).collect()
    };
    let of_steps = |steps: &[Option<LatencySteps>]| -> Vec<Option<PoseTrack>> {
        let both = streams.iter().zip(steps);
        both.map(|(stream, steps)| {
            let track = stream.track;
            Some(straightened(track, &steps.as_ref()?.straightened(&track.t_s)))
        })
        .collect()
    };
    let mut steps = steps_by(&arm.joints);
    let mut unstepped = of_steps(&steps);
    let mut found = diagnose_arm(&arm.joints, &with_tracks(streams, &unstepped), most_lag_s);
    let is_misread = !found.joints.as_ref().is_ok_and(JointReading::is_as_logged);
    if is_misread && steps.iter().all(Option::is_none) {
        // Joints that are misread hide steps, and steps hide how they are to be read.
        let slides = prismatic(arm);
        let joints = match &found.joints {
            Ok(_) => found.corrected_joints(&arm.joints, &slides),
            Err(_) => {
                let mut joints = arm.joints.clone();
                joints.take_for_degrees(&slides);
                joints
            }
        };
        steps = steps_by(&joints);
        if steps.iter().any(Option::is_some) {
            unstepped = of_steps(&steps);
            found = diagnose_arm(&arm.joints, &with_tracks(streams, &unstepped), most_lag_s);
        }
    }
    let streams = with_tracks(streams, &unstepped);
    let tracks: Vec<Option<PoseTrack>> =
        streams.iter().zip(&found.streams).map(|(stream, found)| steadied(stream, found)).collect();
    let courses: Vec<_> = found
        .streams
        .iter()
        .zip(&steps)
        .map(|(found, steps)| match steps {
            Some(steps) => Ok(steps.course(&found.course)),
            None => found.course.clone(),
        })
        .collect();
    let mut steady = if tracks.iter().all(Option::is_none) {
        found
    } else {
        diagnose_arm(&arm.joints, &with_tracks(&streams, &tracks), most_lag_s)
    };
    for (steady, course) in steady.streams.iter_mut().zip(courses) {
        steady.course = course;
    }
    steady
}

/// Streams with other tracks, where there are such.
fn with_tracks<'a>(
    streams: &[PoseStream<'a>],
    tracks: &'a [Option<PoseTrack>],
) -> Vec<PoseStream<'a>> {
    let with = |(stream, track): (&PoseStream<'a>, &'a Option<PoseTrack>)| PoseStream {
        track: track.as_ref().unwrap_or(stream.track),
        ..*stream
    };
    streams.iter().zip(tracks).map(with).collect()
}

/// The diagnosis of an IMU; where its latency is not steady, that of the IMU as it would be if it
/// were.
fn diagnose_imu_steadied(joints: &JointTrack, source: &ImuSource, most_lag_s: f64) -> ImuDiagnosis {
    let stream = imu_stream(source);
    let steps = imu_steps(joints, &stream, most_lag_s);
    let of_rows = |track: &ImuTrack, rows: &[(usize, f64)]| ImuTrack {
        t_s: rows.iter().map(|&(_, t_s)| t_s).collect(),
        orientation: rows
            .iter()
            .filter_map(|&(row, _)| track.orientation.get(row).copied())
            .collect(),
        gyro: rows.iter().map(|&(row, _)| track.gyro[row]).collect(),
        accel: rows.iter().map(|&(row, _)| track.accel[row]).collect(),
    };
    let unstepped =
        steps.as_ref().map(|steps| of_rows(stream.track, &steps.straightened(&stream.track.t_s)));
    let track = unstepped.as_ref().unwrap_or(stream.track);
    let found = diagnose_imu(joints, &ImuStream { track, ..stream }, most_lag_s);
    let latency_course = match &steps {
        Some(steps) => Ok(steps.course(&found.latency_course)),
        None => found.latency_course.clone(),
    };
    let unsteady = found.latency_course.as_ref().ok().filter(|course| course.is_unsteady);
    let Some(course) = unsteady else { return ImuDiagnosis { latency_course, ..found } };
    let track = of_rows(track, &course.straightened(&track.t_s));
    let steady = diagnose_imu(joints, &ImuStream { track: &track, ..stream }, most_lag_s);
    ImuDiagnosis { latency_course, ..steady }
}

/// The poses of a stream at the stamps that they would have if its latency were steady; `None` where
/// it is.
fn steadied(stream: &PoseStream, found: &PoseDiagnosis) -> Option<PoseTrack> {
    let course = found.course.as_ref().ok().filter(|course| course.is_unsteady)?;
    Some(straightened(stream.track, &course.straightened(&stream.track.t_s)))
}

/// Some rows of a track of poses, each at another time.
fn straightened(track: &PoseTrack, rows: &[(usize, f64)]) -> PoseTrack {
    let declared = track.declared.as_ref().map(|declared| DeclaredUnits {
        in_other_angles: declared
            .in_other_angles
            .as_ref()
            .map(|all| rows.iter().map(|&(row, _)| all[row]).collect()),
        ..*declared
    });
    let orientation = match &track.orientation {
        Orientations::Rotations(all) => {
            Orientations::Rotations(rows.iter().map(|&(row, _)| all[row]).collect())
        }
        Orientations::Numbers(all) => {
            Orientations::Numbers(rows.iter().map(|&(row, _)| all[row]).collect())
        }
        Orientations::Unset(_) => Orientations::Unset(rows.len()),
    };
    PoseTrack {
        t_s: rows.iter().map(|&(_, t_s)| t_s).collect(),
        xyz: rows.iter().map(|&(row, _)| track.xyz[row]).collect(),
        orientation,
        declared,
    }
}

/// The joint states of an arm with what was found on them taken off; `None` where no reading of them
/// fits the arm's poses.
fn readable_joints(arm: &Arm, found: &ArmDiagnosis) -> Option<JointTrack> {
    let is_unread = matches!(found.joints, Err(Unseen::NotExcited));
    (!is_unread).then(|| found.corrected_joints(&arm.joints, &prismatic(arm)))
}

/// For each column of an arm's joint track, whether that joint slides.
pub(crate) fn prismatic(arm: &Arm) -> Vec<bool> {
    let slides = |name: &String| {
        arm.robot.joint(name).is_some_and(|joint| joint.kind == JointKind::Prismatic)
    };
    arm.joint_names.iter().map(slides).collect()
}

/// The facts for the rules.
fn facts(run: &Run, diagnoses: Vec<Diagnosis>, read: &Read, options: &Options) -> Facts {
    let unset = run.arms.iter().zip(&diagnoses).flat_map(|(arm, found)| unset(arm, &found.arm));
    let unset: Vec<Unaudited> = unset.collect();
    let arms = run.arms.iter().zip(diagnoses);
    let robots = arms.map(|(arm, diagnosis)| arm_facts(run, arm, diagnosis, options));
    let stamps = run.clocks.iter().filter_map(|clock| {
        let stream = run.streams.get(clock.stream)?;
        Some(StampFacts {
            robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
            topic: stream.topic.clone(),
            span: span_of(run, clock.stream),
            frame: frame_of_several(run, stream),
            due: due(run, stream)?,
            clock: clock.clone(),
        })
    });
    Facts {
        robots: robots.collect(),
        no_robot: run.no_arm.as_ref().map(|error| error.what()),
        hand_eyes: Vec::new(),
        stamps: stamps.collect(),
        unusable: unusable(run),
        rhythms: rhythms(run),
        frames: frames(run),
        norms: norms(run),
        strays: strays(run),
        frozen: frozen(run),
        held: held(run),
        unaudited: unaudited(run, &unset),
        empty: empty(run),
        missing: missing(run, &options.topics),
        figures: options.rules.figures.clone(),
        start: run.span.map(|(start, _)| start),
        origin: run.origin,
        simulated: run.has_clock_topic,
        losses: read.losses.clone(),
        undecodable: undecodable(run, read),
    }
}

/// What could not be decoded: messages, and robot descriptions.
fn undecodable(run: &Run, read: &Read) -> Vec<UndecodableTopic> {
    let description = |(topic, error): &(String, RobotError)| UndecodableTopic {
        topic: topic.clone(),
        what: Undecodable::Description,
        messages: 1,
        why: error.to_string(),
    };
    read.undecodable.iter().cloned().chain(run.unreadable.iter().map(description)).collect()
}

/// When the samples of a stream are due; `None` where the rules about stamps are not asked about it.
fn due(run: &Run, stream: &Stream) -> Option<Due> {
    match stream.role {
        Role::Joints | Role::Imu => Some(Due::Always),
        // Without an arm, nothing says which of the transforms must be there.
        Role::Tf if run.arms.is_empty() => Some(Due::Untold),
        Role::Pose | Role::Tf => Some(Due::InMotion),
        Role::Candidate { .. } | Role::Unassigned => Some(Due::Untold),
        Role::Reference | Role::Target => Some(Due::OnOccasion),
        Role::TfStatic | Role::Description | Role::Ignored => None,
    }
}

/// The frame whose poses a stream holds, where its topic is that of other streams, too.
pub(crate) fn frame_of_several(run: &Run, stream: &Stream) -> Option<String> {
    let of_topic = run.streams.iter().filter(|other| other.topic == stream.topic);
    let is_one_of_several = of_topic.count() > 1 && !stream.child_frame_id.is_empty();
    is_one_of_several.then(|| stream.child_frame_id.clone())
}

fn rhythms(run: &Run) -> Vec<RhythmFacts> {
    let rhythms = run.rhythms.iter().filter_map(|rhythm| {
        let stream = run.streams.get(rhythm.stream)?;
        Some(RhythmFacts {
            robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
            topic: stream.topic.clone(),
            span: span_of(run, rhythm.stream),
            frame: frame_of_several(run, stream),
            due: due(run, stream)?,
            rate_hz: stream.rate_hz,
            said_hz: stream.said_hz,
            // Of joint states no row is left out.
            unusable: if stream.role == Role::Joints { 0 } else { stream.unusable() },
            parts: rhythm.parts.clone(),
            extent: rhythm.extent,
        })
    });
    rhythms.filter(|rhythm| !rhythm.parts.is_empty()).collect()
}

/// The topics of transforms, and what is wrong with their frames.
fn frames(run: &Run) -> FrameFacts {
    let is_tf = |stream: &&Stream| matches!(stream.columns, Some(Columns::Transforms(_)));
    FrameFacts {
        topics: run.streams.iter().filter(is_tf).map(|stream| stream.topic.clone()).collect(),
        flaws: run.flaws.iter().cloned().chain(run.pieces()).collect(),
    }
}

/// The norms of the streams that log rotations, each with all its transforms.
fn norms(run: &Run) -> Vec<NormFacts> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let mut streams: Vec<NormFacts> = Vec::new();
    let mut last = None;
    for norms in &run.norms {
        let Some(stream) = run.streams.get(norms.stream) else { continue };
        let is_rotations = match &stream.columns {
            // Four of a bare array's numbers are a quaternion only where it is a pose.
            Some(Columns::Array(_)) => stream.role == Role::Pose,
            // What a transform says is judged on its own topic.
            Some(Columns::Poses(_)) => stream.role != Role::Ignored && !is_tf(&stream.topic),
            _ => true,
        };
        if !is_rotations {
            continue;
        }
        match streams.last_mut().filter(|_| last == Some(norms.stream)) {
            Some(known) => known.parts.push(norms.clone()),
            None => streams.push(NormFacts {
                robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
                topic: stream.topic.clone(),
                span: span_of(run, norms.stream),
                frame: frame_of_several(run, stream),
                parts: vec![norms.clone()],
            }),
        }
        last = Some(norms.stream);
    }
    streams
}

/// The streams that are audited, each with its samples that hold no usable numbers.
fn unusable(run: &Run) -> Vec<UnusableFacts> {
    let is_asked =
        |stream: &Stream| matches!(stream.role, Role::Joints | Role::Pose | Role::Tf | Role::Imu);
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let of = |(index, stream): (usize, &Stream)| {
        let mut facts = UnusableFacts {
            subject: subject_of(run, stream),
            span: span_of(run, index),
            unusable: stream.unusable(),
            unset: 0,
            misfits: 0,
            samples: 0,
        };
        let kept: usize = stream.times().iter().map(|times| times.len()).sum();
        facts.samples = kept as u64 + facts.unusable;
        match &stream.columns {
            Some(Columns::Joints(joints)) => {
                let names = joints.joints.iter().map(|joint| joint.name.as_str());
                let of_arm = names.zip(&joints.unusable).filter(|(name, _)| {
                    let mut of_arms = run.arms.iter().flat_map(|arm| &arm.joint_facts);
                    run.arms.is_empty() || of_arms.any(|joint| joint.name == *name)
                });
                let worst = of_arm.max_by_key(|(_, count)| **count);
                facts.misfits = joints.wrong_length;
                facts.samples = kept as u64 + facts.misfits;
                facts.unusable = worst.map_or(0, |(_, count)| *count);
                facts.subject.joint =
                    worst.filter(|_| facts.unusable > 0).map(|(name, _)| name.to_owned());
            }
            Some(Columns::Poses(poses) | Columns::Transforms(poses)) => {
                let unset = |poses: &PoseColumns| {
                    poses.q_xyzw.iter().filter(|q| q.iter().all(|part| *part == 0.0)).count()
                };
                let some = poses.iter().map(|poses| (unset(poses), poses.times.len()));
                facts.unset =
                    some.filter(|(unset, all)| unset < all).map(|(unset, _)| unset as u64).sum();
            }
            Some(Columns::Array(array)) => {
                facts.misfits = array.wrong_length;
                facts.samples += facts.misfits;
            }
            _ => {}
        }
        facts
    };
    streams.map(of).collect()
}

/// The streams of joint states, tool poses and transforms, each with what of it jumps away and back.
fn strays(run: &Run) -> Vec<StrayFacts> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let is_asked = |stream: &Stream| match stream.role {
        Role::Joints | Role::Tf => true,
        // What a transform says is judged on its own topic.
        Role::Pose => !is_tf(&stream.topic),
        _ => false,
    };
    let sliding: Vec<String> = run
        .arms
        .iter()
        .flat_map(|arm| arm.robot.joints())
        .filter(|joint| joint.kind == JointKind::Prismatic)
        .map(|joint| joint.name.clone())
        .collect();
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let of = |(index, stream): (usize, &Stream)| {
        let parts: Vec<Strays> =
            run.sift.strays.iter().filter(|strays| strays.stream == index).cloned().collect();
        StrayFacts {
            subject: subject_of(run, stream),
            span: span_of(run, index),
            samples: stream.times().iter().map(|times| times.len()).max().unwrap_or(0),
            sliding: sliding.clone(),
            parts,
        }
    };
    streams.map(of).collect()
}

/// A stream as a subject.
fn subject_of(run: &Run, stream: &Stream) -> Subject {
    Subject {
        robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
        topic: Some(stream.topic.clone()),
        frame: frame_of_several(run, stream),
        ..Subject::default()
    }
}

/// The streams of poses that an arm was held against, each with when it stood still.
fn frozen(run: &Run) -> Vec<FrozenFacts> {
    let of = |index: usize| {
        let stream = run.streams.get(index)?;
        let times = run.frozen.iter().filter(|found| found.stream == index);
        let is_asked = matches!(stream.role, Role::Pose | Role::Joints);
        if !is_asked && !times.clone().any(|found| found.whole) {
            return None;
        }
        Some(FrozenFacts {
            subject: subject_of(run, stream),
            span: span_of(run, index),
            times: times.copied().collect(),
        })
    };
    let joints = (0..run.streams.len()).filter(|&index| run.streams[index].role == Role::Joints);
    joints.chain(run.watched.iter().copied()).filter_map(of).collect()
}

/// The streams whose values could repeat, each with what of it does.
fn held(run: &Run) -> Vec<HeldFacts> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let is_asked = |stream: &Stream| match stream.role {
        Role::Joints | Role::Tf | Role::Imu => true,
        // What a transform says is judged on its own topic.
        Role::Pose => !is_tf(&stream.topic),
        _ => false,
    };
    let of_stream = |index: usize| run.sift.held.iter().filter(move |held| held.stream == index);
    let repeats = |index: usize| of_stream(index).any(|held| held.is_taken_once());
    let is_of_joints = |index: usize| {
        run.arms.iter().any(|arm| {
            let follows = |tf: &PoseSource| tf.stream == index && tf.stamps_copied;
            arm.tf.as_ref().is_ok_and(follows)
                && arm.joint_facts.iter().any(|joint| repeats(joint.stream))
        })
    };
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let of = |(index, stream): (usize, &Stream)| HeldFacts {
        subject: subject_of(run, stream),
        span: span_of(run, index),
        parts: of_stream(index).cloned().collect(),
        is_latched: stream.topic.to_lowercase().contains("latched"),
        is_of_joints: is_of_joints(index),
    };
    streams.map(of).collect()
}

/// The streams of an arm whose orientations were never set.
fn unset(arm: &Arm, found: &ArmDiagnosis) -> Vec<Unaudited> {
    let streams = arm.poses.iter().zip(&found.streams);
    let unset =
        streams.filter(|(_, found)| matches!(found.reading, Err(Unseen::OrientationNotSet)));
    let why = WhyNot::NoOrientation;
    unset.map(|(source, _)| Unaudited { stream: source.stream, why: why.clone() }).collect()
}

/// The streams that are audited or would be, each with why it is not, or not as what it says it is.
fn unaudited(run: &Run, unset: &[Unaudited]) -> Vec<UnauditedFacts> {
    if run.arms.is_empty() {
        return Vec::new();
    }
    let of = |(index, stream): (usize, &Stream)| {
        let known = run.unaudited.iter().chain(unset);
        let why: Vec<_> = known.filter(|found| found.stream == index).collect();
        let is_asked = matches!(stream.role, Role::Joints | Role::Pose) || !why.is_empty();
        is_asked.then(|| UnauditedFacts {
            subject: subject_of(run, stream),
            span: span_of(run, index),
            why: why.into_iter().map(|found| found.why.clone()).collect(),
        })
    };
    run.streams.iter().enumerate().filter_map(of).collect()
}

/// The topics that hold nothing and would be audited; of joint states and transforms only where no
/// other topic has any.
fn empty(run: &Run) -> Vec<EmptyFacts> {
    let holds =
        |role: Role| run.streams.iter().any(|stream| stream.role == role && !stream.is_empty);
    let is_missed = |stream: &&Stream| match &stream.columns {
        _ if !stream.is_empty => false,
        Some(Columns::Joints(_)) => !holds(Role::Joints),
        Some(_) => true,
        None => !stream.type_name.contains("TFMessage") || !holds(Role::Tf),
    };
    let of = |stream: &Stream, joint: Option<String>| EmptyFacts {
        subject: Subject { topic: Some(stream.topic.clone()), joint, ..Subject::default() },
        messages: stream.count,
    };
    let missed = run.streams.iter().filter(is_missed).map(|stream| of(stream, None));
    let joints = run.streams.iter().flat_map(|stream| {
        let joints = joints_without_positions(run, stream).into_iter();
        joints.map(move |joint| of(stream, Some(joint)))
    });
    missed.chain(joints).collect()
}

/// The joints of an arm that a topic of joint states names and never says the position of, and that no
/// other topic says.
fn joints_without_positions(run: &Run, stream: &Stream) -> Vec<String> {
    let Some(Columns::Joints(columns)) = &stream.columns else { return Vec::new() };
    if stream.role != Role::Joints {
        return Vec::new();
    }
    let is_read = |name: &str| {
        run.arms.iter().any(|arm| arm.joint_facts.iter().any(|joint| joint.name == name))
    };
    let is_of_an_arm = |name: &str| run.arms.iter().any(|arm| arm.robot.joint(name).is_some());
    let is_silent = |joint: &&JointColumn| {
        joint.position.iter().all(|position| position.is_nan())
            && is_of_an_arm(&joint.name)
            && !is_read(&joint.name)
    };
    columns.joints.iter().filter(is_silent).map(|joint| joint.name.clone()).collect()
}

/// The topics that the caller expects and the log does not have.
fn missing(run: &Run, topics: &[TopicSettings]) -> Vec<(Subject, String)> {
    let is_there = |said: &TopicSettings| {
        run.streams
            .iter()
            .any(|stream| said.is_of(&stream.topic) && (stream.count > 0 || stream.is_empty))
    };
    let missing = topics.iter().filter(|said| said.is_expected() && !is_there(said));
    let subject = |topic: &str| Subject { topic: Some(topic.to_owned()), ..Subject::default() };
    missing.map(|said| (subject(&said.topic), said.place.clone())).collect()
}

fn span_of(run: &Run, stream: usize) -> Option<Span> {
    let stream = run.streams.get(stream)?;
    Some(Span { start: stream.start?, end: stream.end? })
}

fn arm_facts(run: &Run, arm: &Arm, diagnosis: Diagnosis, options: &Options) -> ArmFacts {
    let joints_stream = arm.joint_facts.first().map_or(0, |facts| facts.stream);
    let whole = run.span.unwrap_or((run.origin, run.origin));
    let whole = Span { start: whole.0, end: whole.1 };
    let mended = diagnosis.arm.corrected_joints(&arm.joints, &prismatic(arm));
    let is_read = !matches!(diagnosis.arm.joints, Err(Unseen::NotExcited));
    let most_lag_s = options.max_latency_s;
    let pose_facts = |source: &PoseSource, found: &PoseDiagnosis| PoseFacts {
        proof: proof(&arm.joints, &mended, &pose_stream(run, source), found),
        topic: run.streams[source.stream].topic.clone(),
        span: span_of(run, source.stream).unwrap_or(whole),
        reference: if source.reference_known {
            source.chain.base_name().to_owned()
        } else {
            run.streams[source.stream].frame_id.clone()
        },
        reference_known: source.reference_known,
        tip: source.chain.tip_name().to_owned(),
        tip_named: source.tip_named,
        witness: run.streams[source.stream].witness.unwrap_or(Witness::Unknown),
        euler: None,
        independent: !source.stamps_copied,
        bare_numbers: matches!(source.track.orientation, Orientations::Numbers(_)),
        bare: source.track.declared.is_none()
            && matches!(run.streams[source.stream].columns, Some(Columns::Array(_))),
        declared: source.track.declared.as_ref().map(|units| Declared {
            angles: units.in_other_angles.is_some().then_some(match units.degrees {
                true => "deg",
                false => "rad",
            }),
            lengths: if units.millimetres { "mm" } else { "m" },
        }),
    };
    let tf = arm.tf.as_ref().ok().zip(diagnosis.tf);
    let imus = arm.imus.iter().zip(diagnosis.imus).map(|(source, diagnosis)| {
        let facts = ImuFacts {
            topic: run.streams[source.stream].topic.clone(),
            span: span_of(run, source.stream).unwrap_or(whole),
            independent: !source.stamps_copied,
            link: source.chain.tip_name().to_owned(),
            link_from_imu: source.link_from_imu.map(|pose| pose.rotation),
            proof: is_read
                .then(|| proof_of_imu(&mended, &imu_stream(source), &diagnosis, most_lag_s))
                .flatten(),
        };
        (facts, diagnosis)
    });
    let samples = run.joint_samples(&arm.joint_facts);
    let samples = match &arm.recorded {
        Some((_, mending)) => mending.mended_samples(&samples),
        None => samples,
    };
    let (samples, track) = match mending(arm, &diagnosis.arm) {
        Some(mending) => {
            (mending.mended_samples(&samples), Cow::Owned(mending.mended(&arm.joints)))
        }
        None => (samples, Cow::Borrowed(&arm.joints)),
    };
    let joints: Vec<usize> = (0..arm.joint_names.len()).collect();
    let joint = |&joint: &usize| joint_facts(run, arm, joint, &samples[joint], &track);
    let joints = joints.par_iter().map(joint).collect();
    let mut shakes = vec![ShakeFacts {
        topic: run.streams[joints_stream].topic.clone(),
        span: span_of(run, joints_stream).unwrap_or(whole),
        in_other_units: false,
        shake: shake_of_joints(arm, &samples, &track),
    }];
    shakes.extend(arm.poses.iter().zip(&diagnosis.arm.streams).map(|(source, found)| ShakeFacts {
        topic: run.streams[source.stream].topic.clone(),
        span: span_of(run, source.stream).unwrap_or(whole),
        in_other_units: matches!(found.length, Ok(Some(_))),
        shake: shake_of_poses(&source.track, found),
    }));
    let poses = arm.poses.iter().zip(&diagnosis.arm.streams).map(|(source, found)| PoseFacts {
        euler: euler(run, source, found, &options.declarations),
        ..pose_facts(source, found)
    });
    let poses = poses.collect();
    ArmFacts {
        name: arm.name.clone(),
        joints_topic: run.streams[joints_stream].topic.clone(),
        span: span_of(run, joints_stream).unwrap_or(whole),
        joints,
        reach_m: arm.chain.max_reach_m(),
        wrong_model: arm.instead_of.clone(),
        dh: diagnosis.dh,
        diagnosis: diagnosis.arm,
        poses,
        tf: tf.into_iter().map(|(source, found)| (pose_facts(source, &found), found)).collect(),
        shakes,
        imus: imus.collect(),
        references: Vec::new(),
    }
}

/// What makes the joint states those that the arm has, where they are far from that: how the arm moves
/// is not told by numbers that are no positions.
fn mending(arm: &Arm, found: &ArmDiagnosis) -> Option<JointMending> {
    /// A smaller zero changes neither speeds nor what a limit says of them, rad or m.
    const FAR: f64 = 0.1;
    let reading = found.joints.as_ref().ok()?;
    let zero = |(joint, offset): (usize, &JointOffset)| {
        let coded = found.scales.iter().find(|scale| scale.column == joint && scale.is_coded());
        let own = offset.offset.as_ref().ok().filter(|_| offset.chosen).map_or(0.0, |it| it.value);
        coded.map_or(own, |scale| scale.offset)
    };
    let offset: Vec<f64> = found.offsets.iter().enumerate().map(zero).collect();
    if reading.is_as_logged() && offset.iter().all(|offset| offset.abs() < FAR) {
        return None;
    }
    let mut mending = JointMending { offset, ..JointMending::none(arm.joint_names.len()) };
    if let Some((really, _)) = &reading.permutation {
        really.iter().enumerate().for_each(|(named, &really)| mending.from[really] = named);
    }
    for (factor, slides) in mending.factor.iter_mut().zip(prismatic(arm)) {
        *factor = if reading.degrees.is_some() && !slides { 1f64.to_radians() } else { 1.0 };
    }
    reading.slips.iter().for_each(|slip| mending.factor[slip.column] *= slip.factor);
    Some(mending)
}

/// The shake of the tip by a stream of poses, but for where its clock steps: the path does, too.
fn shake_of_poses(track: &PoseTrack, found: &PoseDiagnosis) -> Result<Shake, NoShake> {
    /// Rows so near to a step are left out, s.
    const BESIDE_S: f64 = 0.1;
    let jumps = found.course.as_ref().map_or(&[][..], |course| course.jumps.as_slice());
    let is_clear = |t_s: f64| jumps.iter().all(|jump| (jump.at_s - t_s).abs() > BESIDE_S);
    let rows: Vec<usize> = (0..track.t_s.len()).filter(|&row| is_clear(track.t_s[row])).collect();
    let t_s: Vec<f64> = rows.iter().map(|&row| track.t_s[row]).collect();
    shake(&t_s, |row| track.xyz[rows[row]])
}

/// The shake of the tip by the joint states as they are, or where the joints do not share their stamps
/// by the track that they were brought to.
fn shake_of_joints(
    arm: &Arm,
    samples: &[JointSamples<'_>],
    track: &JointTrack,
) -> Result<Shake, NoShake> {
    let mut q = vec![0.0; arm.columns.len()];
    let mut tip = |position: &dyn Fn(usize) -> f64| {
        q.iter_mut().zip(&arm.columns).for_each(|(q, &column)| *q = position(column));
        arm.chain.forward(&q).translation.vector
    };
    match samples.first() {
        Some(first) if samples.iter().all(|other| other.is_beside(first)) => {
            shake(&first.t_s, |row| tip(&|column| samples[column].position[row]))
        }
        _ => shake(&track.t_s, |row| tip(&|column| track.row(row)[column])),
    }
}

/// A joint, and what it does by all of its samples.
fn joint_facts(
    run: &Run,
    arm: &Arm,
    joint: usize,
    samples: &JointSamples<'_>,
    track: &JointTrack,
) -> JointFacts {
    let name = arm.joint_names[joint].clone();
    let model = arm.robot.joint(&name);
    let limits = model.map(|joint| joint.limits).unwrap_or_default();
    let mut motion = JointMotion::default();
    if let Some(source) = arm.joint_facts.get(joint) {
        let JointSamples { t_s, position, velocity } = samples;
        let is_folded = run
            .folded
            .iter()
            .any(|folded| folded.stream == source.stream && folded.joint == source.name);
        motion.is_endless =
            is_folded || model.is_some_and(|joint| joint.kind == JointKind::Continuous);
        // What is logged within one turn has no place on a longer way.
        motion.positions = if is_folded { None } else { beyond_positions(t_s, position, &limits) };
        (motion.speeds, motion.abruptness) = match source.velocities {
            Velocities::Logged | Velocities::Near => (
                beyond_speed(t_s, velocity, &limits),
                abruptness(t_s, velocity, Series::Velocities),
            ),
            Velocities::Derived => {
                let JointTrack { t_s: times_s, dof, qd, .. } = track;
                let qd: Vec<f64> = qd.iter().skip(joint).step_by(*dof).copied().collect();
                (beyond_speed(times_s, &qd, &limits), abruptness(t_s, position, Series::Positions))
            }
        };
    }
    let prismatic = model.is_some_and(|joint| joint.kind == JointKind::Prismatic);
    JointFacts { name, prismatic, limits, motion }
}

/// How the rotations of a stream of six bare numbers are coded, and how near gimbal lock all its rows
/// are; `None` of other streams.
fn euler(
    run: &Run,
    source: &PoseSource,
    found: &PoseDiagnosis,
    declared: &[Declaration],
) -> Option<EulerFacts> {
    let stream = run.streams.get(source.stream)?;
    let Some(Columns::Array(array)) = &stream.columns else { return None };
    let clock = run.clocks.iter().find(|clock| clock.stream == source.stream)?;
    if array.width != 6 {
        return None;
    }
    let names = |declared: &&Declaration| declared.is_of(&stream.topic);
    let declared = declared.iter().find(names);
    let reading = found.reading.as_ref().ok().filter(|reading| reading.is_told);
    let told = reading.and_then(|reading| match reading.best {
        Reading::Numbers(convention) => Some(convention),
        _ => Some(reading.best.misreading()?.is),
    });
    let said = declared.and_then(|declared| match declared.coding {
        Coding::Three(convention) => Some(convention),
        _ => None,
    });
    let convention = told.or(said);
    let in_degrees = declared.is_some_and(|declared| declared.degrees) != found.degrees.is_some();
    let to_radians = if in_degrees { 1_f64.to_radians() } else { 1.0 };
    let margin = |row: usize| {
        let numbers = array.row(row);
        let numbers = [3, 4, 5].map(|at| numbers[at] * to_radians);
        Some((clock.stamp_of(&array.times, row)?, convention?.gimbal_margin(numbers)?))
    };
    Some(EulerFacts {
        convention,
        margins_rad: (0..array.times.len()).filter_map(margin).collect(),
    })
}

/// A segment of a run, audited.
pub(crate) struct Audited {
    pub run: Run,
    pub facts: Facts,
    evaluation: Evaluation,
    seconds: f64,
}

/// The audits of all segments, one at least.
pub(crate) struct Audits {
    segments: Vec<Audited>,
    /// The longest.
    main: usize,
}

impl Audits {
    /// Audits the segments of `log`, each as a run of its own. One that cannot be is left out, unless
    /// it is the longest.
    pub fn of(
        log: Log,
        read: &Read,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        let segments = segments(log);
        let longest = segments.iter().map(|segment| segment.seconds).fold(0.0, f64::max);
        let mut audits = Audits { segments: Vec::new(), main: 0 };
        let mut has_main = false;
        for segment in segments {
            let is_main = !has_main && segment.seconds >= longest;
            match Audited::of(segment, read, options, given) {
                Ok(audited) => {
                    if is_main {
                        (audits.main, has_main) = (audits.segments.len(), true);
                    }
                    audits.segments.push(audited);
                }
                Err(trouble) if is_main => return Err(trouble),
                Err(_) => {}
            }
        }
        Ok(audits)
    }

    /// The longest segment.
    pub fn main(&self) -> &Audited {
        &self.segments[self.main]
    }

    /// What the pictures of the longest segment show that belong to `report`.
    pub fn figures(&self, report: &Report) -> Figures {
        let Audited { run, facts, .. } = self.main();
        let corrected = |arm: &Arm, facts: &ArmFacts| {
            facts.diagnosis.corrected_joints(&arm.joints, &prismatic(arm))
        };
        let of_longest_segment = self.segments.len() > 1;
        let is_told = |topic: &str| {
            report.findings.iter().any(|found| found.subject.topic.as_deref() == Some(topic))
        };
        Figures { of_longest_segment, ..figures(run, facts, corrected, is_told) }
    }

    /// Writes what mends the findings of `report`, which is on these, into `folder`.
    pub fn write_fixes(&self, report: &Report, of: &Options, folder: &Path) -> Result<(), Trouble> {
        let Audited { run, facts, .. } = self.main();
        let mending = Mending::of(report, run, facts, self.main);
        mending.write(folder, &Places::of(of)).map_err(|(place, error)| Trouble {
            kind: TroubleKind::Call,
            what: format!("cannot be written: {error}"),
            place,
            remedy: "name a folder that can be written to with --fix".to_owned(),
        })
    }

    /// The report on all of them.
    pub fn report(&self, mut read: Read, options: &Options) -> Report {
        /// A segment of less than this share of the longest is short.
        const SHORT: f64 = 0.2;
        let main = self.main();
        if let Some((count, seconds)) = main.run.excerpts.as_ref().map(Excerpts::extent) {
            read.note(&format!(
                "a long run: causes are sought in {count} excerpts of {:.0} s where the joints move \
                 most; clocks, rates and gaps are of all of it",
                seconds / count.max(1) as f64
            ));
        }
        let evaluation = match self.segments.as_slice() {
            [only] => only.evaluation.clone(),
            segments => {
                read.note(&self.note());
                let parts = segments.iter().map(|segment| EvaluatedPart {
                    evaluation: segment.evaluation.clone(),
                    is_short: segment.seconds < SHORT * main.seconds,
                });
                merged(parts.collect(), self.main)
            }
        };
        let streams = match self.segments.as_slice() {
            [only] => streams(&only.run),
            segments => joined(segments.iter().flat_map(|segment| streams(&segment.run))),
        };
        if let Some(config) = &options.config {
            let row = |note: String| NoteRow { path: config.clone(), note };
            read.summary.notes.push(row("settings are taken from this file".to_owned()));
            let unused = options.rules.unused(&evaluation.checks).into_iter();
            let unused = unused.map(|known| {
                row(format!("nothing was asked that `ignore` names: {known} ({})", known.place))
            });
            read.summary.notes.extend(unused);
        }
        let workspace = coverage(&main.run, &evaluation.checks);
        let mut report =
            Report::new(read.summary, robots(&main.run), streams, evaluation, options.fail_on);
        report.workspace = workspace;
        report.fails_open = options.fail_on_inconclusive;
        match &main.run.no_arm {
            Some(error) if options.rules.need_model() && !tells_hand_eye(&report.checks) => {
                report.with_trouble(error.into())
            }
            _ => report,
        }
    }

    /// What became of the run.
    fn note(&self) -> String {
        let lengths: Vec<String> =
            self.segments.iter().map(|segment| format!("{:.1} s", segment.seconds)).collect();
        let (count, lengths) = (lengths.len(), lengths.join(", "));
        format!(
            "all stamps step back: the clock began anew. Audited in {count} segments: {lengths}"
        )
    }
}

impl Audited {
    fn of(
        segment: Segment,
        read: &Read,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        let Segment { log, seconds } = segment;
        let mut run = Run::assemble(log, &options.run()).map_err(|error| Trouble::from(&error))?;
        if let Some(given) = given {
            given.apply(&mut run, options.max_latency_s)?;
        }
        settle(&mut run, options.max_latency_s);
        settle_hands(&mut run, options.max_latency_s);
        let diagnoses = diagnose(&mut run, options.max_latency_s);
        let joints = |arm: usize| readable_joints(&run.arms[arm], &diagnoses[arm].arm);
        let hand_eyes = hand_eyes(&run, joints, options.max_latency_s);
        let mut facts = Facts { hand_eyes, ..facts(&run, diagnoses, read, options) };
        for (index, arm) in facts.robots.iter_mut().enumerate() {
            arm.references = references(&run, index, &arm.diagnosis, options.max_latency_s);
        }
        let evaluation = evaluate(&facts, &options.rules);
        Ok(Self { run, facts, evaluation, seconds })
    }
}

/// One row for each stream of the segments.
fn joined(rows: impl Iterator<Item = StreamRow>) -> Vec<StreamRow> {
    let mut joined: Vec<StreamRow> = Vec::new();
    for row in rows {
        let is_same = |other: &&mut StreamRow| {
            let names = |row: &StreamRow| {
                (row.topic.clone(), row.frame_id.clone(), row.child_frame_id.clone())
            };
            other.type_name == row.type_name && names(other) == names(&row)
        };
        match joined.iter_mut().find(is_same) {
            Some(known) => {
                known.count += row.count;
                known.dropped += row.dropped;
                known.rate_hz = known.rate_hz.or(row.rate_hz);
                known.start_ns = [known.start_ns, row.start_ns].into_iter().flatten().min();
                known.end_ns = known.end_ns.max(row.end_ns);
            }
            None => joined.push(row),
        }
    }
    joined
}

/// The report on a run that was only looked at.
pub(crate) fn summary(run: &Run, read: Read) -> Report {
    Report::of_log(read.summary, robots(run), streams(run))
}

fn robots(run: &Run) -> Vec<RobotRow> {
    let row = |arm: &Arm| RobotRow {
        name: arm.name.clone(),
        source: arm.found.clone(),
        base: arm.chain.base_name().to_owned(),
        tip: arm.chain.tip_name().to_owned(),
        joints: arm.chain.joint_names().to_vec(),
    };
    run.arms.iter().map(row).collect()
}

fn streams(run: &Run) -> Vec<StreamRow> {
    let named = |text: &String| (!text.is_empty()).then(|| text.clone());
    let rows = run.streams.iter().map(|stream| StreamRow {
        topic: stream.topic.clone(),
        type_name: stream.type_name.clone(),
        role: stream.role.name(),
        reason: stream.reason.clone(),
        robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
        frame_id: named(&stream.frame_id),
        child_frame_id: named(&stream.child_frame_id),
        reference: stream.reference.clone(),
        link: stream.link.clone(),
        witness: stream.witness.map(Witness::name),
        count: stream.count,
        dropped: stream.dropped,
        rate_hz: stream.rate_hz,
        start_ns: stream.start,
        end_ns: stream.end,
    });
    rows.collect()
}

/// The trouble with a file or folder that the caller named to be written.
pub(crate) fn unwritable(path: &Path, what: String, remedy: &str) -> Trouble {
    let (kind, place) = (TroubleKind::Call, path.display().to_string());
    Trouble { kind, what, place, remedy: remedy.to_owned() }
}

/// Writes the tables of an audited run into a folder.
pub(crate) fn write_tables(
    folder: &Path,
    run: &Run,
    facts: &Facts,
    report: &Report,
) -> Result<(), Trouble> {
    let remedy = "name a folder that can be written with --parquet";
    let trouble = |what| unwritable(folder, what, remedy);
    let streams = facts.robots.iter().flat_map(|arm| {
        let found = arm.poses().chain(arm.tf.iter().map(|(facts, found)| (facts, found)));
        found.map(move |(facts, found)| (arm.name.as_str(), facts.topic.as_str(), &found.aligned))
    });
    let arms = reached(run, &report.checks);
    let frames = [
        findings_frame(&report.findings),
        checks_frame(&report.checks),
        joints_frame(&report.workspace),
        aligned_frames(streams, run.origin),
        reach_map_frame(&arms),
        reached_poses_frame(&arms, run.origin),
    ];
    for (name, frame) in TABLE_FILES.into_iter().zip(frames) {
        let mut frame = frame.map_err(|error| trouble(error.to_string()))?;
        write_table(folder, name, &mut frame).map_err(|TableError { path, cause }| Trouble {
            place: path.display().to_string(),
            ..trouble(cause)
        })?;
    }
    Ok(())
}
