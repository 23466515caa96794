//! Parameters of a job: its options, and the content of the files that they name.

use std::array;
use std::borrow::Cow;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::atom_file::AtomFile;
use super::given_surfaces::{self, FollowedSurface};
use super::placed_points::PointFile;
use super::spec::{
    DistanceSource, FileOption, MeshSpec, Metric, NominalDistance, NumberOrFile, SeedingKind,
};
use crate::error::cause;
use crate::feature::{self, FeatureKind, LabelOptions};
use crate::geometry::norm;
use crate::image::formats::{AnyImage, InputOptions, ReadImage, read_with_options};
use crate::image::{Geometry, Image, ImageSource, LabelTable, LabelValue, Modality, VelocityModel};
use crate::improve::Effort;
use crate::lattice::optimise::Method;
use crate::names::append_distinct;
use crate::progress::ASSUMED;
use crate::published::{canny, genetic};
use crate::well_file::WellFile;
use crate::{Error, Result};

/// Nominal distance between atoms, in units of [`MeshSpec::metric`] (for Canny's points in
/// samples).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spacing {
    /// A constant distance.
    Constant(f64),
    /// `min` on features, growing to `max` away from them.
    FromFeatures {
        /// Distance on features.
        min: f64,
        /// Distance far from them.
        max: f64,
    },
    /// `max`, decreasing to `min` where features run close together.
    FromFeatureGaps {
        /// Smallest distance.
        min: f64,
        /// Distance where no other feature is near.
        max: f64,
    },
    /// `min` where the image is as dark as its features (or as bright, if they are bright), and
    /// `max` at the other extreme.
    FromImage {
        /// Smallest distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
    /// From the Laplacian of b(x): `min` in its valleys, at most `max`.
    FromLaplacian {
        /// Smallest distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
    /// The distances of the atoms that [`SeedingKind::Canny`] places.
    FromCannyAtoms {
        /// Smallest distance between atoms on features.
        min: f64,
        /// Distance far from features.
        max: f64,
    },
    /// The distances of [`Params::distance_map`], clipped to the limits.
    FromDistanceMap {
        /// Smallest distance.
        min: f64,
        /// Largest distance.
        max: f64,
    },
}

impl Spacing {
    /// Returns the smallest distance.
    pub fn min(self) -> f64 {
        self.limits()[0]
    }

    /// Returns the largest distance.
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

    /// Returns the spacing of [`SeedingKind::Canny`] in a space of `dimensions` dimensions.
    pub fn for_canny(dimensions: usize) -> Self {
        Self::FromCannyAtoms {
            min: canny::min_point_distance(dimensions),
            max: canny::UNIFORM_SPACING,
        }
    }
}

impl Metric {
    /// Returns the step of lattice space along each axis.
    pub fn step<const D: usize>(&self, geometry: &Geometry<D>) -> [f64; D] {
        let unit = self.unit(geometry);
        self.lengths(geometry).map(|length| length / unit)
    }

    /// Returns the length of the unit of lattice space, a cube of which holds one sample.
    pub fn unit<const D: usize>(&self, geometry: &Geometry<D>) -> f64 {
        match self {
            Self::Auto | Self::Samples | Self::Shape | Self::Permeability(_) => 1.0,
            Self::Physical | Self::Scales(_) => geometric_mean(self.lengths(geometry)),
        }
    }

    /// Returns the length of one sample along each axis. [`Metric::Auto`] counts as samples here:
    /// [`Params::with_metric_for`] replaces it. Scales that are missing are 1; [`Params::new`]
    /// refuses them.
    pub fn lengths<const D: usize>(&self, geometry: &Geometry<D>) -> [f64; D] {
        match self {
            Self::Auto | Self::Samples => [1.0; D],
            Self::Physical => spacing_in_one_unit(geometry),
            Self::Shape => {
                let spacing = spacing_in_one_unit(geometry);
                spacing.map(|s| s / geometric_mean(spacing))
            }
            Self::Permeability(values) => {
                let along = |axis: [f64; D]| {
                    let length = norm(axis);
                    let squares = axis
                        .iter()
                        .zip(values)
                        .map(|(x, k)| k * (x / length).powi(2));
                    length / squares.sum::<f64>().sqrt()
                };
                let lengths = geometry.axes.map(along);
                lengths.map(|length| length / geometric_mean(lengths))
            }
            Self::Scales(scales) => array::from_fn(|axis| scales.get(axis).copied().unwrap_or(1.0)),
        }
    }
}

/// Returns the distance between samples along each axis: in metres if coordinates have several units of
/// length, else as it is.
fn spacing_in_one_unit<const D: usize>(geometry: &Geometry<D>) -> [f64; D] {
    let in_one_unit = geometry.in_one_unit();
    in_one_unit.as_ref().unwrap_or(geometry).spacing()
}

/// Returns the geometric mean of some lengths; it is exact where all are the same.
fn geometric_mean<const D: usize>(lengths: [f64; D]) -> f64 {
    let longest = lengths.into_iter().fold(0.0, f64::max);
    let shape: f64 = lengths.iter().map(|length| length / longest).product();
    longest * shape.powf(1.0 / D as f64)
}

/// The weight of the image against the lattice: 0 is lattice only, 1 image only.
#[derive(Debug, Clone, PartialEq)]
pub enum Weight<const D: usize = 3> {
    /// A constant weight.
    Constant(f64),
    /// An image of weights, with the dimensions of the image to mesh.
    Image(Box<Image<D>>),
}

/// Evaluators of the lattice energy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Evaluator {
    /// Neighbour lists and exact gradients (fast)
    Pairwise,
    /// Accumulated on the image's grid, as published in 2001 (slow)
    Sampled,
}

