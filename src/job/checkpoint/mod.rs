//! Results of stages, stored in a folder. A job that was stopped continues from there, with the
//! result that it would have had without the stop.
//!
//! Each stage has a file, which holds the key of its job and a checksum of the content. A stage is
//! run again if its file is of another image, other parameters or another version, or is damaged.
//!
//! - `codecs`: encoding of results as bytes

mod codecs;

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::{Params, Weight};
use crate::Result;
use crate::comm::Comm;
use crate::error::{Error, cause, io_error};
pub use crate::files::codec::Codec;
use crate::files::codec::{CHECKSUM_BYTES, checksum};
use crate::files::{self, atomic};
use crate::image::{Geometry, Image, ImageLayers, ImageSource};

/// First bytes of every checkpoint file.
const MAGIC: &[u8] = b"atomesh checkpoint 1\n";

/// A folder with the results of stages.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    folder: PathBuf,
}

/// The checkpoint folder for one job.
pub struct JobCheckpoint {
    folder: PathBuf,
    /// Hash that identifies the job.
    key: [u8; CHECKSUM_BYTES],
}

impl Checkpoint {
    /// Opens a checkpoint folder, which is created if it does not exist.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if it cannot be created, or is not a folder.
    pub fn new(folder: &Path) -> Result<Self> {
        if folder.exists() && !folder.is_dir() {
            let remedy = "give the name of a folder";
            return Err(Error::Io(cause(
                folder.display(),
                "is not a folder",
                remedy,
            )));
        }
        std::fs::create_dir_all(folder).map_err(|e| io_error(folder, "make the folder", e))?;
        Ok(Self {
            folder: folder.to_path_buf(),
        })
    }

    /// Returns the checkpoint of a job. Its key is a hash of everything that determines the result;
    /// only the root rank computes it.
    pub(super) fn for_job<const D: usize>(
        &self,
        source: ImageSource<'_, D>,
        params: &Params<D>,
        comm: &dyn Comm,
    ) -> Result<JobCheckpoint> {
        if !comm.is_root() {
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
        // Images are hashed sample by sample, as their debug output is abbreviated.
        let mut other_params = params.clone();
        // Where results are written does not matter.
        other_params.spec = other_params.spec.reproducible();
        for surface in std::mem::take(&mut other_params.surfaces) {
            hasher.update(format!("{} {:?}", surface.option, surface.surface.name));
            hasher.update(format!("{:?}", surface.surface.coordinates));
            let numbers = surface.surface.shape.points().flatten();
            numbers.for_each(|c| hasher.update(c.to_le_bytes()));
        }
        for image in other_params.distance_map.take().iter() {
            add_image(&mut hasher, image);
        }
        if let Weight::Image(image) =
            std::mem::replace(&mut other_params.beta, Weight::Constant(0.0))
        {
            add_image(&mut hasher, &image);
        } else {
            other_params.beta = params.beta.clone();
        }
        hasher.update(format!("{other_params:?}"));
        Ok(JobCheckpoint {
            folder: self.folder.clone(),
            key: hasher.finalize().into(),
        })
    }
}

/// Hashes an image's geometry and samples.
fn add_image<const D: usize>(hasher: &mut Sha256, image: &Image<D>) {
    add_geometry(hasher, image.dims(), &image.geometry, &image.missing);
    image
        .dead
        .iter()
        .for_each(|dead| hasher.update([u8::from(*dead)]));
    add_samples(hasher, image.as_slice());
}

/// Hashes an image that is read layer by layer.
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

/// The stored result of a stage.
pub enum StoredStage<T> {
    /// The result of the stage.
    Complete(T),
    /// There is no file.
    Missing,
    /// The file cannot be used, for this reason.
    Unusable(String),
}

impl JobCheckpoint {
    fn stage_file(&self, stage: &str) -> PathBuf {
        self.folder.join(format!("{stage}.checkpoint"))
    }

    /// Loads the result of a stage.
    pub fn load<T: Codec>(&self, stage: &str) -> StoredStage<T> {
        let path = self.stage_file(stage);
        let unusable =
            |reason: &str| StoredStage::Unusable(format!("{}: {reason}", path.display()));
        if !path.exists() {
            return StoredStage::Missing;
        }
        let read = files::open(&path, "remove it")
            .and_then(|_| std::fs::read(&path).map_err(|e| io_error(&path, "read", e)));
        let Ok(bytes) = read else {
            return unusable("cannot be read: this stage is run again");
        };
        let parts = bytes.strip_prefix(MAGIC).and_then(|rest| {
            let (key, rest) = rest.split_first_chunk::<CHECKSUM_BYTES>()?;
            let (sum, rest) = rest.split_first_chunk::<CHECKSUM_BYTES>()?;
            Some((key, sum, rest))
        });
        let Some((key, sum, mut rest)) = parts else {
            return unusable("is damaged: this stage is run again");
        };
        if *key != self.key {
            return unusable(
                "is of another image, other options or another version: this stage is run again",
            );
        }
        let is_intact = Sha256::digest(rest)[..] == sum[..];
        match is_intact.then(|| T::decode(&mut rest)).flatten() {
            Some(value) if rest.is_empty() => StoredStage::Complete(value),
            _ => unusable("is damaged: this stage is run again"),
        }
    }

    /// Stores the result of a stage at once, even if the job fails later.
    ///
    /// # Errors
    /// Returns [`Error::Io`] if it cannot be written.
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
