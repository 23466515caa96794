//! Initial lattices of atoms: image box and nominal distance d(x) -> [`Atoms`].
//!
//! - [`densest_lattice`]: the densest regular densest_lattice fitted to the box, for constant d
//! - `regular`: its atoms, or some of them for each of a group
//! - `grow`: a pseudo-regular lattice grown atom by atom, for variable d
//! - `refine`: an isotropic lattice by Delaunay refinement
//! - `guide`: drawn by chance under the image, features first
//! - `projection`: sites projected onto features
//! - `canny`: on features, dense where these bend, and few elsewhere
//! - `fixed`: atoms given by the user
//! - `wells`: atoms along trajectories, and d(x) near them
//! - [`morton`]: memory morton of atoms, for cache locality
//! - `turns`: sites in that order, of which each of a group has a share

pub(crate) mod canny;
mod curve_order;
pub mod densest_lattice;
pub(crate) mod fixed_atoms;
pub(crate) mod grow;
pub(crate) mod guide;
pub mod morton;
pub(crate) mod projection;
pub(crate) mod refine;
mod regular;
pub(crate) mod wells;

use self::fixed_atoms::Clearance;
use self::morton::MortonCurve;
use crate::comm::{self, Comm, SelfComm};
use crate::error::{Error, Result, cause};
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::image::{ScalarField, SparseField};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::partition::OwnedAtoms;
use crate::parallel::prelude::*;
use crate::progress::CancelToken;

/// Where atoms end up: on features, so that the faces of a Delaunay mesh follow them, or alongside,
/// so that the faces of Voronoi cells do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Alignment {
    /// On features and on the sides of the box.
    #[default]
    OnFeatures,
    /// Beside features and strictly inside the box. The mirror images of atoms near a side stand
    /// beyond it, and act on atoms inside as if they were atoms.
    AlongsideFeatures,
}

/// The atoms of a lattice: the nodes of the mesh to come.
#[derive(Debug, Clone, PartialEq)]
pub struct Atoms<const D: usize> {
    /// Positions in lattice space, inside the box `[0, extent]`; on its sides exactly (`0.0` or
    /// `extent[k]`) where the kind says so.
    pub positions: Vec<[f64; D]>,
    /// What each atom may do.
    pub kinds: Vec<AtomKind>,
}

impl<const D: usize> Atoms<D> {
    /// Atoms whose kinds follow from the number of sides of the box they lie on.
    pub fn from_positions(positions: Vec<[f64; D]>, extent: [f64; D]) -> Self {
        let kinds = positions.par_iter();
        let kinds = kinds.map(|&x| kind_at(x, extent)).collect();
        Self { positions, kinds }
    }

    /// Number of atoms.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Which coordinates of each atom may change: 1 for free, 0 for held. Corners and fixed atoms
    /// are held, edge atoms keep to their edge, side atoms to their side.
    pub fn mobility(&self, extent: [f64; D]) -> Vec<[f64; D]> {
        let free = |x: &[f64; D], kind: &AtomKind| match kind {
            AtomKind::Interior => [1.0; D],
            AtomKind::Corner | AtomKind::Fixed => [0.0; D],
            AtomKind::Side | AtomKind::Edge => {
                std::array::from_fn(|k| f64::from(u8::from(x[k] > 0.0 && x[k] < extent[k])))
            }
        };
        self.positions
            .par_iter()
            .zip(&self.kinds)
            .map(|(x, kind)| free(x, kind))
            .collect()
    }
}

/// The number of sides of the box `[0, extent]` on which `x` lies exactly.
pub fn side_count<const D: usize>(x: [f64; D], extent: [f64; D]) -> usize {
    (0..D).filter(|&k| x[k] <= 0.0 || x[k] >= extent[k]).count()
}

/// The kind of an atom at `x` that no user fixed.
pub fn kind_at<const D: usize>(x: [f64; D], extent: [f64; D]) -> AtomKind {
    let held = side_count(x, extent);
    if held == 0 {
        AtomKind::Interior
    } else if held == D {
        AtomKind::Corner
    } else if held + 1 == D {
        // In 2-D a side of the box is an edge.
        AtomKind::Edge
    } else {
        AtomKind::Side
    }
}

