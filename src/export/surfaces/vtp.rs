//! Surfaces as VTK poly data (`.vtp`): triangles, or line segments of a 2-D mesh; triangles back in.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::Path;

use crate::export::surfaces::file::SurfaceFile;
use crate::files::atomic_write;
use crate::files::vtk::xml::Element;
use crate::files::vtk::{ArraySource, Document, VtkFile};
use crate::model::slice::OverlayShape;
use crate::model::surface::SurfaceKind;
use crate::store::vtu::{self, FieldValue, check_lengths, read_cell_integers, read_nodes};
use crate::{Error, Result};

/// Writes surfaces with the number of each facet's surface (`surface`), the numbers of the file's
/// table of surfaces as cell data, and names as one text, a line a surface.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Mesh`]
/// if an array does not have a tuple per facet.
pub fn write_vtp<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let (points, cells) = (file.nodes.len(), file.facets.len());
    check_lengths(path, &file.cell_data, cells, "facets")?;
    let names = file.names.join("\n");
    let labels = file.labels();
    let mut document = Document::new("PolyData", &[]);
    document.open("FieldData", &[]);
    document.add_array(ArraySource::text("surfaces", &names));
    for (name, value) in &file.field_data {
        document.add_array(match value {
            FieldValue::Text(text) => ArraySource::text(name, text),
            FieldValue::F64s(numbers) => ArraySource::slice(name, 1, numbers),
            FieldValue::Ints(numbers) => ArraySource::slice(name, 1, numbers),
        });
    }
    document.close();
    let shape = if D == 2 { "Lines" } else { "Polys" };
    let count = |of: &str| if of == shape { cells } else { 0 };
    let counts = ["Verts", "Lines", "Strips", "Polys"]
        .map(|of| (format!("NumberOf{of}"), count(of).to_string()));
    let mut attributes = vec![("NumberOfPoints", points.to_string())];
    attributes.extend(counts.iter().map(|(name, n)| (name.as_str(), n.clone())));
    document.open("Piece", &attributes);
    document.open("CellData", &[("Scalars", "surface".to_string())]);
    document.add_array(ArraySource::slice("surface", 1, &labels));
    for array in &file.cell_data {
        document.add_array(array.values.source(&array.name, array.components));
    }
    document.close();
    document.open("Points", &[]);
    document.add_array(ArraySource::slice("Points", 3, file.nodes.as_flattened()));
    document.close();
    document.open(shape, &[]);
    let corners = file.facets.as_flattened();
    document.add_array(ArraySource::computed(
        "connectivity",
        1,
        corners.len(),
        |i| i64::from(corners[i]),
    ));
    document.add_array(ArraySource::computed("offsets", 1, cells, |i| {
        (D * (i + 1)) as i64
    }));
    document.close();
    atomic_write(path, |out| document.write(out))
}

/// The triangles of a file, ours or VTK's (polygons are cut into fans): all, or those of the surface
/// of that number.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, is damaged, or does not number its
/// surfaces though a number is given.
pub fn read_triangles(path: &Path, number: Option<i64>) -> Result<Vec<[[f64; 3]; 3]>> {
    let file = VtkFile::read(path, "PolyData")?;
    let found = labelled_triangles(&file, number.is_some())?.into_iter();
    let wanted = found.filter(|(label, _)| number.is_none_or(|number| *label == number));
    Ok(wanted.map(|(_, triangle)| triangle).collect())
}

/// The triangles of a file, each with the number of its surface; with 1 unless it is `numbered`.
fn labelled_triangles(file: &VtkFile, numbered: bool) -> Result<Vec<(i64, [[f64; 3]; 3])>> {
    let polygons = labelled_rings(file, "Polys", numbered)?.into_iter();
    let fan = |(label, ring): (i64, Vec<[f64; 3]>)| {
        let triangle = |k: usize| (label, [ring[0], ring[k - 1], ring[k]]);
        (2..ring.len()).map(triangle).collect::<Vec<_>>()
    };
    Ok(polygons.flat_map(fan).collect())
}

/// The points of each polygon or line of a file, with the number of the surface to which it belongs, likewise.
fn labelled_rings(
    file: &VtkFile,
    element: &str,
    numbered: bool,
) -> Result<Vec<(i64, Vec<[f64; 3]>)>> {
    let piece = file.piece()?;
    let points = vtu::read_count(file, piece, "NumberOfPoints")?;
    let nodes: Vec<[f64; 3]> = read_nodes(file, file.child(piece, "Points")?, points)?;
    let element = file.child(piece, element)?;
    let corners = read_cell_integers(file, element, "connectivity")?;
    let ends = read_cell_integers(file, element, "offsets")?;
    let labels = match numbered {
        false => Vec::new(),
        true => read_cell_integers(file, file.child(piece, "CellData")?, "surface")?,
    };
    let mut found = Vec::new();
    let mut start = 0;
    for (i, &end) in ends.iter().enumerate() {
        let ring = usize::try_from(end)
            .ok()
            .and_then(|end| corners.get(start..end));
        let node = |&n: &i64| usize::try_from(n).ok().and_then(|n| nodes.get(n)).copied();
        let ring: Option<Vec<[f64; 3]>> = ring.and_then(|ring| ring.iter().map(node).collect());
        let Some(ring) = ring else {
            let problem = format!("its polygon or line {i} is damaged");
            return Err(file.error(problem, "write it again"));
        };
        start = end as usize;
        let label = match numbered {
            false => Some(1),
            true => labels.get(i).copied(),
        };
        found.extend(label.map(|label| (label, ring)));
    }
    Ok(found)
}

