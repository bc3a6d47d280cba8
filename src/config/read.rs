//! Parses the file. Errors name the line and suggest a correction.

use std::fs::File as Opened;
use std::io::Read;
use std::path::Path;

use super::file::ConfigFile;
use crate::report::Trouble;
use crate::robot::nearest;

/// In bytes; the parser needs up to 2000 times as much memory.
const MAX_BYTES: usize = 256 << 10;
/// Characters of the config repeated in a message.
const MAX_SHOWN_CHARS: usize = 200;

pub(super) fn read_text(path: &Path) -> Result<String, Trouble> {
    let mut text = String::new();
    let read = Opened::open(path).and_then(|file| {
        // One byte more shows that the file is too large.
        file.take(MAX_BYTES as u64 + 1).read_to_string(&mut text)
    });
    read.map(|_| text).map_err(|error| {
        let remedy = "name a readable file; `poseaudit init LOG` writes one";
        Trouble::call(path.display(), format_args!("cannot be read: {error}"), remedy)
    })
}

pub(super) fn parse(text: &str, path: &Path) -> Result<ConfigFile, Trouble> {
    if text.len() > MAX_BYTES {
        let what = format!("larger than the maximum of {MAX_BYTES} bytes");
        return Err(Trouble::call(path.display(), what, "name the config of one audit"));
    }
    toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let (what, remedy) = reword(error.message());
        Trouble::call(line_place(path, text, at), what, remedy)
    })
}

/// `FILE:LINE` of byte `at`.
pub(super) fn line_place(path: &Path, text: &str, at: usize) -> String {
    let before = &text.as_bytes()[..at.min(text.len())];
    let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
    format!("{}:{line}", path.display())
}

/// Rewords the parser's message, with the nearest known key or value.
fn reword(message: &str) -> (String, &'static str) {
    const KEYS: &str = "docs/config.md lists the keys";
    const VALUES: &str = "docs/config.md lists the values";
    let message = message.lines().map(str::trim).collect::<Vec<_>>().join(", ");
    for (start, kind, remedy) in
        [("unknown field ", "key", KEYS), ("unknown variant ", "value", VALUES)]
    {
        let Some(rest) = message.strip_prefix(start) else { continue };
        // `is`, expected one of `a`, `b`: every second piece is between backquotes.
        let mut quoted = rest.split('`').skip(1).step_by(2);
        let is = &excerpt(quoted.next().unwrap_or_default());
        let known: Vec<&str> = quoted.collect();
        let instead = match nearest(is, known.iter().copied()).first() {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("known are {}", known.join(", ")),
        };
        return (format!("unknown {kind} `{is}`: {instead}"), remedy);
    }
    match message.strip_prefix("missing field ") {
        Some(key) => (format!("the key {} is missing", excerpt(key)), KEYS),
        None => (excerpt(&message), VALUES),
    }
}

/// The first characters of a text from the file.
fn excerpt(text: &str) -> String {
    match text.char_indices().nth(MAX_SHOWN_CHARS) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text.to_owned(),
    }
}
