//! The verb `segment`: separates an object from the background by a minimum cut on the cells of a
//! mesh.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::SurfaceFile;
use crate::export::surfaces::outcome::SURFACE_EXTENSIONS as SURFACES;
use crate::files::vtk::DataArray;
use crate::image::formats::InputOptions;
use crate::image::{Geometry, Image};
use crate::mesh::Mesh;
use crate::model::input::read_mesh_image;
use crate::model::segment::superpixels::Superpixels;
use crate::model::segment::{Options, SegmentSeeds, boundary, cut_cells, cut_samples, dice};
use crate::model::surface::adjacency::{CellAdjacency, find_cell};
use crate::report::cost::cpu_seconds;
use crate::store::{LatticeSpace, MeshFile, Storable, StoredMesh, with_mesh};
use crate::{Error, Result};

/// Arguments of `atomesh segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// The image that was meshed, or another of the same dimensions
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Places in the object, in physical coordinates: a point X,Y,Z (X,Y in 2-D), or a box given by
    /// two of its corners, X,Y,Z:X,Y,Z. May be repeated
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub object: Vec<String>,
    /// Places in the background, given like those of the object; may be repeated
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub background: Vec<String>,
    /// The mesh to write, with `label` (1 object, 0 background) and `mean` (of the image) for each
    /// cell
    #[arg(short, long, value_name = "SEG.vtu")]
    pub output: PathBuf,
    /// Also write the label of each sample as an image
    #[arg(long, value_name = "L.npy")]
    pub labels_out: Option<PathBuf>,
    /// Also write the boundary between object and background, smoothed: .vtp, .obj, or GOCAD's .ts
    #[arg(long, value_name = "S.vtp")]
    pub surface_out: Option<PathBuf>,
    /// Weight of the image values against the boundary
    #[arg(long, value_name = "NUMBER", default_value_t = 1.0)]
    pub lambda: f64,
    /// Difference of neighbouring cells' values at which a boundary is cheap [default: the root
    /// mean square of all differences]
    #[arg(long, value_name = "VALUE")]
    pub sigma: Option<f64>,
    /// An image of the true object (not 0), to be compared with the result
    #[arg(long, value_name = "T.npy")]
    pub truth: Option<PathBuf>,
    /// Also cut the image's samples themselves, which is the classical method, and report both
    #[arg(long)]
    pub voxels: bool,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The result and the cost of a cut.
#[derive(Debug, Serialize)]
struct CutResult {
    /// Number of cells or samples.
    nodes: usize,
    /// Number of cells or samples of the object.
    object: usize,
    /// Fraction of the total volume that is the object's.
    share: f64,
    sigma: f64,
    cost: f64,
    /// Processor seconds for computing mean values; 0 for samples.
    means_seconds: f64,
    /// Processor seconds for the cut.
    cut_seconds: f64,
    dice: Option<f64>,
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

/// Runs the verb.
pub fn segment(args: &SegmentArgs, console: &mut Console) -> Result<()> {
    let mut inputs: Vec<&Path> = vec![&args.image, &args.mesh];
    inputs.extend(args.truth.as_deref());
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    inputs.push(&args.output);
    if let Some(path) = &args.labels_out {
        check_output(path, "--labels-out", &IMAGE_EXTENSIONS, &inputs)?;
        inputs.push(path);
    }
    if let Some(path) = &args.surface_out {
        check_output(path, "--surface-out", &SURFACES, &inputs)?;
    }
    for (option, value) in [("--lambda", Some(args.lambda)), ("--sigma", args.sigma)] {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            let remedy = "give a positive number";
            return Err(parse::option_error(
                option,
                &value.to_string(),
                "is out of range",
                remedy,
            ));
        }
    }
    console.begin_stage("reading");
    with_mesh!(console.read_mesh(&args.mesh)?, file => segment_mesh(args, file, console))
}

