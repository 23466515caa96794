//! Reads meshes that other programs wrote: Gmsh and Exodus.
//!
//! - `gmsh`: `.msh`, versions 2.2 and 4.1, text and binary
//! - `exodus`: Exodus II in NetCDF's classic formats
//! - `netcdf`: NetCDF's classic formats
//!
//! The result has the form of our own files: polyhedra; or tetrahedra with their regions, where the
//! faces inside the mesh that belong to surfaces are faces on features, with the names of the
//! surfaces; or triangles in the plane.

mod exodus;
mod gmsh;
mod netcdf;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::labels::{LabelledRegion, regions_field};
use super::named_surfaces::NamedSurfaces;
use super::output::HORIZON_FACES_ARRAY;
use super::vtu::{read_any_vtu, read_arrays, read_cell_nodes, read_count, read_nodes};
use super::{AnyMesh, FieldValue, MeshFile};
use crate::error::{cause, io_error};
use crate::files::open;
use crate::files::vtk::{DataArray, VtkFile};
use crate::geometry::{sorted, sorted_distinct};
use crate::image::LabelValue;
use crate::mesh::complex::NONE;
use crate::mesh::renumber::{new_numbers, used_items};
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::names;
use crate::{Error, Result};

/// Reads a mesh in our format, VTK's, Gmsh's or Exodus', which is recognised by its first bytes.
///
/// # Errors
/// Returns the errors of [`read_any_vtu`], and [`Error::Mesh`] for a file that is damaged or has
/// cells of an unsupported type.
pub fn read_any_mesh(path: &Path) -> Result<AnyMesh> {
    use std::io::Read;
    let mut head = Vec::new();
    let file = open(path, "give the file of a mesh")?;
    let bytes_read = file.take(16).read_to_end(&mut head);
    bytes_read.map_err(|e| io_error(path, "read", e))?;
    let read_all = || fs::read(path).map_err(|e| io_error(path, "read", e));
    let mesh = if head.starts_with(b"$MeshFormat") || head.starts_with(b"$Comments") {
        gmsh::read(&read_all()?).and_then(ForeignMesh::into_mesh)
    } else if head.starts_with(b"CDF") {
        exodus::read(&read_all()?)
    } else if head.starts_with(b"\x89HDF") {
        Err(FileProblem {
            problem: "is an HDF5 file, perhaps NetCDF-4".into(),
            remedy: "write NetCDF's classic format (nccopy -k 64-bit-offset), or .vtu",
        })
    } else {
        return read_any_vtu(path);
    };
    mesh.map_err(|fault| fault.at(path))
}

/// VTK's types of vertices, lines, triangles and tetrahedra.
const SIMPLEX_TYPES: [i64; 4] = [1, 3, 5, 10];
/// Cell arrays in which programs (ours, Gmsh through meshio, Medit, GEOS) store region numbers.
pub(super) const REGION_ARRAYS: [&str; 5] = [
    "region",
    "gmsh:physical",
    "medit:ref",
    "attribute",
    "CellEntityIds",
];

/// Name in our exports of faces on features that belong to no surface.
const SCRAPS_NAME: &str = "scraps";

/// Returns `true` if a file has tetrahedra together with triangles, lines or vertices.
pub(super) fn is_mixed(types: &[i64]) -> bool {
    types.iter().all(|kind| SIMPLEX_TYPES.contains(kind))
        && types.contains(&10)
        && types.iter().any(|kind| *kind != 10)
}

