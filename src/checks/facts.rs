//! What the rules judge: the diagnosis of every stream beside the names that words need.
//!
//! The pipeline fills these from `run` and `diagnosis`; the rules only read them.

mod arm;

use std::ops::{Deref, DerefMut};

use super::{Judged, Thresholds};
use crate::diagnosis::{HandEyeDiagnosis, Mount};
use crate::finding::{Outcome, Span, Subject};
use crate::log::{self, Loss};
use crate::run::{
    Cadence, CameraAxes, Extent, Flaw, Frozen, Held, Norms, Strays, StreamClock, WhyNot,
};
use crate::time::Stamp;

pub use arm::{
    ArmFacts, Declared, DhFacts, EulerFacts, ImuFacts, JointFacts, JointMotion, PoseFacts,
    ReferenceFacts, ReferenceWitness, ShakeFacts, WitnessKind,
};

/// All that is known of one run.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// The robots in the log that have a model, each with its streams.
    pub robots: Vec<ArmFacts>,
    /// Why there is none, where there is none.
    pub no_robot: Option<String>,
    /// What cameras see, each held against a hand.
    pub hand_eyes: Vec<HandEyeFacts>,
    /// Every stream that plays a part, by its stamps.
    pub stamps: Vec<Of<StampFacts>>,
    /// Every stream that is audited, by its samples that hold no usable numbers.
    pub unusable: Vec<Of<UnusableFacts>>,
    /// Every stream that plays a part, by how regularly it comes.
    pub rhythms: Vec<Of<RhythmFacts>>,
    /// The TF topics, and what keeps their frames from being a tree.
    pub frames: FrameFacts,
    /// Every stream that logs rotations as more than three numbers, by how far they are from rotations.
    pub norms: Vec<Of<Vec<Norms>>>,
    /// Every stream of joint states, tool poses or transforms, by the samples that jump away and back.
    pub strays: Vec<Of<StrayFacts>>,
    /// Every stream of tool poses that the arm can be held against, by when it stood still.
    pub frozen: Vec<Of<Vec<Frozen>>>,
    /// What repeats values with new stamps.
    pub held: Vec<Of<HeldFacts>>,
    /// Every stream of joint states or tool poses, and every other that says it is one, with why it is not
    /// audited as that.
    pub unaudited: Vec<Of<Vec<WhyNot>>>,
    /// Topics that would play a role, and hold no message, or none with finite numbers.
    pub empty: Vec<EmptyFacts>,
    /// Topics that the caller expects and the log does not have, with where that is said.
    pub missing: Vec<(Subject, String)>,
    /// The thresholds that the caller set instead of the rules' own.
    pub thresholds: Thresholds,
    /// First stamp of the run.
    pub start: Option<Stamp>,
    /// The stamp that times in seconds of the diagnosis are relative to.
    pub origin: Stamp,
    /// Whether the log holds `/clock`, the mark of simulation.
    pub simulated: bool,
    /// Damage to the files.
    pub losses: Vec<Loss>,
    /// Topics that the audit wants and that could not be decoded.
    pub undecodable: Vec<UndecodableTopic>,
}

impl Facts {
    /// Number of subjects (streams and joints) in the run, by which intervals are corrected.
    pub fn subjects(&self) -> usize {
        let of_robots: usize = self.robots.iter().map(ArmFacts::subjects).sum();
        (of_robots + self.hand_eyes.len()).max(1)
    }

    /// Whether messages amid the files are lost, so that what is missing of a stream may be the log's.
    pub fn lost_messages(&self) -> bool {
        self.losses.iter().any(|loss| loss.extent >= log::Extent::Messages)
    }

    /// A moment of the run as a person finds it again: seconds from the start.
    pub fn moment(&self, stamp: Stamp) -> String {
        format!("+{:.2} s", stamp.seconds_since(self.start.unwrap_or(stamp)))
    }

    /// Every pose stream with its robot.
    pub fn poses(&self) -> impl Iterator<Item = (&ArmFacts, &Of<PoseFacts>)> {
        self.robots.iter().flat_map(|arm| arm.poses.iter().map(move |stream| (arm, stream)))
    }

    /// Every pose stream and every /tf with its robot.
    pub fn poses_and_tf(&self) -> impl Iterator<Item = (&ArmFacts, &Of<PoseFacts>)> {
        self.robots.iter().flat_map(|arm| arm.poses_and_tf().map(move |stream| (arm, stream)))
    }

    /// Every IMU with its robot.
    pub fn imus(&self) -> impl Iterator<Item = (&ArmFacts, &Of<ImuFacts>)> {
        self.robots.iter().flat_map(|arm| arm.imus.iter().map(move |imu| (arm, imu)))
    }
}

/// What was found on a stream.
#[derive(Clone, Debug)]
pub struct Of<T> {
    /// The stream.
    pub subject: Subject,
    /// First and last stamp used.
    pub span: Option<Span>,
    /// What was found.
    pub found: T,
}

impl<T> Of<T> {
    /// What a rule says of it.
    pub(super) fn judged(&self, outcome: Outcome) -> Judged {
        Judged::new(self.subject.clone(), outcome).within(self.span)
    }

