//! Builds the mesh from the rings of simplices and their centres: faces with their distinct nodes
//! in order, numbered as they occur.

use super::mirror::MirroredAtoms;
use super::needles::{EdgePaths, merge_sides};
use super::nodes::SimplexGroups;
use super::rings::Rings;
use crate::error::{Error, Result, cause};
use crate::geometry::NONE;
use crate::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};

/// Returns the mesh of the cells.
///
/// # Errors
/// Returns [`Error::Delaunay`] if an atom's cell ends on another atom's image, which is impossible
/// in a Delaunay triangulation.
pub fn assemble<const D: usize>(
    mirrored: &MirroredAtoms<D>,
    rings: Vec<Rings>,
    mut centres: Vec<[f64; D]>,
    extent: [f64; D],
    reach: impl Fn(u32) -> f64,
) -> Result<PolyMesh<D>> {
    let mut groups = SimplexGroups::new(centres.len());
    for &[s, t] in rings.iter().flat_map(|part| &part.coincident_pairs) {
        groups.merge(s, t);
    }
    for &[s, t] in rings.iter().flat_map(|part| &part.coincident_pairs) {
        let first = groups.find_first(s);
        merge_sides(&mut centres, first, &[s, t], extent);
    }
    let paths = EdgePaths::new(&rings, &mut groups, &mut centres, extent, reach);
    // Nodes are numbered in the order of the atoms at which they first occur.
    let mut node_numbers = vec![NONE; centres.len()];
    let mut nodes = Vec::with_capacity(centres.len());
    let mut node_number = |first: u32| {
        let number = &mut node_numbers[first as usize];
        if *number == NONE {
            *number = nodes.len() as u32;
            nodes.push(centres[first as usize]);
        }
        *number
    };
    let (mut faces, mut face_cells) = (Lists::default(), Vec::new());
    faces
        .items
        .reserve(rings.iter().map(|p| p.simplices.items.len()).sum());
    let count = rings.iter().map(|p| p.edges.len()).sum();
    faces.offsets.reserve(count);
    face_cells.reserve(count);
    let (mut sides, mut side_cells) = (Lists::default(), Vec::new());
    let mut ring = Vec::new();
    for part in rings {
        for (edge, &[a, b]) in part.edges.iter().enumerate() {
            let simplices = part.simplices.get(edge);
            paths.trace(simplices.iter().map(|&s| groups.find_first(s)), &mut ring);
            if ring.len() < D {
                continue;
            }
            ring.iter_mut().for_each(|s| *s = node_number(*s));
            if (b as usize) < mirrored.atom_count {
                faces.push(ring.iter().copied());
                face_cells.push([a, b]);
                continue;
            }
            let (atom, side) = mirrored.images[b as usize - mirrored.atom_count];
            if atom != a {
                return Err(Error::Delaunay(cause(
                    "Voronoi cells",
                    format!("the cell of atom {a} ends on the image of atom {atom}"),
                    "please report it with the atoms",
                )));
            }
            sides.push(ring.iter().copied());
            side_cells.push([a, FIRST_SIDE + u32::from(side)]);
        }
    }
    for (side, cells) in side_cells.into_iter().enumerate() {
        faces.push(sides.get(side).iter().copied());
        face_cells.push(cells);
    }
    Ok(PolyMesh {
        nodes,
        region: vec![0; mirrored.atom_count],
        on_feature: vec![false; face_cells.len()],
        faces,
        face_cells,
        sites: mirrored.points[..mirrored.atom_count].to_vec(),
    })
}
