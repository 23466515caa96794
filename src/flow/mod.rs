//! Steady single-phase flow: `div(K / viscosity grad p) = q`.
//!
//! Units are free as long as they fit together; the command line uses SI: metres, Pa, Pa s, m^2 for
//! permeability, m^3/s for rates.
//!
//! - [`rock`]: permeability, viscosity, and faults as thin layers
//! - [`split`]: a mesh torn along its faults
//! - [`tets`]: linear finite elements on tetrahedra
//! - [`cells`]: two-point fluxes between cells
//! - [`wells`]: point sources and sinks
//! - [`conserve`]: rates through faces, conserved on every tetrahedron
//! - [`streamlines`]: paths of fluid through tetrahedra
//! - [`system`]: the pressure system, conjugate gradients, what is conserved
//! - [`multigrid`]: the preconditioner
//! - [`sparse`]: sparse matrices

pub mod cells;
pub mod conserve;
pub mod multigrid;
pub mod rock;
pub mod sparse;
pub mod split;
pub mod streamlines;
pub mod system;
#[cfg(test)]
mod test_meshes;
pub mod tets;
pub mod wells;

pub use cells::CellFlow;
pub use conserve::FaceRates;
pub use rock::{Faults, Rock, Tensor};
pub use split::Split;
pub use streamlines::Streamlines;
pub use system::{Figures, Solution};
pub use tets::TetFlow;
pub use wells::{Located, Well};
