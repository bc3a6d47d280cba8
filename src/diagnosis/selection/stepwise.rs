//! Stepwise selection of a set by its score.

/// Set with its score. Smaller scores are better.
pub(crate) struct ScoredSet<T> {
    pub members: Vec<T>,
    pub score: f64,
}

/// Adds the best of `candidates` as long as the score improves. A later one can make others needless: these are removed.
pub(crate) fn grow<T: Copy + PartialEq>(
    candidates: &[T],
    mut best: ScoredSet<T>,
    score: impl Fn(&[T]) -> f64,
) -> ScoredSet<T> {
    let scored = |members: Vec<T>| ScoredSet { score: score(&members), members };
    loop {
        let grown = candidates
            .iter()
            .filter(|one| !best.members.contains(one))
            .map(|&one| scored(best.members.iter().copied().chain([one]).collect()))
            .min_by(|a, b| a.score.total_cmp(&b.score));
        match grown {
            Some(grown) if grown.score < best.score => best = prune(grown, &scored),
            _ => return best,
        }
    }
}

fn prune<T: Copy>(mut set: ScoredSet<T>, scored: &dyn Fn(Vec<T>) -> ScoredSet<T>) -> ScoredSet<T> {
    loop {
        let shrunk = (0..set.members.len())
            .map(|drop| {
                let mut members = set.members.clone();
                members.remove(drop);
                scored(members)
            })
            .min_by(|a, b| a.score.total_cmp(&b.score));
        match shrunk {
            Some(shrunk) if shrunk.score < set.score => set = shrunk,
            _ => return set,
        }
    }
}
