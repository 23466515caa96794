//! The files that a job writes beside its mesh.

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::cli::common::output::potential_image;
use crate::cli::console::Console;
use crate::cli::verbs::report::written_message;
use crate::export::page::{self, MAX_PAGE_BYTES, PageInfo, PageStats};
use crate::image::{Image, ImageSource};
use crate::job::output::cells::cell_mesh_file;
use crate::job::output::{simplex_mesh_file, with_image};
use crate::job::{MeshResult, MeshSpace, MeshSpec, Meshing, Outcome};
use crate::mesh::Simplices;
use crate::report::{Clock, Report, StageCost};
use crate::store::StoredMesh;
use crate::surfaces::extract::default_surfaces;

/// A mesh that was written, with its report.
pub(super) struct WrittenMesh<'a, const D: usize>
where
    MeshSpace<D>: Meshing<D>,
{
    pub(super) spec: &'a MeshSpec,
    pub(super) output: &'a Path,
    /// `true` if the whole report is printed.
    pub(super) shows_details: bool,
    pub(super) outcome: Outcome<D>,
}

impl<const D: usize, M: Simplices<D>> WrittenMesh<'_, D>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    /// Writes the other files of the job, and reports the result.
    pub(super) fn write_others(
        self,
        image: ImageSource<'_, D>,
        mut clock: Clock,
        console: &mut Console,
    ) -> Result<()> {
        let Self {
            spec,
            output,
            shows_details,
            mut outcome,
        } = self;
        if let Some(path) = &spec.lines {
            outcome.write_lines(path)?;
        }
        if let Some(path) = &spec.potential_out {
            let potential = outcome.features.potential.to_dense();
            console.write_image(path, potential_image(potential, image.geometry()))?;
        }
        clock.end();

        let mut report = std::mem::take(&mut outcome.report);
        report.parameters = serde_json::to_value(spec).unwrap_or_default();
        add_own_stages(&mut report, clock.costs());
        let json = report.to_json();
        if let Some(path) = &spec.report {
            crate::files::atomic_write(path, |out| writeln!(out, "{json:#}"))?;
        }
        let table = if shows_details {
            report.table()
        } else {
            report.summary()
        };
        let mut text = format!("{}\nwrote {}", table.trim_end(), output.display());
        if let Some(path) = &spec.page {
            let written = write_page(path, output, &*image.to_image()?, &outcome, json.clone())?;
            text = format!("{text}\n{}", written_message(path, written));
        }
        if let Some(path) = &spec.surfaces {
            let surfaces = write_surfaces(path, output, &outcome, console)?;
            text = format!("{text}\nwrote {}: {surfaces} surfaces", path.display());
        }
        console.result(text, &json);
        Ok(())
    }
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
    outcome: &Outcome<D>,
    console: &mut Console,
) -> Result<usize>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
    let place = output.display().to_string();
    match &outcome.mesh {
        MeshResult::Simplices(annotated) => {
            let stored = StoredMesh::new(simplex_mesh_file(outcome, annotated), &place)?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            console.write_surfaces(path, file)?;
            Ok(count)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let stored = StoredMesh::new(cell_mesh_file(outcome, mesh, *weld), &place)?;
            let file = default_surfaces(&stored)?;
            let count = file.names.len();
            console.write_surfaces(path, file)?;
            Ok(count)
        }
    }
}

/// Writes the page of a mesh that was written to `output`.
fn write_page<const D: usize, M: Simplices<D>>(
    path: &Path,
    output: &Path,
    image: &Image<D>,
    outcome: &Outcome<D>,
    report: serde_json::Value,
) -> Result<PageStats>
where
    MeshSpace<D>: Meshing<D, Mesh = M>,
{
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
                simplex_mesh_file(outcome, annotated),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
        MeshResult::Voronoi { mesh, weld } => {
            let file = with_image(
                cell_mesh_file(outcome, mesh, *weld),
                ImageSource::InMemory(image),
            )?;
            let stored = StoredMesh::new(file, &place)?;
            page::write(path, Some(image), &stored, &info, MAX_PAGE_BYTES)
        }
    }
}
