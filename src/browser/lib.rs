//! poseaudit in a browser: takes a log as bytes and returns the report as a page.
//!
//! [`answer`] takes a [`Question`] with its files and returns the content of the page. `exports` has the C
//! functions that the page's worker calls; they need no binding generator.
#![warn(missing_docs, clippy::unwrap_used)]

mod audit;
mod desk;
#[cfg(target_arch = "wasm32")]
mod exports;

use bytes::Bytes;
use poseaudit::log::Progress;
use poseaudit::report::Trouble;
use serde::{Deserialize, Serialize};

/// A request of the page.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Question {
    /// An audit of one run.
    Audit(audit::Asked),
    /// One pose in every convention, or a comparison of two.
    Desk(desk::Asked),
}

/// The answer to the page.
#[derive(Debug, Default, Serialize)]
pub struct Answer {
    /// Exit status of the same call on the command line.
    pub status: u8,
    /// One line on what is wrong with the call or the log.
    pub error: Option<String>,
    /// The answer as JSON, as on the command line.
    pub json: String,
    /// The answer for people: a page for an audit, text for a pose.
    pub shown: String,
}

/// Answers the question `question` (JSON). `files` are its files, in its order. Reports each step to
/// `progress`.
pub fn answer(question: &str, files: Vec<Bytes>, progress: Progress) -> Answer {
    let answered = match serde_json::from_str(question) {
        Ok(Question::Audit(asked)) => audit::answer(&asked, files, progress),
        Ok(Question::Desk(asked)) => desk::answer(&asked),
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

/// A trouble with the request.
fn misuse(place: &str, what: impl ToString, remedy: &str) -> Trouble {
    let (what, place, remedy) = (what.to_string(), place.to_owned(), remedy.to_owned());
    Trouble { kind: poseaudit::report::TroubleKind::Call, what, place, remedy }
}