fn segment_mesh<const D: usize, M: Storable<D>>(
    args: &SegmentArgs,
    file: MeshFile<M>,
    console: &mut Console,
) -> Result<()> {
    let seed_boxes = SeedBoxes::<D>::parse_all(args)?;
    let stored = StoredMesh::new(file, &args.mesh.display().to_string())?;
    let space = stored.space.clone();
    let image = read_mesh_image(&args.image, &args.input, &space, &console.reader())?;
    let truth = (args.truth.as_deref())
        .map(|path| read_mesh_image(path, &InputOptions::default(), &space, &console.reader()))
        .transpose()?;
    let is_object = |&v: &f32| u8::from(v != 0.0);
    let truth: Option<Vec<u8>> =
        truth.map(|image| image.as_slice().iter().map(is_object).collect());
    let options = Options {
        lambda: args.lambda,
        sigma: args.sigma,
    };

    console.begin_stage("averaging");
    let start = cpu_seconds();
    let mesh = &stored.lattice;
    let face_cells = mesh.cells_of_faces()?;
    let cells = CellAdjacency::new(mesh, &face_cells, &[]);
    let superpixels = Superpixels::new(mesh, &cells, &face_cells, &image, space.step);
    let averaged = cpu_seconds();
    console.begin_stage("cutting");
    let seeds = seed_boxes.cells(mesh, &space, &cells, &face_cells)?;
    let segmentation = cut_cells(&cells, &superpixels.means, &seeds, &options)?;
    let cut = cpu_seconds();

    let labels = &segmentation.labels;
    let sample_labels =
        (args.labels_out.is_some() || truth.is_some()).then(|| superpixels.sample_labels(labels));
    let total: f64 = cells.volumes.iter().sum();
    let object_cells = cells
        .volumes
        .iter()
        .zip(labels)
        .filter(|(_, label)| **label == 1);
    let mut rows = vec![CutResult {
        nodes: cells.len(),
        object: labels.iter().filter(|label| **label == 1).count(),
        share: object_cells.map(|(volume, _)| volume).sum::<f64>() / total,
        sigma: segmentation.sigma,
        cost: segmentation.cost,
        means_seconds: averaged - start,
        cut_seconds: cut - averaged,
        dice: truth
            .as_ref()
            .zip(sample_labels.as_ref())
            .map(|(t, l)| dice(l, t)),
    }];
    if args.voxels {
        console.begin_stage("cutting samples");
        rows.push(segment_voxels(
            &image,
            &space.geometry,
            &seed_boxes,
            &options,
            truth.as_deref(),
        )?);
    }

    console.begin_stage("writing");
    if let (Some(path), Some(labels)) = (&args.labels_out, sample_labels) {
        let labels = labels.into_iter().map(f32::from).collect();
        let labels = Image::new(image.dims(), labels, image.geometry.clone());
        console.write_image(path, labels)?;
    }
    let mut file = stored.into_file();
    if let Some(path) = &args.surface_out {
        let (nodes, facets) = object_boundary(&file.mesh, labels)?;
        let surface = SurfaceFile::new(&nodes, &facets, &[0, facets.len()], "object");
        console.write_surfaces(path, surface.with_space(&space.geometry, true))?;
    }
    file.cell_data
        .retain(|array| !matches!(array.name.as_str(), "label" | "mean"));
    file.cell_data
        .push(DataArray::scalars("label", segmentation.labels));
    file.cell_data
        .push(DataArray::scalars("mean", superpixels.means));
    console.write_mesh(&args.output, file)?;

    let text = format!("{}\nwrote {}", table(&rows), args.output.display());
    let mut rows = rows.into_iter();
    let [cells, samples] = [rows.next(), rows.next()];
    console.result(
        text,
        &json!({
            "file": path_text(&args.output), "labels": args.labels_out.as_deref().map(path_text), "surface": args.surface_out.as_deref().map(path_text),
            "cells": cells, "samples": samples,
        }),
    );
    Ok(())
}

/// Nodes, and facets as node numbers.
type NodesAndFacets<const D: usize> = (Vec<[f64; D]>, Vec<[u32; D]>);

/// Returns the smoothed boundary of the object.
fn object_boundary<const D: usize, M: Storable<D>>(
    physical: &M,
    labels: &[u8],
) -> Result<NodesAndFacets<D>> {
    // If the geometry mirrors the lattice, faces have other numbers in physical coordinates.
    let face_cells = physical.cells_of_faces()?;
    let facets = boundary::boundary_facets(physical, &face_cells, labels);
    let mut nodes = physical.nodes().to_vec();
    boundary::smooth(&mut nodes, &facets);
    Ok((nodes, facets))
}

/// Returns the results of the cuts, one per line.
fn table(rows: &[CutResult]) -> String {
    let names = ["cells", "samples"];
    let mut lines = vec![format!(
        "{:<8} {:>9} {:>9} {:>8} {:>8} {:>8} {:>7}",
        "cut of", "number", "object", "share", "means s", "cut s", "Dice"
    )];
    lines.extend(
        names
            .iter()
            .zip(rows)
            .map(|(name, cut)| cut.summary_line(name)),
    );
    lines.join("\n")
}

