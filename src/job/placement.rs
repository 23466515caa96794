//! Placement of atoms: on a lattice that then moves onto the features, or at Canny's points, which
//! lie on them from the start.

use super::job_domain::JobDomain;
use super::minimisation::{self, optimise};
use super::spec::SeedingKind;
use super::{LatticeParams, Spacing, StageRunner, canny, estimate, periodic};
use crate::comm::Comm;
use crate::error::cause;
use crate::feature::components::for_each_sample;
use crate::feature::{Brightness, Features};
use crate::image::{Image, ImageSource, LabelValue, ScalarField, SparseField};
use crate::lattice::distance::{self, DenseRegion, Distance, DistanceLimits, DistributedDistance};
use crate::lattice::optimise::{self, StopReason};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::{self, Alignment, Atoms, Seeding, SharedBox, wells};
use crate::progress::{CancelToken, Stage};
use crate::published::guide::{GuideOptions, draw_lattice};
use crate::published::laplacian_distance::laplacian_distance;
use crate::published::projection::project_lattice;
use crate::{Error, Result};

/// Largest gradient |grad d| of a variable nominal distance.
const MAX_DISTANCE_GROWTH: f64 = 0.1;

/// Atoms at rest.
pub(super) struct PlacedAtoms<const D: usize> {
    /// The atoms that this rank owns.
    pub atoms: OwnedAtoms<D>,
    /// The nominal distance between them.
    pub distance: DistributedDistance<D>,
    /// Result of the optimiser's last pass, if it ran.
    pub optimise_result: Option<optimise::OptimiseResult>,
}

/// Places atoms and brings them to rest: on a lattice that moves, or at Canny's points, which do
/// not move.
///
/// # Errors
/// Returns the errors of distances and seeding, and [`Error::Interrupted`] if the job is stopped
/// before there is a lattice.
pub(super) fn place_atoms<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<PlacedAtoms<D>> {
    stages.begin_unless_stopped(Stage::Placing)?;
    let comm = stages.comm;
    if params.spec().seeding == SeedingKind::Canny {
        let placed = stages.run_or_interrupt(Stage::Placing, |cancel| {
            canny::canny_atoms(&*source.to_image()?, params, features, frame, comm, cancel)
        })?;
        let atoms = placed.atoms.global_count as f64;
        let estimate = estimate::estimate_from_atom_count::<D>(atoms, params.spec().cell_kind());
        stages.progress.estimate(&estimate);
        estimate::afford(&estimate)?;
        return Ok(placed);
    }
    let distance = nominal_distance(source, params, features, frame, stages)?;
    let fixed = fixed_atoms(&distance.outline(), Alignment::OnFeatures, frame)?;
    optimised_lattice(params, distance, &fixed, features, frame, stages)
}

/// Returns `true` if placing and moving atoms needs the potential only near each atom.
pub(super) fn needs_only_local_potential<const D: usize>(params: &LatticeParams<'_, D>) -> bool {
    matches!(params.spec().seeding, SeedingKind::Fcc | SeedingKind::Grown)
        && !matches!(params.spacing(), Spacing::FromLaplacian { .. })
        && minimisation::needs_only_local_potential(params)
}

/// Returns the nominal distance between atoms, also at wells. With wells or labels it is known
/// everywhere on every rank.
pub(super) fn nominal_distance<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<DistributedDistance<D>> {
    let (extent, well_paths, comm) = (frame.extent, &frame.well_paths, stages.comm);
    let distance = stages.run_or_interrupt(Stage::Placing, |cancel| {
        let mut distance = base_distance(source, params, features, frame.step, comm, cancel)?;
        let is_periodic = params.spec().periodic.is_some();
        if features.labels.is_some() || !well_paths.is_empty() || is_periodic {
            distance = DistributedDistance::Global(distance.into_global(comm)?);
        }
        if let DistributedDistance::Global(global) = distance {
            distance =
                DistributedDistance::Global(distance_with_labels(global, params, features, cancel));
        }
        if let (Some(axes), DistributedDistance::Global(global)) =
            (params.periodic_axes(), &mut distance)
        {
            let growth = MAX_DISTANCE_GROWTH;
            periodic::make_distance_periodic(global, axes, growth, cancel);
        }
        cancel.check(Stage::Placing)?;
        match (
            params
                .spec()
                .well_distance
                .map(|length| length.value)
                .filter(|_| !well_paths.is_empty()),
            distance,
        ) {
            (Some(min_distance), DistributedDistance::Global(distance)) => {
                wells::refine_near_wells(
                    distance,
                    well_paths,
                    min_distance,
                    MAX_DISTANCE_GROWTH,
                    extent,
                    cancel,
                )
                .map(DistributedDistance::Global)
            }
            (_, distance) => Ok(distance),
        }
    })?;
    let outline = distance.outline();
    let mut estimate =
        estimate::estimate_from_distance(&outline, extent, params.spec().cell_kind());
    if stages.may_partition {
        estimate = estimate::estimate_per_rank(
            estimate,
            extent,
            &outline,
            params.spec().seeding,
            comm.size(),
        );
    }
    stages.progress.estimate(&estimate);
    estimate::afford(&estimate)?;
    drop(outline);
    Ok(distance)
}

