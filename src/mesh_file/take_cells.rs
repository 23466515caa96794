//! Meshes of some cells of a mesh, with all their data.
//!
//! Faces whose other cell is left out become boundary faces. They belong to named sets of faces: an
//! interface between regions keeps the name that it had inside the mesh, such as `interface_0_3`, and
//! faces within one region are the set `cut`. The fields `outer_boundary` and `filled_share` declare these
//! sets and the share of the box that is left, so that checks still find holes.

use super::array_names::{
    AXES_FIELD, FACE_SET_NAMES_FIELD, FACE_SETS_FIELD, FILLED_SHARE_FIELD, HORIZON_FACES_ARRAY,
    LABELS_FIELD, LATTICE_EXTENT_FIELD, LATTICE_STEP_FIELD, ORIGIN_FIELD, OUTER_BOUNDARY_FIELD,
    REGION_ARRAY, SURFACE_FACES_FIELD,
};
use super::cell_choice::KnownRegion;
use super::labels::{read_labels, regions_field};
use super::named_regions::interface_name;
use super::named_sets::{FaceSet, NamedSets, face_set_fields};
use super::{FieldValue, LatticeSpace, MeshFile};
use crate::files::vtk::DataArray;
use crate::geometry::sorted;
use crate::mesh::check::OuterBoundary;
use crate::mesh::complex::NONE;
use crate::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};
use crate::mesh::renumber::{new_numbers, used_items};
use crate::mesh::{Mesh, Simplices};
use crate::{Error, Result, error::cause};

/// Name of the set of faces at which a region was cut.
pub const CUT_NAME: &str = "cut";

/// A mesh of which some cells can be taken.
pub trait TakeCells<const D: usize>: Mesh<D> {
    /// Returns the mesh of some cells, in this order, and the nodes that it has of this mesh, ascending.
    /// Faces of polyhedra and polygons whose other cell is left out are on no known side.
    fn with_cells(&self, cells: &[u32]) -> (Self, Vec<u32>);

    /// Returns the region of each cell; empty if there are no regions.
    fn cell_regions(&self, cell_data: &[DataArray]) -> Vec<i32>;

    /// Returns the nodes of a face.
    fn nodes_of_face(&self, face: usize) -> Vec<u32>;
}

impl<const D: usize, M: Simplices<D>> TakeCells<D> for M {
    fn with_cells(&self, cells: &[u32]) -> (Self, Vec<u32>) {
        let corners = cells.iter().flat_map(|&c| self.cell(c as usize)).copied();
        let corners: Vec<u32> = corners.collect();
        let kept = used_items(self.nodes().len(), corners.iter().copied());
        let numbers = new_numbers(self.nodes().len(), &kept);
        let nodes = kept.iter().map(|&n| self.nodes()[n as usize]).collect();
        let corners = corners.iter().map(|&n| numbers[n as usize]).collect();
        (Self::from_parts(nodes, corners), kept)
    }

    fn cell_regions(&self, cell_data: &[DataArray]) -> Vec<i32> {
        let array = cell_data.iter().find(|array| array.name == REGION_ARRAY);
        let regions = array.map_or_else(Vec::new, |array| array.values.to_i64());
        regions.into_iter().map(|region| region as i32).collect()
    }

    fn nodes_of_face(&self, face: usize) -> Vec<u32> {
        self.face(face / (D + 1), face % (D + 1)).to_vec()
    }
}

