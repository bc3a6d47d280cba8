//! Why a transform cannot be told.

/// Why a transform cannot be told.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TfError {
    /// No edge of the tree has this frame.
    #[error("frame '{frame}' is not in the tree{}", did_you_mean(.nearest))]
    UnknownFrame {
        /// The frame asked for.
        frame: String,
        /// Frames whose names come near.
        nearest: Vec<String>,
    },
    /// The frames are in different trees.
    #[error(
        "'{target}' and '{source_frame}' are not connected: their trees have the roots '{target_root}' and '{source_root}'"
    )]
    NotConnected {
        /// The frame asked for.
        target: String,
        /// The other frame asked for.
        source_frame: String,
        /// The root above the one.
        target_root: String,
        /// The root above the other.
        source_root: String,
    },
    /// A transform on the way has no samples on both sides of the time.
    #[error("'{parent}' to '{child}' has no transform at that time: it is {} s {} of its samples", outside_by_s.abs(), side(*.outside_by_s))]
    Extrapolation {
        /// The parent frame of the transform.
        parent: String,
        /// The child frame of the transform.
        child: String,
        /// How far outside the samples the time lies, s: negative before the first.
        outside_by_s: f64,
    },
}

fn side(outside_by_s: f64) -> &'static str {
    if outside_by_s < 0.0 { "before the first" } else { "after the last" }
}

fn did_you_mean(nearest: &[String]) -> String {
    match nearest {
        [] => String::new(),
        names => format!("; did you mean '{}'?", names.join("' or '")),
    }
}
