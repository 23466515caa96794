//! The hash of the file or the folder of an image or a mesh, and of an image in memory.

use std::io::Read;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::file_of_data_set;
use crate::Result;
use crate::error::io_error;

/// Returns the SHA-256 of a file, as `sha256sum` prints it. For a folder, it is the hash of the
/// sorted names of its files, each followed by the content of the file.
///
/// # Errors
/// Returns [`crate::Error::Io`] if a file cannot be read.
pub fn file_hash(path: &Path) -> Result<String> {
    let mut hasher = Sha256::new();
    if path.is_dir() {
        add_folder(path, path, &mut hasher)?;
    } else if let Some(file) = file_of_data_set(path) {
        add_file(&file, &mut hasher)?;
    } else {
        add_file(path, &mut hasher)?;
    }
    Ok(hexadecimal(hasher))
}

/// Returns the SHA-256 of samples as little-endian 32-bit floats.
pub(super) fn hash_of_samples(samples: &[f32]) -> String {
    let mut hasher = Sha256::new();
    for chunk in samples.chunks(1 << 14) {
        let bytes: Vec<[u8; 4]> = chunk.iter().map(|sample| sample.to_le_bytes()).collect();
        hasher.update(bytes.as_flattened());
    }
    hexadecimal(hasher)
}

fn hexadecimal(hasher: Sha256) -> String {
    let bytes = hasher.finalize();
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn add_folder(root: &Path, folder: &Path, hasher: &mut Sha256) -> Result<()> {
    let failed = |e| io_error(folder, "read", e);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
        .map_err(failed)?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            add_folder(root, &path, hasher)?;
            continue;
        }
        let name = path.strip_prefix(root).unwrap_or(&path);
        hasher.update(name.to_string_lossy().as_bytes());
        hasher.update([0]);
        add_file(&path, hasher)?;
    }
    Ok(())
}

fn add_file(path: &Path, hasher: &mut Sha256) -> Result<()> {
    let mut file = crate::files::open(path, "give a file, not a folder")?;
    let mut buffer = vec![0; 1 << 18];
    loop {
        let count = file
            .read(&mut buffer)
            .map_err(|e| io_error(path, "read", e))?;
        if count == 0 {
            break;
        }
        hasher.update(&buffer[..count]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_sha256() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        assert_eq!(
            file_hash(&path).unwrap(),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }
}
