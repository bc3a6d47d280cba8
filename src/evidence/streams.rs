use std::collections::HashMap;

use super::{StreamEvidence, stream_evidence};
use crate::finding::Subject;
use crate::run::{
    Cadence, NotAudited, NotAuditedReason, Role, RoundedStamps, Run, Stream, StreamClock,
    StreamExtent, with_key,
};
use crate::time::Clock;

/// When samples of a stream are expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpectedTiming {
    /// Throughout the run: joint states, IMU.
    Always,
    /// At least while the arm moves: poses and transforms may be published on change.
    WhileMoving,
    /// The stream is not identified.
    Unknown,
    /// Commands, and targets seen by a camera.
    Occasional,
}

impl ExpectedTiming {
    /// Whether an audit depends on the stream.
    pub fn is_expected(self) -> bool {
        matches!(self, ExpectedTiming::Always | ExpectedTiming::WhileMoving)
    }
}

/// Stamps of one stream.
#[derive(Clone, Debug)]
pub struct StampEvidence {
    /// When samples are expected.
    pub due: ExpectedTiming,
    /// Header stamps and their clock.
    pub clock: StreamClock,
    /// Rounding of the stamps, if any.
    pub rounded: Option<RoundedStamps>,
}

/// Sample timing of one stream.
#[derive(Clone, Debug)]
pub struct RhythmEvidence {
    /// When samples are expected.
    pub due: ExpectedTiming,
    /// Samples per second.
    pub rate_hz: Option<f64>,
    /// Whether its samples are rows of a table file, which one program writes.
    pub is_from_table: bool,
    /// Declared samples per second.
    pub declared_hz: Option<f64>,
    /// Samples with unusable numbers.
    pub unusable: u64,
    /// Samples with invalid stamps.
    pub unstamped: u64,
    /// Messages that list other poses, or none, but not this one.
    pub omitted: u64,
    /// The topic's samples in other frames.
    pub in_other_frames: u64,
    /// Timing per sender or transform.
    pub parts: Vec<Cadence>,
    /// Start and end relative to the other streams.
    pub extent: Option<StreamExtent>,
}

impl StreamEvidence<RhythmEvidence> {
    /// The stream, or one transform of a TF topic if only that is concerned.
    pub fn subject_of(&self, concerned: &[&Cadence]) -> Subject {
        match concerned {
            [only] if self.parts.len() > 1 => {
                Subject { frame: only.frame.clone(), ..self.subject.clone() }
            }
            _ => self.subject.clone(),
        }
    }

    /// Parts that an audit needs.
    pub fn required_parts(&self) -> impl Iterator<Item = &Cadence> {
        self.parts.iter().filter(|part| part.is_audited)
    }
}

/// `None` if timing rules do not apply.
fn expected_timing(run: &Run, stream: &Stream) -> Option<ExpectedTiming> {
    match stream.role {
        Role::Joints | Role::Imu => Some(ExpectedTiming::Always),
        // Without an arm, the required transforms are unknown.
        Role::Tf if run.arms.is_empty() => Some(ExpectedTiming::Unknown),
        Role::Pose | Role::Tf => Some(ExpectedTiming::WhileMoving),
        Role::Candidate { .. } | Role::Unassigned => Some(ExpectedTiming::Unknown),
        Role::Reference | Role::Target => Some(ExpectedTiming::Occasional),
        Role::TfStatic | Role::Description | Role::Ignored => None,
    }
}

/// Frame of the stream's poses, if its topic has several streams.
pub(crate) fn frame_of_several(stream: &Stream) -> Option<String> {
    let is_one_of_several = stream.shares_topic && !stream.child_frame_id.is_empty();
    is_one_of_several.then(|| stream.child_frame_id.clone())
}

pub(super) fn rhythms(run: &Run, others: &[NotAudited]) -> Vec<StreamEvidence<RhythmEvidence>> {
    let mut in_other_frames: HashMap<usize, u64> = HashMap::new();
    for found in others {
        if let NotAuditedReason::OtherFrames { samples, .. } = found.reason {
            *in_other_frames.entry(found.stream).or_default() += samples;
        }
    }
    let rhythms = run.rhythms.iter().filter_map(|rhythm| {
        let stream = run.streams.get(rhythm.stream)?;
        let found = RhythmEvidence {
            is_from_table: stream.is_from_table,
            due: expected_timing(run, stream)?,
            rate_hz: stream.rate_hz,
            declared_hz: stream.expected_hz,
            unstamped: run
                .clocks_of(rhythm.stream)
                .iter()
                .filter(|clock| clock.clock == Clock::Header)
                .map(|clock| clock.zero)
                .sum(),
            in_other_frames: in_other_frames.get(&rhythm.stream).copied().unwrap_or(0),
            omitted: stream.omitted,
            // Rows of joint states are never excluded.
            unusable: if stream.role == Role::Joints { 0 } else { stream.unusable() },
            parts: rhythm.parts.clone(),
            extent: rhythm.extent,
        };
        Some(stream_evidence(run, rhythm.stream, found))
    });
    rhythms.filter(|rhythm| !rhythm.parts.is_empty()).collect()
}

pub(super) fn stamps(run: &Run) -> Vec<StreamEvidence<StampEvidence>> {
    let stamps = run.clocks.iter().filter_map(|clock| {
        let stream = run.streams.get(clock.stream)?;
        let own = with_key(&run.rounded, clock.stream, |own| own.stream).iter();
        let rounded = own.max_by(|a, b| a.resolution_s.total_cmp(&b.resolution_s)).cloned();
        let found =
            StampEvidence { due: expected_timing(run, stream)?, clock: clock.clone(), rounded };
        let mut of = stream_evidence(run, clock.stream, found);
        of.subject.frame = clock.frame.clone().or(of.subject.frame);
        Some(of)
    });
    stamps.collect()
}
