//! When a run's streams came: their stamps, and how regularly.

use super::{Of, of};
use crate::finding::Subject;
use crate::run::{
    Cadence, Extent, Role, RoundedStamps, Run, Stream, StreamClock, Unaudited, WhyNot,
};
use crate::time::Clock;

/// When the samples of a stream are due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// From the first of the run to the last: joint states, an IMU.
    Always,
    /// At least while the arm moves: poses and transforms may be sent on change.
    InMotion,
    /// Nobody knows, as nothing says what the stream is.
    Untold,
    /// When there is something to say: commands, and what a camera sees.
    OnOccasion,
}

impl Due {
    /// Whether an audit rests on the stream, so that it must be there.
    pub fn is_expected(self) -> bool {
        matches!(self, Due::Always | Due::InMotion)
    }
}

/// The stamps of one stream, with when they are due.
#[derive(Clone, Debug)]
pub struct StampEvidence {
    /// When its samples are due.
    pub due: Due,
    /// What its headers say, and whose time that is.
    pub clock: StreamClock,
    /// How its stamps were rounded; `None` if they were not.
    pub rounded: Option<RoundedStamps>,
}

/// How regularly one stream comes.
#[derive(Clone, Debug)]
pub struct RhythmEvidence {
    /// When its samples are due.
    pub due: Due,
    /// Samples a second.
    pub rate_hz: Option<f64>,
    /// Samples a second as the caller says that there should be.
    pub said_hz: Option<f64>,
    /// Samples that came and are left out, because they hold no usable numbers.
    pub unusable: u64,
    /// Samples that came and are left out, because their stamps are none.
    pub unstamped: u64,
    /// Samples of its topic that came and say that they are in another frame.
    pub elsewhere: u64,
    /// The rhythm of each of its senders, or of each transform.
    pub parts: Vec<Cadence>,
    /// How it lies against the other streams.
    pub extent: Option<Extent>,
}

impl Of<RhythmEvidence> {
    /// The stream as a subject; of a TF topic the one transform that is concerned, where it is one
    /// of several.
    pub fn subject_of(&self, concerned: &[&Cadence]) -> Subject {
        match concerned {
            [only] if self.parts.len() > 1 => {
                Subject { frame: only.frame.clone(), ..self.subject.clone() }
            }
            _ => self.subject.clone(),
        }
    }

    /// The parts that an audit needs.
    pub fn wanted(&self) -> impl Iterator<Item = &Cadence> {
        self.parts.iter().filter(|part| part.wanted)
    }
}

/// When the samples of a stream are due; `None` where the rules about stamps are not asked about it.
fn due(run: &Run, stream: &Stream) -> Option<Due> {
    match stream.role {
        Role::Joints | Role::Imu => Some(Due::Always),
        // Without an arm, nothing says which of the transforms must be there.
        Role::Tf if run.arms.is_empty() => Some(Due::Untold),
        Role::Pose | Role::Tf => Some(Due::InMotion),
        Role::Candidate { .. } | Role::Unassigned => Some(Due::Untold),
        Role::Reference | Role::Target => Some(Due::OnOccasion),
        Role::TfStatic | Role::Description | Role::Ignored => None,
    }
}

/// The frame whose poses a stream holds, where its topic is that of other streams, too.
pub(crate) fn frame_of_several(run: &Run, stream: &Stream) -> Option<String> {
    let of_topic = run.streams.iter().filter(|other| other.topic == stream.topic);
    let is_one_of_several = of_topic.count() > 1 && !stream.child_frame_id.is_empty();
    is_one_of_several.then(|| stream.child_frame_id.clone())
}

pub(super) fn rhythms(run: &Run, others: &[Unaudited]) -> Vec<Of<RhythmEvidence>> {
    let rhythms = run.rhythms.iter().filter_map(|rhythm| {
        let stream = run.streams.get(rhythm.stream)?;
        let found = RhythmEvidence {
            due: due(run, stream)?,
            rate_hz: stream.rate_hz,
            said_hz: stream.said_hz,
            unstamped: run
                .clocks
                .iter()
                .filter(|clock| clock.stream == rhythm.stream && clock.clock == Clock::Header)
                .map(|clock| clock.zero)
                .sum(),
            elsewhere: others
                .iter()
                .filter(|found| found.stream == rhythm.stream)
                .map(|found| match found.why {
                    WhyNot::OtherFrames { samples, .. } => samples,
                    _ => 0,
                })
                .sum(),
            // Of joint states no row is left out.
            unusable: if stream.role == Role::Joints { 0 } else { stream.unusable() },
            parts: rhythm.parts.clone(),
            extent: rhythm.extent,
        };
        Some(of(run, rhythm.stream, found))
    });
    rhythms.filter(|rhythm| !rhythm.parts.is_empty()).collect()
}

/// Every stream that plays a part, by its stamps.
pub(super) fn stamps(run: &Run) -> Vec<Of<StampEvidence>> {
    let stamps = run.clocks.iter().filter_map(|clock| {
        let stream = run.streams.get(clock.stream)?;
        let own = run.rounded.iter().filter(|own| own.stream == clock.stream);
        let rounded = own.max_by(|a, b| a.resolution_s.total_cmp(&b.resolution_s)).cloned();
        let found = StampEvidence { due: due(run, stream)?, clock: clock.clone(), rounded };
        let mut of = of(run, clock.stream, found);
        of.subject.frame = clock.frame.clone().or(of.subject.frame);
        Some(of)
    });
    stamps.collect()
}
