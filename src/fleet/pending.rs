//! Remaining logs, for external schedulers.

use std::io;
use std::path::Path;

use super::content::{Content, Identity, Stand, key_of};
use super::settings::AuditSettings;
use super::sources::Source;
use super::store::Store;
use crate::report::Trouble;

/// Logs among `sources` without a row in `store`, as far as known without reading them, including copies
/// that are not hashed yet. With `retry`, also logs without a final status.
///
/// # Errors
/// If the store cannot be read.
pub fn pending(
    sources: Vec<Source>,
    store: &Store,
    settings: &AuditSettings,
    identity: Identity,
    retry: bool,
) -> Result<Vec<Source>, Trouble> {
    let (done, contents) = (store.done()?, store.contents()?);
    let known = |path: &Path| -> io::Result<Option<String>> {
        let stand = Stand::of(path)?;
        match identity {
            Identity::File => Ok(Some(Content::of(path, stand, identity)?.id)),
            Identity::Content => Ok(contents.get(&stand.name(path)).cloned()),
        }
    };
    let is_done = |source: &Source| {
        let content = known(&source.path).ok().flatten();
        let key = content.map(|id| key_of(&id, env!("CARGO_PKG_VERSION"), &settings.hash));
        let answer = key.and_then(|key| done.get(&key));
        answer.is_some_and(|answer| answer.status.is_final() || !retry)
    };
    Ok(sources.into_iter().filter(|source| !is_done(source)).collect())
}
