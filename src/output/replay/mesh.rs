use std::fs;
use std::path::{Path, PathBuf};

use re_sdk_types::components::MediaType;

/// Unit: bytes.
const MAX_BYTES: u64 = 64 << 20;

#[derive(Debug)]
pub(super) struct Mesh {
    pub bytes: Vec<u8>,
    pub media_type: &'static str,
}

#[derive(Debug, PartialEq, Eq)]
pub(super) enum MeshError {
    /// No such file below the mesh folders.
    NotFound,
    /// The viewer cannot read it.
    Unreadable(String),
}

impl Mesh {
    /// Only files below `roots` are read: a log may name any file.
    ///
    /// # Errors
    /// If the mesh is not found, or not supported by the viewer.
    pub fn find(uri: &str, roots: &[PathBuf]) -> Result<Self, MeshError> {
        let place = candidate_paths(uri, roots).into_iter().find(|place| place.is_file());
        let place = place.ok_or(MeshError::NotFound)?;
        let unreadable = |error: std::io::Error| MeshError::Unreadable(error.to_string());
        if fs::metadata(&place).map_err(unreadable)?.len() > MAX_BYTES {
            return Err(MeshError::Unreadable(format!(
                "it is larger than {} MiB",
                MAX_BYTES >> 20
            )));
        }
        let bytes = fs::read(&place).map_err(unreadable)?;
        let media_type = media_type(&place, &bytes)?;
        Ok(Self { bytes, media_type })
    }

    pub fn is_coloured(&self) -> bool {
        self.media_type != MediaType::STL
    }
}

/// Candidate paths, likeliest first: below each folder the whole path, then without leading components. A
/// folder may be the package, contain packages, or be an installation prefix.
fn candidate_paths(uri: &str, roots: &[PathBuf]) -> Vec<PathBuf> {
    let path = uri.split_once("://").map_or(uri, |(_, path)| path);
    let parts = path.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".");
    let parts: Vec<&str> = parts.collect();
    if parts.iter().any(|part| *part == ".." || part.contains(':')) {
        return Vec::new();
    }
    let ends = (0..parts.len()).map(|from| parts[from..].iter().collect::<PathBuf>());
    let places = ends.flat_map(|end| {
        roots.iter().flat_map(move |root| [root.join(&end), root.join("share").join(&end)])
    });
    places.collect()
}

/// Uses the extension, because most formats have no signature, and checks the content briefly.
fn media_type(place: &Path, bytes: &[u8]) -> Result<&'static str, MeshError> {
    let kind = place.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let begins_with = |mark: &str| {
        let beginning = &bytes[..bytes.len().min(4096)];
        beginning.windows(mark.len()).any(|window| window == mark.as_bytes())
    };
    let (media_type, is_one) = match kind.as_str() {
        // 80 arbitrary bytes, then the number of triangles.
        "stl" => (MediaType::STL, bytes.len() >= 84 || begins_with("solid")),
        "obj" => (MediaType::OBJ, bytes.starts_with(b"v ") || begins_with("\nv ")),
        "glb" => (MediaType::GLB, bytes.starts_with(b"glTF")),
        "dae" => (MediaType::DAE, begins_with("<COLLADA")),
        _ => {
            return Err(MeshError::Unreadable("the viewer reads STL, OBJ, GLB and DAE".to_owned()));
        }
    };
    let is_none =
        || MeshError::Unreadable(format!("it is not a valid {} file", kind.to_ascii_uppercase()));
    is_one.then_some(media_type).ok_or_else(is_none)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Outcome = Result<(), Box<dyn std::error::Error>>;

    const OBJ: &str = "# a triangle\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

    #[test]
    fn a_folder_may_be_the_package_its_parent_or_its_installation() -> Outcome {
        let uri = "package://my_arm/meshes/link.obj";
        for (at, root) in [
            ("my_arm/meshes/link.obj", ""),
            ("share/my_arm/meshes/link.obj", ""),
            ("some_name/meshes/link.obj", "some_name"),
            ("flat/link.obj", "flat"),
        ] {
            let folder = tempfile::tempdir()?;
            let file = folder.path().join(at);
            fs::create_dir_all(file.parent().ok_or("a folder")?)?;
            fs::write(&file, OBJ)?;
            let mesh = Mesh::find(uri, &[folder.path().join("nowhere"), folder.path().join(root)]);
            assert_eq!(mesh.map(|mesh| mesh.media_type), Ok(MediaType::OBJ), "{at}");
        }
        Ok(())
    }

    #[test]
    fn the_file_with_the_longer_matching_path_is_used() -> Outcome {
        let folder = tempfile::tempdir()?;
        fs::create_dir_all(folder.path().join("visual"))?;
        fs::write(folder.path().join("link.obj"), "v 9 9 9\n")?;
        fs::write(folder.path().join("visual/link.obj"), OBJ)?;
        let mesh = Mesh::find("package://a/visual/link.obj", &[folder.path().to_owned()]);
        assert_eq!(mesh.map(|mesh| mesh.bytes), Ok(OBJ.into()));
        Ok(())
    }

    #[test]
    fn no_file_outside_the_folders_is_read() -> Outcome {
        let folder = tempfile::tempdir()?;
        fs::create_dir(folder.path().join("in"))?;
        fs::write(folder.path().join("secret.obj"), OBJ)?;
        let roots = [folder.path().join("in")];
        let absolute = folder.path().join("secret.obj").display().to_string();
        for uri in ["../secret.obj", "package://a/../../secret.obj", &absolute] {
            assert_eq!(Mesh::find(uri, &roots).map(|_| ()), Err(MeshError::NotFound), "{uri}");
        }
        assert_eq!(Mesh::find(&absolute, &[]).map(|_| ()), Err(MeshError::NotFound));
        Ok(())
    }

    #[test]
    fn unsupported_formats_are_reported() -> Outcome {
        let folder = tempfile::tempdir()?;
        for (name, content, why) in [
            ("a.3ds", OBJ, "the viewer reads STL, OBJ, GLB and DAE"),
            ("a.dae", OBJ, "it is not a valid DAE file"),
            ("a.glb", "", "it is not a valid GLB file"),
            ("a.stl", "short", "it is not a valid STL file"),
        ] {
            fs::write(folder.path().join(name), content)?;
            let found = Mesh::find(name, &[folder.path().to_owned()]);
            assert_eq!(found.map(|_| ()), Err(MeshError::Unreadable(why.to_owned())), "{name}");
        }
        Ok(())
    }
}