/// A site is free if no atom is nearer than this, in units of d (Hale 2001: 0.8).
const MIN_SITE_DISTANCE: f64 = 0.8;
/// Nearest to the sides of what it fills that a site may be, in units of d; 0.71 in a regular
/// lattice.
const SIDE_MARGIN: f64 = 0.4;

/// No atoms yet, in the box from `low` to `high`; `apart` is about how near to each other the nearest will be.
fn empty_grid<const D: usize>(low: [f64; D], high: [f64; D], apart: f64) -> IncrementalGrid<D> {
    // A few atoms a cell where they are dense; never more than some ten million cells.
    let volume: f64 = high
        .iter()
        .zip(&low)
        .map(|(high, low)| high - low)
        .product();
    let edge = (1.6 * apart).max((volume / 1e7).powf(1.0 / D as f64));
    IncrementalGrid::new(low, high, edge)
}

/// How atoms are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Seeding {
    /// The densest regular lattice, face-centred cubic in 3-D and triangular in 2-D: for constant d
    /// slightly stretched per axis to fit ([`densest_lattice::fit_lattice`]), else grown by Hale's Algorithm 2
    /// (`grow::grown`).
    #[default]
    Fcc,
    /// Grown by Algorithm 2 whatever d, from fixed atoms or the centre of the box: the lattice is
    /// regular around wells rather than in the box.
    Grown,
    /// Delaunay refinement (`refine::refined`), isotropic.
    Refine {
        /// Decides where the first point inside is.
        seed: u64,
    },
    /// Drawn by chance under the image, where its features are first (`guide::drawn`).
    Guide {
        /// Decides what is drawn.
        seed: u64,
        /// Most atoms.
        max_atoms: usize,
    },
    /// Sites of a fine lattice projected onto the image's features (`projection::projected`).
    Projection,
    /// From features and image (`canny::seeded`), which decide d, too.
    Canny,
}

/// Seeds a lattice that fills the box `[0, extent]`. [`Alignment::OnFeatures`], corners, edges and sides of
/// the box carry atoms; [`Alignment::AlongsideFeatures`], the outermost atoms are half a d inside.
///
/// `potential` is the image as -1 on features and 0 elsewhere, over the box; only some ways need it.
/// `fixed` atoms (lattice space) are kept exactly where they are; a lattice that is grown grows from
/// them, others make room for them (`fixed::insert`). Atoms come in the order of a space-filling
/// curve, fixed atoms last.
///
/// # Errors
/// [`Error::Distance`] if d does not suit the box,
/// [`Error::Seeding`] if a fixed atom lies outside the box (alongside, also
/// on a side of it) or two lie at one place, or for [`Seeding::Canny`], [`Error::Delaunay`] for
/// refinement in 3-D without the feature `cgal`. Of the ways that need an image, `Error::Seeding` also
/// if there is none or it is the same everywhere, and for projection alongside.
///
/// Once `patience` is over it ends soon, and what it gives is of no use.
pub fn seed<const D: usize>(
    how: Seeding,
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    potential: Option<&SparseField<D>>,
    patience: &CancelToken<'_>,
) -> Result<Atoms<D>> {
    let regular = || seed_regular(how, extent, distance, fixed, alignment, patience, &SelfComm);
    distance.validate(extent)?;
    let image = || {
        potential.map(SparseField::to_dense).ok_or_else(|| {
            seeding_error(
                "needs the potential of an image",
                "give one, or seed regularly",
            )
        })
    };
    let fixed = fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let mut positions = match how {
        Seeding::Fcc | Seeding::Grown => return Ok(regular()?.atoms),
        Seeding::Refine { seed } => {
            refine::refine_lattice(extent, distance, &fixed, alignment, seed, patience)?
        }
        Seeding::Canny => {
            return Err(Error::Seeding(cause(
                "seeding 'canny'",
                "places atoms by features and image, not by a distance",
                "call seeding::canny::seeded",
            )));
        }
        Seeding::Guide {
            seed,
            max_atoms: most,
        } => guide::draw_lattice(
            extent,
            distance,
            &image()?,
            &fixed,
            alignment,
            seed,
            most,
            patience,
        )?,
        Seeding::Projection if alignment == Alignment::AlongsideFeatures => {
            return Err(seeding_error(
                "projection puts atoms onto features, which the faces of Voronoi cells follow",
                "use another seeding for Voronoi cells",
            ));
        }
        Seeding::Projection => {
            projection::project_lattice(extent, distance, &image()?, &fixed, patience)?
        }
    };
    morton::sort_by_curve(&mut positions, extent, 2.0 * distance.min());
    let mut atoms = Atoms::from_positions(positions, extent);
    fixed_atoms::insert(&mut atoms, &fixed, extent, distance);
    Ok(atoms)
}

