use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Deserializer};

/// A rule's code, an estimate's name or a unit.
pub type Word = &'static str;

/// Each distinct word is leaked once; reports contain few.
pub(crate) fn deserialize_word<'de, D: Deserializer<'de>>(from: D) -> Result<Word, D::Error> {
    static KNOWN: Mutex<BTreeSet<Word>> = Mutex::new(BTreeSet::new());
    let text = String::deserialize(from)?;
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let word = known.get(text.as_str()).copied().unwrap_or_else(|| text.leak());
    known.insert(word);
    Ok(word)
}

pub(crate) fn deserialize_optional_word<'de, D: Deserializer<'de>>(
    from: D,
) -> Result<Option<Word>, D::Error> {
    #[derive(Deserialize)]
    struct Read(#[serde(deserialize_with = "deserialize_word")] Word);
    Ok(Option::<Read>::deserialize(from)?.map(|read| read.0))
}

/// Non-finite numbers are written as `null`.
pub(crate) fn deserialize_number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}