    /// The topic of the stream.
    pub fn topic(&self) -> &str {
        self.subject.topic.as_deref().unwrap_or_default()
    }

    /// Length of its span, s; 0 without one.
    pub fn seconds(&self) -> f64 {
        self.span.map_or(0.0, |span| span.seconds())
    }
}

impl<T> Of<T> {
    /// Something else that was found on the same stream.
    pub(super) fn with<U>(&self, found: U) -> Of<U> {
        Of { subject: self.subject.clone(), span: self.span, found }
    }
}

impl<T> Deref for Of<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.found
    }
}

impl<T> DerefMut for Of<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.found
    }
}

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

/// A target that a camera sees, and a hand.
#[derive(Clone, Debug)]
pub struct HandEyeFacts {
    /// Name of the robot whose hand it is, where there is one.
    pub robot: Option<String>,
    /// Topic of the target.
    pub topic: String,
    /// The camera's frame.
    pub camera: String,
    /// The target's frame; empty where the log names none.
    pub target: String,
    /// First and last stamp of the target.
    pub span: Option<Span>,
    /// The hand in words: a topic, or a link and what its poses are computed from.
    pub hand: String,
    /// The frame of the hand; empty where the log names none.
    pub hand_frame: String,
    /// The frame of the base that the hand's poses are in; empty where the log names none.
    pub base: String,
    /// Which way the camera's axes should point, where the log's frames say.
    pub axes: Option<CameraAxes>,
    /// Where the log's frames have the camera.
    pub logged: Option<Mount>,
    /// What was estimated.
    pub diagnosis: HandEyeDiagnosis,
}

impl HandEyeFacts {
    /// The frame that a camera on this mount is in, where the log names it.
    pub fn parent_of(&self, mount: Mount) -> Option<String> {
        let frame = match mount {
            Mount::InHand => &self.hand_frame,
            Mount::InBase => &self.base,
        };
        Some(frame.clone()).filter(|frame| !frame.is_empty())
    }

    /// The target as a subject.
    pub fn subject(&self) -> Subject {
        Subject {
            robot: self.robot.clone(),
            topic: Some(self.topic.clone()),
            frame: Some(self.target.clone()).filter(|frame| !frame.is_empty()),
            joint: None,
        }
    }
}

/// The stamps of one stream, with when they are due.
#[derive(Clone, Debug)]
pub struct StampFacts {
    /// When its samples are due.
    pub due: Due,
    /// What its headers say, and whose time that is.
    pub clock: StreamClock,
}

/// How regularly one stream comes.
#[derive(Clone, Debug)]
pub struct RhythmFacts {
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

impl Of<RhythmFacts> {
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

/// The frames of a log.
#[derive(Clone, Debug, Default)]
pub struct FrameFacts {
    /// The topics of transforms, static ones too.
    pub topics: Vec<String>,
    /// What keeps them from being a tree.
    pub flaws: Vec<Flaw>,
}

/// A topic that says nothing.
#[derive(Clone, Debug)]
pub struct EmptyFacts {
    /// The topic.
    pub subject: Subject,
    /// Its messages, none of which holds finite numbers.
    pub messages: u64,
}

/// What of a stream jumps away and comes back.
#[derive(Clone, Debug)]
pub struct StrayFacts {
    /// Its samples; where it holds several poses, those of the one that has most.
    pub samples: usize,
    /// The joints of it, or its transforms, that have such samples.
    pub parts: Vec<Strays>,
    /// The joints that slide.
    pub sliding: Vec<String>,
}

/// What a stream repeats with new stamps while the arm moves.
#[derive(Clone, Debug)]
pub struct HeldFacts {
    /// Of each of its transforms, or of all of it, where anything is repeated.
    pub parts: Vec<Held>,
    /// Whether its name says that it repeats on purpose.
    pub is_latched: bool,
    /// Whether it is computed from joint states that repeat, and has their stamps.
    pub is_of_joints: bool,
}

/// The samples of a stream that hold no usable numbers.
#[derive(Clone, Copy, Debug, Default)]
pub struct UnusableFacts {
    /// Those that are NaN, infinite or larger than anything is.
    pub unusable: u64,
    /// Those without an orientation, where others have one.
    pub unset: u64,
    /// Those with more or fewer numbers than they should have.
    pub misfits: u64,
    /// Those that name a joint twice, with other positions.
    pub contradictory: u64,
    /// All of them.
    pub samples: u64,
}

/// A topic that could not be decoded.
#[derive(Clone, Debug)]
pub struct UndecodableTopic {
    /// Its name.
    pub topic: String,
    /// What could not: its type, as the log spells it, or a robot description.
    pub what: Undecodable,
    /// How many of its messages could not be decoded.
    pub messages: u64,
    /// Why the first of them could not.
    pub why: String,
}

/// What of a topic could not be decoded.
#[derive(Clone, Debug)]
pub enum Undecodable {
    /// Messages of this type.
    Messages(String),
    /// The robot description in them.
    Description,
}