impl<const D: usize> TakeCells<D> for PolyMesh<D> {
    fn with_cells(&self, cells: &[u32]) -> (Self, Vec<u32>) {
        let numbers = new_numbers(self.sites.len(), cells);
        // The owner of a face has the lower number, and a face with one cell is of this cell.
        let mut faces: Vec<([u32; 2], usize, bool)> = Vec::new();
        for (f, &[a, b]) in self.face_cells.iter().enumerate() {
            let is_inner = b < FIRST_SIDE;
            let first = numbers[a as usize];
            let second = if is_inner { numbers[b as usize] } else { b };
            match (first, second) {
                (NONE, NONE) => {}
                (NONE, _) if !is_inner => {}
                (NONE, second) => faces.push(([second, NONE], f, true)),
                (first, second) if is_inner && second < first => {
                    faces.push(([second, first], f, true));
                }
                (first, second) => faces.push(([first, second], f, false)),
            }
        }
        faces.sort_unstable_by_key(|&([a, b], f, _)| (b >= FIRST_SIDE, a, b, f));
        let rings = faces.iter().flat_map(|&(_, f, _)| self.faces.get(f));
        let kept = used_items(self.nodes.len(), rings.copied());
        let node_numbers = new_numbers(self.nodes.len(), &kept);
        let mut mesh = Self {
            nodes: kept.iter().map(|&n| self.nodes[n as usize]).collect(),
            sites: cells.iter().map(|&c| self.sites[c as usize]).collect(),
            region: cells.iter().map(|&c| self.region[c as usize]).collect(),
            ..Self::default()
        };
        for (cells, f, is_reversed) in faces {
            let mut ring: Vec<u32> = self.faces.get(f).to_vec();
            if is_reversed {
                ring.reverse();
            }
            mesh.faces
                .push(ring.into_iter().map(|n| node_numbers[n as usize]));
            mesh.face_cells.push(cells);
            mesh.on_feature.push(self.on_feature[f]);
        }
        (mesh, kept)
    }

    fn cell_regions(&self, _: &[DataArray]) -> Vec<i32> {
        self.region.clone()
    }

    fn nodes_of_face(&self, face: usize) -> Vec<u32> {
        self.faces.get(face).to_vec()
    }
}

/// Returns the mesh of some cells, in this order, with their data and the nodes that they have. It
/// declares the faces at which cells are left out.
///
/// # Errors
/// Returns [`Error::Mesh`] if more than two cells share a face, or if the mesh records only a part of
/// its position.
pub fn take_cells<const D: usize, M: TakeCells<D>>(
    mut file: MeshFile<M>,
    cells: &[u32],
) -> Result<MeshFile<M>> {
    let count = file.mesh.len();
    if cells.len() == count && cells.iter().zip(0..).all(|(&cell, number)| cell == number) {
        return Ok(file);
    }
    let Some(space) = LatticeSpace::from_file(&file, file.mesh.nodes()) else {
        return Err(Error::Mesh(cause(
            "the mesh",
            "records only a part of where its lattice lies",
            "mesh the image again",
        )));
    };
    let numbers = new_numbers(count, cells);
    let (mesh, kept_nodes) = file.mesh.with_cells(cells);
    let node_numbers = new_numbers(file.mesh.nodes().len(), &kept_nodes);
    let cut = CutFaces::new(&file, &numbers)?;
    let (sets, outer_names) = face_sets(&file, &cut, &mesh, &node_numbers);
    let samples = (0..D).map(|k| space.extent[k] / space.step[k]);
    let box_volume = samples.product::<f64>() * space.geometry.determinant().abs();
    let share = mesh.volumes().iter().sum::<f64>() / box_volume;
    let select = |arrays: &[DataArray], indices: &[u32]| -> Vec<DataArray> {
        let selected = arrays.iter().map(|array| DataArray {
            values: array.values.select_tuples(indices, array.components),
            ..array.clone()
        });
        selected.collect()
    };
    let regions = mesh.cell_regions(&select(&file.cell_data, cells));
    let labels = read_labels(&file).into_iter();
    let labels: Vec<_> = labels
        .filter(|label| regions.contains(&label.region))
        .collect();
    let replaced = [
        FACE_SET_NAMES_FIELD,
        FACE_SETS_FIELD,
        OUTER_BOUNDARY_FIELD,
        FILLED_SHARE_FIELD,
        LABELS_FIELD,
    ];
    file.field_data
        .retain(|(name, _)| !replaced.contains(&name.as_str()));
    for (name, value) in &mut file.field_data {
        let columns = match name.as_str() {
            HORIZON_FACES_ARRAY => [0, 1],
            SURFACE_FACES_FIELD => [1, 2],
            _ => continue,
        };
        if let FieldValue::Ints(rows) = value {
            *rows = renumbered_rows(rows, columns, &numbers);
        }
    }
    if !space.is_stored {
        file.field_data.extend(position_fields(&space));
    }
    if !labels.is_empty() {
        file.field_data.extend(regions_field(&labels));
    }
    file.field_data.extend(face_set_fields(&sets));
    file.field_data.extend([
        (
            OUTER_BOUNDARY_FIELD.into(),
            FieldValue::Text(outer_names.join("\n")),
        ),
        (FILLED_SHARE_FIELD.into(), FieldValue::F64s(vec![share])),
    ]);
    Ok(MeshFile {
        mesh,
        point_data: select(&file.point_data, &kept_nodes),
        cell_data: select(&file.cell_data, cells),
        field_data: file.field_data,
    })
}

