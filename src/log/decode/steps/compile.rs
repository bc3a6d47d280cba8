//! Compiles a schema and the wanted fields into steps.

use super::super::recipes::{Fields, is_below};
use super::super::row::Slot;
use super::super::schema::{
    Arity, Base, Definition, Extensibility, Field, MAX_DEPTH, MAX_FIELDS, Primitive, Schema,
    SchemaError,
};
use super::op::{Count, Op, Step};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Wire {
    Ros1,
    Cdr,
    Cdr2,
}

pub(super) struct Compiler<'a> {
    schema: &'a Schema,
    wanted: Fields,
    each: Option<&'static str>,
    wire: Wire,
    /// Fields so far.
    fields: usize,
    /// Whether each wanted field was found.
    found: Vec<bool>,
}

impl<'a> Compiler<'a> {
    pub(super) fn new(
        schema: &'a Schema,
        wanted: Fields,
        each: Option<&'static str>,
        wire: Wire,
    ) -> Self {
        Self { schema, wanted, each, wire, fields: 0, found: vec![false; wanted.len()] }
    }

    pub(super) fn compile(mut self) -> Result<Vec<Step>, SchemaError> {
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

    /// `prefix` is the path of `message`.
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
        // Without a length prefix, inline the fields.
        let mut own = Vec::new();
        let always = match (self.wire, message.extensibility) {
            (Wire::Ros1 | Wire::Cdr, _) | (_, Extensibility::Final) => None,
            (Wire::Cdr2, extensibility) => Some(extensibility == Extensibility::Appendable),
        };
        let inner = if always.is_some() { &mut own } else { &mut *steps };
        if message.extensibility == Extensibility::Mutable {
            let why = "in which every field has an id";
            push(inner, unread(prefix, &message.name, why), prefix.into());
        }
        for field in &message.fields {
            let path = match prefix {
                "" => field.name.clone(),
                // A type for a nested array has no name.
                _ if field.name.is_empty() => prefix.to_owned(),
                _ => format!("{prefix}.{}", field.name),
            };
            self.field(field, path, depth, inner)?;
        }
        if message.fields.is_empty() && self.wire != Wire::Ros1 {
            // In ROS 2 it takes one byte (`structure_needs_at_least_one_member`).
            push(inner, Op::Skip { size: 1, count: Count::Fixed(1) }, prefix.into());
        }
        if let Some(always) = always {
            push(steps, Op::Delimited { always, steps: own }, prefix.into());
        }
        Ok(())
    }

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
                    // In ROS 1, empty messages take no bytes.
                    (true, Count::Fixed(_)) => return Ok(()),
                    (true, Count::Wire) => Op::Skip { size: 0, count },
                    (false, _) => Op::Repeat { count, steps: nested, rows },
                }
            }
        };
        push(steps, op, path);
        Ok(())
    }

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

    /// Skips the byte length that CDR version 2 puts before a collection of anything but numbers.
    fn push_length(&self, field: &Field, path: &str, steps: &mut Vec<Step>) {
        if self.wire == Wire::Cdr2 && field.arity != Arity::One {
            push(steps, Op::Skip { size: 4, count: Count::Fixed(1) }, path.into());
        }
    }

    fn leads_to_wanted(&self, path: &str) -> bool {
        self.wanted.iter().any(|(wanted, _)| is_below(wanted, path))
    }

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

    /// A message of seconds and nanoseconds, in any order.
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

/// Merges doubles that are consecutive on the wire and in the row.
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

/// Removes the steps after the last wanted field. Array elements must be walked completely to find the next
/// one; a delimited message contains its own end.
fn trim(steps: &mut Vec<Step>) {
    while steps.pop_if(|step| step.op.is_skip()).is_some() {}
    if let Some(Step { op: Op::Delimited { steps, .. }, .. }) = steps.last_mut() {
        trim(steps);
    }
}

/// First reason why a step cannot be executed.
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
