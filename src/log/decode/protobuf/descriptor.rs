//! Message types from a `google.protobuf.FileDescriptorSet`, itself a protocol buffer; field numbers are
//! from descriptor.proto.

use std::collections::HashMap;

use super::super::schema::{MAX_DEPTH, MAX_FIELDS, MAX_NAME, MAX_TYPES, SchemaError, check_length};
use super::wire::{Reader, Value, WireError};

/// Interpretation of a number's bits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Scalar {
    F64,
    F32,
    /// Two's complement sign-extended to 64 bits.
    Signed,
    Unsigned,
    /// Sign in the lowest bit.
    Zigzag,
    Fixed32,
    Fixed64,
    SignedFixed32,
    SignedFixed64,
}

/// Messages per full name, without a leading dot.
#[derive(Debug, Default)]
pub(in super::super) struct Types {
    messages: HashMap<String, Message>,
    /// Total number of fields.
    fields: usize,
}

#[derive(Debug)]
pub(super) struct Message {
    fields: Vec<Field>,
}

#[derive(Debug)]
pub(super) struct Field {
    name: String,
    pub(super) number: u32,
    pub(super) is_repeated: bool,
    pub(super) kind: Kind,
}

/// Type of one value.
#[derive(Debug)]
pub(super) enum Kind {
    Number(Scalar),
    Text,
    /// Full name without a leading dot.
    Message(String),
    /// Bytes, a group or an unknown type.
    Other,
}

impl Message {
    pub(super) fn field(&self, name: &str) -> Option<&Field> {
        self.fields.iter().find(|field| field.name == name)
    }
}

impl Field {
    /// Type name for messages.
    pub(super) fn spelled(&self) -> String {
        let repeated = if self.is_repeated { "repeated " } else { "" };
        match &self.kind {
            Kind::Number(_) => format!("{repeated}number"),
            Kind::Text => format!("{repeated}string"),
            Kind::Message(name) => format!("{repeated}{name}"),
            Kind::Other => format!("{repeated}bytes or group"),
        }
    }
}

impl Types {
    pub(in super::super) fn parse(schema: &[u8]) -> Result<Self, SchemaError> {
        check_length(schema)?;
        let mut types = Self::default();
        let mut reader = Reader::new(schema);
        while let Some((number, value)) = reader.field().map_err(broken)? {
            if number == 1 {
                types.file(bytes(value)?)?;
            }
        }
        Ok(types)
    }

    pub(super) fn message(&self, name: &str) -> Option<&Message> {
        self.messages.get(name)
    }

    fn file(&mut self, file: &[u8]) -> Result<(), SchemaError> {
        let mut package = String::new();
        let mut reader = Reader::new(file);
        while let Some((number, value)) = reader.field().map_err(broken)? {
            if number == 2 {
                package = text(value)?;
            }
        }
        let mut reader = Reader::new(file);
        while let Some((number, value)) = reader.field().map_err(broken)? {
            if number == 4 {
                self.message_type(bytes(value)?, &package, 0)?;
            }
        }
        Ok(())
    }

    /// A `DescriptorProto` and its nested types.
    fn message_type(
        &mut self,
        message: &[u8],
        scope: &str,
        depth: usize,
    ) -> Result<(), SchemaError> {
        if depth > MAX_DEPTH {
            return Err(SchemaError::TooDeep { field: scope.to_owned() });
        }
        let (mut name, mut fields, mut nested) = (String::new(), Vec::new(), Vec::new());
        let mut reader = Reader::new(message);
        while let Some((number, value)) = reader.field().map_err(broken)? {
            match number {
                1 => name = text(value)?,
                2 => fields.push(field(bytes(value)?)?),
                3 => nested.push(bytes(value)?),
                _ => {}
            }
            if self.fields + fields.len() > MAX_FIELDS {
                return Err(SchemaError::TooManyFields);
            }
        }
        if self.messages.len() >= MAX_TYPES {
            return Err(SchemaError::TooManyTypes);
        }
        let full_name = if scope.is_empty() { name } else { format!("{scope}.{name}") };
        for message in nested {
            self.message_type(message, &full_name, depth + 1)?;
        }
        self.fields += fields.len();
        self.messages.insert(full_name, Message { fields });
        Ok(())
    }
}

fn field(field: &[u8]) -> Result<Field, SchemaError> {
    const REPEATED: u64 = 3;
    let (mut name, mut number, mut label, mut code) = (String::new(), 0, 0, 0);
    let mut type_name = String::new();
    let mut reader = Reader::new(field);
    while let Some((tag, value)) = reader.field().map_err(broken)? {
        match (tag, value) {
            (1, value) => name = text(value)?,
            (3, Value::Varint(value)) => number = u32::try_from(value).unwrap_or(0),
            (4, Value::Varint(value)) => label = value,
            (5, Value::Varint(value)) => code = value,
            (6, value) => type_name = text(value)?.trim_start_matches('.').to_owned(),
            _ => {}
        }
    }
    Ok(Field { name, number, is_repeated: label == REPEATED, kind: kind(code, type_name) })
}

/// Kind with this code in `FieldDescriptorProto.Type`.
fn kind(code: u64, type_name: String) -> Kind {
    Kind::Number(match code {
        1 => Scalar::F64,
        2 => Scalar::F32,
        // int64, int32 and enums; negative numbers take ten bytes.
        3 | 5 | 14 => Scalar::Signed,
        // uint64, bool and uint32.
        4 | 8 | 13 => Scalar::Unsigned,
        6 => Scalar::Fixed64,
        7 => Scalar::Fixed32,
        9 => return Kind::Text,
        11 => return Kind::Message(type_name),
        15 => Scalar::SignedFixed32,
        16 => Scalar::SignedFixed64,
        17 | 18 => Scalar::Zigzag,
        _ => return Kind::Other,
    })
}

fn bytes(value: Value<'_>) -> Result<&[u8], SchemaError> {
    value.bytes().map_err(|fault| broken(Reader::new(&[]).error(fault)))
}

/// Limits names, because nested types repeat their parents' names.
fn text(value: Value<'_>) -> Result<String, SchemaError> {
    let name = bytes(value)?;
    if name.len() > MAX_NAME {
        let what = format!("name of more than {MAX_NAME} bytes");
        return Err(SchemaError::Descriptor { what });
    }
    Ok(String::from_utf8_lossy(name).into_owned())
}

fn broken(error: WireError) -> SchemaError {
    SchemaError::Descriptor { what: error.to_string() }
}
