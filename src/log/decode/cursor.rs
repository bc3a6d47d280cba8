//! Cursor over a message in CDR or ROS 1 serialization.

use super::row::MAX_LIST;
use super::schema::Primitive;

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum EncapsulationError {
    #[error("the message has {len} bytes, expected at least the 4 of the CDR header")]
    Short { len: usize },
    #[error(
        "CDR header {id:#06x} is a parameter list, in which every field carries its id; expected \
         plain or delimited CDR (0x0000, 0x0001, 0x0006 to 0x0009)"
    )]
    ParameterList { id: u16 },
    #[error(
        "CDR header {id:#06x} is not plain or delimited CDR (0x0000, 0x0001, 0x0006 to 0x0009)"
    )]
    Unknown { id: u16 },
}

/// Value beyond the end of the message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("byte {offset} of the message: needs {wanted} bytes, {left} remain")]
pub(crate) struct Short {
    /// Offset from the start of the message.
    offset: usize,
    wanted: u64,
    left: usize,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Layout {
    /// ROS 1: no padding.
    Packed,
    /// CDR version 1: aligned to their size.
    Cdr,
    /// CDR version 2: aligned to their size, at most to 4; collections of anything but numbers have a
    /// length prefix.
    Cdr2 {
        /// Messages of types that are not final also have one.
        delimited: bool,
    },
}

/// Bounds-checked cursor over the body of one message.
///
/// CDR aligns values relative to the end of the encapsulation header (DDS XTypes 1.3, §7.4.3 and
/// §7.6.3.1.2).
#[derive(Debug)]
pub(super) struct Cursor<'a> {
    body: &'a [u8],
    at: usize,
    /// Bytes before the body.
    before: usize,
    big_endian: bool,
    max_align: usize,
    layout: Layout,
}

/// Body around a delimited message.
pub(super) struct Outside<'a>(&'a [u8]);

/// Encapsulation header, bytes.
const HEADER: usize = 4;

impl<'a> Cursor<'a> {
    pub(super) fn cdr(message: &'a [u8]) -> Result<Self, EncapsulationError> {
        // The other two bytes are options: they count the padding at the end, which is never read.
        let Some((&[high, low, _, _], body)) = message.split_first_chunk::<HEADER>() else {
            return Err(EncapsulationError::Short { len: message.len() });
        };
        let id = u16::from_be_bytes([high, low]);
        let (layout, max_align) = match id {
            0x0000 | 0x0001 => (Layout::Cdr, 8),
            0x0006 | 0x0007 => (Layout::Cdr2 { delimited: false }, 4),
            0x0008 | 0x0009 => (Layout::Cdr2 { delimited: true }, 4),
            0x0002 | 0x0003 | 0x000a | 0x000b => {
                return Err(EncapsulationError::ParameterList { id });
            }
            _ => return Err(EncapsulationError::Unknown { id }),
        };
        Ok(Self { body, at: 0, before: HEADER, big_endian: id & 1 == 0, max_align, layout })
    }

    pub(super) fn ros1(message: &'a [u8]) -> Self {
        Self {
            body: message,
            at: 0,
            before: 0,
            big_endian: false,
            max_align: 1,
            layout: Layout::Packed,
        }
    }

    pub(super) fn layout(&self) -> Layout {
        self.layout
    }

