use std::fs::{self, Permissions};
use std::io;
use std::path::Path;

/// Has `write` fill the file that it is given, which takes its place at `path` once it is whole: who
/// interrupts it finds there what was there before. The folders of `path` are made; what is no
/// regular file, such as a pipe, is written to directly.
///
/// # Errors
/// What `write` returns, or if no file can be made there.
pub fn write_whole<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    // A link stays, and what it leads to is replaced.
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if path.exists() && !path.is_file() {
        return write(&path);
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder)?;
    let mut beside = tempfile::Builder::new();
    beside.prefix(".poseaudit-");
    if let Some(permissions) = permissions() {
        beside.permissions(permissions);
    }
    let staged = beside.tempfile_in(folder)?.into_temp_path();
    write(&staged)?;
    staged.persist(&path).map_err(|error| error.error)?;
    Ok(())
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
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&file), mode(&plain));
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_regular_file_stays_what_it_is() {
        write_whole(Path::new("/dev/null"), |path| fs::write(path, "text")).unwrap();
        assert!(!Path::new("/dev/null").is_file());
    }
}
