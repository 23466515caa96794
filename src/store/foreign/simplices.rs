//! Meshes of tetrahedra or triangles, with the groups of their elements, as files of our own have
//! them.

use super::groups::{CellGroups, Combinations, GroupNames, GroupedFaces, node_sets};
use super::{FileProblem, ReadResult, labels_field};
use crate::files::vtk::DataArray;
use crate::geometry::{sorted, sorted_distinct};
use crate::mesh::complex::NONE;
use crate::mesh::renumber::{new_numbers, used_items};
use crate::mesh::{Simplices, TetMesh, TriMesh};
use crate::mesh_file::array_names::{HORIZON_FACES_ARRAY, REGION_ARRAY};
use crate::mesh_file::named_surfaces::NamedSurfaces;
use crate::parallel::prelude::*;
use crate::store::named_sets::{NamedSet, NamedSets};
use crate::store::{AnyMesh, MeshFile};

/// A mesh as finite-element formats store it. Each element has the combination of its groups.
#[derive(Debug, Default)]
pub struct ForeignMesh {
    pub nodes: Vec<[f64; 3]>,
    /// Corners of tetrahedra.
    pub tets: Vec<([u32; 4], u32)>,
    /// Corners of triangles: the cells of a 2-D mesh, the faces of a 3-D mesh.
    pub triangles: Vec<([u32; 3], u32)>,
    /// Ends of edges: the faces of a 2-D mesh.
    pub edges: Vec<([u32; 2], u32)>,
    /// Nodes that are elements.
    pub points: Vec<([u32; 1], u32)>,
    /// The combinations of groups.
    pub combinations: Combinations,
    /// Names of groups of points, edges, triangles and tetrahedra.
    pub names: [GroupNames; 4],
    /// Sets of nodes that are no elements.
    pub node_sets: Vec<NamedSet>,
    /// Notes for the user on parts that were left out or changed.
    pub notes: Vec<String>,
}

/// A mesh that was read, with notes for the user.
pub type NotedMesh = (AnyMesh, Vec<String>);

impl ForeignMesh {
    /// Converts to a mesh file of tetrahedra or triangles.
    pub fn into_mesh(mut self) -> ReadResult<NotedMesh> {
        let count = self.nodes.len();
        let are_valid = |corners: &[u32]| corners.iter().all(|&n| (n as usize) < count);
        let is_valid = self.tets.iter().all(|(t, _)| are_valid(t))
            && self.triangles.iter().all(|(t, _)| are_valid(t))
            && self.edges.iter().all(|(e, _)| are_valid(e))
            && self.points.iter().all(|(p, _)| are_valid(p))
            && self.node_sets.iter().all(|set| are_valid(&set.members));
        if !is_valid {
            return Err(FileProblem::damaged(
                "has a cell with a node that does not exist",
            ));
        }
        let is_infinite = |x: &[f64; 3]| x.iter().any(|c| !c.is_finite());
        if let Some(node) = self.nodes.iter().position(is_infinite) {
            return Err(FileProblem::damaged(format!("node {node} is not finite")));
        }
        let mut notes = std::mem::take(&mut self.notes);
        if !self.tets.is_empty() {
            let (tets, faces) = (
                std::mem::take(&mut self.tets),
                std::mem::take(&mut self.triangles),
            );
            let nodes = std::mem::take(&mut self.nodes);
            let file = self.simplex_file::<3, TetMesh, 4>(&nodes, tets, faces, &mut notes)?;
            return Ok((AnyMesh::Tetrahedra(file), notes));
        }
        if self.triangles.is_empty() {
            return Err(FileProblem {
                problem: "has neither tetrahedra nor triangles".into(),
                remedy: "give a mesh of tetrahedra or triangles",
            });
        }
        let is_off_plane = |&n: &u32| self.nodes[n as usize][2] != 0.0;
        let mut triangles = self.triangles.iter();
        if triangles.any(|(t, _)| t.iter().any(is_off_plane)) {
            return Err(FileProblem {
                problem: "has triangles off the plane z = 0, but no tetrahedra".into(),
                remedy: "give the mesh of the volume, or one of that plane",
            });
        }
        let nodes: Vec<[f64; 2]> = self.nodes.iter().map(|x| [x[0], x[1]]).collect();
        let (triangles, edges) = (
            std::mem::take(&mut self.triangles),
            std::mem::take(&mut self.edges),
        );
        let file = self.simplex_file::<2, TriMesh, 3>(&nodes, triangles, edges, &mut notes)?;
        Ok((AnyMesh::Triangles(file), notes))
    }

