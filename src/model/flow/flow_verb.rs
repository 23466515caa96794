//! Computes the flow through a mesh as `atomesh flow` does.

use super::driver::{ComputedFlow, barriers, flow_through_cells, flow_through_elements};
use super::faults::FaultResistance;
use super::flow_spec::FlowSpec;
use super::report::FlowReport;
use super::{Barriers, Rock, Streamlines};
use crate::error::cause;
use crate::geometry::to_3d;
use crate::image::formats::ReadImage;
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Dimension, Simplices, Space};
use crate::progress::{CancelToken, Progress, Stage};
use crate::store::input::{MeshInput, length_unit_warning, mesh_in_depth, time_warning};
use crate::store::stored_mesh::read_live;
use crate::store::with_mesh;
use crate::store::{AnyMesh, MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

/// Default number of streamlines.
const DEFAULT_LINE_COUNT: usize = 200;

/// Factor of the mobility in cells without data. It is not 0, so that the pressure is known there.
const DEAD_MOBILITY_RATIO: f64 = 1e-12;

/// A computed flow.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FlowOutcome {
    /// The mesh, split along its faults, with pressure (Pa) and Darcy velocity (m/s).
    pub mesh: AnyMesh,
    /// The report.
    pub report: FlowReport,
    /// Streamlines, if the options ask for them. In the plane, z is 0.
    pub streamlines: Option<Streamlines<3>>,
}

impl FlowOutcome {
    /// Writes the files beside the mesh that the options name: the streamlines.
    ///
    /// # Errors
    /// Returns [`Error::Io`](crate::Error::Io) if a file cannot be written.
    pub fn write_others(&self, spec: &FlowSpec) -> Result<()> {
        match (&spec.streamlines, &self.streamlines) {
            (Some(path), Some(lines)) => lines.write(path),
            _ => Ok(()),
        }
    }
}

/// Computes steady flow through a mesh, from sources to sinks, as `atomesh flow` does. Lengths of the
/// mesh are assumed to be in metres.
///
/// ```
/// use atomesh::image::synth::{self, SyntheticKind};
/// use atomesh::progress::NoProgress;
/// use atomesh::{FlowSpec, MeshSpec};
///
/// let options = synth::Options { dims: [40, 36, 32], ..Default::default() };
/// let image = synth::make(SyntheticKind::Sphere, &options)?.image;
/// let spec = MeshSpec { distance: "6".parse()?, ..MeshSpec::default() };
/// let mesh = atomesh::mesh(&image, &spec, &mut NoProgress)?.mesh_file(&image)?;
/// let spec = FlowSpec {
///     pressure: vec!["xmin=2e5".parse()?, "xmax=1e5".parse()?],
///     ..FlowSpec::default()
/// };
/// let outcome = atomesh::flow(mesh, &spec, &mut NoProgress)?;
/// assert!(outcome.report.solver.throughput > 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Returns the errors of [`FlowSpec::validate`], those of reading the files that the options name,
/// and [`Error::Flow`] if the flow cannot be computed.
pub fn flow<'a>(
    mesh: impl Into<MeshInput<'a>>,
    spec: &FlowSpec,
    progress: &mut dyn Progress,
) -> Result<FlowOutcome> {
    spec.validate()?;
    let MeshInput {
        mesh,
        name,
        read_image,
    } = mesh.into();
    let run = FlowRun {
        spec,
        name,
        read_image,
        progress,
    };
    with_mesh!(mesh,
        simplices file => run.through_elements(file),
        cells file => run.through_cells(file)
    )
}

/// The options and the progress of a computation.
struct FlowRun<'a> {
    spec: &'a FlowSpec,
    /// The name of the mesh in messages.
    name: &'a str,
    read_image: ReadImage<'a>,
    progress: &'a mut dyn Progress,
}

