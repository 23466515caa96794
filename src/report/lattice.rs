//! Measures how evenly the atoms are spread.

use crate::Result;
use crate::geometry::distance2;
use crate::lattice::optimise::StopReason;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use serde::Serialize;

/// Lattice of atoms from which a mesh was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LatticeReport {
    /// Number of atoms.
    pub atoms: usize,
    /// Distance to the nearest neighbour over the nominal distance d(x): the 1 %, 50 % and 99 %
    /// quantiles.
    pub spacing: [f64; 3],
    /// Course of the optimisation, where there was one.
    pub optimisation: Option<Optimisation>,
}

/// Course of the optimisation. All energies are per atom.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Optimisation {
    /// A between atoms, as published.
    pub energy_lattice: f64,
    /// B of atoms in the image, as published.
    pub energy_image: f64,
    /// P = (1 - beta) A + beta B, as published.
    pub energy: f64,
    /// Term that the stiffening of the force between atoms adds to P.
    pub added_by_stiffening: f64,
    /// Term that Laplacian coordinates add, where they are used.
    pub added_by_laplacian: f64,
    /// Minimised energy: the sum of P and the added terms.
    pub minimised: f64,
    /// Number of evaluations of the energy and its gradient.
    pub evaluations: usize,
    /// Reason why the optimisation stopped.
    pub stop: StopReason,
}

/// Lattice during the optimisation, with the Delaunay mesh of its atoms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TracedLattice {
    /// Step: 0 before atoms move, then one more for each round or generation.
    pub step: usize,
    /// Minimum mean ratio of the simplices (in 2-D Q = 4 sqrt(3) A / (l1^2 + l2^2 + l3^2)).
    pub worst_quality: f64,
    /// Mean of the mean ratios.
    pub mean_quality: f64,
    /// P = (1 - beta) A + beta B of all atoms, as published.
    pub energy: f64,
    /// A of all atoms, as published.
    pub energy_lattice: f64,
    /// B of all atoms.
    pub energy_image: f64,
}

/// Returns the lattice report of a distributed mesh in lattice space. `distance` returns the nominal
/// distance at a position. Neighbours are nodes joined by an edge: in a Delaunay mesh the nearest
/// atom is among them. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub(crate) fn lattice_of_partition<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    distance: impl Fn([f64; D]) -> f64,
) -> Result<LatticeReport> {
    let (mesh, nodes) = (view.mesh, view.mesh.nodes());
    let mut nearest = vec![f64::INFINITY; nodes.len()];
    for cell in mesh.connectivity().chunks_exact(D + 1) {
        for (k, &i) in cell.iter().enumerate() {
            for &j in &cell[k + 1..] {
                let (i, j) = (i as usize, j as usize);
                let square = distance2(&nodes[i], &nodes[j]);
                nearest[i] = nearest[i].min(square);
                nearest[j] = nearest[j].min(square);
            }
        }
    }
    // For a node that several ranks share, one rank collects the nearest neighbours on all of them.
    let shared_value = |n: u32| (nearest[n as usize], distance(nodes[n as usize]));
    let shared_values = view.gather_shared("nearest neighbours", shared_value)?;
    let min_of_shared = |group: &[(u32, (f64, f64))]| {
        let squares = group.iter().map(|(_, (square, _))| *square);
        (squares.fold(f64::INFINITY, f64::min), group[0].1.1)
    };
    let shared_minima = shared_values.chunk_by(|a, b| a.0 == b.0).map(min_of_shared);
    let owned = nearest.iter().zip(nodes).zip(view.shared_mask());
    let owned = owned.filter(|(_, is_shared)| !is_shared);
    let owned = owned.map(|((square, &x), _)| (*square, distance(x)));
    let spacing = relative_spacing(owned.chain(shared_minima));
    let spacing = view.order_statistics(&[spacing.iter().copied()], &[spacing_ranks])?;
    Ok(LatticeReport {
        atoms: view.global_counts[0],
        spacing: std::array::from_fn(|i| spacing[0][i]),
        optimisation: None,
    })
}

/// Returns the distance of each atom to its nearest neighbour over the nominal distance. `nearest` has
/// the square of the distance, and the nominal distance.
pub(super) fn relative_spacing(nearest: impl Iterator<Item = (f64, f64)>) -> Vec<f64> {
    let nearest = nearest.filter(|(square, _)| square.is_finite());
    nearest.map(|(square, d)| square.sqrt() / d).collect()
}

/// Returns the ranks of the 1 %, 50 % and 99 % quantiles among `total` sorted values.
pub(super) fn spacing_ranks(total: usize) -> [usize; 3] {
    [0.01, 0.5, 0.99].map(|s| (s * (total - 1) as f64) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TetMesh;
    use crate::mesh::boxes::kuhn_box;

    fn lattice_of_mesh(mesh: &TetMesh, distance: impl Fn([f64; 3]) -> f64) -> LatticeReport {
        lattice_of_partition(&MeshView::from_mesh(mesh), distance).unwrap()
    }

    #[test]
    fn spacing_is_the_shortest_edge_over_the_nominal_distance() {
        let mut mesh = kuhn_box([6, 6, 6], 2.0);
        assert_eq!(lattice_of_mesh(&mesh, |_| 4.0).spacing, [0.5; 3]);
        // One atom is halfway to its neighbour: its value and that of the neighbour fall to a
        // quarter.
        let middle = 3 * 49 + 3 * 7 + 3;
        mesh.nodes[middle][0] += 1.0;
        let report = lattice_of_mesh(&mesh, |_| 4.0);
        assert_eq!(report.spacing, [0.5; 3]);
        assert_eq!(report.atoms, 343);
        // The nominal distance of half the atoms is twice as large.
        let report = lattice_of_mesh(&mesh, |p| if p[0] > 6.0 { 4.0 } else { 2.0 });
        assert_eq!((report.spacing[0], report.spacing[2]), (0.5, 1.0));
        assert!(lattice_of_mesh(&TetMesh::default(), |_| 1.0).spacing[1].is_nan());
    }
}
