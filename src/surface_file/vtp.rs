//! Writes and reads surfaces as VTK poly data (`.vtp`): triangles, or line segments of a 2-D mesh.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::Path;

use super::SurfaceFile;
use super::sticks::{FaultSticks, Stick};
use crate::Result;
use crate::files::vtk::pieces::{
    FieldValue, check_lengths, read_cell_integers, read_count, read_nodes,
};
use crate::files::vtk::xml::Element;
use crate::files::vtk::{ArraySource, PolyData, VtkFile};
use crate::image::stated::{StatedCoordinates, ZDirection};
use crate::{names, units};

/// Field with the units of x, y and z, with commas between them.
const UNITS_FIELD: &str = "units";

/// Field with the direction in which z grows: `up` or `down`.
const DIRECTION_FIELD: &str = "z_direction";

/// Writes surfaces. The fields `units` and `z_direction` say what the coordinates are. The cell data is the surface number of each facet (`surface`) and the file's
/// own arrays. The names of the surfaces are one text with a line per surface.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written, and [`Error::Mesh`](crate::Error::Mesh) if an array does not
/// have one tuple per facet.
pub fn write_vtp<const D: usize>(path: &Path, file: &SurfaceFile<D>) -> Result<()> {
    let cells = file.facets.len();
    check_lengths(path, &file.cell_data, cells, "facets")?;
    let names = file.names.join("\n");
    let units = file.units.join(",");
    let labels = file.labels();
    let mut fields = vec![ArraySource::text("surfaces", &names)];
    if units.len() > 2 {
        fields.push(ArraySource::text(UNITS_FIELD, &units));
        let direction = if file.z_up { "up" } else { "down" };
        fields.push(ArraySource::text(DIRECTION_FIELD, direction));
    }
    fields.extend((file.field_data.iter()).map(|(name, value)| match value {
        FieldValue::Text(text) => ArraySource::text(name, text),
        FieldValue::F64s(numbers) => ArraySource::slice(name, 1, numbers),
        FieldValue::Ints(numbers) => ArraySource::slice(name, 1, numbers),
    }));
    let mut cell_data = vec![ArraySource::slice("surface", 1, &labels)];
    let arrays = file.cell_data.iter();
    cell_data.extend(arrays.map(|array| array.values.source(&array.name, array.components)));
    let element = if D == 2 { "Lines" } else { "Polys" };
    PolyData {
        fields,
        cell_data: Some(cell_data),
        scalars: Some("surface"),
        corners: Some(file.facets.as_flattened()),
        ..PolyData::new(element, &file.nodes, cells, |i| (D * (i + 1)) as i64)
    }
    .write(path)
}

/// Reads the triangles of a file of this or another program: all of them, or those of the surface
/// with the number `label`. Polygons are cut into fans of triangles.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read, is damaged, or has no surface numbers although
/// `label` is given.
pub fn read_triangles(path: &Path, label: Option<i64>) -> Result<Vec<[[f64; 3]; 3]>> {
    let file = VtkFile::read(path, "PolyData")?;
    let triangles = labelled_triangles(&file, label.is_some())?.into_iter();
    let selected = triangles.filter(|(found, _)| label.is_none_or(|label| *found == label));
    Ok(selected.map(|(_, triangle)| triangle).collect())
}

/// Returns the triangles of a file, each with the number of its surface: those of its polygons, which
/// are cut into fans, and of its strips. The number is 1 if `is_labelled` is `false`.
pub(crate) fn labelled_triangles(
    file: &VtkFile,
    is_labelled: bool,
) -> Result<Vec<(i64, [[f64; 3]; 3])>> {
    let polygons = labelled_rings(file, "Polys", is_labelled)?.into_iter();
    let fan = |(label, ring): (i64, Vec<[f64; 3]>)| {
        let triangle = |k: usize| (label, [ring[0], ring[k - 1], ring[k]]);
        (2..ring.len()).map(triangle).collect::<Vec<_>>()
    };
    let strips = labelled_rings(file, "Strips", is_labelled)?.into_iter();
    let of_strip = |(label, strip): (i64, Vec<[f64; 3]>)| {
        let triangle = |k: usize| match k % 2 {
            0 => (label, [strip[k - 2], strip[k - 1], strip[k]]),
            _ => (label, [strip[k - 1], strip[k - 2], strip[k]]),
        };
        (2..strip.len()).map(triangle).collect::<Vec<_>>()
    };
    Ok(polygons
        .flat_map(fan)
        .chain(strips.flat_map(of_strip))
        .collect())
}

