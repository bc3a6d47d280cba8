use futures_util::StreamExt;
use object_store::{GetOptions, ObjectMeta};

use super::fault::{RemoteFault, Store};
use super::store::Source;
use super::{Address, RemoteObject, error_cause, fetch};

/// Objects below `address`, by name, or the object itself.
pub(super) fn list(address: &Address) -> Result<Vec<RemoteObject>, RemoteFault> {
    let source = Source::connect(address)?;
    let fault = |error| error_cause::remote_fault(&error, source.store);
    let metas = fetch::runtime()?.block_on(async {
        let below = match source.store {
            Store::Web => Vec::new(),
            _ => {
                let prefix = Some(&source.key).filter(|key| !key.as_ref().is_empty());
                let (mut listed, mut found) = (source.client.list(prefix), Vec::new());
                while let Some(meta) = fetch::with_timeout(listed.next()).await? {
                    found.push(meta.map_err(fault)?);
                }
                found
            }
        };
        if below.is_empty() {
            let options = GetOptions { head: true, ..GetOptions::default() };
            let answer = fetch::with_timeout(source.client.get_opts(&source.key, options)).await?;
            let answer = answer.map_err(fault)?;
            return Ok(vec![answer.meta]);
        }
        Ok(below)
    })?;
    let Address(url) = address;
    let of = |meta: ObjectMeta| RemoteObject {
        url: match source.store {
            Store::Web => url.clone(),
            _ => format!("{}{}", source.root, meta.location),
        },
        bytes: meta.size,
        version: meta.e_tag.unwrap_or_else(|| meta.last_modified.to_rfc3339()),
    };
    // Objects that represent a folder are empty.
    let mut listed: Vec<RemoteObject> =
        metas.into_iter().filter(|meta| meta.size > 0).map(of).collect();
    listed.sort();
    Ok(listed)
}
