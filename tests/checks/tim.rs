//! TIM: clocks and stamps.

use poseaudit::finding::{Finding, Severity, Status};
use poseaudit::report::{Report, Verdict};
use poseaudit::synth::{IMU, JOINT_STATES, Motion, POSE, Scenario, TF};

use crate::checks::case::ExpectedEstimate::{self, Amount, AmountWithoutInterval};
use crate::checks::case::{
    Expected, ExpectedSubject, Log, cases, error, info, single_finding, summary, warning,
};
use crate::checks::recording::{
    Message, displace, drop_messages, freeze_joints, freeze_samples, lose_target, rename_topic,
    repeat_samples, set_stamp, shift_stamps,
};
use Expected::{NoFindings, OnlyOtherFinding, Skipped};
use ExpectedSubject::{Run, Topic};

cases! {
    TIM001 a_clock_that_is_set_back: |log| {
        log.edit = Some(|messages| shift_stamps(messages, IMU, 4.0, 4.02, -0.4037));
    } => warning(Topic(IMU), AmountWithoutInterval(0.39, 0.03));
    TIM001 a_clock_that_is_set_back_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.edit = Some(|messages| shift_stamps(messages, IMU, 4.0, 4.02, -0.4037));
    } => warning(Topic(IMU), AmountWithoutInterval(0.39, 0.03));
    TIM001 increasing_stamps_pass: |log| log.run.imu.timing.phase_s = 0.0 => NoFindings;
    TIM001 a_late_pose_is_not_reported_as_clock_reset: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    TIM001 no_stream_for_clock_resets: |log| remove_streams(&mut log.run)
        => Skipped("no stamped stream");

    TIM002 a_pose_with_a_gap: |log| {
        log.edit = Some(|messages| drop_messages(messages, POSE, 3.0, 3.7));
    } => warning(Topic(POSE), AmountWithoutInterval(0.72, 0.05));
    TIM002 an_imu_that_loses_5_percent: |log| {
        log.edit = Some(|messages| {
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == IMU);
                message.topic != IMU || count % 20 != 7
            });
        });
    } => warning(Topic(IMU), AmountWithoutInterval(0.05, 0.005));
    TIM002 a_tracker_that_loses_5_percent_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.edit = Some(|messages| {
            rename_topic(messages, POSE, TRACKER);
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == TRACKER);
                message.topic != TRACKER || count % 20 != 7
            });
        });
    } => warning(Topic(TRACKER), AmountWithoutInterval(0.05, 0.005));
    TIM002 irregular_commands_pass: |log| {
        log.edit = Some(|messages| {
            drop_messages(messages, POSE, 3.0, 5.0);
            rename_topic(messages, POSE, "/goal_pose");
        });
    } => NoFindings;
    TIM002 regular_streams_pass: |log| log.run.pose.timing.rate_hz = 20.0 => NoFindings;
    TIM002 an_early_end_is_not_reported_as_gap: |log| {
        log.edit = Some(|messages| drop_messages(messages, POSE, 6.0, 9.0));
    } => OnlyOtherFinding("TIM006");
    TIM002 no_stream_for_gaps: |log| remove_streams(&mut log.run) => Skipped("no periodic stream");

    TIM004 a_pose_with_stamps_in_equal_pairs: |log| {
        log.edit = Some(|messages| {
            let mut pose = 0;
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                pose += 1;
                if pose % 20 == 0 {
                    message.shift_stamps(-40_000_000);
                }
            }
        });
    } => warning(Topic(POSE), AmountWithoutInterval(0.05, 0.005));
    TIM004 repeated_equal_messages_pass: |log| {
        log.edit = Some(|messages| {
            let mut twice = Vec::new();
            for message in messages.drain(..) {
                let again = message.topic == TF;
                twice.push(message.clone());
                twice.extend(again.then_some(message));
            }
            *messages = twice;
        });
    } => NoFindings;
    TIM004 a_late_pose_is_not_reported_as_equal_stamps: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    TIM004 no_stream_for_equal_stamps: |log| remove_streams(&mut log.run)
        => Skipped("no stamped stream");

    TIM006 a_pose_that_ends_early: |log| {
        log.edit = Some(|messages| drop_messages(messages, POSE, 6.0, 9.0));
    } => warning(Topic(POSE), AmountWithoutInterval(2.0, 0.1));
    TIM006 an_imu_that_begins_late: |log| {
        log.edit = Some(|messages| drop_messages(messages, IMU, -1.0, 2.5));
    } => warning(Topic(IMU), AmountWithoutInterval(2.5, 0.1));
    TIM006 an_imu_that_slows_down: |log| {
        log.edit = Some(|messages| {
            let start_ns = messages[0].log_ns;
            let mut count = 0;
            messages.retain(|message| {
                count += usize::from(message.topic == IMU);
                message.log_ns - start_ns < 5_000_000_000 || message.topic != IMU || count % 3 == 0
            });
        });
    } => warning(Topic(IMU), AmountWithoutInterval(33.3, 1.0));
    TIM006 half_a_second_without_samples_at_the_end_passes: |log| {
        log.edit = Some(|messages| drop_messages(messages, POSE, 7.5, 9.0));
    } => NoFindings;
    TIM006 a_gap_is_not_reported_as_early_end: |log| {
        log.edit = Some(|messages| drop_messages(messages, POSE, 3.0, 3.7));
    } => OnlyOtherFinding("TIM002");
    TIM006 a_late_pose_is_not_reported_as_late_start: |log| log.run.pose.timing.latency_s = 1.5
        => OnlyOtherFinding("LAT001");
    TIM006 no_stream_that_can_end_early: |log| remove_streams(&mut log.run) => Skipped("no stream");

    TIM006 a_pose_stream_with_too_few_samples: |log| {
        log.edit = Some(|messages| displace(messages, POSE, &all_rows(), [f64::NAN; 3]));
    } => warning(Topic(POSE), ExpectedEstimate::None);

    TIM007 a_pose_frozen_for_two_seconds: |log| {
        log.edit = Some(|messages| freeze_samples(messages, POSE, 3.0, 5.0));
    } => error(Topic(POSE), AmountWithoutInterval(1.96, 0.05));
    TIM007 a_pose_frozen_until_the_end: |log| {
        log.edit = Some(|messages| freeze_samples(messages, POSE, 4.0, 9.0));
    } => error(Topic(POSE), AmountWithoutInterval(3.96, 0.05));
    TIM007 a_pose_that_is_always_zero: |log| {
        log.edit = Some(|messages| freeze_samples(messages, POSE, -1.0, 9.0));
    } => error(Topic(POSE), AmountWithoutInterval(7.96, 0.05));
    TIM007 a_tracker_that_loses_its_target: |log| {
        log.run.pose.frame_id = "mocap".to_owned();
        log.edit = Some(|messages| {
            lose_target(messages, POSE, &[(1.5, 2.5), (4.0, 4.6), (5.5, 6.2)]);
            rename_topic(messages, POSE, TRACKER);
        });
    } => error(Topic(TRACKER), AmountWithoutInterval(0.99, 0.05));
    TIM007 a_moving_pose_passes: |log| log.run.pose.timing.rate_hz = 50.0 => NoFindings;
    TIM007 a_resting_arm_is_not_reported_as_frozen: |log| {
        log.run.motion = Motion::AtRest;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
    } => NoFindings;
    TIM007 a_pose_frozen_next_to_a_rest: |log| {
        log.run.motion = Motion::PickAndPlace;
        log.edit = Some(|messages| freeze_samples(messages, POSE, 4.0, 5.0));
    } => error(Topic(POSE), AmountWithoutInterval(0.96, 0.1));
    TIM007 rests_of_a_late_noise_free_pose_pass: |log| {
        log.run.motion = Motion::PickAndPlace;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
        log.run.pose.timing.latency_s = 0.3;
    } => OnlyOtherFinding("LAT001");
    TIM007 rests_of_a_noise_free_pose_with_joints_in_degrees_pass: |log| {
        log.run.motion = Motion::PickAndPlace;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (0.0, 0.0);
        log.run.noise.joints = 2e-4;
        log.run.joints.is_in_degrees = true;
    } => OnlyOtherFinding("ORD004");
    TIM007 a_late_pose_is_not_reported_as_frozen: |log| log.run.pose.timing.latency_s = 1.5
        => OnlyOtherFinding("LAT001");
    TIM007 joint_states_frozen_during_a_motion: |log| {
        log.run.motion = Motion::Continuous;
        log.edit = Some(|messages| freeze_joints(messages, 3.0, 4.5));
    } => error(Topic(JOINT_STATES), AmountWithoutInterval(1.46, 0.1));
    TIM007 joint_states_frozen_until_the_end: |log| {
        log.run.motion = Motion::Continuous;
        log.edit = Some(|messages| freeze_joints(messages, 5.0, 9.0));
    } => error(Topic(JOINT_STATES), AmountWithoutInterval(2.96, 0.1));
    TIM007 no_stream_that_can_freeze: |log| remove_streams(&mut log.run) => Skipped("no");

    TIM008 transforms_repeated_three_times: |log| {
        log.run.tf.timing.rate_hz = 50.0;
        log.edit = Some(|messages| repeat_samples(messages, TF, 3));
    } => error(Topic(TF), AmountWithoutInterval(0.667, 0.05));
    TIM008 transforms_without_repetitions_pass: |log| log.run.tf.timing.rate_hz = 50.0 => NoFindings;
    TIM008 a_frozen_pose_is_not_reported_as_repeated_samples: |log| {
        log.edit = Some(|messages| freeze_samples(messages, POSE, 3.0, 5.0));
    } => OnlyOtherFinding("TIM007");
    TIM008 no_stream_for_repeated_samples: |log| remove_streams(&mut log.run) => Skipped("no stream");

    TIM003 an_imu_clock_that_starts_at_zero: |log| log.run.imu.timing.clock_offset_s = -1.78e9
        => warning(Topic(IMU), Amount(-1.78e9, 0.005));
    TIM003 a_pose_clock_one_hour_ahead: |log| log.run.pose.timing.clock_offset_s = 3600.0
        => warning(Topic(POSE), Amount(3600.0, 0.005));
    TIM003 all_streams_on_another_clock_than_the_recorder: |log| set_clock_offset(&mut log.run, -1.7e9)
        => info(Run, AmountWithoutInterval(-1.7e9, 0.005));
    TIM003 one_second_is_not_reported_as_another_clock: |log| set_clock_offset(&mut log.run, 1.0) => NoFindings;
    TIM003 a_late_pose_is_on_the_same_clock: |log| log.run.pose.timing.latency_s = 1.5
        => OnlyOtherFinding("LAT001");
    TIM003 zero_stamps_are_not_reported_as_another_clock: |log| log.run.pose.timing.has_stamps = false
        => OnlyOtherFinding("TIM005");
    TIM003 no_stream_with_a_clock: |log| remove_streams(&mut log.run) => Skipped("no stamped stream");

    TIM005 a_pose_without_stamps: |log| log.run.pose.timing.has_stamps = false
        => warning(Topic(POSE), ExpectedEstimate::None);
    TIM005 an_imu_without_stamps: |log| log.run.imu.timing.has_stamps = false
        => warning(Topic(IMU), ExpectedEstimate::None);
    TIM005 a_tracker_without_stamps_in_a_log_without_joints: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.pose.timing.has_stamps = false;
        log.edit = Some(|messages| rename_topic(messages, POSE, TRACKER));
    } => warning(Topic(TRACKER), ExpectedEstimate::None);
    TIM005 commands_stamped_zero_pass: |log| {
        log.run.pose.timing.has_stamps = false;
        log.edit = Some(|messages| rename_topic(messages, POSE, "/goal_pose"));
    } => info(Topic("/goal_pose"), ExpectedEstimate::None);
    TIM005 constant_stamps: |log| {
        log.edit = Some(|messages| crate::checks::recording::freeze_stamps(messages, POSE));
    } => warning(Topic(POSE), ExpectedEstimate::None);
    TIM005 stamps_with_impossible_nanoseconds: |log| {
        log.edit = Some(|messages| {
            let of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            for message in of_pose.step_by(20) {
                let second = (message.log_ns / 1_000_000_000) as u32;
                let stamp = [second.to_le_bytes(), u32::MAX.to_le_bytes()].concat();
                set_stamp(message, stamp.try_into().expect("eight bytes"));
            }
        });
    } => warning(Topic(POSE), ExpectedEstimate::None);
    TIM005 decreasing_stamps: |log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                let second = (4_000_000_000 - message.log_ns / 10_000_000 % 1_000_000_000) as u32;
                let stamp = [second.to_le_bytes(), [0; 4]].concat();
                set_stamp(message, stamp.try_into().expect("eight bytes"));
            }
        });
    } => warning(Topic(POSE), ExpectedEstimate::None);
    TIM005 one_zero_stamp: |log| {
        log.edit = Some(|messages| {
            let mut of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            set_stamp(of_pose.nth(100).expect("a pose"), [0; 8]);
        });
    } => info(Topic(POSE), ExpectedEstimate::None);
    TIM005 the_first_stamp_of_a_simulation: |log| {
        log.edit = Some(|messages| {
            let mut of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            set_stamp(of_pose.next().expect("a pose"), [0; 8]);
        });
    } => NoFindings;
    TIM005 two_zero_stamps: |log| {
        log.edit = Some(|messages| {
            let of_pose = messages.iter_mut().filter(|message| message.topic == POSE);
            of_pose.skip(100).take(2).for_each(|message| set_stamp(message, [0; 8]));
        });
    } => warning(Topic(POSE), ExpectedEstimate::None);
    TIM005 advancing_stamps_pass: |log| log.run.pose.timing.phase_s = 0.0 => NoFindings;
    TIM005 another_clock_is_not_reported_as_missing_stamps: |log| log.run.imu.timing.clock_offset_s = -1.78e9
        => OnlyOtherFinding("TIM003");
    TIM005 no_stream_with_stamps: |log| remove_streams(&mut log.run) => Skipped("no");
}

