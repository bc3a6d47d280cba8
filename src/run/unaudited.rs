//! Streams that cannot be what they say, and arms of which nothing could be audited.

/// A stream that is not audited, or not as what it says it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Unaudited {
    /// Index of the stream.
    pub stream: usize,
    /// Why.
    pub why: WhyNot,
}

/// Why a stream is not audited, or not as what it says it is.
#[derive(Clone, Debug, PartialEq)]
pub enum WhyNot {
    /// Its frame is the tool's own, in which the tool does not move. It is audited as one in an unknown
    /// frame.
    OwnFrame {
        /// The frame.
        frame: String,
    },
    /// Its orientations were never set. Its positions are audited.
    NoOrientation,
    /// Its topic has poses of the same in other frames, which nothing ties to the arm.
    OtherFrames {
        /// The frames, in the order of the log.
        frames: Vec<String>,
        /// Poses in them.
        samples: u64,
        /// Poses of the topic.
        of: u64,
    },
    /// All its poses are one while the joints move the tool.
    NeverChanges {
        /// Samples.
        samples: usize,
        /// How far the joints move the tool meanwhile, m.
        moved_m: f64,
    },
    /// Bodies of its topic that stand still while the joints move the tool, and of which nothing says that they
    /// are the tool's: objects of a scene.
    SceneObjects {
        /// Their names.
        names: Vec<String>,
    },
    /// The arm's base moves in its frame, and nothing in the log says how.
    BaseMoves {
        /// The frame.
        frame: String,
        /// The arm's base.
        base: String,
        /// How far the base goes, m.
        travel_m: f64,
        /// How far it turns, rad.
        turn_rad: f64,
    },
    /// It is a tool's, and the log does not tell which arm's.
    WhoseArm {
        /// Names of the arms.
        arms: Vec<String>,
    },
    /// Its name or its frames say that it is a tool's, and no kinematics can be held against it.
    NoKinematics {
        /// What is missing.
        what: String,
    },
    /// Joint states of an arm that no model has.
    NoModel {
        /// The joints.
        joints: Vec<String>,
    },
}
