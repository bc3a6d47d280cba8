//! Distinguishes arms by words of their names.

use super::role::split_words;

/// Words that identify one arm, and those of others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Namespace {
    pub own: Vec<String>,
    others: Vec<String>,
}

/// Which arm a name refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum NamespaceMatch {
    /// Words of a different arm only.
    Foreign,
    /// No distinguishing word.
    Neutral,
    /// A word of this arm.
    Own,
}

impl Namespace {
    /// For each arm, the words that not all share.
    pub fn from_names<S: AsRef<str>>(names: &[S]) -> Vec<Namespace> {
        let all: Vec<Vec<String>> = names.iter().map(|name| split_words(name.as_ref())).collect();
        Self::from_words(&all)
    }

    pub fn from_words(all: &[Vec<String>]) -> Vec<Namespace> {
        let is_shared = |word: &String| all.iter().all(|words| words.contains(word));
        let telling = |words: &Vec<String>| -> Vec<String> {
            words.iter().filter(|word| !is_shared(word)).cloned().collect()
        };
        let namespace = |index: usize| {
            let own = telling(&all[index]);
            let others = all.iter().enumerate().filter(|(other, _)| *other != index);
            let others: Vec<String> = others.flat_map(|(_, words)| telling(words)).collect();
            let others = others.into_iter().filter(|word| !own.contains(word)).collect();
            Namespace { own, others }
        };
        (0..all.len()).map(namespace).collect()
    }

    /// Arm that names refer to.
    pub fn match_names<'n>(&self, names: impl IntoIterator<Item = &'n str>) -> NamespaceMatch {
        let words: Vec<String> = names.into_iter().flat_map(split_words).collect();
        let has = |known: &[String]| known.iter().any(|word| words.contains(word));
        match (has(&self.own), has(&self.others)) {
            (true, _) => NamespaceMatch::Own,
            (false, true) => NamespaceMatch::Foreign,
            (false, false) => NamespaceMatch::Neutral,
        }
    }

    pub fn is_one_of_several(&self) -> bool {
        !self.own.is_empty() || !self.others.is_empty()
    }

    /// Its words as a label.
    pub fn label(&self) -> Option<String> {
        (!self.own.is_empty()).then(|| self.own.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_in_all_names_distinguish_nothing() {
        let namespaces = Namespace::from_names(&["/left/joint_states", "/right/joint_states"]);
        assert_eq!(namespaces[0].match_names(["/left/tcp_pose", ""]), NamespaceMatch::Own);
        assert_eq!(namespaces[1].match_names(["/left/tcp_pose"]), NamespaceMatch::Foreign);
        assert_eq!(
            namespaces[0].match_names(["/joint_states_relay", "tool0"]),
            NamespaceMatch::Neutral
        );
    }

    #[test]
    fn an_arm_without_own_words_rejects_names_of_others() {
        let namespaces = Namespace::from_names(&["/joint_states", "/leader/joint_states"]);
        assert_eq!(namespaces[0].match_names(["/leader/pose"]), NamespaceMatch::Foreign);
        assert_eq!(namespaces[0].match_names(["/tcp_pose"]), NamespaceMatch::Neutral);
        assert!(
            namespaces[0].is_one_of_several()
                && !Namespace::from_names(&["/a"])[0].is_one_of_several()
        );
    }
}
