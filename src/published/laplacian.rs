//! Regularised energy: part of the energy is the distance of each atom from the mean position of
//! its neighbours (Esperanca, Oliveira & Cavalcanti 2008, as described by Fernandes & Gattass 2009,
//! equations 8 and 9).
//!
//! ```text
//! A'   = kappa A + (1 - kappa) sum_i |L(x_i)| / d(x_i)
//! L_i  = x_i - mean of x_j over the neighbours j of i in the Delaunay mesh of the atoms
//! P    = (1 - beta) A' + beta B
//! ```
//!
//! As printed, equation 8 adds vectors L / d; their lengths are meant. A length has no derivative
//! at zero, where it is all over a regular lattice. So |v| is replaced by sqrt(|v|^2 + e^2) - e,
//! with e = 0.02: at most 0.02 less than |v|, and exactly 0 where v is 0.
//!
//! An atom on a side of the box has neighbours on one side of it only. Its L counts only along the
//! axes along which the atom may move. The L of corners and of atoms that users fixed does not
//! count.
//!
//! Neighbours are found when a round begins ([`Energy::refresh`]) and are kept during the round, so
//! that energy and gradient are smooth:
//!
//! ```text
//! dP / dx_k gets  s_k - sum over neighbours i of k of s_i / n_i  - w_k |v_k|^2 / (root_k d_k) grad d(x_k)
//!                 - (root_k - e) (1 - kappa) grad beta(x_k)
//! s_i = w_i v_i / (root_i d_i),  v_i = L_i / d_i,  root_i = sqrt(|v_i|^2 + e^2),
//! w_i = (1 - beta(x_i)) (1 - kappa)
//! ```

use std::sync::Arc;

use crate::parallel::prelude::*;

use crate::error::{Error, Result, cause};
use crate::lattice::distance::Distance;
use crate::lattice::energy::CHUNK_ATOMS;
use crate::lattice::energy::{Beta, Energy, EnergyParts, EnergyTerms, PairwiseEnergy};
use crate::lattice::halo::OwnedAndGhosts;
use crate::mesh::delaunay::{delaunay, delaunay_plane};
use crate::mesh::{Simplices, TetMesh};

/// Rounding e of |L| near zero, in units of d.
const ROUNDING_LENGTH: f64 = 0.02;

/// The weight kappa of A that Esperanca et al. suggest.
pub const DEFAULT_KAPPA: f64 = 0.7;

/// Returns the Delaunay triangulation of points in space.
type Triangulation<'a> = dyn Fn(&[[f64; 3]]) -> Result<TetMesh> + Send + Sync + 'a;

/// The Delaunay neighbours of every atom.
#[derive(Default)]
struct AtomAdjacency {
    /// Where each atom's neighbours start, and one more at the end.
    starts: Vec<u32>,
    /// Ascending for each atom.
    neighbours: Vec<u32>,
}

impl AtomAdjacency {
    /// Returns the adjacency of the nodes of a mesh.
    fn from_mesh<const D: usize>(mesh: &impl Simplices<D>) -> Self {
        let mut pairs: Vec<[u32; 2]> = Vec::with_capacity(mesh.len() * D * (D + 1));
        for cell in mesh.connectivity().chunks_exact(D + 1) {
            for &i in cell {
                pairs.extend(cell.iter().filter(|&&j| j != i).map(|&j| [i, j]));
            }
        }
        pairs.par_sort_unstable();
        pairs.dedup();
        let mut starts = vec![0; mesh.nodes().len() + 1];
        for pair in &pairs {
            starts[pair[0] as usize + 1] += 1;
        }
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        Self {
            starts,
            neighbours: pairs.into_iter().map(|pair| pair[1]).collect(),
        }
    }

    /// Returns the Delaunay neighbours of atoms in the plane or in space.
    fn delaunay<const D: usize>(x: &[[f64; D]], in_space: &Triangulation<'_>) -> Result<Self> {
        // The compiler does not know that `D` is 2 or 3, so coordinates are copied one by one.
        fn cast_dims<const D: usize, const E: usize>(x: &[[f64; D]]) -> Vec<[f64; E]> {
            x.iter().map(|x| std::array::from_fn(|k| x[k])).collect()
        }
        match D {
            2 => Ok(Self::from_mesh(&delaunay_plane(&cast_dims(x))?)),
            _ => Ok(Self::from_mesh(&in_space(&cast_dims(x))?)),
        }
    }

    fn neighbours_of(&self, n: usize) -> &[u32] {
        &self.neighbours[self.starts[n] as usize..self.starts[n + 1] as usize]
    }
}

