use std::borrow::Cow;
use std::fmt::{Display, Write as _};

const STAND_IN: char = '\u{fffd}';

/// Replaces control characters: a name from a log cannot set colours, move the cursor or start a line.
/// Escapes characters that change the writing direction.
pub fn tame(text: &str) -> Cow<'_, str> {
    match text.contains(char::is_control) {
        true => {
            let text = text.replace(char::is_control, STAND_IN.encode_utf8(&mut [0; 4]));
            Cow::Owned(upright(&text).into_owned())
        }
        false => upright(text),
    }
}

/// [`tame`] for any text from a file.
pub fn foreign(text: impl Display) -> String {
    tame(&text.to_string()).into_owned()
}

/// Escapes characters that change the writing direction. Strings in double quotes keep their value in JSON,
/// YAML and TOML.
pub fn upright(text: &str) -> Cow<'_, str> {
    if !text.contains(turns) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(escaped(text, turns))
}

/// One line of JSON, YAML or TOML.
pub(crate) fn quoted(text: &str) -> String {
    let text = serde_json::Value::from(text).to_string();
    escaped(&text, |c| turns(c) || c.is_control())
}

/// One shell word.
pub fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+:@%=,".contains(c);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut all, c| {
        match is_escaped(c) {
            // Writing to a string cannot fail.
            true => drop(write!(all, "\\u{:04x}", u32::from(c))),
            false => all.push(c),
        }
        all
    })
}

/// Changes the writing direction, ends a line invisibly, or is a C1 terminal control that no format
/// escapes.
fn turns(c: char) -> bool {
    matches!(
        c,
        '\u{61c}'
            | '\u{80}'..='\u{9f}'
            | '\u{200e}'
            | '\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2066}'..='\u{2069}'
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_control_character_is_left_and_all_else_is() {
        assert_eq!(tame("/a\u{1b}[31m\nb\u{9b}é"), "/a\u{fffd}[31m\u{fffd}b\u{fffd}é");
        assert!(matches!(tame("0.5° ± 1"), Cow::Borrowed(_)));
    }

    #[test]
    fn what_turns_the_direction_of_writing_is_shown_as_an_escape() {
        let text = "/a\u{202e}b\u{2066}c\u{200f}\u{2028}";
        assert_eq!(tame(text), r"/a\u202eb\u2066c\u200f\u2028");
        assert_eq!(upright("\u{9b}31m"), r"\u009b31m");
        assert!(matches!(upright("/é"), Cow::Borrowed(_)));
        for text in [text, "'it\u{7f}'s\\\"\n\u{9b}"] {
            let quoted = quoted(text);
            assert!(quoted.bytes().all(|byte| byte.is_ascii_graphic()), "{quoted}");
            let read: toml::Table = format!("a = {quoted}").parse().expect("TOML");
            assert_eq!(read["a"].as_str(), Some(text));
            assert_eq!(serde_json::from_str::<String>(&quoted).expect("JSON"), text);
            assert_eq!(serde_saphyr::from_str::<String>(&quoted).expect("YAML"), text);
        }
    }
}
