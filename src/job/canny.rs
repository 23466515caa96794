//! Atoms at Canny's points.

use super::job_domain::JobDomain;
use super::placement::PlacedAtoms;
use super::{LatticeParams, MeshScene};
use crate::Result;
use crate::comm::Comm;
use crate::feature::{Features, gaussian};
use crate::geometry::to_3d;
use crate::image::{Image, ScalarField};
use crate::improve;
use crate::lattice::AtomKind;
use crate::lattice::distance::DistributedDistance;
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::{self, Atoms};
use crate::progress::{CancelToken, Stage};
use crate::published::canny;

/// Returns atoms at Canny's points, moved onto the smooth features on which the points around them
/// agree.
pub(super) fn canny_atoms<const D: usize>(
    image: &Image<D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<PlacedAtoms<D>> {
    let image = smooth_image(
        image,
        frame.step,
        params.spec().sigma.unwrap_or(1.0),
        cancel,
    );
    let (mut atoms, distance) =
        canny::place_atoms(&features.points, &image, &frame.fixed_atoms, cancel)?;
    cancel.check(Stage::Placing)?;
    let seeded_count = atoms.len() - frame.fixed_atoms.len();
    let scene = MeshScene {
        extent: frame.extent,
        features,
        distance: &distance,
    };
    snap_to_features(&mut atoms, seeded_count, &scene);
    Ok(PlacedAtoms {
        atoms: OwnedAtoms::from_global(atoms, comm),
        distance: DistributedDistance::Global(distance),
        optimise_result: None,
    })
}

/// Largest distance, in lattice units, by which Canny's points are moved onto the smooth curve or
/// surface through them.
const MAX_SNAP_DISTANCE: f64 = 0.5;

/// Moves the fixed atoms among the first `seeded_count` onto the local planes of the features
/// around them. These atoms are noisy points of features; after the move, later steps find them on
/// their feature.
fn snap_to_features<const D: usize>(
    atoms: &mut Atoms<D>,
    seeded_count: usize,
    scene: &MeshScene<'_, D>,
) {
    let extent = to_3d(scene.extent);
    let kinds: Vec<AtomKind> = atoms
        .positions
        .iter()
        .map(|&x| seeding::kind_at(x, scene.extent))
        .collect();
    let mut moved: Vec<[f64; 3]> = atoms.positions.iter().map(|&x| to_3d(x)).collect();
    let planes = scene.local_planes();
    improve::snap_to_features(&mut moved, &kinds, extent, &planes, MAX_SNAP_DISTANCE);
    let is_fixed = |&n: &usize| atoms.kinds[n] == AtomKind::Fixed;
    for n in (0..seeded_count).filter(is_fixed) {
        atoms.positions[n] = std::array::from_fn(|k| moved[n][k]);
    }
}

/// Returns an image smoothed by a Gaussian of `sigma` samples, as a field in lattice space.
pub(super) fn smooth_image<const D: usize>(
    image: &Image<D>,
    step: [f64; D],
    sigma: f64,
    cancel: &CancelToken<'_>,
) -> ScalarField<D> {
    let mut samples = image.as_slice().to_vec();
    gaussian::smooth(image.dims(), &mut samples, [sigma; D], cancel);
    ScalarField {
        dims: image.dims(),
        step,
        samples,
    }
}