/// A topic whose name does not indicate its role.
const TRACKER: &str = "/tracker/rigid_body";

/// Moves all stamps to a clock that is ahead of the recorder's by `offset_s`.
fn set_clock_offset(run: &mut Scenario, offset_s: f64) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.clock_offset_s = offset_s;
    }
}

/// All sample indices.
fn all_rows() -> Vec<usize> {
    (0..10_000).collect()
}

pub(crate) fn remove_streams(run: &mut Scenario) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.rate_hz = 0.0;
    }
}

#[test]
fn gaps_of_poses_at_rest_pass() {
    let report = Log::modified(|log| {
        log.run.motion = Motion::AtRest;
        log.edit = Some(|messages| {
            drop_messages(messages, POSE, 3.0, 4.7);
            drop_messages(messages, POSE, 5.5, 9.0);
        });
    })
    .report();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    let statuses_of_pose = |code: &str| {
        let rows = report.checks.iter().filter(move |row| row.code == code);
        rows.filter(|row| row.subject.label() == POSE).map(|row| row.status).collect::<Vec<_>>()
    };
    assert_eq!(
        [statuses_of_pose("TIM002"), statuses_of_pose("TIM006")],
        [[Status::Pass], [Status::Pass]]
    );
}

#[test]
fn points_measured_at_rest_may_pause() {
    let report = Log::modified(|log| {
        log.run.joints.timing.rate_hz = 0.0;
        (log.run.duration_s, log.run.pose.timing.rate_hz) = (120.0, 0.5);
        log.edit = Some(|messages| {
            rename_topic(messages, POSE, TRACKER);
            drop_messages(messages, TRACKER, 40.0, 80.0);
        });
    })
    .report();
    let rows = report.checks.iter().filter(|row| row.code == "TIM002");
    let of_tracker = rows.filter(|row| row.subject.label() == TRACKER);
    assert_eq!(of_tracker.map(|row| row.status).collect::<Vec<_>>(), [Status::Skipped]);
}

