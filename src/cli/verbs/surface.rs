//! The verb `surface`: groups faces on features into labelled surfaces.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::interpretation::{GRID_EXTENSIONS, InterpretationOptions, STICK_EXTENSIONS};
use super::region_interfaces::write_region_interfaces;
use crate::cli::common::depth::mesh_in_depth;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::parse;
use crate::error::cause;
use crate::export::{SurfaceFile, write_obj, write_tsurf, write_vtp};
use crate::feature::{DetectionOptions, FeatureKind};
use crate::files::vtk::DataArray;
use crate::geometry::{normal, unit};
use crate::image::formats::InputOptions;
use crate::image::{Geometry, Image};
use crate::job::MeshSpec;
use crate::job::spec::NumberOrFile;
use crate::mesh::Mesh;
use crate::model::surface::measure::MapAxes;
use crate::model::surface::stored_surfaces::{group_facets, horizon_facets};
use crate::model::surface::{
    Options, SurfaceKind, SurfaceMeasure, Surfaces, facet_selection, measure,
};
use crate::store::{LatticeSpace, MeshFile, Storable, StoredMesh, read_labels, with_mesh};
use crate::{Error, Result, feature};

/// Arguments of `atomesh surface`.
#[derive(Debug, Args)]
pub struct SurfaceArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// An image; faces on its features are used and not those that the mesh declares
    #[arg(value_name = "IMAGE")]
    pub image: Option<PathBuf>,
    /// The file to write: surfaces as .vtp, .obj, or GOCAD's .ts; faults as sticks: .csv; a horizon
    /// as a grid of its heights: .irap, .zmap, .cps3
    #[arg(short, long, value_name = "S.vtp")]
    pub output: PathBuf,
    /// Options that group faces into surfaces.
    #[command(flatten)]
    pub grouping: GroupingOptions,
    /// The criterion by which faces form a surface
    #[arg(long, value_name = "WHAT", default_value = "bends")]
    pub by: GroupBy,
    /// Smallest area of a surface, in square samples (length in 2-D); smaller ones are omitted, and
    /// 0 keeps all [default: ten faces, and 2 % of the largest surface]
    #[arg(long, value_name = "AREA", allow_negative_numbers = true)]
    pub min_area: Option<f64>,
    /// Options for sticks and grids.
    #[command(flatten)]
    pub interpretation: InterpretationOptions,
    /// Show in the table which surfaces meet (--json always does)
    #[arg(long)]
    pub meets: bool,
    /// Depth of the valleys of b(x), from 0 to 1, from which faces count as lying on the features
    /// of IMAGE [default: 0.6]
    #[arg(long, value_name = "DEPTH", requires = "image")]
    pub depth: Option<f64>,
    /// The features to detect in IMAGE [default: auto]
    #[arg(long, value_name = "KIND", requires = "image")]
    pub feature: Option<feature::FeatureKind>,
    /// Scale of the features, in samples [default: depends on the kind of feature]
    #[arg(long, value_name = "S", requires = "image")]
    pub sigma: Option<f64>,
    /// Smallest strength of a feature, in units of the feature image; for an isosurface, its value
    /// [default: automatic; it is printed]
    #[arg(
        long,
        value_name = "T",
        allow_negative_numbers = true,
        requires = "image"
    )]
    pub threshold: Option<f32>,
    /// Convert two-way time to depth in metres, with one velocity in m/s for the whole mesh, or a
    /// file of interval velocities in m/s on a grid in two-way time
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    pub velocity: Option<NumberOrFile>,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// The criterion by which faces form a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum GroupBy {
    /// Faces on features that continue one another: faults, horizons
    Bends,
    /// All faces between the same two regions, or between a region and the sides of the mesh; the
    /// faces of a region enclose it
    Regions,
}

/// Options that group faces into surfaces, and set their orientation.
#[derive(Debug, Clone, Args)]
pub struct GroupingOptions {
    /// Largest bend from face to face within a surface, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = DEFAULT_MAX_BEND)]
    pub max_bend: f64,
    /// The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in
    /// 2-D]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<String>,
}

/// Default of the largest bend from face to face within a surface, in degrees.
const DEFAULT_MAX_BEND: f64 = 25.0;

