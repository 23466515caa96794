//! Segments a mesh as `atomesh segment` does.

use serde::Serialize;
use serde_json::{Value, json};

use super::places::Places;
use super::segment_spec::SegmentSpec;
use super::superpixels::Superpixels;
use super::{Options, boundary, cut_cells, cut_samples, dice};
use crate::Result;
use crate::files::output::path_text;
use crate::files::vtk::DataArray;
use crate::image::formats::{AnyImage, InputOptions, LoadedImage, ReadImage};
use crate::image::{Geometry, Image};
use crate::model::surface::adjacency::CellAdjacency;
use crate::model::surface::{AnySurfaces, SurfaceFile};
use crate::progress::cost::cpu_seconds;
use crate::progress::{Progress, Stage};
use crate::store::input::{ImageInput, MeshInput, image_part, read_mesh_image};
use crate::store::with_mesh;
use crate::store::{AnyMesh, MeshFile, Storable, StoredMesh};

/// A segmented mesh.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SegmentOutcome {
    /// The mesh, with `label` (1 object, 0 background) and `mean` (of the image) for each cell.
    pub mesh: AnyMesh,
    /// The cut of the cells.
    pub cells: CutResult,
    /// The cut of the image's samples, if the options ask for it.
    pub samples: Option<CutResult>,
    /// The label of each sample, if the options ask for them.
    pub labels: Option<AnyImage>,
    /// The boundary of the object, if the options ask for it.
    pub surface: Option<AnySurfaces>,
}

/// The result and the cost of a cut.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CutResult {
    /// Number of cells or samples.
    pub nodes: usize,
    /// Number of cells or samples of the object.
    pub object: usize,
    /// Fraction of the total volume that is the object's.
    pub share: f64,
    /// Difference of neighbouring values at which a boundary is cheap.
    pub sigma: f64,
    /// Cost of the cut.
    pub cost: f64,
    /// Processor seconds for computing mean values; 0 for samples.
    pub means_seconds: f64,
    /// Processor seconds for the cut.
    pub cut_seconds: f64,
    /// Agreement with the true object, if it is given: 1 if they are equal, 0 if they are disjoint.
    pub dice: Option<f64>,
}

impl CutResult {
    fn summary_line(&self, name: &str) -> String {
        let dice = self.dice.map_or("-".into(), |d| format!("{d:.4}"));
        format!(
            "{name:<8} {:>9} {:>9} {:>7.2}% {:>8.3} {:>8.3} {dice:>7}",
            self.nodes,
            self.object,
            100.0 * self.share,
            self.means_seconds,
            self.cut_seconds
        )
    }
}

impl SegmentOutcome {
    /// Writes the files beside the mesh that the options name: the labels and the boundary.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if a file cannot be written.
    pub fn write_others(&self, spec: &SegmentSpec) -> Result<()> {
        if let (Some(path), Some(labels)) = (&spec.labels_out, &self.labels) {
            labels.write(path)?;
        }
        match (&spec.surface_out, &self.surface) {
            (Some(path), Some(surface)) => surface.write(path),
            _ => Ok(()),
        }
    }

    /// Returns the results of the cuts and the names of the files as JSON.
    pub fn to_json(&self, spec: &SegmentSpec) -> Value {
        json!({
            "labels": spec.labels_out.as_deref().map(path_text),
            "surface": spec.surface_out.as_deref().map(path_text),
            "cells": self.cells,
            "samples": self.samples,
        })
    }

    /// Returns the results of the cuts as a table.
    pub fn table(&self) -> String {
        let mut lines = vec![format!(
            "{:<8} {:>9} {:>9} {:>8} {:>8} {:>8} {:>7}",
            "cut of", "number", "object", "share", "means s", "cut s", "Dice"
        )];
        lines.push(self.cells.summary_line("cells"));
        lines.extend(self.samples.as_ref().map(|cut| cut.summary_line("samples")));
        lines.join("\n")
    }
}

/// Separates an object from the background by a minimum cut on the cells of a mesh, as
/// `atomesh segment` does. `image` is the one that was meshed, or another of the same dimensions.
///
/// ```
/// use atomesh::image::formats::AnyImage;
/// use atomesh::image::{Geometry, Image};
/// use atomesh::progress::NoProgress;
/// use atomesh::{MeshSpec, SegmentSpec};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "4".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let spec = SegmentSpec {
///     object: vec!["20,18".parse()?],
///     background: vec!["2,2".parse()?],
///     ..SegmentSpec::default()
/// };
/// let image = AnyImage::Plane(image.into());
/// let outcome = atomesh::segment(mesh, image, &spec, &mut NoProgress)?;
/// assert!((outcome.cells.share - 0.26).abs() < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`SegmentSpec::validate`], those of reading the true object, and
/// [`Error::Job`](crate::Error::Job) for a place outside the mesh.
pub fn segment<'a>(
    mesh: impl Into<MeshInput<'a>>,
    image: impl Into<ImageInput<'a>>,
    spec: &SegmentSpec,
    progress: &mut dyn Progress,
) -> Result<SegmentOutcome> {
    spec.validate()?;
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    let run = SegmentRun {
        spec,
        name,
        image: image.into(),
        read_image,
        progress,
    };
    let mesh = match mesh {
        AnyMesh::Tetrahedra(file) => image_part(file, &mut *run.progress).into(),
        other => other,
    };
    with_mesh!(mesh, file => run.segment(file))
}