impl FlowRun<'_> {
    /// Computes the flow through triangles or tetrahedra.
    fn through_elements<const D: usize, M: Simplices<D>>(
        mut self,
        file: MeshFile<M>,
    ) -> Result<FlowOutcome>
    where
        MeshFile<M>: Into<AnyMesh>,
    {
        let mut stored = self.prepare(file)?;
        let rock = self.rock(&stored)?;
        let conditions = self.spec.conditions()?;
        let to_cells = |mesh: &M| PolyMesh::from_simplices(mesh, &[], &[]);
        let barriers = self.barriers(&mut stored, to_cells)?;
        let lines = self.line_count();
        let computed = self.solve(|cancel| {
            flow_through_elements(stored, rock, &barriers, &conditions, lines, cancel)
        })?;
        Ok(outcome(computed))
    }

    /// Computes the flow through Voronoi cells (or other polyhedra or polygons).
    fn through_cells<const D: usize>(mut self, file: MeshFile<PolyMesh<D>>) -> Result<FlowOutcome>
    where
        Space<D>: Dimension<D>,
        MeshFile<PolyMesh<D>>: Into<AnyMesh>,
    {
        let mut stored = self.prepare(file)?;
        let rock = self.rock(&stored)?;
        let conditions = self.spec.conditions()?;
        let barriers = self.barriers(&mut stored, |mesh: &PolyMesh<D>| Ok(mesh.clone()))?;
        let lines = self.line_count();
        let (computed, notes) = self.solve(|cancel| {
            flow_through_cells(stored, &rock, &barriers, &conditions, lines, cancel)
        })?;
        notes.iter().for_each(|note| self.progress.note(note));
        Ok(outcome(computed))
    }

    /// Prepares the mesh and checks that its cells fill it. Warns if a coordinate is time.
    fn prepare<const D: usize, M: Storable<D>>(
        &mut self,
        file: MeshFile<M>,
    ) -> Result<StoredMesh<D, M>> {
        let velocity = self.spec.velocity.as_ref();
        let (name, progress) = (self.name, &mut *self.progress);
        let stored = mesh_in_depth(file, velocity, name, self.read_image, progress)?;
        stored.check_filled(name)?;
        let geometry = &stored.space.geometry;
        let warnings = [time_warning(geometry), length_unit_warning(geometry)];
        for warning in warnings.iter().flatten() {
            progress.note(warning);
        }
        Ok(stored)
    }

    /// Returns the mobility of every cell. Cells without data hardly conduct.
    fn rock<const D: usize, M: Storable<D>>(&mut self, stored: &StoredMesh<D, M>) -> Result<Rock> {
        let rock = self.spec.rock(stored)?;
        let cells = stored.lattice.len();
        let Some(live) = read_live(&stored.arrays.cell_data, cells) else {
            return Ok(rock);
        };
        let is_dead: Vec<bool> = live.iter().map(|share| *share == 0.0).collect();
        let count = is_dead.iter().filter(|is_dead| **is_dead).count();
        if count == 0 {
            return Ok(rock);
        }
        self.progress.note(&format!(
            "{count} of {cells} cells hold no data (cell array live): nothing flows there"
        ));
        Ok(rock.scaled_where(&is_dead, DEAD_MOBILITY_RATIO))
    }

    /// Returns the number of streamlines; `None` if the options ask for none.
    fn line_count(&self) -> Option<usize> {
        let default = self.spec.streamlines.as_ref().map(|_| DEFAULT_LINE_COUNT);
        self.spec.lines.or(default)
    }

    /// Runs the solver, which ends soon after the caller asks to stop.
    fn solve<T>(&mut self, work: impl FnOnce(&CancelToken<'_>) -> T) -> T {
        self.progress.stage(Stage::Pressure);
        let progress = &mut *self.progress;
        let callback = &mut |fraction: Option<f64>| {
            if let Some(fraction) = fraction {
                progress.fraction_done(fraction);
            }
            progress.keep_going()
        };
        CancelToken::run_with_progress(callback, work)
    }

    /// Returns the faces that resist flow. `to_cells` converts the mesh if faults are extended.
    fn barriers<const D: usize, M: Storable<D>>(
        &mut self,
        stored: &mut StoredMesh<D, M>,
        to_cells: impl FnOnce(&M) -> Result<PolyMesh<D>>,
    ) -> Result<Barriers> {
        let options = &self.spec.fault_options;
        let laws = options.laws(FaultResistance::Closed)?;
        if laws.law.is_open() && laws.overrides.is_empty() {
            return Ok(Barriers::default());
        }
        let name = self.name;
        match stored.feature_marks() {
            Some(marks) => {
                self.progress.stage(Stage::GroupingFaults);
                let distance = self.spec.extend_faults;
                let cells = distance
                    .map(|_| stored.with_world_mesh(to_cells))
                    .transpose()?;
                let extend = distance.zip(cells.as_ref());
                let found = barriers(stored, &marks, &laws, extend)?;
                if found.is_idle {
                    self.progress.note(&format!(
                        "{name} has surfaces, but no faults, so that nothing resists flow; --barriers says which surfaces resist"
                    ));
                }
                for fault in &found.extended {
                    self.progress.note(&fault.note(D));
                }
                Ok(found.barriers)
            }
            None if options.faults.is_some() || !laws.overrides.is_empty() => {
                let remedy = "give a mesh that atomesh mesh wrote, or open faults";
                let cause = cause(
                    name,
                    "does not say which of its faces lie on features",
                    remedy,
                );
                Err(Error::Flow(cause.with_parameter("faults")))
            }
            None => {
                self.progress.note(&format!(
                    "{name} does not say which faces lie on features, so that nothing counts as a fault"
                ));
                Ok(Barriers::default())
            }
        }
    }
}

/// Returns the outcome for a mesh of any kind and dimension.
fn outcome<const D: usize, M>(computed: ComputedFlow<D, M>) -> FlowOutcome
where
    MeshFile<M>: Into<AnyMesh>,
{
    FlowOutcome {
        mesh: computed.file.into(),
        report: computed.report,
        streamlines: computed.streamlines.map(|lines| Streamlines {
            points: lines.points.into_iter().map(to_3d).collect(),
            time: lines.time,
            ends: lines.ends,
            rate: lines.rate,
        }),
    }
}