/// Methods that move atoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Optimizer {
    /// Limited-memory BFGS (fast)
    #[default]
    Lbfgs,
    /// Steepest descent, in coordinates scaled as for L-BFGS
    Descent,
    /// A genetic algorithm: a population of ten lattices (slow)
    Genetic,
}

impl Optimizer {
    /// Returns the method that moves atoms.
    pub(crate) fn method<const D: usize>(self) -> Method<D> {
        match self {
            Self::Lbfgs => Method::Lbfgs,
            Self::Descent => Method::Descent,
            Self::Genetic => genetic::method(),
        }
    }
}

/// An atom that a user placed.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedAtom<const D: usize = 3> {
    /// Name of the atom in errors, e.g. the line of the file it comes from.
    pub name: String,
    /// Position in the coordinates of its file, or in the image's physical coordinates.
    pub position: [f64; D],
}

/// A well, in the coordinates of its file.
#[derive(Debug, Clone, PartialEq)]
pub struct WellPath<const D: usize = 3> {
    /// Name of the well in errors, e.g. its file.
    pub name: String,
    /// Points of the trajectory; in 2-D one point is enough.
    pub points: Vec<[f64; D]>,
    /// Largest radius of the well.
    pub radius: f64,
    /// The file of the well, and what is known about its coordinates.
    pub file: PointFile,
}

/// Everything that determines a mesh, apart from the image: the options, and the content of the
/// files that they name.
#[derive(Debug, Clone, PartialEq)]
pub struct Params<const D: usize = 3> {
    /// The options, [resolved](MeshSpec::resolved).
    pub spec: MeshSpec,
    /// Modality of the image, if its geometry does not show it.
    pub modality: Modality,
    /// Points inside and outside an object, for features by random shortest paths.
    pub path_seeds: feature::PathSeeds<D>,
    /// Distance between atoms, in samples, for each sample of the image; `None` unless the options
    /// name a file of distances.
    pub distance_map: Option<Box<Image<D>>>,
    /// Weight of the image.
    pub beta: Weight<D>,
    /// Atoms that stay where they are (wells, sources).
    pub fixed_atoms: Vec<FixedAtom<D>>,
    /// The file of fixed atoms, and what is known about its coordinates.
    pub atom_file: PointFile,
    /// Wells: fixed atoms along their trajectories.
    pub wells: Vec<WellPath<D>>,
    /// Surfaces to follow.
    pub surfaces: Vec<FollowedSurface>,
    /// Surfaces at which the cells above the image end.
    pub topography: Vec<FollowedSurface>,
    /// The volume of velocities that converted the image to depth.
    pub velocities: Option<VelocityModel<D>>,
    /// The unit of two-way time in the image's file, if the image was converted to depth.
    pub time_unit: Option<String>,
    /// A note on what was assumed of the space in which cells are regular.
    pub metric_note: Option<String>,
}

