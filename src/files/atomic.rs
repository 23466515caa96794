//! Files that appear whole or not at all.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::error::{Error, Result, cause, os};

/// Writes a file so that nobody ever sees half of it: `write` fills a temporary file in the
/// target's own folder, which then takes the target's name (replacing what was there).
///
/// On any error, and if `write` panics, the temporary file is removed and the target is untouched.
///
/// # Errors
/// [`Error::Io`] if the folder does not exist, the target is a folder, or writing fails.
pub fn atomic_write(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<()> {
    let mut batch = Batch::default();
    batch.write(path, write)?;
    batch.commit()
}

/// Several files that belong together: none takes its name before all are written.
#[derive(Default)]
pub struct Batch {
    /// Each file, and the name it will take.
    files: Vec<(Unfinished, PathBuf)>,
    /// Folders made for them, the outer ones first.
    folders: Vec<PathBuf>,
}

impl Batch {
    /// Writes one of the files; its folder must exist.
    ///
    /// # Errors
    /// As [`atomic_write`].
    pub fn write(
        &mut self,
        path: &Path,
        write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> Result<()> {
        let (unfinished, file) = Unfinished::create(path)?;
        let mut writer = BufWriter::with_capacity(1 << 16, file);
        let written = write(&mut writer).and_then(|()| writer.flush());
        written.map_err(|error| os(path, "write", error))?;
        self.files.push((unfinished, path.to_path_buf()));
        Ok(())
    }

    /// Makes a folder, and those around it that do not exist.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be made.
    pub fn folder(&mut self, path: &Path) -> Result<()> {
        let missing: Vec<&Path> = path
            .ancestors()
            .take_while(|folder| *folder != Path::new("") && !folder.is_dir())
            .collect();
        for folder in missing.into_iter().rev() {
            fs::create_dir(folder).map_err(|error| os(folder, "make the folder", error))?;
            self.folders.push(folder.to_path_buf());
        }
        Ok(())
    }

    /// Gives all files their names.
    ///
    /// # Errors
    /// [`Error::Io`] if one cannot take its name; those after it do not either.
    pub fn commit(mut self) -> Result<()> {
        let mut unfinished = unfinished();
        for (file, path) in &mut self.files {
            fs::rename(&file.path, &*path).map_err(|error| os(path, "write", error))?;
            unfinished.remove(&file.path);
            file.renamed = true;
        }
        Ok(())
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        self.files.clear();
        for folder in self.folders.iter().rev() {
            // Fails, as it shall, where there are files in it.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Checks that a file could be written at `path`: its folder exists and it is not a folder itself.
/// Jobs call this before their long work, [`atomic_write`] calls it anyway.
///
/// # Errors
/// [`Error::Io`] that names the folder.
pub fn check_target(path: &Path) -> Result<()> {
    let folder = folder_of(path);
    if !folder.is_dir() {
        let problem = format!("the folder {} does not exist", folder.display());
        return Err(Error::Io(cause(
            path.display(),
            problem,
            "create it, or write elsewhere",
        )));
    }
    if path.is_dir() || path.file_name().is_none() {
        return Err(Error::Io(cause(
            path.display(),
            "is a folder",
            "name a file to write",
        )));
    }
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Every temporary file that has not taken its name yet.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes every temporary file of this process that has not taken its name yet, and waits for files
/// that are just taking theirs. For a thread that ends the process.
pub fn remove_unfinished() {
    for path in std::mem::take(&mut *unfinished()) {
        // Nothing useful can be done if this fails: the process ends.
        let _ = fs::remove_file(path);
    }
}

/// A temporary file that is deleted when dropped, unless it was renamed.
struct Unfinished {
    path: PathBuf,
    renamed: bool,
}

impl Unfinished {
    fn create(target: &Path) -> Result<(Self, File)> {
        // Distinct within the process by the counter, between processes by the process id.
        static COUNTER: AtomicU32 = AtomicU32::new(0);
        check_target(target)?;
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let count = COUNTER.fetch_add(1, Ordering::Relaxed);
        // Cut so that a long (but legal) target name does not make an illegal temporary one.
        let stem: String = name.chars().take(40).collect();
        let path = folder_of(target).join(format!(".{stem}.{}-{count}.tmp", std::process::id()));
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(|error| os(target, "write", error))?;
        unfinished().insert(path.clone());
        Ok((
            Self {
                path,
                renamed: false,
            },
            file,
        ))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.renamed {
            // Nothing useful can be done if this fails: the first error is the one to report.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn replaces_the_target_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        atomic_write(&path, |w| w.write_all(b"old")).unwrap();
        atomic_write(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, b"old").unwrap();
        let error = atomic_write(&path, |w| {
            w.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        })
        .unwrap_err();
        assert!(error.to_string().contains("disk full"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn files_that_belong_together_appear_together_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("case/inner");
        let fill = |fails: bool| {
            let mut batch = Batch::default();
            batch.folder(&inner)?;
            batch.write(&inner.join("a"), |w| w.write_all(b"a"))?;
            batch.write(&inner.join("b"), |w| match fails {
                true => Err(std::io::Error::other("disk full")),
                false => w.write_all(b"b"),
            })?;
            batch.commit()
        };
        assert!(fill(true).is_err());
        assert!(names(folder.path()).is_empty());
        fill(false).unwrap();
        assert_eq!(names(&inner), ["a", "b"]);
        assert!(fill(true).is_err());
        assert_eq!(names(&inner), ["a", "b"]);
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nowhere/a.txt");
        let error = atomic_write(&path, |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("nowhere does not exist"), "{error}");
        let error = atomic_write(folder.path(), |_| Ok(()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("is a folder"), "{error}");
        assert!(names(folder.path()).is_empty());
    }
}
