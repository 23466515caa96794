//! The whole job: image in, mesh out. The command line and any other front end call `run`.
//!
//! - [`spec`]: all options, as one value
//! - `params`: the options, and what the files that they name hold
//! - `depth`: images in two-way time converted to depth
//! - `run`: the one pass through all stages
//! - `checkpoint`: results of stages, stored in a folder so that an interrupted job can go on
//! - `stages`: reports each stage to the clock and the progress
//! - `frame`: lattice space, and its relation to the image
//! - `placement`: atoms at rest, on a lattice that has moved or on Canny's points
//! - `optimise`: how the lattice moves
//! - `canny`: Canny's points as atoms
//! - `simplices`: atoms at rest become tetrahedra or triangles
//! - `distributed`: large meshes of which each rank has a part
//! - `join`: how atoms become simplices, which differs in the plane and in space
//! - `cells`: how atoms become Voronoi cells
//! - `equalise`: Voronoi cells of more equal size
//! - `measure`: quality and fidelity of the mesh
//! - `regions`: labels of cells, and faces where labels change
//! - `horizons`: which faces lie on horizons
//! - `well_file`: trajectories of wells in CSV files
//!
//! All stages work in *lattice space* (sample index times a step per axis); `store` transforms the
//! result into physical coordinates.

mod canny;
pub(crate) mod cells;
mod checkpoint;
pub(crate) mod depth;
mod distributed;
mod equalise;
mod estimate;
mod frame;
pub(crate) mod horizons;
mod join;
mod measure;
mod optimise;
mod params;
mod placement;
mod regions;
mod run;
mod simplices;
pub mod spec;
mod stages;
pub(crate) mod well_file;

pub use checkpoint::Checkpoint;
pub use distributed::MeshShare;
pub(crate) use frame::{lattice_beta, lattice_points, lattice_well_paths};
pub use join::{AnnotatedMesh, JoinedMesh, MeshScene, MeshSpace, Meshing};
pub use measure::{BOX_TOLERANCE, scaled_mesh};
pub(crate) use optimise::optimize_options;
pub use params::{Evaluator, FixedAtom, Params, Spacing, Weight, WellPath};
pub use run::{MeshResult, Outcome, Provenance, RunOptions, run, run_from};
pub use spec::{CellKind, MeshSpec, Metric};
pub use stages::StageRunner;
