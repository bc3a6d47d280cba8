//! What the rules judge of one robot.

use super::Of;
use crate::diagnosis::{
    Abruptness, DhEstimate, Excess, ImuDiagnosis, ImuProof, JointDiagnosis, JointScale, NoShake,
    PoseDiagnosis, Proof, ReferenceDiagnosis, Seen, Shake,
};
use crate::finding::{Span, Subject, Unit};
use crate::geometry::{AngleUnit, Convention, LengthScale, Rotation};
use crate::robot::{DhConvention, Limits};
use crate::run::{Witness, WrongModel};
use crate::time::Stamp;

/// One robot and its streams.
#[derive(Clone, Debug)]
pub struct ArmFacts {
    /// Name of the robot.
    pub name: String,
    /// Topic of its joint states.
    pub joints_topic: String,
    /// First and last stamp of its joint states.
    pub span: Span,
    /// The joints of its chain, as `diagnosis` numbers them.
    pub joints: Vec<JointFacts>,
    /// Distance of the tip from the base at full stretch, m.
    pub reach_m: f64,
    /// The model that was named, where the log is of another arm, with which all else is judged.
    pub wrong_model: Option<WrongModel>,
    /// What its DH table says of itself and what the streams say of that, where it is one.
    pub dh: Option<DhFacts>,
    /// What was estimated on its joints.
    pub diagnosis: JointDiagnosis,
    /// The pose streams, in the order that the twins of a joint offset count them.
    pub poses: Vec<Of<PoseFacts>>,
    /// What /tf says of the tip, against FK of the joint states as recorded.
    pub tf: Option<Of<PoseFacts>>,
    /// What shakes the tip, by the joint states and by each pose stream.
    pub shakes: Vec<Of<ShakeFacts>>,
    /// The IMUs on the arm.
    pub imus: Vec<Of<ImuFacts>>,
    /// What the arm was told.
    pub references: Vec<Of<ReferenceFacts>>,
}

impl ArmFacts {
    pub(super) fn subjects(&self) -> usize {
        let poses = self.poses_and_tf().count();
        let streams = poses + self.imus.len() + self.references.len();
        self.joints.len() + streams
    }

    /// The pose streams and then /tf.
    pub fn poses_and_tf(&self) -> impl Iterator<Item = &Of<PoseFacts>> {
        self.poses.iter().chain(&self.tf)
    }

    /// Whose word the arm's pose streams are together: an outside witness stands out, and only where
    /// all are the controller's is nothing else there.
    pub fn witness(&self) -> Witness {
        let of = |witness: Witness| self.poses.iter().filter(move |s| s.witness == witness).count();
        match (of(Witness::External), of(Witness::Controller)) {
            (1.., _) => Witness::External,
            (0, controllers) if controllers == self.poses.len() => Witness::Controller,
            _ => Witness::Unknown,
        }
    }

    /// Largest speed of the tip by FK, m/s; 0 where no stream says.
    pub fn top_speed_m_s(&self) -> f64 {
        self.poses_and_tf().map(|stream| stream.diagnosis.top_speed_m_s).fold(0.0, f64::max)
    }

    /// The robot as a subject.
    pub fn subject(&self) -> Subject {
        Subject { robot: Some(self.name.clone()), ..Subject::default() }
    }

    /// A topic of this robot as a subject.
    pub fn topic(&self, topic: &str) -> Subject {
        Subject { topic: Some(topic.to_owned()), ..self.subject() }
    }

    /// A frame that a topic of this robot speaks of, as a subject.
    pub fn frame(&self, topic: &str, frame: &str) -> Subject {
        Subject { frame: Some(frame.to_owned()), ..self.topic(topic) }
    }

    /// A joint of this robot as a subject.
    pub fn joint(&self, index: usize) -> Subject {
        let joint = self.joints.get(index).map(|joint| joint.name.clone());
        Subject { joint, ..self.subject() }
    }

    /// What the joint states say of a joint, as a subject.
    pub fn joint_states(&self, index: usize) -> Subject {
        Subject { topic: Some(self.joints_topic.clone()), ..self.joint(index) }
    }

    /// The scale of a joint that has a wrong one.
    pub fn scale(&self, index: usize) -> Option<&JointScale> {
        self.diagnosis.scales.iter().find(|scale| scale.column == index)
    }

    /// The unit of a joint's positions.
    pub fn joint_unit(&self, index: usize) -> Unit {
        match self.joints.get(index) {
            Some(joint) if joint.prismatic => Unit::Metre,
            _ => Unit::Radian,
        }
    }
}

/// The DH table of a robot.
#[derive(Clone, Debug)]
pub struct DhFacts {
    /// The convention that it says it is in.
    pub declared: DhConvention,
    /// What either convention leaves of the streams.
    pub estimate: DhEstimate,
}