/// File endings of the surface formats that can be written.
pub const SURFACE_EXTENSIONS: [&str; 3] = ["vtp", "obj", "ts"];

/// Default depth of the valleys of b(x) from which faces count as lying on features.
const DEFAULT_VALLEY_DEPTH: f64 = 0.6;

/// Smallest cosine of the angle between the normals of a face and of its feature (35 degrees).
const MIN_NORMAL_COSINE: f64 = 0.82;

impl GroupingOptions {
    /// Returns the checked options for surfaces of at least `min_area`.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a bend that is not an angle between 0 and 90 degrees, or a
    /// negative area.
    pub fn options(&self, min_area: Option<f64>) -> Result<Options> {
        let refuse = |option: String, remedy: &str| {
            Err(Error::Job(cause(option, "is out of range", remedy)))
        };
        if !(self.max_bend > 0.0 && self.max_bend < 90.0) {
            return refuse(
                format!("--max-bend {}", self.max_bend),
                "give degrees above 0 and below 90; 25 is the default",
            );
        }
        if let Some(area) = min_area.filter(|a| !(a.is_finite() && *a >= 0.0)) {
            return refuse(
                format!("--min-area {area}"),
                "give 0 or more square samples",
            );
        }
        Ok(Options {
            max_bend: self.max_bend,
            min_area,
            ..Options::default()
        })
    }

    /// Returns the directions of up, north and east, and `true` if the axis that is up points in
    /// its positive direction.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for anything but an axis or minus an axis.
    pub fn up_direction<const D: usize>(&self) -> Result<(MapAxes<D>, bool)> {
        let typed = self.up.as_deref().unwrap_or(["x", "y", "z"][D - 1]);
        let (axis, positive) = parse::axis::<D>("--up", typed)?;
        Ok((MapAxes::from_axis(axis, positive), positive))
    }
}

/// Returns the facets that the mesh declares to lie on features.
///
/// # Errors
/// Returns [`Error::Mesh`] if it declares none.
pub fn tagged_facets<const D: usize, M: Storable<D>>(
    stored: &StoredMesh<D, M>,
    place: &Path,
) -> Result<Vec<[u32; D]>> {
    let marks = stored.feature_marks();
    let facets = marks.map(|marks| facet_selection::marked_facets(&stored.lattice, &marks));
    let refuse =
        |problem: &str, remedy: &str| Err(Error::Mesh(cause(place.display(), problem, remedy)));
    match facets {
        None => refuse(
            "does not say which faces lie on features (no cell data feature_faces)",
            "give a mesh that atomesh mesh wrote",
        ),
        Some(facets) if facets.is_empty() => refuse(
            "has no face on a feature",
            "mesh the image with features, and with slivers removed",
        ),
        Some(facets) => Ok(facets),
    }
}

/// Reads the image of a mesh, and checks that it fills the mesh's box.
///
/// # Errors
/// Returns [`Error::Image`] or [`Error::Io`] if it cannot be used.
pub fn read_mesh_image<const D: usize>(
    path: &Path,
    input: &InputOptions,
    space: &LatticeSpace<D>,
    console: &Console,
) -> Result<Image<D>> {
    let place = path.display().to_string();
    let any_image = console.read_image(path, input)?;
    let image = any_image.into_image().ok_or_else(|| {
        let problem = format!("is not a {D}-D image, but the mesh is {D}-D");
        Error::Image(cause(&place, problem, "give the image that was meshed"))
    })?;
    image.check(&place)?;
    space.check_image(&image.geometry, image.dims(), &place)?;
    Ok(image)
}

