//! TIM: clocks and stamps.

use poseaudit::finding::{Finding, Severity, Status};
use poseaudit::report::{Report, Verdict};
use poseaudit::synth::{IMU, JOINT_STATES, Motion, POSE, Scenario, TF};

use crate::checks::case::What::{self, About, Amount};
use crate::checks::case::{Expected, Log, On, cases, error, info, summary, the, warning};
use crate::checks::recording::{
    Message, cut_out, repeat, restamp, set_stamp, stick, stick_joints, throw,
};
use Expected::{BlamedOn, Skipped, Sound};
use On::{Run, Topic};

cases! {
    TIM001 a_clock_that_is_set_back: |log| {
        log.edit = Some(|messages| restamp(messages, IMU, 4.0, 4.02, -0.4037));
    } => warning(Topic(IMU), About(0.39, 0.03));
    TIM001 a_clock_that_is_set_back_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.edit = Some(|messages| restamp(messages, IMU, 4.0, 4.02, -0.4037));
    } => warning(Topic(IMU), About(0.39, 0.03));
    TIM001 messages_in_turn_are_sound: |log| log.run.imu.timing.phase_s = 0.0 => Sound;
    TIM001 a_late_pose_runs_forward: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    TIM001 no_stream_that_could_run_back: |log| without_streams(&mut log.run)
        => Skipped("no stamped stream");

    TIM002 a_pose_that_stops_for_a_while: |log| {
        log.edit = Some(|messages| cut_out(messages, POSE, 3.0, 3.7));
    } => warning(Topic(POSE), About(0.72, 0.05));
    TIM002 an_imu_that_loses_one_in_twenty: |log| {
        log.edit = Some(|messages| {
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == IMU);
                message.topic != IMU || count % 20 != 7
            });
        });
    } => warning(Topic(IMU), About(0.05, 0.005));
    TIM002 a_tracker_that_loses_one_in_twenty_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.edit = Some(|messages| {
            rename(messages, POSE, TRACKER);
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == TRACKER);
                message.topic != TRACKER || count % 20 != 7
            });
        });
    } => warning(Topic(TRACKER), About(0.05, 0.005));
    TIM002 commands_come_when_they_come: |log| {
        log.edit = Some(|messages| {
            cut_out(messages, POSE, 3.0, 5.0);
            rename(messages, POSE, "/goal_pose");
        });
    } => Sound;
    TIM002 steady_streams_are_sound: |log| log.run.pose.timing.rate_hz = 20.0 => Sound;
    TIM002 a_pose_that_ends_early_has_no_gap: |log| {
        log.edit = Some(|messages| cut_out(messages, POSE, 6.0, 9.0));
    } => BlamedOn("TIM006");
    TIM002 no_stream_to_interrupt: |log| without_streams(&mut log.run) => Skipped("no periodic stream");

    TIM004 a_pose_that_is_stamped_in_pairs: |log| {
        log.edit = Some(|messages| {
            let mut pose = 0;
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                pose += 1;
                if pose % 20 == 0 {
                    message.restamp(-40_000_000);
                }
            }
        });
    } => warning(Topic(POSE), About(0.05, 0.005));
    TIM004 equal_messages_sent_twice_are_sound: |log| {
        log.edit = Some(|messages| {
            let mut twice = Vec::new();
            for message in messages.drain(..) {
                let again = message.topic == TF;
                twice.push(message.clone());
                twice.extend(again.then_some(message));
            }
            *messages = twice;
        });
    } => Sound;
    TIM004 a_late_pose_is_stamped_once: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    TIM004 no_stream_to_repeat: |log| without_streams(&mut log.run)
        => Skipped("no stamped stream");

    TIM006 a_pose_that_ends_early: |log| {
        log.edit = Some(|messages| cut_out(messages, POSE, 6.0, 9.0));
    } => warning(Topic(POSE), About(2.0, 0.1));
    TIM006 an_imu_that_begins_late: |log| {
        log.edit = Some(|messages| cut_out(messages, IMU, -1.0, 2.5));
    } => warning(Topic(IMU), About(2.5, 0.1));
    TIM006 an_imu_that_slows_down: |log| {
        log.edit = Some(|messages| {
            let start_ns = messages[0].log_ns;
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == IMU);
                message.log_ns - start_ns < 5_000_000_000 || message.topic != IMU || count % 3 == 0
            });
        });
    } => warning(Topic(IMU), About(33.3, 1.0));
    TIM006 half_a_second_is_sound: |log| {
        log.edit = Some(|messages| cut_out(messages, POSE, 7.5, 9.0));
    } => Sound;
    TIM006 a_gap_is_no_early_end: |log| {
        log.edit = Some(|messages| cut_out(messages, POSE, 3.0, 3.7));
    } => BlamedOn("TIM002");
    TIM006 a_late_pose_does_not_begin_late: |log| log.run.pose.timing.latency_s = 1.5
        => BlamedOn("LAT001");
    TIM006 no_stream_to_end: |log| without_streams(&mut log.run) => Skipped("no stream");

    TIM006 a_pose_that_is_nowhere: |log| {
        log.edit = Some(|messages| throw(messages, POSE, &every(), [f64::NAN; 3]));
    } => warning(Topic(POSE), What::None);

    TIM007 a_pose_that_stands_still_for_two_seconds: |log| {
        log.edit = Some(|messages| stick(messages, POSE, 3.0, 5.0));
    } => error(Topic(POSE), About(1.96, 0.05));
    TIM007 a_pose_that_dies_and_is_repeated: |log| {
        log.edit = Some(|messages| stick(messages, POSE, 4.0, 9.0));
    } => error(Topic(POSE), About(3.96, 0.05));
    TIM007 a_pose_that_never_was: |log| {
        log.edit = Some(|messages| stick(messages, POSE, -1.0, 9.0));
    } => error(Topic(POSE), About(7.96, 0.05));
    TIM007 a_pose_that_moves_is_sound: |log| log.run.pose.timing.rate_hz = 50.0 => Sound;
    TIM007 an_arm_that_rests_stands_still: |log| {
        log.run.motion = Motion::AtRest;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
    } => Sound;
    TIM007 a_pose_that_stands_still_beside_a_rest: |log| {
        log.run.motion = Motion::PickAndPlace;
        log.edit = Some(|messages| stick(messages, POSE, 4.0, 5.0));
    } => error(Topic(POSE), About(0.96, 0.1));
    TIM007 rests_of_a_late_pose_without_noise_are_sound: |log| {
        log.run.motion = Motion::PickAndPlace;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
        log.run.pose.timing.latency_s = 0.3;
    } => BlamedOn("LAT001");
    TIM007 rests_of_a_pose_without_noise_beside_joints_in_degrees_are_sound: |log| {
        log.run.motion = Motion::PickAndPlace;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
        log.run.noise.joints = 2e-4;
        log.run.joints.in_degrees = true;
    } => BlamedOn("ORD004");
    TIM007 a_late_pose_does_not_stand_still: |log| log.run.pose.timing.latency_s = 1.5
        => BlamedOn("LAT001");
    TIM007 joint_states_that_stand_still_amid_a_motion: |log| {
        log.run.motion = Motion::Continuous;
        log.edit = Some(|messages| stick_joints(messages, 3.0, 4.5));
    } => error(Topic(JOINT_STATES), About(1.46, 0.1));
    TIM007 no_stream_that_could_stand_still: |log| without_streams(&mut log.run) => Skipped("no");

    TIM008 transforms_that_are_sent_three_times: |log| {
        log.run.tf.timing.rate_hz = 50.0;
        log.edit = Some(|messages| repeat(messages, TF, 3));
    } => error(Topic(TF), About(0.667, 0.05));
    TIM008 fresh_transforms_are_sound: |log| log.run.tf.timing.rate_hz = 50.0 => Sound;
    TIM008 a_pose_that_stands_still_is_no_poller: |log| {
        log.edit = Some(|messages| stick(messages, POSE, 3.0, 5.0));
    } => BlamedOn("TIM007");
    TIM008 no_stream_that_repeats: |log| without_streams(&mut log.run) => Skipped("no stream");

    TIM003 an_imu_that_counts_from_its_start: |log| log.run.imu.timing.clock_offset_s = -1.78e9
        => warning(Topic(IMU), Amount(-1.78e9, 0.005));
    TIM003 a_pose_that_is_an_hour_ahead: |log| log.run.pose.timing.clock_offset_s = 3600.0
        => warning(Topic(POSE), Amount(3600.0, 0.005));
    TIM003 all_on_one_foreign_clock: |log| on_clock(&mut log.run, -1.7e9)
        => info(Run, About(-1.7e9, 0.005));
    TIM003 a_second_is_no_other_clock: |log| on_clock(&mut log.run, 1.0) => Sound;
    TIM003 a_late_pose_is_on_the_same_clock: |log| log.run.pose.timing.latency_s = 1.5
        => BlamedOn("LAT001");
    TIM003 zero_stamps_are_no_clock: |log| log.run.pose.timing.stamped = false
        => BlamedOn("TIM005");
    TIM003 no_stream: |log| without_streams(&mut log.run) => Skipped("no stamped stream");

    TIM005 a_pose_without_stamps: |log| log.run.pose.timing.stamped = false
        => warning(Topic(POSE), What::None);
    TIM005 an_imu_without_stamps: |log| log.run.imu.timing.stamped = false
        => warning(Topic(IMU), What::None);
    TIM005 a_tracker_without_stamps_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.pose.timing.stamped = false;
        log.edit = Some(|messages| rename(messages, POSE, TRACKER));
    } => warning(Topic(TRACKER), What::None);
    TIM005 commands_that_are_to_be_followed_at_once: |log| {
        log.run.pose.timing.stamped = false;
        log.edit = Some(|messages| rename(messages, POSE, "/goal_pose"));
    } => info(Topic("/goal_pose"), What::None);
    TIM005 stamps_that_stand_still: |log| {
        log.edit = Some(|messages| crate::checks::recording::freeze(messages, POSE));
    } => warning(Topic(POSE), What::None);
    TIM005 stamps_of_four_thousand_million_nanoseconds: |log| {
        log.edit = Some(|messages| {
            let of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            for message in of_pose.step_by(20) {
                let second = (message.log_ns / 1_000_000_000) as u32;
                let stamp = [second.to_le_bytes(), u32::MAX.to_le_bytes()].concat();
                set_stamp(message, stamp.try_into().expect("eight bytes"));
            }
        });
    } => warning(Topic(POSE), What::None);
    TIM005 stamps_that_run_backward: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                let second = (4_000_000_000 - message.log_ns / 10_000_000 % 1_000_000_000) as u32;
                let stamp = [second.to_le_bytes(), [0; 4]].concat();
                set_stamp(message, stamp.try_into().expect("eight bytes"));
            }
        });
    } => warning(Topic(POSE), What::None);
    TIM005 one_stamp_that_is_zero: |log| {
        log.edit = Some(|messages| {
            let mut of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            set_stamp(of_pose.nth(100).expect("a pose"), [0; 8]);
        });
    } => info(Topic(POSE), What::None);
    TIM005 the_first_stamp_of_a_simulation: |log| {
        log.edit = Some(|messages| {
            let mut of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            set_stamp(of_pose.next().expect("a pose"), [0; 8]);
        });
    } => Sound;
    TIM005 two_stamps_that_are_zero: |log| {
        log.edit = Some(|messages| {
            let of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            of_pose.skip(100).take(2).for_each(|message| set_stamp(message, [0; 8]));
        });
    } => warning(Topic(POSE), What::None);
    TIM005 stamps_that_advance_are_sound: |log| log.run.pose.timing.phase_s = 0.0 => Sound;
    TIM005 another_clock_is_no_missing_stamp: |log| log.run.imu.timing.clock_offset_s = -1.78e9
        => BlamedOn("TIM003");
    TIM005 no_stream_to_stamp: |log| without_streams(&mut log.run) => Skipped("no");
}

