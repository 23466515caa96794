//! The verb `edit`: adds, moves and removes atoms, and meshes only their neighbourhood again.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::depth::image_in_depth;
use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::cli::parse;
use crate::error::{cause, io_error};
use crate::feature;
use crate::image::formats::InputOptions;
use crate::image::formats::{AnyImage, LoadedImage};
use crate::image::{Image, ImageSource};
use crate::job::spec::{CellKind, DistanceSource, NominalDistance};
use crate::job::{MeshSpec, Params};
use crate::mesh::Mesh;
use crate::model::edit::cells::{self, edit_cells};
use crate::model::edit::{
    AtomChange, Edit, EditedMesh, Summary, edit as edit_simplices, editable_mesh,
};
use crate::progress::{Progress, Stage};
use crate::report::{Clock, Report};
use crate::store::output::with_image;
use crate::store::{FieldValue, MeshFile, Storable, with_mesh};
use crate::{Error, Result};

/// Arguments of `atomesh edit`.
#[derive(Debug, Args)]
pub struct EditArgs {
    /// A mesh written by atomesh
    #[arg(value_name = "MESH.vtu")]
    pub mesh: PathBuf,
    /// The image that was meshed
    #[arg(value_name = "IMAGE")]
    pub image: PathBuf,
    /// The edited mesh to write
    #[arg(short, long, value_name = "OUT.vtu")]
    pub output: PathBuf,
    /// A new atom, in the image's physical coordinates (X,Y in 2-D). This and the other edits may
    /// be repeated
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub add: Vec<String>,
    /// Move atom N to X,Y,Z. N is the number of a point of the mesh as ParaView shows it, or of a
    /// cell for Voronoi cells
    #[arg(long = "move", value_name = "N:X,Y,Z", allow_hyphen_values = true)]
    pub moves: Vec<String>,
    /// Remove atom N
    #[arg(long, value_name = "N")]
    pub remove: Vec<String>,
    /// A CSV file of edits, one per line: add,X,Y,Z or move,N,X,Y,Z or remove,N
    #[arg(long, value_name = "FILE.csv")]
    pub edits: Option<PathBuf>,
    /// Let added and moved atoms move like all others. By default they stay in place, as wells do
    #[arg(long)]
    pub free: bool,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

const POINT_REMEDY: &str = "give a point such as 1500,2000,300 (1500,2000 in 2-D)";
const ATOM_REMEDY: &str = "give the number of a point of the mesh, as ParaView shows it";

/// Runs the verb.
pub fn edit(args: &EditArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let mut inputs: Vec<&Path> = vec![&args.mesh, &args.image];
    inputs.extend(args.edits.as_deref());
    check_output(&args.output, "--output", &["vtu"], &inputs)?;
    let mut clock = Clock::new();
    console.begin_stage(Stage::Reading);
    clock.begin(Stage::Reading);
    with_mesh!(console.read_mesh(&args.mesh)?,
        simplices file => {
            let dropped = editable_mesh::dropped_arrays(&file);
            run(args, file, edit_simplices, dropped, clock, interrupts, console)
        },
        cells file => {
            let dropped = cells::dropped_arrays(&file);
            run(args, file, edit_cells, dropped, clock, interrupts, console)
        }
    )
}

/// The function that edits a mesh of one kind of cells.
type EditFn<const D: usize, M> = fn(
    MeshFile<M>,
    &str,
    &Image<D>,
    &Params<D>,
    &[Edit<D>],
    bool,
    &mut dyn Progress,
) -> Result<EditedMesh<M>>;

/// Edits a mesh of any dimension and kind of cells. Arrays in `dropped` are not in the edited mesh.
fn run<const D: usize, M: Storable<D>>(
    args: &EditArgs,
    file: MeshFile<M>,
    edit: EditFn<D, M>,
    dropped: Vec<String>,
    mut clock: Clock,
    interrupts: &Interrupts,
    console: &mut Console,
) -> Result<()> {
    let edits = parse_edits(args)?;
    let (spec, mut notes) = recorded_spec(args, &file)?;
    let Some(LoadedImage { image, .. }) =
        image_of_dimension(console.read_image(&args.image, &spec.input)?)
    else {
        return Err(Error::Job(cause(
            args.image.display(),
            format!("is not a {D}-D image, but the mesh is {D}-D"),
            "give the image that was meshed",
        )));
    };
    image.check(&args.image.display().to_string())?;
    let mut params =
        Params::<D>::read_with(&spec, &console.reader()).map_err(with_option_name::<MeshSpec>)?;
    // An image that is in depth already is not converted.
    let velocity = (spec.velocity.as_ref()).filter(|_| image.geometry.time_coordinate().is_some());
    let labels = params.spec.feature.has_labels();
    let (image, conversion) = image_in_depth(image, velocity, labels, console)?;
    if let Some(conversion) = &conversion {
        params
            .convert_to_depth(conversion)
            .map_err(with_option_name::<MeshSpec>)?;
    }
    let image = if feature::fills_gaps(&image, params.spec.feature, params.modality) {
        (image.mark_dead(!params.spec.input.keeps_nulls())?).map_or(image, |marked| marked.image)
    } else {
        image
    };
    let hash = console.hash(&args.image)?;
    notes.extend(notes_on_input(args, &file, &hash, &dropped));
    clock.end();

    let place = args.mesh.display().to_string();
    let before = file.mesh.len();
    let mut progress = EditProgress {
        console,
        interrupts,
    };
    let edited = edit(
        file,
        &place,
        &image,
        &params,
        &edits,
        args.free,
        &mut progress,
    )?;
    let after = edited.file.mesh.len();
    console.begin_stage(Stage::Writing);
    clock.begin(Stage::Writing);
    let file = with_image(edited.file, ImageSource::InMemory(&image))?;
    console.write_mesh(&args.output, file)?;
    clock.end();

    let mut summary = edited.summary;
    summary.notes.splice(0..0, notes);
    summary
        .stages
        .splice(0..0, clock.costs()[..1].iter().cloned());
    summary.stages.extend_from_slice(&clock.costs()[1..]);
    let mut json = json!({
        "file": path_text(&args.output),
        "edits": edits.iter().map(|edit| &edit.name).collect::<Vec<_>>(),
    });
    if let (Some(object), Ok(serde_json::Value::Object(fields))) =
        (json.as_object_mut(), serde_json::to_value(&summary))
    {
        object.extend(fields);
    }
    let cells = [before, after];
    let table = table::<D, M>(&edits, &summary, cells);
    console.result(
        format_args!("{table}\nwrote {}", args.output.display()),
        &json,
    );
    Ok(())
}

/// Returns notes on another image than the one that was meshed, and on arrays that are dropped.
/// `hash` is that of the image.
fn notes_on_input<M>(
    args: &EditArgs,
    file: &MeshFile<M>,
    hash: &str,
    dropped: &[String],
) -> Vec<String> {
    let mut notes = Vec::new();
    if text_field(file, "input_sha256").is_some_and(|recorded| recorded.trim() != hash) {
        notes.push(format!(
            "{} is not the file that was meshed (its SHA-256 differs)",
            args.image.display()
        ));
    }
    if !dropped.is_empty() {
        notes.push(format!(
            "dropped the arrays {}, which an edit cannot update",
            dropped.join(", ")
        ));
    }
    notes
}

/// Returns the image if it has dimension `D`.
fn image_of_dimension<const D: usize>(image: AnyImage) -> Option<LoadedImage<D>> {
    let image: Box<dyn std::any::Any> = match image {
        AnyImage::Plane(loaded) => Box::new(loaded),
        AnyImage::Space(loaded) => Box::new(loaded),
    };
    image.downcast().ok().map(|loaded| *loaded)
}

/// Returns the field data of this name, if it is a text.
fn text_field<'a, M>(file: &'a MeshFile<M>, name: &str) -> Option<&'a str> {
    let mut fields = file.field_data.iter();
    fields.find_map(|(known, value)| match value {
        FieldValue::Text(text) if known == name => Some(text.as_str()),
        _ => None,
    })
}