    /// Creates a mesh of simplices with `N` nodes, with regions, sets, and marks on the inner faces
    /// that belong to groups. Unused nodes are removed, and cells are oriented positively.
    fn simplex_file<const D: usize, M: Simplices<D>, const N: usize>(
        mut self,
        nodes: &[[f64; D]],
        cells: Vec<([u32; N], u32)>,
        mut faces: Vec<([u32; D], u32)>,
        notes: &mut Vec<String>,
    ) -> ReadResult<MeshFile<M>> {
        let cells = merge_repeated_cells(cells, &mut self.combinations, notes);
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
        let neighbours = mesh.neighbours().map_err(|face| {
            FileProblem::damaged(format!("more than two cells share the face {face:?}"))
        })?;
        let cell_combinations: Vec<u32> = cells.iter().map(|cell| cell.1).collect();
        drop(cells);
        let cell_groups =
            CellGroups::new(&cell_combinations, &self.combinations, &self.names[N - 1]);
        let mut sets = NamedSets {
            cells: cell_groups.sets,
            nodes: self.lower_sets(D, &new_index, notes),
            ..NamedSets::default()
        };
        for (face, _) in &mut faces {
            *face = sorted(face.map(|n| new_index[n as usize]));
        }
        let mut grouped = GroupedFaces::new(faces, &mut self.combinations, &self.names[D - 1]);
        let (mut marks, mut horizons) = (vec![0u8; mesh.len()], vec![0u8; mesh.len()]);
        let mut named = Vec::new();
        for (c, k) in (0..mesh.len()).flat_map(|c| (0..N).map(move |k| (c, k))) {
            let beyond = neighbours[N * c + k];
            let is_inside = beyond != NONE;
            let found = grouped.find(&sorted(mesh.face(c, k)), is_inside);
            let Some(face) = found.filter(|_| is_inside) else {
                continue;
            };
            marks[c] |= 1 << k;
            horizons[c] |= u8::from(grouped.is_on_horizon(face)) << k;
            if beyond as usize > c
                && let Some(index) = grouped.surface_index(face)
            {
                named.push(([c as u32, beyond], index));
            }
        }
        let surfaces = NamedSurfaces::new(&grouped.surface_names(), named);
        let lost;
        (sets.faces, lost) = grouped.into_sets(if D == 3 { "surface" } else { "curve" });
        note_lost(notes, lost, "faces of groups lie on no cell");
        note_sets(notes, &sets);
        let mut field_data = surfaces.into_fields();
        field_data.extend(labels_field(&cell_groups.regions, &cell_groups.names));
        let mut cell_data = vec![
            DataArray::scalars(REGION_ARRAY, cell_groups.regions),
            DataArray::scalars(M::FEATURE_FACES_ARRAY, marks),
        ];
        if horizons.iter().any(|&bits| bits > 0) {
            cell_data.push(DataArray::scalars(HORIZON_FACES_ARRAY, horizons));
        }
        let counts = [mesh.nodes().len(), mesh.len()];
        let mut file = MeshFile {
            mesh,
            point_data: Vec::new(),
            cell_data,
            field_data,
        };
        sets.add_to(&mut file, counts[0], counts[1]);
        Ok(file)
    }

    /// Returns the sets of nodes, and those of elements of a lower dimension than the faces.
    fn lower_sets(
        &mut self,
        dim: usize,
        new_index: &[u32],
        notes: &mut Vec<String>,
    ) -> Vec<NamedSet> {
        let points = self.points.iter().map(|(p, number)| (&p[..], *number));
        let mut sets = node_sets(points, &self.combinations, &self.names[0], "point");
        if dim == 3 {
            let edges = self.edges.iter().map(|(e, number)| (&e[..], *number));
            sets.extend(node_sets(
                edges,
                &self.combinations,
                &self.names[1],
                "curve",
            ));
        }
        sets.append(&mut self.node_sets);
        let lost = renumber_sets(&mut sets, new_index);
        note_lost(notes, lost, "nodes of sets belong to no cell");
        sets
    }
}

/// Gives the members of sets new numbers. Returns the number of members that have none, and removes
/// them.
pub fn renumber_sets(sets: &mut Vec<NamedSet>, new_index: &[u32]) -> usize {
    let mut lost = 0;
    for set in sets.iter_mut() {
        let count = set.members.len();
        let members = set.members.iter().map(|&n| new_index[n as usize]);
        set.members = sorted_distinct(members.filter(|&n| n != NONE));
        lost += count - set.members.len();
    }
    sets.retain(|set| !set.members.is_empty());
    lost
}

/// Adds a note that elements were left out.
pub fn note_lost(notes: &mut Vec<String>, count: usize, problem: &str) {
    if count > 0 {
        notes.push(format!("{count} {problem}: left out"));
    }
}

/// Adds a note that groups overlap.
fn note_sets(notes: &mut Vec<String>, sets: &NamedSets) {
    if sets.cells.is_empty() {
        return;
    }
    let names: Vec<String> = (sets.cells.iter())
        .map(|set| format!("'{}'", set.name))
        .collect();
    notes.push(format!(
        "groups of cells overlap: cells in the same groups are a region, and {} a set of cells",
        if names.len() == 1 {
            format!("{} is", names[0])
        } else {
            format!("each of {} is", names.join(", "))
        }
    ));
}

/// Merges cells with the same nodes that are in different groups: MSH 2.2 holds a cell once for each
/// of its groups.
fn merge_repeated_cells<const N: usize>(
    mut cells: Vec<([u32; N], u32)>,
    combinations: &mut Combinations,
    notes: &mut Vec<String>,
) -> Vec<([u32; N], u32)> {
    let key = |&c: &u32| sorted(cells[c as usize].0);
    let mut order: Vec<u32> = (0..cells.len() as u32).collect();
    order.par_sort_unstable_by(|a, b| (key(a), a).cmp(&(key(b), b)));
    let runs = order.chunk_by(|a, b| key(a) == key(b));
    let runs: Vec<Vec<u32>> = runs.filter(|r| r.len() > 1).map(<[u32]>::to_vec).collect();
    let mut is_repeated = vec![false; cells.len()];
    for run in runs {
        let first = run[0] as usize;
        for &next in &run[1..] {
            let [known, more] = [cells[first].1, cells[next as usize].1];
            let mut groups = combinations.groups(more).iter();
            if !groups.any(|g| combinations.groups(known).contains(g)) {
                cells[first].1 = combinations.union(known, more);
                is_repeated[next as usize] = true;
            }
        }
    }
    let count = is_repeated.iter().filter(|&&repeated| repeated).count();
    if count > 0 {
        notes.push(format!(
            "{count} cells are in the file more than once, for several groups: each is read once"
        ));
        let mut repeated = is_repeated.into_iter();
        cells.retain(|_| !repeated.next().unwrap_or(false));
    }
    cells
}
