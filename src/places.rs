//! Inputs and outputs of a call: no output may overwrite an input or another output. Checked before
//! anything is read.
//!
//! Existing files are identified by device and inode, whatever their links and spelling, new ones by folder
//! and name.

use std::collections::HashSet;
use std::fs::{self, Metadata};
use std::io;
use std::path::{Component, Path, PathBuf};

use crate::log;
use crate::report::{Trouble, is_descriptor, resolve_local_link};

/// Default file name of a config.
pub const CONFIG_FILE_NAME: &str = "poseaudit.toml";

/// Files and folders of a call.
#[derive(Clone, Debug, Default)]
pub struct PathRegistry {
    inputs: Vec<(&'static str, ResolvedPath)>,
    folders: Vec<InputFolder>,
    outputs: Vec<Output>,
}

/// A folder whose files may all be read.
#[derive(Clone, Debug)]
struct InputFolder {
    folder: ResolvedPath,
    content: FolderContent,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FolderContent {
    /// Files in this folder become part of the log.
    Log,
    /// Only existing files are read.
    Meshes,
    /// Fleet results.
    Results,
}

/// A file, or a folder for files.
#[derive(Clone, Debug)]
struct Output {
    option: &'static str,
    place: ResolvedPath,
    kind: OutputKind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OutputKind {
    File,
    /// Folder; its other files are kept.
    Folder,
    /// Reserved for this option.
    Reserved,
}

/// A file that exists or will be created.
#[derive(Clone, Debug)]
struct ResolvedPath {
    given: PathBuf,
    /// Path without links, `.` and `..`.
    path: PathBuf,
    /// If it exists.
    metadata: Option<Metadata>,
}

impl PathRegistry {
    /// Registers an input.
    pub fn add_input(&mut self, what: &'static str, path: &Path) {
        self.inputs.push((what, ResolvedPath::resolve(path)));
    }

    /// Registers a folder of meshes.
    pub fn add_mesh_folder(&mut self, folder: &Path) {
        self.folders.push(InputFolder {
            folder: ResolvedPath::resolve(folder),
            content: FolderContent::Meshes,
        });
    }

    /// Registers fleet results as input.
    pub fn add_results_folder(&mut self, folder: &Path) {
        self.folders.push(InputFolder {
            folder: ResolvedPath::resolve(folder),
            content: FolderContent::Results,
        });
    }

    /// Registers a log: a file with its sidecars, or a folder. Ignores remote objects and a `#episode`
    /// suffix.
    pub fn add_log(&mut self, path: &Path) {
        let Some(path) = log::local(path) else { return };
        let (path, _) = log::split_episode(&path);
        let absolute = std::path::absolute(&path).unwrap_or_else(|_| path.clone());
        let folder =
            path.is_dir().then(|| path.clone()).or_else(|| log::enclosing_dataset(&absolute));
        let is_last = |folder: &PathBuf| {
            self.folders.last().is_some_and(|tree| {
                tree.content == FolderContent::Log && tree.folder.given == *folder
            })
        };
        // Consecutive episodes share a folder.
        let folder = folder.filter(|folder| !is_last(folder));
        let content = FolderContent::Log;
        self.folders.extend(
            folder.map(|folder| InputFolder { folder: ResolvedPath::resolve(&folder), content }),
        );
        for file in log::sidecars(&path) {
            self.add_input("a file of the log", &file);
        }
        self.add_input("the log", &path);
    }

    /// For commands without other outputs: checks stdout and stderr.
    ///
    /// # Errors
    /// If one leads to one of `logs`.
    pub fn check_read_only<'a>(logs: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Trouble> {
        let mut places = Self::default();
        logs.into_iter().for_each(|log| places.add_log(log));
        places.check()
    }

    /// Registers an output file.
    pub fn add_output(&mut self, option: &'static str, path: &Path) {
        self.outputs.push(Output {
            option,
            place: ResolvedPath::resolve(path),
            kind: OutputKind::File,
        });
    }

    /// Registers output files in `folder`.
    pub fn add_outputs_in(
        &mut self,
        option: &'static str,
        folder: &Path,
        names: impl IntoIterator<Item = String>,
    ) {
        self.outputs.push(Output {
            option,
            place: ResolvedPath::resolve(folder),
            kind: OutputKind::Folder,
        });
        names.into_iter().for_each(|name| self.add_output(option, &folder.join(name)));
    }

