//! Files that appear whole or not at all.
//!
//! Each is written and synchronised under a temporary name in its own folder and then renamed, which
//! operating systems do in one step. Several that belong together are all written before the first is
//! renamed; what they replace is kept under a second name until all have taken theirs, and takes its
//! name back if one cannot. No operating system renames several files in one step: were the computer
//! switched off between two of these renames, the first ones would be there without the others.
//!
//! What a killed process leaves under temporary names, the next one that writes into the same folder
//! removes.

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

/// All that this thread writes during `work` appears when it has succeeded; if it fails, nothing does.
/// Of several files written to one path, the last remains.
///
/// # Errors
/// Those of the work; [`Error::Io`] if a file cannot take its name: then none has.
pub fn transaction<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    /// Also where the work panics.
    struct TransactionGuard;
    impl Drop for TransactionGuard {
        fn drop(&mut self) {
            drop(OPEN_BATCH.take());
        }
    }
    OPEN_BATCH.set(Some(Batch::default()));
    let guard = TransactionGuard;
    let done = work()?;
    let batch = OPEN_BATCH.take();
    drop(guard);
    batch.map_or(Ok(()), Batch::commit)?;
    Ok(done)
}

/// What this writes appears when it is written, also within [`transaction`].
pub fn commit_immediately<T>(work: impl FnOnce() -> T) -> T {
    let job = OPEN_BATCH.take();
    let done = work();
    OPEN_BATCH.set(job);
    done
}

thread_local! {
    /// What [`together`] has gathered so far.
    static OPEN_BATCH: RefCell<Option<Batch>> = const { RefCell::new(None) };
}

/// Writes a file so that nobody ever sees half of it: `write` fills a temporary file in the
/// target's own folder, which then takes the target's name (replacing what was there).
///
/// On any error, and if `write` panics, the temporary file is removed and the target is untouched.
///
/// # Errors
/// [`Error::Io`] if the folder does not exist, the target is a folder, or writing fails.
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
    /// Each file, and the name it will take.
    files: Vec<(UnfinishedFile, PathBuf)>,
    /// Folders made for them, the outer ones first.
    folders: Vec<PathBuf>,
    /// Folders that appear with all that is in them.
    trees: Vec<UnfinishedTree>,
}

