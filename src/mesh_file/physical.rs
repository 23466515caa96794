//! Meshes in lattice space and in physical space.

use crate::image::Geometry;
use crate::mesh::Simplices;
use crate::mesh::interface::reverse_orientation;
use crate::parallel::prelude::*;

/// Converts a mesh from lattice space (sample index times `step`) to physical space.
///
/// Nodes and cells keep their order. If the geometry mirrors space (depth downwards, for example),
/// the last two nodes of every cell are exchanged, so that all cells stay positively oriented.
pub fn to_physical<const D: usize, M: Simplices<D>>(
    mesh: &M,
    step: [f64; D],
    geometry: &Geometry<D>,
) -> M {
    let physical = |p: &[f64; D]| geometry.to_physical(std::array::from_fn(|k| p[k] / step[k]));
    let nodes = mesh.nodes().par_iter().map(physical).collect();
    replace_nodes(mesh, nodes, geometry)
}

/// Returns a mesh with the same cells and other nodes. If the geometry mirrors space, the last two
/// nodes of every cell are exchanged.
pub fn replace_nodes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    nodes: Vec<[f64; D]>,
    geometry: &Geometry<D>,
) -> M {
    let mut mesh = mesh.with_nodes(nodes);
    if geometry.determinant() < 0.0 {
        reverse_orientation::<D>(mesh.parts_mut().1);
    }
    mesh
}

/// Converts the bits of cells' faces (bit k: the face opposite node k) between lattice and physical
/// space, in either direction: if [`to_physical`] mirrors space, it exchanges the last two nodes.
pub fn face_bits_to_physical<const D: usize>(bits: &[u8], mirrored: bool) -> Vec<u8> {
    if !mirrored {
        return bits.to_vec();
    }
    let (last, second_last) = (1 << D, 1 << (D - 1));
    let swap_last_two =
        |b: u8| (b & !(last | second_last)) | (b & second_last) << 1 | (b & last) >> 1;
    bits.iter().map(|&b| swap_last_two(b)).collect()
}
#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::volume6;
    use crate::mesh::{TetMesh, TriMesh};

    #[test]
    fn physical_tetrahedra_stay_positive_also_when_space_is_mirrored() {
        let mesh = TetMesh {
            nodes: vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 4.0]],
            tets: vec![[0, 1, 2, 3]],
        };
        for depth in [5.0, -5.0] {
            let geometry = Geometry::with_spacing([10.0, 20.0, 30.0], [1.0, 3.0, depth]);
            let physical = to_physical(&mesh, [2.0, 1.0, 0.5], &geometry);
            assert_eq!(physical.nodes[1], [11.0, 20.0, 30.0]);
            assert_eq!(physical.nodes[2], [10.0, 29.0, 30.0]);
            assert_eq!(physical.nodes[3], [10.0, 20.0, 30.0 + 8.0 * depth]);
            assert_eq!(volume6(&physical.corners(0)), 1.0 * 9.0 * 40.0);
        }
    }

    #[test]
    fn physical_triangles_stay_positive_and_keep_their_marked_edges() {
        let mesh = TriMesh {
            nodes: vec![[0.0; 2], [2.0, 0.0], [0.0, 3.0]],
            triangles: vec![[0, 1, 2]],
        };
        for sample_interval in [5.0, -5.0] {
            let geometry = Geometry::with_spacing([10.0, 20.0], [1.0, sample_interval]);
            let physical = to_physical(&mesh, [1.0, 0.5], &geometry);
            assert_eq!(physical.nodes[2], [10.0, 20.0 + 6.0 * sample_interval]);
            assert_eq!(physical.volume(0), 30.0);
            // The edge between nodes 0 and 1 is opposite node 2.
            let mirrored = geometry.determinant() < 0.0;
            let bits = face_bits_to_physical::<2>(&[4], mirrored);
            let k = bits[0].trailing_zeros() as usize;
            assert_eq!(physical.triangles[0][k], 2);
            assert_eq!(face_bits_to_physical::<2>(&bits, mirrored), [4]);
        }
    }
}
