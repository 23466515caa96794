//! Meshes that other programs wrote: Gmsh's and Exodus.
//!
//! - `gmsh`: `.msh`, versions 2.2 and 4.1, text and binary
//! - `exodus`: Exodus II in NetCDF's classic formats
//! - `netcdf`: these formats
//!
//! They become what our own files are: polyhedra, or tetrahedra with their region, and the faces within the mesh that
//! belong to surfaces as faces on features, with the surfaces' names; or triangles of the plane.

mod exodus;
mod gmsh;
mod netcdf;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::labels::{LabelledRegion, regions_field};
use super::named_surfaces::NamedSurfaces;
use super::output::HORIZON_FACES_ARRAY;
use super::vtu::{read_any_vtu, read_arrays, read_cell_integers, read_count, read_nodes};
use super::{AnyMesh, FieldValue, MeshFile};
use crate::error::{cause, io_error};
use crate::files::open;
use crate::files::vtk::{DataArray, VtkFile};
use crate::image::LabelValue;
use crate::mesh::complex::NONE;
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::{Error, Result};

/// Reads a mesh: ours, VTK's, Gmsh's or Exodus'; which, its first bytes say.
///
/// # Errors
/// As [`read_any_vtu`]; [`Error::Mesh`] for what is damaged or holds other cells than simplices.
pub fn read_any_mesh(path: &Path) -> Result<AnyMesh> {
    use std::io::Read;
    let mut first = Vec::new();
    let file = open(path, "give a mesh")?;
    let read = file.take(16).read_to_end(&mut first);
    read.map_err(|e| io_error(path, "read", e))?;
    let all = || fs::read(path).map_err(|e| io_error(path, "read", e));
    let mesh = if first.starts_with(b"$MeshFormat") || first.starts_with(b"$Comments") {
        gmsh::read(&all()?).and_then(ForeignMesh::into_mesh)
    } else if first.starts_with(b"CDF") {
        exodus::read(&all()?)
    } else if first.starts_with(b"\x89HDF") {
        Err(FileProblem {
            problem: "is HDF5, or NetCDF-4 on it".into(),
            remedy: "write NetCDF's classic format (nccopy -k 64-bit-offset), or .vtu",
        })
    } else {
        return read_any_vtu(path);
    };
    mesh.map_err(|fault| Error::Mesh(cause(path.display(), fault.problem, fault.remedy)))
}

/// VTK's numbers of vertices, lines, triangles and tetrahedra, with their corners.
const SIMPLEX_TYPES: [(i64, usize); 4] = [(1, 1), (3, 2), (5, 3), (10, 4)];
/// Arrays of cells that programs (ours, Gmsh through meshio, Medit, GEOS) number regions by.
pub(super) const REGION_ARRAYS: [&str; 5] = [
    "region",
    "gmsh:physical",
    "medit:ref",
    "attribute",
    "CellEntityIds",
];

/// The name of faces on features that make no surface in our exports.
const SCRAPS_NAME: &str = "scraps";

/// Whether VTK's cells are tetrahedra with triangles, lines or vertices beside them.
pub(super) fn is_mixed(types: &[i64]) -> bool {
    let small = |kind: &i64| SIMPLEX_TYPES.iter().any(|(known, _)| known == kind);
    types.iter().all(small) && types.contains(&10) && types.iter().any(|kind| *kind != 10)
}

/// A mesh of such cells: triangles within it lie on features.
pub(super) fn read_mixed(path: &Path, file: &VtkFile, types: &[i64]) -> Result<AnyMesh> {
    let piece = file.piece()?;
    let points = read_count(file, piece, "NumberOfPoints")?;
    let cells = file.child(piece, "Cells")?;
    let (ends, corners) = (
        read_cell_integers(file, cells, "offsets")?,
        read_cell_integers(file, cells, "connectivity")?,
    );
    let arrays = read_arrays(file, piece, "CellData", types.len())?;
    let named = |name: &&str| arrays.iter().find(|a| a.name == *name && a.components == 1);
    let regions = REGION_ARRAYS
        .iter()
        .find_map(named)
        .map(|array| array.values.to_i64());
    let damaged = || file.error("has cells of other nodes than it says", "write it again");
    let mut foreign = ForeignMesh {
        nodes: read_nodes(file, file.child(piece, "Points")?, points)?,
        ..ForeignMesh::default()
    };
    let mut begin = 0;
    for (c, kind) in types.iter().enumerate() {
        let size = SIMPLEX_TYPES
            .iter()
            .find(|(known, _)| known == kind)
            .map_or(0, |(_, size)| *size);
        let end = usize::try_from(*ends.get(c).ok_or_else(damaged)?).map_err(|_| damaged())?;
        let nodes = corners.get(begin..end).filter(|nodes| nodes.len() == size);
        let node = |k: usize| u32::try_from(nodes.map_or(-1, |nodes| nodes[k]));
        let all = |k: usize| node(k).map_err(|_| damaged());
        let region = regions.as_ref().map_or(0, |regions| regions[c] as i32);
        match size {
            4 => foreign
                .tets
                .push(([all(0)?, all(1)?, all(2)?, all(3)?], region)),
            3 => foreign
                .triangles
                .push(([all(0)?, all(1)?, all(2)?], region)),
            _ if nodes.is_none() => return Err(damaged()),
            _ => {}
        }
        begin = end;
    }
    let fault =
        |fault: FileProblem| Error::Mesh(cause(path.display(), fault.problem, fault.remedy));
    foreign.into_mesh().map_err(fault)
}

