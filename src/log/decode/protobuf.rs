//! Protocol buffers, decoded with the descriptors in the log.
//!
//! Looks up field numbers by name once per channel, then reads messages sequentially (protobuf.dev,
//! "Encoding"). Skips unknown fields. A missing field has its proto3 default: zero or empty.

mod descriptor;
mod wire;

use super::fault::{Append, DecodeError};
use super::recipes::{Fields, is_below};
use super::row::{Row, Slot};
use super::schema::SchemaError;

pub(super) use self::descriptor::Types;
use self::descriptor::{Field, Kind, Message, Scalar};
use self::wire::Fault;
pub(crate) use self::wire::{Reader, Value, WireError};

/// Wanted fields as a tree of field numbers.
#[derive(Debug)]
pub(crate) struct Plan {
    root: Vec<WantedField>,
    /// Reset before a message; `row_slots` before each row.
    slots: Vec<Slot>,
    row_slots: Vec<Slot>,
    has_rows: bool,
    has_vectors: bool,
}

#[derive(Debug)]
struct WantedField {
    number: u32,
    /// Path from the root.
    path: Box<str>,
    what: FieldTarget,
}

#[derive(Debug)]
enum FieldTarget {
    Seconds(Scalar),
    Nanoseconds(Scalar),
    Number(Scalar, usize),
    List(Scalar, usize),
    Text(usize),
    Names,
    Message(Vec<WantedField>),
    /// Repeated message, one row each.
    Rows(Vec<WantedField>),
}

#[derive(Debug, Default)]
struct FoundCounts {
    rows: usize,
    /// Messages with wanted numbers, such as a position, in the whole message or one row.
    vectors: usize,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Pass {
    /// Outside rows.
    Shared,
    Rows,
}

impl Plan {
    /// Each element of the array `each`, if given, becomes a row.
    pub(super) fn compile(
        types: &Types,
        type_name: &str,
        fields: Fields,
        each: Option<&'static str>,
    ) -> Result<Self, SchemaError> {
        let message = types
            .message(type_name)
            .ok_or_else(|| SchemaError::NoRoot { type_name: type_name.to_owned() })?;
        let fields: Vec<_> = fields.iter().collect();
        let root = Compiler { types, each }.message(message, "", &fields)?;
        let is_in_row = |path: &str| each.is_some_and(|each| is_below(path, each));
        let in_row = fields.iter().filter(|(path, _)| is_in_row(path));
        Ok(Self {
            has_vectors: has_vectors(&root),
            root,
            row_slots: in_row.map(|(_, slot)| *slot).collect(),
            slots: fields.iter().map(|(_, slot)| *slot).collect(),
            has_rows: each.is_some(),
        })
    }

    pub(super) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        self.slots.iter().for_each(|&slot| row.reset(slot));
        // The rows may precede the fields they share.
        let mut met = FoundCounts::default();
        self.walk(&self.root, Reader::new(message), Pass::Shared, row, append, &mut met)?;
        self.cap_lists(row);
        if self.has_rows {
            self.walk(&self.root, Reader::new(message), Pass::Rows, row, append, &mut met)?;
        } else {
            self.require_vectors(&met, &Reader::new(message))?;
            append(row)?;
        }
        Ok(())
    }

    fn walk(
        &self,
        wanted: &[WantedField],
        mut reader: Reader<'_>,
        pass: Pass,
        row: &mut Row,
        append: &mut Append<'_>,
        met: &mut FoundCounts,
    ) -> Result<(), DecodeError<'static>> {
        while let Some((number, value)) = reader.field()? {
            let Some(WantedField { what, path, .. }) =
                wanted.iter().find(|wanted| wanted.number == number)
            else {
                continue;
            };
            let at = |fault| reader.error(fault).in_field(path);
            match (what, pass) {
                (FieldTarget::Message(wanted), _) => {
                    met.vectors += usize::from(is_vector(wanted));
                    let inner = reader.message(value).map_err(at)?;
                    self.walk(wanted, inner, pass, row, append, met)?;
                }
                (FieldTarget::Rows(wanted), Pass::Rows) => {
                    self.row_slots.iter().for_each(|&slot| row.reset(slot));
                    met.vectors = 0;
                    let inner = reader.message(value).map_err(at)?;
                    self.walk(wanted, inner, Pass::Shared, row, append, met)?;
                    self.require_vectors(met, &reader)?;
                    self.cap_lists(row);
                    row.index = met.rows;
                    met.rows += 1;
                    append(row)?;
                }
                (FieldTarget::Rows(_), Pass::Shared) => {}
                (_, Pass::Rows) => {}
                (what, Pass::Shared) => what.read(value, row).map_err(at)?,
            }
        }
        Ok(())
    }

    /// Without position and rotation all numbers would be zero. One of the two may be missing.
    fn require_vectors(&self, met: &FoundCounts, reader: &Reader<'_>) -> Result<(), WireError> {
        match met.vectors {
            0 if self.has_vectors => Err(reader.error(Fault::Empty)),
            _ => Ok(()),
        }
    }

    fn cap_lists(&self, row: &mut Row) {
        for slot in &self.slots {
            if let Slot::List(index) = *slot {
                row.cap_list(index);
            }
        }
    }
}

