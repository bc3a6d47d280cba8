//! Streams with stamps from a coarse clock.

use crate::run::tick_grid::TickGrid;
use crate::stats::median;
use crate::time::{Stamp, seconds};

pub(super) struct CoarseClock {
    /// Clock resolution, s.
    pub tick_s: f64,
    /// Rows with stamps interpolated from finer receive times.
    pub interpolated: Option<Vec<(Stamp, i64)>>,
    /// Whether lost rows are undetectable because rows may share a tick.
    pub is_blurred: bool,
}

impl CoarseClock {
    /// Detects a coarse clock from rows in stamp order with receive times. `None` if there is none.
    pub fn detect(times: &[(Stamp, i64)]) -> Option<Self> {
        let (begin, received) = *times.first()?;
        let stamped_s: Vec<f64> = times.iter().map(|(at, _)| at.seconds_since(begin)).collect();
        let grid = TickGrid::detect(&stamped_s)?;
        let since_s = |nanos: i64| seconds(nanos.saturating_sub(received));
        let received_s: Vec<f64> = times.iter().map(|(_, nanos)| since_s(*nanos)).collect();
        if is_of_whole_ticks(&received_s, grid.tick_s) {
            return None;
        }
        let is_even = grid.is_of_one_even_sender();
        if grid.hides_no_loss(&received_s) {
            let mut delays: Vec<f64> = stamped_s
                .iter()
                .zip(&received_s)
                .map(|(stamped, received)| received - stamped)
                .collect();
            let delay_s = median(&mut delays)?;
            let at = |received_s: f64| begin.shifted(received_s - delay_s);
            let mut finer: Vec<(Stamp, i64)> =
                times.iter().map(|(_, nanos)| (at(since_s(*nanos)), *nanos)).collect();
            finer.sort_unstable();
            finer.dedup_by_key(|(stamp, _)| *stamp);
            return Some(Self {
                tick_s: grid.tick_s,
                interpolated: Some(finer),
                is_blurred: false,
            });
        }
        // Receive times of the same resolution add nothing.
        let is_alike = || {
            let other = TickGrid::detect(&received_s);
            other.is_some_and(|other| (other.tick_s - grid.tick_s).abs() < 0.01 * grid.tick_s)
        };
        let may_hide = grid.ticks.contains(&1) && grid.ticks.iter().any(|ticks| *ticks > 1);
        is_even.then(|| Self {
            tick_s: grid.tick_s,
            interpolated: None,
            is_blurred: may_hide && is_alike(),
        })
    }
}

fn is_of_whole_ticks(received_s: &[f64], tick_s: f64) -> bool {
    const MIN_WHOLE_TICK_SHARE: f64 = 0.95;
    const MAX_TICK_DEVIATION: f64 = 0.05;
    let is_whole = |pair: &&[f64]| {
        let ticks = (pair[1] - pair[0]) / tick_s;
        ticks > 0.5 && (ticks - ticks.round()).abs() < MAX_TICK_DEVIATION
    };
    let whole = received_s.windows(2).filter(is_whole).count();
    whole as f64 >= MIN_WHOLE_TICK_SHARE * received_s.len().saturating_sub(1) as f64
}
