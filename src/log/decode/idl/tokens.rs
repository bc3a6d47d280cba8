use super::super::schema::{MAX_NAME, SchemaError, excerpt};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Token<'a> {
    /// Identifier, or several with `::` between or before them.
    Name(&'a str),
    /// Starts with a digit.
    Number(&'a str),
    /// String or character literal with its quotes.
    Text(&'a str),
    /// Any other character.
    Mark(char),
}

/// Token stream of consecutive files.
#[derive(Default)]
pub(super) struct Tokens<'a> {
    text: &'a str,
    /// Start of the next token.
    at: usize,
}

impl<'a> Tokens<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let mut tokens = Self { text, at: 0 };
        if tokens.is_header(0) {
            tokens.skip_line();
        }
        tokens.skip_blank();
        tokens
    }

    pub(super) fn is_at_end(&self) -> bool {
        self.at == self.text.len()
    }

    pub(super) fn here(&self) -> usize {
        self.at
    }

    pub(super) fn since(&self, place: usize) -> String {
        excerpt(self.text[place..self.at].trim())
    }

    pub(super) fn peek(&self) -> Option<Token<'a>> {
        let rest = &self.text[self.at..];
        let first = rest.chars().next()?;
        Some(match first {
            '"' | '\'' => Token::Text(&rest[..text_length(rest, first)]),
            '0'..='9' => {
                Token::Number(leading_part(rest, |c| c.is_alphanumeric() || c == '.' || c == '_'))
            }
            ':' if rest.starts_with("::") => Token::Name(name(rest)),
            _ if first.is_alphabetic() || first == '_' => Token::Name(name(rest)),
            mark => Token::Mark(mark),
        })
    }

    pub(super) fn take(&mut self) -> Option<Token<'a>> {
        let token = self.peek()?;
        self.at += match token {
            Token::Name(text) | Token::Number(text) | Token::Text(text) => text.len(),
            Token::Mark(mark) => mark.len_utf8(),
        };
        self.skip_blank();
        Some(token)
    }

    /// Consumes `mark` if it is next.
    pub(super) fn accept(&mut self, mark: char) -> bool {
        let is_next = self.peek() == Some(Token::Mark(mark));
        if is_next {
            self.take();
        }
        is_next
    }

    pub(super) fn expect(&mut self, mark: char) -> Result<(), SchemaError> {
        if self.accept(mark) {
            return Ok(());
        }
        let expected = match mark {
            '{' => "`{`",
            '}' => "`}`",
            ';' => "`;`",
            '=' => "`=`",
            '<' => "`<`",
            '>' => "`>`",
            ')' => "`)`",
            _ => "`]`",
        };
        self.refuse_next(expected)
    }

    /// `expected` is for the error.
    pub(super) fn name(&mut self, expected: &'static str) -> Result<&'a str, SchemaError> {
        match self.peek() {
            Some(Token::Name(name)) if name.len() <= MAX_NAME => {
                self.take();
                Ok(name)
            }
            Some(Token::Name(_)) => Err(SchemaError::LongName { line: self.line() }),
            _ => self.refuse_next(expected),
        }
    }

    pub(super) fn refuse<T>(&self, expected: &'static str, found: &str) -> Result<T, SchemaError> {
        Err(SchemaError::Syntax { line: self.line(), expected, found: excerpt(found) })
    }

    fn refuse_next<T>(&self, expected: &'static str) -> Result<T, SchemaError> {
        let line = self.text[self.at..].lines().next().unwrap_or("the end");
        self.refuse(expected, line.trim())
    }

    fn line(&self) -> usize {
        self.text[..self.at].matches('\n').count() + 1
    }

    /// Includes `mark`.
    pub(super) fn skip_to(&mut self, mark: char) -> Result<(), SchemaError> {
        while !self.accept(mark) {
            if self.take().is_none() {
                return self.expect(mark);
            }
        }
        Ok(())
    }

    /// Up to the end of the next `{ … }`.
    pub(super) fn skip_block(&mut self) -> Result<(), SchemaError> {
        self.skip_to('{')?;
        self.skip_nested('{', '}')
    }

    /// A bound in `< … >`, if present.
    pub(super) fn skip_bound(&mut self) -> Result<(), SchemaError> {
        if self.accept('<') { self.skip_nested('<', '>') } else { Ok(()) }
    }

    /// Returns the first word of an annotation's parameters.
    pub(super) fn parenthesized(&mut self) -> Result<Option<&'a str>, SchemaError> {
        if !self.accept('(') {
            return Ok(None);
        }
        let first = match self.peek() {
            Some(Token::Name(name) | Token::Number(name)) => Some(name),
            _ => None,
        };
        self.skip_nested('(', ')')?;
        Ok(first)
    }

    /// The opening mark is already consumed.
    fn skip_nested(&mut self, open: char, close: char) -> Result<(), SchemaError> {
        let mut depth = 1_usize;
        while depth > 0 {
            match self.take() {
                Some(Token::Mark(mark)) if mark == open => depth += 1,
                Some(Token::Mark(mark)) if mark == close => depth -= 1,
                Some(_) => {}
                None => return self.expect(close),
            }
        }
        Ok(())
    }

    /// Whitespace, comments, preprocessor lines and file separators.
    fn skip_blank(&mut self) {
        loop {
            let rest = &self.text[self.at..];
            let blank = rest.len() - rest.trim_start().len();
            let starts_line = self.at == 0 || rest[..blank].contains('\n');
            self.at += blank;
            let rest = &self.text[self.at..];
            let is_line = rest.starts_with("//") || rest.starts_with('#');
            if is_line || (starts_line && self.is_header(self.at)) {
                self.skip_line();
            } else if let Some(comment) = rest.strip_prefix("/*") {
                self.at += 2 + comment.find("*/").map_or(comment.len(), |end| end + 2);
            } else {
                return;
            }
        }
    }

    /// Separator of two files.
    fn is_header(&self, at: usize) -> bool {
        self.text[at..].starts_with("===") || self.text[at..].starts_with("IDL:")
    }

    fn skip_line(&mut self) {
        let rest = &self.text[self.at..];
        self.at += rest.find('\n').unwrap_or(rest.len());
    }
}

/// Up to the end if it is not terminated.
fn text_length(text: &str, quote: char) -> usize {
    let mut is_escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        if c == quote && !is_escaped {
            return at + c.len_utf8();
        }
        is_escaped = c == '\\' && !is_escaped;
    }
    text.len()
}

fn leading_part(text: &str, belongs: impl Fn(char) -> bool) -> &str {
    &text[..text.find(|c| !belongs(c)).unwrap_or(text.len())]
}

/// See [`Token::Name`].
fn name(text: &str) -> &str {
    let mut length = 0;
    loop {
        if text[length..].starts_with("::") {
            length += 2;
        }
        length += leading_part(&text[length..], |c| c.is_alphanumeric() || c == '_').len();
        if !text[length..].starts_with("::") {
            return &text[..length];
        }
    }
}
