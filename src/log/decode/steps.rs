//! A schema and a recipe compiled into the steps that read one message of CDR or of ROS 1.

mod shape;

use super::cursor::{Cursor, EncapsulationError, Layout, Short};
use super::plan::{Append, DecodeError};
use super::recipes::Fields;
use super::row::{Row, Slot};
use super::schema::{
    Arity, Base, Definition, Extensibility, Field, MAX_DEPTH, MAX_FIELDS, Primitive, Schema,
    SchemaError,
};

pub(super) use self::shape::Shape;

/// The steps that read the wanted fields of a message, and pass over the others, in one walk.
#[derive(Debug)]
pub(in crate::log) struct Plan {
    serialization: Serialization,
    /// For values that simply follow each other.
    plain: Vec<Step>,
    /// For the second CDR, with lengths among the values; empty for ROS 1.
    delimited: Vec<Step>,
    /// Whether the message itself is the row, or a [`Op::Repeat`] among the steps has rows.
    whole: bool,
}

/// The rules by which messages were written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Serialization {
    /// ROS 1: packed, little endian, no header.
    Ros1,
    /// CDR, of whichever version the header of each message says.
    Cdr,
}

/// One field to read or to pass over.
#[derive(Debug)]
struct Step {
    op: Op,
    /// Path of the field from the message's root.
    field: Box<str>,
}

#[derive(Debug)]
enum Op {
    /// Pass over numbers of `size` bytes.
    Skip { size: usize, count: Count },
    /// Pass over strings.
    SkipTexts(Count),
    /// Read [`Row::seconds`].
    Seconds(Primitive),
    /// Read [`Row::nanoseconds`].
    Nanoseconds(Primitive),
    /// Read into one of [`Row::numbers`].
    Number(Primitive, usize),
    /// Read doubles that follow each other into as many of [`Row::numbers`].
    Doubles(std::ops::Range<usize>),
    /// Read into one of [`Row::lists`].
    List(Primitive, Count, usize),
    /// Read into one of [`Row::texts`].
    Text(usize),
    /// Read [`Row::names`].
    Names(Count),
    /// Walk the steps for every element of an array.
    Repeat { count: Count, steps: Vec<Step>, rows: bool },
    /// Walk the steps of a message before which its length may stand: `always`, or where the
    /// header of the message says that types are delimited.
    Delimited { always: bool, steps: Vec<Step> },
    /// Fail: what follows cannot be found. Compiled only to be cut off as of no use, or refused.
    Unreadable(Box<SchemaError>),
}

/// How often a value is there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Count {
    /// As often as the schema says.
    Fixed(u32),
    /// As often as the length on the wire says.
    Wire,
}

impl Plan {
    /// Compiles the steps that read `fields` from messages of `schema`; the elements of the array
    /// `each`, if there is one, are a row each.
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

    /// Reads `message` through `row` and gives each of its rows to `append`.
    pub(super) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        let mut cursor = self.cursor(message)?;
        // Beside the row, which it fills.
        let mut shape = row.shape.take().unwrap_or_default();
        let result = self.read(message, &mut cursor, row, &mut shape, append);
        row.shape = Some(shape);
        result
    }

    /// Reads `message` by the shape of the one before it if it has the same, else by its steps.
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
            shape.take(self, message);
        }
        Ok(())
    }

    /// A cursor at the first value of `message`.
    fn cursor<'m>(&self, message: &'m [u8]) -> Result<Cursor<'m>, EncapsulationError> {
        match self.serialization {
            Serialization::Ros1 => Ok(Cursor::ros1(message)),
            Serialization::Cdr => Cursor::cdr(message),
        }
    }

    /// The steps for what is at `cursor`.
    fn steps(&self, cursor: &Cursor<'_>) -> &[Step] {
        match cursor.layout() {
            Layout::Packed | Layout::Cdr => &self.plain,
            Layout::Cdr2 { .. } => &self.delimited,
        }
    }
}

