//! HDF5, as h5py writes it: data sets of numbers, by their paths. The groups of an episode each
//! (`data/demo_0` of robomimic and LIBERO) are tables of their own.

use ::bytes::Bytes;
use hdf5_reader::group::Group;
use hdf5_reader::{Attribute, Dataset, Datatype, Hdf5File, OpenOptions};

use super::{
    Column, Episodes, MOST_COLUMNS, MOST_NUMBERS, MOST_PACKED, MOST_SMALL, MOST_WIDE, RATES,
    Refusal, Table, common_rows, lies_on_side, rate_in, usual,
};
use crate::Extent;
use crate::losses::Losses;

pub(crate) const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Groups within groups that are looked at.
const DEEP: usize = 8;
/// Names of groups of episodes, before their number.
const EPISODES: &[&str] = &["demo", "episode", "ep", "traj", "trajectory"];

/// The episodes of a file; the only one that is `wanted`, if one is.
pub(super) fn read(
    bytes: Bytes,
    wanted: Option<&str>,
    losses: &mut Losses,
) -> Result<Episodes, Refusal> {
    let (home, episodes, rate_hz) = opened(bytes)?;
    let names = match episodes.is_empty() {
        true => vec![None],
        false => episodes.into_iter().map(Some).collect(),
    };
    let mut budget = MOST_NUMBERS;
    let mut found = Vec::new();
    for name in names {
        let label = name.clone().unwrap_or_else(|| "0".to_owned());
        if wanted.is_some_and(|wanted| *wanted != label) {
            continue;
        }
        let group = match &name {
            Some(name) => home.group(name).map_err(|error| worded(&error))?,
            None => home.clone(),
        };
        let mut walk = Walk { found: Vec::new(), columns: Vec::new(), budget, refused: None };
        walk.descend(&group, "", 0);
        walk.read();
        budget = walk.budget;
        if let (Some(what), true) = (walk.refused, found.is_empty()) {
            losses.add_unplaced(Extent::Messages, None, what);
        }
        let rows = usual(walk.columns.iter().map(|column| column.values.len() / column.width));
        let (columns, others): (Vec<Column>, _) =
            walk.columns.into_iter().partition(|column| column.values.len() == rows * column.width);
        let unread = others.into_iter().map(|column| {
            let why = format!("{} rows, not {rows}", column.values.len() / column.width.max(1));
            (column.name, why)
        });
        let unread = unread.collect();
        let rate_hz = rate_of(&group).or(rate_hz);
        found.push((label, Table { rows, columns, rate_hz, unread, ..Table::default() }));
    }
    Ok(found)
}

/// The names of the episodes of a file.
pub(super) fn episodes_in(bytes: Bytes) -> Result<Vec<String>, Refusal> {
    opened(bytes).map(|(_, episodes, _)| episodes)
}

/// The group that holds the episodes, their names, and the rate that the file declares.
fn opened(bytes: Bytes) -> Result<(Group, Vec<String>, Option<f64>), Refusal> {
    let most = MOST_NUMBERS.min(MOST_PACKED.saturating_mul(bytes.len()).max(MOST_SMALL));
    let options =
        OpenOptions::default().with_max_read_bytes(8 * most).with_max_chunk_bytes(1 << 30);
    let file = Hdf5File::from_owner(bytes, options).map_err(|error| worded(&error))?;
    let root = file.root_group().map_err(|error| worded(&error))?;
    let rate_hz = rate_of(&root);
    let episodes = episode_groups(&root);
    if let (true, Ok(data)) = (episodes.is_empty(), root.group("data")) {
        let own = episode_groups(&data);
        if !own.is_empty() {
            let rate_hz = rate_hz.or_else(|| rate_of(&data));
            return Ok((data, own, rate_hz));
        }
    }
    Ok((root, episodes, rate_hz))
}

/// The groups of episodes in a group, in the order of their numbers.
fn episode_groups(group: &Group) -> Vec<String> {
    let Ok((groups, _)) = group.member_names() else { return Vec::new() };
    let numbered = groups.into_iter().filter_map(|name| {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        let stem = name[..name.len() - digits.len()].trim_end_matches(['_', '-']).to_lowercase();
        let number: u64 = digits.parse().ok()?;
        (stem.is_empty() || EPISODES.contains(&stem.as_str())).then_some((number, name))
    });
    let mut numbered: Vec<(u64, String)> = numbered.collect();
    numbered.sort();
    numbered.into_iter().map(|(_, name)| name).collect()
}

/// A walk over the groups of a file.
struct Walk {
    /// Data sets with their paths.
    found: Vec<(String, Dataset)>,
    columns: Vec<Column>,
    budget: usize,
    /// Why the first data set that could not be read could not.
    refused: Option<String>,
}

impl Walk {
    fn descend(&mut self, group: &Group, path: &str, depth: usize) {
        let (groups, datasets) = match group.members() {
            Ok(members) => members,
            Err(error) => {
                self.refused.get_or_insert_with(|| format!("group '/{path}': {}", worded(&error)));
                return;
            }
        };
        let below = |name: &str| {
            let name = name.rsplit('/').next().unwrap_or(name);
            if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
        };
        for dataset in datasets {
            if self.found.len() == MOST_COLUMNS {
                return;
            }
            let name = below(dataset.name());
            self.found.push((name, dataset));
        }
        if depth < DEEP {
            for group in groups {
                self.descend(&group, &below(group.name()), depth + 1);
            }
        }
    }