impl Batch {
    /// Writes a folder in place of what has its name: `fill` is told where. It is known by `file` in it, and
    /// replaces no folder without that, unless it is empty.
    ///
    /// # Errors
    /// [`Error::Io`] if the folder around it does not exist or something else has its name; those of
    /// filling it.
    pub fn write_tree(
        &mut self,
        path: &Path,
        file: &str,
        fill: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<()> {
        let tree = UnfinishedTree::create(path, file)?;
        fill(tree.path())?;
        sync_folder(tree.path());
        self.trees.push(tree);
        Ok(())
    }

    /// Writes one of the files; its folder must exist.
    ///
    /// # Errors
    /// As [`atomic_write`].
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

    /// Keeps a file that has been written, unless that failed. Apart from [`Batch::write`], so that it is compiled
    /// once.
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

    /// Makes a folder, and those around it that do not exist.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be made.
    pub fn create_folder(&mut self, path: &Path) -> Result<()> {
        let missing: Vec<&Path> = path
            .ancestors()
            .take_while(|folder| *folder != Path::new("") && !folder.is_dir())
            .collect();
        for folder in missing.into_iter().rev() {
            // Not between the folder and the note of it may the process end.
            let mut all = unfinished::unfinished_paths();
            fs::create_dir(folder).map_err(|error| io_error(folder, "make the folder", error))?;
            all.folders.push(folder.to_path_buf());
            self.folders.push(folder.to_path_buf());
        }
        Ok(())
    }

    /// Gives all files their names, or those of a larger job ([`together`]) at its end.
    ///
    /// # Errors
    /// [`Error::Io`] if one cannot take its name; those before it have given theirs back then, and
    /// what they had replaced is there again.
    pub fn commit(mut self) -> Result<()> {
        if OPEN_BATCH.with_borrow(Option::is_some) {
            OPEN_BATCH.with_borrow_mut(|job| job.as_mut().map(|job| job.merge(self)));
            return Ok(());
        }
        // Whoever removes unfinished files waits until all these are finished.
        let mut unfinished = unfinished::unfinished_paths();
        let many = self.files.len() + self.trees.len() > 1;
        let trees = self.trees.iter().map(UnfinishedTree::target);
        let paths = (self.files.iter()).map(|(_, path)| path.as_path());
        let folders: BTreeSet<PathBuf> = (paths.chain(trees))
            .map(|path| parent_folder(path).to_path_buf())
            .collect();
        let mut grown: Vec<CommittedTree> = Vec::new();
        let undone =
            |grown: Vec<CommittedTree>| grown.into_iter().rev().for_each(CommittedTree::undo);
        for tree in std::mem::take(&mut self.trees) {
            match tree.commit(&mut unfinished) {
                Ok(tree) => grown.push(tree),
                Err(error) => {
                    undone(grown);
                    return Err(error);
                }
            }
        }
        let files: Vec<(FinishedFile, PathBuf)> = (self.files.drain(..))
            .filter_map(|(file, path)| Some((file.finish(&mut unfinished)?, path)))
            .collect();
        let mut placed: Vec<CommittedFile> = Vec::new();
        for (temporary, path) in files {
            match CommittedFile::new(temporary.path, path, many) {
                Ok(file) => placed.push(file),
                Err(error) => {
                    placed.into_iter().rev().for_each(CommittedFile::undo);
                    undone(grown);
                    return Err(error);
                }
            }
        }
        drop(placed);
        let made = std::mem::take(&mut self.folders);
        unfinished.folders.retain(|folder| !made.contains(folder));
        folders.iter().for_each(|folder| sync_folder(folder));
        Ok(())
    }
}

impl Batch {
    /// What another has written, in place of what was to have the same names.
    fn merge(&mut self, mut other: Self) {
        let paths: BTreeSet<&Path> = other.files.iter().map(|(_, path)| path.as_path()).collect();
        self.files
            .retain(|(_, path)| !paths.contains(path.as_path()));
        self.files.append(&mut other.files);
        self.folders.append(&mut other.folders);
        let later = std::mem::take(&mut other.trees);
        let replaced =
            |tree: &UnfinishedTree| later.iter().any(|other| other.target() == tree.target());
        self.trees.retain(|tree| !replaced(tree));
        self.trees.extend(later);
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        self.files.clear();
        self.trees.clear();
        if self.folders.is_empty() {
            return;
        }
        let mut all = unfinished::unfinished_paths();
        all.folders.retain(|folder| !self.folders.contains(folder));
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
    let folder = parent_folder(path);
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

fn parent_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Makes a renamed file's new name last, where folders can be synchronised.
fn sync_folder(folder: &Path) {
    #[cfg(unix)]
    if let Ok(folder) = File::open(folder) {
        // Some file systems cannot; the files themselves are safe.
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
            batch.write(&inner.join("b"), |w| match fails {
                true => Err(std::io::Error::other("disk full")),
                false => w.write_all(b"b"),
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
    fn a_folder_appears_whole_in_place_of_its_like_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tree");
        let fill = |text: &'static str, fails: bool| {
            let mut batch = Batch::default();
            batch.write_tree(&path, "mark", |at| {
                fs::write(at.join("mark"), text).map_err(|e| io_error(at, "write", e))?;
                match fails {
                    true => Err(Error::Io(cause("disk", "is full", "make room"))),
                    false => fs::write(at.join(text), "").map_err(|e| io_error(at, "write", e)),
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
        // A folder of something else stays.
        fs::remove_file(path.join("mark")).unwrap();
        let error = fill("four", false).unwrap_err().to_string();
        assert!(error.contains("holds no mark"), "{error}");
        assert_eq!(list_names(&path), ["two"]);
    }

    /// The second of three files cannot take its name: the first gives its own back, with what was
    /// there before and without.
    #[test]
    fn a_rename_that_fails_in_the_middle_undoes_those_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for before in [None, Some("old")] {
            if let Some(text) = before {
                fs::write(at("a"), text).unwrap();
                fs::write(at("c"), text).unwrap();
            }
            let mut batch = Batch::default();
            for name in ["a", "b", "c"] {
                batch.write(&at(name), |w| w.write_all(b"new")).unwrap();
            }
            fs::create_dir_all(at("b/full")).unwrap();
            let error = batch.commit().unwrap_err().to_string();
            assert!(error.contains("b: cannot write"), "{error}");
            fs::remove_dir_all(at("b")).unwrap();
            let expected: &[&str] = if before.is_some() { &["a", "c"] } else { &[] };
            assert_eq!(list_names(folder.path()), expected);
            for name in expected {
                assert_eq!(fs::read_to_string(at(name)).ok().as_deref(), before);
            }
        }
        // Without the obstacle all are replaced, and nothing else is left.
        let mut batch = Batch::default();
        for name in ["a", "b", "c"] {
            batch.write(&at(name), |w| w.write_all(b"new")).unwrap();
        }
        batch.commit().unwrap();
        assert_eq!(list_names(folder.path()), ["a", "b", "c"]);
        assert_eq!(fs::read(at("a")).unwrap(), b"new");
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
        // As `exit_without_unfinished` does, which would trouble the tests beside this one.
        fs::remove_file(&temporary).unwrap();
        assert!(batch.commit().is_err());
        assert!(!unfinished::unfinished_paths().files.contains(&temporary));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(list_names(folder.path()), ["a.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_a_file_as_any_other_new_one() {
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