/// Returns the options with which the mesh was made, as far as an edit needs them, and notes on
/// steps that an edit does not repeat.
fn recorded_spec<M>(args: &EditArgs, file: &MeshFile<M>) -> Result<(MeshSpec, Vec<String>)> {
    let refuse = |problem: String, remedy| Error::Mesh(cause(args.mesh.display(), problem, remedy));
    let record = text_field(file, "parameters").ok_or_else(|| {
        refuse(
            "does not record how it was made (no field data `parameters`)".into(),
            "give a mesh that atomesh mesh wrote",
        )
    })?;
    // Earlier versions accepted options that had no effect.
    let unknown = |problem: &str| {
        refuse(
            format!("has parameters that this version does not accept: {problem}"),
            "mesh the image again",
        )
    };
    let mut spec: MeshSpec = toml::from_str(record.trim())
        .map_err(|e| unknown(&e.message().replace('\n', ", ")).with_source(e))?;
    let mut notes = Vec::new();
    let mut note = |line: &str| notes.push(line.to_string());
    // The mesh holds its fixed atoms and its distances, while the files may no longer exist.
    // Voronoi cells hold their fixed atoms only after a first edit.
    let needs_files =
        spec.cell_kind() == CellKind::Voronoi && file.cell_array(cells::ATOM_KIND).is_none();
    if !needs_files {
        spec.atoms_from = None;
        spec.well.clear();
        spec.well_distance = None;
    }
    if matches!(spec.distance, NominalDistance::Range { .. }) {
        spec.distance_from = DistanceSource::Features;
    }
    if spec.coarse_to_fine > 0 {
        note(
            "passes on a smoother potential are skipped, as atoms are close to their final positions",
        );
    }
    if spec.smooth.is_some() {
        note("the mesh was smoothed; the edited part is not");
    }
    if spec.slivers.is_exudation() {
        note(
            "slivers were removed by exudation; in the edited part they are removed by flips and smoothing",
        );
    }
    spec.validate().map_err(|e| unknown(&e.to_string()))?;
    spec.input = args.input.with_fallback(&spec.input);
    Ok((spec, notes))
}

