//! Inserts patches into a mesh in place of the cells that they replace.

use super::editable_cells::{ATOM_KIND, EditableCells, ON_FEATURE, volume_name};
use super::patch::{CellPatch, NewCell};
use crate::edit::{Summary, newest_fields};
use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::geometry::NONE;
use crate::mesh::Mesh;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::mesh_file::array_names::{DISTANCE_ARRAY, HORIZON_FACES_ARRAY};
use crate::store::{FieldValue, MeshFile};
use crate::{Error, Result};

/// New numbers of the nodes or cells of a mesh. Items that stay keep their numbers. New items take
/// the numbers of removed ones, and then further numbers at the end. If numbers of removed items
/// remain, the last items take them.
struct Renumbering {
    /// New number of each old item, followed by those of the new items; `NONE` for removed
    /// ones.
    new_numbers: Vec<u32>,
    /// For each new number, the index of the item that has it, among the old items followed by the
    /// new ones.
    sources: Vec<u32>,
}

impl Renumbering {
    /// Assigns numbers. `requested` holds the number that each new item is to have, if any; it must
    /// be that of a removed item.
    fn new(is_removed: &[bool], requested: &[Option<u32>]) -> Self {
        let old = is_removed.len();
        let mut sources: Vec<Option<u32>> = (0..old as u32)
            .map(|n| (!is_removed[n as usize]).then_some(n))
            .collect();
        let mut remaining = Vec::new();
        for (i, request) in (old as u32..).zip(requested) {
            match request.map(|n| &mut sources[n as usize]) {
                Some(slot @ None) => *slot = Some(i),
                _ => remaining.push(i),
            }
        }
        let mut remaining = remaining.into_iter();
        for slot in sources.iter_mut().filter(|slot| slot.is_none()) {
            *slot = remaining.next();
        }
        sources.extend(remaining.map(Some));
        let mut hole = 0;
        while let Some(last) = sources.pop() {
            let Some(last) = last else { continue };
            while sources.get(hole).is_some_and(Option::is_some) {
                hole += 1;
            }
            match sources.get_mut(hole) {
                Some(slot) => *slot = Some(last),
                None => {
                    sources.push(Some(last));
                    break;
                }
            }
        }
        let sources: Vec<u32> = sources.into_iter().flatten().collect();
        let mut new_numbers = vec![NONE; old + requested.len()];
        for (n, &i) in (0..).zip(&sources) {
            new_numbers[i as usize] = n;
        }
        Self {
            new_numbers,
            sources,
        }
    }
}

/// A face: its cells, its nodes, and whether it lies on a feature and on a horizon.
type MarkedFace = ([u32; 2], Vec<u32>, bool, bool);

/// Inserts the patches into the mesh and returns it with its arrays, as a file stores it.
///
/// # Errors
/// Returns [`Error::Mesh`] if the new mesh is not valid.
pub fn stitch_patches<const D: usize>(
    mut editable: EditableCells<D>,
    patches: Vec<CellPatch<D>>,
    summary: &mut Summary,
) -> Result<MeshFile<PolyMesh<D>>> {
    let stitching = Stitching::new(&editable.mesh, &patches);
    let faces = stitching.faces(&editable, &patches);
    let mut shift = editable.mesh.sites.len();
    for patch in &patches {
        for &(edit, i) in &patch.edited_atoms {
            summary.atoms[edit] = Some(stitching.cells.new_numbers[shift + i]);
        }
        shift += patch.new_cells.len();
    }
    let mut mesh = stitching.atoms(&mut editable);
    let mut horizons: Vec<i64> = Vec::new();
    let mut on_feature = vec![0u8; mesh.sites.len()];
    for (cells, ring, is_on_feature, is_on_horizon) in faces {
        mesh.faces.push(ring);
        mesh.face_cells.push(cells);
        mesh.on_feature.push(is_on_feature);
        if is_on_feature {
            for c in cells {
                on_feature[c as usize] = 1;
            }
        }
        if is_on_horizon {
            horizons.extend(cells.map(i64::from));
        }
    }
    let space = &editable.space;
    let hints = CheckHints {
        weld: editable.weld,
        ..CheckHints::default()
    };
    let validity = check_with_hints(&mesh, hints, [0.0; D], space.extent, space.tolerance());
    if let Some(problem) = validity.problems.first() {
        return Err(Error::Mesh(cause(
            "the edited mesh",
            format!("is not valid: {problem}"),
            "give other positions, or mesh the image again; please also report this error, with the mesh",
        )));
    }
    mesh.swap_positions(&mut editable.world, space.is_mirrored());

    let mut cell_data = stitching.cell_arrays(&mesh, &editable);
    cell_data.insert(1, DataArray::scalars(ON_FEATURE, on_feature));
    summary.nodes[1] = mesh.nodes.len();
    let horizons =
        (!horizons.is_empty()).then_some((HORIZON_FACES_ARRAY.into(), FieldValue::Ints(horizons)));
    editable
        .fields
        .retain(|(name, _)| name != HORIZON_FACES_ARRAY);
    Ok(MeshFile {
        cell_data,
        point_data: Vec::new(),
        field_data: newest_fields(editable.fields.into_iter().chain(horizons)),
        mesh,
    })
}

