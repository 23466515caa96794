//! Writes CGNS in HDF5 (version 3.4 of the format; with polyhedra 4.2), with one base and one
//! unstructured zone. Tetrahedra or triangles are in one section, and each name has a section of
//! faces, a family and a boundary condition. Other cells are polygons (NGON_n) and polyhedra made
//! of them (NFACE_n), and each name has a boundary condition with a list of faces. The values of
//! cells are a solution at their centres.
//!
//! Source: "CGNS Standard Interface Data Structures", version 4.2, chapters 6, 7 and 9; "CGNS HDF5
//! node mapping". A node is a group with the attributes name, label, type and flags. Its values are
//! the dataset " data", whose axes are in reverse order.

use std::path::Path;

use super::groups::FaceNames;
use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::hdf5::{self, Hdf5Attribute, Hdf5Node};
use crate::export::format::{ExportContent, ExportFormat};
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::export::values::scalar_columns;
use crate::files::Batch;
use crate::mesh::poly::Lists;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "cgns",
    description: "CGNS: any cells with their values, boundary conditions by name",
    extensions: &["cgns"],
    has_companion: false,
    holds_any_cells: true,
    uses_depth: false,
    supported_content: &[
        ExportContent::Names,
        ExportContent::Regions,
        ExportContent::Porosity,
        ExportContent::Permeability,
        ExportContent::Properties,
        ExportContent::Quadratic,
    ],
    deck_path: None,
    names: FormatNames {
        regions: Naming::Numbers,
        faces: Naming::Names(NameRules {
            reserved: &[
                "Base",
                "Cells",
                "CGNSLibraryVersion",
                "Faces",
                "GridCoordinates",
                "Values",
                "Zone",
                "ZoneBC",
                "ZoneType",
            ],
            ..NODE_NAMES
        }),
        properties: Some(NameRules {
            reserved: &["GridLocation"],
            ..NODE_NAMES
        }),
        has_columns: true,
        ..FormatNames::NONE
    },
    write,
};

/// Rules of CGNS for the names of nodes.
const NODE_NAMES: NameRules = NameRules {
    max_bytes: NAME_BYTES - 1,
    distinct_bytes: NAME_BYTES - 1,
    is_allowed: |c| c == ' ' || c.is_ascii_graphic() && c != '/',
    is_allowed_first: |c| c.is_ascii_graphic() && c != '.',
    ..NameRules::TEXT
};
/// Element types of linear and of quadratic simplices, by their number of corners.
const SIMPLEX_TYPES: [[i32; 2]; 5] = [[0, 0], [0, 0], [3, 4], [5, 6], [10, 11]];
const NGON_TYPE: i32 = 22;
const NFACE_TYPE: i32 = 23;
/// Size of a name or a label in bytes, with the final zero.
const NAME_BYTES: usize = 33;

/// Named node.
type NamedNode<'a> = (String, Hdf5Node<'a>);

/// Writes the mesh.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let faces = model.mesh.faces_of_cells();
    let simplices = if model.tets.is_some() || model.triangles.is_some() {
        Some(SimplexMesh::new(model, names, "CGNS")?)
    } else {
        None
    };
    let (dim, nodes) = match &simplices {
        Some(mesh) => (mesh.corner_count - 1, mesh.node_count()),
        None => (3, model.mesh.nodes.len()),
    };
    let point = |i: usize| match &simplices {
        Some(mesh) => mesh.point(i),
        None => model.mesh.nodes[i],
    };
    let axes = (0..3).zip(["CoordinateX", "CoordinateY", "CoordinateZ"]);
    let axes = axes.map(|(k, name)| {
        let numbers = LazyArray::from_fn(nodes, move |i| point(i)[k]);
        array_node(name, numbers)
    });
    let mut zone = vec![
        text_node("ZoneType", "ZoneType_t", "Unstructured"),
        group_node("GridCoordinates", "GridCoordinates_t", axes.collect()),
    ];
    let (sections, conditions) = match &simplices {
        Some(mesh) => simplex_sections(mesh),
        None => polyhedron_sections(model, &names.faces, &faces),
    };
    zone.extend(sections);
    let families = conditions.iter().map(|(name, _)| {
        let condition = text_node("FamBC", "FamilyBC_t", "UserDefined");
        group_node(name, "Family_t", vec![condition])
    });
    let families: Vec<NamedNode> = families.collect();
    zone.push(group_node("ZoneBC", "ZoneBC_t", conditions));
    let mut values = vec![text_node("GridLocation", "GridLocation_t", "CellCenter")];
    for (name, column) in scalar_columns(model, &names.properties) {
        let numbers = LazyArray::from_fn(column.len(), move |i| column[i]);
        values.push(array_node(&name, numbers));
    }
    zone.push(group_node("Values", "FlowSolution_t", values));
    let sizes = [nodes as i32, model.len() as i32, 0];
    let zone = data_node(
        "Zone",
        "Zone_t",
        "I4",
        Some((vec![3, 1], int_array(sizes.to_vec()))),
        zone,
    );
    let dims = vec![dim as i32, 3];
    let children = [zone].into_iter().chain(families).collect();
    let base = data_node(
        "Base",
        "CGNSBase_t",
        "I4",
        Some((vec![2], int_array(dims))),
        children,
    );
    // Polygons need version 4, in which they have offsets. Older libraries can read the rest.
    let version = if simplices.is_some() { 3.4 } else { 4.2 };
    let root = root_node(version, base);
    batch.write(path, |out| hdf5::write(out, &root))
}

