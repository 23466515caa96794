//! VTKHDF (version 2.3 of the format, VTK 9.4 and later; simplices are read by 9.1 too): cells of any shape in
//! one HDF5 file, with what is known of them. What has a name is an array of nodes, 1 where they are in it.
//!
//! Of a mesh torn along surfaces there are wedges of no thickness, too, of region 0 and without values.

use std::path::Path;

use super::groups::{Names, nodes_of};
use super::simplices::Simplices;
use crate::Result;
use crate::export::containers::binary::Numbers;
use crate::export::containers::hdf5::{self, Attribute, Node};
use crate::export::values::of_cells;
use crate::files::Batch;
use crate::files::vtk::DataArray;
use crate::mesh::poly::Lists;
use crate::model::reservoir::Model;

/// VTK's numbers of cells: of linear simplices by their number of corners, of quadratic ones; of others.
const SIMPLEX: [[u8; 2]; 5] = [[0, 0], [0, 0], [0, 0], [5, 22], [10, 24]];
const WEDGE: u8 = 13;
const POLYHEDRON: u8 = 42;

/// Named nodes.
type Nodes<'a> = Vec<(String, Node<'a>)>;

/// Writes the mesh.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if it cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let simplices = model.tets.is_some() || model.triangles.is_some();
    let simplices = match simplices {
        true => Some(Simplices::new(model, "VTKHDF")?),
        false => None,
    };
    let arrays = of_cells(model);
    let faces = model.mesh.faces_of_cells();
    let (mut nodes, cells, sets) = match &simplices {
        Some(mesh) => of_simplices(mesh),
        None => of_polyhedra(model, &faces),
    };
    let rows = |array: &DataArray| {
        let mut values = array.values.to_f64();
        let empty = if array.name == "region" {
            0.0
        } else {
            f64::NAN
        };
        values.resize(cells * array.components, empty);
        let dims = match array.components {
            1 => vec![cells as u64],
            n => vec![cells as u64, n as u64],
        };
        let numbers = match array.name.as_str() {
            "region" => Numbers::computed(values.len(), move |i| values[i] as i32),
            _ => Numbers::computed(values.len(), move |i| values[i]),
        };
        (array.name.clone(), Node::Data(dims, numbers))
    };
    nodes.push((
        "CellData".into(),
        Node::Group(arrays.iter().map(rows).collect()),
    ));
    let points = simplices
        .as_ref()
        .map_or(model.mesh.nodes.len(), Simplices::node_count);
    let set = |(name, members): (String, Vec<u32>)| {
        let mut within = vec![0u8; points];
        members.iter().for_each(|&n| within[n as usize] = 1);
        (name, list(Numbers::computed(points, move |i| within[i])))
    };
    let sets = sets.into_iter().map(set).collect();
    nodes.push(("PointData".into(), Node::Group(sets)));
    let kind = "UnstructuredGrid";
    let said = vec![
        ("Version".into(), Attribute::Ints(vec![2, 3])),
        ("Type".into(), Attribute::Text(kind.into(), kind.len())),
    ];
    let root = Node::Group(vec![("VTKHDF".into(), Node::Described(said, nodes))]);
    batch.write(path, |out| hdf5::write(out, &root))
}

fn list(numbers: Numbers<'_>) -> Node<'_> {
    Node::Data(vec![numbers.len as u64], numbers)
}

fn one<'a>(name: &str, value: usize) -> (String, Node<'a>) {
    (
        name.into(),
        list(Numbers::computed(1, move |_| value as i64)),
    )
}

/// Points, cells' nodes and types; the offsets of the cells' nodes.
fn grid<'a>(
    points: Numbers<'a>,
    connectivity: Numbers<'a>,
    offsets: Numbers<'a>,
    types: Numbers<'a>,
) -> Nodes<'a> {
    let count = points.len / 3;
    vec![
        one("NumberOfPoints", count),
        one("NumberOfCells", types.len),
        one("NumberOfConnectivityIds", connectivity.len),
        ("Points".into(), Node::Data(vec![count as u64, 3], points)),
        ("Connectivity".into(), list(connectivity)),
        ("Offsets".into(), list(offsets)),
        ("Types".into(), list(types)),
    ]
}

