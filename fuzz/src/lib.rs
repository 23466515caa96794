//! What the fuzz targets share, and the test of any job.

pub mod jobs;
pub mod verbs;

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// A folder for the files of one process, in memory where that is possible.
pub fn folder() -> PathBuf {
    thread_local!(static FOLDER: RefCell<Option<TempDir>> = const { RefCell::new(None) });
    FOLDER.with_borrow_mut(|folder| {
        let made = || {
            let memory = Path::new("/dev/shm");
            match memory.is_dir() {
                true => TempDir::new_in(memory),
                false => TempDir::new(),
            }
        };
        folder
            .get_or_insert_with(|| made().expect("a folder"))
            .path()
            .to_path_buf()
    })
}
