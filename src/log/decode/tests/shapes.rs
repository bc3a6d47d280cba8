//! Decoding does not depend on previous messages.

use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::*;
use super::cdr;
use crate::testing::{self, Cdr};
use ground::stream::Columns;

/// Also returns the number of errors. `one_row` serves all messages.
fn decoded(
    type_name: &str,
    schema: &str,
    messages: &[Vec<u8>],
    one_row: bool,
) -> (Vec<(&'static str, Option<Columns>)>, usize) {
    let recipe = Recipe::for_type(type_name).unwrap();
    let plan = cdr(type_name, schema).plan(recipe).unwrap();
    let (mut builder, mut row, mut failed) = (recipe.builder(), Row::default(), 0);
    for (index, message) in messages.iter().enumerate() {
        if !one_row {
            row = Row::default();
        }
        let times = RowTimes { log: index as i64, publish: 0, sequence: 0 };
        let mut append = |row: &Row| builder.append(row, times);
        failed += usize::from(plan.decode(message, &mut row, &mut append).is_err());
    }
    (builder.finalize(), failed)
}

/// Over long runs of one kind, rapid changes and truncated messages.
fn assert_alike(type_name: &str, schema: &str, of_kind: impl Fn(usize, &mut Pcg64) -> Vec<u8>) {
    let mut random = Pcg64::seed_from_u64(7);
    for longest in [1, 3, 40] {
        let mut messages = Vec::new();
        while messages.len() < 300 {
            let kind = random.random_range(0..6);
            for _ in 0..random.random_range(0..=longest) {
                let mut message = of_kind(kind, &mut random);
                if random.random_ratio(1, 20) {
                    message.truncate(random.random_range(0..message.len()));
                }
                messages.push(message);
            }
        }
        let alone = decoded(type_name, schema, &messages, false);
        let after_others = decoded(type_name, schema, &messages, true);
        assert!(alone.1 > 0 && alone.1 < messages.len() / 4, "{}", alone.1);
        assert_eq!(format!("{after_others:?}"), format!("{alone:?}"), "{type_name}, {longest}");
    }
}

fn numbers(count: usize, random: &mut Pcg64) -> Vec<f64> {
    (0..count).map(|_| random.random()).collect()
}

#[test]
fn joint_states_decode_independently_of_previous_messages() {
    assert_alike("sensor_msgs/msg/JointState", testing::JOINT_STATE, |kind, random| {
        let names: &[&str] =
            [&["a", "b"][..], &["b", "a"], &["a", "c"], &["a"], &[], &["ab", ""]][kind];
        let velocities = names.len() * usize::from(kind % 2 == 0);
        let (q, qd) = (numbers(names.len(), random), numbers(velocities, random));
        // Different byte order; frame of different length.
        let message = if kind == 5 { Cdr::big() } else { Cdr::little() };
        let frame = if kind == 1 { "arm" } else { "base_link" };
        let header = message.header(random.next_u32(), random.next_u32(), frame);
        header.texts(names).list(&q).list(&qd).u32(0).done()
    });
}

#[test]
fn poses_decode_independently_of_previous_messages() {
    assert_alike("geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED, |kind, random| {
        let frame = ["base", "bass", "", "/base", "a longer frame", "world"][kind];
        let header = Cdr::little().header(random.next_u32(), 0, frame);
        header.all(&numbers(7, random)).done()
    });
}

#[test]
fn transforms_decode_independently_of_previous_messages() {
    let frames = ["a", "b", "c", "d"];
    assert_alike("tf2_msgs/msg/TFMessage", testing::TF_MESSAGE, |kind, random| {
        // Same frames in a different order, equal lengths, more frames, none.
        let children: &[usize] = [&[1, 2, 3][..], &[3, 2, 1], &[1, 1, 1], &[1, 2], &[], &[2]][kind];
        let mut message = Cdr::little().u32(children.len() as u32);
        for &child in children {
            let parent = frames[child - 1];
            message = message.header(random.next_u32(), 0, parent).text(frames[child]);
            message = message.all(&numbers(7, random));
        }
        message.done()
    });
}

#[test]
fn two_publishers_whose_schemas_differ_share_the_frames_of_a_topic() {
    let type_name = "tf2_msgs/msg/TFMessage";
    let recipe = Recipe::for_type(type_name).unwrap();
    let plan = cdr(type_name, testing::TF_MESSAGE).plan(recipe).unwrap();
    let (mut builder, mut rows) = (recipe.builder(), [Row::default(), Row::default()]);
    for index in 0..60 {
        let children = [["b", "c"], ["c", "b"]][index % 2];
        let mut message = Cdr::little().u32(2);
        for child in children {
            let x = if child == "b" { 1.0 } else { 2.0 };
            message = message.header(0, 1, "a").text(child).all(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        }
        let times = RowTimes { log: index as i64, publish: 0, sequence: 0 };
        let mut append = |row: &Row| builder.append(row, times);
        plan.decode(&message.done(), &mut rows[index % 2], &mut append).unwrap();
    }
    let mut parts = builder.finalize();
    let Some(Columns::Transforms(groups)) = parts.remove(0).1 else { panic!("transforms") };
    let found: Vec<(&str, usize)> =
        groups.iter().map(|group| (group.child_frame_id.as_str(), group.xyz.len())).collect();
    assert_eq!(found, [("b", 60), ("c", 60)]);
    assert!(groups[0].xyz.iter().all(|xyz| xyz[0] == 1.0));
    assert!(groups[1].xyz.iter().all(|xyz| xyz[0] == 2.0));
}
