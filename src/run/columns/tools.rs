//! Compares commanded and measured tool positions of a table: delay, and offset at rest. Needs no arm.

use crate::log::{Log, Note, Topic};
use crate::run::joint_order::TABLE;
use crate::run::role::{Role, array_role};
use crate::stream::Columns;

use super::cells::join_tables;

/// Number of coordinates, first in a pose.
const POSITION_COORDINATES: usize = 3;
/// Maximum residual of a followed coordinate, as a share of its spread.
const MAX_MATCH_RESIDUAL: f64 = 0.02;

/// Notes delay and rest offset of each coordinate that follows its command, given exactly one measured and
/// one commanded position.
pub(super) fn compare_commanded_position(log: &mut Log) {
    let of = |is_command: bool| -> Option<&Topic> {
        let mut own = log.topics.iter().filter(|topic| {
            let role = array_role(&topic.name, 2 * POSITION_COORDINATES, false).0;
            is_named_pose(topic) && (role == Role::Reference) == is_command
        });
        own.next().filter(|_| own.next().is_none())
    };
    let Some((measured, commanded)) = of(false).zip(of(true)) else { return };
    let Some(sheet) = join_tables(&[(measured, 1.0), (commanded, 1.0)]) else { return };
    let first = measured.cells.len();
    let of_axis = |axis: usize| -> Option<String> {
        let (apart, rows) = sheet.offset_at_rest(axis, first + axis)?;
        let shift = sheet.shift_with_offset(axis, first + axis, apart)?;
        let by = -1e3 * shift.delay_s;
        (shift.residual < MAX_MATCH_RESIDUAL).then(|| {
            format!(
                "{} {} {} by {:.0} ms; offset at rest {apart:+.3} in its own unit ({rows} rows)",
                measured.cells[axis].name,
                if by < 0.0 { "leads" } else { "follows" },
                commanded.cells[axis].name,
                by.abs()
            )
        })
    };
    let found: Vec<String> = (0..POSITION_COORDINATES).filter_map(of_axis).collect();
    let what = found.join("; ");
    let file = log.files.first().map(|file| file.path.clone());
    if let Some(file) = file.filter(|_| !what.is_empty()) {
        log.notes.push(Note { file, what });
    }
}

fn is_named_pose(topic: &Topic) -> bool {
    let is_pose = match &topic.columns {
        Some(Columns::Array(array)) => !array.unnamed && matches!(array.width, 6 | 7),
        Some(Columns::Poses(_)) => true,
        _ => false,
    };
    topic.encoding == TABLE && is_pose && topic.cells.len() >= POSITION_COORDINATES
}
