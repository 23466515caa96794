//! What stages gave, kept in a folder: a job that was ended goes on from there, and ends as it would have
//! ended anyhow.
//!
//! Each stage has a file, which says of which job it is and what the check sum of the rest is: what is of
//! another image, other parameters or another version is made anew, and so is what is damaged.
//!
//! - `kept`: results as bytes

mod codecs;

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::{Params, Weight};
use crate::error::{Error, cause, io_error};
pub use crate::files::codec::Codec;
use crate::files::codec::{CHECKSUM_BYTES, checksum};
use crate::files::{self, atomic};
use crate::image::{Geometry, Image, ImageLayers, ImageSource};
use crate::{Result, comm};

/// How every file of a stage begins.
const MAGIC: &[u8] = b"atomesh checkpoint 1\n";

/// A folder with what the stages of a job gave.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    folder: PathBuf,
}

/// The same, of one job.
pub struct JobCheckpoint {
    folder: PathBuf,
    /// Tells this job from all others.
    key: [u8; CHECKSUM_BYTES],
}

impl Checkpoint {
    /// In this folder, which is made if it is not there.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be made, or is no folder.
    pub fn new(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            let remedy = "give the name of a folder";
            return Err(Error::Io(cause(folder.display(), "is no folder", remedy)));
        }
        std::fs::create_dir_all(folder).map_err(|e| io_error(folder, "make the folder", e))?;
        Ok(Self {
            folder: folder.to_path_buf(),
        })
    }

    /// For a job: by all that decides its result, which only the first rank asks for.
    pub(super) fn for_job<const D: usize>(
        &self,
        source: ImageSource<'_, D>,
        params: &Params<D>,
    ) -> Result<JobCheckpoint> {
        if !comm::is_root() {
            return Ok(JobCheckpoint {
                folder: self.folder.clone(),
                key: [0; CHECKSUM_BYTES],
            });
        }
        let mut hasher = Sha256::new();
        hasher.update(env!("CARGO_PKG_VERSION"));
        match source {
            ImageSource::InMemory(image) => add_image(&mut hasher, image),
            ImageSource::Layered(layers) => add_layers(&mut hasher, layers)?,
        }
        // Images are written out in full, not as they are shown.
        let mut rest = params.clone();
        for image in rest.distance_map.take().iter() {
            add_image(&mut hasher, image);
        }
        if let Weight::Image(image) = std::mem::replace(&mut rest.beta, Weight::Constant(0.0)) {
            add_image(&mut hasher, &image);
        } else {
            rest.beta = params.beta.clone();
        }
        hasher.update(format!("{rest:?}"));
        Ok(JobCheckpoint {
            folder: self.folder.clone(),
            key: hasher.finalize().into(),
        })
    }
}

/// An image's samples, and where they lie.
fn add_image<const D: usize>(hasher: &mut Sha256, image: &Image<D>) {
    add_geometry(hasher, image.dims(), &image.geometry, &image.missing);
    image
        .dead
        .iter()
        .for_each(|dead| hasher.update([u8::from(*dead)]));
    add_samples(hasher, image.as_slice());
}

/// The same, layer by layer.
fn add_layers<const D: usize>(hasher: &mut Sha256, layers: &dyn ImageLayers<D>) -> Result<()> {
    let dims = layers.dims();
    add_geometry(hasher, dims, layers.geometry(), &[]);
    let mut layer = vec![0.0; dims[..D - 1].iter().product()];
    for i in 0..dims[D - 1] {
        layers.read_layers(i, &mut layer)?;
        add_samples(hasher, &layer);
    }
    Ok(())
}

fn add_geometry<const D: usize>(
    hasher: &mut Sha256,
    dims: [usize; D],
    geometry: &Geometry<D>,
    missing: &[bool],
) {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write!(text, "{dims:?} {geometry:?} {missing:?}");
    hasher.update(text);
}

fn add_samples(hasher: &mut Sha256, samples: &[f32]) {
    let mut bytes = Vec::new();
    for part in samples.chunks(1 << 16) {
        bytes.clear();
        bytes.extend(part.iter().flat_map(|v| v.to_le_bytes()));
        hasher.update(&bytes);
    }
}

/// What there is of a stage.
pub enum StoredStage<T> {
    /// Its result.
    Complete(T),
    /// Nothing.
    Missing,
    /// A file that is of no use, and why.
    Unusable(String),
}

impl JobCheckpoint {
    fn stage_file(&self, stage: &str) -> PathBuf {
        self.folder.join(format!("{stage}.checkpoint"))
    }

    /// What was kept of a stage.
    pub fn load<T: Codec>(&self, stage: &str) -> StoredStage<T> {
        let path = self.stage_file(stage);
        let useless = |why: &str| StoredStage::Unusable(format!("{}: {why}", path.display()));
        if !path.exists() {
            return StoredStage::Missing;
        }
        let read = files::open(&path, "remove it")
            .and_then(|_| std::fs::read(&path).map_err(|e| io_error(&path, "read", e)));
        let Ok(bytes) = read else {
            return useless("cannot be read: this stage is made again");
        };
        let parts = bytes.strip_prefix(MAGIC).and_then(|rest| {
            let (key, rest) = rest.split_first_chunk::<CHECKSUM_BYTES>()?;
            let (sum, rest) = rest.split_first_chunk::<CHECKSUM_BYTES>()?;
            Some((key, sum, rest))
        });
        let Some((key, sum, mut rest)) = parts else {
            return useless("is damaged: this stage is made again");
        };
        if *key != self.key {
            return useless(
                "is of another image, other options or another version: this stage is made anew",
            );
        }
        let whole = Sha256::digest(rest)[..] == sum[..];
        match whole.then(|| T::decode(&mut rest)).flatten() {
            Some(value) if rest.is_empty() => StoredStage::Complete(value),
            _ => useless("is damaged: this stage is made again"),
        }
    }

    /// Keeps the result of a stage, whatever becomes of the job.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written.
    pub fn save<T: Codec>(&self, stage: &str, value: &T) -> Result<()> {
        let path = self.stage_file(stage);
        let sum = checksum(value).map_err(|e| io_error(&path, "write", e))?;
        atomic::commit_immediately(|| {
            files::atomic_write(&path, |out| {
                out.write_all(MAGIC)?;
                out.write_all(&self.key)?;
                out.write_all(&sum)?;
                value.encode(out)
            })
        })
    }
}
