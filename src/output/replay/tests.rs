use std::fs;

use re_chunk::{Chunk, EntityPath, TimelineName};
use re_log_types::{LogMsg, StoreKind};
use re_sdk_types::ComponentDescriptor;
use re_sdk_types::archetypes::{
    Asset3D, BarChart, Capsules3D, Scalars, StateChange, TextDocument, Transform3D,
};
use re_sdk_types::blueprint::archetypes::ViewContents;
use re_sdk_types::blueprint::components::QueryExpression;
use re_sdk_types::components::{Scalar, Text, TransformFrameId};

use super::timeline_writer::entity_path;
use super::*;
use crate::diagnosis::AlignedSamples;
use crate::finding::{Cause, Evidence, Severity, Subject};
use crate::report::figures::{Figures, FindingFigure};
use crate::report::{Trouble, TroubleKind, Verdict};
use crate::robot::catalogue;

type Outcome = Result<(), Box<dyn std::error::Error>>;

const ORIGIN: Stamp = Stamp::from_nanos(1_780_000_000_000_000_000);
/// Delay from stamp to receive time.
const TRANSPORT_S: f64 = 0.003;

fn chain(robot: &Robot) -> Chain {
    robot.chain(robot.link("base").unwrap(), robot.link("tool0").unwrap()).unwrap()
}

/// The shoulder rotates at 100 Hz; poses are consistent.
fn motion(chain: &Chain, rows: usize) -> (JointTrack, AlignedSamples) {
    let mut joints = JointTrack { dof: chain.dof(), ..JointTrack::default() };
    let mut aligned = AlignedSamples::default();
    for row in 0..rows {
        let t_s = row as f64 * 0.01;
        let mut q = vec![0.5; chain.dof()];
        q[0] = t_s;
        aligned.t_s.push(t_s);
        let base_from_tip = chain.forward(&q);
        for poses in
            [&mut aligned.logged, &mut aligned.fk, &mut aligned.corrected, &mut aligned.fk_at_truth]
        {
            poses.push(base_from_tip);
        }
        joints.t_s.push(t_s);
        joints.q.extend(&q);
        joints.qd.extend(vec![0.0; chain.dof()]);
    }
    (joints, aligned)
}

fn received(joints: &JointTrack) -> ReceiveTimes {
    let stamps = joints.t_s.iter().map(|&t_s| ORIGIN.shifted(t_s));
    ReceiveTimes::new(stamps.map(|stamp| (stamp, stamp.shifted(TRANSPORT_S))).collect())
}

fn finding() -> Finding {
    Finding {
        code: "LAT001",
        severity: Severity::Error,
        title: "stream is late",
        message: "22 ms late".to_owned(),
        subject: Subject { topic: Some("/tcp/pose".to_owned()), ..Subject::default() },
        cause: Cause::Other,
        segment: None,
        estimate: None,
        evidence: Evidence { effect: Some("26 mm".to_owned()), ..Evidence::default() },
        fix: "stamp it when it is sampled".to_owned(),
        start_ns: Some(ORIGIN.shifted(0.1)),
        end_ns: Some(ORIGIN.shifted(0.3)),
    }
}

fn report(verdict: Verdict, findings: Vec<Finding>) -> Report {
    let trouble = Trouble {
        kind: TroubleKind::Call,
        what: String::new(),
        place: String::new(),
        remedy: String::new(),
    };
    let mut report = Report::from_trouble(trouble);
    (report.verdict, report.error, report.findings) = (verdict, None, findings);
    report
}

fn stream(aligned: &AlignedSamples, kind: StreamKind) -> ReplayStream<'_> {
    ReplayStream {
        topic: if kind == StreamKind::Tf { "/tf" } else { "/tcp/pose" },
        kind,
        aligned,
        received: ReceiveTimes::default(),
        base_from_reference: Pose::identity(),
        reference_known: true,
        latency_s: 0.022,
    }
}

