//! Reads meshes that other programs wrote: Gmsh, Exodus and VTK.
//!
//! - `gmsh`: `.msh`, versions 2.2 and 4.1, text and binary
//! - `exodus`: Exodus II
//! - `netcdf`: NetCDF's classic formats and NetCDF-4
//! - `groups`: regions, surfaces and sets from groups of elements
//! - `region_arrays`: regions from cell arrays of VTK files
//! - `simplices`: meshes of tetrahedra or triangles with groups
//! - `vtkhdf`: unstructured grids in VTKHDF
//!
//! The result has the form of our own files: polyhedra; or tetrahedra with their regions, where the
//! faces inside the mesh that belong to surfaces are faces on features, with the names of the
//! surfaces; or triangles in the plane.

mod exodus;
mod gmsh;
mod groups;
mod netcdf;
pub(super) mod region_arrays;
mod simplices;
mod vtkhdf;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

pub(super) use groups::{Combinations, Group, GroupNames, GroupedFaces};
use simplices::{ForeignMesh, NotedMesh, note_lost, renumber_sets};

use super::named_sets::NamedSets;
use super::vtu::{
    read_any_vtu_with_notes, read_arrays, read_cell_nodes, read_count, read_fields, read_nodes,
    read_vtk_file_with_notes,
};
use super::{AnyMesh, FieldValue, LabelledRegion, MeshFile};
use crate::error::{cause, io_error};
use crate::files::open;
use crate::files::vtk::{DataArray, VtkFile};
use crate::geometry::{sorted, sorted_distinct};
use crate::image::LabelValue;
use crate::image::formats::hdf5::Hdf5Source;
use crate::mesh::poly::PolyMesh;
use crate::mesh::renumber::used_items;
use crate::mesh_file::array_names::{HORIZON_FACES_ARRAY, REGION_ARRAY};
use crate::mesh_file::labels::regions_field;
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::names;
use crate::{Error, Result};

/// Format of a mesh file, by its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MeshFormat {
    Gmsh,
    NetCdf,
    Hdf5,
    /// VTK's formats.
    Vtk,
}

impl MeshFormat {
    /// Returns the format that begins with these bytes; VTK's if it is no other.
    fn from_start(head: &[u8]) -> Self {
        match head {
            _ if head.starts_with(b"$MeshFormat") || head.starts_with(b"$Comments") => Self::Gmsh,
            _ if head.starts_with(b"CDF") => Self::NetCdf,
            _ if head.starts_with(b"\x89HDF") => Self::Hdf5,
            _ => Self::Vtk,
        }
    }

    /// Returns the format of a file if it is a mesh. `head` are its first bytes.
    pub fn of_mesh(path: &Path, head: &[u8]) -> Option<Self> {
        let format = Self::from_start(head);
        let text = String::from_utf8_lossy(head).to_ascii_lowercase();
        let is_grid = |text: &str| {
            let mut words = text.split_ascii_whitespace();
            let is_legacy =
                words.any(|word| word == "dataset") && words.next() == Some("unstructured_grid");
            is_legacy
                || text.contains("type=\"unstructuredgrid\"")
                || text.contains("type=\"punstructuredgrid\"")
        };
        match format {
            Self::Gmsh => Some(format),
            // Exodus has the dimension of its nodes in the header, near the beginning.
            Self::NetCdf if text.contains("num_nodes") => Some(format),
            Self::NetCdf => None,
            Self::Vtk if is_grid(&text) => Some(format),
            Self::Hdf5 => match Hdf5Mesh::of_file(path).ok()?? {
                Hdf5Mesh::Exodus => Some(Self::NetCdf),
                Hdf5Mesh::VtkHdf => Some(Self::Hdf5),
            },
            Self::Vtk => None,
        }
    }

    /// Returns the name of the format.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gmsh => "Gmsh",
            Self::NetCdf => "Exodus II",
            Self::Hdf5 => "VTKHDF unstructured grid",
            Self::Vtk => "VTK unstructured grid",
        }
    }
}

/// Format of the mesh in an HDF5 file.
enum Hdf5Mesh {
    /// Exodus II in NetCDF-4.
    Exodus,
    VtkHdf,
}

