//! The files of a job: which it reads, which it writes, and what is in those that it reads.

use std::path::{Path, PathBuf};

use crate::cli::common::feature::path_seeds;
use crate::cli::common::output::{check_output, same_file};
use crate::cli::parse;
use crate::cli::wells::WellFile;
use crate::error::cause;
use crate::image::Image;
use crate::image::formats::{self, ReadOptions};
use crate::improve;
use crate::job::asked::{
    Apart, BetaFrom, Cells, DistanceFrom, Job, LatticeJob, LatticeSpace, PlacementJob, Slivers,
    Start, VelocityFrom,
};
use crate::job::{CellKind, FixedAtom, Metric, Params, Spacing, Weight, WellPath};
use crate::lattice::seeding::Seeding;
use crate::store::output::no_partitions_error;
use crate::store::pvtu::is_pvtu;
use crate::{Error, Result, comm};

/// Where the mesh of an image goes: where the job says, or into this folder.
pub fn output_path(image: &Path, job: &Job) -> PathBuf {
    job.outputs.mesh.clone().unwrap_or_else(|| {
        Path::new(image.file_stem().unwrap_or(image.as_os_str())).with_extension("vtu")
    })
}

/// Outputs can be written, have the endings of what they hold, and replace no input (`config` is the
/// file of the job itself) and no other output.
///
/// # Errors
/// [`Error::Job`] that names the option; [`Error::Io`] for an output whose folder does not exist.
pub fn check_files(image: &Path, job: &Job, config: Option<&Path>) -> Result<()> {
    let mut inputs = vec![image];
    inputs.extend(config);
    inputs.extend(job.atoms_from.as_deref());
    inputs.extend(job.input.geometry_from.as_deref());
    if let Some(lattice) = job.lattice() {
        if let Some(wells) = &lattice.wells {
            inputs.extend(wells.files.iter().map(PathBuf::as_path));
        }
        if let BetaFrom::File(path) = &lattice.beta {
            inputs.push(path);
        }
        inputs.extend(distance_file(lattice));
    }
    if let Some(VelocityFrom::File(path)) = &job.velocity {
        inputs.push(path);
    }
    let mesh = output_path(image, job);
    let trace = job.lattice().and_then(|lattice| lattice.trace.as_ref());
    let outputs = [
        (Some(&mesh), "--output", "vtu"),
        (job.outputs.report.as_ref(), "--report", "json"),
        (trace, "--trace", "pvd"),
        (job.outputs.potential.as_ref(), "--potential-out", "vti"),
        (job.outputs.lines.as_ref(), "--lines", "vtp"),
        (job.outputs.page.as_ref(), "--page", "html"),
        (job.outputs.surfaces.as_ref(), "--surfaces", "vtp"),
    ];
    let mut seen: Vec<&Path> = Vec::new();
    for (path, option, ending) in outputs {
        let Some(path) = path else { continue };
        let both = [ending, "pvtu"];
        let endings = if ending == "vtu" {
            &both[..]
        } else {
            &both[..1]
        };
        check_output(path, option, endings, &inputs)?;
        if seen.iter().any(|other| same_file(other, path)) {
            let place = format!("{option} {}", path.display());
            return Err(Error::Job(cause(
                place,
                "is also the name of another output",
                "give each output a name of its own",
            )));
        }
        seen.push(path);
    }
    if is_pvtu(&mesh) && matches!(job.cells, Cells::Voronoi { .. }) {
        return Err(no_partitions_error(&mesh));
    }
    if let (Some(path), true) = (trace, comm::size() > 1) {
        return Err(Error::Job(cause(
            format!("--trace {}", path.display()),
            "is written by one process only",
            "omit it, or start this without mpirun",
        )));
    }
    if let (Some(folder), Some(_)) = (&job.outputs.checkpoint, trace) {
        return Err(Error::Job(cause(
            format!("--checkpoint {}", folder.display()),
            "keeps no lattices for --trace",
            "omit one of them",
        )));
    }
    Ok(())
}

/// The file of distances, if there is one.
fn distance_file(lattice: &LatticeJob) -> Option<&Path> {
    match &lattice.apart {
        Apart::Varying {
            by: DistanceFrom::File(path),
            ..
        } => Some(path),
        _ => None,
    }
}

/// What the pipeline is told; reads the files that the job names.
///
/// # Errors
/// Of those files; [`Error::Job`] for what there is not with `D` axes.
pub fn read_params<const D: usize>(job: &Job) -> Result<Params<D>> {
    let mut params = Params {
        feature: job.features.kind(),
        sigma: job.features.sigma,
        threshold: job.features.threshold(),
        feature_weights: job.features.weights(),
        path_seeds: path_seeds(job)?,
        labels: job.features.labels().to_vec(),
        keep_nulls: job.input.keeps_nulls(),
        fixed_atoms: job
            .atoms_from
            .as_deref()
            .map_or(Ok(Vec::new()), read_fixed_atoms)?,
        metric: metric(&job.metric)?,
        seed: job.seed.0,
        ..Params::default()
    };
    match &job.placement {
        PlacementJob::Canny => {
            params.seeding = Seeding::Canny;
            params.spacing = Spacing::for_canny(D);
        }
        PlacementJob::Lattice(lattice) => set_lattice_params(&mut params, lattice, job.seed.0)?,
    }
    match job.cells {
        Cells::Voronoi { weld } => {
            params.cells = CellKind::Voronoi;
            params.weld_ratio = weld;
        }
        Cells::Simplices { slivers, smooth } => {
            if D != 2 && smooth.is_some() {
                let problem = "is for the triangles of 2-D images";
                return Err(parse::option_error("--smooth", "", problem, "omit it"));
            }
            params.smoothing = smooth;
            params.min_dihedral = match slivers {
                Slivers::Left => None,
                Slivers::Removed {
                    method,
                    min_dihedral,
                } => {
                    params.sliver_method = method;
                    Some(min_dihedral)
                }
            };
        }
    }
    if D == 2 && params.sliver_method == improve::SliverMethod::Exude {
        return Err(Error::Job(cause(
            "--slivers exude",
            "does nothing in 2-D, where the Delaunay triangulation has no slivers",
            "omit it",
        )));
    }
    Ok(params)
}

