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
use crate::image::formats::{AnyImage, InputOptions};
use crate::image::stated::CoordinateOptions;
use crate::job::spec::{FileOption, InvalidValue};
use crate::model::columns::given::{GivenHorizon, HorizonShape};
use crate::model::columns::{ColumnsInput, ColumnsSpec};
use crate::progress::Stage;
use crate::surface_file::interpretation::read_interpretation_as;

/// Endings of files of surfaces and points. All others are images.
const SURFACE_ENDINGS: [&str; 11] = [
    "vtp", "ts", "obj", "pl", "vs", "csv", "xyz", "txt", "dat", "charisma", "asc",
];

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
    /// the dimensions of the meshed image, or with its own position), a grid (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), or
    /// surfaces FILE[:NAME] (.ts, .vtp, .obj) or points. z is brought to one unit and one direction; what a file does not say
    /// follows it: ,unit=ft ,z=down ,null=-999
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
    let options: Vec<Option<FileOption>> = args
        .horizon
        .iter()
        .map(|text| horizon_file(text))
        .collect::<Result<_>>()?;
    let files = options.iter().flatten().map(|option| option.path.as_path());
    let inputs: Vec<&Path> = [args.map.as_path()].into_iter().chain(files).collect();
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    console.begin_stage(Stage::Reading);
    let map = console.read_mesh(&args.map)?;
    let horizon = |text: &String| read_horizon(text, &spec.input, console);
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

/// Returns the file that the value of `--horizon` names; `None` if it is a number.
fn horizon_file(text: &str) -> Result<Option<FileOption>> {
    if text.parse::<f64>().is_ok() {
        return Ok(None);
    }
    let option: FileOption = (text.parse()).map_err(|error: InvalidValue| {
        option_error("--horizon", text, &error.problem, &error.remedy)
    })?;
    if let Some(false) = option.is_horizon {
        let remedy = "omit ,fault";
        return Err(option_error(
            "--horizon",
            text,
            "is a horizon and no fault",
            remedy,
        ));
    }
    Ok(Some(option))
}

/// Reads a horizon from the value of `--horizon`.
fn read_horizon(text: &str, input: &InputOptions, console: &Console) -> Result<GivenHorizon> {
    let nulls = input.point_nulls()?;
    let given = |shape, options: &CoordinateOptions| GivenHorizon {
        place: text.to_string(),
        shape,
        options: options.with_nulls(nulls.clone()),
    };
    let Some(option) = horizon_file(text)? else {
        let z = number("--horizon", text, "give a finite z")?;
        return Ok(given(HorizonShape::Flat(z), &CoordinateOptions::default()));
    };
    let path = option.path.as_path();
    if !is_surface_file(path) {
        let AnyImage::Plane(loaded) = console.read_image(path, input)? else {
            let remedy = "give an image of z over the map";
            return Err(option_error("--horizon", text, "is a 3-D image", remedy));
        };
        loaded.notes.iter().for_each(|note| console.note(note));
        return Ok(given(
            HorizonShape::Grid(Box::new(loaded.image)),
            &option.coordinates,
        ));
    }
    let mut surfaces = read_interpretation_as(path, &option.coordinates.columns)?;
    let names: Vec<String> = surfaces
        .iter()
        .map(|surface| surface.name.clone())
        .collect();
    if let Some(name) = &option.name {
        let named = names.iter().position(|other| other == name);
        let by_number = name
            .parse::<usize>()
            .ok()
            .and_then(|number| number.checked_sub(1));
        match named.or(by_number.filter(|&k| k < surfaces.len())) {
            Some(k) => surfaces = vec![surfaces.swap_remove(k)],
            None => {
                let problem = format!("names no surface: the file has {}", names.join(", "));
                let remedy = "give FILE, FILE:NAME or FILE:NUMBER";
                return Err(option_error("--horizon", text, &problem, remedy));
            }
        }
    }
    Ok(given(HorizonShape::Surfaces(surfaces), &option.coordinates))
}

/// Returns `true` if a file holds surfaces or points and no image, judged by its ending.
fn is_surface_file(path: &Path) -> bool {
    let ending = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    SURFACE_ENDINGS.contains(&&*ending)
}
