//! Writes XDMF 2, with its numbers in an HDF5 file beside it: cells with their values, and node
//! sets of named faces. ParaView, VisIt and meshio read it.
//!
//! Some readers (meshio) accept only a file with one grid and no sets, DOLFINx reads a grid by its
//! name, which is `mesh` by default, and only from the HDF5 file with the name of the XDMF file. So
//! the named faces are in two more files:
//!
//! - `NAME_facets.xdmf` with `NAME_facets.h5` has one grid, `facets`: all named faces, each with the
//!   number of its name
//! - `NAME_names.xdmf` has a node set of the cells, and a grid of faces, for each name
//!
//! The names of regions and faces are in `Information` elements, in the form that meshio reads.

use std::fmt::Write as _;
use std::path::Path;

use super::NAMES_AND_ROCK;
use super::groups::sorted_regions;
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
    ["Triangle", "Triangle_6"],
    ["Tetrahedron", "Tetrahedron_10"],
];

/// Contents of an XDMF file and of its HDF5 file.
struct XdmfContent<'a> {
    /// Name of the HDF5 file.
    file: String,
    xml: String,
    nodes: Vec<(String, Hdf5Node<'a>)>,
}

impl<'a> XdmfContent<'a> {
    /// Creates the content of the XDMF file at `path`, whose HDF5 file has the same name.
    fn new(path: &Path) -> Self {
        let file = path.with_extension("h5");
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        Self {
            file: name.into_owned(),
            xml: HEAD.into(),
            nodes: Vec::new(),
        }
    }

    /// Adds the positions of all nodes.
    fn add_points(&mut self, mesh: &'a SimplexMesh<'a>) {
        let points = mesh.node_count();
        self.xml.push_str(GEOMETRY);
        let positions = LazyArray::from_fn(3 * points, |i| mesh.point(i / 3)[i % 3]);
        self.add_data("points".into(), &[points, 3], positions);
        self.xml.push_str("</Geometry>\n");
    }

    /// Adds the numbers of names, as meshio reads them; `dim` is the dimension of what has the names.
    fn add_names<'n>(&mut self, dim: usize, names: impl Iterator<Item = (&'n str, i64)>) {
        let maps = names.map(|(name, number)| {
            let name = escape(name);
            format!("<map key=\"{name}\" dim=\"{dim}\">{number}</map>")
        });
        let maps: Vec<String> = maps.collect();
        if !maps.is_empty() {
            let _ = writeln!(
                self.xml,
                "<Information Name=\"names\" Value=\"{}\"><![CDATA[<main>{}</main>]]></Information>",
                maps.len(),
                maps.concat()
            );
        }
    }

    /// Adds all named faces as one grid, with the number of the name of each.
    fn add_facets(&mut self, mesh: &'a SimplexMesh<'a>) {
        let (mut nodes, mut numbers) = (Vec::new(), Vec::new());
        for group in &mesh.named_sides {
            nodes.extend(mesh.side_nodes(group));
            numbers.resize(numbers.len() + group.cells.len(), group.number as i32);
        }
        self.xml
            .push_str("<Grid Name=\"facets\" GridType=\"Uniform\">\n");
        let size = nodes.len() / numbers.len().max(1);
        let kind = TOPOLOGY_NAMES[mesh.corner_count - 1][usize::from(mesh.is_quadratic())];
        self.add_topology("facets".into(), kind, size, nodes);
        self.add_points(mesh);
        self.xml
            .push_str("<Attribute Name=\"facet\" AttributeType=\"Scalar\" Center=\"Cell\">");
        let count = numbers.len();
        let numbers = LazyArray::from_fn(count, move |i| numbers[i]);
        self.add_data("facet".into(), &[count], numbers);
        self.xml.push_str("</Attribute>\n");
        let names = mesh.named_sides.iter();
        let names = names.map(|group| (group.name.as_str(), group.number as i64));
        self.add_names(mesh.corner_count - 2, names);
        self.xml.push_str("</Grid>\n");
    }

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
    let mut content = XdmfContent::new(path);
    let order = usize::from(mesh.is_quadratic());
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
    content.add_points(mesh);
    content.add_cell_arrays(model, &names.properties, mesh.len());
    let regions = sorted_regions(model);
    let named = regions.iter().map(|&r| (names.region(r), i64::from(r)));
    content.add_names(mesh.corner_count - 1, named);
    let cells_xml = content
        .xml
        .replacen("Grid Name=\"cells\"", "Grid Name=\"mesh\"", 1);
    content.add_node_sets(mesh);
    content.xml.push_str("</Grid>\n");
    content.add_side_grids(mesh);
    let mut write = |path: &Path, xml: &str, nodes: Vec<(String, Hdf5Node)>| {
        batch.write(path, |out| std::io::Write::write_all(out, xml.as_bytes()))?;
        if nodes.is_empty() {
            return Ok(());
        }
        let root = Hdf5Node::Group(nodes);
        batch.write(&path.with_extension("h5"), |out| hdf5::write(out, &root))
    };
    if !mesh.named_sides.is_empty() || !mesh.node_sets.is_empty() {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let companion = |ending: &str| path.with_file_name(format!("{stem}_{ending}.xdmf"));
        write(&companion("names"), &(content.xml + TAIL), Vec::new())?;
        let mut facets = XdmfContent::new(&companion("facets"));
        facets.add_facets(mesh);
        write(&companion("facets"), &(facets.xml + TAIL), facets.nodes)?;
    }
    write(path, &(cells_xml + "</Grid>\n" + TAIL), content.nodes)
}
