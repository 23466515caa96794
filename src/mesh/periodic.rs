//! Opposite sides of a box that match node by node, so that copies of a mesh fill space.
//!
//! A node on the far side of a periodic axis is the image of the node on the near side whose other
//! coordinates are the same, to the last bit. On an edge or in a corner of the box a node is far
//! along several axes. Its *base* is the node that is near along all of them.

use std::collections::BTreeMap;

use super::Simplices;
use super::complex::NONE;
use crate::error::cause;
use crate::geometry::sorted;
use crate::{Error, Result};

/// Coordinates as bits, which are equal only for equal coordinates.
type PointKey<const D: usize> = [u64; D];

/// Returns the key of a point; -0 and 0 are the same coordinate.
fn key<const D: usize>(x: [f64; D]) -> PointKey<D> {
    x.map(|c| (c + 0.0).to_bits())
}

/// The nodes of a mesh, or the atoms of a lattice, in a box with periodic axes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PeriodicNodes {
    /// The base of each node; its own number for nodes on no far side.
    pub base: Vec<u32>,
    /// Bit k for each periodic axis on whose far side a node lies.
    pub far_axes: Vec<u8>,
    /// Number of nodes on near or far sides that have no counterpart.
    pub unmatched: usize,
}

impl PeriodicNodes {
    /// Finds the bases of nodes in the box `[0, extent]`.
    pub fn new<const D: usize>(nodes: &[[f64; D]], extent: [f64; D], axes: [bool; D]) -> Self {
        let is_far = |x: &[f64; D], k: usize| axes[k] && x[k] == extent[k];
        let is_near = |x: &[f64; D], k: usize| axes[k] && x[k] == 0.0;
        let on_sides = (0..).zip(nodes);
        let on_sides = on_sides.filter(|(_, x)| (0..D).any(|k| is_far(x, k) || is_near(x, k)));
        let numbers: BTreeMap<PointKey<D>, u32> =
            on_sides.clone().map(|(n, x)| (key(*x), n)).collect();
        let mut result = Self {
            base: (0..nodes.len() as u32).collect(),
            far_axes: vec![0; nodes.len()],
            unmatched: 0,
        };
        for (n, x) in on_sides {
            let bits = (0..D).filter(|&k| is_far(x, k));
            result.far_axes[n as usize] = bits.fold(0, |bits, k| bits | 1 << k);
            let near = std::array::from_fn(|k| if is_far(x, k) { 0.0 } else { x[k] });
            let has_images = (0..D).filter(|&k| is_near(x, k)).all(|k| {
                let mut image = *x;
                image[k] = extent[k];
                numbers.contains_key(&key(image))
            });
            match numbers.get(&key(near)) {
                Some(&base) if has_images => result.base[n as usize] = base,
                _ => result.unmatched += 1,
            }
        }
        result
    }

    /// Returns the nodes that are images of others, each with its base.
    pub fn pairs(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let numbered = (0..).zip(self.base.iter().copied());
        numbered.filter(|(n, base)| n != base)
    }

    /// Moves each image to where its base is, beyond the box.
    pub fn follow_bases<const D: usize>(&self, positions: &mut [[f64; D]], extent: [f64; D]) {
        for (n, base) in self.pairs() {
            let (bits, near) = (self.far_axes[n as usize], positions[base as usize]);
            positions[n as usize] = std::array::from_fn(|k| {
                if bits >> k & 1 == 1 {
                    extent[k]
                } else {
                    near[k]
                }
            });
        }
    }
}

/// Figures of a periodic mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PeriodicCheck {
    /// Number of nodes that are images of others.
    pub node_pairs: usize,
    /// Number of pairs of opposite faces.
    pub face_pairs: usize,
    /// Number of these whose cells belong to different regions.
    pub different_regions: usize,
}

