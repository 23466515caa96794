//! XDMF 2 with its numbers in an HDF5 file beside it: cells with what is known of them, and sets of nodes for
//! what has a name. ParaView, VisIt and meshio read it.
//!
//! What has a name is in a second file, `NAME_names.xdmf`, as sets of nodes of the same cells and as grids of faces: some
//! readers (meshio) take a file of one grid without sets only, and readers of XDMF do little with sets of faces.

use std::fmt::Write as _;
use std::path::Path;

use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::containers::binary::LazyArray;
use crate::export::containers::hdf5::{self, Hdf5Node};
use crate::export::values::cell_arrays;
use crate::files::Batch;
use crate::files::vtk::xml::escape;
use crate::model::reservoir::Model;

/// XDMF's names of simplices: linear, quadratic; by their number of corners.
const TOPOLOGY_NAMES: [[&str; 2]; 5] = [
    ["", ""],
    ["", ""],
    ["Polyline", "Edge_3"],
    ["Triangle", "Tri_6"],
    ["Tetrahedron", "Tet_10"],
];

/// What is written in XDMF and in HDF5.
struct XdmfContent<'a> {
    /// The name of the HDF5 file.
    file: String,
    xml: String,
    nodes: Vec<(String, Hdf5Node<'a>)>,
}

impl<'a> XdmfContent<'a> {
    /// Puts a dataset into the one and what refers to it into the other.
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
             Format=\"HDF\">{}:/{name}</DataItem>",
            lengths.join(" "),
            escape(&self.file),
        );
        let dims = dims.iter().map(|&n| n as u64).collect();
        self.nodes.push((name, Hdf5Node::Dataset(dims, numbers)));
    }

    /// Cells of one type.
    fn add_topology(&mut self, name: String, kind: &str, size: usize, nodes: Vec<u32>) {
        let count = nodes.len() / size;
        let more = if kind == "Polyline" {
            " NodesPerElement=\"2\""
        } else {
            ""
        };
        let _ = writeln!(
            self.xml,
            "<Topology TopologyType=\"{kind}\" NumberOfElements=\"{count}\"{more}>"
        );
        let numbers = LazyArray::from_fn(nodes.len(), move |i| nodes[i] as i32);
        self.add_data(name, &[count, size], numbers);
        self.xml.push_str("</Topology>\n");
    }
}

/// How an XDMF file begins, and ends.
const HEAD: &str = "<?xml version=\"1.0\"?>\n<Xdmf Version=\"2.0\">\n<Domain>\n";
const TAIL: &str = "</Domain>\n</Xdmf>\n";

/// Writes all files.
///
/// # Errors
/// [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor triangles.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, "XDMF")?;
    let companion = path.with_extension("h5");
    let name = companion.file_name().unwrap_or_default().to_string_lossy();
    let mut written = XdmfContent {
        file: name.into_owned(),
        xml: HEAD.into(),
        nodes: Vec::new(),
    };
    let order = usize::from(mesh.is_quadratic());
    let geometry = "<Geometry GeometryType=\"XYZ\">\n";
    let points = mesh.node_count();
    written
        .xml
        .push_str("<Grid Name=\"cells\" GridType=\"Uniform\">\n");
    let mut corners = Vec::new();
    (0..mesh.len()).for_each(|i| mesh.visit_nodes(mesh.get(i), |n| corners.push(n)));
    let size = corners.len() / mesh.len().max(1);
    written.add_topology(
        "cells".into(),
        TOPOLOGY_NAMES[mesh.corner_count][order],
        size,
        corners,
    );
    written.xml.push_str(geometry);
    let positions = LazyArray::from_fn(3 * points, |i| mesh.point(i / 3)[i % 3]);
    written.add_data("points".into(), &[points, 3], positions);
    written.xml.push_str("</Geometry>\n");
    for array in cell_arrays(model) {
        let kind = match array.components {
            1 => "Scalar",
            3 => "Vector",
            6 => "Tensor6",
            _ => "Matrix",
        };
        let _ = writeln!(
            written.xml,
            "<Attribute Name=\"{}\" AttributeType=\"{kind}\" Center=\"Cell\">",
            escape(&array.name)
        );
        let values = array.values.to_f64();
        let dims = [mesh.len(), array.components];
        let dims = if array.components == 1 {
            &dims[..1]
        } else {
            &dims
        };
        let name = format!("of_cells_{}", array.name.replace('/', "_"));
        match array.name.as_str() {
            "region" => {
                let numbers = LazyArray::from_fn(values.len(), move |i| values[i] as i32);
                written.add_data(name, dims, numbers);
            }
            _ => written.add_data(
                name,
                dims,
                LazyArray::from_fn(values.len(), move |i| values[i]),
            ),
        }
        written.xml.push_str("</Attribute>\n");
    }
    let sides = |k: usize| {
        let named = &mesh.named_sides[k];
        let mut nodes = Vec::new();
        (0..named.cells.len())
            .for_each(|i| mesh.visit_nodes(named.sides.get(i), |n| nodes.push(n)));
        nodes
    };
    let cells = written.xml.clone();
    for (k, named) in mesh.named_sides.iter().enumerate() {
        let mut nodes = sides(k);
        nodes.sort_unstable();
        nodes.dedup();
        let _ = writeln!(
            written.xml,
            "<Set Name=\"{}\" SetType=\"Node\">",
            escape(&named.name)
        );
        let count = nodes.len();
        let numbers = LazyArray::from_fn(count, move |i| nodes[i] as i32);
        written.add_data(format!("nodes_{}", named.name), &[count], numbers);
        written.xml.push_str("</Set>\n");
    }
    written.xml.push_str("</Grid>\n");
    for (k, named) in mesh.named_sides.iter().enumerate() {
        let nodes = sides(k);
        let size = nodes.len() / named.cells.len().max(1);
        let _ = writeln!(
            written.xml,
            "<Grid Name=\"{}\" GridType=\"Uniform\">",
            escape(&named.name)
        );
        let kind = TOPOLOGY_NAMES[mesh.corner_count - 1][order];
        written.add_topology(format!("faces_{}", named.name), kind, size, nodes);
        let _ = writeln!(
            written.xml,
            "{geometry}<DataItem Dimensions=\"{points} 3\" NumberType=\"Float\" Precision=\"8\" \
             Format=\"HDF\">{}:/points</DataItem>\n</Geometry>\n</Grid>",
            escape(&written.file),
        );
    }
    let root = Hdf5Node::Group(written.nodes);
    batch.write(&companion, |out| hdf5::write(out, &root))?;
    let mut write = |path: &Path, xml: &str| {
        batch.write(path, |out| std::io::Write::write_all(out, xml.as_bytes()))
    };
    if !mesh.named_sides.is_empty() {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let names = path.with_file_name(format!("{stem}_names.xdmf"));
        write(&names, &(written.xml + TAIL))?;
    }
    write(path, &(cells + "</Grid>\n" + TAIL))
}
