//! Rings of simplices and their centres -> the mesh: faces with the nodes that differ, in order,
//! numbered as they are met.

use rayon::prelude::*;

use super::mirror::Mirrored;
use super::nodes::{Node, merged};
use super::rings::Rings;
use crate::error::{Error, Result, cause};
use crate::mesh::poly::{Lists, PolyMesh, SIDE_0};

/// Rings in one task.
const CHUNK: usize = 8192;

/// Some faces: nodes by the numbers of simplices.
#[derive(Default)]
struct Faces {
    nodes: Lists,
    cells: Vec<[u32; 2]>,
}

impl Faces {
    fn push(&mut self, nodes: &[u32], cells: [u32; 2]) {
        self.nodes.push(nodes.iter().copied());
        self.cells.push(cells);
    }

    fn append(&mut self, other: &Self) {
        let base = self.nodes.items.len() as u32;
        self.nodes.items.extend_from_slice(&other.nodes.items);
        let offsets = &other.nodes.offsets[1..];
        self.nodes.offsets.extend(offsets.iter().map(|o| o + base));
        self.cells.extend_from_slice(&other.cells);
    }
}

/// The mesh of the cells.
///
/// # Errors
/// [`Error::Delaunay`] if an atom's cell ends on another atom's image, which no true Delaunay
/// triangulation can say.
pub fn assemble<const D: usize>(
    mirrored: &Mirrored<D>,
    rings: &Rings,
    centres: &[Node<D>],
    tolerance: f64,
) -> Result<PolyMesh<D>> {
    let node_of = merged(centres, rings, tolerance);
    let parts: Vec<Result<[Faces; 2]>> = (0..rings.edges.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let all = chunk * CHUNK..((chunk + 1) * CHUNK).min(rings.edges.len());
            let mut faces = [Faces::default(), Faces::default()];
            let mut ring = Vec::new();
            for edge in all {
                collapse(rings.simplices.get(edge), &node_of, &mut ring);
                if ring.len() < D {
                    continue;
                }
                let [a, b] = rings.edges[edge];
                if (b as usize) < mirrored.atoms {
                    faces[0].push(&ring, [a, b]);
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
                faces[1].push(&ring, [a, SIDE_0 + u32::from(side)]);
            }
            Ok(faces)
        })
        .collect();
    let mut faces = Faces::default();
    let mut sides = Faces::default();
    for part in parts {
        let [inner, outer] = part?;
        faces.append(&inner);
        sides.append(&outer);
    }
    faces.append(&sides);

    let mut number = vec![u32::MAX; centres.len()];
    let mut nodes = Vec::new();
    for node in &mut faces.nodes.items {
        let number = &mut number[*node as usize];
        if *number == u32::MAX {
            *number = nodes.len() as u32;
            nodes.push(centres[*node as usize].position);
        }
        *node = *number;
    }
    Ok(PolyMesh {
        nodes,
        region: vec![0; mirrored.atoms],
        on_feature: vec![false; faces.cells.len()],
        faces: faces.nodes,
        face_cells: faces.cells,
        sites: mirrored.points[..mirrored.atoms].to_vec(),
    })
}

/// The nodes of a ring that differ, into `nodes`: repeats go, and so do ways to a node and back.
fn collapse(ring: &[u32], node_of: &[u32], nodes: &mut Vec<u32>) {
    nodes.clear();
    for node in ring.iter().map(|&s| node_of[s as usize]) {
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
        let same: Vec<u32> = (0..9).collect();
        let check = |ring: &[u32], want: &[u32]| {
            let mut nodes = Vec::new();
            collapse(ring, &same, &mut nodes);
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