/// Cuts the image's samples and not the cells.
fn segment_voxels<const D: usize>(
    image: &Image<D>,
    geometry: &Geometry<D>,
    seed_boxes: &SeedBoxes<D>,
    options: &Options,
    truth: Option<&[u8]>,
) -> Result<CutResult> {
    let seeds = seed_boxes.samples(image.dims(), geometry)?;
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

/// A box or a point in physical coordinates, and the option that gives it.
struct SeedBox<const D: usize> {
    option: &'static str,
    text: String,
    low: [f64; D],
    high: [f64; D],
}

impl<const D: usize> SeedBox<D> {
    fn parse(option: &'static str, text: &str) -> Result<Self> {
        let remedy = match D {
            2 => "give a point X,Y or a box X,Y:X,Y",
            _ => "give a point X,Y,Z or a box X,Y,Z:X,Y,Z",
        };
        let (a, b) = text.split_once(':').unwrap_or((text, text));
        let [a, b] = [
            parse::point::<D>(option, a, remedy)?,
            parse::point::<D>(option, b, remedy)?,
        ];
        Ok(Self {
            option,
            text: text.into(),
            low: std::array::from_fn(|k| a[k].min(b[k])),
            high: std::array::from_fn(|k| a[k].max(b[k])),
        })
    }

    fn contains(&self, p: [f64; D]) -> bool {
        (0..D).all(|k| self.low[k] <= p[k] && p[k] <= self.high[k])
    }

    fn centre(&self) -> [f64; D] {
        std::array::from_fn(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    fn outside_error(&self, container: &str) -> Error {
        let place = format!("{} {}", self.option, self.text);
        let remedy = "give physical coordinates; atomesh info shows their range";
        Error::Job(cause(
            place,
            format!("lies outside the {container}"),
            remedy,
        ))
    }
}

/// All places that the user marked.
struct SeedBoxes<const D: usize> {
    object: Vec<SeedBox<D>>,
    background: Vec<SeedBox<D>>,
}

impl<const D: usize> SeedBoxes<D> {
    fn parse_all(args: &SegmentArgs) -> Result<Self> {
        let parse = |option: &'static str, texts: &[String]| {
            texts
                .iter()
                .map(|text| SeedBox::parse(option, text))
                .collect::<Result<_>>()
        };
        Ok(Self {
            object: parse("--object", &args.object)?,
            background: parse("--background", &args.background)?,
        })
    }

    /// Returns the cells whose centres lie in the boxes, and the cells that contain the centres of
    /// the boxes.
    fn cells<M: Mesh<D>>(
        &self,
        mesh: &M,
        space: &LatticeSpace<D>,
        cells: &CellAdjacency<D>,
        face_cells: &[[u32; 2]],
    ) -> Result<SegmentSeeds> {
        let centres = cells.centres.iter().map(|&p| space.to_world(p));
        let centres: Vec<[f64; D]> = centres.collect();
        let find = |boxes: &[SeedBox<D>]| {
            let mut cells = Vec::new();
            for seed in boxes {
                let middle = space
                    .to_lattice(seed.centre())
                    .and_then(|p| find_cell(mesh, face_cells, p))
                    .ok_or_else(|| seed.outside_error("mesh"))?;
                cells.push(middle);
                cells.extend(
                    (0..)
                        .zip(&centres)
                        .filter(|(_, p)| seed.contains(**p))
                        .map(|(c, _)| c),
                );
            }
            cells.sort_unstable();
            cells.dedup();
            Ok::<Vec<u32>, Error>(cells)
        };
        Ok(SegmentSeeds {
            object: find(&self.object)?,
            background: find(&self.background)?,
        })
    }

    /// Returns the samples in the boxes, and those nearest to the centres of the boxes.
    fn samples(&self, dims: [usize; D], geometry: &Geometry<D>) -> Result<SegmentSeeds> {
        let count: usize = dims.iter().product();
        let index_of = |mut i: usize| {
            dims.map(|n| {
                let index = i % n;
                i /= n;
                index as f64
            })
        };
        let find = |boxes: &[SeedBox<D>]| {
            let mut samples = Vec::new();
            for seed in boxes {
                let index = geometry.to_index(seed.centre()).map(|p| p.map(f64::round));
                let middle = index
                    .filter(|p| (0..D).all(|k| 0.0 <= p[k] && p[k] < dims[k] as f64))
                    .ok_or_else(|| seed.outside_error("image"))?;
                let index = (0..D)
                    .rev()
                    .fold(0, |index, k| index * dims[k] + middle[k] as usize);
                samples.push(index as u32);
                if seed.low != seed.high {
                    let is_inside = |i: &usize| seed.contains(geometry.to_physical(index_of(*i)));
                    samples.extend((0..count).filter(is_inside).map(|i| i as u32));
                }
            }
            samples.sort_unstable();
            samples.dedup();
            Ok::<Vec<u32>, Error>(samples)
        };
        Ok(SegmentSeeds {
            object: find(&self.object)?,
            background: find(&self.background)?,
        })
    }
}
