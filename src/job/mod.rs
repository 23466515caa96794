//! The whole job: image in, mesh out. The command line and other front ends call [`run()`] or
//! [`run_from`].
//!
//! - [`spec`]: all options, as one value
//! - `params`: the options, and the content of the files that they name
//! - `depth`: converts the images among the parameters from two-way time to depth
//! - `mesh_verb`: runs all stages of a job
//! - `advice`: options for a better mesh, tried on a part of the image
//! - `checkpoint`: results of stages, stored in a folder so that an interrupted job can continue
//! - `stages`: reports each stage to the clock and the caller
//! - `estimate`: estimates of the size of a mesh
//! - `job_domain`: lattice space, and its relation to the image
//! - `given_surfaces`: surfaces that the user gives, in the image
//! - `extended_surfaces`: given faults continued to what they end near
//! - `placement`: atoms at rest, on a lattice that has moved or on Canny's points
//! - `minimisation`: moves the atoms of a lattice
//! - `canny`: atoms at Canny's points
//! - `simplices`: makes tetrahedra or triangles from atoms at rest
//! - `distributed`: large meshes of which each rank has a part
//! - `join`: joins atoms to simplices, which differs in the plane and in space
//! - `scene`: the box, the features and the nominal distance with which atoms are joined
//! - `cells`: makes Voronoi cells
//! - `equalise`: makes Voronoi cells more equal in size
//! - `skew_faces`: removes faces far from the line between the centroids of their cells
//! - `padding`: cells beyond the image
//! - `periodic`: opposite sides that match
//! - `output`: the mesh as a file, and files of lines and feature points
//! - `topography`: the surface at which those above it end
//! - `measure`: quality and fidelity of the mesh
//! - `regions`: labels of cells, and faces where labels change
//! - `horizons`: the faces that lie on horizons
//! - `named_faces`: the faces on surfaces that the user gives
//! - `live`: the share of each cell that holds data
//! - `features`: detects features alone
//! - `placed_points`: wells and fixed atoms in the frame of the image
//! - `atom_file`: fixed atoms in tables
//!
//! All stages work in *lattice space* (sample index times a step per axis); `store` transforms the
//! result into physical coordinates.

mod advice;
pub(crate) mod atom_file;
mod canny;
pub(crate) mod cell_choice;
pub(crate) mod cells;
mod checkpoint;
pub(crate) mod cover;
mod depth;
mod distributed;
mod equalise;
mod estimate;
mod extended_surfaces;
mod features;
pub(crate) mod given_surfaces;
pub(crate) mod horizons;
mod job_domain;
mod join;
pub(crate) mod live;
mod local_cells;
mod measure;
mod mesh_verb;
mod minimisation;
mod named_faces;
pub(crate) mod output;
pub(crate) mod padding;
mod params;
mod periodic;
mod placed_points;
mod placement;
mod regions;
mod scene;
pub(crate) mod simplices;
mod skew_faces;
pub mod spec;
mod stages;
mod topography;

use crate::Result;
use crate::image::formats::read_with_options;
use crate::image::{Image, image_in_depth};
use crate::mesh::Space;
use crate::progress::Progress;

pub use crate::mesh::check::BOX_TOLERANCE;
pub use crate::mesh_file::{Burden, Provenance};
pub use checkpoint::Checkpoint;
pub use distributed::MeshShare;
pub(crate) use features::detect_in_one_process;
pub use features::{FeatureOutcome, FeatureSpec, features};
pub use given_surfaces::FollowedSurface;
pub(crate) use job_domain::{lattice_beta, lattice_points, lattice_well_paths};
pub use join::AnnotatedMesh;
pub(crate) use join::{JoinAtoms, JoinedMesh};
pub use measure::scaled_mesh;
pub use mesh_verb::{MeshImage, MeshResult, Outcome, RunOptions, run, run_from};
pub(crate) use minimisation::{job_energy, optimise_options};
pub use output::lines::{write_feature_lines, write_lines};
pub use output::points::write_feature_points;
pub use padding::PaddingCells;
pub(crate) use params::LatticeParams;
pub use params::{Evaluator, FixedAtom, Optimizer, Params, Spacing, Weight, WellPath};
pub use placed_points::PointFile;
pub(crate) use scene::MeshScene;
pub use spec::{CellKind, MeshSpec, Metric};
pub(crate) use stages::StageRunner;

/// Makes a mesh of an image, as `atomesh mesh` does, and reads the files that the options name.
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::{MeshSpec, progress::NoProgress};
///
/// let disc = |i: usize| f32::from(u8::from((i % 40).abs_diff(20) < 11 && (i / 40).abs_diff(18) < 9));
/// let image = Image::new([40, 36], (0..40 * 36).map(disc).collect(), Geometry::default());
/// let spec = MeshSpec { distance: "5".parse()?, ..MeshSpec::default() };
/// let outcome = atomesh::mesh(&image, &spec, &mut NoProgress)?;
/// assert!(outcome.simplices().is_some_and(|mesh| mesh.mesh.triangles.len() > 50));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of reading these files and of [`run()`].
pub fn mesh<const D: usize>(
    image: &Image<D>,
    spec: &MeshSpec,
    progress: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    Space<D>: MeshImage<D>,
{
    let mut params = Params::read(spec)?;
    if spec.velocity.is_none() {
        return run(image, &params, progress);
    }
    params.note_time_unit(&image.geometry);
    let is_labels = params.spec.feature.has_labels();
    let (image, conversion) = image_in_depth(
        image.clone(),
        spec.velocity.as_ref(),
        is_labels,
        &read_with_options,
    )?;
    if let Some(conversion) = conversion {
        params.convert_to_depth(&conversion)?;
    }
    run(&image, &params, progress)
}
