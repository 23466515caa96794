//! The files that a job of `atomesh mesh` reads and writes.

use std::path::{Path, PathBuf};

use crate::error::cause;
use crate::files::output::{check_output, same_file};
use crate::job::MeshSpec;
use crate::job::output::no_partitions_error;
use crate::job::spec::{CellKind, DistanceSource, NumberOrFile};
use crate::mesh_file::pvtu::is_pvtu;
use crate::{Error, Result};

/// Returns the path of the mesh: the one that the options name, or one in this folder that is named
/// after the image.
pub fn output_path(image: &Path, spec: &MeshSpec) -> PathBuf {
    spec.output.clone().unwrap_or_else(|| {
        Path::new(image.file_stem().unwrap_or(image.as_os_str())).with_extension("vtu")
    })
}

/// Checks that all outputs can be written, have the right file endings, and replace neither an
/// input (`config` is the configuration file) nor another output.
///
/// # Errors
/// Returns [`Error::Job`] that names the option, and [`Error::Io`] for an output whose folder does
/// not exist.
pub fn check_files(
    image: &Path,
    spec: &MeshSpec,
    config: Option<&Path>,
    rank_count: usize,
) -> Result<()> {
    let mut inputs = vec![image];
    inputs.extend(config);
    inputs.extend(spec.input.geometry_from.as_deref());
    let surfaces = spec
        .surface
        .iter()
        .chain(&spec.topography)
        .chain(&spec.atoms_from)
        .chain(&spec.well);
    inputs.extend(surfaces.map(|surface| surface.path.as_path()));
    inputs.extend(spec.beta.file());
    if let DistanceSource::File(path) = &spec.distance_from {
        inputs.push(path);
    }
    inputs.extend(spec.velocity.as_ref().and_then(NumberOrFile::file));
    let mesh = output_path(image, spec);
    let trace = spec.trace.as_ref();
    let outputs = [
        (Some(&mesh), "--output", "vtu"),
        (spec.report.as_ref(), "--report", "json"),
        (trace, "--trace", "pvd"),
        (spec.potential_out.as_ref(), "--potential-out", "vti"),
        (spec.lines.as_ref(), "--lines", "vtp"),
        (spec.page.as_ref(), "--page", "html"),
        (spec.surfaces.as_ref(), "--surfaces", "vtp"),
    ];
    let mut seen: Vec<&Path> = Vec::new();
    for (path, option, ending) in outputs {
        let Some(path) = path else { continue };
        let mesh_endings = [ending, "pvtu"];
        let endings = if ending == "vtu" {
            &mesh_endings[..]
        } else {
            &mesh_endings[..1]
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
    if is_pvtu(&mesh) && spec.cell_kind() == CellKind::Voronoi {
        return Err(no_partitions_error(&mesh));
    }
    if is_pvtu(&mesh) && !spec.surface.is_empty() {
        return Err(Error::Job(cause(
            mesh.display(),
            "does not hold the names of surfaces",
            "give a name that ends in .vtu",
        )));
    }
    if let (Some(path), true) = (trace, rank_count > 1) {
        return Err(Error::Job(cause(
            format!("--trace {}", path.display()),
            "is written by one process only",
            "omit it, or start this without mpirun",
        )));
    }
    if let (Some(folder), Some(_)) = (&spec.checkpoint, trace) {
        return Err(Error::Job(cause(
            format!("--checkpoint {}", folder.display()),
            "keeps no lattices for --trace",
            "omit one of them",
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_default_the_mesh_is_named_after_the_image() {
        let image = Path::new("absent/survey.sgy");
        assert_eq!(
            output_path(image, &MeshSpec::default()),
            Path::new("survey.vtu")
        );
    }
}
