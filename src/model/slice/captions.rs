//! Captions of pictures: the names of their files, and their position.

use std::path::Path;

use super::Caption;
use crate::image::formats::stream::ImageHeader;
use crate::image::geometry::AxisScale;
use crate::mesh::Mesh;
use crate::store::{FieldValue, MeshFile};

/// Returns the title of a picture: the names of its files, and of the image over which they are
/// drawn.
pub(super) fn title(foreground: &[&Path], image: Option<&Path>) -> String {
    let name = |path: &Path| match path.file_name() {
        Some(name) => name.to_string_lossy().into_owned(),
        None => path.display().to_string(),
    };
    let foreground: Vec<String> = foreground.iter().map(|path| name(path)).collect();
    match (foreground.join(", "), image.map(name)) {
        (foreground, None) => foreground,
        (foreground, Some(image)) if foreground.is_empty() => image,
        (foreground, Some(image)) => format!("{foreground} over {image}"),
    }
}

/// Returns the number of cells of a mesh, and the nominal distance of its atoms if it is recorded.
pub(super) fn cells_caption<const D: usize, M: Mesh<D>>(file: &MeshFile<M>) -> String {
    let distance = distance_text(file).map_or(String::new(), |d| format!(", d = {d} samples"));
    format!("{} {}{distance}", file.mesh.len(), M::CELLS_NAME)
}

/// Returns the nominal distance of atoms as it was typed, from the record in the mesh.
fn distance_text<M>(file: &MeshFile<M>) -> Option<String> {
    let Some(FieldValue::Text(text)) = file.field_value("parameters") else {
        return None;
    };
    let table = toml::from_str::<toml::Table>(text.trim_end_matches('\0')).ok()?;
    Some(table.get("distance")?.as_str()?.to_string())
}

/// Returns the scale of an image axis with line numbers: the inlines or crosslines of a survey.
pub(super) fn line_ruler<const D: usize>(head: &ImageHeader<D>, k: usize) -> Option<AxisScale> {
    let [inlines, crosslines] = head.line_numbers?;
    let geometry = &head.geometry;
    let name = &geometry.names[k];
    let lines = match &**name {
        "inline" => inlines,
        "crossline" => crosslines,
        _ => return None,
    };
    let level = geometry.axes[k].iter().position(|&step| step != 0.0)?;
    let unit = &geometry.units[level];
    let spacing = geometry.spacing()[k];
    let name = match lines.step {
        1 => name.clone(),
        step => format!("{name}, step {step}"),
    };
    let label = match &**unit {
        "line" | "trace" => name.clone(),
        unit => {
            // Three significant digits are enough.
            let digits = 2 - spacing.abs().max(1e-9).log10().floor() as i32;
            let scale = 10f64.powi(digits);
            let spacing = (spacing * scale).round() / scale;
            format!("{name} ({} apart)", format!("{spacing} {unit}").trim())
        }
    };
    Some(AxisScale {
        label,
        first: lines.first as f64,
        last: lines.last() as f64,
    })
}

/// Returns the line numbers and the coordinates of the point where the sections of a survey meet.
pub(super) fn crossing_caption(head: &ImageHeader<3>, at: [f64; 3], caption: &Caption) -> String {
    let dims = head.dims;
    let number = |k: usize| {
        let ruler = caption.rulers[k].as_ref()?;
        let fraction = at[k] / (dims[k].max(2) - 1) as f64;
        let line = ruler.first + fraction * (ruler.last - ruler.first);
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
