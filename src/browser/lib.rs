//! poseaudit in a browser: a log in as bytes, the report out as a page.
//!
//! [`answer`] takes a [`Question`] and the files that it names, and says all that the page shows. What the
//! page's worker calls is in `exports`: a few functions with pointers, so that nothing but cargo makes them.
#![warn(missing_docs, clippy::unwrap_used)]

mod audit;
mod desk;
#[cfg(target_arch = "wasm32")]
mod exports;

use bytes::Bytes;
use poseaudit::log::Progress;
use poseaudit::report::Trouble;
use serde::{Deserialize, Serialize};

/// What the page asks.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Question {
    /// An audit of one run.
    Audit(audit::Asked),
    /// One pose in every convention, or what makes two agree.
    Desk(desk::Asked),
}

/// What the page shows.
#[derive(Debug, Default, Serialize)]
pub struct Answer {
    /// The exit status of the same call of the program.
    pub status: u8,
    /// In one line: what is wrong with the call or the log.
    pub error: Option<String>,
    /// For programs, as the program writes it.
    pub json: String,
    /// For people, as the program writes it: of an audit a page, of a pose text.
    pub shown: String,
}

/// Answers the question that `question` is as JSON; `files` are those that it names, in its order. Each step is
/// told to `progress`.
pub fn answer(question: &str, files: Vec<Bytes>, progress: Progress) -> Answer {
    let answered = match serde_json::from_str(question) {
        Ok(Question::Audit(asked)) => audit::answer(&asked, files, progress),
        Ok(Question::Desk(asked)) => desk::answer(&asked),
        Err(error) => {
            let error = Some(format!("the page asks what is not understood: {error}"));
            return Answer { status: 2, error, ..Answer::default() };
        }
    };
    answered.unwrap_or_else(|trouble| refused(&trouble))
}

fn refused(trouble: &Trouble) -> Answer {
    Answer { status: 2, error: Some(trouble.to_string()), ..Answer::default() }
}

/// A trouble with what was asked.
fn misuse(place: &str, what: impl ToString, remedy: &str) -> Trouble {
    let (what, place, remedy) = (what.to_string(), place.to_owned(), remedy.to_owned());
    Trouble { kind: poseaudit::report::TroubleKind::Call, what, place, remedy }
}
