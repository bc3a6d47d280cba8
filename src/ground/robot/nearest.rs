//! Suggestions for misspelt names.

/// Up to three of `candidates` similar to `name`, most similar first, ignoring case.
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let furthest = (name.chars().count() / 3).max(1);
    let name = name.to_lowercase();
    let mut near: Vec<(usize, &str)> = candidates
        .map(|candidate| (strsim::levenshtein(&name, &candidate.to_lowercase()), candidate))
        .filter(|(distance, _)| *distance <= furthest)
        .collect();
    near.sort_by_key(|(distance, _)| *distance);
    near.into_iter().take(3).map(|(_, candidate)| candidate).collect()
}
