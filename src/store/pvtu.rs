//! Meshes in parts: a `.pvtu` file that names `.vtu` files, each with some of the cells one after the other
//! and with the nodes of these, so that nobody need hold all. Nodes keep their numbers in the array `node`:
//! put together in order, the parts are the mesh.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::vtu::{MeshFile, add_vtu, read_any_vtu};
use super::{AnyMesh, Storable};
use crate::error::cause;
use crate::files::Batch;
use crate::files::vtk::xml::escape;
use crate::files::vtk::{DataArray, Values, VtkFile};
use crate::mesh::Simplices;
use crate::{Error, Result};

/// The array of the nodes' numbers in the whole mesh.
const GLOBAL_NODE_ARRAY: &str = "node";

/// Whether a file of this name is to be one of parts.
pub fn is_pvtu(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("pvtu"))
}

/// The same mesh as a part of one in which its nodes have these numbers.
pub fn with_global_nodes<M>(mut file: MeshFile<M>, numbers: &[u32]) -> MeshFile<M> {
    let numbers: Vec<i64> = numbers.iter().map(|&node| node.into()).collect();
    file.point_data
        .push(DataArray::scalars(GLOBAL_NODE_ARRAY, numbers));
    file
}

/// The cells of one of `count` parts of a mesh, their nodes and all that is known of both.
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
    let own = part * cells / count..(part + 1) * cells / count;
    let size = D + 1;
    let corners = &file.mesh.connectivity()[own.start * size..own.end * size];
    let mut nodes = corners.to_vec();
    nodes.sort_unstable();
    nodes.dedup();
    let mut number = vec![0; file.mesh.nodes().len()];
    for (i, &node) in nodes.iter().enumerate() {
        number[node as usize] = i as u32;
    }
    let own: Vec<u32> = own.map(|cell| cell as u32).collect();
    let some = |arrays: &[DataArray], which: &[u32]| -> Vec<DataArray> {
        let of = |array: &DataArray| DataArray {
            values: array.values.select_tuples(which, array.components),
            ..array.clone()
        };
        arrays.iter().map(of).collect()
    };
    let mut point_data = some(&file.point_data, &nodes);
    let numbers: Vec<i64> = nodes.iter().map(|&node| node.into()).collect();
    point_data.push(DataArray::scalars(GLOBAL_NODE_ARRAY, numbers));
    let at = |&node: &u32| file.mesh.nodes()[node as usize];
    MeshFile {
        mesh: M::from_parts(
            nodes.iter().map(at).collect(),
            corners.iter().map(|&node| number[node as usize]).collect(),
        ),
        point_data,
        cell_data: some(&file.cell_data, &own),
        field_data: file.field_data,
    }
}

/// Writes one of `count` parts, and with the first the file that names all.
///
/// # Errors
/// As [`write_vtu`](super::write_vtu).
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

/// The name of a part's file, which lies beside that which names all.
fn partition_path(path: &Path, part: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    format!("{stem}_{part:04}.vtu").into()
}

/// Reads a mesh in parts.
///
/// # Errors
/// As [`read_any_vtu`]; [`Error::Mesh`] for parts that do not fit together.
pub fn read_pvtu(path: &Path) -> Result<AnyMesh> {
    let file = VtkFile::read(path, "PUnstructuredGrid")?;
    let pieces = file
        .data_set()
        .children
        .iter()
        .filter(|c| c.name == "Piece");
    let (mut plane, mut space, mut count) = (Vec::new(), Vec::new(), 0);
    for piece in pieces {
        let Some(source) = piece.attribute("Source") else {
            return Err(file.error("has a piece without a Source", "write it again"));
        };
        count += 1;
        match read_any_vtu(&path.with_file_name("").join(source))? {
            AnyMesh::Triangles(part) => plane.push(part),
            AnyMesh::Tetrahedra(part) => space.push(part),
            AnyMesh::Polygons(_) | AnyMesh::Polyhedra(_) => {}
        }
    }
    match (plane.len(), space.len()) {
        (0, 0) if count == 0 => Err(file.error("names no parts", "write it again")),
        (all, 0) if all == count => concatenate(path, plane).map(AnyMesh::Triangles),
        (0, all) if all == count => concatenate(path, space).map(AnyMesh::Tetrahedra),
        _ => Err(file.error(
            "has parts that are neither all of tetrahedra nor all of triangles",
            "merge them into one .vtu (ParaView: Merge Blocks)",
        )),
    }
}

