//! Files that have taken their final names, with backups of the files that they replace.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

use super::leftovers::{BACKUP_SUFFIX, RANDOM_CHAR_COUNT, prefix};
use super::parent_folder;
use crate::error::{Result, io_error};

/// A file that has taken its final name, with a backup of the file that it replaced.
pub struct CommittedFile {
    path: PathBuf,
    /// Another name of the replaced file, which is removed when this is dropped.
    backup: Option<TempPath>,
    /// Keeps the replaced file locked, so that no other process takes its backup for a leftover.
    _lock: Option<File>,
}

impl CommittedFile {
    /// Renames a temporary file to `path`. With `keep_previous`, a file that has this name already
    /// is kept under a backup name until the returned value is dropped.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) with the error of the operating system if the file
    /// cannot be renamed or backed up.
    pub fn new(temporary: TempPath, path: PathBuf, keep_previous: bool) -> Result<Self> {
        let write_error = |error| io_error(&path, "write", error);
        let keep_previous = keep_previous && path.is_file();
        // The lock is best effort: the file may be read-only, or on a file system without locks.
        let lock = (keep_previous.then(|| File::open(&path).ok()).flatten())
            .filter(|file| file.try_lock().is_ok());
        let backup = if keep_previous {
            Some(create_backup(&path).map_err(write_error)?)
        } else {
            None
        };
        match temporary.persist(&path) {
            Ok(()) => Ok(Self {
                path,
                backup,
                _lock: lock,
            }),
            Err(error) => {
                let failure = write_error(error.error);
                // On file systems without hard links the backup was a rename, so the file must get
                // its name back.
                if let Some(backup) = backup
                    && !path.exists()
                {
                    Self::restore(backup, &path);
                }
                Err(failure)
            }
        }
    }

    /// Restores the file that was replaced, or removes the new one if none was.
    pub fn undo(self) {
        match self.backup {
            Some(backup) => Self::restore(backup, &self.path),
            // Nothing useful can be done if this fails: the first error is the one to report.
            None => drop(fs::remove_file(&self.path)),
        }
    }

    fn restore(backup: TempPath, path: &Path) {
        if let Err(error) = backup.persist(path) {
            // A file under a backup name is better than a lost file.
            let _ = error.path.keep();
        }
    }
}

/// Gives a file a second name in its folder. Where the file system has no hard links, the file is
/// renamed instead.
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