/// Arm without streams, joints as recorded.
fn arm<'a>(robot: &'a Robot, chain: &'a Chain, recorded: &'a JointTrack) -> ReplayArm<'a> {
    ReplayArm {
        name: "ur5e",
        robot,
        chain,
        columns: &[0, 1, 2, 3, 4, 5][..chain.dof()],
        received: received(recorded),
        recorded,
        corrected: recorded.clone(),
        streams: Vec::new(),
        imus: Vec::new(),
    }
}

fn replay<'a>(arms: Vec<ReplayArm<'a>>, report: &'a Report) -> Replay<'a> {
    Replay { origin: ORIGIN, span: (ORIGIN, ORIGIN.shifted(0.5)), arms, report }
}

struct ReadRecording {
    messages: Vec<LogMsg>,
    notes: Vec<String>,
}

impl ReadRecording {
    fn write_and_read(
        replay: &Replay<'_>,
        wanted: &Recording,
    ) -> Result<Self, Box<dyn std::error::Error>> {
        let (messages, notes) = messages(wanted, replay)?;
        Ok(Self { messages, notes })
    }

    fn chunks(&self, path: &EntityPath) -> Vec<Chunk> {
        let recorded = self.messages.iter().filter_map(|message| match message {
            LogMsg::ArrowMsg(id, message) if id.kind() == StoreKind::Recording => {
                Some(Chunk::from_arrow_msg(message).unwrap())
            }
            _ => None,
        });
        recorded.filter(|chunk| chunk.entity_path() == path).collect()
    }

    fn with(&self, path: &[&str], component: &ComponentDescriptor) -> Option<Chunk> {
        let chunks = self.chunks(&entity_path(path)).into_iter();
        chunks.filter(|chunk| chunk.components().get(component.component).is_some()).last()
    }

    fn text(&self, path: &[&str]) -> String {
        let text = TextDocument::descriptor_text();
        let chunk = self.with(path, &text).expect("a page");
        let mut texts = chunk.component_batch::<Text>(text.component, 0).unwrap().unwrap();
        texts.remove(0).to_string()
    }
}

fn times(chunk: &Chunk, timeline: &str) -> Vec<i64> {
    chunk.timelines()[&TimelineName::try_new(timeline).unwrap()].times_raw().to_vec()
}

#[test]
fn a_recording_is_written_with_its_folder() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 50);
    let mut arm = arm(robot, &chain, &recorded);
    arm.corrected.q.iter_mut().for_each(|position| *position += 0.01);
    arm.streams = vec![stream(&aligned, StreamKind::Pose), stream(&aligned, StreamKind::Tf)];
    let yaw_error = &[(0.0, 0.1), (0.1, 0.2)];
    arm.imus = vec![ReplayImu { topic: "/imu/data", received: ReceiveTimes::default(), yaw_error }];
    let report = report(Verdict::Fail, vec![finding()]);
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("made/run.rrd");
    let notes = write(&Recording::from(path.clone()), &replay(vec![arm], &report))?;
    let bytes = fs::read(&path)?;
    assert!(bytes.starts_with(b"RRF2") && bytes.len() > 10_000);
    let again = folder.path().join("again.rrd");
    let mut second = self::arm(robot, &chain, &recorded);
    second.corrected.q.iter_mut().for_each(|position| *position += 0.01);
    second.streams = vec![stream(&aligned, StreamKind::Pose), stream(&aligned, StreamKind::Tf)];
    second.imus =
        vec![ReplayImu { topic: "/imu/data", received: ReceiveTimes::default(), yaw_error }];
    write(&Recording::from(again.clone()), &replay(vec![second], &report))?;
    assert!(bytes == fs::read(&again)?, "the bytes of equal recordings differ");
    assert!(notes.is_empty(), "{notes:?}");
    Ok(())
}

