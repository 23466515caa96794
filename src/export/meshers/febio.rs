//! Writes models for FEBio (`.feb`, specification 4.0): nodes, elements in a part for each region, and
//! a surface and a set of nodes for each named group of faces. A 2-D mesh becomes shells of thickness
//! 1, and its named edges become sets of edges. Quadratic elements are `tet10` and `tri6`, whose nodes
//! FEBio has in the order of VTK.
//!
//! The model has no boundary conditions, loads or steps. Each region has a material of its own, with
//! values to be replaced.
//!
//! If the mesh is split along surfaces, the two sides of each are a pair of surfaces, for a contact or
//! a tie.

use std::io::Write;
use std::path::Path;

use super::NAMED_ELEMENTS;
use super::groups::sorted_regions;
use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::{FileWriter, TextBuilder, WriteResult, write_items};
use crate::geometry::sorted_distinct;
use crate::model::reservoir::Model;
use crate::names::NameRules;

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "febio",
    description: "FEBio model: parts, surfaces and sets of nodes",
    extensions: &["feb"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: NAMED_ELEMENTS,
    deck_path: None,
    names: FormatNames {
        regions: Naming::Names(NAMES),
        faces: Naming::Names(NAMES),
        faces_overlap: true,
        has_cell_sets: true,
        node_set_prefix: Some(NODE_SET_PREFIX),
        table: TablePlace::Companion,
        ..FormatNames::NONE
    },
    write,
};

/// Rules for names, which are attributes of XML. FEBio refers to the nodes of a surface as
/// `@surface:NAME`, so that names have no colon and no `@`.
const NAMES: NameRules = NameRules {
    is_allowed: |c| !c.is_control() && !['"', '&', '<', '>', '\'', ':', '@', ','].contains(&c),
    is_allowed_first: |c| {
        !c.is_control() && !['"', '&', '<', '>', '\'', ':', '@', ','].contains(&c)
    },
    ..NameRules::TEXT
};
/// Text before the names of sets of nodes, so that none has the name of a surface.
const NODE_SET_PREFIX: &str = "nodes_";
/// Names of linear and of quadratic elements, by their number of corners.
const ELEMENT_NAMES: [[&str; 2]; 5] = [
    ["", ""],
    ["", ""],
    ["line2", "line3"],
    ["tri3", "tri6"],
    ["tet4", "tet10"],
];

/// Writes the mesh. Numbers begin with 1.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "FEBio's format")?;
    let regions = &sorted_regions(model);
    let [cell_name, side_name] = [mesh.corner_count, mesh.corner_count - 1]
        .map(|corners| ELEMENT_NAMES[corners][usize::from(mesh.is_quadratic())]);
    batch.write(path, |out| {
        writeln!(out, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>")?;
        writeln!(out, "<febio_spec version=\"4.0\">")?;
        writeln!(out, "\t<Module type=\"solid\"/>")?;
        write_materials(out, names, regions)?;
        writeln!(out, "\t<Mesh>\n\t\t<Nodes name=\"nodes\">")?;
        write_items(out, mesh.node_count(), |text, i| {
            let [x, y, z] = mesh.point(i);
            text.word("\t\t\t<node id=\"").int(i + 1).word("\">");
            text.real(x).word(",").real(y).word(",").real(z);
            text.word("</node>").end_line();
        })?;
        writeln!(out, "\t\t</Nodes>")?;
        for &region in regions {
            let is_in_region = |t: &u32| mesh.region[*t as usize] == region;
            let cells: Vec<u32> = (0..mesh.len() as u32).filter(is_in_region).collect();
            let name = names.region(region);
            writeln!(out, "\t\t<Elements type=\"{cell_name}\" name=\"{name}\">")?;
            write_items(out, cells.len(), |text, i| {
                write_element(text, mesh, "elem", cells[i], mesh.get(cells[i] as usize));
            })?;
            writeln!(out, "\t\t</Elements>")?;
        }
        let kind = if mesh.corner_count == 4 {
            "Surface"
        } else {
            "Edge"
        };
        for group in &mesh.named_sides {
            writeln!(out, "\t\t<{kind} name=\"{}\">", group.name)?;
            write_items(out, group.sides.len(), |text, i| {
                write_element(text, mesh, side_name, i as u32, group.sides.get(i));
            })?;
            writeln!(out, "\t\t</{kind}>")?;
        }
        for set in &names.cell_sets {
            write_list(out, "ElementSet", &set.name, &set.members)?;
        }
        for set in &mesh.node_sets {
            write_list(out, "NodeSet", &set.name, &set.members)?;
        }
        for group in &mesh.named_sides {
            let nodes = sorted_distinct(mesh.side_nodes(group));
            let name = format!("{NODE_SET_PREFIX}{}", group.name);
            write_list(out, "NodeSet", &name, &nodes)?;
        }
        for split in &names.split {
            let [primary, secondary] = &split.sides;
            writeln!(out, "\t\t<SurfacePair name=\"{}\">", split.elements)?;
            writeln!(out, "\t\t\t<primary>{primary}</primary>")?;
            writeln!(out, "\t\t\t<secondary>{secondary}</secondary>")?;
            writeln!(out, "\t\t</SurfacePair>")?;
        }
        writeln!(out, "\t</Mesh>\n\t<MeshDomains>")?;
        for &region in regions {
            let name = names.region(region);
            if mesh.corner_count == 4 {
                writeln!(out, "\t\t<SolidDomain name=\"{name}\" mat=\"{name}\"/>")?;
            } else {
                writeln!(out, "\t\t<ShellDomain name=\"{name}\" mat=\"{name}\">")?;
                writeln!(out, "\t\t\t<shell_thickness>1</shell_thickness>")?;
                writeln!(out, "\t\t</ShellDomain>")?;
            }
        }
        writeln!(out, "\t</MeshDomains>\n</febio_spec>")
    })?;
    mesh.write_face_pairs(batch, path, 1)
}

