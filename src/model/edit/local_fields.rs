//! Fields that the neighbourhood of an edit needs: features, nominal distance, and weight of the
//! image.

use super::Edit;
use super::window::EditWindow;
use crate::Result;
use crate::feature::{Features, ResolvedOptions, detect_part};
use crate::image::Image;
use crate::job::{Params, Spacing};
use crate::lattice::distance::Distance;
use crate::lattice::energy::Beta;
use crate::progress::CancelToken;

/// Input that all neighbourhoods share.
pub struct Context<'a, const D: usize> {
    /// The whole image.
    pub image: &'a Image<D>,
    /// Parameters with which the mesh was made.
    pub params: &'a Params<D>,
    /// Detection options as they were resolved for the whole image.
    pub resolved_options: &'a [ResolvedOptions],
    /// Weight of the image.
    pub beta: &'a Beta<D>,
    /// All edits.
    pub edits: &'a [Edit<D>],
}

/// The fields around an edit, in the lattice space of its window.
pub struct LocalFields<const D: usize> {
    /// Features in the window.
    pub features: Features<D>,
    /// Nominal distance d(x).
    pub distance: Distance<D>,
    /// Weight of the image.
    pub beta: Beta<D>,
}

impl<const D: usize> LocalFields<D> {
    /// Computes the fields in a window of an image whose samples are `step` apart.
    /// `variable_distance` is called for d(x) if it is not constant.
    ///
    /// # Errors
    /// Returns the errors of feature detection and of `variable_distance`.
    pub fn detect(
        window: &EditWindow<D>,
        step: [f64; D],
        context: &Context<'_, D>,
        cancel: &CancelToken<'_>,
        variable_distance: impl FnOnce() -> Result<Distance<D>>,
    ) -> Result<Self> {
        let params = context.params;
        let options = params.feature_options(step);
        let part = window.crop(context.image);
        let features = detect_part(
            &part,
            &options,
            context.resolved_options,
            &window.open_sides,
            cancel,
        )?;
        let distance = match params.spacing() {
            Spacing::Constant(d) => Distance::Constant(d),
            _ => variable_distance()?,
        };
        let beta = match context.beta {
            Beta::Constant(beta) => Beta::Constant(*beta),
            Beta::Field(field) => Beta::Field(window.crop_field(field)),
        };
        Ok(Self {
            features,
            distance,
            beta,
        })
    }
}