/// Returns all edits: `--add`, `--move`, `--remove`, then those of the file.
fn parse_edits<const D: usize>(args: &EditArgs) -> Result<Vec<Edit<D>>> {
    let mut edits = Vec::new();
    for words in &args.add {
        edits.push(Edit {
            name: format!("--add {words}"),
            change: AtomChange::Add(parse::point("--add", words, POINT_REMEDY)?),
        });
    }
    for words in &args.moves {
        let remedy = "give an atom and its new place such as 812:1500,2000,300";
        let Some((node, target)) = words.split_once(':') else {
            return Err(parse::option_error("--move", words, "has no colon", remedy));
        };
        let node = parse_atom("--move", words, node)?;
        edits.push(Edit {
            name: format!("--move {words}"),
            change: AtomChange::Move(node, parse::point("--move", target, POINT_REMEDY)?),
        });
    }
    for words in &args.remove {
        edits.push(Edit {
            name: format!("--remove {words}"),
            change: AtomChange::Remove(parse_atom("--remove", words, words)?),
        });
    }
    if let Some(path) = &args.edits {
        edits.extend(read_edits(path)?);
    }
    if edits.is_empty() {
        return Err(Error::Job(cause(
            "atomesh edit",
            "has nothing to do",
            "give --add, --move, --remove or --edits",
        )));
    }
    Ok(edits)
}

fn parse_atom(option: &str, value: &str, word: &str) -> Result<u32> {
    let atom = word.trim().parse();
    atom.map_err(|_| parse::option_error(option, value, "does not name an atom", ATOM_REMEDY))
}

/// Reads edits from a CSV file. Empty lines and lines that begin with `#` are skipped.
fn read_edits<const D: usize>(path: &Path) -> Result<Vec<Edit<D>>> {
    let text = std::fs::read_to_string(path).map_err(|e| io_error(path, "read", e))?;
    let mut edits = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let place = format!("{}:{number}", path.display());
        let (verb, rest) = line.split_once(',').unwrap_or((line, ""));
        let change = match verb.trim().to_ascii_lowercase().as_str() {
            "add" => AtomChange::Add(parse::point(&place, rest, POINT_REMEDY)?),
            "remove" => AtomChange::Remove(parse_atom(&place, rest, rest)?),
            "move" => {
                let (node, target) = rest.split_once(',').unwrap_or((rest, ""));
                AtomChange::Move(
                    parse_atom(&place, rest, node)?,
                    parse::point(&place, target, POINT_REMEDY)?,
                )
            }
            _ => {
                return Err(Error::Job(cause(
                    place,
                    format!("'{line}' is not an edit"),
                    "write add,X,Y,Z or move,N,X,Y,Z or remove,N",
                )));
            }
        };
        let name = format!("{place}: {line}");
        edits.push(Edit { name, change });
    }
    Ok(edits)
}

/// Returns a table of the edits, the changed parts and their quality.
fn table<const D: usize, M: Mesh<D>>(
    edits: &[Edit<D>],
    summary: &Summary,
    cells: [usize; 2],
) -> String {
    let mut lines = Vec::new();
    let mut line = |name: &str, text: String| lines.push(format!("{name:<12}{text}"));
    for (edit, atom) in edits.iter().zip(&summary.atoms) {
        let state = atom.map_or("gone".into(), |n| format!("atom {n}"));
        line(
            "edit",
            format!("{} is {state}", edit.name.trim_start_matches('-')),
        );
    }
    let kind = M::CELLS_NAME;
    let [before, after] = summary.nodes;
    line(
        "mesh",
        format!(
            "{after} nodes, {} {kind}; before {before} and {}",
            cells[1], cells[0]
        ),
    );
    line(
        "changed",
        format!(
            "{} of {} {kind} rebuilt, around {} movable atoms; {} neighbours removed",
            summary.cells[1], summary.cells[0], summary.movable_atoms, summary.removed_neighbours
        ),
    );
    if let [Some(before), Some(after)] = &summary.quality {
        line(
            "quality",
            format!(
                "in the rebuilt part, angles {:.1} to {:.1}, mean ratio {:.3}; before {:.1} to {:.1}, {:.3}",
                after.smallest_angle.worst,
                after.largest_angle.worst,
                after.mean_ratio_mean,
                before.smallest_angle.worst,
                before.largest_angle.worst,
                before.mean_ratio_mean,
            ),
        );
    }
    line(
        "work",
        format!(
            "features detected in {} samples; {} evaluations of the energy",
            summary.samples, summary.evaluations
        ),
    );
    let report = Report {
        stages: summary.stages.clone(),
        notes: summary.notes.clone(),
        ..Report::default()
    };
    lines.push(report.table().trim_end().to_string());
    lines.join("\n")
}

/// Shows the stages on the console, and stops the edit when the user asks for it.
struct EditProgress<'a> {
    console: &'a mut Console,
    interrupts: &'a Interrupts,
}

impl Progress for EditProgress<'_> {
    fn stage(&mut self, stage: Stage) {
        self.console.begin_stage(stage);
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.console.progress(fraction, "");
    }

    fn keep_going(&mut self) -> bool {
        !self.interrupts.is_requested()
    }
}
