//! Files that appear completely or not at all.
//!
//! Each file is written and synchronised under a temporary name in its own folder and then renamed,
//! which operating systems do in one step. Several files that belong together are all written
//! before the first is renamed. The files that they replace are kept under backup names until all
//! new files have taken their names, and are restored if one cannot. No operating system renames
//! several files in one step: if the computer is switched off between two of these renames, only
//! some of the files are new.
//!
//! The next process that writes into the same folder removes the temporary files that a killed
//! process has left.

mod committed;
mod leftovers;
mod tree;
mod unfinished;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result, cause, io_error};
use committed::CommittedFile;
use tree::{CommittedTree, UnfinishedTree};
use unfinished::{FinishedFile, UnfinishedFile};

pub use tree::check_tree;
pub use unfinished::{exit_without_unfinished, remove_unfinished};

/// Runs `work`. All files that this thread writes during it appear when it succeeds; if it fails,
/// none appears. Of several files written to one path, the last remains.
///
/// # Errors
/// Returns the error of `work`, or [`Error::Io`] if a file cannot take its name; then none has.
pub fn transaction<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    /// Discards the batch also when `work` panics.
    struct TransactionGuard;
    impl Drop for TransactionGuard {
        fn drop(&mut self) {
            drop(OPEN_BATCH.take());
        }
    }
    OPEN_BATCH.set(Some(Batch::default()));
    let guard = TransactionGuard;
    let result = work()?;
    let batch = OPEN_BATCH.take();
    drop(guard);
    batch.map_or(Ok(()), Batch::commit)?;
    Ok(result)
}

/// Runs `work` outside of any [`transaction`]: its files appear as soon as they are written.
pub fn commit_immediately<T>(work: impl FnOnce() -> T) -> T {
    let outer_batch = OPEN_BATCH.take();
    let result = work();
    OPEN_BATCH.set(outer_batch);
    result
}

thread_local! {
    /// The files that the open [`transaction`] of this thread has collected so far.
    static OPEN_BATCH: RefCell<Option<Batch>> = const { RefCell::new(None) };
}

/// Writes a file so that no reader ever sees half of it: `write` fills a temporary file in the
/// target's folder, which then takes the target's name and replaces what was there.
///
/// On any error, and if `write` panics, the temporary file is removed and the target is unchanged.
///
/// # Errors
/// Returns [`Error::Io`] if the folder does not exist, the target is a folder, or writing fails.
pub fn atomic_write(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let mut batch = Batch::default();
    batch.write(path, write)?;
    batch.commit()
}

/// Several files that belong together: all appear, or none.
#[derive(Default)]
pub struct Batch {
    /// Each file, and the name that it will take.
    files: Vec<(UnfinishedFile, PathBuf)>,
    /// Folders created for the files, outer ones first.
    folders: Vec<PathBuf>,
    /// Folders that appear with all their content.
    trees: Vec<UnfinishedTree>,
}