/// The surfaces and lines of a file as they are drawn, by the numbers and names that it gives them; without
/// numbers they are one, of the file's name.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, is damaged, or holds neither.
pub fn read_shapes(path: &Path) -> Result<Vec<OverlayShape>> {
    let file = VtkFile::read(path, "PolyData")?;
    let (numbered, names) = (is_numbered(&file)?, surface_names(&file));
    let holds = |element: &str| Ok::<_, Error>(file.piece()?.child(element).is_some());
    let mut shapes: BTreeMap<i64, OverlayShape> = BTreeMap::new();
    if holds("Polys")? {
        for (label, triangle) in labelled_triangles(&file, numbered)? {
            shapes.entry(label).or_default().triangles.push(triangle);
        }
    }
    if holds("Lines")? {
        // Numbers are those of polygons, if there are any.
        for (label, line) in labelled_rings(&file, "Lines", numbered && shapes.is_empty())? {
            shapes.entry(label).or_default().lines.push(line);
        }
    }
    if shapes.is_empty() {
        return Err(file.error("holds neither polygons nor lines", "leave it out"));
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for (label, shape) in &mut shapes {
        shape.name = match numbered {
            true => surface_name(*label, &names),
            false => stem.to_string(),
        };
        let kinds = [SurfaceKind::Fault, SurfaceKind::Horizon].into_iter();
        let mut named = kinds.filter(|kind| numbered && shape.name.starts_with(kind.name()));
        shape.kind = named.next();
    }
    Ok(shapes.into_values().collect())
}

/// Whether a file says to which surface each of its cells belongs.
fn is_numbered(file: &VtkFile) -> Result<bool> {
    let data = file.piece()?.child("CellData");
    let mut arrays = data.iter().flat_map(|data| &data.children);
    Ok(arrays.any(|array| array.attribute("Name") == Some("surface")))
}

/// The names of a file's surfaces, from number 1 on.
fn surface_names(file: &VtkFile) -> Vec<String> {
    let names = file.data_set().child("FieldData").and_then(|fields| {
        let named = |array: &&Element| array.attribute("Name") == Some("surfaces");
        file.text(fields.children.iter().find(named)?).ok()
    });
    let names = names.unwrap_or_default();
    let lines = names.trim_end_matches('\0').lines();
    lines.map(String::from).collect()
}

fn surface_name(label: i64, names: &[String]) -> String {
    let at = usize::try_from(label - 1).ok();
    let name = at.and_then(|at| names.get(at).cloned());
    name.unwrap_or_else(|| format!("surface{label}"))
}

/// The surfaces of a file, ours or VTK's, by the numbers and names that it gives them; without numbers
/// they are one.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or is damaged.
pub fn read_surfaces(path: &Path) -> Result<SurfaceFile<3>> {
    let file = VtkFile::read(path, "PolyData")?;
    let (numbered, names) = (is_numbered(&file)?, surface_names(&file));
    let mut found = SurfaceFile {
        surface_starts: vec![0],
        z_up: true,
        ..SurfaceFile::default()
    };
    let mut by_label: BTreeMap<i64, Vec<[[f64; 3]; 3]>> = BTreeMap::new();
    for (label, triangle) in labelled_triangles(&file, numbered)? {
        by_label.entry(label).or_default().push(triangle);
    }
    for (label, triangles) in by_label {
        let mut nodes: Vec<[f64; 3]> = triangles.as_flattened().to_vec();
        nodes.sort_unstable_by(compare_points);
        nodes.dedup();
        let first = found.nodes.len();
        let place =
            |x: [f64; 3]| (first + nodes.partition_point(|y| compare_points(y, &x).is_lt())) as u32;
        found.facets.extend(triangles.iter().map(|t| t.map(place)));
        found.nodes.extend(&nodes);
        found.surface_starts.push(found.facets.len());
        found.names.push(surface_name(label, &names));
    }
    Ok(found)
}

fn compare_points(a: &[f64; 3], b: &[f64; 3]) -> Ordering {
    (0..3).fold(Ordering::Equal, |found, k| {
        found.then(a[k].total_cmp(&b[k]))
    })
}
