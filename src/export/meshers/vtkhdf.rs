//! Writes VTKHDF: cells of any shape with their values in one HDF5 file. Each name is a node array,
//! which is 1 for the nodes on the named faces. Tetrahedra and triangles are in version 1.0 of the
//! format, polyhedra in version 2.5.
//!
//! If the mesh is split along surfaces, it has also wedges without thickness, without values, and in
//! a region of their own: 0, or the smallest number above it that no cell has.

use std::path::Path;

use super::NAMES_AND_ROCK;
use super::groups::{face_nodes, sorted_regions};
use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::hdf5::{self, Hdf5Attribute, Hdf5Node};
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::export::values::cell_arrays;
use crate::files::Batch;
use crate::files::vtk::DataArray;
use crate::mesh::poly::Lists;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "vtkhdf",
    description: "VTKHDF: any cells with their values and sets of nodes",
    extensions: &["vtkhdf"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: NAMES_AND_ROCK,
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        faces: Naming::Names(LINK_NAMES),
        faces_overlap: true,
        node_set_prefix: Some(""),
        properties: Some(LINK_NAMES),
        ..FormatNames::NONE
    },
    write,
};

/// Rules of HDF5 for the names of datasets.
const LINK_NAMES: NameRules = NameRules {
    max_bytes: 255,
    distinct_bytes: 255,
    is_allowed: |c| !c.is_control() && c != '/',
    is_allowed_first: |c| !c.is_control() && !['/', '.'].contains(&c),
    ..NameRules::TEXT
};
/// Programs that read polyhedra of this version of the format.
pub const READERS_OF_POLYHEDRA: &str =
    "VTK 9.6 or later, in ParaView 6.1 or PyVista (older versions crash)";
/// Programs that read tetrahedra and triangles of this version of the format.
pub const READERS_OF_SIMPLICES: &str = "VTK 9.2 or later, in ParaView 5.11 or PyVista";
/// VTK cell types of linear and of quadratic simplices, by their number of corners.
const SIMPLEX_TYPES: [[u8; 2]; 5] = [[0, 0], [0, 0], [0, 0], [5, 22], [10, 24]];
const WEDGE_TYPE: u8 = 13;
const POLYHEDRON_TYPE: u8 = 42;

/// Named nodes of an HDF5 file.
type NamedNodes<'a> = Vec<(String, Hdf5Node<'a>)>;

/// Writes the mesh.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let simplices = if model.tets.is_some() || model.triangles.is_some() {
        Some(SimplexMesh::new(model, names, "VTKHDF")?)
    } else {
        None
    };
    let arrays = cell_arrays(model, &names.properties);
    let faces = model.mesh.faces_of_cells();
    let (mut nodes, cells, sets) = match &simplices {
        Some(mesh) => simplex_grid(mesh),
        None => polyhedron_grid(model, names, &faces),
    };
    let regions = sorted_regions(model);
    let is_free = |number: &i32| regions.binary_search(number).is_err();
    let wedge_region = (0..).find(is_free).map_or(0.0, f64::from);
    let cell_array = |array: &DataArray| {
        let mut values = array.values.to_f64();
        let fill_value = if array.name == "region" {
            wedge_region
        } else {
            f64::NAN
        };
        values.resize(cells * array.components, fill_value);
        let dims = match array.components {
            1 => vec![cells as u64],
            n => vec![cells as u64, n as u64],
        };
        let numbers = match array.name.as_str() {
            "region" => LazyArray::from_fn(values.len(), move |i| values[i] as i32),
            _ => LazyArray::from_fn(values.len(), move |i| values[i]),
        };
        (array.name.clone(), Hdf5Node::Dataset(dims, numbers))
    };
    nodes.push((
        "CellData".into(),
        Hdf5Node::Group(arrays.iter().map(cell_array).collect()),
    ));
    let points = simplices
        .as_ref()
        .map_or(model.mesh.nodes.len(), SimplexMesh::node_count);
    let set = |(name, members): (String, Vec<u32>)| {
        let mut membership = vec![0u8; points];
        members.iter().for_each(|&n| membership[n as usize] = 1);
        (
            name,
            array_node(LazyArray::from_fn(points, move |i| membership[i])),
        )
    };
    let sets = sets.into_iter().map(set).collect();
    nodes.push(("PointData".into(), Hdf5Node::Group(sets)));
    let kind = "UnstructuredGrid";
    // Older readers warn of a version above their own.
    let version = if simplices.is_some() {
        vec![1, 0]
    } else {
        vec![2, 5]
    };
    let attributes = vec![
        ("Version".into(), Hdf5Attribute::Ints(version)),
        ("Type".into(), Hdf5Attribute::Text(kind.into(), kind.len())),
    ];
    let root = Hdf5Node::Group(vec![(
        "VTKHDF".into(),
        Hdf5Node::GroupWithAttributes(attributes, nodes),
    )]);
    batch.write(path, |out| hdf5::write(out, &root))
}

fn array_node(numbers: LazyArray<'_>) -> Hdf5Node<'_> {
    Hdf5Node::Dataset(vec![numbers.len as u64], numbers)
}

fn count_node<'a>(name: &str, value: usize) -> (String, Hdf5Node<'a>) {
    (
        name.into(),
        array_node(LazyArray::from_fn(1, move |_| value as i64)),
    )
}

