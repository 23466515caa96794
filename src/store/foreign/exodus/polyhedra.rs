//! Blocks of cells (`NFACED`) that are lists of faces (`NSIDED`).

use super::{BlockGroups, missing_element_error, nodes, side_set_sides};
use crate::geometry::sorted;
use crate::mesh::poly::PolyMesh;
use crate::store::MeshFile;
use crate::store::foreign::netcdf::NetcdfReader;
use crate::store::foreign::{FileProblem, NamedFaces, ReadResult, labels_field};
use crate::store::mixed_elements::SolidAssembler;

/// Reads a mesh of polyhedra.
pub fn read(file: &NetcdfReader, groups: BlockGroups) -> ReadResult<MeshFile<PolyMesh<3>>> {
    let mut faces: Vec<Vec<u32>> = Vec::new();
    for block in 1.. {
        let connect = format!("fbconn{block}");
        if file.shape(&connect).is_none() {
            break;
        }
        faces.extend(read_lists(file, &connect, &format!("fbepecnt{block}"))?);
    }
    let (cells, region) = read_blocks(file, &groups)?;
    let ring = |&face: &u32| faces.get(face as usize).cloned();
    let no_face = || FileProblem::damaged("has a cell with a face that does not exist");
    let mut solids = SolidAssembler::default();
    for cell in &cells {
        let rings: Option<Vec<Vec<u32>>> = cell.iter().map(ring).collect();
        solids.add(rings.ok_or_else(no_face)?);
    }
    let (mut mesh, kept) = solids
        .into_mesh(&nodes(file)?)
        .map_err(FileProblem::damaged)?;
    mesh.region = region;
    let mut named = Vec::new();
    for (set, element, side) in side_set_sides(file)? {
        let cell = element.checked_sub(1).and_then(|i| cells.get(i));
        let face = cell
            .zip(side.checked_sub(1))
            .and_then(|(cell, i)| cell.get(i));
        let nodes = face.and_then(ring).ok_or_else(missing_element_error)?;
        named.push((sorted(nodes), -set));
    }
    named.sort_unstable();
    let names = NamedFaces::new(&groups.face_names);
    let mut surfaces = Vec::new();
    let mut horizons = Vec::new();
    for f in 0..mesh.inner_face_count() {
        let ring = mesh.faces.get(f).iter().map(|&n| kept[n as usize]);
        let ring: Vec<u32> = sorted(ring.collect());
        let first = named.partition_point(|(nodes, _)| *nodes < ring);
        let same_face = named[first..]
            .iter()
            .take_while(|(nodes, _)| *nodes == ring);
        let groups_of_face: Vec<i32> = same_face.map(|(_, group)| *group).collect();
        mesh.on_feature[f] = !groups_of_face.is_empty();
        surfaces.extend(
            names
                .name_index(&groups_of_face)
                .map(|name_index| (mesh.face_cells[f], name_index)),
        );
        if names.has_horizon(&groups_of_face) {
            horizons.extend(mesh.face_cells[f].map(i64::from));
        }
    }
    let mut field_data = names.named_surfaces(surfaces).into_fields();
    field_data.extend(NamedFaces::horizons_field(horizons));
    field_data.extend(labels_field(&mesh.region, &groups.region_names));
    Ok(MeshFile {
        mesh,
        point_data: Vec::new(),
        cell_data: Vec::new(),
        field_data,
    })
}

/// Reads the faces of all cells, and the region of each cell.
fn read_blocks(file: &NetcdfReader, groups: &BlockGroups) -> ReadResult<(Vec<Vec<u32>>, Vec<i32>)> {
    let (mut cells, mut region): (Vec<Vec<u32>>, Vec<i32>) = (Vec::new(), Vec::new());
    for block in 0..groups.block_ids.len().max(1) {
        let [face_array, node_array] =
            ["facconn", "connect"].map(|name| format!("{name}{}", block + 1));
        if file.shape(&face_array).is_some() {
            cells.extend(read_lists(
                file,
                &face_array,
                &format!("ebepecnt{}", block + 1),
            )?);
            region.resize(cells.len(), groups.region(block));
        } else if file.shape(&node_array).is_some() {
            let kind = file.attribute(&node_array, "elem_type").unwrap_or_default();
            return Err(FileProblem {
                problem: format!(
                    "block {} has elements '{kind}', but other blocks have cells that are lists of faces",
                    groups.block_number(block)
                ),
                remedy: "write all blocks with cells that are lists of faces (NFACED)",
            });
        }
    }
    Ok((cells, region))
}

/// Reads lists of numbers, which count from 1 in the file. The array `counts` has the length of
/// each list; without it, all lists have the length of a row.
fn read_lists(file: &NetcdfReader, name: &str, counts: &str) -> ReadResult<Vec<Vec<u32>>> {
    let numbers = file.numbers(name)?;
    let counts: Vec<f64> = match (file.shape(counts), file.shape(name)) {
        (None, Some(&[count, size])) => vec![size as f64; count],
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