/// The regularised energy of a lattice.
#[derive(Clone)]
pub struct RegularisedEnergy<'a, const D: usize> {
    pairs: PairwiseEnergy<'a, D>,
    distance: &'a Distance<D>,
    beta: Beta<D>,
    kappa: f64,
    /// 1 for each coordinate that may change, else 0.
    mobility: Vec<[f64; D]>,
    adjacency: Arc<AtomAdjacency>,
    /// s_i over the count of neighbours of i.
    neighbour_shares: Vec<[f64; D]>,
    parts: EnergyParts,
    triangulation: Arc<Triangulation<'a>>,
}

impl<'a, const D: usize> RegularisedEnergy<'a, D> {
    /// Creates the regularised energy from `pairs`, an evaluator for `distance` and `beta` of atoms
    /// on features. A gets the weight `kappa`. `mobility` says which coordinates of each atom may
    /// change ([`Atoms::mobility`](crate::lattice::seeding::Atoms::mobility)).
    ///
    /// # Errors
    /// Returns [`Error::Optimise`] if kappa is not in [0, 1].
    pub fn new(
        pairs: PairwiseEnergy<'a, D>,
        distance: &'a Distance<D>,
        beta: Beta<D>,
        kappa: f64,
        mobility: Vec<[f64; D]>,
    ) -> Result<Self> {
        if !(0.0..=1.0).contains(&kappa) {
            return Err(Error::Optimise(cause(
                "kappa",
                format!("{kappa} is not between 0 and 1"),
                "1 omits Laplacian coordinates, 0.7 is typical with them",
            )));
        }
        Ok(Self {
            pairs: pairs.with_kappa(kappa),
            distance,
            beta,
            kappa,
            mobility,
            adjacency: Arc::default(),
            neighbour_shares: Vec::new(),
            parts: EnergyParts::default(),
            triangulation: Arc::new(delaunay),
        })
    }

    /// Sets the function that returns the [`delaunay`] triangulation in space.
    pub(crate) fn with_triangulation(
        self,
        triangulation: impl Fn(&[[f64; 3]]) -> Result<TetMesh> + Send + Sync + 'a,
    ) -> Self {
        Self {
            triangulation: Arc::new(triangulation),
            ..self
        }
    }

    /// Returns (1 - kappa) (1 - beta) and its gradient.
    fn laplacian_weight(&self, x: [f64; D]) -> (f64, [f64; D]) {
        let lattice_weight = 1.0 - self.kappa;
        match &self.beta {
            Beta::Constant(beta) => (lattice_weight * (1.0 - beta), [0.0; D]),
            Beta::Field(field) => {
                let (beta, slope) = field.value_and_gradient(x);
                (
                    lattice_weight * (1.0 - beta),
                    slope.map(|s| -lattice_weight * s),
                )
            }
        }
    }

    /// Returns the term of atom `n`, unweighted and weighted. Adds the derivative with respect to
    /// the atom's own position to `gradient`, and writes the part of each neighbour to
    /// `neighbour_share`.
    fn term(
        &self,
        x: &[[f64; D]],
        n: usize,
        gradient: &mut [f64; D],
        neighbour_share: &mut [f64; D],
    ) -> [f64; 2] {
        let neighbours = self.adjacency.neighbours_of(n);
        if neighbours.is_empty() {
            *neighbour_share = [0.0; D];
            return [0.0; 2];
        }
        let mut sum = [0.0; D];
        for &j in neighbours {
            for k in 0..D {
                sum[k] += x[j as usize][k];
            }
        }
        let count = neighbours.len() as f64;
        let (d, d_slope) = self.distance.value_and_gradient_at(x[n]);
        let (weight, weight_slope) = self.laplacian_weight(x[n]);
        let v: [f64; D] =
            std::array::from_fn(|k| self.mobility[n][k] * (x[n][k] - sum[k] / count) / d);
        let v2: f64 = v.iter().map(|v| v * v).sum();
        let root = (v2 + ROUNDING_LENGTH * ROUNDING_LENGTH).sqrt();
        let length = root - ROUNDING_LENGTH;
        for k in 0..D {
            let slope = weight * v[k] / (root * d);
            neighbour_share[k] = slope / count;
            gradient[k] += slope - weight * v2 / (root * d) * d_slope[k] + length * weight_slope[k];
        }
        [length, weight * length]
    }
}

