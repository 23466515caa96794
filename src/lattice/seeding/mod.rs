//! Initial lattices of atoms: image box and nominal distance d(x) -> [`Atoms`].
//!
//! - [`densest_lattice`]: the densest regular lattice fitted to the box, for constant d
//! - `regular`: the atoms of that lattice, or those of one rank
//! - `grow`: a pseudo-regular lattice grown atom by atom, for variable d
//! - `refine`: an isotropic lattice by Delaunay refinement
//! - `fixed_atoms`: atoms given by the user
//! - `line_atoms`: atoms along the lines where feature surfaces meet
//! - `wells`: atoms along trajectories, and d(x) near them
//! - [`morton`]: memory order of atoms along a Morton curve, for cache locality
//! - `shared_box`: the box in slabs that ranks fill, and distribution of sites in that order

pub mod densest_lattice;
pub(crate) mod fixed_atoms;
pub(crate) mod grow;
pub(crate) mod line_atoms;
pub mod morton;
pub(crate) mod refine;
mod regular;
mod shared_box;
pub(crate) mod wells;

use self::fixed_atoms::Clearance;
use self::morton::MortonCurve;
use crate::error::Result;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::lattice::AtomKind;
use crate::lattice::distance::Distance;
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

pub(crate) use grow::required_range;
pub(crate) use shared_box::SharedBox;

/// Where atoms end up: on features, so that the faces of a Delaunay mesh follow the features, or
/// alongside them, so that the faces of Voronoi cells do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Alignment {
    /// On features and on the sides of the box.
    #[default]
    OnFeatures,
    /// Beside features and strictly inside the box. The mirror images of atoms near a side stand
    /// beyond it, and act on atoms inside as atoms do.
    AlongsideFeatures,
}

/// The atoms of a lattice, which become the nodes of the mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Atoms<const D: usize> {
    /// Positions in lattice space, inside the box `[0, extent]`; on its sides exactly (`0.0` or
    /// `extent[k]`) where the kind says so.
    pub positions: Vec<[f64; D]>,
    /// The constraint on each atom.
    pub kinds: Vec<AtomKind>,
}

impl<const D: usize> Atoms<D> {
    /// Creates atoms whose kinds follow from the count of sides of the box on which they lie.
    pub fn from_positions(positions: Vec<[f64; D]>, extent: [f64; D]) -> Self {
        let kinds = positions.par_iter();
        let kinds = kinds.map(|&x| kind_at(x, extent)).collect();
        Self { positions, kinds }
    }

    /// Returns the count of atoms.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns `true` if there are no atoms.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns for each coordinate of each atom 1 if it may change, else 0. Corners and fixed atoms
    /// do not move, edge atoms keep to their edge, side atoms to their side.
    pub fn mobility(&self, extent: [f64; D]) -> Vec<[f64; D]> {
        let mobility_of = |x: &[f64; D], kind: &AtomKind| match kind {
            AtomKind::Interior => [1.0; D],
            AtomKind::Corner | AtomKind::Fixed => [0.0; D],
            AtomKind::Side | AtomKind::Edge => {
                std::array::from_fn(|k| f64::from(u8::from(x[k] > 0.0 && x[k] < extent[k])))
            }
        };
        self.positions
            .par_iter()
            .zip(&self.kinds)
            .map(|(x, kind)| mobility_of(x, kind))
            .collect()
    }
}

/// Returns the count of sides of the box `[0, extent]` on which `x` lies exactly.
pub fn side_count<const D: usize>(x: [f64; D], extent: [f64; D]) -> usize {
    (0..D).filter(|&k| x[k] <= 0.0 || x[k] >= extent[k]).count()
}

/// Returns the kind of an atom at `x` that is not fixed by the user.
pub fn kind_at<const D: usize>(x: [f64; D], extent: [f64; D]) -> AtomKind {
    let count = side_count(x, extent);
    if count == 0 {
        AtomKind::Interior
    } else if count == D {
        AtomKind::Corner
    } else if count + 1 == D {
        // In 2-D a side of the box is an edge.
        AtomKind::Edge
    } else {
        AtomKind::Side
    }
}

/// A site is free if no atom is nearer than this, in units of d (Hale 2001: 0.8).
pub(crate) const MIN_SITE_DISTANCE: f64 = 0.8;
/// Smallest distance of a site from the sides of the region that it fills, in units of d; 0.71 in a
/// regular lattice.
pub(crate) const SIDE_MARGIN: f64 = 0.4;

/// Creates an empty grid for atoms in the box from `low` to `high` that are at least about
/// `min_distance` apart.
pub(crate) fn empty_grid<const D: usize>(
    low: [f64; D],
    high: [f64; D],
    min_distance: f64,
) -> IncrementalGrid<D> {
    // A few atoms a cell where they are dense, and never more than about ten million cells.
    let volume: f64 = high
        .iter()
        .zip(&low)
        .map(|(high, low)| high - low)
        .product();
    let edge = (1.6 * min_distance).max((volume / 1e7).powf(1.0 / D as f64));
    IncrementalGrid::new(low, high, edge)
}