#[test]
fn a_finding_has_its_own_views_with_limit_and_links() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 50);
    let mut arm = arm(robot, &chain, &recorded);
    arm.streams = vec![stream(&aligned, StreamKind::Pose)];
    // Errors of a healthy stream are not magnified.
    assert_eq!(tools::magnification(&arm), 1.0);
    let shake = Finding { code: "MOT001", ..finding() };
    let mut report = report(Verdict::Fail, vec![shake]);
    let (spectrum, trace) = (vec![[10.0, 1e-3], [12.0, 2e-3]], vec![[0.1, 1e-3], [0.2, -1e-3]]);
    report.figures = Some(Figures {
        of_findings: vec![(0, FindingFigure::Vibration { spectrum, trace })],
        start: Some(ORIGIN),
        ..Figures::default()
    });
    let seen = ReadRecording::write_and_read(&replay(vec![arm], &report), &Recording::default())?;
    let bars = seen.with(&["proof/01/spectrum"], &BarChart::descriptor_values());
    assert!(bars.is_some());
    let value = |path: &str| -> Vec<f64> {
        let scalars = Scalars::descriptor_scalars();
        let chunk = seen.with(&[path], &scalars).expect(path);
        let values = (0..chunk.num_rows())
            .filter_map(|row| chunk.component_batch::<Scalar>(scalars.component, row)?.ok());
        values.flatten().map(|value| value.0.0).collect()
    };
    assert_eq!(value("proof/01/trace/tip"), [1.0, -1.0]);
    // In mm: limits of the vibration and of a residual.
    assert_eq!(value("proof/01/trace/limit_0"), [0.5, 0.5]);
    assert_eq!(value("errors/ur5e/position_mm/tcp/pose/limit"), [1.0, 1.0]);
    let page = seen.text(&["findings", "page_1"]);
    assert!(page.contains("(recording://proof/01/spectrum)"), "{page}");
    assert!(page.contains("(recording://spans/01-MOT001)"), "{page}");
    Ok(())
}

#[test]
fn every_expected_entity_is_written() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 50);
    let mut arm = arm(robot, &chain, &recorded);
    arm.corrected.q.iter_mut().for_each(|position| *position += 0.01);
    arm.streams = vec![stream(&aligned, StreamKind::Pose), stream(&aligned, StreamKind::Tf)];
    let yaw_error = &[(0.0, 0.1), (0.1, 0.2)];
    arm.imus = vec![ReplayImu { topic: "/imu/data", received: ReceiveTimes::default(), yaw_error }];
    let report = report(Verdict::Fail, vec![finding()]);
    let seen = ReadRecording::write_and_read(&replay(vec![arm], &report), &Recording::default())?;
    for path in [
        "arms/ur5e/arm",
        "arms/ur5e/arm_as_recorded",
        "arms/ur5e/links/forearm_link",
        "arms/ur5e/links/forearm_link/frame",
        "arms/ur5e/tip",
        "arms/ur5e/tcp/pose/as_logged",
        "arms/ur5e/tcp/pose/as_explained_trail",
        "arms/ur5e/tcp/pose/error",
        "arms/ur5e/tf/as_logged",
        "errors/ur5e/position_mm/tcp/pose/as_explained",
        "errors/ur5e/rotation_deg/tf/as_logged",
        "errors/ur5e/yaw_deg/imu/data",
        "joints/ur5e/elbow_joint",
        "findings",
        "findings/page_1",
        "report",
    ] {
        assert!(!seen.chunks(&entity_path(&[path])).is_empty(), "{path}");
    }
    Ok(())
}