impl<const D: usize> Energy<D> for RegularisedEnergy<'_, D> {
    fn evaluate(&mut self, x: &[[f64; D]], gradient: &mut [[f64; D]]) -> Result<f64> {
        let energy = self.pairs.evaluate(x, gradient)?;
        let mut shares = std::mem::take(&mut self.neighbour_shares);
        shares.resize(x.len(), [0.0; D]);
        let sums: Vec<[f64; 2]> = gradient
            .par_chunks_mut(CHUNK_ATOMS)
            .zip(shares.par_chunks_mut(CHUNK_ATOMS))
            .enumerate()
            .map(|(chunk, (gradient, shares))| {
                let mut total = [0.0; 2];
                for (n, (gradient, share)) in gradient.iter_mut().zip(shares).enumerate() {
                    let [length, weighted] = self.term(x, chunk * CHUNK_ATOMS + n, gradient, share);
                    total[0] += length;
                    total[1] += weighted;
                }
                total
            })
            .collect();
        gradient
            .par_iter_mut()
            .with_min_len(CHUNK_ATOMS)
            .enumerate()
            .for_each(|(n, gradient)| {
                for &j in self.adjacency.neighbours_of(n) {
                    for k in 0..D {
                        gradient[k] -= shares[j as usize][k];
                    }
                }
            });
        self.neighbour_shares = shares;
        let [length, weighted] = sums
            .iter()
            .fold([0.0; 2], |t, s| [t[0] + s[0], t[1] + s[1]]);
        let EnergyParts { lattice, image } = self.pairs.parts();
        self.parts = EnergyParts {
            lattice: self.kappa * lattice + (1.0 - self.kappa) * length,
            image,
        };
        Ok(energy + weighted)
    }

    fn terms(
        &mut self,
        x: &[[f64; D]],
        halo: &OwnedAndGhosts<'_>,
        minimised: f64,
        gradient: &mut [[f64; D]],
    ) -> Result<EnergyTerms> {
        // The energy without regularisation, in which A counts fully.
        let unregularised = self.pairs.clone().with_kappa(1.0).evaluate(x, gradient)?;
        let terms = self.pairs.terms(x, halo, unregularised, gradient)?;
        Ok(EnergyTerms {
            smoothing: minimised - unregularised,
            ..terms
        })
    }

    fn stiffness(&self, x: &[[f64; D]]) -> Vec<f32> {
        self.pairs.stiffness(x)
    }

    fn refresh(&mut self, x: &[[f64; D]]) -> Result<bool> {
        self.adjacency = Arc::new(AtomAdjacency::delaunay(x, &*self.triangulation)?);
        Ok(true)
    }

    fn duplicate(&self) -> Box<dyn Energy<D> + Send + '_> {
        Box::new(self.clone())
    }

    fn parts(&self) -> EnergyParts {
        self.parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::SparseField;
    use crate::lattice::energy::pairwise::tests::smooth;
    use crate::lattice::seeding::{self, Alignment, Atoms};

    /// A lattice of the box in which every atom that may move is moved.
    fn perturbed_lattice<const D: usize>(extent: [f64; D], distance: &Distance<D>) -> Atoms<D> {
        let mut atoms = seeding::fcc(extent, distance, &[], Alignment::OnFeatures).unwrap();
        let mobility = atoms.mobility(extent);
        for (n, (x, mobility)) in atoms.positions.iter_mut().zip(&mobility).enumerate() {
            for k in 0..D {
                x[k] += 0.5 * mobility[k] * ((n * D + k) as f64 * 12.9898).sin();
            }
        }
        atoms
    }

    /// Returns the largest error of the gradient over its root mean square, for coordinates that
    /// may change.
    fn error<const D: usize>(
        extent: [f64; D],
        distance: &Distance<D>,
        beta: &Beta<D>,
        kappa: f64,
    ) -> f64 {
        let atoms = perturbed_lattice(extent, distance);
        let image = SparseField::from_field(&smooth(extent, -1.0, 0.0));
        let mobility = atoms.mobility(extent);
        let pairs = PairwiseEnergy::new(extent, distance, Some(&image), beta.clone()).unwrap();
        let mut energy =
            RegularisedEnergy::new(pairs, distance, beta.clone(), kappa, mobility.clone()).unwrap();
        assert!(energy.refresh(&atoms.positions).unwrap());
        let mut x = atoms.positions;
        let mut gradient = vec![[0.0; D]; x.len()];
        let value = energy.evaluate(&x, &mut gradient).unwrap();
        if let Beta::Constant(beta) = beta {
            let EnergyParts { lattice, image } = energy.parts();
            let sum = (1.0 - beta) * lattice + beta * image;
            assert!((sum - value).abs() < 1e-9 * value.abs().max(1.0));
        }
        let mut unused = gradient.clone();
        let (mut worst, mut square, mut count) = (0.0f64, 0.0, 0.0);
        for n in 0..x.len() {
            for k in (0..D).filter(|&k| mobility[n][k] > 0.0) {
                // The step is large enough for the single precision of pairs, if they count; errors
                // are of fourth order.
                let h = if kappa > 0.0 { 4e-3 } else { 1e-3 };
                let original = x[n][k];
                let mut value = |offset: f64| {
                    x[n][k] = original + offset;
                    energy.evaluate(&x, &mut unused).unwrap()
                };
                let inner_difference = value(h) - value(-h);
                let outer_difference = value(2.0 * h) - value(-2.0 * h);
                x[n][k] = original;
                let slope = (8.0 * inner_difference - outer_difference) / (12.0 * h);
                worst = worst.max((slope - gradient[n][k]).abs());
                square += gradient[n][k].powi(2);
                count += 1.0;
            }
        }
        assert!(count > 100.0);
        worst / (square / count).sqrt()
    }

    #[test]
    fn the_gradient_is_exact() {
        fn check<const D: usize>(extent: [f64; D]) {
            let field = Distance::Field(smooth(extent, 3.5, 4.5));
            for distance in [Distance::Constant(4.0), field] {
                for beta in [Beta::Constant(0.4), Beta::Field(smooth(extent, 0.2, 0.8))] {
                    // Without pairs, whose energies have single precision, the bound is tighter.
                    for (kappa, bound) in [(0.0, 5e-4), (DEFAULT_KAPPA, 2e-3)] {
                        let error = error(extent, &distance, &beta, kappa);
                        println!("{D}-D, kappa {kappa}: {error:.1e}");
                        assert!(error < bound, "{error:e}");
                    }
                }
            }
        }
        check([40.0, 36.0]);
        check([22.0, 20.0, 18.0]);
    }

    #[test]
    fn a_regular_lattice_has_no_laplacian_energy_and_moving_an_atom_costs_its_length() {
        let (extent, d) = ([40.0, 12.0 * 12.0f64.sqrt()], 4.0);
        let distance = Distance::Constant(d);
        let atoms = seeding::fcc(extent, &distance, &[], Alignment::OnFeatures).unwrap();
        let is_inner = |x: &[f64; 2]| (0..2).all(|k| x[k] > 2.5 * d && x[k] < extent[k] - 2.5 * d);
        let mobility = atoms
            .positions
            .iter()
            .map(|x| [f64::from(u8::from(is_inner(x))); 2]);
        let beta = Beta::Constant(0.0);
        let pairs = PairwiseEnergy::new(extent, &distance, None, beta.clone()).unwrap();
        let mut energy =
            RegularisedEnergy::new(pairs, &distance, beta, 0.0, mobility.collect()).unwrap();
        energy.refresh(&atoms.positions).unwrap();
        let mut gradient = vec![[0.0; 2]; atoms.len()];
        let zero = energy.evaluate(&atoms.positions, &mut gradient).unwrap();
        assert!(zero.abs() < 1e-9, "{zero}");
        let n = atoms.positions.iter().position(is_inner).unwrap();
        let is_deep = |x: &[f64; 2]| (0..2).all(|k| x[k] > 3.8 * d && x[k] < extent[k] - 3.8 * d);
        let n = atoms.positions.iter().position(is_deep).unwrap_or(n);
        let mut x = atoms.positions.clone();
        x[n][0] += 0.3 * d;
        let moved = energy.evaluate(&x, &mut gradient).unwrap();
        // The atom's own L, and a sixth of it for each of the six neighbours that count.
        let counted = energy
            .adjacency
            .neighbours_of(n)
            .iter()
            .filter(|&&j| is_inner(&atoms.positions[j as usize]));
        let rounded = |v: f64| (v * v + ROUNDING_LENGTH * ROUNDING_LENGTH).sqrt() - ROUNDING_LENGTH;
        let expected = rounded(0.3) + counted.count() as f64 * rounded(0.05);
        assert!((moved - expected).abs() < 1e-9, "{moved} {expected}");
    }

    #[test]
    fn kappa_outside_its_range_is_refused() {
        let distance = Distance::Constant(3.0);
        for kappa in [-0.1, 1.1, f64::NAN] {
            let beta = Beta::Constant(0.5);
            let pairs = PairwiseEnergy::new([9.0; 3], &distance, None, beta.clone()).unwrap();
            assert!(RegularisedEnergy::new(pairs, &distance, beta, kappa, Vec::new()).is_err());
        }
    }
}
