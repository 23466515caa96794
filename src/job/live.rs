//! The share of each cell that holds data.

use super::{MeshResult, Params};
use crate::Result;
use crate::feature::Features;
use crate::image::{ImageSource, LiveVolume};
use crate::mesh::{Mesh, Simplices};

/// Returns the share of each cell of a job's mesh that holds data; `None` if all cells are full of
/// data. `step` is the length of one sample along each axis of lattice space. If the mesh is
/// partitioned, all ranks have shares, whether their own cells are full or not.
///
/// # Errors
/// Returns the errors of loading the image, and an [`Error::Job`](crate::Error::Job) if there is not
/// enough memory.
pub(super) fn shares_in_job<const D: usize, M: Simplices<D>>(
    source: ImageSource<'_, D>,
    features: &Features<D>,
    params: &Params<D>,
    mesh: &MeshResult<D, M>,
    step: [f64; D],
    is_partitioned: bool,
) -> Result<Option<Vec<f64>>> {
    let live = live_volume(source, features, params.spec.input.keeps_nulls())?;
    let shares = live.map(|live| live_shares(mesh, step, &live));
    Ok(shares.filter(|shares| is_partitioned || shares.iter().any(|share| *share < 1.0)))
}

/// Returns the part of an image that holds data, or `None` if all samples do. The samples of an
/// image in memory must be marked already. An image in layers is loaded only if its features say
/// that it has gaps; `keeps_nulls` is `true` if null values count as data.
///
/// # Errors
/// Returns the errors of loading the image, and an [`Error::Job`](crate::Error::Job) if there is
/// not enough memory.
fn live_volume<const D: usize>(
    source: ImageSource<'_, D>,
    features: &Features<D>,
    keeps_nulls: bool,
) -> Result<Option<LiveVolume<D>>> {
    match source {
        ImageSource::InMemory(image) => LiveVolume::new(image),
        ImageSource::Layered(_) if features.missing.is_none() => Ok(None),
        ImageSource::Layered(layers) => match layers.load()?.mark_dead(!keeps_nulls)? {
            Some(marked) => LiveVolume::new(&marked.image),
            None => Ok(None),
        },
    }
}

/// Returns the share of each cell that holds data. `step` is the length of one sample along each
/// axis of lattice space.
fn live_shares<const D: usize, M: Simplices<D>>(
    mesh: &MeshResult<D, M>,
    step: [f64; D],
    live: &LiveVolume<D>,
) -> Vec<f64> {
    let to_index = |x: [f64; D]| std::array::from_fn(|k| x[k] / step[k]);
    match mesh {
        MeshResult::Simplices(annotated) => shares_of_cells(&annotated.mesh, live, to_index),
        MeshResult::Voronoi { mesh, .. } => shares_of_cells(mesh, live, to_index),
    }
}

/// Returns the share of each cell of a mesh that holds data. `index_of` converts positions in the
/// mesh to sample indices.
pub(crate) fn shares_of_cells<const D: usize>(
    mesh: &impl Mesh<D>,
    live: &LiveVolume<D>,
    index_of: impl Fn([f64; D]) -> [f64; D] + Sync,
) -> Vec<f64> {
    mesh.mean_over_simplices(|corners| {
        let mut indices = [[0.0; D]; 4];
        for (index, &corner) in indices.iter_mut().zip(corners) {
            *index = index_of(corner);
        }
        live.live_share(&indices[..=D])
    })
}

/// Returns the note on cells without data, if there are any.
pub(super) fn note_on_live_shares(shares: &[f64]) -> Option<String> {
    let dead = shares.iter().filter(|share| **share == 0.0).count();
    let partial = shares.iter().filter(|share| **share < 1.0).count() - dead;
    (dead + partial > 0).then(|| {
        format!(
            "{dead} of {} cells hold no data, and {partial} hold some: the cell array live has the share of each",
            shares.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::FeatureKind;
    use crate::geometry::grid_index::index_at;
    use crate::image::{Geometry, Image};
    use crate::job::{CellKind, MeshImage, MeshSpec, Outcome, Params, run};
    use crate::mesh::Space;
    use crate::progress::NoProgress;

    /// Returns the mesh of an image without data from sample `first_dead` along x on, and the
    /// volumes of its cells.
    fn half_space<const D: usize>(cells: CellKind, first_dead: usize) -> (Outcome<D>, Vec<f64>)
    where
        Space<D>: MeshImage<D>,
    {
        let dims = [24; D];
        let sample = |i: usize| {
            let x = index_at(dims, i);
            let is_dead = x[0] >= first_dead;
            if is_dead {
                f32::NAN
            } else {
                (0.37 * x[1] as f32 + 0.2).sin()
            }
        };
        let samples = (0..dims.iter().product()).map(sample).collect();
        let image = Image::new(dims, samples, Geometry::default());
        let params = Params::new(MeshSpec {
            cells: Some(cells),
            feature: FeatureKind::NoFeatures,
            distance: "5".parse().unwrap(),
            ..MeshSpec::default()
        })
        .unwrap();
        let outcome = run(&image, &params, &mut NoProgress).unwrap();
        let volumes = match &outcome.mesh {
            MeshResult::Simplices(annotated) => annotated.mesh.volumes(),
            MeshResult::Voronoi { mesh, .. } => mesh.volumes(),
        };
        (outcome, volumes)
    }

    /// Checks that the live volume is that of a box from 0 to half a sample before the first dead
    /// one.
    fn check<const D: usize>(cells: CellKind)
    where
        Space<D>: MeshImage<D>,
    {
        let (outcome, volumes) = half_space::<D>(cells, 15);
        let live = outcome.live.unwrap();
        let sum: f64 = live
            .iter()
            .zip(&volumes)
            .map(|(share, volume)| share * volume)
            .sum();
        let expected = 14.5 * 23f64.powi(D as i32 - 1);
        assert!(
            (sum / expected - 1.0).abs() < 1e-9,
            "{D} {cells:?}: {sum} {expected}"
        );
        assert!(live.contains(&0.0) && live.contains(&1.0));
        let (outcome, _) = half_space::<D>(cells, 24);
        assert!(outcome.live.is_none());
    }

    #[test]
    fn cells_of_every_kind_have_the_share_of_a_half_space() {
        check::<2>(CellKind::Simplices);
        check::<2>(CellKind::Voronoi);
        check::<3>(CellKind::Simplices);
        check::<3>(CellKind::Voronoi);
    }
}