impl Batch {
    /// Writes a folder that replaces the one at `path`. `fill` is called with the path of the
    /// temporary folder. A folder of this kind contains a file named `marker`: a folder that is
    /// there already is replaced only if it has this file or is empty.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if the parent folder does not exist or something else has the name,
    /// and any error of `fill`.
    pub fn write_tree(
        &mut self,
        path: &Path,
        marker: &str,
        fill: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<()> {
        let tree = UnfinishedTree::create(path, marker)?;
        fill(tree.path())?;
        sync_folder(tree.path());
        self.trees.push(tree);
        Ok(())
    }

    /// Writes one file of the batch. Its folder must exist.
    ///
    /// # Errors
    /// Returns [`Error::Io`] as [`atomic_write`] does.
    pub fn write(
        &mut self,
        path: &Path,
        write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> Result<()> {
        let (unfinished, file) = UnfinishedFile::create(path)?;
        let mut writer = BufWriter::with_capacity(1 << 16, file);
        let written = write(&mut writer);
        self.add_written(path, unfinished, writer, written)
    }

    /// Adds a file that has been written, or returns the error if writing failed. Separate from
    /// [`Batch::write`], so that it is compiled only once.
    fn add_written(
        &mut self,
        path: &Path,
        unfinished: UnfinishedFile,
        mut writer: BufWriter<File>,
        written: io::Result<()>,
    ) -> Result<()> {
        written
            .and_then(|()| writer.flush())
            .and_then(|()| writer.get_ref().sync_all())
            .map_err(|error| io_error(path, "write", error))?;
        self.files.push((unfinished, path.to_path_buf()));
        Ok(())
    }

    /// Creates a folder, and its parents where they do not exist.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if a folder cannot be created.
    pub fn create_folder(&mut self, path: &Path) -> Result<()> {
        let missing: Vec<&Path> = path
            .ancestors()
            .take_while(|folder| *folder != Path::new("") && !folder.is_dir())
            .collect();
        for folder in missing.into_iter().rev() {
            // The process must not end between creating the folder and recording it.
            let mut paths = unfinished::unfinished_paths();
            fs::create_dir(folder).map_err(|error| io_error(folder, "make the folder", error))?;
            paths.folders.push(folder.to_path_buf());
            self.folders.push(folder.to_path_buf());
        }
        Ok(())
    }

    /// Renames all files to their final names. Inside a [`transaction`], the files are only passed
    /// on to it.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if a file cannot take its name. Then all renames are undone, and the
    /// files that were replaced are restored.
    pub fn commit(mut self) -> Result<()> {
        if OPEN_BATCH.with_borrow(Option::is_some) {
            OPEN_BATCH.with_borrow_mut(|batch| batch.as_mut().map(|batch| batch.merge(self)));
            return Ok(());
        }
        // This lock makes a thread that removes unfinished files wait until all files here are
        // renamed.
        let mut unfinished = unfinished::unfinished_paths();
        let keep_previous = self.files.len() + self.trees.len() > 1;
        let trees = self.trees.iter().map(UnfinishedTree::target);
        let paths = (self.files.iter()).map(|(_, path)| path.as_path());
        let folders: BTreeSet<PathBuf> = (paths.chain(trees))
            .map(|path| parent_folder(path).to_path_buf())
            .collect();
        let mut committed_trees: Vec<CommittedTree> = Vec::new();
        let undo_trees =
            |trees: Vec<CommittedTree>| trees.into_iter().rev().for_each(CommittedTree::undo);
        for tree in std::mem::take(&mut self.trees) {
            match tree.commit(&mut unfinished) {
                Ok(tree) => committed_trees.push(tree),
                Err(error) => {
                    undo_trees(committed_trees);
                    return Err(error);
                }
            }
        }
        let files: Vec<(FinishedFile, PathBuf)> = (self.files.drain(..))
            .filter_map(|(file, path)| Some((file.finish(&mut unfinished)?, path)))
            .collect();
        let mut committed_files: Vec<CommittedFile> = Vec::new();
        for (temporary, path) in files {
            match CommittedFile::new(temporary.path, path, keep_previous) {
                Ok(file) => committed_files.push(file),
                Err(error) => {
                    committed_files
                        .into_iter()
                        .rev()
                        .for_each(CommittedFile::undo);
                    undo_trees(committed_trees);
                    return Err(error);
                }
            }
        }
        drop(committed_files);
        let created_folders = std::mem::take(&mut self.folders);
        unfinished
            .folders
            .retain(|folder| !created_folders.contains(folder));
        folders.iter().for_each(|folder| sync_folder(folder));
        Ok(())
    }
}

impl Batch {
    /// Adds the files of another batch, which replace files of this one that have the same names.
    fn merge(&mut self, mut other: Self) {
        let paths: BTreeSet<&Path> = other.files.iter().map(|(_, path)| path.as_path()).collect();
        self.files
            .retain(|(_, path)| !paths.contains(path.as_path()));
        self.files.append(&mut other.files);
        self.folders.append(&mut other.folders);
        let newer_trees = std::mem::take(&mut other.trees);
        let is_replaced = |tree: &UnfinishedTree| {
            newer_trees
                .iter()
                .any(|other| other.target() == tree.target())
        };
        self.trees.retain(|tree| !is_replaced(tree));
        self.trees.extend(newer_trees);
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        self.files.clear();
        self.trees.clear();
        if self.folders.is_empty() {
            return;
        }
        let mut paths = unfinished::unfinished_paths();
        paths
            .folders
            .retain(|folder| !self.folders.contains(folder));
        for folder in self.folders.iter().rev() {
            // The call fails, as intended, if the folder is not empty.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Checks that a file could be written at `path`: its folder exists and it is not a folder itself.
/// Jobs call this before their long work; [`atomic_write`] checks it anyway.
///
/// # Errors
/// Returns [`Error::Io`] with the name of the folder.
pub fn check_target(path: &Path) -> Result<()> {
    let folder = parent_folder(path);
    if !folder.is_dir() {
        let problem = format!("the folder {} does not exist", folder.display());
        let remedy = "create it, or write elsewhere";
        let source = io::Error::from(io::ErrorKind::NotFound);
        return Err(Error::Io(
            cause(path.display(), problem, remedy).with_source(source),
        ));
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

fn parent_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Synchronises a folder, so that a rename in it is permanent, where folders can be synchronised.
fn sync_folder(folder: &Path) {
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder) {
        // Some file systems cannot synchronise folders; the files themselves are safe.
        let _ = folder.sync_all();
    }
    #[cfg(not(unix))]
    let _ = folder;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list_names(folder: &Path) -> Vec<String> {
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
        assert_eq!(list_names(folder.path()), ["a.txt"]);
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
        assert_eq!(list_names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn files_that_belong_together_appear_together_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("case/inner");
        let fill = |fails: bool| {
            let mut batch = Batch::default();
            batch.create_folder(&inner)?;
            batch.write(&inner.join("a"), |w| w.write_all(b"a"))?;
            batch.write(&inner.join("b"), |w| {
                if fails {
                    Err(std::io::Error::other("disk full"))
                } else {
                    w.write_all(b"b")
                }
            })?;
            batch.commit()
        };
        assert!(fill(true).is_err());
        assert!(list_names(folder.path()).is_empty());
        fill(false).unwrap();
        assert_eq!(list_names(&inner), ["a", "b"]);
        assert!(fill(true).is_err());
        assert_eq!(list_names(&inner), ["a", "b"]);
    }

    #[test]
    fn a_folder_replaces_one_of_its_kind_completely_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tree");
        let fill = |text: &'static str, fails: bool| {
            let mut batch = Batch::default();
            batch.write_tree(&path, "mark", |tree| {
                fs::write(tree.join("mark"), text).map_err(|e| io_error(tree, "write", e))?;
                if fails {
                    Err(Error::Io(cause("disk", "is full", "make room")))
                } else {
                    fs::write(tree.join(text), "").map_err(|e| io_error(tree, "write", e))
                }
            })?;
            batch.commit()
        };
        assert!(fill("one", true).is_err());
        assert!(list_names(folder.path()).is_empty());
        fill("one", false).unwrap();
        fill("two", false).unwrap();
        assert_eq!(list_names(&path), ["mark", "two"]);
        assert!(fill("three", true).is_err());
        assert_eq!(list_names(&path), ["mark", "two"]);
        assert_eq!(list_names(folder.path()), ["a.tree"]);
        // A folder without the marker file is not replaced.
        fs::remove_file(path.join("mark")).unwrap();
        let error = fill("four", false).unwrap_err().to_string();
        assert!(error.contains("contains no mark"), "{error}");
        assert_eq!(list_names(&path), ["two"]);
    }

    /// The second of three files cannot take its name: the first rename is undone, with and without
    /// a previous file.
    #[test]
    fn a_rename_that_fails_in_the_middle_undoes_those_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let path_of = |name: &str| folder.path().join(name);
        for old_text in [None, Some("old")] {
            if let Some(text) = old_text {
                fs::write(path_of("a"), text).unwrap();
                fs::write(path_of("c"), text).unwrap();
            }
            let mut batch = Batch::default();
            for name in ["a", "b", "c"] {
                batch
                    .write(&path_of(name), |w| w.write_all(b"new"))
                    .unwrap();
            }
            fs::create_dir_all(path_of("b/full")).unwrap();
            let error = batch.commit().unwrap_err().to_string();
            assert!(error.contains("b: cannot write"), "{error}");
            fs::remove_dir_all(path_of("b")).unwrap();
            let expected: &[&str] = if old_text.is_some() { &["a", "c"] } else { &[] };
            assert_eq!(list_names(folder.path()), expected);
            for name in expected {
                assert_eq!(fs::read_to_string(path_of(name)).ok().as_deref(), old_text);
            }
        }
        // Without the obstacle all files are replaced, and nothing else is left.
        let mut batch = Batch::default();
        for name in ["a", "b", "c"] {
            batch
                .write(&path_of(name), |w| w.write_all(b"new"))
                .unwrap();
        }
        batch.commit().unwrap();
        assert_eq!(list_names(folder.path()), ["a", "b", "c"]);
        assert_eq!(fs::read(path_of("a")).unwrap(), b"new");
    }

    #[test]
    fn a_file_whose_temporary_one_is_gone_is_refused_and_nothing_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, b"old").unwrap();
        let mut batch = Batch::default();
        batch.write(&path, |w| w.write_all(b"new")).unwrap();
        let temporary = batch.files[0].0.path().to_path_buf();
        assert!(unfinished::unfinished_paths().files.contains(&temporary));
        // `exit_without_unfinished` does the same, but it would disturb other tests that run at the
        // same time.
        fs::remove_file(&temporary).unwrap();
        assert!(batch.commit().is_err());
        assert!(!unfinished::unfinished_paths().files.contains(&temporary));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(list_names(folder.path()), ["a.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_has_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let [plain, ours] = ["plain", "ours"].map(|name| folder.path().join(name));
        fs::write(&plain, b"").unwrap();
        atomic_write(&ours, |_| Ok(())).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
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
        assert!(list_names(folder.path()).is_empty());
    }
}
