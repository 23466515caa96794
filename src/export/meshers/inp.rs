//! Writes input for Abaqus and CalculiX: nodes and C3D4 elements, an element set for each region,
//! and a node set and a surface for each named group of faces. A file with materials and steps
//! includes it (`*INCLUDE`). A 2-D mesh has CPE3 elements, or S3 elements without surfaces if it is
//! not in a plane z = constant. Quadratic elements are C3D10, CPE6 and S6.
//!
//! If the mesh is split along surfaces, the cohesive elements between the two sides (COH3D6) are in
//! a second file, `NAME-cohesive.inp`. CalculiX has no such elements and connects the two sides by
//! other means. There are none between quadratic elements.
//!
//! The conditions of a periodic mesh are in a file of their own, too, `NAME-periodic.inp`: a reference
//! node for each periodic axis, and equations that make the displacement of each node on a far side
//! that of the node opposite it plus those of the reference nodes.

use std::io::Write;
use std::path::Path;

use super::PERIODIC_ELEMENTS;
use super::groups::sorted_regions;
use super::simplices::SimplexMesh;
use crate::Result;
use crate::export::format::ExportFormat;
use crate::export::names::{ExportNames, FormatNames, Naming, TablePlace};
use crate::files::Batch;
use crate::files::text::FileWriter;
use crate::files::text::{TextBuilder, write_items};
use crate::geometry::sorted_distinct;
use crate::model::reservoir::Model;
use crate::names::{LetterCase, NameRules};

/// Entry of this format in the list of formats.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "inp",
    description: "Abaqus and CalculiX elements, sets and surfaces",
    extensions: &["inp"],
    has_companion: false,
    holds_any_cells: false,
    uses_depth: false,
    supported_content: PERIODIC_ELEMENTS,
    deck_path: None,
    names: FormatNames {
        regions: Naming::Names(NameRules {
            reserved: &["EALL"],
            ..SET_NAMES
        }),
        // The names of sets of faces have a letter before them.
        faces: Naming::Names(NameRules {
            max_bytes: SET_NAMES.max_bytes - 1,
            distinct_bytes: SET_NAMES.max_bytes - 1,
            reserved: &["ALL", "PERIODIC_X", "PERIODIC_Y", "PERIODIC_Z"],
            ..SET_NAMES
        }),
        faces_overlap: true,
        has_cell_sets: true,
        node_set_prefix: Some("N"),
        table: TablePlace::Comments("** "),
        ..FormatNames::NONE
    },
    write,
};

/// Rules of Abaqus and CalculiX for the names of sets, which they convert to upper case.
const SET_NAMES: NameRules = NameRules {
    max_bytes: 80,
    distinct_bytes: 80,
    case: LetterCase::Upper,
    ..NameRules::HYPHENATED
};
/// Maximum number of characters that are read of a number.
const NUMBER_WIDTH: usize = 20;
/// Number of terms of an equation in a line.
const TERMS_PER_LINE: usize = 4;
/// Number of values in a line of a set.
const NUMBERS_PER_LINE: usize = 16;
/// Local nodes of the faces S1 to S4 of a tetrahedron, from 0.
const FACE_NODES: [&[usize]; 4] = [&[0, 1, 2], &[0, 3, 1], &[1, 3, 2], &[2, 3, 0]];
/// Local nodes of the edges S1 to S3 of a triangle, from 0.
const EDGE_NODES: [&[usize]; 3] = [&[0, 1], &[1, 2], &[2, 0]];

/// Writes the mesh. Numbers begin with 1.
///
/// # Errors
/// Returns [`Error::Export`](crate::Error::Export) if the cells are neither tetrahedra nor
/// triangles.
pub fn write(model: &Model, names: &ExportNames, batch: &mut Batch, path: &Path) -> Result<()> {
    let mesh = &SimplexMesh::new(model, names, "Abaqus' format")?;
    let is_horizontal = mesh.nodes.iter().all(|p| p[2] == mesh.nodes[0][2]);
    let kind = match (mesh.corner_count, mesh.is_quadratic()) {
        (4, false) => "C3D4",
        (4, true) => "C3D10",
        (_, false) if is_horizontal => "CPE3",
        (_, true) if is_horizontal => "CPE6",
        (_, false) => "S3",
        (_, true) => "S6",
    };
    batch.write(path, |out| {
        write!(out, "{}", names.comments())?;
        writeln!(out, "*NODE, NSET=NALL")?;
        write_items(out, mesh.node_count(), |text, i| {
            let [x, y, z] = mesh.point(i);
            text.int(i + 1);
            for x in [x, y, z] {
                text.word(", ").real_in_width(x, NUMBER_WIDTH);
            }
            text.end_line();
        })?;
        writeln!(out, "*ELEMENT, TYPE={kind}, ELSET=EALL")?;
        write_items(out, mesh.len(), |text, t| {
            text.int(t + 1);
            mesh.visit_nodes(mesh.get(t), |n| {
                text.word(", ").int(n + 1);
            });
            text.end_line();
        })?;
        for region in sorted_regions(model) {
            let is_in_region = |t: &u32| mesh.region[*t as usize] == region;
            let region_cells: Vec<u32> = (0..mesh.len() as u32).filter(is_in_region).collect();
            writeln!(out, "*ELSET, ELSET={}", names.region(region))?;
            write_set(out, &region_cells)?;
        }
        for set in &names.cell_sets {
            writeln!(out, "*ELSET, ELSET={}", set.name)?;
            write_set(out, &set.members)?;
        }
        for set in &mesh.node_sets {
            writeln!(out, "*NSET, NSET={}", set.name)?;
            write_set(out, &set.members)?;
        }
        for group in &mesh.named_sides {
            let name = &group.name;
            let nodes = sorted_distinct(mesh.side_nodes(group));
            writeln!(out, "*NSET, NSET=N{name}")?;
            write_set(out, &nodes)?;
            if kind.starts_with('S') {
                continue;
            }
            let faces = if mesh.corner_count == 4 {
                &FACE_NODES[..]
            } else {
                &EDGE_NODES
            };
            writeln!(out, "*SURFACE, NAME=S{name}, TYPE=ELEMENT")?;
            write_items(out, group.cells.len(), |text, i| {
                let cell = group.cells[i] as usize;
                let (ring, corners) = (group.sides.get(i), mesh.get(cell));
                let is_side = |face: &&[usize]| face.iter().all(|&k| ring.contains(&corners[k]));
                let side = faces.iter().position(is_side).map_or(0, |k| k + 1);
                text.int(cell + 1).word(", S").int(side).end_line();
            })?;
        }
        Ok(())
    })?;
    mesh.write_face_pairs(batch, path, 1)?;
    let is_flat = kind.starts_with("CPE");
    write_periodic(mesh, if is_flat { 2 } else { 3 }, batch, path)?;
    write_cohesive(mesh, batch, path)
}

