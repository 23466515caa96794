//! Writes XDMF 2, with its numbers in an HDF5 file beside it: cells with their values, and node
//! sets of named faces. ParaView, VisIt and meshio read it.
//!
//! The named faces are in a second file, `NAME_names.xdmf`, as node sets of the same cells and as
//! grids of faces. Some readers (meshio) accept only a file with one grid and no sets, and few
//! readers of XDMF support face sets.

use std::fmt::Write as _;
use std::path::Path;

use super::NAMES_AND_ROCK;
use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::hdf5::{self, Hdf5Node};
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, Naming};
use crate::export::values::cell_arrays;
use crate::files::Batch;
use crate::files::vtk::xml::escape;
use crate::geometry::sorted_distinct;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "xdmf",
    description: "XDMF with HDF5: cells with their values, sets of faces and nodes",
    extensions: &["xdmf", "xmf"],
    has_companion: false,
    holds_any_cells: false,
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

/// Rules of HDF5 for the names of datasets, in which the names of faces and properties have a word before them.
const LINK_NAMES: NameRules = NameRules {
    max_bytes: 255,
    distinct_bytes: 255,
    is_allowed: |c| !c.is_control() && c != '/',
    is_allowed_first: |c| !c.is_control() && !['/', '.'].contains(&c),
    ..NameRules::TEXT
};
/// XDMF names of linear and of quadratic simplices, by their number of corners.
const TOPOLOGY_NAMES: [[&str; 2]; 5] = [
    ["", ""],
    ["", ""],
    ["Polyline", "Edge_3"],
    ["Triangle", "Tri_6"],
    ["Tetrahedron", "Tet_10"],
];

/// Contents of the XDMF file and of the HDF5 file.
struct XdmfContent<'a> {
    /// Name of the HDF5 file.
    file: String,
    xml: String,
    nodes: Vec<(String, Hdf5Node<'a>)>,
}

impl<'a> XdmfContent<'a> {
    /// Adds a dataset to the HDF5 file, and a reference to it to the XDMF file.
    fn add_data(&mut self, name: String, dims: &[usize], numbers: LazyArray<'a>) {
        let lengths: Vec<String> = dims.iter().map(usize::to_string).collect();
        let (kind, precision) = match numbers.vtk_type {
            "Int32" => ("Int", 4),
            "UInt32" => ("UInt", 4),
            _ => ("Float", 8),
        };
        let _ = writeln!(
            self.xml,
            "<DataItem Dimensions=\"{}\" NumberType=\"{kind}\" Precision=\"{precision}\" \
             Format=\"HDF\">{}:/{}</DataItem>",
            lengths.join(" "),
            escape(&self.file),
            escape(&name),
        );
        let dims = dims.iter().map(|&n| n as u64).collect();
        self.nodes.push((name, Hdf5Node::Dataset(dims, numbers)));
    }

    /// Adds cells of one type.
    fn add_topology(&mut self, name: String, kind: &str, size: usize, nodes: Vec<u32>) {
        let count = nodes.len() / size;
        let nodes_per_element = if kind == "Polyline" {
            " NodesPerElement=\"2\""
        } else {
            ""
        };
        let _ = writeln!(
            self.xml,
            "<Topology TopologyType=\"{kind}\" NumberOfElements=\"{count}\"{nodes_per_element}>"
        );
        let numbers = LazyArray::from_fn(nodes.len(), move |i| nodes[i] as i32);
        self.add_data(name, &[count, size], numbers);
        self.xml.push_str("</Topology>\n");
    }

    /// Adds the values of the cells.
    fn add_cell_arrays(&mut self, model: &Model, names: &[String], cells: usize) {
        for array in cell_arrays(model, names) {
            let kind = match array.components {
                1 => "Scalar",
                3 => "Vector",
                6 => "Tensor6",
                _ => "Matrix",
            };
            let _ = writeln!(
                self.xml,
                "<Attribute Name=\"{}\" AttributeType=\"{kind}\" Center=\"Cell\">",
                escape(&array.name)
            );
            let values = array.values.to_f64();
            let dims = [cells, array.components];
            let dims = if array.components == 1 {
                &dims[..1]
            } else {
                &dims
            };
            let name = format!("of_cells_{}", array.name);
            match array.name.as_str() {
                "region" => {
                    let numbers = LazyArray::from_fn(values.len(), move |i| values[i] as i32);
                    self.add_data(name, dims, numbers);
                }
                _ => self.add_data(
                    name,
                    dims,
                    LazyArray::from_fn(values.len(), move |i| values[i]),
                ),
            }
            self.xml.push_str("</Attribute>\n");
        }
    }

