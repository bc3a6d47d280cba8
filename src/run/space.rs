//! Distinguishes arms by words of their names.

use super::role::words;

/// Words that identify one arm, and those of others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Space {
    own: Vec<String>,
    others: Vec<String>,
}

/// Which arm a name refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Claim {
    /// Words of a different arm only.
    Foreign,
    /// No distinguishing word.
    Neutral,
    /// A word of this arm.
    Own,
}

impl Space {
    /// For each arm, the words that not all share.
    pub fn of_names<S: AsRef<str>>(names: &[S]) -> Vec<Space> {
        let all: Vec<Vec<String>> = names.iter().map(|name| words(name.as_ref())).collect();
        Self::of_words(&all)
    }

    pub fn of_words(all: &[Vec<String>]) -> Vec<Space> {
        let is_shared = |word: &String| all.iter().all(|words| words.contains(word));
        let telling = |words: &Vec<String>| -> Vec<String> {
            words.iter().filter(|word| !is_shared(word)).cloned().collect()
        };
        let space = |index: usize| {
            let own = telling(&all[index]);
            let others = all.iter().enumerate().filter(|(other, _)| *other != index);
            let others: Vec<String> = others.flat_map(|(_, words)| telling(words)).collect();
            let others = others.into_iter().filter(|word| !own.contains(word)).collect();
            Space { own, others }
        };
        (0..all.len()).map(space).collect()
    }

    /// Arm that names refer to.
    pub fn claim<'n>(&self, names: impl IntoIterator<Item = &'n str>) -> Claim {
        let words: Vec<String> = names.into_iter().flat_map(words).collect();
        let has = |known: &[String]| known.iter().any(|word| words.contains(word));
        match (has(&self.own), has(&self.others)) {
            (true, _) => Claim::Own,
            (false, true) => Claim::Foreign,
            (false, false) => Claim::Neutral,
        }
    }

    pub fn is_one_of_several(&self) -> bool {
        !self.own.is_empty() || !self.others.is_empty()
    }

    pub fn words(&self) -> &[String] {
        &self.own
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
    fn what_all_names_have_tells_nothing() {
        let spaces = Space::of_names(&["/left/joint_states", "/right/joint_states"]);
        assert_eq!(spaces[0].claim(["/left/tcp_pose", ""]), Claim::Own);
        assert_eq!(spaces[1].claim(["/left/tcp_pose"]), Claim::Foreign);
        assert_eq!(spaces[0].claim(["/joint_states_relay", "tool0"]), Claim::Neutral);
    }

    #[test]
    fn an_arm_without_a_word_of_its_own_has_what_is_not_the_others() {
        let spaces = Space::of_names(&["/joint_states", "/leader/joint_states"]);
        assert_eq!(spaces[0].claim(["/leader/pose"]), Claim::Foreign);
        assert_eq!(spaces[0].claim(["/tcp_pose"]), Claim::Neutral);
        assert!(spaces[0].is_one_of_several() && !Space::of_names(&["/a"])[0].is_one_of_several());
    }
}
