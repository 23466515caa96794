//! The verb `surface`: faces on features, as labelled surfaces.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::args::{FeatureChoice, InputOptions};
use super::console::Console;
use super::job::{check_output, feature_scale, threshold};
use super::parse;
use crate::export::{MeshFile, SurfaceFile, read_vtu, write_obj, write_tsurf, write_vtp};
use crate::io::vtk::DataArray;
use crate::mesh::{EDGES, TetMesh, norm, sub};
use crate::pipeline::file::Placed;
use crate::surface::facets::{normal, unit};
use crate::surface::measure::Up;
use crate::surface::{Measure, Options, Surfaces, measure, select};
use crate::{Error, Result, error::cause, feature, io};

/// `atomesh surface`.
#[derive(Debug, Args)]
pub struct SurfaceArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// Look for faces on the features of this image, whatever the mesh says of its faces
    #[arg(value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// The surfaces to write: .vtp, .obj, or GOCAD's .ts
    #[arg(short, long, value_name = "S.vtp")]
    pub output: PathBuf,
    /// How surfaces are told apart.
    #[command(flatten)]
    pub grouping: Grouping,
    /// Depth of the valleys of b(x) from which on faces lie on the features of IMAGE, from 0 to 1
    #[arg(long, value_name = "DEPTH", default_value_t = 0.6)]
    pub depth: f64,
    /// The features of IMAGE
    #[arg(long, value_name = "KIND", default_value = "auto")]
    pub feature: FeatureChoice,
    /// Scale of the features in samples [default: by the kind of feature]
    #[arg(long, value_name = "S")]
    pub sigma: Option<f64>,
    /// Least strength of a feature, in units of the feature image [default: automatic, printed]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub threshold: Option<f32>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// What makes faces one surface, and how its orientation is told.
#[derive(Debug, Clone, Args)]
pub struct Grouping {
    /// Largest bend from face to face within a surface, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 25.0)]
    pub max_bend: f64,
    /// Drop surfaces of less area, in square samples [default: ten faces]
    #[arg(long, value_name = "AREA", allow_negative_numbers = true)]
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

/// Faces lie along a feature if their normals differ by less than 35 degrees from its.
const ALONG: f64 = 0.82;

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

/// The faces that the mesh says lie on features.
///
/// # Errors
/// [`Error::Mesh`] if it says nothing, or that none does.
pub fn marked_faces(placed: &Placed, place: &Path) -> Result<Vec<[u32; 3]>> {
    let faces = (placed.feature_faces.as_ref()).map(|bits| select::marked(&placed.lattice, bits));
    let refuse =
        |problem: &str, remedy: &str| Err(Error::Mesh(cause(place.display(), problem, remedy)));
    match faces {
        None => refuse(
            "does not say which faces lie on features (no cell data feature_faces)",
            "give a mesh that atomesh mesh wrote",
        ),
        Some(faces) if faces.is_empty() => refuse(
            "has no face on a feature",
            "mesh the image with features, and with slivers removed",
        ),
        Some(faces) => Ok(faces),
    }
}

/// Groups faces of a mesh, closes gaps, turns all to one side in physical space.
pub fn group(placed: &Placed, faces: Vec<[u32; 3]>, options: &Options, up: &Up<3>) -> Surfaces<3> {
    let candidates = select::spanned(&placed.lattice, &faces);
    let mut surfaces = Surfaces::find(&placed.lattice.nodes, faces, &candidates, options);
    surfaces.orient(&placed.physical.nodes, up.up);
    surfaces
}

/// The faces on the features of the image.
fn faces_on_image(
    args: &SurfaceArgs,
    path: &Path,
    placed: &Placed,
    distance: Option<f64>,
    console: &mut Console,
) -> Result<Vec<[u32; 3]>> {
    let image = io::read(path, &args.input.read_options()?)?.image;
    let place = path.display().to_string();
    image.check(&place)?;
    placed.check_dims(image.dims(), &place)?;
    let options = feature::Options {
        kind: args.feature.into(),
        scale: feature_scale(args.sigma)?,
        threshold: threshold(args.threshold)?,
        d_min: distance.unwrap_or_else(|| mean_edge(&placed.lattice)),
        step: placed.step,
        ..feature::Options::default()
    };
    let features = feature::detect(&image, &options)?;
    features.notes.iter().for_each(|note| console.note(note));
    let (b, sigma) = (&features.potential, features.sigma);
    let faces = select::in_valleys(&placed.lattice, b, sigma, args.depth, ALONG);
    if faces.is_empty() {
        return Err(Error::Mesh(cause(
            args.mesh.display(),
            format!("has no face on a feature of {place}"),
            "give the image that was meshed, or a smaller --depth",
        )));
    }
    Ok(faces)
}

/// The least nominal distance between nodes, if the mesh says so.
fn least_distance(file: &MeshFile) -> Option<f64> {
    let array = file.point_data.iter().find(|a| a.name == "distance")?;
    let least = array
        .values
        .to_f64()
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    (least.is_finite() && least > 0.0).then_some(least)
}

/// Mean length of the edges of a mesh.
fn mean_edge(mesh: &TetMesh) -> f64 {
    let edges = |t: usize| {
        let x = mesh.corners(t);
        EDGES
            .map(|[i, j]| norm(sub(x[i], x[j])))
            .iter()
            .sum::<f64>()
            / 6.0
    };
    (0..mesh.tets.len()).map(edges).sum::<f64>() / mesh.tets.len() as f64
}

/// `atomesh surface`.
pub fn surface(args: &SurfaceArgs, console: &mut Console) -> Result<()> {
    let mut inputs = vec![args.mesh.as_path()];
    inputs.extend(args.image.as_deref());
    check_output(&args.output, "--output", &WRITTEN, &inputs)?;
    if !(args.depth > 0.0 && args.depth < 1.0) {
        let remedy = "give a number above 0 and below 1; 0.6 is usual";
        return Err(parse::bad(
            "--depth",
            &args.depth.to_string(),
            "is out of range",
            remedy,
        ));
    }
    let options = args.grouping.options()?;
    let (up, z_up) = args.grouping.up()?;
    console.begin_stage("reading");
    let file = read_vtu(&args.mesh)?;
    let distance = least_distance(&file);
    let placed = Placed::new(file, &args.mesh.display().to_string())?;
    let faces = match &args.image {
        None => marked_faces(&placed, &args.mesh)?,
        Some(path) => {
            console.begin_stage("finding features");
            faces_on_image(args, path, &placed, distance, console)?
        }
    };
    console.begin_stage("grouping faces");
    let surfaces = group(&placed, faces, &options, &up);
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