fn set_lattice_params<const D: usize>(
    params: &mut Params<D>,
    lattice: &LatticeJob,
    seed: u64,
) -> Result<()> {
    params.spacing = match lattice.apart {
        Apart::Everywhere(d) => Spacing::Constant(d),
        Apart::Varying { min, max, ref by } => match by {
            DistanceFrom::Gaps => Spacing::FromFeatureGaps { min, max },
            DistanceFrom::Features => Spacing::FromFeatures { min, max },
            DistanceFrom::Image => Spacing::FromImage { min, max },
            DistanceFrom::Laplacian => Spacing::FromLaplacian { min, max },
            DistanceFrom::File(_) => Spacing::FromDistanceMap { min, max },
        },
    };
    params.distance_map = match distance_file(lattice) {
        Some(path) => {
            let what = "give one distance per sample of the image";
            Some(Box::new(read_image("--distance-from", path, what)?))
        }
        None => None,
    };
    params.beta = match &lattice.beta {
        BetaFrom::Constant(beta) => Weight::Constant(*beta),
        BetaFrom::File(path) => Weight::Image(Box::new(read_beta(path)?)),
    };
    if let Some(wells) = &lattice.wells {
        params.wells = wells
            .files
            .iter()
            .map(|path| read_well(path))
            .collect::<Result<_>>()?;
        params.well_distance = wells.distance;
    }
    params.seeding = match lattice.start {
        Start::Fcc => Seeding::Fcc,
        Start::Grown => Seeding::Grown,
        Start::Refine => Seeding::Refine { seed },
        Start::Guide { most } => Seeding::Guide {
            seed,
            max_atoms: most.unwrap_or(usize::MAX),
        },
        Start::Projection => Seeding::Projection,
    };
    params.evaluator = lattice.energy.evaluator();
    params.kappa = lattice.energy.kappa();
    params.optimizer = lattice.optimizer;
    params.rounds = lattice.rounds;
    params.coarse_passes = lattice.coarse_passes;
    Ok(())
}

/// Lattice space for an image of `D` axes.
fn metric<const D: usize>(space: &LatticeSpace) -> Result<Metric<D>> {
    match space {
        LatticeSpace::Samples => Ok(Metric::Samples),
        LatticeSpace::Physical => Ok(Metric::Physical),
        LatticeSpace::Shape => Ok(Metric::Shape),
        LatticeSpace::Scales(scales) => match scales.as_slice().try_into() {
            Ok(scales) => Ok(Metric::Scales(scales)),
            Err(_) => {
                let text: Vec<String> = scales.iter().map(f64::to_string).collect();
                let problem = format!("has {} scales, but the image {D} axes", scales.len());
                let remedy = "give one scale per axis";
                Err(parse::option_error(
                    "--metric",
                    &text.join(","),
                    &problem,
                    remedy,
                ))
            }
        },
    }
}

fn read_fixed_atoms<const D: usize>(path: &Path) -> Result<Vec<FixedAtom<D>>> {
    let named = |(line, position)| FixedAtom {
        name: format!("{}:{line}", path.display()),
        position,
    };
    Ok(parse::points(path)?.into_iter().map(named).collect())
}

fn read_well<const D: usize>(path: &Path) -> Result<WellPath<D>> {
    let file = WellFile::<D>::read(path, D - 1)?;
    Ok(WellPath {
        name: path.display().to_string(),
        radius: file.points.iter().map(|p| p.2).fold(0.0, f64::max),
        points: file.points.iter().map(|p| p.1).collect(),
    })
}

/// An image that an option names; `remedy` says what to give.
fn read_image<const D: usize>(option: &str, path: &Path, remedy: &str) -> Result<Image<D>> {
    let read = formats::read_any(path, &ReadOptions::default())?;
    read.into_image().ok_or_else(|| {
        Error::Job(cause(
            format!("{option} {}", path.display()),
            format!("is not a {D}-D image"),
            remedy,
        ))
    })
}

/// An image of weights.
fn read_beta<const D: usize>(path: &Path) -> Result<Image<D>> {
    let image = read_image("--beta", path, "give one weight per sample of the image")?;
    let stats = image.stats();
    if stats.first_non_finite.is_some() || stats.min < 0.0 || stats.max >= 1.0 {
        return Err(Error::Job(cause(
            format!("--beta {}", path.display()),
            format!("holds weights from {} to {}, or none", stats.min, stats.max),
            "give weights that are at least 0 and below 1",
        )));
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_default_the_mesh_is_named_after_the_image() {
        let image = Path::new("absent/survey.sgy");
        assert_eq!(output_path(image, &Job::default()), Path::new("survey.vtu"));
        assert_eq!(
            read_params::<3>(&Job::default()).unwrap(),
            Params::default()
        );
    }
}
