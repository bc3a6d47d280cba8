//! TIM: clocks and stamps.

use poseaudit::synth::{IMU, POSE, Scenario};

use crate::case::What::{self, About, Amount};
use crate::case::{Expected, On, cases, info, warning};
use Expected::{BlamedOn, Skipped, Sound};
use On::{Run, Topic};

cases! {
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
    TIM005 stamps_that_stand_still: |log| {
        log.edit = Some(|messages| crate::recording::freeze(messages, POSE));
    } => warning(Topic(POSE), What::None);
    TIM005 stamps_that_advance_are_sound: |log| log.run.pose.timing.phase_s = 0.0 => Sound;
    TIM005 another_clock_is_no_missing_stamp: |log| log.run.imu.timing.clock_offset_s = -1.78e9
        => BlamedOn("TIM003");
    TIM005 no_stream_to_stamp: |log| without_streams(&mut log.run) => Skipped("no");
}

/// Puts all stamps on a clock that is this much ahead of the recorder's, s.
fn on_clock(run: &mut Scenario, offset_s: f64) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.clock_offset_s = offset_s;
    }
}

fn without_streams(run: &mut Scenario) {
    let Scenario { joints, pose, tf, imu, .. } = run;
    for timing in [&mut joints.timing, &mut pose.timing, &mut tf.timing, &mut imu.timing] {
        timing.rate_hz = 0.0;
    }
}
