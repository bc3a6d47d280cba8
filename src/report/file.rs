use std::fs::{self, Permissions};
use std::io;
use std::path::{Path, PathBuf};

use crate::boundary::Staged;

/// Has `write` fill the file that it is given, which takes its place at `path` once it is whole: who
/// interrupts it finds there what was there before. The folders of `path` are made; what is no
/// regular file, such as a pipe, is written to directly. A link stays, and what it leads to in its own
/// folder is replaced.
///
/// # Errors
/// What `write` returns, or if no file can be made there: where a link leads out of its folder, and where
/// the file that is there is read-only, nothing is.
pub fn write_whole<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let path = replaceable(path)?;
    if path.exists() && (!path.is_file() || is_descriptor(&path)) {
        return write(&path);
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder)?;
    let mut beside = tempfile::Builder::new();
    beside.prefix(".poseaudit-");
    // Who may not read the old one may not read the new one.
    let of_old = fs::metadata(&path).map(|metadata| metadata.permissions()).ok();
    if let Some(permissions) = of_old.or_else(permissions) {
        beside.permissions(permissions);
    }
    let staged = Staged::new(|| Ok(beside.tempfile_in(folder)?.into_temp_path()))?;
    write(&staged)?;
    fs::rename(&*staged, &path)?;
    Ok(())
}

/// The path at which what is written to `path` would be: that of a file which is there already, unless a link
/// leads to it out of its own folder.
///
/// # Errors
/// If a link does, or the file is protected against being written.
pub(crate) fn replaceable(path: &Path) -> io::Result<PathBuf> {
    let Ok(target) = fs::canonicalize(path) else { return Ok(path.to_owned()) };
    if is_descriptor(path) {
        return Ok(path.to_owned());
    }
    let metadata = fs::metadata(&target)?;
    if !metadata.is_file() {
        return Ok(target);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = fs::canonicalize(folder.unwrap_or(Path::new(".")))?;
    if path.is_symlink() && target.parent() != Some(&folder) {
        let target = target.display();
        return Err(io::Error::other(format!("it is a link out of its folder, to {target}")));
    }
    if metadata.permissions().readonly() {
        return Err(io::Error::other("the file there is read-only"));
    }
    Ok(target)
}

/// Whether `path` names what this process has open, as `/dev/stdout` does: that is written to as it is.
pub(crate) fn is_descriptor(path: &Path) -> bool {
    path.starts_with("/dev") || path.starts_with("/proc")
}

/// Those of any new file; a temporary one is its owner's alone.
#[cfg(unix)]
fn permissions() -> Option<Permissions> {
    use std::os::unix::fs::PermissionsExt;
    Some(Permissions::from_mode(0o666))
}

#[cfg(not(unix))]
fn permissions() -> Option<Permissions> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_finished_leaves_the_old_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/report.json");
        write_whole(&path, |staged| fs::write(staged, "old")).unwrap();
        let error = write_whole(&path, |staged| {
            fs::write(staged, "half")?;
            Err(io::Error::other("interrupted"))
        });
        assert_eq!(error.unwrap_err().to_string(), "interrupted");
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_and_others_may_read_the_file() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [file, link, plain] = ["file", "link", "plain"].map(|name| folder.path().join(name));
        fs::write(&plain, "").unwrap();
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        write_whole(&link, |staged| fs::write(staged, "new")).unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&file), mode(&plain));
        fs::set_permissions(&file, Permissions::from_mode(0o600)).unwrap();
        write_whole(&link, |staged| fs::write(staged, "newer")).unwrap();
        assert_eq!(mode(&file), 0o600);
    }

    #[cfg(unix)]
    #[test]
    fn neither_what_a_link_leads_to_elsewhere_nor_what_is_read_only_is_replaced() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [file, link] = ["file", "other/link"].map(|name| folder.path().join(name));
        fs::create_dir(link.parent().unwrap()).unwrap();
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        let refused = |path: &Path| {
            let error: io::Error =
                write_whole(path, |staged| fs::write(staged, "new")).unwrap_err();
            assert_eq!(fs::read_to_string(&file).unwrap(), "old");
            error.to_string()
        };
        assert!(refused(&link).starts_with("it is a link out of its folder, to /"));
        fs::set_permissions(&file, Permissions::from_mode(0o444)).unwrap();
        assert_eq!(refused(&file), "the file there is read-only");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_regular_file_stays_what_it_is() {
        write_whole(Path::new("/dev/null"), |path| fs::write(path, "text")).unwrap();
        assert!(!Path::new("/dev/null").is_file());
    }
}
