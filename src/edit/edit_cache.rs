//! Images as edits prepare them, which stay in memory between the edits of a session.

use std::sync::{Arc, OnceLock};

use super::whole_features::{EditImage, WholeFeatures};
use crate::Result;
use crate::image::Image;
use crate::job::{MeshSpec, Params};
use crate::memory::LastValue;

/// The image of the last edit, as it was prepared for the options of its mesh, with its features. An
/// edit of another mesh of the same image with the same options takes it over.
#[derive(Debug, Default)]
pub struct EditCache(LastValue);

impl EditCache {
    /// Returns the image that was prepared for these options, or prepares it. `hash` is that of the
    /// file of the image.
    ///
    /// # Errors
    /// Returns the errors of `prepare`.
    pub(super) fn prepared<const D: usize>(
        &self,
        hash: &str,
        spec: &MeshSpec,
        prepare: impl FnOnce() -> Result<(Image<D>, Params<D>)>,
    ) -> Result<Arc<PreparedImage<D>>> {
        let fits = |known: &PreparedImage<D>| known.hash == hash && known.spec == *spec;
        let make = || Ok(PreparedImage::new(hash, spec, prepare()?));
        self.0.get_or_make(fits, make)
    }
}

/// An image that is prepared for edits.
#[derive(Debug)]
pub(super) struct PreparedImage<const D: usize> {
    hash: String,
    spec: MeshSpec,
    image: Image<D>,
    params: Params<D>,
    features: OnceLock<WholeFeatures<D>>,
}

impl<const D: usize> PreparedImage<D> {
    /// Returns an image that was prepared for these options.
    pub fn new(hash: &str, spec: &MeshSpec, (image, params): (Image<D>, Params<D>)) -> Self {
        Self {
            hash: hash.into(),
            spec: spec.clone(),
            image,
            params,
            features: OnceLock::new(),
        }
    }

    /// Returns the image for an edit, which takes the features of the whole image if several edits
    /// `share` them.
    pub fn for_edit(&self, share: bool) -> EditImage<'_, D> {
        EditImage {
            image: &self.image,
            params: &self.params,
            features: share.then_some(&self.features),
        }
    }
}