/// A topic whose name does not indicate its role.
const TRACKER: &str = "/tracker/rigid_body";

fn rename(messages: &mut [Message], from: &str, to: &str) {
    for message in messages.iter_mut().filter(|message| message.topic == from) {
        message.topic = to.to_owned();
    }
}

/// Moves all stamps to a clock that is ahead of the recorder's by `offset_s`.
fn on_clock(run: &mut Scenario, offset_s: f64) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.clock_offset_s = offset_s;
    }
}

/// All sample indices.
fn every() -> Vec<usize> {
    (0..10_000).collect()
}

pub(crate) fn without_streams(run: &mut Scenario) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.rate_hz = 0.0;
    }
}

#[test]
fn an_arm_at_rest_may_be_silent_about_it() {
    let report = Log::with(|log| {
        log.run.motion = Motion::AtRest;
        log.edit = Some(|messages| {
            cut_out(messages, POSE, 3.0, 4.7);
            cut_out(messages, POSE, 5.5, 9.0);
        });
    })
    .audited();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    let is_poses = |code: &str| {
        let rows = report.checks.iter().filter(move |row| row.code == code);
        rows.filter(|row| row.subject.label() == POSE).map(|row| row.status).collect::<Vec<_>>()
    };
    assert_eq!([is_poses("TIM002"), is_poses("TIM006")], [[Status::Pass], [Status::Pass]]);
}

