//! Describes the file of an image or of a mesh, as `atomesh info` does.

use std::io::Read;
use std::path::Path;

use serde_json::{Map, Value, json};

use super::foreign::read_any_mesh;
use super::vtu::{AnyMesh, FieldValue, MeshFile, with_mesh};
use crate::Result;
use crate::files::vtk::DataArray;
use crate::geometry::bounding_box;
use crate::image::formats::{InputOptions, describe};
use crate::mesh::Mesh;

/// Largest length of a list that is shown in the text; of a longer one only the length is.
const MAX_LISTED: usize = 64;

/// The description of a file, as text for people and as JSON for programs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FileInfo {
    /// The description as lines of text.
    pub text: String,
    /// The description as JSON.
    pub json: Value,
}

/// Describes the file of an image or of a mesh, as `atomesh info` does. `input` says how to read an
/// image.
///
/// ```
/// use atomesh::image::formats::{InputOptions, write};
/// use atomesh::image::{Geometry, Image};
///
/// let path = std::env::temp_dir().join("atomesh-info-example.npy");
/// write(&path, &Image::new([3, 4], vec![0.5; 12], Geometry::default()))?;
/// let info = atomesh::info(&path, &InputOptions::default())?;
/// assert_eq!(info.json["image"]["numpy_shape"][0], 4);
/// # std::fs::remove_file(&path).ok();
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// Returns the errors of [`describe`] and of [`read_any_mesh`].
pub fn info(path: &Path, input: &InputOptions) -> Result<FileInfo> {
    if is_unstructured_grid(path) {
        let mesh: AnyMesh = read_any_mesh(path)?;
        return Ok(with_mesh!(mesh, file => describe_mesh(path, &file)));
    }
    let description = describe(path, &input.read_options_for(path)?)?;
    Ok(FileInfo {
        text: description.to_lines().trim_end().to_string(),
        json: serde_json::to_value(&description).unwrap_or_default(),
    })
}

/// Returns `true` if a file looks like a VTK unstructured grid.
fn is_unstructured_grid(path: &Path) -> bool {
    let mut head = Vec::new();
    let Ok(file) = crate::files::open(path, "give a file") else {
        return false;
    };
    let read = file.take(1024).read_to_end(&mut head);
    read.is_ok() && String::from_utf8_lossy(&head).contains("type=\"UnstructuredGrid\"")
}

fn describe_mesh<const D: usize, M: Mesh<D>>(path: &Path, file: &MeshFile<M>) -> FileInfo {
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
    let mut fields = Map::new();
    for (name, value) in &file.field_data {
        let value = match value {
            FieldValue::Text(text) => json!(text),
            FieldValue::F64s(values) => json!(values),
            FieldValue::Ints(values) => json!(values),
        };
        let shown = match &value {
            Value::String(text) => text.trim().replace('\n', ", "),
            Value::Array(list) if list.len() > MAX_LISTED => format!("{} numbers", list.len()),
            other => other.to_string(),
        };
        lines.push(format!("{name}: {shown}"));
        fields.insert(name.clone(), value);
    }
    FileInfo {
        text: lines.join("\n"),
        json: json!({
            "file": path.display().to_string(), "format": "VTK unstructured grid", "nodes": nodes,
            kind: cells, "from": low.to_vec(), "to": high.to_vec(), "point_data": points,
            "cell_data": arrays, "fields": fields,
        }),
    }
}