/// Walks `steps` once.
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
                for index in 0..count.of(cursor).map_err(at)? {
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

impl Op {
    /// Whether the step leaves the row as it is.
    fn is_skip(&self) -> bool {
        match self {
            Op::Skip { .. } | Op::SkipTexts(_) => true,
            Op::Repeat { steps, rows, .. } => !rows && steps.iter().all(|step| step.op.is_skip()),
            Op::Delimited { steps, .. } => steps.iter().all(|step| step.op.is_skip()),
            Op::Unreadable(_) => true,
            _ => false,
        }
    }

    /// Steps within this one.
    fn inner(&self) -> &[Step] {
        match self {
            Op::Repeat { steps, .. } | Op::Delimited { steps, .. } => steps,
            _ => &[],
        }
    }

    /// Reads or passes over one field; what has steps of its own is walked by [`walk`].
    fn run(&self, cursor: &mut Cursor<'_>, row: &mut Row) -> Result<(), Short> {
        match *self {
            Op::Skip { size, count } => {
                let count = count.of(cursor)?;
                cursor.skip(size, count.into())?;
            }
            Op::SkipTexts(count) => {
                for _ in 0..count.of(cursor)? {
                    cursor.text()?;
                }
            }
            Op::Seconds(primitive) => row.seconds = cursor.integer(primitive)?,
            Op::Nanoseconds(primitive) => row.nanoseconds = cursor.integer(primitive)?,
            Op::Number(primitive, index) => row.numbers[index] = cursor.number(primitive)?,
            Op::Doubles(ref range) => cursor.doubles(&mut row.numbers[range.clone()])?,
            Op::List(primitive, count, index) => {
                let count = count.of(cursor)?;
                cursor.numbers(primitive, count, &mut row.lists[index])?;
            }
            Op::Text(index) => row.set_text(index, cursor.text()?),
            Op::Names(count) => {
                row.names.clear();
                for _ in 0..count.of(cursor)? {
                    row.names.push(cursor.text()?);
                }
            }
            Op::Repeat { .. } | Op::Delimited { .. } | Op::Unreadable(_) => {}
        }
        Ok(())
    }
}

impl Count {
    /// The count for the value at the cursor.
    fn of(self, cursor: &mut Cursor<'_>) -> Result<u32, Short> {
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

/// How steps differ by what they are walked over.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Wire {
    Ros1,
    Cdr,
    Cdr2,
}

/// What is known while a schema is walked.
struct Compiler<'a> {
    schema: &'a Schema,
    wanted: Fields,
    each: Option<&'static str>,
    wire: Wire,
    /// Fields met so far.
    fields: usize,
    /// Which of the wanted fields were met.
    found: Vec<bool>,
}

impl<'a> Compiler<'a> {
    fn new(schema: &'a Schema, wanted: Fields, each: Option<&'static str>, wire: Wire) -> Self {
        Self { schema, wanted, each, wire, fields: 0, found: vec![false; wanted.len()] }
    }

    /// The steps of a whole message.
    fn compile(mut self) -> Result<Vec<Step>, SchemaError> {
        let mut steps = Vec::new();
        self.message(self.schema.root(), "", 0, &mut steps)?;
        if let Some(index) = self.found.iter().position(|found| !found) {
            let missing = SchemaError::Missing { field: self.wanted[index].0 };
            return Err(unreadable(&steps).unwrap_or(missing));
        }
        trim(&mut steps);
        join(&mut steps);
        unreadable(&steps).map_or(Ok(steps), Err)
    }

    /// Appends the steps for the fields of `message`, whose own path is `prefix`.
    fn message(
        &mut self,
        message: &Definition,
        prefix: &str,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: prefix.into() });
        }
        // Without a length before them, the fields are as if they stood where the message does.
        let mut own = Vec::new();
        let always = match (self.wire, message.extensibility) {
            (Wire::Ros1 | Wire::Cdr, _) | (_, Extensibility::Final) => None,
            (Wire::Cdr2, extensibility) => Some(extensibility == Extensibility::Appendable),
        };
        let inner = if always.is_some() { &mut own } else { &mut *steps };
        if message.extensibility == Extensibility::Mutable {
            let why = "in which every field carries its id";
            push(inner, unread(prefix, &message.name, why), prefix.into());
        }
        for field in &message.fields {
            let path = match prefix {
                "" => field.name.clone(),
                // A type that stands for an array in an array has no name of its own.
                _ if field.name.is_empty() => prefix.to_owned(),
                _ => format!("{prefix}.{}", field.name),
            };
            self.field(field, path, depth, inner)?;
        }
        if message.fields.is_empty() && self.wire != Wire::Ros1 {
            // An empty message takes a byte in ROS 2 (`structure_needs_at_least_one_member`).
            push(inner, Op::Skip { size: 1, count: Count::Fixed(1) }, prefix.into());
        }
        if let Some(always) = always {
            push(steps, Op::Delimited { always, steps: own }, prefix.into());
        }
        Ok(())
    }

    /// Appends the steps for one field.
    fn field(
        &mut self,
        field: &Field,
        path: String,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        // A long path takes the memory of several fields.
        self.fields += 1 + path.len() / 64;
        if self.fields > MAX_FIELDS {
            return Err(SchemaError::TooManyFields);
        }
        let wanted = self.wanted.iter().position(|(wanted, _)| *wanted == path);
        if let Some(index) = wanted {
            self.found[index] = true;
            return self.read(field, path, self.wanted[index].1, depth, steps);
        }
        let count = Count::from(field.arity);
        let op = match &field.base {
            Base::Number(primitive) => Op::Skip { size: primitive.size(), count },
            Base::Text => {
                self.push_length(field, &path, steps);
                Op::SkipTexts(count)
            }
            Base::Enumeration(primitive) => {
                self.push_length(field, &path, steps);
                Op::Skip { size: primitive.size(), count }
            }
            Base::Unreadable(why) => unread(&path, &field.spelled, why),
            Base::Message(name) => {
                let rows = self.each == Some(path.as_str());
                if field.arity != Arity::One && !rows && self.leads_to_wanted(&path) {
                    return Err(mismatch(field, path, "a single message"));
                }
                if field.arity == Arity::One && !rows {
                    return self.nested(name, &path, depth, steps);
                }
                let mut nested = Vec::new();
                self.nested(name, &path, depth, &mut nested)?;
                self.push_length(field, &path, steps);
                match (nested.is_empty() && !rows, count) {
                    // In ROS 1 an empty message takes no bytes, however often it is there.
                    (true, Count::Fixed(_)) => return Ok(()),
                    (true, Count::Wire) => Op::Skip { size: 0, count },
                    (false, _) => Op::Repeat { count, steps: nested, rows },
                }
            }
        };
        push(steps, op, path);
        Ok(())
    }

    /// Appends the steps for the message type `name` at `path`.
    fn nested(
        &mut self,
        name: &str,
        path: &str,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        match self.schema.definition(name) {
            Some(definition) => self.message(definition, path, depth + 1, steps),
            None => {
                let undefined =
                    SchemaError::Undefined { field: path.into(), type_name: name.into() };
                push(steps, Op::Unreadable(Box::new(undefined)), path.into());
                Ok(())
            }
        }
    }

    /// Passes over the length in bytes that the second CDR puts before a collection of anything but
    /// numbers.
    fn push_length(&self, field: &Field, path: &str, steps: &mut Vec<Step>) {
        if self.wire == Wire::Cdr2 && field.arity != Arity::One {
            push(steps, Op::Skip { size: 4, count: Count::Fixed(1) }, path.into());
        }
    }

    /// Whether the recipe wants a field below `path`.
    fn leads_to_wanted(&self, path: &str) -> bool {
        let below =
            |wanted: &str| wanted.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'));
        self.wanted.iter().any(|(wanted, _)| below(wanted))
    }

    /// Appends the steps that read `field` into `slot`.
    fn read(
        &mut self,
        field: &Field,
        path: String,
        slot: Slot,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        let count = Count::from(field.arity);
        let op = match (slot, &field.base, field.arity) {
            (Slot::Stamp, Base::Message(name), Arity::One) => {
                return self.stamp(field, name, path, depth, steps);
            }
            (Slot::Number(index), &Base::Number(primitive), Arity::One) => {
                Op::Number(primitive, index)
            }
            (Slot::Text(index), Base::Text, Arity::One) => Op::Text(index),
            (Slot::List(index), &Base::Number(primitive), Arity::Array(_) | Arity::Sequence) => {
                Op::List(primitive, count, index)
            }
            (Slot::Names, Base::Text, Arity::Array(_) | Arity::Sequence) => {
                self.push_length(field, &path, steps);
                Op::Names(count)
            }
            _ => return Err(mismatch(field, path, slot.expected())),
        };
        push(steps, op, path);
        Ok(())
    }

    /// Appends the steps that read a stamp: a message of seconds and nanoseconds, in any order.
    fn stamp(
        &mut self,
        field: &Field,
        name: &str,
        path: String,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        let Some(definition) = self.schema.definition(name) else {
            return self.nested(name, &path, depth, steps);
        };
        let part = |field: &Field| match (field.name.as_str(), &field.base, field.arity) {
            ("sec" | "secs", &Base::Number(primitive), Arity::One) => Some(Op::Seconds(primitive)),
            ("nanosec" | "nsec" | "nsecs", &Base::Number(primitive), Arity::One) => {
                Some(Op::Nanoseconds(primitive))
            }
            _ => None,
        };
        let parts: Vec<Op> = definition.fields.iter().filter_map(part).collect();
        let both = parts.iter().any(|op| matches!(op, Op::Seconds(_)))
            && parts.iter().any(|op| matches!(op, Op::Nanoseconds(_)));
        if !both || parts.len() != definition.fields.len() {
            return Err(mismatch(field, path, Slot::Stamp.expected()));
        }
        let parts = parts.into_iter().map(|op| Step { op, field: path.as_str().into() });
        match (self.wire, definition.extensibility) {
            (Wire::Ros1 | Wire::Cdr, _) | (_, Extensibility::Final) => steps.extend(parts),
            (Wire::Cdr2, extensibility) => {
                let always = extensibility == Extensibility::Appendable;
                push(steps, Op::Delimited { always, steps: parts.collect() }, path.clone());
            }
        }
        Ok(())
    }
}

