//! One array of a store: metadata and rows.

use std::ops::Range;

use serde_json::Value;

use super::codec::Codec;
use super::store::ZarrStore;
use crate::memory_budget::MemoryBudget;
use crate::tables::chunks::{AssembledRows, ChunkAssembly, ChunkGrid, checked_product};
use crate::tables::npy::ElementType;
use crate::tables::{MAX_WIDTH, TableError, names};

/// Larger sides are not credible.
const MAX_SIDE: usize = 1 << 30;
/// Writers use up to four: filters, a shuffle, a compressor and a checksum.
const MAX_CODECS: usize = 16;

#[derive(Clone, Debug)]
pub(super) struct ZarrArray {
    /// Path within the store.
    pub path: String,
    grid: ChunkGrid,
    /// Codecs in encoding order.
    codecs: Vec<Codec>,
    /// Prefix and separator of the indices in a chunk's name.
    prefix: &'static str,
    separator: &'static str,
}

impl ZarrArray {
    /// `None` if not numeric.
    pub fn from_metadata(path: &str, metadata: &Value) -> Option<Result<Self, TableError>> {
        let is_third = metadata.get("zarr_format")?.as_u64()? == 3;
        let read = if is_third { parse_v3(metadata) } else { parse_v2(metadata) };
        let array = match read? {
            Ok(array) => array,
            Err(what) => return Some(Err(what.in_part(path))),
        };
        let ChunkGrid { shape, chunks, .. } = &array.grid;
        let is_sound = chunks.len() == shape.len()
            && !shape.is_empty()
            && chunks.iter().all(|side| (1..=MAX_SIDE).contains(side))
            && shape.iter().all(|side| *side <= MAX_SIDE);
        if array.codecs.len() > MAX_CODECS {
            return Some(Err(format!("'{path}': more than {MAX_CODECS} codecs").into()));
        }
        let array = Self { path: path.to_owned(), ..array };
        Some(if is_sound { Ok(array) } else { Err(format!("'{path}': invalid chunks").into()) })
    }

    pub fn rows(&self) -> usize {
        self.grid.shape[0]
    }

    /// Numbers per row; `None` for images.
    pub fn width(&self) -> Option<usize> {
        let inner = &self.grid.shape[1..];
        let is_image = inner.len() > 1 && !self.grid.kind.is_float();
        checked_product(inner).filter(|width| (1..=MAX_WIDTH).contains(width) && !is_image)
    }

    pub fn kind(&self) -> String {
        self.grid.kind.name()
    }

    pub fn read(
        &self,
        store: &mut ZarrStore,
        rows: Range<usize>,
        memory: &mut MemoryBudget,
    ) -> Result<AssembledRows, TableError> {
        if rows.is_empty() {
            return Ok(AssembledRows { values: Vec::new(), lost: Vec::new(), why: None });
        }
        let whole = self.grid.chunk_bytes();
        let whole =
            whole.ok_or_else(|| format!("its chunk size is invalid: {:?}", self.grid.chunks))?;
        memory.reserve(rows.len().saturating_mul(self.width().unwrap_or(0)))?;
        // Packed, unpacked and unshuffled copies.
        memory.check_available((whole as u64).saturating_mul(3))?;
        let mut all = ChunkAssembly::new(&self.grid, rows);
        for place in all.chunk_indices() {
            let numbers: Vec<String> = place.iter().map(usize::to_string).collect();
            let key = format!("{}/{}{}", self.path, self.prefix, numbers.join(self.separator));
            let chunk = store.get(&key, whole as u64).and_then(|packed| {
                packed.map(|packed| self.decode_chunk(packed, whole)).transpose()
            });
            if !all.add_chunk(&place, chunk) {
                break;
            }
        }
        Ok(all.finish(names::is_joints_or_pose(&self.path)))
    }

    fn decode_chunk(&self, mut bytes: Vec<u8>, whole: usize) -> Result<Vec<u8>, TableError> {
        for codec in self.codecs.iter().rev() {
            // A checksum adds 4 bytes.
            bytes = codec.decode(&bytes, whole + 4)?;
        }
        match bytes.len() {
            own if own < whole => Err(format!("a chunk has {own} bytes instead of {whole}").into()),
            _ => Ok(bytes),
        }
    }
}

