//! What a process that was killed leaves behind, and the next one removes.
//!
//! A temporary file is locked for as long as its process lives: a file with a temporary name that can be
//! locked belongs to nobody. Where files cannot be locked, nothing is removed.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// How names of files end that have not taken theirs yet.
pub const UNFINISHED_SUFFIX: &str = ".atomesh-unfinished";

/// How second names of files end that are being replaced.
pub const BACKUP_SUFFIX: &str = ".atomesh-before";

/// Random characters in a temporary name.
pub const RANDOM_CHAR_COUNT: usize = 6;

/// What temporary names in place of a target's begin with: hidden, and recognisable.
pub fn prefix(target: &Path) -> OsString {
    let name = target.file_name().unwrap_or_default();
    let mut prefix = OsString::from(".");
    match name.to_str() {
        // Cut so that a long (but legal) target name does not make an illegal temporary one.
        Some(name) if name.len() > MAX_PREFIX_BYTES => prefix.extend([truncate_name(name)]),
        _ => prefix.push(name),
    }
    prefix.push(".");
    prefix
}

/// Bytes of a target's name that a temporary one holds at most: names have at most 255.
const MAX_PREFIX_BYTES: usize = 200;

fn truncate_name(name: &str) -> &OsStr {
    let end = (0..=MAX_PREFIX_BYTES)
        .rev()
        .find(|&i| name.is_char_boundary(i));
    OsStr::new(&name[..end.unwrap_or_default()])
}

/// Removes what killed processes left in a folder; once for each folder.
pub fn remove_leftovers(folder: &Path) {
    static CLEANED_FOLDERS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    let swept = CLEANED_FOLDERS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .insert(folder.to_path_buf());
    if swept {
        remove_leftovers_now(folder);
    }
}

/// Failures are no matter here: what cannot be removed stays.
fn remove_leftovers_now(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        let Some(name) = name.to_str().and_then(|name| name.strip_prefix('.')) else {
            continue;
        };
        let unfinished = name.ends_with(UNFINISHED_SUFFIX);
        let before = name.strip_suffix(BACKUP_SUFFIX);
        let Ok(kind) = entry.file_type() else {
            continue;
        };
        if !unfinished && before.is_none() || kind.is_symlink() {
            continue;
        }
        let remove = |path: &Path| match kind.is_dir() {
            true => fs::remove_dir_all(path),
            false => fs::remove_file(path),
        };
        let Ok(file) = File::open(&path) else {
            continue;
        };
        if file.try_lock().is_err() {
            continue;
        }
        // A name that may have been cut says nothing of its target.
        let target = before
            .and_then(|name| name.get(..name.len().checked_sub(RANDOM_CHAR_COUNT + 1)?))
            .filter(|name| name.len() + 4 <= MAX_PREFIX_BYTES);
        let _ = match target.map(|name| folder.join(name)) {
            None if !unfinished => continue,
            // Killed where files cannot have two names, between giving this one up and the new one.
            Some(target) if !target.exists() => fs::rename(&path, target),
            _ => remove(&path),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_holds_is_removed_and_what_was_replaced_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let temporary = |target: &str, suffix: &str| {
            let mut name = prefix(Path::new(target));
            name.push("aBc123");
            name.push(suffix);
            at(name.to_str().unwrap())
        };
        let [dead, alive] = ["dead", "alive"].map(|name| temporary(name, UNFINISHED_SUFFIX));
        // Nobody's, though it looks like it; cut within a character it would be no text.
        let odd = at(&format!(".éééé{BACKUP_SUFFIX}"));
        let [kept, lost] = ["kept.vtu", "lost.vtu"].map(|name| temporary(name, BACKUP_SUFFIX));
        for path in [
            &dead,
            &alive,
            &kept,
            &lost,
            &at("kept.vtu"),
            &at(".other.tmp"),
            &odd,
        ] {
            fs::write(path, path.to_str().unwrap()).unwrap();
        }
        // A folder, with what is in it.
        let tree = temporary("a.zarr", UNFINISHED_SUFFIX);
        fs::create_dir_all(tree.join("c")).unwrap();
        fs::write(tree.join("c/0"), "").unwrap();
        let held = File::open(&alive).unwrap();
        held.lock().unwrap();
        remove_leftovers_now(folder.path());
        let there = |path: &Path| path.exists();
        assert!(!cfg!(unix) || !there(&tree));
        assert!(!there(&dead) && there(&alive) && !there(&kept) && !there(&lost));
        assert!(there(&at(".other.tmp")) && there(&odd));
        assert_eq!(
            fs::read_to_string(at("kept.vtu")).unwrap(),
            at("kept.vtu").to_str().unwrap()
        );
        assert_eq!(
            fs::read_to_string(at("lost.vtu")).unwrap(),
            lost.to_str().unwrap()
        );
        drop(held);
        remove_leftovers_now(folder.path());
        assert!(!there(&alive));
    }

    #[test]
    fn long_names_are_cut_between_characters() {
        let long = "é".repeat(120);
        let cut = prefix(Path::new(&long));
        assert_eq!(cut.to_str().unwrap(), format!(".{}.", "é".repeat(100)));
    }
}
