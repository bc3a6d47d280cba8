use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC};

/// Name of a log in reports and messages: its path, or its URL without secrets.
///
/// Secrets are user and password before the host, and everything after `?` or `#`, even in texts that only
/// look like a URL.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct SourceName(String);

impl SourceName {
    /// Name of the path or URL.
    pub fn from_path(path: &Path) -> Self {
        let text = path.to_string_lossy();
        Self(match text.split_once("://") {
            Some((scheme, rest)) if is_scheme(scheme) => {
                let scheme = scheme.to_ascii_lowercase();
                format!("{scheme}://{}", without_secrets(&scheme, rest))
            }
            _ if fs::symlink_metadata(path).is_ok() => text.into_owned(),
            _ => {
                let text = without_values(&text);
                match text.rsplit_once('@').filter(|(before, _)| before.contains(':')) {
                    Some((_, rest)) => format!("…{rest}"),
                    None => text.to_owned(),
                }
            }
        })
    }
}

impl fmt::Display for SourceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<SourceName> for PathBuf {
    fn from(SourceName(name): SourceName) -> Self {
        name.into()
    }
}

/// Characters escaped in the path of a URI.
pub const ESCAPED: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'/').remove(b'.').remove(b'_').remove(b'-').remove(b'~');

pub(super) fn is_scheme(text: &str) -> bool {
    text.len() > 1
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"+-.".contains(&byte))
}

fn without_secrets<'a>(scheme: &str, rest: &'a str) -> &'a str {
    let rest = match scheme {
        // `?` is an ordinary character in object keys.
        "s3" | "s3a" | "gs" | "az" | "abfs" | "abfss" => without_values(rest),
        _ => rest.split(['?', '#']).next().unwrap_or_default(),
    };
    let authority = rest.split('/').next().unwrap_or_default();
    match authority.rsplit_once('@') {
        // Container in an Azure URL.
        Some((container, _)) if scheme.starts_with("abfs") && !container.contains(':') => rest,
        Some((secret, _)) => &rest[secret.len() + 1..],
        // A password containing a slash.
        None if !has_port_at_most(authority) => match rest.rsplit_once('@') {
            Some((_, rest)) => rest,
            None => "…",
        },
        None => rest,
    }
}

fn has_port_at_most(authority: &str) -> bool {
    let host = authority.rsplit_once(']').map_or(authority, |(_, behind)| behind);
    let port = host.split_once(':').map_or("", |(_, port)| port);
    port.bytes().all(|byte| byte.is_ascii_digit())
}

/// Text before the first `?` or `#` that is followed by a value.
fn without_values(text: &str) -> &str {
    let is_followed = |at: &usize| text[*at..].contains('=');
    text.find(['?', '#']).filter(is_followed).map_or(text, |at| &text[..at])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn displayed_name(text: &str) -> String {
        SourceName::from_path(Path::new(text)).to_string()
    }

    #[test]
    fn names_contain_no_user_password_signature_or_token() {
        for (url, name) in [
            (
                "https://me:word@host:8080/a%20b/run.mcap?X-Amz-Signature=abc#part",
                "https://host:8080/a%20b/run.mcap",
            ),
            ("HTTPS://me:word@host/run.mcap?token=abc", "https://host/run.mcap"),
            ("https://word@host/run.mcap#token", "https://host/run.mcap"),
            ("https://me:wo/rd@host/run.mcap", "https://host/run.mcap"),
            ("https://me:wo?rd@host/run.mcap", "https://…"),
            ("https://[::1]:80/run.mcap?word", "https://[::1]:80/run.mcap"),
            ("http://host", "http://host"),
            ("s3://KEY:wo/rd@bucket/run.mcap", "s3://bucket/run.mcap"),
            ("s3://bucket/run.mcap?X-Amz-Signature=word", "s3://bucket/run.mcap"),
            ("s3://bucket/a?b#c.mcap", "s3://bucket/a?b#c.mcap"),
            (
                "abfss://box@me.dfs.core.windows.net/run.mcap?sig=word",
                "abfss://box@me.dfs.core.windows.net/run.mcap",
            ),
            ("abfss://me:word@host/run.mcap", "abfss://host/run.mcap"),
            ("htps://me:word@host/run.mcap?sig=word", "htps://host/run.mcap"),
            ("https:/me:word@host/run.mcap?sig=word", "…host/run.mcap"),
            ("https//me:word@host/run.mcap", "…host/run.mcap"),
            ("/home/htps:/me:word@host/run.mcap", "…host/run.mcap"),
            ("runs/cell@3 12:00?.mcap", "runs/cell@3 12:00?.mcap"),
        ] {
            assert_eq!(displayed_name(url), name, "{url}");
        }
    }

    #[test]
    fn an_existing_file_keeps_its_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("12:00@cell3?a=b.mcap");
        fs::write(&path, "").expect("a file");
        assert_eq!(SourceName::from_path(&path).to_string(), path.display().to_string());
    }
}
