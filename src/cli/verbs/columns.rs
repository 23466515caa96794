//! The verb `columns`: extends the Voronoi cells of a map down through layers between horizons.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse::{number, option_error};
use crate::error::cause;
use crate::export::surfaces::vtp::read_triangles;
use crate::export::{Gocad, read_gocad};
use crate::image::Geometry;
use crate::image::formats::AnyImage;
use crate::image::formats::InputOptions;
use crate::mesh::poly::PolyMesh;
use crate::model::columns::horizon::{Horizon, TriangleIndex};
use crate::model::columns::{Columns, LayerDivision, columns};
use crate::store::{AnyMesh, LatticeSpace, StoredMesh};

use crate::model::columns::file::columns_to_file;
use crate::store::output::Provenance;
use crate::{Error, Result};

/// Arguments of `atomesh columns`.
#[derive(Debug, Args)]
pub struct ColumnsArgs {
    /// The map: a mesh of Voronoi cells of a 2-D image, made by `atomesh mesh MAP --cells voronoi`
    #[arg(value_name = "MAP.vtu")]
    pub map: PathBuf,
    /// The mesh to write
    #[arg(short, long, value_name = "CELLS.vtu")]
    pub output: PathBuf,
    /// A horizon; give at least two, from the top down. Each is a number z, a 2-D image of z (with
    /// the dimensions of the meshed image, or with its own position), or a surface
    /// FILE.vtp[:NUMBER]
    #[arg(long, value_name = "Z", required = true, allow_hyphen_values = true)]
    pub horizon: Vec<String>,
    /// Number of layers between two horizons: one number for all intervals, or N,N,... [default: 1]
    #[arg(long, value_name = "N,...", conflicts_with = "layer_thickness")]
    pub layers: Option<String>,
    /// Mean thickness of the layers; replaces --layers
    #[arg(long, value_name = "T", allow_hyphen_values = true)]
    pub layer_thickness: Option<f64>,
    /// Smallest thickness of a layer; thinner layers vanish at that place
    #[arg(
        long,
        value_name = "T",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    pub least_thickness: f64,
    /// Unit of z [default: the unit of the map's x]
    #[arg(long, value_name = "UNIT")]
    pub z_unit: Option<String>,
    /// Options for reading the images.
    #[command(flatten, next_help_heading = "Reading images")]
    pub input: InputOptions,
}

/// Runs the verb.
pub fn run(args: &ColumnsArgs, console: &mut Console) -> Result<()> {
    let division = division(args)?;
    if !(args.least_thickness >= 0.0 && args.least_thickness.is_finite()) {
        let value = args.least_thickness.to_string();
        let remedy = "give 0 or more, in the unit of z";
        return Err(option_error(
            "--least-thickness",
            &value,
            "is not a thickness",
            remedy,
        ));
    }
    let files: Vec<&Path> = args.horizon.iter().map(Path::new).collect();
    let inputs: Vec<&Path> = [args.map.as_path()].into_iter().chain(files).collect();
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    console.begin_stage("reading");
    let (map, space) = read_map(&args.map, console)?;
    let mut z = Vec::new();
    for text in &args.horizon {
        let horizon = read_horizon(text, &space, &args.input, console)?;
        let (values, missing) = horizon.z_at_nodes(&map, text)?;
        if missing > 0 {
            console.note(format_args!(
                "{text} is not known at {missing} of the map's {} nodes: extrapolated smoothly there",
                values.len()
            ));
        }
        z.push(values);
    }
    console.begin_stage("building columns");
    let min_thickness = args.least_thickness;
    let built = columns(&map, &z, &args.horizon, &division, min_thickness)?;
    let table = table(&built, &map);
    let result = json!({
        "cells": built.column.len(),
        "columns": map.sites.len(),
        "layers": built.layer_counts,
        "missing": built.missing_counts,
        "z_grows": if built.is_z_up { "upwards" } else { "downwards" },
        "file": path_text(&args.output),
    });
    console.begin_stage("writing");
    let provenance = Provenance {
        parameters: format!("columns = {:?}", args.horizon),
        input_sha256: console.hash(&args.map)?,
    };
    let z_unit = args.z_unit.as_ref().unwrap_or(&space.geometry.units[0]);
    let file = columns_to_file(built, &map.region, &space, z_unit, &provenance);
    console.write_mesh(&args.output, file)?;
    console.result(
        format_args!("{table}\nwrote {}", args.output.display()),
        &result,
    );
    Ok(())
}