/// Returns the points, the nodes of the cells with their offsets, and the cell types, as HDF5
/// nodes.
fn grid_nodes<'a>(
    points: LazyArray<'a>,
    connectivity: LazyArray<'a>,
    offsets: LazyArray<'a>,
    types: LazyArray<'a>,
) -> NamedNodes<'a> {
    let count = points.len / 3;
    vec![
        count_node("NumberOfPoints", count),
        count_node("NumberOfCells", types.len),
        count_node("NumberOfConnectivityIds", connectivity.len),
        (
            "Points".into(),
            Hdf5Node::Dataset(vec![count as u64, 3], points),
        ),
        ("Connectivity".into(), array_node(connectivity)),
        ("Offsets".into(), array_node(offsets)),
        ("Types".into(), array_node(types)),
    ]
}

/// Named node sets.
type NodeSets = Vec<(String, Vec<u32>)>;

/// Returns the grid of a simplex mesh, its number of cells, and its node sets.
fn simplex_grid<'a>(mesh: &'a SimplexMesh) -> (NamedNodes<'a>, usize, NodeSets) {
    let mut connectivity: Vec<i64> = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit_nodes(mesh.get(i), |n| connectivity.push(n.into())));
    let size = connectivity.len() / mesh.len().max(1);
    let wedges = mesh
        .elements_between()
        .iter()
        .flat_map(|torn| &torn.face_pairs);
    for &pair in wedges {
        connectivity.extend(pair.as_flattened().iter().map(|&n| i64::from(n)));
    }
    let (simplex_count, cell_count) = (
        mesh.len(),
        (connectivity.len() - mesh.len() * size) / 6 + mesh.len(),
    );
    let kind = SIMPLEX_TYPES[mesh.corner_count][usize::from(mesh.is_quadratic())];
    let points = LazyArray::from_fn(3 * mesh.node_count(), |i| mesh.point(i / 3)[i % 3]);
    let offset =
        move |i: usize| (i.min(simplex_count) * size + i.saturating_sub(simplex_count) * 6) as i64;
    let types = LazyArray::from_fn(cell_count, move |i| {
        if i < simplex_count { kind } else { WEDGE_TYPE }
    });
    let ids = LazyArray::from_fn(connectivity.len(), move |i| connectivity[i]);
    let nodes = grid_nodes(
        points,
        ids,
        LazyArray::from_fn(cell_count + 1, offset),
        types,
    );
    let sets = (mesh.named_sides.iter()).map(|group| (group.name.clone(), mesh.side_nodes(group)));
    let others = mesh.node_sets.iter();
    let others = others.map(|set| (set.name.clone(), set.members.clone()));
    (nodes, cell_count, sets.chain(others).collect())
}

/// Returns the grid of polyhedra, its number of cells, and its node sets. Each face is stored once.
fn polyhedron_grid<'a>(
    model: &'a Model,
    names: &ExportNames,
    cell_faces: &'a Lists,
) -> (NamedNodes<'a>, usize, NodeSets) {
    let mesh = &model.mesh;
    let (mut connectivity, mut offsets): (Vec<i64>, Vec<i64>) = (Vec::new(), vec![0]);
    let mut cell_nodes: Vec<u32> = Vec::new();
    for cell in 0..model.len() {
        cell_nodes.clear();
        cell_nodes.extend(
            cell_faces
                .get(cell)
                .iter()
                .flat_map(|&f| mesh.faces.get(f as usize)),
        );
        cell_nodes.sort_unstable();
        cell_nodes.dedup();
        connectivity.extend(cell_nodes.iter().map(|&n| i64::from(n)));
        offsets.push(connectivity.len() as i64);
    }
    let types = LazyArray::from_fn(model.len(), |_| POLYHEDRON_TYPE);
    let points = LazyArray::from_slice(mesh.nodes.as_flattened());
    let ids = LazyArray::from_fn(connectivity.len(), move |i| connectivity[i]);
    let mut nodes = grid_nodes(
        points,
        ids,
        LazyArray::from_fn(offsets.len(), move |i| offsets[i]),
        types,
    );
    let int = |list: &'a [u32]| LazyArray::from_fn(list.len(), move |i| i64::from(list[i]));
    let faces = mesh.face_cells.len();
    nodes.extend([
        count_node("NumberOfFaces", faces),
        count_node("NumberOfFaceConnectivityIds", mesh.faces.items.len()),
        count_node("NumberOfPolyhedronToFaceIds", cell_faces.items.len()),
        (
            "FaceConnectivity".into(),
            array_node(int(&mesh.faces.items)),
        ),
        ("FaceOffsets".into(), array_node(int(&mesh.faces.offsets))),
        (
            "PolyhedronToFaces".into(),
            array_node(int(&cell_faces.items)),
        ),
        (
            "PolyhedronOffsets".into(),
            array_node(int(&cell_faces.offsets)),
        ),
    ]);
    let groups = names.faces.groups().into_iter();
    let sets = groups.map(|group| (group.name, face_nodes(model, &group.faces)));
    let others = names.node_sets.iter();
    let others = others.map(|set| (set.name.clone(), set.members.clone()));
    (nodes, model.len(), sets.chain(others).collect())
}