/// Returns the root of a file of a version of CGNS.
fn root_node(version: f32, base: NamedNode<'_>) -> Hdf5Node<'_> {
    let version = LazyArray::from_fn(1, move |_| version);
    let version = data_node(
        "CGNSLibraryVersion",
        "CGNSLibraryVersion_t",
        "R4",
        Some((vec![1], version)),
        Vec::new(),
    );
    let text = |text: &str, size| Hdf5Attribute::Text(text.into(), size);
    let attributes = vec![
        ("name".into(), text("HDF5 MotherNode", NAME_BYTES)),
        ("label".into(), text("Root Node of HDF5 File", NAME_BYTES)),
        ("type".into(), text("MT", 3)),
    ];
    let hdf5_version = chars_node("HDF5 Version 1.8.0", NAME_BYTES);
    let children = vec![
        (" format".into(), chars_node("IEEE_LITTLE_32", 15)),
        (" hdf5version".into(), hdf5_version),
        version,
        base,
    ];
    Hdf5Node::GroupWithAttributes(attributes, children)
}

/// Returns a node with data of the type `kind`.
fn data_node<'a>(
    name: &str,
    label: &str,
    kind: &str,
    data: Option<(Vec<u64>, LazyArray<'a>)>,
    children: Vec<NamedNode<'a>>,
) -> NamedNode<'a> {
    let attributes = vec![
        ("name".into(), Hdf5Attribute::Text(name.into(), NAME_BYTES)),
        (
            "label".into(),
            Hdf5Attribute::Text(label.into(), NAME_BYTES),
        ),
        ("type".into(), Hdf5Attribute::Text(kind.into(), 3)),
        ("flags".into(), Hdf5Attribute::Ints(vec![1])),
    ];
    let mut links: Vec<NamedNode<'a>> = Vec::new();
    if let Some((dims, numbers)) = data {
        links.push((" data".into(), Hdf5Node::Dataset(dims, numbers)));
    }
    links.extend(children);
    (
        name.into(),
        Hdf5Node::GroupWithAttributes(attributes, links),
    )
}

/// Returns a node without data.
fn group_node<'a>(name: &str, label: &str, children: Vec<NamedNode<'a>>) -> NamedNode<'a> {
    data_node(name, label, "MT", None, children)
}

fn chars_node<'a>(text: &str, length: usize) -> Hdf5Node<'a> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(length, 0);
    Hdf5Node::Dataset(
        vec![length as u64],
        LazyArray::from_fn(length, move |i| bytes[i] as i8),
    )
}

fn text_node<'a>(name: &str, label: &str, text: &str) -> NamedNode<'a> {
    text_parent_node(name, label, text, Vec::new())
}

/// Returns a text node with child nodes.
fn text_parent_node<'a>(
    name: &str,
    label: &str,
    text: &str,
    children: Vec<NamedNode<'a>>,
) -> NamedNode<'a> {
    let bytes = text.as_bytes().to_vec();
    let numbers = LazyArray::from_fn(bytes.len(), move |i| bytes[i] as i8);
    let data = Some((vec![numbers.len as u64], numbers));
    data_node(name, label, "C1", data, children)
}

fn int_array<'a>(values: Vec<i32>) -> LazyArray<'a> {
    LazyArray::from_fn(values.len(), move |i| values[i])
}

/// Returns an array node.
fn array_node<'a>(name: &str, numbers: LazyArray<'a>) -> NamedNode<'a> {
    let kind = if numbers.vtk_type == "Int32" {
        "I4"
    } else {
        "R8"
    };
    let dims = vec![numbers.len as u64];
    data_node(name, "DataArray_t", kind, Some((dims, numbers)), Vec::new())
}

