//! Streams that are not audited, or not with their stated meaning.

/// A stream that is not audited, or not with its stated meaning.
#[derive(Clone, Debug, PartialEq)]
pub struct NotAudited {
    /// Index of the stream.
    pub stream: usize,
    /// The reason.
    pub why: NotAuditedReason,
}

/// Why a stream is not audited, or not with its stated meaning.
#[derive(Clone, Debug, PartialEq)]
pub enum NotAuditedReason {
    /// Its frame is the tool's own, where the tool does not move. It is audited with an unknown frame.
    OwnFrame {
        /// The frame.
        frame: String,
    },
    /// Its orientations were never set. Its positions are audited.
    NoOrientation,
    /// Its topic has poses of the same body in other frames that are not tied to the arm.
    OtherFrames {
        /// The frames, in the order of the log.
        frames: Vec<String>,
        /// Number of poses in them.
        samples: u64,
        /// Number of poses of the topic.
        of: u64,
    },
    /// All its poses are equal while the joints move the tool.
    NeverChanges {
        /// Number of samples.
        samples: usize,
        /// Motion of the tool by the joints, m.
        moved_m: f64,
    },
    /// Bodies of its topic that are stationary while the joints move the tool, and are not named as the
    /// tool: objects of a scene.
    SceneObjects {
        /// Their names.
        names: Vec<String>,
    },
    /// The arm's base moves in its frame, and the log has no transforms for it.
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
    /// It is a tool pose, but its arm is undetermined.
    WhoseArm {
        /// Names of the arms.
        arms: Vec<String>,
    },
    /// Its name or frames mark it as a tool pose, but no kinematics can predict it.
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