fn is_vector(wanted: &[WantedField]) -> bool {
    wanted.iter().any(|wanted| matches!(wanted.what, FieldTarget::Number(..)))
}

fn has_vectors(wanted: &[WantedField]) -> bool {
    wanted.iter().any(|wanted| match &wanted.what {
        FieldTarget::Message(wanted) | FieldTarget::Rows(wanted) => {
            is_vector(wanted) || has_vectors(wanted)
        }
        _ => false,
    })
}

impl FieldTarget {
    /// Reads a field without nested wanted fields.
    fn read(&self, value: Value<'_>, row: &mut Row) -> Result<(), Fault> {
        match *self {
            FieldTarget::Seconds(scalar) => row.seconds = scalar.integer(value)?,
            FieldTarget::Nanoseconds(scalar) => row.nanoseconds = scalar.integer(value)?,
            FieldTarget::Number(scalar, index) => row.numbers[index] = scalar.number(value)?,
            FieldTarget::List(scalar, index) => {
                // Packed into one value, or one value each.
                let Value::Bytes(packed) = value else {
                    row.push(index, scalar.number(value)?);
                    return Ok(());
                };
                let mut reader = Reader::new(packed);
                while let Some(value) = scalar.next(&mut reader)? {
                    row.push(index, scalar.number(value)?);
                }
            }
            FieldTarget::Text(index) => row.set_text(index, value.bytes()?),
            FieldTarget::Names => row.names.push(value.bytes()?),
            FieldTarget::Message(_) | FieldTarget::Rows(_) => {}
        }
        Ok(())
    }
}

impl Scalar {
    fn next<'a>(self, reader: &mut Reader<'a>) -> Result<Option<Value<'a>>, Fault> {
        if reader.is_at_end() {
            return Ok(None);
        }
        Ok(Some(match self {
            Scalar::F64 | Scalar::Fixed64 | Scalar::SignedFixed64 => {
                Value::Fixed64(reader.fixed()?)
            }
            Scalar::F32 | Scalar::Fixed32 | Scalar::SignedFixed32 => {
                Value::Fixed32(reader.fixed()?)
            }
            Scalar::Signed | Scalar::Unsigned | Scalar::Zigzag => Value::Varint(reader.varint()?),
        }))
    }

    fn number(self, value: Value<'_>) -> Result<f64, Fault> {
        Ok(match (self, value) {
            (Scalar::F64, Value::Fixed64(bytes)) => f64::from_le_bytes(bytes),
            (Scalar::F32, Value::Fixed32(bytes)) => f32::from_le_bytes(bytes).into(),
            (Scalar::Unsigned, Value::Varint(bits)) => bits as f64,
            (Scalar::Fixed64, Value::Fixed64(bytes)) => u64::from_le_bytes(bytes) as f64,
            _ => self.integer(value)? as f64,
        })
    }

    /// Saturates; truncates fractions.
    fn integer(self, value: Value<'_>) -> Result<i64, Fault> {
        let saturated = |bits: u64| i64::try_from(bits).unwrap_or(i64::MAX);
        Ok(match (self, value) {
            (Scalar::Signed, Value::Varint(bits)) => bits.cast_signed(),
            (Scalar::Unsigned, Value::Varint(bits)) => saturated(bits),
            (Scalar::Zigzag, Value::Varint(bits)) => {
                (bits >> 1).cast_signed() ^ -(bits & 1).cast_signed()
            }
            (Scalar::Fixed32, Value::Fixed32(bytes)) => u32::from_le_bytes(bytes).into(),
            (Scalar::SignedFixed32, Value::Fixed32(bytes)) => i32::from_le_bytes(bytes).into(),
            (Scalar::Fixed64, Value::Fixed64(bytes)) => saturated(u64::from_le_bytes(bytes)),
            (Scalar::SignedFixed64, Value::Fixed64(bytes)) => i64::from_le_bytes(bytes),
            (Scalar::F64 | Scalar::F32, Value::Fixed64(_) | Value::Fixed32(_)) => {
                self.number(value)? as i64
            }
            _ => return Err(Fault::WireType),
        })
    }
}

