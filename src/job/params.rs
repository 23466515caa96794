//! What a job asks for: how far atoms are apart, what they follow, how they move, what is done with the
//! mesh.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::feature;
use crate::image::{Geometry, Image, Modality};
use crate::improve;
use crate::improve::triangles::relax::Scheme;
use crate::lattice::optimize;
use crate::lattice::seeding::{self, Seeding};

/// How far atoms shall be apart, in the lengths of [`Params::metric`] (Canny's points: in samples).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spacing {
    /// The same everywhere.
    Constant(f64),
    /// `min` on features, growing to `max` away from them.
    FromFeatures {
        /// Distance on features.
        min: f64,
        /// Distance far from them.
        max: f64,
    },
    /// `max`, but `min` at least where features run close together.
    FromFeatureGaps {
        /// Least distance.
        min: f64,
        /// Distance where no other feature is near.
        max: f64,
    },
    /// Where the image is as dark as its features `min` (as bright, if they are bright), at the other end
    /// `max`.
    FromImage {
        /// Least distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
    /// From the Laplacian of b(x): `min` in its valleys, at most `max`.
    FromLaplacian {
        /// Least distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
    /// As the atoms lie that [`Seeding::Canny`] places.
    FromCannyAtoms {
        /// The least distance between those on features.
        min: f64,
        /// The distance where nothing else is.
        max: f64,
    },
    /// As [`Params::distance_map`] says, clipped.
    FromDistanceMap {
        /// Least distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
}

/// 8 samples, and a third of that in gaps between features.
pub(super) const DEFAULT_DISTANCES: [f64; 2] = [2.7, 8.0];

impl Default for Spacing {
    fn default() -> Self {
        let [min, max] = DEFAULT_DISTANCES;
        Self::FromFeatureGaps { min, max }
    }
}

impl Spacing {
    /// The smallest distance asked for.
    pub fn min(self) -> f64 {
        self.limits()[0]
    }

    /// The largest distance asked for.
    pub fn max(self) -> f64 {
        self.limits()[1]
    }

    fn limits(self) -> [f64; 2] {
        match self {
            Self::Constant(d) => [d; 2],
            Self::FromFeatures { min, max }
            | Self::FromFeatureGaps { min, max }
            | Self::FromImage { min, max }
            | Self::FromLaplacian { min, max }
            | Self::FromCannyAtoms { min, max }
            | Self::FromDistanceMap { min, max } => [min, max],
        }
    }

    /// The same kind in a larger unit of length; Canny's points are samples apart anyhow.
    fn scaled_by_unit(mut self, unit: f64) -> Self {
        match &mut self {
            Self::FromCannyAtoms { .. } => {}
            Self::Constant(d) => *d /= unit,
            Self::FromFeatures { min, max }
            | Self::FromFeatureGaps { min, max }
            | Self::FromImage { min, max }
            | Self::FromLaplacian { min, max }
            | Self::FromDistanceMap { min, max } => {
                *min /= unit;
                *max /= unit;
            }
        }
        self
    }

    /// That of [`Seeding::Canny`], in a space of `dimensions`.
    pub fn for_canny(dimensions: usize) -> Self {
        Self::FromCannyAtoms {
            min: seeding::canny::min_point_distance(dimensions),
            max: seeding::canny::UNIFORM_SPACING,
        }
    }
}

/// The length of one sample along each axis, which says in which space cells shall be well shaped.
///
/// Lattice space has these lengths, but for a common factor: a unit cube of it holds one sample, so
/// that windows and grids are as large as for [`Metric::Samples`] whatever the unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Metric<const D: usize = 3> {
    /// 1: cells are as flat as the image's own samples.
    Samples,
    /// The image's physical spacing.
    Physical,
    /// The same times one factor, such that a cube of lattice space holds as many samples as ever.
    Shape,
    /// As given.
    Scales([f64; D]),
}

impl<const D: usize> Metric<D> {
    /// The step of lattice space along each axis.
    pub fn step(self, geometry: &Geometry<D>) -> [f64; D] {
        let unit = self.unit(geometry);
        self.lengths(geometry).map(|length| length / unit)
    }

    /// The length of the unit of lattice space, a cube of which holds as many samples as ever.
    pub fn unit(self, geometry: &Geometry<D>) -> f64 {
        match self {
            Self::Samples | Self::Shape => 1.0,
            Self::Physical | Self::Scales(_) => geometric_mean(self.lengths(geometry)),
        }
    }

    /// The length of one sample along each axis.
    pub fn lengths(self, geometry: &Geometry<D>) -> [f64; D] {
        match self {
            Self::Samples => [1.0; D],
            Self::Physical => geometry.spacing(),
            Self::Shape => {
                let spacing = geometry.spacing();
                spacing.map(|s| s / geometric_mean(spacing))
            }
            Self::Scales(lengths) => lengths,
        }
    }
}

/// The geometric mean; exact where all are the same.
fn geometric_mean<const D: usize>(lengths: [f64; D]) -> f64 {
    let longest = lengths.into_iter().fold(0.0, f64::max);
    let shape: f64 = lengths.iter().map(|length| length / longest).product();
    longest * shape.powf(1.0 / D as f64)
}

/// The weight of the image against the lattice: 0 is lattice only, 1 image only.
#[derive(Debug, Clone, PartialEq)]
pub enum Weight<const D: usize = 3> {
    /// The same everywhere.
    Constant(f64),
    /// An image of weights, of the same dims as the image to mesh.
    Image(Box<Image<D>>),
}

/// Which evaluator of the lattice energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Evaluator {
    /// Neighbour lists and exact gradients (fast)
    Pairwise,
    /// Accumulated on the image's grid, as published in 2001 (slow)
    Sampled,
}

