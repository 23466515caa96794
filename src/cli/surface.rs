//! The verb `surface`: faces on features, as labelled surfaces.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::console::Console;
use super::job::check_output;
use super::parse;
use crate::export::{SurfaceFile, read_vtu, write_obj, write_tsurf, write_vtp};
use crate::io::vtk::DataArray;
use crate::pipeline::file::Placed;
use crate::surface::facets::{normal, unit};
use crate::surface::measure::Up;
use crate::surface::{Measure, Options, Surfaces, measure, select};
use crate::{Error, Result, error::cause};

/// `atomesh surface`.
#[derive(Debug, Args)]
pub struct SurfaceArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The surfaces to write: .vtp, .obj, or GOCAD's .ts
    #[arg(short, long, value_name = "S.vtp")]
    pub output: PathBuf,
    /// How surfaces are told apart.
    #[command(flatten)]
    pub grouping: Grouping,
}

/// What makes faces one surface, and how its orientation is told.
#[derive(Debug, Clone, Args)]
pub struct Grouping {
    /// Largest bend from face to face within a surface, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 25.0)]
    pub max_bend: f64,
    /// Drop surfaces of less area, in square samples [default: ten faces]
    #[arg(long, value_name = "AREA")]
    pub min_area: Option<f64>,
    /// Which way is up: x, y, z or -x, -y, -z in physical coordinates
    #[arg(
        long,
        value_name = "AXIS",
        default_value = "z",
        allow_hyphen_values = true
    )]
    pub up: String,
}

/// The endings of the surface formats that are written.
pub const WRITTEN: [&str; 3] = ["vtp", "obj", "ts"];

impl Grouping {
    /// The options, checked.
    ///
    /// # Errors
    /// [`Error::Job`] for a bend that is no angle below 90 degrees, or a negative area.
    pub fn options(&self) -> Result<Options> {
        let refuse = |option: String, remedy: &str| {
            Err(Error::Job(cause(option, "is out of range", remedy)))
        };
        if !(self.max_bend > 0.0 && self.max_bend < 90.0) {
            return refuse(
                format!("--max-bend {}", self.max_bend),
                "give degrees above 0 and below 90; 25 is usual",
            );
        }
        if let Some(area) = self.min_area.filter(|a| !(a.is_finite() && *a >= 0.0)) {
            return refuse(
                format!("--min-area {area}"),
                "give 0 or more square samples",
            );
        }
        Ok(Options {
            max_bend: self.max_bend,
            min_area: self.min_area,
            ..Options::default()
        })
    }

    /// The directions of up, north and east; and whether z grows upwards, as far as it says.
    ///
    /// # Errors
    /// [`Error::Job`] for anything but x, y, z, -x, -y or -z.
    pub fn up(&self) -> Result<(Up<3>, bool)> {
        let positive = !self.up.starts_with('-');
        let axis = ["x", "y", "z"]
            .iter()
            .position(|&a| a == self.up.trim_start_matches('-'));
        match axis {
            Some(axis) => Ok((Up::along(axis, positive), positive)),
            None => Err(parse::bad(
                "--up",
                &self.up,
                "is no axis",
                "give x, y, z, -x, -y or -z",
            )),
        }
    }
}

/// The surfaces of a mesh, oriented in physical space.
///
/// # Errors
/// [`Error::Mesh`] if the mesh does not say which of its faces lie on features.
pub fn surfaces(
    placed: &Placed,
    place: &Path,
    options: &Options,
    up: &Up<3>,
) -> Result<Surfaces<3>> {
    let Some(bits) = &placed.feature_faces else {
        return Err(Error::Mesh(cause(
            place.display(),
            "does not say which faces lie on features (no cell data feature_faces)",
            "give a mesh that atomesh mesh wrote",
        )));
    };
    let faces = select::marked(&placed.lattice, bits);
    let candidates = select::spanned(&placed.lattice, &faces);
    let mut surfaces = Surfaces::find(&placed.lattice.nodes, faces, &candidates, options);
    surfaces.orient(&placed.physical.nodes, up.up);
    Ok(surfaces)
}

