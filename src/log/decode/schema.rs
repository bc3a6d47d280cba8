//! Message types as a schema describes them, whatever language it is written in.

use std::borrow::Cow;
use std::collections::HashMap;

/// Most fields that a schema may define in all, and most that a message may have with all that it
/// contains. Types that double at every level are stopped here.
pub(super) const MAX_FIELDS: usize = 10_000;

/// Most types that a schema may define.
pub(super) const MAX_TYPES: usize = 5_000;

/// Deepest nesting of messages. A type that contains itself is stopped here.
pub(super) const MAX_DEPTH: usize = 32;

/// Longest schema, in bytes. Those of whole message packages have below a tenth of it.
const MAX_BYTES: usize = 4 << 20;

/// Longest name of a field or type, in bytes.
pub(super) const MAX_NAME: usize = 256;

/// Why a schema cannot be used.
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
    #[error("it does not define `{}`", excerpt(type_name))]
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
    #[error("more than {MAX_FIELDS} fields in all; types that contain each other many times over?")]
    TooManyFields,
    #[error("more than {MAX_TYPES} types")]
    TooManyTypes,
    #[error("{bytes} bytes long, more than {MAX_BYTES}")]
    TooLong { bytes: usize },
    #[error("expected {expected} in field `{}`, found `{}`", excerpt(field), excerpt(found))]
    Mismatch { field: String, expected: &'static str, found: String },
    #[error("no field `{field}`")]
    Missing { field: &'static str },
}

/// Refuses a schema that is too long to be one.
pub(super) fn check_length(schema: &[u8]) -> Result<(), SchemaError> {
    match schema.len() {
        0..=MAX_BYTES => Ok(()),
        bytes => Err(SchemaError::TooLong { bytes }),
    }
}

/// The schema as text.
pub(super) fn text(schema: &[u8]) -> Result<Cow<'_, str>, SchemaError> {
    check_length(schema).map(|()| String::from_utf8_lossy(schema))
}

/// The start of `text`, for messages to people.
pub(crate) fn excerpt(text: &str) -> String {
    const LONGEST: usize = 80;
    start_of(text, LONGEST).into_owned()
}

/// A name of a topic, type, frame or joint, which messages hold whole; one that is longer than any is
/// cut.
pub(crate) fn bounded(name: &str) -> Cow<'_, str> {
    const LONGEST: usize = 256;
    match start_of(name, LONGEST) {
        short if !short.contains(char::is_control) => short,
        // A name is a word in reports, tables and scripts, and never more than one line.
        short => Cow::Owned(short.replace(char::is_control, "\u{fffd}")),
    }
}

/// The first characters of `text`, with an ellipsis where there are more.
fn start_of(text: &str, longest: usize) -> Cow<'_, str> {
    match text.char_indices().nth(longest) {
        Some((end, _)) => Cow::Owned(format!("{}…", &text[..end])),
        None => Cow::Borrowed(text),
    }
}

/// A number on the wire. Truth values, bytes and characters are read as 8-bit numbers.
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
    /// Bytes on the wire.
    pub(super) const fn size(self) -> usize {
        match self {
            Primitive::U8 | Primitive::I8 => 1,
            Primitive::U16 | Primitive::I16 => 2,
            Primitive::U32 | Primitive::I32 | Primitive::F32 => 4,
            Primitive::U64 | Primitive::I64 | Primitive::F64 => 8,
        }
    }
}

/// The type of one value of a field.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Base {
    Number(Primitive),
    /// A named number: the second CDR has a length before collections of it.
    Enumeration(Primitive),
    Text,
    /// Another message, by its name in [`canonical`] form.
    Message(String),
    /// What cannot be read or passed over, and why.
    Unreadable(&'static str),
}

/// How many values a field has.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Arity {
    One,
    Array(u32),
    Sequence,
}

/// One field of a message.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) base: Base,
    pub(super) arity: Arity,
    /// The type as the schema spells it, for messages to people.
    pub(super) spelled: String,
}

/// Whether a type may grow, by which the second CDR tells whether its length stands before it (DDS
/// XTypes 1.3, §7.4.3.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Extensibility {
    /// The schema does not say: as the header of each message has it.
    Unsaid,
    Final,
    Appendable,
    /// Every member carries its id.
    Mutable,
}

/// One message type.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Definition {
    /// In [`canonical`] form.
    pub(super) name: String,
    pub(super) fields: Vec<Field>,
    pub(super) extensibility: Extensibility,
}

impl Definition {
    /// A type without fields so far.
    pub(super) fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), fields: Vec::new(), extensibility: Extensibility::Unsaid }
    }
}

/// A message type with all types that it contains.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Schema {
    definitions: Vec<Definition>,
    by_name: HashMap<String, usize>,
    root: usize,
}

/// Types that a schema may use without defining them, with those of their seconds and nanoseconds.
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

/// `package/Type` for either spelling of a type name, `package/msg/Type` or `package/Type`.
pub(crate) fn canonical(type_name: &str) -> Cow<'_, str> {
    match type_name.split_once("/msg/") {
        Some((package, name)) => Cow::Owned(format!("{package}/{name}")),
        None => Cow::Borrowed(type_name),
    }
}

impl Schema {
    /// The type `type_name` with the others of `definitions`; of equal names the first holds.
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

    /// The message itself.
    pub(super) fn root(&self) -> &Definition {
        &self.definitions[self.root]
    }

    /// The definition of the canonical name `name`.
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
