//! Message types of a schema in any language.

use std::borrow::Cow;
use std::collections::HashMap;

/// In a schema and in a message including nested ones. Limits types that double at every level.
pub(super) const MAX_FIELDS: usize = 10_000;

pub(super) const MAX_TYPES: usize = 5_000;

/// Nesting depth. Limits types that contain themselves.
pub(super) const MAX_DEPTH: usize = 32;

/// Whole message packages need less than a tenth.
const MAX_BYTES: usize = 4 << 20;

/// Name length of a field or type, bytes.
pub(super) const MAX_NAME: usize = 256;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum SchemaError {
    #[error("line {line}: expected `MSG: package/Type` after the separator, found `{found}`")]
    Separator { line: usize, found: String },
    #[error("line {line}: expected `type name`, found `{found}`")]
    Field { line: usize, found: String },
    #[error(
        "line {line}: array length of `{}` is not a number from 1 to 4294967295",
        excerpt(found)
    )]
    ArrayLength { line: usize, found: String },
    #[error("line {line}: expected {expected}, found `{found}`")]
    Syntax { line: usize, expected: &'static str, found: String },
    #[error("line {line}: name of more than {MAX_NAME} bytes")]
    LongName { line: usize },
    #[error("not a FileDescriptorSet: {}", excerpt(what))]
    Descriptor { what: String },
    #[error("does not define `{}`", excerpt(type_name))]
    NoRoot { type_name: String },
    #[error(
        "field `{}` is of type `{}`, which the schema does not define",
        excerpt(field),
        excerpt(type_name)
    )]
    Undefined { field: String, type_name: String },
    #[error("field `{}` is of type `{}`, {why}", excerpt(field), excerpt(spelled))]
    Unreadable { field: String, spelled: String, why: &'static str },
    #[error(
        "field `{}` is nested deeper than {MAX_DEPTH}; does its type contain itself?",
        excerpt(field)
    )]
    TooDeep { field: String },
    #[error("more than {MAX_FIELDS} fields in total; types may contain each other repeatedly")]
    TooManyFields,
    #[error("more than {MAX_TYPES} types")]
    TooManyTypes,
    #[error("{bytes} bytes long; the limit is {MAX_BYTES}")]
    TooLong { bytes: usize },
    #[error("expected {expected} in field `{}`, found `{}`", excerpt(field), excerpt(found))]
    Mismatch { field: String, expected: &'static str, found: String },
    #[error("no field `{field}`")]
    Missing { field: &'static str },
}

pub(super) fn check_length(schema: &[u8]) -> Result<(), SchemaError> {
    match schema.len() {
        0..=MAX_BYTES => Ok(()),
        bytes => Err(SchemaError::TooLong { bytes }),
    }
}

pub(super) fn text(schema: &[u8]) -> Result<Cow<'_, str>, SchemaError> {
    check_length(schema).map(|()| String::from_utf8_lossy(schema))
}

/// Shortens text for messages.
pub(crate) fn excerpt(text: &str) -> String {
    const MAX_CHARS: usize = 80;
    start_of(text, MAX_CHARS).into_owned()
}

/// Truncates the name of a topic, type, frame or joint.
pub(crate) fn bounded(name: &str) -> Cow<'_, str> {
    const MAX_CHARS: usize = 256;
    match start_of(name, MAX_CHARS) {
        short if !short.contains(char::is_control) => short,
        // Names must fit on one line of reports, tables and scripts.
        short => Cow::Owned(short.replace(char::is_control, "\u{fffd}")),
    }
}

/// Marks truncation with an ellipsis.
fn start_of(text: &str, longest: usize) -> Cow<'_, str> {
    match text.char_indices().nth(longest) {
        Some((end, _)) => Cow::Owned(format!("{}…", &text[..end])),
        None => Cow::Borrowed(text),
    }
}

/// Booleans, bytes and characters are 8-bit numbers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Primitive {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Primitive {
    /// Size on the wire, bytes.
    pub(super) const fn size(self) -> usize {
        match self {
            Primitive::U8 | Primitive::I8 => 1,
            Primitive::U16 | Primitive::I16 => 2,
            Primitive::U32 | Primitive::I32 | Primitive::F32 => 4,
            Primitive::U64 | Primitive::I64 | Primitive::F64 => 8,
        }
    }
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Base {
    Number(Primitive),
    /// In CDR version 2, its collections have a length prefix.
    Enumeration(Primitive),
    Text,
    /// Keyed by [`canonical`] name.
    Message(String),
    /// Can be neither read nor skipped; with the reason.
    Unreadable(&'static str),
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Arity {
    One,
    Array(u32),
    Sequence,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) base: Base,
    pub(super) arity: Arity,
    pub(super) spelled: String,
}

/// Determines the length prefix in CDR version 2 (DDS XTypes 1.3, §7.4.3.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Extensibility {
    /// Determined by the header of each message.
    Undeclared,
    Final,
    Appendable,
    /// Every member has an id.
    Mutable,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Definition {
    /// Name in [`canonical`] form.
    pub(super) name: String,
    pub(super) fields: Vec<Field>,
    pub(super) extensibility: Extensibility,
}

impl Definition {
    pub(super) fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), fields: Vec::new(), extensibility: Extensibility::Undeclared }
    }
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Schema {
    definitions: Vec<Definition>,
    by_name: HashMap<String, usize>,
    root: usize,
}

/// Usable without a definition; with their seconds and nanoseconds.
const BUILT_IN: [(&str, Primitive, Primitive); 4] = [
    ("time", Primitive::U32, Primitive::U32),
    ("duration", Primitive::I32, Primitive::I32),
    ("builtin_interfaces/Time", Primitive::I32, Primitive::U32),
    ("builtin_interfaces/Duration", Primitive::I32, Primitive::U32),
];

fn built_in((name, seconds, nanoseconds): (&str, Primitive, Primitive)) -> Definition {
    let field = |name: &str, primitive| Field {
        name: name.into(),
        base: Base::Number(primitive),
        arity: Arity::One,
        spelled: "a 32-bit number".into(),
    };
    let fields = vec![field("sec", seconds), field("nanosec", nanoseconds)];
    Definition { fields, ..Definition::new(name) }
}

/// Converts `package/msg/Type` to `package/Type`.
pub(crate) fn canonical(type_name: &str) -> Cow<'_, str> {
    match type_name.split_once("/msg/") {
        Some((package, name)) => Cow::Owned(format!("{package}/{name}")),
        None => Cow::Borrowed(type_name),
    }
}

impl Schema {
    /// For duplicate names the first definition counts.
    pub(super) fn new(
        type_name: &str,
        mut definitions: Vec<Definition>,
    ) -> Result<Self, SchemaError> {
        definitions.extend(BUILT_IN.map(built_in));
        let mut by_name = HashMap::new();
        for (index, definition) in definitions.iter().enumerate() {
            by_name.entry(definition.name.clone()).or_insert(index);
        }
        let root = *by_name
            .get(canonical(type_name).as_ref())
            .ok_or_else(|| SchemaError::NoRoot { type_name: type_name.to_owned() })?;
        Ok(Self { definitions, by_name, root })
    }

    pub(super) fn root(&self) -> &Definition {
        &self.definitions[self.root]
    }

    pub(super) fn definition(&self, name: &str) -> Option<&Definition> {
        self.by_name.get(name).map(|&index| &self.definitions[index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_line() {
        assert_eq!(bounded("/tf\nrm -r"), "/tf\u{fffd}rm -r");
        assert_eq!(bounded("/tf"), "/tf");
    }
}
