use super::parts::rows_by_sender;
use super::*;
use crate::run::Epoch;
use crate::stream::{Columns, JointColumn, JointColumns, PoseColumns};

const MS: i64 = 1_000_000;

/// 100 Hz for 10 s, received 1 ms after the stamps. `edit` returns a row's stamp and receive time, ms.
fn poses(edit: impl Fn(i64) -> Option<(i64, i64)>) -> Columns {
    let mut poses = PoseColumns::default();
    for row in 0..1000 {
        let Some((stamp, received)) = edit(row) else { continue };
        poses.times.push((1_000_000 + stamp) * MS, (1_000_000 + received) * MS, 0);
        poses.xyz.push([row as f64, 0.0, 0.0]);
        poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
    }
    Columns::Poses(vec![poses])
}

fn on_time(row: i64) -> (i64, i64) {
    (10 * row, 10 * row + 1)
}

/// Cadence of the first part, with a joint that moves for 5 s.
fn cadence(columns: &Columns) -> Cadence {
    let clock = StreamClock {
        stream: 0,
        frame: None,
        clock: Clock::Header,
        stamps: HeaderStamps::Sound,
        rows: 0,
        zero: 0,
        begins_at_zero: false,
        out_of_range: 0,
        valid_range: i64::MIN..=i64::MAX,
        log_minus_header_s: Some(1e-3),
        soonest_s: Some(1e-3),
        epoch: Epoch::Common,
        alignment: None,
    };
    let stamps: Vec<Stamp> =
        (0..1000).map(|row| Stamp::from_nanos((1_000_000 + 10 * row) * MS)).collect();
    let position: Vec<f64> = (0..1000).map(|row| 0.01 * f64::from(row.min(500))).collect();
    let (parts, joints) = (split_parts(columns, &[]), vec![(stamps.into(), position.into())]);
    parts[0].cadence(&parts[0].measure_period(&clock, &ArmMotion { joints }))
}

fn missing(cadence: &Cadence) -> usize {
    cadence.missing_rows.iter().map(|hole| hole.count).sum()
}

#[test]
fn a_steady_stream_has_its_period_and_nothing_else() {
    let jittered = |row: i64| Some((10 * row + (row * 7919) % 3, 10 * row + 5));
    for columns in [poses(|row| Some(on_time(row))), poses(jittered)] {
        let found = cadence(&columns);
        assert!(found.period_s.is_some_and(|period_s| (period_s - 0.01).abs() < 1e-4));
        assert_eq!((found.is_regular, found.bunched), (true, 0));
        assert_eq!((found.repeats, found.conflicts), (0, 0));
        assert!(found.missing_rows.is_empty() && found.slow_spans.is_empty(), "{found:?}");
        assert!(found.steps_back.is_empty(), "{found:?}");
    }
}

/// Two seconds for each step of a task and an uneven time for its motion, in whole seconds.
#[test]
fn events_have_no_period() {
    let motion_s = |event: i64| [7, 8, 5, 8, 7, 9, 4, 9, 5, 6][(event % 10) as usize];
    let start_s = |event: i64| -> i64 { (0..event).map(|before| 4 + motion_s(before)).sum() };
    let at_s = |row: i64| start_s(row / 3) + 2 * (row % 3);
    let found = cadence(&poses(|row| Some((1000 * at_s(row), 1000 * at_s(row)))));
    assert!(!found.is_regular, "{found:?}");
    // A sender that loses as many rows.
    let lost = |row: i64| [1, 3, 5, 6].contains(&(row % 9)).then_some((2000 * row, 2000 * row));
    assert!(cadence(&poses(lost)).is_regular);
}

#[test]
fn a_gap_states_whether_the_arm_moves() {
    let silent =
        |from: i64| poses(move |row| (!(from..from + 60).contains(&row)).then(|| on_time(row)));
    for (from, moving) in [(200, true), (700, false)] {
        let found = cadence(&silent(from));
        let [MissingRows { span: stretch, count: 60, is_silent: true }] =
            found.missing_rows.as_slice()
        else {
            panic!("{found:?}")
        };
        assert!((stretch.seconds() - 0.61).abs() < 1e-9, "{stretch:?}");
        assert_eq!(stretch.is_arm_moving, Some(moving));
    }
}

#[test]
fn a_clock_stepped_forward_is_no_silence() {
    let set = |row: i64| {
        let (stamp, received) = on_time(row);
        Some((stamp + if row < 300 { 0 } else { 700 }, received))
    };
    let found = cadence(&poses(set));
    let [MissingRows { is_silent: false, .. }] = found.missing_rows.as_slice() else {
        panic!("{found:?}")
    };
}

#[test]
fn missing_rows_are_counted_and_late_rows_replace_them() {
    let lossy = cadence(&poses(|row| (row % 20 != 7).then(|| on_time(row))));
    assert_eq!((missing(&lossy), lossy.bunched), (50, 0));
    let late = |row: i64| {
        let (stamp, received) = on_time(row);
        Some((stamp + if row % 20 == 7 { 8 } else { 0 }, received + 8))
    };
    let late = cadence(&poses(late));
    assert_eq!((missing(&late), late.bunched), (50, 50));
    let random = |row: i64| Some((10 * row + (row * 7919) % 97, 10 * row + 100));
    assert!(!cadence(&poses(random)).is_regular);
}