    /// Reads the data sets that were found.
    fn read(&mut self) {
        let sides = |dataset: &Dataset| -> Vec<usize> {
            dataset
                .shape()
                .iter()
                .map(|side| usize::try_from(*side).unwrap_or(usize::MAX))
                .collect()
        };
        let found = std::mem::take(&mut self.found);
        let numeric = found.iter().filter(|(_, dataset)| kind_of(dataset.dtype()).is_some());
        let shapes: Vec<Vec<usize>> = numeric.map(|(_, dataset)| sides(dataset)).collect();
        let rows = common_rows(&shapes);
        for (name, dataset) in found {
            let is_on_side = lies_on_side(&sides(&dataset), rows);
            self.dataset(&dataset, name, is_on_side);
        }
    }

    /// Takes a data set of numbers: a row each, of one number or of a few; a column each if it lies on its
    /// side.
    fn dataset(&mut self, dataset: &Dataset, name: String, is_on_side: bool) {
        let Some(kind) = kind_of(dataset.dtype()) else { return };
        let mut shape = dataset.shape().to_vec();
        if is_on_side {
            shape.reverse();
        }
        let [rows, inner @ ..] = shape.as_slice() else { return };
        // Whole numbers in more than two dimensions are images.
        if inner.len() > 1 && !kind.starts_with("float") {
            return;
        }
        let width = inner.iter().try_fold(1_u64, |all, side| all.checked_mul(*side));
        let Some(width) = width.filter(|width| (1..=MOST_WIDE as u64).contains(width)) else {
            return;
        };
        let Some(count) = rows.checked_mul(width).filter(|count| *count > 0) else { return };
        if count > self.budget as u64 {
            self.refused
                .get_or_insert_with(|| format!("'{name}' declares {rows} rows of {width} numbers"));
            return;
        }
        match values(dataset) {
            Ok(mut values) => {
                self.budget -= count as usize;
                if is_on_side {
                    let (rows, width) = (*rows as usize, width as usize);
                    let turned = (0..rows * width).map(|at| values[at % width * rows + at / width]);
                    values = turned.collect();
                }
                self.columns.push(Column {
                    name,
                    kind,
                    width: width as usize,
                    parts: Vec::new(),
                    values,
                });
            }
            Err(error) => {
                self.refused.get_or_insert_with(|| format!("'{name}': {}", worded(&error)));
            }
        }
    }
}

/// The numbers of a data set, whatever their type.
fn values(dataset: &Dataset) -> Result<Vec<f64>, hdf5_reader::error::Error> {
    macro_rules! read {
        ($kind:ty) => {
            dataset
                .read_array::<$kind>()
                .map(|array| array.into_iter().map(|value| value as f64).collect())
        };
    }
    match dataset.dtype() {
        Datatype::FloatingPoint { size: 4, .. } => read!(f32),
        Datatype::FixedPoint { size: 1, signed: true, .. } => read!(i8),
        Datatype::FixedPoint { size: 1, signed: false, .. } => read!(u8),
        Datatype::FixedPoint { size: 2, signed: true, .. } => read!(i16),
        Datatype::FixedPoint { size: 2, signed: false, .. } => read!(u16),
        Datatype::FixedPoint { size: 4, signed: true, .. } => read!(i32),
        Datatype::FixedPoint { size: 4, signed: false, .. } => read!(u32),
        Datatype::FixedPoint { size: 8, signed: true, .. } => read!(i64),
        Datatype::FixedPoint { size: 8, signed: false, .. } => read!(u64),
        _ => read!(f64),
    }
}

fn kind_of(datatype: &Datatype) -> Option<String> {
    match datatype {
        Datatype::FloatingPoint { size: size @ (4 | 8), .. } => Some(format!("float{}", 8 * size)),
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), signed, .. } => {
            let sign = if *signed { "" } else { "u" };
            Some(format!("{sign}int{}", 8 * size))
        }
        _ => None,
    }
}

/// The rate in the attributes of a group: a number, or one in robomimic's `env_args`.
fn rate_of(group: &Group) -> Option<f64> {
    let attributes = group.attributes().ok()?;
    let plain = |attribute: &Attribute| {
        RATES.contains(&attribute.name.as_str()).then(|| attribute.read_as_f64().ok()).flatten()
    };
    let in_text = |attribute: &Attribute| {
        let text =
            (attribute.name == "env_args").then(|| attribute.read_string().ok()).flatten()?;
        rate_in(&serde_json::from_str(&text).ok()?)
    };
    let rate = attributes.iter().find_map(plain).or_else(|| attributes.iter().find_map(in_text))?;
    (rate.is_finite() && rate > 0.0).then_some(rate)
}

fn worded(error: &hdf5_reader::error::Error) -> Refusal {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    // h5py's own LZF, and what plugins bring.
    let advice = if line.contains("unsupported filter") { "; write it with gzip" } else { "" };
    format!("the HDF5 file cannot be read: {line}{advice}")
}
