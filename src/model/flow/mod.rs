//! Steady single-phase flow: `div(K / viscosity grad p) = q`.
//!
//! Units are free as long as they fit together; the command line uses SI: metres, Pa, Pa s, m^2 for
//! permeability, m^3/s for rates.
//!
//! - `rock`: permeability, viscosity, and faults as thin layers
//! - `barriers`: which faces are faults, each with its own law
//! - `split`: a mesh torn along its faults
//! - `elements`: linear finite elements on triangles and tetrahedra
//! - `linear`: linear functions on triangles and tetrahedra
//! - `cells`: two-point fluxes between cells
//! - `wells`: point sources and sinks
//! - `conserve`: rates through faces, conserved on every triangle or tetrahedron
//! - `inside`: the same inside polyhedra and polygons
//! - `streamlines`: paths of fluid through them
//! - `report`: what is said of a flow
//! - `system`: the pressure system, conjugate gradients, what is conserved
//! - `multigrid`: the preconditioner
//! - `sparse`: sparse matrices

pub(crate) mod barriers;
pub(crate) mod cells;
pub(crate) mod conserve;
pub(crate) mod elements;
pub(crate) mod inside;
mod linear;
pub(crate) mod multigrid;
pub mod report;
pub(crate) mod rock;
pub(crate) mod sparse;
pub(crate) mod split;
pub(crate) mod streamlines;
pub(crate) mod system;
#[cfg(test)]
pub(crate) mod test_meshes;
pub mod through;
pub(crate) mod wells;

pub use barriers::Barriers;
pub use cells::CellFlow;
pub use conserve::FaceRates;
pub use elements::ElementFlow;
pub use inside::Inside;
pub use rock::{Faults, Rock, Tensor};
pub use split::Split;
pub use streamlines::Streamlines;
pub use system::{Figures, Solution};
pub use wells::{Located, Well};
