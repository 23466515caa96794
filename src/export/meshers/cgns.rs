//! CGNS in HDF5 (version 3.4 of the format; with polyhedra 4.2): one base and one unstructured zone. Tetrahedra or triangles in one section, with a
//! section of faces, a family and a boundary condition for each name; of other cells, polygons (NGON_n) and polyhedra
//! of them (NFACE_n), and a boundary condition with a list of faces for each name. What is known of cells is a
//! solution at their centres.
//!
//! Layout: "CGNS Standard Interface Data Structures", version 4.2, chapters 6, 7 and 9; "CGNS HDF5 node
//! mapping": a node is a group with the attributes name, label, type and flags, whose numbers are its dataset
//! " data", with the lengths along the axes the other way round.

use std::path::Path;

use super::groups::Names;
use super::simplices::Simplices;
use crate::Result;
use crate::export::containers::binary::Numbers;
use crate::export::containers::hdf5::{self, Attribute, Node};
use crate::export::values::columns;
use crate::files::Batch;
use crate::mesh::poly::Lists;
use crate::model::reservoir::Model;

/// Numbers of element types: linear and quadratic simplices, by their number of corners; others.
const SIMPLEX: [[i32; 2]; 5] = [[0, 0], [0, 0], [3, 4], [5, 6], [10, 11]];
const POLYGONS: i32 = 22;
const POLYHEDRA: i32 = 23;
/// Bytes of a name or a label, with the 0 at its end.
const NAME: usize = 33;

/// A named node.
type Child<'a> = (String, Node<'a>);

/// Writes the mesh.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if it cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let faces = model.mesh.faces_of_cells();
    let simplices = match model.tets.is_some() || model.triangles.is_some() {
        true => Some(Simplices::new(model, "CGNS")?),
        false => None,
    };
    let (dim, nodes) = match &simplices {
        Some(mesh) => (mesh.size - 1, mesh.node_count()),
        None => (3, model.mesh.nodes.len()),
    };
    let point = |i: usize| match &simplices {
        Some(mesh) => mesh.point(i),
        None => model.mesh.nodes[i],
    };
    let axes = (0..3).zip(["CoordinateX", "CoordinateY", "CoordinateZ"]);
    let axes = axes.map(|(k, name)| {
        let numbers = Numbers::computed(nodes, move |i| point(i)[k]);
        array(name, numbers)
    });
    let mut zone = vec![
        text("ZoneType", "ZoneType_t", "Unstructured"),
        inner("GridCoordinates", "GridCoordinates_t", axes.collect()),
    ];
    let (sections, conditions) = match &simplices {
        Some(mesh) => of_simplices(mesh),
        None => of_polyhedra(model, &faces),
    };
    zone.extend(sections);
    let families = conditions.iter().map(|(name, _)| {
        let condition = text("FamBC", "FamilyBC_t", "UserDefined");
        inner(name, "Family_t", vec![condition])
    });
    let families: Vec<Child> = families.collect();
    zone.push(inner("ZoneBC", "ZoneBC_t", conditions));
    let mut values = vec![text("GridLocation", "GridLocation_t", "CellCenter")];
    for (name, column) in columns(model) {
        let numbers = Numbers::computed(column.len(), move |i| column[i]);
        values.push(array(&name, numbers));
    }
    zone.push(inner("Values", "FlowSolution_t", values));
    let sizes = [nodes as i32, model.len() as i32, 0];
    let zone = node(
        "Zone",
        "Zone_t",
        "I4",
        Some((vec![3, 1], ints(sizes.to_vec()))),
        zone,
    );
    let dims = vec![dim as i32, 3];
    let below = [zone].into_iter().chain(families).collect();
    let base = node(
        "Base",
        "CGNSBase_t",
        "I4",
        Some((vec![2], ints(dims))),
        below,
    );
    // Polygons have their offsets since version 4; what else there is, older libraries read.
    let version: f32 = if simplices.is_some() { 3.4 } else { 4.2 };
    let version = Numbers::computed(1, move |_| version);
    let version = node(
        "CGNSLibraryVersion",
        "CGNSLibraryVersion_t",
        "R4",
        Some((vec![1], version)),
        Vec::new(),
    );
    let said = vec![
        (
            "name".into(),
            Attribute::Text("HDF5 MotherNode".into(), NAME),
        ),
        (
            "label".into(),
            Attribute::Text("Root Node of HDF5 File".into(), NAME),
        ),
        ("type".into(), Attribute::Text("MT".into(), 3)),
    ];
    let root = Node::Described(
        said,
        vec![
            (" format".into(), letters("IEEE_LITTLE_32", 15)),
            (" hdf5version".into(), letters("HDF5 Version 1.8.0", NAME)),
            version,
            base,
        ],
    );
    batch.write(path, |out| hdf5::write(out, &root))
}

/// A node of some type of numbers.
fn node<'a>(
    name: &str,
    label: &str,
    kind: &str,
    data: Option<(Vec<u64>, Numbers<'a>)>,
    children: Vec<Child<'a>>,
) -> Child<'a> {
    let mut name = name.replace('/', "_");
    name.truncate(
        (0..NAME)
            .rev()
            .find(|&at| name.is_char_boundary(at))
            .unwrap_or(0),
    );
    let said = vec![
        ("name".into(), Attribute::Text(name.clone(), NAME)),
        ("label".into(), Attribute::Text(label.into(), NAME)),
        ("type".into(), Attribute::Text(kind.into(), 3)),
        ("flags".into(), Attribute::Ints(vec![1])),
    ];
    let mut links: Vec<Child<'a>> = Vec::new();
    if let Some((dims, numbers)) = data {
        links.push((" data".into(), Node::Data(dims, numbers)));
    }
    links.extend(children);
    (name, Node::Described(said, links))
}

