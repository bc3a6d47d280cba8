//! Filters the samples of a stream before estimation: one publisher, no outliers, no stale or repeated
//! values.

use std::borrow::Cow;

use super::held::{self, Held, held};
use super::publishers::{self, Publishers, publishers};
use super::role::Role;
use super::rows::Rows;
use super::series::{Values, series};
use super::stalled::{self, Stalled, stalled};
use super::strays::{self, Strays, strays};
use super::streams::{Clocks, Stream};

/// Samples excluded from estimation.
#[derive(Debug, Default)]
pub struct Sift {
    /// Outliers.
    pub strays: Vec<Strays>,
    /// Topics and transforms with two publishers.
    pub publishers: Vec<Publishers>,
    /// Repeated values with new stamps.
    pub held: Vec<Held>,
    /// Frozen joint states.
    pub(super) stalled: Vec<Stalled>,
}

impl Sift {
    pub(super) fn of(streams: &[Stream], clocks: &Clocks) -> Self {
        let mut series = series(streams, clocks);
        let publishers = publishers(&series);
        for series in &mut series {
            publishers::hide(&publishers, series.stream, series.piece, &mut series.rows);
            // A message resent with its stamp is the same row.
            series.rows.dedup_by_key(|(stamp, _)| *stamp);
        }
        let held = held(&series);
        let joints = series.iter().filter(|series| {
            matches!(series.values, Values::Joints(_))
                && streams[series.stream].role == Role::Joints
        });
        let stalled = joints.flat_map(|series| {
            let mut rows = Cow::Borrowed(&series.rows);
            if held::is_taken_once(&held, series.stream, series.piece) {
                held::take_once(&held, series.stream, series.piece, rows.to_mut());
            }
            stalled(series, &rows)
        });
        let stalled = stalled.collect();
        let strays = strays(streams, clocks, &publishers);
        Self { strays, publishers, held, stalled }
    }

    /// Removes the filtered rows of a part.
    pub(super) fn sift(&self, stream: usize, piece: usize, rows: &mut Rows) {
        publishers::hide(&self.publishers, stream, piece, rows);
        strays::hide(&self.strays, stream, piece, rows);
        stalled::hide(&self.stalled, stream, rows);
        held::take_once(&self.held, stream, piece, rows);
    }

    /// Copies the results of one part to another stream.
    pub(super) fn share(&mut self, (stream, piece): (usize, usize), to: usize) {
        fn shared<T: Clone>(
            all: &mut Vec<T>,
            is_of_it: impl Fn(&T) -> bool,
            moved: impl Fn(T) -> T,
        ) {
            let new: Vec<T> = all.iter().filter(|one| is_of_it(one)).cloned().map(moved).collect();
            all.extend(new);
        }
        let of_it = |own: (usize, usize)| own == (stream, piece);
        shared(
            &mut self.strays,
            |one| of_it((one.stream, one.piece)),
            |one| Strays { stream: to, piece: 0, ..one },
        );
        shared(
            &mut self.publishers,
            |one| of_it((one.stream, one.piece)),
            |one| Publishers { stream: to, piece: 0, ..one },
        );
        shared(
            &mut self.held,
            |one| of_it((one.stream, one.piece)),
            |one| Held { stream: to, piece: 0, ..one },
        );
    }
}