/// Returns the fields with the position of a lattice space.
fn position_fields<const D: usize>(space: &LatticeSpace<D>) -> [(String, FieldValue); 4] {
    let numbers = |name: &str, values: &[f64]| (name.into(), FieldValue::F64s(values.to_vec()));
    [
        numbers(ORIGIN_FIELD, &space.geometry.origin),
        numbers(AXES_FIELD, space.geometry.axes.as_flattened()),
        numbers(LATTICE_STEP_FIELD, &space.step),
        numbers(LATTICE_EXTENT_FIELD, &space.extent),
    ]
}

/// Returns rows of numbers, two `columns` of which are cells, with new numbers of cells: ascending, and
/// without the rows of cells that are left out.
fn renumbered_rows(rows: &[i64], columns: [usize; 2], numbers: &[u32]) -> Vec<i64> {
    let new_number = |cell: i64| {
        let number = usize::try_from(cell).ok().and_then(|c| numbers.get(c));
        number.copied().filter(|&number| number != NONE)
    };
    let renumbered = rows.chunks_exact(columns[1] + 1).filter_map(|row| {
        let [a, b] = columns.map(|column| new_number(row[column]));
        let (a, b) = (a?, b?);
        let mut row = row.to_vec();
        row[columns[0]] = a.min(b).into();
        row[columns[1]] = a.max(b).into();
        Some(row)
    });
    renumbered.flatten().collect()
}

/// The faces between a cell that is kept and one that is not.
struct CutFaces {
    /// Names of the sets that they form.
    names: Vec<String>,
    /// For each face the index of its name, and its nodes.
    faces: Vec<(usize, Vec<u32>)>,
}

impl CutFaces {
    /// Finds the faces of a mesh of which one cell has no new number.
    fn new<const D: usize, M: TakeCells<D>>(file: &MeshFile<M>, numbers: &[u32]) -> Result<Self> {
        let regions = file.mesh.cell_regions(&file.cell_data);
        let region = |cell: u32| regions.get(cell as usize).copied().unwrap_or(0);
        let mut found: Vec<([i32; 2], usize)> = Vec::new();
        for (face, [a, b]) in file.mesh.cells_of_faces()?.into_iter().enumerate() {
            if a == NONE || b >= FIRST_SIDE {
                continue;
            }
            if (numbers[a as usize] == NONE) != (numbers[b as usize] == NONE) {
                found.push((sorted([region(a), region(b)]), face));
            }
        }
        found.sort_unstable();
        let known = KnownRegion::of_file(file);
        let label = |region: i32| KnownRegion::label_of(&known, region);
        let (mut names, mut faces) = (Vec::new(), Vec::new());
        for same_pair in found.chunk_by(|a, b| a.0 == b.0) {
            let [a, b] = same_pair[0].0;
            names.push(if a == b {
                CUT_NAME.to_string()
            } else {
                interface_name([&label(a), &label(b)])
            });
            let nodes = same_pair.iter().map(|(_, f)| file.mesh.nodes_of_face(*f));
            faces.extend(nodes.map(|nodes| (names.len() - 1, nodes)));
        }
        Ok(Self { names, faces })
    }
}

