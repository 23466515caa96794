//! Reads VTK unstructured grids of polyhedra (cell type 42) or, in 2-D, polygons (7).
//!
//! VTK stores the faces of every polyhedron with it, oriented outwards, so each face between two
//! cells is in the file twice. Reading joins the two copies and restores the same faces in the same
//! order. Sites and regions are cell data. Faces on features are a list of pairs of cells in the
//! field data.

use crate::geometry::sorted;
use crate::parallel::prelude::*;

use super::foreign::region_arrays;
use super::vtu::{
    self, read_arrays, read_cell_integers, read_cell_values, read_fields, read_nodes,
};
use crate::error::{Error, Result};
use crate::files::vtk::VtkFile;
use crate::files::vtk::xml::Element;
use crate::geometry::NONE;
use crate::mesh::poly::{Lists, PolyMesh};
use crate::mesh::{Mesh, TriMesh};
use crate::mesh_file::array_names::{FEATURE_FACES_FIELD, REGION_ARRAY, SITE_ARRAY};
use crate::mesh_file::{FieldValue, MeshFile};

/// VTK's type of quadrilaterals.
const VTK_QUADRILATERAL: u8 = 9;

/// Reads a mesh of polyhedra or polygons that atomesh, VTK or ParaView wrote. Faces on the boundary
/// have [`NONE`] beyond them. If the file has no sites, each cell's site is the mean of its
/// nodes. Adds notes for the user.
///
/// # Errors
/// Returns [`Error::Io`](crate::Error::Io) if the file is damaged, has cells of other types, or if
/// three cells share a face.
pub(super) fn read_cells<const D: usize>(
    file: &VtkFile,
    notes: &mut Vec<String>,
) -> Result<MeshFile<PolyMesh<D>>> {
    let piece = file.piece()?;
    let points = vtu::read_count(file, piece, "NumberOfPoints")?;
    let count = vtu::read_count(file, piece, "NumberOfCells")?;
    let nodes = read_nodes(file, file.child(piece, "Points")?, points)?;
    let element = file.child(piece, "Cells")?;
    let types = read_cell_integers(file, element, "types")?;
    let kind = i64::from(PolyMesh::<D>::VTK_CELL);
    let is_expected = |t: i64| if D == 2 { is_polygon(t) } else { t == kind };
    if let Some(cell) = types.iter().position(|&t| !is_expected(t)) {
        let problem = format!(
            "cell {cell} is of VTK's type {}, not {kind} like the first",
            types[cell]
        );
        return Err(file.error(problem, "give a mesh of one kind of cells"));
    }
    let damaged = |part: &str| damaged_error(file, part);
    // The stream has the nodes of all faces of all cells.
    let numbers = |name: &str| {
        let numbers = read_cell_values(file, element, name)?.to_u32();
        numbers.ok_or_else(|| damaged("their nodes do not exist"))
    };
    let (stream, ends) = if D == 2 {
        (
            numbers("connectivity")?,
            read_cell_integers(file, element, "offsets")?,
        )
    } else {
        face_streams(file, element)?
    };
    let too_many = points.max(stream.len()) >= u32::MAX as usize;
    if types.len() != count || ends.len() != count || too_many {
        return Err(damaged("their arrays differ in length"));
    }
    let mut sides = CellFaces::default();
    let mut start = 0;
    for (cell, &end) in ends.iter().enumerate() {
        let end = usize::try_from(end)
            .ok()
            .filter(|&end| end <= stream.len() && end >= start);
        let cell_stream = &stream[start..end.ok_or_else(|| damaged("their offsets are wrong"))?];
        start += cell_stream.len();
        let added = sides.push_stream::<D>(cell as u32, cell_stream);
        added.ok_or_else(|| damaged("their faces are wrong"))?;
    }
    drop(stream);
    if sides.rings.items.iter().any(|&n| n as usize >= points) {
        return Err(damaged("their nodes do not exist"));
    }
    let mut mesh = (sides.to_mesh::<D>(nodes, count))
        .ok_or_else(|| damaged("a face belongs to three cells"))?;

    let mut cell_data = read_arrays(file, piece, "CellData", count)?;
    let mut field_data = read_fields(file)?;
    notes.extend(region_arrays::adopt(&mut cell_data, &mut field_data));
    let mut take = |name: &str| {
        let index = cell_data.iter().position(|a| a.name == name)?;
        Some(cell_data.remove(index).values)
    };
    if let Some(values) = take(REGION_ARRAY) {
        mesh.region = values.to_i64().iter().map(|&r| r as i32).collect();
    }
    match take(SITE_ARRAY).map(|values| values.to_f64()) {
        Some(sites) if sites.len() == 3 * count => {
            let site = |s: &[f64]| std::array::from_fn(|k| s[k]);
            mesh.sites = sites.chunks_exact(3).map(site).collect();
        }
        _ => mesh.sites = node_means(&mesh, count),
    }
    if let Some(index) = field_data.iter().position(|f| f.0 == FEATURE_FACES_FIELD)
        && let (_, FieldValue::Ints(pairs)) = field_data.remove(index)
    {
        mark_feature_faces(&mut mesh, &pairs);
    }
    Ok(MeshFile {
        mesh,
        point_data: read_arrays(file, piece, "PointData", points)?,
        cell_data,
        field_data,
    })
}

