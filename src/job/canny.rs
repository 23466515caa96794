//! Canny's points as atoms.

use super::frame::JobDomain;
use super::placement::PlacedAtoms;
use super::{MeshScene, MeshSpace, Meshing, Params};
use crate::Result;
use crate::comm::WorldComm;
use crate::feature::{Features, gaussian};
use crate::geometry::to_3d;
use crate::image::{Image, ScalarField};
use crate::improve;
use crate::lattice::AtomKind;
use crate::lattice::distance::DistributedDistance;
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::{self, Atoms};
use crate::progress::{CancelToken, Stage};

/// Atoms at Canny's points, on what the points around them agree on.
pub(super) fn canny_atoms<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    patience: &CancelToken<'_>,
) -> Result<PlacedAtoms<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let image = smooth_image(
        image,
        frame.step,
        params.spec.sigma.unwrap_or(1.0),
        patience,
    );
    let (mut atoms, distance) =
        seeding::canny::place_atoms(&features.points, &image, &frame.fixed_atoms, patience)?;
    patience.check(Stage::Placing)?;
    let seeded = atoms.len() - frame.fixed_atoms.len();
    let scene = MeshScene {
        extent: frame.extent,
        features,
        distance: &distance,
    };
    snap_to_features(&mut atoms, seeded, &scene);
    Ok(PlacedAtoms {
        atoms: OwnedAtoms::from_global(atoms, &WorldComm),
        distance: DistributedDistance::Global(distance),
        optimize_result: None,
    })
}

/// How far (lattice units) Canny's points are moved onto the smooth curve or sheet through them.
const MAX_SNAP_DISTANCE: f64 = 0.5;

/// Moves the fixed atoms among the first `seeded`, which are noisy points of features, onto what the
/// points around them agree on, so that what follows knows that they are on it.
fn snap_to_features<const D: usize>(atoms: &mut Atoms<D>, seeded: usize, scene: &MeshScene<'_, D>)
where
    MeshSpace<D>: Meshing<D>,
{
    let extent = to_3d(scene.extent);
    let free: Vec<AtomKind> = atoms
        .positions
        .iter()
        .map(|&x| seeding::kind_at(x, scene.extent))
        .collect();
    let mut moved: Vec<[f64; 3]> = atoms.positions.iter().map(|&x| to_3d(x)).collect();
    let sheets = MeshSpace::<D>::local_planes(scene);
    improve::snap_to_features(&mut moved, &free, extent, &sheets, MAX_SNAP_DISTANCE);
    let fixed = |&n: &usize| atoms.kinds[n] == AtomKind::Fixed;
    for n in (0..seeded).filter(fixed) {
        atoms.positions[n] = std::array::from_fn(|k| moved[n][k]);
    }
}

/// An image smoothed over `sigma` samples, in lattice space.
pub(super) fn smooth_image<const D: usize>(
    image: &Image<D>,
    step: [f64; D],
    sigma: f64,
    patience: &CancelToken<'_>,
) -> ScalarField<D> {
    let mut samples = image.as_slice().to_vec();
    gaussian::smooth(image.dims(), &mut samples, [sigma; D], patience);
    ScalarField {
        dims: image.dims(),
        step,
        samples,
    }
}
