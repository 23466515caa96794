//! The verb `paint`: grows regions of cells from seeds, within layers but not across surfaces.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use serde_json::json;

use crate::Result;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::export::SurfaceFile;
use crate::export::surfaces::outcome::SURFACE_EXTENSIONS;
use crate::image::ScalarField;
use crate::image::formats::InputOptions;
use crate::mesh::Mesh;
use crate::model::geodesics::{GeodesicSource, Geodesics};
use crate::model::input::read_mesh_image;
use crate::model::paint::{blocks, contrast_factors, paint as paint_cells};
use crate::model::surface::GroupingOptions;
use crate::model::surface::adjacency::{CellAdjacency, enclosing_facets, find_cell};
use crate::model::surface::stored_surfaces::{group_facets, tagged_facets};
use crate::store::{LatticeSpace, MeshFile, Storable, StoredMesh, with_mesh};

/// Smallest number of cells of a compartment; smaller ones are fragments between surfaces.
const MIN_COMPARTMENT_CELLS: usize = 24;

/// Arguments of `atomesh paint`.
#[derive(Debug, Args)]
pub struct PaintArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The mesh to write, with the painted regions as cell data `region` (0: not painted)
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// Points where paint begins, in physical coordinates (X,Y in 2-D); =N sets the region,
    /// otherwise each seed has its own. May be repeated; `auto` paints every block between surfaces
    #[arg(
        long,
        value_name = "X,Y,Z[=N]",
        required = true,
        allow_hyphen_values = true
    )]
    pub seed: Vec<String>,
    /// An image; paint flows less easily where its values change
    #[arg(long, value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// Largest distance of paint from its seed, in samples, along the shortest path that crosses no
    /// surface
    #[arg(long, value_name = "SAMPLES")]
    pub level: Option<f64>,
    /// Largest width of an opening that paint does not pass, as a fraction of the blocks that it
    /// connects; 0 for none
    #[arg(long, value_name = "SHARE", default_value_t = 0.3)]
    pub neck: f64,
    /// Also write the surfaces around the painted regions: .vtp, .obj, or GOCAD's .ts
    #[arg(long, value_name = "S.vtp")]
    pub surface_out: Option<PathBuf>,
    /// Options that group faces into the surfaces that paint does not cross.
    #[command(flatten)]
    pub grouping: GroupingOptions,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The report on one painted region.
#[derive(Debug, Serialize)]
struct PaintedRegion {
    region: u32,
    cells: usize,
    volume: f64,
    share: f64,
}

/// Runs the verb.
pub fn paint(args: &PaintArgs, console: &mut Console) -> Result<()> {
    let inputs: Vec<&std::path::Path> = [Some(args.mesh.as_path()), args.image.as_deref()]
        .into_iter()
        .flatten()
        .collect();
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    if let Some(path) = &args.surface_out {
        let inputs = [inputs.as_slice(), &[&args.output]].concat();
        check_output(path, "--surface-out", &SURFACE_EXTENSIONS, &inputs)?;
    }
    if args.image.is_none() {
        args.input.refuse_unused("no image is given")?;
    }
    console.begin_stage("reading");
    with_mesh!(console.read_mesh(&args.mesh)?, file => paint_mesh(args, file, console))
}

fn paint_mesh<const D: usize, M: Storable<D>>(
    args: &PaintArgs,
    file: MeshFile<M>,
    console: &mut Console,
) -> Result<()> {
    let seeds = parse_seeds::<D>(&args.seed)?;
    let options = args.grouping.options(Some(0.0))?;
    let (_, z_up) = args.grouping.up_direction::<D>()?;
    let level = check_range(
        "--level",
        args.level.unwrap_or(f64::INFINITY),
        0.0..=f64::INFINITY,
    )?;
    let neck = check_range("--neck", args.neck, 0.0..=1.0)?;
    let name = args.mesh.display().to_string();
    let stored = StoredMesh::new(file, &name)?;
    let tagged = tagged_facets(&stored, &name)?;
    let mut closed = group_facets(&stored, tagged, &options).facets;
    closed.iter_mut().for_each(|facet| facet.sort_unstable());
    closed.sort_unstable();

    console.begin_stage("painting");
    let face_cells = stored.lattice.cells_of_faces()?;
    let cells = CellAdjacency::new(&stored.lattice, &face_cells, &closed);
    let (block, count) = blocks(&cells, neck, MIN_COMPARTMENT_CELLS);
    let space = stored.space.clone();
    let regions: Vec<u32> = match &seeds {
        None => block.iter().map(|b| b + 1).collect(),
        Some(seeds) => {
            let sources = geodesic_sources(args, seeds, &stored, &face_cells)?;
            let contrast = image_contrast(args, &space, &cells, console)?;
            let geodesics = Geodesics::new(&stored.lattice, &face_cells, &cells);
            let painted = paint_cells(&geodesics, &block, contrast.as_deref(), &sources, level);
            let label = |label: Option<u32>| label.unwrap_or(0);
            painted.label.into_iter().map(label).collect()
        }
    };
    let mut file = stored.into_file();
    // If the geometry mirrors the lattice, faces have other numbers in physical coordinates.
    let face_cells = file.mesh.cells_of_faces()?;

    console.begin_stage("writing");
    M::set_regions(&mut file, regions.iter().map(|&r| r as i32).collect());
    let painted = totals(&file.mesh, &regions);
    if let Some(path) = &args.surface_out {
        let physical = &file.mesh;
        let (mut facets, mut start) = (Vec::new(), vec![0]);
        for PaintedRegion { region, .. } in &painted {
            facets.extend(enclosing_facets(physical, &face_cells, &regions, *region));
            start.push(facets.len());
        }
        let mut surfaces = SurfaceFile::new(physical.nodes(), &facets, &start, "region");
        surfaces.names = painted
            .iter()
            .map(|r| format!("region{}", r.region))
            .collect();
        console.write_surfaces(path, surfaces.with_space(&space.geometry, z_up))?;
    }
    console.write_mesh(&args.output, file)?;
    let mut lines = vec![format!(
        "{:>6} {:>9} {:>13} {:>7}",
        "region",
        "cells",
        if D == 2 { "area" } else { "volume" },
        "share"
    )];
    lines.extend(painted.iter().map(|r| {
        let share = 100.0 * r.share;
        format!(
            "{:>6} {:>9} {:>13.6e} {share:>6.2}%",
            r.region, r.cells, r.volume
        )
    }));
    lines.push(format!(
        "wrote {}: {} regions",
        args.output.display(),
        painted.len()
    ));
    console.result(
        lines.join("\n"),
        &json!({
            "file": path_text(&args.output), "surface": args.surface_out.as_deref().map(path_text), "blocks": count, "regions": painted,
        }),
    );
    Ok(())
}