fn table(columns: &Columns, map: &PolyMesh<2>) -> String {
    let layers: Vec<String> = columns.layer_counts.iter().map(usize::to_string).collect();
    let mut lines = vec![
        format!(
            "cells          {} in {} columns",
            columns.column.len(),
            map.sites.len()
        ),
        format!(
            "layers         {} in the intervals, from the top",
            layers.join(", ")
        ),
        format!(
            "z              grows {}",
            if columns.is_z_up {
                "upwards"
            } else {
                "downwards: export it with --down z"
            }
        ),
    ];
    let missing = columns
        .missing_counts
        .iter()
        .enumerate()
        .filter(|m| *m.1 > 0);
    let missing: Vec<String> = missing
        .map(|(layer, count)| format!("layer {layer} in {count} columns"))
        .collect();
    if !missing.is_empty() {
        lines.push(format!("pinched out    {}", missing.join(", ")));
    }
    lines.join("\n")
}

fn division(args: &ColumnsArgs) -> Result<LayerDivision> {
    if let Some(thickness) = args.layer_thickness {
        return Ok(LayerDivision::Thickness(thickness));
    }
    let text = args.layers.as_deref().unwrap_or("1");
    let counts: Option<Vec<usize>> = text.split(',').map(|w| w.trim().parse().ok()).collect();
    counts.map(LayerDivision::Counts).ok_or_else(|| {
        let remedy = "give one, or one for each interval, such as 3,5";
        option_error("--layers", text, "is not a number of layers", remedy)
    })
}

/// Reads the map and its lattice space.
fn read_map(path: &Path, console: &Console) -> Result<(PolyMesh<2>, LatticeSpace<2>)> {
    let problem = match console.read_mesh(path)? {
        AnyMesh::Polygons(file) => {
            let stored = StoredMesh::new(file, &path.display().to_string())?;
            let space = stored.space.clone();
            return Ok((stored.into_file().mesh, space));
        }
        AnyMesh::Triangles(_) => "has triangles, which make poor columns for flow",
        AnyMesh::Tetrahedra(_) | AnyMesh::Polyhedra(_) => "is not a map but a 3-D mesh",
    };
    Err(Error::Mesh(cause(
        path.display(),
        problem,
        "mesh a 2-D image of the map with --cells voronoi",
    )))
}

/// Reads a horizon from the value of `--horizon`.
fn read_horizon(
    text: &str,
    space: &LatticeSpace<2>,
    input: &InputOptions,
    console: &Console,
) -> Result<Horizon> {
    if let Ok(z) = text.parse::<f64>() {
        return Ok(Horizon::Flat(number(
            "--horizon",
            &z.to_string(),
            "give a finite z",
        )?));
    }
    let (path, number) = match text.rsplit_once(':') {
        Some((path, number)) if path.ends_with(".vtp") => {
            let number = number.parse().map_err(|_| {
                let remedy = "give FILE.vtp or FILE.vtp:NUMBER";
                option_error("--horizon", text, "names no surface", remedy)
            })?;
            (Path::new(path), Some(number))
        }
        _ => (Path::new(text), None),
    };
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("vtp"))
    {
        let triangles = read_triangles(path, number)?;
        if triangles.is_empty() {
            let remedy = "give a surface of `atomesh surface`: FILE.vtp, or FILE.vtp:NUMBER";
            return Err(option_error(
                "--horizon",
                text,
                "has no such surface",
                remedy,
            ));
        }
        return Ok(Horizon::Surface(TriangleIndex::new(triangles)));
    }
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("ts"))
    {
        let Gocad::Surfaces(file) = read_gocad(path)? else {
            let remedy = "give a file of TSurf objects";
            return Err(option_error(
                "--horizon",
                text,
                "holds lines and no surface",
                remedy,
            ));
        };
        let corners = file
            .facets
            .iter()
            .map(|f| f.map(|n| file.nodes[n as usize]));
        return Ok(Horizon::Surface(TriangleIndex::new(corners.collect())));
    }
    let loaded = console.read_image(path, input)?;
    let AnyImage::Plane(loaded) = loaded else {
        let remedy = "give an image of z over the map";
        return Err(option_error("--horizon", text, "is a 3-D image", remedy));
    };
    loaded.notes.iter().for_each(|note| console.note(note));
    let mut image = loaded.image;
    // An image without a position has the position of the map.
    let unplaced = Geometry::<2>::default();
    let is_placed =
        (image.geometry.origin, image.geometry.axes) != (unplaced.origin, unplaced.axes);
    if !is_placed && space.fits_dims(image.dims()) {
        image.geometry = space.geometry.clone();
    }
    Ok(Horizon::Grid(image))
}