/// Marks faces as on features; `pairs` are the cells on both sides of each.
fn mark_feature_faces<const D: usize>(mesh: &mut PolyMesh<D>, pairs: &[i64]) {
    let inner = mesh.inner_face_count();
    for pair in pairs.chunks_exact(2) {
        let pair = [pair[0] as u32, pair[1] as u32];
        if let Ok(f) = mesh.face_cells[..inner].binary_search(&pair) {
            mesh.on_feature[f] = true;
        }
    }
}

fn damaged_error(file: &VtkFile, part: &str) -> Error {
    let problem = format!("its cells are damaged: {part}");
    file.error(problem, crate::files::REWRITE_DAMAGED)
}

/// Returns the faces of polyhedra as a stream, and the end of each cell's faces in it. Other cells
/// have none.
pub(super) fn face_streams(file: &VtkFile, element: &Element) -> Result<(Vec<u32>, Vec<i64>)> {
    let numbers = |name: &str| {
        let numbers = read_cell_values(file, element, name)?.to_u32();
        numbers.ok_or_else(|| damaged_error(file, "their nodes"))
    };
    let has = |name: &str| (element.children.iter()).any(|a| a.attribute("Name") == Some(name));
    if has("polyhedron_to_faces") {
        let [nodes, node_ends, faces] =
            ["face_connectivity", "face_offsets", "polyhedron_to_faces"].map(numbers);
        let ends = numbers("polyhedron_offsets")?;
        return read_face_lists(&nodes?, &node_ends?, &faces?, &ends)
            .ok_or_else(|| damaged_error(file, "their faces"));
    }
    Ok((
        numbers("faces")?,
        read_cell_integers(file, element, "faceoffsets")?,
    ))
}

/// Returns `true` if cells of this VTK type are polygons.
pub(super) fn is_polygon(kind: i64) -> bool {
    let kinds = [
        TriMesh::VTK_CELL,
        PolyMesh::<2>::VTK_CELL,
        VTK_QUADRILATERAL,
    ];
    kinds.map(i64::from).contains(&kind)
}

/// Converts polyhedra as VTK writes them since version 9.4 (lists of faces, which are lists of
/// nodes) to the older form: a stream of counts and nodes, and the end of each polyhedron in it.
fn read_face_lists(
    nodes: &[u32],
    node_ends: &[u32],
    faces: &[u32],
    face_ends: &[u32],
) -> Option<(Vec<u32>, Vec<i64>)> {
    let range = |ends: &[u32], i: usize| {
        let begin = if i == 0 { 0 } else { *ends.get(i - 1)? };
        Some(begin as usize..*ends.get(i)? as usize)
    };
    let (mut stream, mut ends) = (Vec::new(), Vec::new());
    for cell in 0..face_ends.len() {
        let cell_faces = faces.get(range(face_ends, cell)?)?;
        stream.push(cell_faces.len() as u32);
        for &face in cell_faces {
            let ring = nodes.get(range(node_ends, face as usize)?)?;
            stream.push(ring.len() as u32);
            stream.extend(ring);
        }
        ends.push(stream.len() as i64);
    }
    Some((stream, ends))
}

/// Calls `visit` with each face in a polyhedron's stream; returns `None` if the stream is invalid.
pub(super) fn for_each_face(stream: &[u32], mut visit: impl FnMut(&[u32])) -> Option<()> {
    let (&count, mut remaining) = stream.split_first()?;
    for _ in 0..count {
        let (&size, tail) = remaining.split_first()?;
        visit(tail.get(..size as usize).filter(|ring| ring.len() >= 3)?);
        remaining = &tail[size as usize..];
    }
    remaining.is_empty().then_some(())
}

/// The faces of all cells of a file; faces between two cells appear twice.
#[derive(Default)]
pub(super) struct CellFaces {
    /// The cell of each face.
    face_cell: Vec<u32>,
    /// The nodes of each face, in order.
    pub rings: Lists,
}

