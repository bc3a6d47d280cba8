//! Errors of transform lookups.

/// Why a transform lookup failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TfError {
    /// No edge of the tree has this frame.
    #[error("frame '{frame}' is not in the tree{}", did_you_mean(.nearest))]
    UnknownFrame {
        /// The requested frame.
        frame: String,
        /// Frames with similar names.
        nearest: Vec<String>,
    },
    /// The frames are in different trees.
    #[error(
        "'{target}' and '{source_frame}' are not connected: their trees have the roots '{target_root}' and \
         '{source_root}'"
    )]
    NotConnected {
        /// The requested target frame.
        target: String,
        /// The requested source frame.
        source_frame: String,
        /// Root above the target.
        target_root: String,
        /// Root above the source.
        source_root: String,
    },
    /// A transform on the path has no samples around the time.
    #[error("'{parent}' to '{child}' has no transform at that time, {} s {} of its samples", outside_by_s.abs(), side(*.outside_by_s))]
    Extrapolation {
        /// Parent frame of the transform.
        parent: String,
        /// Child frame of the transform.
        child: String,
        /// Distance from the samples, s: negative before the first.
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