/// New numbers and new parts of a mesh. The new nodes and cells of all patches are numbered one
/// after the other, after the old ones, before they take numbers of removed ones.
struct Stitching<const D: usize> {
    nodes: Renumbering,
    cells: Renumbering,
    node_is_removed: Vec<bool>,
    new_nodes: Vec<[f64; D]>,
    new_cells: Vec<NewCell<D>>,
    /// For each cell, old and new, `true` if its volume may have changed.
    needs_volume: Vec<bool>,
    /// Numbers of old nodes and cells.
    old_counts: [usize; 2],
}

impl<const D: usize> Stitching<D> {
    fn new(mesh: &PolyMesh<D>, patches: &[CellPatch<D>]) -> Self {
        let (node_count, cell_count) = (mesh.nodes.len(), mesh.sites.len());
        let flags = |count: usize, indices: &dyn Fn(&CellPatch<D>) -> &[u32]| {
            let mut flags = vec![false; count];
            for patch in patches {
                indices(patch)
                    .iter()
                    .for_each(|&i| flags[i as usize] = true);
            }
            flags
        };
        let node_is_removed = flags(node_count, &|patch| &patch.removed_nodes);
        let cell_is_removed = flags(cell_count, &|patch| &patch.removed_cells);
        let mut needs_volume = flags(cell_count, &|patch| &patch.border_cells);
        let new_nodes: Vec<[f64; D]> = patches.iter().flat_map(|p| p.new_nodes.clone()).collect();
        let new_cells: Vec<NewCell<D>> = patches.iter().flat_map(|p| p.new_cells.clone()).collect();
        needs_volume.extend(vec![true; new_cells.len()]);
        let nodes = Renumbering::new(&node_is_removed, &vec![None; new_nodes.len()]);
        let requested: Vec<Option<u32>> = new_cells.iter().map(|f| f.number).collect();
        Self {
            nodes,
            cells: Renumbering::new(&cell_is_removed, &requested),
            node_is_removed,
            new_nodes,
            new_cells,
            needs_volume,
            old_counts: [node_count, cell_count],
        }
    }

    /// Returns the faces of the new mesh: those between two cells, then those on the sides of the
    /// box.
    fn faces(&self, editable: &EditableCells<D>, patches: &[CellPatch<D>]) -> Vec<MarkedFace> {
        let [node_count, cell_count] = self.old_counts;
        let mut faces: Vec<MarkedFace> = Vec::new();
        let mut add_face = |ring: &[u32],
                            neighbours: [u32; 2],
                            on_feature: bool,
                            on_horizon: bool,
                            shift: [usize; 2]| {
            let number = |numbers: &Renumbering, i: u32, old: usize, shift: usize| {
                let i = i as usize;
                numbers.new_numbers[if i < old { i } else { i + shift }]
            };
            let mut ring: Vec<u32> = ring
                .iter()
                .map(|&n| number(&self.nodes, n, node_count, shift[0]))
                .collect();
            let mut cells = neighbours.map(|c| {
                if c < FIRST_SIDE {
                    number(&self.cells, c, cell_count, shift[1])
                } else {
                    c
                }
            });
            if cells[1] < cells[0] {
                cells.reverse();
                ring.reverse();
            }
            faces.push((cells, ring, on_feature, on_horizon));
        };
        let old = &editable.mesh;
        for (f, &cells) in old.face_cells.iter().enumerate() {
            let ring = old.faces.get(f);
            if ring.iter().all(|&n| !self.node_is_removed[n as usize]) {
                add_face(
                    ring,
                    cells,
                    old.on_feature[f],
                    editable.on_horizon[f],
                    [0, 0],
                );
            }
        }
        let mut shift = [0, 0];
        for patch in patches {
            for face in &patch.new_faces {
                add_face(
                    &face.ring,
                    face.cells,
                    face.on_feature,
                    face.on_horizon,
                    shift,
                );
            }
            shift[0] += patch.new_nodes.len();
            shift[1] += patch.new_cells.len();
        }
        faces.sort_by_key(|face| (face.0[1] >= FIRST_SIDE, face.0));

        faces
    }