#[test]
fn links_match_forward_kinematics_on_every_timeline() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, _) = motion(&chain, 50);
    let report = report(Verdict::Pass, Vec::new());
    let arms = || vec![arm(robot, &chain, &recorded)];
    let seen = ReadRecording::write_and_read(&replay(arms(), &report), &Recording::default())?;
    let translation = Transform3D::descriptor_translation();
    for (link, frame) in [("tool0", None), ("forearm_link", Some(2))] {
        let chunk = seen.with(&["arms", "ur5e", "links", link], &translation).ok_or(link)?;
        let drawn: Vec<[f32; 3]> =
            chunk.iter_slices::<[f32; 3]>(translation.component).map(|row| row[0]).collect();
        assert_eq!(drawn.len(), recorded.len());
        let mut frames = Vec::new();
        for (row, drawn) in drawn.iter().enumerate() {
            chain.joint_frames(recorded.row(row), &mut frames);
            let pose = frame.map_or(chain.forward(recorded.row(row)), |frame: usize| frames[frame]);
            for (drawn, fk) in drawn.iter().zip(crate::geometry::xyz_of(&pose)) {
                assert!((f64::from(*drawn) - fk).abs() < 1e-6, "{link} {row}: {drawn} is not {fk}");
            }
        }
        assert_eq!(times(&chunk, "sample"), (0..50).collect::<Vec<i64>>());
        assert_eq!(times(&chunk, "run")[3], 30_000_000);
        assert_eq!(times(&chunk, "stamp")[3], ORIGIN.nanos() + 30_000_000);
        assert_eq!(times(&chunk, "log_time")[3], ORIGIN.nanos() + 33_000_000);
    }
    let wanted = Recording { shares_log_timelines: true, ..Recording::default() };
    let seen = ReadRecording::write_and_read(&replay(arms(), &report), &wanted)?;
    let chunk = seen.with(&["arms", "ur5e", "tip"], &translation).ok_or("tip")?;
    assert_eq!(times(&chunk, "ros2_timestamp")[3], ORIGIN.nanos() + 30_000_000);
    assert_eq!(times(&chunk, "message_log_time")[3], ORIGIN.nanos() + 33_000_000);
    Ok(())
}

#[test]
fn corrected_poses_are_drawn_at_their_time_of_measurement() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 50);
    let mut arm = arm(robot, &chain, &recorded);
    arm.streams = vec![stream(&aligned, StreamKind::Pose)];
    let report = report(Verdict::Pass, Vec::new());
    let seen = ReadRecording::write_and_read(&replay(vec![arm], &report), &Recording::default())?;
    let translation = Transform3D::descriptor_translation();
    let of = |state| seen.with(&["arms", "ur5e", "/tcp/pose", state], &translation).ok_or(state);
    let (logged, explained) = (of("as_logged")?, of("as_explained")?);
    assert_eq!(times(&logged, "run")[10] - times(&explained, "run")[10], 22_000_000);
    // Stamps of 0.1 s and 0.078 s: joint states 10 and 7.
    assert_eq!((times(&logged, "sample")[10], times(&explained, "sample")[10]), (10, 7));
    Ok(())
}

#[test]
fn a_long_run_is_decimated_with_a_note() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 9_001);
    let mut arm = arm(robot, &chain, &recorded);
    arm.streams = vec![stream(&aligned, StreamKind::Pose)];
    let report = report(Verdict::Pass, Vec::new());
    let seen = ReadRecording::write_and_read(&replay(vec![arm], &report), &Recording::default())?;
    let mut in_time = 0;
    for message in &seen.messages {
        let LogMsg::ArrowMsg(id, message) = message else { continue };
        let chunk = Chunk::from_arrow_msg(message)?;
        let is_still = chunk.is_static() || id.kind() == StoreKind::Blueprint;
        assert!(is_still || chunk.num_rows() <= MAX_ROWS + 1, "{}", chunk.entity_path());
        in_time += usize::from(!is_still);
    }
    assert!(in_time > 10);
    let page = seen.text(&["report"]);
    assert!(page.contains("9001 joint states of ur5e, thinned to about 4000"), "{page}");
    assert!(page.contains("9001 samples of /tcp/pose"), "{page}");
    Ok(())
}

#[test]
fn a_finding_has_a_span_a_message_and_a_page() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, _) = motion(&chain, 50);
    let mut whole = finding();
    (whole.start_ns, whole.end_ns) = (None, None);
    let report = report(Verdict::Fail, vec![finding(), whole]);
    let arms = vec![arm(robot, &chain, &recorded)];
    let seen = ReadRecording::write_and_read(&replay(arms, &report), &Recording::default())?;
    let state = StateChange::descriptor_state();
    for (lane, ends) in [("01-LAT001", [100, 300]), ("02-LAT001", [0, 500])] {
        let chunks = seen.chunks(&entity_path(&["spans", lane]));
        let chunk = chunks.iter().find(|chunk| !chunk.is_static()).ok_or(lane)?;
        assert_eq!(times(chunk, "run"), ends.map(|ms| ms * 1_000_000), "{lane}");
        let states = [0, 1].map(|row| chunk.component_batch::<Text>(state.component, row));
        let states = states.map(|state| state.unwrap().unwrap()[0].to_string());
        assert_eq!(states, ["LAT001 /tcp/pose: 22 ms late", ""]);
    }
    assert_eq!(seen.chunks(&findings::log()).len(), 2);
    let page = seen.text(&["findings", "page_1"]);
    for said in ["error LAT001 stream is late", "`/tcp/pose`", "22 ms late", "- 26 mm", "**fix**"] {
        assert!(page.contains(said), "{said}: {page}");
    }
    Ok(())
}

