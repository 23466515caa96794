//! Opens files that are read more than once, or from the middle.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result, cause, io_error};

/// Opens a file that is read more than once, or from its middle. A folder is refused, and so is a
/// pipe or a device, which could keep the reader waiting endlessly. `remedy` says what to give
/// instead of a folder.
///
/// # Errors
/// Returns [`Error::Io`] if the path is not a regular file or cannot be opened.
pub fn open(path: &Path, remedy: &str) -> Result<File> {
    let kind = fs::metadata(path)
        .map_err(|e| io_error(path, "open", e))?
        .file_type();
    if kind.is_dir() {
        return Err(Error::Io(cause(path.display(), "is a folder", remedy)));
    }
    if !kind.is_file() {
        let problem = "is a pipe or a device, which cannot be read from more than one place";
        let remedy = "write its content to a file first";
        return Err(Error::Io(cause(path.display(), problem, remedy)));
    }
    File::open(path).map_err(|e| io_error(path, "open", e))
}

/// Reads a whole file, as [`open`] opens it.
///
/// # Errors
/// Returns the errors of [`open`], and [`Error::Io`] if the file cannot be read.
pub fn read(path: &Path, remedy: &str) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path, remedy)?
        .read_to_end(&mut bytes)
        .map_err(|e| io_error(path, "read", e))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_devices_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let message = |path: &Path| open(path, "give a file").unwrap_err().to_string();
        assert!(message(folder.path()).contains("is a folder; give a file"));
        assert!(message(&folder.path().join("none")).contains("cannot open"));
        #[cfg(unix)]
        {
            let pipe = folder.path().join("pipe");
            let status = std::process::Command::new("mkfifo").arg(&pipe).status();
            assert!(status.unwrap().success());
            assert!(message(&pipe).contains("pipe or a device"));
        }
        let file = folder.path().join("file");
        fs::write(&file, "x").unwrap();
        assert!(open(&file, "").is_ok());
    }
}
