//! Removes repeated candidates.

/// Keeps the first of each kind. `is_same` compares it with a later one.
pub(crate) fn distinct<T>(
    candidates: impl IntoIterator<Item = T>,
    is_same: impl Fn(&T, &T) -> bool,
) -> Vec<T> {
    let mut distinct: Vec<T> = Vec::new();
    for candidate in candidates {
        if !distinct.iter().any(|first| is_same(first, &candidate)) {
            distinct.push(candidate);
        }
    }
    distinct
}
