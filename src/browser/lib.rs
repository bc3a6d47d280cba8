//! poseaudit in a browser: [`answer`] takes a [`Request`] with its files and returns the page's content.
//! `exports` has the C functions for the page's worker, without a binding generator.
#![warn(missing_docs, clippy::unwrap_used)]

mod audit;
mod desk;
#[cfg(target_arch = "wasm32")]
mod exports;

use bytes::Bytes;
use poseaudit::log::Progress;
use poseaudit::report::Trouble;
use serde::{Deserialize, Serialize};

/// Request of the page.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Request {
    /// Audit of one run.
    Audit(audit::AuditRequest),
    /// One pose in every convention, or a comparison of two.
    Desk(desk::PoseRequest),
}

/// Answer to the page.
#[derive(Debug, Default, Serialize)]
pub struct Answer {
    /// Exit status on the command line.
    pub status: u8,
    /// One line on an invalid call or log.
    pub error: Option<String>,
    /// JSON, as on the command line.
    pub json: String,
    /// A page for an audit, text for a pose.
    pub shown: String,
}

/// Answers the JSON `question`, with `files` in its order. Reports steps to `progress`.
pub fn answer(question: &str, files: Vec<Bytes>, progress: Progress) -> Answer {
    let answered = match serde_json::from_str(question) {
        Ok(Request::Audit(request)) => audit::answer(&request, files, progress),
        Ok(Request::Desk(request)) => desk::answer(&request),
        Err(error) => {
            let error = Some(format!("invalid request from the page: {error}"));
            return Answer { status: 2, error, ..Answer::default() };
        }
    };
    answered.unwrap_or_else(|trouble| refused(&trouble))
}

fn refused(trouble: &Trouble) -> Answer {
    Answer { status: 2, error: Some(trouble.to_string()), ..Answer::default() }
}