struct Compiler<'a> {
    types: &'a Types,
    each: Option<&'static str>,
}

impl Compiler<'_> {
    /// Fields that lead to the wanted ones, whose paths all start with `prefix`.
    fn message(
        &self,
        message: &Message,
        prefix: &str,
        wanted: &[&'static (&'static str, Slot)],
    ) -> Result<Vec<WantedField>, SchemaError> {
        let mut found: Vec<WantedField> = Vec::new();
        for (index, (path, slot)) in wanted.iter().enumerate() {
            let name = name_below(path, prefix);
            let own_path = &path[..path.len() - path[prefix_len(prefix)..].len() + name.len()];
            let is_first =
                wanted[..index].iter().all(|(other, _)| name_below(other, prefix) != name);
            if !is_first {
                continue;
            }
            let field = message.field(name).ok_or(SchemaError::Missing { field: path })?;
            let what = if own_path == *path {
                self.leaf(field, path, *slot)?
            } else {
                let below =
                    |wanted: &&&'static (&'static str, Slot)| name_below(wanted.0, prefix) == name;
                let below: Vec<_> = wanted.iter().filter(below).copied().collect();
                self.branch(field, own_path, &below)?
            };
            found.push(WantedField { number: field.number, path: own_path.into(), what });
        }
        Ok(found)
    }

    fn branch(
        &self,
        field: &Field,
        path: &str,
        wanted: &[&'static (&'static str, Slot)],
    ) -> Result<FieldTarget, SchemaError> {
        let is_rows = self.each == Some(path);
        let (Kind::Message(type_name), true) = (&field.kind, field.is_repeated == is_rows) else {
            let expected = if is_rows { "an array of messages" } else { "a single message" };
            return Err(mismatch(field, path, expected));
        };
        let fields = self.message(self.nested(type_name, path)?, path, wanted)?;
        Ok(if is_rows { FieldTarget::Rows(fields) } else { FieldTarget::Message(fields) })
    }

    fn leaf(&self, field: &Field, path: &str, slot: Slot) -> Result<FieldTarget, SchemaError> {
        Ok(match (slot, &field.kind, field.is_repeated) {
            (Slot::Stamp, Kind::Message(type_name), false) => {
                self.stamp(self.nested(type_name, path)?, field, path)?
            }
            (Slot::Number(index), &Kind::Number(scalar), false) => {
                FieldTarget::Number(scalar, index)
            }
            (Slot::Text(index), Kind::Text, false) => FieldTarget::Text(index),
            (Slot::List(index), &Kind::Number(scalar), true) => FieldTarget::List(scalar, index),
            (Slot::Names, Kind::Text, true) => FieldTarget::Names,
            _ => return Err(mismatch(field, path, slot.expected())),
        })
    }

    /// Message with seconds and nanoseconds, such as `google.protobuf.Timestamp`.
    fn stamp(
        &self,
        message: &Message,
        field: &Field,
        path: &str,
    ) -> Result<FieldTarget, SchemaError> {
        let part = |names: &[&str], what: fn(Scalar) -> FieldTarget| {
            let part = names.iter().find_map(|name| message.field(name))?;
            let Kind::Number(scalar) = part.kind else { return None };
            Some(WantedField { number: part.number, path: path.into(), what: what(scalar) })
        };
        let seconds = part(&["seconds", "secs", "sec"], FieldTarget::Seconds);
        let nanoseconds = part(&["nanos", "nanosec", "nsecs", "nsec"], FieldTarget::Nanoseconds);
        match (seconds, nanoseconds) {
            (Some(seconds), Some(nanoseconds)) => {
                Ok(FieldTarget::Message(vec![seconds, nanoseconds]))
            }
            _ => Err(mismatch(field, path, Slot::Stamp.expected())),
        }
    }

    fn nested(&self, type_name: &str, path: &str) -> Result<&Message, SchemaError> {
        self.types.message(type_name).ok_or_else(|| SchemaError::Undefined {
            field: path.to_owned(),
            type_name: type_name.to_owned(),
        })
    }
}

fn prefix_len(prefix: &str) -> usize {
    if prefix.is_empty() { 0 } else { prefix.len() + 1 }
}

fn name_below<'a>(path: &'a str, prefix: &str) -> &'a str {
    let rest = &path[prefix_len(prefix)..];
    rest.split('.').next().unwrap_or(rest)
}

fn mismatch(field: &Field, path: &str, expected: &'static str) -> SchemaError {
    SchemaError::Mismatch { field: path.to_owned(), expected, found: field.spelled() }
}