/// One joint of a chain.
#[derive(Clone, Debug)]
pub struct JointFacts {
    /// Its name, as the log spells it.
    pub name: String,
    /// Whether it slides.
    pub prismatic: bool,
    /// The limits that the model states.
    pub limits: Limits,
    /// What it does, by all of its samples.
    pub motion: JointMotion,
}

/// What a joint does over the run.
#[derive(Clone, Debug, Default)]
pub struct JointMotion {
    /// How far it is beyond its positions' limits.
    pub positions: Option<Excess>,
    /// How far it is beyond its speed limit.
    pub speeds: Option<Excess>,
    /// How abruptly it changes its speed; `None` where its samples do not tell.
    pub abruptness: Option<Abruptness>,
    /// Whether it turns without end, by the model or as the log shows.
    pub is_endless: bool,
}

/// One stream of poses.
#[derive(Clone, Debug)]
pub struct PoseFacts {
    /// The frame that its poses are expressed in.
    pub reference: String,
    /// Whether that frame is tied to the robot; if not its pose is estimated and not judged.
    pub reference_known: bool,
    /// The frame whose poses they are.
    pub tip: String,
    /// Whether somebody named the tip (`--tip`, the stream's child frame), so that an offset from it
    /// is a fault and not the active TCP.
    pub tip_named: bool,
    /// Whose word the poses are.
    pub witness: Witness,
    /// Its error straight from FK.
    pub proof: Seen<Proof>,
    /// Whether its stamps are its own, not copies of the joints'.
    pub independent: bool,
    /// Whether its rotations are bare numbers, which may be degrees.
    pub bare_numbers: bool,
    /// Whether it holds bare numbers of which nothing is declared, so that they violate no convention.
    pub bare: bool,
    /// The units that the caller declared its numbers to be in.
    pub declared: Option<Declared>,
    /// How its rotations are coded, where they are three bare numbers.
    pub euler: Option<EulerFacts>,
    /// What was estimated on it.
    pub diagnosis: PoseDiagnosis,
}

/// Rotations that are coded as three numbers.
#[derive(Clone, Debug)]
pub struct EulerFacts {
    /// What the numbers are, as declared or as the arm tells; `None` where it does not.
    pub convention: Option<Convention>,
    /// For every row with a stamp, how far it is from gimbal lock, rad; empty where the convention
    /// has none.
    pub margins_rad: Vec<(Stamp, f64)>,
}

/// The units of a stream's numbers as the caller declared them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Declared {
    /// The unit of the angles, where the numbers hold any.
    pub angles: Option<AngleUnit>,
    /// The unit of the positions.
    pub lengths: LengthScale,
}

/// What one stream says of the tip's shake.
#[derive(Clone, Debug)]
pub struct ShakeFacts {
    /// Whether its positions are not the metres that they are taken for.
    pub in_other_units: bool,
    /// The shake, or why it does not tell.
    pub shake: Result<Shake, NoShake>,
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ImuFacts {
    /// Whether its stamps are its own, not copies of the joints'.
    pub independent: bool,
    /// The link that carries it.
    pub link: String,
    /// How it is turned in that link by the log's frames, where they say.
    pub link_from_imu: Option<Rotation>,
    /// What it leaves straight against FK; `None` where it does not turn with the arm.
    pub proof: Option<ImuProof>,
    /// What was estimated on it.
    pub diagnosis: ImuDiagnosis,
}

/// One stream of commands.
#[derive(Clone, Debug)]
pub struct ReferenceFacts {
    /// Whether joints are commanded, and not poses.
    pub is_of_joints: bool,
    /// Whether the link that is commanded was named; if not it may be an active TCP.
    pub tip_named: bool,
    /// Whether a frame was named that commanded poses are in.
    pub frame_named: bool,
    /// Who says where the tip was, one for each entry of the gaps and of a line's witnesses.
    pub witnesses: Vec<ReferenceWitness>,
    /// What was estimated; why the commands cannot be held against the arm, where they cannot.
    pub diagnosis: Result<Seen<ReferenceDiagnosis>, String>,
}

/// Who says where the tip was.
#[derive(Clone, Debug)]
pub struct ReferenceWitness {
    /// Its name in words: the topic of a stream.
    pub name: String,
    /// What its poses are.
    pub kind: WitnessKind,
}

/// What the poses of a witness are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WitnessKind {
    /// Forward kinematics of the joint states as recorded.
    Kinematics,
    /// Those of a stream with everything taken off that was found on it.
    Corrected,
    /// Those of a stream as it was logged.
    AsLogged,
}