impl<const D: usize> Default for Params<D> {
    fn default() -> Self {
        Self::with_resolved(
            MeshSpec::default().resolved(),
            feature::PathSeeds::default(),
        )
    }
}

impl<const D: usize> Params<D> {
    /// Returns the parameters for images of `D` axes. It reads no file; the caller adds the content
    /// of files.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for options that make no sense ([`MeshSpec::validate`]), or not in
    /// `D` dimensions.
    pub fn new(spec: MeshSpec) -> Result<Self> {
        spec.validate()?;
        if let (Some(padding), 2) = (&spec.pad, D) {
            return Err(Error::Job(cause(
                format!("pad {padding}"),
                "continues a mesh of tetrahedra, but the image is 2-D",
                "omit it",
            )));
        }
        if let (Some(topography), 2) = (&spec.topography, D) {
            return Err(Error::Job(cause(
                format!("topography {topography}"),
                "ends a mesh of tetrahedra, but the image is 2-D",
                "omit it",
            )));
        }
        if let Metric::Scales(scales) | Metric::Permeability(scales) = &spec.metric
            && scales.len() != D
        {
            return Err(Error::Job(cause(
                format!("metric {}", spec.metric),
                format!("has {} scales, but the image has {D} axes", scales.len()),
                "give one scale per axis",
            )));
        }
        if D != 2 && spec.smooth.is_some() {
            return Err(Error::Job(cause(
                "smooth",
                "is for the triangles of 2-D images",
                "omit it",
            )));
        }
        if D == 2 && spec.slivers.is_exudation() {
            return Err(Error::Job(cause(
                "slivers exude",
                "does nothing in 2-D, where the Delaunay triangulation has no slivers",
                "omit it",
            )));
        }
        if D == 2 && spec.seeding == SeedingKind::Canny && spec.effort() == Effort::Best {
            return Err(Error::Job(cause(
                "effort best",
                "is spent on atoms that move and on tetrahedra, but no atom moves in this 2-D mesh",
                "omit it, or choose another seeding",
            )));
        }
        let path_seeds = spec.path_seeds()?;
        Ok(Self::with_resolved(spec.resolved(), path_seeds))
    }

    /// Returns the parameters for images of `D` axes, and reads the files that the options name.
    ///
    /// # Errors
    /// Returns the errors of [`Params::new`] and those of reading these files.
    pub fn read(spec: &MeshSpec) -> Result<Self> {
        Self::read_with(spec, &read_with_options)
    }

