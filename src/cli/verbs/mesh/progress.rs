//! The progress of a job on the console, and its trace of lattices.

use std::path::Path;

use crate::cli::allocator;
use crate::cli::console::Console;
use crate::cli::interrupts::Interrupts;
use crate::comm::Comm;
use crate::files::vtk::DataArray;
use crate::image::Geometry;
use crate::job::{MeshSpace, MeshSpec, Meshing, Params};
use crate::memory::Bytes;
use crate::mesh::Simplices;
use crate::mesh::delaunay::{delaunay, delaunay_plane};
use crate::progress::{LatticeSnapshot, OptimizeStatus, Progress, SizeEstimate, Stage};
use crate::report::{TracedLattice, quality, smallest_angles};
use crate::store::{FieldValue, MeshFile, PvdSeries, to_physical};
use crate::{Error, Result};

/// Shows the progress of the job, writes its lattices to the trace, and stops the job when the user
/// asks for it.
pub(super) struct MeshProgress<'a> {
    console: &'a mut Console,
    interrupts: &'a Interrupts,
    comm: &'a dyn Comm,
    trace_path: Option<&'a Path>,
    /// The trace, which is created with the first lattice.
    trace: Option<PvdSeries>,
    /// Report entries of the lattices in the trace.
    pub(super) traced_lattices: Vec<TracedLattice>,
    /// `true` if lattices lie in the plane z = 0.
    is_planar: bool,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// The error of a lattice that could not be written.
    pub(super) trace_error: Option<Error>,
    stage: Stage,
    /// The stage in which the user asked to stop, if so.
    interrupted_stage: Option<Stage>,
}

impl<'a> MeshProgress<'a> {
    pub(super) fn new<const D: usize>(
        params: &Params<D>,
        spec: &'a MeshSpec,
        geometry: &Geometry<D>,
        interrupts: &'a Interrupts,
        comm: &'a dyn Comm,
        console: &'a mut Console,
    ) -> Self
    where
        MeshSpace<D>: Meshing<D>,
    {
        let step = params.spec.metric.step(geometry);
        Self {
            console,
            interrupts,
            comm,
            trace_path: spec.trace.as_deref(),
            trace: None,
            traced_lattices: Vec::new(),
            is_planar: D == 2,
            geometry: geometry.to_3d(),
            step: std::array::from_fn(|k| step.get(k).copied().unwrap_or(1.0)),
            trace_error: None,
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
        let step = self.traced_lattices.len();
        trace.add(step as f64, &frame)?;
        self.traced_lattices.push(TracedLattice {
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

impl Progress for MeshProgress<'_> {
    fn stage(&mut self, stage: Stage) {
        allocator::trim();
        self.stage = stage;
        self.console.begin_stage(stage);
        self.interrupts.set_stage(stage, self.comm);
    }

    fn note(&mut self, line: &str) {
        self.console.note(line);
    }

    fn estimate(&mut self, estimate: &SizeEstimate) {
        let SizeEstimate {
            atoms,
            cells,
            bytes,
        } = *estimate;
        self.console.log_line(format_args!(
            "about {} atoms, {} cells, {} of memory",
            round_to_two_digits(atoms),
            round_to_two_digits(cells),
            Bytes(bytes)
        ));
    }

    fn optimize_step(&mut self, progress: &OptimizeStatus) {
        self.console.progress(
            progress.evaluations as f64 / progress.max_evaluations as f64,
            format_args!("round {}, energy {:.4e}", progress.round, progress.energy),
        );
    }

    fn fraction_done(&mut self, fraction: f64) {
        self.console.progress(fraction, "");
    }

    fn lattice(&mut self, snapshot: &LatticeSnapshot<'_>) {
        if let Some(path) = self.trace_path
            && self.trace_error.is_none()
        {
            self.trace_error = self.add_snapshot(path, snapshot).err();
        }
    }

    fn wants_lattices(&self) -> bool {
        self.trace_path.is_some()
    }

    fn keep_going(&mut self) -> bool {
        if self.trace_error.is_some() {
            return false;
        }
        if self.interrupted_stage.is_none() && self.interrupts.is_requested() {
            self.interrupted_stage = Some(self.stage);
            self.console
                .note("interrupted: the lattice becomes a mesh if this takes no longer than two seconds; press Ctrl-C again to stop at once");
        }
        // After a stop of the optimisation, the later stages run in full.
        self.interrupted_stage
            .is_none_or(|stage| stage == Stage::Optimising && stage != self.stage)
    }
}

/// Formats a number with two significant digits.
fn round_to_two_digits(number: f64) -> String {
    match number {
        n if n >= 1e6 => format!("{:.1} million", n / 1e6),
        n => {
            let step = 10f64.powf((n.max(10.0)).log10().floor() - 1.0);
            format!("{:.0}", (n / step).round() * step)
        }
    }
}
