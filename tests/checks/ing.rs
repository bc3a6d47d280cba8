//! ING: unreadable data.

use poseaudit::synth::{IMU, JOINT_STATES, POSE};

use crate::checks::case::ExpectedSubject::{File, JointOf, Topic};
use crate::checks::case::{Expected, ExpectedEstimate, cases, error, info, warning};
use crate::checks::recording::{Message, displace};
use crate::checks::tim::remove_streams;
use Expected::{NoFindings, OnlyOtherFinding, Refused, Skipped};

cases! {
    ING001 a_chunk_with_flipped_bits: |log| {
        log.edit = Some(|_| ());
        log.damage = Some(flip_bits);
    } => error(File, ExpectedEstimate::None);
    ING001 a_truncated_log: |log| {
        log.edit = Some(|_| ());
        log.damage = Some(|bytes| bytes.truncate(bytes.len() * 9 / 10));
    } => warning(File, ExpectedEstimate::None);
    ING001 a_log_without_its_summary: |log| log.damage = Some(cut_summary)
        => warning(File, ExpectedEstimate::None);
    ING001 a_compressed_log_passes: |log| log.edit = Some(|_| ()) => NoFindings;
    ING001 an_unusable_schema_is_not_reported_as_damage: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                message.definition = "three numbers, and four\n".to_owned();
            }
        });
    } => OnlyOtherFinding("ING002");
    ING001 an_empty_file: |log| log.damage = Some(Vec::clear) => Refused("empty");

    ING002 a_pose_with_an_unusable_schema: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                message.definition = "three numbers, and four\n".to_owned();
            }
        });
    } => warning(Topic(POSE), ExpectedEstimate::None);
    ING002 an_imu_with_truncated_messages: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == IMU) {
                message.cdr.truncate(100);
            }
        });
    } => warning(Topic(IMU), ExpectedEstimate::None);
    ING002 a_truncated_robot_description: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|it| it.topic == "/robot_description") {
                let kept = message.cdr.len() / 2;
                message.cdr[kept..].fill(b' ');
            }
        });
    } => warning(Topic("/robot_description"), ExpectedEstimate::None);
    ING002 an_unusable_schema_of_an_unused_type_passes: |log| {
        log.edit = Some(|messages| {
            let mut foreign = messages[0].clone();
            foreign.topic = "/diagnostics".to_owned();
            foreign.type_name = "acme_msgs/msg/Widget".to_owned();
            foreign.definition = "Gear[] gears\n".to_owned();
            messages.push(foreign);
        });
    } => NoFindings;
    ING002 a_truncated_log_can_be_decoded: |log| {
        log.edit = Some(|_| ());
        log.damage = Some(|bytes| bytes.truncate(bytes.len() * 9 / 10));
    } => OnlyOtherFinding("ING001");
    ING003 poses_of_which_half_are_infinite: |log| {
        log.edit = Some(|messages| displace(messages, POSE, &every_second_row(), [f64::INFINITY; 3]));
    } => warning(Topic(POSE), ExpectedEstimate::AmountWithoutInterval(0.5, 0.01));
    ING003 nan_poses_for_one_second: |log| {
        log.edit = Some(|messages| {
            displace(messages, POSE, &(60..85).collect::<Vec<_>>(), [f64::NAN; 3]);
        });
    } => warning(Topic(POSE), ExpectedEstimate::AmountWithoutInterval(0.125, 0.001));
    ING003 unset_orientations: |log| {
        log.edit = Some(|messages| {
            let poses = messages.iter_mut().filter(|message| message.topic == POSE);
            for pose in poses.step_by(3) {
                let end = pose.cdr.len();
                pose.cdr[end - 32..].fill(0);
            }
        });
    } => warning(Topic(POSE), ExpectedEstimate::AmountWithoutInterval(1.0 / 3.0, 0.01));
    ING003 an_impossible_joint_position: |log| {
        log.edit = Some(|messages| turn_one_sample(messages, 1e308));
    } => info(JointOf(JOINT_STATES, "shoulder_lift_joint"), ExpectedEstimate::AmountWithoutInterval(1.0 / 400.0, 1e-4));
    ING003 a_joint_position_whose_square_overflows: |log| {
        log.edit = Some(|messages| turn_one_sample(messages, 1e155));
    } => info(JointOf(JOINT_STATES, "shoulder_lift_joint"), ExpectedEstimate::AmountWithoutInterval(1.0 / 400.0, 1e-4));
    ING003 a_fault_free_log: |_| {} => NoFindings;
    ING003 no_stream_with_samples: |log| remove_streams(&mut log.run) => Skipped("no joint states");
    ING003 an_outlier_is_usable: |log| {
        log.edit = Some(|messages| displace(messages, POSE, &[100], [0.5, 0.0, 0.0]));
    } => OnlyOtherFinding("MOT005");
    ING002 a_text_file: |log| log.damage = Some(|bytes| *bytes = b"to,do\nor,not\n".to_vec())
        => Refused("text");
}

/// Removes the footer and the summary section.
fn cut_summary(bytes: &mut Vec<u8>) {
    // The footer ends 8 magic bytes before the end of the file. Its first field is the start of the
    // summary.
    let footer = bytes.len() - 8 - 20;
    let summary = u64::from_le_bytes(bytes[footer..footer + 8].try_into().expect("eight bytes"));
    bytes.truncate(usize::try_from(summary).expect("it fits into memory"));
}

/// Flips bits at the end of a chunk in the middle of the log.
#[allow(clippy::ptr_arg, reason = "one of several edits of whole files")]
fn flip_bits(bytes: &mut Vec<u8>) {
    const MAGIC: usize = 8;
    const CHUNK: u8 = 6;
    let mut chunk_ends = Vec::new();
    let mut at = MAGIC;
    while at < bytes.len() - MAGIC {
        let length = bytes[at + 1..at + 9].try_into().expect("eight bytes");
        let end =
            at + 9 + usize::try_from(u64::from_le_bytes(length)).expect("it fits into memory");
        if bytes[at] == CHUNK {
            chunk_ends.push(end);
        }
        at = end;
    }
    assert!(chunk_ends.len() > 2, "a log of some chunks");
    let end = chunk_ends[chunk_ends.len() / 2];
    bytes[end - 64..end].iter_mut().for_each(|byte| *byte ^= 0x55);
}

fn every_second_row() -> Vec<usize> {
    (0..1000).step_by(2).collect()
}

/// Rotates the second joint of one joint state.
fn turn_one_sample(messages: &mut [Message], by_rad: f64) {
    let mut states = messages.iter_mut().filter(|message| message.topic == JOINT_STATES);
    states.nth(200).expect("a joint state").turn_joint(1, by_rad);
}
