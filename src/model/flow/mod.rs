//! Steady single-phase flow: `div(K / viscosity grad p) = q`.
//!
//! Units are free as long as they fit together; the command line uses SI: metres, Pa, Pa s, m^2 for
//! permeability, m^3/s for rates.
//!
//! From a pressure of 1 on the left to 0 on the right of a square:
//!
//! ```
//! use atomesh::mesh::TriMesh;
//! use atomesh::model::flow::{Barriers, ElementFlow, Rock, Tensor};
//!
//! let mesh = TriMesh {
//!     nodes: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]],
//!     triangles: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
//! };
//! let rock = Rock::uniform(Tensor::isotropic(2.0), 1.0);
//! let flow = ElementFlow::new(&mesh, &Barriers::default(), rock)?;
//! let found = flow.solve(&[0.0; 5], &[(0, 1.0), (3, 1.0), (1, 0.0), (2, 0.0)])?;
//! assert!((found.pressure[4] - 0.5).abs() < 1e-12);
//! assert!((found.figures.throughput - 2.0).abs() < 1e-12);
//! assert!((flow.velocity(&found.pressure)[0][0] - 2.0).abs() < 1e-12);
//! # Ok::<(), atomesh::Error>(())
//! ```
//!
//! - `rock`: permeability, viscosity, and faults as thin layers
//! - `barriers`: which faces are faults, each with its own law
//! - `split`: a mesh torn along its faults
//! - `elements`: linear finite elements on triangles and tetrahedra
//! - `linear`: linear functions on triangles and tetrahedra
//! - `cells`: two-point fluxes between cells
//! - `anisotropy`: what two-point fluxes miss along each axis
//! - `wells`: point sources and sinks
//! - `conserve`: rates through faces, conserved on every triangle or tetrahedron
//! - `inside`: the same inside polyhedra and polygons
//! - `streamlines`: paths of fluid through them
//! - `report`: what is said of a flow
//! - `system`: the pressure system, conjugate gradients, what is conserved
//! - `multigrid`: the preconditioner
//! - `sparse`: sparse matrices

pub mod anisotropy;
pub(crate) mod barriers;
pub(crate) mod cells;
pub mod driver;
pub(crate) mod elements;
pub(crate) mod face_rates;
pub(crate) mod multigrid;
pub(crate) mod reconstruction;
pub mod report;
pub(crate) mod rock;
mod shape_functions;
pub(crate) mod sparse_matrix;
pub(crate) mod split_mesh;
pub(crate) mod streamlines;
pub(crate) mod system;
#[cfg(test)]
pub(crate) mod test_meshes;
pub(crate) mod wells;

pub use barriers::Barriers;
pub use cells::CellFlow;
pub use elements::ElementFlow;
pub use face_rates::FaceRates;
pub use reconstruction::CellReconstruction;
pub use rock::{FaultLaw, Rock, Tensor};
pub use split_mesh::SplitMesh;
pub use streamlines::Streamlines;
pub use system::{Solution, SolveStats};
pub use wells::{LocatedWell, PointWell};
