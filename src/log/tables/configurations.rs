//! Tables of configurations in formats other than text.

use std::path::Path;

use super::{Cell, ReadContext, Table, TableFormat, matlab, npy, records, xlsx};
use crate::losses::Losses;
use crate::memory_budget::MemoryBudget;

/// Names and rows of the numbers in the only table of the file at `path`, in the order of its columns; text is 0. `None` for
/// other formats, several tables, and damaged files.
pub(crate) fn names_and_rows(
    format: TableFormat,
    path: &Path,
    bytes: &[u8],
) -> Option<(Vec<String>, Vec<Vec<f64>>)> {
    let mut memory = MemoryBudget::new(None);
    memory.add_file(bytes.len() as u64);
    let mut losses = Losses::new(path);
    let context = &mut ReadContext { losses: &mut losses, memory: &mut memory, times: Vec::new() };
    let tables = match format {
        TableFormat::Npy => npy::read_npy(bytes, context),
        TableFormat::Npz => npy::read_npz(bytes, context),
        TableFormat::Matlab => matlab::read(bytes, context),
        TableFormat::Xlsx => xlsx::read(bytes, context),
        TableFormat::Json => records::read_json(bytes, context),
        TableFormat::Yaml => records::read_yaml(bytes, context),
        _ => return None,
    };
    let tables = tables.ok().filter(|_| losses.is_empty())?;
    match tables.as_slice() {
        [(_, table)] if table.losses.is_empty() => Some(table.names_and_rows()),
        _ => None,
    }
}

impl Table {
    fn names_and_rows(&self) -> (Vec<String>, Vec<Vec<f64>>) {
        let cells = self.row_cells();
        let name = |cell: &Option<Cell>| cell.map_or_else(String::new, |cell| self.cell_name(cell));
        let row = |row: usize| {
            let numbers = cells.iter().map(|cell| cell.map_or(0.0, |cell| self.number(row, cell)));
            numbers.collect()
        };
        (cells.iter().map(name).collect(), (0..self.rows).map(row).collect())
    }
}