    /// Returns the parameters as [`Params::read`] does, and reads images with `read_image`.
    ///
    /// # Errors
    /// Returns the errors of [`Params::read`] and of `read_image`.
    pub(crate) fn read_with(spec: &MeshSpec, read_image: ReadImage<'_>) -> Result<Self> {
        let mut params = Self::new(spec.clone())?;
        let nulls = spec.input.point_nulls()?;
        let read_surfaces =
            |flag, options: &[_]| given_surfaces::read(flag, options, nulls.as_deref());
        params.surfaces = read_surfaces("surface", &spec.surface)?;
        params.topography = read_surfaces("topography", spec.topography.as_slice())?;
        let point_file = |flag: &str, option: &FileOption| PointFile {
            place: format!("{flag} {option}"),
            options: option.coordinates.with_nulls(nulls.clone()),
            ..PointFile::default()
        };
        if let Some(option) = &spec.atoms_from {
            (params.fixed_atoms, params.atom_file) =
                read_fixed_atoms(option, point_file("atoms-from", option))?;
        }
        if spec.seeding == SeedingKind::Canny {
            return Ok(params);
        }
        if let DistanceSource::File(path) = &spec.distance_from {
            let remedy = "give one distance per sample of the image";
            let distances = with_dimension(
                "distance-from",
                path,
                read_image(path, &InputOptions::default())?,
                remedy,
            )?;
            params.distance_map = Some(Box::new(distances));
        }
        if let NumberOrFile::File(path) = &spec.beta {
            params.beta = Weight::Image(Box::new(check_beta(
                path,
                read_image(path, &InputOptions::default())?,
            )?));
        }
        for option in &spec.well {
            let wells = read_wells(option, &point_file("well", option))?;
            params.wells.extend(wells);
        }
        Ok(params)
    }

