//! NumPy's `.npy` arrays and `.npz` archives.
//!
//! Format: NumPy Enhancement Proposal 1 (`numpy.lib.format`), versions 1 to 3.

use std::io::{Cursor, Read};

use super::chunks::{checked_product, column_major_index};
use super::{
    Column, Episodes, MAX_COLUMNS, MAX_WIDTH, ReadColumn, ReadContext, RowCounts, Table,
    TableError, is_transposed, rate_of_scalars, row_counts,
};
use crate::memory_budget::MemoryBudget;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";
const MAX_HEADER_BYTES: usize = 1 << 16;

#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct ElementType {
    letter: u8,
    size: usize,
    is_big: bool,
}

impl ElementType {
    /// Parses `<f8` and the like; `None` if not numeric.
    pub fn parse(text: &str) -> Option<Self> {
        let bare = text.trim_start_matches(['<', '>', '|', '=']);
        let (letter, size) = bare.split_at_checked(1)?;
        let (letter, size) = (letter.as_bytes()[0], size.parse().ok()?);
        let is_known = match letter {
            b'f' => matches!(size, 2 | 4 | 8),
            b'i' | b'u' => matches!(size, 1 | 2 | 4 | 8),
            b'b' => size == 1,
            _ => false,
        };
        is_known.then_some(Self { letter, size, is_big: text.starts_with('>') })
    }

    pub fn size(self) -> usize {
        self.size
    }

    pub fn is_float(self) -> bool {
        self.letter == b'f'
    }

    pub fn name(self) -> String {
        let name = match self.letter {
            b'f' => "float",
            b'i' => "int",
            b'u' => "uint",
            _ => return "bool".to_owned(),
        };
        format!("{name}{}", 8 * self.size)
    }

    pub fn read(self, bytes: &[u8]) -> f64 {
        let mut own = [0; 8];
        own[..self.size].copy_from_slice(&bytes[..self.size]);
        if self.is_big {
            own[..self.size].reverse();
        }
        let raw = u64::from_le_bytes(own);
        let spare = 64 - 8 * self.size as u32;
        match (self.letter, self.size) {
            (b'f', 2) => half_to_f64(raw as u16),
            (b'f', 4) => f32::from_bits(raw as u32).into(),
            (b'f', _) => f64::from_bits(raw),
            (b'i', _) => ((raw << spare) as i64 >> spare) as f64,
            _ => raw as f64,
        }
    }
}

