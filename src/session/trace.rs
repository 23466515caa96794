//! The progress of a job that also writes its lattices to a trace.

use std::path::Path;

use crate::files::vtk::DataArray;
use crate::image::Geometry;
use crate::job::{MeshSpec, Params};
use crate::memory;
use crate::mesh::Simplices;
use crate::mesh::delaunay::{delaunay, delaunay_plane};
use crate::progress::{LatticeSnapshot, OptimiseStatus, Progress, SizeEstimate, Stage};
use crate::report::{TracedLattice, quality, smallest_angles};
use crate::store::{FieldValue, MeshFile, PvdSeries, to_physical};
use crate::{Error, Result};

/// Passes the progress of the job on, writes its lattices to the trace, and stops the job once when
/// the user asks for it.
pub(super) struct TracedProgress<'a> {
    progress: &'a mut dyn Progress,
    path: Option<&'a Path>,
    /// The trace, which is created with the first lattice.
    trace: Option<PvdSeries>,
    /// Report entries of the lattices in the trace.
    pub(super) lattices: Vec<TracedLattice>,
    /// `true` if lattices lie in the plane z = 0.
    is_planar: bool,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// The error of a lattice that could not be written.
    pub(super) error: Option<Error>,
    stage: Stage,
    /// The stage in which the user asked to stop, if so.
    interrupted_stage: Option<Stage>,
}

impl<'a> TracedProgress<'a> {
    pub(super) fn new<const D: usize>(
        params: &Params<D>,
        spec: &'a MeshSpec,
        geometry: &Geometry<D>,
        progress: &'a mut dyn Progress,
    ) -> Self {
        let step = params.spec.metric.step(geometry);
        Self {
            progress,
            path: spec.trace.as_deref(),
            trace: None,
            lattices: Vec::new(),
            is_planar: D == 2,
            geometry: geometry.to_3d(),
            step: std::array::from_fn(|k| step.get(k).copied().unwrap_or(1.0)),
            error: None,
            stage: Stage::Reading,
            interrupted_stage: None,
        }
    }

    /// Adds a lattice to the trace.
    fn add_snapshot(&mut self, path: &Path, snapshot: &LatticeSnapshot<'_>) -> Result<()> {
        // The first lattice of a further optimisation is in the trace already.
        if self.trace.is_some() && snapshot.round == 0 {
            return Ok(());
        }
        if self.is_planar {
            let atoms: Vec<[f64; 2]> = snapshot.positions.iter().map(|x| [x[0], x[1]]).collect();
            let step = [self.step[0], self.step[1]];
            let geometry = self.geometry.flatten();
            return self.add_cells(path, &delaunay_plane(&atoms)?, step, &geometry, snapshot);
        }
        let (mesh, geometry) = (delaunay(snapshot.positions)?, self.geometry.clone());
        self.add_cells(path, &mesh, self.step, &geometry, snapshot)
    }

    /// Adds the cells of a lattice to the trace, in physical coordinates, with its energies and
    /// quality.
    fn add_cells<const D: usize, M: Simplices<D>>(
        &mut self,
        path: &Path,
        mesh: &M,
        step: [f64; D],
        geometry: &Geometry<D>,
        snapshot: &LatticeSnapshot<'_>,
    ) -> Result<()> {
        let energies = [
            ("energy", snapshot.energy),
            ("energy_lattice", snapshot.lattice_energy),
            ("energy_image", snapshot.image_energy),
        ];
        let field = |(name, value): (&str, f64)| (name.into(), FieldValue::F64s(vec![value]));
        let lattice_quality = quality(mesh);
        let mesh = to_physical(mesh, step, geometry);
        let frame = MeshFile {
            point_data: Vec::new(),
            cell_data: vec![DataArray::scalars(
                M::MIN_ANGLE_ARRAY,
                smallest_angles(&mesh),
            )],
            field_data: energies.into_iter().map(field).collect(),
            mesh,
        };
        let trace = match &mut self.trace {
            Some(trace) => trace,
            none => none.insert(PvdSeries::create(path)?),
        };
        let step = self.lattices.len();
        trace.add(step as f64, &frame)?;
        self.lattices.push(TracedLattice {
            step,
            worst_quality: lattice_quality.mean_ratio.worst,
            mean_quality: lattice_quality.mean_ratio_mean,
            energy: snapshot.energy,
            energy_lattice: snapshot.lattice_energy,
            energy_image: snapshot.image_energy,
        });
        Ok(())
    }
}

impl Progress for TracedProgress<'_> {
    fn stage(&mut self, stage: Stage) {
        memory::trim();
        self.stage = stage;
        self.progress.stage(stage);
    }

    fn note(&mut self, line: &str) {
        self.progress.note(line);
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        self.progress.estimate(estimate);
    }

    fn optimise_step(&mut self, status: &OptimiseStatus) {
        self.progress.optimise_step(status);
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.progress.fraction_done(fraction);
    }

    fn lattice(&mut self, snapshot: &LatticeSnapshot<'_>) {
        if let Some(path) = self.path
            && self.error.is_none()
        {
            self.error = self.add_snapshot(path, snapshot).err();
        }
    }

    fn wants_lattices(&self) -> bool {
        self.path.is_some()
    }

    fn keep_going(&mut self) -> bool {
        if self.error.is_some() {
            return false;
        }
        if self.interrupted_stage.is_none() && !self.progress.keep_going() {
            self.interrupted_stage = Some(self.stage);
            self.progress
                .note("interrupted: the lattice becomes a mesh if this takes no longer than two seconds; press Ctrl-C again to stop at once");
        }
        // After a stop of the optimisation, the later stages run in full.
        self.interrupted_stage
            .is_none_or(|stage| stage == Stage::Optimising && stage != self.stage)
    }
}
