//! What Canny's points and smoothing by the image add to the job.

use super::{Meshing, Params, Scene, Space};
use crate::feature::canny::steepness;
use crate::feature::gaussian;
use crate::feature::volume::Volume;
use crate::geometry::in_space;
use crate::image::{Field, Image};
use crate::improve;
use crate::improve::triangles::relax::{self, Relaxation};
use crate::lattice::AtomKind;
use crate::lattice::energy::Parts;
use crate::lattice::optimize::{self, Stop};
use crate::lattice::seeding::{self, Atoms};

/// How far (lattice units) Canny's points are moved onto the smooth curve or sheet through them.
const ONTO_FEATURE: f64 = 0.5;

/// Moves the fixed atoms among the first `seeded`, which are noisy points of features, onto what the
/// points around them agree on, so that what follows knows that they are on it.
pub(super) fn put_onto_features<const D: usize>(
    atoms: &mut Atoms<D>,
    seeded: usize,
    scene: &Scene<'_, D>,
) where
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

/// The outcome where nothing is to be moved.
pub(super) const AT_REST: optimize::Rest = optimize::Rest {
    stop: Stop::Converged,
    rounds: 0,
    iterations: 0,
    evaluations: 0,
    energy_before: 0.0,
    energy_after: 0.0,
    parts: Parts {
        lattice: 0.0,
        image: 0.0,
    },
};

/// An image smoothed over `sigma` samples, in lattice space.
pub(super) fn smoothed<const D: usize>(image: &Image<D>, step: [f64; D], sigma: f64) -> Field<D> {
    let mut samples = image.as_slice().to_vec();
    gaussian::smooth(image.dims(), &mut samples, [sigma; D]);
    Field {
        dims: image.dims(),
        step,
        samples,
    }
}

/// How the triangles shall be smoothed, if they shall be.
pub(super) fn relaxation<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    step: [f64; D],
) -> Option<Relaxation<D>> {
    let scheme = params.smooth?;
    let image = smoothed(image, step, params.sigma.unwrap_or(1.0));
    let steepness = steepness(Volume {
        dims: image.dims,
        samples: &image.samples,
    });
    Some(Relaxation {
        scheme,
        weight: relax::weight(Field {
            samples: steepness,
            ..image
        }),
        rounds: relax::ROUNDS,
    })
}
