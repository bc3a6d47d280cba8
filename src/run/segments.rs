//! Splits a run at clock restarts, such as a simulation reset or a looped bag, and at seams of a table.
//!
//! At a restart, the stamps of all streams decrease by more than a second. If only one stream's do, the rules report it.

use super::seams::seams;
use crate::log::{Log, Topic};
use crate::stats::median;
use crate::stream::{Columns, Times};
use crate::time::{NANOS_PER_SECOND, Stamp};

/// Minimum decrease, ns.
const MIN_RESTART_NS: i64 = NANOS_PER_SECOND;
/// Maximum receive time between decreases of one restart, ns.
const MAX_RESTART_SPREAD_NS: i64 = 2 * NANOS_PER_SECOND;

/// Part of a log between two restarts or seams.
#[derive(Debug)]
pub struct Segment {
    /// Its data. Data without time, such as static transforms, is in every segment.
    pub log: Log,
    /// Time from the first to the last stamp, s.
    pub duration_s: f64,
    /// What separates it from the others. `None` if there are no others.
    pub cut: Option<Cut>,
}

/// What separates segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// All clocks restart.
    Restart,
    /// A table without times continues with another recording.
    Seam,
}

impl Segment {
    fn whole(log: Log) -> Self {
        Self { log, duration_s: 0.0, cut: None }
    }

    /// Messages of topics that are not valid at all times.
    pub fn messages(&self) -> u64 {
        self.log.topics.iter().filter(|topic| has_times(topic)).map(|topic| topic.messages).sum()
    }
}

/// Minimum median duration, s; shorter segments are jumping stamps.
const MIN_MEDIAN_DURATION_S: f64 = 1.0;

/// Splits a log at its restarts, or else its seams, in receive order.
pub fn segments(mut log: Log) -> Vec<Segment> {
    let moving = || log.topics.iter().filter(|topic| has_times(topic));
    let seams = seams(&log);
    if seams.is_empty() && !moving().flat_map(times_of).any(may_restart) {
        return vec![Segment::whole(log)];
    }
    let pieces: Vec<OrderedPart> = moving().flat_map(OrderedPart::all_of_topic).collect();
    let reference =
        pieces.iter().max_by_key(|piece| (!piece.restarts.is_empty(), piece.order.len()));
    let restarts: Vec<ClockRestart> = match reference {
        Some(reference) => {
            let restarts = reference.restarts.iter().map(|&at| reference.restart(at));
            restarts.filter(|restart| pieces.iter().all(|piece| piece.agrees(restart))).collect()
        }
        None => Vec::new(),
    };
    let at_seam = |[last_before_ns, first_after_ns]: [i64; 2]| ClockRestart {
        last_before_ns,
        first_after_ns,
    };
    let (cut, restarts) = match restarts.is_empty() {
        true => (Cut::Seam, seams.into_iter().map(at_seam).collect()),
        false => (Cut::Restart, restarts),
    };
    let Some(reference) = reference.filter(|_| !restarts.is_empty()) else {
        return vec![Segment::whole(log)];
    };
    let cuts = reference.cuts(&restarts);
    let spans: Vec<f64> =
        (0..=restarts.len()).map(|segment| reference.seconds(&cuts, segment)).collect();
    if median(&mut spans.clone()).is_none_or(|usual_s| usual_s < MIN_MEDIAN_DURATION_S) {
        return vec![Segment::whole(log)];
    }
    // Each segment clones the rest of the log.
    let topics = std::mem::take(&mut log.topics);
    spans
        .into_iter()
        .enumerate()
        .map(|(index, seconds)| {
            let own = topics.iter().map(|topic| segment_of_topic(topic, &restarts, index));
            let log = Log { topics: own.collect(), ..log.clone() };
            Segment { log, duration_s: seconds, cut: Some(cut) }
        })
        .collect()
}

fn times_of(topic: &Topic) -> Vec<&Times> {
    topic.columns.as_ref().map(Columns::times).unwrap_or_default()
}

/// Whether stamps decrease in receive order, without sorting.
fn may_restart(times: &Times) -> bool {
    times.header.windows(2).any(|pair| steps_back(pair[0], pair[1])) || !times.log.is_sorted()
}

