//! `atomesh slice`: pictures of a mesh over its image.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use crate::cli::common::output::{check_output, shown};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::image::Geometry;
use crate::image::formats::stream::{Head, Opened, Slabs};
use crate::image::formats::{AnyLoaded, InputOptions, Loaded};
use crate::image::geometry::Ruler;
use crate::mesh::Mesh;
use crate::model::slice::{self, Canvas, Caption, Sections, Skeleton};
use crate::store::{AnyMesh, FieldValue, MeshFile, Stored, StoredMesh, in_depth_of};
use crate::{Error, Result};

/// `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// Its mesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// Sections with the planes of samples, or the mesh as a body with a corner open
    #[arg(long, value_name = "VIEW", default_value = "sections")]
    pub view: View,
    /// The point where the planes meet, in physical coordinates [default: the middle]
    #[arg(long, value_name = "X,Y,Z", allow_negative_numbers = true)]
    pub at: Option<String>,
    /// How to read the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum View {
    /// In 2-D the whole mesh, in 3-D its sections with three planes
    Sections,
    /// The mesh as a body with a corner open (3-D)
    #[value(name = "3d")]
    Solid,
}

/// Runs the verb.
pub fn slice(args: &SliceArgs, console: &mut Console) -> Result<()> {
    check_output(
        &args.output,
        "--output",
        &["png"],
        &[&args.image, &args.mesh],
    )?;
    let at = args
        .at
        .as_deref()
        .map(|text| parse::point("--at", text, "give a point such as 1500,2000,300"))
        .transpose()?;
    console.begin_stage("reading");
    let image = match console.open_image(&args.image, &args.input)? {
        // Painted at any point, not only on planes.
        Opened::Stream(stream) if args.view == View::Solid => {
            Opened::Held(Opened::Stream(stream).load(&args.image)?)
        }
        other => other,
    };
    let mesh = console.read_mesh(&args.mesh)?;
    console.begin_stage("drawing");
    let other = |mesh: u8, image: u8| {
        let problem = format!("is a {mesh}-D mesh, but the image is {image}-D");
        refuse(&args.mesh, &problem, "give the mesh of the image")
    };
    let picture = match (image, mesh) {
        (Opened::Held(AnyLoaded::Plane(_)), _) if args.view == View::Solid => {
            let problem = "shows meshes in space, but the image is 2-D";
            return Err(Error::Job(cause("--view 3d", problem, "omit it")));
        }
        (Opened::Held(AnyLoaded::Plane(loaded)), mesh) => match mesh {
            AnyMesh::Plane(file) => plane(args, loaded, &file)?,
            AnyMesh::PlaneCells(file) => plane(args, loaded, &file)?,
            _ => return Err(other(3, 2)),
        },
        (image, AnyMesh::Space(file)) => space(args, image, file, at)?,
        (image, AnyMesh::SpaceCells(file)) => space(args, image, file, at)?,
        _ => return Err(other(2, 3)),
    };
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": shown(&args.output), "size": [width, height] }),
    );
    Ok(())
}

fn refuse(place: &Path, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(place.display(), problem, remedy))
}

/// The image in depth, if its mesh is.
fn below<const D: usize, M: Mesh<D>>(mut loaded: Loaded<D>, file: &MeshFile<M>) -> Loaded<D> {
    let image = &mut loaded.image;
    if let Some(geometry) = in_depth_of(file, &image.geometry, image.dims()) {
        image.geometry = geometry;
    }
    loaded
}

fn plane<M: Stored<2>>(args: &SliceArgs, loaded: Loaded<2>, file: &MeshFile<M>) -> Result<Canvas> {
    let loaded = &below(loaded, file);
    let image = &loaded.image;
    let skeleton = skeleton(args, file, &image.geometry)?;
    slice::plane(image, &skeleton, &caption(args, file, &loaded.head()))
}

