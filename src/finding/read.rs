//! What a report is read back by.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Deserializer};

/// A word that this program has for something: a rule's code, what an estimate is of, a unit.
pub type Word = &'static str;

/// Reads a word. Each is kept once and for as long as the process lives; reports have few.
pub(crate) fn word<'de, D: Deserializer<'de>>(from: D) -> Result<Word, D::Error> {
    static KNOWN: Mutex<BTreeSet<Word>> = Mutex::new(BTreeSet::new());
    let text = String::deserialize(from)?;
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let word = known.get(text.as_str()).copied().unwrap_or_else(|| text.leak());
    known.insert(word);
    Ok(word)
}

/// The same of what may be missing.
pub(crate) fn maybe_word<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Word>, D::Error> {
    #[derive(Deserialize)]
    struct Read(#[serde(deserialize_with = "word")] Word);
    Ok(Option::<Read>::deserialize(from)?.map(|read| read.0))
}

/// Reads a number, of which what is not finite was written as `null`.
pub(crate) fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}