/// Returns the sets of faces of a mesh of some cells, with its numbers of nodes, and the names of those
/// at which cells are left out, now or before.
fn face_sets<const D: usize, M: TakeCells<D>>(
    file: &MeshFile<M>,
    cut: &CutFaces,
    mesh: &M,
    node_numbers: &[u32],
) -> (Vec<FaceSet>, Vec<String>) {
    let renumbered = |nodes: &[u32]| -> Option<Vec<u32>> {
        let nodes = nodes.iter().map(|&n| node_numbers[n as usize]);
        let nodes: Option<Vec<u32>> = nodes.map(|n| (n != NONE).then_some(n)).collect();
        nodes.map(sorted)
    };
    let known = NamedSets::from_file(file).faces;
    let mut sets: Vec<FaceSet> = Vec::new();
    if !known.is_empty() {
        let faces = (0..mesh.face_count()).map(|f| sorted(mesh.nodes_of_face(f)));
        let kept: Vec<Vec<u32>> = sorted(faces.collect());
        for set in known {
            let old = (0..set.faces.len()).filter_map(|i| renumbered(set.faces.get(i)));
            let mut faces = Lists::default();
            old.filter(|nodes| kept.binary_search(nodes).is_ok())
                .for_each(|nodes| faces.push(nodes));
            if !faces.is_empty() {
                let name = set.name;
                sets.push(FaceSet { name, faces });
            }
        }
    }
    let mut outer = outer_names(file);
    outer.retain(|name| sets.iter().any(|set| set.name == *name));
    for (index, name) in cut.names.iter().enumerate() {
        // A set that bounded the mesh before goes on; other sets keep their names.
        let is_taken = |name: &str| {
            sets.iter().any(|set| set.name == name) && !outer.iter().any(|known| known == name)
        };
        let numbered = (2..).map(|n| format!("{name}_{n}"));
        let mut candidates = std::iter::once(name.clone()).chain(numbered);
        let name = candidates
            .find(|candidate| !is_taken(candidate))
            .unwrap_or_default();
        let position = sets.iter().position(|set| set.name == name);
        let position = position.unwrap_or_else(|| {
            sets.push(FaceSet {
                name: name.clone(),
                faces: Lists::default(),
            });
            outer.push(name);
            sets.len() - 1
        });
        let own = cut.faces.iter().filter(|(number, _)| *number == index);
        own.filter_map(|(_, nodes)| renumbered(nodes))
            .for_each(|nodes| sets[position].faces.push(nodes));
    }
    (sets, outer)
}

/// Returns the names of the sets of faces at which cells were left out.
fn outer_names<M>(file: &MeshFile<M>) -> Vec<String> {
    match file.field_value(OUTER_BOUNDARY_FIELD) {
        Some(FieldValue::Text(names)) => names
            .trim_end_matches('\0')
            .lines()
            .map(str::to_string)
            .collect(),
        _ => Vec::new(),
    }
}

