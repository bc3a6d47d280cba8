//! Message definitions as rosbag2 writes them: the definition of the type, then those of all that it
//! contains, each after a line of `=` and a line `MSG: package/Type`.

use std::borrow::Cow;

/// Why a schema cannot be used.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(in crate::log) enum SchemaError {
    #[error("line {line}: expected `MSG: package/Type` after the separator, found `{found}`")]
    Separator { line: usize, found: String },
    #[error("line {line}: expected `type name`, found `{found}`")]
    Field { line: usize, found: String },
    #[error("line {line}: array length of `{found}` is not a number from 1 to 4294967295")]
    ArrayLength { line: usize, found: String },
    #[error("field `{field}` is of type `{type_name}`, which the schema does not define")]
    Undefined { field: String, type_name: String },
    #[error("field `{field}` is of type `wstring`, which has no settled encoding")]
    WideString { field: String },
    #[error("field `{field}` is nested deeper than {limit}; does its type contain itself?")]
    TooDeep { field: String, limit: usize },
    #[error("more than {limit} fields in all; types that contain each other many times over?")]
    TooLarge { limit: usize },
    #[error("expected {expected} in field `{field}`, found `{found}`")]
    Mismatch { field: String, expected: &'static str, found: String },
    #[error("no field `{field}`")]
    Missing { field: &'static str },
}

/// A number on the wire. `bool`, `byte` and `char` are read as [`Primitive::U8`].
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

    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "bool" | "byte" | "char" | "uint8" => Primitive::U8,
            "int8" => Primitive::I8,
            "uint16" => Primitive::U16,
            "int16" => Primitive::I16,
            "uint32" => Primitive::U32,
            "int32" => Primitive::I32,
            "uint64" => Primitive::U64,
            "int64" => Primitive::I64,
            "float32" => Primitive::F32,
            "float64" => Primitive::F64,
            _ => return None,
        })
    }
}

/// The type of one value of a field.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Base {
    Number(Primitive),
    Text,
    WideText,
    /// Another message, by its name in [`canonical`] form.
    Message(String),
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

/// One message type.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Definition {
    pub(super) name: String,
    pub(super) fields: Vec<Field>,
}

/// A message type with all types that it contains; the first is the message itself.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Schema {
    root: Definition,
    nested: Vec<Definition>,
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
    Definition {
        name: name.into(),
        fields: vec![field("sec", seconds), field("nanosec", nanoseconds)],
    }
}

/// `package/Type` for either spelling of a type name, `package/msg/Type` or `package/Type`.
pub(in crate::log) fn canonical(type_name: &str) -> Cow<'_, str> {
    match type_name.split_once("/msg/") {
        Some((package, name)) => Cow::Owned(format!("{package}/{name}")),
        None => Cow::Borrowed(type_name),
    }
}

impl Schema {
    /// Parses the concatenated definitions of `type_name`.
    pub(super) fn parse(type_name: &str, text: &[u8]) -> Result<Self, SchemaError> {
        let text = String::from_utf8_lossy(text);
        let mut done = Vec::new();
        let mut current = Definition { name: canonical(type_name).into(), fields: Vec::new() };
        let mut lines = text.lines().map(str::trim).enumerate();
        while let Some((index, line)) = lines.next() {
            if line.len() >= 3 && line.bytes().all(|byte| byte == b'=') {
                let (index, header) = lines.next().unwrap_or((index + 1, ""));
                let Some(name) = header.strip_prefix("MSG:") else {
                    return Err(SchemaError::Separator { line: index + 1, found: header.into() });
                };
                let name = canonical(name.trim()).into_owned();
                done.push(std::mem::replace(&mut current, Definition { name, fields: Vec::new() }));
            } else if let Some(field) = parse_field(&current.name, index + 1, line)? {
                current.fields.push(field);
            }
        }
        done.push(current);
        let mut nested = done.split_off(1);
        nested.extend(BUILT_IN.map(built_in));
        Ok(Self { root: done.remove(0), nested })
    }

    /// The message itself.
    pub(super) fn root(&self) -> &Definition {
        &self.root
    }

    /// The definition of the canonical name `name`.
    pub(super) fn definition(&self, name: &str) -> Option<&Definition> {
        self.nested.iter().find(|definition| definition.name == name)
    }
}

/// The field that a line declares; `None` for a constant, a comment or an empty line.
fn parse_field(owner: &str, number: usize, line: &str) -> Result<Option<Field>, SchemaError> {
    // A `#` within the text of a constant or a default may be cut: neither is on the wire.
    let declaration = line.split('#').next().unwrap_or_default().trim();
    if declaration.is_empty() {
        return Ok(None);
    }
    let malformed = || SchemaError::Field { line: number, found: line.into() };
    let (spelled, rest) = declaration.split_once(char::is_whitespace).ok_or_else(malformed)?;
    let rest = rest.trim_start();
    let name_end = rest.find(|c: char| c.is_whitespace() || c == '=').unwrap_or(rest.len());
    let (name, default) = rest.split_at(name_end);
    if name.is_empty() {
        return Err(malformed());
    }
    if default.trim_start().starts_with('=') {
        return Ok(None);
    }
    let (base, arity) = parse_type(owner, number, spelled)?;
    Ok(Some(Field { name: name.into(), base, arity, spelled: spelled.into() }))
}

