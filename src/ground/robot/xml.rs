//! XML of untrusted models. Documents that would exhaust time or memory are rejected before parsing.

use roxmltree::{Document, Error, ParsingOptions};

use super::error::Problem;

/// Maximum size, bytes. The URDF of a humanoid has about 200 kB.
pub(super) const MAX_TEXT_BYTES: usize = 8 << 20;
/// Elements, texts and comments.
const MAX_NODES: u32 = 200_000;
const MAX_DEPTH: usize = 100;
/// Per element; the parser compares all pairs.
const MAX_ATTRIBUTES: usize = 256;
/// Declarations; the parser copies those of an element to its descendants.
const MAX_NAMESPACES: usize = 512;

/// Rejects declared entities: 400 kB of them expand to 40 GB.
///
/// # Errors
/// The byte offset and the problem.
pub fn document(text: &str) -> Result<Document<'_>, (usize, Problem)> {
    bounded(text)?;
    let declares = text.contains("<!ENTITY");
    let options = ParsingOptions {
        allow_dtd: !declares,
        nodes_limit: MAX_NODES,
        ..ParsingOptions::default()
    };
    Document::parse_with_options(text, options)
        .map_err(|error| (byte_of(text, &error), problem_of(&error)))
}

fn problem_of(error: &Error) -> Problem {
    match error {
        Error::UnknownNamespace(prefix, _) if prefix == "xacro" => {
            Problem::Xacro { found: "the prefix xacro:".to_owned() }
        }
        Error::DtdDetected => Problem::DocumentType,
        Error::NodesLimitReached => too_much(MAX_NODES as usize, "elements and texts"),
        other => Problem::Xml(other.to_string()),
    }
}

fn too_much(limit: usize, what: &'static str) -> Problem {
    Problem::TooMuch { what, limit }
}

fn byte_of(text: &str, error: &Error) -> usize {
    let row = error.pos().row.saturating_sub(1) as usize;
    text.split_inclusive('\n').take(row).map(str::len).sum()
}

/// Rejects documents that would take the parser too much time or memory.
fn bounded(text: &str) -> Result<(), (usize, Problem)> {
    if text.len() > MAX_TEXT_BYTES {
        return Err((0, too_much(MAX_TEXT_BYTES, "bytes")));
    }
    let (mut depth, mut namespaces, mut from) = (0_usize, 0, 0);
    while let Some(start) = text[from..].find('<').map(|at| from + at) {
        let rest = &text[start..];
        let passed = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        let passed = passed.iter().find(|(open, _)| rest.starts_with(open));
        let length = match passed {
            Some((_, close)) => rest.find(close).map(|at| at + close.len()),
            None => tag_length(rest),
        };
        let Some(length) = length else { break };
        from = start + length;
        if passed.is_some() {
            continue;
        }
        let tag = &rest[..length];
        if tag.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !tag.ends_with("/>") && !tag.starts_with("<!") {
            depth += 1;
        }
        namespaces += tag.matches("xmlns").count();
        let quotes = tag.bytes().filter(|byte| matches!(byte, b'"' | b'\'')).count();
        let refusal = [
            (depth > MAX_DEPTH, too_much(MAX_DEPTH, "nested elements")),
            (quotes > 2 * MAX_ATTRIBUTES, too_much(MAX_ATTRIBUTES, "attributes of an element")),
            (namespaces > MAX_NAMESPACES, too_much(MAX_NAMESPACES, "namespaces")),
        ];
        if let Some((_, problem)) = refusal.into_iter().find(|(refused, _)| *refused) {
            return Err((start, problem));
        }
    }
    Ok(())
}

/// A `>` between quotes does not end the tag.
fn tag_length(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, byte) in text.bytes().enumerate() {
        match (byte, quote) {
            (b'>', None) => return Some(at + 1),
            (b'"' | b'\'', None) => quote = Some(byte),
            (_, Some(open)) if byte == open => quote = None,
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::*;

    fn refusal(text: &str) -> String {
        document(text).map(|_| ()).unwrap_err().1.to_string()
    }

    #[test]
    fn entity_expansion_and_large_xml_are_refused_before_parsing() {
        let entities = format!(
            "<!DOCTYPE r [<!ENTITY a \"{}\">]><robot name=\"{}\"/>",
            "a".repeat(200_000),
            "&a;".repeat(60_000)
        );
        assert!(refusal(&entities).contains("declares entities"));
        assert!(refusal(&" ".repeat(MAX_TEXT_BYTES + 1)).contains("8388608 bytes"));
        assert!(refusal(&format!("<r>{}</r>", "<a/>".repeat(200_000))).contains("200000 elements"));
        let deep = format!("{}{}", "<a>".repeat(101), "</a>".repeat(101));
        assert!(refusal(&deep).contains("100 nested elements"));
        // Each would take minutes.
        let of_one: String = (0..100_000).fold("<a ".to_owned(), |mut text, at| {
            let _ = write!(text, "a{at}='' ");
            text
        });
        assert!(refusal(&format!("{of_one}/>")).contains("256 attributes of an element"));
        let nested = (0..5_000).fold(String::new(), |mut text, at| {
            let _ = write!(text, "<a xmlns:n{at}='u'/>");
            text
        });
        assert!(refusal(&format!("<r>{nested}</r>")).contains("512 namespaces"));
    }

    #[test]
    fn tags_in_comments_and_quotes_are_ignored_and_errors_have_a_place() {
        let text = format!(
            "<?xml version='1.0'?><!DOCTYPE robot><robot><!-- {} --><a b='>{}'/><![CDATA[{}]]></robot>",
            "<a>".repeat(200),
            "&lt;".repeat(200),
            "<a>".repeat(200)
        );
        assert!(document(&text).is_ok(), "{}", refusal(&text));
        let (at, problem) = document("<robot>\n<link name='a'>\n</robot>").unwrap_err();
        assert!(matches!(problem, Problem::Xml(_)) && at == 24, "{at}");
        for broken in ["<a b='", "<", "<!--", "<a", "</a>", "<![CDATA[", "<?"] {
            assert!(document(broken).is_err(), "{broken}");
        }
    }
}
