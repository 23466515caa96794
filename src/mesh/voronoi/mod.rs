//! Builds the Voronoi cells (PEBI grid) of atoms in a box, cut exactly by the box.
//!
//! - `mirror`: images of atoms outside the box, so that cells end on its sides
//! - `circumcentre`: centres of circumscribed spheres, also of flat simplices
//! - `rings`: the Delaunay simplices around every edge
//! - `nodes`: the nodes of cells
//! - `needles`: removes faces that are narrower than rounding errors
//! - `assemble`: faces with nodes, in order
//! - [`conform`]: sites whose cells have the facets of a surface as faces
//!
//! The cells are the dual of the Delaunay triangulation of atoms and images: each simplex gives a
//! node (its circumcentre), each edge a face (normal to the edge, at its middle), each atom a cell.

mod assemble;
mod circumcentre;
pub mod conform;
mod mirror;
mod needles;
mod nodes;
mod rings;

use crate::parallel::prelude::*;

use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::mesh::TetMesh;
use crate::mesh::check::broken_cells;
use crate::mesh::delaunay;
use crate::mesh::poly::PolyMesh;
use mirror::MirroredAtoms;
use rings::Rings;

/// Distance, relative to the mean distance between atoms, below which two nodes coincide, or a node
/// lies on a side of the box. It is far above rounding errors and far below all sizes that matter.
const SAME_NODE_TOLERANCE: f64 = 1e-10;

/// Returns the Voronoi cells of atoms, cut by the box `[0, extent]`. Cell i belongs to atom i.
///
/// All atoms must lie strictly inside. Sites are the atoms, rounded to about 1e-16 of the extent.
/// Nodes that coincide (more than four atoms on one empty sphere, as in any perfect lattice) are
/// merged, and faces without area do not appear. Faces are flat and normal to the line between
/// their atoms to about 1e-10. Faces on the box's sides have exactly the side's coordinate, and the
/// cells' volumes add up to the volume of the box.
///
/// # Errors
/// Returns [`Error::Delaunay`] if there is no atom, if an atom lies on a side or outside, if two
/// atoms coincide.
pub fn voronoi(atoms: &[[f64; 3]], extent: [f64; 3]) -> Result<PolyMesh<3>> {
    voronoi_welded(atoms, extent, 0.0)
}

/// Returns the [`voronoi`] cells without their smallest faces. Nodes nearer to one another than the
/// fraction `weld` of their distance to the nearest atoms are merged. Faces narrower than that
/// vanish, and with them the connections across them. At such places faces are no longer exactly
/// flat or normal to their connections (errors are about `weld`). Volumes still add up to the
/// volume of the box.
///
/// # Errors
/// Returns the errors of [`voronoi`].
pub fn voronoi_welded(atoms: &[[f64; 3]], extent: [f64; 3], weld: f64) -> Result<PolyMesh<3>> {
    voronoi_by(atoms, extent, weld, delaunay::delaunay)
}

/// Returns the cells of [`voronoi_welded`], with the [`delaunay`](delaunay::delaunay) triangulations
/// that `triangulate` returns.
///
/// # Errors
/// Returns the errors of [`voronoi`] and of `triangulate`.
pub(crate) fn voronoi_by(
    atoms: &[[f64; 3]],
    extent: [f64; 3],
    weld: f64,
    triangulate: impl Fn(&[[f64; 3]]) -> Result<TetMesh>,
) -> Result<PolyMesh<3>> {
    build_cells(
        atoms,
        extent,
        weld,
        |points| Ok(triangulate(points)?.tets),
        circumcentre::tetrahedron_circumcentre,
    )
}

/// Returns the Voronoi cells of atoms in the plane, as [`voronoi`] does in 3-D: polygons.
///
/// # Errors
/// Returns the errors of [`voronoi`].
pub fn voronoi_plane(atoms: &[[f64; 2]], extent: [f64; 2]) -> Result<PolyMesh<2>> {
    voronoi_plane_welded(atoms, extent, 0.0)
}

/// Returns the cells of [`voronoi_plane`] without their shortest edges, as [`voronoi_welded`] does
/// in 3-D.
///
/// # Errors
/// Returns the errors of [`voronoi_plane`].
pub fn voronoi_plane_welded(
    atoms: &[[f64; 2]],
    extent: [f64; 2],
    weld: f64,
) -> Result<PolyMesh<2>> {
    build_cells(
        atoms,
        extent,
        weld,
        |points| Ok(delaunay::delaunay_plane(points)?.triangles),
        circumcentre::triangle_circumcentre,
    )
}

