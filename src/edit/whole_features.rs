//! Features of a whole image, which the edits of a session share.
//!
//! Most of the time of an edit goes into the detection of features near it. An edit that is not the
//! first of its image takes them from those of the whole image instead.

use std::sync::OnceLock;

use super::window::EditWindow;
use crate::Result;
use crate::feature::{DetectionOptions, FeaturePoint, Features, ResolvedOptions, detect_part};
use crate::image::{Image, ScalarField, SparseField};
use crate::job::{LatticeParams, Params};
use crate::progress::CancelToken;

/// An image that was meshed, with the parameters of its mesh.
#[derive(Debug, Clone, Copy)]
pub struct EditImage<'a, const D: usize> {
    /// The image.
    pub image: &'a Image<D>,
    /// The parameters with which the mesh was made.
    pub params: &'a Params<D>,
    /// The features of the whole image, if several edits share them. The first of these edits
    /// detects them. By default, each edit detects the features near it.
    pub features: Option<&'a OnceLock<WholeFeatures<D>>>,
}

impl<'a, const D: usize> EditImage<'a, D> {
    /// Returns an image in which each edit detects the features near it.
    pub fn new(image: &'a Image<D>, params: &'a Params<D>) -> Self {
        Self {
            image,
            params,
            features: None,
        }
    }
}

/// Features of a whole image.
#[derive(Debug)]
pub struct WholeFeatures<const D: usize> {
    /// The features. Their potential is zero.
    features: Features<D>,
    /// The potential b(x).
    potential: ScalarField<D>,
}

impl<const D: usize> WholeFeatures<D> {
    /// Detects the features of an image, with options that are resolved already. Samples are `step`
    /// apart.
    ///
    /// # Errors
    /// Returns the errors of feature detection.
    pub(super) fn detect(
        image: &Image<D>,
        params: &LatticeParams<'_, D>,
        resolved: &[ResolvedOptions],
        step: [f64; D],
        cancel: &CancelToken<'_>,
    ) -> Result<Self> {
        let (options, closed_sides) = (params.feature_options(step), [[false; 2]; D]);
        let mut features = detect_part(image, &options, resolved, &closed_sides, cancel)?;
        let zero = SparseField::zero(image.dims(), step);
        let potential = std::mem::replace(&mut features.potential, zero).to_dense();
        Ok(Self {
            features,
            potential,
        })
    }

    /// Returns the features in a window, in the window's lattice space. They have no labels.
    pub(super) fn in_window(&self, window: &EditWindow<D>) -> Features<D> {
        let whole = &self.features;
        let extent = window.extent();
        let inside: Vec<(usize, [f64; D])> = (whole.points.iter())
            .map(|point| window.to_local(point.position.map(f64::from)))
            .enumerate()
            .filter(|(_, x)| (0..D).all(|k| (0.0..=extent[k]).contains(&x[k])))
            .collect();
        let point = |&(i, x): &(usize, [f64; D])| FeaturePoint {
            position: x.map(|c| c as f32),
            ..whole.points[i]
        };
        let spacing = (whole.spacing.as_ref())
            .map(|spacing| inside.iter().map(|&(i, _)| spacing[i]).collect());
        Features {
            points: inside.iter().map(point).collect(),
            surface: inside.iter().map(|&(i, _)| whole.surface[i]).collect(),
            on_horizon: inside.iter().map(|&(i, _)| whole.on_horizon[i]).collect(),
            names: whole.names.clone(),
            potential: SparseField::from_field(&window.crop_field(&self.potential)),
            spacing,
            sigma: whole.sigma,
            ..Features::empty(window.dims, &DetectionOptions::default())
        }
    }
}