/// Returns the facets on the features of the image.
fn facets_on_image<const D: usize, M: Mesh<D>>(
    args: &SurfaceArgs,
    path: &Path,
    stored: &StoredMesh<D, M>,
    distance: Option<f64>,
    console: &mut Console,
) -> Result<Vec<[u32; D]>> {
    let image = read_mesh_image(path, &args.input, &stored.space, console)?;
    let d_min = distance.unwrap_or_else(|| mean_spacing(&stored.lattice));
    let spec = MeshSpec {
        feature: args.feature.unwrap_or(FeatureKind::Auto),
        sigma: args.sigma,
        threshold: args.threshold,
        ..MeshSpec::default()
    };
    spec.validate().map_err(with_option_name)?;
    let options = DetectionOptions {
        d_min,
        ..spec.detection_options(stored.space.step)?
    };
    let features = feature::detect(&image, &options)?;
    features.notes.iter().for_each(|note| console.note(note));
    let (b, sigma) = (&features.potential, features.sigma);
    let depth = args.depth.unwrap_or(DEFAULT_VALLEY_DEPTH);
    let facets =
        facet_selection::valley_facets(&stored.lattice, b, sigma, depth, MIN_NORMAL_COSINE);
    if facets.is_empty() {
        return Err(Error::Mesh(cause(
            args.mesh.display(),
            format!("has no face on a feature of {}", path.display()),
            "give the image that was meshed, or a smaller --depth",
        )));
    }
    Ok(facets)
}

/// Returns the smallest nominal distance between nodes, if the mesh records it.
fn min_distance<M>(file: &MeshFile<M>) -> Option<f64> {
    let mut arrays = file.point_data.iter().chain(&file.cell_data);
    let array = arrays.find(|a| a.name == "distance")?;
    let distances = array.values.to_f64().into_iter();
    let min = distances.fold(f64::INFINITY, f64::min);
    (min.is_finite() && min > 0.0).then_some(min)
}

/// Returns the mean spacing of nodes: the D-th root of the volume per node.
fn mean_spacing<const D: usize, M: Mesh<D>>(mesh: &M) -> f64 {
    let volume: f64 = mesh.volumes().iter().sum();
    (volume / mesh.nodes().len() as f64).powf(1.0 / D as f64)
}

/// Runs the verb.
pub fn surface(args: &SurfaceArgs, console: &mut Console) -> Result<()> {
    let mut inputs = vec![args.mesh.as_path()];
    inputs.extend(args.image.as_deref());
    let endings = [&SURFACE_EXTENSIONS[..], &STICK_EXTENSIONS, &GRID_EXTENSIONS].concat();
    check_output(&args.output, "--output", &endings, &inputs)?;
    args.interpretation.refuse_unused(&args.output)?;
    let depth = args.depth.unwrap_or(DEFAULT_VALLEY_DEPTH);
    if args.image.is_none() {
        args.input.refuse_unused("no image is given")?;
    }
    if !(depth > 0.0 && depth < 1.0) {
        let remedy = "give a number above 0 and below 1; 0.6 is the default";
        return Err(parse::option_error(
            "--depth",
            &depth.to_string(),
            "is out of range",
            remedy,
        ));
    }
    console.begin_stage("reading");
    with_mesh!(console.read_mesh(&args.mesh)?, file => extract_surfaces(args, file, console))
}

fn extract_surfaces<const D: usize, M: Storable<D>>(
    args: &SurfaceArgs,
    file: MeshFile<M>,
    console: &mut Console,
) -> Result<()> {
    let options = args.grouping.options(args.min_area)?;
    let (up, z_up) = args.grouping.up_direction::<D>()?;
    let distance = min_distance(&file);
    let labels = read_labels(&file);
    let place = args.mesh.display().to_string();
    let mut stored = mesh_in_depth(file, args.velocity.as_ref(), &place, console)?;
    if args.by == GroupBy::Regions {
        return write_region_interfaces(args, &stored, &labels, z_up, console);
    }
    // All other arrays are no longer needed, except for regions that are labels.
    if labels.is_empty() {
        stored.arrays = MeshFile::default();
    }
    let facets = match &args.image {
        None => tagged_facets(&stored, &args.mesh)?,
        Some(path) => {
            console.begin_stage("finding features");
            facets_on_image(args, path, &stored, distance, console)?
        }
    };
    console.begin_stage("grouping faces");
    let units = &stored.space.geometry.units;
    let up = up.with_units(units);
    if !up.has_dip {
        let is_time = stored.space.geometry.time_coordinate().is_some();
        console.note(mixed_units_note(units, &up, is_time));
    }
    let up = (&up, z_up);
    let target = (args.output.as_path(), &args.interpretation);
    let (surfaces, measures) = write_groups(target, &stored, facets, &options, up, console)?;
    let mut text = table(&measures, D, args.meets);
    if surfaces.dropped_count > 0 {
        text += &format!(
            "\nomitted: {} small surfaces, {:.0} {} in all, {:.1} % of the area; --min-area 0 keeps them",
            surfaces.dropped_count,
            surfaces.dropped_area,
            if D == 2 { "samples" } else { "square samples" },
            100.0 * surfaces.dropped_share(stored.lattice.nodes()),
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
            "file": path_text(&args.output),
            "surfaces": measures,
            "dropped": surfaces.dropped_count,
            "dropped_area": surfaces.dropped_area,
        }),
    );
    Ok(())
}

