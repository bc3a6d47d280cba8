use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

/// Label names and values, such as `site` → `berlin`.
pub type Labels = BTreeMap<String, String>;

/// Pattern for the end of a path, such as `{site}/{arm}/*.mcap`: a name in braces captures text, `*`
/// matches anything; neither matches `/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Template {
    parts: Vec<Vec<Token>>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Token {
    Text(String),
    Wildcard,
    Name(String),
}

/// Invalid [`Template`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}; expected parts of a path with names in braces, as in {{site}}/{{arm}}/*.mcap")]
pub struct TemplateError(&'static str);

impl FromStr for Template {
    type Err = TemplateError;

    fn from_str(text: &str) -> Result<Self, TemplateError> {
        let parts: Vec<Vec<Token>> = text.split('/').map(parse_tokens).collect::<Result<_, _>>()?;
        let has_name = parts.iter().flatten().any(|token| matches!(token, Token::Name(_)));
        has_name.then_some(Self { parts }).ok_or(TemplateError("it contains no {name}"))
    }
}

fn parse_tokens(part: &str) -> Result<Vec<Token>, TemplateError> {
    let (mut tokens, mut rest) = (Vec::new(), part);
    while let Some(at) = rest.find(['*', '{', '}']) {
        if at > 0 {
            tokens.push(Token::Text(rest[..at].to_owned()));
        }
        let after = &rest[at + 1..];
        rest = match rest.as_bytes()[at] {
            b'*' => {
                tokens.push(Token::Wildcard);
                after
            }
            b'{' => {
                let end = after.find('}').ok_or(TemplateError("a { is not closed"))?;
                if end == 0 {
                    return Err(TemplateError("{} contains no name"));
                }
                tokens.push(Token::Name(after[..end].to_owned()));
                &after[end + 1..]
            }
            _ => return Err(TemplateError("a } closes nothing")),
        };
    }
    if !rest.is_empty() {
        tokens.push(Token::Text(rest.to_owned()));
    }
    Ok(tokens)
}

impl Template {
    /// Labels in the path; empty if it does not match.
    pub fn labels(&self, path: &Path) -> Labels {
        let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
        let mut labels = Labels::new();
        let Some(skipped) = parts.len().checked_sub(self.parts.len()) else { return labels };
        for (tokens, part) in self.parts.iter().zip(&parts[skipped..]) {
            if !match_tokens(tokens, part, &mut labels) {
                return Labels::new();
            }
        }
        labels
    }
}

/// Names match the shortest non-empty text.
fn match_tokens(tokens: &[Token], text: &str, labels: &mut Labels) -> bool {
    let Some((first, others)) = tokens.split_first() else { return text.is_empty() };
    let ends = text.char_indices().map(|(at, _)| at).chain([text.len()]);
    match first {
        Token::Text(wanted) => text
            .strip_prefix(wanted.as_str())
            .is_some_and(|rest| match_tokens(others, rest, labels)),
        Token::Wildcard => ends.into_iter().any(|end| match_tokens(others, &text[end..], labels)),
        Token::Name(name) => ends.into_iter().filter(|&end| end > 0).any(|end| {
            let is_taken = match_tokens(others, &text[end..], labels);
            if is_taken {
                labels.insert(name.clone(), text[..end].to_owned());
            }
            is_taken
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(template: &str, path: &str) -> String {
        let template: Template = template.parse().expect("a template");
        let labels = template.labels(Path::new(path));
        labels.iter().map(|(name, value)| format!("{name}={value} ")).collect()
    }

    #[test]
    fn labels_are_read_from_the_end_of_a_path() {
        let said = labels("{site}/{arm}/*", "/data/berlin/cell3/run_1.mcap");
        assert_eq!(said, "arm=cell3 site=berlin ");
        let said = labels("{site}_{arm}_*.mcap", "/data/berlin_cell_3_x.mcap");
        assert_eq!(said, "arm=cell site=berlin ");
        assert_eq!(labels("{site}/*.bag", "/data/berlin/run.mcap"), "");
        assert_eq!(labels("{a}/{b}/{c}/{d}", "x/y"), "");
    }

    #[test]
    fn a_template_without_names_is_rejected() {
        for text in ["*/*", "{site", "{}/*", "site}"] {
            assert!(text.parse::<Template>().is_err(), "{text}");
        }
    }
}
