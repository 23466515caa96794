//! Where atoms stand: how far apart, where at first, and where they come to rest.
//!
//! - [`distance`]: nominal distance d(x) between atoms
//! - [`seeding`]: a lattice of atoms that fills the image's box
//! - [`energy`]: the energy of the lattice and its gradient
//! - [`optimize`]: atoms move to lower it
//! - `share`: the atoms that one of several processes has
//! - [`halo`]: these, and those of others near them, while they move

pub mod distance;
pub mod energy;
pub mod halo;
pub mod optimize;
pub(crate) mod partition;
pub mod seeding;

/// What an atom (mesh node) may do: how many of the box's sides hold it, or a user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum AtomKind {
    /// Moves freely inside the box.
    Interior = 0,
    /// Moves in a side of the box.
    Side = 1,
    /// Moves along an edge of the box.
    Edge = 2,
    /// A corner of the box: does not move.
    Corner = 3,
    /// Placed by the user (a well, a source): does not move.
    Fixed = 4,
}