/// Groups facets of a mesh into surfaces, measures and writes them. `up` is the direction that is
/// up; `z_up` is `true` if z grows upwards.
fn write_groups<const D: usize, M: Storable<D>>(
    (path, interpretation): (&Path, &InterpretationOptions),
    stored: &StoredMesh<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
    (up, z_up): (&MapAxes<D>, bool),
    console: &mut Console,
) -> Result<(Surfaces<D>, Vec<SurfaceMeasure>)> {
    let mut surfaces = group_facets(stored, facets, options);
    let nodes = stored.world.nodes.as_slice();
    surfaces.orient(nodes, up.up);
    let up = &up.with_geometry(&stored.space.geometry);
    let measures = measure(&surfaces, nodes, up, &horizon_facets(stored));
    let mut file = SurfaceFile::new(nodes, &surfaces.facets, &surfaces.start, "surface");
    file.names = measures.iter().map(surface_name).collect();
    file.cell_data = cell_data(&surfaces, &measures, nodes);
    console.begin_stage("writing");
    let geometry = &stored.space.geometry;
    if !interpretation.write(path, &file, geometry, &measures, console)? {
        write_file(path, file, geometry, z_up, console)?;
    }
    Ok((surfaces, measures))
}

/// Writes what `atomesh surface` writes of a mesh with default options, and returns the number of
/// surfaces. A mesh without features has none.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub(super) fn write_tagged_surfaces<const D: usize, M: Storable<D>>(
    path: &Path,
    stored: &StoredMesh<D, M>,
    console: &mut Console,
) -> Result<usize> {
    let grouping = GroupingOptions {
        max_bend: DEFAULT_MAX_BEND,
        up: None,
    };
    let (up, z_up) = grouping.up_direction::<D>()?;
    let up = up.with_units(&stored.space.geometry.units);
    let marks = stored.feature_marks().unwrap_or_default();
    let facets = if marks.is_empty() {
        Vec::new()
    } else {
        facet_selection::marked_facets(&stored.lattice, &marks)
    };
    let options = grouping.options(None)?;
    let target = (path, &InterpretationOptions::default());
    let (surfaces, _) = write_groups(target, stored, facets, &options, (&up, z_up), console)?;
    Ok(surfaces.len())
}

/// Returns the name of a surface in files.
fn surface_name(measure: &SurfaceMeasure) -> String {
    let name = measure.name.clone();
    name.unwrap_or_else(|| format!("{}{}", measure.kind.name(), measure.surface))
}

/// Returns the note that says why dips are missing.
fn mixed_units_note<const D: usize>(units: &[String; D], up: &MapAxes<D>, is_time: bool) -> String {
    let unit_name = |unit: &String| match unit.as_str() {
        "" => "no unit".to_string(),
        unit => unit.to_string(),
    };
    let missing = if up.has_strike {
        "no dip"
    } else {
        "neither dip nor strike"
    };
    format!(
        "axes of different units ({}): {missing}; area, off plane and rim mix them{}",
        units.iter().map(unit_name).collect::<Vec<_>>().join(", "),
        if is_time {
            "; --velocity converts time to depth"
        } else {
            ""
        }
    )
}

/// Writes surfaces in the format of the file's ending.
///
/// # Errors
/// Returns [`Error::Io`] if the file cannot be written.
pub fn write_file<const D: usize>(
    path: &Path,
    mut file: SurfaceFile<D>,
    geometry: &Geometry<D>,
    z_up: bool,
    console: &mut Console,
) -> Result<()> {
    file.units = geometry.to_3d().units;
    file.z_up = z_up;
    let has_ending = |ending: &str| {
        path.extension()
            .is_some_and(|e| e.eq_ignore_ascii_case(ending))
    };
    console.write_surfaces(path, file, |file| {
        if has_ending("obj") {
            write_obj(path, file)
        } else if has_ending("ts") {
            write_tsurf(path, file)
        } else {
            write_vtp(path, file)
        }
    })
}