#[test]
fn irregular_waits_are_no_missing_rows() {
    // Waits of 8 to 20 ms, mostly 10 ms.
    let waits = |row: i64| match (row * 7919) % 20 {
        0..14 => 10,
        14..17 => 13,
        17..19 => 16,
        _ => 20,
    };
    let at = |row: i64| (0..row).map(waits).sum::<i64>();
    let waiting = cadence(&poses(|row| Some((at(row), at(row) + 1))));
    assert_eq!(missing(&waiting), 0, "{waiting:?}");
    let stalled =
        cadence(&poses(|row| Some((at(row) + 300 * i64::from(row >= 400), at(row) + 301))));
    let [hole] = stalled.missing_rows.as_slice() else { panic!("{stalled:?}") };
    assert!((hole.span.seconds() - 0.31).abs() < 0.02, "{hole:?}");
}

#[test]
fn a_lower_rate_for_seconds_is_a_slow_span() {
    let slow = |row: i64| (row < 600 || row % 4 == 0).then(|| on_time(row));
    let found = cadence(&poses(slow));
    let [stretch] = found.slow_spans.as_slice() else { panic!("{found:?}") };
    assert!((stretch.rate_hz - 25.0).abs() < 1.0 && stretch.seconds() > 3.5, "{stretch:?}");
    // Here every interval is long on its own.
    let crawls = |row: i64| (row < 700 || row % 20 == 0).then(|| on_time(row));
    let found = cadence(&poses(crawls));
    let [stretch] = found.slow_spans.as_slice() else { panic!("{found:?}") };
    assert!((stretch.rate_hz - 5.0).abs() < 0.5, "{stretch:?}");
}

#[test]
fn stamps_are_compared_in_receive_order() {
    let back = |row: i64| {
        let (stamp, received) = on_time(row);
        Some((stamp - if (300..330).contains(&row) { 407 } else { 0 }, received))
    };
    let found = cadence(&poses(back));
    let [(at, by_s)] = found.steps_back.as_slice() else { panic!("{found:?}") };
    assert_eq!(at.nanos(), (1_000_000 + 2990) * MS);
    assert!((by_s - 0.397).abs() < 1e-9, "{by_s}");
    assert_eq!(found.set_back, 1);
    // Two swapped stamps step back by one period.
    let swapped = |row: i64| {
        let (stamp, received) = on_time(row);
        Some((stamp, received + if row == 500 { 15 } else { 0 }))
    };
    let found = cadence(&poses(swapped));
    let [(_, by_s)] = found.steps_back.as_slice() else { panic!("{found:?}") };
    assert!((by_s - 0.01).abs() < 1e-9, "{by_s}");
    assert_eq!(found.set_back, 0);
}

#[test]
fn a_stamp_that_stands_still_is_held_and_an_old_row_in_the_place_of_a_new_one_is_stale() {
    let held = |row: i64| Some((10 * row.min(500), 10 * row + 1));
    assert_eq!(cadence(&poses(held)).held, 498);
    let resent = |row: i64| {
        let (stamp, received) = on_time(row);
        Some((stamp - if row % 100 == 50 { 60 } else { 0 }, received))
    };
    let mut columns = poses(resent);
    if let Columns::Poses(poses) = &mut columns {
        poses[0].xyz.update(|_| [0.0; 3]);
    }
    let found = cadence(&columns);
    assert_eq!((found.held, found.stale, found.repeats, missing(&found)), (0, 10, 10, 10));
}

#[test]
fn identical_repeats_do_not_hold_a_stamp() {
    // Four copies of each message, and a second publisher in every hundredth row.
    let mut columns = poses(|row| Some((40 * (row / 4), 10 * row + 1)));
    if let Columns::Poses(poses) = &mut columns {
        let relayed = |row: f64| if row % 100.0 == 49.0 { -1.0 } else { (row / 4.0).floor() };
        poses[0].xyz.update(|[row, y, z]| [relayed(row), y, z]);
    }
    let found = cadence(&columns);
    assert_eq!((found.conflicts, found.held, found.repeats), (10, 0, 740));
}

#[test]
fn a_stamp_used_twice_is_a_repeat_or_a_conflict() {
    let mut columns = poses(|row| {
        let (stamp, received) = on_time(row);
        Some((stamp - if row % 100 == 50 { 10 } else { 0 }, received))
    });
    let found = cadence(&columns);
    assert_eq!((found.repeats, found.conflicts, missing(&found)), (0, 10, 10));
    if let Columns::Poses(poses) = &mut columns {
        poses[0].xyz.update(|_| [0.0; 3]);
    }
    let found = cadence(&columns);
    assert_eq!((found.repeats, found.conflicts), (10, 0));
}

#[test]
fn two_senders_on_one_topic_are_separated() {
    let mut columns = JointColumns::default();
    for name in ["arm", "finger"] {
        columns.joints.push(JointColumn { name: name.to_owned(), ..JointColumn::default() });
    }
    for row in 0..300 {
        let of_arm = row % 3 != 0;
        columns.times.push(10 * row * MS, 10 * row * MS, 0);
        let values = if of_arm { [0.1, f64::NAN] } else { [f64::NAN, 0.2] };
        for (joint, value) in columns.joints.iter_mut().zip(values) {
            joint.position.push(value);
            joint.velocity.push(f64::NAN);
        }
    }
    let rows: Vec<usize> = rows_by_sender(&columns).iter().map(Vec::len).collect();
    assert_eq!(rows, [100, 200]);
}
