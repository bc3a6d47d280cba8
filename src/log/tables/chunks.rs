//! Assembles chunked arrays of Zarr and HDF5; finds the rows whose chunks are missing or damaged.

use std::ops::Range;

use super::TableError;
use super::npy::ElementType;

const MAX_ABSENT_CHUNKS: usize = 1 << 16;

#[derive(Clone, Debug)]
pub(super) struct ChunkGrid {
    pub shape: Vec<usize>,
    /// None is 0.
    pub chunks: Vec<usize>,
    pub kind: ElementType,
    /// Value of elements without a chunk.
    pub fill: f64,
    /// The first index varies fastest within a chunk.
    pub is_fortran: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChunkState {
    Absent,
    Whole,
    Damaged,
}

pub(super) struct ChunkAssembly<'a> {
    grid: &'a ChunkGrid,
    rows: Range<usize>,
    /// Chunks along each dimension except the first.
    inner: Vec<usize>,
    width: usize,
    values: Vec<f64>,
    states: Vec<ChunkState>,
    absent: usize,
    why: Option<TableError>,
}

#[derive(Debug)]
pub(super) struct AssembledRows {
    pub values: Vec<f64>,
    pub lost: Vec<Range<usize>>,
    pub why: Option<TableError>,
}

impl ChunkGrid {
    /// `None` on overflow.
    pub fn chunk_bytes(&self) -> Option<usize> {
        checked_product(&self.chunks)?.checked_mul(self.kind.size())
    }
}

impl<'a> ChunkAssembly<'a> {
    /// The caller accounts for the memory.
    pub fn new(grid: &'a ChunkGrid, rows: Range<usize>) -> Self {
        let width: usize = grid.shape[1..].iter().product();
        let sides = grid.shape[1..].iter().zip(&grid.chunks[1..]);
        let inner: Vec<usize> = sides.map(|(side, own)| side.div_ceil(*own)).collect();
        let bands = rows.end.div_ceil(grid.chunks[0]) - rows.start / grid.chunks[0];
        let states = vec![ChunkState::Absent; bands * inner.iter().product::<usize>()];
        let values = vec![grid.fill; rows.len() * width];
        Self { grid, rows, inner, width, values, states, absent: 0, why: None }
    }

    pub fn chunk_indices(&self) -> impl Iterator<Item = Vec<usize>> + use<> {
        let (inner, first) = (self.inner.clone(), self.rows.start / self.grid.chunks[0]);
        let wide: usize = inner.iter().product();
        (0..self.states.len()).map(move |number| {
            let mut place = vec![first + number / wide];
            place.extend(unravel_index(number % wide, &inner));
            place
        })
    }

    /// Returns false if too many chunks are missing to continue.
    pub fn add_chunk(
        &mut self,
        place: &[usize],
        chunk: Result<Option<Vec<u8>>, TableError>,
    ) -> bool {
        let Some(state) = self.state_of(place) else { return true };
        self.states[state] = match chunk {
            Ok(Some(bytes))
                if self.grid.chunk_bytes().is_some_and(|whole| bytes.len() >= whole) =>
            {
                self.scatter(&bytes, place);
                ChunkState::Whole
            }
            Ok(None) => {
                self.absent += 1;
                ChunkState::Absent
            }
            other => {
                let why = other.err().unwrap_or_else(|| "a chunk is truncated".into());
                self.why.get_or_insert(why);
                ChunkState::Damaged
            }
        };
        self.absent < MAX_ABSENT_CHUNKS
    }

    /// Marks unreadable chunks with unknown indices.
    pub fn mark_absent_damaged(&mut self, why: TableError) {
        let absent = self.states.iter_mut().filter(|state| **state == ChunkState::Absent);
        absent.for_each(|state| *state = ChunkState::Damaged);
        self.why.get_or_insert(why);
    }