/// 16-bit float: sign, 5 bits of exponent, 10 of fraction.
fn half_to_f64(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 if fraction > 0.0 => f64::NAN,
        31 => f64::INFINITY,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// Numbers of an array with one dimension. `None` for other arrays.
pub(super) fn single_numbers(bytes: &[u8]) -> Option<Vec<f64>> {
    let (header, kind, data) = plain_array(bytes)?;
    let ([rows] | [rows, 1]) = header.shape.as_slice() else { return None };
    Some(data.chunks_exact(kind.size).take(*rows).map(|bytes| kind.read(bytes)).collect())
}

/// An array of one type of numbers, without fields.
fn plain_array(bytes: &[u8]) -> Option<(Header, ElementType, &[u8])> {
    let (header, data) = bytes.starts_with(MAGIC).then(|| parse_header(bytes).ok()).flatten()?;
    let [(_, kind, 0, 1)] = header.fields.as_slice() else { return None };
    let kind = *kind;
    Some((header, kind, data))
}

/// Each field has a name, a type, an offset in a row and a width.
#[derive(Clone)]
struct Header {
    fields: Vec<(String, ElementType, usize, usize)>,
    row_bytes: usize,
    shape: Vec<usize>,
    is_fortran: bool,
}

pub(super) fn read_npy(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let (header, data) = parse_header(bytes)?;
    let rows = row_counts(std::slice::from_ref(&header.shape));
    let array = NpyArray::new("array", header, data.len(), &rows)?;
    let candidates = array.columns(data, context.memory)?;
    Ok(vec![("0".to_owned(), Table::from_columns(candidates, None, context.memory))])
}

/// Arrays with the same number of rows form one table; a scalar called `fps` or similar is the rate.
/// Unpacks only members whose headers declare numbers, one by one.
pub(super) fn read_npz(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes))
        .map_err(|error| format!("the zip archive cannot be read: {error}"))?;
    let (mut arrays, mut scalars) = (Vec::new(), Vec::new());
    let (mut unread, mut candidates) = (Vec::new(), Vec::new());
    let count = archive.len();
    if count > MAX_COLUMNS {
        let what = format!("{count} arrays; only {MAX_COLUMNS} are read");
        TableError::from(what).report(None, context.losses);
    }
    for index in 0..count.min(MAX_COLUMNS) {
        let name = archive.name_for_index(index).and_then(Result::ok);
        let Some(name) = name.and_then(|name| name.strip_suffix(".npy").map(str::to_owned)) else {
            continue;
        };
        match unpack_member(&mut archive, index, MAX_HEADER_BYTES as u64 + 64) {
            Ok(head) => match parse_header(&head) {
                Ok((header, _)) if header.is_scalar() => {
                    scalars.extend(scalar_value(&head).map(|value| (name, value)));
                }
                Ok((header, data)) => arrays.push((index, name, header, head.len() - data.len())),
                Err(why) => unread.push((name, why.to_string())),
            },
            Err(why) => why.in_part(&name).report(None, context.losses),
        }
    }
    let shapes: Vec<Vec<usize>> =
        arrays.iter().map(|(_, _, header, _)| header.shape.clone()).collect();
    let common = row_counts(&shapes);
    for (index, name, header, begin) in arrays {
        let needed = header.bytes().and_then(|bytes| bytes.checked_add(begin));
        let array =
            match NpyArray::new(&name, header, needed.unwrap_or(usize::MAX) - begin, &common) {
                Ok(array) => array,
                Err(why) => {
                    unread.push((name, why.to_string()));
                    continue;
                }
            };
        let rows = array.rows;
        // Unpacked bytes and numbers are in memory at the same time.
        let most = needed.unwrap_or(usize::MAX) as u64;
        let read = context.memory.check_available(most).map_err(TableError::from);
        // One extra byte reaches the end, which verifies the checksum.
        let read = read.and_then(|()| unpack_member(&mut archive, index, most.saturating_add(1)));
        let read = read.and_then(|content| {
            array.columns(content.get(begin..).unwrap_or_default(), context.memory)
        });
        match read {
            Ok(columns) => candidates.extend(columns),
            Err(why) => candidates.push(ReadColumn::unreadable(&name, rows, why)),
        }
    }
    let rate_hz = rate_of_scalars(&scalars);
    tables_of_columns(candidates, rate_hz, unread, context)
}

fn tables_of_columns(
    columns: Vec<ReadColumn>,
    rate_hz: Option<f64>,
    unread: Vec<(String, String)>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    if columns.is_empty() {
        let first = unread.first().map(|(name, why)| format!("; '{name}': {why}"));
        return Err(format!("it contains no array of numbers{}", first.unwrap_or_default()).into());
    }
    let mut tables = Table::by_row_count(columns, context.memory);
    tables[0].rate_hz = rate_hz;
    tables[0].unread.extend(unread);
    Ok(tables.into_iter().map(|table| ("0".to_owned(), table)).collect())
}

/// An array of another format, with its numbers.
#[derive(Clone)]
pub(super) struct RawArray {
    pub name: String,
    pub element: ElementType,
    pub sides: Vec<usize>,
    pub is_fortran: bool,
    pub data: Vec<u8>,
}

/// Tables of arrays with the same number of rows. The bytes of the arrays are reserved.
pub(super) fn tables_of_arrays(
    arrays: Vec<RawArray>,
    rate_hz: Option<f64>,
    mut unread: Vec<(String, String)>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let shapes: Vec<Vec<usize>> = arrays.iter().map(|array| array.sides.clone()).collect();
    let common = row_counts(&shapes);
    let mut candidates = Vec::new();
    for RawArray { name, element, sides, is_fortran, data } in arrays {
        let fields = vec![(String::new(), element, 0, 1)];
        let header = Header { fields, row_bytes: element.size, shape: sides, is_fortran };
        match NpyArray::new(&name, header, data.len(), &common) {
            Ok(array) => match array.columns(&data, context.memory) {
                Ok(columns) => candidates.extend(columns),
                Err(why) => candidates.push(ReadColumn::unreadable(&name, array.rows, why)),
            },
            Err(why) => unread.push((name.clone(), why.to_string())),
        }
        context.memory.release(data.len() / 8);
    }
    tables_of_columns(candidates, rate_hz, unread, context)
}

type Archive<'a> = zip::ZipArchive<Cursor<&'a [u8]>>;