/// The parts put together.
fn concatenate<const D: usize, M: Simplices<D> + Storable<D>>(
    path: &Path,
    parts: Vec<MeshFile<M>>,
) -> Result<MeshFile<M>> {
    let fault = |problem: &str| {
        let remedy = "give the file that atomesh wrote with its parts beside it, or merge the parts into \
                      one .vtu (ParaView: Merge Blocks, Clean to Grid)";
        Error::Mesh(cause(path.display(), problem, remedy))
    };
    let (mut corners, mut fields) = (Vec::new(), None);
    // Of all parts' nodes one after the other.
    let (mut numbers, mut positions) = (Vec::<usize>::new(), Vec::new());
    let (mut point_data, mut cell_data) = (None, None);
    for mut part in parts {
        let named = |array: &DataArray| array.name == GLOBAL_NODE_ARRAY && array.components == 1;
        let Some(at) = part.point_data.iter().position(named) else {
            return Err(fault(
                "has a part without the array 'node' of its nodes' numbers",
            ));
        };
        let own = part.point_data.remove(at).values.to_i64();
        let fits = |&node: &i64| (0..i64::from(u32::MAX)).contains(&node);
        if !own.iter().all(fits) {
            return Err(fault("has a node whose number is none"));
        }
        corners.extend(
            part.mesh
                .connectivity()
                .iter()
                .map(|&i| own[i as usize] as u32),
        );
        numbers.extend(own.iter().map(|&node| node as usize));
        positions.extend_from_slice(part.mesh.nodes());
        append_arrays(&mut point_data, part.point_data)
            .and_then(|()| append_arrays(&mut cell_data, part.cell_data))
            .ok_or_else(|| fault("has parts with different arrays"))?;
        fields.get_or_insert(part.field_data);
    }
    let count = numbers.iter().max().map_or(0, |most| most + 1);
    if count > numbers.len() {
        return Err(fault("lacks some of its nodes: a part is missing"));
    }
    let mut first = vec![u32::MAX; count];
    for (i, &node) in numbers.iter().enumerate().rev() {
        first[node] = i as u32;
    }
    if first.contains(&u32::MAX) {
        return Err(fault("lacks some of its nodes: a part is missing"));
    }
    let mut point_data = point_data.unwrap_or_default();
    for array in &mut point_data {
        array.values = array.values.select_tuples(&first, array.components);
    }
    Ok(MeshFile {
        mesh: M::from_parts(
            first.iter().map(|&i| positions[i as usize]).collect(),
            corners,
        ),
        point_data,
        cell_data: cell_data.unwrap_or_default(),
        field_data: fields.unwrap_or_default(),
    })
}

/// Puts the next part's arrays behind those of the others; `None` if they are not the same.
fn append_arrays(all: &mut Option<Vec<DataArray>>, next: Vec<DataArray>) -> Option<()> {
    let Some(all) = all else {
        *all = Some(next);
        return Some(());
    };
    if all.len() != next.len() {
        return None;
    }
    for (all, next) in all.iter_mut().zip(next) {
        let alike = all.name == next.name && all.components == next.components;
        if !(alike && Values::append(&mut all.values, next.values)) {
            return None;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::store::write_vtu;

    /// A strip of tetrahedra, with arrays of all kinds.
    fn mesh() -> MeshFile {
        let node = |i: i32| {
            let t = 0.9 * f64::from(i);
            [t.cos(), t.sin(), 0.3 * t]
        };
        MeshFile {
            mesh: TetMesh {
                nodes: (0..11).map(node).collect(),
                tets: (0..8).map(|i| [i, i + 1, i + 2, i + 3]).collect(),
            },
            point_data: vec![DataArray {
                name: "pair".into(),
                components: 2,
                values: (0..22i32).collect::<Vec<_>>().into(),
            }],
            cell_data: vec![DataArray::scalars("region", (0..8i32).collect::<Vec<_>>())],
            field_data: Vec::new(),
        }
    }

    #[test]
    fn parts_put_together_are_the_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let whole = mesh();
        for count in [1, 2, 3, 8, 11] {
            let path = folder.path().join(format!("mesh{count}.pvtu"));
            for part in (0..count).rev() {
                let piece = extract_partition(whole.clone(), part, count);
                write_partition(&path, &piece, part, count).unwrap();
            }
            let read = read_any_vtu(&path).unwrap();
            assert!(read == AnyMesh::Tetrahedra(whole.clone()), "{count}");
        }
        std::fs::remove_file(folder.path().join("mesh3_0001.vtu")).unwrap();
        let missing = read_any_vtu(&folder.path().join("mesh3.pvtu")).unwrap_err();
        assert!(missing.to_string().contains("mesh3_0001.vtu"), "{missing}");
        // Parts of another mesh.
        let few = extract_partition(whole.clone(), 0, 8);
        for part in 1..5 {
            let path = folder.path().join(format!("mesh8_000{part}.vtu"));
            write_vtu(&path, &few).unwrap();
        }
        let lacks = read_any_vtu(&folder.path().join("mesh8.pvtu")).unwrap_err();
        assert!(lacks.to_string().contains("a part is missing"), "{lacks}");
        let other = MeshFile {
            cell_data: Vec::new(),
            ..few
        };
        write_vtu(&folder.path().join("mesh2_0001.vtu"), &other).unwrap();
        let unlike = read_any_vtu(&folder.path().join("mesh2.pvtu")).unwrap_err();
        assert!(unlike.to_string().contains("different arrays"), "{unlike}");
    }
}