/// Writes a material for each region, with values to be replaced.
fn write_materials(out: FileWriter, names: &ExportNames, regions: &[i32]) -> WriteResult {
    writeln!(out, "\t<Material>")?;
    writeln!(
        out,
        "\t\t<!-- Replace these materials, or their values. -->"
    )?;
    for (number, &region) in (1..).zip(regions) {
        let name = names.region(region);
        writeln!(
            out,
            "\t\t<material id=\"{number}\" name=\"{name}\" type=\"neo-Hookean\">"
        )?;
        writeln!(out, "\t\t\t<density>1</density>")?;
        writeln!(out, "\t\t\t<E>1</E>\n\t\t\t<v>0.3</v>\n\t\t</material>")?;
    }
    writeln!(out, "\t</Material>")
}

/// Writes an element or a face with its number, from 0, and its corners.
fn write_element(
    text: &mut TextBuilder,
    mesh: &SimplexMesh,
    name: &str,
    number: u32,
    corners: &[u32],
) {
    text.word("\t\t\t<").word(name).word(" id=\"");
    text.int(number + 1).word("\">");
    let mut separator = "";
    mesh.visit_nodes(corners, |n| {
        text.word(separator).int(n + 1);
        separator = ",";
    });
    text.word("</").word(name).word(">").end_line();
}

/// Writes the numbers of a set, which begin with 1 in the file, in one line, as pyfebio requires.
fn write_list(out: FileWriter, kind: &str, name: &str, numbers: &[u32]) -> WriteResult {
    write!(out, "\t\t<{kind} name=\"{name}\">")?;
    write_items(out, numbers.len(), |text, i| {
        text.word(if i == 0 { "" } else { "," }).int(numbers[i] + 1);
    })?;
    writeln!(out, "</{kind}>")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::PolyMesh;

    /// Writes a box of 2 x 1 x 1 cubes of two regions.
    fn text(is_quadratic: bool) -> String {
        let tets = kuhn_box([2, 1, 1], 1.0);
        let region = |tet: &[u32; 4]| {
            let x: f64 = tet.iter().map(|&n| tets.nodes[n as usize][0]).sum();
            i32::from(x > 4.0)
        };
        let regions: Vec<i32> = tets.tets.iter().map(region).collect();
        let bits = vec![0; tets.tets.len()];
        let mut mesh = PolyMesh::from_simplices(&tets, &bits, &regions).unwrap();
        mesh.assign_sides([0.0; 3], [2.0, 1.0, 1.0]);
        let mut model = Model::new(mesh, Some(tets));
        model.is_quadratic = is_quadratic;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("box.feb");
        FORMAT.write(&model, &path).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn a_box_has_parts_surfaces_and_sets_of_nodes() {
        for (is_quadratic, cell, side, nodes) in
            [(false, "tet4", "tri3", 12), (true, "tet10", "tri6", 45)]
        {
            let text = text(is_quadratic);
            assert_eq!(text.matches("<node ").count(), nodes);
            for name in ["region0", "region1"] {
                let part = format!("<Elements type=\"{cell}\" name=\"{name}\">");
                let domain = format!("<SolidDomain name=\"{name}\" mat=\"{name}\"/>");
                assert!(text.contains(&part) && text.contains(&domain), "{text}");
            }
            assert_eq!(text.matches("<elem ").count(), 12);
            let face = format!("<{side} id=");
            // Two triangles a square: ten squares on the sides, and one between the regions.
            assert_eq!(text.matches(&face).count(), 22, "{text}");
            let names = [
                "xmin",
                "xmax",
                "ymin",
                "ymax",
                "zmin",
                "zmax",
                "interface_0_1",
            ];
            for name in names {
                assert!(
                    text.contains(&format!("<Surface name=\"{name}\">")),
                    "{text}"
                );
            }
            let corners = if is_quadratic { 9 } else { 4 };
            let line = text.lines().find(|l| l.contains("\"nodes_xmax\"")).unwrap();
            assert_eq!(line.matches(',').count(), corners - 1, "{line}");
        }
    }
}