    /// Returns the parameters with the metric that suits an image, if it is to be chosen, and with all
    /// distances in the unit of the metric. Cells of a scan are well shaped in space, those of a survey in
    /// samples, because layers are thin. Other images count as scans if they are labels, and if a distance
    /// has a unit of length.
    ///
    /// # Errors
    /// Returns the errors of [`MeshSpec::with_lengths_in`].
    pub fn with_metric_for(&self, source: ImageSource<'_, D>) -> Result<Cow<'_, Self>> {
        let has_unit = self.spec.unit_of_lengths().is_some();
        if self.spec.metric != Metric::Auto && !has_unit {
            return Ok(Cow::Borrowed(self));
        }
        let geometry = source.geometry();
        let mut params = self.clone();
        if self.spec.metric == Metric::Auto {
            let modality = self.modality.or_detect(geometry);
            let is_isotropic = || Metric::Shape.lengths(geometry).iter().all(|l| *l == 1.0);
            params.spec.metric = match modality {
                Modality::Scan => Metric::Shape,
                _ if has_unit => Metric::Shape,
                Modality::Unknown if !is_isotropic() && self.is_about_labels(source, modality) => {
                    Metric::Shape
                }
                Modality::Survey | Modality::Unknown => Metric::Samples,
            };
            let is_guess = params.spec.metric == Metric::Shape && !has_unit;
            if is_guess && geometry.units[0].is_empty() && !is_isotropic() {
                let spacing = geometry.spacing().map(|s| s.to_string()).join(" x ");
                params.metric_note = Some(format!(
                    "{ASSUMED}the distances between samples ({spacing}, no unit) are lengths, and cells are \
                     regular in space; --metric samples makes them as flat as samples"
                ));
            }
        }
        params.spec = params.spec.with_lengths_in(geometry)?;
        Ok(Cow::Owned(params))
    }

    /// Returns `true` if the features are those of labels, and the image lies in space.
    fn is_about_labels(&self, source: ImageSource<'_, D>, modality: Modality) -> bool {
        let (kind, geometry) = (self.spec.feature, source.geometry());
        let is_labelled = || match source {
            ImageSource::InMemory(image) if kind == FeatureKind::Auto => {
                image.label_evidence(modality).is_some()
            }
            _ => kind.has_labels() || kind == FeatureKind::Mask,
        };
        geometry.length_scales().is_ok() && is_labelled()
    }

    fn with_resolved(spec: MeshSpec, path_seeds: feature::PathSeeds<D>) -> Self {
        let beta = match spec.beta {
            NumberOrFile::Constant(beta) => beta,
            NumberOrFile::File(_) => 0.5,
        };
        Self {
            spec,
            modality: Modality::Unknown,
            path_seeds,
            distance_map: None,
            beta: Weight::Constant(beta),
            fixed_atoms: Vec::new(),
            atom_file: PointFile::default(),
            wells: Vec::new(),
            surfaces: Vec::new(),
            topography: Vec::new(),
            velocities: None,
            time_unit: None,
            metric_note: None,
        }
    }

    /// Returns the distance between atoms.
    pub fn spacing(&self) -> Spacing {
        if self.spec.seeding == SeedingKind::Canny {
            return Spacing::for_canny(D);
        }
        let (min, max) = match self.spec.distance {
            NominalDistance::Constant(d) => return Spacing::Constant(d),
            NominalDistance::InUnit { min, max, .. } if min == max => {
                return Spacing::Constant(max);
            }
            NominalDistance::Range { min, max } | NominalDistance::InUnit { min, max, .. } => {
                (min, max)
            }
        };
        if self.distance_map.is_some() {
            return Spacing::FromDistanceMap { min, max };
        }
        match self.spec.distance_from {
            DistanceSource::Gaps => Spacing::FromFeatureGaps { min, max },
            DistanceSource::Features => Spacing::FromFeatures { min, max },
            DistanceSource::Image => Spacing::FromImage { min, max },
            DistanceSource::Laplacian => Spacing::FromLaplacian { min, max },
            DistanceSource::File(_) => Spacing::FromDistanceMap { min, max },
        }
    }

    /// Returns the same parameters with the names that the image gives to its labels, where the options
    /// give none. Labels with names are features unless others are chosen.
    ///
    /// # Errors
    /// Returns the errors of loading the image.
    pub(crate) fn with_label_names(&self, source: ImageSource<'_, D>) -> Result<Cow<'_, Self>> {
        let kind = self.spec.feature;
        let given = self.spec.input.label_table.as_deref();
        let unused = |problem: &str, remedy: &str| match given {
            Some(file) if file != Path::new("none") => {
                let place = format!("label-table {}", file.display());
                Err(Error::Job(cause(place, problem, remedy)))
            }
            _ => Ok(Cow::Borrowed(self)),
        };
        let ImageSource::InMemory(image) = source else {
            let problem = "names labels, but the image is read in parts";
            return unused(problem, "omit it, and name labels with --label");
        };
        if image.label_names.is_empty() || !matches!(kind, FeatureKind::Auto | FeatureKind::Labels)
        {
            let problem = format!("names labels, but {kind} are followed");
            return unused(&problem, "omit it, or follow labels (--feature labels)");
        }
        let Some(table) = LabelTable::from_image(image) else {
            let problem = "names labels, but the image has too many values to be one of labels";
            return unused(problem, "omit it, or give an image of labels");
        };
        let is_in_image = |(label, _): &(LabelValue, String)| table.values.contains(label);
        if !image.label_names.iter().any(is_in_image) {
            let values: Vec<String> = table
                .values
                .iter()
                .take(12)
                .map(LabelValue::to_string)
                .collect();
            let problem = format!(
                "names none of the image's labels, such as {}",
                values.join(", ")
            );
            return unused(&problem, "give the table of this image");
        }
        let options_of = |label: LabelValue| self.spec.label.iter().find(|o| o.label == label);
        let is_unnamed = |label: LabelValue| {
            options_of(label).is_none_or(|o| o.name.is_none() && o.merge_into.is_none())
        };
        let new_names: Vec<(LabelValue, String)> = (image.label_names.iter())
            .filter(|(label, _)| table.values.contains(label) && is_unnamed(*label))
            .cloned()
            .collect();
        let given = self
            .spec
            .label
            .iter()
            .filter_map(|options| options.name.clone());
        let mut names: Vec<String> = given.collect();
        let given_count = names.len();
        append_distinct(&mut names, new_names.iter().map(|(_, name)| name.clone()));
        let mut params = self.clone();
        for ((label, _), name) in new_names.iter().zip(names.drain(given_count..)) {
            let known = params.spec.label.iter_mut().find(|o| o.label == *label);
            match known {
                Some(options) => options.name = Some(name),
                None => params.spec.label.push(LabelOptions {
                    label: *label,
                    distance: None,
                    unit: None,
                    name: Some(name),
                    merge_into: None,
                }),
            }
        }
        params.spec = params.spec.resolved();
        Ok(Cow::Owned(params))
    }

    /// Returns how features are detected where samples are `step` apart in lattice space.
    pub fn feature_options(&self, step: [f64; D]) -> feature::DetectionOptions<D> {
        let spec = &self.spec;
        // Canny's points are points of Canny's edges, unless another feature is named.
        let kind = match (spec.feature, spec.seeding) {
            (feature::FeatureKind::Auto, SeedingKind::Canny) => feature::FeatureKind::Canny,
            (kind, _) => kind,
        };
        let spacing = self.spacing();
        let (threshold, further_levels) = spec.threshold_levels();
        feature::DetectionOptions {
            kind,
            modality: self.modality,
            scale: spec.sigma,
            label_smoothing: spec.label_smoothing,
            threshold,
            further_levels,
            min_part: spec.min_part_samples(),
            fault_evidence: spec.fault_evidence,
            min_dip: spec.min_dip,
            min_fault_size: spec.min_fault_size,
            min_confidence: spec.min_confidence,
            keep_chaos: spec.keep_chaos,
            seeks_crossings: spec.effort() != Effort::Draft,
            weights: spec.feature_weights.0,
            seeds: self.path_seeds.clone(),
            labels: spec.label.clone(),
            d_min: spacing.min(),
            gap_d_max: match spacing {
                Spacing::FromFeatureGaps { max, .. } => Some(max),
                _ => None,
            },
            step,
            keep_nulls: spec.input.keeps_nulls(),
            ..feature::DetectionOptions::default()
        }
    }
}

/// Parameters of a job with distances in units of lattice space.
#[derive(Debug, Clone)]
pub(crate) struct LatticeParams<'a, const D: usize>(Cow<'a, Params<D>>);

impl<'a, const D: usize> LatticeParams<'a, D> {
    /// Converts distances to units of lattice space, each of which is `unit` long.
    pub fn new(params: &'a Params<D>, unit: f64) -> Self {
        if unit == 1.0 {
            return Self(Cow::Borrowed(params));
        }
        let mut params = params.clone();
        match &mut params.spec.distance {
            NominalDistance::Constant(d) => *d /= unit,
            NominalDistance::Range { min, max } | NominalDistance::InUnit { min, max, .. } => {
                *min /= unit;
                *max /= unit;
            }
        }
        if let Some(length) = &mut params.spec.well_distance {
            length.value /= unit;
        }
        for label in &mut params.spec.label {
            label.distance = label.distance.map(|d| d / unit);
        }
        if let Some(distances) = &mut params.distance_map {
            let samples = distances.as_slice().iter();
            let samples = samples.map(|&d| (f64::from(d) / unit) as f32).collect();
            **distances = Image::new(distances.dims(), samples, distances.geometry.clone());
        }
        Self(Cow::Owned(params))
    }

