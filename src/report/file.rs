use std::fs::{self, Permissions};
use std::io;
use std::path::{Path, PathBuf};

use crate::boundary::StagedFile;

/// Writes a temporary file and moves it to `path` when complete, so an interruption keeps the old file.
/// Creates the parent folders. Writes directly to pipes and the like. Keeps a symbolic link and replaces
/// its target.
///
/// # Errors
/// If `write` fails, the file cannot be created or is read-only, or a link points outside its folder.
pub fn write_whole<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let path = resolve_local_link(path)?;
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
    let of_old = fs::metadata(&path).map(|metadata| metadata.permissions()).ok();
    if let Some(permissions) = of_old.or_else(permissions) {
        beside.permissions(permissions);
    }
    let staged = StagedFile::new(|| Ok(beside.tempfile_in(folder)?.into_temp_path()))?;
    write(&staged)?;
    fs::rename(&*staged, &path)?;
    Ok(())
}

/// Follows a link within the same folder.
///
/// # Errors
/// If the link points outside its folder, or if the file is read-only.
pub(crate) fn resolve_local_link(path: &Path) -> io::Result<PathBuf> {
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
        return Err(io::Error::other(format!(
            "it is a symbolic link to {target}, outside its folder"
        )));
    }
    if metadata.permissions().readonly() {
        return Err(io::Error::other("the file there is read-only"));
    }
    Ok(target)
}

/// Such as `/dev/stdout`: written directly.
pub(crate) fn is_descriptor(path: &Path) -> bool {
    path.starts_with("/dev") || path.starts_with("/proc")
}

/// Temporary files are accessible to the owner only.
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
    fn an_incomplete_write_keeps_the_old_file() {
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
    fn a_link_is_kept_and_the_file_is_readable_by_others() {
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
    fn targets_of_foreign_links_and_read_only_files_are_kept() {
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
        assert!(refused(&link).starts_with("it is a symbolic link to /"));
        fs::set_permissions(&file, Permissions::from_mode(0o444)).unwrap();
        assert_eq!(refused(&file), "the file there is read-only");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn special_files_are_not_replaced() {
        write_whole(Path::new("/dev/null"), |path| fs::write(path, "text")).unwrap();
        assert!(!Path::new("/dev/null").is_file());
    }
}
