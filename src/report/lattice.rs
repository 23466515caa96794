//! How evenly the atoms are spread.

use crate::mesh::Simplices;
use serde::Serialize;

/// The lattice of atoms from which a mesh was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lattice {
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
pub fn lattice<const D: usize>(
    mesh: &impl Simplices<D>,
    distance: impl Fn([f64; D]) -> f64,
) -> Lattice {
    let nodes = mesh.nodes();
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
    figures(&nearest, nodes, distance)
}

/// Figures of a lattice from the squares of the distances to each atom's nearest neighbour.
pub(super) fn figures<const D: usize>(
    nearest: &[f64],
    atoms: &[[f64; D]],
    distance: impl Fn([f64; D]) -> f64,
) -> Lattice {
    let mut spacing: Vec<f64> = nearest
        .iter()
        .zip(atoms)
        .filter(|(square, _)| square.is_finite())
        .map(|(square, &atom)| square.sqrt() / distance(atom))
        .collect();
    spacing.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| {
        let rank = share * spacing.len().saturating_sub(1) as f64;
        spacing.get(rank as usize).copied().unwrap_or(f64::NAN)
    };
    Lattice {
        atoms: atoms.len(),
        spacing: [0.01, 0.5, 0.99].map(at),
        optimisation: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::boxes::kuhn_box;

    #[test]
    fn spacing_is_the_shortest_edge_over_the_nominal_distance() {
        let mut mesh = kuhn_box([6, 6, 6], 2.0);
        assert_eq!(lattice(&mesh, |_| 4.0).spacing, [0.5; 3]);
        // One atom halfway to its neighbour: its figure and the neighbour's fall to a quarter.
        let middle = 3 * 49 + 3 * 7 + 3;
        mesh.nodes[middle][0] += 1.0;
        let found = lattice(&mesh, |_| 4.0);
        assert_eq!(found.spacing, [0.5; 3]);
        assert_eq!(found.atoms, 343);
        // Half the atoms are asked to be twice as far apart.
        let found = lattice(&mesh, |p| if p[0] > 6.0 { 4.0 } else { 2.0 });
        assert_eq!((found.spacing[0], found.spacing[2]), (0.5, 1.0));
        assert!(lattice(&TetMesh::default(), |_| 1.0).spacing[1].is_nan());
    }
}
