//! One array of a store: what its metadata say, in the second version of Zarr and in the third, and its rows.

use std::ops::Range;

use serde_json::Value;

use super::codec::Codec;
use super::store::Store;
use crate::tables::npy::Kind;
use crate::tables::{MOST_NUMBERS, MOST_PACKED, MOST_SMALL, MOST_WIDE, Refusal};

/// The longest side of an array: what is beyond is no size.
const LONGEST: usize = 1 << 30;

/// What an array is, and how its chunks are found and packed.
#[derive(Clone, Debug)]
pub(super) struct Array {
    /// Where it is in the store.
    pub path: String,
    pub shape: Vec<usize>,
    chunks: Vec<usize>,
    kind: Kind,
    /// What is where no chunk is.
    fill: f64,
    is_fortran: bool,
    /// In the order of the packing.
    codecs: Vec<Codec>,
    /// What stands before the numbers of a chunk's name, and between them.
    before: &'static str,
    between: &'static str,
}

impl Array {
    /// The array that the metadata at `path` describe; `None` of one that holds no numbers.
    pub fn of(path: &str, metadata: &Value) -> Option<Result<Self, Refusal>> {
        let is_third = metadata.get("zarr_format")?.as_u64()? == 3;
        let read = if is_third { third(metadata) } else { second(metadata) };
        let array = match read? {
            Ok(array) => array,
            Err(what) => return Some(Err(format!("'{path}': {what}"))),
        };
        let is_sound = array.chunks.len() == array.shape.len()
            && !array.shape.is_empty()
            && array.chunks.iter().all(|side| (1..=LONGEST).contains(side))
            && array.shape.iter().all(|side| *side <= LONGEST);
        let array = Self { path: path.to_owned(), ..array };
        Some(if is_sound {
            Ok(array)
        } else {
            Err(format!("'{path}': it declares no chunks that can be"))
        })
    }

    pub fn rows(&self) -> usize {
        self.shape[0]
    }

    /// The numbers of a row; `None` of images.
    pub fn width(&self) -> Option<usize> {
        let inner = &self.shape[1..];
        let width = inner.iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
        let is_image = inner.len() > 1 && !self.kind.is_float();
        width.filter(|width| (1..=MOST_WIDE).contains(width) && !is_image)
    }

    pub fn kind(&self) -> String {
        self.kind.name()
    }

    /// The numbers of some rows, row by row.
    pub fn read(&self, store: &mut Store, rows: Range<usize>) -> Result<Vec<f64>, Refusal> {
        let named = |what: Refusal| format!("'{}': {what}", self.path);
        let width = self.width().unwrap_or(0);
        if rows.len().checked_mul(width).is_none_or(|count| count > MOST_NUMBERS) {
            return Err(named(format!("it declares {} rows of {width} numbers", rows.len())));
        }
        let (mut values, mut absent) = (Vec::new(), 0);
        let deep = self.chunks[0];
        let mut first = rows.start / deep;
        while first * deep < rows.end {
            let own = rows.start.max(first * deep)..rows.end.min(first.saturating_add(1) * deep);
            self.band(store, first, own, (&mut values, &mut absent)).map_err(named)?;
            first += 1;
        }
        Ok(values)
    }

    /// The numbers of `rows`, which are all in chunks of number `first` from above.
    fn band(
        &self,
        store: &mut Store,
        first: usize,
        rows: Range<usize>,
        (values, absent): (&mut Vec<f64>, &mut usize),
    ) -> Result<(), Refusal> {
        let inner = &self.shape[1..];
        let grid = inner.iter().zip(&self.chunks[1..]).map(|(side, own)| side.div_ceil(*own));
        let grid: Vec<usize> = grid.collect();
        let width: usize = inner.iter().product();
        let begin = values.len();
        for number in 0..grid.iter().product() {
            let place = places(number, &grid);
            let names: Vec<String> =
                [&first].into_iter().chain(&place).map(usize::to_string).collect();
            let key = format!("{}/{}{}", self.path, self.before, names.join(self.between));
            let chunk = store.get(&key)?.map(|packed| self.unpacked(packed)).transpose()?;
            if chunk.is_none() {
                *absent += rows.len() * width / grid.iter().product::<usize>().max(1);
                if *absent > MOST_SMALL {
                    return Err(format!("{absent} and more of its numbers are in no chunk"));
                }
            }
            // Once something is there.
            values.resize(begin + rows.len() * width, self.fill);
            let Some(chunk) = chunk else { continue };
            self.scatter(&chunk, first, &place, &rows, &mut values[begin..]);
        }
        Ok(())
    }