/// Returns a section of elements of one type, numbered from `first`.
fn element_section<'a>(
    name: &str,
    kind: i32,
    first: usize,
    count: usize,
    lists: Vec<NamedNode<'a>>,
) -> NamedNode<'a> {
    let range = int_array(vec![first as i32, (first + count - 1) as i32]);
    let mut children = vec![data_node(
        "ElementRange",
        "IndexRange_t",
        "I4",
        Some((vec![2], range)),
        Vec::new(),
    )];
    children.extend(lists);
    let kind = int_array(vec![kind, 0]);
    data_node(name, "Elements_t", "I4", Some((vec![2], kind)), children)
}

/// Returns a boundary condition: the numbers of its faces as a list, or the first and the last
/// number as a range.
fn boundary_condition<'a>(
    name: &str,
    location: &str,
    points: Vec<i32>,
    is_range: bool,
) -> NamedNode<'a> {
    let (list, label) = if is_range {
        ("PointRange", "IndexRange_t")
    } else {
        ("PointList", "IndexArray_t")
    };
    let dims = vec![points.len() as u64, 1];
    let points = data_node(
        list,
        label,
        "I4",
        Some((dims, int_array(points))),
        Vec::new(),
    );
    let location = text_node("GridLocation", "GridLocation_t", location);
    let family = text_node("FamilyName", "FamilyName_t", name);
    let children = vec![points, location, family];
    text_parent_node(name, "BC_t", "FamilySpecified", children)
}

/// Returns the sections and the boundary conditions of a simplex mesh.
fn simplex_sections<'a>(mesh: &SimplexMesh) -> (Vec<NamedNode<'a>>, Vec<NamedNode<'a>>) {
    let order = usize::from(mesh.is_quadratic());
    let location = if mesh.corner_count == 4 {
        "FaceCenter"
    } else {
        "EdgeCenter"
    };
    let connectivity = |nodes: Vec<i32>| vec![array_node("ElementConnectivity", int_array(nodes))];
    let mut nodes = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit_nodes(mesh.get(i), |n| nodes.push(n as i32 + 1)));
    let kind = SIMPLEX_TYPES[mesh.corner_count][order];
    let mut sections = vec![element_section(
        "Cells",
        kind,
        1,
        mesh.len(),
        connectivity(nodes),
    )];
    let (mut conditions, mut next) = (Vec::new(), mesh.len() + 1);
    for group in &mesh.named_sides {
        let (count, mut nodes) = (group.cells.len(), Vec::new());
        (0..count).for_each(|i| mesh.visit_nodes(group.sides.get(i), |n| nodes.push(n as i32 + 1)));
        let kind = SIMPLEX_TYPES[mesh.corner_count - 1][order];
        sections.push(element_section(
            &group.name,
            kind,
            next,
            count,
            connectivity(nodes),
        ));
        let range = vec![next as i32, (next + count - 1) as i32];
        conditions.push(boundary_condition(&group.name, location, range, true));
        next += count;
    }
    (sections, conditions)
}

/// Returns the sections and the boundary conditions of polyhedra: first all faces, then the cells.
/// A face has a negative number in the cell into which it points.
fn polyhedron_sections<'a>(
    model: &'a Model,
    names: &FaceNames,
    cell_faces: &'a Lists,
) -> (Vec<NamedNode<'a>>, Vec<NamedNode<'a>>) {
    let mesh = &model.mesh;
    let offsets = |list: &'a Lists| {
        let numbers = LazyArray::from_fn(list.offsets.len(), |i| list.offsets[i] as i32);
        array_node("ElementStartOffset", numbers)
    };
    let faces = mesh.face_cells.len();
    let nodes = LazyArray::from_fn(mesh.faces.items.len(), |i| mesh.faces.items[i] as i32 + 1);
    let lists = vec![
        offsets(&mesh.faces),
        array_node("ElementConnectivity", nodes),
    ];
    let polygons = element_section("Faces", NGON_TYPE, 1, faces, lists);
    let mut signed_faces = Vec::with_capacity(cell_faces.items.len());
    for cell in 0..model.len() {
        for &face in cell_faces.get(cell) {
            let owner = mesh.face_cells[face as usize][0] as usize;
            let number = face as i32 + 1;
            signed_faces.push(if owner == cell { number } else { -number });
        }
    }
    let lists = vec![
        offsets(cell_faces),
        array_node("ElementConnectivity", int_array(signed_faces)),
    ];
    let cells = element_section("Cells", NFACE_TYPE, faces + 1, model.len(), lists);
    let groups = names.groups().into_iter();
    let conditions = groups.map(|group| {
        let list = group.faces.iter().map(|&f| f as i32 + 1).collect();
        boundary_condition(&group.name, "FaceCenter", list, false)
    });
    (vec![polygons, cells], conditions.collect())
}