/// Reads a mesh of tetrahedra together with triangles, lines or vertices. Triangles inside the mesh
/// are faces on features.
pub(super) fn read_mixed(path: &Path, file: &VtkFile, types: &[i64]) -> Result<AnyMesh> {
    let piece = file.piece()?;
    let points = read_count(file, piece, "NumberOfPoints")?;
    let cells = file.child(piece, "Cells")?;
    let corners = read_cell_nodes(file, cells, types.len())?;
    let arrays = read_arrays(file, piece, "CellData", types.len())?;
    let is_scalar = |name: &&str| arrays.iter().find(|a| a.name == *name && a.components == 1);
    let regions = REGION_ARRAYS
        .iter()
        .find_map(is_scalar)
        .map(|array| array.values.to_i64());
    let mut foreign = ForeignMesh {
        nodes: read_nodes(file, file.child(piece, "Points")?, points)?,
        ..ForeignMesh::default()
    };
    for (c, kind) in types.iter().enumerate() {
        let region = regions.as_ref().map_or(0, |regions| regions[c] as i32);
        match (*kind, corners.get(c)) {
            (1, [_]) | (3, [_, _]) => {}
            (5, &[i, j, k]) => foreign.triangles.push(([i, j, k], region)),
            (10, &[i, j, k, l]) => foreign.tets.push(([i, j, k, l], region)),
            _ => {
                return Err(file.error(
                    "has cells with a wrong number of nodes",
                    crate::files::REWRITE_DAMAGED,
                ));
            }
        }
    }
    foreign.into_mesh().map_err(|fault| fault.at(path))
}

/// A problem of a file, and its remedy.
#[derive(Debug)]
struct FileProblem {
    problem: String,
    remedy: &'static str,
}

impl FileProblem {
    /// Returns the problem of a file that does not follow its format.
    fn damaged(problem: impl Into<String>) -> Self {
        Self {
            problem: problem.into(),
            remedy: crate::files::REWRITE_DAMAGED,
        }
    }

    /// Returns the error of the file at `path`.
    fn at(self, path: &Path) -> Error {
        Error::Mesh(cause(path.display(), self.problem, self.remedy))
    }
}

type ReadResult<T> = std::result::Result<T, FileProblem>;

/// A mesh as finite-element formats store it.
#[derive(Debug, Default)]
struct ForeignMesh {
    nodes: Vec<[f64; 3]>,
    /// Corners of tetrahedra, each with the number of its region.
    tets: Vec<([u32; 4], i32)>,
    /// Corners of triangles, with region numbers: the cells of a 2-D mesh, the faces of a 3-D mesh.
    triangles: Vec<([u32; 3], i32)>,
    /// Ends of edges, each with the number of its group: the faces of a 2-D mesh.
    edges: Vec<([u32; 2], i32)>,
    /// Names of regions.
    names: BTreeMap<i32, String>,
    /// Names of groups of faces.
    face_names: BTreeMap<i32, String>,
}

impl ForeignMesh {
    /// Converts to a mesh file of tetrahedra or triangles.
    fn into_mesh(self) -> ReadResult<AnyMesh> {
        let count = self.nodes.len();
        let are_valid = |corners: &[u32]| corners.iter().all(|&n| (n as usize) < count);
        let is_valid = self.tets.iter().all(|(t, _)| are_valid(t))
            && self.triangles.iter().all(|(t, _)| are_valid(t))
            && self.edges.iter().all(|(e, _)| are_valid(e));
        if !is_valid {
            return Err(FileProblem::damaged(
                "has a cell with a node that does not exist",
            ));
        }
        if let Some(node) = self
            .nodes
            .iter()
            .position(|x| x.iter().any(|c| !c.is_finite()))
        {
            return Err(FileProblem::damaged(format!("node {node} is not finite")));
        }
        if !self.tets.is_empty() {
            let (faces, names) = (self.triangles, &self.face_names);
            let file = simplex_mesh_file::<3, TetMesh, 4>(
                &self.nodes,
                &self.tets,
                faces,
                names,
                &self.names,
            )?;
            return Ok(AnyMesh::Tetrahedra(file));
        }
        if self.triangles.is_empty() {
            return Err(FileProblem {
                problem: "has neither tetrahedra nor triangles".into(),
                remedy: "give a mesh of tetrahedra or triangles",
            });
        }
        let is_off_plane = |&n: &u32| self.nodes[n as usize][2] != 0.0;
        if self
            .triangles
            .iter()
            .any(|(t, _)| t.iter().any(is_off_plane))
        {
            return Err(FileProblem {
                problem: "has triangles off the plane z = 0, but no tetrahedra".into(),
                remedy: "give the mesh of the volume, or one of that plane",
            });
        }
        let nodes: Vec<[f64; 2]> = self.nodes.iter().map(|x| [x[0], x[1]]).collect();
        let names = &self.face_names;
        let file = simplex_mesh_file::<2, TriMesh, 3>(
            &nodes,
            &self.triangles,
            self.edges,
            names,
            &self.names,
        )?;
        Ok(AnyMesh::Triangles(file))
    }
}

