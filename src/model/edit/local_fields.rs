//! What an edit's neighbourhood lies in: features, distance, weight of the image.

use super::Edit;
use super::window::EditWindow;
use crate::Result;
use crate::feature::{Features, ResolvedOptions, detect_part};
use crate::image::Image;
use crate::job::{Params, Spacing};
use crate::lattice::distance::Distance;
use crate::lattice::energy::Beta;
use crate::progress::CancelToken;

/// What is the same for all neighbourhoods.
pub struct Context<'a, const D: usize> {
    /// The image.
    pub image: &'a Image<D>,
    /// What the mesh was made with.
    pub params: &'a Params<D>,
    /// What detection settled on.
    pub resolved_options: &'a [ResolvedOptions],
    /// The weight of the image.
    pub beta: &'a Beta<D>,
    /// All edits.
    pub edits: &'a [Edit<D>],
}

/// What a neighbourhood lies in, in the lattice space of its window.
pub struct LocalFields<const D: usize> {
    /// The features there.
    pub features: Features<D>,
    /// d(x), as the mesh knows it.
    pub distance: Distance<D>,
    /// The weight of the image.
    pub beta: Beta<D>,
}

impl<const D: usize> LocalFields<D> {
    /// Looks at what is in a window of a box whose samples are `step` apart; `varying` tells a distance
    /// that is not the same everywhere.
    ///
    /// # Errors
    /// Those of feature detection, and of `varying`.
    pub fn detect(
        window: &EditWindow<D>,
        step: [f64; D],
        context: &Context<'_, D>,
        patience: &CancelToken<'_>,
        varying: impl FnOnce() -> Result<Distance<D>>,
    ) -> Result<Self> {
        let params = context.params;
        let options = params.feature_options(step);
        let part = window.crop(context.image);
        let features = detect_part(
            &part,
            &options,
            context.resolved_options,
            &window.open_sides,
            patience,
        )?;
        let distance = match params.spacing {
            Spacing::Constant(d) => Distance::Constant(d),
            _ => varying()?,
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