/// Returns arrays with the normal of each face, and with the measures of the surface that it
/// belongs to.
fn cell_data<const D: usize>(
    surfaces: &Surfaces<D>,
    measures: &[SurfaceMeasure],
    nodes: &[[f64; D]],
) -> Vec<DataArray> {
    let labels = surfaces.labels();
    let per_face = |value: &dyn Fn(&SurfaceMeasure) -> f64| -> Vec<f32> {
        labels
            .iter()
            .map(|&s| value(&measures[s as usize]) as f32)
            .collect()
    };
    let normal = |facet: &[u32; D]| {
        let n = unit(normal(&facet.map(|i| nodes[i as usize])));
        [0, 1, 2].map(|k| n.get(k).copied().unwrap_or(0.0) as f32)
    };
    let horizon = |&s: &u32| u8::from(measures[s as usize].kind == SurfaceKind::Horizon);
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
        DataArray::scalars("dip", per_face(&|m| m.dip.unwrap_or(f64::NAN))),
        DataArray::scalars("strike", per_face(&|m| m.strike.unwrap_or(f64::NAN))),
        DataArray::scalars(
            if D == 2 { "length" } else { "area" },
            per_face(&|m| m.area),
        ),
        DataArray::scalars("horizon", labels.iter().map(horizon).collect::<Vec<u8>>()),
    ]
}

/// Returns a table of the largest surfaces, with the surfaces that they meet if `meets` is set.
fn table(measures: &[SurfaceMeasure], dimension: usize, meets: bool) -> String {
    const MAX_ROWS: usize = 40;
    let [area, rim] = match dimension {
        2 => ["length", "ends"],
        _ => ["area", "rim"],
    };
    let title = |name: &'static str| if meets { name } else { "" };
    let mut lines = vec![format!(
        "{:>7} {:>7} {:>11} {:>6} {:>6} {:>4} {:>9} {:>9} {:>6} {:>5} {:>9}  {}",
        "surface",
        "kind",
        area,
        "faces",
        "strike",
        "dip",
        "off plane",
        rim,
        "pieces",
        "holes",
        "hole area",
        title("meets")
    )];
    // Names that differ from kind and number are shown at the end of the line.
    if measures.iter().any(|m| m.name.is_some()) {
        lines[0] += "  name";
    }
    let angle = |angle: Option<f64>| angle.map_or("-".into(), |angle| format!("{angle:.0}"));
    for m in measures.iter().take(MAX_ROWS) {
        let others = m.adjacent_surfaces.iter().filter(|_| meets);
        let others: Vec<String> = others.map(ToString::to_string).collect();
        lines.push(format!(
            "{:>7} {:>7} {:>11.5} {:>6} {:>6} {:>4} {:>9.3} {:>9.5} {:>6} {:>5} {:>9.3}  {}",
            m.surface,
            m.kind.name(),
            ShortNumber(m.area),
            m.facets,
            angle(m.strike),
            angle(m.dip),
            ShortNumber(m.rms_plane_distance),
            ShortNumber(m.rim),
            m.components,
            m.holes,
            ShortNumber(m.hole_area),
            others.join(" ")
        ));
        if let (Some(name), Some(line)) = (&m.name, lines.last_mut()) {
            *line += &format!("  {name}");
        }
    }
    lines
        .iter_mut()
        .for_each(|line| line.truncate(line.trim_end().len()));
    if measures.len() > MAX_ROWS {
        lines.push(format!(
            "... and {} smaller ones",
            measures.len() - MAX_ROWS
        ));
    }
    lines.join("\n")
}

/// A number that is displayed with about as many digits as the format's precision.
pub(super) struct ShortNumber(pub f64);

impl std::fmt::Display for ShortNumber {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(4) as i32;
        let integer_digits = self.0.abs().clamp(1e-300, 1e300).log10().floor() as i32 + 1;
        let decimals = (digits - integer_digits).clamp(0, 9) as usize;
        f.pad_integral(self.0 >= 0.0, "", &format!("{:.decimals$}", self.0.abs()))
    }
}