/// An atom that a user placed.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedAtom<const D: usize = 3> {
    /// What to call it in an error, e.g. the line of the file it comes from.
    pub name: String,
    /// Where it is, in the image's physical coordinates.
    pub position: [f64; D],
}

/// A well, in the image's physical coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct WellPath<const D: usize = 3> {
    /// What to call it in an error, e.g. its file.
    pub name: String,
    /// The points of its way; in 2-D one may do.
    pub points: Vec<[f64; D]>,
    /// Its largest radius.
    pub radius: f64,
}

/// What the mesh is made of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum CellKind {
    /// Tetrahedra, or triangles in the plane, with atoms on the features.
    #[default]
    Simplices,
    /// Voronoi cells of atoms alongside the features.
    Voronoi,
}

/// What the whole job is told.
#[derive(Debug, Clone, PartialEq)]
pub struct Params<const D: usize = 3> {
    /// What the mesh is made of.
    pub cells: CellKind,
    /// Distance between atoms.
    pub spacing: Spacing,
    /// Distances, one per sample of the image, for [`StackSpacing::FromDistanceMap`].
    pub distance_map: Option<Box<Image<D>>>,
    /// Features to follow.
    pub feature: feature::FeatureKind,
    /// Where the image comes from, if its geometry alone does not tell.
    pub modality: Modality,
    /// Width in samples of the Gaussian under which features are sought; by kind if `None`.
    pub sigma: Option<f64>,
    /// Least strength of a feature, in units of the image; from the image itself if `None`.
    pub threshold: Option<f32>,
    /// Depths of the valleys of faults and of horizons where both are followed.
    pub feature_weights: [f64; 2],
    /// Points of an object and around it, for [`feature::FeatureKind::Paths`].
    pub path_seeds: feature::PathSeeds<D>,
    /// What is wanted of labels, for [`feature::FeatureKind::Labels`].
    pub labels: Vec<feature::LabelOptions>,
    /// Whether no common null values are recognised, nor traces that are zero throughout.
    pub keep_nulls: bool,
    /// Weight of the image.
    pub beta: Weight<D>,
    /// Atoms that stay where they are (wells, sources).
    pub fixed_atoms: Vec<FixedAtom<D>>,
    /// Wells: fixed atoms along their ways.
    pub wells: Vec<WellPath<D>>,
    /// Distance between atoms at wells; as elsewhere if `None`.
    pub well_distance: Option<f64>,
    /// Initial positions of atoms.
    pub seeding: Seeding,
    /// Evaluator of the energy.
    pub evaluator: Evaluator,
    /// Weight in [0, 1] of the energy between atoms against their Laplacian coordinates
    /// ([`Regularised`](crate::densest_lattice::energy::RegularisedEnergy)); 1 leaves those out.
    pub kappa: f64,
    /// How atoms are moved.
    pub optimizer: optimize::Method,
    /// Most rounds of perturbing and minimising (Hale 2001, Algorithm 3), which end when one gains nothing;
    /// if `None`, one, or three with Laplacian coordinates.
    pub rounds: Option<usize>,
    /// Number of passes on smoother potentials before the last one: the first is 2^n times as wide.
    pub coarse_passes: usize,
    /// Smallest (dihedral) angle aimed at, in degrees; `None` leaves the slivers in.
    pub min_dihedral: Option<f64>,
    /// How they are removed.
    pub sliver_method: improve::SliverMethod,
    /// Nodes of Voronoi cells nearer to one another than this share of the cells' size are one.
    pub weld_ratio: f64,
    /// How a triangulation of the plane is smoothed under the weight of the image, if it shall be.
    pub smoothing: Option<Scheme>,
    /// Lattice space.
    pub metric: Metric<D>,
    /// Seed of the perturbations.
    pub seed: u64,
}