    /// Reserves `folder` for `option`.
    pub fn reserve_folder(&mut self, option: &'static str, folder: &Path) {
        self.outputs.push(Output {
            option,
            place: ResolvedPath::resolve(folder),
            kind: OutputKind::Reserved,
        });
    }

    /// Checks all outputs, with those that `register` adds.
    ///
    /// # Errors
    /// As [`Self::check`].
    pub fn check_with(&self, register: impl FnOnce(&mut Self)) -> Result<(), Trouble> {
        let mut places = self.clone();
        register(&mut places);
        places.check()
    }

    /// Checks all outputs.
    ///
    /// # Errors
    /// If one would overwrite an input or another output, or cannot be written.
    pub fn check(&self) -> Result<(), Trouble> {
        let standard = [standard_stream_path(&io::stdout()), standard_stream_path(&io::stderr())];
        for stream in standard.iter().flatten() {
            let input = self.inputs.iter().find(|(_, input)| input.is_same_file(stream));
            if let Some((what, input)) = input {
                let why = format!("it is {what} {}, which would be lost", input.given.display());
                return Err(Trouble::call("stdout", why, "send it elsewhere"));
            }
            if let Some(why) = self.folders.iter().find_map(|tree| tree.input_conflict(stream)) {
                return Err(Trouble::call("stdout", why, "send it elsewhere"));
            }
        }
        for (at, output) in self.outputs.iter().enumerate() {
            let Output { option, place, kind } = output;
            let is_file = *kind == OutputKind::File;
            let refuse = |why: &str| {
                let shown = format!("{option} {}", place.given.display());
                Err(Trouble::call(shown, why, format_args!("name another with {option}")))
            };
            if place.is_device() && is_file {
                continue;
            }
            let input = self.inputs.iter().find(|(_, input)| input.is_same_file(place) && is_file);
            if let Some((what, input)) = input {
                let input = input.given.display();
                return refuse(&format!("it is {what} {input}, which would be lost"));
            }
            if let Some(other) = self.outputs[..at].iter().find(|other| other.collides(output)) {
                let (other, path) = (other.option, other.place.given.display());
                return refuse(&format!("{other} {path} is written there too"));
            }
            if let Some(why) = self.folders.iter().find_map(|tree| tree.output_conflict(output)) {
                return refuse(&why);
            }
            if let Err(why) = place.can_be(*kind) {
                return refuse(&why);
            }
            let is_standard = standard.iter().flatten().any(|stream| place.is_same_file(stream));
            if is_standard && is_file && !is_descriptor(&place.given) {
                return refuse("stdout or stderr leads there");
            }
        }
        Ok(())
    }
}

impl InputFolder {
    /// Why `output` may not be written, if so.
    fn output_conflict(&self, output: &Output) -> Option<String> {
        let Output { place, kind, .. } = output;
        let exists = place.metadata.is_some();
        let is_inside = place.path.starts_with(&self.folder.path);
        let folder = self.folder.given.display();
        match self.content {
            _ if exists && *kind == OutputKind::File && self.input_conflict(place).is_some() => {
                self.input_conflict(place)
            }
            // A config next to the log is no part of the log.
            FolderContent::Log
                if place.path.ends_with(CONFIG_FILE_NAME) && *kind == OutputKind::File =>
            {
                None
            }
            FolderContent::Log if is_inside => {
                Some(format!("it is inside the log {folder}, and would become part of it"))
            }
            _ => None,
        }
    }

