//! Steady single-phase flow: solves `div(K / viscosity grad p) = q`.
//!
//! Any consistent set of units works. The command line uses SI units: metres, Pa, Pa s, m^2 for
//! permeability, m^3/s for rates.
//!
//! Example: flow through a square from pressure 1 on its left side to pressure 0 on its right side.
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
//! let solution = flow.solve(&[0.0; 5], &[(0, 1.0), (3, 1.0), (1, 0.0), (2, 0.0)])?;
//! assert!((solution.pressure[4] - 0.5).abs() < 1e-12);
//! assert!((solution.stats.throughput - 2.0).abs() < 1e-12);
//! assert!((flow.velocity(&solution.pressure)[0][0] - 2.0).abs() < 1e-12);
//! # Ok::<(), atomesh::Error>(())
//! ```
//!
//! - `rock`: permeability, viscosity, and faults as thin layers
//! - `barriers`: the faces that resist flow, and the fault law of each
//! - `split_mesh`: meshes split along their faults
//! - `elements`: linear finite elements on triangles and tetrahedra
//! - `shape_functions`: linear shape functions on triangles and tetrahedra
//! - `cells`: two-point fluxes between cells
//! - `anisotropy`: errors of two-point fluxes along each axis
//! - `wells`: point sources and sinks
//! - `face_rates`: rates through faces that are conserved on every triangle or tetrahedron
//! - `reconstruction`: conserved rates inside polyhedra and polygons
//! - `streamlines`: paths of fluid through these rates
//! - `flow_spec`: all options, as one value
//! - `faults`: options that say how faults resist flow
//! - `flow_verb`: the whole computation, from a mesh and its options
//! - `driver`: flow through a mesh from a file, with its boundary conditions and barriers
//! - `report`: the report of a computed flow
//! - `system`: the pressure system, conjugate gradients, and the mass balance
//! - `multigrid`: the preconditioner
//! - `sparse_matrix`: sparse matrices

pub(crate) mod anisotropy;
pub(crate) mod barriers;
pub(crate) mod cells;
pub(crate) mod driver;
pub(crate) mod elements;
pub(crate) mod face_rates;
pub(crate) mod faults;
mod flow_spec;
mod flow_verb;
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
pub use faults::{FaultMultiplier, FaultOptions, FaultResistance};
pub use flow_spec::{FlowPermeability, FlowPoint, FlowSpec, SidePressure};
pub use flow_verb::{FlowOutcome, flow};
pub use reconstruction::CellReconstruction;
pub use rock::{FaultLaw, Rock, Tensor};
pub use split_mesh::SplitMesh;
pub use streamlines::Streamlines;
pub use system::{Solution, SolveStats};
pub use wells::{LocatedWell, PointWell};