impl CellFaces {
    /// Adds a face of a cell.
    pub fn push(&mut self, cell: u32, ring: &[u32]) {
        self.rings.push(ring.iter().copied());
        self.face_cell.push(cell);
    }

    /// Adds the faces in a cell's stream; `None` if the stream is invalid.
    fn push_stream<const D: usize>(&mut self, cell: u32, stream: &[u32]) -> Option<()> {
        let mut add_face = |ring: &[u32]| self.push(cell, ring);
        if D == 2 {
            let (&[first, _, ..], &[.., last]) = (stream, stream) else {
                return None;
            };
            stream.windows(2).for_each(&mut add_face);
            add_face(&[last, first]);
            return (stream.len() >= 3).then_some(());
        }
        for_each_face(stream, add_face)
    }

    /// Returns the three lowest nodes of a face (both nodes of an edge), ascending. Different faces
    /// rarely have the same key.
    fn sort_key(&self, side: usize) -> [u32; 3] {
        let mut smallest = [u32::MAX; 3];
        for &n in self.rings.get(side) {
            if n < smallest[2] {
                smallest[2] = n;
                if n < smallest[1] {
                    smallest.swap(1, 2);
                }
                if n < smallest[0] {
                    smallest.swap(0, 1);
                }
            }
        }
        smallest
    }

    /// Returns the nodes of a face, ascending.
    fn sorted_nodes(&self, side: u32) -> Vec<u32> {
        sorted(self.rings.get(side as usize).to_vec())
    }

    /// Returns the mesh, or `None` if three cells share a face.
    pub fn to_mesh<const D: usize>(
        &self,
        nodes: Vec<[f64; D]>,
        cells: usize,
    ) -> Option<PolyMesh<D>> {
        let sides = 0..self.face_cell.len();
        let mut order: Vec<([u32; 3], u32)> = sides
            .into_par_iter()
            .map(|i| (self.sort_key(i), i as u32))
            .collect();
        order.par_sort_unstable();
        // The sort order of faces: inner faces first, then by cells, then by position in the file.
        let mut faces: Vec<(bool, [u32; 2], u32)> = Vec::with_capacity(order.len() / 2);
        let mut add_face = |first: u32, second: Option<u32>| {
            let beyond = second.map_or(NONE, |other| self.face_cell[other as usize]);
            faces.push((
                second.is_none(),
                [self.face_cell[first as usize], beyond],
                first,
            ));
        };
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            match *group {
                [(_, side)] => add_face(side, None),
                [(_, first), (_, second)]
                    if self.sorted_nodes(first) == self.sorted_nodes(second) =>
                {
                    add_face(first, Some(second))
                }
                _ => {
                    let sides = group.iter().map(|&(_, i)| (self.sorted_nodes(i), i));
                    let sides: Vec<(Vec<u32>, u32)> = sorted(sides.collect());
                    for same in sides.chunk_by(|a, b| a.0 == b.0) {
                        match *same {
                            [(_, side)] => add_face(side, None),
                            [(_, first), (_, second)] => add_face(first, Some(second)),
                            _ => return None,
                        }
                    }
                }
            }
        }
        drop(order);
        faces.par_sort_unstable();
        let mut mesh = PolyMesh {
            nodes,
            region: vec![0; cells],
            on_feature: vec![false; faces.len()],
            ..PolyMesh::default()
        };
        for (_, cells, side) in faces {
            let ring = self.rings.get(side as usize);
            mesh.faces.push(ring.iter().copied());
            mesh.face_cells.push(cells);
        }
        Some(mesh)
    }
}

