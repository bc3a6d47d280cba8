//! Table columns whose names contradict their numbers.

use crate::diagnosis::value_range;
use crate::log::{Log, Note};
use crate::run::joint_order::TABLE;
use crate::stream::{ArrayColumns, Columns, JointColumn, JointColumns};

/// Finds joint topics whose rows all hold a unit quaternion. Makes them unnamed numbers
/// and reports the contradiction, unless the file named the columns.
pub(super) fn report_contradictions(log: &mut Log) {
    let Some(file) = log.files.first().map(|file| file.path.clone()) else { return };
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut found = Vec::new();
    for topic in log.topics.iter_mut().filter(|topic| topic.encoding == TABLE) {
        let Some(Columns::Joints(joints)) = &topic.columns else { continue };
        let Some(first) = quaternion_in(joints) else { continue };
        topic.columns = Some(Columns::Array(to_unnamed(joints)));
        // A file may be named after the joint that moves.
        if stem.starts_with(&topic.name) {
            continue;
        }
        found.push(format!(
            "'{}' is named as joint positions, but its numbers {} to {} form a unit quaternion in every row, \
             as in a pose",
            topic.name,
            first + 1,
            first + 4
        ));
    }
    let notes = found.into_iter().map(|what| Note { file: file.clone(), what });
    if notes.len() > 0 {
        log.contradictions.get_or_insert_default().extend(notes);
    }
}

/// Index of the first of four numbers whose norm is 1 in each row, if at least two move: a rotation about one axis moves
/// two.
fn quaternion_in(joints: &JointColumns) -> Option<usize> {
    const MAX_NORM_DEVIATION: f64 = 1e-3;
    const MIN_SPAN: f64 = 0.05;
    const MIN_MOVING: usize = 2;
    if joints.joints.len() < 7 || joints.converted_from_degrees {
        return None;
    }
    let moves = |joint: &&JointColumn| value_range(joint.position.iter().copied()) > MIN_SPAN;
    [3, 0].into_iter().find(|&at| {
        let four = &joints.joints[at..at + 4];
        let norm_squared =
            |row: usize| four.iter().map(|joint| joint.position[row].powi(2)).sum::<f64>();
        (0..joints.times.len()).all(|row| (norm_squared(row) - 1.0).abs() < MAX_NORM_DEVIATION)
            && four.iter().filter(moves).count() >= MIN_MOVING
    })
}

fn to_unnamed(joints: &JointColumns) -> ArrayColumns {
    let row = |row: usize| joints.joints.iter().map(move |joint| joint.position[row]);
    ArrayColumns {
        width: joints.joints.len(),
        values: (0..joints.times.len()).flat_map(row).collect(),
        times: joints.times.clone(),
        not_finite: joints.not_finite,
        unnamed: true,
        ..ArrayColumns::default()
    }
}
