//! Blocks of cells (`NFACED`) that are lists of faces (`NSIDED`).

use super::{ObjectList, missing_element_error, node_sets, nodes, side_sets};
use crate::geometry::sorted;
use crate::mesh::renumber::new_numbers;
use crate::mesh_file::formats::exodus::{ELEMENT_TYPE, ELEMENTS, ELEMENTS_OF_FACES, FACES};
use crate::store::foreign::groups::{CellGroups, Combinations, Group, GroupNames, GroupedFaces};
use crate::store::foreign::netcdf::NetcdfReader;
use crate::store::foreign::{
    FileProblem, NotedMesh, ReadResult, labels_field, note_lost, poly_file, renumber_sets,
};
use crate::store::mixed_elements::SolidAssembler;
use crate::store::named_sets::NamedSets;

/// Reads a mesh of polyhedra.
pub fn read(file: &NetcdfReader, blocks: &ObjectList) -> ReadResult<NotedMesh> {
    let mut faces: Vec<Vec<u32>> = Vec::new();
    for block in 1.. {
        let connect = format!("{}{block}", FACES.list);
        if file.shape(&connect).is_none() {
            break;
        }
        faces.extend(read_lists(
            file,
            &connect,
            &format!("{}{block}", FACES.counts),
        )?);
    }
    let mut combinations = Combinations::default();
    let mut block_names = GroupNames::new();
    let (cells, cell_combinations) =
        read_blocks(file, blocks, &mut combinations, &mut block_names)?;
    let ring = |&face: &u32| faces.get(face as usize).cloned();
    let no_face = || FileProblem::damaged("has a cell with a face that does not exist");
    let mut solids = SolidAssembler::default();
    for cell in &cells {
        let rings: Option<Vec<Vec<u32>>> = cell.iter().map(ring).collect();
        solids.add(rings.ok_or_else(no_face)?);
    }
    let positions = nodes(file)?;
    let (mut mesh, kept) = solids.into_mesh(&positions).map_err(FileProblem::damaged)?;
    let cell_groups = CellGroups::new(&cell_combinations, &combinations, &block_names);
    mesh.region = cell_groups.regions;
    let new_index = new_numbers(positions.len(), &kept);
    let mut set_names = GroupNames::new();
    let mut grouped = Vec::new();
    for side in side_sets(file, &mut set_names)? {
        let cell = cells.get(side.element);
        let nodes = cell.and_then(|cell| ring(cell.get(side.side)?));
        let nodes = nodes.ok_or_else(missing_element_error)?;
        let nodes = nodes.into_iter().map(|n| new_index[n as usize]);
        let combination = combinations.number(&[side.group]);
        grouped.push((sorted(nodes.collect::<Vec<u32>>()), combination));
    }
    let mut notes = Vec::new();
    let mut sets = NamedSets {
        nodes: node_sets(file, positions.len())?,
        ..NamedSets::default()
    };
    let lost = renumber_sets(&mut sets.nodes, &new_index);
    note_lost(&mut notes, lost, "nodes of sets belong to no cell");
    let grouped = GroupedFaces::new(grouped, &mut combinations, &set_names);
    let mut read = poly_file(mesh, grouped, sets, &mut notes);
    let labels = labels_field(&read.mesh.region, &cell_groups.names);
    read.field_data.extend(labels);
    Ok((crate::store::AnyMesh::Polyhedra(read), notes))
}

/// Reads the faces of all cells, and the combination of the groups of each cell.
fn read_blocks(
    file: &NetcdfReader,
    blocks: &ObjectList,
    combinations: &mut Combinations,
    names: &mut GroupNames,
) -> ReadResult<(Vec<Vec<u32>>, Vec<u32>)> {
    let (mut cells, mut groups): (Vec<Vec<u32>>, Vec<u32>) = (Vec::new(), Vec::new());
    for (block, &id) in blocks.ids.iter().enumerate() {
        let [face_array, node_array] =
            [&ELEMENTS_OF_FACES, &ELEMENTS].map(|names| format!("{}{}", names.list, block + 1));
        let group = Group::Physical(id);
        blocks.add_name(block, group, names);
        if file.shape(&face_array).is_some() {
            cells.extend(read_lists(
                file,
                &face_array,
                &format!("{}{}", ELEMENTS_OF_FACES.counts, block + 1),
            )?);
            groups.resize(cells.len(), combinations.number(&[group]));
        } else if file.shape(&node_array).is_some() {
            let kind = file
                .attribute(&node_array, ELEMENT_TYPE)
                .unwrap_or_default();
            return Err(FileProblem {
                problem: format!(
                    "block {id} has elements '{kind}', but other blocks have cells that are lists of faces"
                ),
                remedy: "write all blocks with cells that are lists of faces (NFACED)",
            });
        }
    }
    Ok((cells, groups))
}

/// Reads lists of numbers, which count from 1 in the file. The array `counts` has the length of
/// each list; without it, all lists have the length of a row.
fn read_lists(file: &NetcdfReader, name: &str, counts: &str) -> ReadResult<Vec<Vec<u32>>> {
    let numbers = file.numbers(name)?;
    let counts: Vec<f64> = match (file.shape(counts), file.shape(name)) {
        (None, Some(shape)) if shape.len() == 2 => vec![shape[1] as f64; shape[0]],
        _ => file.numbers(counts)?,
    };
    let damaged = || FileProblem::damaged(format!("'{name}' is not as long as its lists together"));
    let mut remaining = numbers.as_slice();
    let mut lists = Vec::with_capacity(counts.len());
    for count in counts {
        let (list, tail) = remaining
            .split_at_checked(count as usize)
            .ok_or_else(damaged)?;
        remaining = tail;
        // A zero is invalid; it becomes a number that is too large.
        lists.push(list.iter().map(|&n| (n as u32).wrapping_sub(1)).collect());
    }
    remaining.is_empty().then_some(lists).ok_or_else(damaged)
}
