//! Stamps of all rows, and the rows for estimation.

use super::excerpts::Excerpts;
use super::rounded;
use super::rows::Rows;
use super::sample_filter::SampleFilter;
use super::set_back::leave_out_overlaps;
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
        let ticks_s = rounded::clock_ticks_s(streams, wanted);
        let rounded = rounded::restore_stamps(streams, wanted);
        let mut clocks = StreamClocks::select(streams, wanted, max_latency_s);
        (clocks.rounded, clocks.ticks_s) = (rounded, ticks_s);
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
