//! One array of a store, Zarr versions 2 and 3: its metadata and its rows.

use std::ops::Range;

use serde_json::Value;

use super::codec::Codec;
use super::store::Store;
use crate::memory::Memory;
use crate::tables::chunks::{Assembled, Assembly, Grid};
use crate::tables::npy::Kind;
use crate::tables::{MOST_WIDE, Refusal, names};

/// Maximum side of an array; larger values are not credible.
const LONGEST: usize = 1 << 30;
/// Maximum number of codecs. Writers use up to four: filters, a shuffle, a compressor and a checksum.
const MOST_CODECS: usize = 16;

/// Layout of an array, with the names and codecs of its chunks.
#[derive(Clone, Debug)]
pub(super) struct Array {
    /// Path within the store.
    pub path: String,
    grid: Grid,
    /// In encoding order.
    codecs: Vec<Codec>,
    /// Prefix and separator of the indices in the name of a chunk.
    before: &'static str,
    between: &'static str,
}

impl Array {
    /// Parses the metadata of the array at `path`; `None` if it is not numeric.
    pub fn of(path: &str, metadata: &Value) -> Option<Result<Self, Refusal>> {
        let is_third = metadata.get("zarr_format")?.as_u64()? == 3;
        let read = if is_third { third(metadata) } else { second(metadata) };
        let array = match read? {
            Ok(array) => array,
            Err(what) => return Some(Err(what.of(path))),
        };
        let Grid { shape, chunks, .. } = &array.grid;
        let is_sound = chunks.len() == shape.len()
            && !shape.is_empty()
            && chunks.iter().all(|side| (1..=LONGEST).contains(side))
            && shape.iter().all(|side| *side <= LONGEST);
        if array.codecs.len() > MOST_CODECS {
            return Some(Err(format!("'{path}': more than {MOST_CODECS} codecs").into()));
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
        let width = inner.iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
        let is_image = inner.len() > 1 && !self.grid.kind.is_float();
        width.filter(|width| (1..=MOST_WIDE).contains(width) && !is_image)
    }

    pub fn kind(&self) -> String {
        self.grid.kind.name()
    }

    /// Reads some rows; also returns which of them are lost.
    pub fn read(
        &self,
        store: &mut Store,
        rows: Range<usize>,
        memory: &mut Memory,
    ) -> Result<Assembled, Refusal> {
        if rows.is_empty() {
            return Ok(Assembled { values: Vec::new(), lost: Vec::new(), why: None });
        }
        let whole = self.grid.chunk_bytes();
        let whole =
            whole.ok_or_else(|| format!("its chunk size is invalid: {:?}", self.grid.chunks))?;
        memory.take(rows.len().saturating_mul(self.width().unwrap_or(0)))?;
        // Packed, unpacked and unshuffled copies.
        memory.allows((whole as u64).saturating_mul(3))?;
        let mut all = Assembly::of(&self.grid, rows);
        for place in all.places() {
            let numbers: Vec<String> = place.iter().map(usize::to_string).collect();
            let key = format!("{}/{}{}", self.path, self.before, numbers.join(self.between));
            let chunk = store
                .get(&key, whole as u64)
                .and_then(|packed| packed.map(|packed| self.unpacked(packed, whole)).transpose());
            if !all.put(&place, chunk) {
                break;
            }
        }
        Ok(all.finish(names::is_of_arm(&self.path)))
    }

    /// Decodes a chunk of `whole` bytes.
    fn unpacked(&self, mut bytes: Vec<u8>, whole: usize) -> Result<Vec<u8>, Refusal> {
        for codec in self.codecs.iter().rev() {
            // A checksum adds 4 bytes.
            bytes = codec.undo(&bytes, whole + 4)?;
        }
        match bytes.len() {
            own if own < whole => Err(format!("a chunk has {own} bytes instead of {whole}").into()),
            _ => Ok(bytes),
        }
    }
}

fn sides(value: Option<&Value>) -> Option<Vec<usize>> {
    let side = |value: &Value| usize::try_from(value.as_u64()?).ok();
    value?.as_array()?.iter().map(side).collect()
}

/// Fill value for missing chunks: a number, or a name of one.
fn fill(value: Option<&Value>) -> f64 {
    match value {
        Some(Value::Number(number)) => number.as_f64().unwrap_or(f64::NAN),
        Some(Value::String(word)) => word.parse().unwrap_or(f64::NAN),
        Some(Value::Bool(is)) => f64::from(u8::from(*is)),
        _ => 0.0,
    }
}

fn second(metadata: &Value) -> Option<Result<Array, Refusal>> {
    let kind = Kind::of(metadata.get("dtype")?.as_str()?)?;
    let codec =
        |value: &Value| Codec::of(value.get("id").and_then(Value::as_str).unwrap_or(""), value);
    let filters = metadata.get("filters").and_then(Value::as_array).into_iter().flatten();
    let packer = metadata.get("compressor").filter(|value| !value.is_null());
    let codecs: Result<Vec<Codec>, Refusal> =
        filters.chain(packer).take(MOST_CODECS + 1).map(codec).collect();
    let separator = metadata.get("dimension_separator").and_then(Value::as_str);
    let array = |codecs| {
        Some(Array {
            path: String::new(),
            grid: Grid {
                shape: sides(metadata.get("shape"))?,
                chunks: sides(metadata.get("chunks"))?,
                kind,
                fill: fill(metadata.get("fill_value")),
                is_fortran: metadata.get("order").and_then(Value::as_str) == Some("F"),
            },
            codecs,
            before: "",
            between: if separator == Some("/") { "/" } else { "." },
        })
    };
    codecs.map(array).transpose()
}

fn third(metadata: &Value) -> Option<Result<Array, Refusal>> {
    let text =
        |value: &Value, name: &str| value.get(name).and_then(Value::as_str).map(str::to_owned);
    let settings = |value: &Value, name: &str| text(value.get("configuration")?, name);
    let (mut codecs, mut is_big) = (Vec::new(), false);
    let all = metadata.get("codecs").and_then(Value::as_array).into_iter().flatten();
    for codec in all.take(MOST_CODECS + 2) {
        match text(codec, "name").as_deref().unwrap_or("") {
            "bytes" => is_big = settings(codec, "endian").as_deref() == Some("big"),
            name => match Codec::of(name, codec.get("configuration").unwrap_or(&Value::Null)) {
                Ok(codec) => codecs.push(codec),
                Err(what) => return Some(Err(what)),
            },
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
    Some(Ok(Array {
        path: String::new(),
        grid: Grid {
            shape: sides(metadata.get("shape"))?,
            chunks: sides(grid.and_then(|grid| grid.get("chunk_shape")))?,
            kind: Kind::of(&kind)?,
            fill: fill(metadata.get("fill_value")),
            is_fortran: false,
        },
        codecs,
        before: match (is_second, is_dotted) {
            (true, _) => "",
            (false, true) => "c.",
            (false, false) => "c/",
        },
        between: if is_dotted { "." } else { "/" },
    }))
}
