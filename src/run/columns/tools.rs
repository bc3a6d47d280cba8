//! Commanded positions of a tool beside measured ones, in one table: by how much the tool follows, and how far
//! it is off where both stand still. No arm is needed for that.

use crate::log::{Log, Note, Topic};
use crate::run::by_order::TABLE;
use crate::run::role::{Role, beside_arm};
use crate::stream::Columns;

use super::cells::side_by_side;

/// Numbers of a position, which stand first in a pose.
const POSITION: usize = 3;

/// Says how the one measured position of the table follows the one commanded.
pub(super) fn compare(log: &mut Log) {
    let of = |role: Role| -> Option<&Topic> {
        let mut own = log.topics.iter().filter(|topic| {
            topic.encoding == TABLE && is_named_pose(topic) && beside_arm(&topic.name) == role
        });
        own.next().filter(|_| own.next().is_none())
    };
    let Some((measured, commanded)) = of(Role::Unassigned).zip(of(Role::Reference)) else { return };
    let Some(sheet) = side_by_side(&[(measured, 1.0), (commanded, 1.0)]) else { return };
    let first = measured.cells.len();
    let (own, others) = ([0, 1, 2], [first, first + 1, first + 2]);
    let Some(shift) = sheet.shift(&own, &others) else { return };
    let (by, of) = (-1e3 * shift.later_s, &commanded.name);
    let when = if by < 0.0 { "leads" } else { "follows" };
    let mut what = format!(
        "'{}' {when} '{of}' by {:.0} ms, to within {:.1} % of how far it moves",
        measured.name,
        by.abs(),
        1e2 * shift.left
    );
    if let Some((apart, rows)) = sheet.apart_at_rest(&own, &others) {
        let size = apart.iter().map(|it| it * it).sum::<f64>().sqrt();
        what += &format!("; at rest it is {size:.3} off, in its own unit, by {rows} rows");
    }
    if let Some(file) = log.files.first().map(|file| file.path.clone()) {
        log.notes.push(Note { file, what });
    }
}

/// Whether names say that a topic's numbers are a pose or a position.
fn is_named_pose(topic: &Topic) -> bool {
    let is_pose = match &topic.columns {
        Some(Columns::Array(array)) => !array.unnamed && matches!(array.width, 6 | 7),
        Some(Columns::Poses(_)) => true,
        _ => false,
    };
    is_pose && topic.cells.len() >= POSITION
}