/// Checks that opposite sides of a mesh of the box `[0, extent]` match. `neighbours` are those of its
/// cells, and `regions` the regions of its cells, or empty.
///
/// # Errors
/// Returns [`Error::Mesh`] if a node or a face has no counterpart.
pub fn check_periodic<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbours: &[u32],
    regions: &[i32],
    extent: [f64; D],
    axes: [bool; D],
) -> Result<(PeriodicNodes, PeriodicCheck)> {
    let nodes = PeriodicNodes::new(mesh.nodes(), extent, axes);
    let refuse = |count: usize, what: &str| {
        Error::Mesh(cause(
            "the periodic mesh",
            format!("came out with {count} {what} without a counterpart on the opposite side"),
            "choose another distance or seed, and please report it with the image: this is an error in atomesh",
        ))
    };
    if nodes.unmatched > 0 {
        return Err(refuse(nodes.unmatched, "nodes"));
    }
    let mut check = PeriodicCheck {
        node_pairs: nodes.pairs().count(),
        ..PeriodicCheck::default()
    };
    for k in (0..D).filter(|&k| axes[k]) {
        let mut sides: [BTreeMap<Vec<(u32, u8)>, usize>; 2] = Default::default();
        for (face, _) in (0..).zip(neighbours).filter(|(_, n)| **n == NONE) {
            let (c, i) = (face / (D + 1), face % (D + 1));
            let corners = mesh.face(c, i);
            for (side, plane) in [0.0, extent[k]].into_iter().enumerate() {
                if corners
                    .iter()
                    .all(|&n| mesh.nodes()[n as usize][k] == plane)
                {
                    let near = corners.map(|n| shifted_number(&nodes, n, k));
                    sides[side].insert(sorted(near.to_vec()), c);
                }
            }
        }
        let [near, far] = &sides;
        let unmatched = near.keys().filter(|face| !far.contains_key(*face)).count()
            + far.keys().filter(|face| !near.contains_key(*face)).count();
        if unmatched > 0 {
            return Err(refuse(unmatched, "faces"));
        }
        check.face_pairs += near.len();
        let pairs = near.values().zip(far.values());
        let differ = |(a, b): &(&usize, &usize)| regions.get(**a) != regions.get(**b);
        check.different_regions += pairs.filter(differ).count();
    }
    Ok((nodes, check))
}

/// Returns what a node has in common with the node opposite it along `axis`, and with no
/// other node on the same side.
fn shifted_number(nodes: &PeriodicNodes, node: u32, axis: usize) -> (u32, u8) {
    // Nodes on a side that have one base differ in the other axes along which they are far.
    let other_axes = nodes.far_axes[node as usize] & !(1 << axis);
    (nodes.base[node as usize], other_axes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::boxes::kuhn_box;

    #[test]
    fn nodes_of_a_regular_box_have_their_bases_for_any_axes() {
        let mesh = kuhn_box([3, 4, 2], 1.0);
        let extent = [3.0, 4.0, 2.0];
        for bits in 1..8 {
            let axes = [0, 1, 2].map(|k| bits >> k & 1 == 1);
            let neighbours = mesh.neighbours().unwrap();
            let (nodes, check) = check_periodic(&mesh, &neighbours, &[], extent, axes).unwrap();
            let counts = [4, 5, 3];
            let all: usize = counts.iter().product();
            let bases: usize = (0..3).map(|k| counts[k] - usize::from(axes[k])).product();
            assert_eq!(check.node_pairs, all - bases, "{axes:?}");
            let sides = [16, 12, 24];
            let faces: usize = (0..3).filter(|&k| axes[k]).map(|k| sides[k]).sum();
            assert_eq!(
                (check.face_pairs, check.different_regions),
                (faces, 0),
                "{axes:?}"
            );
            for (n, base) in nodes.pairs() {
                let (x, y) = (mesh.nodes[n as usize], mesh.nodes[base as usize]);
                for k in 0..3 {
                    let shift = if nodes.far_axes[n as usize] >> k & 1 == 1 {
                        extent[k]
                    } else {
                        0.0
                    };
                    assert_eq!(x[k] - y[k], shift);
                }
            }
        }
    }

    #[test]
    fn a_node_or_a_face_without_a_counterpart_is_an_error() {
        let mut mesh = kuhn_box([2, 2, 2], 1.0);
        let neighbours = mesh.neighbours().unwrap();
        let middle = mesh
            .nodes
            .iter()
            .position(|x| *x == [2.0, 1.0, 1.0])
            .unwrap();
        mesh.nodes[middle][1] += 1e-15;
        let error = check_periodic(&mesh, &neighbours, &[], [2.0; 3], [true, false, false]);
        let message = error.unwrap_err().to_string();
        assert!(message.contains("2 nodes without"), "{message}");
        // Other diagonals on one side.
        let mut mesh = kuhn_box([1, 1, 1], 1.0);
        mesh.nodes.iter_mut().for_each(|x| x[1] = 1.0 - x[1]);
        mesh.tets.iter_mut().for_each(|tet| tet.swap(0, 1));
        let other = kuhn_box([1, 1, 1], 1.0);
        let mut joined = other.clone();
        for tet in &mesh.tets {
            let joined_tet = tet.map(|n| {
                let mut x = mesh.nodes[n as usize];
                x[0] += 1.0;
                let known = joined.nodes.iter().position(|y| *y == x);
                known.unwrap_or_else(|| {
                    joined.nodes.push(x);
                    joined.nodes.len() - 1
                }) as u32
            });
            joined.tets.push(joined_tet);
        }
        let neighbours = vec![NONE; 4 * joined.tets.len()];
        let error = check_periodic(
            &joined,
            &neighbours,
            &[],
            [2.0, 1.0, 1.0],
            [true, false, false],
        );
        let message = error.unwrap_err().to_string();
        assert!(message.contains("4 faces without"), "{message}");
    }
}
