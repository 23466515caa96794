//! Writes meshes in several files: a `.pvtu` file that lists `.vtu` files. Each of these has consecutive
//! cells and their nodes, so that no process needs the whole mesh. The array `node` has the global
//! numbers of nodes: concatenated in order, the parts are the mesh.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::MeshFile;
use super::array_names::GLOBAL_NODE_ARRAY;
use super::vtu::add_vtu;
use crate::Result;
use crate::files::Batch;
use crate::files::vtk::DataArray;
use crate::files::vtk::xml::escape;
use crate::geometry::sorted_distinct;
use crate::mesh::Simplices;
use crate::mesh::renumber::new_numbers;

/// Returns `true` if a file of this name is a mesh in several files.
pub fn is_pvtu(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("pvtu"))
}

/// Adds the global numbers of nodes, for a part of a mesh.
pub fn with_global_nodes<M>(mut file: MeshFile<M>, global_ids: &[u32]) -> MeshFile<M> {
    let global_ids: Vec<i64> = global_ids.iter().map(|&node| node.into()).collect();
    file.point_data
        .push(DataArray::scalars(GLOBAL_NODE_ARRAY, global_ids));
    file
}

/// Returns the cells of one of `count` parts of a mesh with their nodes and the data of both.
pub fn extract_partition<const D: usize, M: Simplices<D>>(
    mut file: MeshFile<M>,
    part: usize,
    count: usize,
) -> MeshFile<M> {
    if count == 1 {
        let numbers: Vec<i64> = (0..file.mesh.nodes().len() as i64).collect();
        file.point_data
            .push(DataArray::scalars(GLOBAL_NODE_ARRAY, numbers));
        return file;
    }
    let cells = file.mesh.len();
    let cells_of_part = part * cells / count..(part + 1) * cells / count;
    let size = D + 1;
    let corners = &file.mesh.connectivity()[cells_of_part.start * size..cells_of_part.end * size];
    let nodes = sorted_distinct(corners.iter().copied());
    let new_index = new_numbers(file.mesh.nodes().len(), &nodes);
    let cells_of_part: Vec<u32> = cells_of_part.map(|cell| cell as u32).collect();
    let select = |arrays: &[DataArray], indices: &[u32]| -> Vec<DataArray> {
        let select_array = |array: &DataArray| DataArray {
            values: array.values.select_tuples(indices, array.components),
            ..array.clone()
        };
        arrays.iter().map(select_array).collect()
    };
    let mut point_data = select(&file.point_data, &nodes);
    let numbers: Vec<i64> = nodes.iter().map(|&node| node.into()).collect();
    point_data.push(DataArray::scalars(GLOBAL_NODE_ARRAY, numbers));
    let position = |&node: &u32| file.mesh.nodes()[node as usize];
    MeshFile {
        mesh: M::from_parts(
            nodes.iter().map(position).collect(),
            corners
                .iter()
                .map(|&node| new_index[node as usize])
                .collect(),
        ),
        point_data,
        cell_data: select(&file.cell_data, &cells_of_part),
        field_data: file.field_data,
    }
}

/// Writes one of `count` parts, and with the first part the file that lists all.
///
/// # Errors
/// Returns the errors of [`write_vtu`](super::write_vtu).
pub fn write_partition<const D: usize, M: Simplices<D>>(
    path: &Path,
    file: &MeshFile<M>,
    part: usize,
    count: usize,
) -> Result<()> {
    let mut batch = Batch::default();
    add_vtu(
        &mut batch,
        &path.with_file_name(partition_path(path, part)),
        file,
    )?;
    if part == 0 {
        batch.write(path, |out| {
            writeln!(
                out,
                "<?xml version=\"1.0\"?>\n<VTKFile type=\"PUnstructuredGrid\" version=\"1.0\" \
                 byte_order=\"LittleEndian\" header_type=\"UInt64\">\n  \
                 <PUnstructuredGrid GhostLevel=\"0\">"
            )?;
            let groups = [
                ("PPointData", &file.point_data),
                ("PCellData", &file.cell_data),
            ];
            for (element, arrays) in groups {
                writeln!(out, "    <{element}>")?;
                for array in arrays {
                    let (kind, name) = (array.values.type_name(), escape(&array.name));
                    let count = array.components;
                    writeln!(
                        out,
                        "      <PDataArray type=\"{kind}\" Name=\"{name}\" \
                         NumberOfComponents=\"{count}\"/>"
                    )?;
                }
                writeln!(out, "    </{element}>")?;
            }
            writeln!(
                out,
                "    <PPoints>\n      <PDataArray type=\"Float64\" Name=\"Points\" \
                 NumberOfComponents=\"3\"/>\n    </PPoints>"
            )?;
            for part in 0..count {
                let source = escape(&partition_path(path, part).to_string_lossy());
                writeln!(out, "    <Piece Source=\"{source}\"/>")?;
            }
            writeln!(out, "  </PUnstructuredGrid>\n</VTKFile>")
        })?;
    }
    batch.commit()
}

/// Returns the file name of a part, which is in the same folder as the `.pvtu` file.
fn partition_path(path: &Path, part: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    format!("{stem}_{part:04}.vtu").into()
}