/// Returns the positions of atoms that never move: those that the user gives, and those of wells.
pub(super) fn fixed_atoms<const D: usize>(
    distance: &Distance<D>,
    alignment: Alignment,
    frame: &JobDomain<D>,
) -> Result<Vec<[f64; D]>> {
    let mut fixed = frame.fixed_atoms.clone();
    fixed.extend(wells::place_atoms(
        &frame.well_paths,
        distance,
        frame.extent,
        alignment,
    )?);
    Ok(fixed)
}

/// Seeds a lattice by the method of the job.
///
/// # Errors
/// Returns the errors of the method, and an [`Error::Seeding`] for [`SeedingKind::Canny`], which
/// places atoms by the image instead of a distance.
pub(super) fn seed_atoms<const D: usize>(
    params: &LatticeParams<'_, D>,
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    potential: &SparseField<D>,
    cancel: &CancelToken<'_>,
) -> Result<Atoms<D>> {
    let seed = params.spec().rng_seed;
    let seeding = match params.spec().seeding {
        SeedingKind::Fcc => Seeding::Fcc,
        SeedingKind::Grown => Seeding::Grown,
        SeedingKind::Refine => Seeding::Refine { seed },
        kind => {
            let max_atoms = params.spec().max_atoms.unwrap_or(usize::MAX);
            let options = GuideOptions {
                alignment,
                seed,
                max_atoms,
            };
            return seeding::seed_with(extent, distance, fixed, alignment, |fixed| {
                let potential = &potential.to_dense();
                match kind {
                    SeedingKind::Guide => {
                        draw_lattice(extent, distance, potential, fixed, options, cancel)
                    }
                    SeedingKind::Projection => {
                        project_lattice(extent, distance, potential, fixed, alignment, cancel)
                    }
                    _ => Err(Error::Seeding(cause(
                        "seeding 'canny'",
                        "places atoms by features and image, not by a distance",
                        "choose another seeding",
                    ))),
                }
            });
        }
    };
    seeding::seed(seeding, extent, distance, fixed, alignment, cancel)
}

