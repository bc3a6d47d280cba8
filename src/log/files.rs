use std::collections::HashMap;
use std::fs;
use std::path::PathBuf;

use bytes::Bytes;

use super::LogError;
use super::mapped::MappedFile;
use super::remote::Address;
use super::tables;

#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct LogInput {
    pub(super) path: PathBuf,
    pub(super) address: Option<Address>,
    pub(super) given: Option<Bytes>,
    pub(super) in_bag: bool,
    /// Messages according to the folder's `metadata.yaml`.
    pub(super) recorded: Option<u64>,
    /// The only wanted episode.
    pub(super) episode: Option<String>,
}

impl LogInput {
    pub(super) fn local(path: PathBuf) -> Self {
        Self { path, address: None, given: None, in_bag: false, recorded: None, episode: None }
    }

    pub(super) fn bag_file(path: PathBuf) -> Self {
        Self { in_bag: true, ..Self::local(path) }
    }

    /// Size; 0 if unknown, as for an object that has not been requested.
    pub(super) fn bytes(&self) -> u64 {
        match &self.given {
            Some(content) => content.len() as u64,
            None => fs::metadata(&self.path).map_or(0, |metadata| metadata.len()),
        }
    }

    pub(super) fn open(&self) -> Result<MappedFile, LogError> {
        match &self.given {
            Some(content) => MappedFile::from_content(&self.path, content),
            None => MappedFile::open(&self.path),
        }
    }
}

pub(super) fn reject_duplicates(inputs: &[LogInput]) -> Result<(), LogError> {
    let mut by_size: HashMap<u64, Vec<&LogInput>> = HashMap::new();
    for input in inputs {
        let same_size = by_size.entry(input.bytes()).or_default();
        for first in same_size.iter() {
            let is_same = match (&first.address, &input.address) {
                (None, None) => is_same(first, input),
                (first, other) => first == other,
            };
            if is_same {
                let (path, first) = (input.path.clone(), first.path.clone());
                return Err(LogError::Twice { path, first });
            }
        }
        same_size.push(input);
    }
    Ok(())
}

fn is_same(a: &LogInput, b: &LogInput) -> bool {
    if let (Ok(a), Ok(b)) = (fs::canonicalize(&a.path), fs::canonicalize(&b.path))
        && a == b
    {
        return true;
    }
    // Signals of one run may be equal, such as a command and its state.
    let are_signals = |bytes: &[u8]| a.in_bag && b.in_bag && tables::is_text(bytes);
    // Errors in opening are reported when the file is read.
    match (a.open(), b.open()) {
        (Ok(a), Ok(b)) => a.bytes() == b.bytes() && !are_signals(a.bytes()),
        _ => false,
    }
}
