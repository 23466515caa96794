//! Rings of simplices and their centres -> the mesh: faces with the nodes that differ, in order,
//! numbered as they are met.

use super::mirror::Mirrored;
use super::nodes::Groups;
use super::rings::Rings;
use crate::error::{Error, Result, cause};
use crate::mesh::poly::{Lists, PolyMesh, SIDE_0};

/// The mesh of the cells.
///
/// # Errors
/// [`Error::Delaunay`] if an atom's cell ends on another atom's image, which no true Delaunay
/// triangulation can say.
pub fn assemble<const D: usize>(
    mirrored: &Mirrored<D>,
    rings: Vec<Rings>,
    centres: &[[f64; D]],
) -> Result<PolyMesh<D>> {
    let mut groups = Groups::new(centres.len());
    for &[s, t] in rings.iter().flat_map(|part| &part.joined) {
        groups.join(s, t);
    }
    // Nodes are numbered as they are met, in the order of atoms.
    let mut number = vec![u32::MAX; centres.len()];
    let mut nodes = Vec::with_capacity(centres.len());
    let mut node_of = |s: u32| {
        let mut node = number[s as usize];
        if node == u32::MAX {
            let first = groups.first(s) as usize;
            node = number[first];
            if node == u32::MAX {
                node = nodes.len() as u32;
                nodes.push(centres[first]);
                number[first] = node;
            }
            number[s as usize] = node;
        }
        node
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
            collapse(simplices.iter().map(|&s| node_of(s)), &mut ring);
            if ring.len() < D {
                continue;
            }
            if (b as usize) < mirrored.atoms {
                faces.push(ring.iter().copied());
                face_cells.push([a, b]);
                continue;
            }
            let (atom, side) = mirrored.images[b as usize - mirrored.atoms];
            if atom != a {
                return Err(Error::Delaunay(cause(
                    "Voronoi cells",
                    format!("atom {a} seems to be nearest beyond the side of atom {atom}"),
                    "please report it with the atoms",
                )));
            }
            sides.push(ring.iter().copied());
            side_cells.push([a, SIDE_0 + u32::from(side)]);
        }
    }
    for (side, cells) in side_cells.into_iter().enumerate() {
        faces.push(sides.get(side).iter().copied());
        face_cells.push(cells);
    }
    Ok(PolyMesh {
        nodes,
        region: vec![0; mirrored.atoms],
        on_feature: vec![false; face_cells.len()],
        faces,
        face_cells,
        sites: mirrored.points[..mirrored.atoms].to_vec(),
    })
}

/// The nodes of a ring that differ, into `nodes`: repeats go, and so do ways to a node and back.
fn collapse(ring: impl Iterator<Item = u32>, nodes: &mut Vec<u32>) {
    nodes.clear();
    for node in ring {
        if nodes.last() == Some(&node) {
            continue;
        }
        nodes.push(node);
        while let [.., x, _, y] = nodes[..]
            && x == y
        {
            nodes.truncate(nodes.len() - 2);
        }
    }
    // The same where the end meets the beginning.
    let mut start = 0;
    loop {
        let rest = &nodes[start..];
        match rest {
            [first, .., last] if first == last => {
                nodes.pop();
            }
            [first, .., second_last, _] if rest.len() > 2 && first == second_last => {
                nodes.truncate(nodes.len() - 2);
            }
            [_, second, .., last] if rest.len() > 2 && second == last => start += 2,
            _ => break,
        }
    }
    nodes.drain(..start);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_lose_repeats_and_spikes() {
        let check = |ring: &[u32], want: &[u32]| {
            let mut nodes = Vec::new();
            collapse(ring.iter().copied(), &mut nodes);
            let mut turned = want.to_vec();
            let any = (0..want.len().max(1)).any(|_| {
                turned.rotate_left(1.min(want.len()));
                turned == nodes
            });
            assert!(any, "{ring:?}: {nodes:?}, not {want:?}");
        };
        check(&[1, 2, 3], &[1, 2, 3]);
        check(&[1, 1, 2, 2, 3, 1], &[1, 2, 3]);
        check(&[1, 2, 3, 2, 4], &[1, 2, 4]);
        check(&[2, 4, 1, 2, 3], &[2, 4, 1]);
        check(&[3, 2, 4, 1, 2], &[2, 4, 1]);
        check(&[5, 6, 5, 5], &[5]);
        check(&[5, 6], &[5, 6]);
        check(&[7, 7], &[7]);
    }
}
