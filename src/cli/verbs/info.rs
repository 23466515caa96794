//! The verb `info`: describes an image file or a mesh file.

use std::io::Read;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::Result;
use crate::cli::common::options::read_options;
use crate::cli::console::Console;
use crate::files::vtk::DataArray;
use crate::geometry::bounding_box;
use crate::image::formats;
use crate::image::formats::InputOptions;
use crate::mesh::Mesh;
use crate::store::{FieldValue, MeshFile, with_mesh};

/// Arguments of `atomesh info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// An image or a mesh
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Options for reading the image.
    #[command(flatten, next_help_heading = "Reading the image")]
    pub input: InputOptions,
}

/// Largest length of a list that is printed; of a longer one only the length is.
const MAX_LISTED: usize = 64;

/// Runs the verb for an image or a mesh.
pub fn info(args: &InfoArgs, console: &mut Console) -> Result<()> {
    if is_mesh(&args.file) {
        return mesh_info(&args.file, console);
    }
    let description = formats::describe(&args.file, &read_options(&args.input, &args.file)?)?;
    let value = serde_json::to_value(&description).unwrap_or_default();
    console.result(description.to_lines().trim_end(), &value);
    Ok(())
}

/// Returns `true` if a file looks like a VTK unstructured grid.
fn is_mesh(path: &Path) -> bool {
    let mut head = Vec::new();
    let Ok(file) = crate::files::open(path, "give a file") else {
        return false;
    };
    let read = file.take(1024).read_to_end(&mut head);
    read.is_ok() && String::from_utf8_lossy(&head).contains("type=\"UnstructuredGrid\"")
}

/// Reads and describes a mesh.
fn mesh_info(path: &Path, console: &mut Console) -> Result<()> {
    with_mesh!(console.read_mesh(path)?, file => describe(path, &file, console));
    Ok(())
}

fn describe<const D: usize, M: Mesh<D>>(path: &Path, file: &MeshFile<M>, console: &mut Console) {
    let [low, high] = bounding_box(file.mesh.nodes());
    let names = |arrays: &[DataArray]| -> Vec<String> {
        arrays.iter().map(|array| array.name.clone()).collect()
    };
    let (points, arrays) = (names(&file.point_data), names(&file.cell_data));
    let (nodes, cells, kind) = (file.mesh.nodes().len(), file.mesh.len(), M::CELLS_NAME);
    let mut lines = vec![
        format!("file        {}", path.display()),
        "format      VTK unstructured grid".to_string(),
        format!("mesh        {nodes} nodes, {cells} {kind}"),
        format!("from        {low:?}"),
        format!("to          {high:?}"),
        format!("point data  {}", points.join(", ")),
        format!("cell data   {}", arrays.join(", ")),
    ];
    let mut fields = serde_json::Map::new();
    for (name, value) in &file.field_data {
        let value = match value {
            FieldValue::Text(text) => json!(text),
            FieldValue::F64s(values) => json!(values),
            FieldValue::Ints(values) => json!(values),
        };
        let shown = match &value {
            serde_json::Value::String(text) => text.trim().replace('\n', ", "),
            serde_json::Value::Array(list) if list.len() > MAX_LISTED => {
                format!("{} numbers", list.len())
            }
            other => other.to_string(),
        };
        lines.push(format!("{name}: {shown}"));
        fields.insert(name.clone(), value);
    }
    console.result(
        lines.join("\n"),
        &json!({
            "file": path, "format": "VTK unstructured grid", "nodes": nodes, kind: cells,
            "from": low.to_vec(), "to": high.to_vec(), "point_data": points, "cell_data": arrays,
            "fields": fields,
        }),
    );
}