/// Returns the seeds as sources in cells of the mesh.
fn geodesic_sources<const D: usize, M: Storable<D>>(
    args: &PaintArgs,
    seeds: &[SeedPoint<D>],
    stored: &StoredMesh<D, M>,
    face_cells: &[[u32; 2]],
) -> Result<Vec<GeodesicSource<D>>> {
    (seeds.iter().zip(&args.seed))
        .map(|(&(p, label), text)| {
            let position = stored.space.to_lattice(p);
            let located = position.and_then(|position| {
                Some((position, find_cell(&stored.lattice, face_cells, position)?))
            });
            let (position, cell) = located.ok_or_else(|| {
                let remedy = "give physical coordinates; atomesh info shows their range";
                parse::option_error("--seed", text, "lies outside the mesh", remedy)
            })?;
            Ok(GeodesicSource {
                position,
                cell,
                label,
            })
        })
        .collect()
}

/// Returns the number of cells, the volume and the fraction of the total volume of each region that
/// has cells, except for region 0, which is unpainted.
fn totals<const D: usize, M: Mesh<D>>(mesh: &M, regions: &[u32]) -> Vec<PaintedRegion> {
    let max_region = regions.iter().copied().max().unwrap_or(0) as usize;
    let mut sums = vec![(0, 0.0); max_region + 1];
    let mut total = 0.0;
    for (volume, &region) in mesh.volumes().iter().zip(regions) {
        sums[region as usize].0 += 1;
        sums[region as usize].1 += volume;
        total += volume;
    }
    let numbered = (0..).zip(sums).skip(1).filter(|(_, sum)| sum.0 > 0);
    numbered
        .map(|(region, (cells, volume))| PaintedRegion {
            region,
            cells,
            volume,
            share: volume / total,
        })
        .collect()
}

/// Returns for each link the factor by which the image slows paint, if an image is given.
fn image_contrast<const D: usize>(
    args: &PaintArgs,
    space: &LatticeSpace<D>,
    cells: &CellAdjacency<D>,
    console: &Console,
) -> Result<Option<Vec<f64>>> {
    let Some(path) = &args.image else {
        return Ok(None);
    };
    let image = read_mesh_image(path, &args.input, space, &console.reader())?;
    let field = ScalarField {
        dims: image.dims(),
        step: space.step,
        samples: image.as_slice().to_vec(),
    };
    let values: Vec<f64> = cells.centres.iter().map(|&x| field.value(x)).collect();
    Ok(Some(contrast_factors(cells, &values)))
}

/// A point where paint begins, and its region, from 1.
type SeedPoint<const D: usize> = ([f64; D], u32);

/// Parses the seeds and their regions; returns `None` for `auto`.
fn parse_seeds<const D: usize>(texts: &[String]) -> Result<Option<Vec<SeedPoint<D>>>> {
    if let [only] = texts
        && only == "auto"
    {
        return Ok(None);
    }
    let remedy = match D {
        2 => "give X,Y or X,Y=N, such as 10,20.5 or 10,20.5=2, or auto alone",
        _ => "give X,Y,Z or X,Y,Z=N, such as 10,20.5,30 or 10,20.5,30=2, or auto alone",
    };
    let seed = |(text, default): (&String, u32)| {
        let (point, region) = match text.split_once('=') {
            None => (text.as_str(), default),
            Some((point, region)) => {
                let region = region
                    .trim()
                    .parse()
                    .ok()
                    .filter(|u| (1..=1_000_000).contains(u));
                let wrong = || {
                    parse::option_error("--seed", text, "has no region from 1 to 1000000", remedy)
                };
                (point, region.ok_or_else(wrong)?)
            }
        };
        Ok((parse::point("--seed", point, remedy)?, region))
    };
    let seeds: Result<Vec<_>> = texts.iter().zip(1..).map(seed).collect();
    seeds.map(Some)
}

/// Checks that a number is in a range.
fn check_range(option: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<f64> {
    if range.contains(&value) {
        return Ok(value);
    }
    let remedy = format!("give a number from {} to {}", range.start(), range.end());
    Err(parse::option_error(
        option,
        &value.to_string(),
        "is out of range",
        &remedy,
    ))
}
