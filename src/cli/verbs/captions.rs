//! What is written over pictures: of which files they are, and where they lie.

use std::path::Path;

use crate::cli::common::output::path_text;
use crate::image::formats::stream::ImageHeader;
use crate::image::geometry::AxisScale;
use crate::mesh::Mesh;
use crate::model::slice::Caption;
use crate::store::{FieldValue, MeshFile};

/// The names of files, and of the image that they are drawn over.
pub(super) fn title(above: &[&Path], image: Option<&Path>) -> String {
    let name = |path: &Path| match path.file_name() {
        Some(name) => name.to_string_lossy().into_owned(),
        None => path_text(path),
    };
    let above: Vec<String> = above.iter().map(|path| name(path)).collect();
    match (above.join(", "), image.map(name)) {
        (above, None) => above,
        (above, Some(image)) if above.is_empty() => image,
        (above, Some(image)) => format!("{above} over {image}"),
    }
}

/// How many cells a mesh has, and how far apart atoms were asked to be.
pub(super) fn cells_caption<const D: usize, M: Mesh<D>>(file: &MeshFile<M>) -> String {
    let distance = distance_text(file).map_or(String::new(), |d| format!(", d = {d} samples"));
    format!("{} {}{distance}", file.mesh.len(), M::CELLS_NAME)
}

/// The distance of atoms that was asked for, as it was typed.
fn distance_text<M>(file: &MeshFile<M>) -> Option<String> {
    let Some(FieldValue::Text(text)) = file.field_value("parameters") else {
        return None;
    };
    let table = toml::from_str::<toml::Table>(text.trim_end_matches('\0')).ok()?;
    Some(table.get("distance")?.as_str()?.to_string())
}

/// An image axis that is read off by line numbers: of a survey's inlines or crosslines.
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
    Some(AxisScale {
        label,
        first: lines.first as f64,
        last: lines.last() as f64,
    })
}

/// Where the sections of a survey meet: lines, and coordinates.
pub(super) fn crossing_caption(head: &ImageHeader<3>, at: [f64; 3], caption: &Caption) -> String {
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
