//! Stamps of all rows, and the rows for estimation.

use super::excerpts::Excerpts;
use super::rounded;
use super::rows::Rows;
use super::sample_filter::SampleFilter;
use super::streams::{Stream, StreamClocks};
use crate::time::Clock;

pub(super) struct Timing {
    pub clocks: StreamClocks,
    pub excerpts: Option<Excerpts>,
    pub sample_filter: SampleFilter,
}

impl Timing {
    /// Selects clocks, measures rates, and checks rows.
    pub fn new(streams: &mut [Stream], wanted: Clock, max_latency_s: f64) -> Self {
        let rounded = rounded::restore_stamps(streams, wanted);
        let mut clocks = StreamClocks::select(streams, wanted, max_latency_s);
        clocks.rounded = rounded;
        clocks.measure(streams);
        let sample_filter = SampleFilter::new(streams, &clocks);
        let excerpts = Excerpts::select(streams, &clocks, &sample_filter);
        Self { clocks, excerpts, sample_filter }
    }

    /// Rows for estimation: less than `around_s` from an excerpt, and not excluded.
    pub fn filtered_rows(
        &self,
        streams: &[Stream],
        stream: usize,
        piece: usize,
        around_s: f64,
    ) -> Rows {
        let mut rows = match &self.excerpts {
            Some(excerpts) => {
                self.clocks.rows_where(streams, stream, piece, excerpts.time_filter(around_s))
            }
            None => self.clocks.rows(streams, stream, piece),
        };
        if let Some(times) = streams[stream].times().get(piece) {
            leave_out_overlaps(&mut rows, &times.log);
        }
        self.sample_filter.apply(stream, piece, &mut rows);
        rows
    }

    /// Shares one part's clock and results with a new stream.
    pub fn share(&mut self, stream: usize, piece: usize) {
        self.sample_filter.share((stream, piece), self.clocks.streams());
        self.clocks.share(stream, piece);
    }
}

/// Removes rows after a clock was set back until it has caught up. Keeps single messages out of order.
fn leave_out_overlaps(rows: &mut Rows, received: &[i64]) {
    /// Minimum consecutive rows with earlier stamps.
    const BLOCK: usize = 10;
    if rows.is_sorted_by_key(|(stamp, _)| *stamp) {
        return;
    }
    rows.sort_by_key(|(_, row)| received[*row]);
    let mut latest = None;
    let behind: Vec<bool> = rows
        .iter()
        .map(|(stamp, _)| {
            let is_behind = latest.is_some_and(|latest| *stamp < latest);
            latest = latest.max(Some(*stamp));
            is_behind
        })
        .collect();
    let blocks = behind.chunk_by(|a, b| a == b);
    let kept: Vec<bool> = blocks
        .flat_map(|block| std::iter::repeat_n(!block[0] || block.len() < BLOCK, block.len()))
        .collect();
    let mut kept = kept.into_iter();
    rows.retain(|_| kept.next().unwrap_or(true));
}