    /// Returns the nodes and sites of the new mesh, and updates their physical positions.
    fn atoms(&self, editable: &mut EditableCells<D>) -> PolyMesh<D> {
        let (old, space) = (&editable.mesh, &editable.space);
        let (nodes, cells, new_cells) = (&self.nodes, &self.cells, &self.new_cells);
        let sites: Vec<[f64; D]> = new_cells.iter().map(|f| f.site).collect();
        let regions: Vec<i32> = new_cells.iter().map(|f| f.region).collect();
        let mesh = PolyMesh::<D> {
            nodes: reorder(nodes, &old.nodes, &self.new_nodes),
            sites: reorder(cells, &old.sites, &sites),
            region: reorder(cells, &old.region, &regions),
            ..PolyMesh::default()
        };
        let new_nodes = self.new_nodes.iter().map(|&x| space.to_world(x));
        let positions: Vec<[f64; D]> = new_nodes.collect();
        let world = &mut editable.world;
        world.nodes = reorder(nodes, &world.nodes, &positions);
        let positions: Vec<[f64; D]> = (new_cells.iter())
            .map(|f| f.world.unwrap_or_else(|| space.to_world(f.site)))
            .collect();
        world.sites = reorder(cells, &world.sites, &positions);
        mesh
    }

    /// Returns the arrays of the cells.
    fn cell_arrays(&self, mesh: &PolyMesh<D>, editable: &EditableCells<D>) -> Vec<DataArray> {
        let new_cell = |i: u32| {
            self.new_cells
                .get((i as usize).wrapping_sub(self.old_counts[1]))
        };
        let lists = mesh.faces_of_cells();
        let volume = |(n, &i): (usize, &u32)| {
            if self.needs_volume[i as usize] {
                mesh.cell_shape(n, lists.get(n)).0
            } else {
                editable.volume[i as usize]
            }
        };
        let volumes: Vec<f64> = self.cells.sources.iter().enumerate().map(volume).collect();
        let distance =
            |&i: &u32| new_cell(i).map_or_else(|| editable.distance[i as usize], |f| f.distance);
        let distance: Vec<f32> = self.cells.sources.iter().map(distance).collect();
        let kind =
            |&i: &u32| new_cell(i).map_or_else(|| editable.kinds[i as usize], |f| f.kind) as u8;
        let kinds: Vec<u8> = self.cells.sources.iter().map(kind).collect();
        vec![
            DataArray::scalars(volume_name::<D>(), volumes),
            DataArray::scalars(DISTANCE_ARRAY, distance),
            DataArray::scalars(ATOM_KIND, kinds),
        ]
    }
}

/// Returns the values `old` and `new` of the items in the order of their new numbers.
fn reorder<T: Copy>(numbers: &Renumbering, old: &[T], new: &[T]) -> Vec<T> {
    let value = |&i: &u32| {
        old.get(i as usize)
            .copied()
            .unwrap_or_else(|| new[i as usize - old.len()])
    };
    numbers.sources.iter().map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_things_take_places_and_the_last_fill_what_is_left() {
        // Old items are 0 to 4, of which 1 and 2 are removed; of the two new ones the second
        // requests number 1.
        let numbers = Renumbering::new(&[false, true, true, false, false], &[None, Some(1)]);
        assert_eq!(numbers.sources, [0, 6, 5, 3, 4]);
        let fewer = Renumbering::new(&[false, true, true, false, false], &[None]);
        assert_eq!(fewer.sources, [0, 5, 4, 3]);
        assert_eq!(fewer.new_numbers, [0, NONE, NONE, 3, 2, 1]);
        let more = Renumbering::new(&[true, false], &[None, None, None]);
        assert_eq!(more.sources, [2, 1, 3, 4]);
        let none = Renumbering::new(&[false, false, true], &[]);
        assert_eq!(none.sources, [0, 1]);
    }
}
