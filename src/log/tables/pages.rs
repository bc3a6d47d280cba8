//! Page headers of a Parquet column, read in advance.
//!
//! Format: `PageHeader` of parquet.thrift, in Thrift's compact protocol.

use parquet::column::page::PageMetadata;

/// Nesting depth of skipped structures.
const MAX_DEPTH: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PageHeader {
    pub is_dictionary: bool,
    /// Count, including nulls.
    pub values: usize,
    /// Version 2 pages only.
    rows: Option<usize>,
    pub unpacked_bytes: usize,
}

impl PageHeader {
    pub fn metadata(self) -> PageMetadata {
        let num_levels = (!self.is_dictionary).then_some(self.values);
        PageMetadata { num_rows: self.rows, num_levels, is_dict: self.is_dictionary }
    }
}

/// Valid headers up to the first damaged one, without index pages.
pub(super) fn headers(mut column: &[u8]) -> Vec<PageHeader> {
    let mut found = Vec::new();
    while !column.is_empty() {
        let mut reader = Reader { rest: column };
        let Some((header, packed_bytes)) = reader.page() else { break };
        let Some(rest) = reader.rest.get(packed_bytes..) else { break };
        found.extend(header);
        column = rest;
    }
    found
}

struct Reader<'a> {
    rest: &'a [u8],
}

/// Types of Thrift's compact protocol.
const STOP: u8 = 0;
const TRUE: u8 = 1;
const FALSE: u8 = 2;
const I32: u8 = 5;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
const STRUCT: u8 = 12;

/// Page types.
const DATA: i64 = 0;
const INDEX: i64 = 1;
const DICTIONARY: i64 = 2;
const DATA_V2: i64 = 3;

impl Reader<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*first)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn integer(&mut self) -> Option<i64> {
        let raw = self.varint()?;
        Some((raw >> 1).cast_signed() ^ -(raw & 1).cast_signed())
    }

    /// Number and type of the next field after field `last`. The inner `None` marks the end.
    fn field(&mut self, last: &mut i64) -> Option<Option<(i64, u8)>> {
        let byte = self.byte()?;
        let kind = byte & 0x0f;
        if kind == STOP {
            return Some(None);
        }
        *last = match byte >> 4 {
            0 => self.integer()?,
            step => last.checked_add(step.into())?,
        };
        Some(Some((*last, kind)))
    }

    fn skip(&mut self, kind: u8, deep: usize) -> Option<()> {
        let deep = deep.checked_sub(1)?;
        match kind {
            TRUE | FALSE => {}
            3 => _ = self.byte()?,
            4..=6 => _ = self.varint()?,
            7 => self.rest = self.rest.get(8..)?,
            BINARY => {
                let length = usize::try_from(self.varint()?).ok()?;
                self.rest = self.rest.get(length..)?;
            }
            LIST | SET => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { (head >> 4).into() };
                for _ in 0..count {
                    // A boolean in a list takes one byte.
                    self.skip(if matches!(head & 15, TRUE | FALSE) { 3 } else { head & 15 }, deep)?;
                }
            }
            STRUCT => {
                let mut last = 0;
                while let Some((_, kind)) = self.field(&mut last)? {
                    self.skip(kind, deep)?;
                }
            }
            _ => return None,
        }
        Some(())
    }

    /// `None` for an index page; and the packed size of the page.
    fn page(&mut self) -> Option<(Option<PageHeader>, usize)> {
        let (mut kind, mut unpacked, mut packed, mut data, mut data_v2) =
            (None, None, None, None, None);
        let mut last = 0;
        while let Some((number, of)) = self.field(&mut last)? {
            match (number, of) {
                (1, I32) => kind = Some(self.integer()?),
                (2, I32) => unpacked = Some(self.integer()?),
                (3, I32) => packed = Some(self.integer()?),
                (5, STRUCT) => data = Some(self.counts()?),
                (8, STRUCT) => data_v2 = Some(self.counts()?),
                _ => self.skip(of, MAX_DEPTH)?,
            }
        }
        let size = |number: i64| usize::try_from(number).ok();
        let (unpacked_bytes, packed_bytes) = (size(unpacked?)?, size(packed?)?);
        let whole = |is_dictionary: bool, (values, rows): (i64, Option<i64>)| {
            let (values, rows) = (size(values)?, rows.map(size));
            Some(PageHeader { is_dictionary, values, rows: rows.flatten(), unpacked_bytes })
        };
        let header = match kind? {
            INDEX => None,
            DICTIONARY => Some(whole(true, (0, None))?),
            DATA => Some(whole(false, (data?.0, None))?),
            DATA_V2 => Some(whole(false, data_v2?)?),
            _ => return None,
        };
        Some((header, packed_bytes))
    }

    /// Fields 1 and 3 of a data page header: values and rows.
    fn counts(&mut self) -> Option<(i64, Option<i64>)> {
        let (mut values, mut rows, mut last) = (None, None, 0);
        while let Some((number, kind)) = self.field(&mut last)? {
            match (number, kind) {
                (1, I32) => values = Some(self.integer()?),
                (3, I32) => rows = Some(self.integer()?),
                _ => self.skip(kind, MAX_DEPTH)?,
            }
        }
        Some((values?, rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_headers_are_read_up_to_the_first_damaged_one() {
        // Type 0, 30 bytes unpacked, 4 packed, 7 values in encodings 0, 3 and 3; then the page.
        let page = [
            0x15, 0, 0x15, 60, 0x15, 8, 0x2c, 0x15, 14, 0x15, 0, 0x15, 6, 0x15, 6, 0, 0, 1, 2, 3, 4,
        ];
        let header = PageHeader { is_dictionary: false, values: 7, rows: None, unpacked_bytes: 30 };
        let two = [page, page].concat();
        assert_eq!(headers(&two), [header, header]);
        assert_eq!(headers(&two[..two.len() - 1]), [header]);
        for at in 0..two.len() {
            for value in [0, 1, 0x0c, 0x2c, 0x7f, 0x80, 0xff] {
                let mut other = two.clone();
                other[at] = value;
                assert!(headers(&other).len() <= 2);
            }
        }
        // Lists of booleans without content must end.
        assert_eq!(headers(&[0x19, 0xf1, 0xff, 0xff, 0xff, 0xff, 0x0f]), []);
        assert_eq!(headers(&[0x1c; 1000]), []);
    }
}