/// The method by which atoms are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Seeding {
    /// The densest regular lattice, face-centred cubic in 3-D and triangular in 2-D: for constant d
    /// slightly stretched per axis to fit ([`densest_lattice::fit_lattice`]), else grown by Hale's
    /// Algorithm 2 (`grow::grow_lattice`).
    #[default]
    Fcc,
    /// Grown by Algorithm 2 also for constant d, from fixed atoms or the centre of the box: the
    /// lattice is regular around wells rather than in the box.
    Grown,
    /// Delaunay refinement (`refine::refine_lattice`), isotropic.
    Refine {
        /// Seed of the position of the first point inside.
        seed: u64,
    },
}

/// Seeds a lattice that fills the box `[0, extent]`. With [`Alignment::OnFeatures`], corners, edges
/// and sides of the box have atoms; with [`Alignment::AlongsideFeatures`], the outermost atoms are
/// half a d inside.
///
/// `fixed` atoms (lattice space) are kept exactly where they are. A lattice that is grown grows from
/// them; in other lattices, atoms too near to them are removed (`fixed_atoms::insert`). Atoms come
/// in the order of a space-filling curve, fixed atoms last.
///
/// # Errors
/// Returns [`Error::Distance`](crate::Error::Distance) if d does not suit the box. Returns
/// [`Error::Seeding`](crate::Error::Seeding) if a fixed atom lies outside the box (alongside, also
/// on a side of it), or if two lie at one place.
///
/// Once `cancel` is cancelled, the function returns soon, with a useless result.
pub fn seed<const D: usize>(
    seeding: Seeding,
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    cancel: &CancelToken<'_>,
) -> Result<Atoms<D>> {
    if let Seeding::Refine { seed } = seeding {
        let refine = |fixed: &[[f64; D]]| {
            refine::refine_lattice(extent, distance, fixed, alignment, seed, cancel)
        };
        return seed_with(extent, distance, fixed, alignment, refine);
    }
    distance.validate(extent)?;
    let shared_box = SharedBox::of_one_process(extent);
    let atoms = seed_regular(shared_box, seeding, distance, fixed, alignment, cancel)?;
    Ok(atoms.atoms)
}

/// Seeds a lattice as [`seed`] does, at the positions that `place` returns for the fixed atoms.
///
/// # Errors
/// Returns an error as [`seed`] does, and those of `place`.
pub fn seed_with<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    place: impl FnOnce(&[[f64; D]]) -> Result<Vec<[f64; D]>>,
) -> Result<Atoms<D>> {
    distance.validate(extent)?;
    let fixed = fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let mut positions = place(&fixed)?;
    morton::sort_by_curve(&mut positions, extent, 2.0 * distance.min());
    let mut atoms = Atoms::from_positions(positions, extent);
    fixed_atoms::insert(&mut atoms, &fixed, extent, distance);
    Ok(atoms)
}

/// Returns this rank's atoms of the regular lattice of constant d, or of the lattice that is grown. No rank ever has
/// more than these. Each rank must know d in its [required range](required_range) and along the box's edges.
///
/// # Errors
/// Returns an error as [`seed`] does, or if another rank fails.
pub(crate) fn seed_regular<const D: usize>(
    shared_box: SharedBox<'_, D>,
    seeding: Seeding,
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    cancel: &CancelToken<'_>,
) -> Result<OwnedAtoms<D>> {
    if let (Seeding::Fcc, Distance::Constant(_)) = (seeding, distance) {
        return regular::place_atoms(shared_box, distance, fixed, alignment);
    }
    let extent = shared_box.extent;
    distance.validate(extent)?;
    let fixed = &fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let sites = grow::grow_lattice(shared_box, distance, fixed, alignment, cancel)?;
    let curve = MortonCurve::new(extent, 2.0 * distance.min());
    let clearance = Clearance::new(fixed, extent, distance);
    shared_box.redistribute(sites, &curve, fixed, &clearance)
}

/// Seeds a lattice by [`seed`] with [`Seeding::Fcc`].
///
/// # Errors
/// Returns an error as [`seed`] does.
pub fn fcc<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
) -> Result<Atoms<D>> {
    let seeding = Seeding::Fcc;
    let cancel = &CancelToken::never();
    seed(seeding, extent, distance, fixed, alignment, cancel)
}

/// Seeds a lattice by [`seed`] on features, for tests.
#[cfg(test)]
pub(in crate::lattice) fn seed_on_features<const D: usize>(
    seeding: Seeding,
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
) -> Result<Atoms<D>> {
    let (alignment, cancel) = (Alignment::OnFeatures, &CancelToken::never());
    seed(seeding, extent, distance, fixed, alignment, cancel)
}
