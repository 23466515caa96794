//! Writes a grid for MRST (MATLAB or Octave) as a MAT-file: `G` with its geometry, `rock`, and `T`,
//! the transmissibility of every face.
//!
//! Conventions are MRST's: z is depth; numbers begin with 1, and 0 is outside; normals have the
//! length of the face's area and point from the first neighbour to the second. `G.faces.tagNames`
//! has the name of each `G.faces.tag`, and `G.nodes.sets` the nodes of each name. `G.cells.sites`
//! are the points to which `T` refers. `computeTrans` uses centroids instead, which is wrong for
//! Voronoi cells. `G.cells.active` is 0 for inactive cells, which have no transmissibilities. `W` are the wells, if there are any, with the fields that `addWell` makes.
//! Source: K.-A. Lie, "An Introduction to Reservoir Simulation Using MATLAB/GNU Octave", section
//! 3.4.

use std::path::Path;

use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::mat::{self, MatFields, MatValue};
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::meshers::groups::{FaceGroup, FaceNames, face_nodes};
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::files::Batch;
use crate::files::vtk::VtkScalar;
use crate::mesh::poly::{FIRST_SIDE, Lists};
use crate::model::reservoir::{Control, Model, Permeability, Well};
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "mrst",
    description: "MRST grid as a MAT-file: G, rock, T",
    extensions: &["mat"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: true,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::CutOffs,
        ExportContent::Faults,
        ExportContent::ClosedFaults,
        ExportContent::Wells,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        faces: Naming::Names(mat::FIELD_NAMES),
        properties: Some(mat::FIELD_NAMES),
        wells: Some(NameRules::TEXT),
        ..FormatNames::NONE
    },
    write,
};

/// Converts a point in metres to z downwards.
fn point_with_z_down([x, y, z]: [f64; 3]) -> [f64; 3] {
    [x, y, -z]
}

/// Returns a matrix with one point per row.
fn point_matrix<'a>(count: usize, point: impl Fn(usize) -> [f64; 3] + Sync + 'a) -> MatValue<'a> {
    let value = move |i: usize| point(i % count)[i / count];
    MatValue::Matrix(count, 3, LazyArray::from_fn(3 * count, value))
}

/// Converts numbers that begin with 0 to numbers that begin with 1.
fn one_based(numbers: &[u32]) -> MatValue<'_> {
    MatValue::column(LazyArray::from_fn(numbers.len(), |i| numbers[i] + 1))
}

/// Writes the grid.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if a MAT-file cannot hold the model, and
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let (mesh, cells) = (&model.mesh, model.len());
    let cell_faces = mesh.faces_of_cells();
    let groups = names.faces.groups();
    let set = |group: &'_ FaceGroup| {
        let nodes = face_nodes(model, &group.faces);
        MatValue::column(LazyArray::from_fn(nodes.len(), move |i| nodes[i] + 1))
    };
    let sets = groups.iter().map(|group| (group.name.as_str(), set(group)));
    let node_fields = MatValue::Struct(vec![
        ("num", MatValue::scalar(mesh.nodes.len() as f64)),
        (
            "coords",
            point_matrix(mesh.nodes.len(), |n| point_with_z_down(mesh.nodes[n])),
        ),
        ("sets", MatValue::Struct(sets.collect())),
    ]);
    let texts = ["atomesh", "computeGeometry"].map(MatValue::Text);
    let grid = MatValue::Struct(vec![
        ("cells", MatValue::Struct(cell_fields(model, &cell_faces))),
        ("faces", MatValue::Struct(face_fields(model, &names.faces))),
        ("nodes", node_fields),
        ("griddim", MatValue::scalar(3.0)),
        ("type", MatValue::CellArray(texts.into())),
    ]);
    let mut variables = vec![("G", grid)];
    let mut rock = Vec::new();
    if let Some(porosity) = &model.porosity {
        rock.push(("poro", MatValue::column(LazyArray::from_slice(porosity))));
    }
    if let Some(permeability) = &model.permeability {
        rock.push(("perm", permeability_matrix(permeability, cells)));
        let numbers = face_transmissibility(model, permeability);
        variables.push(("T", MatValue::column(numbers)));
    }
    if !rock.is_empty() {
        variables.push(("rock", MatValue::Struct(rock)));
    }
    if !model.case.wells.is_empty() {
        let wells = model.case.wells.iter().zip(&names.wells);
        let wells = wells.map(|(well, name)| well_fields(model, well, name));
        variables.push(("W", MatValue::StructArray(wells.collect())));
    }
    if !model.properties.is_empty() {
        let field = |p: &'_ crate::files::vtk::DataArray| {
            let (values, width) = (p.values.to_f64(), p.components);
            let value = move |i: usize| values[i % cells * width + i / cells];
            MatValue::Matrix(cells, width, LazyArray::from_fn(cells * width, value))
        };
        let columns = model.properties.iter().zip(&names.properties);
        let fields = columns.map(|(p, name)| (name.as_str(), field(p))).collect();
        variables.push(("properties", MatValue::Struct(fields)));
    }
    mat::check(path, &variables)?;
    batch.write(path, |out| mat::write(out, &variables))
}

