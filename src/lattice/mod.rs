//! The lattice of atoms that becomes the nodes of the mesh: spacing, initial positions and
//! optimisation.
//!
//! - [`distance`]: nominal distance d(x) between atoms
//! - [`seeding`]: initial lattices that fill the image's box
//! - [`energy`]: the energy of the lattice and its gradient
//! - [`optimise`]: moves atoms to lower the energy
//! - `owned_atoms`: distribution of the atoms over ranks
//! - `halo`: owned atoms and ghosts of a rank while atoms move

pub mod distance;
pub mod energy;
pub(crate) mod halo;
pub mod optimise;
pub(crate) mod owned_atoms;
pub mod seeding;

/// The constraint on an atom (mesh node): sides of the box on which it lies, or fixed by the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum AtomKind {
    /// Moves freely inside the box.
    Interior = 0,
    /// Moves in a side of the box.
    Side = 1,
    /// Moves along an edge of the box.
    Edge = 2,
    /// Corner of the box: does not move.
    Corner = 3,
    /// Placed by the user (a well, a source): does not move.
    Fixed = 4,
}
