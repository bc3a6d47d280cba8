//! Orders candidates by score, and removes repeated ones.

/// Candidates by increasing score.
pub(crate) fn by_score<T>(scored: impl IntoIterator<Item = (f64, T)>) -> impl Iterator<Item = T> {
    let mut scored: Vec<(f64, T)> = scored.into_iter().collect();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    scored.into_iter().map(|(_, candidate)| candidate)
}

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