/// The type `spelled` in the definition of `owner`.
fn parse_type(owner: &str, line: usize, spelled: &str) -> Result<(Base, Arity), SchemaError> {
    let (base, arity) = match spelled.strip_suffix(']').and_then(|rest| rest.rsplit_once('[')) {
        None => (spelled, Arity::One),
        Some((base, "")) => (base, Arity::Sequence),
        Some((base, bound)) if bound.starts_with("<=") => (base, Arity::Sequence),
        Some((base, length)) => match length.parse() {
            Ok(length) if length > 0 => (base, Arity::Array(length)),
            _ => return Err(SchemaError::ArrayLength { line, found: spelled.into() }),
        },
    };
    let base = base.split_once("<=").map_or(base, |(unbounded, _)| unbounded);
    Ok((parse_base(owner, base), arity))
}

/// The type of one value, `name` in the definition of `owner`.
fn parse_base(owner: &str, name: &str) -> Base {
    if let Some(primitive) = Primitive::named(name) {
        return Base::Number(primitive);
    }
    match name {
        "string" => Base::Text,
        "wstring" => Base::WideText,
        "time" | "duration" => Base::Message(name.into()),
        "Header" => Base::Message("std_msgs/Header".into()),
        _ if name.contains('/') => Base::Message(canonical(name).into()),
        _ => match owner.rsplit_once('/') {
            Some((package, _)) => Base::Message(format!("{package}/{name}")),
            None => Base::Message(name.into()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(text: &str) -> Vec<(String, Base, Arity)> {
        let schema = Schema::parse("pkg/msg/Type", text.as_bytes()).unwrap();
        let fields = schema.root().fields.iter();
        fields.map(|field| (field.name.clone(), field.base.clone(), field.arity)).collect()
    }

    fn one(text: &str) -> (Base, Arity) {
        let mut fields = fields(text);
        assert_eq!(fields.len(), 1, "{text}");
        let (_, base, arity) = fields.remove(0);
        (base, arity)
    }

    #[test]
    fn every_kind_of_type_is_read() {
        assert_eq!(one("float32 x"), (Base::Number(Primitive::F32), Arity::One));
        assert_eq!(one("uint8[] x"), (Base::Number(Primitive::U8), Arity::Sequence));
        assert_eq!(one("float64[36] x"), (Base::Number(Primitive::F64), Arity::Array(36)));
        assert_eq!(one("int32[<=5] x"), (Base::Number(Primitive::I32), Arity::Sequence));
        assert_eq!(one("string<=10 x"), (Base::Text, Arity::One));
        assert_eq!(one("string<=10[<=5] x"), (Base::Text, Arity::Sequence));
        assert_eq!(one("string<=10[5] x"), (Base::Text, Arity::Array(5)));
        assert_eq!(one("Other x"), (Base::Message("pkg/Other".into()), Arity::One));
        assert_eq!(one("a/msg/B[] x"), (Base::Message("a/B".into()), Arity::Sequence));
        assert_eq!(one("Header header"), (Base::Message("std_msgs/Header".into()), Arity::One));
    }

    #[test]
    fn constants_comments_and_defaults_are_no_fields() {
        let text = "# a comment\n\nint32 A=1\nint32 B = 2\nstring C='a # b'\nstring D= \"x\" \n\
                    int32 with_default 5 # because\nstring text \"a=b # c\"\n  \tfloat64   spaced  \n";
        let fields = fields(text);
        let names: Vec<&str> = fields.iter().map(|(name, ..)| name.as_str()).collect();
        assert_eq!(names, ["with_default", "text", "spaced"]);
    }

    #[test]
    fn nested_definitions_are_found_by_either_spelling() {
        let text = "A a\r\n=====\r\nMSG: pkg/msg/A\r\nB b\r\n=====\r\nMSG: pkg/B\r\nint8 x\r\n";
        let schema = Schema::parse("pkg/Type", text.as_bytes()).unwrap();
        assert_eq!(schema.definition("pkg/A").unwrap().fields[0].name, "b");
        assert_eq!(schema.definition("pkg/B").unwrap().fields[0].name, "x");
        assert_eq!(schema.definition("pkg/C"), None);
    }

    #[test]
    fn broken_schemas_name_the_line() {
        let error = |text: &str| Schema::parse("p/T", text.as_bytes()).unwrap_err().to_string();
        assert_eq!(error("int32 a\nint32"), "line 2: expected `type name`, found `int32`");
        assert!(error("int8 x\n====\nint8 y").starts_with("line 3: expected `MSG: "));
        assert!(error("int8 x\n====").starts_with("line 3: expected `MSG: "));
        assert!(error("int8[0] x").contains("array length of `int8[0]`"));
        assert!(error("int8[99999999999] x").contains("array length"));
    }
}
