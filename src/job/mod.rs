//! The whole job: image in, mesh out. The command line and any other front end call `run`.
//!
//! - [`asked`]: all that can be asked for, as one value
//! - [`settings`]: the same as flat options, `words`: how these are read
//! - `params`: what the pass is told, with the files that were named
//! - `run`: the one pass through all stages
//! - `checkpoint`: what stages gave, kept in a folder to go on from
//! - `stages`: what clock and observer are told of them
//! - `frame`: lattice space, and what lies in it
//! - `place`: atoms at rest, placed on a lattice that moves or as Canny's points
//! - `optimise`: how the lattice moves
//! - `canny`: Canny's points as atoms
//! - `simplices`: atoms at rest become tetrahedra or triangles
//! - `pieces`: large ones made by ranks that each hold a part
//! - `join`: how atoms become simplices, which differs in the plane and in space
//! - `cells`: how they become Voronoi cells
//! - `even`: cells more alike
//! - `measure`: the figures of either
//! - `regions`: labels of cells, and faces where they change
//! - `horizons`: which faces lie on horizons
//!
//! All works in *lattice space* (sample index times a step per axis); `store` puts the outcome where
//! the image lies in the world.

pub mod asked;
mod canny;
pub(crate) mod cells;
mod checkpoint;
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
pub mod settings;
mod simplices;
mod stages;
mod words;

pub use asked::Job;
pub use checkpoint::Checkpoint;
pub use distributed::MeshShare;
pub(crate) use frame::{lattice_beta, lattice_points, lattice_well_paths};
pub use join::{AnnotatedMesh, JoinedMesh, MeshScene, MeshSpace, Meshing};
pub use measure::{BOX_TOLERANCE, scaled_mesh};
pub(crate) use optimise::optimize_options;
pub use params::{CellKind, Evaluator, FixedAtom, Metric, Params, Spacing, Weight, WellPath};
pub use run::{MeshResult, Outcome, Provenance, RunOptions, run, run_from};
pub use settings::Settings;
pub use stages::StageRunner;