/// The regular lattice of constant d, or the one that is grown; each of a group has a share.
fn seed_regular<const D: usize>(
    how: Seeding,
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    patience: &CancelToken<'_>,
    group: &dyn Comm,
) -> Result<OwnedAtoms<D>> {
    if let (Seeding::Fcc, Distance::Constant(_)) = (how, distance) {
        return regular::place_atoms(extent, distance, fixed, alignment, group);
    }
    distance.validate(extent)?;
    let fixed = &fixed_atoms::validate(fixed, extent, distance, alignment)?;
    let sites = grow::grow_lattice(extent, distance, fixed, alignment, patience, group)?;
    let curve = MortonCurve::new(extent, 2.0 * distance.min());
    let room = Clearance::new(fixed, extent, distance);
    curve_order::redistribute(sites, &curve, extent, (fixed, &room), group)
}

/// [`seed`], of whose atoms each of a group has a share in the end. Where the lattice is regular or grown, none ever has
/// more.
///
/// # Errors
/// Those of [`seed`].
pub(crate) fn seed_partition<const D: usize>(
    how: Seeding,
    extent: [f64; D],
    distance: &DistributedDistance<D>,
    fixed: &[[f64; D]],
    potential: &SparseField<D>,
    group: &dyn Comm,
    patience: &CancelToken<'_>,
) -> Result<OwnedAtoms<D>> {
    let on = Alignment::OnFeatures;
    if let Seeding::Fcc | Seeding::Grown = how {
        let last = D - 1;
        let looked_at = grow::required_range(extent[last], distance.max(), group);
        let distance = distance.fetch_between(last, looked_at, group)?;
        return seed_regular(how, extent, &distance, fixed, on, patience, group);
    }
    let distance = distance.global(group)?;
    let potential = Some(potential);
    let all = seed(how, extent, &distance, fixed, on, potential, patience)?;
    comm::ensure_identical("atoms placed", &all)?;
    Ok(OwnedAtoms::from_global(all, group))
}

/// [`seed`] with [`Seeding::Fcc`].
///
/// # Errors
/// Those of [`seed`].
pub fn fcc<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
) -> Result<Atoms<D>> {
    let how = Seeding::Fcc;
    let patience = &CancelToken::never();
    seed(how, extent, distance, fixed, alignment, None, patience)
}

fn seeding_error(problem: impl std::fmt::Display, remedy: &str) -> Error {
    Error::Seeding(cause("seeding", problem, remedy))
}

/// The least and the largest sample of a potential by which atoms are placed in the box `[0, extent]`.
fn potential_range<const D: usize>(
    potential: &ScalarField<D>,
    extent: [f64; D],
    how: &str,
) -> Result<[f32; 2]> {
    let refuse = |problem: String, remedy: &str| {
        let place = format!("seeding {how}: image potential");
        Err(Error::Seeding(cause(place, problem, remedy)))
    };
    let count: usize = potential.dims.iter().product();
    let spans = (0..D).all(|k| (potential.extent()[k] - extent[k]).abs() <= 1e-6 * extent[k]);
    if !spans || potential.samples.len() != count || u32::try_from(count).is_err() {
        let problem = format!(
            "its {count} samples span {:?}, the box {extent:?}",
            potential.extent()
        );
        return refuse(
            problem,
            "give one that spans the box, of fewer than 2^32 samples",
        );
    }
    if !potential.samples.iter().all(|b| b.is_finite()) {
        return refuse(
            "is not a number everywhere".into(),
            "give one without NaN and infinities",
        );
    }
    let fold = |f: fn(f32, f32) -> f32, start| potential.samples.iter().copied().fold(start, f);
    let [low, high] = [
        fold(f32::min, f32::INFINITY),
        fold(f32::max, f32::NEG_INFINITY),
    ];
    if low < high {
        Ok([low, high])
    } else {
        let problem = format!("is {low} everywhere: no place is likelier than another");
        refuse(problem, "follow other features, or use another seeding")
    }
}