/// Elements of cells, in the order in which they have values.
const CELL_ELEMENTS: [&str; 4] = ["Verts", "Lines", "Polys", "Strips"];

/// Returns the ends of the polygons or lines of an element in their list of points; none if the file
/// does not have the element.
fn cell_ends(file: &VtkFile, element: &str) -> Result<Vec<i64>> {
    match file.piece()?.child(element) {
        Some(cells) if !cells.children.is_empty() => read_cell_integers(file, cells, "offsets"),
        _ => Ok(Vec::new()),
    }
}

/// Returns the points of each polygon or line of a file, with the number of its surface. The number
/// is 1 if `is_labelled` is `false`.
pub(crate) fn labelled_rings(
    file: &VtkFile,
    element: &str,
    is_labelled: bool,
) -> Result<Vec<(i64, Vec<[f64; 3]>)>> {
    let piece = file.piece()?;
    let points = read_count(file, piece, "NumberOfPoints")?;
    let nodes: Vec<[f64; 3]> = read_nodes(file, file.child(piece, "Points")?, points)?;
    let ends = cell_ends(file, element)?;
    if ends.is_empty() {
        return Ok(Vec::new());
    }
    let mut first_cell = 0;
    for before in CELL_ELEMENTS
        .into_iter()
        .take_while(|other| *other != element)
    {
        first_cell += cell_ends(file, before)?.len();
    }
    let cells = file.child(piece, element)?;
    let corners = read_cell_integers(file, cells, "connectivity")?;
    let labels = if is_labelled {
        read_cell_integers(file, file.child(piece, "CellData")?, "surface")?
    } else {
        Vec::new()
    };
    let mut rings = Vec::new();
    let mut start = 0;
    for (i, &end) in ends.iter().enumerate() {
        let ring = usize::try_from(end)
            .ok()
            .and_then(|end| corners.get(start..end));
        let node = |&n: &i64| usize::try_from(n).ok().and_then(|n| nodes.get(n)).copied();
        let ring: Option<Vec<[f64; 3]>> = ring.and_then(|ring| ring.iter().map(node).collect());
        let Some(ring) = ring else {
            let problem = format!("its polygon or line {i} is damaged");
            return Err(file.error(problem, crate::files::REWRITE_DAMAGED));
        };
        start = end as usize;
        let label = if is_labelled {
            labels.get(first_cell + i).copied()
        } else {
            Some(1)
        };
        rings.extend(label.map(|label| (label, ring)));
    }
    Ok(rings)
}

/// Returns `true` if a file has the surface number of each cell.
pub(crate) fn is_numbered(file: &VtkFile) -> Result<bool> {
    let data = file.piece()?.child("CellData");
    let mut arrays = data.iter().flat_map(|data| &data.children);
    Ok(arrays.any(|array| array.attribute("Name") == Some("surface")))
}

/// Returns the names of the surfaces of a file. The first name is that of surface 1.
pub(crate) fn surface_names(file: &VtkFile) -> Vec<String> {
    let names = field_text(file, "surfaces").unwrap_or_default();
    names.lines().map(String::from).collect()
}

/// Returns the text of a field, if the file has it.
fn field_text(file: &VtkFile, name: &str) -> Option<String> {
    let fields = file.data_set().child("FieldData")?;
    let has_name = |array: &&Element| array.attribute("Name") == Some(name);
    let text = file.text(fields.children.iter().find(has_name)?).ok()?;
    Some(text.trim_end_matches('\0').to_string())
}