/// Resets the clock of all streams to the start after `after_s`, like a simulator reset.
fn restart_clock(messages: &mut [Message], after_s: f64) {
    shift_stamps(messages, "", after_s, f64::MAX, -after_s);
}

/// Findings other than the remark that the restarted clock is not the recorder's.
fn faults(report: &Report) -> Vec<&Finding> {
    let faults = report.findings.iter().filter(|finding| finding.severity > Severity::Info);
    faults.collect()
}

#[test]
fn a_clock_restart_splits_the_run() {
    let split = Log::modified(|log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| restart_clock(messages, 12.0));
    })
    .report();
    assert!(faults(&split).is_empty(), "{}", summary(&split.findings));
    assert_eq!(split.verdict, Verdict::Pass);
    assert!(split.log.notes[0].note.contains("2 segments"), "{:?}", split.log.notes);
    let remark = single_finding(&split, "TIM003", "");
    assert_eq!(remark.evidence.more["segment"]["number"], 2);
    let whole = Log::modified(|log| log.run.duration_s = 20.0).report();
    let counts = |report: &Report| -> Vec<u64> {
        report.streams.iter().map(|stream| stream.count).collect()
    };
    // Static data are in both segments.
    for (count, of_whole) in counts(&split).into_iter().zip(counts(&whole)) {
        assert!(count == of_whole || count == 2 * of_whole, "{count} of {of_whole}");
    }
}

#[test]
fn a_fault_of_one_segment_is_found_in_that_segment() {
    let report = Log::modified(|log| {
        log.run.duration_s = 24.0;
        log.edit = Some(|messages| {
            shift_stamps(messages, POSE, 12.0, f64::MAX, 0.020);
            restart_clock(messages, 12.0);
        });
    })
    .report();
    let [finding] = faults(&report)[..] else { panic!("{}", summary(&report.findings)) };
    assert_eq!((finding.code, finding.subject.label()), ("LAT001", POSE));
    assert_eq!(finding.evidence.more["segment"]["number"], 2);
    let value = finding.estimate.as_ref().and_then(|estimate| estimate.value());
    assert!(value.is_some_and(|value| (value - 0.020).abs() < 0.2e-3), "{finding:#?}");
}

#[test]
fn a_last_segment_too_short_to_judge_leaves_nothing_inconclusive() {
    let report = Log::modified(|log| {
        log.run.duration_s = 13.0;
        log.edit = Some(|messages| restart_clock(messages, 12.0));
    })
    .report();
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