    /// Enters a message with a length prefix. Nothing beyond its end is read until [`Cursor::leave`].
    pub(super) fn enter(&mut self) -> Result<Outside<'a>, Short> {
        let length = self.length()? as usize;
        let outside = Outside(self.body);
        self.body = &self.body[..self.at + length];
        Ok(outside)
    }

    /// Skips fields that a newer version of the type appended.
    pub(super) fn leave(&mut self, outside: Outside<'a>) {
        self.at = self.body.len();
        self.body = outside.0;
    }

    pub(super) fn before(&self) -> usize {
        self.before
    }

    /// In the body. Padding may precede the next value.
    pub(super) fn position(&self) -> usize {
        self.at
    }

    pub(super) fn seek(&mut self, at: usize) {
        self.at = at;
    }

    pub(super) fn is_little_endian(&self) -> bool {
        !self.big_endian
    }

    /// Position in the body of the next value of `size` bytes.
    #[inline]
    pub(super) fn aligned(&self, size: usize) -> usize {
        let align = size.min(self.max_align);
        self.at + (self.at.wrapping_neg() & (align - 1))
    }

    #[inline]
    fn take(&mut self, size: usize, count: u64) -> Result<&'a [u8], Short> {
        if count == 0 || size == 0 {
            return Ok(&[]);
        }
        let start = self.aligned(size);
        let left = self.body.len().saturating_sub(start);
        let wanted = count.saturating_mul(size as u64);
        if wanted > left as u64 {
            return Err(Short { offset: self.before + start, wanted, left });
        }
        self.at = start + wanted as usize;
        Ok(&self.body[start..self.at])
    }

    /// Little-endian bytes.
    #[inline]
    fn value<const N: usize>(&mut self) -> Result<[u8; N], Short> {
        let start = self.aligned(N);
        let rest = self.body.get(start..).unwrap_or_default();
        let Some(mut value) = rest.first_chunk::<N>().copied() else {
            return Err(Short { offset: self.before + start, wanted: N as u64, left: rest.len() });
        };
        self.at = start + N;
        if self.big_endian {
            value.reverse();
        }
        Ok(value)
    }

    #[inline]
    pub(super) fn skip(&mut self, size: usize, count: u64) -> Result<(), Short> {
        self.take(size, count).map(|_| ())
    }

    /// Length of a sequence whose elements take at least one byte each.
    #[inline]
    pub(super) fn length(&mut self) -> Result<u32, Short> {
        let length = u32::from_le_bytes(self.value()?);
        let left = self.body.len() - self.at;
        if length as usize > left {
            return Err(Short { offset: self.before + self.at, wanted: length.into(), left });
        }
        Ok(length)
    }

    /// Text without the terminating zero of CDR.
    #[inline]
    pub(super) fn text(&mut self) -> Result<&'a [u8], Short> {
        let length = self.length()?;
        let bytes = self.take(1, length.into())?;
        match self.layout {
            Layout::Packed => Ok(bytes),
            Layout::Cdr | Layout::Cdr2 { .. } => Ok(bytes.strip_suffix(&[0]).unwrap_or(bytes)),
        }
    }

    /// Truncates fractions.
    #[inline]
    pub(super) fn integer(&mut self, primitive: Primitive) -> Result<i64, Short> {
        Ok(match primitive {
            Primitive::U64 => i64::try_from(u64::from_le_bytes(self.value()?)).unwrap_or(i64::MAX),
            Primitive::I64 => i64::from_le_bytes(self.value()?),
            other => self.number(other)? as i64,
        })
    }

    #[inline]
    pub(super) fn number(&mut self, primitive: Primitive) -> Result<f64, Short> {
        Ok(match primitive {
            Primitive::U8 => u8::from_le_bytes(self.value()?).into(),
            Primitive::I8 => i8::from_le_bytes(self.value()?).into(),
            Primitive::U16 => u16::from_le_bytes(self.value()?).into(),
            Primitive::I16 => i16::from_le_bytes(self.value()?).into(),
            Primitive::U32 => u32::from_le_bytes(self.value()?).into(),
            Primitive::I32 => i32::from_le_bytes(self.value()?).into(),
            Primitive::U64 => u64::from_le_bytes(self.value()?) as f64,
            Primitive::I64 => i64::from_le_bytes(self.value()?) as f64,
            Primitive::F32 => f32::from_le_bytes(self.value()?).into(),
            Primitive::F64 => f64::from_le_bytes(self.value()?),
        })
    }

    #[inline]
    pub(super) fn doubles(&mut self, values: &mut [f64]) -> Result<(), Short> {
        if self.big_endian {
            for value in values {
                *value = f64::from_le_bytes(self.value()?);
            }
            return Ok(());
        }
        let start = self.aligned(8);
        let rest = self.body.get(start..).unwrap_or_default();
        let Some(bytes) = rest.get(..8 * values.len()) else {
            let left = rest.len() % 8;
            let offset = self.before + start + rest.len() - left;
            return Err(Short { offset, wanted: 8, left });
        };
        for (value, &bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
            *value = f64::from_le_bytes(bytes);
        }
        self.at = start + bytes.len();
        Ok(())
    }

    /// Clears `list` if there are more numbers than [`MAX_LIST`].
    pub(super) fn numbers(
        &mut self,
        primitive: Primitive,
        count: u32,
        list: &mut Vec<f64>,
    ) -> Result<(), Short> {
        list.clear();
        // Check the bounds before allocating.
        let bytes = self.take(primitive.size(), count.into())?;
        if count as usize > MAX_LIST {
            return Ok(());
        }
        if primitive == Primitive::F64 && !self.big_endian {
            list.extend(bytes.as_chunks().0.iter().map(|&value| f64::from_le_bytes(value)));
            return Ok(());
        }
        let mut values = Cursor { body: bytes, at: 0, ..*self };
        list.reserve(count as usize);
        for _ in 0..count {
            list.push(values.number(primitive)?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_aligned_after_the_header() {
        let mut message = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        message.extend(1.5f64.to_le_bytes());
        let mut cursor = Cursor::cdr(&message).unwrap();
        assert_eq!(cursor.number(Primitive::U8), Ok(7.0));
        assert_eq!(cursor.number(Primitive::F64), Ok(1.5));
    }

    #[test]
    fn the_second_cdr_aligns_doubles_to_four() {
        let mut message = vec![0, 7, 0, 0, 7, 0, 0, 0];
        message.extend(1.5f64.to_le_bytes());
        let mut cursor = Cursor::cdr(&message).unwrap();
        assert_eq!(cursor.number(Primitive::U8), Ok(7.0));
        assert_eq!(cursor.number(Primitive::F64), Ok(1.5));
    }

    #[test]
    fn the_header_states_big_endian() {
        let mut message = vec![0, 0, 0, 0];
        message.extend((-5i32).to_be_bytes());
        message.extend([0, 0, 0, 3, b'a', b'b', 0]);
        let mut cursor = Cursor::cdr(&message).unwrap();
        assert_eq!(cursor.integer(Primitive::I32), Ok(-5));
        assert_eq!(cursor.text(), Ok(b"ab".as_slice()));
    }

    #[test]
    fn a_hostile_length_is_refused_before_allocation() {
        let message = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        let mut cursor = Cursor::cdr(&message).unwrap();
        let short = Short { offset: 8, wanted: u32::MAX.into(), left: 2 };
        assert_eq!(cursor.text(), Err(short));
        let mut list = Vec::new();
        let mut cursor = Cursor::cdr(&message).unwrap();
        assert!(cursor.numbers(Primitive::F64, u32::MAX, &mut list).is_err());
        assert_eq!(list.capacity(), 0);
    }

    #[test]
    fn ros_1_has_no_header_no_padding_and_no_zero_after_a_text() {
        let mut message = vec![7];
        message.extend(1.5f64.to_le_bytes());
        message.extend([2, 0, 0, 0, b'a', 0, 1, 2]);
        let mut cursor = Cursor::ros1(&message);
        assert_eq!(cursor.number(Primitive::U8), Ok(7.0));
        assert_eq!(cursor.number(Primitive::F64), Ok(1.5));
        assert_eq!(cursor.text(), Ok(b"a\0".as_slice()));
        let short = cursor.number(Primitive::F32).unwrap_err();
        assert_eq!(short, Short { offset: 15, wanted: 4, left: 2 });
    }

    #[test]
    fn nothing_beyond_the_end_of_a_delimited_message_is_read() {
        let message = [0, 9, 0, 0, 3, 0, 0, 0, 1, 2, 3, 4];
        let mut cursor = Cursor::cdr(&message).unwrap();
        let outside = cursor.enter().unwrap();
        assert_eq!(cursor.number(Primitive::U8), Ok(1.0));
        let short = Short { offset: 10, wanted: 2, left: 1 };
        assert_eq!(cursor.number(Primitive::U16), Err(short));
        cursor.leave(outside);
        assert_eq!(cursor.number(Primitive::U8), Ok(4.0));
    }

    #[test]
    fn errors_name_other_representations() {
        for id in [2, 3, 10, 11] {
            let refused = Cursor::cdr(&[0, id, 0, 0]).unwrap_err();
            assert_eq!(refused, EncapsulationError::ParameterList { id: id.into() });
        }
        let unknown = Cursor::cdr(&[0, 12, 0, 0]).unwrap_err();
        assert_eq!(unknown, EncapsulationError::Unknown { id: 12 });
        assert_eq!(Cursor::cdr(&[0, 1]).unwrap_err(), EncapsulationError::Short { len: 2 });
    }
}