/// What is wrong with a file.
#[derive(Debug)]
struct FileProblem {
    problem: String,
    remedy: &'static str,
}

impl FileProblem {
    /// Of a file that is not as its format says.
    fn damaged(problem: impl Into<String>) -> Self {
        Self {
            problem: problem.into(),
            remedy: "write it again",
        }
    }
}

type ReadResult<T> = std::result::Result<T, FileProblem>;

/// A mesh as formats of finite elements have it.
#[derive(Debug, Default)]
struct ForeignMesh {
    nodes: Vec<[f64; 3]>,
    /// Corners of tetrahedra, each with the number of its region.
    tets: Vec<([u32; 4], i32)>,
    /// Corners of triangles, with regions: the cells of a mesh of the plane, else faces.
    triangles: Vec<([u32; 3], i32)>,
    /// Ends of edges, each with the number of its group: faces of a mesh of the plane.
    edges: Vec<([u32; 2], i32)>,
    /// Names of regions.
    names: BTreeMap<i32, String>,
    /// Names of groups of faces.
    face_names: BTreeMap<i32, String>,
}

impl ForeignMesh {
    /// The mesh that it is.
    fn into_mesh(self) -> ReadResult<AnyMesh> {
        let count = self.nodes.len();
        let used = |corners: &[u32]| corners.iter().all(|&n| (n as usize) < count);
        let known = self.tets.iter().all(|(t, _)| used(t))
            && self.triangles.iter().all(|(t, _)| used(t))
            && self.edges.iter().all(|(e, _)| used(e));
        if !known {
            return Err(FileProblem::damaged(
                "has a cell of nodes that it does not have",
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
                problem: "holds neither tetrahedra nor triangles".into(),
                remedy: "give a mesh of these",
            });
        }
        let off = |&n: &u32| self.nodes[n as usize][2] != 0.0;
        if self.triangles.iter().any(|(t, _)| t.iter().any(off)) {
            return Err(FileProblem {
                problem: "holds triangles off the plane z = 0, but no tetrahedra".into(),
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

/// Simplices of `N` nodes with their regions, and with marks on the faces within the mesh, which have the
/// numbers of groups and these names; nodes that no cell has are left out, and cells turned to be positive.
fn simplex_mesh_file<const D: usize, M: Simplices<D>, const N: usize>(
    nodes: &[[f64; D]],
    cells: &[([u32; N], i32)],
    mut faces: Vec<([u32; D], i32)>,
    face_names: &BTreeMap<i32, String>,
    names: &BTreeMap<i32, String>,
) -> ReadResult<MeshFile<M>> {
    let mut place = vec![NONE; nodes.len()];
    for &n in cells.iter().flat_map(|(corners, _)| corners) {
        place[n as usize] = 0;
    }
    let mut kept = Vec::new();
    for (place, &x) in place.iter_mut().zip(nodes) {
        if *place == 0 {
            *place = kept.len() as u32;
            kept.push(x);
        }
    }
    let corners = cells.iter().flat_map(|(corners, _)| corners);
    let corners: Vec<u32> = corners.map(|&n| place[n as usize]).collect();
    let mut mesh = M::from_parts(kept, corners);
    let turned: Vec<usize> = (0..mesh.len()).filter(|&c| mesh.volume(c) < 0.0).collect();
    for c in turned {
        mesh.parts_mut().1.swap(N * c + N - 2, N * c + N - 1);
    }
    let neighbors = mesh.neighbors().map_err(|face| {
        FileProblem::damaged(format!("more than two cells share the face {face:?}"))
    })?;
    for (face, _) in &mut faces {
        *face = face.map(|n| place[n as usize]);
        face.sort_unstable();
    }
    faces.sort_unstable();
    // The groups of the face of a cell, if it is within the mesh.
    let groups = |c: usize, k: usize| {
        let mut face = mesh.face(c, k);
        face.sort_unstable();
        let within = neighbors[N * c + k] != NONE;
        let first = faces.partition_point(|(known, _)| *known < face);
        let same = faces[first..]
            .iter()
            .take_while(move |(known, _)| within && *known == face);
        same.map(|(_, group)| *group).collect::<Vec<i32>>()
    };
    let called = NamedFaces::new(face_names);
    let bits = |is: &dyn Fn(usize, usize) -> bool| -> Vec<u8> {
        let of_cell = |c: usize| (0..N).map(|k| u8::from(is(c, k)) << k).sum();
        (0..mesh.len()).map(of_cell).collect()
    };
    let marks = bits(&|c, k| !groups(c, k).is_empty());
    let horizons = bits(&|c, k| called.has_horizon(&groups(c, k)));
    let mut on = Vec::new();
    for (c, k) in (0..mesh.len()).flat_map(|c| (0..N).map(move |k| (c, k))) {
        let beyond = neighbors[N * c + k];
        if beyond as usize > c
            && let Some(place) = called.name_index(&groups(c, k))
        {
            on.push(([c as u32, beyond], place));
        }
    }
    let regions: Vec<i32> = cells.iter().map(|(_, region)| *region).collect();
    let mut field_data = called.named_surfaces(on).into_fields();
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

/// The names of groups of faces that make surfaces.
struct NamedFaces {
    groups: Vec<i32>,
    names: Vec<String>,
}

impl NamedFaces {
    fn new(groups: &BTreeMap<i32, String>) -> Self {
        let called = groups
            .iter()
            .map(|(&group, name)| (group, sanitized_name(name)));
        let (groups, names) = called
            .filter(|(_, name)| !name.is_empty() && name != SCRAPS_NAME)
            .unzip();
        Self { groups, names }
    }

    /// The place among the names of that of a face in these groups, if one of them has a name.
    fn name_index(&self, groups: &[i32]) -> Option<u32> {
        let at = self.groups.iter().position(|own| groups.contains(own));
        at.map(|at| at as u32)
    }

    /// Whether one of these groups is a horizon, by its name.
    fn has_horizon(&self, groups: &[i32]) -> bool {
        let mut own = self.groups.iter().zip(&self.names);
        own.any(|(group, name)| {
            groups.contains(group) && name.to_ascii_lowercase().starts_with("horizon")
        })
    }

    /// The surfaces of faces between two cells, each with the place of its name.
    fn named_surfaces(&self, faces: Vec<([u32; 2], u32)>) -> NamedSurfaces {
        NamedSurfaces::new(&self.names, faces)
    }

    /// The field of faces of polyhedra on horizons: pairs of cells.
    fn horizons_field(pairs: Vec<i64>) -> Option<(String, FieldValue)> {
        (!pairs.is_empty()).then(|| (HORIZON_FACES_ARRAY.into(), FieldValue::Ints(pairs)))
    }
}

/// The field that says what regions are called; none if none has a name.
fn labels_field(regions: &[i32], names: &BTreeMap<i32, String>) -> Option<(String, FieldValue)> {
    if names.is_empty() {
        return None;
    }
    let mut known = regions.to_vec();
    known.sort_unstable();
    known.dedup();
    let labels = known.iter().map(|&region| LabelledRegion {
        region,
        label: LabelValue::Whole(region.into()),
        name: names.get(&region).cloned(),
    });
    regions_field(&labels.collect::<Vec<_>>())
}

/// The region that a name of ours stands for: `region7` is 7.
fn region_number(name: &str) -> Option<i32> {
    name.strip_prefix("region")?.replace('_', "-").parse().ok()
}

/// Gives regions the numbers that their names stand for, if these are numbers that no other has; other
/// names are kept as far as exports can hold them.
fn assign_regions(groups: BTreeMap<i32, String>) -> (BTreeMap<i32, i32>, BTreeMap<i32, String>) {
    let numbers: BTreeMap<i32, i32> = (groups.iter())
        .filter_map(|(&group, name)| Some((group, region_number(name)?)))
        .collect();
    let free = |number: &i32| !groups.contains_key(number) || numbers.contains_key(number);
    if !numbers.is_empty() && numbers.values().all(free) {
        let rest = groups
            .into_iter()
            .filter(|(group, _)| !numbers.contains_key(group));
        let names = sanitized_names(rest);
        return (numbers, names);
    }
    (BTreeMap::new(), sanitized_names(groups))
}

fn sanitized_names(groups: impl IntoIterator<Item = (i32, String)>) -> BTreeMap<i32, String> {
    let named = groups
        .into_iter()
        .filter(|(_, name)| !name.trim().is_empty());
    named
        .map(|(group, name)| (group, sanitized_name(&name)))
        .collect()
}

/// A name as far as exports can hold it.
fn sanitized_name(name: &str) -> String {
    let plain = |c: char| match c.is_ascii_alphanumeric() || c == '-' {
        true => c,
        false => '_',
    };
    name.trim().chars().take(60).map(plain).collect()
}

#[cfg(test)]
mod tests;