    /// Why an existing file may not be replaced: it is in the folder, or a link inside leads to it.
    fn input_conflict(&self, place: &ResolvedPath) -> Option<String> {
        let own = place.metadata.as_ref().filter(|metadata| metadata.is_file())?;
        let folder = self.folder.given.display();
        let is_inside = place.path.starts_with(&self.folder.path);
        match self.content {
            FolderContent::Meshes => {
                is_inside.then(|| format!("it is one of the files in --mesh-root {folder}"))
            }
            FolderContent::Log | FolderContent::Results => {
                let what = if self.content == FolderContent::Log {
                    "a file of the log"
                } else {
                    "a table of"
                };
                let holds = || is_inside || contains_file(&self.folder.path, own);
                holds().then(|| format!("it is {what} {folder}, which would be lost"))
            }
        }
    }
}

/// Directly or through a link.
fn contains_file(folder: &Path, file: &Metadata) -> bool {
    let (mut open, mut seen) = (vec![folder.to_owned()], HashSet::new());
    while let Some(folder) = open.pop() {
        // Links may form cycles.
        let Ok(own) = fs::canonicalize(&folder) else { continue };
        if !seen.insert(own) {
            continue;
        }
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            match fs::metadata(entry.path()) {
                Ok(metadata) if metadata.is_dir() => open.push(entry.path()),
                Ok(metadata) if is_same(&metadata, file) => return true,
                _ => {}
            }
        }
    }
    false
}

impl Output {
    fn collides(&self, other: &Self) -> bool {
        let (a, b) = (&self.place, &other.place);
        if a.is_device() || b.is_device() {
            return false;
        }
        let within = |outer: &Self, inner: &Self| {
            outer.kind != OutputKind::Folder && inner.place.path.starts_with(&outer.place.path)
        };
        let are_one =
            self.kind == OutputKind::File && other.kind == OutputKind::File && a.is_same_file(b);
        are_one || within(self, other) || within(other, self)
    }
}

impl ResolvedPath {
    fn resolve(given: &Path) -> Self {
        let path = resolve_links(given);
        let metadata = fs::metadata(&path).ok();
        Self { given: given.to_owned(), path, metadata }
    }

    /// Whether they are the same file.
    fn is_same_file(&self, other: &Self) -> bool {
        let same = self.metadata.as_ref().zip(other.metadata.as_ref());
        self.path == other.path || same.is_some_and(|(a, b)| is_same(a, b))
    }

    /// Such as a pipe: nothing is overwritten.
    fn is_device(&self) -> bool {
        self.metadata.as_ref().is_some_and(|is| !is.is_file() && !is.is_dir())
    }

    fn can_be(&self, kind: OutputKind) -> Result<(), String> {
        let is_folder = self.metadata.as_ref().map(Metadata::is_dir);
        match (kind, is_folder) {
            (OutputKind::File, Some(true)) => return Err("it is a folder".to_owned()),
            (OutputKind::Folder | OutputKind::Reserved, Some(false)) => {
                return Err("it is not a folder".to_owned());
            }
            (OutputKind::File, Some(false)) => {
                resolve_local_link(&self.given).map_err(|error| error.to_string())?;
            }
            _ => {}
        }
        let mut above = self.path.ancestors().skip(1);
        match above.find(|above| above.exists()).filter(|above| !above.is_dir()) {
            Some(above) => Err(format!("{} is not a folder", above.display())),
            None => Ok(()),
        }
    }
}

/// Without links, `.` and `..`, even for a new file.
fn resolve_links(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let known = path.ancestors().find_map(|above| Some((above, fs::canonicalize(above).ok()?)));
    let Some((above, mut resolved)) = known else { return path };
    for part in path.strip_prefix(above).unwrap_or(Path::new("")).components() {
        match part {
            Component::ParentDir => drop(resolved.pop()),
            part => resolved.push(part),
        }
    }
    // `new/..` may resolve to an existing path.
    fs::canonicalize(&resolved).unwrap_or(resolved)
}

#[cfg(unix)]
fn is_same(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn is_same(_: &Metadata, _: &Metadata) -> bool {
    false
}

/// Redirection of a standard stream.
#[cfg(unix)]
fn standard_stream_path(stream: &impl std::os::fd::AsFd) -> Option<ResolvedPath> {
    let file = fs::File::from(stream.as_fd().try_clone_to_owned().ok()?);
    let metadata = file.metadata().ok().filter(Metadata::is_file)?;
    Some(ResolvedPath { given: PathBuf::new(), path: PathBuf::new(), metadata: Some(metadata) })
}

#[cfg(not(unix))]
fn standard_stream_path<T>(_: &T) -> Option<ResolvedPath> {
    None
}