/// Returns the fields of the cells; `faces` are those of each cell.
fn cell_fields<'a>(model: &'a Model, faces: &'a Lists) -> MatFields<'a> {
    let (graph, cells) = (&model.graph, model.len());
    vec![
        ("num", MatValue::scalar(cells as f64)),
        ("facePos", one_based(&faces.offsets)),
        ("faces", one_based(&faces.items)),
        (
            "indexMap",
            MatValue::column(LazyArray::from_fn(cells, |c| c as u32 + 1)),
        ),
        (
            "volumes",
            MatValue::column(LazyArray::from_slice(&graph.volume)),
        ),
        (
            "centroids",
            point_matrix(cells, |c| point_with_z_down(graph.centroid[c])),
        ),
        (
            "sites",
            point_matrix(cells, |c| point_with_z_down(graph.site[c])),
        ),
        (
            "region",
            MatValue::column(LazyArray::from_slice(&graph.region)),
        ),
        (
            "active",
            MatValue::column(LazyArray::from_fn(cells, |c| f64::from(model.is_active(c)))),
        ),
    ]
}

/// Returns the fields of the faces.
fn face_fields<'a>(model: &'a Model, names: &'a FaceNames) -> MatFields<'a> {
    let (mesh, graph) = (&model.mesh, &model.graph);
    let (faces, inner) = (mesh.face_cells.len(), mesh.inner_face_count());
    let name_values = names.names.iter().map(|name| MatValue::Text(name));
    let area = move |f: usize| match f.checked_sub(inner) {
        None => (graph.connections[f].area, graph.connections[f].normal),
        Some(outer) => (graph.boundary[outer].area, graph.boundary[outer].normal),
    };
    // The mirrored z axis reverses the orientation of faces, so their nodes are written in reverse
    // order.
    let offsets = &mesh.faces.offsets;
    let nodes = move |range: std::ops::Range<usize>, bytes: &mut Vec<u8>| {
        let mut face = offsets.partition_point(|&o| o as usize <= range.start) - 1;
        for i in range {
            while offsets[face + 1] as usize <= i {
                face += 1;
            }
            let mirrored = (offsets[face] + offsets[face + 1]) as usize - 1 - i;
            (mesh.faces.items[mirrored] + 1).append_bytes(bytes);
        }
    };
    let neighbour = move |i: usize| match mesh.face_cells[i % faces][i / faces] {
        outside if outside >= FIRST_SIDE => 0,
        cell => cell + 1,
    };
    vec![
        ("num", MatValue::scalar(faces as f64)),
        ("nodePos", one_based(&mesh.faces.offsets)),
        (
            "nodes",
            MatValue::column(LazyArray::from_fill::<u32>(mesh.faces.items.len(), nodes)),
        ),
        (
            "neighbors",
            MatValue::Matrix(faces, 2, LazyArray::from_fn(2 * faces, neighbour)),
        ),
        (
            "tag",
            MatValue::column(LazyArray::from_slice(&names.face_numbers)),
        ),
        ("tagNames", MatValue::CellArray(name_values.collect())),
        (
            "areas",
            MatValue::column(LazyArray::from_fn(faces, move |f| area(f).0)),
        ),
        (
            "normals",
            point_matrix(faces, move |f| {
                let (area, normal) = area(f);
                point_with_z_down(normal.map(|n| area * n))
            }),
        ),
        (
            "centroids",
            point_matrix(faces, |f| point_with_z_down(mesh.face_shape(f).centroid)),
        ),
    ]
}