/// Creates a mesh of simplices with `N` nodes, with regions, and with marks on the inner faces that
/// belong to groups. `face_names` are the names of groups of faces, `names` those of regions.
/// Unused nodes are removed, and cells are oriented positively.
fn simplex_mesh_file<const D: usize, M: Simplices<D>, const N: usize>(
    nodes: &[[f64; D]],
    cells: &[([u32; N], i32)],
    mut faces: Vec<([u32; D], i32)>,
    face_names: &BTreeMap<i32, String>,
    names: &BTreeMap<i32, String>,
) -> ReadResult<MeshFile<M>> {
    let corners = cells.iter().flat_map(|(corners, _)| corners);
    let kept = used_items(nodes.len(), corners.clone().copied());
    let new_index = new_numbers(nodes.len(), &kept);
    let corners: Vec<u32> = corners.map(|&n| new_index[n as usize]).collect();
    let kept = kept.iter().map(|&n| nodes[n as usize]).collect();
    let mut mesh = M::from_parts(kept, corners);
    let inverted: Vec<usize> = (0..mesh.len()).filter(|&c| mesh.volume(c) < 0.0).collect();
    for c in inverted {
        mesh.parts_mut().1.swap(N * c + N - 2, N * c + N - 1);
    }
    let neighbors = mesh.neighbors().map_err(|face| {
        FileProblem::damaged(format!("more than two cells share the face {face:?}"))
    })?;
    for (face, _) in &mut faces {
        *face = sorted(face.map(|n| new_index[n as usize]));
    }
    faces.sort_unstable();
    // Returns the groups of a face of a cell, if the face is inside the mesh.
    let groups = |c: usize, k: usize| {
        let face = sorted(mesh.face(c, k));
        let is_inner = neighbors[N * c + k] != NONE;
        let first = faces.partition_point(|(known, _)| *known < face);
        let matching = faces[first..]
            .iter()
            .take_while(move |(known, _)| is_inner && *known == face);
        matching.map(|(_, group)| *group).collect::<Vec<i32>>()
    };
    let named_faces = NamedFaces::new(face_names);
    let face_bits = |is_set: &dyn Fn(usize, usize) -> bool| -> Vec<u8> {
        let bits_of_cell = |c: usize| (0..N).map(|k| u8::from(is_set(c, k)) << k).sum::<u8>();
        (0..mesh.len()).map(bits_of_cell).collect()
    };
    let marks = face_bits(&|c, k| !groups(c, k).is_empty());
    let horizons = face_bits(&|c, k| named_faces.has_horizon(&groups(c, k)));
    let mut named = Vec::new();
    for (c, k) in (0..mesh.len()).flat_map(|c| (0..N).map(move |k| (c, k))) {
        let beyond = neighbors[N * c + k];
        if beyond as usize > c
            && let Some(name_index) = named_faces.name_index(&groups(c, k))
        {
            named.push(([c as u32, beyond], name_index));
        }
    }
    let regions: Vec<i32> = cells.iter().map(|(_, region)| *region).collect();
    let mut field_data = named_faces.named_surfaces(named).into_fields();
    field_data.extend(labels_field(&regions, names));
    let mut cell_data = vec![
        DataArray::scalars("region", regions),
        DataArray::scalars(M::FEATURE_FACES_ARRAY, marks),
    ];
    if horizons.iter().any(|&bits| bits > 0) {
        cell_data.push(DataArray::scalars(HORIZON_FACES_ARRAY, horizons));
    }
    Ok(MeshFile {
        mesh,
        point_data: Vec::new(),
        cell_data,
        field_data,
    })
}

