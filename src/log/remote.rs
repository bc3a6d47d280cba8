//! Logs in object storage, by URL. A temporary file represents the object. Bytes are fetched into it: the
//! required ones of an indexed MCAP, otherwise all.

#[cfg(feature = "cloud")]
mod credentials;
#[cfg(feature = "cloud")]
mod error_cause;
mod fault;
#[cfg(feature = "cloud")]
mod fetch;
#[cfg(feature = "cloud")]
mod listing;
#[cfg(feature = "cloud")]
mod minimum_rate;
#[cfg(feature = "cloud")]
mod store;

use std::fmt;
use std::path::{Path, PathBuf};

use percent_encoding::percent_decode_str;

use super::name::{SourceName, is_scheme};
use super::ranges::Present;
use super::unpack::Unpacked;
use super::{LogError, ReadOptions};

pub use self::fault::RemoteFault;

/// URL of an object, with its scheme in lower case.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Address(String);

impl Address {
    /// Address of `path` if it is a URL of anything but a local file.
    ///
    /// # Errors
    /// If the URL scheme is not supported.
    pub(super) fn from_path(path: &Path) -> Result<Option<Self>, LogError> {
        let Some((scheme, rest)) = scheme(path) else { return Ok(None) };
        if SCHEMES.contains(&scheme.as_str()) {
            return Ok(Some(Self(format!("{scheme}://{rest}"))));
        }
        let url = SourceName::from_path(path).into();
        Err(LogError::Remote { url, fault: RemoteFault::Scheme { scheme } })
    }

    pub(super) fn display_path(&self) -> PathBuf {
        SourceName::from_path(Path::new(&self.0)).into()
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Address({})", self.display_path().display())
    }
}

const SCHEMES: &[&str] = &["s3", "s3a", "gs", "az", "abfs", "abfss", "http", "https"];

/// Scheme in lower case and the text after `://`.
fn scheme(path: &Path) -> Option<(String, &str)> {
    let (scheme, rest) = path.to_str()?.split_once("://")?;
    is_scheme(scheme).then(|| (scheme.to_ascii_lowercase(), rest))
}

pub(super) fn local(path: &Path) -> Option<PathBuf> {
    let (_, rest) = scheme(path).filter(|(scheme, _)| scheme == "file")?;
    let rest = rest.strip_prefix("localhost").unwrap_or(rest);
    Some(percent_decode_str(rest).decode_utf8().ok()?.into_owned().into())
}

/// Whether `path` is the URL of an object, or of a prefix for [`list`].
pub fn is_url(path: &Path) -> bool {
    scheme(path).is_some_and(|(scheme, _)| SCHEMES.contains(&scheme.as_str()))
}

/// `path`, with the scheme of a URL in lower case.
pub fn normalize_url(path: &Path) -> PathBuf {
    match Address::from_path(path) {
        Ok(Some(Address(url))) => url.into(),
        _ => path.to_owned(),
    }
}

/// Object found by [`list`].
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct RemoteObject {
    /// URL for [`open`](super::open).
    pub url: String,
    /// Size.
    pub bytes: u64,
    /// The store's entity tag, otherwise the modification time.
    pub version: String,
}

/// Objects whose URLs start with `url` and a `/`, sorted by name, or the object itself. A web server cannot
/// list.
///
/// # Errors
/// If there are none, or if the store does not list them.
pub fn list(url: &Path) -> Result<Vec<RemoteObject>, LogError> {
    let Some(address) = Address::from_path(url)? else {
        return Err(LogError::NotFound { path: url.to_owned() });
    };
    let shown = address.display_path();
    #[cfg(feature = "cloud")]
    let listed = listing::list(&address);
    #[cfg(not(feature = "cloud"))]
    let listed = Err(RemoteFault::NotBuilt);
    listed.map_err(|fault| LogError::Remote { url: shown, fault })
}

pub(super) struct Fetched {
    pub(super) file: Unpacked,
    pub(super) present: Present,
    pub(super) bytes: u64,
}

/// Fetches all parts if checksums are verified.
#[cfg(feature = "cloud")]
pub(super) fn fetch(address: &Address, options: &ReadOptions) -> Result<Fetched, RemoteFault> {
    fetch::fetch(address, options)
}

#[cfg(not(feature = "cloud"))]
pub(super) fn fetch(_: &Address, _: &ReadOptions) -> Result<Fetched, RemoteFault> {
    Err(RemoteFault::NotBuilt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_are_distinguished_from_paths() {
        let is_url = |text: &str| is_url(Path::new(text));
        assert!(is_url("s3://bucket/run.mcap") && is_url("https://host/run.mcap"));
        assert!(!is_url("run.mcap") && !is_url("C://run.mcap") && !is_url("./s3://x"));
        assert!(!is_url("ftp://host/run.mcap"));
        let refused = Address::from_path(Path::new("ftp://host/run.mcap")).unwrap_err().to_string();
        assert!(
            refused.starts_with("ftp://host/run.mcap: unsupported URL scheme ftp"),
            "{refused}"
        );
        assert!(!refused.contains('\n'));
        let local = |text: &str| local(Path::new(text)).map(|path| path.display().to_string());
        assert_eq!(local("file:///a%20b/100%.mcap").as_deref(), Some("/a b/100%.mcap"));
        assert_eq!(local("file://localhost/run.mcap").as_deref(), Some("/run.mcap"));
        assert_eq!(local("s3://bucket/run.mcap"), None);
    }

    #[test]
    fn schemes_ignore_case_and_no_address_can_be_printed() {
        let path = Path::new("HTTPS://me:word@host/run.mcap?sig=word");
        let address = Address::from_path(path).unwrap().expect("a URL");
        assert_eq!(format!("{address:?}"), "Address(https://host/run.mcap)");
        assert_eq!(normalize_url(path), Path::new("https://me:word@host/run.mcap?sig=word"));
        assert!(is_url(Path::new("S3://bucket/run.mcap")));
        assert_eq!(local(Path::new("FILE:///run.mcap")), Some("/run.mcap".into()));
        let refused =
            Address::from_path(Path::new("htps://me:word@host/run?sig=word")).unwrap_err();
        assert!(!refused.to_string().contains("word"), "{refused}");
    }
}
