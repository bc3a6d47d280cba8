//! NumPy's `.npy` arrays and `.npz` archives of them.
//!
//! Format: NumPy Enhancement Proposal 1 (`numpy.lib.format`), versions 1 to 3.

use std::io::{Cursor, Read};

use super::{
    Column, Episodes, MOST_COLUMNS, MOST_NUMBERS, MOST_WIDE, Refusal, Table, common_rows,
    lies_on_side,
};

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest header that is read.
const MOST_HEADER: usize = 1 << 16;

/// One element: how its bytes are read.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Kind {
    letter: u8,
    size: usize,
    is_big: bool,
}

impl Kind {
    /// Of a text such as `<f8`; `None` for what holds no numbers.
    pub fn of(text: &str) -> Option<Self> {
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
            (b'f', 2) => half(raw as u16),
            (b'f', 4) => f32::from_bits(raw as u32).into(),
            (b'f', _) => f64::from_bits(raw),
            (b'i', _) => ((raw << spare) as i64 >> spare) as f64,
            _ => raw as f64,
        }
    }
}

/// A float of 16 bits: a sign, 5 bits of exponent, 10 of fraction.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 if fraction > 0.0 => f64::NAN,
        31 => f64::INFINITY,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// What the header says: fields with their places in a row, the shape, and whether columns come first.
struct Header {
    fields: Vec<(String, Kind, usize, usize)>,
    row_bytes: usize,
    shape: Vec<usize>,
    is_fortran: bool,
}

/// An array alone.
pub(super) fn npy(bytes: &[u8]) -> Result<Episodes, Refusal> {
    let rows = common_rows(&shape_of(bytes).into_iter().collect::<Vec<_>>());
    let (columns, rows) = array("array", bytes, rows)?;
    Ok(vec![("0".to_owned(), Table { rows, columns, rate_hz: None, ..Table::default() })])
}

/// An archive: its arrays of most rows are one table; a scalar called `fps` or the like is its rate.
pub(super) fn npz(bytes: &[u8]) -> Result<Episodes, Refusal> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes))
        .map_err(|error| format!("the zip archive cannot be read: {error}"))?;
    let (mut arrays, mut rate_hz): (Vec<(String, Vec<u8>)>, _) = (Vec::new(), None);
    let mut budget = MOST_NUMBERS;
    for index in 0..archive.len().min(MOST_COLUMNS) {
        let entry =
            archive.by_index(index).map_err(|error| format!("a member cannot be read: {error}"))?;
        let name = entry.name().ok().and_then(|name| name.strip_suffix(".npy").map(str::to_owned));
        let Some(name) = name else { continue };
        let mut content = Vec::new();
        let most = 8 * budget as u64;
        let read = entry.take(most + 1).read_to_end(&mut content);
        read.map_err(|error| format!("'{name}' cannot be unpacked: {error}"))?;
        if content.len() as u64 > most {
            return Err(format!("its arrays have more than {MOST_NUMBERS} numbers"));
        }
        if let Some(scalar) = scalar(&content) {
            if ["fps", "rate", "hz", "rate_hz", "frequency", "control_freq"]
                .contains(&name.as_str())
            {
                rate_hz = Some(scalar).filter(|rate| *rate > 0.0);
            }
            continue;
        }
        arrays.push((name, content));
        budget = budget.saturating_sub(arrays.last().map_or(0, |(_, content)| content.len() / 8));
    }
    let shapes: Vec<Vec<usize>> = arrays.iter().filter_map(|(_, bytes)| shape_of(bytes)).collect();
    let common = common_rows(&shapes);
    let mut table = Table { rate_hz, ..Table::default() };
    let mut read = Vec::new();
    for (name, content) in arrays {
        match array(&name, &content, common) {
            Ok((columns, rows)) => read.push((name, columns, rows)),
            Err(why) => table.unread.push((name, why)),
        }
    }
    table.rows =
        read.iter().map(|(_, _, rows)| *rows).max().ok_or("it holds no array of numbers")?;
    for (name, columns, rows) in read {
        match rows == table.rows {
            true => table.columns.extend(columns),
            false => table.unread.push((name, format!("{rows} rows, not {}", table.rows))),
        }
    }
    Ok(vec![("0".to_owned(), table)])
}

/// The shape of an array.
fn shape_of(bytes: &[u8]) -> Option<Vec<usize>> {
    header(bytes).ok().map(|(header, _)| header.shape)
}

/// The number of an array without dimensions.
fn scalar(bytes: &[u8]) -> Option<f64> {
    let (header, data) = header(bytes).ok()?;
    let [(_, kind, 0, 1)] = header.fields.as_slice() else { return None };
    (header.shape.iter().product::<usize>() == 1
        && header.shape.len() < 2
        && data.len() >= kind.size)
        .then(|| kind.read(data))
}