    /// Adds the nodes of each named group of faces, and the other sets of nodes.
    fn add_node_sets(&mut self, mesh: &SimplexMesh<'_>) {
        for group in &mesh.named_sides {
            self.add_node_set(&group.name, sorted_distinct(mesh.side_nodes(group)));
        }
        for set in &mesh.node_sets {
            self.add_node_set(&set.name, set.members.clone());
        }
    }

    fn add_node_set(&mut self, name: &str, nodes: Vec<u32>) {
        let _ = writeln!(self.xml, "<Set Name=\"{}\" SetType=\"Node\">", escape(name));
        let count = nodes.len();
        let numbers = LazyArray::from_fn(count, move |i| nodes[i] as i32);
        self.add_data(format!("nodes_{name}"), &[count], numbers);
        self.xml.push_str("</Set>\n");
    }

    /// Adds each named group of faces as a grid.
    fn add_side_grids(&mut self, mesh: &SimplexMesh<'_>) {
        for group in &mesh.named_sides {
            let nodes = mesh.side_nodes(group);
            let size = nodes.len() / group.cells.len().max(1);
            let _ = writeln!(
                self.xml,
                "<Grid Name=\"{}\" GridType=\"Uniform\">",
                escape(&group.name)
            );
            let kind = TOPOLOGY_NAMES[mesh.corner_count - 1][usize::from(mesh.is_quadratic())];
            self.add_topology(format!("faces_{}", group.name), kind, size, nodes);
            let _ = writeln!(
                self.xml,
                "{GEOMETRY}<DataItem Dimensions=\"{} 3\" NumberType=\"Float\" Precision=\"8\" \
                 Format=\"HDF\">{}:/points</DataItem>\n</Geometry>\n</Grid>",
                mesh.node_count(),
                escape(&self.file),
            );
        }
    }
}

/// Begin and end of an XDMF file.
const HEAD: &str = "<?xml version=\"1.0\"?>\n<Xdmf Version=\"2.0\">\n<Domain>\n";
const TAIL: &str = "</Domain>\n</Xdmf>\n";
const GEOMETRY: &str = "<Geometry GeometryType=\"XYZ\">\n";

/// Writes all files.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "XDMF")?;
    let companion = path.with_extension("h5");
    let name = companion.file_name().unwrap_or_default().to_string_lossy();
    let mut content = XdmfContent {
        file: name.into_owned(),
        xml: HEAD.into(),
        nodes: Vec::new(),
    };
    let order = usize::from(mesh.is_quadratic());
    let points = mesh.node_count();
    content
        .xml
        .push_str("<Grid Name=\"cells\" GridType=\"Uniform\">\n");
    let mut corners = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit_nodes(mesh.get(i), |n| corners.push(n)));
    let size = corners.len() / mesh.len().max(1);
    content.add_topology(
        "cells".into(),
        TOPOLOGY_NAMES[mesh.corner_count][order],
        size,
        corners,
    );
    content.xml.push_str(GEOMETRY);
    let positions = LazyArray::from_fn(3 * points, |i| mesh.point(i / 3)[i % 3]);
    content.add_data("points".into(), &[points, 3], positions);
    content.xml.push_str("</Geometry>\n");
    content.add_cell_arrays(model, &names.properties, mesh.len());
    let cells_xml = content.xml.clone();
    content.add_node_sets(mesh);
    content.xml.push_str("</Grid>\n");
    content.add_side_grids(mesh);
    let root = Hdf5Node::Group(content.nodes);
    batch.write(&companion, |out| hdf5::write(out, &root))?;
    let mut write = |path: &Path, xml: &str| {
        batch.write(path, |out| std::io::Write::write_all(out, xml.as_bytes()))
    };
    if !mesh.named_sides.is_empty() || !mesh.node_sets.is_empty() {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let names_path = path.with_file_name(format!("{stem}_names.xdmf"));
        write(&names_path, &(content.xml + TAIL))?;
    }
    write(path, &(cells_xml + "</Grid>\n" + TAIL))
}
