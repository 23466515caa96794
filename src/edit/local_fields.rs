//! Fields that the neighbourhood of an edit needs: features, nominal distance, and weight of the
//! image.

use super::Edit;
use super::resolve::{EditGroup, INFLUENCE_RADIUS};
use super::whole_features::WholeFeatures;
use super::window::EditWindow;
use crate::Result;
use crate::feature::resolved::detection_reach;
use crate::feature::{Features, ResolvedOptions, detect_part};
use crate::geometry::bounding_box;
use crate::image::Image;
use crate::job::{LatticeParams, Spacing, lattice_beta};
use crate::lattice::distance::Distance;
use crate::lattice::energy::Beta;
use crate::progress::CancelToken;

/// Input that all neighbourhoods share.
pub struct Context<'a, const D: usize> {
    /// The whole image.
    pub image: &'a Image<D>,
    /// Parameters with which the mesh was made.
    pub params: &'a LatticeParams<'a, D>,
    /// Detection options as they were resolved for the whole image.
    pub resolved_options: Vec<ResolvedOptions>,
    /// Weight of the image.
    pub beta: Beta<D>,
    /// All edits.
    pub edits: &'a [Edit<D>],
    /// The features of the whole image, if they are known.
    pub whole_features: Option<&'a WholeFeatures<D>>,
}

impl<'a, const D: usize> Context<'a, D> {
    /// Creates the input for samples that are `step` apart.
    ///
    /// # Errors
    /// Returns an error if the weight does not fit the image.
    pub fn new(
        image: &'a Image<D>,
        params: &'a LatticeParams<'a, D>,
        edits: &'a [Edit<D>],
        resolved_options: Vec<ResolvedOptions>,
        step: [f64; D],
    ) -> Result<Self> {
        Ok(Self {
            whole_features: None,
            image,
            params,
            resolved_options,
            beta: lattice_beta(params.beta(), image.dims(), step)?,
            edits,
        })
    }
}

impl<const D: usize> EditGroup<D> {
    /// Returns the window that contains these positions and all that an edit depends on, with the
    /// samples that detection needs around them. Samples are `step` apart; `extent` is the far
    /// corner of the box.
    pub fn window(
        &self,
        positions: &[[f64; D]],
        context: &Context<'_, D>,
        step: [f64; D],
        extent: [f64; D],
    ) -> EditWindow<D> {
        let [mut low, mut high] = bounding_box(positions);
        high = high.map(|x| x.max(0.0));
        for (x, d) in &self.edited_places {
            low = std::array::from_fn(|k| low[k].min(x[k] - INFLUENCE_RADIUS * d));
            high = std::array::from_fn(|k| high[k].max(x[k] + INFLUENCE_RADIUS * d));
        }
        let margin = detection_reach::<D>(&context.resolved_options);
        EditWindow::from_bounds(low, high, margin, context.image.dims(), step, extent)
    }
}

/// The fields around an edit, in the lattice space of its window.
pub struct LocalFields<const D: usize> {
    /// Features in the window.
    pub features: Features<D>,
    /// Number of samples in which features were detected.
    pub detected_samples: usize,
    /// Nominal distance d(x).
    pub distance: Distance<D>,
    /// Weight of the image.
    pub beta: Beta<D>,
}

impl<const D: usize> LocalFields<D> {
    /// Computes the fields in a window of an image whose samples are `step` apart. Features are
    /// detected there if those of the whole image are not known.
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
        let (features, detected_samples) = match context.whole_features {
            Some(whole) => (whole.in_window(window), 0),
            None => {
                let options = params.feature_options(step);
                let (part, resolved) = (window.crop(context.image), &context.resolved_options);
                let sides = &window.open_sides;
                let features = detect_part(&part, &options, resolved, sides, cancel)?;
                (features, window.dims.iter().product())
            }
        };
        let distance = match params.spacing() {
            Spacing::Constant(d) => Distance::Constant(d),
            _ => variable_distance()?,
        };
        let beta = match &context.beta {
            Beta::Constant(beta) => Beta::Constant(*beta),
            Beta::Field(field) => Beta::Field(window.crop_field(field)),
        };
        Ok(Self {
            features,
            detected_samples,
            distance,
            beta,
        })
    }
}