/// Resets the clock of all streams to the start after `after_s`, like a simulator reset.
fn reset(messages: &mut [Message], after_s: f64) {
    restamp(messages, "", after_s, f64::MAX, -after_s);
}

/// Findings other than the remark that the restarted clock is not the recorder's.
fn faults(report: &Report) -> Vec<&Finding> {
    let faults = report.findings.iter().filter(|finding| finding.severity > Severity::Info);
    faults.collect()
}

#[test]
fn a_clock_that_begins_anew_splits_the_run() {
    let split = Log::with(|log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| reset(messages, 12.0));
    })
    .audited();
    assert!(faults(&split).is_empty(), "{}", summary(&split.findings));
    assert_eq!(split.verdict, Verdict::Pass);
    assert!(split.log.notes[0].note.contains("2 segments"), "{:?}", split.log.notes);
    let remark = the(&split, "TIM003", "");
    assert_eq!(remark.evidence.more["segment"]["number"], 2);
    let whole = Log::with(|log| log.run.duration_s = 20.0).audited();
    let counts = |report: &Report| -> Vec<u64> {
        report.streams.iter().map(|stream| stream.count).collect()
    };
    // Static data are in both segments.
    for (count, of_whole) in counts(&split).into_iter().zip(counts(&whole)) {
        assert!(count == of_whole || count == 2 * of_whole, "{count} of {of_whole}");
    }
}

