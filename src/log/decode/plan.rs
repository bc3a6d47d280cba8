//! Plans: a schema and a recipe compiled into the steps that read one message.

use super::Recipe;
use super::builder::TooManyJoints;
use super::cdr::{Cursor, EncapsulationError, Short};
use super::row::{Row, Slot};
use super::schema::{Arity, Base, Definition, Field, Primitive, Schema, SchemaError};

/// Deepest nesting of messages. A type that contains itself is stopped here.
const MAX_DEPTH: usize = 32;

/// Most fields in a message with all that it contains. Types that double at every level are stopped
/// here.
const MAX_FIELDS: usize = 10_000;

/// The steps that read the wanted fields of a message, and pass over the others, in one walk.
#[derive(Debug)]
pub(in crate::log) struct Plan {
    steps: Vec<Step>,
    /// Whether the message itself is the row, or a [`Op::Repeat`] among the steps has rows.
    whole: bool,
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
    /// Read into one of [`Row::lists`].
    List(Primitive, Count, usize),
    /// Read into one of [`Row::texts`].
    Text(usize),
    /// Read [`Row::names`].
    Names(Count),
    /// Walk the steps for every element of an array.
    Repeat { count: Count, steps: Vec<Step>, rows: bool },
}

/// How often a value is there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Count {
    /// As often as the schema says.
    Fixed(u32),
    /// As often as the length on the wire says.
    Wire,
}