fn parse_sides(value: Option<&Value>) -> Option<Vec<usize>> {
    let side = |value: &Value| usize::try_from(value.as_u64()?).ok();
    value?.as_array()?.iter().map(side).collect()
}

/// A number or its name.
fn parse_fill_value(value: Option<&Value>) -> f64 {
    match value {
        Some(Value::Number(number)) => number.as_f64().unwrap_or(f64::NAN),
        Some(Value::String(word)) => word.parse().unwrap_or(f64::NAN),
        Some(Value::Bool(is)) => f64::from(u8::from(*is)),
        _ => 0.0,
    }
}

fn parse_v2(metadata: &Value) -> Option<Result<ZarrArray, TableError>> {
    let kind = ElementType::parse(metadata.get("dtype")?.as_str()?)?;
    let codec = |value: &Value| {
        Codec::from_name(value.get("id").and_then(Value::as_str).unwrap_or(""), value)
    };
    let filters = metadata.get("filters").and_then(Value::as_array).into_iter().flatten();
    let packer = metadata.get("compressor").filter(|value| !value.is_null());
    let codecs: Result<Vec<Codec>, TableError> =
        filters.chain(packer).take(MAX_CODECS + 1).map(codec).collect();
    let separator = metadata.get("dimension_separator").and_then(Value::as_str);
    let array = |codecs| {
        Some(ZarrArray {
            path: String::new(),
            grid: ChunkGrid {
                shape: parse_sides(metadata.get("shape"))?,
                chunks: parse_sides(metadata.get("chunks"))?,
                kind,
                fill: parse_fill_value(metadata.get("fill_value")),
                is_fortran: metadata.get("order").and_then(Value::as_str) == Some("F"),
            },
            codecs,
            prefix: "",
            separator: if separator == Some("/") { "/" } else { "." },
        })
    };
    codecs.map(array).transpose()
}

fn parse_v3(metadata: &Value) -> Option<Result<ZarrArray, TableError>> {
    let text =
        |value: &Value, name: &str| value.get(name).and_then(Value::as_str).map(str::to_owned);
    let settings = |value: &Value, name: &str| text(value.get("configuration")?, name);
    let (mut codecs, mut is_big) = (Vec::new(), false);
    let all = metadata.get("codecs").and_then(Value::as_array).into_iter().flatten();
    for codec in all.take(MAX_CODECS + 2) {
        match text(codec, "name").as_deref().unwrap_or("") {
            "bytes" => is_big = settings(codec, "endian").as_deref() == Some("big"),
            name => {
                match Codec::from_name(name, codec.get("configuration").unwrap_or(&Value::Null)) {
                    Ok(codec) => codecs.push(codec),
                    Err(what) => return Some(Err(what)),
                }
            }
        }
    }
    let (mark, kind) = (if is_big { ">" } else { "<" }, text(metadata, "data_type")?);
    let kind =
        match kind.strip_prefix("float").or(kind.strip_prefix("int")).or(kind.strip_prefix("uint"))
        {
            Some(bits) => format!("{mark}{}{}", &kind[..1], bits.parse::<usize>().ok()? / 8),
            None if kind == "bool" => "|b1".to_owned(),
            None => return None,
        };
    let encoding = metadata.get("chunk_key_encoding");
    let is_second = encoding.and_then(|own| text(own, "name")).as_deref() == Some("v2");
    let separator = encoding.and_then(|own| settings(own, "separator"));
    let is_dotted = separator.as_deref().map_or(is_second, |separator| separator == ".");
    let grid = metadata.get("chunk_grid").and_then(|grid| grid.get("configuration"));
    Some(Ok(ZarrArray {
        path: String::new(),
        grid: ChunkGrid {
            shape: parse_sides(metadata.get("shape"))?,
            chunks: parse_sides(grid.and_then(|grid| grid.get("chunk_shape")))?,
            kind: ElementType::parse(&kind)?,
            fill: parse_fill_value(metadata.get("fill_value")),
            is_fortran: false,
        },
        codecs,
        prefix: match (is_second, is_dotted) {
            (true, _) => "",
            (false, true) => "c.",
            (false, false) => "c/",
        },
        separator: if is_dotted { "." } else { "/" },
    }))
}
