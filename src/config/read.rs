//! From the text of the file to its layout, with errors that name the line and what was meant.

use std::fs;
use std::path::Path;

use super::file::File;
use crate::report::{Trouble, TroubleKind};
use crate::robot::nearest;

/// The text of the file at `path`.
pub(super) fn text_of(path: &Path) -> Result<String, Trouble> {
    let place = path.display().to_string();
    fs::read_to_string(path).map_err(|error| {
        let remedy = "name a file that can be read; `poseaudit init LOG` writes one";
        refused(place, format!("cannot be read: {error}"), remedy)
    })
}

/// The layout of a text.
pub(super) fn parsed(text: &str, path: &Path) -> Result<File, Trouble> {
    toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let (what, remedy) = worded(error.message());
        refused(place(path, text, at), what, remedy)
    })
}

/// A trouble with the config.
pub(super) fn refused(place: String, what: String, remedy: &str) -> Trouble {
    Trouble { kind: TroubleKind::Call, what, place, remedy: remedy.to_owned() }
}

/// `FILE:LINE` of byte `at`.
pub(super) fn place(path: &Path, text: &str, at: usize) -> String {
    let before = &text.as_bytes()[..at.min(text.len())];
    let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
    format!("{}:{line}", path.display())
}

/// What a parser's message says, in our words: of what is unknown the nearest that is known.
fn worded(message: &str) -> (String, &'static str) {
    const KEYS: &str = "docs/config.md lists the keys";
    const VALUES: &str = "docs/config.md says what can stand there";
    let message = message.lines().map(str::trim).collect::<Vec<_>>().join(", ");
    for (start, kind, remedy) in
        [("unknown field ", "key", KEYS), ("unknown variant ", "value", VALUES)]
    {
        let Some(rest) = message.strip_prefix(start) else { continue };
        // `is`, expected one of `a`, `b`: every second piece stands between backquotes.
        let mut quoted = rest.split('`').skip(1).step_by(2);
        let is = quoted.next().unwrap_or_default();
        let known: Vec<&str> = quoted.collect();
        let instead = match nearest(is, known.iter().copied()).first() {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("known are {}", known.join(", ")),
        };
        return (format!("unknown {kind} `{is}`: {instead}"), remedy);
    }
    match message.strip_prefix("missing field ") {
        Some(key) => (format!("the key {key} is missing"), KEYS),
        None => (message, VALUES),
    }
}
