use std::borrow::Cow;

/// The replacement character.
const STAND_IN: char = '\u{fffd}';

/// `text` without control characters, for a terminal or a line of a log: a name in a log cannot set
/// colours, move the cursor or begin a line.
pub fn tame(text: &str) -> Cow<'_, str> {
    match text.contains(char::is_control) {
        true => Cow::Owned(text.replace(char::is_control, STAND_IN.encode_utf8(&mut [0; 4]))),
        false => Cow::Borrowed(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_control_character_is_left_and_all_else_is() {
        assert_eq!(tame("/a\u{1b}[31m\nb\u{9b}é"), "/a\u{fffd}[31m\u{fffd}b\u{fffd}é");
        assert!(matches!(tame("0.5° ± 1"), Cow::Borrowed(_)));
    }
}