fn unpack_member(archive: &mut Archive, index: usize, most: u64) -> Result<Vec<u8>, TableError> {
    let member = archive.by_index(index).map_err(|error| format!("it cannot be read: {error}"))?;
    let mut content = Vec::new();
    member
        .take(most)
        .read_to_end(&mut content)
        .map_err(|error| format!("it cannot be unpacked: {error}"))?;
    Ok(content)
}

impl Header {
    fn bytes(&self) -> Option<usize> {
        checked_product(&self.shape)?.checked_mul(self.row_bytes)
    }

    fn is_scalar(&self) -> bool {
        matches!(self.fields.as_slice(), [(_, _, 0, 1)])
            && self.shape.len() < 2
            && self.shape.iter().product::<usize>() == 1
    }
}

fn scalar_value(bytes: &[u8]) -> Option<f64> {
    let (header, data) = parse_header(bytes).ok()?;
    let [(_, kind, 0, 1)] = header.fields.as_slice() else { return None };
    (header.is_scalar() && data.len() >= kind.size).then(|| kind.read(data))
}

struct NpyArray<'a> {
    name: &'a str,
    header: Header,
    rows: usize,
    /// Elements per row.
    inner: usize,
    is_record: bool,
}

impl<'a> NpyArray<'a> {
    /// Checks the header against the `bytes` of data.
    fn new(
        name: &'a str,
        header: Header,
        bytes: usize,
        rows: &RowCounts,
    ) -> Result<Self, TableError> {
        let mut header = header;
        if is_transposed(&header.shape, rows) {
            header.shape.swap(0, 1);
            header.is_fortran = !header.is_fortran;
        }
        let rows = *header.shape.first().ok_or("it is a single number")?;
        let inner = checked_product(&header.shape[1..]);
        let sides = || {
            let sides: Vec<String> = header.shape[1..].iter().map(usize::to_string).collect();
            format!(
                "its rows have {} numbers, as images have; save each of several episodes as an array of its own",
                sides.join(" × ")
            )
        };
        let inner = inner.filter(|inner| (1..=MAX_WIDTH).contains(inner)).ok_or_else(sides)?;
        // Without data, the declared size is not credible.
        if header.bytes().is_none() || (rows > 0 && bytes == 0) {
            return Err(format!("it declares {rows} rows of {inner} numbers without data").into());
        }
        let is_record = header.fields.len() > 1 || !header.fields[0].0.is_empty();
        if is_record && inner > 1 {
            return Err("its records have more than one dimension".into());
        }
        Ok(Self { name, header, rows, inner, is_record })
    }

    fn columns(
        &self,
        data: &[u8],
        memory: &mut MemoryBudget,
    ) -> Result<Vec<ReadColumn>, TableError> {
        let Self { name, header, rows, inner, is_record } = self;
        let Header { fields, row_bytes, shape, is_fortran } = header;
        let (rows, inner) = (*rows, *inner);
        let elements = data.len() / (*row_bytes).max(1);
        let by_columns = *is_fortran && inner > 1;
        // In column-major order the last number completes a row.
        let there = match by_columns {
            true => elements.saturating_sub(rows * (inner - 1)).min(rows),
            false => (elements / inner).min(rows),
        };
        let wide: usize = fields.iter().map(|(_, _, _, wide)| wide * inner).sum();
        memory.reserve(there.saturating_mul(wide))?;
        let why = (there < rows).then(|| {
            let needed = rows.saturating_mul(inner).saturating_mul(*row_bytes);
            format!("truncated: {needed} bytes declared, {} present", data.len()).into()
        });
        let columns = fields.iter().map(|(field, kind, at, wide)| {
            let element = |number: usize| kind.read(&data[number * row_bytes + at..]);
            let values = match (is_record, by_columns) {
                (true, _) => (0..there)
                    .flat_map(|row| (0..*wide).map(move |part| (row, part)))
                    .map(|(row, part)| kind.read(&data[row * row_bytes + at + part * kind.size..]))
                    .collect(),
                (false, false) => (0..there * inner).map(element).collect(),
                // The first index varies fastest; reorder the others to row-major.
                (false, true) => (0..there)
                    .flat_map(|row| (0..inner).map(move |part| (row, part)))
                    .map(|(row, part)| element(row + rows * column_major_index(part, &shape[1..])))
                    .collect(),
            };
            let name = if field.is_empty() { (*name).to_owned() } else { field.clone() };
            let width = if *is_record { *wide } else { inner };
            let column = Column { name, kind: kind.name(), width, values, ..Column::default() };
            ReadColumn { column, rows, lost: Vec::new(), why: Option::clone(&why) }
        });
        Ok(columns.collect())
    }
}

