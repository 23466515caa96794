//! Temporary files that have not taken their names yet.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::{Builder, NamedTempFile, TempPath};

use super::leftovers::{self, RANDOM_CHAR_COUNT, prefix};
use super::{check_target, parent_folder};
use crate::error::{Result, io_error};

/// All of this process.
static UNFINISHED_PATHS: Mutex<UnfinishedPaths> = Mutex::new(UnfinishedPaths {
    files: BTreeSet::new(),
    folders: Vec::new(),
    trees: BTreeSet::new(),
});

/// What would be left if the process ended now.
#[derive(Default)]
pub struct UnfinishedPaths {
    /// Temporary files.
    pub files: BTreeSet<PathBuf>,
    /// Folders made for files that are not there yet, the outer ones first.
    pub folders: Vec<PathBuf>,
    /// Folders under temporary names, with all that is in them.
    pub trees: BTreeSet<PathBuf>,
}

/// The list of all; while it is held, no file is begun or ended, nor does the process end.
pub fn unfinished_paths() -> MutexGuard<'static, UnfinishedPaths> {
    UNFINISHED_PATHS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

/// Ends the process, from any thread, with no file half written: temporary files that have not taken
/// their names yet are removed, and those that are just taking theirs are waited for. Nobody else writes
/// or ends a file in between.
pub fn exit_without_unfinished(code: i32) -> ! {
    let mut all = unfinished_paths();
    remove_all(&mut all);
    std::process::exit(code)
}

/// Removes temporary files for a process that ends and may wait for nothing, such as memory; what is just
/// being begun or ended may stay, for the next process to remove.
pub fn remove_unfinished() {
    if let Ok(mut all) = UNFINISHED_PATHS.try_lock() {
        remove_all(&mut all);
    }
}

fn remove_all(all: &mut UnfinishedPaths) {
    let UnfinishedPaths {
        files,
        folders,
        trees,
    } = std::mem::take(all);
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

/// One that is about to take its name.
pub struct FinishedFile {
    /// Its temporary name.
    pub path: TempPath,
    /// Keeps it locked: whoever finds it knows that it is not left over.
    _lock: File,
}

impl UnfinishedFile {
    /// Beside its target, to be written.
    ///
    /// # Errors
    /// As [`check_target`], or if it cannot be made.
    pub fn create(target: &Path) -> Result<(Self, File)> {
        check_target(target)?;
        leftovers::remove_leftovers(parent_folder(target));
        // Not between the file and the note of it may the process end.
        let mut all = unfinished_paths();
        let made = create_locked(target).and_then(|file| Ok((file.as_file().try_clone()?, file)));
        let (lock, file) = made.map_err(|error| io_error(target, "write", error))?;
        let (file, path) = file.into_parts();
        all.files.insert(path.to_path_buf());
        let taken = FinishedFile { path, _lock: lock };
        Ok((Self { file: Some(taken) }, file))
    }

    /// The file, no longer in the list of unfinished ones.
    pub fn finish(mut self, all: &mut UnfinishedPaths) -> Option<FinishedFile> {
        let file = self.file.take()?;
        all.files.remove(&*file.path);
        Some(file)
    }

    /// Its temporary name.
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

/// A new temporary file, locked where files can be.
fn create_locked(target: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    let prefix = prefix(target);
    builder
        .prefix(&prefix)
        .suffix(leftovers::UNFINISHED_SUFFIX)
        .rand_bytes(RANDOM_CHAR_COUNT);
    #[cfg(unix)]
    {
        // As any other new file, not private as temporary ones are by default.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    loop {
        let file = builder.tempfile_in(parent_folder(target))?;
        match file.as_file().try_lock() {
            // Between its making and its lock another process may have taken it for one left over.
            Err(fs::TryLockError::WouldBlock) => (),
            Ok(()) if !file.path().exists() => (),
            _ => return Ok(file),
        }
    }
}
