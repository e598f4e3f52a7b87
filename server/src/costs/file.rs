//! A cost model as a file: where it lies, read with limits, written whole or not at all.

use super::CostModel;
use crate::scene::Scene;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Longer than any table we write.
const MAX_BYTES: u64 = 1 << 20;

/// Why there is no cost model.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// The operating system says no.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why not.
        source: io::Error,
    },
    /// It is no cost model, or one of another version.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: String,
        /// Field, what was expected and what was found.
        reason: String,
    },
}

/// The place of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CostFile {
    path: PathBuf,
}

impl CostFile {
    /// At this path.
    pub fn at(path: PathBuf) -> CostFile {
        CostFile { path }
    }

    /// Beside a scene file; of a built-in scene in the user's cache, if there is one.
    pub fn beside(scene: &str) -> Option<CostFile> {
        if !Scene::built_in_names().contains(&scene) {
            return Some(CostFile::at(PathBuf::from(format!("{scene}.cost.json"))));
        }
        let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let cache = absolute("XDG_CACHE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".cache")))?;
        Some(CostFile::at(cache.join("warplight").join(format!("{scene}.cost.json"))))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is a file.
    pub fn exists(&self) -> bool {
        self.path.is_file()
    }

    /// Reads it.
    ///
    /// # Errors
    /// What the operating system says, or what is wrong with it in one line that names file and field.
    pub fn read(&self) -> Result<CostModel, CostError> {
        let path = || self.path.display().to_string();
        let io = |source| CostError::Io { path: path(), source };
        let mut text = String::new();
        let file = std::fs::File::open(&self.path).map_err(io)?;
        file.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(io)?;
        if text.len() as u64 > MAX_BYTES {
            let reason = format!("expected a cost model of at most {MAX_BYTES} bytes");
            return Err(CostError::Malformed { path: path(), reason });
        }
        CostModel::from_json(&text).map_err(|reason| CostError::Malformed { path: path(), reason })
    }

    /// Writes it, with the folder it lies in.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write(&self, model: &CostModel) -> Result<(), CostError> {
        let io = |source| CostError::Io { path: self.path.display().to_string(), source };
        let mut text = serde_json::to_string_pretty(model).map_err(|error| io(io::Error::other(error)))?;
        text.push('\n');
        if let Some(folder) = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        write_whole(&self.path, text.as_bytes()).map_err(io)
    }
}

/// Writes `bytes` beside `path` and renames: a reader sees the old file or the new one, never a part.
///
/// # Errors
/// What the operating system says; the file beside is removed.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // The process number keeps two programs that write to one folder apart.
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}.part", std::process::id()));
    let beside = Path::new(&beside);
    let written = std::fs::write(beside, bytes).and_then(|()| std::fs::rename(beside, path));
    if written.is_err() {
        let _ = std::fs::remove_file(beside);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::super::tests::model;
    use super::*;

    #[test]
    fn a_model_comes_back_as_it_was_written_and_its_folder_is_made() {
        let folder = tempfile::tempdir().unwrap();
        let file = CostFile::at(folder.path().join("deep/er/s.cost.json"));
        assert!(!file.exists());
        file.write(&model()).unwrap();
        assert_eq!(file.read().unwrap(), model());
        let beside = std::fs::read_dir(file.path().parent().unwrap()).unwrap().count();
        assert_eq!(beside, 1, "nothing is left beside it");
    }

    #[test]
    fn a_damaged_model_is_refused_in_one_line_that_names_file_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.cost.json");
        let file = CostFile::at(path.clone());
        assert!(matches!(file.read(), Err(CostError::Io { .. })));
        let good = serde_json::to_string(&model()).unwrap();
        // Cut anywhere it is refused, and nothing panics.
        for end in 0..good.len() {
            std::fs::write(&path, &good[..end]).unwrap();
            assert!(file.read().is_err(), "cut after {end} bytes");
        }
        for (from, to, field) in [
            ("\"schema\":1", "\"schema\":2", "schema"),
            ("\"pixels\":1000", "\"pixels\":0", "display.pixels"),
            ("\"time_ms\":2.0", "\"time_ms\":-2.0", "coarse"),
            ("\"time_ms\":2.0", "\"time_ms\":\"soon\"", "string"),
            ("\"error\":0.2", "\"error\":-0.2", "coarse"),
            ("\"machine\"", "\"engine\"", "engine"),
        ] {
            assert!(good.contains(from), "{from}");
            std::fs::write(&path, good.replace(from, to)).unwrap();
            let told = file.read().unwrap_err().to_string();
            assert!(told.contains("bad.cost.json") && told.contains(field) && !told.contains('\n'), "{to}: {told}");
        }
        std::fs::write(&path, vec![b' '; (MAX_BYTES + 1) as usize]).unwrap();
        assert!(file.read().unwrap_err().to_string().contains("at most"));
        std::fs::write(&path, [0xff, 0xfe]).unwrap();
        assert!(file.read().is_err());
    }

    #[test]
    fn the_model_of_a_scene_file_lies_beside_it() {
        let beside = CostFile::beside("some/scene.toml").unwrap();
        assert_eq!(beside.path(), Path::new("some/scene.toml.cost.json"));
        if let Some(cached) = CostFile::beside("gallery") {
            assert!(cached.path().ends_with("warplight/gallery.cost.json"));
        }
    }
}
