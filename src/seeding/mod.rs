//! Initial lattices of atoms: image box and nominal distance d(x) -> [`Atoms`].
//!
//! - [`lattice`]: a face-centred cubic lattice fitted to the box, for constant d
//! - [`order`]: memory order of atoms, for cache locality

pub mod lattice;
pub mod order;

use crate::distance::Distance;
use crate::error::{Error, Result, cause};
use crate::mesh::AtomKind;

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
    pub fn in_box(positions: Vec<[f64; D]>, extent: [f64; D]) -> Self {
        let kinds = positions.iter().map(|&x| kind_in_box(x, extent)).collect();
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
            .iter()
            .zip(&self.kinds)
            .map(|(x, kind)| free(x, kind))
            .collect()
    }
}

/// The number of sides of the box `[0, extent]` on which `x` lies exactly.
fn sides_held<const D: usize>(x: [f64; D], extent: [f64; D]) -> usize {
    (0..D).filter(|&k| x[k] <= 0.0 || x[k] >= extent[k]).count()
}

/// The kind of an atom at `x` that no user fixed.
fn kind_in_box<const D: usize>(x: [f64; D], extent: [f64; D]) -> AtomKind {
    let held = sides_held(x, extent);
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

/// Seeds a face-centred cubic lattice that fills the box `[0, extent]` exactly: corners, edges and
/// sides of the box carry atoms.
///
/// For constant d the lattice is regular, slightly stretched per axis to fit
/// ([`lattice::fitted`]).
///
/// # Errors
/// [`Error::Seeding`] if a side of the box is shorter than two d or not a number.
pub fn fcc(extent: [f64; 3], distance: &Distance<3>, _fixed: &[[f64; 3]]) -> Result<Atoms<3>> {
    let smallest = distance.min();
    for k in 0..3 {
        if !(smallest > 0.0 && extent[k] >= 2.0 * smallest && extent[k].is_finite()) {
            return Err(Error::Seeding(cause(
                format!("distance {smallest}"),
                format!(
                    "axis {k} of the box is {} long, shorter than two distances",
                    extent[k]
                ),
                "choose a smaller distance",
            )));
        }
    }
    let mut positions = lattice::fitted(extent, smallest);
    order::sort_by_curve(&mut positions, extent, 2.0 * smallest);
    Ok(Atoms::in_box(positions, extent))
}
