//! Encodings of text tables other than UTF-8: UTF-16 (Excel's "Unicode text") and single bytes (Excel's CSV outside
//! English-speaking countries). Lines may end with carriage returns alone (Excel's "CSV (Macintosh)").

use std::borrow::Cow;

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};

/// Bytes examined to distinguish text from binary data.
const CHECKED_BYTES: usize = 4096;

/// Whether it may be text, in UTF-8 or another encoding.
pub(crate) fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(CHECKED_BYTES)];
    let is_control = |c: char| c.is_ascii_control() && !c.is_ascii_whitespace();
    match utf16(head) {
        Some(text) => !text.chars().any(|c| is_control(c) || c == char::REPLACEMENT_CHARACTER),
        None => !head.iter().any(|byte| is_control(char::from(*byte))),
    }
}

/// Bytes in no known encoding are taken for Windows-1252: names stay distinct, and numbers are ASCII.
pub(crate) fn to_utf8(bytes: &[u8]) -> Cow<'_, [u8]> {
    let text = decoded(bytes);
    match !text.contains(&b'\n') && text.contains(&b'\r') {
        true => text.iter().map(|byte| if *byte == b'\r' { b'\n' } else { *byte }).collect(),
        false => text,
    }
}

fn decoded(bytes: &[u8]) -> Cow<'_, [u8]> {
    let owned = |text: Cow<'_, str>| Cow::Owned(text.into_owned().into_bytes());
    if let Some(text) = utf16(bytes) {
        return owned(text);
    }
    match std::str::from_utf8(bytes) {
        // The head of a file may end within a character.
        Err(error) if error.error_len().is_some() => {
            owned(WINDOWS_1252.decode_without_bom_handling(bytes).0)
        }
        _ => Cow::Borrowed(bytes),
    }
}

/// `None` without the byte-order mark of UTF-16, unless every second byte is 0.
fn utf16(bytes: &[u8]) -> Option<Cow<'_, str>> {
    let marked = Encoding::for_bom(bytes).filter(|(_, mark)| *mark == 2);
    let (encoding, mark) = marked.or_else(|| Some((unmarked_utf16(bytes)?, 0)))?;
    // The head of a file may end within a character.
    let whole = &bytes[mark..bytes.len() - bytes.len() % 2];
    Some(encoding.decode_without_bom_handling(whole).0)
}

/// Encoding of Latin letters in UTF-16 without a byte-order mark.
fn unmarked_utf16(bytes: &[u8]) -> Option<&'static Encoding> {
    const MIN_LETTERS: usize = 16;
    let head = &bytes[..bytes.len().min(CHECKED_BYTES)];
    let is = |zero: usize| {
        let mut pairs = head.chunks_exact(2);
        pairs.len() >= MIN_LETTERS && pairs.all(|pair| pair[zero] == 0 && pair[1 - zero] != 0)
    };
    [(1, UTF_16LE), (0, UTF_16BE)].into_iter().find(|(zero, _)| is(*zero)).map(|(_, own)| own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_excel_is_decoded() {
        let text = "Zeit;Achse 1 [°]\n0,5;1\n";
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        let single: Vec<u8> = text.chars().map(|c| u32::from(c) as u8).collect();
        for bytes in [
            [b"\xff\xfe", &little[..]].concat(),
            [b"\xfe\xff", &big[..]].concat(),
            little,
            big,
            single,
        ] {
            assert_eq!(to_utf8(&bytes), text.as_bytes());
            assert!(is_text(&bytes) && is_text(&bytes[..bytes.len() - 1]), "{bytes:?}");
        }
        assert_eq!(to_utf8("Gr\u{fc}".as_bytes()), "Gr\u{fc}".as_bytes());
        assert_eq!(to_utf8(b"t,q\r0,1\r").as_ref(), b"t,q\n0,1\n");
        assert_eq!(to_utf8(b"t,q\r\n0,1\r\n").as_ref(), b"t,q\r\n0,1\r\n");
        assert!(!is_text(b"\xff\xfe\x00\x00\x01\x00") && !is_text(b"\x01\x02"));
    }
}