fn steps_back(before_ns: i64, after_ns: i64) -> bool {
    before_ns.saturating_sub(after_ns) > MIN_RESTART_NS
}

/// Whether a topic's data is valid only at its time.
fn has_times(topic: &Topic) -> bool {
    let holds_at_all_times =
        matches!(topic.columns, Some(Columns::Text(_)) | None) || topic.name.ends_with("tf_static");
    !holds_at_all_times
}

/// Receive times of the last message before a restart and the first after it.
#[derive(Clone, Copy, Debug)]
struct ClockRestart {
    last_before_ns: i64,
    first_after_ns: i64,
}

struct OrderedPart<'a> {
    times: &'a Times,
    order: Vec<usize>,
    /// Indices into `order` of decreasing stamps.
    restarts: Vec<usize>,
}

impl<'a> OrderedPart<'a> {
    fn all_of_topic(topic: &'a Topic) -> Vec<Self> {
        times_of(topic).into_iter().map(Self::new).collect()
    }

    fn new(times: &'a Times) -> Self {
        let mut order: Vec<usize> = (0..times.len()).collect();
        // Files are nearly in receive order. Keep theirs if the recorder's clock restarted.
        if !times.log.windows(2).any(|pair| steps_back(pair[0], pair[1])) {
            order.sort_by_key(|&row| times.log[row]);
        }
        let stamped: Vec<(usize, i64)> = order
            .iter()
            .enumerate()
            .map(|(at, &row)| (at, times.header[row]))
            .filter(|(_, stamp)| *stamp != 0)
            .collect();
        let restarts = stamped.windows(2).filter(|pair| steps_back(pair[0].1, pair[1].1));
        let restarts = restarts.map(|pair| pair[1].0).collect();
        Self { times, order, restarts }
    }

    fn received(&self, at: usize) -> i64 {
        self.times.log[self.order[at]]
    }

    fn restart(&self, at: usize) -> ClockRestart {
        ClockRestart { last_before_ns: self.received(at - 1), first_after_ns: self.received(at) }
    }

    /// Index at which its own stamps decrease at `restart`.
    fn matching_restart(&self, restart: &ClockRestart) -> Option<usize> {
        let apart = |&&at: &&usize| {
            let own = self.restart(at);
            let after = own.first_after_ns.saturating_sub(restart.first_after_ns).saturating_abs();
            let before = own.last_before_ns.saturating_sub(restart.last_before_ns).saturating_abs();
            (after, before)
        };
        let near = self.restarts.iter().filter(|at| apart(at).0 <= MAX_RESTART_SPREAD_NS);
        near.min_by_key(|at| apart(at).0.saturating_add(apart(at).1)).copied()
    }

    /// Whether its stamps decrease at `restart`, are missing, or do not cover it.
    fn agrees(&self, restart: &ClockRestart) -> bool {
        let stamped = self.order.iter().filter(|&&row| self.times.header[row] != 0);
        let received = stamped.map(|&row| self.times.log[row]);
        let (first, last) = match (received.clone().min(), received.max()) {
            (Some(first), Some(last)) => (first, last),
            _ => return true,
        };
        let ClockRestart { last_before_ns, first_after_ns } = *restart;
        let is_over =
            last <= last_before_ns.max(first_after_ns).saturating_add(MAX_RESTART_SPREAD_NS);
        let is_later =
            first >= last_before_ns.min(first_after_ns).saturating_sub(MAX_RESTART_SPREAD_NS);
        self.matching_restart(restart).is_some() || is_over || is_later
    }

    /// Start of each segment but the first, as ascending indices into `order`.
    fn cuts(&self, restarts: &[ClockRestart]) -> Vec<usize> {
        let by_receipt = |restart: &ClockRestart| {
            let is_later = |&row: &usize| self.times.log[row] >= restart.first_after_ns;
            self.order.iter().position(is_later).unwrap_or(self.order.len())
        };
        let cuts = restarts
            .iter()
            .map(|restart| self.matching_restart(restart).unwrap_or_else(|| by_receipt(restart)));
        // Each row is in one segment.
        let mut from = 0;
        cuts.map(|cut| {
            from = cut.max(from);
            from
        })
        .collect()
    }