    fn state_of(&self, place: &[usize]) -> Option<usize> {
        let (first, rest) = place.split_first()?;
        let band = first.checked_sub(self.rows.start / self.grid.chunks[0])?;
        let is_there = rest.len() == self.inner.len()
            && rest.iter().zip(&self.inner).all(|(at, side)| at < side);
        let cell = row_major_index(rest, &self.inner);
        let wide: usize = self.inner.iter().product();
        let number = band.checked_mul(wide)?.checked_add(cell)?;
        (is_there && number < self.states.len()).then_some(number)
    }

    fn band(&self, first: usize) -> Range<usize> {
        let deep = self.grid.chunks[0];
        self.rows.start.max(first * deep)
            ..self.rows.end.min(first.saturating_add(1).saturating_mul(deep))
    }

    fn scatter(&mut self, chunk: &[u8], place: &[usize]) {
        let (inner, own) = (&self.grid.shape[1..], &self.grid.chunks[1..]);
        let (first, deep) = (place[0], self.grid.chunks[0]);
        let sides: usize = own.iter().product();
        let rows = self.band(first);
        for part in 0..sides {
            let at_in_chunk = unravel_index(part, own);
            let at: Vec<usize> = at_in_chunk
                .iter()
                .zip(&place[1..])
                .zip(own)
                .map(|((at, chunk), own)| chunk * own + at)
                .collect();
            // The last chunks extend beyond the array.
            if at.iter().zip(inner).any(|(at, side)| at >= side) {
                continue;
            }
            let column = row_major_index(&at, inner);
            let back = column_major_index(part, own);
            for row in rows.clone() {
                let deeper = row - first * deep;
                let element =
                    if self.grid.is_fortran { deeper + deep * back } else { deeper * sides + part };
                self.values[(row - self.rows.start) * self.width + column] =
                    self.grid.kind.read(&chunk[element * self.grid.kind.size()..]);
            }
        }
    }

    /// Writers omit chunks that hold only the fill value. A missing chunk is therefore a loss only if the
    /// number before or after it differs from the fill value. An array without any chunk is a loss if it
    /// `must_vary`.
    pub fn finish(mut self, must_vary: bool) -> AssembledRows {
        let wide: usize = self.inner.iter().product::<usize>().max(1);
        let bands = self.states.len() / wide;
        let first = self.rows.start / self.grid.chunks[0];
        let mut is_lost = vec![false; bands];
        let mut missing = 0_usize;
        for cell in 0..wide {
            let state = |band: usize| self.states[band * wide + cell];
            let columns = self.columns_of(cell);
            let is_fill = |row: usize| {
                let at = (row - self.rows.start) * self.width;
                columns.iter().all(|column| self.values[at + column] == self.grid.fill)
            };
            let is_empty = (0..bands).all(|band| state(band) == ChunkState::Absent);
            let mut band = 0;
            while band < bands {
                let start = band;
                while band < bands && state(band) == ChunkState::Absent {
                    band += 1;
                }
                if band > start {
                    let whole = |band: usize| state(band) == ChunkState::Whole;
                    let before = start.checked_sub(1).filter(|band| whole(*band));
                    let after = (band < bands).then_some(band).filter(|band| whole(*band));
                    let before = before.is_none_or(|band| is_fill(self.band(first + band).end - 1));
                    let after = after.is_none_or(|band| is_fill(self.band(first + band).start));
                    if !(before && after) || (is_empty && must_vary) {
                        is_lost[start..band].fill(true);
                        missing += band - start;
                    }
                }
                if band < bands {
                    is_lost[band] |= state(band) == ChunkState::Damaged;
                    band += 1;
                }
            }
        }
        let lost: Vec<Range<usize>> = (0..bands)
            .filter(|band| is_lost[*band])
            .map(|band| self.band(first + band))
            .map(|rows| rows.start - self.rows.start..rows.end - self.rows.start)
            .collect();
        let why = self.why.take().or_else(|| {
            let of = bands * wide;
            (missing > 0).then(|| format!("{missing} of its {of} chunks are missing").into())
        });
        AssembledRows { values: self.values, lost, why }
    }

