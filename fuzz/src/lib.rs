//! Checks of the fuzz targets, also used by `tests/any_bytes.rs`.

pub mod images;
pub mod jobs;
pub mod meshes;
mod verbs;

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// Returns a folder for the files of this thread, in memory if possible.
pub fn folder() -> PathBuf {
    thread_local!(static FOLDER: RefCell<Option<TempDir>> = const { RefCell::new(None) });
    FOLDER.with_borrow_mut(|folder| {
        let create = || {
            let memory = Path::new("/dev/shm");
            if memory.is_dir() {
                TempDir::new_in(memory)
            } else {
                TempDir::new()
            }
        };
        folder
            .get_or_insert_with(|| create().expect("a folder"))
            .path()
            .to_path_buf()
    })
}
