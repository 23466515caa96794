//! Images that stay in memory after they were read from files.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::Result;
use crate::image::formats::{AnyImage, InputOptions, file_hash, read_with_options};

/// Largest number of images that stay in memory; the one that was read first leaves first.
const MAX_IMAGES: usize = 4;

/// Images as they were read from files, and hashes of files. Files that change meanwhile are not read
/// again.
#[derive(Debug, Default)]
pub struct ImageCache {
    entries: Mutex<Entries>,
}

#[derive(Debug, Default)]
struct Entries {
    images: Vec<(PathBuf, InputOptions, Arc<AnyImage>)>,
    hashes: Vec<(PathBuf, String)>,
}

impl ImageCache {
    fn entries(&self) -> MutexGuard<'_, Entries> {
        // Entries are complete whenever the lock is released.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the image of a file, as [`read_with_options`] does.
    pub(super) fn read(&self, path: &Path, input: &InputOptions) -> Result<AnyImage> {
        let mut entries = self.entries();
        let images = &mut entries.images;
        let known = images
            .iter()
            .find(|entry| entry.0 == path && entry.1 == *input);
        if let Some((_, _, image)) = known {
            return Ok((**image).clone());
        }
        let image = Arc::new(read_with_options(path, input)?);
        if images.len() == MAX_IMAGES {
            images.remove(0);
        }
        images.push((path.into(), input.clone(), Arc::clone(&image)));
        Ok((*image).clone())
    }

    /// Returns the hash of a file.
    pub(super) fn hash(&self, path: &Path) -> Result<String> {
        let mut entries = self.entries();
        let hashes = &mut entries.hashes;
        if let Some((_, hash)) = hashes.iter().find(|entry| entry.0 == path) {
            return Ok(hash.clone());
        }
        let hash = file_hash(path)?;
        hashes.push((path.into(), hash.clone()));
        Ok(hash)
    }
}
