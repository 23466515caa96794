//! Reads meshes in several files: a `.pvtu` file that lists `.vtu` files. Each of these has consecutive
//! cells and their nodes, so that no process needs the whole mesh. The array `node` has the global
//! numbers of nodes: concatenated in order, the parts are the mesh.

use std::path::Path;

use super::vtu::read_any_vtu;
use super::{AnyMesh, MeshFile, Storable};
use crate::error::cause;
use crate::files::vtk::{DataArray, Values, VtkFile};
use crate::geometry::NONE;
use crate::mesh::Simplices;
use crate::mesh_file::array_names::GLOBAL_NODE_ARRAY;
use crate::{Error, Result};

/// Reads a mesh in several files.
///
/// # Errors
/// Returns the errors of [`read_any_vtu`], and [`Error::Mesh`] for parts that do not match.
pub fn read_pvtu(path: &Path) -> Result<AnyMesh> {
    let file = VtkFile::read(path, "PUnstructuredGrid")?;
    let pieces = file
        .data_set()
        .children
        .iter()
        .filter(|c| c.name == "Piece");
    let (mut triangles, mut tetrahedra, mut count) = (Vec::new(), Vec::new(), 0);
    for piece in pieces {
        let Some(source) = piece.attribute("Source") else {
            return Err(file.error(
                "has a piece without a Source",
                crate::files::REWRITE_DAMAGED,
            ));
        };
        count += 1;
        match read_any_vtu(&path.with_file_name("").join(source))? {
            AnyMesh::Triangles(part) => triangles.push(part),
            AnyMesh::Tetrahedra(part) => tetrahedra.push(part),
            AnyMesh::Polygons(_) | AnyMesh::Polyhedra(_) => {}
        }
    }
    match (triangles.len(), tetrahedra.len()) {
        (0, 0) if count == 0 => Err(file.error("lists no parts", crate::files::REWRITE_DAMAGED)),
        (parts, 0) if parts == count => concatenate(path, triangles).map(AnyMesh::Triangles),
        (0, parts) if parts == count => concatenate(path, tetrahedra).map(AnyMesh::Tetrahedra),
        _ => Err(file.error(
            "has parts with different cells, or cells other than tetrahedra and triangles",
            "merge them into one .vtu (ParaView: Merge Blocks)",
        )),
    }
}

/// Concatenates the parts.
fn concatenate<const D: usize, M: Simplices<D> + Storable<D>>(
    path: &Path,
    parts: Vec<MeshFile<M>>,
) -> Result<MeshFile<M>> {
    let error = |problem: &str| {
        let remedy = "give the file that atomesh wrote with its parts beside it, or merge the parts into \
                      one .vtu (ParaView: Merge Blocks, Clean to Grid)";
        Error::Mesh(cause(path.display(), problem, remedy))
    };
    let (mut corners, mut fields) = (Vec::new(), None);
    // Global numbers and positions of the nodes of all parts, one part after the other.
    let (mut global_ids, mut positions) = (Vec::<usize>::new(), Vec::new());
    let (mut point_data, mut cell_data) = (None, None);
    for mut part in parts {
        let is_global_node =
            |array: &DataArray| array.name == GLOBAL_NODE_ARRAY && array.components == 1;
        let Some(index) = part.point_data.iter().position(is_global_node) else {
            return Err(error(
                "has a part without the array 'node' of its nodes' numbers",
            ));
        };
        let part_ids = part.point_data.remove(index).values.to_i64();
        let is_valid = |&node: &i64| (0..i64::from(u32::MAX)).contains(&node);
        if !part_ids.iter().all(is_valid) {
            return Err(error("has an invalid node number"));
        }
        corners.extend(
            part.mesh
                .connectivity()
                .iter()
                .map(|&i| part_ids[i as usize] as u32),
        );
        global_ids.extend(part_ids.iter().map(|&node| node as usize));
        positions.extend_from_slice(part.mesh.nodes());
        append_arrays(&mut point_data, part.point_data)
            .and_then(|()| append_arrays(&mut cell_data, part.cell_data))
            .ok_or_else(|| error("has parts with different arrays"))?;
        fields.get_or_insert(part.field_data);
    }
    let count = global_ids.iter().max().map_or(0, |max| max + 1);
    if count > global_ids.len() {
        return Err(error("lacks some of its nodes: a part is missing"));
    }
    let mut first = vec![NONE; count];
    for (i, &node) in global_ids.iter().enumerate().rev() {
        first[node] = i as u32;
    }
    if first.contains(&NONE) {
        return Err(error("lacks some of its nodes: a part is missing"));
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

/// Appends the arrays of the next part; `None` if it has other arrays.
fn append_arrays(all: &mut Option<Vec<DataArray>>, next: Vec<DataArray>) -> Option<()> {
    let Some(all) = all else {
        *all = Some(next);
        return Some(());
    };
    if all.len() != next.len() {
        return None;
    }
    for (all, next) in all.iter_mut().zip(next) {
        let is_same = all.name == next.name && all.components == next.components;
        if !(is_same && Values::append(&mut all.values, next.values)) {
            return None;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh_file::pvtu::{extract_partition, write_partition};
    use crate::store::write_vtu;

    /// Returns a strip of tetrahedra, with arrays of several types.
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
    fn concatenated_parts_are_the_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let global = mesh();
        for count in [1, 2, 3, 8, 11] {
            let path = folder.path().join(format!("mesh{count}.pvtu"));
            for part in (0..count).rev() {
                let partition = extract_partition(global.clone(), part, count);
                write_partition(&path, &partition, part, count).unwrap();
            }
            let read = read_any_vtu(&path).unwrap();
            assert!(read == AnyMesh::Tetrahedra(global.clone()), "{count}");
        }
        std::fs::remove_file(folder.path().join("mesh3_0001.vtu")).unwrap();
        let missing = read_any_vtu(&folder.path().join("mesh3.pvtu")).unwrap_err();
        assert!(missing.to_string().contains("mesh3_0001.vtu"), "{missing}");
        // Parts of another mesh.
        let other_mesh = extract_partition(global.clone(), 0, 8);
        for part in 1..5 {
            let path = folder.path().join(format!("mesh8_000{part}.vtu"));
            write_vtu(&path, &other_mesh).unwrap();
        }
        let error = read_any_vtu(&folder.path().join("mesh8.pvtu")).unwrap_err();
        assert!(error.to_string().contains("a part is missing"), "{error}");
        let without_arrays = MeshFile {
            cell_data: Vec::new(),
            ..other_mesh
        };
        write_vtu(&folder.path().join("mesh2_0001.vtu"), &without_arrays).unwrap();
        let error = read_any_vtu(&folder.path().join("mesh2.pvtu")).unwrap_err();
        assert!(error.to_string().contains("different arrays"), "{error}");
    }
}
