//! Files that take their names, and can give them back.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

use super::leftovers::{BACKUP_SUFFIX, RANDOM_CHAR_COUNT, prefix};
use super::parent_folder;
use crate::error::{Result, io_error};

/// A file that has taken its name, and what had that name before.
pub struct CommittedFile {
    path: PathBuf,
    /// Removed when dropped.
    backup: Option<TempPath>,
    /// Keeps that locked, so that no other process takes it for one left over.
    _lock: Option<File>,
}

impl CommittedFile {
    /// Lets a temporary file take its name; with `keep`, what had it before is kept until this is dropped.
    ///
    /// # Errors
    /// What the operating system reports.
    pub fn new(temporary: TempPath, path: PathBuf, keep: bool) -> Result<Self> {
        let failed = |error| io_error(&path, "write", error);
        let keep = keep && path.is_file();
        // Best effort: it may be read-only, or on a file system without locks.
        let lock =
            (keep.then(|| File::open(&path).ok()).flatten()).filter(|file| file.try_lock().is_ok());
        let before = match keep {
            true => Some(create_backup(&path).map_err(failed)?),
            false => None,
        };
        match temporary.persist(&path) {
            Ok(()) => Ok(Self {
                path,
                backup: before,
                _lock: lock,
            }),
            Err(error) => {
                let failed = failed(error.error);
                // It has a name less where a file cannot have two.
                if let Some(before) = before
                    && !path.exists()
                {
                    Self::restore(before, &path);
                }
                Err(failed)
            }
        }
    }

    /// Gives the name back to what had it.
    pub fn undo(self) {
        match self.backup {
            Some(before) => Self::restore(before, &self.path),
            // Nothing useful can be done if this fails: the first error is the one to report.
            None => drop(fs::remove_file(&self.path)),
        }
    }

    fn restore(before: TempPath, path: &Path) {
        if let Err(kept) = before.persist(path) {
            // Better under a strange name than gone.
            let _ = kept.path.keep();
        }
    }
}

/// Gives a file a second name in its folder; where files cannot have two, another name.
fn create_backup(path: &Path) -> io::Result<TempPath> {
    let mut builder = Builder::new();
    let prefix = prefix(path);
    let builder = (builder.prefix(&prefix))
        .suffix(BACKUP_SUFFIX)
        .rand_bytes(RANDOM_CHAR_COUNT);
    let folder = parent_folder(path);
    let linked = builder
        .make_in(folder, |name| fs::hard_link(path, name))
        .or_else(|_| builder.make_in(folder, |name| fs::rename(path, name)))?;
    Ok(linked.into_temp_path())
}
