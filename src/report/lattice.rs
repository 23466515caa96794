//! How evenly the atoms are spread.

use crate::comm::LocalOrComm;
use crate::comm::selection::order_statistics;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use serde::Serialize;

/// The lattice of atoms from which a mesh was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LatticeReport {
    /// Number of atoms.
    pub atoms: usize,
    /// Distance to the nearest neighbour over the nominal distance d(x): the values that 1, 50 and
    /// 99 % of the atoms do not reach.
    pub spacing: [f64; 3],
    /// How the optimisation went, where there was one.
    pub optimisation: Option<Optimisation>,
}

/// How the optimisation went. All energies are per atom.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Optimisation {
    /// A between atoms, as published.
    pub energy_lattice: f64,
    /// B of atoms in the image, as published.
    pub energy_image: f64,
    /// P = (1 - beta) A + beta B, as published.
    pub energy: f64,
    /// What the stiffening of the force between atoms adds to P.
    pub added_by_stiffening: f64,
    /// What Laplacian coordinates add to that, where these were asked for.
    pub added_by_laplacian: f64,
    /// The sum of P and what is added: what was minimised.
    pub minimised: f64,
    /// Evaluations of the energy and its gradient.
    pub evaluations: usize,
    /// Why it stopped.
    pub stop: String,
}

/// A lattice on its way, and the Delaunay mesh of its atoms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TracedLattice {
    /// 0 before atoms moved, then one more for each round or generation.
    pub step: usize,
    /// The lowest mean ratio of its simplices (in the plane Q = 4 sqrt(3) A / (l1^2 + l2^2 + l3^2)).
    pub worst_quality: f64,
    /// The mean of their mean ratios.
    pub mean_quality: f64,
    /// P = (1 - beta) A + beta B of all atoms, as published.
    pub energy: f64,
    /// A of all atoms, as published.
    pub energy_lattice: f64,
    /// B of all atoms.
    pub energy_image: f64,
}

/// Figures of a lattice from its mesh, in lattice space, with the nominal distance at any
/// position. Neighbours are nodes joined by an edge, among which a Delaunay mesh has the nearest.
pub fn measure_lattice<const D: usize, M: Simplices<D>>(
    mesh: &M,
    distance: impl Fn([f64; D]) -> f64,
) -> LatticeReport {
    let Ok(found) = lattice_of_partition(&MeshView::from_mesh(mesh), distance);
    found
}

/// The same of a mesh in parts, on all who hold one.
///
/// # Errors
/// Those of the other holders.
pub(crate) fn lattice_of_partition<const D: usize, M: Simplices<D>, H: LocalOrComm + ?Sized>(
    part: &MeshView<'_, D, M, H>,
    distance: impl Fn([f64; D]) -> f64,
) -> Result<LatticeReport, H::Error> {
    let (mesh, nodes) = (part.mesh, part.mesh.nodes());
    let mut nearest = vec![f64::INFINITY; nodes.len()];
    for cell in mesh.connectivity().chunks_exact(D + 1) {
        for (k, &i) in cell.iter().enumerate() {
            for &j in &cell[k + 1..] {
                let (i, j) = (i as usize, j as usize);
                let square: f64 = (0..D).map(|c| (nodes[i][c] - nodes[j][c]).powi(2)).sum();
                nearest[i] = nearest[i].min(square);
                nearest[j] = nearest[j].min(square);
            }
        }
    }
    // Of a node that parts share one of them says how near its neighbours in all of these are.
    let of_shared = |n: u32| (nearest[n as usize], distance(nodes[n as usize]));
    let of_shared = part.gather_shared("nearest neighbours", of_shared)?;
    let least = |all: &[(u32, (f64, f64))]| {
        let squares = all.iter().map(|(_, (square, _))| *square);
        (squares.fold(f64::INFINITY, f64::min), all[0].1.1)
    };
    let of_shared = of_shared.chunk_by(|a, b| a.0 == b.0).map(least);
    let own = nearest.iter().zip(nodes).zip(part.shared_mask());
    let own = own.filter(|(_, is_shared)| !is_shared);
    let own = own.map(|((square, &x), _)| (*square, distance(x)));
    lattice_figures(own.chain(of_shared), part.global_counts[0], part.comm)
}

/// Figures of a lattice of so many atoms from the squares of the distances to each one's nearest neighbour, and the
/// nominal distances there.
///
/// # Errors
/// Those of the other holders.
pub(super) fn lattice_figures<H: LocalOrComm + ?Sized>(
    nearest: impl Iterator<Item = (f64, f64)>,
    atoms: usize,
    holders: &H,
) -> Result<LatticeReport, H::Error> {
    let spacing: Vec<f64> = nearest
        .filter(|(square, _)| square.is_finite())
        .map(|(square, distance)| square.sqrt() / distance)
        .collect();
    let ranks = |total: usize| [0.01, 0.5, 0.99].map(|s| (s * (total - 1) as f64) as usize);
    let spacing = order_statistics(&[spacing.iter().copied()], &[ranks], holders)?;
    Ok(LatticeReport {
        atoms,
        spacing: std::array::from_fn(|i| spacing[0][i]),
        optimisation: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::boxes::kuhn_box;

    #[test]
    fn spacing_is_the_shortest_edge_over_the_nominal_distance() {
        let mut mesh = kuhn_box([6, 6, 6], 2.0);
        assert_eq!(measure_lattice(&mesh, |_| 4.0).spacing, [0.5; 3]);
        // One atom halfway to its neighbour: its figure and the neighbour's fall to a quarter.
        let middle = 3 * 49 + 3 * 7 + 3;
        mesh.nodes[middle][0] += 1.0;
        let found = measure_lattice(&mesh, |_| 4.0);
        assert_eq!(found.spacing, [0.5; 3]);
        assert_eq!(found.atoms, 343);
        // Half the atoms are asked to be twice as far apart.
        let found = measure_lattice(&mesh, |p| if p[0] > 6.0 { 4.0 } else { 2.0 });
        assert_eq!((found.spacing[0], found.spacing[2]), (0.5, 1.0));
        assert!(measure_lattice(&TetMesh::default(), |_| 1.0).spacing[1].is_nan());
    }
}