/// Reads the boundary at which cells were left out; `None` if the mesh fills its box.
pub fn read_outer_boundary<M>(file: &MeshFile<M>) -> Option<OuterBoundary> {
    let filled_share = match file.field_value(FILLED_SHARE_FIELD) {
        Some(FieldValue::F64s(share)) => *share.first()?,
        _ => return None,
    };
    let names = outer_names(file);
    let sets = NamedSets::from_file(file).faces.into_iter();
    let mut boundary = OuterBoundary {
        filled_share,
        ..OuterBoundary::default()
    };
    for (number, set) in (0..).zip(sets.filter(|set| names.contains(&set.name))) {
        let faces = (0..set.faces.len()).map(|i| (set.faces.get(i).to_vec(), number));
        boundary.faces.extend(faces);
        boundary.names.push(set.name);
    }
    boundary.faces.sort_unstable();
    Some(boundary)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::{CheckHints, check_with_hints};
    use crate::mesh::poly::PolyMesh;

    /// Returns a box of 3 x 2 x 2 cubes, whose region is the number of the cube along x.
    fn boxes() -> MeshFile {
        let mesh = kuhn_box([3, 2, 2], 1.0);
        let region = |c: usize| (mesh.centres()(c)[0]) as i32;
        let regions: Vec<i32> = (0..mesh.len()).map(region).collect();
        let nodes = (0..mesh.nodes.len() as i32).collect::<Vec<_>>();
        MeshFile {
            point_data: vec![DataArray::scalars("number", nodes)],
            cell_data: vec![DataArray::scalars(REGION_ARRAY, regions)],
            field_data: Vec::new(),
            mesh,
        }
    }

    /// Takes the cells of some regions, checks the mesh, and returns it.
    fn take<M: TakeCells<3>>(file: &MeshFile<M>, kept: &[i32]) -> MeshFile<M> {
        let regions = file.mesh.cell_regions(&file.cell_data);
        let cells = (0..)
            .zip(&regions)
            .filter(|(_, region)| kept.contains(region));
        let cells: Vec<u32> = cells.map(|(cell, _)| cell).collect();
        take_cells(file.clone(), &cells).unwrap()
    }

    fn problems<M: TakeCells<3>>(file: &MeshFile<M>, outer: &OuterBoundary) -> Vec<String> {
        let hints = CheckHints {
            outer: Some(outer),
            ..CheckHints::default()
        };
        check_with_hints(&file.mesh, hints, [0.0; 3], [3.0, 2.0, 2.0], 1e-12).problems
    }

    #[test]
    fn a_part_has_named_boundaries_within_which_holes_are_found() {
        let file = boxes();
        let part = take(&file, &[0, 2]);
        let outer = read_outer_boundary(&part).unwrap();
        assert_eq!(outer.names, ["interface_0_1", "interface_1_2"]);
        // Two interfaces of four squares of two triangles.
        assert_eq!(outer.faces.len(), 16);
        assert!((outer.filled_share - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(problems(&part, &outer), [""; 0]);
        // Values go with their nodes: the nodes of x = 0, 1, 2 and 3.
        let numbers = part.point_data[0].values.to_i64();
        let x = |n: i64| file.mesh.nodes[n as usize][0];
        assert!(
            numbers
                .iter()
                .zip(&part.mesh.nodes)
                .all(|(&n, p)| x(n) == p[0])
        );
        for cell in 0..part.mesh.len() {
            let mut holed = part.clone();
            holed.mesh.tets.remove(cell);
            assert!(!problems(&holed, &outer).is_empty(), "{cell}");
        }
        // The part of a part declares both boundaries that it has.
        let last = take(&part, &[2]);
        let outer = read_outer_boundary(&last).unwrap();
        assert_eq!((outer.names.len(), outer.faces.len()), (1, 8));
        assert_eq!(problems(&last, &outer), [""; 0]);
        let cut = take_cells(last, &[0, 1, 2]).unwrap();
        let names = read_outer_boundary(&cut).unwrap().names;
        assert!(names.contains(&CUT_NAME.to_string()), "{names:?}");
    }

    #[test]
    fn polyhedra_are_taken_in_any_order() {
        let file = boxes();
        let regions = file.mesh.cell_regions(&file.cell_data);
        let mesh = PolyMesh::from_simplices(&file.mesh, &[], &regions).unwrap();
        let cells = MeshFile::<()>::default().with_mesh(mesh);
        let count = cells.mesh.sites.len() as u32;
        let reversed = take_cells(cells.clone(), &(0..count).rev().collect::<Vec<_>>()).unwrap();
        let mut mesh = reversed.mesh;
        mesh.assign_sides([0.0; 3], [3.0, 2.0, 2.0]);
        assert!(mesh.region.iter().rev().eq(&regions));
        let none = OuterBoundary {
            filled_share: 1.0,
            ..OuterBoundary::default()
        };
        let whole = MeshFile::<()>::default().with_mesh(mesh);
        assert_eq!(problems(&whole, &none), [""; 0]);
        let mut part = take(&cells, &[1]);
        let outer = read_outer_boundary(&part).unwrap();
        part.mesh.assign_sides([0.0; 3], [3.0, 2.0, 2.0]);
        part.mesh
            .release_sides(|nodes| outer.set_of(nodes).map(|_| true));
        assert_eq!(outer.faces.len(), 16);
        assert_eq!(problems(&part, &outer), [""; 0]);
    }
}
