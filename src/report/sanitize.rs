use std::borrow::Cow;
use std::fmt::{Display, Write as _};

const REPLACEMENT: char = '\u{fffd}';

/// Replaces control characters: a name from a log cannot set colours, move the cursor or start a line.
/// Escapes characters that change the writing direction.
pub fn sanitize(text: &str) -> Cow<'_, str> {
    match text.contains(char::is_control) {
        true => {
            let text = text.replace(char::is_control, REPLACEMENT.encode_utf8(&mut [0; 4]));
            Cow::Owned(escape_direction(&text).into_owned())
        }
        false => escape_direction(text),
    }
}

/// [`sanitize`] for any text from a file.
pub fn sanitize_display(text: impl Display) -> String {
    sanitize(&text.to_string()).into_owned()
}

/// Escapes characters that change the writing direction. Strings in double quotes keep their value in JSON,
/// YAML and TOML.
pub fn escape_direction(text: &str) -> Cow<'_, str> {
    if !text.contains(is_direction_control) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(escape_if(text, is_direction_control))
}

/// One line of JSON, YAML or TOML.
pub(crate) fn quote_line(text: &str) -> String {
    let text = serde_json::Value::from(text).to_string();
    escape_if(&text, |c| is_direction_control(c) || c.is_control())
}

/// One shell word.
pub fn quote_for_shell(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+:@%=,".contains(c);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

fn escape_if(text: &str, is_escaped: impl Fn(char) -> bool) -> String {
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
fn is_direction_control(c: char) -> bool {
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
    fn control_characters_are_replaced_and_nothing_else() {
        assert_eq!(sanitize("/a\u{1b}[31m\nb\u{9b}é"), "/a\u{fffd}[31m\u{fffd}b\u{fffd}é");
        assert!(matches!(sanitize("0.5° ± 1"), Cow::Borrowed(_)));
    }

    #[test]
    fn direction_controls_are_escaped() {
        let text = "/a\u{202e}b\u{2066}c\u{200f}\u{2028}";
        assert_eq!(sanitize(text), r"/a\u202eb\u2066c\u200f\u2028");
        assert_eq!(escape_direction("\u{9b}31m"), r"\u009b31m");
        assert!(matches!(escape_direction("/é"), Cow::Borrowed(_)));
        for text in [text, "'it\u{7f}'s\\\"\n\u{9b}"] {
            let quoted = quote_line(text);
            assert!(quoted.bytes().all(|byte| byte.is_ascii_graphic()), "{quoted}");
            let read: toml::Table = format!("a = {quoted}").parse().expect("TOML");
            assert_eq!(read["a"].as_str(), Some(text));
            assert_eq!(serde_json::from_str::<String>(&quoted).expect("JSON"), text);
            assert_eq!(serde_saphyr::from_str::<String>(&quoted).expect("YAML"), text);
        }
    }
}