const MESHED: &str = r#"<robot name="two">
  <link name="base"><visual><geometry><mesh filename="package://two/base.obj"/></geometry></visual></link>
  <joint name="turn" type="continuous"><parent link="base"/><child link="tool0"/><origin xyz="0 0 1"/></joint>
  <link name="tool0"><visual><geometry><mesh filename="package://two/tool.stl" scale="2 2 2"/></geometry></visual></link>
</robot>"#;

#[test]
fn missing_meshes_are_replaced_and_reported() -> Outcome {
    let robot = Robot::from_urdf(MESHED, "test")?;
    let chain = chain(&robot);
    let (recorded, _) = motion(&chain, 50);
    let report = report(Verdict::Pass, Vec::new());
    let folder = tempfile::tempdir()?;
    let seen = |mesh_roots| {
        let wanted = Recording { mesh_roots, ..Recording::default() };
        ReadRecording::write_and_read(
            &replay(vec![arm(&robot, &chain, &recorded)], &report),
            &wanted,
        )
    };
    let (blob, lengths) = (Asset3D::descriptor_blob(), Capsules3D::descriptor_lengths());
    let mesh = |seen: &ReadRecording, link| {
        seen.with(&["arms", "ur5e", "links", link, "visual_0"], &blob).is_some()
    };
    let capsules = |seen: &ReadRecording| seen.with(&["arms", "ur5e", "arm"], &lengths).is_some();

    let none = seen(Vec::new())?;
    assert!(capsules(&none) && !mesh(&none, "base") && none.notes.is_empty());
    let page = none.text(&["report"]);
    assert!(page.contains("capsules") && page.contains("--mesh-root"), "{page}");

    let root = || vec![folder.path().to_owned()];
    fs::write(folder.path().join("base.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")?;
    fs::write(folder.path().join("tool.stl"), "short")?;
    let half = seen(root())?;
    assert!(capsules(&half) && mesh(&half, "base") && !mesh(&half, "tool0"));
    let said = "1 of the 2 meshes of ur5e are not drawn, shown as capsules instead: package://two/tool.stl \
        cannot be shown: it is not a valid STL file";
    assert_eq!(half.notes, [said]);

    fs::remove_file(folder.path().join("tool.stl"))?;
    let missing = seen(root())?;
    assert!(missing.notes[0].ends_with("package://two/tool.stl is not below --mesh-root"));

    fs::write(folder.path().join("tool.stl"), "solid tool\nendsolid tool\n")?;
    let whole = seen(root())?;
    assert!(!capsules(&whole) && mesh(&whole, "base") && mesh(&whole, "tool0"));
    assert_eq!(whole.notes, ["ur5e is drawn with the 2 meshes of its model"]);
    Ok(())
}

#[test]
fn the_layout_has_the_application_of_the_recording() -> Outcome {
    let report = report(Verdict::Inconclusive, Vec::new());
    let wanted =
        Recording { application: Some("an-opened-log".to_owned()), ..Recording::default() };
    let seen = ReadRecording::write_and_read(&replay(Vec::new(), &report), &wanted)?;
    let mut layouts =
        seen.messages.iter().map(LogMsg::store_id).filter(|id| id.kind() == StoreKind::Blueprint);
    let layout = layouts.next().ok_or("a layout")?;
    assert_eq!(layout.application_id().as_str(), "an-opened-log");
    Ok(())
}

#[test]
fn scenes_of_a_layer_contain_the_log_in_its_frames() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, _) = motion(&chain, 50);
    let report = report(Verdict::Pass, Vec::new());
    let views = |wanted: &Recording| -> Result<Vec<String>, Box<dyn std::error::Error>> {
        let arms = vec![arm(robot, &chain, &recorded)];
        let seen = ReadRecording::write_and_read(&replay(arms, &report), wanted)?;
        let contents = ViewContents::descriptor_query().component;
        let layouts = seen.messages.iter().filter_map(|message| match message {
            LogMsg::ArrowMsg(id, message) if id.kind() == StoreKind::Blueprint => {
                Some(Chunk::from_arrow_msg(message).unwrap())
            }
            _ => None,
        });
        let rules = layouts.filter_map(|chunk| {
            let rules = chunk.component_batch::<QueryExpression>(contents, 0)?.ok()?;
            Some(rules.iter().map(|rule| rule.0.to_string()).collect::<Vec<_>>().join(" "))
        });
        Ok(rules.collect())
    };
    let of_log = |rules: &String| rules.starts_with("$origin/** + /** - /arms/**");
    assert_eq!(views(&Recording::default())?.iter().filter(|rules| of_log(rules)).count(), 0);
    let base = BaseRecording {
        application: "an-app".to_owned(),
        id: "rec-1".to_owned(),
        timelines: ["message_log_time".to_owned()].into(),
    };
    let layer = Recording::default().with_base("log.rrd".into(), &base);
    assert_eq!(
        (layer.application.as_deref(), layer.id.as_deref()),
        (Some("an-app"), Some("rec-1"))
    );
    assert_eq!(views(&layer)?.iter().filter(|rules| of_log(rules)).count(), 1);
    let arms = vec![arm(robot, &chain, &recorded)];
    let seen = ReadRecording::write_and_read(&replay(arms, &report), &layer)?;
    let frame = |descriptor: ComponentDescriptor| {
        let chunk = seen.with(&["arms", "ur5e"], &descriptor).expect("a connection");
        let frames = chunk.component_batch::<TransformFrameId>(descriptor.component, 0);
        frames.unwrap().unwrap().remove(0).to_string()
    };
    assert_eq!(frame(Transform3D::descriptor_parent_frame()), "base");
    assert_eq!(frame(Transform3D::descriptor_child_frame()), "tf#/arms/ur5e");
    Ok(())
}

