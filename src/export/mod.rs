//! Meshes out (and in again): one file per format. Physical coordinates only; [`to_physical`]
//! makes them.
//!
//! - [`vtu`]: VTK unstructured grids, our own mesh format
//! - [`polyhedra`]: the same for polyhedra and polygons
//! - [`pvd`]: the lattice after each round, for ParaView
//! - [`surfaces`]: labelled surfaces, for [`vtp`], [`obj`] and GOCAD's [`tsurf`]
//!
//! Models for simulators, each with its writer in a file of its own:
//!
//! - [`format`](mod@format): the table of them
//! - [`text`]: numbers as text, fast
//! - [`twin`]: the VTU beside a format that does not hold the cells' shapes
//! - [`opm`]: decks for OPM Flow and Eclipse
//! - [`openfoam`]: OpenFOAM cases
//! - [`disv`]: MODFLOW 6 on columns
//! - [`pflotran`], [`tough`], [`darts`]: cells and connections for PFLOTRAN, TOUGH2 and DARTS
//! - [`mrst`]: grids for MRST, in MATLAB's container [`mat`]
//! - [`geos`]: VTU for GEOS
//! - [`resqml`]: RESQML, in the containers [`epc`] and [`hdf5`]
//! - [`grdecl`]: corner-point grids, of [`pillars`] and [`layers`], found by [`walk`]s through cells
//! - [`binary`]: numbers as bytes, for containers
//! - [`groups`](mod@groups): named faces, for those with [`simplices`]: [`msh`], [`inp`], [`medit`],
//!   [`tetgen`], and for surfaces alone: [`stl`], [`obj`]

pub mod binary;
pub mod darts;
pub mod disv;
pub mod epc;
pub mod format;
pub mod geos;
pub mod grdecl;
pub mod groups;
pub mod hdf5;
pub mod inp;
pub mod layers;
pub mod mat;
pub mod medit;
pub mod mrst;
pub mod msh;
pub mod obj;
pub mod openfoam;
pub mod opm;
pub mod pflotran;
pub mod pillars;
pub mod polyhedra;
pub mod pvd;
pub mod resqml;
pub mod simplices;
pub mod stl;
pub mod surfaces;
pub mod tetgen;
pub mod text;
pub mod tough;
pub mod tsurf;
pub mod twin;
pub mod vtp;
pub mod vtu;
pub mod walk;

pub use format::{FORMATS, Format};
pub use obj::write_obj;
pub use polyhedra::write_cells_vtu;
pub use pvd::Trace;
pub use surfaces::SurfaceFile;
pub use tsurf::write_tsurf;
pub use vtp::write_vtp;
pub use vtu::{AnyMesh, FieldValue, MeshFile, read_any_vtu, read_vtu, write_vtu};

use rayon::prelude::*;

use crate::image::Geometry;
use crate::mesh::Simplices;

/// A mesh in lattice space (sample index times `step`) as a mesh in physical space.
///
/// Nodes and cells keep their order. Where the geometry mirrors space (depth downwards, say), the
/// last two nodes of every cell change places, so that all stay positively oriented.
pub fn to_physical<const D: usize, M: Simplices<D>>(
    mesh: &M,
    step: [f64; D],
    geometry: &Geometry<D>,
) -> M {
    let physical = |p: &[f64; D]| geometry.to_physical(std::array::from_fn(|k| p[k] / step[k]));
    let nodes = mesh.nodes().par_iter().map(physical).collect();
    turned(mesh, nodes, geometry)
}

/// The same cells with other nodes; where the geometry mirrors space, the last two nodes of every
/// cell change places.
pub fn turned<const D: usize, M: Simplices<D>>(
    mesh: &M,
    nodes: Vec<[f64; D]>,
    geometry: &Geometry<D>,
) -> M {
    let mut corners = mesh.connectivity().to_vec();
    if geometry.determinant() < 0.0 {
        for cell in corners.chunks_exact_mut(D + 1) {
            cell.swap(D - 1, D);
        }
    }
    M::from_parts(nodes, corners)
}

/// Bits for the faces of cells (bit k: the face opposite node k) as [`to_physical`] turns their
/// nodes, there and back.
pub fn face_bits_to_physical<const D: usize>(bits: &[u8], geometry: &Geometry<D>) -> Vec<u8> {
    if geometry.determinant() >= 0.0 {
        return bits.to_vec();
    }
    let (last, before) = (1 << D, 1 << (D - 1));
    let turn = |b: u8| (b & !(last | before)) | (b & before) << 1 | (b & last) >> 1;
    bits.iter().map(|&b| turn(b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{TetMesh, TriMesh, volume6};

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
        for down in [5.0, -5.0] {
            let geometry = Geometry::with_spacing([10.0, 20.0], [1.0, down]);
            let physical = to_physical(&mesh, [1.0, 0.5], &geometry);
            assert_eq!(physical.nodes[2], [10.0, 20.0 + 6.0 * down]);
            assert_eq!(physical.volume(0), 30.0);
            // The edge between nodes 0 and 1, opposite node 2.
            let bits = face_bits_to_physical(&[4], &geometry);
            let k = bits[0].trailing_zeros() as usize;
            assert_eq!(physical.triangles[0][k], 2);
            assert_eq!(face_bits_to_physical(&bits, &geometry), [4]);
        }
    }
}
