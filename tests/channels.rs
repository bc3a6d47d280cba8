//! Foxglove channels of a log and of its audit.

use std::io::Cursor;
use std::path::PathBuf;

use mcap::records::MessageHeader;
use poseaudit::finding::Severity;
use poseaudit::log::{Log, ReadOptions, Topic};
use poseaudit::output::foxglove::{Channel, channels, problems};
use poseaudit::stream::{Columns, PoseColumns};
use poseaudit::{Audited, Options, audit_prepared, prepare};

fn read(log: &str) -> (Log, Options) {
    let path = PathBuf::from(format!("{}/fixtures/{log}.mcap", env!("CARGO_MANIFEST_DIR")));
    let options = Options { logs: vec![path], ..Options::default() };
    let mut log = poseaudit::log::open(&options.logs, &options.read).expect("a log");
    prepare(&mut log, &options.run).expect("one clock");
    (log, options)
}

fn audit(log: &str) -> (Vec<Topic>, Audited) {
    let (log, options) = read(log);
    let topics = log.topics.clone();
    (topics, audit_prepared(log, &options).expect("a report"))
}

fn mcap_file(channels: &[Channel]) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression_threads(0);
    let mut writer = options.create(Cursor::new(Vec::new())).expect("memory");
    for channel in channels {
        let schema = channel.schema.to_string();
        let schema = writer.add_schema(channel.schema_name, "jsonschema", schema.as_bytes());
        let id =
            writer.add_channel(schema.expect("room"), &channel.topic, "json", &Default::default());
        let channel_id = id.expect("room");
        for position in 0..channel.message_count() {
            let message = channel.message(position).expect("a message");
            let (log_time, publish_time) = (message.log_time, message.publish_time);
            let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time };
            writer.write_to_known_channel(&header, &message.data).expect("memory");
        }
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

/// Frames, stamps and values of poses, by child frame.
fn poses(topics: &[Topic], name: &str) -> Vec<PoseColumns> {
    let topic = topics.iter().find(|topic| topic.name == name).expect(name);
    let Some(Columns::Poses(poses) | Columns::Transforms(poses)) = &topic.columns else {
        panic!("{name} has no poses")
    };
    let mut poses = poses.clone();
    for part in &mut poses {
        part.times.sequence = Default::default();
    }
    poses.sort_by(|a, b| a.child_frame_id.cmp(&b.child_frame_id));
    poses
}

#[test]
fn poses_and_transforms_are_read_back_as_logged() {
    let (topics, audited) = audit("faulty");
    let channels = channels(topics.clone(), Some(&audited));
    let given = [(PathBuf::from("copy.mcap"), mcap_file(&channels).into())].into();
    let options = ReadOptions { given, ..ReadOptions::default() };
    let copy = poseaudit::log::open(&["copy.mcap".into()], &options).expect("a log");
    assert_eq!(copy.losses, []);
    for name in ["/tcp_pose_broadcaster/pose", "/tf"] {
        assert_eq!(poses(&topics, name), poses(&copy.topics, name), "{name}");
    }
    let fk = poses(&copy.topics, "/poseaudit/fk/tcp_pose_broadcaster/pose");
    let pose = poses(&copy.topics, "/poseaudit/pose/tcp_pose_broadcaster/pose");
    assert_eq!(fk[0].times, pose[0].times);
    assert_eq!(fk[0].frame_id, "base");
}

#[test]
fn an_unaudited_log_has_its_own_channels_only() {
    let (mut log, _) = read("clean");
    log.topics.retain(|topic| topic.name == "/joint_states");
    let Some(Columns::Joints(joints)) = &mut log.topics[0].columns else { panic!("joints") };
    let rows = joints.times.len();
    // Foxglove has no negative times.
    (joints.times.log[3], joints.times.log[7]) = (-1, i64::MIN);
    let own = channels(log.topics, None);
    assert_eq!(own.len(), 1);
    assert_eq!(
        (own[0].message_count(), own[0].untimed, own[0].schema_name),
        (rows - 2, 2, "foxglove.JointStates")
    );
    let first = own[0].log_time(0).expect("a message");
    assert_eq!(own[0].count_while(|time| time <= first), 1);
    assert_eq!(own[0].message(rows - 2), None);
}

#[test]
fn topics_of_a_log_keep_their_names() {
    let (mut topics, audited) = audit("faulty");
    let mut taken = topics[0].clone();
    taken.name = "/poseaudit/log".to_owned();
    topics.push(taken);
    let names: Vec<String> =
        channels(topics, Some(&audited)).into_iter().map(|channel| channel.topic).collect();
    assert!(names.contains(&"/poseaudit/log/2".to_owned()), "{names:?}");
}

#[test]
fn problems_are_the_verdict_the_findings_and_the_remarks() {
    let (_, audited) = audit("faulty");
    let report = &audited.report;
    let problems = problems(report);
    assert!(problems[0].message.starts_with("FAIL"), "{:?}", problems[0]);
    for (problem, finding) in problems[1..].iter().zip(&report.findings) {
        assert_eq!(
            (problem.severity, problem.tip.as_ref()),
            (finding.severity, Some(&finding.fix))
        );
        assert!(
            problem.message.starts_with(finding.code) && problem.message.contains(&finding.message)
        );
    }
    let remarks = &problems[1 + report.findings.len()..];
    assert!(remarks.iter().all(|problem| problem.severity == Severity::Info));
}