/// Returns the statements of a file about its coordinates.
fn stated_coordinates(file: &VtkFile) -> StatedCoordinates {
    let mut stated = StatedCoordinates::default();
    let units = field_text(file, UNITS_FIELD).unwrap_or_default();
    for (stated, unit) in stated.units.iter_mut().zip(units.split(',')) {
        *stated = units::find(unit).map(|_| unit.to_string());
    }
    stated.z_direction = match field_text(file, DIRECTION_FIELD).as_deref() {
        Some("up") => Some(ZDirection::Up),
        Some("down") => Some(ZDirection::Down),
        _ => None,
    };
    stated
}

pub(crate) fn surface_name(label: i64, names: &[String]) -> String {
    let index = usize::try_from(label - 1).ok();
    let name = index.and_then(|at| names.get(at).cloned());
    name.unwrap_or_else(|| format!("surface{label}"))
}

/// Reads the lines of a file as fault sticks, with the numbers and names in the file. A file without
/// surface numbers gives one fault with the name of the file.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read or is damaged.
pub fn read_line_sticks(path: &Path) -> Result<Vec<FaultSticks>> {
    let file = VtkFile::read(path, "PolyData")?;
    let (is_labelled, names) = (is_numbered(&file)?, names_of(path, &file)?);
    let stated = stated_coordinates(&file);
    let mut faults: BTreeMap<i64, Vec<Stick>> = BTreeMap::new();
    for (label, points) in labelled_rings(&file, "Lines", is_labelled)? {
        let sticks = faults.entry(label).or_default();
        sticks.push(Stick {
            name: (sticks.len() + 1).to_string(),
            line: None,
            points,
        });
    }
    let fault = |(label, sticks)| FaultSticks {
        name: surface_name(label, &names),
        sticks,
        coordinates: stated.clone(),
    };
    Ok(faults.into_iter().map(fault).collect())
}

/// Returns the names of the surfaces of a file; that of the file if its surfaces have no numbers.
fn names_of(path: &Path, file: &VtkFile) -> Result<Vec<String>> {
    let names = surface_names(file);
    if names.is_empty() && !is_numbered(file)? {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        return Ok(vec![names::from_file(&stem)]);
    }
    Ok(names)
}

/// Reads the surfaces of a file of this or another program, with the numbers and names in the file.
/// A file without surface numbers gives one surface with the name of the file.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be read or is damaged.
pub fn read_surfaces(path: &Path) -> Result<SurfaceFile<3>> {
    let file = VtkFile::read(path, "PolyData")?;
    let (is_labelled, names) = (is_numbered(&file)?, names_of(path, &file)?);
    let stated = stated_coordinates(&file);
    let mut file_surfaces = SurfaceFile {
        surface_starts: vec![0],
        z_up: stated.z_direction != Some(ZDirection::Down),
        units: (stated.units.each_ref()).map(|unit| unit.clone().unwrap_or_default()),
        stated,
        ..SurfaceFile::default()
    };
    let mut triangles_by_label: BTreeMap<i64, Vec<[[f64; 3]; 3]>> = BTreeMap::new();
    for (label, triangle) in labelled_triangles(&file, is_labelled)? {
        triangles_by_label.entry(label).or_default().push(triangle);
    }
    for (label, triangles) in triangles_by_label {
        let mut nodes: Vec<[f64; 3]> = triangles.as_flattened().to_vec();
        nodes.sort_unstable_by(compare_points);
        nodes.dedup();
        let first = file_surfaces.nodes.len();
        let node_index =
            |x: [f64; 3]| (first + nodes.partition_point(|y| compare_points(y, &x).is_lt())) as u32;
        file_surfaces
            .facets
            .extend(triangles.iter().map(|t| t.map(node_index)));
        file_surfaces.nodes.extend(&nodes);
        file_surfaces
            .surface_starts
            .push(file_surfaces.facets.len());
        file_surfaces.names.push(surface_name(label, &names));
    }
    Ok(file_surfaces)
}

fn compare_points(a: &[f64; 3], b: &[f64; 3]) -> Ordering {
    (0..3).fold(Ordering::Equal, |order, k| {
        order.then(a[k].total_cmp(&b[k]))
    })
}
