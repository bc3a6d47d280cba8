//! Inputs and outputs of a call: no output may overwrite an input or another output. Checked before
//! anything is read.
//!
//! Existing files are identified by device and inode, whatever their links and spelling, new ones by folder
//! and name.

use std::collections::HashSet;
use std::fs::{self, Metadata};
use std::io;
use std::path::{Component, Path, PathBuf};

use crate::config::FILE_NAME;
use crate::log;
use crate::report::{Trouble, TroubleKind, is_descriptor, resolve_local_link};

/// Files and folders of a call.
#[derive(Clone, Debug, Default)]
pub struct Places {
    inputs: Vec<(&'static str, Place)>,
    trees: Vec<Tree>,
    outputs: Vec<Output>,
}

/// A folder whose files may all be read.
#[derive(Clone, Debug)]
struct Tree {
    folder: Place,
    content: Content,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
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
    place: Place,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    File,
    /// Folder; its other files are kept.
    Folder,
    /// Reserved for this option.
    Own,
}

/// A file that exists or will be created.
#[derive(Clone, Debug)]
struct Place {
    given: PathBuf,
    /// Path without links, `.` and `..`.
    path: PathBuf,
    /// If it exists.
    metadata: Option<Metadata>,
}

impl Places {
    /// Registers an input.
    pub fn reads(&mut self, what: &'static str, path: &Path) {
        self.inputs.push((what, Place::of(path)));
    }

    /// Registers a folder of meshes.
    pub fn reads_below(&mut self, folder: &Path) {
        self.trees.push(Tree { folder: Place::of(folder), content: Content::Meshes });
    }

    /// Registers fleet results as input.
    pub fn reads_results(&mut self, folder: &Path) {
        self.trees.push(Tree { folder: Place::of(folder), content: Content::Results });
    }

    /// Registers a log: a file with its sidecars, or a folder. Ignores remote objects and a `#episode`
    /// suffix.
    pub fn reads_log(&mut self, path: &Path) {
        let Some(path) = log::local(path) else { return };
        let (path, _) = log::split_episode(&path);
        let absolute = std::path::absolute(&path).unwrap_or_else(|_| path.clone());
        let folder =
            path.is_dir().then(|| path.clone()).or_else(|| log::enclosing_dataset(&absolute));
        let is_last = |folder: &PathBuf| {
            self.trees
                .last()
                .is_some_and(|tree| tree.content == Content::Log && tree.folder.given == *folder)
        };
        // Consecutive episodes share a folder.
        let folder = folder.filter(|folder| !is_last(folder));
        let content = Content::Log;
        self.trees.extend(folder.map(|folder| Tree { folder: Place::of(&folder), content }));
        for file in log::sidecars(&path) {
            self.reads("a file of the log", &file);
        }
        self.reads("the log", &path);
    }

    /// For commands without other outputs: checks stdout and stderr.
    ///
    /// # Errors
    /// If one leads to one of `logs`.
    pub fn only_read<'a>(logs: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Trouble> {
        let mut places = Self::default();
        logs.into_iter().for_each(|log| places.reads_log(log));
        places.check()
    }

    /// Registers an output file.
    pub fn writes(&mut self, option: &'static str, path: &Path) {
        self.outputs.push(Output { option, place: Place::of(path), kind: Kind::File });
    }

    /// Registers output files in `folder`.
    pub fn writes_into(
        &mut self,
        option: &'static str,
        folder: &Path,
        names: impl IntoIterator<Item = String>,
    ) {
        self.outputs.push(Output { option, place: Place::of(folder), kind: Kind::Folder });
        names.into_iter().for_each(|name| self.writes(option, &folder.join(name)));
    }

    /// Reserves `folder` for `option`.
    pub fn keeps(&mut self, option: &'static str, folder: &Path) {
        self.outputs.push(Output { option, place: Place::of(folder), kind: Kind::Own });
    }

