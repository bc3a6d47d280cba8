//! Wire format of protocol buffers.

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{fault} (byte {offset} of the enclosing message)", field_prefix(path))]
pub(crate) struct WireError {
    /// Path of the field, if known.
    path: String,
    /// Offset in the message that contains the field.
    offset: usize,
    fault: Fault,
}

impl WireError {
    pub(super) fn in_field(self, path: &str) -> Self {
        Self { path: path.to_owned(), ..self }
    }
}

fn field_prefix(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!("field `{path}`: ") }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Fault {
    #[error("a value extends beyond the end")]
    Short,
    #[error("a number with more than 64 bits")]
    Varint,
    #[error("a wire type that differs from the schema")]
    WireType,
    #[error("an unknown wire type")]
    UnknownWireType,
    #[error("field number 0")]
    FieldNumber,
    #[error("unterminated groups, or groups nested too deeply")]
    Group,
    #[error("neither a position nor a rotation")]
    Empty,
}

/// One variant per wire type.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Value<'a> {
    Varint(u64),
    Fixed64([u8; 8]),
    Fixed32([u8; 4]),
    Bytes(&'a [u8]),
}

impl<'a> Value<'a> {
    /// Content of a string, bytes field or message.
    pub(super) fn bytes(self) -> Result<&'a [u8], Fault> {
        match self {
            Value::Bytes(bytes) => Ok(bytes),
            _ => Err(Fault::WireType),
        }
    }
}

/// Reads the fields of one message.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

/// Groups are long deprecated.
const MAX_GROUPS: usize = 32;

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(crate) fn is_at_end(&self) -> bool {
        self.at == self.bytes.len()
    }

    pub(crate) fn error(&self, fault: Fault) -> WireError {
        WireError { path: String::new(), offset: self.at, fault }
    }

    pub(super) fn message(&self, value: Value<'a>) -> Result<Reader<'a>, Fault> {
        value.bytes().map(Reader::new)
    }

    /// Skips groups. `None` at the end.
    pub(crate) fn field(&mut self) -> Result<Option<(u32, Value<'a>)>, WireError> {
        self.next_field().map_err(|fault| self.error(fault))
    }

    fn next_field(&mut self) -> Result<Option<(u32, Value<'a>)>, Fault> {
        let mut groups = 0_usize;
        loop {
            if self.is_at_end() {
                return if groups == 0 { Ok(None) } else { Err(Fault::Group) };
            }
            let tag = self.varint()?;
            let number = u32::try_from(tag >> 3).map_err(|_| Fault::FieldNumber)?;
            if number == 0 {
                return Err(Fault::FieldNumber);
            }
            let value = match tag & 7 {
                0 => Value::Varint(self.varint()?),
                1 => Value::Fixed64(self.fixed()?),
                2 => {
                    let length = self.varint()?;
                    Value::Bytes(self.take(usize::try_from(length).map_err(|_| Fault::Short)?)?)
                }
                3 if groups < MAX_GROUPS => {
                    groups += 1;
                    continue;
                }
                4 if groups > 0 => {
                    groups -= 1;
                    continue;
                }
                3 | 4 => return Err(Fault::Group),
                5 => Value::Fixed32(self.fixed()?),
                _ => return Err(Fault::UnknownWireType),
            };
            if groups == 0 {
                return Ok(Some((number, value)));
            }
        }
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], Fault> {
        let end = self.at.checked_add(length).ok_or(Fault::Short)?;
        let bytes = self.bytes.get(self.at..end).ok_or(Fault::Short)?;
        self.at = end;
        Ok(bytes)
    }

    pub(super) fn fixed<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let (bytes, _) = self.bytes[self.at..].split_first_chunk::<N>().ok_or(Fault::Short)?;
        self.at += N;
        Ok(*bytes)
    }

    pub(crate) fn varint(&mut self) -> Result<u64, Fault> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let &byte = self.bytes.get(self.at).ok_or(Fault::Short)?;
            self.at += 1;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                return Err(Fault::Varint);
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(Fault::Varint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_encoding_guide() {
        // protobuf.dev, "Encoding": 150 is 96 01; as field 1 it is 08 96 01.
        assert_eq!(Reader::new(&[0x96, 0x01]).varint(), Ok(150));
        let field = Reader::new(&[0x08, 0x96, 0x01]).field();
        assert_eq!(field, Ok(Some((1, Value::Varint(150)))));
        let minus_two = [0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01];
        assert_eq!(Reader::new(&minus_two).varint(), Ok((-2_i64).cast_unsigned()));
        assert_eq!(Reader::new(&[0xff; 11]).varint(), Err(Fault::Varint));
    }

    #[test]
    fn protobuf_groups_are_skipped() {
        // Field 3 as a group with field 1, then field 2.
        let bytes = [0x1b, 0x08, 0x01, 0x1c, 0x10, 0x07];
        assert_eq!(Reader::new(&bytes).field(), Ok(Some((2, Value::Varint(7)))));
        for broken in [&[0x1b, 0x08, 0x01][..], &[0x1c], &[0x1b; 100]] {
            assert_eq!(Reader::new(broken).field().unwrap_err().fault, Fault::Group);
        }
    }

    #[test]
    fn hostile_lengths_are_refused() {
        let length = [0x0a, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01, 0];
        assert_eq!(Reader::new(&length).field().unwrap_err().fault, Fault::Short);
        assert_eq!(Reader::new(&[0x0d, 1, 2]).field().unwrap_err().fault, Fault::Short);
        assert_eq!(Reader::new(&[0x00]).field().unwrap_err().fault, Fault::FieldNumber);
        assert_eq!(Reader::new(&[0x0f]).field().unwrap_err().fault, Fault::UnknownWireType);
    }
}