    /// Converts distances for an image with this geometry, whose samples are `step` apart in lattice
    /// space, as the file of a mesh records it.
    pub fn for_step(params: &'a Params<D>, geometry: &Geometry<D>, step: [f64; D]) -> Self {
        Self::new(params, params.spec.metric.lengths(geometry)[0] / step[0])
    }

    /// Returns the options.
    pub fn spec(&self) -> &MeshSpec {
        &self.0.spec
    }

    /// Returns the distance between atoms, as [`Params::spacing`] does.
    pub fn spacing(&self) -> Spacing {
        self.0.spacing()
    }

    /// Returns how features are detected, as [`Params::feature_options`] does.
    pub fn feature_options(&self, step: [f64; D]) -> feature::DetectionOptions<D> {
        self.0.feature_options(step)
    }

    /// Returns the distance between atoms for each sample of the image, if it is given.
    pub fn distance_map(&self) -> Option<&Image<D>> {
        self.0.distance_map.as_deref()
    }

    /// Returns the weight of the image.
    pub fn beta(&self) -> &Weight<D> {
        &self.0.beta
    }

    /// Returns the axes along which the mesh is periodic, if there are any.
    pub fn periodic_axes(&self) -> Option<[bool; D]> {
        let axes = self.0.spec.periodic?;
        Some(array::from_fn(|k| axes.0[k]))
    }

