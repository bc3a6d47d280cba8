//! Message definitions in ROS format: the definition of the type, then all types it contains, each after a
//! line of `=` and a line `MSG: package/Type`.

use std::collections::HashSet;

use super::schema::{
    self, Arity, Base, Definition, Field, MAX_FIELDS, MAX_NAME, MAX_TYPES, Primitive, Schema,
    SchemaError, canonical, excerpt,
};

/// Common ROS 2 types, for logs without schemas.
const COMMON: &str = include_str!("common.msg");

/// ROS generation: some words have two meanings.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Dialect {
    /// `byte` is signed.
    Ros1,
    /// `byte` is unsigned.
    Ros2,
}

/// The only type that ROS 1 allows without a package.
const HEADER: &str = "std_msgs/Header";

pub(super) fn parse(
    type_name: &str,
    schema: &[u8],
    dialect: Dialect,
) -> Result<Schema, SchemaError> {
    let text = schema::text(schema)?;
    Schema::new(type_name, definitions(&canonical(type_name), &text, dialect)?)
}

/// `None` if the type is not common.
pub(super) fn common(type_name: &str) -> Option<Schema> {
    let definitions = definitions("", COMMON, Dialect::Ros2).ok()?;
    Schema::new(type_name, definitions).ok()
}

/// The first is called `name`.
fn definitions(name: &str, text: &str, dialect: Dialect) -> Result<Vec<Definition>, SchemaError> {
    let mut done = Vec::new();
    let mut fields = 0;
    let mut current = Definition::new(name);
    let mut lines = text.lines().map(str::trim).enumerate();
    while let Some((index, line)) = lines.next() {
        if line.len() >= 3 && line.bytes().all(|byte| byte == b'=') {
            let (index, header) = lines.next().unwrap_or((index + 1, ""));
            let Some(name) = header.strip_prefix("MSG:") else {
                return Err(SchemaError::Separator { line: index + 1, found: excerpt(header) });
            };
            let next = Definition::new(canonical(name.trim()));
            done.push(std::mem::replace(&mut current, next));
            if done.len() > MAX_TYPES {
                return Err(SchemaError::TooManyTypes);
            }
        } else if let Some(field) = field(&current.name, index + 1, line, dialect)? {
            current.fields.push(field);
            fields += 1;
            if fields > MAX_FIELDS {
                return Err(SchemaError::TooManyFields);
            }
        }
    }
    done.push(current);
    if dialect == Dialect::Ros2 {
        qualify_headers(&mut done);
    }
    Ok(done)
}

/// Resolves a bare `Header` to ROS's own if its package does not define one: definitions converted from ROS
/// 1 keep the bare name.
fn qualify_headers(definitions: &mut [Definition]) {
    let defined: HashSet<String> =
        definitions.iter().map(|definition| definition.name.clone()).collect();
    for field in definitions.iter_mut().flat_map(|definition| &mut definition.fields) {
        if let Base::Message(name) = &mut field.base
            && field.spelled.starts_with("Header")
            && name.rsplit('/').next() == Some("Header")
            && !defined.contains(name)
        {
            HEADER.clone_into(name);
        }
    }
}

/// `None` for a constant, comment or empty line.
fn field(
    owner: &str,
    number: usize,
    line: &str,
    dialect: Dialect,
) -> Result<Option<Field>, SchemaError> {
    // A `#` may cut off a string constant or default: neither is on the wire.
    let declaration = line.split('#').next().unwrap_or_default().trim();
    if declaration.is_empty() {
        return Ok(None);
    }
    let malformed = || SchemaError::Field { line: number, found: excerpt(line) };
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
    if name.len().max(spelled.len()) > MAX_NAME {
        return Err(SchemaError::LongName { line: number });
    }
    let (base, arity) = type_of(owner, number, spelled, dialect)?;
    Ok(Some(Field { name: name.into(), base, arity, spelled: spelled.into() }))
}

/// `owner` is the enclosing definition.
fn type_of(
    owner: &str,
    line: usize,
    spelled: &str,
    dialect: Dialect,
) -> Result<(Base, Arity), SchemaError> {
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
    Ok((base_of(owner, base, dialect), arity))
}

