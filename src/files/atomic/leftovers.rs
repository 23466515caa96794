//! Removes temporary files that killed processes have left behind.
//!
//! A process keeps its temporary files locked as long as it lives. A file with a temporary name
//! that can be locked therefore belongs to no process. Where files cannot be locked, nothing is
//! removed.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Suffix of the temporary names of files that are being written.
pub const UNFINISHED_SUFFIX: &str = ".atomesh-unfinished";

/// Suffix of the backup names of files that are being replaced.
pub const BACKUP_SUFFIX: &str = ".atomesh-before";

/// Count of random characters in a temporary name.
pub const RANDOM_CHAR_COUNT: usize = 6;

/// Returns the prefix of temporary names for a target: a dot, which hides the file, and the
/// target's name.
pub fn prefix(target: &Path) -> OsString {
    let name = target.file_name().unwrap_or_default();
    let mut prefix = OsString::from(".");
    match name.to_str() {
        // A long but legal target name must not give an illegal temporary name.
        Some(name) if name.len() > MAX_PREFIX_BYTES => prefix.extend([truncate_name(name)]),
        _ => prefix.push(name),
    }
    prefix.push(".");
    prefix
}

/// Most bytes of a target's name that a temporary name repeats. File names have at most 255 bytes.
const MAX_PREFIX_BYTES: usize = 200;

fn truncate_name(name: &str) -> &OsStr {
    let end = (0..=MAX_PREFIX_BYTES)
        .rev()
        .find(|&i| name.is_char_boundary(i));
    OsStr::new(&name[..end.unwrap_or_default()])
}

/// Removes what killed processes have left in a folder. Does nothing if this process has cleaned
/// the folder before.
pub fn remove_leftovers(folder: &Path) {
    static CLEANED_FOLDERS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let is_first_visit = CLEANED_FOLDERS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .insert(folder.to_path_buf());
    if is_first_visit {
        remove_leftovers_now(folder);
    }
}

/// Removes leftovers without a check for earlier calls. Failures are ignored: what cannot be
/// removed stays.
fn remove_leftovers_now(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        let Some(name) = name.to_str().and_then(|name| name.strip_prefix('.')) else {
            continue;
        };
        let is_unfinished = name.ends_with(UNFINISHED_SUFFIX);
        let backup_name = name.strip_suffix(BACKUP_SUFFIX);
        let Ok(kind) = entry.file_type() else {
            continue;
        };
        if !is_unfinished && backup_name.is_none() || kind.is_symlink() {
            continue;
        }
        let remove = |path: &Path| {
            if kind.is_dir() {
                fs::remove_dir_all(path)
            } else {
                fs::remove_file(path)
            }
        };
        let Ok(file) = File::open(&path) else {
            continue;
        };
        if file.try_lock().is_err() {
            continue;
        }
        // A name that may have been cut does not tell its target.
        let target = backup_name
            .and_then(|name| name.get(..name.len().checked_sub(RANDOM_CHAR_COUNT + 1)?))
            .filter(|name| name.len() + 4 <= MAX_PREFIX_BYTES);
        let _ = match target.map(|name| folder.join(name)) {
            None if !is_unfinished => continue,
            // A process was killed where files cannot have two names, after it renamed the old file
            // and before it renamed the new one.
            Some(target) if !target.exists() => fs::rename(&path, target),
            _ => remove(&path),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlocked_leftovers_are_removed_and_replaced_files_restored() {
        let folder = tempfile::tempdir().unwrap();
        let path_of = |name: &str| folder.path().join(name);
        let temporary = |target: &str, suffix: &str| {
            let mut name = prefix(Path::new(target));
            name.push("aBc123");
            name.push(suffix);
            path_of(name.to_str().unwrap())
        };
        let [dead, alive] = ["dead", "alive"].map(|name| temporary(name, UNFINISHED_SUFFIX));
        // Not a temporary name, though it looks like one. A cut inside a character would not give
        // valid text.
        let odd = path_of(&format!(".éééé{BACKUP_SUFFIX}"));
        let [kept, lost] = ["kept.vtu", "lost.vtu"].map(|name| temporary(name, BACKUP_SUFFIX));
        for path in [
            &dead,
            &alive,
            &kept,
            &lost,
            &path_of("kept.vtu"),
            &path_of(".other.tmp"),
            &odd,
        ] {
            fs::write(path, path.to_str().unwrap()).unwrap();
        }
        // A folder with a file in it.
        let tree = temporary("a.zarr", UNFINISHED_SUFFIX);
        fs::create_dir_all(tree.join("c")).unwrap();
        fs::write(tree.join("c/0"), "").unwrap();
        let locked = File::open(&alive).unwrap();
        locked.lock().unwrap();
        remove_leftovers_now(folder.path());
        let exists = |path: &Path| path.exists();
        assert!(!cfg!(unix) || !exists(&tree));
        assert!(!exists(&dead) && exists(&alive) && !exists(&kept) && !exists(&lost));
        assert!(exists(&path_of(".other.tmp")) && exists(&odd));
        assert_eq!(
            fs::read_to_string(path_of("kept.vtu")).unwrap(),
            path_of("kept.vtu").to_str().unwrap()
        );
        assert_eq!(
            fs::read_to_string(path_of("lost.vtu")).unwrap(),
            lost.to_str().unwrap()
        );
        drop(locked);
        remove_leftovers_now(folder.path());
        assert!(!exists(&alive));
    }

    #[test]
    fn long_names_are_cut_between_characters() {
        let long = "é".repeat(120);
        let cut = prefix(Path::new(&long));
        assert_eq!(cut.to_str().unwrap(), format!(".{}.", "é".repeat(100)));
    }
}