/// Why a message could not be decoded.
#[derive(Debug, thiserror::Error)]
pub(in crate::log) enum DecodeError<'p> {
    /// The message is not in a representation read here.
    #[error(transparent)]
    Encapsulation(#[from] EncapsulationError),
    /// A field reaches beyond the end of the message.
    #[error("field `{field}`: {short}")]
    Short { field: &'p str, short: Short },
    /// The columns refused the row.
    #[error(transparent)]
    Refused(#[from] TooManyJoints),
}

/// What a walk does with each row.
type Append<'f> = dyn FnMut(&Row) -> Result<(), TooManyJoints> + 'f;

impl Plan {
    /// Compiles the steps that read the fields of `recipe` from messages of `schema`.
    pub(super) fn compile(schema: &Schema, recipe: &Recipe) -> Result<Self, SchemaError> {
        let mut compiler =
            Compiler { schema, recipe, fields: 0, found: vec![false; recipe.fields.len()] };
        let mut steps = compiler.message(schema.root(), "", 0)?;
        let missing = compiler.found.iter().position(|found| !found);
        if let Some(index) = missing {
            return Err(SchemaError::Missing { field: recipe.fields[index].0 });
        }
        // What follows the last wanted field need not be walked.
        while steps.pop_if(|step| step.op.is_skip()).is_some() {}
        Ok(Self { steps, whole: recipe.each.is_none() })
    }

    /// Reads `message` through `row` and gives each of its rows to `append`.
    pub(in crate::log) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        let mut cursor = Cursor::new(message)?;
        walk(&self.steps, &mut cursor, row, append)?;
        if self.whole {
            append(row)?;
        }
        Ok(())
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
        if let Op::Repeat { count, steps, rows } = op {
            for _ in 0..count.of(cursor).map_err(at)? {
                walk(steps, cursor, row, append)?;
                if *rows {
                    append(row)?;
                }
            }
        } else {
            op.run(cursor, row).map_err(at)?;
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
            _ => false,
        }
    }

    /// Reads or passes over one field; a [`Op::Repeat`] is walked by [`walk`].
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
            Op::Repeat { .. } => {}
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

/// What is known while a schema is walked.
struct Compiler<'a> {
    schema: &'a Schema,
    recipe: &'a Recipe,
    /// Fields met so far.
    fields: usize,
    /// Which of the recipe's fields were met.
    found: Vec<bool>,
}

impl Compiler<'_> {
    /// The steps for the fields of `message`, whose own path is `prefix`.
    fn message(
        &mut self,
        message: &Definition,
        prefix: &str,
        depth: usize,
    ) -> Result<Vec<Step>, SchemaError> {
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: prefix.into(), limit: MAX_DEPTH });
        }
        let mut steps = Vec::new();
        for field in &message.fields {
            let path = match prefix {
                "" => field.name.clone(),
                _ => format!("{prefix}.{}", field.name),
            };
            self.field(field, path, depth, &mut steps)?;
        }
        if message.fields.is_empty() {
            // An empty message takes a byte on the wire (`structure_needs_at_least_one_member`).
            push(&mut steps, Op::Skip { size: 1, count: Count::Fixed(1) }, prefix.into());
        }
        Ok(steps)
    }

    /// Appends the steps for one field.
    fn field(
        &mut self,
        field: &Field,
        path: String,
        depth: usize,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        self.fields += 1;
        if self.fields > MAX_FIELDS {
            return Err(SchemaError::TooLarge { limit: MAX_FIELDS });
        }
        let wanted = self.recipe.fields.iter().position(|(wanted, _)| *wanted == path);
        if let Some(index) = wanted {
            self.found[index] = true;
            return self.read(field, path, self.recipe.fields[index].1, steps);
        }
        let count = Count::from(field.arity);
        let op = match &field.base {
            Base::Number(primitive) => Op::Skip { size: primitive.size(), count },
            Base::Text => Op::SkipTexts(count),
            Base::WideText => return Err(SchemaError::WideString { field: path }),
            Base::Message(name) => {
                let rows = self.recipe.each == Some(path.as_str());
                if field.arity != Arity::One && !rows && self.leads_to_wanted(&path) {
                    return Err(mismatch(field, path, "a single message"));
                }
                let nested = self.nested(name, &path, depth)?;
                if field.arity == Arity::One && !rows {
                    // One of it is as if its fields stood here.
                    steps.extend(nested);
                    return Ok(());
                }
                Op::Repeat { count, steps: nested, rows }
            }
        };
        push(steps, op, path);
        Ok(())
    }

    /// The steps for the message type `name` at `path`.
    fn nested(&mut self, name: &str, path: &str, depth: usize) -> Result<Vec<Step>, SchemaError> {
        match self.schema.definition(name) {
            Some(definition) => self.message(definition, path, depth + 1),
            None => Err(SchemaError::Undefined { field: path.into(), type_name: name.into() }),
        }
    }

    /// Whether the recipe wants a field below `path`.
    fn leads_to_wanted(&self, path: &str) -> bool {
        let below =
            |wanted: &str| wanted.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'));
        self.recipe.fields.iter().any(|(wanted, _)| below(wanted))
    }

    /// Appends the steps that read `field` into `slot`.
    fn read(
        &self,
        field: &Field,
        path: String,
        slot: Slot,
        steps: &mut Vec<Step>,
    ) -> Result<(), SchemaError> {
        let count = Count::from(field.arity);
        let op = match (slot, &field.base, field.arity) {
            (Slot::Stamp, _, Arity::One) => return self.stamp(field, path, steps),
            (Slot::Number(index), &Base::Number(primitive), Arity::One) => {
                Op::Number(primitive, index)
            }
            (Slot::Text(index), Base::Text, Arity::One) => Op::Text(index),
            (Slot::List(index), &Base::Number(primitive), Arity::Array(_) | Arity::Sequence) => {
                Op::List(primitive, count, index)
            }
            (Slot::Names, Base::Text, Arity::Array(_) | Arity::Sequence) => Op::Names(count),
            _ => return Err(mismatch(field, path, slot.expected())),
        };
        push(steps, op, path);
        Ok(())
    }

    /// Appends the steps that read a stamp: a message of seconds and nanoseconds, in any order.
    fn stamp(&self, field: &Field, path: String, steps: &mut Vec<Step>) -> Result<(), SchemaError> {
        let Base::Message(name) = &field.base else {
            return Err(mismatch(field, path, Slot::Stamp.expected()));
        };
        let Some(definition) = self.schema.definition(name) else {
            return Err(SchemaError::Undefined { field: path, type_name: name.clone() });
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
        for op in parts {
            push(steps, op, path.clone());
        }
        Ok(())
    }
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