    /// Checks all outputs.
    ///
    /// # Errors
    /// If one would overwrite an input or another output, or cannot be written.
    pub fn check(&self) -> Result<(), Trouble> {
        let standard = [standard(&io::stdout()), standard(&io::stderr())];
        for stream in standard.iter().flatten() {
            let input = self.inputs.iter().find(|(_, input)| input.is(stream));
            if let Some((what, input)) = input {
                let why = format!("it is {what} {}, which would be lost", input.given.display());
                return Err(refused("stdout", &why, "send it elsewhere"));
            }
            if let Some(why) = self.trees.iter().find_map(|tree| tree.loses(stream)) {
                return Err(refused("stdout", &why, "send it elsewhere"));
            }
        }
        for (at, output) in self.outputs.iter().enumerate() {
            let Output { option, place, kind } = output;
            let is_file = *kind == Kind::File;
            let refuse = |why: &str| {
                let shown = format!("{option} {}", place.given.display());
                Err(refused(&shown, why, &format!("name another with {option}")))
            };
            if place.is_device() && is_file {
                continue;
            }
            let input = self.inputs.iter().find(|(_, input)| input.is(place) && is_file);
            if let Some((what, input)) = input {
                let input = input.given.display();
                return refuse(&format!("it is {what} {input}, which would be lost"));
            }
            if let Some(other) = self.outputs[..at].iter().find(|other| other.collides(output)) {
                let (other, path) = (other.option, other.place.given.display());
                return refuse(&format!("{other} {path} is written there too"));
            }
            if let Some(why) = self.trees.iter().find_map(|tree| tree.refuses(output)) {
                return refuse(&why);
            }
            if let Err(why) = place.can_be(*kind) {
                return refuse(&why);
            }
            let is_standard = standard.iter().flatten().any(|stream| place.is(stream));
            if is_standard && is_file && !is_descriptor(&place.given) {
                return refuse("stdout or stderr leads there");
            }
        }
        Ok(())
    }
}

impl Tree {
    /// Why `output` may not be written, if so.
    fn refuses(&self, output: &Output) -> Option<String> {
        let Output { place, kind, .. } = output;
        let exists = place.metadata.is_some();
        let is_inside = place.path.starts_with(&self.folder.path);
        let folder = self.folder.given.display();
        match self.content {
            _ if exists && *kind == Kind::File && self.loses(place).is_some() => self.loses(place),
            // A config next to the log is no part of the log.
            Content::Log if place.path.ends_with(FILE_NAME) && *kind == Kind::File => None,
            Content::Log if is_inside => {
                Some(format!("it is inside the log {folder}, and would become part of it"))
            }
            _ => None,
        }
    }

    /// Why an existing file may not be replaced: it is in the folder, or a link inside leads to it.
    fn loses(&self, place: &Place) -> Option<String> {
        let own = place.metadata.as_ref().filter(|metadata| metadata.is_file())?;
        let folder = self.folder.given.display();
        let is_inside = place.path.starts_with(&self.folder.path);
        match self.content {
            Content::Meshes => {
                is_inside.then(|| format!("it is one of the files in --mesh-root {folder}"))
            }
            Content::Log | Content::Results => {
                let what =
                    if self.content == Content::Log { "a file of the log" } else { "a table of" };
                let holds = || is_inside || holds(&self.folder.path, own);
                holds().then(|| format!("it is {what} {folder}, which would be lost"))
            }
        }
    }
}

/// Directly or through a link.
fn holds(folder: &Path, file: &Metadata) -> bool {
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
            outer.kind != Kind::Folder && inner.place.path.starts_with(&outer.place.path)
        };
        let are_one = self.kind == Kind::File && other.kind == Kind::File && a.is(b);
        are_one || within(self, other) || within(other, self)
    }
}

impl Place {
    fn of(given: &Path) -> Self {
        let path = resolved(given);
        let metadata = fs::metadata(&path).ok();
        Self { given: given.to_owned(), path, metadata }
    }

    /// Whether they are the same file.
    fn is(&self, other: &Self) -> bool {
        let same = self.metadata.as_ref().zip(other.metadata.as_ref());
        self.path == other.path || same.is_some_and(|(a, b)| is_same(a, b))
    }

    /// Such as a pipe: nothing is overwritten.
    fn is_device(&self) -> bool {
        self.metadata.as_ref().is_some_and(|is| !is.is_file() && !is.is_dir())
    }

    fn can_be(&self, kind: Kind) -> Result<(), String> {
        let is_folder = self.metadata.as_ref().map(Metadata::is_dir);
        match (kind, is_folder) {
            (Kind::File, Some(true)) => return Err("it is a folder".to_owned()),
            (Kind::Folder | Kind::Own, Some(false)) => return Err("it is not a folder".to_owned()),
            (Kind::File, Some(false)) => {
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
fn resolved(path: &Path) -> PathBuf {
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
fn standard(stream: &impl std::os::fd::AsFd) -> Option<Place> {
    let file = fs::File::from(stream.as_fd().try_clone_to_owned().ok()?);
    let metadata = file.metadata().ok().filter(Metadata::is_file)?;
    Some(Place { given: PathBuf::new(), path: PathBuf::new(), metadata: Some(metadata) })
}

#[cfg(not(unix))]
fn standard<T>(_: &T) -> Option<Place> {
    None
}

fn refused(place: &str, what: &str, remedy: &str) -> Trouble {
    let (place, what, remedy) = (place.to_owned(), what.to_owned(), remedy.to_owned());
    Trouble { kind: TroubleKind::Call, what, place, remedy }
}