/// Seeds a lattice with atoms on features by the method of the job, and returns the atoms that this
/// rank owns.
fn seed_partition<const D: usize>(
    params: &LatticeParams<'_, D>,
    extent: [f64; D],
    distance: &DistributedDistance<D>,
    fixed: &[[f64; D]],
    potential: &SparseField<D>,
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<OwnedAtoms<D>> {
    let regular = match params.spec().seeding {
        SeedingKind::Fcc => Seeding::Fcc,
        SeedingKind::Grown => Seeding::Grown,
        _ => {
            let (distance, alignment) = (distance.global(comm)?, Alignment::OnFeatures);
            let atoms = seed_atoms(
                params, extent, &distance, fixed, alignment, potential, cancel,
            )?;
            comm.ensure_identical("atoms placed", &atoms)?;
            return Ok(OwnedAtoms::from_global(atoms, comm));
        }
    };
    let shared_box = SharedBox::new(extent, comm);
    let range = seeding::required_range(shared_box, distance.max());
    let distance = distance.fetch_between(D - 1, range, comm)?;
    let alignment = Alignment::OnFeatures;
    seeding::seed_regular(shared_box, regular, &distance, fixed, alignment, cancel)
}

/// Seeds a lattice with atoms on features, and moves it.
pub(super) fn optimised_lattice<const D: usize>(
    params: &LatticeParams<'_, D>,
    distance: DistributedDistance<D>,
    fixed: &[[f64; D]],
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<PlacedAtoms<D>> {
    let comm = stages.comm;
    let (atoms, optimised) = stages.load_or_run_shares("3-moved", |stages| {
        let (mut atoms, ()) = stages.load_or_run_shares("2-seeded", |stages| {
            let atoms = stages.run_or_interrupt(Stage::Placing, |cancel| {
                let (extent, potential) = (frame.extent, &features.potential);
                seed_partition(params, extent, &distance, fixed, potential, comm, cancel)
            })?;
            Ok((atoms, ()))
        })?;
        if let Some(axes) = params.periodic_axes() {
            let min_distance = distance.outline().min();
            periodic::tie_lattice(&mut atoms, frame.extent, min_distance, axes)?;
        }
        stages.begin(Stage::Optimising);
        let optimised = optimise(
            &mut atoms,
            params,
            features,
            &distance,
            frame,
            comm,
            stages.progress,
        )?;
        if optimised.stop == StopReason::Interrupted {
            stages.mark_interrupted();
        }
        Ok((atoms, optimised))
    })?;
    Ok(PlacedAtoms {
        atoms,
        distance,
        optimise_result: Some(optimised),
    })
}

/// Returns the brightness at which a distance from the image is smallest, which is that of the
/// features, and the reason.
fn densest_brightness<const D: usize>(
    image: &Image<D>,
    features: &Features<D>,
) -> (DenseRegion, String) {
    let is_bright = |value: f32| {
        let samples = image.as_slice().iter();
        let sum: f64 = samples.map(|&s| f64::from(s)).sum();
        f64::from(value) * image.as_slice().len() as f64 > sum
    };
    let kinds = features.resolved.iter();
    let mut regions = kinds.filter_map(|options| {
        let kind = options.kind;
        Some(match (options.mask, kind.brightness()) {
            (Some(value), _) if is_bright(value) => {
                (DenseRegion::Bright, format!("a thin mask of {value}"))
            }
            (Some(value), _) => (DenseRegion::Dark, format!("a thin mask of {value}")),
            (None, Some(Brightness::Bright)) => {
                (DenseRegion::Bright, format!("{kind}, which are bright"))
            }
            (None, Some(Brightness::Dark)) => {
                (DenseRegion::Dark, format!("{kind}, which are dark"))
            }
            (None, None) => return None,
        })
    });
    let last = regions.next_back();
    last.unwrap_or_else(|| (DenseRegion::Dark, "features neither bright nor dark".into()))
}

/// Returns the note of the report on how the distance was derived from the image.
pub(super) fn distance_note<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
) -> Result<Option<String>> {
    let Spacing::FromImage { .. } = params.spacing() else {
        return Ok(None);
    };
    let (dense, why) = densest_brightness(&*source.to_image()?, features);
    let extreme = match dense {
        DenseRegion::Dark => "darkest",
        DenseRegion::Bright => "brightest",
    };
    Ok(Some(format!(
        "distance from image: smallest where it is {extreme}, as it has {why}"
    )))
}

/// Returns the distance with the distances of labels that have their own. A label's distance below
/// the largest distance limits the distance in its samples; one above it scales the distance up.
fn distance_with_labels<const D: usize>(
    distance: Distance<D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    cancel: &CancelToken<'_>,
) -> Distance<D> {
    let Some(labelled) = &features.labels else {
        return distance;
    };
    let label_distance = |label: &LabelValue| {
        let options = params
            .spec()
            .label
            .iter()
            .find(|options| options.label == *label);
        options.and_then(|options| options.distance)
    };
    let distances: Vec<Option<f64>> = labelled.labels.iter().map(label_distance).collect();
    if distances.iter().all(Option::is_none) {
        return distance;
    }
    let max = params.spacing().max();
    let mut field = match &distance {
        Distance::Bricks(_) => return distance,
        Distance::Field(field) => field.clone(),
        Distance::Constant(d) => {
            let min = distances.iter().flatten().copied().fold(*d, f64::min);
            distance::coarse_field(features.potential.extent(), min, *d)
        }
    };
    let (dims, step) = (field.dims, field.step);
    for_each_sample(dims, |i, at| {
        let x = std::array::from_fn(|k| at[k] as f64 * step[k]);
        if let Some(target) = distances[labelled.label_at(x) as usize] {
            let d = &mut field.samples[i];
            *d = if target <= max {
                d.min(target as f32)
            } else {
                *d * (target / max) as f32
            };
        }
    });
    distance::limit_gradient(&mut field, MAX_DISTANCE_GROWTH, cancel);
    Distance::Field(field)
}

/// Returns the nominal distance of the parameters, without wells and labels.
fn base_distance<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    step: [f64; D],
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<DistributedDistance<D>> {
    let field = |image: &Image<D>| ScalarField {
        dims: image.dims(),
        step,
        samples: image.as_slice().to_vec(),
    };
    let label_distances = || {
        params
            .spec()
            .label
            .iter()
            .filter_map(|options| options.distance)
    };
    let min_with_labels = |d: f64| label_distances().fold(d, f64::min);
    let growth = MAX_DISTANCE_GROWTH;
    let gaps = |min, max| {
        DistributedDistance::from_gaps(features, DistanceLimits { min, max, growth }, cancel, comm)
    };
    let result = match params.spacing() {
        Spacing::Constant(d) if features.spacing.is_some() => {
            return gaps(min_with_labels(d), d.max(min_with_labels(d)));
        }
        Spacing::FromFeatureGaps { min, max } => {
            // Parts of labels may be thinner than the smallest distance.
            let spacing = features.spacing.iter().flatten();
            let min = match features.labels {
                Some(_) => spacing.fold(min, |min, d| min.min(f64::from(*d))),
                None => min,
            };
            return gaps(min_with_labels(min), max);
        }
        Spacing::FromFeatures { min, max } => {
            let limits = DistanceLimits { min, max, growth };
            return DistributedDistance::from_features(features, limits, cancel, comm);
        }
        Spacing::Constant(d) => Ok(Distance::Constant(d)),
        Spacing::FromImage { min, max } => {
            let image = source.to_image()?;
            let dense = densest_brightness(&image, features).0;
            distance::from_image(&field(&image), dense, min, max, MAX_DISTANCE_GROWTH, cancel)
        }
        Spacing::FromLaplacian { min, max } => laplacian_distance(
            &features.potential.to_dense(),
            features.sigma,
            min,
            max,
            MAX_DISTANCE_GROWTH,
            cancel,
        ),
        Spacing::FromCannyAtoms { .. } => Err(Error::Job(cause(
            "distance",
            "comes from Canny's points, but this seeding places no atoms on them",
            "give a --distance, or choose --seeding canny",
        ))),
        Spacing::FromDistanceMap { min, max } => match params.distance_map() {
            Some(map) if map.dims() == source.dims() => {
                distance::from_samples(field(map), min, max, MAX_DISTANCE_GROWTH, cancel)
            }
            map => Err(Error::Job(cause(
                "distances",
                format!(
                    "have {:?} samples, but the image has {:?}",
                    map.as_ref().map(|image| image.dims()).unwrap_or([0; D]),
                    source.dims()
                ),
                "give one distance per sample of the image",
            ))),
        },
    };
    result.map(DistributedDistance::Global)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::SelfComm;
    use crate::feature::{DetectionOptions, FeatureKind, detect};
    use crate::image::Geometry;
    use crate::job::Params;
    use crate::job::spec::{DistanceSource, MeshSpec, NominalDistance};

    #[test]
    fn a_distance_from_the_image_is_least_on_features_bright_or_dark() {
        for (sign, kind, word) in [
            (1.0, FeatureKind::Ridges, "brightest"),
            (-1.0, FeatureKind::Valleys, "darkest"),
        ] {
            let line = |x: usize| (-0.5 * ((x as f64 - 40.0) / 1.5).powi(2)).exp();
            let samples = (0..80 * 70).map(|i| (sign * line(i % 80)) as f32);
            let image = Image::new([80, 70], samples.collect(), Geometry::default());
            let features = detect(&image, &DetectionOptions::with_kind(kind, 4.0)).unwrap();
            let params = Params::new(MeshSpec {
                distance: NominalDistance::Range { min: 4.0, max: 7.0 },
                distance_from: DistanceSource::Image,
                ..MeshSpec::default()
            })
            .unwrap();
            let params = LatticeParams::new(&params, 1.0);
            let d = base_distance(
                ImageSource::InMemory(&image),
                &params,
                &features,
                [1.0; 2],
                &SelfComm,
                &CancelToken::never(),
            );
            let d = d.unwrap().into_global(&SelfComm).unwrap();
            let d = |x: f64| d.value_at([x, 35.0]);
            assert!(
                d(40.0) < 4.1 && d(5.0) > 6.0,
                "{kind}: {} {}",
                d(40.0),
                d(5.0)
            );
            let note = distance_note(ImageSource::InMemory(&image), &params, &features);
            let note = note.unwrap().unwrap();
            assert!(note.contains(word), "{note}");
        }
    }
}