    /// Returns the fixed atoms, in physical coordinates.
    pub fn fixed_atoms(&self) -> &[FixedAtom<D>] {
        &self.0.fixed_atoms
    }

    /// Returns the wells, in physical coordinates.
    pub fn wells(&self) -> &[WellPath<D>] {
        &self.0.wells
    }
}

/// Reads fixed atoms from a table; each is named after its line.
fn read_fixed_atoms<const D: usize>(
    option: &FileOption,
    point_file: PointFile,
) -> Result<(Vec<FixedAtom<D>>, PointFile)> {
    let atoms = AtomFile::<D>::read(&option.path, &option.coordinates.columns)?;
    let fixed_atom = |(line, position)| FixedAtom {
        name: format!("{}:{line}", option.path.display()),
        position,
    };
    let point_file = PointFile {
        stated: atoms.coordinates,
        notes: atoms.notes,
        ..point_file
    };
    Ok((
        atoms.points.into_iter().map(fixed_atom).collect(),
        point_file,
    ))
}

/// Reads the wells of a file, or the one that the option names.
fn read_wells<const D: usize>(
    option: &FileOption,
    point_file: &PointFile,
) -> Result<Vec<WellPath<D>>> {
    let options = &option.coordinates;
    let mut files = WellFile::<D>::read_all(&option.path, &options.columns, options.head, D - 1)?;
    if let Some(name) = &option.name {
        let names: Vec<String> = files.iter().map(|file| file.name.clone()).collect();
        match names.iter().position(|other| other == name) {
            Some(index) => files = vec![files.swap_remove(index)],
            None if files.len() == 1 => files[0].name.clone_from(name),
            None => {
                let problem = format!("names no well: the file has {}", names.join(", "));
                return Err(Error::Job(cause(
                    &point_file.place,
                    problem,
                    "give one of these names",
                )));
            }
        }
    }
    let several = files.len() > 1;
    let path = option.path.display();
    let well = |file: WellFile<D>| WellPath {
        name: if several {
            format!("{path}:{}", file.name)
        } else {
            path.to_string()
        },
        radius: file
            .points
            .iter()
            .filter_map(|p| p.radius)
            .fold(0.0, f64::max),
        points: file.points.iter().map(|p| p.position).collect(),
        file: PointFile {
            stated: file.coordinates,
            notes: file.notes,
            survey: file.survey,
            ..point_file.clone()
        },
    };
    Ok(files.into_iter().map(well).collect())
}

/// Returns the image that an option names; `remedy` says what to give.
///
/// # Errors
/// Returns [`Error::Job`] if the image does not have `D` axes.
fn with_dimension<const D: usize>(
    option: &str,
    path: &Path,
    image: AnyImage,
    remedy: &str,
) -> Result<Image<D>> {
    image.into_image().ok_or_else(|| {
        Error::Job(cause(
            format!("{option} {}", path.display()),
            format!("is not a {D}-D image"),
            remedy,
        ))
    })
}

/// Returns the image of weights.
///
/// # Errors
/// Returns [`Error::Job`] if it does not have `D` axes, or for a weight outside [0, 1).
fn check_beta<const D: usize>(path: &Path, image: AnyImage) -> Result<Image<D>> {
    let remedy = "give one weight per sample of the image";
    let image = with_dimension("beta", path, image, remedy)?;
    let stats = image.stats();
    if stats.first_non_finite.is_some() || stats.min < 0.0 || stats.max >= 1.0 {
        return Err(Error::Job(cause(
            format!("beta {}", path.display()),
            format!(
                "holds weights from {} to {}, or values that are not finite",
                stats.min, stats.max
            ),
            "give weights that are at least 0 and below 1",
        )));
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_options_read_no_files() {
        assert_eq!(
            Params::<3>::read(&MeshSpec::default()).unwrap(),
            Params::default()
        );
    }
}
