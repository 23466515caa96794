//! Folders that appear with all their content or not at all.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use tempfile::Builder;

use super::leftovers::{self, BACKUP_SUFFIX, RANDOM_CHAR_COUNT, UNFINISHED_SUFFIX, prefix};
use super::{parent_folder, unfinished};
use crate::error::{Error, Result, cause, io_error};

/// A folder under a temporary name. Dropping it removes the folder and its content.
pub struct UnfinishedTree {
    temp_path: Option<PathBuf>,
    target: PathBuf,
    /// Keeps the folder locked, so that no other process takes it for a leftover.
    _lock: Option<File>,
}

impl UnfinishedTree {
    /// Creates the temporary folder in the parent folder of `target`.
    ///
    /// # Errors
    /// Returns [`Error::Io`] as [`check_tree`] does, or if the folder cannot be created.
    pub fn create(target: &Path, marker: &str) -> Result<Self> {
        check_tree(target, marker)?;
        leftovers::remove_leftovers(parent_folder(target));
        // The process must not end between creating the folder and recording it.
        let mut paths = unfinished::unfinished_paths();
        let temporary = unused_name(target, UNFINISHED_SUFFIX)
            .and_then(|path| fs::create_dir(&path).map(|()| path))
            .map_err(|error| io_error(target, "make the folder", error))?;
        // The lock is best effort: not every system can lock folders.
        let lock = File::open(&temporary)
            .ok()
            .filter(|file| file.try_lock().is_ok());
        paths.trees.insert(temporary.clone());
        Ok(Self {
            temp_path: Some(temporary),
            target: target.to_path_buf(),
            _lock: lock,
        })
    }

    /// Returns the path under which the folder is filled.
    pub fn path(&self) -> &Path {
        self.temp_path.as_deref().unwrap_or(&self.target)
    }

    /// Returns the final path of the folder.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Renames the folder to its final name. A folder that has this name already is kept as a
    /// backup until the result is dropped.
    ///
    /// # Errors
    /// Returns [`Error::Io`] with the error of the operating system if a rename fails.
    pub fn commit(mut self, paths: &mut unfinished::UnfinishedPaths) -> Result<CommittedTree> {
        let write_error = |error| io_error(&self.target, "write", error);
        let mut committed = CommittedTree {
            target: self.target.clone(),
            backup: None,
        };
        if self.target.exists() {
            let backup = unused_name(&self.target, BACKUP_SUFFIX).map_err(write_error)?;
            fs::rename(&self.target, &backup).map_err(write_error)?;
            committed.backup = Some(backup);
        }
        let Some(temporary) = self.temp_path.take() else {
            return Ok(committed);
        };
        paths.trees.remove(&temporary);
        match fs::rename(&temporary, &self.target) {
            Ok(()) => Ok(committed),
            Err(error) => {
                drop(fs::remove_dir_all(temporary));
                if let Some(backup) = committed.backup.take() {
                    drop(fs::rename(backup, &self.target));
                }
                Err(write_error(error))
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

/// A folder that has taken its final name, and a backup of the folder that it replaced, which is
/// removed when this is dropped.
pub struct CommittedTree {
    target: PathBuf,
    backup: Option<PathBuf>,
}

impl CommittedTree {
    /// Restores the folder that was replaced.
    pub fn undo(mut self) {
        // Nothing useful can be done if this fails: the first error is the one to report.
        drop(fs::remove_dir_all(&self.target));
        if let Some(backup) = self.backup.take() {
            drop(fs::rename(backup, &self.target));
        }
    }
}

impl Drop for CommittedTree {
    fn drop(&mut self) {
        if let Some(backup) = self.backup.take() {
            drop(fs::remove_dir_all(backup));
        }
    }
}

/// Returns a name in the target's folder that does not exist yet.
fn unused_name(target: &Path, suffix: &str) -> std::io::Result<PathBuf> {
    let prefix = prefix(target);
    let mut builder = Builder::new();
    builder
        .prefix(&prefix)
        .suffix(suffix)
        .rand_bytes(RANDOM_CHAR_COUNT);
    let refuse_existing = |path: &Path| {
        if path.exists() {
            Err(std::io::ErrorKind::AlreadyExists.into())
        } else {
            Ok(path.to_path_buf())
        }
    };
    // Nothing is created: only the path is needed.
    Ok(builder
        .make_in(parent_folder(target), refuse_existing)?
        .into_parts()
        .0)
}

/// Checks that a folder could be written at `path`: its parent folder exists, and at `path` is
/// nothing, an empty folder, or a folder of the same kind, which contains the file `marker`.
///
/// # Errors
/// Returns [`Error::Io`] with the name of the missing folder or of what is in the way.
pub fn check_tree(path: &Path, marker: &str) -> Result<()> {
    let folder = parent_folder(path);
    if !folder.is_dir() {
        let problem = format!("the folder {} does not exist", folder.display());
        let remedy = "create it, or write elsewhere";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    let is_empty = || fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    if path.exists() && !path.join(marker).is_file() && !is_empty() {
        let problem = format!("exists already and contains no {marker}");
        let remedy = "remove it, or give another name";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    Ok(())
}