    fn columns_of(&self, cell: usize) -> Vec<usize> {
        let (inner, own) = (&self.grid.shape[1..], &self.grid.chunks[1..]);
        let place = unravel_index(cell, &self.inner);
        let is_in = |column: &usize| {
            let at = unravel_index(*column, inner);
            at.iter().zip(own).zip(&place).all(|((at, own), place)| at / own == *place)
        };
        (0..self.width).filter(is_in).collect()
    }
}

/// `None` on overflow.
pub(super) fn checked_product(sides: &[usize]) -> Option<usize> {
    sides.iter().try_fold(1, |all: usize, side| all.checked_mul(*side))
}

fn row_major_index(places: &[usize], sides: &[usize]) -> usize {
    places.iter().zip(sides).fold(0, |all, (at, side)| all * side + at)
}

/// `number` is the row-major index.
pub(super) fn column_major_index(number: usize, sides: &[usize]) -> usize {
    let places = unravel_index(number, sides);
    places.iter().rev().zip(sides.iter().rev()).fold(0, |all, (at, side)| all * side + at)
}

/// The last index varies fastest.
fn unravel_index(number: usize, sides: &[usize]) -> Vec<usize> {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A 20 by 4 array in chunks of 5 by 2.
    fn assembled(
        number: impl Fn(usize) -> f64,
        must_vary: bool,
        changed: &[(usize, usize, bool)],
    ) -> AssembledRows {
        let kind = ElementType::parse("<f8").expect("a kind");
        let grid = ChunkGrid {
            shape: vec![20, 4],
            chunks: vec![5, 2],
            kind,
            fill: 0.0,
            is_fortran: false,
        };
        let mut all = ChunkAssembly::new(&grid, 0..20);
        for place in all.chunk_indices() {
            let rows = 5 * place[0]..5 * place[0] + 5;
            let own = rows
                .flat_map(|row| [2 * place[1], 2 * place[1] + 1].map(|at| number(4 * row + at)));
            let bytes = own.flat_map(f64::to_le_bytes).collect();
            let change = changed.iter().find(|(band, cell, _)| place == [*band, *cell]);
            all.add_chunk(
                &place,
                match change {
                    None => Ok(Some(bytes)),
                    Some((.., false)) => Ok(None),
                    Some((.., true)) => Err("damaged".into()),
                },
            );
        }
        all.finish(must_vary)
    }

    #[test]
    fn missing_and_damaged_chunks_are_lost_rows() {
        let number = |at: usize| at as f64 + 1.0;
        let whole = assembled(number, true, &[]);
        assert_eq!(whole.values, (1..=80).map(f64::from).collect::<Vec<_>>());
        assert!(whole.lost.is_empty() && whole.why.is_none());
        let cut = assembled(number, true, &[(1, 0, false), (3, 1, true)]);
        assert_eq!(cut.lost, [5..10, 15..20]);
        assert_eq!(cut.values[4 * 5 + 2], 23.0);
    }

    #[test]
    fn missing_chunks_of_the_fill_value_are_no_loss() {
        let absent = [(1, 0, false), (2, 0, false)];
        let zeros = |at: usize| if at % 4 < 2 { 0.0 } else { at as f64 + 1.0 };
        assert!(assembled(zeros, true, &absent).lost.is_empty());
        let one = |at: usize| if at == 4 * 4 { 1.0 } else { zeros(at) };
        assert_eq!(assembled(one, true, &absent).lost, [5..10, 10..15]);
        let none: Vec<(usize, usize, bool)> = (0..8).map(|at| (at / 2, at % 2, false)).collect();
        assert!(assembled(|_| 0.0, false, &none).lost.is_empty());
        assert_eq!(assembled(|_| 0.0, true, &none).lost.len(), 4);
    }
}