#[test]
fn a_run_without_an_arm_has_a_page() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("run.rrd");
    let report = report(Verdict::Inconclusive, vec![finding()]);
    write(&Recording::from(path.clone()), &replay(Vec::new(), &report))?;
    assert!(fs::read(&path)?.starts_with(b"RRF2"));
    Ok(())
}

#[test]
fn an_error_names_the_file() -> Outcome {
    let folder = tempfile::tempdir()?;
    let report = report(Verdict::Pass, Vec::new());
    let recording = Recording::from(folder.path().to_owned());
    let error = write(&recording, &replay(Vec::new(), &report)).unwrap_err();
    assert!(error.to_string().starts_with(&folder.path().display().to_string()), "{error}");
    assert!(matches!(error.cause, ReplayCause::Folder(_)));
    Ok(())
}

#[test]
fn a_label_has_the_topic_only_if_the_state_is_ambiguous() -> Outcome {
    let robot = catalogue::find("ur5e").unwrap();
    let chain = chain(robot);
    let (recorded, aligned) = motion(&chain, 50);
    let mut arm = arm(robot, &chain, &recorded);
    arm.streams = vec![stream(&aligned, StreamKind::Pose), stream(&aligned, StreamKind::Tf)];
    let of = |arm: &ReplayArm<'_>, row: usize| arm.label(&arm.streams[row], PoseState::Logged);
    assert_eq!((of(&arm, 0), of(&arm, 1)), ("as logged".to_owned(), "/tf".to_owned()));
    arm.streams.push(stream(&aligned, StreamKind::Pose));
    assert_eq!(of(&arm, 0), "/tcp/pose as logged");
    Ok(())
}
