use super::super::cursor::{Cursor, Short};
use super::super::row::Row;
use super::super::schema::{Arity, Primitive, SchemaError};

#[derive(Debug)]
pub(super) struct Step {
    pub(super) op: Op,
    /// Path from the message's root.
    pub(super) field: Box<str>,
}

#[derive(Debug)]
pub(super) enum Op {
    /// Numbers of `size` bytes.
    Skip {
        size: usize,
        count: Count,
    },
    SkipTexts(Count),
    /// Writes to [`Row::seconds`].
    Seconds(Primitive),
    /// Writes to [`Row::nanoseconds`].
    Nanoseconds(Primitive),
    /// Writes to one of [`Row::numbers`].
    Number(Primitive, usize),
    /// Consecutive, into [`Row::numbers`].
    Doubles(std::ops::Range<usize>),
    /// Writes to one of [`Row::lists`].
    List(Primitive, Count, usize),
    /// Writes to one of [`Row::texts`].
    Text(usize),
    /// Writes to [`Row::names`].
    Names(Count),
    /// Loop over the elements of an array.
    Repeat {
        count: Count,
        steps: Vec<Step>,
        rows: bool,
    },
    /// Message with a length prefix: `always`, or if the header of the message declares delimited types.
    Delimited {
        always: bool,
        steps: Vec<Step>,
    },
    /// Fails: the position of the following fields is unknown. Such steps are either trimmed or rejected.
    Unreadable(Box<SchemaError>),
}

/// Number of values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Count {
    /// Given by the schema.
    Fixed(u32),
    /// Length on the wire.
    Wire,
}

impl Op {
    /// The row stays unchanged.
    pub(super) fn is_skip(&self) -> bool {
        match self {
            Op::Skip { .. } | Op::SkipTexts(_) => true,
            Op::Repeat { steps, rows, .. } => !rows && steps.iter().all(|step| step.op.is_skip()),
            Op::Delimited { steps, .. } => steps.iter().all(|step| step.op.is_skip()),
            Op::Unreadable(_) => true,
            _ => false,
        }
    }

    pub(super) fn inner(&self) -> &[Step] {
        match self {
            Op::Repeat { steps, .. } | Op::Delimited { steps, .. } => steps,
            _ => &[],
        }
    }

    /// The plan executes nested steps.
    pub(super) fn run(&self, cursor: &mut Cursor<'_>, row: &mut Row) -> Result<(), Short> {
        match *self {
            Op::Skip { size, count } => {
                let count = count.read(cursor)?;
                cursor.skip(size, count.into())?;
            }
            Op::SkipTexts(count) => {
                for _ in 0..count.read(cursor)? {
                    cursor.text()?;
                }
            }
            Op::Seconds(primitive) => row.seconds = cursor.integer(primitive)?,
            Op::Nanoseconds(primitive) => row.nanoseconds = cursor.integer(primitive)?,
            Op::Number(primitive, index) => row.numbers[index] = cursor.number(primitive)?,
            Op::Doubles(ref range) => cursor.doubles(&mut row.numbers[range.clone()])?,
            Op::List(primitive, count, index) => {
                let count = count.read(cursor)?;
                cursor.numbers(primitive, count, &mut row.lists[index])?;
            }
            Op::Text(index) => row.set_text(index, cursor.text()?),
            Op::Names(count) => {
                row.names.clear();
                for _ in 0..count.read(cursor)? {
                    row.names.push(cursor.text()?);
                }
            }
            Op::Repeat { .. } | Op::Delimited { .. } | Op::Unreadable(_) => {}
        }
        Ok(())
    }
}

impl Count {
    /// Number of values at the cursor.
    pub(super) fn read(self, cursor: &mut Cursor<'_>) -> Result<u32, Short> {
        match self {
            Count::Fixed(count) => Ok(count),
            Count::Wire => cursor.length(),
        }
    }
}

impl From<Arity> for Count {
    fn from(arity: Arity) -> Self {
        match arity {
            Arity::One => Count::Fixed(1),
            Arity::Array(count) => Count::Fixed(count),
            Arity::Sequence => Count::Wire,
        }
    }
}
