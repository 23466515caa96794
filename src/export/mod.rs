//! Meshes out (and in again): one file per format. Physical coordinates only; [`to_physical`]
//! makes them.
//!
//! - [`vtu`]: VTK unstructured grids, our own mesh format
//! - [`pvd`]: the lattice after each round, for ParaView
//! - [`surfaces`]: labelled surfaces, for [`vtp`], [`obj`] and GOCAD's [`tsurf`]

pub mod obj;
pub mod pvd;
pub mod surfaces;
pub mod tsurf;
pub mod vtp;
pub mod vtu;

pub use obj::write_obj;
pub use pvd::Trace;
pub use surfaces::SurfaceFile;
pub use tsurf::write_tsurf;
pub use vtp::write_vtp;
pub use vtu::{FieldValue, MeshFile, read_vtu, write_vtu};

use rayon::prelude::*;

use crate::image::Geometry;
use crate::mesh::{TetMesh, volume6};

/// A mesh in lattice space (sample index times `step`) as a mesh in physical space.
///
/// Nodes and tetrahedra keep their order. Where the geometry mirrors space (depth downwards, say),
/// nodes 2 and 3 of every tetrahedron change places, so that all stay positively oriented.
pub fn to_physical(mesh: &TetMesh, step: [f64; 3], geometry: &Geometry<3>) -> TetMesh {
    let physical = |p: &[f64; 3]| geometry.to_physical(std::array::from_fn(|k| p[k] / step[k]));
    let nodes = mesh.nodes.par_iter().map(physical).collect();
    let mirrored = mirrors(geometry);
    let turn = |t: &[u32; 4]| {
        if mirrored {
            [t[0], t[1], t[3], t[2]]
        } else {
            *t
        }
    };
    TetMesh {
        nodes,
        tets: mesh.tets.iter().map(turn).collect(),
    }
}

/// Bits for the faces of tetrahedra (bit k: the face opposite node k) as [`to_physical`] turns their
/// nodes, there and back.
pub fn face_bits_to_physical(bits: &[u8], geometry: &Geometry<3>) -> Vec<u8> {
    let mirrored = mirrors(geometry);
    let turn = |b: u8| {
        if mirrored {
            (b & 3) | (b & 4) << 1 | (b & 8) >> 1
        } else {
            b
        }
    };
    bits.iter().map(|&b| turn(b)).collect()
}

fn mirrors(geometry: &Geometry<3>) -> bool {
    let [a, b, c] = geometry.axes;
    volume6(&[[0.0; 3], a, b, c]) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