/// Returns the header and the bytes after it.
fn parse_header(bytes: &[u8]) -> Result<(Header, &[u8]), TableError> {
    let cut = || TableError::from("truncated within its header");
    let rest = bytes.strip_prefix(MAGIC).ok_or("not an NPY array")?;
    let (version, rest) = rest.split_at_checked(2).ok_or_else(cut)?;
    let wide = if version[0] >= 2 { 4 } else { 2 };
    let (length, rest) = rest.split_at_checked(wide).ok_or_else(cut)?;
    let length = length.iter().rev().fold(0, |all, byte| all << 8 | usize::from(*byte));
    if length > MAX_HEADER_BYTES {
        return Err(format!("its header has {length} bytes, too many").into());
    }
    let (text, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    let text = std::str::from_utf8(text).map_err(|_| "its header is not text")?;
    let header = parse_header_text(text).ok_or(match text.contains("O'") {
        true => "it contains Python objects, which cannot be read; save plain arrays",
        false => "its header does not describe numbers",
    })?;
    Ok((header, data))
}

fn parse_header_text(text: &str) -> Option<Header> {
    let after =
        |key: &str| text.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let is_fortran = after("fortran_order")?.starts_with("True");
    let shape = after("shape")?.strip_prefix('(')?.split_once(')')?.0;
    let sides = shape.split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Option<Vec<usize>> =
        sides.map(|side| side.trim_end_matches('L').parse().ok()).collect();
    let kind = after("descr")?;
    let quoted = |text: &str| -> Option<String> {
        let quote = text.chars().next().filter(|c| ['\'', '"'].contains(c))?;
        text[1..].split_once(quote).map(|(own, _)| own.to_owned())
    };
    let mut fields = Vec::new();
    let mut at = 0;
    match kind.strip_prefix('[') {
        None => {
            let kind = ElementType::parse(&quoted(kind)?)?;
            fields.push((String::new(), kind, 0, 1));
            at = kind.size;
        }
        Some(mut rest) => {
            // A sequence of ('name', '<f8') and ('name', '<f8', (6,)).
            while let Some((_, field)) =
                rest.split_once('(').filter(|(before, _)| !before.contains(']'))
            {
                let name = quoted(field)?;
                let behind =
                    field.get(name.len() + 2..)?.trim_start().strip_prefix(',')?.trim_start();
                let kind_text = quoted(behind)?;
                let kind = ElementType::parse(&kind_text)?;
                let behind = behind.get(kind_text.len() + 2..)?.trim_start();
                let (wide, behind) = match behind.strip_prefix(',').map(str::trim_start) {
                    Some(sides) => {
                        let (sides, behind) = sides.strip_prefix('(')?.split_once(')')?;
                        let sides = sides.split(',').map(str::trim).filter(|side| !side.is_empty());
                        let wide: Option<usize> =
                            sides.map(|side| side.parse::<usize>().ok()).product();
                        (wide.filter(|wide| (1..=MAX_WIDTH).contains(wide))?, behind)
                    }
                    None => (1, behind),
                };
                rest = behind.split_once(')')?.1;
                fields.push((name, kind, at, wide));
                at += wide * kind.size;
            }
        }
    }
    (!fields.is_empty()).then_some(Header { fields, row_bytes: at, shape: shape?, is_fortran })
}

#[cfg(test)]
mod tests {
    use super::ElementType;

    /// Reference values from `numpy.float16`.
    #[test]
    fn half_floats_are_read() {
        let cases = [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_953_125),
            (0x7bff, 65504.0),
            (0x0001, 5.960_464_477_539_063e-8),
            (0x0400, 6.103_515_625e-5),
            (0xfc00, f64::NEG_INFINITY),
        ];
        for (bits, number) in cases {
            let read =
                |kind: &str, bytes: [u8; 2]| ElementType::parse(kind).expect("known").read(&bytes);
            assert_eq!(read("<f2", u16::to_le_bytes(bits)), number, "{bits:x}");
            assert_eq!(read(">f2", u16::to_be_bytes(bits)), number, "{bits:x}");
        }
        assert!(ElementType::parse("<f2").expect("known").read(&[0xff, 0x7f]).is_nan());
    }
}