/// Makes one step of doubles that follow each other, on the wire and in the row.
fn join(steps: &mut Vec<Step>) {
    let mut joined: Vec<Step> = Vec::with_capacity(steps.len());
    for mut step in steps.drain(..) {
        if let Op::Repeat { steps, .. } | Op::Delimited { steps, .. } = &mut step.op {
            join(steps);
        }
        if let Op::Number(Primitive::F64, index) = step.op {
            if let Some(Step { op: Op::Doubles(range), .. }) = joined.last_mut()
                && range.end == index
            {
                range.end += 1;
                continue;
            }
            step.op = Op::Doubles(index..index + 1);
        }
        joined.push(step);
    }
    *steps = joined;
}

/// Cuts off what follows the last wanted field: it need not be walked. Within the elements of an
/// array all must be, to find the next; a delimited message says itself where it ends.
fn trim(steps: &mut Vec<Step>) {
    while steps.pop_if(|step| step.op.is_skip()).is_some() {}
    if let Some(Step { op: Op::Delimited { steps, .. }, .. }) = steps.last_mut() {
        trim(steps);
    }
}

/// The first reason why a step cannot be walked.
fn unreadable(steps: &[Step]) -> Option<SchemaError> {
    steps.iter().find_map(|step| match &step.op {
        Op::Unreadable(error) => Some((**error).clone()),
        op => unreadable(op.inner()),
    })
}

fn unread(path: &str, spelled: &str, why: &'static str) -> Op {
    let (field, spelled) = (path.to_owned(), spelled.to_owned());
    Op::Unreadable(Box::new(SchemaError::Unreadable { field, spelled, why }))
}

/// Appends a step; numbers to pass over join those before them.
fn push(steps: &mut Vec<Step>, op: Op, path: String) {
    if let Op::Skip { size, count: Count::Fixed(more) } = op
        && let Some(Step { op: Op::Skip { size: before, count: Count::Fixed(count) }, .. }) =
            steps.last_mut()
        && *before == size
        && let Some(sum) = count.checked_add(more)
    {
        *count = sum;
        return;
    }
    steps.push(Step { op, field: path.into() });
}

fn mismatch(field: &Field, path: String, expected: &'static str) -> SchemaError {
    SchemaError::Mismatch { field: path, expected, found: field.spelled.clone() }
}
