//! Patches put into the mesh in place of what they are made for.

use super::editable_cells::{ATOM_KIND, EditableCells, ON_FEATURE, volume_name};
use super::patch::{CellPatch, NewCell};
use crate::error::cause;
use crate::files::vtk::DataArray;
use crate::mesh::Mesh;
use crate::mesh::check::{CheckHints, check_with_hints};
use crate::mesh::poly::{FIRST_SIDE, PolyMesh};
use crate::model::edit::Summary;
use crate::store::output::{DISTANCE_ARRAY, HORIZON_FACES_ARRAY};
use crate::store::{FieldValue, MeshFile};
use crate::{Error, Result};

/// New numbers of what a list holds: those that stay keep theirs, new ones fill the places of those that go,
/// then follow; places that are left over take the last.
struct Renumbering {
    /// For each old number and behind these for each new thing.
    new_numbers: Vec<u32>,
    /// For each number where it comes from.
    sources: Vec<u32>,
}

impl Renumbering {
    /// `wishes` are the numbers that new things shall have, if they shall have any: places of those that go.
    fn new(goes: &[bool], wishes: &[Option<u32>]) -> Self {
        let old = goes.len();
        let mut from: Vec<Option<u32>> = (0..old as u32)
            .map(|n| (!goes[n as usize]).then_some(n))
            .collect();
        let mut rest = Vec::new();
        for (i, wish) in (old as u32..).zip(wishes) {
            match wish.map(|n| &mut from[n as usize]) {
                Some(place @ None) => *place = Some(i),
                _ => rest.push(i),
            }
        }
        let mut rest = rest.into_iter();
        for place in from.iter_mut().filter(|place| place.is_none()) {
            *place = rest.next();
        }
        from.extend(rest.map(Some));
        let mut hole = 0;
        while let Some(last) = from.pop() {
            let Some(last) = last else { continue };
            while from.get(hole).is_some_and(Option::is_some) {
                hole += 1;
            }
            match from.get_mut(hole) {
                Some(place) => *place = Some(last),
                None => {
                    from.push(Some(last));
                    break;
                }
            }
        }
        let sources: Vec<u32> = from.into_iter().flatten().collect();
        let mut new_numbers = vec![u32::MAX; old + wishes.len()];
        for (n, &i) in (0..).zip(&sources) {
            new_numbers[i as usize] = n;
        }
        Self {
            new_numbers,
            sources,
        }
    }
}

/// A face with its marks.
type MarkedFace = ([u32; 2], Vec<u32>, bool, bool);