fn build_cells<const D: usize, const N: usize>(
    atoms: &[[f64; D]],
    extent: [f64; D],
    weld: f64,
    triangulate: impl Fn(&[[f64; D]]) -> Result<Vec<[u32; N]>>,
    centre: impl Fn([[f64; D]; N]) -> [f64; D] + Sync,
) -> Result<PolyMesh<D>> {
    let error =
        |problem: String, remedy: &str| Error::Delaunay(cause("Voronoi cells", problem, remedy));
    let atoms = mirror::round_coordinates(atoms, extent);
    if atoms.is_empty() || atoms.len() > u32::MAX as usize / 64 {
        return Err(error(
            format!("cannot be made of {} atoms", atoms.len()),
            "give at least one, and fewer than 67 million",
        ));
    }
    let is_outside = |x: &[f64; D]| !(0..D).all(|k| x[k] > 0.0 && x[k] < extent[k]);
    if let Some(i) = atoms.iter().position(is_outside) {
        return Err(error(
            format!(
                "atom {i} at {:?} is not inside the box {extent:?}",
                atoms[i]
            ),
            "move it inside: cells need their atoms off the sides",
        ));
    }
    let volume: f64 = extent.iter().product();
    let tolerance = SAME_NODE_TOLERANCE * (volume / atoms.len() as f64).powf(1.0 / D as f64);
    let mut mirrored = MirroredAtoms::new(atoms, extent);
    loop {
        let simplices =
            rings::ordered_simplices(mirrored.atom_count, &triangulate(&mirrored.points)?);
        let nodes = nodes::centres(&mirrored, &simplices, extent, tolerance, &centre);
        let mut faces = WeldedRings::new(&mirrored, &simplices, &nodes, tolerance, weld, &[]);
        let mut is_complete = true;
        // A cell that extends beyond a side lacks its image in that side.
        for (simplex, node) in simplices.iter().zip(&nodes) {
            let sides = nodes::sides_beyond(node, extent);
            for side in (0..2 * D).filter(|side| sides >> side & 1 == 1) {
                for &node in simplex {
                    if (node as usize) < mirrored.atom_count {
                        is_complete &= !mirrored.add(node as usize, side);
                    }
                }
            }
        }
        for &atom in faces.rings.iter().flat_map(|part| &part.open_atoms) {
            for side in 0..2 * D {
                is_complete &= !mirrored.add(atom as usize, side);
            }
        }
        if !is_complete {
            continue;
        }
        // Cells that welding would break keep their nodes unwelded, and the cells are assembled
        // again, until no cell is broken.
        let mut is_unwelded = vec![false; mirrored.atom_count];
        loop {
            let rings = std::mem::take(&mut faces.rings);
            let weld_radius = |s: u32| faces.weld_radius(s);
            if weld == 0.0 {
                return assemble::assemble(&mirrored, rings, nodes, extent, weld_radius);
            }
            let mesh = assemble::assemble(&mirrored, rings, nodes.clone(), extent, weld_radius)?;
            let mut has_new = false;
            for cell in broken_cells(&mesh, weld, tolerance) {
                has_new |= !std::mem::replace(&mut is_unwelded[cell as usize], true);
            }
            if !has_new {
                return Ok(mesh);
            }
            faces = WeldedRings::new(&mirrored, &simplices, &nodes, tolerance, weld, &is_unwelded);
        }
    }
}

/// The faces of cells, and for each node the distance within which other nodes coincide with it.
struct WeldedRings {
    rings: Vec<Rings>,
    weld_radii: Vec<f64>,
    tolerance: f64,
}

impl WeldedRings {
    /// Merges nodes within the fraction `weld` of their distance to atoms, except for cells with
    /// `is_unwelded`.
    fn new<const D: usize, const N: usize>(
        mirrored: &MirroredAtoms<D>,
        simplices: &[[u32; N]],
        nodes: &[[f64; D]],
        tolerance: f64,
        weld: f64,
        is_unwelded: &[bool],
    ) -> Self {
        let keeps_nodes = |n: &u32| {
            is_unwelded
                .get(mirrored.owner(*n))
                .copied()
                .unwrap_or(false)
        };
        let weld_radius = |(simplex, node): (&[u32; N], &[f64; D])| {
            if simplex.iter().any(keeps_nodes) {
                return tolerance;
            }
            let atom = &mirrored.points[simplex[0] as usize];
            tolerance.max(weld * distance2(node, atom).sqrt())
        };
        let mut welded = Self {
            rings: Vec::new(),
            weld_radii: if weld > 0.0 {
                simplices.par_iter().zip(nodes).map(weld_radius).collect()
            } else {
                Vec::new()
            },
            tolerance,
        };
        let coincide = |s: u32, t: u32| {
            let radius = welded.weld_radius(s).min(welded.weld_radius(t));
            distance2(&nodes[s as usize], &nodes[t as usize]) <= radius * radius
        };
        let is_narrow = |ring: &[u32]| {
            let radii = ring.iter().map(|&s| welded.weld_radius(s));
            let width = radii.fold(f64::INFINITY, f64::min);
            N > 3 && needles::is_narrow(ring.iter().map(|&s| nodes[s as usize]), width)
        };
        welded.rings = rings::rings(mirrored.atom_count, simplices, coincide, is_narrow);
        welded
    }

    fn weld_radius(&self, simplex: u32) -> f64 {
        let radius = self.weld_radii.get(simplex as usize);
        radius.copied().unwrap_or(self.tolerance)
    }
}

#[cfg(test)]
mod tests;
