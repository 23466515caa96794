//! Temporary files that have not taken their final names yet.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::{Builder, NamedTempFile, TempPath};

use super::leftovers::{self, RANDOM_CHAR_COUNT, prefix};
use super::{check_target, parent_folder};
use crate::error::{Result, io_error};

/// All unfinished files and folders of this process.
static UNFINISHED_PATHS: Mutex<UnfinishedPaths> = Mutex::new(UnfinishedPaths {
    files: BTreeSet::new(),
    folders: Vec::new(),
    trees: BTreeSet::new(),
});

/// Files and folders that would be left over if the process ended now.
#[derive(Default)]
pub struct UnfinishedPaths {
    /// Temporary files.
    pub files: BTreeSet<PathBuf>,
    /// Folders created for files that are not there yet, outer ones first.
    pub folders: Vec<PathBuf>,
    /// Folders under temporary names, with their content.
    pub trees: BTreeSet<PathBuf>,
}

/// Locks and returns the list of unfinished files. As long as the lock lasts, no other thread can
/// create or rename such a file or end the process.
pub fn unfinished_paths() -> MutexGuard<'static, UnfinishedPaths> {
    UNFINISHED_PATHS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

/// Ends the process, from any thread, and leaves no file half written. Temporary files are removed.
/// If another thread is renaming files to their final names, this call waits for it; afterwards no
/// thread can write or rename a file.
pub fn exit_without_unfinished(code: i32) -> ! {
    let mut paths = unfinished_paths();
    remove_all(&mut paths);
    std::process::exit(code)
}

/// Removes temporary files without waiting for a lock, for a process that must end at once, for
/// example because memory is exhausted. A file that another thread is just creating or renaming may
/// stay; the next process removes it.
pub fn remove_unfinished() {
    if let Ok(mut paths) = UNFINISHED_PATHS.try_lock() {
        remove_all(&mut paths);
    }
}

fn remove_all(paths: &mut UnfinishedPaths) {
    let UnfinishedPaths {
        files,
        folders,
        trees,
    } = std::mem::take(paths);
    // Nothing useful can be done if this fails: the process ends.
    for path in files {
        let _ = fs::remove_file(path);
    }
    for path in trees {
        let _ = fs::remove_dir_all(path);
    }
    for path in folders.into_iter().rev() {
        let _ = fs::remove_dir(path);
    }
}

/// A temporary file that is deleted when dropped.
pub struct UnfinishedFile {
    file: Option<FinishedFile>,
}

/// A temporary file that is complete and about to take its final name.
pub struct FinishedFile {
    /// Its temporary path.
    pub path: TempPath,
    /// Keeps the file locked, so that no other process takes it for a leftover. `None` where a file
    /// cannot have two handles, as in a browser.
    _lock: Option<File>,
}

impl UnfinishedFile {
    /// Creates the temporary file in the folder of `target`. Returns also a handle to write to it.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) as [`check_target`] does, or if the file cannot be
    /// created.
    pub fn create(target: &Path) -> Result<(Self, File)> {
        check_target(target)?;
        leftovers::remove_leftovers(parent_folder(target));
        // The process must not end between creating the file and recording it.
        let mut paths = unfinished_paths();
        let created = create_locked(target).and_then(|file| Ok((second_handle(&file)?, file)));
        let (lock, file) = created.map_err(|error| io_error(target, "write", error))?;
        let (file, path) = file.into_parts();
        paths.files.insert(path.to_path_buf());
        let finished = FinishedFile { path, _lock: lock };
        Ok((
            Self {
                file: Some(finished),
            },
            file,
        ))
    }

    /// Takes the file out of the list of unfinished ones and returns it.
    pub fn finish(mut self, paths: &mut UnfinishedPaths) -> Option<FinishedFile> {
        let file = self.file.take()?;
        paths.files.remove(&*file.path);
        Some(file)
    }

    /// Returns its temporary path.
    #[cfg(test)]
    pub fn path(&self) -> &Path {
        &self.file.as_ref().unwrap().path
    }
}

impl Drop for UnfinishedFile {
    fn drop(&mut self) {
        if let Some(file) = self.file.take() {
            unfinished_paths().files.remove(&*file.path);
        }
    }
}

/// Returns another handle of the same file, or `None` where a file cannot have two.
fn second_handle(file: &NamedTempFile) -> io::Result<Option<File>> {
    match file.as_file().try_clone() {
        Err(error) if error.kind() == io::ErrorKind::Unsupported => Ok(None),
        handle => handle.map(Some),
    }
}

/// Creates a temporary file and locks it, where files can be locked.
fn create_locked(target: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    let prefix = prefix(target);
    builder
        .prefix(&prefix)
        .suffix(leftovers::UNFINISHED_SUFFIX)
        .rand_bytes(RANDOM_CHAR_COUNT);
    #[cfg(unix)]
    {
        // The file gets the permissions of any other new file; temporary files are private by
        // default.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    loop {
        let file = builder.tempfile_in(parent_folder(target))?;
        match file.as_file().try_lock() {
            // Before this process locked the file, another one may have taken it for a leftover.
            Err(fs::TryLockError::WouldBlock) => (),
            Ok(()) if !file.path().exists() => (),
            _ => return Ok(file),
        }
    }
}
