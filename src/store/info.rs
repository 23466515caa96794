//! Describes the file of an image or of a mesh, as `atomesh info` does.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value, json};

use super::foreign::{MeshFormat, read_any_mesh_with_notes, read_start};
use super::named_sets::{NamedSet, NamedSets};
use super::{FieldValue, MeshFile, Storable, read_labels, with_mesh};
use crate::Result;
use crate::files::vtk::DataArray;
use crate::geometry::bounding_box;
use crate::image::formats::{InputOptions, describe};
use crate::mesh_file::named_surfaces::NamedSurfaces;

/// Largest length of a list that is shown in the text; of a longer one only the length is.
const MAX_LISTED: usize = 64;
/// Number of bytes at the start of a file that tell its format.
const HEAD_BYTES: u64 = 2048;

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
/// Returns the errors of [`describe`] and of [`read_any_mesh`](super::read_any_mesh).
pub fn info(path: &Path, input: &InputOptions) -> Result<FileInfo> {
    if let Some(format) = mesh_format(path) {
        let (mesh, notes) = read_any_mesh_with_notes(path)?;
        return Ok(with_mesh!(mesh, file => describe_mesh(path, format, &file, &notes)));
    }
    let description = describe(path, &input.read_options_for(path)?)?;
    Ok(FileInfo {
        text: description.to_lines().trim_end().to_string(),
        json: serde_json::to_value(&description).unwrap_or_default(),
    })
}

/// Returns the format of a file if it is a mesh. A folder, or what cannot be read, is none.
fn mesh_format(path: &Path) -> Option<MeshFormat> {
    let head = path
        .is_file()
        .then(|| read_start(path, HEAD_BYTES).ok())??;
    MeshFormat::of_mesh(path, &head)
}

fn describe_mesh<const D: usize, M: Storable<D>>(
    path: &Path,
    format: MeshFormat,
    file: &MeshFile<M>,
    notes: &[String],
) -> FileInfo {
    let [low, high] = bounding_box(file.mesh.nodes());
    let names = |arrays: &[DataArray]| -> Vec<String> {
        arrays.iter().map(|array| array.name.clone()).collect()
    };
    let (points, arrays) = (names(&file.point_data), names(&file.cell_data));
    let (nodes, cells, kind) = (file.mesh.nodes().len(), file.mesh.len(), M::CELLS_NAME);
    let regions = region_counts(file);
    let sets = NamedSets::from_file(file);
    let surfaces = NamedSurfaces::from_file(file).names;
    let faces = sets.faces.iter().map(|set| (&set.name, set.faces.len()));
    let of_members = |set: &'_ NamedSet| (set.name.clone(), set.members.len());
    let groups: [(&str, Vec<(String, usize)>); 4] = [
        ("regions", regions),
        ("cell sets", sets.cells.iter().map(of_members).collect()),
        (
            "face sets",
            faces.map(|(name, n)| (name.clone(), n)).collect(),
        ),
        ("node sets", sets.nodes.iter().map(of_members).collect()),
    ];
    let mut lines = vec![
        format!("file        {}", path.display()),
        format!("format      {}", format.name()),
        format!("mesh        {nodes} nodes, {cells} {kind}"),
        format!("from        {low:?}"),
        format!("to          {high:?}"),
        format!("point data  {}", points.join(", ")),
        format!("cell data   {}", arrays.join(", ")),
    ];
    let mut json = json!({
        "file": path.display().to_string(), "format": format.name(), "nodes": nodes,
        kind: cells, "from": low.to_vec(), "to": high.to_vec(), "point_data": points,
        "cell_data": arrays, "surfaces": surfaces, "notes": notes,
    });
    if !surfaces.is_empty() {
        lines.push(format!("surfaces    {}", surfaces.join(", ")));
    }
    for (title, group) in &groups {
        let shown = group.iter().take(MAX_LISTED);
        let mut shown: Vec<String> = shown.map(|(name, n)| format!("{name} ({n})")).collect();
        if group.len() > MAX_LISTED {
            shown.push(format!("and {} more", group.len() - MAX_LISTED));
        }
        if !shown.is_empty() {
            lines.push(format!("{title:<11} {}", shown.join(", ")));
        }
        let entries = group
            .iter()
            .map(|(name, n)| json!({"name": name, "count": n}));
        json[title.replace(' ', "_")] = entries.collect();
    }
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
    lines.extend(notes.iter().map(|note| format!("note: {note}")));
    json["fields"] = fields.into();
    FileInfo {
        text: lines.join("\n"),
        json,
    }
}

/// Returns the name, or the number, and the number of cells of each region; empty if the mesh has no
/// regions.
fn region_counts<const D: usize, M: Storable<D>>(file: &MeshFile<M>) -> Vec<(String, usize)> {
    let labels = read_labels(file);
    let mut counts: BTreeMap<i32, usize> = BTreeMap::new();
    for region in file.mesh.regions(&file.cell_data).unwrap_or_default() {
        *counts.entry(region).or_default() += 1;
    }
    let name = |region: i32| {
        let label = labels.iter().find(|label| label.region == region);
        let name = label.and_then(|label| label.name.clone());
        name.unwrap_or_else(|| region.to_string())
    };
    counts
        .into_iter()
        .map(|(region, n)| (name(region), n))
        .collect()
}