fn space<M: Stored<3>>(
    args: &SliceArgs,
    image: Opened,
    file: MeshFile<M>,
    at: Option<[f64; 3]>,
) -> Result<Canvas> {
    let image = match image {
        Opened::Held(AnyLoaded::Space(loaded)) => {
            Opened::Held(AnyLoaded::Space(below(loaded, &file)))
        }
        other => other,
    };
    let (head, slabs): (Head<3>, &dyn Slabs) = match &image {
        Opened::Stream(stream) => {
            let mut head = stream.head.clone();
            if let Some(geometry) = in_depth_of(&file, &head.geometry, head.dims) {
                head.geometry = geometry;
            }
            (head, stream)
        }
        Opened::Held(AnyLoaded::Space(loaded)) => (loaded.head(), &loaded.image),
        Opened::Held(AnyLoaded::Plane(_)) => return Err(flat(args)),
    };
    let at = match at {
        Some(at) => head.geometry.to_index(at).ok_or_else(|| flat(args))?,
        None => head.dims.map(|n| (n / 2) as f64),
    };
    let mut caption = caption(args, &file, &head);
    match (args.view, &image) {
        (View::Solid, Opened::Held(AnyLoaded::Space(loaded))) => {
            let stored = StoredMesh::new(file, &args.mesh.display().to_string())?;
            let place = args.image.display().to_string();
            stored.space.check_dims(head.dims, &place)?;
            slice::solid(&loaded.image, &stored, at, &caption)
        }
        _ => {
            caption.subtitle += &met(&head, at, &caption);
            let skeleton = skeleton(args, &file, &head.geometry)?;
            let sections = Sections::of(&args.image, head.dims, slabs, at)?;
            slice::space(&sections, &head.geometry, &skeleton, &caption)
        }
    }
}

fn skeleton<const D: usize, M: Stored<D>>(
    args: &SliceArgs,
    file: &MeshFile<M>,
    geometry: &Geometry<D>,
) -> Result<Skeleton<D>> {
    Skeleton::new(file, geometry).ok_or_else(|| flat(args))
}

fn flat(args: &SliceArgs) -> Error {
    let problem = "the image's axes are linearly dependent";
    refuse(&args.mesh, problem, "correct its geometry")
}

/// The files, how many cells there are, and how far apart atoms were asked to be.
fn caption<const D: usize, M: Mesh<D>>(
    args: &SliceArgs,
    file: &MeshFile<M>,
    head: &Head<D>,
) -> Caption {
    let name = |path: &Path| match path.file_name() {
        Some(name) => name.to_string_lossy().into_owned(),
        None => shown(path),
    };
    let distance = match file.field("parameters") {
        Some(FieldValue::Text(text)) => toml::from_str::<toml::Table>(text.trim_end_matches('\0'))
            .ok()
            .and_then(|table| Some(table.get("distance")?.as_str()?.to_string())),
        _ => None,
    };
    let distance = distance.map_or(String::new(), |d| format!(", d = {d} samples"));
    Caption {
        title: format!("{} over {}", name(&args.mesh), name(&args.image)),
        subtitle: format!("{} {}{distance}", file.mesh.len(), M::CELLS),
        values: String::new(),
        rulers: std::array::from_fn(|k| (k < D).then(|| lines(head, k)).flatten()),
    }
}

/// An image axis that is read off by line numbers: of a survey's inlines or crosslines.
fn lines<const D: usize>(head: &Head<D>, k: usize) -> Option<Ruler> {
    let [inlines, crosslines] = head.lines?;
    let geometry = &head.geometry;
    let name = &geometry.names[k];
    let lines = match &**name {
        "inline" => inlines,
        "crossline" => crosslines,
        _ => return None,
    };
    let level = geometry.axes[k].iter().position(|&step| step != 0.0)?;
    let unit = &geometry.units[level];
    let apart = geometry.spacing()[k] / lines.step as f64;
    let label = match &**unit {
        "line" | "trace" => name.clone(),
        unit => {
            // Three digits are enough.
            let digits = 2 - apart.abs().max(1e-9).log10().floor() as i32;
            let ten = 10f64.powi(digits);
            let apart = (apart * ten).round() / ten;
            format!("{name} ({} apart)", format!("{apart} {unit}").trim())
        }
    };
    Some(Ruler {
        label,
        first: lines.first as f64,
        last: lines.last() as f64,
    })
}

/// Where the sections of a survey meet: lines, and coordinates.
fn met(head: &Head<3>, at: [f64; 3], caption: &Caption) -> String {
    let dims = head.dims;
    let number = |k: usize| {
        let ruler = caption.rulers[k].as_ref()?;
        let share = at[k] / (dims[k].max(2) - 1) as f64;
        let line = ruler.first + share * (ruler.last - ruler.first);
        Some(format!("{} {line:.0}", head.geometry.names[k]))
    };
    let lines: Vec<String> = (0..3).rev().filter_map(number).collect();
    if lines.is_empty() {
        return String::new();
    }
    let [x, y, z] = head.geometry.to_physical(at);
    let units = &head.geometry.units;
    format!(
        "; at {}: x {x:.0} {}, y {y:.0} {}, z {z:.0} {}",
        lines.join(", "),
        units[0],
        units[1],
        units[2]
    )
}
