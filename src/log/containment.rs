//! Files of folder logs. Links out of the folder are not followed: a downloaded log must not expose other
//! files.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

pub(super) const LINK_LEADS_OUTSIDE: &str = "is a link out of the log folder and is not followed; copy its target \
    into the folder";

#[derive(Debug)]
pub(super) struct Containment {
    root: Option<PathBuf>,
    folders: HashMap<PathBuf, bool>,
}

impl Containment {
    pub(super) fn new(folder: &Path) -> Self {
        let root = fs::canonicalize(folder).ok();
        let root = root.map(|root| hub_repository(&root).unwrap_or(root));
        Self { root, folders: HashMap::new() }
    }

    /// Whether the file at `path` is inside the folder or does not exist.
    pub(super) fn holds(&mut self, path: &Path) -> bool {
        let Some(root) = &self.root else { return true };
        let is_inside =
            |path: &Path| fs::canonicalize(path).is_ok_and(|path| path.starts_with(root));
        match fs::symlink_metadata(path) {
            Ok(metadata) if metadata.is_symlink() => is_inside(path),
            Ok(_) => {
                let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty())
                else {
                    return true;
                };
                if let Some(known) = self.folders.get(parent) {
                    return *known;
                }
                let found = is_inside(parent);
                self.folders.insert(parent.to_owned(), found);
                found
            }
            Err(_) => true,
        }
    }
}

/// Repository folder in the Hugging Face hub cache, whose snapshots link into `blobs` (huggingface_hub,
/// "Understand caching").
fn hub_repository(snapshot: &Path) -> Option<PathBuf> {
    let snapshots = snapshot.parent().filter(|above| above.ends_with("snapshots"))?;
    let repository = snapshots.parent()?;
    repository.join("blobs").is_dir().then(|| repository.to_owned())
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn links_within_the_folder_are_followed_and_others_are_not() {
        let home = tempfile::tempdir().expect("a folder");
        let at = |name: &str| home.path().join(name);
        for folder in ["log/inside", "other", "repo/snapshots/1/data", "repo/blobs"] {
            fs::create_dir_all(at(folder)).expect("a folder");
        }
        for file in ["log/inside/a", "other/b", "repo/blobs/c"] {
            fs::write(at(file), "x").expect("a file");
        }
        for (to, link) in [
            ("log/inside/a", "log/near"),
            ("other/b", "log/far"),
            ("other", "log/folder"),
            ("repo/blobs/c", "repo/snapshots/1/data/c"),
            ("other/b", "repo/snapshots/1/data/b"),
        ] {
            symlink(at(to), at(link)).expect("a link");
        }
        let mut log = Containment::new(&at("log"));
        for (file, holds) in [
            ("log/inside/a", true),
            ("log/near", true),
            ("log/none", true),
            ("log/far", false),
            ("log/folder/b", false),
        ] {
            assert_eq!(log.holds(&at(file)), holds, "{file}");
        }
        let mut snapshot = Containment::new(&at("repo/snapshots/1"));
        assert!(snapshot.holds(&at("repo/snapshots/1/data/c")));
        assert!(!snapshot.holds(&at("repo/snapshots/1/data/b")));
    }
}
