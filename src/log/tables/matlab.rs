//! MATLAB's `.mat` files of versions 5 to 7, as `save` writes them by default. Version 7.3 is HDF5.
//!
//! Format: MathWorks, *MAT-File Format*, level 5. A file is a header and data elements; a variable is an element of
//! elements, which may be compressed. Fields of structs become paths. `matlab/elements.rs` combines the arrays in the
//! elements of cell arrays and struct arrays.

mod elements;

use std::io::Read;

use flate2::read::ZlibDecoder;

use self::elements::{ElementArray, ElementArrays};
use super::chunks::checked_product;
use super::npy::{ElementType, RawArray, tables_of_arrays};
use super::{Episodes, MAX_COLUMNS, MAX_DEPTH, ReadContext, TableError, rate_of_scalars};
use crate::memory_budget::MemoryBudget;

pub(crate) const MAGIC: &[u8] = b"MATLAB 5.0 MAT-file";
const HEADER_BYTES: usize = 128;
/// Types of elements.
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of matrices.
const CELL: u32 = 1;
const STRUCT: u32 = 2;
const NUMERIC: std::ops::RangeInclusive<u32> = 6..=15;
const COMPLEX_FLAG: u32 = 0x800;
/// Arrays within the elements of cell arrays and struct arrays.
const MAX_ELEMENT_ARRAYS: usize = 1_000_000;

#[derive(Default)]
struct Variables {
    arrays: Vec<RawArray>,
    elements: Vec<ElementArray>,
    scalars: Vec<(String, f64)>,
    unread: Vec<(String, String)>,
}

pub(super) fn read(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let (header, content) =
        bytes.split_at_checked(HEADER_BYTES).ok_or("truncated within its header")?;
    let is_big = header.ends_with(b"MI");
    let mut found = Variables::default();
    let elements = Elements { bytes: content, is_big };
    for element in elements {
        let read = element.and_then(|element| found.add_variable(element, is_big, context.memory));
        if let Err(why) = read {
            why.report(None, context.losses);
        }
        if found.arrays.len() > MAX_COLUMNS {
            let what = format!("more than {MAX_COLUMNS} arrays; the others are not read");
            TableError::from(what).report(None, context.losses);
            break;
        }
    }
    let Variables { mut arrays, elements, scalars, mut unread } = found;
    let rate_hz = rate_of_scalars(&scalars);
    match elements::combine(elements, &arrays, &mut unread) {
        ElementArrays::Whole(combined) => {
            arrays.extend(combined);
            tables_of_arrays(arrays, rate_hz, unread, context)
        }
        ElementArrays::Episodes(episodes) => {
            let mut all = Episodes::new();
            for (at, mut own) in episodes.into_iter().enumerate() {
                elements::add_shared(&mut own, &arrays);
                let unread = std::mem::take(&mut unread);
                let rate_hz = rate_of_scalars(&elements::scalars(&own)).or(rate_hz);
                let tables = tables_of_arrays(own, rate_hz, unread, context)?;
                all.extend(tables.into_iter().map(|(_, table)| ((at + 1).to_string(), table)));
            }
            Ok(all)
        }
    }
}

#[derive(Clone, Copy)]
struct Element<'a> {
    kind: u32,
    data: &'a [u8],
}

struct Elements<'a> {
    bytes: &'a [u8],
    is_big: bool,
}

impl<'a> Iterator for Elements<'a> {
    type Item = Result<Element<'a>, TableError>;

    fn next(&mut self) -> Option<Self::Item> {
        /// Type and size.
        const TAG_BYTES: usize = 8;
        if self.bytes.is_empty() {
            return None;
        }
        let cut = |elements: &mut Self| {
            elements.bytes = &[];
            Some(Err("truncated within a variable".into()))
        };
        let Some((tag, rest)) = self.bytes.split_at_checked(TAG_BYTES) else { return cut(self) };
        let [first, size] = [&tag[..4], &tag[4..]].map(|word| number(word, self.is_big));
        // Up to four bytes are within the tag.
        if let (kind, small @ 1..=4) = (first & 0xffff, (first >> 16) as usize) {
            self.bytes = rest;
            return Some(Ok(Element { kind, data: &tag[4..4 + small] }));
        }
        let Some(data) = rest.get(..size as usize) else { return cut(self) };
        let padded = match first {
            COMPRESSED => data.len(),
            _ => data.len().next_multiple_of(TAG_BYTES),
        };
        self.bytes = rest.get(padded..).unwrap_or_default();
        Some(Ok(Element { kind: first, data }))
    }
}

/// Of four bytes.
fn number(bytes: &[u8], is_big: bool) -> u32 {
    let bytes = <[u8; 4]>::try_from(bytes).unwrap_or_default();
    if is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
}

impl Variables {
    fn add_variable(
        &mut self,
        element: Element<'_>,
        is_big: bool,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        match element.kind {
            MATRIX => self.add_matrix(element.data, is_big, &MatrixPlace::default(), memory),
            COMPRESSED => {
                let unpacked = unpack(element.data, is_big, memory)?;
                let mut inner = Elements { bytes: &unpacked, is_big };
                match inner.next() {
                    Some(Ok(Element { kind: MATRIX, data })) => {
                        self.add_matrix(data, is_big, &MatrixPlace::default(), memory)
                    }
                    Some(Err(why)) => Err(why),
                    _ => Ok(()),
                }
            }
            _ => Ok(()),
        }
    }

