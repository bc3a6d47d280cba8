//! Arrays in the elements of cell arrays and struct arrays. The elements are rows, columns or episodes.

use std::collections::{BTreeMap, BTreeSet};

use super::super::npy::{ElementType, RawArray};
use super::super::{MAX_PARAMETERS, clock};

pub(super) struct ElementArray {
    /// Index of the element.
    pub element: usize,
    pub array: RawArray,
}

pub(super) enum ElementArrays {
    /// One array per name.
    Whole(Vec<RawArray>),
    Episodes(Vec<Vec<RawArray>>),
}

/// Elements of a few numbers are rows of an array. Vectors of one length without times are its columns. Other elements
/// are episodes, unless they hold less than the arrays of the file.
pub(super) fn combine(
    elements: Vec<ElementArray>,
    arrays: &[RawArray],
    unread: &mut Vec<(String, String)>,
) -> ElementArrays {
    let count = elements.iter().map(|own| own.element + 1).max().unwrap_or(0);
    let is_row = |own: &ElementArray| own.array.numbers() <= MAX_PARAMETERS;
    let is_column = |own: &ElementArray| {
        own.array.sides.len() == 1
            && own.array.numbers() == elements[0].array.numbers()
            && !clock::is_time(&own.array.name)
    };
    let are_rows = count > MAX_PARAMETERS && elements.iter().all(is_row);
    let are_columns =
        count <= MAX_PARAMETERS && !elements.iter().any(is_row) && elements.iter().all(is_column);
    let held = |arrays: &mut dyn Iterator<Item = &RawArray>| arrays.map(RawArray::numbers).sum();
    let in_arrays: usize = held(&mut arrays.iter());
    let in_elements: usize = held(&mut elements.iter().map(|own| &own.array));
    if !are_rows && !are_columns && in_elements < in_arrays {
        let names: BTreeSet<String> = elements.into_iter().map(|own| own.array.name).collect();
        let why = "a cell array or struct array next to larger arrays; save its numbers as arrays";
        unread.extend(names.into_iter().map(|name| (name, why.to_owned())));
        return ElementArrays::Whole(Vec::new());
    }
    if !are_rows && !are_columns {
        let mut episodes: Vec<Vec<RawArray>> = (0..count).map(|_| Vec::new()).collect();
        for ElementArray { element, array } in elements {
            episodes[element].push(array);
        }
        episodes.retain(|arrays| !arrays.is_empty());
        return match episodes.is_empty() {
            true => ElementArrays::Whole(Vec::new()),
            false => ElementArrays::Episodes(episodes),
        };
    }
    let mut by_name: BTreeMap<String, Vec<RawArray>> = BTreeMap::new();
    for ElementArray { array, .. } in elements {
        by_name.entry(array.name.clone()).or_default().push(array);
    }
    let mut whole = Vec::new();
    for (name, arrays) in by_name {
        let length = arrays[0].numbers();
        if arrays.len() != count || arrays.iter().any(|array| array.numbers() != length) {
            let why = format!("its {count} elements have different sizes");
            unread.push((name, why));
            continue;
        }
        let data = arrays.iter().flat_map(RawArray::values).flat_map(f64::to_le_bytes).collect();
        let element = ElementType::parse("<f8").unwrap_or(arrays[0].element);
        // Elements are stored one after another: as rows, or as columns.
        let sides = if are_rows { vec![count, length] } else { vec![length, count] };
        whole.push(RawArray { name, element, sides, is_fortran: are_columns, data });
    }
    ElementArrays::Whole(whole)
}

/// Adds arrays outside the elements that have as many rows as the episode, such as common times.
pub(super) fn add_shared(episode: &mut Vec<RawArray>, shared: &[RawArray]) {
    let rows = |array: &RawArray| array.sides.iter().copied().max();
    let is_of_episode = |array: &&RawArray| episode.iter().any(|own| rows(own) == rows(array));
    let own: Vec<RawArray> = shared.iter().filter(is_of_episode).cloned().collect();
    episode.extend(own);
}

/// Single numbers of an episode, by the names of their fields.
pub(super) fn scalars(episode: &[RawArray]) -> Vec<(String, f64)> {
    let scalar = |array: &RawArray| {
        let field = array.name.rsplit('/').next()?.to_owned();
        array.values().next().filter(|_| array.numbers() == 1).map(|value| (field, value))
    };
    episode.iter().filter_map(scalar).collect()
}

impl RawArray {
    fn numbers(&self) -> usize {
        self.sides.iter().product()
    }

    /// In the order of the file.
    fn values(&self) -> impl Iterator<Item = f64> + '_ {
        let size = self.element.size().max(1);
        self.data.chunks_exact(size).map(|bytes| self.element.read(bytes))
    }
}