/// Returns the transmissibility of each face; outside of the mesh there is no resistance.
fn face_transmissibility<'a>(model: &'a Model, permeability: &'a Permeability) -> LazyArray<'a> {
    let inner = model.mesh.inner_face_count();
    let transmissibility = move |f: usize| match f.checked_sub(inner) {
        None => permeability.transmissibility[f],
        Some(outer) => {
            let face = &model.graph.boundary[outer];
            let mobility = permeability.rock.mobility(face.cell as usize);
            face.area * mobility.normal_component(face.normal) / face.distance
        }
    };
    LazyArray::from_fn(model.mesh.face_cells.len(), transmissibility)
}

/// Returns the fields that `addWell` makes for a well, in SI units. Rates are positive for
/// injection. Pressures refer to the depth of the first cell.
fn well_fields<'a>(model: &'a Model, well: &'a Well, name: &'a str) -> MatFields<'a> {
    let (kind, value) = match well.control {
        Control::Inject(rate) => ("rate", rate),
        // Formats without schedules have no such wells.
        Control::Scheduled => ("rate", 0.0),
        Control::Pressure(pressure) => ("bhp", pressure),
    };
    let sign = if matches!(well.control, Control::Inject(_)) {
        1.0
    } else {
        -1.0
    };
    let count = well.cells.len();
    let depth = |i: usize| model.depth(well.cells[i].0 as usize);
    let reference = if count > 0 { depth(0) } else { 0.0 };
    let per_cell = |value: fn(&(u32, f64)) -> f64| {
        MatValue::column(LazyArray::from_fn(count, move |i| value(&well.cells[i])))
    };
    vec![
        ("name", MatValue::Text(name)),
        ("cells", per_cell(|c| f64::from(c.0 + 1))),
        ("type", MatValue::Text(kind)),
        ("val", MatValue::scalar(value)),
        ("sign", MatValue::scalar(sign)),
        ("WI", per_cell(|c| c.1)),
        (
            "dZ",
            MatValue::column(LazyArray::from_fn(count, move |i| depth(i) - reference)),
        ),
        ("r", MatValue::scalar(well.radius)),
        ("refDepth", MatValue::scalar(reference)),
        ("compi", MatValue::scalar(1.0)),
        ("status", MatValue::scalar(1.0)),
    ]
}

/// Returns the permeability: one column if the rock is isotropic, three for kx, ky, kz, or all six:
/// xx, xy, xz, yy, yz, zz.
fn permeability_matrix(permeability: &Permeability, cells: usize) -> MatValue<'_> {
    let rock = &permeability.rock;
    let all_cells = |test: fn(&[f64; 6]) -> bool| rock.mobilities.iter().all(|k| test(&k.0));
    let columns: &'static [(usize, f64)] =
        if all_cells(|k| k[0] == k[1] && k[0] == k[2] && k[3..] == [0.0; 3]) {
            &[(0, 1.0)]
        } else if all_cells(|k| k[3..] == [0.0; 3]) {
            &[(0, 1.0), (1, 1.0), (2, 1.0)]
        } else {
            // The sign of z changes.
            &[(0, 1.0), (3, 1.0), (5, -1.0), (1, 1.0), (4, -1.0), (2, 1.0)]
        };
    let value = move |i: usize| {
        let (component, sign) = columns[i / cells];
        sign * rock.mobility(i % cells).0[component]
    };
    let count = columns.len();
    MatValue::Matrix(cells, count, LazyArray::from_fn(cells * count, value))
}
