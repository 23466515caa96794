//! Atoms in a box -> their Voronoi cells (PEBI grid), cut exactly by the box.
//!
//! - `mirror`: images of atoms outside the box, so that cells end on its sides
//! - `centre`: centres of circumscribed spheres, also of flat simplices
//! - `rings`: the Delaunay simplices round every edge
//! - `nodes`: the nodes of cells
//! - `needles`: faces narrower than rounding, which are none
//! - `assemble`: faces with nodes, in order
//! - [`conform`]: sites whose cells have the facets of a surface for faces
//!
//! The cells are the dual of the Delaunay triangulation of atoms and images: a node for every
//! simplex (its centre), a face for every edge (square to it, half-way), a cell for every atom.

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
use crate::mesh::check::broken_cells;
use crate::mesh::delaunay;
use crate::mesh::poly::PolyMesh;
use mirror::MirroredAtoms;
use rings::Rings;

/// Nodes nearer to one another, or to a side, than this share of the mean distance between atoms are
/// one, or on it: far above rounding, far below anything that matters.
const SAME_NODE_TOLERANCE: f64 = 1e-10;

/// The Voronoi cells of atoms, cut by the box `[0, extent]`: cell i belongs to atom i.
///
/// All atoms must lie strictly inside. Sites are the atoms, rounded to about 1e-16 of the extent.
/// Nodes that coincide (more than four atoms on one empty sphere, as in any perfect lattice) are
/// one, and faces without area do not appear. Faces are flat and square to the line between their
/// atoms to about 1e-10; faces on the box's sides have exactly the side's coordinate, and the cells'
/// volumes add up to the box's.
///
/// # Errors
/// [`Error::Delaunay`] if there is no atom, one lies on a side or outside, two are at one place, or
/// built without TetGen.
pub fn voronoi(atoms: &[[f64; 3]], extent: [f64; 3]) -> Result<PolyMesh<3>> {
    voronoi_welded(atoms, extent, 0.0)
}

/// [`voronoi`] without its smallest faces: nodes nearer to one another than the share `weld` of their
/// distance to the nearest atoms are one, and faces narrower than that are gone, with the connections
/// across them. Faces at such places are no longer quite flat or square to their connections (by about
/// `weld`); volumes still add up to the box's.
///
/// # Errors
/// As [`voronoi`].
pub fn voronoi_welded(atoms: &[[f64; 3]], extent: [f64; 3], weld: f64) -> Result<PolyMesh<3>> {
    build_cells(
        atoms,
        extent,
        weld,
        |points| Ok(delaunay::delaunay(points)?.tets),
        circumcentre::tetrahedron_circumcentre,
    )
}

/// [`voronoi`] in the plane: polygons.
///
/// # Errors
/// As [`voronoi`], but that it needs no TetGen.
pub fn voronoi_plane(atoms: &[[f64; 2]], extent: [f64; 2]) -> Result<PolyMesh<2>> {
    voronoi_plane_welded(atoms, extent, 0.0)
}

/// [`voronoi_welded`] in the plane: without the shortest edges.
///
/// # Errors
/// As [`voronoi_welded`].
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
    let refuse =
        |problem: String, remedy: &str| Error::Delaunay(cause("Voronoi cells", problem, remedy));
    let atoms = mirror::round_coordinates(atoms, extent);
    if atoms.is_empty() || atoms.len() > u32::MAX as usize / 64 {
        return Err(refuse(
            format!("{} atoms", atoms.len()),
            "give at least one, and fewer than 67 million",
        ));
    }
    let outside = |x: &[f64; D]| !(0..D).all(|k| x[k] > 0.0 && x[k] < extent[k]);
    if let Some(i) = atoms.iter().position(outside) {
        return Err(refuse(
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
        let mut faces = WeldedRings::new(&mirrored, &simplices, &nodes, (tolerance, weld), &[]);
        let mut complete = true;
        // A cell that reaches beyond a side lacks its image in that side.
        for (simplex, node) in simplices.iter().zip(&nodes) {
            let beyond = nodes::sides_beyond(node, extent);
            for side in (0..2 * D).filter(|side| beyond >> side & 1 == 1) {
                for &node in simplex {
                    if (node as usize) < mirrored.atom_count {
                        complete &= !mirrored.add(node as usize, side);
                    }
                }
            }
        }
        for &atom in faces.rings.iter().flat_map(|part| &part.open_atoms) {
            for side in 0..2 * D {
                complete &= !mirrored.add(atom as usize, side);
            }
        }
        if !complete {
            continue;
        }
        // Where welding would break cells, their nodes stay apart, and those around are looked at again.
        let mut whole = vec![false; mirrored.atom_count];
        loop {
            let rings = std::mem::take(&mut faces.rings);
            let reach = |s: u32| faces.weld_radius(s);
            if weld == 0.0 {
                return assemble::assemble(&mirrored, rings, nodes, extent, reach);
            }
            let mesh = assemble::assemble(&mirrored, rings, nodes.clone(), extent, reach)?;
            let mut more = false;
            for cell in broken_cells(&mesh) {
                more |= !std::mem::replace(&mut whole[cell as usize], true);
            }
            if !more {
                return Ok(mesh);
            }
            faces = WeldedRings::new(&mirrored, &simplices, &nodes, (tolerance, weld), &whole);
        }
    }
}

/// The faces of cells, and how near to each node others are the same.
struct WeldedRings {
    rings: Vec<Rings>,
    weld_radii: Vec<f64>,
    tolerance: f64,
}

impl WeldedRings {
    /// Nodes within the share `weld` of their distance to atoms are the same, but for those of cells that are
    /// to stay `whole`.
    fn new<const D: usize, const N: usize>(
        mirrored: &MirroredAtoms<D>,
        simplices: &[[u32; N]],
        nodes: &[[f64; D]],
        (tolerance, weld): (f64, f64),
        whole: &[bool],
    ) -> Self {
        let stays = |n: &u32| whole.get(mirrored.owner(*n)).copied().unwrap_or(false);
        let size = |(simplex, node): (&[u32; N], &[f64; D])| {
            if simplex.iter().any(stays) {
                return tolerance;
            }
            let atom = &mirrored.points[simplex[0] as usize];
            tolerance.max(weld * distance2(node, atom).sqrt())
        };
        let mut welded = Self {
            rings: Vec::new(),
            weld_radii: match weld > 0.0 {
                true => simplices.par_iter().zip(nodes).map(size).collect(),
                false => Vec::new(),
            },
            tolerance,
        };
        let one = |s: u32, t: u32| {
            let reach = welded.weld_radius(s).min(welded.weld_radius(t));
            distance2(&nodes[s as usize], &nodes[t as usize]) <= reach * reach
        };
        let narrow = |ring: &[u32]| {
            let reaches = ring.iter().map(|&s| welded.weld_radius(s));
            let width = reaches.fold(f64::INFINITY, f64::min);
            N > 3 && needles::is_narrow(ring.iter().map(|&s| nodes[s as usize]), width)
        };
        welded.rings = rings::rings(mirrored.atom_count, simplices, one, narrow);
        welded
    }

    fn weld_radius(&self, simplex: u32) -> f64 {
        let reach = self.weld_radii.get(simplex as usize);
        reach.copied().unwrap_or(self.tolerance)
    }
}

#[cfg(test)]
#[cfg(feature = "tetgen")]
mod tests;
