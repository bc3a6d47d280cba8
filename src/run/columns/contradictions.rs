//! Table columns whose names contradict their numbers.

use crate::diagnosis::NumericTable;
use crate::log::{Log, Note};
use crate::run::joint_order::TABLE;
use crate::stream::{ArrayColumns, Columns, JointColumns};

/// Finds joint topics that hold a unit quaternion in every row, as a pose does. Makes them unnamed numbers
/// and reports the contradiction.
pub(super) fn report_contradictions(log: &mut Log) {
    let Some(file) = log.files.first().map(|file| file.path.clone()) else { return };
    let mut found = Vec::new();
    for topic in log.topics.iter_mut().filter(|topic| topic.encoding == TABLE) {
        let Some(Columns::Joints(joints)) = &topic.columns else { continue };
        let Some(first) = quaternion_in(joints) else { continue };
        found.push(format!(
            "'{}' is named as joint positions, but its numbers {} to {} form a unit quaternion in every row, \
             as in a pose",
            topic.name,
            first + 1,
            first + 4
        ));
        topic.columns = Some(Columns::Array(to_unnamed(joints)));
    }
    let notes = found.into_iter().map(|what| Note { file: file.clone(), what });
    if notes.len() > 0 {
        log.contradictions.get_or_insert_default().extend(notes);
    }
}

fn quaternion_in(joints: &JointColumns) -> Option<usize> {
    let count = joints.joints.len();
    if count < 7 || joints.converted_from_degrees {
        return None;
    }
    let columns: Vec<Vec<f64>> = joints.joints.iter().map(|joint| joint.position.clone()).collect();
    let rows = (0..joints.times.len()).map(|row| row as f64).collect();
    let sheet = NumericTable::new(rows, columns, vec![0; count]);
    [3, 0].into_iter().find(|&at| sheet.is_quaternion([at, at + 1, at + 2, at + 3]))
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
