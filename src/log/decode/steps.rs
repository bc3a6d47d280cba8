//! Steps that read a CDR or ROS 1 message, compiled from a schema and a recipe.

mod compile;
mod op;
mod shape;

use self::compile::{Compiler, Wire};
use self::op::{Op, Step};
use super::cursor::{Cursor, EncapsulationError, Layout};
use super::fault::{Append, DecodeError};
use super::recipes::Fields;
use super::row::Row;
use super::schema::{Schema, SchemaError};

pub(super) use self::shape::Shape;

/// Reads the wanted fields of a message and skips the others, in one pass.
#[derive(Debug)]
pub(crate) struct Plan {
    serialization: Serialization,
    /// Steps for consecutive values without lengths.
    plain: Vec<Step>,
    /// For CDR version 2, with lengths between the values; empty for ROS 1.
    delimited: Vec<Step>,
    /// The message itself is the row; otherwise an [`Op::Repeat`] has rows.
    whole: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Serialization {
    /// Packed, little-endian, without a header.
    Ros1,
    /// In the version given by the header of each message.
    Cdr,
}

impl Plan {
    /// Each element of the array `each`, if given, becomes a row.
    pub(super) fn compile(
        schema: &Schema,
        fields: Fields,
        each: Option<&'static str>,
        serialization: Serialization,
    ) -> Result<Self, SchemaError> {
        let steps = |wire| Compiler::new(schema, fields, each, wire).compile();
        let (plain, delimited) = match serialization {
            Serialization::Ros1 => (steps(Wire::Ros1)?, Vec::new()),
            Serialization::Cdr => (steps(Wire::Cdr)?, steps(Wire::Cdr2)?),
        };
        Ok(Self { serialization, plain, delimited, whole: each.is_none() })
    }

    pub(super) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        let mut cursor = self.cursor(message)?;
        // `row` is borrowed mutably.
        let mut shape = row.shape.take().unwrap_or_default();
        let result = self.read(message, &mut cursor, row, &mut shape, append);
        row.shape = Some(shape);
        result
    }

    /// Uses the shape of the previous message if it is the same; otherwise the steps.
    fn read<'p>(
        &'p self,
        message: &[u8],
        cursor: &mut Cursor<'_>,
        row: &mut Row,
        shape: &mut Shape,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        if shape.is_of(message) {
            return shape.read(message, cursor, row, append);
        }
        shape.forget();
        walk(self.steps(cursor), cursor, row, append)?;
        if self.whole {
            append(row)?;
        }
        if shape.is_wanted() {
            let first = self.cursor(message)?;
            shape.take(self.steps(&first), first, self.whole, message);
        }
        Ok(())
    }

    fn cursor<'m>(&self, message: &'m [u8]) -> Result<Cursor<'m>, EncapsulationError> {
        match self.serialization {
            Serialization::Ros1 => Ok(Cursor::ros1(message)),
            Serialization::Cdr => Cursor::cdr(message),
        }
    }

    fn steps(&self, cursor: &Cursor<'_>) -> &[Step] {
        match cursor.layout() {
            Layout::Packed | Layout::Cdr => &self.plain,
            Layout::Cdr2 { .. } => &self.delimited,
        }
    }
}

fn walk<'p>(
    steps: &'p [Step],
    cursor: &mut Cursor<'_>,
    row: &mut Row,
    append: &mut Append<'_>,
) -> Result<(), DecodeError<'p>> {
    for Step { op, field } in steps {
        let at = |short| DecodeError::Short { field, short };
        match op {
            Op::Repeat { count, steps, rows } => {
                for index in 0..count.read(cursor).map_err(at)? {
                    walk(steps, cursor, row, append)?;
                    if *rows {
                        row.index = index as usize;
                        append(row)?;
                    }
                }
            }
            Op::Delimited { always, steps } => {
                if *always || cursor.layout() == (Layout::Cdr2 { delimited: true }) {
                    let outside = cursor.enter().map_err(at)?;
                    walk(steps, cursor, row, append)?;
                    cursor.leave(outside);
                } else {
                    walk(steps, cursor, row, append)?;
                }
            }
            _ => op.run(cursor, row).map_err(at)?,
        }
    }
    Ok(())
}