impl Hdf5Mesh {
    /// Returns the format of the mesh in a file; `None` if it has none.
    fn of_file(path: &Path) -> Result<Option<Self>> {
        let source = Hdf5Source::open(path)?;
        if vtkhdf::is_grid(&source) {
            return Ok(Some(Self::VtkHdf));
        }
        let names = source.group("/").map(|root| root.member_names());
        let Some(Ok((_, names))) = names else {
            let problem = "cannot be listed: it is damaged, or has a virtual data set";
            return Err(source.error("/", problem, crate::files::REWRITE_DAMAGED));
        };
        let has = |name: &str| names.iter().any(|known| known == name);
        Ok((has("coord") || has("coordx")).then_some(Self::Exodus))
    }
}

/// Reads a mesh in our format, VTK's, Gmsh's or Exodus', which is recognised by its first bytes.
///
/// # Errors
/// Returns the errors of [`read_any_vtu`](super::read_any_vtu), and [`Error::Mesh`] for a file that
/// is damaged or has cells of an unsupported type.
pub fn read_any_mesh(path: &Path) -> Result<AnyMesh> {
    Ok(read_any_mesh_with_notes(path)?.0)
}

/// Reads a mesh as [`read_any_mesh`] does. Returns also notes for the user: what was left out, and
/// what is a guess.
///
/// # Errors
/// Returns the errors of [`read_any_mesh`].
pub fn read_any_mesh_with_notes(path: &Path) -> Result<(AnyMesh, Vec<String>)> {
    let read_all = || fs::read(path).map_err(|e| io_error(path, "read", e));
    let mesh = match MeshFormat::from_start(&read_start(path, 16)?) {
        MeshFormat::Gmsh => gmsh::read(&read_all()?).and_then(ForeignMesh::into_mesh),
        MeshFormat::NetCdf => exodus::read(path),
        MeshFormat::Hdf5 => match Hdf5Mesh::of_file(path)? {
            Some(Hdf5Mesh::Exodus) => exodus::read(path),
            Some(Hdf5Mesh::VtkHdf) => {
                let file = vtkhdf::to_vtk_file(&Hdf5Source::open(path)?, path)?;
                return read_vtk_file_with_notes(&file, path);
            }
            None => Err(FileProblem {
                problem:
                    "is an HDF5 file, but neither Exodus II nor an unstructured grid of VTKHDF"
                        .into(),
                remedy: "give a mesh, for example as .vtu",
            }),
        },
        MeshFormat::Vtk => return read_any_vtu_with_notes(path),
    };
    let (mesh, notes) = mesh.map_err(|fault| fault.at(path))?;
    let place = path.display();
    let notes = notes.iter().map(|note| format!("{place}: {note}"));
    Ok((mesh, notes.collect()))
}

/// Returns the first bytes of a file.
pub(super) fn read_start(path: &Path, count: u64) -> Result<Vec<u8>> {
    use std::io::Read;
    let mut head = Vec::new();
    let file = open(path, "give the file of a mesh")?;
    let bytes_read = file.take(count).read_to_end(&mut head);
    bytes_read.map_err(|e| io_error(path, "read", e))?;
    Ok(head)
}

/// VTK's types of vertices, lines, triangles and tetrahedra.
const SIMPLEX_TYPES: [i64; 4] = [1, 3, 5, 10];

/// Name in our exports of faces on features that belong to no surface.
const FRAGMENTS_NAME: &str = "scraps";

/// Returns `true` if a file has tetrahedra together with triangles, lines or vertices.
pub(super) fn is_mixed(types: &[i64]) -> bool {
    types.iter().all(|kind| SIMPLEX_TYPES.contains(kind))
        && types.contains(&10)
        && types.iter().any(|kind| *kind != 10)
}

/// Returns the group of a flat cell or a line in a VTK file with this number: a number other than 0
/// is a group.
pub(super) fn vtk_group(number: Option<i32>) -> Group {
    match number {
        Some(number) if number != 0 => Group::Physical(number),
        _ => Group::Entity(0),
    }
}

