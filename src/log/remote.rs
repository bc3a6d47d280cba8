//! Logs in object storage, by URL.
//!
//! An object is given to the readers as a temporary file of its size, into which its bytes are
//! fetched: of an indexed MCAP those that its reading looks at, of anything else all. What can be
//! fetched is fetched side by side, and taken up where a connection broke off.

#[cfg(feature = "cloud")]
mod cause;
mod fault;
#[cfg(feature = "cloud")]
mod fetch;
#[cfg(feature = "cloud")]
mod listing;
#[cfg(feature = "cloud")]
mod named;
#[cfg(feature = "cloud")]
mod patience;
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

/// The URL of an object in a store, with its scheme in lower case.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Address(String);

impl Address {
    /// The address that `path` is, if it is a URL of something else than a local file.
    ///
    /// # Errors
    /// If it is a URL of a kind that is not known.
    pub(super) fn of(path: &Path) -> Result<Option<Self>, LogError> {
        let Some((scheme, rest)) = scheme(path) else { return Ok(None) };
        if SCHEMES.contains(&scheme.as_str()) {
            return Ok(Some(Self(format!("{scheme}://{rest}"))));
        }
        let url = SourceName::of(path).into();
        Err(LogError::Remote { url, fault: RemoteFault::Scheme { scheme } })
    }

    /// What it is called in reports.
    pub(super) fn shown(&self) -> PathBuf {
        SourceName::of(Path::new(&self.0)).into()
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Address({})", self.shown().display())
    }
}

/// What URLs of objects begin with.
const SCHEMES: &[&str] = &["s3", "s3a", "gs", "az", "abfs", "abfss", "http", "https"];

/// What `path` begins with, in lower case, and what follows `://`, if it is a URL.
fn scheme(path: &Path) -> Option<(String, &str)> {
    let (scheme, rest) = path.to_str()?.split_once("://")?;
    is_scheme(scheme).then(|| (scheme.to_ascii_lowercase(), rest))
}

/// The local file that `path` is a URL of, if it is one of the scheme `file`.
pub(super) fn local(path: &Path) -> Option<PathBuf> {
    let (_, rest) = scheme(path).filter(|(scheme, _)| scheme == "file")?;
    let rest = rest.strip_prefix("localhost").unwrap_or(rest);
    Some(percent_decode_str(rest).decode_utf8().ok()?.into_owned().into())
}

/// Whether `path` is a URL of an object, or of a prefix that [`list`] lists.
pub fn is_url(path: &Path) -> bool {
    scheme(path).is_some_and(|(scheme, _)| SCHEMES.contains(&scheme.as_str()))
}

/// `path`, or the URL that it is with its scheme in lower case.
pub fn normal(path: &Path) -> PathBuf {
    match Address::of(path) {
        Ok(Some(Address(url))) => url.into(),
        _ => path.to_owned(),
    }
}

/// An object that [`list`] found.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct Listed {
    /// Its URL, as [`open`](super::open) takes it.
    pub url: String,
    /// Its size.
    pub bytes: u64,
    /// What changes whenever its content does: the store's entity tag, or else when it was written.
    pub version: String,
}

/// The objects whose URLs begin with `url` and a `/`, in the order of their names; the object itself
/// where it is one. Of a web server, which lists nothing, only that.
///
/// # Errors
/// Where there are none, or the store refuses to say.
pub fn list(url: &Path) -> Result<Vec<Listed>, LogError> {
    let Some(address) = Address::of(url)? else {
        return Err(LogError::NotFound { path: url.to_owned() });
    };
    let shown = address.shown();
    #[cfg(feature = "cloud")]
    let listed = listing::list(&address);
    #[cfg(not(feature = "cloud"))]
    let listed = Err(RemoteFault::NotBuilt);
    listed.map_err(|fault| LogError::Remote { url: shown, fault })
}

/// An object, as far as it was fetched.
pub(super) struct Fetched {
    /// The temporary file that stands for it.
    pub(super) file: Unpacked,
    /// What of it is there.
    pub(super) present: Present,
    /// How many bytes came over the network for that.
    pub(super) bytes: u64,
}

/// Fetches what is read of the object at `address`; all of it where everything is to be verified.
#[cfg(feature = "cloud")]
pub(super) fn fetch(address: &Address, options: &ReadOptions) -> Result<Fetched, RemoteFault> {
    fetch::fetch(address, options)
}

/// Refuses.
#[cfg(not(feature = "cloud"))]
pub(super) fn fetch(_: &Address, _: &ReadOptions) -> Result<Fetched, RemoteFault> {
    Err(RemoteFault::NotBuilt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_of_stores_are_told_from_paths() {
        let is_url = |text: &str| is_url(Path::new(text));
        assert!(is_url("s3://bucket/run.mcap") && is_url("https://host/run.mcap"));
        assert!(!is_url("run.mcap") && !is_url("C://run.mcap") && !is_url("./s3://x"));
        assert!(!is_url("ftp://host/run.mcap"));
        let refused = Address::of(Path::new("ftp://host/run.mcap")).unwrap_err().to_string();
        assert!(
            refused.starts_with("ftp://host/run.mcap: no store is reached by ftp"),
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
        let address = Address::of(path).unwrap().expect("a URL");
        assert_eq!(format!("{address:?}"), "Address(https://host/run.mcap)");
        assert_eq!(normal(path), Path::new("https://me:word@host/run.mcap?sig=word"));
        assert!(is_url(Path::new("S3://bucket/run.mcap")));
        assert_eq!(local(Path::new("FILE:///run.mcap")), Some("/run.mcap".into()));
        let refused = Address::of(Path::new("htps://me:word@host/run?sig=word")).unwrap_err();
        assert!(!refused.to_string().contains("word"), "{refused}");
    }
}