    fn add_matrix(
        &mut self,
        data: &[u8],
        is_big: bool,
        place: &MatrixPlace,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let mut elements = Elements { bytes: data, is_big };
        let mut next = || -> Result<Element<'_>, TableError> {
            elements.next().unwrap_or_else(|| Err("truncated within a variable".into()))
        };
        // An empty field of a struct has no elements.
        if data.is_empty() {
            return Ok(());
        }
        let flags = next()?.data.get(..4).map_or(0, |word| number(word, is_big));
        let sides = next()?.data.chunks_exact(4).map(|word| number(word, is_big) as usize);
        let sides: Vec<usize> = sides.collect();
        let own = next()?.data;
        let name = match place.path.as_str() {
            "" => String::from_utf8_lossy(own).into_owned(),
            path => path.to_owned(),
        };
        let count = checked_product(&sides).unwrap_or(usize::MAX);
        let class = flags & 0xff;
        let is_several = class == CELL || (class == STRUCT && count > 1);
        let why = match class {
            _ if count == 0 => return Ok(()),
            CELL | STRUCT if place.depth == MAX_DEPTH => "nested too deeply",
            CELL | STRUCT if is_several && place.element.is_some() => {
                "an array of cells or structs within another one; save its numbers as arrays"
            }
            CELL | STRUCT if count > MAX_ELEMENT_ARRAYS => "an array of too many elements",
            CELL => {
                for at in 0..count {
                    let place = place.inner(name.clone(), Some(at));
                    self.add_matrix(next()?.data, is_big, &place, memory)?;
                }
                return Ok(());
            }
            STRUCT => {
                let width = next()?.data.get(..4).map_or(0, |word| number(word, is_big) as usize);
                let fields: Vec<String> = next()?
                    .data
                    .chunks_exact(width.max(1))
                    .map(|field| field.split(|byte| *byte == 0).next().unwrap_or_default())
                    .map(|field| format!("{name}/{}", String::from_utf8_lossy(field)))
                    .collect();
                for at in 0..count {
                    for field in &fields {
                        let element = is_several.then_some(at).or(place.element);
                        let place = place.inner(field.clone(), element);
                        self.add_matrix(next()?.data, is_big, &place, memory)?;
                    }
                }
                return Ok(());
            }
            4 => "text, not numbers",
            5 => "a sparse matrix; save it as a full one",
            _ if !NUMERIC.contains(&class) => {
                "an object, such as a table or timeseries, not numbers; save its numbers as arrays"
            }
            _ if flags & COMPLEX_FLAG != 0 => "complex numbers",
            _ => {
                let Element { kind, data } = next()?;
                let array = (name, sides, element_type(kind, is_big), data);
                return self.add_array(array, place.element, memory);
            }
        };
        if place.element.is_none_or(|element| element == 0) {
            self.unread.push((name, why.to_owned()));
        }
        Ok(())
    }

    fn add_array(
        &mut self,
        (name, mut sides, kind, data): (String, Vec<usize>, Option<ElementType>, &[u8]),
        element: Option<usize>,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let Some(kind) = kind else {
            self.unread.push((name, "numbers of an unknown type".to_owned()));
            return Ok(());
        };
        if element.is_none() && sides.iter().all(|side| *side == 1) {
            let value = (data.len() >= kind.size()).then(|| kind.read(data));
            self.scalars.extend(value.map(|value| (name, value)));
            return Ok(());
        }
        // Numbers are stored by columns. The pages of a three-dimensional array are its rows.
        let is_fortran = sides.len() < 3;
        match sides.as_slice() {
            &[1, count] => sides = vec![count],
            [_, _] => {}
            _ => sides.reverse(),
        }
        memory.reserve_bytes(data.len() as u64)?;
        let array = RawArray { name, element: kind, sides, is_fortran, data: data.to_vec() };
        match element {
            Some(_) if self.elements.len() >= MAX_ELEMENT_ARRAYS => {
                return Err(format!("more than {MAX_ELEMENT_ARRAYS} arrays in its elements").into());
            }
            Some(element) => self.elements.push(ElementArray { element, array }),
            None => self.arrays.push(array),
        }
        Ok(())
    }
}

/// Place of a matrix within a variable.
#[derive(Default)]
struct MatrixPlace {
    /// Names a field of a struct, or a cell. Empty for variables, which have their own names.
    path: String,
    depth: usize,
    /// Index in a cell array or struct array.
    element: Option<usize>,
}

impl MatrixPlace {
    fn inner(&self, path: String, element: Option<usize>) -> Self {
        Self { path, depth: self.depth + 1, element }
    }
}

/// The size of the element within is in its tag.
fn unpack(packed: &[u8], is_big: bool, memory: &MemoryBudget) -> Result<Vec<u8>, TableError> {
    let unpacked = |most: u64| -> Result<Vec<u8>, TableError> {
        let mut content = Vec::new();
        ZlibDecoder::new(packed)
            .take(most)
            .read_to_end(&mut content)
            .map_err(|error| format!("a variable cannot be unpacked: {error}"))?;
        Ok(content)
    };
    let tag = unpacked(8)?;
    let size = tag.get(4..).map_or(0, |word| number(word, is_big));
    let needed = u64::from(size).saturating_add(8);
    memory.check_available(needed)?;
    unpacked(needed)
}

/// Of a stored type, which may be smaller than the variable's.
fn element_type(kind: u32, is_big: bool) -> Option<ElementType> {
    let name = match kind {
        1 => "i1",
        2 => "u1",
        3 => "i2",
        4 => "u2",
        5 => "i4",
        6 => "u4",
        7 => "f4",
        9 => "f8",
        12 => "i8",
        13 => "u8",
        _ => return None,
    };
    ElementType::parse(&format!("{}{name}", if is_big { '>' } else { '<' }))
}