/// A node without numbers.
fn inner<'a>(name: &str, label: &str, children: Vec<Child<'a>>) -> Child<'a> {
    node(name, label, "MT", None, children)
}

fn letters<'a>(text: &str, length: usize) -> Node<'a> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(length, 0);
    Node::Data(
        vec![length as u64],
        Numbers::computed(length, move |i| bytes[i] as i8),
    )
}

fn text<'a>(name: &str, label: &str, text: &str) -> Child<'a> {
    text_above(name, label, text, Vec::new())
}

/// A text with nodes below it.
fn text_above<'a>(name: &str, label: &str, text: &str, children: Vec<Child<'a>>) -> Child<'a> {
    let bytes = text.as_bytes().to_vec();
    let numbers = Numbers::computed(bytes.len(), move |i| bytes[i] as i8);
    let data = Some((vec![numbers.len as u64], numbers));
    node(name, label, "C1", data, children)
}

fn ints<'a>(values: Vec<i32>) -> Numbers<'a> {
    Numbers::computed(values.len(), move |i| values[i])
}

/// A list of numbers.
fn array<'a>(name: &str, numbers: Numbers<'a>) -> Child<'a> {
    let kind = if numbers.kind == "Int32" { "I4" } else { "R8" };
    let dims = vec![numbers.len as u64];
    node(name, "DataArray_t", kind, Some((dims, numbers)), Vec::new())
}

/// Elements of one type, numbered from `first` on.
fn section<'a>(
    name: &str,
    kind: i32,
    first: usize,
    count: usize,
    lists: Vec<Child<'a>>,
) -> Child<'a> {
    let range = ints(vec![first as i32, (first + count - 1) as i32]);
    let mut children = vec![node(
        "ElementRange",
        "IndexRange_t",
        "I4",
        Some((vec![2], range)),
        Vec::new(),
    )];
    children.extend(lists);
    let kind = ints(vec![kind, 0]);
    node(name, "Elements_t", "I4", Some((vec![2], kind)), children)
}

/// What has a name: numbers of faces, a list of them or the first and last.
fn condition<'a>(name: &str, place: &str, points: Vec<i32>, is_range: bool) -> Child<'a> {
    let (list, label) = match is_range {
        true => ("PointRange", "IndexRange_t"),
        false => ("PointList", "IndexArray_t"),
    };
    let dims = vec![points.len() as u64, 1];
    let points = node(list, label, "I4", Some((dims, ints(points))), Vec::new());
    let place = text("GridLocation", "GridLocation_t", place);
    let family = text("FamilyName", "FamilyName_t", name);
    let children = vec![points, place, family];
    text_above(name, "BC_t", "FamilySpecified", children)
}

/// Sections, and boundary conditions.
fn of_simplices<'a>(mesh: &Simplices) -> (Vec<Child<'a>>, Vec<Child<'a>>) {
    let order = usize::from(mesh.is_quadratic());
    let place = if mesh.size == 4 {
        "FaceCenter"
    } else {
        "EdgeCenter"
    };
    let connectivity = |nodes: Vec<i32>| vec![array("ElementConnectivity", ints(nodes))];
    let mut nodes = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit(mesh.get(i), |n| nodes.push(n as i32 + 1)));
    let kind = SIMPLEX[mesh.size][order];
    let mut sections = vec![section("Cells", kind, 1, mesh.len(), connectivity(nodes))];
    let (mut conditions, mut next) = (Vec::new(), mesh.len() + 1);
    for named in &mesh.named {
        let (count, mut nodes) = (named.cells.len(), Vec::new());
        (0..count).for_each(|i| mesh.visit(named.sides.get(i), |n| nodes.push(n as i32 + 1)));
        let kind = SIMPLEX[mesh.size - 1][order];
        sections.push(section(&named.name, kind, next, count, connectivity(nodes)));
        let range = vec![next as i32, (next + count - 1) as i32];
        conditions.push(condition(&named.name, place, range, true));
        next += count;
    }
    (sections, conditions)
}

/// The same of polyhedra: all faces, then the cells, whose faces have a minus where they turn inwards.
fn of_polyhedra<'a>(model: &'a Model, of_cells: &'a Lists) -> (Vec<Child<'a>>, Vec<Child<'a>>) {
    let mesh = &model.mesh;
    let offsets = |list: &'a Lists| {
        let numbers = Numbers::computed(list.offsets.len(), |i| list.offsets[i] as i32);
        array("ElementStartOffset", numbers)
    };
    let faces = mesh.face_cells.len();
    let nodes = Numbers::computed(mesh.faces.items.len(), |i| mesh.faces.items[i] as i32 + 1);
    let lists = vec![offsets(&mesh.faces), array("ElementConnectivity", nodes)];
    let polygons = section("Faces", POLYGONS, 1, faces, lists);
    let mut signed = Vec::with_capacity(of_cells.items.len());
    for cell in 0..model.len() {
        for &face in of_cells.get(cell) {
            let owner = mesh.face_cells[face as usize][0] as usize;
            let number = face as i32 + 1;
            signed.push(if owner == cell { number } else { -number });
        }
    }
    let lists = vec![
        offsets(of_cells),
        array("ElementConnectivity", ints(signed)),
    ];
    let cells = section("Cells", POLYHEDRA, faces + 1, model.len(), lists);
    let groups = Names::new(model).groups().into_iter();
    let conditions = groups.map(|group| {
        let list = group.faces.iter().map(|&f| f as i32 + 1).collect();
        condition(&group.name, "FaceCenter", list, false)
    });
    (vec![polygons, cells], conditions.collect())
}
