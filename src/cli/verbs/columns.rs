//! The verb `columns`: extends the Voronoi cells of a map down through layers between horizons.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::cli::parse::{number, option_error};
use crate::export::surfaces::vtp::read_triangles;
use crate::export::{Gocad, read_gocad};
use crate::image::formats::{AnyImage, InputOptions};
use crate::model::columns::horizon::{Horizon, TriangleIndex};
use crate::model::columns::{ColumnsInput, ColumnsSpec};
use crate::progress::Stage;

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
    /// Options of the columns.
    #[command(flatten)]
    pub spec: ColumnsSpec,
}

/// Runs the verb.
pub fn columns(args: &ColumnsArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    spec.validate().map_err(with_option_name::<ColumnsSpec>)?;
    let horizons = args.horizon.iter().map(Path::new);
    let inputs: Vec<&Path> = [args.map.as_path()].into_iter().chain(horizons).collect();
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    console.begin_stage(Stage::Reading);
    let map = console.read_mesh(&args.map)?;
    let horizon = |text: &String| {
        let horizon = read_horizon(text, &spec.input, console)?;
        Ok((text.clone(), horizon))
    };
    let input = ColumnsInput {
        map,
        name: &path_text(&args.map),
        sha256: console.hash(&args.map)?,
        horizons: args.horizon.iter().map(horizon).collect::<Result<_>>()?,
    };
    let outcome = console.run(interrupts, |_, progress| {
        crate::columns(input, spec, progress).map_err(with_option_name::<ColumnsSpec>)
    })?;
    console.begin_stage(Stage::Writing);
    let (table, mut report) = (outcome.table(), outcome.to_json());
    report["file"] = json!(path_text(&args.output));
    console.write_mesh(&args.output, outcome.mesh)?;
    console.result(
        format_args!("{table}\nwrote {}", args.output.display()),
        &report,
    );
    Ok(())
}

/// Reads a horizon from the value of `--horizon`.
fn read_horizon(text: &str, input: &InputOptions, console: &Console) -> Result<Horizon> {
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
    Ok(Horizon::Grid(loaded.image))
}