/// Sets of nodes by name.
type Sets = Vec<(String, Vec<u32>)>;

/// The grid, its number of cells, and its sets of nodes.
fn of_simplices<'a>(mesh: &'a Simplices) -> (Nodes<'a>, usize, Sets) {
    let mut connectivity: Vec<i64> = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit(mesh.get(i), |n| connectivity.push(n.into())));
    let size = connectivity.len() / mesh.len().max(1);
    let wedges = mesh.torn.iter().flat_map(|torn| &torn.pairs);
    for &pair in wedges {
        connectivity.extend(pair.as_flattened().iter().map(|&n| i64::from(n)));
    }
    let (own, all) = (
        mesh.len(),
        (connectivity.len() - mesh.len() * size) / 6 + mesh.len(),
    );
    let kind = SIMPLEX[mesh.size][usize::from(mesh.is_quadratic())];
    let points = Numbers::computed(3 * mesh.node_count(), |i| mesh.point(i / 3)[i % 3]);
    let offset = move |i: usize| (i.min(own) * size + i.saturating_sub(own) * 6) as i64;
    let types = Numbers::computed(all, move |i| if i < own { kind } else { WEDGE });
    let ids = Numbers::computed(connectivity.len(), move |i| connectivity[i]);
    let nodes = grid(points, ids, Numbers::computed(all + 1, offset), types);
    let sets = mesh.named.iter().map(|named| {
        let mut members = Vec::new();
        (0..named.cells.len()).for_each(|i| mesh.visit(named.sides.get(i), |n| members.push(n)));
        (named.name.clone(), members)
    });
    (nodes, all, sets.collect())
}

/// The same of polyhedra, whose faces are each in the file once.
fn of_polyhedra<'a>(model: &'a Model, of_cells: &'a Lists) -> (Nodes<'a>, usize, Sets) {
    let mesh = &model.mesh;
    let (mut connectivity, mut offsets): (Vec<i64>, Vec<i64>) = (Vec::new(), vec![0]);
    let mut own: Vec<u32> = Vec::new();
    for cell in 0..model.len() {
        own.clear();
        own.extend(
            of_cells
                .get(cell)
                .iter()
                .flat_map(|&f| mesh.faces.get(f as usize)),
        );
        own.sort_unstable();
        own.dedup();
        connectivity.extend(own.iter().map(|&n| i64::from(n)));
        offsets.push(connectivity.len() as i64);
    }
    let types = Numbers::computed(model.len(), |_| POLYHEDRON);
    let points = Numbers::slice(mesh.nodes.as_flattened());
    let ids = Numbers::computed(connectivity.len(), move |i| connectivity[i]);
    let mut nodes = grid(
        points,
        ids,
        Numbers::computed(offsets.len(), move |i| offsets[i]),
        types,
    );
    let int = |list: &'a [u32]| Numbers::computed(list.len(), move |i| i64::from(list[i]));
    let faces = mesh.face_cells.len();
    nodes.extend([
        one("NumberOfFaces", faces),
        one("NumberOfFaceConnectivityIds", mesh.faces.items.len()),
        one("NumberOfPolyhedronToFaceIds", of_cells.items.len()),
        ("FaceConnectivity".into(), list(int(&mesh.faces.items))),
        ("FaceOffsets".into(), list(int(&mesh.faces.offsets))),
        ("PolyhedronToFaces".into(), list(int(&of_cells.items))),
        ("PolyhedronOffsets".into(), list(int(&of_cells.offsets))),
    ]);
    let groups = Names::new(model).groups().into_iter();
    let sets = groups.map(|group| (group.name, nodes_of(model, &group.faces)));
    (nodes, model.len(), sets.collect())
}
