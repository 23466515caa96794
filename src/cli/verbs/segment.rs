//! The verb `segment`: object and background by a minimum cut on the cells of a mesh.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::json;

use super::surface::{SURFACE_EXTENSIONS as SURFACES, read_mesh_image, write_file};
use crate::cli::common::output::{IMAGE_EXTENSIONS, check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::SurfaceFile;
use crate::files::vtk::DataArray;
use crate::image::formats::InputOptions;
use crate::image::{Geometry, Image};
use crate::mesh::Mesh;
use crate::model::segment::superpixels::Superpixels;
use crate::model::segment::{Options, SegmentSeeds, boundary, cut_cells, cut_samples, dice};
use crate::model::surface::adjacency::{CellAdjacency, find_cell};
use crate::report::cost::cpu_seconds;
use crate::store::{LatticeSpace, MeshFile, Storable, StoredMesh, with_mesh};
use crate::{Error, Result};

/// `atomesh segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// The image that was meshed, or another of the same dimensions
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Where the object is, in physical coordinates; may be repeated: a point X,Y,Z (X,Y in 2-D),
    /// or a box
    /// as two of its corners, X,Y,Z:X,Y,Z
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub object: Vec<String>,
    /// Where the background is, given in the same way; may be repeated
    #[arg(
        long,
        value_name = "X,Y,Z[:X,Y,Z]",
        required = true,
        allow_hyphen_values = true
    )]
    pub background: Vec<String>,
    /// The mesh with `label` (1 object, 0 background) and `mean` (of the image) for each cell
    #[arg(short, long, value_name = "SEG.vtu")]
    pub output: PathBuf,
    /// The label of each sample, as an image
    #[arg(long, value_name = "L.npy")]
    pub labels_out: Option<PathBuf>,
    /// The boundary between object and background, smoothed: .vtp, .obj, or GOCAD's .ts
    #[arg(long, value_name = "S.vtp")]
    pub surface_out: Option<PathBuf>,
    /// Weight of the values against the boundary
    #[arg(long, value_name = "NUMBER", default_value_t = 1.0)]
    pub lambda: f64,
    /// Difference of neighbouring cells' values at which a boundary is cheap [default: the root mean
    /// square of all differences]
    #[arg(long, value_name = "VALUE")]
    pub sigma: Option<f64>,
    /// An image of the true object (not 0), with which the result is compared
    #[arg(long, value_name = "T.npy")]
    pub truth: Option<PathBuf>,
    /// Also cut the image's samples themselves, the classical method, and report both
    #[arg(long)]
    pub voxels: bool,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// What a cut found and cost.
#[derive(Debug, Serialize)]
struct CutResult {
    /// Cells, or samples.
    nodes: usize,
    /// Those of the object.
    object: usize,
    /// The object's share of the whole.
    share: f64,
    sigma: f64,
    cost: f64,
    /// Processor seconds for mean values; 0 for samples.
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
    let marks = SeedBoxes::<D>::parse_all(args)?;
    let stored = StoredMesh::new(file, &args.mesh.display().to_string())?;
    let space = stored.space.clone();
    let image = read_mesh_image(&args.image, &args.input, &space, console)?;
    let truth = (args.truth.as_deref())
        .map(|path| read_mesh_image(path, &InputOptions::default(), &space, console))
        .transpose()?;
    let truth: Option<Vec<u8>> = truth.map(|image| {
        image
            .as_slice()
            .iter()
            .map(|&v| u8::from(v != 0.0))
            .collect()
    });
    let options = Options {
        lambda: args.lambda,
        sigma: args.sigma,
    };

    console.begin_stage("averaging");
    let start = cpu_seconds();
    let mesh = &stored.lattice;
    let across = mesh.cells_of_faces()?;
    let cells = CellAdjacency::new(mesh, &across, &[]);
    let superpixels = Superpixels::new(mesh, &cells, &across, &image, space.step);
    let averaged = cpu_seconds();
    console.begin_stage("cutting");
    let seeds = marks.cells(mesh, &space, &cells, &across)?;
    let found = cut_cells(&cells, &superpixels.means, &seeds, &options)?;
    let cut = cpu_seconds();

    let labels = &found.labels;
    let of_samples =
        (args.labels_out.is_some() || truth.is_some()).then(|| superpixels.sample_labels(labels));
    let whole: f64 = cells.volumes.iter().sum();
    let inside = cells
        .volumes
        .iter()
        .zip(labels)
        .filter(|(_, label)| **label == 1);
    let mut rows = vec![CutResult {
        nodes: cells.len(),
        object: labels.iter().filter(|label| **label == 1).count(),
        share: inside.map(|(volume, _)| volume).sum::<f64>() / whole,
        sigma: found.sigma,
        cost: found.cost,
        means_seconds: averaged - start,
        cut_seconds: cut - averaged,
        dice: truth
            .as_ref()
            .zip(of_samples.as_ref())
            .map(|(t, l)| dice(l, t)),
    }];
    if args.voxels {
        console.begin_stage("cutting samples");
        rows.push(segment_voxels(
            &image,
            &space.geometry,
            &marks,
            &options,
            truth.as_deref(),
        )?);
    }

