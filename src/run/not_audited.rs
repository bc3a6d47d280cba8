//! Streams that are not audited as stated.

/// A stream that is not audited as stated.
#[derive(Clone, Debug, PartialEq)]
pub struct NotAudited {
    /// Index of the stream.
    pub stream: usize,
    /// The reason.
    pub reason: NotAuditedReason,
}

/// Why a stream is not audited as stated.
#[derive(Clone, Debug, PartialEq)]
pub enum NotAuditedReason {
    /// Its frame is the tool's own; audited with an unknown frame.
    OwnFrame {
        /// The frame.
        frame: String,
    },
    /// Orientations were never set; positions are audited.
    NoOrientation,
    /// Joint states in which every position is 0.
    NeverSet {
        /// Number of samples.
        samples: usize,
        /// A joint whose limits exclude 0.
        impossible: Option<String>,
    },
    /// Poses of the same body in frames not tied to the arm.
    OtherFrames {
        /// The frames, in the order of the log.
        frames: Vec<String>,
        /// Poses in them.
        samples: u64,
        /// Poses of the topic.
        of: u64,
    },
    /// Constant poses while joints move the tool.
    NeverChanges {
        /// Number of samples.
        samples: usize,
        /// Tool motion by the joints, m.
        moved_m: f64,
    },
    /// Bodies that rest while the joints move the tool, and are not named as the tool: objects of a scene.
    SceneObjects {
        /// Their child frames.
        bodies: Vec<String>,
        /// Tool motion by the joints meanwhile, m.
        moved_m: f64,
    },
    /// Named as the tool, in a frame of the robot, or compared with the reference stream, but its motion is another, or too
    /// short to tell.
    DoesNotFollow {
        /// Highest correlation of its speed with the tool's. `None` if undetermined.
        correlation: Option<f64>,
        /// Named as the tool, or stated to be of the reference's body.
        is_named: bool,
        /// Topic of the reference stream in a log without joint states.
        reference: Option<String>,
    },
    /// The base moves in its frame, without logged transforms.
    BaseMoves {
        /// The frame.
        frame: String,
        /// The arm's base.
        base: String,
        /// Travel of the base, m.
        travel_m: f64,
        /// Rotation of the base, rad.
        turn_rad: f64,
    },
    /// Poses that names or frames assign to one arm, but that follow another; audited against that one.
    OtherArm {
        /// The arm by names and frames.
        named: String,
        /// The arm that they follow.
        arm: String,
    },
    /// A tool pose of an undetermined arm.
    WhoseArm {
        /// Names of the arms.
        arms: Vec<String>,
    },
    /// A tool pose by name or frame that no kinematics predicts.
    NoKinematics {
        /// The missing part.
        what: String,
    },
    /// Joint states of an arm without a model.
    NoModel {
        /// The joints.
        joints: Vec<String>,
    },
}