/// The input, the options and the progress of a segmentation.
struct SegmentRun<'a> {
    spec: &'a SegmentSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    image: ImageInput<'a>,
    read_image: ReadImage<'a>,
    progress: &'a mut dyn Progress,
}

impl SegmentRun<'_> {
    fn segment<const D: usize, M: Storable<D>>(self, file: MeshFile<M>) -> Result<SegmentOutcome>
    where
        MeshFile<M>: Into<AnyMesh>,
        SurfaceFile<D>: Into<AnySurfaces>,
        LoadedImage<D>: Into<AnyImage>,
    {
        let Self { spec, progress, .. } = self;
        let places = spec.places::<D>()?;
        let stored = StoredMesh::new(file, self.name)?;
        let space = stored.space.clone();
        let image = self.image.fitting(&space)?;
        let is_object = |&v: &f32| u8::from(v != 0.0);
        let truth = (spec.truth.as_deref())
            .map(|path| read_mesh_image(path, &InputOptions::default(), &space, self.read_image))
            .transpose()?
            .map(|image| image.as_slice().iter().map(is_object).collect::<Vec<u8>>());
        let options = Options {
            lambda: spec.lambda,
            sigma: spec.sigma,
        };

        progress.stage(Stage::Averaging);
        let start = cpu_seconds();
        let mesh = &stored.lattice;
        let face_cells = mesh.cells_of_faces()?;
        let cells = CellAdjacency::new(mesh, &face_cells, &[]);
        let superpixels = Superpixels::new(mesh, &cells, &face_cells, &image, space.step);
        let averaged = cpu_seconds();
        progress.stage(Stage::Separating);
        let seeds = places.cells(mesh, &space, &cells, &face_cells)?;
        let segmentation = cut_cells(&cells, &superpixels.means, &seeds, &options)?;
        let cut = cpu_seconds();

        let labels = segmentation.labels;
        let sample_labels = (spec.labels_out.is_some() || truth.is_some())
            .then(|| superpixels.sample_labels(&labels));
        let total: f64 = cells.volumes.iter().sum();
        let volumes = cells.volumes.iter().zip(&labels);
        let object_volumes = volumes.filter(|(_, label)| **label == 1);
        let cells = CutResult {
            nodes: cells.len(),
            object: labels.iter().filter(|label| **label == 1).count(),
            share: object_volumes.map(|(volume, _)| volume).sum::<f64>() / total,
            sigma: segmentation.sigma,
            cost: segmentation.cost,
            means_seconds: averaged - start,
            cut_seconds: cut - averaged,
            dice: (truth.as_ref().zip(sample_labels.as_ref())).map(|(t, l)| dice(l, t)),
        };
        let samples = if spec.voxels {
            progress.stage(Stage::SeparatingSamples);
            let truth = truth.as_deref();
            Some(cut_image(
                &image,
                &space.geometry,
                &places,
                &options,
                truth,
            )?)
        } else {
            None
        };
        let mut file = stored.into_file();
        let surface = match &spec.surface_out {
            Some(_) => {
                Some(object_boundary(&file.mesh, &labels)?.with_space(&space.geometry, true))
            }
            None => None,
        };
        file.cell_data
            .retain(|array| !matches!(array.name.as_str(), "label" | "mean"));
        file.cell_data.push(DataArray::scalars("label", labels));
        file.cell_data
            .push(DataArray::scalars("mean", superpixels.means));
        let labels = sample_labels
            .filter(|_| spec.labels_out.is_some())
            .map(|labels| {
                let labels = labels.into_iter().map(f32::from).collect();
                Image::new(image.dims(), labels, image.geometry.clone())
            });
        Ok(SegmentOutcome {
            mesh: file.into(),
            cells,
            samples,
            labels: labels.map(|labels| LoadedImage::from(labels).into()),
            surface: surface.map(Into::into),
        })
    }
}

/// Returns the smoothed boundary of the object.
fn object_boundary<const D: usize, M: Storable<D>>(
    physical: &M,
    labels: &[u8],
) -> Result<SurfaceFile<D>> {
    // If the geometry mirrors the lattice, faces have other numbers in physical coordinates.
    let face_cells = physical.cells_of_faces()?;
    let facets = boundary::boundary_facets(physical, &face_cells, labels);
    let mut nodes = physical.nodes().to_vec();
    boundary::smooth(&mut nodes, &facets);
    Ok(SurfaceFile::new(
        &nodes,
        &facets,
        &[0, facets.len()],
        "object",
    ))
}

/// Cuts the image's samples and not the cells.
fn cut_image<const D: usize>(
    image: &Image<D>,
    geometry: &Geometry<D>,
    places: &Places<D>,
    options: &Options,
    truth: Option<&[u8]>,
) -> Result<CutResult> {
    let seeds = places.samples(image.dims(), geometry)?;
    let start = cpu_seconds();
    let cut = cut_samples(image, &seeds, options)?;
    let cut_seconds = cpu_seconds() - start;
    let object = cut.labels.iter().filter(|label| **label == 1).count();
    Ok(CutResult {
        nodes: cut.labels.len(),
        object,
        share: object as f64 / cut.labels.len() as f64,
        sigma: cut.sigma,
        cost: cut.cost,
        means_seconds: 0.0,
        cut_seconds,
        dice: truth.map(|truth| dice(&cut.labels, truth)),
    })
}
