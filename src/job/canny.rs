//! Canny's points as atoms.

use super::frame::Frame;
use super::place::Placed;
use super::{Meshing, Params, Scene, Space};
use crate::Result;
use crate::feature::{Features, gaussian};
use crate::geometry::in_space;
use crate::image::{Field, Image};
use crate::improve;
use crate::lattice::AtomKind;
use crate::lattice::distance::Shared;
use crate::lattice::seeding::{self, Atoms};
use crate::lattice::share::OwnAtoms;
use crate::observer::{Patience, Stage};
use crate::ranks::Ranks;

/// Atoms at Canny's points, on what the points around them agree on.
pub(super) fn placed<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    patience: &Patience<'_>,
) -> Result<Placed<D>>
where
    Space<D>: Meshing<D>,
{
    let image = smoothed(image, frame.step, params.sigma.unwrap_or(1.0), patience);
    let (mut atoms, distance) =
        seeding::canny::seeded(&features.points, &image, &frame.fixed, patience)?;
    patience.lasts(Stage::Placing)?;
    let seeded = atoms.len() - frame.fixed.len();
    let scene = Scene {
        extent: frame.extent,
        features,
        distance: &distance,
    };
    put_onto_features(&mut atoms, seeded, &scene);
    Ok(Placed {
        atoms: OwnAtoms::of(atoms, &Ranks),
        distance: Shared::All(distance),
        optimised: None,
    })
}

/// How far (lattice units) Canny's points are moved onto the smooth curve or sheet through them.
const ONTO_FEATURE: f64 = 0.5;

/// Moves the fixed atoms among the first `seeded`, which are noisy points of features, onto what the
/// points around them agree on, so that what follows knows that they are on it.
fn put_onto_features<const D: usize>(atoms: &mut Atoms<D>, seeded: usize, scene: &Scene<'_, D>)
where
    Space<D>: Meshing<D>,
{
    let extent = in_space(scene.extent);
    let free: Vec<AtomKind> = atoms
        .positions
        .iter()
        .map(|&x| seeding::kind_in_box(x, scene.extent))
        .collect();
    let mut moved: Vec<[f64; 3]> = atoms.positions.iter().map(|&x| in_space(x)).collect();
    let sheets = Space::<D>::sheets(scene);
    improve::settle(&mut moved, &free, extent, &sheets, ONTO_FEATURE);
    let fixed = |&n: &usize| atoms.kinds[n] == AtomKind::Fixed;
    for n in (0..seeded).filter(fixed) {
        atoms.positions[n] = std::array::from_fn(|k| moved[n][k]);
    }
}

/// An image smoothed over `sigma` samples, in lattice space.
pub(super) fn smoothed<const D: usize>(
    image: &Image<D>,
    step: [f64; D],
    sigma: f64,
    patience: &Patience<'_>,
) -> Field<D> {
    let mut samples = image.as_slice().to_vec();
    gaussian::smooth(image.dims(), &mut samples, [sigma; D], patience);
    Field {
        dims: image.dims(),
        step,
        samples,
    }
}
