//! Documentation of a rule.

use maud::{Markup, PreEscaped, html};
use pulldown_cmark::{Event, Parser, TagEnd};

use crate::checks::Rule;

/// Meaning of the finding and when it misleads.
pub fn folded(rule: &Rule) -> Markup {
    html! {
        details .values .rule {
            summary { "What " (rule.code) " means, when it misleads" }
            p .says { (rule.code) " " (rule.name) ": " (rule.grade) }
            (PreEscaped(rendered(&rule.doc())))
        }
    }
}

/// Paragraphs, headings, lists and code. Escapes all text.
fn rendered(markdown: &str) -> String {
    let mut out = String::new();
    for event in Parser::new(markdown) {
        match event {
            Event::Start(tag) => out.extend(element(&tag.to_end()).map(|name| format!("<{name}>"))),
            Event::End(end) => out.extend(element(&end).map(|name| format!("</{name}>"))),
            Event::Code(text) => out.push_str(&html! { code { (text.as_ref()) } }.into_string()),
            Event::SoftBreak | Event::HardBreak => out.push('\n'),
            Event::Text(text) | Event::Html(text) | Event::InlineHtml(text) => {
                out.push_str(&html! { (text.as_ref()) }.into_string());
            }
            _ => {}
        }
    }
    out
}

const fn element(end: &TagEnd) -> Option<&'static str> {
    match end {
        TagEnd::Paragraph => Some("p"),
        TagEnd::Heading(_) => Some("h4"),
        TagEnd::List(_) => Some("ul"),
        TagEnd::Item => Some("li"),
        TagEnd::CodeBlock => Some("pre"),
        TagEnd::Emphasis => Some("em"),
        TagEnd::Strong => Some("strong"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::registry;

    #[test]
    fn every_rule_is_rendered_whole_and_closed() {
        for rule in registry() {
            let page = rendered(&rule.doc());
            for name in ["p", "h4", "ul", "li", "em", "strong", "code"] {
                let count = |tag: String| page.matches(&tag).count();
                assert_eq!(
                    count(format!("<{name}>")),
                    count(format!("</{name}>")),
                    "{}",
                    rule.code
                );
            }
            assert!(page.contains("<h4>What it means</h4>"), "{}", rule.code);
        }
        assert_eq!(rendered("a < `b<c>`"), "<p>a &lt; <code>b&lt;c&gt;</code></p>");
    }
}