/// Names of the axes of the image in the names of reference nodes.
const AXIS_NAMES: [&str; 3] = ["X", "Y", "Z"];

/// Writes the equations of a periodic mesh for displacements of `dofs` components. Their first term is
/// the node on the far side, which depends on the others.
fn write_periodic(mesh: &SimplexMesh, dofs: usize, batch: &mut Batch, path: &Path) -> Result<()> {
    let pairs = &mesh.periodic_pairs;
    let axes: Vec<usize> = (0..3).filter(|&axis| mesh.period(axis).is_some()).collect();
    if axes.is_empty() {
        return Ok(());
    }
    let reference = |axis: usize| {
        let index = axes.iter().position(|&other| other == axis);
        mesh.node_count() + index.unwrap_or(0) + 1
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let path = path.with_file_name(format!("{stem}-periodic.inp"));
    batch.write(&path, |out| {
        writeln!(
            out,
            "** Periodic conditions, to be included after the mesh. Fix one node of the mesh, and give the\n\
             ** displacement of NPERIODIC_X over a period along x (Y, Z), which is the mean strain times it."
        )?;
        for &axis in &axes {
            writeln!(out, "*NODE, NSET=NPERIODIC_{}", AXIS_NAMES[axis])?;
            let [x, y, z] = mesh.period(axis).unwrap_or_default();
            writeln!(out, "{}, {x:e}, {y:e}, {z:e}", reference(axis))?;
        }
        write_items(out, pairs.len(), |text, i| {
            let pair = &pairs[i];
            let far_axes = axes.iter().filter(|&&axis| pair.axes >> axis & 1 == 1);
            let references = far_axes.map(|&axis| reference(axis));
            let mut terms = vec![(pair.node as usize + 1, "1"), (pair.base as usize + 1, "-1")];
            terms.extend(references.map(|node| (node, "-1")));
            for dof in 1..=dofs {
                text.word("*EQUATION").end_line();
                text.int(terms.len()).end_line();
                for line in terms.chunks(TERMS_PER_LINE) {
                    let mut separator = "";
                    for (node, factor) in line {
                        text.word(separator).int(*node).word(", ").int(dof);
                        text.word(", ").word(factor);
                        separator = ", ";
                    }
                    text.end_line();
                }
            }
        })
    })
}

/// Writes the elements between the two sides of the surfaces along which the mesh is split. Their
/// numbers follow those of the other elements.
fn write_cohesive(mesh: &SimplexMesh, batch: &mut Batch, path: &Path) -> Result<()> {
    if mesh.elements_between().is_empty() {
        return Ok(());
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    batch.write(
        &path.with_file_name(format!("{stem}-cohesive.inp")),
        |out| {
            let mut next = mesh.len() + 1;
            for torn in mesh.elements_between() {
                let name = &torn.name;
                writeln!(out, "*ELEMENT, TYPE=COH3D6, ELSET={name}")?;
                write_items(out, torn.face_pairs.len(), |text, i| {
                    text.int(next + i);
                    for &n in torn.face_pairs[i].as_flattened() {
                        text.word(", ").int(n + 1);
                    }
                    text.end_line();
                })?;
                next += torn.face_pairs.len();
            }
            Ok(())
        },
    )
}

/// Writes the numbers of a set, which begin with 1 in the file.
fn write_set(out: FileWriter, numbers: &[u32]) -> std::io::Result<()> {
    write_items(
        out,
        numbers.len().div_ceil(NUMBERS_PER_LINE),
        |text: &mut TextBuilder, line| {
            let line =
                &numbers[line * NUMBERS_PER_LINE..numbers.len().min((line + 1) * NUMBERS_PER_LINE)];
            text.int(line[0] + 1);
            for n in &line[1..] {
                text.word(", ").int(n + 1);
            }
            text.end_line();
        },
    )
}