#[test]
fn a_fault_of_one_segment_is_found_in_it() {
    let report = Log::with(|log| {
        log.run.duration_s = 24.0;
        log.edit = Some(|messages| {
            restamp(messages, POSE, 12.0, f64::MAX, 0.020);
            reset(messages, 12.0);
        });
    })
    .audited();
    let [finding] = faults(&report)[..] else { panic!("{}", summary(&report.findings)) };
    assert_eq!((finding.code, finding.subject.label()), ("LAT001", POSE));
    assert_eq!(finding.evidence.more["segment"]["number"], 2);
    let value = finding.estimate.as_ref().and_then(|estimate| estimate.value());
    assert!(value.is_some_and(|value| (value - 0.020).abs() < 0.2e-3), "{finding:#?}");
}

#[test]
fn a_tail_too_short_to_judge_leaves_nothing_open() {
    let report = Log::with(|log| {
        log.run.duration_s = 13.0;
        log.edit = Some(|messages| reset(messages, 12.0));
    })
    .audited();
    assert!(faults(&report).is_empty(), "{}", summary(&report.findings));
    assert_eq!(report.verdict, Verdict::Pass);
    // The poses are too slow to show vibration, and there is no camera.
    let others =
        [&["TIM003", "MOT001", "HEC001", "HEC002", "HEC003"], crate::checks::WITHOUT_INPUT]
            .concat();
    for row in report.checks.iter().filter(|row| !others.contains(&row.code)) {
        assert_eq!(row.status, Status::Pass, "{row:#?}");
    }
}
