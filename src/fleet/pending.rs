//! Remaining logs, for external schedulers.

use std::io;
use std::path::Path;

use super::content::{FileState, Identity, LogContent, row_key};
use super::settings::AuditSettings;
use super::sources::LogSource;
use super::store::Store;
use crate::report::Trouble;

/// Logs among `sources` without a row in `store`, as far as known without reading them, including copies
/// that are not hashed yet. With `retry`, also logs without a final status.
///
/// # Errors
/// If the store cannot be read.
pub fn pending(
    sources: Vec<LogSource>,
    store: &Store,
    settings: &AuditSettings,
    identity: Identity,
    retry: bool,
) -> Result<Vec<LogSource>, Trouble> {
    let (done, contents) = (store.finished_answers()?, store.known_contents()?);
    let known = |path: &Path| -> io::Result<Option<String>> {
        let state = FileState::read(path)?;
        match identity {
            Identity::File => Ok(Some(LogContent::identify(path, state, identity)?.id)),
            Identity::Content => Ok(contents.get(&state.hash(path)).cloned()),
        }
    };
    let is_done = |source: &LogSource| {
        let content = known(&source.path).ok().flatten();
        let key = content.map(|id| row_key(&id, env!("CARGO_PKG_VERSION"), &settings.hash));
        let answer = key.and_then(|key| done.get(&key));
        answer.is_some_and(|answer| answer.status.is_final() || !retry)
    };
    Ok(sources.into_iter().filter(|source| !is_done(source)).collect())
}