    /// Puts the numbers of one chunk where they are in `rows`.
    fn scatter(
        &self,
        chunk: &[u8],
        first: usize,
        place: &[usize],
        rows: &Range<usize>,
        into: &mut [f64],
    ) {
        let (inner, own) = (&self.shape[1..], &self.chunks[1..]);
        let width: usize = inner.iter().product();
        let sides: usize = own.iter().product();
        let deep = self.chunks[0];
        for part in 0..sides {
            let within = places(part, own);
            let at: Vec<usize> = within
                .iter()
                .zip(place)
                .zip(own)
                .map(|((at, chunk), own)| chunk * own + at)
                .collect();
            // The last chunks reach beyond the array.
            if at.iter().zip(inner).any(|(at, side)| at >= side) {
                continue;
            }
            let column = at.iter().zip(inner).fold(0, |all, (at, side)| all * side + at);
            let back: usize = within
                .iter()
                .rev()
                .zip(own.iter().rev())
                .fold(0, |all, (at, side)| all * side + at);
            for row in rows.clone() {
                let deeper = row - first * deep;
                let element =
                    if self.is_fortran { deeper + deep * back } else { deeper * sides + part };
                into[(row - rows.start) * width + column] =
                    self.kind.read(&chunk[element * self.kind.size()..]);
            }
        }
    }

    /// The bytes of a chunk, all of them.
    fn unpacked(&self, mut bytes: Vec<u8>) -> Result<Vec<u8>, Refusal> {
        let count = self.chunks.iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
        let most = MOST_SMALL.max(bytes.len().saturating_mul(MOST_PACKED));
        let whole = count
            .and_then(|count| count.checked_mul(self.kind.size()))
            .filter(|whole| *whole <= most)
            .ok_or_else(|| {
                format!("its chunks of {} bytes declare {:?}", bytes.len(), self.chunks)
            })?;
        for codec in self.codecs.iter().rev() {
            // A checksum is 4 bytes more.
            bytes = codec.undo(&bytes, whole + 4)?;
        }
        match bytes.len() {
            own if own < whole => Err(format!("a chunk has {own} bytes, {whole} are declared")),
            _ => Ok(bytes),
        }
    }
}

/// The places in a box of these sides of its element of this number, the last going fastest.
fn places(number: usize, sides: &[usize]) -> Vec<usize> {
    let mut rest = number;
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
    places
}

fn sides(value: Option<&Value>) -> Option<Vec<usize>> {
    let side = |value: &Value| usize::try_from(value.as_u64()?).ok();
    value?.as_array()?.iter().map(side).collect()
}

/// What stands where no chunk is: a number, or a word for one.
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
    let codecs: Result<Vec<Codec>, Refusal> = filters.chain(packer).map(codec).collect();
    let separator = metadata.get("dimension_separator").and_then(Value::as_str);
    let array = |codecs| {
        Some(Array {
            path: String::new(),
            shape: sides(metadata.get("shape"))?,
            chunks: sides(metadata.get("chunks"))?,
            kind,
            fill: fill(metadata.get("fill_value")),
            is_fortran: metadata.get("order").and_then(Value::as_str) == Some("F"),
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
    for codec in metadata.get("codecs").and_then(Value::as_array).into_iter().flatten() {
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
        shape: sides(metadata.get("shape"))?,
        chunks: sides(grid.and_then(|grid| grid.get("chunk_shape")))?,
        kind: Kind::of(&kind)?,
        fill: fill(metadata.get("fill_value")),
        is_fortran: false,
        codecs,
        before: match (is_second, is_dotted) {
            (true, _) => "",
            (false, true) => "c.",
            (false, false) => "c/",
        },
        between: if is_dotted { "." } else { "/" },
    }))
}