/// Reads a mesh of tetrahedra together with triangles, lines or vertices. Triangles inside the mesh
/// are faces on features.
pub(super) fn read_mixed(
    path: &Path,
    file: &VtkFile,
    types: &[i64],
    notes: &mut Vec<String>,
) -> Result<AnyMesh> {
    let piece = file.piece()?;
    let points = read_count(file, piece, "NumberOfPoints")?;
    let cells = file.child(piece, "Cells")?;
    let corners = read_cell_nodes(file, cells, types.len())?;
    let arrays = read_arrays(file, piece, "CellData", types.len())?;
    let found = region_arrays::find(&arrays);
    let mut foreign = ForeignMesh {
        nodes: read_nodes(file, file.child(piece, "Points")?, points)?,
        ..ForeignMesh::default()
    };
    let mut tet_cells = Vec::new();
    for (c, kind) in types.iter().enumerate() {
        let number = found.as_ref().map(|found| found.regions[c]);
        let group = match kind {
            10 => Group::Physical(number.unwrap_or(0)),
            _ => vtk_group(number),
        };
        let combination = foreign.combinations.number(&[group]);
        match (*kind, corners.get(c)) {
            (1, &[i]) => foreign.points.push(([i], combination)),
            (3, &[i, j]) => foreign.edges.push(([i, j], combination)),
            (5, &[i, j, k]) => foreign.triangles.push(([i, j, k], combination)),
            (10, &[i, j, k, l]) => {
                foreign.tets.push(([i, j, k, l], combination));
                tet_cells.push(c as u32);
            }
            _ => {
                return Err(file.error(
                    "has cells with a wrong number of nodes",
                    crate::files::REWRITE_DAMAGED,
                ));
            }
        }
    }
    let nodes_of_tets = foreign.tets.iter().flat_map(|tet| tet.0);
    let are_valid = nodes_of_tets.clone().all(|n| (n as usize) < points);
    let kept = if are_valid {
        used_items(points, nodes_of_tets)
    } else {
        Vec::new()
    };
    let (mut mesh, mesh_notes) = foreign.into_mesh().map_err(|fault| fault.at(path))?;
    notes.extend(mesh_notes);
    if let AnyMesh::Tetrahedra(mesh) = &mut mesh {
        let own = [REGION_ARRAY, HORIZON_FACES_ARRAY];
        let others = arrays
            .into_iter()
            .filter(|array| !own.contains(&array.name.as_str()));
        let others = select_rows(others.collect(), &tet_cells);
        mesh.cell_data.extend(others);
        let point_data = read_arrays(file, piece, "PointData", points)?;
        mesh.point_data.extend(select_rows(point_data, &kept));
        mesh.field_data.extend(read_fields(file)?);
        if let Some(found) = found.filter(|found| !found.labels.is_empty()) {
            mesh.field_data.extend(regions_field(&found.labels));
        }
    }
    Ok(mesh)
}

/// Returns some rows of arrays.
pub(super) fn select_rows(arrays: Vec<DataArray>, rows: &[u32]) -> Vec<DataArray> {
    let select = |array: DataArray| DataArray {
        values: array.values.select_tuples(rows, array.components),
        ..array
    };
    arrays.into_iter().map(select).collect()
}

/// Creates the file of a mesh of polyhedra whose faces are in groups. The nodes of these faces have
/// the numbers of the mesh.
pub(super) fn poly_file(
    mut mesh: PolyMesh<3>,
    mut grouped: GroupedFaces<'_, Vec<u32>>,
    mut sets: NamedSets,
    notes: &mut Vec<String>,
) -> MeshFile<PolyMesh<3>> {
    let (mut surfaces, mut horizons) = (Vec::new(), Vec::new());
    let inner_faces = mesh.inner_face_count();
    for f in 0..mesh.face_cells.len() {
        let is_inside = f < inner_faces;
        let found = grouped.find(&sorted(mesh.faces.get(f).to_vec()), is_inside);
        let Some(face) = found.filter(|_| is_inside) else {
            continue;
        };
        mesh.on_feature[f] = true;
        let index = grouped.surface_index(face);
        surfaces.extend(index.map(|index| (mesh.face_cells[f], index)));
        if grouped.is_on_horizon(face) {
            horizons.extend(mesh.face_cells[f].map(i64::from));
        }
    }
    let named = NamedSurfaces::new(&grouped.surface_names(), surfaces);
    let lost;
    (sets.faces, lost) = grouped.into_sets("surface");
    note_lost(notes, lost, "faces of groups lie on no cell");
    let mut field_data = named.into_fields();
    if !horizons.is_empty() {
        field_data.push((HORIZON_FACES_ARRAY.into(), FieldValue::Ints(horizons)));
    }
    let counts = [mesh.nodes.len(), mesh.sites.len()];
    let mut file = MeshFile {
        mesh,
        point_data: Vec::new(),
        cell_data: Vec::new(),
        field_data,
    };
    sets.add_to(&mut file, counts[0], counts[1]);
    file
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