    fn rows(&self, cuts: &[usize], segment: usize) -> Vec<usize> {
        let mut rows = self.rows_in_order(cuts, segment).to_vec();
        rows.sort_unstable();
        rows
    }

    fn rows_in_order(&self, cuts: &[usize], segment: usize) -> &[usize] {
        let (from, to) = self.bounds(cuts, segment);
        self.order.get(from..to).unwrap_or_default()
    }

    fn bounds(&self, cuts: &[usize], segment: usize) -> (usize, usize) {
        let from = segment.checked_sub(1).map_or(0, |before| cuts[before]);
        (from, cuts.get(segment).copied().unwrap_or(self.order.len()))
    }

    fn seconds(&self, cuts: &[usize], segment: usize) -> f64 {
        let rows = self.rows_in_order(cuts, segment);
        let stamps = || rows.iter().map(|&row| Stamp::from_nanos(self.times.header[row]));
        match (stamps().min(), stamps().max()) {
            (Some(first), Some(last)) => last.seconds_since(first),
            _ => 0.0,
        }
    }
}

/// One segment of a topic. Splits the message count by rows; dropped samples count in the first segment
/// with rows.
fn segment_of_topic(topic: &Topic, restarts: &[ClockRestart], segment: usize) -> Topic {
    if !has_times(topic) {
        return topic.clone();
    }
    let pieces = OrderedPart::all_of_topic(topic);
    let cuts: Vec<Vec<usize>> = pieces.iter().map(|piece| piece.cuts(restarts)).collect();
    let rows: Vec<Vec<usize>> =
        pieces.iter().zip(&cuts).map(|(piece, cuts)| piece.rows(cuts, segment)).collect();
    let received = || {
        let rows = pieces.iter().zip(&rows);
        rows.flat_map(|(piece, rows)| rows.iter().map(|&row| piece.times.log[row]))
    };
    let span = received().min().zip(received().max());
    let bounds: Vec<(usize, usize)> =
        pieces.iter().zip(&cuts).map(|(piece, cuts)| piece.bounds(cuts, segment)).collect();
    let all: usize = pieces.iter().map(|piece| piece.order.len()).sum();
    let messages = match all {
        0 if segment > 0 => 0,
        0 => topic.messages,
        _ => {
            let until =
                |rows: usize| (topic.messages as f64 * rows as f64 / all as f64).round() as u64;
            until(bounds.iter().map(|it| it.1).sum()) - until(bounds.iter().map(|it| it.0).sum())
        }
    };
    let mut columns = topic.columns.clone();
    if let Some(columns) = &mut columns {
        let is_first = |part: usize| match (bounds.get(part), pieces.get(part)) {
            (Some((0, to)), Some(piece)) => *to > 0 || (segment == 0 && piece.order.is_empty()),
            _ => false,
        };
        columns.clear_dropped(is_first);
        columns.retain(&rows);
        if topic.read_as.is_some() && !topic.is_aligned_by_motion {
            // Table rows have made-up receive times that put episodes one after another.
            columns.times_mut().into_iter().for_each(|times| times.log.clone_from(&times.header));
        }
    }
    Topic {
        // The table reader decides whether an episode has a topic.
        messages: if topic.read_as.is_some() {
            messages.max(topic.messages.min(1))
        } else {
            messages
        },
        columns,
        undecodable: topic.undecodable.clone().filter(|_| segment == 0),
        span: span.map(|(first, last)| (Stamp::from_nanos(first), Stamp::from_nanos(last))),
        ..topic.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{ImuColumns, TextColumns};

    const S: i64 = NANOS_PER_SECOND;

    fn topic(name: &str, columns: Columns) -> Topic {
        let messages = columns.times().iter().map(|times| times.len() as u64).sum();
        Topic { name: name.to_owned(), messages, columns: Some(columns), ..Topic::default() }
    }

    /// IMU at 10 Hz; `stamp` maps receive time to header stamp, s.
    fn imu(name: &str, from: i64, to: i64, stamp: impl Fn(i64) -> i64) -> Topic {
        let mut imu = ImuColumns::default();
        for received in (from * 10..to * 10).map(|tick| tick * S / 10) {
            imu.times.push(stamp(received), 1_000 * S + received, 0);
            imu.gyro.push([received as f64, 0.0, 0.0]);
            imu.accel.push([0.0; 3]);
            imu.q_xyzw.push([0.0; 4]);
        }
        topic(name, Columns::Imu(imu))
    }

    fn log(topics: Vec<Topic>) -> Log {
        Log { topics, ..Log::default() }
    }

    fn restarted(received: i64) -> i64 {
        S + received - if received < 20 * S { 0 } else { 20 * S }
    }

    fn rows(segment: &Segment, topic: usize) -> usize {
        let columns = segment.log.topics[topic].columns.as_ref().expect("columns");
        columns.times().iter().map(|times| times.len()).sum()
    }

    #[test]
    fn stamps_of_a_restarted_clock_form_two_segments() {
        let mut text = TextColumns::default();
        text.times.push(0, 0, 0);
        text.text.push("<robot/>".to_owned());
        let unstamped = imu("/unstamped", 0, 30, |_| 0);
        let short = imu("/only_before", 2, 18, restarted);
        let segments = segments(log(vec![
            imu("/a", 0, 30, restarted),
            imu("/b", 1, 28, restarted),
            unstamped,
            short,
            topic("/robot_description", Columns::Text(text)),
        ]));
        let held: Vec<Vec<usize>> =
            segments.iter().map(|one| (0..5).map(|at| rows(one, at)).collect()).collect();
        assert_eq!(held, [[200, 190, 200, 160, 1], [100, 80, 100, 0, 1]]);
        assert!((segments[0].duration_s - 19.9).abs() < 1e-9);
        assert_eq!(segments[1].log.topics[0].messages, 100);
    }

    #[test]
    fn messages_and_dropped_samples_of_all_segments_add_up() {
        let dropping = |mut topic: Topic, count: u64| {
            if let Some(Columns::Imu(imu)) = &mut topic.columns {
                imu.not_finite = count;
            }
            topic.messages += count;
            topic
        };
        let topics = vec![
            dropping(imu("/a", 0, 30, restarted), 7),
            dropping(imu("/late", 21, 30, restarted), 2),
            imu("/unstamped", 3, 29, |_| 0),
            dropping(topic("/never", Columns::Imu(ImuColumns::default())), 5),
        ];
        let before: Vec<u64> = topics.iter().map(|topic| topic.messages).collect();
        let segments = segments(log(topics));
        assert_eq!(segments.len(), 2);
        let of_topic = |at: usize, count: &dyn Fn(&Topic) -> u64| -> Vec<u64> {
            segments.iter().map(|segment| count(&segment.log.topics[at])).collect()
        };
        for (at, messages) in before.into_iter().enumerate() {
            let own = of_topic(at, &|topic| topic.messages);
            assert_eq!(own.iter().sum::<u64>(), messages, "{at}: {own:?}");
        }
        let dropped = |topic: &Topic| match &topic.columns {
            Some(Columns::Imu(imu)) => imu.not_finite,
            _ => 0,
        };
        let own: Vec<Vec<u64>> = (0..4).map(|at| of_topic(at, &dropped)).collect();
        assert_eq!(own, [[7, 0], [0, 2], [0, 0], [5, 0]]);
        // A segment without the topic has none of its messages.
        assert_eq!(of_topic(1, &|topic| topic.messages), [0, 92]);
    }

    #[test]
    fn one_stream_that_steps_back_is_no_restart() {
        let whole = segments(log(vec![imu("/a", 0, 30, restarted), imu("/b", 0, 30, |t| S + t)]));
        assert_eq!(whole.len(), 1);
        assert_eq!(rows(&whole[0], 0), 300);
    }

    #[test]
    fn a_recorder_that_keeps_simulated_time_restarts_too() {
        let both = |name: &str| {
            let mut topic = imu(name, 0, 30, restarted);
            if let Some(Columns::Imu(imu)) = &mut topic.columns {
                imu.times.log = imu.times.header.clone();
            }
            topic
        };
        let segments = segments(log(vec![both("/a"), both("/b")]));
        let held: Vec<usize> = segments.iter().map(|segment| rows(segment, 1)).collect();
        assert_eq!(held, [200, 100]);
    }
}