impl<const D: usize> Default for Params<D> {
    fn default() -> Self {
        Self {
            cells: CellKind::default(),
            spacing: Spacing::default(),
            feature: feature::FeatureKind::Auto,
            modality: Modality::Unknown,
            sigma: None,
            threshold: None,
            feature_weights: [1.0; 2],
            distance_map: None,
            path_seeds: feature::PathSeeds::default(),
            labels: Vec::new(),
            keep_nulls: false,
            beta: Weight::Constant(0.5),
            fixed_atoms: Vec::new(),
            wells: Vec::new(),
            well_distance: None,
            seeding: Seeding::Fcc,
            evaluator: Evaluator::Pairwise,
            kappa: 1.0,
            optimizer: optimize::Method::Lbfgs,
            rounds: None,
            coarse_passes: 0,
            min_dihedral: Some(30.0),
            sliver_method: improve::SliverMethod::Joe,
            weld_ratio: 0.0,
            smoothing: None,
            metric: Metric::Samples,
            seed: 1,
        }
    }
}

impl<const D: usize> Params<D> {
    /// The same with distances in units of lattice space, each of which is `unit` long.
    pub(crate) fn in_lattice_units(&self, unit: f64) -> Cow<'_, Self> {
        if unit == 1.0 {
            return Cow::Borrowed(self);
        }
        let mut params = self.clone();
        params.spacing = self.spacing.scaled_by_unit(unit);
        params.well_distance = self.well_distance.map(|d| d / unit);
        for wish in &mut params.labels {
            wish.distance = wish.distance.map(|d| d / unit);
        }
        if let Some(distances) = &mut params.distance_map {
            let samples = distances.as_slice().iter();
            let samples = samples.map(|&d| (f64::from(d) / unit) as f32).collect();
            **distances = Image::new(distances.dims(), samples, distances.geometry.clone());
        }
        Cow::Owned(params)
    }

    /// How features are sought.
    pub fn feature_options(&self, step: [f64; D]) -> feature::DetectionOptions<D> {
        // Canny's points are, unless another feature is named, points of Canny's edges.
        let kind = match (self.feature, self.seeding) {
            (feature::FeatureKind::Auto, Seeding::Canny) => feature::FeatureKind::Canny,
            (kind, _) => kind,
        };
        feature::DetectionOptions {
            kind,
            modality: self.modality,
            scale: self.sigma,
            threshold: self.threshold,
            weights: self.feature_weights,
            seeds: self.path_seeds.clone(),
            labels: self.labels.clone(),
            d_min: self.spacing.min(),
            gap_d_max: match self.spacing {
                Spacing::FromFeatureGaps { max, .. } => Some(max),
                _ => None,
            },
            step,
            keep_nulls: self.keep_nulls,
            ..feature::DetectionOptions::default()
        }
    }
}