    console.begin_stage("writing");
    if let (Some(path), Some(labels)) = (&args.labels_out, of_samples) {
        let labels = labels.into_iter().map(f32::from).collect();
        let labels = Image::new(image.dims(), labels, image.geometry.clone());
        console.write_image(path, labels)?;
    }
    let mut file = stored.into_file();
    if let Some(path) = &args.surface_out {
        let physical = &file.mesh;
        // Faces have other numbers where the world mirrors the lattice.
        let across = physical.cells_of_faces()?;
        let facets = boundary::boundary_facets(physical, &across, labels);
        let mut nodes = physical.nodes().to_vec();
        boundary::smooth(&mut nodes, &facets);
        let surface = SurfaceFile::new(&nodes, &facets, &[0, facets.len()], "object");
        write_file(path, surface, &space.geometry, true, console)?;
    }
    file.cell_data
        .retain(|array| !matches!(array.name.as_str(), "label" | "mean"));
    file.cell_data
        .push(DataArray::scalars("label", found.labels));
    file.cell_data
        .push(DataArray::scalars("mean", superpixels.means));
    console.write_mesh(&args.output, file)?;

    let names = ["cells", "samples"];
    let mut lines = vec![format!(
        "{:<8} {:>9} {:>9} {:>8} {:>8} {:>8} {:>7}",
        "cut of", "number", "object", "share", "means s", "cut s", "Dice"
    )];
    lines.extend(
        names
            .iter()
            .zip(&rows)
            .map(|(name, cut)| cut.summary_line(name)),
    );
    lines.push(format!("wrote {}", args.output.display()));
    let mut rows = rows.into_iter();
    let [cells, samples] = [rows.next(), rows.next()];
    console.result(
        lines.join("\n"),
        &json!({
            "file": path_text(&args.output), "labels": args.labels_out.as_deref().map(path_text), "surface": args.surface_out.as_deref().map(path_text),
            "cells": cells, "samples": samples,
        }),
    );
    Ok(())
}

/// Cuts the samples themselves.
fn segment_voxels<const D: usize>(
    image: &Image<D>,
    geometry: &Geometry<D>,
    marks: &SeedBoxes<D>,
    options: &Options,
    truth: Option<&[u8]>,
) -> Result<CutResult> {
    let seeds = marks.samples(image.dims(), geometry)?;
    let start = cpu_seconds();
    let found = cut_samples(image, &seeds, options)?;
    let cut_seconds = cpu_seconds() - start;
    let object = found.labels.iter().filter(|label| **label == 1).count();
    Ok(CutResult {
        nodes: found.labels.len(),
        object,
        share: object as f64 / found.labels.len() as f64,
        sigma: found.sigma,
        cost: found.cost,
        means_seconds: 0.0,
        cut_seconds,
        dice: truth.map(|truth| dice(&found.labels, truth)),
    })
}

/// A box in physical coordinates, or a point, and what was typed.
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

    fn outside_error(&self, of: &str) -> Error {
        let place = format!("{} {}", self.option, self.text);
        let remedy = "give physical coordinates; atomesh info shows their range";
        Error::Job(cause(place, format!("lies outside the {of}"), remedy))
    }
}

/// Everything that the user marked.
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

    /// Cells whose centres the boxes hold, and those that hold the boxes' middles.
    fn cells<M: Mesh<D>>(
        &self,
        mesh: &M,
        space: &LatticeSpace<D>,
        cells: &CellAdjacency<D>,
        across: &[[u32; 2]],
    ) -> Result<SegmentSeeds> {
        let centres = cells.centres.iter().map(|&p| space.to_world(p));
        let centres: Vec<[f64; D]> = centres.collect();
        let find = |marks: &[SeedBox<D>]| {
            let mut found = Vec::new();
            for mark in marks {
                let middle = space
                    .to_lattice(mark.centre())
                    .and_then(|p| find_cell(mesh, across, p))
                    .ok_or_else(|| mark.outside_error("mesh"))?;
                found.push(middle);
                found.extend(
                    (0..)
                        .zip(&centres)
                        .filter(|(_, p)| mark.contains(**p))
                        .map(|(c, _)| c),
                );
            }
            found.sort_unstable();
            found.dedup();
            Ok::<Vec<u32>, Error>(found)
        };
        Ok(SegmentSeeds {
            object: find(&self.object)?,
            background: find(&self.background)?,
        })
    }

    /// Samples that the boxes hold, and those nearest to the boxes' middles.
    fn samples(&self, dims: [usize; D], geometry: &Geometry<D>) -> Result<SegmentSeeds> {
        let count: usize = dims.iter().product();
        let index_of = |mut i: usize| {
            dims.map(|n| {
                let index = i % n;
                i /= n;
                index as f64
            })
        };
        let find = |marks: &[SeedBox<D>]| {
            let mut found = Vec::new();
            for mark in marks {
                let index = geometry.to_index(mark.centre()).map(|p| p.map(f64::round));
                let middle = index
                    .filter(|p| (0..D).all(|k| 0.0 <= p[k] && p[k] < dims[k] as f64))
                    .ok_or_else(|| mark.outside_error("image"))?;
                let at = (0..D)
                    .rev()
                    .fold(0, |at, k| at * dims[k] + middle[k] as usize);
                found.push(at as u32);
                if mark.low != mark.high {
                    let held = |i: &usize| mark.contains(geometry.to_physical(index_of(*i)));
                    found.extend((0..count).filter(held).map(|i| i as u32));
                }
            }
            found.sort_unstable();
            found.dedup();
            Ok::<Vec<u32>, Error>(found)
        };
        Ok(SegmentSeeds {
            object: find(&self.object)?,
            background: find(&self.background)?,
        })
    }
}