/// The columns of one array, and its rows; an array on its side, of `rows` columns, is transposed.
fn array(name: &str, bytes: &[u8], rows: usize) -> Result<(Vec<Column>, usize), Refusal> {
    let (header, data) = header(bytes)?;
    let Header { fields, row_bytes, mut shape, mut is_fortran } = header;
    if lies_on_side(&shape, rows) {
        shape.swap(0, 1);
        is_fortran = !is_fortran;
    }
    let rows = *shape.first().ok_or("it is a single number")?;
    let inner = shape[1..].iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
    let inner = inner
        .filter(|inner| (1..=MOST_WIDE).contains(inner))
        .ok_or("its rows are images or empty")?;
    let count = rows.checked_mul(inner).filter(|count| *count <= MOST_NUMBERS);
    let needed = count.and_then(|count| count.checked_mul(row_bytes));
    let (count, needed) =
        count.zip(needed).ok_or_else(|| format!("it declares {rows} rows of {inner} numbers"))?;
    if data.len() < needed {
        return Err(format!(
            "it is cut off: {rows} rows take {needed} bytes, and {} are there",
            data.len()
        ));
    }
    let is_record = fields.len() > 1 || !fields[0].0.is_empty();
    if is_record && inner > 1 {
        return Err("its records are in more than one dimension".to_owned());
    }
    let columns = fields.iter().map(|(field, kind, at, wide)| {
        let element = |number: usize| kind.read(&data[number * row_bytes + at..]);
        let values = match (is_record, is_fortran && inner > 1) {
            (true, _) => (0..rows)
                .flat_map(|row| (0..*wide).map(move |part| (row, part)))
                .map(|(row, part)| kind.read(&data[row * row_bytes + at + part * kind.size..]))
                .collect(),
            (false, false) => (0..count).map(element).collect(),
            // The first side goes fastest; the others are taken in their own order.
            (false, true) => (0..rows)
                .flat_map(|row| (0..inner).map(move |part| (row, part)))
                .map(|(row, part)| element(row + rows * transposed(part, &shape[1..])))
                .collect(),
        };
        let name = if field.is_empty() { name.to_owned() } else { field.clone() };
        let width = if is_record { *wide } else { inner };
        Column { name, kind: kind.name(), width, parts: Vec::new(), values }
    });
    Ok((columns.collect(), rows))
}

/// The place by columns of what is number `part` by rows.
fn transposed(part: usize, sides: &[usize]) -> usize {
    let mut rest = part;
    let mut places: Vec<usize> = sides
        .iter()
        .rev()
        .map(|side| {
            let place = rest % side;
            rest /= side;
            place
        })
        .collect();
    places.reverse();
    let mut step = 1;
    places
        .iter()
        .zip(sides)
        .map(|(place, side)| {
            let at = place * step;
            step *= side;
            at
        })
        .sum()
}

/// The header, and the bytes behind it.
fn header(bytes: &[u8]) -> Result<(Header, &[u8]), Refusal> {
    let cut = || "it is cut off within its header".to_owned();
    let rest = bytes.strip_prefix(MAGIC).ok_or("it is no NPY array")?;
    let (version, rest) = rest.split_at_checked(2).ok_or_else(cut)?;
    let wide = if version[0] >= 2 { 4 } else { 2 };
    let (length, rest) = rest.split_at_checked(wide).ok_or_else(cut)?;
    let length = length.iter().rev().fold(0, |all, byte| all << 8 | usize::from(*byte));
    if length > MOST_HEADER {
        return Err(format!("its header has {length} bytes"));
    }
    let (text, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    let text = std::str::from_utf8(text).map_err(|_| "its header is no text")?;
    let header = parsed(text).ok_or_else(|| match text.contains("O'") {
        true => "it holds Python objects, which are not read; save plain arrays".to_owned(),
        false => "its header does not describe numbers".to_owned(),
    })?;
    Ok((header, data))
}

fn parsed(text: &str) -> Option<Header> {
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
            let kind = Kind::of(&quoted(kind)?)?;
            fields.push((String::new(), kind, 0, 1));
            at = kind.size;
        }
        Some(mut rest) => {
            // ('name', '<f8'), ('name', '<f8', (6,)): one after another.
            while let Some((_, field)) =
                rest.split_once('(').filter(|(before, _)| !before.contains(']'))
            {
                let name = quoted(field)?;
                let behind =
                    field.get(name.len() + 2..)?.trim_start().strip_prefix(',')?.trim_start();
                let kind_text = quoted(behind)?;
                let kind = Kind::of(&kind_text)?;
                let behind = behind.get(kind_text.len() + 2..)?.trim_start();
                let (wide, behind) = match behind.strip_prefix(',').map(str::trim_start) {
                    Some(sides) => {
                        let (sides, behind) = sides.strip_prefix('(')?.split_once(')')?;
                        let sides = sides.split(',').map(str::trim).filter(|side| !side.is_empty());
                        let wide: Option<usize> =
                            sides.map(|side| side.parse::<usize>().ok()).product();
                        (wide.filter(|wide| (1..=MOST_WIDE).contains(wide))?, behind)
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
    use super::Kind;

    /// What `numpy.float16` makes of these bits.
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
            let read = |kind: &str, bytes: [u8; 2]| Kind::of(kind).expect("known").read(&bytes);
            assert_eq!(read("<f2", u16::to_le_bytes(bits)), number, "{bits:x}");
            assert_eq!(read(">f2", u16::to_be_bytes(bits)), number, "{bits:x}");
        }
        assert!(Kind::of("<f2").expect("known").read(&[0xff, 0x7f]).is_nan());
    }
}
