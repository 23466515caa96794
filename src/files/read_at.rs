//! Reads parts of one file from many threads at once.

use std::fs::File;
use std::io::Result;

/// Fills `buffer` from byte `offset` of `file` on. Any number of threads may call this at once.
///
/// # Errors
/// Returns the error of the operating system, also if the file is too short.
#[cfg(unix)]
pub fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset)
}

/// Fills `buffer` from byte `offset` of `file` on. Any number of threads may call this at once.
///
/// # Errors
/// Returns the error of the operating system, also if the file is too short.
#[cfg(not(unix))]
pub fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> Result<()> {
    seek_and_read(file, buffer, offset)
}

/// Seeks and reads, for systems without positioned reads. A lock lets one thread at a time move the
/// file's only cursor.
#[cfg(any(not(unix), test))]
fn seek_and_read(mut file: &File, buffer: &mut [u8], offset: u64) -> Result<()> {
    use std::io::{Read, Seek, SeekFrom};
    use std::sync::{Mutex, PoisonError};

    static CURSOR: Mutex<()> = Mutex::new(());
    let _guard = CURSOR.lock().unwrap_or_else(PoisonError::into_inner);
    file.seek(SeekFrom::Start(offset))?;
    file.read_exact(buffer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parallel::prelude::*;

    #[test]
    fn threads_read_their_own_parts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("numbers");
        let numbers: Vec<u8> = (0..20_000u32).flat_map(u32::to_le_bytes).collect();
        std::fs::write(&path, &numbers).unwrap();
        let file = File::open(&path).unwrap();
        for read in [read_exact_at, seek_and_read] {
            (0..200u64).into_par_iter().for_each(|i| {
                let mut part = [0; 400];
                read(&file, &mut part, 400 * i).unwrap();
                let start = 400 * i as usize;
                assert_eq!(part, numbers[start..start + 400]);
            });
            assert!(read(&file, &mut [0; 8], 79_996).is_err());
        }
    }
}
