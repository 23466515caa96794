//! The verb `slice`: draws pictures of meshes, images, surfaces and lines.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::common::options::with_option_name;
use crate::cli::common::output::{check_output, path_text};
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::error::cause;
use crate::export::surfaces::vtp::read_shapes;
use crate::model::slice::{InputNames, SliceInput, SliceSpec};
use crate::progress::Stage;
use crate::{Error, Result};

/// Arguments of `atomesh slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// The files to draw: the image that was meshed, its mesh (.vtu), surfaces and lines (.vtp).
    /// With --view 3d each of these may be drawn alone
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The picture to write
    #[arg(short, long, value_name = "OUT.png")]
    pub output: PathBuf,
    /// Options of the picture.
    #[command(flatten)]
    pub spec: SliceSpec,
}

/// File endings by which a mesh is recognised if it is the only file.
const MESH_EXTENSIONS: [&str; 5] = ["vtu", "msh", "e", "exo", "ex2"];

/// Classifies the files: surfaces and lines by their ending; of two other files, the first is the
/// image.
fn classify(files: &[PathBuf]) -> Result<InputNames> {
    let has_ending = |path: &Path, endings: &[&str]| {
        let ending = path.extension().and_then(|ending| ending.to_str());
        ending.is_some_and(|ending| endings.iter().any(|e| ending.eq_ignore_ascii_case(e)))
    };
    let files = files.iter().cloned();
    let (shapes, others): (Vec<_>, Vec<_>) = files.partition(|path| has_ending(path, &["vtp"]));
    let (image, mesh) = match &others[..] {
        [] => (None, None),
        [mesh] if has_ending(mesh, &MESH_EXTENSIONS) => (None, Some(mesh.clone())),
        [image] => (Some(image.clone()), None),
        [image, mesh] => (Some(image.clone()), Some(mesh.clone())),
        [.., last] => {
            let problem = "is one file too many: there is an image and a mesh already";
            return Err(Error::Job(cause(last.display(), problem, "omit it")));
        }
    };
    Ok(InputNames {
        image,
        mesh,
        shapes,
    })
}

/// Runs the verb.
pub fn slice(args: &SliceArgs, interrupts: &Interrupts, console: &mut Console) -> Result<()> {
    let spec = &args.spec;
    let inputs: Vec<&Path> = args.files.iter().map(PathBuf::as_path).collect();
    check_output(&args.output, "--output", &["png"], &inputs)?;
    let names = classify(&args.files)?;
    spec.validate(names.image.is_some(), names.mesh.is_some())
        .map_err(with_option_name::<SliceSpec>)?;
    console.begin_stage(Stage::Reading);
    let open = |path: &PathBuf| console.open_image(path, &spec.input);
    let image = names.image.as_ref().map(open).transpose()?;
    let read_mesh = |path: &PathBuf| console.read_mesh(path);
    let mesh = names.mesh.as_ref().map(read_mesh).transpose()?;
    let shapes = names.shapes.iter().map(|path| read_shapes(path));
    let shapes: Vec<_> = shapes.collect::<Result<_>>()?;
    let input = SliceInput {
        image,
        mesh,
        shapes: shapes.concat(),
        names,
    };
    let picture = console.run(interrupts, |_, progress| {
        crate::slice(input, spec, progress).map_err(with_option_name::<SliceSpec>)
    })?;
    picture.write(&args.output)?;
    let [width, height] = picture.size();
    console.result(
        format_args!("wrote {}: {width} x {height} pixels", args.output.display()),
        &json!({ "file": path_text(&args.output), "size": [width, height] }),
    );
    Ok(())
}
