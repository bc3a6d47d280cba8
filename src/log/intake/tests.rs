use super::*;
use crate::decode::MAX_FRAMES;
use crate::testing::{Cdr, POSE_STAMPED};
use crate::topic::MessagePlace;

const HOUR: u64 = 3_600_000_000_000;

fn poses(schema: &str) -> Format<'_> {
    Format {
        encoding: "cdr",
        type_name: "geometry_msgs/msg/PoseStamped",
        schema_encoding: "ros2msg",
        schema: schema.as_bytes(),
    }
}

fn message(time: u64, data: &[u8], latched: bool) -> Message<'_> {
    let (log_time, publish_time, place) = (time, time, MessagePlace::Byte(0));
    Message { log_time, publish_time, sequence: 0, data, place, latched }
}

#[test]
fn a_redefined_channel_remains_one_channel() {
    let mut intake = Intake::default();
    let other = format!("{POSE_STAMPED}# another text\n");
    let first = intake.channel("/a", poses(POSE_STAMPED));
    assert_eq!(intake.channel("/a", poses(POSE_STAMPED)), first);
    assert_ne!(intake.channel("/a", poses(&other)), first);
    assert_ne!(intake.channel("/b", poses(POSE_STAMPED)), first);
    assert_eq!(intake.topics.len(), 2);
}

#[test]
fn channels_are_bounded() {
    let mut intake = Intake::default();
    let taken = |n: usize, intake: &mut Intake| {
        intake.channel(&n.to_string(), Format { type_name: "a/B", ..poses("") }).is_some()
    };
    assert!((0..MAX_CHANNELS).all(|n| taken(n, &mut intake)));
    assert!(!taken(MAX_CHANNELS, &mut intake));
    assert!(taken(0, &mut intake));
}

#[test]
fn frames_are_bounded_and_those_beyond_are_counted() {
    let mut intake = Intake::default();
    intake.begin_file(Path::new("a"), 0);
    let channel = intake.channel("/a", poses(POSE_STAMPED)).unwrap();
    for time in 0..MAX_FRAMES as u32 + 7 {
        let pose = Cdr::pose_stamped(time, 0, &time.to_string(), [0.0; 3]);
        intake.message(channel, message(time.into(), &pose, false));
    }
    let log = intake.finish(Vec::new());
    let Some(Columns::Poses(poses)) = &log.topics[0].columns else { panic!("poses") };
    assert_eq!(poses.len(), MAX_FRAMES);
    let undecodable = log.topics[0].undecodable.as_ref().unwrap();
    assert_eq!(undecodable.messages, 7);
    assert!(undecodable.first.contains("pairs of frames"), "{}", undecodable.first);
}

#[test]
fn too_many_poses_are_reported_as_unused() {
    let schema = POSE_STAMPED.replace("Pose pose\n", "Pose[] poses\n");
    let mut intake = Intake::default();
    intake.begin_file(Path::new("a"), 0);
    let format = Format { type_name: "geometry_msgs/msg/PoseArray", ..poses(&schema) };
    let channel = intake.channel("/particles", format).unwrap();
    let cloud = Cdr::little().header(1, 2, "map").u32(40).all(&[0.5; 7 * 40]).done();
    intake.message(channel, message(1, &cloud, false));
    let log = intake.finish(Vec::new());
    assert_eq!((&log.topics[0].columns, &log.topics[0].undecodable), (&None, &None));
    let useless = log.topics[0].unusable.as_deref().unwrap();
    assert_eq!(useless, "a message contains 40 poses; an arm has at most 16");
}

#[test]
fn a_latched_message_that_is_repeated_is_counted_but_not_a_row() {
    let mut intake = Intake::default();
    intake.begin_file(Path::new("a"), 0);
    let channel = intake.channel("/a", poses(POSE_STAMPED)).unwrap();
    let [one, two] = [1, 2].map(|n| Cdr::pose_stamped(n, 0, "base", [0.0; 3]));
    for (time, data, latched) in
        [(1, &one, true), (2, &two, true), (3, &one, true), (4, &two, false)]
    {
        intake.message(channel, message(time, data, latched));
    }
    let log = intake.finish(Vec::new());
    assert_eq!(log.messages, 4);
    let Some(Columns::Poses(poses)) = &log.topics[0].columns else { panic!("poses") };
    assert_eq!(poses[0].times.log, [1, 2, 4]);
}

fn notes(files: &[(&str, &[u64])]) -> Vec<String> {
    let mut intake = Intake::default();
    for (name, times) in files {
        intake.begin_file(Path::new(name), 0);
        let channel = intake.channel("/a", poses(POSE_STAMPED)).unwrap();
        for &time in *times {
            intake.message(channel, message(time, &[], false));
        }
    }
    let notes = intake.finish(Vec::new()).notes;
    notes.iter().map(|note| format!("{}: {}", note.file.display(), note.what)).collect()
}

#[test]
fn unrelated_files_are_reported() {
    let hours: [&[u64]; 3] = [&[0, HOUR], &[HOUR, 2 * HOUR], &[HOUR / 2, 3 * HOUR / 2]];
    assert_eq!(notes(&[("b", hours[1]), ("a", hours[0])]), [""; 0]);
    assert_eq!(
        notes(&[("c", hours[2]), ("a", hours[0])]),
        ["c: 1800.0 s of `/a` are also in a: are they recordings of the same run?"]
    );
    let days: &[u64] = &[49 * HOUR, 50 * HOUR];
    assert_eq!(
        notes(&[("a", hours[0]), ("b", days)]),
        ["b: it begins 48.0 h after a ends: does it belong to the same run?"]
    );
}
