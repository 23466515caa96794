//! The files that a job writes beside its mesh.

use std::io::Write;
use std::path::Path;

use super::Answer;
use crate::Result;
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::image::{Image, ImageSource, formats};
use crate::job::output::cells::cell_mesh_file;
use crate::job::output::{simplex_mesh_file, with_image};
use crate::job::{MeshResult, MeshSpec, Outcome};
use crate::mesh::Simplices;
use crate::report::{Clock, Report, StageCost};
use crate::store::StoredMesh;
use crate::surfaces::extract::default_surfaces;

/// Writes the other files of a job whose mesh was written to `output`, and returns the answer with the
/// report.
pub(super) fn write_others<const D: usize, M: Simplices<D>>(
    spec: &MeshSpec,
    output: &Path,
    mut outcome: Outcome<D, M>,
    image: ImageSource<'_, D>,
    (mut clock, details): (Clock, bool),
    mut answer: Answer,
) -> Result<Answer> {
    if let Some(path) = &spec.lines {
        outcome.write_lines(path)?;
    }
    if let Some(path) = &spec.potential_out {
        let potential = outcome.features.potential.to_dense();
        formats::write(path, &potential.into_image(image.geometry()))?;
    }
    clock.end();

    let mut report = std::mem::take(&mut outcome.report);
    report.parameters = serde_json::to_value(spec).unwrap_or_default();
    add_own_stages(&mut report, clock.costs());
    let json = report.to_json();
    if let Some(path) = &spec.report {
        crate::files::atomic_write(path, |out| writeln!(out, "{json:#}"))?;
    }
    answer = answer.with_file(output, "");
    if let Some(path) = &spec.page {
        let written = write_page(path, output, &*image.to_image()?, &outcome, json.clone())?;
        answer = answer.with_file(path, &written.size_text());
    }
    if let Some(path) = &spec.surfaces {
        let surfaces = write_surfaces(path, output, &outcome)?;
        answer = answer.with_file(path, &format!("{surfaces} surfaces"));
    }
    let table = if details {
        report.table()
    } else {
        report.summary()
    };
    answer.text = table.trim_end().to_string();
    answer.json = json;
    Ok(answer)
}

/// Adds the stages before and after the job.
fn add_own_stages(report: &mut Report, costs: &[StageCost]) {
    report.stages.splice(0..0, costs[..1].iter().cloned());
    report.stages.extend_from_slice(&costs[1..]);
}

/// Writes the faces on features of a mesh that was written to `output`, each with the number of its
/// surface. Returns the number of surfaces.
fn write_surfaces<const D: usize, M: Simplices<D>>(
    path: &Path,
    output: &Path,
    outcome: &Outcome<D, M>,
) -> Result<usize> {
    let place = output.display().to_string();
    match &outcome.mesh {
        MeshResult::Simplices(annotated) => {
            let stored = StoredMesh::new(
                outcome.with_kept_cells(simplex_mesh_file(outcome, annotated))?,
                &place,
            )?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            file.write(path)?;
            Ok(count)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let stored = StoredMesh::new(
                outcome.with_kept_cells(cell_mesh_file(outcome, mesh, *weld))?,
                &place,
            )?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            file.write(path)?;
            Ok(count)
        }
    }
}

/// Writes the page of a mesh that was written to `output`.
fn write_page<const D: usize, M: Simplices<D>>(
    path: &Path,
    output: &Path,
    image: &Image<D>,
    outcome: &Outcome<D, M>,
    report: serde_json::Value,
) -> Result<PageStats> {
    let name = output.file_name().unwrap_or(output.as_os_str());
    let info = PageInfo {
        title: name.to_string_lossy().into_owned(),
        report,
        parameters: outcome.provenance.parameters.clone(),
        input_hash: outcome.provenance.input_sha256.clone(),
    };
    let place = output.display().to_string();
    // The page shows the mesh as its file holds it.
    match &outcome.mesh {
        MeshResult::Simplices(annotated) => {
            let file = with_image(
                outcome.with_kept_cells(simplex_mesh_file(outcome, annotated))?,
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let file = with_image(
                outcome.with_kept_cells(cell_mesh_file(outcome, mesh, *weld))?,
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
    }
}