fn base_of(owner: &str, name: &str, dialect: Dialect) -> Base {
    if let Some(primitive) = primitive(name, dialect) {
        return Base::Number(primitive);
    }
    match name {
        "string" => Base::Text,
        "wstring" => Base::Unreadable("which has no settled encoding"),
        "time" | "duration" => Base::Message(name.into()),
        // In ROS 2 it is of the same package; see `qualify_headers`.
        "Header" if dialect == Dialect::Ros1 => Base::Message(HEADER.into()),
        _ if name.contains('/') => Base::Message(canonical(name).into()),
        _ => match owner.rsplit_once('/') {
            Some((package, _)) => Base::Message(format!("{package}/{name}")),
            None => Base::Message(name.into()),
        },
    }
}

fn primitive(name: &str, dialect: Dialect) -> Option<Primitive> {
    Some(match name {
        "byte" if dialect == Dialect::Ros1 => Primitive::I8,
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

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(type_name: &str, text: &str) -> Result<Schema, SchemaError> {
        parse(type_name, text.as_bytes(), Dialect::Ros2)
    }

    fn fields(text: &str) -> Vec<(String, Base, Arity)> {
        let schema = parsed("pkg/msg/Type", text).unwrap();
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
    fn every_message_type_syntax_is_parsed() {
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
    fn a_byte_has_a_sign_in_ros_1_only() {
        for (dialect, byte) in [(Dialect::Ros1, Primitive::I8), (Dialect::Ros2, Primitive::U8)] {
            let schema = parse("p/T", b"byte b\nchar c", dialect).unwrap();
            let bases = schema.root().fields.iter().map(|field| &field.base);
            let expected = [Base::Number(byte), Base::Number(Primitive::U8)];
            assert!(bases.eq(&expected), "{dialect:?}");
        }
    }

    #[test]
    fn constants_comments_and_defaults_give_no_fields() {
        let text = "# a comment\n\nint32 A=1\nint32 B = 2\nstring C='a # b'\nstring D= \"x\" \n\
                    int32 with_default 5 # because\nstring text \"a=b # c\"\n  \tfloat64   spaced  \n";
        let fields = fields(text);
        let names: Vec<&str> = fields.iter().map(|(name, ..)| name.as_str()).collect();
        assert_eq!(names, ["with_default", "text", "spaced"]);
    }

    #[test]
    fn nested_definitions_are_found_by_either_spelling() {
        let text = "A a\r\n=====\r\nMSG: pkg/msg/A\r\nB b\r\n=====\r\nMSG: pkg/B\r\nint8 x\r\n";
        let schema = parsed("pkg/Type", text).unwrap();
        assert_eq!(schema.definition("pkg/A").unwrap().fields[0].name, "b");
        assert_eq!(schema.definition("pkg/B").unwrap().fields[0].name, "x");
        assert_eq!(schema.definition("pkg/C"), None);
    }

    #[test]
    fn broken_schemas_name_the_line() {
        let error = |text: &str| parsed("p/T", text).unwrap_err().to_string();
        assert_eq!(error("int32 a\nint32"), "line 2: expected `type name`, found `int32`");
        assert!(error("int8 x\n====\nint8 y").starts_with("line 3: expected `MSG: "));
        assert!(error("int8 x\n====").starts_with("line 3: expected `MSG: "));
        assert!(error("int8[0] x").contains("array length of `int8[0]`"));
        assert!(error("int8[99999999999] x").contains("array length"));
        assert!(error(&format!("int8 {}", "x".repeat(300))).contains("name of more than 256"));
    }

    #[test]
    fn schemas_of_any_size_are_refused_before_they_fill_the_memory() {
        let many_fields: String = (0..1_000_000).map(|i| format!("f x{i}\n")).collect();
        assert_eq!(
            parsed("p/T", &many_fields).unwrap_err(),
            SchemaError::TooLong { bytes: many_fields.len() }
        );
        let fields = &many_fields[..many_fields[..200_000].rfind('\n').unwrap()];
        assert_eq!(parsed("p/T", fields).unwrap_err(), SchemaError::TooManyFields);
        let types = "===\nMSG: a/B\n".repeat(100_000);
        assert_eq!(parsed("p/T", &types).unwrap_err(), SchemaError::TooManyTypes);
    }

    #[test]
    fn the_common_definitions_are_complete() {
        let all = definitions("", COMMON, Dialect::Ros2).unwrap();
        assert!(all.len() > 20);
        let schema = common("std_msgs/String").unwrap();
        for definition in &all {
            for field in &definition.fields {
                if let Base::Message(name) = &field.base {
                    assert!(schema.definition(name).is_some(), "{} {name}", definition.name);
                }
            }
        }
    }
}
