//! Documentation of a rule.

use maud::{Markup, PreEscaped, html};
use pulldown_cmark::{Event, Parser, TagEnd};

use crate::checks::Rule;

/// Meaning of the finding and when it misleads.
pub fn rule_details(rule: &Rule) -> Markup {
    html! {
        details .values .rule {
            summary { "What " (rule.code) " means, when it misleads" }
            p .says { (rule.code) " " (rule.name) ": " (rule.grade) }
            (PreEscaped(render_markdown(&rule.doc())))
        }
    }
}

/// Paragraphs, headings, lists and code. Escapes all text.
fn render_markdown(markdown: &str) -> String {
    let mut out = String::new();
    for event in Parser::new(markdown) {
        match event {
            Event::Start(tag) => {
                out.extend(html_element(&tag.to_end()).map(|name| format!("<{name}>")))
            }
            Event::End(end) => out.extend(html_element(&end).map(|name| format!("</{name}>"))),
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

const fn html_element(end: &TagEnd) -> Option<&'static str> {
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
    fn every_rule_renders_with_closed_elements() {
        for rule in registry() {
            let page = render_markdown(&rule.doc());
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
        assert_eq!(render_markdown("a < `b<c>`"), "<p>a &lt; <code>b&lt;c&gt;</code></p>");
    }
}