/// The mesh with the patches, and what is known of it, as a file holds it.
///
/// # Errors
/// [`Error::Mesh`] if it is not valid.
pub fn stitch_patches<const D: usize>(
    mut grid: EditableCells<D>,
    patches: Vec<CellPatch<D>>,
    summary: &mut Summary,
) -> Result<MeshFile<PolyMesh<D>>> {
    let (nodes, cells) = (grid.mesh.nodes.len(), grid.mesh.sites.len());
    let flags = |count: usize, of: &dyn Fn(&CellPatch<D>) -> &[u32]| {
        let mut flags = vec![false; count];
        for patch in &patches {
            of(patch).iter().for_each(|&i| flags[i as usize] = true);
        }
        flags
    };
    let dead = flags(nodes, &|patch| &patch.removed_nodes);
    let gone = flags(cells, &|patch| &patch.removed_cells);
    let mut measured = flags(cells, &|patch| &patch.border_cells);
    let new_nodes: Vec<[f64; D]> = patches.iter().flat_map(|p| p.new_nodes.clone()).collect();
    let fresh: Vec<NewCell<D>> = patches.iter().flat_map(|p| p.new_cells.clone()).collect();
    measured.extend(vec![true; fresh.len()]);
    let node = Renumbering::new(&dead, &vec![None; new_nodes.len()]);
    let wishes: Vec<Option<u32>> = fresh.iter().map(|f| f.number).collect();
    let cell = Renumbering::new(&gone, &wishes);

    let mut faces: Vec<MarkedFace> = Vec::new();
    let mut put =
        |ring: &[u32], beside: [u32; 2], on_feature: bool, on_horizon: bool, shift: [usize; 2]| {
            let number = |numbers: &Renumbering, i: u32, old: usize, shift: usize| {
                let i = i as usize;
                numbers.new_numbers[if i < old { i } else { i + shift }]
            };
            let mut ring: Vec<u32> = ring
                .iter()
                .map(|&n| number(&node, n, nodes, shift[0]))
                .collect();
            let mut own = beside.map(|c| match c < FIRST_SIDE {
                true => number(&cell, c, cells, shift[1]),
                false => c,
            });
            if own[1] < own[0] {
                own.reverse();
                ring.reverse();
            }
            faces.push((own, ring, on_feature, on_horizon));
        };
    let old = &grid.mesh;
    for (f, &own) in old.face_cells.iter().enumerate() {
        let ring = old.faces.get(f);
        if ring.iter().all(|&n| !dead[n as usize]) {
            put(ring, own, old.on_feature[f], grid.on_horizon[f], [0, 0]);
        }
    }
    let mut shift = [0, 0];
    for patch in &patches {
        for face in &patch.new_faces {
            put(
                &face.ring,
                face.cells,
                face.on_feature,
                face.on_horizon,
                shift,
            );
        }
        for &(edit, i) in &patch.edited_atoms {
            summary.atoms[edit] = Some(cell.new_numbers[cells + shift[1] + i]);
        }
        shift[0] += patch.new_nodes.len();
        shift[1] += patch.new_cells.len();
    }
    // Faces between cells come first.
    faces.sort_by_key(|face| (face.0[1] >= FIRST_SIDE, face.0));

    let of_cell = |i: u32| fresh.get((i as usize).wrapping_sub(cells));
    let space = &grid.space;
    let mut mesh = PolyMesh::<D> {
        nodes: reorder(&node, &old.nodes, &new_nodes),
        sites: reorder(
            &cell,
            &old.sites,
            &fresh.iter().map(|f| f.site).collect::<Vec<_>>(),
        ),
        region: reorder(
            &cell,
            &old.region,
            &fresh.iter().map(|f| f.region).collect::<Vec<_>>(),
        ),
        ..PolyMesh::default()
    };
    let in_world: Vec<[f64; D]> = new_nodes.iter().map(|&x| space.to_world(x)).collect();
    grid.world.nodes = reorder(&node, &grid.world.nodes, &in_world);
    let in_world: Vec<[f64; D]> = (fresh.iter())
        .map(|f| f.world.unwrap_or_else(|| space.to_world(f.site)))
        .collect();
    grid.world.sites = reorder(&cell, &grid.world.sites, &in_world);
    let mut horizons: Vec<i64> = Vec::new();
    let mut on_feature = vec![0u8; mesh.sites.len()];
    for (own, ring, is_on_feature, is_on_horizon) in faces {
        mesh.faces.push(ring);
        mesh.face_cells.push(own);
        mesh.on_feature.push(is_on_feature);
        if is_on_feature {
            for c in own {
                on_feature[c as usize] = 1;
            }
        }
        if is_on_horizon {
            horizons.extend(own.map(i64::from));
        }
    }
    let known = CheckHints {
        weld: grid.weld,
        ..CheckHints::default()
    };
    let found = check_with_hints(&mesh, known, [0.0; D], space.extent, space.tolerance());
    if let Some(problem) = found.problems.first() {
        return Err(Error::Mesh(cause(
            "the edited mesh",
            format!("came out invalid: {problem}"),
            "give other positions, or mesh the image again; and please report it with the mesh, for \
             this should never happen",
        )));
    }
    mesh.swap_positions(&mut grid.world, space.is_mirrored());

    let lists = mesh.faces_of_cells();
    let size = |(n, &i): (usize, &u32)| match measured[i as usize] {
        true => mesh.cell_shape(n, lists.get(n)).0,
        false => grid.volume[i as usize],
    };
    let volumes: Vec<f64> = cell.sources.iter().enumerate().map(size).collect();
    let distance = |&i: &u32| of_cell(i).map_or_else(|| grid.distance[i as usize], |f| f.distance);
    let distance: Vec<f32> = cell.sources.iter().map(distance).collect();
    let kind = |&i: &u32| of_cell(i).map_or_else(|| grid.kinds[i as usize], |f| f.kind) as u8;
    let kinds: Vec<u8> = cell.sources.iter().map(kind).collect();
    summary.nodes[1] = mesh.nodes.len();
    // A field of the same name further down is a newer one.
    let mut fields: Vec<(String, FieldValue)> = Vec::new();
    let horizons =
        (!horizons.is_empty()).then_some((HORIZON_FACES_ARRAY.into(), FieldValue::Ints(horizons)));
    grid.fields.retain(|(name, _)| name != HORIZON_FACES_ARRAY);
    for (name, value) in grid.fields.into_iter().chain(horizons) {
        match fields.iter_mut().find(|(known, _)| *known == name) {
            Some(field) => field.1 = value,
            None => fields.push((name, value)),
        }
    }
    Ok(MeshFile {
        cell_data: vec![
            DataArray::scalars(volume_name::<D>(), volumes),
            DataArray::scalars(ON_FEATURE, on_feature),
            DataArray::scalars(DISTANCE_ARRAY, distance),
            DataArray::scalars(ATOM_KIND, kinds),
        ],
        point_data: Vec::new(),
        field_data: fields,
        mesh,
    })
}

/// What the things have that come from `old` and `new`, in the order of their new numbers.
fn reorder<T: Copy>(numbers: &Renumbering, old: &[T], new: &[T]) -> Vec<T> {
    let one = |&i: &u32| {
        old.get(i as usize)
            .copied()
            .unwrap_or_else(|| new[i as usize - old.len()])
    };
    numbers.sources.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_things_take_places_and_the_last_fill_what_is_left() {
        // Old 0 to 4, of which 1 and 2 go; two new ones, the second shall be 1.
        let numbers = Renumbering::new(&[false, true, true, false, false], &[None, Some(1)]);
        assert_eq!(numbers.sources, [0, 6, 5, 3, 4]);
        let fewer = Renumbering::new(&[false, true, true, false, false], &[None]);
        assert_eq!(fewer.sources, [0, 5, 4, 3]);
        assert_eq!(fewer.new_numbers, [0, u32::MAX, u32::MAX, 3, 2, 1]);
        let more = Renumbering::new(&[true, false], &[None, None, None]);
        assert_eq!(more.sources, [2, 1, 3, 4]);
        let none = Renumbering::new(&[false, false, true], &[]);
        assert_eq!(none.sources, [0, 1]);
    }
}