/// Returns the mean of each cell's nodes; a node counts once for each face of the cell that uses
/// it.
pub(super) fn node_means<const D: usize>(mesh: &PolyMesh<D>, cells: usize) -> Vec<[f64; D]> {
    let mut sums = vec![([0.0; D], 0.0); cells];
    for (f, owners) in mesh.face_cells.iter().enumerate() {
        for &cell in owners {
            let Some((sum, count)) = sums.get_mut(cell as usize) else {
                continue;
            };
            for &n in mesh.faces.get(f) {
                *sum = std::array::from_fn(|k| sum[k] + mesh.nodes[n as usize][k]);
                *count += 1.0;
            }
        }
    }
    sums.iter()
        .map(|(sum, count)| sum.map(|c| c / count))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::{AnyMesh, read_any_vtu, write_cells_vtu};
    use super::*;
    use crate::files::vtk::DataArray;
    use crate::mesh::poly::samples::two_cells;

    fn round_trip<const D: usize>() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.vtu");
        let mut file = MeshFile {
            mesh: two_cells::<D>(0.75),
            cell_data: vec![DataArray::scalars("volume", vec![0.75, 1.25])],
            field_data: vec![("note".into(), FieldValue::Text("two".into()))],
            ..MeshFile::default()
        };
        write_cells_vtu(&path, &file).unwrap();
        let read_file = VtkFile::read(&path, "UnstructuredGrid").unwrap();
        let read = read_cells::<D>(&read_file, &mut Vec::new()).unwrap();
        let mut mesh = read.mesh;
        assert!(mesh.face_cells[1..].iter().all(|c| c[1] == NONE));
        let mut high = [1.0; D];
        high[0] = 2.0;
        mesh.assign_sides([0.0; D], high);
        // Reading may start a polygon with another edge, which changes the order of boundary faces.
        if D == 3 {
            assert_eq!(mesh, file.mesh);
        } else {
            let report = crate::mesh::check::check(&mesh, [0.0; D], high, 1e-12);
            assert!(report.passed(), "{report:?}");
            assert_eq!((&mesh.sites, mesh.on_feature[0]), (&file.mesh.sites, true));
        }
        assert_eq!(
            (read.cell_data, &read.field_data),
            (file.cell_data.clone(), &file.field_data)
        );
        let any = read_any_vtu(&path).unwrap();
        assert!(matches!(
            (D, any),
            (2, AnyMesh::Polygons(_)) | (3, AnyMesh::Polyhedra(_))
        ));
        file.cell_data.push(DataArray::scalars("short", vec![1u8]));
        assert!(write_cells_vtu(&path, &file).is_err());

        let bytes = std::fs::read(&path).unwrap();
        for end in (0..bytes.len() - 40).step_by(31) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            assert!(read_any_vtu(&path).is_err(), "cut at {end}");
        }
    }

    #[test]
    fn cells_come_back_as_they_were() {
        round_trip::<2>();
        round_trip::<3>();
    }

    #[test]
    fn invalid_streams_are_refused() {
        let add = |stream: &[u32]| CellFaces::default().push_stream::<3>(0, stream);
        for stream in [
            &[][..],
            &[1, 3, 0, 1],
            &[1, 2, 0, 1],
            &[1, u32::MAX, 0, 1],
            &[1, 3, 0, 1, 2, 9],
        ] {
            assert!(add(stream).is_none(), "{stream:?}");
        }
        let mut sides = CellFaces::default();
        assert!(sides.push_stream::<3>(7, &[1, 4, 5, 0, 9, 2]).is_some());
        assert_eq!(
            (sides.rings.get(0), sides.face_cell[0]),
            (&[5, 0, 9, 2][..], 7)
        );
        assert_eq!(sides.sort_key(0), [0, 2, 5]);
        assert!(CellFaces::default().push_stream::<2>(0, &[0, 1]).is_none());
    }

    #[test]
    fn invalid_lists_of_faces_are_refused() {
        let nodes = [0, 2, 1, 0, 1, 3];
        let stream = read_face_lists(&nodes, &[3, 6], &[0, 1], &[2]).unwrap();
        assert_eq!(stream, (vec![2, 3, 0, 2, 1, 3, 0, 1, 3], vec![9]));
        for (node_ends, faces, face_ends) in [
            (&[3, 7], [0, 1], [2]),
            (&[4, 3], [0, 1], [2]),
            (&[3, 6], [0, 2], [2]),
            (&[3, 6], [0, 1], [3]),
        ] {
            assert_eq!(read_face_lists(&nodes, node_ends, &faces, &face_ends), None);
        }
    }

    #[test]
    fn faces_with_the_same_lowest_nodes_are_distinguished() {
        // Two faces of one cell each, and one face of two cells; all have the nodes 0, 1, 2.
        let mut sides = CellFaces::default();
        sides
            .push_stream::<3>(0, &[2, 4, 0, 1, 2, 3, 3, 0, 1, 2])
            .unwrap();
        sides
            .push_stream::<3>(1, &[2, 4, 0, 2, 1, 4, 3, 2, 1, 0])
            .unwrap();
        let mesh = sides.to_mesh::<3>(vec![[0.0; 3]; 5], 2).unwrap();
        assert_eq!(mesh.face_cells, [[0, 1], [0, NONE], [1, NONE]]);
        sides.push_stream::<3>(2, &[1, 3, 0, 1, 2]).unwrap();
        assert!(sides.to_mesh::<3>(vec![[0.0; 3]; 5], 3).is_none());
    }
}