/// Names of groups of faces that are surfaces.
struct NamedFaces {
    groups: Vec<i32>,
    names: Vec<String>,
}

impl NamedFaces {
    fn new(groups: &BTreeMap<i32, String>) -> Self {
        let (groups, names) = named_groups(groups.clone())
            .into_iter()
            .filter(|(_, name)| name != SCRAPS_NAME)
            .unzip();
        Self { groups, names }
    }

    /// Returns the index of the name of a face in these groups, if one of them has a name.
    fn name_index(&self, groups: &[i32]) -> Option<u32> {
        let index = self.groups.iter().position(|known| groups.contains(known));
        index.map(|i| i as u32)
    }

    /// Returns `true` if the name of one of these groups marks it as a horizon.
    fn has_horizon(&self, groups: &[i32]) -> bool {
        let mut known = self.groups.iter().zip(&self.names);
        known.any(|(group, name)| {
            groups.contains(group) && name.to_ascii_lowercase().starts_with("horizon")
        })
    }

    /// Returns the named surfaces; `faces` are pairs of cells with the index of a name.
    fn named_surfaces(&self, faces: Vec<([u32; 2], u32)>) -> NamedSurfaces {
        NamedSurfaces::new(&self.names, faces)
    }

    /// Returns the field that lists the faces of polyhedra on horizons, as pairs of cells.
    fn horizons_field(pairs: Vec<i64>) -> Option<(String, FieldValue)> {
        (!pairs.is_empty()).then(|| (HORIZON_FACES_ARRAY.into(), FieldValue::Ints(pairs)))
    }
}

/// Returns the field with the names of regions, or `None` if no region has a name.
fn labels_field(regions: &[i32], names: &BTreeMap<i32, String>) -> Option<(String, FieldValue)> {
    if names.is_empty() {
        return None;
    }
    let numbers = sorted_distinct(regions.iter().copied());
    let labels = numbers.iter().map(|&region| LabelledRegion {
        region,
        label: LabelValue::Whole(region.into()),
        name: names.get(&region).cloned(),
    });
    regions_field(&labels.collect::<Vec<_>>())
}

/// Returns the region number in one of our region names: 7 for `region7`.
fn region_number(name: &str) -> Option<i32> {
    name.strip_prefix("region")?.replace('_', "-").parse().ok()
}

/// Returns new numbers for regions whose names contain numbers (`region7`), if no other region has
/// these numbers, and the names of the other regions.
fn assign_regions(groups: BTreeMap<i32, String>) -> (BTreeMap<i32, i32>, BTreeMap<i32, String>) {
    let numbers: BTreeMap<i32, i32> = (groups.iter())
        .filter_map(|(&group, name)| Some((group, region_number(name)?)))
        .collect();
    let is_free = |number: &i32| !groups.contains_key(number) || numbers.contains_key(number);
    if !numbers.is_empty() && numbers.values().all(is_free) {
        let others = groups
            .into_iter()
            .filter(|(group, _)| !numbers.contains_key(group));
        let names = named_groups(others);
        return (numbers, names);
    }
    (BTreeMap::new(), named_groups(groups))
}

/// Returns the groups that have names.
fn named_groups(groups: impl IntoIterator<Item = (i32, String)>) -> BTreeMap<i32, String> {
    let names = groups.into_iter();
    let names = names.map(|(group, name)| (group, names::from_file(&name)));
    names.filter(|(_, name)| !name.is_empty()).collect()
}

#[cfg(test)]
mod tests;