/// `atomesh surface`.
pub fn surface(args: &SurfaceArgs, console: &mut Console) -> Result<()> {
    check_output(&args.output, "--output", &WRITTEN, &[&args.mesh])?;
    let options = args.grouping.options()?;
    let (up, z_up) = args.grouping.up()?;
    console.begin_stage("reading");
    let placed = Placed::new(read_vtu(&args.mesh)?, &args.mesh.display().to_string())?;
    console.begin_stage("grouping faces");
    let surfaces = surfaces(&placed, &args.mesh, &options, &up)?;
    let measures = measure(&surfaces, &placed.physical.nodes, &up);
    console.begin_stage("writing");
    let nodes = &placed.physical.nodes;
    let mut file = SurfaceFile::new(nodes, &surfaces.facets, &surfaces.start, "surface");
    file.cell_data = cell_data(&surfaces, &measures, nodes);
    write_file(&args.output, &file, z_up)?;
    let mut text = table(&measures);
    if surfaces.filled > 0 {
        text += &format!("\n{} faces close gaps", surfaces.filled);
    }
    if surfaces.dropped > 0 {
        text += &format!(
            "\nleft out: {} small surfaces, {:.0} square samples in all",
            surfaces.dropped, surfaces.dropped_area
        );
    }
    text += &format!(
        "\nwrote {}: {} surfaces",
        args.output.display(),
        surfaces.len()
    );
    console.result(
        text,
        &json!({
            "file": args.output,
            "surfaces": measures,
            "filled_faces": surfaces.filled,
            "dropped": surfaces.dropped,
            "dropped_area": surfaces.dropped_area,
        }),
    );
    Ok(())
}

/// Writes surfaces in the format of the file's ending.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn write_file(path: &Path, file: &SurfaceFile<3>, z_up: bool) -> Result<()> {
    let ends = |ending: &str| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case(ending))
    };
    if ends("obj") {
        write_obj(path, file)
    } else if ends("ts") {
        write_tsurf(path, file, z_up)
    } else {
        write_vtp(path, file)
    }
}

/// What is known of each face and of the surface that it is part of.
fn cell_data(surfaces: &Surfaces<3>, measures: &[Measure], nodes: &[[f64; 3]]) -> Vec<DataArray> {
    let labels = surfaces.labels();
    let of = |value: &dyn Fn(&Measure) -> f64| -> Vec<f32> {
        labels
            .iter()
            .map(|&s| value(&measures[s as usize]) as f32)
            .collect()
    };
    let normal = |face: &[u32; 3]| unit(normal(&face.map(|i| nodes[i as usize]))).map(|c| c as f32);
    vec![
        DataArray {
            name: "normal".into(),
            components: 3,
            values: surfaces
                .facets
                .iter()
                .flat_map(normal)
                .collect::<Vec<f32>>()
                .into(),
        },
        DataArray::scalars("dip", of(&|m| m.dip)),
        DataArray::scalars("strike", of(&|m| m.strike.unwrap_or(f64::NAN))),
        DataArray::scalars("area", of(&|m| m.area)),
    ]
}

/// The largest surfaces as lines of text.
fn table(measures: &[Measure]) -> String {
    const MOST: usize = 40;
    let mut lines = vec![format!(
        "{:>7} {:>11} {:>6} {:>6} {:>4} {:>9} {:>9} {:>6} {:>5}  {}",
        "surface", "area", "faces", "strike", "dip", "off plane", "rim", "pieces", "holes", "meets"
    )];
    for m in measures.iter().take(MOST) {
        let meets: Vec<String> = m.meets.iter().map(|s| (s + 1).to_string()).collect();
        lines.push(format!(
            "{:>7} {:>11.5} {:>6} {:>6.0} {:>4.0} {:>9.3} {:>9.5} {:>6} {:>5}  {}",
            m.surface + 1,
            Short(m.area),
            m.facets,
            m.strike.unwrap_or(f64::NAN),
            m.dip,
            Short(m.off_plane),
            Short(m.rim),
            m.components,
            m.holes,
            meets.join(" ")
        ));
    }
    if measures.len() > MOST {
        lines.push(format!("... and {} smaller ones", measures.len() - MOST));
    }
    lines.join("\n")
}

/// A number in about as many digits as the precision asks for.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(4) as i32;
        let before = self.0.abs().max(1e-300).log10().floor() as i32 + 1;
        let decimals = (digits - before).clamp(0, 9) as usize;
        f.pad_integral(self.0 >= 0.0, "", &format!("{:.decimals$}", self.0.abs()))
    }
}
