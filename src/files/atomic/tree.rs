//! Folders that appear whole or not at all.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use tempfile::Builder;

use super::leftovers::{self, BACKUP_SUFFIX, RANDOM_CHAR_COUNT, UNFINISHED_SUFFIX, prefix};
use super::{parent_folder, unfinished};
use crate::error::{Error, Result, cause, io_error};

/// A folder under a temporary name, which is removed with all that is in it when dropped.
pub struct UnfinishedTree {
    temp_path: Option<PathBuf>,
    target: PathBuf,
    /// Keeps it locked: whoever finds it knows that it is not left over.
    _lock: Option<File>,
}

impl UnfinishedTree {
    /// Beside its target, to be filled.
    ///
    /// # Errors
    /// As [`check_tree`], or if it cannot be made.
    pub fn create(target: &Path, file: &str) -> Result<Self> {
        check_tree(target, file)?;
        leftovers::remove_leftovers(parent_folder(target));
        // Not between the folder and the note of it may the process end.
        let mut all = unfinished::unfinished_paths();
        let temporary = unused_name(target, UNFINISHED_SUFFIX)
            .and_then(|path| fs::create_dir(&path).map(|()| path))
            .map_err(|error| io_error(target, "make the folder", error))?;
        // Best effort: not everywhere can folders be locked.
        let lock = File::open(&temporary)
            .ok()
            .filter(|file| file.try_lock().is_ok());
        all.trees.insert(temporary.clone());
        Ok(Self {
            temp_path: Some(temporary),
            target: target.to_path_buf(),
            _lock: lock,
        })
    }

    /// Where it is filled.
    pub fn path(&self) -> &Path {
        self.temp_path.as_deref().unwrap_or(&self.target)
    }

    /// What it will be called.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Takes its name; what had it before is kept until the result is dropped.
    ///
    /// # Errors
    /// What the operating system reports.
    pub fn commit(mut self, all: &mut unfinished::UnfinishedPaths) -> Result<CommittedTree> {
        let failed = |error| io_error(&self.target, "write", error);
        let mut placed = CommittedTree {
            target: self.target.clone(),
            backup: None,
        };
        if self.target.exists() {
            let before = unused_name(&self.target, BACKUP_SUFFIX).map_err(failed)?;
            fs::rename(&self.target, &before).map_err(failed)?;
            placed.backup = Some(before);
        }
        let Some(temporary) = self.temp_path.take() else {
            return Ok(placed);
        };
        all.trees.remove(&temporary);
        match fs::rename(&temporary, &self.target) {
            Ok(()) => Ok(placed),
            Err(error) => {
                drop(fs::remove_dir_all(temporary));
                if let Some(before) = placed.backup.take() {
                    drop(fs::rename(before, &self.target));
                }
                Err(failed(error))
            }
        }
    }
}

impl Drop for UnfinishedTree {
    fn drop(&mut self) {
        if let Some(temporary) = self.temp_path.take() {
            unfinished::unfinished_paths().trees.remove(&temporary);
            drop(fs::remove_dir_all(temporary));
        }
    }
}

/// A folder that has taken its name, and what had that before, which is removed when this is dropped.
pub struct CommittedTree {
    target: PathBuf,
    backup: Option<PathBuf>,
}

impl CommittedTree {
    /// Gives the name back to what had it.
    pub fn undo(mut self) {
        // Nothing useful can be done if this fails: the first error is the one to report.
        drop(fs::remove_dir_all(&self.target));
        if let Some(before) = self.backup.take() {
            drop(fs::rename(before, &self.target));
        }
    }
}

impl Drop for CommittedTree {
    fn drop(&mut self) {
        if let Some(before) = self.backup.take() {
            drop(fs::remove_dir_all(before));
        }
    }
}

/// A name beside a target that nothing has.
fn unused_name(target: &Path, suffix: &str) -> std::io::Result<PathBuf> {
    let prefix = prefix(target);
    let mut builder = Builder::new();
    builder
        .prefix(&prefix)
        .suffix(suffix)
        .rand_bytes(RANDOM_CHAR_COUNT);
    let free = |path: &Path| match path.exists() {
        true => Err(std::io::ErrorKind::AlreadyExists.into()),
        false => Ok(path.to_path_buf()),
    };
    // Nothing is made: the path alone is wanted.
    Ok(builder.make_in(parent_folder(target), free)?.into_parts().0)
}

/// Checks that a folder could be written at `path`: its own folder exists, and nothing is there but what is
/// such a folder already, one that holds `file`, or is empty.
///
/// # Errors
/// [`Error::Io`] that names what is in the way.
pub fn check_tree(path: &Path, file: &str) -> Result<()> {
    let folder = parent_folder(path);
    if !folder.is_dir() {
        let problem = format!("the folder {} does not exist", folder.display());
        let remedy = "create it, or write elsewhere";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    let is_empty = || fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    if path.exists() && !path.join(file).is_file() && !is_empty() {
        let problem = format!("is there already and holds no {file}");
        let remedy = "remove it, or give another name";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    Ok(())
}
